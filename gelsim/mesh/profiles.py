"""Profiles of gel and object for presses that reduce to a plane: triangles in (r, z) or (x, z), fine where the bodies meet.

A coarse triangulation, of right triangles in the gel and of Delaunay's in the object, is refined by longest-edge bisection (Rivara 1984)
until no edge is longer than the sizes of `gelsim.mesh.sizing` allow, divided by `FINER`: a plane costs little. Bisection never more than
halves the smallest angle. New points of curved edges go onto the exact arc; mid-side nodes too. Nothing is drawn by lot, and it takes
milliseconds, so nothing is cached.

The gel is a flat block, mapped to a dome as in `gelsim.mesh.gel_mesh`. A body of revolution presses a disc of the gel instead of its
square, `gel_radius`. Sharp rims of the object that touch the gel end a gel edge and are refined around.

Left out: profiles that are not convex, mesh files.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gelsim.geometry import FACE_EDGES, PlanarMesh, edges_of
from gelsim.mesh.sizing import OBJECT_COARSER, SIZES, Footprint, MeshSizes, SizeField, contact_edge
from gelsim.scene.definition import Scene
from gelsim.scene.shape_table import SHAPES
from gelsim.shape.outlines import edge_radius, profile, rounded
from gelsim.shape.shapes import gel_height, press_depth
from gelsim.shape.solids import Array, Segment, Sizes, edge_middles, refine
from gelsim.units import MM

FINER = {"fast": 1.5, "balanced": 1.5, "reference": 2.1}
"""Edges of a solid's mesh over those of a profile. `reference` wants the contact's radius to 1 % (docs/validation.md, Accuracy)."""
RIM_PER_RADIUS = 0.5
"""Edge length at a rigid object's rounded rim over its radius."""
_MARGIN = 0.1 * MM
"""Beyond the overlap, as fine as in it."""
_SHARP = np.cos(np.radians(30.0))


def gel_radius(scene: Scene) -> float:
    """Radius [m] of the disc that stands for the gel's rectangle: of the same area."""
    x, y = scene.gel.size_mm
    return float(np.sqrt(x * y / np.pi)) * MM


def mesh_profiles(scene: Scene, *, finer: float | None = None, gel_end: float | None = None) -> tuple[PlanarMesh, PlanarMesh]:
    """The gel's and the object's profile, as they just touch; groups as of the solids. A rigid object has edges only.

    Args:
        finer: Edges of a solid's mesh of this fidelity over these; `FINER` when left out.
        gel_end: Largest r or x of the gel [m]; `gel_radius`, or half its width under a drawn object, when left out.
    Raises:
        SceneError: The shape fields make no solid.
    """
    sizes, depth = SIZES[scene.fidelity], press_depth(scene)
    finer = finer or FINER[scene.fidelity]
    segments = _pressed(scene)
    turned = SHAPES[scene.object.shape].turned
    end = gel_end or (gel_radius(scene) if turned else scene.gel.size_mm[0] * MM / 2)
    half = min(overlap(scene) + _MARGIN, end)
    edge = contact_edge(Footprint((0.0, 0.0), (half, half), 1.0), sizes)
    radius = edge_radius(scene.object, scene.fidelity) if scene.object.rigid else 0.0
    ends = [before.end for before, after in zip(segments[:-1], segments[1:], strict=True) if _sharp(before, after)]
    arcs = [np.mean([segment.start, segment.end], axis=0) for segment in segments if 0.0 < segment.radius <= radius]
    rims, rounds = (_touched(np.reshape(some, (-1, 2)), depth, end) for some in (ends, arcs))
    if radius:
        sizes = replace(sizes, rim=min(sizes.rim, RIM_PER_RADIUS * radius))
    bottom = -min(0.5 * scene.gel.thickness_mm * MM, 0.5 * half)
    gel = _field(half, bottom, 0.0, edge, sizes, sizes.gel_far, np.vstack([rims, rounds]) * [1.0, 0.0])
    gel_mesh = gel_profile(scene, end, rims, lambda p: gel(p) / finer)
    body_edge = OBJECT_COARSER * edge
    across = max(segment.end[0] for segment in segments)
    far = max(body_edge, min(sizes.object_far, across / 1.25))
    body = _field(half, 0.0, 0.5 * depth, body_edge, sizes, far, np.vstack([rims, rounds]))
    if scene.object.rigid:
        return gel_mesh, rigid_profile(segments, lambda p: body(p) / finer)
    return gel_mesh, _object(segments, lambda p: body(p) / finer)


def _touched(points: Array, depth: float, end: float) -> Array:
    return points[(points[:, 1] < depth) & (points[:, 0] < end * (1 - 1e-3))]


def _pressed(scene: Scene) -> tuple[Segment, ...]:
    body = scene.object
    return rounded(profile(body), edge_radius(body, scene.fidelity)) if body.rigid else profile(body)


def overlap(scene: Scene) -> float:
    """Half width [m] of the overlap of undeformed object and gel at full depth, centred."""
    line = np.vstack([_fine(segment) for segment in _pressed(scene)])
    inside = line[:, 1] - gel_height(scene.gel, line * [1.0, 0.0]) < press_depth(scene)
    return float(line[inside, 0].max())


def _fine(segment: Segment) -> Array:
    start, end = np.array(segment.start), np.array(segment.end)
    return segment.project(start + np.linspace(0, 1, 201)[:, None] * (end - start))[0]


def _sharp(before: Segment, after: Segment) -> bool:
    return float(before.tangents()[1] @ after.tangents()[0]) < _SHARP


def _field(half: float, bottom: float, top: float, edge: float, sizes: MeshSizes, far: float, rims: Array) -> Sizes:
    along = ((np.insert(rims, 1, 0.0, axis=1), min(edge, sizes.rim)),) if len(rims) else ()
    field = SizeField((0.0, 0.0, bottom), (half, half, top), edge, sizes.growth, far, 0.0, along, sizes.rim_growth)
    return lambda p: field(np.insert(p, 1, 0.0, axis=1))


# ---------------------------------------------------------------------------------------------------------------- the two bodies
def gel_profile(scene: Scene, end: float, rims: Array, sizes: Sizes, skin: float = 0.0) -> PlanarMesh:
    """The gel from the axis to `end` [m]; its edges end below `rims` (K, 2), and at the foot of a `skin` [m], which is region 1."""
    thickness = scene.gel.thickness_mm * MM
    stops = np.unique([0.0, *rims[:, 0], end])
    columns = [
        a + (b - a) * np.arange(n) / n for a, b in zip(stops[:-1], stops[1:], strict=True) for n in [max(1, round((b - a) / thickness))]
    ]
    x = np.concatenate([*columns, [end]])
    levels = [-thickness, -skin, 0.0] if skin else [-thickness, 0.0]
    high = len(levels)
    grid = np.stack(np.meshgrid(x, levels, indexing="ij"), axis=-1).reshape(-1, 2)
    low = (high * np.arange(len(x) - 1)[:, None] + np.arange(high - 1)).ravel()
    faces = np.vstack([np.stack([low, low + high, low + high + 1], 1), np.stack([low, low + high + 1, low + 1], 1)]).astype(np.int32)
    vertices, faces = refine(grid, faces, sizes)
    nodes, triangles = _quadratic(vertices, faces)
    regions = (vertices[faces, 1].mean(axis=1) > -skin).astype(np.int32)
    edges = _boundary(triangles)
    middle = nodes[edges[:, 2]]
    groups = {
        "bonded": edges[middle[:, 1] < -thickness * (1 - 1e-9)],
        "coated": edges[middle[:, 1] > -thickness * 1e-9],
        "side": edges[middle[:, 0] > end * (1 - 1e-9)],
    }
    share = (nodes[:, 1] + thickness) / thickness
    nodes[:, 1] = np.where(share == 0.0, nodes[:, 1], share * (thickness + gel_height(scene.gel, nodes * [1.0, 0.0])) - thickness)
    return PlanarMesh(nodes, triangles, groups, regions)


def _object(segments: tuple[Segment, ...], sizes: Sizes) -> PlanarMesh:
    """A convex body between the profile, its base and the axis."""
    from scipy.spatial import Delaunay

    top = np.array(segments[-1].end)
    pieces = [*segments, Segment((top[0], top[1]), (0.0, top[1])), Segment((0.0, top[1]), (0.0, 0.0))]
    spacing = 0.5 * max(top[0], segments[0].end[0])
    rim: list[Array] = []
    for piece in pieces:
        points = piece.samples()
        length = np.linalg.norm(np.diff(points, axis=0), axis=1).max()
        cuts = max(1, round(length / spacing))
        dense = [a + (b - a) * k / cuts for a, b in zip(points[:-1], points[1:], strict=True) for k in range(cuts)]
        rim += [piece.project(np.array(dense))[0]]
    border = np.vstack(rim)
    _, first = np.unique(np.round(border * 1e12), axis=0, return_index=True)
    border = border[np.sort(first)]
    x, z = (np.arange(0.5 * spacing, limit, spacing) for limit in (border[:, 0].max(), top[1]))
    inner = np.stack(np.meshgrid(x, z, indexing="ij"), axis=-1).reshape(-1, 2)
    # well inside: left of every chord of the border
    chord = np.roll(border, -1, axis=0) - border
    away = chord[:, 0] * (inner[:, None, 1] - border[:, 1]) - chord[:, 1] * (inner[:, None, 0] - border[:, 0])
    inner = inner[(away / np.linalg.norm(chord, axis=1)).min(axis=1) > 0.35 * spacing]
    points = np.vstack([border, inner])
    faces = Delaunay(points).simplices.astype(np.int32)
    a, b, c = (points[faces[:, k]] for k in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    faces[area < 0] = faces[area < 0][:, ::-1]
    faces = faces[np.abs(area) > 1e-12 * spacing**2]
    arcs = [segment for segment in segments if segment.radius]
    vertices, faces = refine(points, faces, sizes, arcs)
    nodes, triangles = _quadratic(vertices, faces, arcs)
    edges = _boundary(triangles)
    middle = nodes[edges[:, 2]]
    base, axis = middle[:, 1] > top[1] * (1 - 1e-9), middle[:, 0] < 1e-12
    return PlanarMesh(nodes, triangles, {"base": edges[base], "contact": edges[~base & ~axis]})


def rigid_profile(segments: Sequence[Segment], sizes: Sizes) -> PlanarMesh:
    """The edges of a rigid body alone, from the apex up, no longer than `sizes` of their middles."""
    line: list[Array] = []
    for segment in segments:
        points = segment.samples()
        while True:
            middle = segment.project(points[:-1] + 0.5 * np.diff(points, axis=0))[0]
            long = np.linalg.norm(np.diff(points, axis=0), axis=1) > sizes(middle)
            if not long.any():
                break
            points = np.insert(points, np.flatnonzero(long) + 1, middle[long], axis=0)
        whole = np.empty((2 * len(points) - 1, 2))
        whole[::2], whole[1::2] = points, middle
        line.append(whole[1:] if line else whole)
    nodes = np.vstack(line)
    start = np.arange(0, len(nodes) - 2, 2)
    return PlanarMesh(nodes, np.zeros((0, 6), np.int32), {"contact": np.stack([start, start + 2, start + 1], 1).astype(np.int32)})


# ---------------------------------------------------------------------------------------------------------------- triangles
def _quadratic(vertices: Array, faces: NDArray[np.int32], arcs: Sequence[Segment] = ()) -> tuple[Array, NDArray[np.int32]]:
    """Six-node triangles, middles of boundary edges on the arcs."""
    edges, index = edges_of(faces, FACE_EDGES)
    nodes = np.vstack([vertices, edge_middles(vertices, edges, index, arcs)])
    return nodes, np.hstack([faces, len(vertices) + index]).astype(np.int32)


def _boundary(triangles: NDArray[np.int32]) -> NDArray[np.int32]:
    """Boundary edges (start, end, middle), the solid on the left."""
    edges = triangles[:, [[0, 1, 3], [1, 2, 4], [2, 0, 5]]].reshape(-1, 3)
    _, first, count = np.unique(edges[:, 2], return_index=True, return_counts=True)
    return edges[np.sort(first[count == 1])]


def mesh_report(mesh: PlanarMesh) -> dict[str, object]:
    """Nodes and elements for report.json."""
    return {
        "nodes": len(mesh.nodes),
        "elements": len(mesh.triangles),
        "contact_edges": len(mesh.groups.get("coated", mesh.groups.get("contact", ()))),
    }
