"""Fills the gel and the object with ten-node tetrahedra, fine where they meet and coarse where they do not.

The filling is fTetWild's (Hu et al. 2020) through pytetwild, with the size field of `gelsim.sizing`. What comes back is turned right side
out, its boundary put exactly onto the planes and curved patches of the shape (fTetWild keeps only within an envelope of it), and given
mid-side nodes that lie on the exact shape.

A skin and grains are filled together with the body: their surfaces are given to fTetWild too, which keeps them, each tet's material is told
by the winding number of its middle, and interfaces are put onto their exact shape like the boundary.

A symmetric body is meshed as the part its mirror planes cut out and mirrored up to what is asked for. Under a shape drawn along y both
bodies are meshed in a space squeezed along y and stretched back: tets are long where nothing changes. The gel is always meshed as a flat
block; a dome is the image of that block under z ↦ (z + T)(T + height(x, y)) / T - T, exact on its faces.

Left out: adaptivity (the press itself reports its error).
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import MeshingError
from gelsim.files import whole_file
from gelsim.geometry import (
    AXES,
    TET_EDGES,
    TetMesh,
    TriMesh,
    flip,
    interface_faces,
    is_closed,
    jacobian_determinants,
    mirror,
    outer_faces,
    quadratic_tets,
    region_volumes,
    tet_quality,
    tet_volumes,
    winding_numbers,
)
from gelsim.inclusions import Inclusion, inclusions
from gelsim.scene import Body, Gel, Scene
from gelsim.shapes import (
    DRAWN,
    RELIEFS,
    TURNED,
    fine_feature,
    gel_height,
    load_mesh,
    placement,
    press_depth,
    rigid_surface,
    shape_symmetry,
    sharp_edges,
    solid,
    wall,
)
from gelsim.sizing import LONGER, OBJECT_COARSER, SIZES, Footprint, MeshSizes, SizeField, class_above, class_below, contact_edge
from gelsim.solids import Array, Plane, Solid, Sweep, classify, membership, patch_distances, snap, solid_surface, zero_cuts
from gelsim.units import MM

_SCHEMA = 2
"""Raise it when the same key would no longer give the same mesh."""
_WORST_QUALITY = 0.02
"""Smallest mean-ratio quality of a straight tet that is let through; fTetWild's own meshes reach 0.1 to 0.3."""
_CHORD = 0.05
"""Distance allowed between the facets that fTetWild is given and the curved shape, per edge length asked for there."""
_COARSE = np.radians(30.0)
"""Angle between the corners of a turned object before its surface is refined: at 15 degrees a foot would get edges of a quarter radius."""
_MOST_CURVED = 0.12
"""Largest move of a mid-side node onto the exact shape, per edge length: an arc of 54 degrees."""
_ALONG = 5.0
"""Twist [degrees] up to which a drawn object still lies along the long sides of tets: turned by it, 3 : 1 becomes 2.9 : 1.1."""
_ATTEMPTS = ((0.05, 10.0, 20), (0.02, 6.0, 80), (0.1, 6.0, 80))
"""How far fTetWild may move the surface before its vertices are put back, per smallest edge length; its AMIPS energy to stop at (a
regular tet has 3); the passes it may take. The next is tried when one leaves a bad or folded tet; a smaller envelope costs more tets."""

Progress = Callable[[str], None]
Image = Callable[[TetMesh], TetMesh]
Within = tuple[tuple[Inclusion, TriMesh], ...]
"""What lies inside an object, with the facets that fTetWild is given for it."""


# ---------------------------------------------------------------------------------------------------------------- the two bodies
def mesh_gel(scene: Scene, symmetry: frozenset[str] = frozenset(), progress: Progress | None = None) -> TetMesh:
    """The gel, cut at the planes of `symmetry`; groups "bonded" (inner face), "coated" (outer face) and "side".

    Args:
        progress: Told in one line what is being meshed, when it is not in the cache; None writes it to stderr if that is a terminal.
    Raises:
        SceneError: The gel's fields make no solid.
        MeshingError: The filling failed or is of too low quality.
    """
    sizes, area = SIZES[scene.fidelity], footprint(scene)
    x, y, thickness = (v * MM for v in (scene.gel.size_mm[0] / 2, scene.gel.size_mm[1] / 2, scene.gel.thickness_mm))
    edge = _contact_edge(scene, area)
    rims = _touching(scene, sharp_edges(scene.object))
    field = _field(area, -min(0.5 * thickness, 0.5 * min(area.high)), 0.0, edge, sizes, sizes.gel_far, rims)
    # A quarter, then its mirror images; along an axis at whose one side all the contact lies the whole, for its image would be wasted.
    left, near = (end if side else 0.0 for side, end in zip(area.side, (x, y), strict=True))
    planes = (((0, 0, 1), 0), ((0, 0, -1), thickness), ((1, 0, 0), x), ((0, 1, 0), y), ((-1, 0, 0), left), ((0, -1, 0), near))
    block = Solid(
        tuple(Plane(normal, offset) for normal, offset in planes),
        ("coated", "bonded", "side", "side", "side" if left else "x", "side" if near else "y"),
        np.array([[i, j, k] for i in (-left, x) for j in (-near, y) for k in (-thickness, 0.0)]),
    )
    vertices, faces, _ = solid_surface(block, np.inf, np.inf)
    fences = _fences(rims, field.rim, area)
    surface = TriMesh(np.vstack([vertices, fences.vertices]), np.vstack([faces, fences.faces + len(vertices)]).astype(np.int32))
    mesh = _cached_fill(surface, block, field, area.stretch, "the gel", progress, image=lambda flat: _domed(scene.gel, flat))
    for axis, side in zip("xy", area.side, strict=True):
        mesh = flip(mesh, axis) if side < 0 else mesh
    return _mirrored(mesh, symmetry)


def _domed(gel: Gel, block: TetMesh) -> TetMesh:
    """The flat block under the gel's outer face."""
    thickness, nodes = gel.thickness_mm * MM, block.rest_positions.copy()
    share = (nodes[:, 2] + thickness) / thickness
    nodes[:, 2] = np.where(share == 0.0, nodes[:, 2], share * (thickness + gel_height(gel, nodes[:, :2])) - thickness)
    return TetMesh(_unfolded(nodes, block.tets, 1.0), block.tets, block.groups, block.symmetry)


def mesh_object(scene: Scene, symmetry: frozenset[str] = frozenset(), progress: Progress | None = None) -> TetMesh:
    """The object in its own frame, cut at the planes of `symmetry`; groups "base" (top plane) and "contact" (all else but the cut planes).

    The base of a `mesh` shape is what faces up within the top 2 % of its height.

    Raises:
        SceneError: The shape fields make no solid.
        MeshingError: The surface cannot be filled, or the filling is of too low quality.
    """
    body, sizes = scene.object, SIZES[scene.fidelity]
    area = footprint(scene.replace(press=replace(scene.press, offset_mm=(0.0, 0.0))))
    edge = OBJECT_COARSER * _contact_edge(scene, area)
    within: tuple[Inclusion, ...] = ()
    # As of the gel: no mirror image where one side alone is touched.
    side_x, side_y = side = tuple(sign if axis in shape_symmetry(body) else 0 for axis, sign in zip("xy", area.side, strict=True))
    if body.shape == "mesh":
        surface, shape, stretch = load_mesh(body), None, 1.0
        narrow = float(np.ptp(surface.vertices, axis=0).min())
    else:
        cut = shape_symmetry(body) - {axis for axis, sign in zip("xy", side, strict=True) if sign}
        surface, shape, stretch = None, solid(body, cut, _COARSE), area.stretch
        within = inclusions(body, cut, _COARSE)
        narrow = float(np.ptp(solid(body).hull, axis=0).min())
    # Away from contact a tall object is a spring, but it needs two or three quadratic edges across to bend and stay round.
    far = max(edge, min(sizes.object_far, narrow / 2.5))
    rims = _cut(sharp_edges(body), min(edge, sizes.rim))
    reach = np.minimum(area.high, np.array(scene.gel.size_mm) * MM / 2 * (1 - 1e-3))  # beside the gel, or at its border, no rim presses
    rims = rims[((rims[..., 2] < 1.5 * press_depth(scene)) & (np.abs(rims[..., :2]) <= reach).all(axis=-1)).all(axis=1)]
    uneven = 2.0 * body.amplitude_mm * MM if body.shape in RELIEFS else 0.0
    box = replace(area, low=(0.0, 0.0), side=(side_x, side_y)), 0.0, 0.5 * press_depth(scene) + uneven
    field = _field(*box, edge, sizes, far, rims, _seams(body, shape, within, sizes))
    inner: list[TriMesh] = []
    if surface is None:
        assert shape is not None
        surface, *inner = (
            TriMesh(*solid_surface(each, np.inf, lambda points: _CHORD * field(points))[:2]) for each in (shape, *(i.shape for i in within))
        )
    label = f"the object ({body.mesh if body.shape == 'mesh' else body.shape})"
    mesh = _cached_fill(surface, shape, field, stretch, label, progress, tuple(zip(within, inner, strict=True)))
    for axis, sign in zip("xy", side, strict=True):
        mesh = flip(mesh, axis) if sign < 0 else mesh
    return _mirrored(mesh, symmetry)


def _contact_edge(scene: Scene, area: Footprint) -> float:
    """Edge length in contact [m], short enough for the waves of an uneven object."""
    sizes = SIZES[scene.fidelity]
    return min(contact_edge(area, sizes), fine_feature(scene.object) / sizes.divisions)


def _seams(body: Body, shape: Solid | None, within: tuple[Inclusion, ...], sizes: MeshSizes) -> tuple[Array, float]:
    """Points (K, 3) of what is thin, or of another material, inside an object, and the edge length [m] that it asks for."""
    share = np.sqrt(SIZES["fast"].divisions / sizes.divisions)
    wanted = [(each.shape, share * each.size) for each in within]
    if shape is not None and body.shape in ("tube", "shell"):
        wanted.append((shape, share * wall(body)))
    size = min((each for _, each in wanted), default=np.inf)
    points = [np.zeros((0, 3)), *(solid_surface(each, size, np.inf)[0] for each, _ in wanted)]
    if shape is not None and body.shape in ("tube", "shell"):
        hollow = tuple(p for p in shape.patches if isinstance(p, Sweep) and any(s.radius < 0 for s in p.segments))
        near = patch_distances(hollow, points[-1]).min(axis=1) < 1.5 * wall(body)
        points[-1] = points[-1][near]
    return np.vstack(points), size


def _field(area: Footprint, bottom: float, top: float, edge: float, sizes: MeshSizes, far: float, rims: Array,
           seams: tuple[Array, float] = (np.zeros((0, 3)), np.inf)) -> SizeField:  # fmt: skip
    rounding = min(area.high) if area.round else 0.0
    rim = min(edge, sizes.rim if len(rims) or not len(seams[0]) else np.inf, seams[1])
    points = np.vstack([_cut(rims, rim).reshape(-1, 3), seams[0]])
    folded = area.folded(points)
    _, first = np.unique(np.round(folded / (0.1 * rim)), axis=0, return_index=True)
    corners = (*area.low, bottom), (*area.high, top)
    mirrored = (not area.side[0], not area.side[1])
    return SizeField(*corners, edge, sizes.growth, far, rounding, rim, sizes.rim_growth, folded[np.sort(first)], mirrored)


def _cut(pieces: Array, longest: float) -> Array:
    """Straight pieces (K, 2, 3) cut into ones no longer than `longest`."""
    steps = np.maximum(1, np.ceil(np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1) / longest * (1 - 1e-9)).astype(int))
    lines = [a + np.linspace(0.0, 1.0, n + 1)[:, None] * (b - a) for (a, b), n in zip(pieces, steps, strict=True)]
    return np.vstack([np.zeros((0, 2, 3)), *(np.stack([line[:-1], line[1:]], axis=1) for line in lines)])


def _touching(scene: Scene, pieces: Array) -> Array:
    """Where edges of the object (K, 2, 3) meet the gel's flat block when pressed into it; those over its border do not count."""
    turn, shift = placement(scene, rigid_surface(scene, frozenset()))
    placed = _cut(pieces, 0.5 * MM) @ turn.T + shift
    inside = (np.abs(placed[..., :2]) < np.array(scene.gel.size_mm) * MM / 2 * (1 - 1e-3)).all(axis=(1, 2))
    placed = placed[inside]
    gap = placed[..., 2] - gel_height(scene.gel, placed[..., :2].reshape(-1, 2)).reshape(-1, 2)
    placed = placed[(gap < press_depth(scene)).all(axis=1)]
    placed[..., 2] = 0.0
    return placed


def _fences(pieces: Array, depth: float, area: Footprint) -> TriMesh:
    """Upright strips below pieces (K, 2, 3) of the plane z = 0, folded as the area is: fTetWild keeps them, so edges lie along."""
    folded = area.folded(pieces)
    crosses = ((pieces[:, 0, :2] * pieces[:, 1, :2] < -1e-18) & (np.array(area.side) == 0)).any(axis=1)
    long = np.linalg.norm(folded[:, 1] - folded[:, 0], axis=1) > 1e-6
    tops = folded[long & ~crosses]
    _, first = np.unique(np.round(np.sort(tops, axis=1) * 1e9), axis=0, return_index=True)
    tops = tops[np.sort(first)]
    corners = np.concatenate([tops, tops - [0.0, 0.0, depth]], axis=1).reshape(-1, 3)
    faces = (4 * np.arange(len(tops))[:, None, None] + np.array([[0, 1, 3], [0, 3, 2]])).reshape(-1, 3)
    vertices, index = np.unique(np.round(corners, 12), axis=0, return_inverse=True)
    return TriMesh(vertices.reshape(-1, 3), index.ravel()[faces].astype(np.int32).reshape(-1, 3))


def footprint(scene: Scene) -> Footprint:
    """The undeformed overlap at full depth with a margin for drape and tangential travel, in classes."""
    surface = rigid_surface(scene, frozenset())
    turn, shift = placement(scene, surface)
    points = surface.nodes @ turn.T + shift
    half = np.array(scene.gel.size_mm) * MM / 2
    over = (np.abs(points[:, :2]) <= half).all(axis=1)
    touched = points[over & (points[:, 2] - gel_height(scene.gel, points[:, :2]) < press_depth(scene))][:, :2]
    if not len(touched):
        touched = shift[None, :2]
    margin = 0.1 * MM + np.abs(scene.press.shear_mm) * MM
    low, high = touched.min(axis=0) - margin, touched.max(axis=0) + margin
    inner = np.maximum(0.0, np.maximum(low, -high))
    outer = np.maximum(-low, high)
    high_class = np.minimum([class_above(v) for v in outer], half)
    low_class = [class_below(v) for v in inner]
    width = high_class - low_class
    drawn = scene.object.shape in DRAWN and abs(scene.press.twist_deg) <= _ALONG
    stretch = float(np.clip(np.floor(width[1] / width[0]), 1.0, 3.0)) if drawn else 1.0
    round_area = scene.object.shape in TURNED and not any(low_class)
    side_x, side_y = (int(np.sign(h)) if each else 0 for each, h in zip(low_class, low + high, strict=True))
    corners = (float(low_class[0]), float(low_class[1])), (float(high_class[0]), float(high_class[1]))
    return Footprint(*corners, stretch, round_area, (side_x, side_y))


def mesh_report(mesh: TetMesh, parts: tuple[str, ...] = ()) -> dict[str, object]:
    """Nodes, elements and quality (mean ratio of the straight tets, 1 is regular) for report.json; of several parts their volumes."""
    quality = tet_quality(mesh.rest_positions, mesh.tets)
    report: dict[str, object] = {
        "nodes": len(mesh.rest_positions),
        "elements": len(mesh.tets),
        "smallest_quality": round(float(quality.min()), 4),
        "mean_quality": round(float(quality.mean()), 4),
        "symmetry": "".join(sorted(mesh.symmetry)),
    }
    if len(parts) > 1:
        report["volume_mm3"] = _volumes(mesh, parts)
    return report


def _volumes(mesh: TetMesh, parts: tuple[str, ...]) -> dict[str, float]:
    """Of the whole body, mirror images included."""
    return {name: float(2 ** len(mesh.symmetry) * v / MM**3) for name, v in zip(parts, region_volumes(mesh), strict=True)}


def _mirrored(mesh: TetMesh, symmetry: frozenset[str]) -> TetMesh:
    for axis in sorted(mesh.symmetry - symmetry):
        mesh = mirror(mesh, axis)
    return mesh


# ---------------------------------------------------------------------------------------------------------------- filling
def _fill(surface: TriMesh, shape: Solid | None, field: SizeField, stretch: float, label: str, within: Within = (),
          image: Image | None = None) -> TetMesh:  # fmt: skip
    """Ten-node tets inside a closed surface, boundary nodes on the exact shape (None: on the facets as they come).

    They are such that none folds under `image`: a long flat tet of good quality may, where that bends it."""
    squeeze = np.array([1.0, 1.0 / stretch, 1.0])
    narrow = field.squeezed(stretch)
    smallest = min(field.contact, field.rim)
    inside = TriMesh(surface.vertices * squeeze, surface.faces)
    for _, inner in within:
        inside = TriMesh(
            np.vstack([inside.vertices, inner.vertices * squeeze]), np.vstack([inside.faces, inner.faces + len(inside.vertices)])
        )
    fault = ""
    for attempt in _ATTEMPTS:
        vertices, tets = _tetwild(inside, narrow, attempt, label)
        vertices = vertices / squeeze
        inverted = tet_volumes(vertices, tets) < 0
        tets[inverted] = tets[inverted][:, [1, 0, 2, 3]]
        regions = _regions(vertices, tets, within)
        near = 2 * stretch * (attempt[0] * smallest + _CHORD * field(vertices))
        vertices, faces, patch = _snapped(vertices, tets, regions, shape, within, near)
        quality = tet_quality(vertices * squeeze, tets)
        if quality.min() <= _WORST_QUALITY:
            fault = f"one of quality {quality.min():.3g}; allowed: above {_WORST_QUALITY:g}"
            continue
        mesh = _ten_node(vertices, tets, regions, shape, within, faces, patch, label)
        smallest = _smallest_jacobian(mesh, image)
        if smallest > 0.0:
            return mesh
        fault = f"a folded one (smallest Jacobian {smallest / MM**3:.3g} mm³)"
    raise MeshingError(
        f"filling {label} with tetrahedra left {fault}; try another fidelity, or a surface without sliver faces and gaps below 0.05 mm"
    )


def _ten_node(vertices: Array, tets: NDArray[np.int32], regions: NDArray[np.int32], shape: Solid | None, within: Within,
              faces: NDArray[np.int32], patch: NDArray[np.int64], label: str) -> TetMesh:  # fmt: skip
    """The filling with mid-side nodes on the exact shape, and its groups; `faces` and `patch` as `_snapped` gives them."""
    nodes, tets10 = quadratic_tets(vertices, tets)
    boundary = outer_faces(tets10)
    if shape is None:
        return TetMesh(nodes, tets10, _mesh_groups(nodes, boundary, label))
    nodes = _curved(nodes, tets10, faces, patch, _together(shape, within), len(vertices))
    roles = np.array(shape.roles)[patch[: len(boundary)]]
    groups = {role: boundary[roles == role] for role in sorted(set(shape.roles) - set(AXES))}
    return TetMesh(nodes, tets10, groups, frozenset(shape.roles) & frozenset(AXES), regions)


def _smallest_jacobian(mesh: TetMesh, image: Image | None) -> float:
    """Of a filling as it will be used [m³]; a tet folds where it is not positive."""
    used = image(mesh) if image else mesh
    return float(jacobian_determinants(used.rest_positions, used.tets).min())


def _regions(vertices: Array, tets: NDArray[np.int32], within: Within) -> NDArray[np.int32]:
    """The part that each tet belongs to, (T,): of an object with a skin what is not flesh is the skin, number 1."""
    regions, middle = np.zeros(len(tets), np.int32), vertices[tets].mean(axis=1)
    for part, surface in within:
        inside = winding_numbers(middle, surface) > 0.5
        if part.region:
            regions[inside] = part.region
        else:
            regions[~inside] = 1
    return regions


def _together(shape: Solid, within: Within) -> Solid:
    """The patches of the outer shape, then those of the interfaces: their bases and cuts are the outer ones."""
    inner = [p for part, _ in within for p, role in zip(part.shape.patches, part.shape.roles, strict=True) if role == "contact"]
    return Solid((*shape.patches, *inner), (*shape.roles, *("interface" for _ in inner)), shape.hull)


def _tetwild(surface: TriMesh, field: SizeField, attempt: tuple[float, float, int], label: str) -> tuple[Array, NDArray[np.int32]]:
    """fTetWild in a process of its own: it writes to the standard streams and into the working folder, and a bad surface can crash it.

    It draws random numbers that cannot be seeded, so each call gives another mesh; the cache keeps the first.
    """
    envelope, energy, passes = attempt
    lower, upper = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    diagonal = float(np.linalg.norm(upper - lower))
    fenced = not is_closed(surface.faces)  # a block with strips in it: its winding number would not tell inside from outside beside them
    points, cells, values = field.background(lower - 0.05 * diagonal, upper + 0.05 * diagonal)
    with tempfile.TemporaryDirectory() as folder:
        given = {  # in millimetres: some of its tolerances are absolute
            "vertices": surface.vertices / MM, "faces": surface.faces,
            "bg_vertices": points / MM, "bg_tets": cells, "bg_values": values / LONGER / MM, "edge_length_abs": field.far / LONGER / MM,
            "epsilon": envelope * min(field.contact, field.rim) / diagonal, "stop_energy": energy, "num_opt_iter": passes,
            "disable_filtering": fenced,
        }  # fmt: skip
        np.savez(Path(folder) / "in.npz", **{name: np.asarray(value) for name, value in given.items()})  # type: ignore[arg-type]
        child = subprocess.run([sys.executable, "-c", _CHILD], cwd=folder, capture_output=True, text=True, errors="replace", check=False)
        out = Path(folder) / "out.npz"
        if child.returncode or not out.exists():
            said = (child.stderr.strip().splitlines() or [f"exit code {child.returncode}"])[-1]
            raise MeshingError(f"filling {label} with tetrahedra failed ({said}); try to close and clean its surface")
        with np.load(out, allow_pickle=False) as stored:
            filled, tets = stored["vertices"], stored["tets"]
    if fenced:
        centre = filled[tets].mean(axis=1) * MM
        tets = tets[((centre > lower) & (centre < upper)).all(axis=1)]
    if not len(tets):
        raise MeshingError(f"filling {label} left no tetrahedron: its surface encloses nothing; try to close it and check its orientation")
    used, tets = np.unique(tets, return_inverse=True)
    return filled[used] * MM, tets.reshape(-1, 4).astype(np.int32)


_CHILD = """
import numpy, pytetwild
with numpy.load("in.npz", allow_pickle=False) as stored:
    given = {name: stored[name] if stored[name].ndim else stored[name].item() for name in stored.files}
surface = given.pop("vertices"), given.pop("faces")
vertices, tets = pytetwild.tetrahedralize(*surface, num_threads=1, quiet=True, loglevel=6, coarsen=True, **given)
numpy.savez("out.npz", vertices=vertices, tets=tets)
"""


def _snapped(vertices: Array, tets: NDArray[np.int32], regions: NDArray[np.int32], shape: Solid | None, within: Within,
             near: Array) -> tuple[Array, NDArray[np.int32], NDArray[np.int64]]:  # fmt: skip
    """Vertices of boundary and interfaces put on the patches of the faces around them, at most `near` away; these six-node faces, boundary
    first, and the patch of each in `_together`."""
    tets10 = quadratic_tets(vertices, tets)[1]
    if shape is None:
        return vertices, outer_faces(tets10), np.zeros(0, np.int64)
    faces = [outer_faces(tets10)]
    patch = [classify(shape.patches, vertices, faces[0][:, :3], near)]
    before = len(shape.patches)
    for part, _ in within:
        mine = tuple(p for p, role in zip(part.shape.patches, part.shape.roles, strict=True) if role == "contact")
        faces.append(interface_faces(tets10, regions == part.region if part.region else regions != 1))
        patch.append(before + classify(mine, vertices, faces[-1][:, :3], near))
        before += len(mine)
    whole, all_faces, all_patches = _together(shape, within), np.vstack(faces), np.concatenate(patch)
    member = membership(all_faces[:, :3], all_patches, len(vertices), len(whole.patches))
    on = member.any(axis=1)
    moved = vertices.copy()
    moved[on] = snap(whole.patches, vertices[on], member[on])
    zero_cuts(whole, moved, member)
    return moved, all_faces, all_patches


def _curved(
    nodes: Array, tets: NDArray[np.int32], boundary: NDArray[np.int32], patch: NDArray[np.int64], shape: Solid, vertex_count: int
) -> Array:
    """Mid-side nodes of boundary edges on the exact shape, but for edges whose curving would fold a tet or move the node too far."""
    member = membership(boundary[:, 3:], patch, len(nodes), len(shape.patches))
    member[:vertex_count] = False
    on = np.flatnonzero(member.any(axis=1))
    curved = nodes.copy()
    curved[on] = snap(shape.patches, nodes[on], member[on])
    zero_cuts(shape, curved, member)
    return _unfolded(curved, tets, _MOST_CURVED)


def _unfolded(curved: Array, tets: NDArray[np.int32], most: float) -> Array:
    """Nodes whose middles are put back to straight where they lie more than `most` edge lengths off, or where they would fold a tet."""
    ends = np.zeros((len(curved), 2), np.int64)
    ends[tets[:, 4:]] = tets[:, TET_EDGES]
    straight = curved[ends].mean(axis=1)
    vertex = np.setdiff1d(np.arange(len(curved)), tets[:, 4:])
    straight[vertex] = curved[vertex]
    length = np.linalg.norm(curved[ends[:, 1]] - curved[ends[:, 0]], axis=1)
    # Straight middles as they come would differ by rounding from a node that is already on its plane.
    bent = np.linalg.norm(curved - straight, axis=1)
    out = np.where((bent > most * length)[:, None], straight, curved)
    reference = 6.0 * tet_volumes(curved, tets)[:, None]
    while True:
        folded = (jacobian_determinants(out, tets) < 0.1 * reference).any(axis=1)
        back = np.unique(tets[folded, 4:])
        back = back[(bent[back] > 1e-12) & (out[back] != straight[back]).any(axis=1)]
        if not len(back):
            return out
        out[back] = straight[back]


def _mesh_groups(nodes: Array, boundary: NDArray[np.int32], label: str) -> dict[str, NDArray[np.int32]]:
    corners = nodes[boundary[:, :3]]
    top = nodes[:, 2].max()
    up = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0.0
    base = up & (corners[:, :, 2] >= top - 0.02 * (top - nodes[:, 2].min())).all(axis=1)
    if not base.any():
        raise MeshingError(f"{label} has no face in the top 2 % of its height to fix to the platen; try to cut it flat there")
    return {"base": boundary[base], "contact": boundary[~base]}


# ---------------------------------------------------------------------------------------------------------------- cache
def cache_folder() -> Path:
    """$GELSIM_CACHE, or the user's cache folder; never inside the repository."""
    import platformdirs

    return Path(os.environ.get("GELSIM_CACHE") or platformdirs.user_cache_dir("gelsim")) / "meshes"


def _cached_fill(surface: TriMesh, shape: Solid | None, field: SizeField, stretch: float, label: str, progress: Progress | None,
                 within: Within = (), image: Image | None = None) -> TetMesh:  # fmt: skip
    """`_fill` from the cache, under `image`, which it does not depend on: a filling made for one that folds under another is made anew."""
    key = _key(surface, shape, field, stretch, within)
    path = cache_folder() / f"{key}.npz"
    mesh = _read(path)
    if mesh is None or _smallest_jacobian(mesh, image) <= 0.0:
        (progress or _say)(f"meshing {label}: once for this shape and size, then it comes from the cache")
        mesh = _fill(surface, shape, field, stretch, label, within, image)
        try:
            _write(path, mesh)
        except OSError as error:  # a full or read-only cache costs time, not the result
            (progress or _say)(f"the mesh of {label} is not kept: {path.parent} cannot be written ({error.strerror})")
    return image(mesh) if image else mesh


def _say(line: str) -> None:
    if sys.stderr.isatty():
        print(line, file=sys.stderr, flush=True)


def _key(surface: TriMesh, shape: Solid | None, field: SizeField, stretch: float, within: Within) -> str:
    """Hash of everything a mesh depends on. Coordinates are rounded to a picometre, so that the last bits of libm do not matter."""
    digest = hashlib.sha256()
    settings = [_SCHEMA, version("pytetwild"), _MOST_CURVED, _ATTEMPTS, _CHILD, LONGER, field.settings(), stretch, shape and shape.roles]
    digest.update(json.dumps(settings, sort_keys=True, default=float).encode())
    digest.update(np.round(surface.vertices * 1e12).astype(np.int64).tobytes())
    digest.update(surface.faces.tobytes())
    for part, inner in within:
        digest.update(f"{part.region} {part.shape.roles}".encode())
        digest.update(np.round(inner.vertices * 1e12).astype(np.int64).tobytes())
        digest.update(inner.faces.tobytes())
    return digest.hexdigest()[:32]


def _write(path: Path, mesh: TetMesh) -> None:
    groups = {f"group_{name}": faces for name, faces in mesh.groups.items()}
    arrays = {"rest_positions": mesh.rest_positions, "tets": mesh.tets, "symmetry": np.array("".join(sorted(mesh.symmetry)))}
    arrays["regions"] = mesh.regions
    with whole_file(path) as partial, partial.open("wb") as file:
        np.savez(file, **arrays, **groups)  # type: ignore[arg-type]


def _read(path: Path) -> TetMesh | None:
    """The stored mesh, or None where there is none or it is damaged."""
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as stored:
            groups = {name.removeprefix("group_"): stored[name] for name in stored.files if name.startswith("group_")}
            regions = stored["regions"] if "regions" in stored.files else np.zeros(0, np.int32)  # kept before there were any
            mesh = TetMesh(stored["rest_positions"], stored["tets"], groups, frozenset(str(stored["symmetry"])), regions)
        count = len(mesh.rest_positions)
        whole = np.isfinite(mesh.rest_positions).all() and all(0 <= a.min() and a.max() < count for a in (mesh.tets, *groups.values()))
        return mesh if whole else None
    except (OSError, ValueError, KeyError, AssertionError, EOFError, zipfile.BadZipFile, zlib.error):
        return None
