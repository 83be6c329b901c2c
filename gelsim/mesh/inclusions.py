"""What lies inside an object: the flesh under a skin and the grains in it, as solids whose surfaces the mesh has to follow.

A skin is what lies less than its thickness inside the surface, base left out: its inner boundary is the profile moved inward, line by line
and arc by arc, which is exact where the profile is convex, and where it is not (the crease between a tomato's ball and its foot) keeps a
sharp crease for the round one that a constant distance has. Grains are balls put at random, one after the other, where they come no nearer
than a quarter of their radius to each other, to the surface (or to the skin) and to the base.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from gelsim.errors import SceneError
from gelsim.geometry import TriMesh, winding_numbers
from gelsim.scene.definition import Body
from gelsim.scene.materials import parts
from gelsim.scene.shape_table import SHAPES
from gelsim.shape.outlines import profile, sides
from gelsim.shape.shapes import closed, coarse_surface, hull_points, runs, solid
from gelsim.shape.solids import HULL_STEP, Array, Ball, Patch, Plane, Segment, Solid, patch_distances, solid_surface
from gelsim.units import MM

Point = tuple[float, float]
_CLEARANCE = 0.25
"""Room around a grain, over its radius: a tet or two fit in."""
_TRIES = 2000
"""Rounds of random places, one a grain."""


@dataclass(frozen=True, eq=False)
class Inclusion:
    """A solid inside the object whose surface parts two materials."""

    region: int
    """What lies inside, as an index into `materials.parts`."""
    shape: Solid
    size: float
    """Edge length [m] that the surface asks for: a skin's thickness, a grain's radius."""


def inclusions(body: Body, symmetry: frozenset[str], step: float = HULL_STEP) -> tuple[Inclusion, ...]:
    """The flesh within the skin, then the grains, cut at the planes of `symmetry`; none of a body of one material.

    Raises:
        SceneError: The skin is so thick that it leaves nothing, or the grains do not fit.
    """
    names, found = parts(body), []
    if "skin" in names:
        found.append(Inclusion(0, flesh(body, symmetry, step), body.skin.thickness_mm * MM))
    if "grains" in names:
        assert not symmetry, "grains lie at random"
        radius = body.grains.radius_mm * MM
        balls = tuple(Ball((x, y, z), radius) for x, y, z in grain_centres(body).tolist())
        found.append(Inclusion(names.index("grains"), _solid_of(balls), radius))
    return tuple(found)


def flesh(body: Body, symmetry: frozenset[str] = frozenset(), step: float = HULL_STEP) -> Solid:
    """What a skin encloses."""
    row, thickness = SHAPES[body.shape], body.skin.thickness_mm * MM
    segments = _moved_inward(profile(body), thickness)
    inner, length = body, 2 * (sides(body)[1] - thickness)
    if not segments or (row.drawn and length <= 0):
        raise SceneError(f"object.skin.thickness_mm = {body.skin.thickness_mm:g} mm leaves nothing of the {body.shape} inside it")
    patches: list[Patch] = [*runs(segments, row.turned)]
    if row.drawn:
        inner = replace(body, length_mm=length / MM)
        patches += [Plane((0.0, y, 0.0), length / 2) for y in (1.0, *(() if "y" in symmetry else (-1.0,)))]
    closed_patches, roles = closed(patches, body, symmetry)
    if row.convex:
        return Solid(closed_patches, roles, hull_points(segments, inner, symmetry, step))
    return Solid(closed_patches, roles, *coarse_surface(segments, (), inner, symmetry, step))


def _moved_inward(segments: tuple[Segment, ...], by: float) -> tuple[Segment, ...]:
    """A profile from the axis to the base, moved to its left by a distance; empty where a piece of it is swallowed."""
    moved = [_shifted(segment, by) for segment in segments]
    curves = [segment for segment in moved if segment is not None]
    if len(curves) < len(segments):
        return ()
    top = segments[-1].end[1]
    joints = [_meet(Segment((0.0, -1.0), (0.0, 1.0)), curves[0], curves[0].start)]
    for k in range(len(curves) - 1):
        smooth = segments[k].tangents()[1] @ segments[k + 1].tangents()[0] > 1 - 1e-9
        joints.append(curves[k].end if smooth else _meet(curves[k], curves[k + 1], curves[k].end))
    joints.append(_meet(curves[-1], Segment((0.0, top), (1.0, top)), curves[-1].end))
    places = [joint for joint in joints if joint is not None]
    if len(places) < len(joints):
        return ()
    whole = tuple(replace(s, start=a, end=b) for s, a, b in zip(curves, places[:-1], places[1:], strict=True))
    # a piece that turned about has been swallowed by its neighbours
    kept = all(np.subtract(new.end, new.start) @ np.subtract(old.end, old.start) > 0 for new, old in zip(whole, segments, strict=True))
    return whole if kept and min(s.end[0] for s in whole) > 0 else ()


def _shifted(segment: Segment, by: float) -> Segment | None:
    if segment.radius:
        if segment.radius <= by:
            return None
        middle = segment.centre or (0.0, segment.radius)
        smaller = 1.0 - by / segment.radius
        (a, b), (c, d) = (np.add(middle, smaller * np.subtract(p, middle)).tolist() for p in (segment.start, segment.end))
        return Segment((a, b), (c, d), segment.radius - by, middle)
    along = segment.tangents()[0]
    inward = by * np.array([-along[1], along[0]])
    (a, b), (c, d) = np.add(segment.start, inward).tolist(), np.add(segment.end, inward).tolist()
    return Segment((a, b), (c, d))


def _meet(one: Segment, two: Segment, near: Point) -> Point | None:
    """Where the line or circle of one piece meets that of the next, at the place nearest to a point; None where they do not."""
    if two.radius:
        one, two = two, one
    assert not two.radius, "no profile has two arcs in a row"
    direction = two.tangents()[0]
    if not one.radius:
        a = np.column_stack([one.tangents()[0], -direction])
        if abs(np.linalg.det(a)) < 1e-12:
            return None
        x, z = np.add(one.start, np.linalg.solve(a, np.subtract(two.start, one.start))[0] * a[:, 0]).tolist()
        return x, z
    away = np.subtract(two.start, one.centre or (0.0, one.radius))
    half = away @ direction
    root = half**2 - away @ away + one.radius**2
    if root < 0.0:
        return None
    places = [np.add(two.start, (-half + sign * np.sqrt(root)) * direction) for sign in (-1.0, 1.0)]
    x, z = min(places, key=lambda p: float(np.linalg.norm(p - near))).tolist()
    return x, z


def grain_centres(body: Body) -> Array:
    """Centres of the grains [m], (count, 3), in the object's frame.

    Raises:
        SceneError: They do not fit.
    """
    return np.array(_grain_centres(body))


@lru_cache(maxsize=16)
def _grain_centres(body: Body) -> tuple[tuple[float, ...], ...]:
    radius = body.grains.radius_mm * MM
    room = (1 + _CLEARANCE) * radius
    around = flesh(body) if "skin" in parts(body) else solid(body)
    vertices, faces, _ = solid_surface(around, np.inf, 0.1 * radius)
    surface = TriMesh(vertices, faces)
    rng = np.random.default_rng(body.grains.seed)
    low, high = vertices.min(axis=0) + room, vertices.max(axis=0) - room
    centres = np.zeros((0, 3))
    for _ in range(_TRIES if (low < high).all() else 0):
        trial = rng.uniform(low, high, (body.grains.count, 3))
        # Whether a place is within the object is dear, and where there is hardly room left most are taken.
        trial = trial[(np.linalg.norm(trial[:, None] - centres, axis=2) > radius + room).all(axis=1)]
        trial = trial[(patch_distances(around.patches, trial) > room).all(axis=1)]
        trial = trial[winding_numbers(trial, surface) > 0.5]
        for point in trial:
            if (np.linalg.norm(centres - point, axis=1) > radius + room).all():
                centres = np.vstack([centres, point])
            if len(centres) == body.grains.count:
                return tuple(tuple(centre) for centre in centres.tolist())
    raise SceneError(
        f"object.grains.count = {body.grains.count}: only {len(centres)} of radius {body.grains.radius_mm:g} mm found room in the "
        f"{body.shape}; fewer or smaller ones fit"
    )


def _solid_of(balls: tuple[Ball, ...]) -> Solid:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=1)
    vertices = np.vstack([np.array(b.centre) + b.radius * np.asarray(ball.vertices) for b in balls])
    faces = np.vstack([np.asarray(ball.faces) + k * len(ball.vertices) for k in range(len(balls))])
    return Solid(balls, ("contact",) * len(balls), vertices, faces.astype(np.int32))
