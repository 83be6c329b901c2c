"""Fills the object with ten-node tetrahedra, fine where it meets the gel and coarse where it does not.

The filling is fTetWild's (Hu et al. 2020) through pytetwild, with the size field of `gelsim.mesh.sizing`. What comes back is turned right
side out, its boundary put exactly onto the planes and curved patches of the shape (fTetWild keeps only within an envelope of it), and given
mid-side nodes that lie on the exact shape.

A skin and grains are filled together with the body: their surfaces are given to fTetWild too, which keeps them, each tet's material is told
by the winding number of its middle, and interfaces are put onto their exact shape like the boundary.

A symmetric body is meshed as the part its mirror planes cut out and mirrored up to what is asked for. A shape drawn along y is meshed in a
space squeezed along y and stretched back: tets are long where nothing changes.

Left out: adaptivity (the press itself reports its error). The gel: `gelsim.mesh.gel_mesh`.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import MeshingError, SceneError
from gelsim.files import cache_folder, whole_file
from gelsim.geometry import (
    AXES,
    TetMesh,
    TriMesh,
    flip,
    interface_faces,
    jacobian_determinants,
    mirrored,
    outer_faces,
    quadratic_tets,
    region_volumes,
    tet_quality,
    tet_volumes,
    unfolded,
    winding_numbers,
)
from gelsim.mesh.contact_area import contact_field, core, edge_in_contact, footprint
from gelsim.mesh.inclusions import Inclusion, inclusions
from gelsim.mesh.sizing import LONGER, SIZES, MeshSizes, SizeField, class_above, object_edge
from gelsim.scene.definition import Body, Scene
from gelsim.scene.shape_table import SHAPES
from gelsim.shape.mesh_file import compare_bodies
from gelsim.shape.orientation import is_reoriented
from gelsim.shape.outlines import bore, wall
from gelsim.shape.rims import cut_pieces
from gelsim.shape.shapes import object_surface, of_file, own_frame, press_depth, shape_symmetry, sharp_edges, solid
from gelsim.shape.solids import Array, Solid, Sweep, classify, membership, patch_distances, snap, solid_surface, zero_cuts
from gelsim.units import MM

_SCHEMA = 4
"""Raise it when the same key would no longer give the same mesh."""
_WORST_QUALITY = 0.02
"""Smallest mean-ratio quality of a straight tet that is let through; fTetWild's own meshes reach 0.1 to 0.3."""
_CHORD = 0.05
"""Distance allowed between the facets that fTetWild is given and the curved shape, per edge length asked for there."""
_COARSE = np.radians(30.0)
"""Angle between the corners of a turned object before its surface is refined: at 15 degrees a foot would get edges of a quarter radius."""
_MOST_CURVED = 0.12
"""Largest move of a mid-side node onto the exact shape, per edge length: an arc of 54 degrees."""
_ATTEMPTS = ((1.0, 10.0, 20), (1 / 3, 10.0, 20), (2 / 15, 6.0, 80))
"""Share of the envelope in which fTetWild may move the surface before its vertices are put back; its AMIPS energy to
stop at (a regular tet has 3); the passes it may take. The next is tried when one leaves a bad or folded tet; a smaller envelope costs more
passes."""
_OF_FACETS = 0.15
"""The same per smallest edge length (`MeshSizes.envelope`) of a surface of facets alone."""

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Domain:
    """What is filled."""

    label: str
    """What people are told it is."""
    surface: TriMesh
    """The facets that fTetWild is given [m]."""
    shape: Solid | None = None
    """What boundary nodes are put on; None: they stay on the facets."""
    within: tuple[tuple[Inclusion, TriMesh], ...] = ()
    """What lies inside it, with the facets that fTetWild is given for it."""

    def patches(self) -> Solid:
        """The patches of the outer shape, then those of the interfaces: their bases and cuts are the outer ones."""
        assert self.shape is not None
        inner = [p for part, _ in self.within for p, role in zip(part.shape.patches, part.shape.roles, strict=True) if role == "contact"]
        return Solid((*self.shape.patches, *inner), (*self.shape.roles, *("interface" for _ in inner)), self.shape.hull)


# ---------------------------------------------------------------------------------------------------------------- the object
def mesh_object(
    scene: Scene, symmetry: frozenset[str] = frozenset(), progress: Progress | None = None, *, drawn_before: int = 0
) -> TetMesh:
    """The object in its own frame, cut at the planes of `symmetry`; groups "base" (top plane) and "contact" (all else but the cut planes).

    The base of a `mesh` shape is what faces up within the top 2 % of its height.

    Args:
        drawn_before: Meshes of it that did not serve: this is another of the same sizes, for fTetWild draws by lot.
    Raises:
        SceneError: The shape fields make no solid, or the bodies of a file are filled otherwise than meant.
        MeshingError: The surface cannot be filled, the filling is of too low quality, or the platen does not hold all of it.
    """
    body, sizes = scene.object, SIZES[scene.fidelity]
    centred = scene.replace(press=replace(scene.press, offset_mm=(0.0, 0.0)))
    area = footprint(centred)
    within: tuple[Inclusion, ...] = ()
    # As of the gel: no mirror image where one side alone is touched.
    side_x, side_y = side = tuple(sign if axis in shape_symmetry(body) else 0 for axis, sign in zip("xy", area.side, strict=True))
    row = SHAPES[body.shape]
    if of_file(body) or is_reoriented(body):  # what is cut where it is held has no patches of its own
        surface = object_surface(body, edge_length=np.inf, chord=_CHORD * edge_in_contact(scene, area))
        shape, stretch = None, 1.0
        told = compare_bodies(surface)
        if told and told.faults:  # a rigid object may have them: only its outside counts
            raise SceneError(f'object.mesh = "{body.mesh}": {told.faults[0]}')
        narrow = float(np.ptp(surface.vertices, axis=0).min())
    else:
        cut = shape_symmetry(body) - {axis for axis, sign in zip("xy", side, strict=True) if sign}
        surface, shape, stretch = None, solid(body, cut, _COARSE), area.stretch
        within = inclusions(body, cut, _COARSE)
        narrow = float(np.ptp(solid(body).hull, axis=0).min())
    uneven = 2.0 * body.amplitude_mm * MM if row.relief else 0.0
    deep = class_above(0.5 * press_depth(scene)) if sizes.deeper else 0.5 * press_depth(scene)
    box = replace(area, low=(0.0, 0.0), side=(side_x, side_y)), 0.0, deep + uneven
    edge = object_edge(box[0], box[2], edge_in_contact(scene, area), np.inf if row.bumpy else sizes.most_cubes)
    # Away from contact a tall object is a spring, but it needs two or three quadratic edges across to bend and stay round.
    far = max(edge, min(sizes.object_far, narrow / 2.5))
    rims = cut_pieces(sharp_edges(body), min(edge, sizes.rim))
    reach = np.minimum(area.high, np.array(scene.gel.size_mm) * MM / 2 * (1 - 1e-3))  # beside the gel, or at its border, no rim presses
    rims = rims[((rims[..., 2] < 1.5 * press_depth(scene)) & (np.abs(rims[..., :2]) <= reach).all(axis=-1)).all(axis=1)]
    seams, thin = _seams(body, shape, within, sizes)
    field = contact_field(*box, edge, sizes, far, rims, (seams, min(edge, thin)), core(centred, edge, of_object=True))
    inner: list[TriMesh] = []
    if is_reoriented(body) and not of_file(body):
        # Facets as short as the tets over them: with a cylinder's longest the force of one was 1.4 % too small.
        turn, shift = own_frame(body)
        surface = object_surface(body, edge_length=lambda points: field(points @ turn.T + shift), chord=_CHORD * edge)
    if surface is None:
        assert shape is not None
        surface, *inner = (
            TriMesh(*solid_surface(each, np.inf, lambda points: _CHORD * field(points))[:2]) for each in (shape, *(i.shape for i in within))
        )
    label = f"the object ({body.mesh if of_file(body) else body.shape})"
    domain = Domain(label, surface, shape, tuple(zip(within, inner, strict=True)))
    smallest = min(field.smallest, np.inf if len(seams) else sizes.rim)
    envelope = (_OF_FACETS if shape is None else sizes.envelope) * smallest
    mesh = _cached_fill(domain, field, stretch, envelope, progress, drawn_before)
    _check_held(mesh, label)
    for axis, sign in zip("xy", side, strict=True):
        mesh = flip(mesh, axis) if sign < 0 else mesh
    return mirrored(mesh, symmetry)


def _check_held(mesh: TetMesh, label: str) -> None:
    """Every body of an object must reach the platen: one that does not would float, and its press converge without a force."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    nodes, first = len(mesh.rest_positions), np.repeat(mesh.tets[:, 0], mesh.tets.shape[1])
    count, body = connected_components(coo_array((np.ones(len(first)), (first, mesh.tets.ravel())), (nodes, nodes)), directed=False)
    loose = np.setdiff1d(np.arange(count), body[mesh.groups["base"]])
    if len(loose):
        z = mesh.rest_positions[:, 2] / MM
        lowest = min(z[body == each].max() for each in loose)
        raise MeshingError(
            f"{label} is {count} bodies apart, {len(loose)} of them without a face in the top 2 % of the height to fix to the platen "
            f"(the lowest ends at {lowest:.3g} of {z.max():.3g} mm); join them, end them at one height, or set object.rigid = true"
        )


def _seams(body: Body, shape: Solid | None, within: tuple[Inclusion, ...], sizes: MeshSizes) -> tuple[Array, float]:
    """Points (K, 3) of what is thin, or of another material, inside an object, and the edge length [m] that it asks for."""
    share = np.sqrt(SIZES["fast"].divisions / sizes.divisions)
    wanted = [(each.shape, share * each.size) for each in within]
    if shape is not None and bore(body):
        wanted.append((shape, share * wall(body)))
    size = min((each for _, each in wanted), default=np.inf)
    points = [np.zeros((0, 3)), *(solid_surface(each, size, np.inf)[0] for each, _ in wanted)]
    if shape is not None and bore(body):
        hollow = tuple(p for p in shape.patches if isinstance(p, Sweep) and any(s.radius < 0 for s in p.segments))
        near = patch_distances(hollow, points[-1]).min(axis=1) < 1.5 * wall(body)
        points[-1] = points[-1][near]
    return np.vstack(points), size


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


# ---------------------------------------------------------------------------------------------------------------- filling
def _fill(domain: Domain, field: SizeField, stretch: float, envelope: float) -> TetMesh:
    """Ten-node tets inside a closed surface, boundary nodes on the exact shape."""
    squeeze = np.array([1.0, 1.0 / stretch, 1.0])
    narrow = field.squeezed(stretch)
    inside = TriMesh(domain.surface.vertices * squeeze, domain.surface.faces)
    for _, inner in domain.within:
        inside = TriMesh(
            np.vstack([inside.vertices, inner.vertices * squeeze]), np.vstack([inside.faces, inner.faces + len(inside.vertices)])
        )
    fault = ""
    for share, energy, passes in _ATTEMPTS:
        vertices, tets = _tetwild(inside, narrow, share * envelope, energy, passes, domain.label)
        vertices = vertices / squeeze
        inverted = tet_volumes(vertices, tets) < 0
        tets[inverted] = tets[inverted][:, [1, 0, 2, 3]]
        regions = _regions(vertices, tets, domain)
        near = 2 * stretch * (share * envelope + _CHORD * field(vertices))
        vertices, faces, patch = _snapped(domain, vertices, tets, regions, near)
        quality = tet_quality(vertices * squeeze, tets)
        if quality.min() <= _WORST_QUALITY:
            fault = f"one of quality {quality.min():.3g}; allowed: above {_WORST_QUALITY:g}"
            continue
        mesh = _ten_node(domain, vertices, tets, regions, faces, patch)
        jacobian = float(jacobian_determinants(mesh.rest_positions, mesh.tets).min())
        if jacobian > 0.0:
            return mesh
        fault = f"a folded one (smallest Jacobian {jacobian / MM**3:.3g} mm³)"
    raise MeshingError(
        f"filling {domain.label} with tetrahedra left {fault}; try another fidelity, or a surface without sliver faces and gaps below "
        "0.05 mm"
    )


def _ten_node(domain: Domain, vertices: Array, tets: NDArray[np.int32], regions: NDArray[np.int32], faces: NDArray[np.int32],
              patch: NDArray[np.int64]) -> TetMesh:  # fmt: skip
    """The filling with mid-side nodes on the exact shape, and its groups; `faces` and `patch` as `_snapped` gives them."""
    nodes, tets10 = quadratic_tets(vertices, tets)
    boundary = outer_faces(tets10)
    shape = domain.shape
    if shape is None:
        return TetMesh(nodes, tets10, _mesh_groups(nodes, boundary, domain.label))
    nodes = _curved(nodes, tets10, faces, patch, domain.patches(), len(vertices))
    roles = np.array(shape.roles)[patch[: len(boundary)]]
    groups = {role: boundary[roles == role] for role in sorted(set(shape.roles) - set(AXES))}
    return TetMesh(nodes, tets10, groups, frozenset(shape.roles) & frozenset(AXES), regions)


def _regions(vertices: Array, tets: NDArray[np.int32], domain: Domain) -> NDArray[np.int32]:
    """The part that each tet belongs to, (T,): of an object with a skin what is not flesh is the skin, number 1."""
    regions, middle = np.zeros(len(tets), np.int32), vertices[tets].mean(axis=1)
    for part, surface in domain.within:
        inside = winding_numbers(middle, surface) > 0.5
        if part.region:
            regions[inside] = part.region
        else:
            regions[~inside] = 1
    return regions


def _tetwild(
    surface: TriMesh, field: SizeField, envelope: float, energy: float, passes: int, label: str
) -> tuple[Array, NDArray[np.int32]]:
    """fTetWild in a process of its own: it writes to the standard streams and into the working folder, and a bad surface can crash it.

    It draws random numbers that cannot be seeded, so each call gives another mesh; the cache keeps it.
    """
    lower, upper = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    diagonal = float(np.linalg.norm(upper - lower))
    points, cells, values = field.background(lower - 0.05 * diagonal, upper + 0.05 * diagonal)
    with tempfile.TemporaryDirectory() as folder:
        given = {  # in millimetres: some of its tolerances are absolute
            "vertices": surface.vertices / MM, "faces": surface.faces,
            "bg_vertices": points / MM, "bg_tets": cells, "bg_values": values / LONGER / MM, "edge_length_abs": field.far / LONGER / MM,
            "epsilon": envelope / diagonal, "stop_energy": energy, "num_opt_iter": passes,
        }  # fmt: skip
        np.savez(Path(folder) / "in.npz", **{name: np.asarray(value) for name, value in given.items()})  # type: ignore[arg-type]
        command = [sys.executable, "-c", _WITHOUT_PYVISTA + _CHILD]
        child = subprocess.run(command, cwd=folder, capture_output=True, text=True, errors="replace", check=False)
        out = Path(folder) / "out.npz"
        if child.returncode or not out.exists():
            said = (child.stderr.strip().splitlines() or [f"exit code {child.returncode}"])[-1]
            raise MeshingError(
                f"filling {label} with tetrahedra failed ({said}); try a larger part, or rigid; of a file, to close and clean its surface"
            )
        with np.load(out, allow_pickle=False) as stored:
            filled, tets = stored["vertices"], stored["tets"]
    if not len(tets):
        raise MeshingError(f"filling {label} left no tetrahedron: its surface encloses nothing; try to close it and check its orientation")
    used, tets = np.unique(tets, return_inverse=True)
    return filled[used] * MM, tets.reshape(-1, 4).astype(np.int32)


_WITHOUT_PYVISTA = """
import sys, types
sys.modules["pyvista"] = types.ModuleType("pyvista")
"""
"""Run before `_CHILD`: pytetwild imports it only to register itself there, so that it and VTK, 580 MB, need not be installed."""
_CHILD = """
import numpy, pytetwild
with numpy.load("in.npz", allow_pickle=False) as stored:
    given = {name: stored[name] if stored[name].ndim else stored[name].item() for name in stored.files}
surface = given.pop("vertices"), given.pop("faces")
vertices, tets = pytetwild.tetrahedralize(*surface, num_threads=1, quiet=True, loglevel=6, coarsen=True, **given)
numpy.savez("out.npz", vertices=vertices, tets=tets)
"""


def _snapped(
    domain: Domain, vertices: Array, tets: NDArray[np.int32], regions: NDArray[np.int32], near: Array
) -> tuple[Array, NDArray[np.int32], NDArray[np.int64]]:
    """Vertices of boundary and interfaces put on the patches of the faces around them, at most `near` away; these six-node faces, boundary
    first, and the patch of each in `Domain.patches`."""
    tets10, shape = quadratic_tets(vertices, tets)[1], domain.shape
    if shape is None:
        boundary = outer_faces(tets10)
        return _on_facets(domain.surface, vertices, np.unique(boundary[:, :3]), near), boundary, np.zeros(0, np.int64)
    faces = [outer_faces(tets10)]
    patch = [classify(shape.patches, vertices, faces[0][:, :3], near)]
    before = len(shape.patches)
    for part, _ in domain.within:
        mine = tuple(p for p, role in zip(part.shape.patches, part.shape.roles, strict=True) if role == "contact")
        faces.append(interface_faces(tets10, regions == part.region if part.region else regions != 1))
        patch.append(before + classify(mine, vertices, faces[-1][:, :3], near))
        before += len(mine)
    whole, all_faces, all_patches = domain.patches(), np.vstack(faces), np.concatenate(patch)
    member = membership(all_faces[:, :3], all_patches, len(vertices), len(whole.patches))
    on = member.any(axis=1)
    moved = vertices.copy()
    moved[on] = snap(whole.patches, vertices[on], member[on])
    zero_cuts(whole, moved, member)
    return moved, all_faces, all_patches


def _on_facets(surface: TriMesh, vertices: Array, on: NDArray[np.int32], near: Array) -> Array:
    """Vertices, of which some are put on the closest facet, at most `near` away.

    fTetWild leaves one in ten meshes a vertex that is 30 µm too low, by which a press begins too early: forces of a rod scattered by 11 %,
    so by 1 %.
    """
    from trimesh.triangles import closest_point

    corners, moved = surface.vertices[surface.faces], vertices.copy()
    low, high = corners.min(axis=1), corners.max(axis=1)
    for part in np.array_split(on, 1 + len(on) * len(corners) // 10**7):
        at, far = vertices[part], near[part, None]
        beside = np.logical_and.reduce([
            (at[:, i, None] >= low[:, i] - far) & (at[:, i, None] <= high[:, i] + far) for i in range(3)
        ])  # fmt: skip
        place, facet = np.nonzero(beside)
        found = closest_point(corners[facet] / MM, at[place] / MM) * MM
        away = np.linalg.norm(found - at[place], axis=1)
        order = np.lexsort((away, place))
        each, first = np.unique(place[order], return_index=True)
        best = order[first]
        good = away[best] <= near[part[each]]
        moved[part[each[good]]] = found[best[good]]
    return moved


def _curved(
    nodes: Array, tets: NDArray[np.int32], boundary: NDArray[np.int32], patch: NDArray[np.int64], shape: Solid, vertex_count: int
) -> Array:
    """Mid-side nodes of boundary edges on the exact shape, but for those that would fold a tet or move too far (`unfolded`)."""
    member = membership(boundary[:, 3:], patch, len(nodes), len(shape.patches))
    member[:vertex_count] = False
    on = np.flatnonzero(member.any(axis=1))
    curved = nodes.copy()
    curved[on] = snap(shape.patches, nodes[on], member[on])
    zero_cuts(shape, curved, member)
    return unfolded(curved, tets, _MOST_CURVED)


def _mesh_groups(nodes: Array, boundary: NDArray[np.int32], label: str) -> dict[str, NDArray[np.int32]]:
    corners = nodes[boundary[:, :3]]
    top = nodes[:, 2].max()
    up = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0.0
    base = up & (corners[:, :, 2] >= top - 0.02 * (top - nodes[:, 2].min())).all(axis=1)
    if not base.any():
        raise MeshingError(f"{label} has no face in the top 2 % of its height to fix to the platen; try to cut it flat there")
    return {"base": boundary[base], "contact": boundary[~base]}


# ---------------------------------------------------------------------------------------------------------------- cache
def _cached_fill(
    domain: Domain, field: SizeField, stretch: float, envelope: float, progress: Progress | None, drawn_before: int
) -> TetMesh:
    """`_fill` from the cache, which keeps each draw by its number."""
    key = _key(domain, field, stretch, envelope) + (f"-{drawn_before}" if drawn_before else "")
    path = cache_folder("meshes") / f"{key}.npz"
    mesh = _read(path)
    if mesh is None:
        (progress or _say)(f"meshing {domain.label}: once for this shape and size, then it comes from the cache")
        mesh = _fill(domain, field, stretch, envelope)
        try:
            _write(path, mesh)
        except OSError as error:  # a full or read-only cache costs time, not the result
            (progress or _say)(f"the mesh of {domain.label} is not kept: {path.parent} cannot be written ({error.strerror})")
    return mesh


def _say(line: str) -> None:
    if sys.stderr.isatty():
        print(line, file=sys.stderr, flush=True)


def _key(domain: Domain, field: SizeField, stretch: float, envelope: float) -> str:
    """Hash of everything a mesh depends on. Coordinates are rounded to a picometre, so that the last bits of libm do not matter."""
    digest = hashlib.sha256()
    asked = [field.settings(), stretch, envelope, domain.shape and domain.shape.roles]
    settings = [_SCHEMA, version("pytetwild"), _MOST_CURVED, _ATTEMPTS, _CHILD, LONGER, *asked]
    digest.update(json.dumps(settings, sort_keys=True, default=float).encode())
    digest.update(np.round(domain.surface.vertices * 1e12).astype(np.int64).tobytes())
    digest.update(domain.surface.faces.tobytes())
    for part, inner in domain.within:
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
