"""From the states of a profile to the motion of whole surfaces: turned about z, or drawn along y.

The gel's outer face is the whole rectangle of the scene, in triangles as fine as the profile's edges but for `FINEST`; its nodes take the
displacement that the profile's quadratic edges have at their distance from the axis or the plane. Where the rectangle reaches beyond the
profile (its corners, beyond a disc of the same area) the displacement at the profile's end goes on. The object's nodes lie on circles, or
straight lines, through the profile's own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelsim.fem.indicator import FORCE_ERROR_PER_JUMP, MOVING
from gelsim.fem.planar.elements import edge_quadrature, edge_shape
from gelsim.fem.planar.problem import PlanarProblem
from gelsim.fem.planar.touching import touching_intervals
from gelsim.fem.recording import Recorder, whole_surface
from gelsim.geometry import PlanarMesh, QuadraticSurface, quadratic_faces
from gelsim.results import SurfaceMotion
from gelsim.shape.shapes import gel_height
from gelsim.shape.solids import refine
from gelsim.units import KPA_PER_PA, MM_PER_M

Array = NDArray[np.float64]

FINEST = 0.3e-3
"""Shortest edge of a turned gel's surface [m]: its nodes then lie 0.1 to 0.15 mm apart."""
_SECTORS = 48
_ALONG = 1e-3
"""Edges of drawn surfaces along y [m]."""


class PlanarRecorder(Recorder):
    """`Recorder` of a `PlanarProblem`."""

    problem: PlanarProblem

    def _contact(self) -> tuple[float, Array]:
        """Area in contact [m²] of the whole body, projected on the window, and pressure [Pa] at all nodes."""
        problem, contact = self.problem, self.problem.contact
        place, _ = edge_quadrature(contact.points)
        x = (problem.solids.rest + problem.solids.displacement.numpy())[contact.slave_faces][..., 0]
        pressure = np.asarray(contact.pressure.numpy(), np.float64)
        # augmentation leaves half the penalty's smoothing as overlap
        opening = contact.gap.numpy().reshape(len(x), -1) + problem.law.smoothing / 2
        ends = np.sort(x[:, :2], axis=1)
        start, end = touching_intervals(ends, x @ edge_shape(place).T, opening, pressure.reshape(len(x), -1)).T
        area = ((end**2 - start**2) / 2 if problem.turned else end - start).sum() * problem.copies / MM_PER_M**2
        # hats of the two halves of an edge: positive weights to average with
        hats = np.stack([np.maximum(1 - 2 * place, 0), np.maximum(2 * place - 1, 0), 1 - np.abs(2 * place - 1)], axis=1)
        weight = contact.rest_weight.reshape(len(contact.slave_faces), -1)
        nodes, count = contact.slave_faces.ravel(), problem.solids.node_count
        top = np.bincount(nodes, (weight * pressure.reshape(weight.shape) @ hats).ravel(), count)
        bottom = np.bincount(nodes, (weight @ hats).ravel(), count)
        return float(area), top / np.where(bottom > 0, bottom, 1.0) / KPA_PER_PA

    def _per_jump(self, smallest_jacobian: float) -> float:
        return FORCE_ERROR_PER_JUMP["profile"]

    def _kink(self, displacement: Array) -> float:
        """`indicator.surface_kink` of the profile: mean edge length times the jump of du_z/dx at its vertices, root mean square [m]."""
        profile = self.problem.gel
        assert isinstance(profile, PlanarMesh)
        line = _line(profile)
        place, up = profile.nodes[line, 0], displacement[line, 2]
        length = np.diff(place[::2])
        first, last, middle = up[:-2:2], up[2::2], up[1::2]
        begin, end = (4 * middle - 3 * first - last) / length, (first + 3 * last - 4 * middle) / length
        across = (end[:-1] - begin[1:]) * 0.5 * (length[:-1] + length[1:])
        share = (length[:-1] + length[1:]) * (place[2:-1:2] if self.problem.turned else 1.0)
        share = np.where(np.abs(up[2:-1:2]) > MOVING * np.abs(up).max(), share, 0.0)
        return float(np.sqrt((share * across**2).sum() / max(share.sum(), 1e-300)))

    def _symmetry(self) -> str:
        return "axisymmetric" if self.problem.turned else "plane-strain"

    def _surfaces(self, everything: Array) -> tuple[SurfaceMotion, SurfaceMotion, Array]:
        problem = self.problem
        profile, body = problem.gel, problem.body
        assert isinstance(profile, PlanarMesh) and isinstance(body, PlanarMesh)
        line = _line(profile)
        surface, planes = _gel_surface(problem, profile, line)
        away = surface.nodes[:, :2] - (0.0 if planes else np.array(problem.scene.press.offset_mm) / MM_PER_M)
        across = np.hypot(away[:, 0], away[:, 1]) if problem.turned else np.abs(away[:, 0])
        knots = profile.nodes[line[::2], 0]
        piece = np.clip(np.searchsorted(knots, across, side="right") - 1, 0, len(knots) - 2)
        xi = np.clip((across - knots[piece]) / (knots[piece + 1] - knots[piece]), 0.0, 1.0)
        three = line[2 * piece[:, None] + np.array([0, 2, 1])]
        moved = np.einsum("gk,ngki->ngi", edge_shape(xi), everything[:, three])
        with np.errstate(invalid="ignore", divide="ignore"):
            outward = np.where(across[:, None] > 0, away / across[:, None], 0.0) if problem.turned else np.sign(away) * [1.0, 0.0]
        displacement = np.concatenate([moved[..., :1] * outward, moved[..., 2:]], axis=-1)
        pressure = np.stack([np.interp(across, profile.nodes[line, 0], state[line], right=0.0) for state in self._pressure])
        gel, pressure = whole_surface(surface, displacement, pressure, planes)
        return gel, self._object(body, everything), pressure

    def _object(self, body: PlanarMesh, everything: Array) -> SurfaceMotion:
        problem = self.problem
        line = _line(body)
        across, up = body.nodes[line].T
        moved = everything[:, problem.object_nodes[line]]
        if problem.turned:
            angle = 2 * np.pi * np.arange(2 * _SECTORS) / (2 * _SECTORS)
            direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
            nodes = np.concatenate(
                [across[:, None, None] * direction, np.broadcast_to(up[:, None, None], (len(up), len(angle), 1))], axis=-1
            )
            motion = np.concatenate(
                [moved[:, :, None, :1] * direction, np.broadcast_to(moved[:, :, None, 2:], (*moved.shape[:2], len(angle), 1))], axis=-1
            )
            nodes[..., :2] += np.array(problem.scene.press.offset_mm) / MM_PER_M
            faces = _grid_faces(len(line), 2 * _SECTORS, pointed=True)
            planes: frozenset[str] = frozenset()
        else:
            half = (problem.depth_mm or 0.0) / MM_PER_M / 2
            along = np.linspace(-half, half, 2 * max(1, round(2 * half / _ALONG)) + 1)
            shape = (len(line), len(along))
            nodes = np.stack([np.broadcast_to(v, shape) for v in (across[:, None], along, up[:, None])], axis=-1)
            motion = np.broadcast_to(moved[:, :, None, :], (len(moved), *shape, 3))
            faces, planes = _grid_faces(len(line), len(along), pointed=False), frozenset("x")
        used, faces = np.unique(faces, return_inverse=True)
        surface = QuadraticSurface(nodes.reshape(-1, 3)[used], faces.reshape(-1, 6).astype(np.int32))
        motion = motion.reshape(len(moved), -1, 3)[:, used]
        return whole_surface(surface, motion, np.zeros(motion.shape[:2]), planes)[0]


def _line(mesh: PlanarMesh) -> NDArray[np.int64]:
    """Nodes of the contact profile from the axis outward: vertex, middle, vertex, …"""
    edges = mesh.groups["coated"] if "coated" in mesh.groups else mesh.groups["contact"]
    follows = {int(start): (int(end), int(middle)) for start, end, middle in edges}
    at = next(iter(set(follows) - {end for end, _ in follows.values()}))
    line = [at]
    while at in follows:
        at, middle = follows[at]
        line += [middle, at]
    return np.array(line if mesh.nodes[line[0], 0] < mesh.nodes[line[-1], 0] else line[::-1])


def _gel_surface(problem: PlanarProblem, profile: PlanarMesh, line: NDArray[np.int64]) -> tuple[QuadraticSurface, frozenset[str]]:
    """The rest surface, and the mirror planes of which it is the positive side."""
    scene = problem.scene
    x, y = np.array(scene.gel.size_mm) / MM_PER_M / 2
    if not problem.turned:
        along = np.linspace(0.0, y, 2 * max(1, round(y / _ALONG)) + 1)
        grid = np.stack(np.meshgrid(profile.nodes[line, 0], along, indexing="ij"), axis=-1).reshape(-1, 2)
        faces = _grid_faces(len(line), len(along), pointed=False)[:, [0, 2, 1, 5, 4, 3]].astype(np.int32)
        return QuadraticSurface(np.insert(grid, 2, 0.0, axis=1), faces), frozenset("xy")
    offset = np.array(scene.press.offset_mm) / MM_PER_M
    whole = bool(offset.any())
    low = np.array([-x, -y]) if whole else np.zeros(2)
    columns, rows = (max(2, 1 + round(2 * side / (end - start))) for side, start, end in zip((x, y), low, (x, y), strict=True))
    grid = [np.linspace(start, end, count) for start, end, count in zip(low, (x, y), (columns, rows), strict=True)]
    vertices = np.stack(np.meshgrid(*grid, indexing="ij"), axis=-1).reshape(-1, 2)
    number = np.arange(len(vertices)).reshape(columns, rows)
    a, b, c, d = number[:-1, :-1].ravel(), number[1:, :-1].ravel(), number[1:, 1:].ravel(), number[:-1, 1:].ravel()
    faces = np.vstack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    places, lengths = profile.nodes[line[1::2], 0], np.diff(profile.nodes[line[::2], 0])

    def sizes(points: Array) -> Array:
        away = points - offset
        return np.maximum(FINEST, np.interp(np.hypot(away[:, 0], away[:, 1]), places, lengths))

    vertices, faces = refine(vertices, faces, sizes)
    flat = quadratic_faces(np.insert(vertices, 2, 0.0, axis=1), faces)
    nodes = flat.nodes.copy()
    nodes[:, 2] = gel_height(scene.gel, nodes[:, :2])
    return QuadraticSurface(nodes, flat.faces), frozenset() if whole else frozenset("xy")


def _grid_faces(rows: int, columns: int, pointed: bool) -> NDArray[np.int64]:
    """Six-node faces of a grid of nodes, vertices at even places; `pointed`: the first row is one point, columns close a circle."""
    i, j = np.meshgrid(np.arange(0, rows - 2, 2), np.arange(0, columns - (0 if pointed else 2), 2), indexing="ij")
    i, j = i.ravel(), j.ravel()

    def node(row: NDArray[np.int64], column: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.where(row == 0, 0, row * columns + column % columns) if pointed else row * columns + column

    a, b, c, d = node(i, j), node(i + 2, j), node(i + 2, j + 2), node(i, j + 2)
    ab, bc, cd, da, ca = node(i + 1, j), node(i + 2, j + 1), node(i + 1, j + 2), node(i, j + 1), node(i + 1, j + 1)
    ca = np.where((i == 0) & pointed, cd, ca)
    # the profile runs outward and up with the solid above: from outside, columns run against the clock
    one = np.stack([a, c, b, ca, bc, ab], axis=1)
    two = np.stack([a, d, c, da, cd, ca], axis=1)
    return np.vstack([one, two[i > 0] if pointed else two])
