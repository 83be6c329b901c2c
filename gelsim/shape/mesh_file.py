"""Objects from files: reads a watertight STL, OBJ or PLY, checks it, and puts its lowest point at the origin.

Only geometry is read: no material, texture or other file that the mesh names is opened, and nothing in it is run.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import SceneError
from gelsim.geometry import TriMesh, enclosed_volume
from gelsim.units import MESH_UNITS, MM

Array = NDArray[np.float64]
_BYTES = 100_000_000
_FACES = 2_000_000
_EXTENT = (0.5e-3, 100e-3)
"""Smallest and largest extent [m]: a part in metres said to be in millimetres falls below it."""
_THIN_ABOVE = 20_000
_THIN_TOLERANCE = 5e-6
"""A finer mesh is thinned as long as its surface moves less than this [m]: a quarter of the overlap that a press may show."""
_COMPARED = 100, 500_000
"""Bodies and faces above which it is not asked how bodies lie to each other: it would take more than some seconds."""
_SHARED = 1e-3
"""Share of the volume that bodies may have in common by rounding and still only touch."""


@dataclass(frozen=True)
class Bodies:
    """How the closed surfaces of a file lie to each other."""

    volume: float
    """What is filled [m³]: what several share counts once."""
    faults: tuple[str, ...]
    """Surfaces whose filling can hardly be what is meant, largest first."""
    shared: float
    """What the sum of the bodies' volumes is more [m³]; 0 where they touch at most."""


@lru_cache(maxsize=8)
def read_surface(path: str, unit: str) -> tuple[TriMesh, dict[str, object]]:
    """The watertight surface in a file, outward, lowest point at the origin, and what was done to it.

    The file is read once a process; call it with the same path again after a change and the old surface comes back.

    Args:
        unit: "mm", "cm", "m" or "in", of the file's numbers.
    Raises:
        SceneError: File missing, too large, no surface, not watertight, or of an extent that suggests another unit.
    """
    import trimesh

    try:
        size = Path(path).stat().st_size
    except OSError as error:
        raise SceneError(f'object.mesh = "{path}" cannot be read ({error.strerror}); allowed: a watertight STL, OBJ or PLY file') from None
    kind = Path(path).suffix.lower().lstrip(".")
    if kind not in ("stl", "obj", "ply"):
        raise SceneError(f'object.mesh = "{path}" is no STL, OBJ or PLY file; allowed: one of these three')
    if unit not in MESH_UNITS:
        raise SceneError(f'object.mesh_unit = "{unit}" is unknown; allowed: {", ".join(MESH_UNITS)}')
    if size > _BYTES:
        raise SceneError(f'object.mesh = "{path}" has {size / 1e6:.0f} MB; allowed: up to {_BYTES / 1e6:.0f} MB')
    try:
        with open(path, "rb") as file:  # a stream and no resolver: material files that an OBJ names are never opened
            read = trimesh.load_mesh(file, file_type=kind, process=False, skip_materials=True)
        vertices, faces = np.asarray(read.vertices, np.float64), np.asarray(read.faces, np.int64)
    except Exception as error:  # trimesh raises many kinds on a damaged file; each of them is the user's file
        what = f"cannot be read as {kind.upper()} ({type(error).__name__})"
        raise SceneError(f'object.mesh = "{path}" {what}; allowed: a triangle surface') from None
    if not len(faces) or not np.isfinite(vertices).all():
        raise SceneError(f'object.mesh = "{path}" holds {len(faces)} faces and non-finite numbers or none; allowed: a triangle surface')
    if len(faces) > _FACES:
        raise SceneError(f'object.mesh = "{path}" has {len(faces)} faces; allowed: up to {_FACES}')
    mesh = trimesh.Trimesh(vertices * MESH_UNITS[unit], faces, process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    mesh.update_faces(mesh.nondegenerate_faces())
    mesh.remove_unreferenced_vertices()
    extent = mesh.extents if len(mesh.faces) else np.zeros(3)
    if extent.min() < _EXTENT[0] or extent.max() > _EXTENT[1]:
        fits = [u for u, m in MESH_UNITS.items() if (e := extent / MESH_UNITS[unit] * m).min() >= _EXTENT[0] and e.max() <= _EXTENT[1]]
        hint = f'; with object.mesh_unit = "{fits[0]}" it would fit' if fits else ""
        text = " x ".join(f"{1e3 * e:.4g}" for e in extent)
        raise SceneError(f'object.mesh = "{path}" is {text} mm when read in {unit}; allowed: 0.5 to 100 mm in each direction{hint}')
    if not mesh.is_watertight:
        lone = len(mesh.edges_unique) - len(mesh.face_adjacency)
        raise SceneError(f'object.mesh = "{path}" is not watertight ({lone} open edges); allowed: a closed surface')
    done: dict[str, object] = {"file_faces": len(faces)}
    if not mesh.is_winding_consistent:
        mesh.fix_normals()
        done["reoriented"] = True
    if mesh.volume < 0:
        mesh.invert()
        done["turned_inside_out"] = True
    if not mesh.is_winding_consistent or mesh.volume <= 1e-3 * _EXTENT[0] ** 3:
        raise SceneError(f'object.mesh = "{path}" encloses {mesh.volume * 1e9:.3g} mm³; allowed: a closed surface that encloses a volume')
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if len(faces) > _THIN_ABOVE:
        vertices, faces = _thinned(vertices, faces)
        done["thinned_to_faces"] = len(faces)
    lowest = vertices[:, 2].min()
    tip = vertices[vertices[:, 2] <= lowest + 1e-7]
    vertices = vertices - np.array([*(tip.min(axis=0) + tip.max(axis=0))[:2] / 2, lowest])
    return TriMesh(vertices, faces.astype(np.int32)), done


@lru_cache(maxsize=8)
def compare_bodies(surface: TriMesh) -> Bodies | None:
    """How the bodies of a watertight, outward surface lie to each other.

    None of a single one, of more bodies or faces than are compared, and where manifold3d takes a body for no manifold.
    """
    import manifold3d
    from trimesh import graph

    if len(surface.faces) > _COMPARED[1]:
        return None
    shells = graph.connected_components(graph.face_adjacency(surface.faces), min_len=4)
    if not 1 < len(shells) <= _COMPARED[0]:
        return None
    parts = []
    for shell in shells:
        used, faces = np.unique(surface.faces[shell], return_inverse=True)
        parts.append(TriMesh(surface.vertices[used], faces.reshape(-1, 3).astype(np.int32)))
    parts.sort(key=lambda part: -abs(enclosed_volume(part)))
    outward = [enclosed_volume(part) > 0 for part in parts]
    solids = [
        manifold3d.Manifold(manifold3d.Mesh64(part.vertices, (part.faces if out else part.faces[:, ::-1]).astype(np.uint64)))
        for part, out in zip(parts, outward, strict=True)
    ]
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
    filled = manifold3d.Manifold.batch_boolean(whole, manifold3d.OpType.Add).volume()
    shared = sum(solid.volume() for solid in whole) - filled
    return Bodies(filled, tuple(faults), shared if shared > _SHARED * filled else 0.0)


def _thinned(vertices: Array, faces: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """The same surface within `_TOLERANCE` with fewer faces; as it was where manifold3d takes it for no manifold."""
    import manifold3d

    solid3 = manifold3d.Manifold(manifold3d.Mesh64(vertices, faces.astype(np.uint64)))
    if solid3.status() != manifold3d.Error.NoError:
        return vertices, faces
    thin = solid3.simplify(_THIN_TOLERANCE).to_mesh64()
    return np.asarray(thin.vert_properties)[:, :3], np.asarray(thin.tri_verts).astype(np.int64)
