"""The gel as ten-node tetrahedra, fine where contact is expected: the same press gives the same mesh, bit for bit.

The flat block under the gel, or the quarter or half of it that mirror planes leave, is cut into near cubes and bisected down to the size
field of `gelsim.mesh.sizing` (`gelsim.mesh.bisection`). Edges are laid along the object's sharp edges where these touch it
(`gelsim.mesh.rim_edges`). Mid-side nodes are set, and all nodes lifted to the dome by z ↦ (z + T)(T + height(x, y)) / T - T, exact on the
faces of the block. Inner vertices of tets that this folds are raised or lowered.

Under a shape drawn along y the cubes are cubes in a space squeezed along y: tets are long where nothing changes. It takes a tenth of a
second, so nothing is cached.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from gelsim.errors import MeshingError
from gelsim.geometry import (
    TET_EDGES,
    TetMesh,
    flip,
    jacobian_determinants,
    mirrored,
    outer_faces,
    quadratic_tets,
    tet_quality,
    tet_volumes,
    unfolded,
)
from gelsim.mesh.bisection import UNIT, Lattice, Tets, cells_across, kuhn_box, refine
from gelsim.mesh.contact_area import contact_field, core, edge_in_contact, footprint
from gelsim.mesh.rim_edges import lay_edges
from gelsim.mesh.sizing import SIZES, Footprint, MeshSizes, SizeField
from gelsim.scene.definition import Gel, Scene
from gelsim.shape.outlines import edge_radius
from gelsim.shape.rims import rims_on_gel
from gelsim.shape.shapes import gel_height
from gelsim.shape.solids import Array
from gelsim.units import MM

LONGER_ACROSS = 1.6
"""Longest leg of a bisected face over the size field; the shortest is √2 shorter. At rims it is 1, but not at `fast`: a rigid box is off by
12 µm there, with 3,429 unknowns; it would be by 4 µm with 5,363, and presses of many rims took twice as long."""
RIM_PER_RADIUS = 2.0
"""Edge length along a rigid object's rims over their radius: with 3 the membrane wavers along a straight edge by 4 µm RMS, with 2 by less
than 2 (docs/validation.md, *Straight edges*)."""
FINE_DEPTH = 0.15
"""Depth over which edges stay as short as at the surface, per thickness and per half width of the contact area."""
_FOLDED = (1.0, 0.5, 0.25)
"""Shares of the far edge length, tried in turn where a long flat tet folds under the dome and no height of a vertex helps."""
_LEAST = 0.01
"""Mean-ratio quality below which a tet counts as folded: of one that the dome flattens to none, rounding alone says the sign."""
_ROUNDS = 10
ALIKE = 0.05 * MM
"""Distance of a rim's middle from the mirror image of another within which they are the same."""


def mesh_gel(scene: Scene, symmetry: frozenset[str] = frozenset()) -> TetMesh:
    """The gel, cut at the planes of `symmetry`; groups "bonded" (inner face), "coated" (outer face) and "side".

    Raises:
        SceneError: The object's fields make no solid, or none of it lies over the gel.
        MeshingError: A tet folds under the dome.
    """
    rims = rims_on_gel(scene)
    sizes, area = SIZES[scene.fidelity], _unmirrored(footprint(scene), rims)
    if scene.fidelity != "fast":
        sizes = replace(sizes, rim=_rim(scene, sizes) / LONGER_ACROSS)
    # a soft edge gives way, and is met as well without parallels; at `fast` they would be nearer than faces are long
    beside = sizes.rim if scene.object.rigid and scene.fidelity != "fast" else 0.0
    x, y, thickness = (v * MM for v in (scene.gel.size_mm[0] / 2, scene.gel.size_mm[1] / 2, scene.gel.thickness_mm))
    fine = FINE_DEPTH * min(thickness, *area.high)
    edge = edge_in_contact(scene, area)
    field = contact_field(area, -fine, 0.0, edge, sizes, sizes.gel_far, rims, core(scene, edge, of_object=False))
    # A quarter, then its mirror images; along an axis at whose one side all the contact lies the whole, for its image would be wasted.
    left, near = (end if side else 0.0 for side, end in zip(area.side, (x, y), strict=True))
    low, high = np.array([-left, -near, -thickness]), np.array([x, y, 0.0])
    pieces = _folded_rims(rims, area)
    for share in _FOLDED:
        vertices, tets = _block(low, high, replace(field, far=share * field.far), area.stretch, pieces, beside)
        mesh = _ten_node(low, high, vertices, tets, area)
        # The pad of a file is its own mirror image in no plane.
        mesh = _domed(scene.gel, _whole(mesh, area, symmetry) if scene.gel.profile == "mesh" else mesh)
        smallest = float(jacobian_determinants(mesh.rest_positions, mesh.tets).min())
        if smallest > 0.0:
            break
    else:
        what = f"a folded one (smallest Jacobian {smallest / MM**3:.3g} mm³)"
        raise MeshingError(f"filling the gel with tetrahedra left {what}; try another fidelity, or a thicker gel.edge_thickness_mm")
    return mesh if scene.gel.profile == "mesh" else _whole(mesh, area, symmetry)


def _whole(mesh: TetMesh, area: Footprint, symmetry: frozenset[str]) -> TetMesh:
    """What was meshed, on the side of the contact, with its mirror images in all planes but those of `symmetry`."""
    for axis, side in zip("xy", area.side, strict=True):
        mesh = flip(mesh, axis) if side < 0 else mesh
    return mirrored(mesh, symmetry)


def _rim(scene: Scene, sizes: MeshSizes) -> float:
    """Edge length along rims [m]: short enough for the radius of a rigid object's, if that has one."""
    radius = edge_radius(scene.object, scene.fidelity) if scene.object.rigid else 0.0
    return min(sizes.rim, max(RIM_PER_RADIUS * radius, sizes.finest)) if radius else sizes.rim


def _unmirrored(area: Footprint, rims: Array) -> Footprint:
    """The area, as lying at one side along each axis to whose other side the rims (K, 2, 3) have no mirror images: these would be meshed
    as well."""
    if not len(rims):
        return area
    middles = rims.mean(axis=1)
    low, high, sides = list(area.low), list(area.high), list(area.side)
    for axis in (0, 1):
        image = middles * np.where(np.arange(3) == axis, -1.0, 1.0)
        if not sides[axis] and KDTree(middles).query(image)[0].max() > ALIKE:
            low[axis], sides[axis] = -high[axis], 1
    return replace(area, low=tuple(low), high=tuple(high), side=tuple(sides))


def _folded_rims(rims: Array, area: Footprint) -> Array:
    """Straight pieces (K, 2, 2) of the rims (K, 2, 3) on the part of the gel that is meshed; without those that cross its mirror planes."""
    folded = area.folded(rims)
    crosses = ((rims[:, 0, :2] * rims[:, 1, :2] < -1e-18) & (np.array(area.side) == 0)).any(axis=1)
    long = np.linalg.norm(folded[:, 1] - folded[:, 0], axis=1) > 1e-6
    pieces = folded[long & ~crosses][..., :2]
    _, first = np.unique(np.round(np.sort(pieces, axis=1) * 1e9), axis=0, return_index=True)
    return pieces[np.sort(first)]


def _block(low: Array, high: Array, field: SizeField, stretch: float, pieces: Array, beside: float) -> tuple[Array, Tets]:
    """Vertices and tets of a box from `low` to `high`, edges of its top along `pieces` and, at a distance, `beside` them."""
    squeeze = np.array([1.0, 1.0 / stretch, 1.0])
    narrow = field.squeezed(stretch)
    cells = cells_across((high - low) * squeeze)

    def place(points: Lattice) -> Array:
        share = points / (cells * UNIT)
        return low * (1.0 - share) + high * share  # exact at both ends

    def too_large(points: Lattice, tets: Tets) -> NDArray[np.bool_]:
        used, local = np.unique(tets, return_inverse=True)
        at = place(points[used]) * squeeze
        local = local.reshape(-1, 4)
        # Seen from above a tet of any of the three shapes has a face of legs l: l, not its height, is what a face of the top will have.
        across = np.diff(at[local][:, TET_EDGES, :2], axis=2)[:, :, 0]
        return np.sqrt(0.5 * (across**2).sum(axis=2).max(axis=1)) > LONGER_ACROSS * narrow(at)[local].min(axis=1)

    points, tets = refine(*kuhn_box(cells), too_large)
    return lay_edges(place(points), tets, pieces, squeeze, beside)


def _ten_node(low: Array, high: Array, vertices: Array, tets: Tets, area: Footprint) -> TetMesh:
    """The block with its groups; open at the planes that it will be mirrored at."""
    nodes, tets10 = quadratic_tets(vertices, tets.astype(np.int32))
    faces = outer_faces(tets10)
    at_low, at_high = ((nodes[faces] == end).all(axis=1).T for end in (low, high))
    side = at_high[0] | at_high[1]
    for axis in (0, 1):
        if area.side[axis]:
            side |= at_low[axis]
    groups = {"bonded": faces[at_low[2]], "coated": faces[at_high[2]], "side": faces[side]}
    return TetMesh(nodes, tets10, groups, frozenset(axis for axis, one in zip("xy", area.side, strict=True) if not one))


def _domed(gel: Gel, block: TetMesh) -> TetMesh:
    """The flat block under the gel's outer face."""
    thickness, nodes = gel.thickness_mm * MM, block.rest_positions.copy()
    share = (nodes[:, 2] + thickness) / thickness
    nodes[:, 2] = np.where(share == 0.0, nodes[:, 2], share * (thickness + gel_height(gel, nodes[:, :2])) - thickness)
    nodes = _untangled(nodes, block.tets, (share > 0.0) & (share < 1.0))
    return TetMesh(unfolded(nodes, block.tets, 1.0), block.tets, block.groups, block.symmetry)


def _untangled(nodes: Array, tets: NDArray[np.int32], inner: NDArray[np.bool_]) -> Array:
    """Nodes (N, 3) with the `inner` (N,) vertices of folded tets raised or lowered, each to the middle of where no tet around it folds.

    Edges and faces are straight where the lift is bent: one across the crease where a dome ends in its land, or one that leans beside a
    rim, may pass a vertex that it lay below or above in the flat block. The volume of a tet is linear in the height of a vertex, so the
    limits are exact. A vertex without such a place stays; a mesh without folds is left as it is, bit for bit.
    """
    out = nodes.copy()
    for _ in range(_ROUNDS):
        vertices = np.unique(tets[tet_quality(out, tets) < _LEAST, :4])
        if not len(vertices):
            break
        for vertex in vertices[inner[vertices]]:
            around = tets[(tets[:, :4] == vertex).any(axis=1)]
            volume = tet_volumes(out, around)
            raised = out.copy()
            raised[vertex, 2] += MM
            slope = (tet_volumes(raised, around) - volume) / MM
            low, high = (-volume[slope > 0.0] / slope[slope > 0.0]).max(), (-volume[slope < 0.0] / slope[slope < 0.0]).min()
            if low < high:
                out[vertex, 2] += 0.5 * (low + high)
    rise = out[:, 2] - nodes[:, 2]
    out[tets[:, 4:], 2] += 0.5 * rise[tets[:, TET_EDGES]].sum(axis=2)  # a middle is one node for all tets around its edge
    return out
