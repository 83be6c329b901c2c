"""Objects from files: reads an STL, OBJ, PLY, OFF or GLB, checks and turns it, and puts its lowest point at the origin.

A surface bounds a body where every edge is passed as often one way as the other: two faces an edge, or four where two boxes share one. The
rest are open edges. A rigid object needs the surface that touches alone: what is missing is closed, so that the winding number tells inside
from outside everywhere. A hole gets a fan of triangles to its middle; where what is missing faces away from the gel, as the back of a scan,
walls go up from the rim to a lid; of a bare sheet the side that the gel sees is the outside. Without that a sheet's winding number is ½ on
neither side (tests/unit/test_mesh_file.py measures it). A soft object is closed, by fans, only when `object.mesh_repair` asks for it.

A slit, open edges with no area between them, is sewn: a face is split where a vertex of the rim lies on its open edge. So is what slivers
leave, triangles without area that close a surface in name. Two faces back to back bound nothing and are left out.

Only geometry is read: no material, texture or other file that the mesh names is opened, and nothing in it is run.

Left out: what crosses itself within one body is not looked for; the winding number counts it as filled.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import SceneError
from gelsim.geometry import TriMesh, enclosed_volume
from gelsim.scene.definition import Body, Gel
from gelsim.scene.limits import MESH_SUFFIXES
from gelsim.shape.orientation import is_reoriented, orientation
from gelsim.units import MESH_UNITS, MM

if TYPE_CHECKING:
    import manifold3d

Array = NDArray[np.float64]
Faces = NDArray[np.int64]
_BYTES = 100_000_000
_FACES = 2_000_000
_SMALLEST = 0.5e-3
"""Of the largest extent of a rigid object, of the least of a soft one [m]: a part in metres said to be in millimetres falls below it."""
_LARGEST = {"rigid": 10.0, "soft": 100e-3}
"""Largest extent [m]: of a soft object everything is meshed, of a rigid one only what lies over the gel counts."""
_SEWN_WITHIN = 1e-6
"""Of the largest extent: how far a vertex may be from an edge that it lies on. STL's numbers are rounded at 6e-8 of theirs."""
_MOST_SEWN = 10_000_000
"""Pairs of edge and vertex that are looked at: where a file asks for more, what is open is closed as a hole, and memory stays bounded."""
_THIN_ABOVE = 20_000
_THIN_TOLERANCE = 5e-6
"""A finer mesh is thinned as long as its surface moves less than this [m]: a quarter of the overlap that a press may show."""
_COMPARED = 100, 500_000
"""Bodies and faces above which it is not asked how bodies lie to each other: it would take more than some seconds."""
_SHARED = 1e-3
"""Share of the volume that bodies may have in common by rounding and still only touch."""
_SCAN = 0.1
"""Share of the surface that may be missing for what fans enclose to tell outside from inside; of more, what walls and lid enclose tells."""
_SHEET = 0.7
"""Share from which on nothing is behind the surface (of half a ball ½ is missing): the side that the gel sees is the outside."""
_LID = 0.5
"""Height of the lid above the highest point over the largest extent."""
_AWAY = 0.5
"""Cosine of the slope up to which what is missing faces away from the gel, or to it."""
HELD_BELOW = 0.1
"""Share of the height of a turned soft object that is cut off, for the platen to hold it."""


@dataclass(frozen=True, eq=False)
class Bodies:
    """How the closed surfaces of a file lie to each other."""

    filled: TriMesh
    """The surface of what is filled."""
    volume: float
    """What is filled [m³]: what several share counts once."""
    faults: tuple[str, ...]
    """Surfaces whose filling can hardly be what is meant, largest first."""
    shared: float
    """What the sum of the bodies' volumes is more [m³]; 0 where they touch at most."""


@dataclass(frozen=True, eq=False)
class Part:
    """What a file holds, as it stands on the gel."""

    surface: TriMesh
    """Closed, outward, lowest point at the origin [m]."""
    done: dict[str, object]
    """What was found, and done to it, for the report."""
    notes: tuple[str, ...]
    """What a user should know of that, in sentences."""


def file_stamp(part: Body | Gel) -> tuple[int, ...]:
    """Changes when the file of object or gel does: a key for caches beside it; () without a file, or where it cannot be read."""
    try:
        found = os.stat(part.mesh or "")
    except OSError:
        return ()
    return found.st_mtime_ns, found.st_size, found.st_ino


def read_part(body: Body) -> Part:
    """The object in the file that shape = "mesh" names.

    Raises:
        SceneError: File missing, too large, no surface, of an extent that suggests another unit, or, of a soft object, not closed.
    """
    plain = Body(  # of an object only this decides it
        shape="mesh", mesh=body.mesh, mesh_unit=body.mesh_unit, mesh_scale=body.mesh_scale, mesh_repair=body.mesh_repair,
        press_side=body.press_side, rotation_deg=body.rotation_deg, rigid=body.rigid,
    )  # fmt: skip
    return _part(plain, file_stamp(body))


def check_file(fields: Mapping[str, Any]) -> None:
    """Reads the file of an object of which these fields are known, so that a plan or a study fails before its first press.

    Raises:
        SceneError: As by `read_part`; of an object that is not known to be soft only what a rigid one is refused for.
    """
    known = {key: fields[key] for key in ("mesh", "mesh_unit", "mesh_scale", "mesh_repair") if type(fields.get(key)) in (str, float, bool)}
    read_part(Body(shape="mesh", rigid=fields.get("rigid", False) is not False, **known))


@lru_cache(maxsize=8)
def _part(body: Body, stamp: tuple[int, ...]) -> Part:
    vertices, faces, done = welded(str(body.mesh), stamp)
    named, kind = f'object.mesh = "{body.mesh}"', "rigid" if body.rigid else "soft"
    done, notes = dict(done), []
    vertices = vertices * (MESH_UNITS[body.mesh_unit] * body.mesh_scale)
    _check_extent(np.ptp(vertices, axis=0), body, named)
    vertices = vertices @ orientation(body).T
    if open_in_file := done["open_edges"]:
        if not body.rigid and not body.mesh_repair:
            holes = len(_Rims(vertices, faces).missing)
            raise SceneError(
                f"{named} is not closed ({open_in_file} open edges, holes: {holes}); allowed for a soft object is a closed "
                "surface; object.mesh_repair = true closes it by fans of triangles, and object.rigid = true presses it as it is"
            )
        faces = _noted(done, "sewn_faces", *_sewn(vertices, faces))
    rims = _Rims(vertices, faces)
    area = 0.5 * np.linalg.norm(_area_vectors(vertices[faces]), axis=1).sum()
    missing = 0.5 * np.linalg.norm(rims.missing, axis=1).sum()
    sheet = body.rigid and missing > _SHEET * area
    if sheet:
        inside_out = rims.missing[:, 2].sum() < 0.0
        notes += [f"{named}: its faces look away from the gel, and nothing is behind them: their back is pressed"] if inside_out else []
    else:
        inside_out = _volume(*rims.closed(body.rigid and missing > _SCAN * area)) < 0.0
    if inside_out:
        faces = faces[:, ::-1]
        rims = _Rims(vertices, faces)
        done["turned_inside_out"] = True
    if open_in_file and not rims.edges:
        notes.append(f"{named} has {open_in_file} open edges, slits without area; closed by splitting {done['sewn_faces']} faces at them")
    if rims.edges:
        done["closed_holes"] = len(rims.missing)
        done["closed_area_mm2"] = round(float(missing) / MM**2, 3)
        how = "fans of triangles" + (", and walls up to a lid where it faces away from the gel" if body.rigid else " (mesh_repair)")
        notes.append(f"{named} has {rims.edges} open edges, holes: {len(rims.missing)}; closed by {how}")
        low = vertices[:, 2].min()
        facing = rims.missing[:, 2] < -_AWAY * np.linalg.norm(rims.missing, axis=1)
        if (facing & (rims.centres[:, 2] < low + 1.0 * MM) & (rims.size > 0.2 * MM)).any():
            notes.append(
                f"{named}: what closes a hole faces the gel within 1 mm of the lowest point; object.press_side turns another side to it"
            )
        vertices, faces = rims.closed(body.rigid)
    volume = _volume(vertices, faces)
    if volume <= 1e-3 * _SMALLEST**3:
        raise SceneError(f"{named} encloses {volume * 1e9:.3g} mm³; allowed for a {kind} object: a surface around a volume")
    if len(faces) > _THIN_ABOVE:
        vertices, faces = _thinned(vertices, faces)
        done["thinned_to_faces"] = len(faces)
    if is_reoriented(body) and not body.rigid:
        vertices, faces = cut_flat(vertices, faces, named)
    lowest = vertices[:, 2].min()
    tip = vertices[vertices[:, 2] <= lowest + 1e-7]
    apex = np.array([*(tip.min(axis=0) + tip.max(axis=0))[:2] / 2, lowest])
    done["apex_mm"] = [round(float(place) / MM, 6) + 0.0 for place in apex]
    vertices = vertices - apex
    surface = TriMesh(vertices, faces.astype(np.int32))
    told = compare_bodies(surface)
    if told and (told.faults or told.shared):
        notes += [f"{named}: {fault}" for fault in told.faults] if body.rigid else []
        more = f"the sum of their volumes is {told.shared / MM**3:.3g} mm³ more"
        notes += [f"{named}: its bodies overlap, they are joined: {more}"] if told.shared else []
        if told.shared and not told.faults:  # a rigid one's distance would be to faces within, too
            surface = told.filled
    return Part(surface, done, tuple(notes))


@lru_cache(maxsize=4)
def welded(path: str, stamp: tuple[int, ...], field: str = "object.mesh") -> tuple[Array, Faces, dict[str, object]]:
    """Vertices in the file's unit, no two at one place, faces alike in orientation where they can be, and what was done.

    `open_edges` of what was done are the file's; slivers are sewn over where it is closed by them alone.

    Raises:
        SceneError: The file that `field` names is missing, too large, or no surface.
    """
    import trimesh

    named = f'{field} = "{path}"'
    allowed = "STL, OBJ, PLY, OFF or GLB file"
    try:
        size = os.stat(path).st_size
        kind = Path(path).suffix.lower().lstrip(".")
        if f".{kind}" not in MESH_SUFFIXES:
            raise SceneError(f"{named} is no {allowed}; allowed: one of these five")
        if size > _BYTES:
            raise SceneError(f"{named} has {size / 1e6:.0f} MB; allowed: up to {_BYTES / 1e6:.0f} MB")
        with open(path, "rb") as file:  # a stream and no resolver: material files that an OBJ names are never opened
            read = trimesh.load_mesh(file, file_type=kind, process=False, skip_materials=True)
        vertices, faces = np.asarray(read.vertices, np.float64), np.asarray(read.faces, np.int64)
    except SceneError:
        raise
    except OSError as error:
        raise SceneError(f"{named} cannot be read ({error.strerror}); allowed: an {allowed}") from None
    except Exception as error:  # trimesh raises many kinds on a damaged file; each of them is the user's file
        raise SceneError(f"{named} cannot be read as {kind.upper()} ({type(error).__name__}); allowed: a triangle surface") from None
    if not len(faces) or not np.isfinite(vertices).all():
        raise SceneError(f"{named} holds {len(faces)} faces and non-finite numbers or none; allowed: a triangle surface")
    if len(faces) > _FACES:
        raise SceneError(f"{named} has {len(faces)} faces; allowed: up to {_FACES}")
    done: dict[str, object] = {"file_faces": len(faces)}
    unit = np.ptp(vertices, axis=0).max() or 1.0
    mesh = trimesh.Trimesh(vertices / unit, faces, process=False)  # trimesh welds within 1e-8
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    mesh.update_faces((mesh.faces != np.roll(mesh.faces, 1, axis=1)).all(axis=1))
    mesh.remove_unreferenced_vertices()
    faces = np.asarray(mesh.faces, np.int64)
    first = faces.argmin(axis=1)
    begun = np.take_along_axis(faces, (first[:, None] + np.arange(3)) % 3, axis=1)
    count = len(mesh.vertices)
    _, once = np.unique((begun[:, 0] * count + begun[:, 1]) * count + begun[:, 2], return_index=True)
    if len(once) < len(faces):  # the same face twice, the same side out
        mesh.update_faces(np.sort(once))
        done["repeated_faces"] = len(faces) - len(once)
    faces = np.asarray(mesh.faces, np.int64)
    _, of_corners, sides = np.unique(np.sort(faces, axis=1), axis=0, return_inverse=True, return_counts=True)
    back_to_back = sides[of_corners.ravel()] > 1
    if back_to_back.any() and not back_to_back.all():
        mesh.update_faces(~back_to_back)
        mesh.remove_unreferenced_vertices()
        done["faces_back_to_back"] = int(back_to_back.sum())
    whole = mesh.nondegenerate_faces()
    if not whole.any():
        raise SceneError(f"{named} holds {done['file_faces']} faces, none of which has an area; allowed: a triangle surface")
    if not _alike(np.asarray(mesh.faces, np.int64), len(mesh.vertices)):
        trimesh.repair.fix_winding(mesh)
        done["reoriented"] = True
    vertices, faces = np.asarray(mesh.vertices) * unit, np.asarray(mesh.faces, np.int64)
    done["open_edges"] = open_edges(vertices, faces)
    if not whole.all():
        faces = faces[whole]
        faces = faces if done["open_edges"] else _noted(done, "sewn_faces", *_sewn(vertices, faces))
    return vertices, faces, done


def _noted(done: dict[str, object], what: str, faces: Faces, count: int) -> Faces:
    """Faces, of which `count` were treated, as `what` in what was done."""
    if count:
        done[what] = count
    return faces


def _check_extent(extent: Array, body: Body, named: str) -> None:
    def fits(size: Array) -> bool:
        least = size.max() if body.rigid else size.min()
        return bool(least >= _SMALLEST and size.max() <= _LARGEST["rigid" if body.rigid else "soft"])

    if fits(extent):
        return
    given = MESH_UNITS[body.mesh_unit]
    other = next((unit for unit, metres in MESH_UNITS.items() if fits(extent / given * metres)), None)
    text = " x ".join(f"{e / MM:.4g}" for e in extent)
    allowed = "0.5 mm to 10 m across for a rigid object" if body.rigid else "0.5 to 100 mm in each direction for a soft object"
    hint = f'; with object.mesh_unit = "{other}" it would fit' if other else "" if body.rigid else "; rigid = true allows more"
    scale = f" times {body.mesh_scale:g}" if body.mesh_scale != 1.0 else ""
    raise SceneError(f"{named} is {text} mm when read in {body.mesh_unit}{scale}; allowed: {allowed}{hint}")


def _directed(faces: Faces, count: int) -> tuple[Faces, Faces, NDArray[np.int64]]:
    """Edges (E, 2) of faces, ascending, how many faces each has, and how much more often it is passed that way than back."""
    pairs = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    ways = np.where(pairs[:, 0] < pairs[:, 1], 1, -1)
    keys, index, uses = np.unique(pairs.min(axis=1) * count + pairs.max(axis=1), return_inverse=True, return_counts=True)
    net = np.bincount(index.ravel(), weights=ways, minlength=len(keys)).astype(np.int64)
    return np.stack(np.divmod(keys, count), axis=1), uses, net


def _alike(faces: Faces, count: int) -> bool:
    """Whether faces that share an edge by two have the same side out."""
    _, uses, net = _directed(faces, count)
    return not ((uses == 2) & (net != 0)).any()


def _area_vectors(corners: Array) -> Array:
    """Twice the vector area of each triangle (F, 3, 3)."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _volume(vertices: Array, faces: Faces) -> float:
    return enclosed_volume(TriMesh(vertices, faces.astype(np.int32)))


def open_edges(vertices: Array, faces: Faces) -> int:
    """Edges that are passed more often one way than the other."""
    return _Rims(vertices, faces).edges


def _sewn(vertices: Array, faces: Faces) -> tuple[Faces, int]:
    """Faces split where a vertex of the rim lies on their open edge, and how many were."""
    from scipy.spatial import KDTree

    split_faces = 0
    within = _SEWN_WITHIN * np.ptp(vertices, axis=0).max()
    for _ in range(3):  # a face has no more edges, and each is split at all places at once
        edges, _, net = _directed(faces, len(vertices))
        rim = edges[net != 0]
        if not len(rim):
            break
        corners = np.unique(rim)
        begin, along = vertices[rim[:, 0]], np.diff(vertices[rim], axis=1)[:, 0]
        length = np.linalg.norm(along, axis=1)
        places_of, reach = KDTree(vertices[corners]), (begin + along / 2, length / 2 + within)
        if places_of.query_ball_point(*reach, return_length=True).sum() > _MOST_SEWN:
            break
        near = places_of.query_ball_point(*reach)
        edge, corner = np.repeat(np.arange(len(rim)), [len(one) for one in near]), corners[np.concatenate(near).astype(np.int64)]
        away = vertices[corner] - begin[edge]
        share = (away * along[edge]).sum(axis=1) / np.maximum(length[edge], 1e-300) ** 2
        apart = np.linalg.norm(away - share[:, None] * along[edge], axis=1)
        on_it = (apart <= within) & (corner != rim[edge, 0]) & (corner != rim[edge, 1]) & (share > 0.0) & (share < 1.0)
        order = np.lexsort((share[on_it], edge[on_it]))
        places: dict[tuple[int, int], list[int]] = {}
        for number, place in zip(edge[on_it][order].tolist(), corner[on_it][order].tolist(), strict=True):
            places.setdefault((int(rim[number, 0]), int(rim[number, 1])), []).append(place)
        if not places:
            break
        kept, made = np.ones(len(faces), bool), []
        touched = np.flatnonzero(np.isin(faces, np.array(list(places))).sum(axis=1) >= 2)
        for number, face in zip(touched.tolist(), faces[touched].tolist(), strict=True):
            for first in range(3):
                a, b, c = (face[(first + step) % 3] for step in range(3))
                if inner := places.get((min(a, b), max(a, b))):
                    line = [a, *(inner if a < b else inner[::-1]), b]
                    made += [[one, two, c] for one, two in zip(line, line[1:], strict=False) if c not in (one, two)]
                    kept[number] = False
                    break
        if not made:
            break
        split_faces += int((~kept).sum())
        faces = np.vstack([faces[kept], made])
    return faces, split_faces


class _Rims:
    """Open edges, by holes: what hangs together."""

    def __init__(self, vertices: Array, faces: Faces) -> None:
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        self.vertices, self.faces = vertices, faces
        edges, _, net = _directed(faces, len(vertices))
        self.edges = int((net != 0).sum())
        times = np.abs(net)
        back = np.where(net[:, None] > 0, edges[:, ::-1], edges)  # as faces that close it have to pass them
        self.rim = np.repeat(back, times, axis=0)
        used, local = np.unique(self.rim, return_inverse=True)
        local = local.reshape(-1, 2)
        links = coo_array((np.ones(len(local)), (local[:, 0], local[:, 1])), (len(used), len(used)))
        holes, of_vertex = connected_components(links, directed=False) if len(used) else (0, np.zeros(0, np.int64))
        self.hole = of_vertex[local[:, 0]] if len(local) else np.zeros(0, np.int64)
        ends = vertices[self.rim]
        length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)

        def summed(values: Array) -> Array:
            return np.stack([np.bincount(self.hole, column, holes) for column in values.T], axis=1).astype(np.float64)

        self.size = np.bincount(self.hole, weights=length, minlength=holes) / np.pi
        """Diameter of each hole as if it were round [m], (H,)."""
        self.centres = summed(ends.mean(axis=1) * length[:, None]) / (np.pi * self.size)[:, None]
        self.missing = summed(np.cross(ends[:, 0] - self.centres[self.hole], ends[:, 1] - self.centres[self.hole]))
        """Twice the vector area of what closes each hole, (H, 3)."""

    def closed(self, away: bool) -> tuple[Array, Faces]:
        """Vertices and faces of the surface with every hole closed; `away`: by walls and a lid where what is missing faces up."""
        up = self.missing[:, 2] > _AWAY * np.linalg.norm(self.missing, axis=1) if away else np.zeros(len(self.missing), bool)
        lifted = up[self.hole]
        centres = self.centres.copy()
        top = self.vertices[:, 2].max() + _LID * np.ptp(self.vertices, axis=0).max()
        centres[up, 2] = top
        count = len(self.vertices)
        fans = np.column_stack([self.rim[~lifted], count + self.hole[~lifted]])
        below = self.rim[lifted]
        used, local = np.unique(below, return_inverse=True)
        above = count + len(centres) + local.reshape(-1, 2)
        walls = [np.column_stack([below, above[:, 1]]), np.column_stack([below[:, 0], above[:, ::-1]])]
        lids = np.column_stack([above, count + self.hole[lifted]])
        raised = self.vertices[used]
        raised[:, 2] = top
        return np.vstack([self.vertices, centres, raised]), np.vstack([self.faces, fans, *walls, lids])


def bodies_of(surface: TriMesh) -> list[NDArray[np.int64]]:
    """Faces of each body: what hangs together by edges of two faces."""
    from trimesh import graph

    return [np.asarray(body) for body in graph.connected_components(graph.face_adjacency(surface.faces), min_len=4)]


@lru_cache(maxsize=8)
def compare_bodies(surface: TriMesh) -> Bodies | None:
    """How the bodies of a watertight, outward surface lie to each other.

    None of a single one, of more bodies or faces than are compared, and where manifold3d takes a body for no manifold.
    """
    import manifold3d

    if len(surface.faces) > _COMPARED[1]:
        return None
    shells = bodies_of(surface)
    if not 1 < len(shells) <= _COMPARED[0]:
        return None
    parts = []
    for shell in shells:
        used, faces = np.unique(surface.faces[shell], return_inverse=True)
        parts.append(TriMesh(surface.vertices[used], faces.reshape(-1, 3).astype(np.int32)))
    parts.sort(key=lambda part: -abs(enclosed_volume(part)))
    outward = [enclosed_volume(part) > 0 for part in parts]
    solids = [_manifold(part.vertices, part.faces if out else part.faces[:, ::-1]) for part, out in zip(parts, outward, strict=True)]
    if any(solid.status() != manifold3d.Error.NoError for solid in solids):
        return None
    lower, upper = (np.array([end(part.vertices, axis=0) for part in parts]) for end in (np.min, np.max))

    def lies_in(i: int, j: int) -> bool:
        within = (lower[i] > lower[j]).all() and (upper[i] < upper[j]).all()  # what ends flush with another is no cavity
        return bool(within) and (solids[i] - solids[j]).volume() < 1e-6 * solids[i].volume()

    around = [[j for j in range(i) if lies_in(i, j)] for i in range(len(parts))]
    faults, whole = [], []
    for i, part in enumerate(parts):
        name = f"a body of {' x '.join(f'{e:.3g}' for e in np.ptp(part.vertices, axis=0) / MM)} mm"
        material = sum(1 if outward[j] else -1 for j in around[i])  # how often the others wind around it: 1 in a body, 0 in its cavity
        if outward[i] and material > 0:
            faults.append(f"{name} lies in another and its faces point outward, so it is filled; flip them for a cavity, or leave it out")
        elif outward[i]:
            cavities = [solids[j] for j in range(i + 1, len(parts)) if not outward[j] and i in around[j]]
            whole.append(manifold3d.Manifold.batch_boolean([solids[i], *cavities], manifold3d.OpType.Subtract))
        elif material < 1:
            faults.append(f"{name} is inside out and no cavity of another, so it is left out; flip its faces")
    filled = manifold3d.Manifold.batch_boolean(whole, manifold3d.OpType.Add)
    volume, mesh = filled.volume(), filled.to_mesh64()
    shared = sum(solid.volume() for solid in whole) - volume
    outside = TriMesh(np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts).astype(np.int32))
    return Bodies(outside, volume, tuple(faults), shared if shared > _SHARED * volume else 0.0)


def _manifold(vertices: Array, faces: Faces) -> manifold3d.Manifold:
    """A surface as manifold3d has it, which takes arrays that may be written, in the order of C: its own may not."""
    import manifold3d

    return manifold3d.Manifold(manifold3d.Mesh64(np.array(vertices, order="C"), np.array(faces, np.uint64, order="C")))


def cut_flat(vertices: Array, faces: Faces, named: str) -> tuple[Array, Faces]:
    """Without what lies above the plane at which the platen holds it."""
    import manifold3d

    solid3 = _manifold(vertices, faces)
    if solid3.status() != manifold3d.Error.NoError:
        raise SceneError(
            f"{named} cannot be cut where a turned soft object is held ({solid3.status().name}); give rigid = true, or no turn"
        )
    low, high = vertices[:, 2].min(), vertices[:, 2].max()
    kept = solid3.trim_by_plane((0.0, 0.0, -1.0), -(high - HELD_BELOW * (high - low))).to_mesh64()
    return np.asarray(kept.vert_properties)[:, :3], np.asarray(kept.tri_verts).astype(np.int64)


def _thinned(vertices: Array, faces: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """The same surface within `_TOLERANCE` with fewer faces; as it was where manifold3d takes it for no manifold."""
    import manifold3d

    solid3 = _manifold(vertices, faces)
    if solid3.status() != manifold3d.Error.NoError:
        return vertices, faces
    thin = solid3.simplify(_THIN_TOLERANCE).to_mesh64()
    return np.asarray(thin.vert_properties)[:, :3], np.asarray(thin.tri_verts).astype(np.int64)
