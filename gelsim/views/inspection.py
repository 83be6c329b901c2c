"""What a result folder, a dataset, a press.npz or a mesh file holds: in numbers, and as a drawing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from gelsim.data.episodes import load_dataset
from gelsim.errors import SceneError
from gelsim.geometry import TriMesh
from gelsim.pipeline.outputs import plain_json, read_press
from gelsim.results import Deformation
from gelsim.scene.definition import Scene
from gelsim.scene.layers import load_scene
from gelsim.shape.mesh_file import compare_bodies
from gelsim.units import KPA, MESH_UNITS, MM

MESH_SUFFIXES = (".stl", ".obj", ".ply")


def inspect(path: Path, mesh_unit: str = "mm") -> dict[str, Any]:
    """The facts about a path, as plain values.

    Args:
        path: A result folder, a dataset, a press.npz, or an STL, OBJ or PLY file.
        mesh_unit: What a mesh file's numbers are in.
    Raises:
        SceneError: It does not exist, or is none of these.
    """
    if _is_dataset(path):
        from gelsim.views.dataset_sheet import dataset_facts

        facts = {"kind": "dataset"} | dataset_facts(load_dataset(path))
    elif path.is_dir():
        if not (path / "press.npz").exists():
            raise SceneError(f"{path}: holds no press.npz, and no meta/info.json: it is neither a result of gelsim nor a dataset")
        facts = _press_facts(read_press(path / "press.npz"))
        facts = {"kind": "result folder", "files": sorted(item.name for item in path.iterdir())} | facts
        if (path / "report.json").exists():
            report = json.loads((path / "report.json").read_text(encoding="utf-8"))
            facts |= {key: report.get(key) for key in ("status", "meshes", "seconds", "warnings")}
    elif path.suffix == ".npz":
        facts = {"kind": "press"} | _press_facts(read_press(path))
    elif path.suffix.lower() in MESH_SUFFIXES:
        facts = {"kind": "mesh file"} | _mesh_facts(path, mesh_unit)
    elif not path.exists():
        raise SceneError(f"{path}: there is no such file or folder")
    else:
        hint = "; a sensor file goes with --sensor" if path.suffix == ".toml" else ""
        raise SceneError(f"{path}: is none of what inspect reads: a result folder, a press.npz, an STL, OBJ or PLY file{hint}")
    plain = plain_json({"path": str(path)} | facts)
    assert isinstance(plain, dict)
    return plain


def inspect_sensor(scene: Scene) -> dict[str, Any]:
    """The facts about a scene's sensor, as plain values."""
    from gelsim.views import sensor_sheet

    return {"kind": "sensor", "preset": scene.sensor.preset} | sensor_sheet.sensor_facts(scene)


def draw_sensor(scene: Scene, out: Path) -> None:
    """Draws layout and no-contact frame of a scene's sensor into a PNG file.

    Raises:
        RenderError: This machine cannot render.
    """
    from gelsim.views import sensor_sheet

    sensor_sheet.draw_sensor(out, scene)


def describe(facts: dict[str, Any]) -> str:
    """The facts as aligned lines for people."""
    lines = []
    for key, value in facts.items():
        if isinstance(value, dict):
            value = ", ".join(f"{name} {_short(item)}" for name, item in value.items())
        lines.append(f"{key.replace('_', ' '):<22} {_short(value)}")
    return "\n".join(lines)


def draw(path: Path, out: Path, mesh_unit: str = "mm") -> None:
    """Draws what lies at the path into a PNG file.

    Raises:
        SceneError: As for `inspect`.
    """
    from gelsim.pipeline import sheet

    out.parent.mkdir(parents=True, exist_ok=True)
    if _is_dataset(path):
        from gelsim.views.dataset_sheet import draw_dataset

        draw_dataset(out, load_dataset(path))
        return
    if path.suffix.lower() in MESH_SUFFIXES:
        mesh = _load_mesh(path)
        sheet.draw_surface(out, np.asarray(mesh.vertices) * MESH_UNITS[mesh_unit], np.asarray(mesh.faces), path.name)
        return
    folder = path if path.is_dir() else path.parent
    scene = load_scene(folder / "scene.toml") if (folder / "scene.toml").exists() else Scene()
    sheet.draw_mechanics(out, scene, read_press(folder / "press.npz" if path.is_dir() else path))


def export(path: Path, html: str | None = None, series: str | None = None) -> dict[str, str]:
    """Writes the press at a path as a page, and as a series of surfaces; returns where.

    Raises:
        SceneError: There is no press.
    """
    from gelsim.views import press_page

    folder = path if path.is_dir() else path.parent
    file = path / "press.npz" if path.is_dir() else path
    if file.suffix != ".npz" or not file.is_file():
        raise SceneError(f"{path}: --html and --vtu show a press: a result folder or a press.npz")
    press, written = read_press(file), {}
    if html:
        press_page.write_page(Path(html), press, sorted((folder / "frames").glob("*.png")), folder.name)
        written["page"] = html
    if series:
        press_page.write_series(Path(series), press)
        written["series"] = str(Path(series) / "press.pvd")
    return written


def _is_dataset(path: Path) -> bool:
    return (path / "meta" / "info.json").is_file()


def _press_facts(press: Deformation) -> dict[str, Any]:
    return {
        "status": press.status.value,
        "states": len(press.approach),
        "approach_mm": press.approach / MM,
        "normal_force_n": np.abs(press.force[:, 2]),
        "contact_area_mm2": press.contact_area / MM**2,
        "peak_pressure_kpa": press.contact_pressure.max() / KPA,
        "gel_surface": f"{len(press.gel.rest)} nodes, {len(press.gel.faces6)} six-node faces",
        "object_surface": f"{len(press.object.rest)} nodes, {len(press.object.faces6)} six-node faces",
        "smallest_jacobian": press.min_jacobian.min(),
        "largest_penetration_mm": press.penetration.max() / MM,
        "newton_iterations": press.newton_iterations,
    }


def _load_mesh(path: Path) -> Any:
    import trimesh

    try:
        return trimesh.load_mesh(str(path))
    except Exception as error:  # the readers of trimesh raise whatever they stumble on
        raise SceneError(f"{path}: cannot be read as a mesh ({error})") from None


def _mesh_facts(path: Path, unit: str) -> dict[str, Any]:
    mesh = _load_mesh(path)
    if not len(getattr(mesh, "faces", ())):
        raise SceneError(f"{path}: holds no triangles")
    scale = MESH_UNITS[unit] / MM
    edges, uses = np.unique(np.sort(np.asarray(mesh.edges), axis=1), axis=0, return_counts=True)
    outward = bool(mesh.is_winding_consistent and mesh.volume > 0)
    told = compare_bodies(TriMesh(mesh.vertices * scale * MM, mesh.faces)) if mesh.is_watertight and outward else None
    notes = list(told.faults) if told else []
    if told and told.shared:
        notes.append(f"bodies overlap, they are joined: the sum of their volumes is {told.shared / MM**3:.3g} mm³ more")
    return {
        "unit": unit,
        "vertices": len(mesh.vertices),
        "triangles": len(mesh.faces),
        "size_mm": np.asarray(mesh.extents) * scale,
        "lowest_point_mm": np.asarray(mesh.vertices)[np.argmin(mesh.vertices[:, 2])] * scale,
        "watertight": bool(mesh.is_watertight),
        "open_edges": int((uses == 1).sum()),
        "outward": outward,
        "volume_mm3": told.volume / MM**3 if told else float(mesh.volume) * scale**3,
        "bodies": int(mesh.body_count),
        **({"notes": notes} if notes else {}),
        "edge_lengths_mm": np.percentile(np.asarray(mesh.edges_unique_length), [0, 50, 100]) * scale,
    }


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return ", ".join(_short(item) for item in value) or "none"
    if isinstance(value, dict):
        return "(" + ", ".join(f"{name} {_short(item)}" for name, item in value.items()) + ")"
    return str(value)
