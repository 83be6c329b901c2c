"""What a result folder, a dataset, a press.npz or a mesh file holds: in numbers, and as a drawing."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gelsim.data.episodes import load_dataset
from gelsim.errors import SceneError
from gelsim.geometry import FACE_EDGES, edges_of, enclosed_volume
from gelsim.pipeline.outputs import plain_json, read_press
from gelsim.results import Deformation
from gelsim.scene.definition import Body, Scene
from gelsim.scene.layers import build_scene, load_scene
from gelsim.scene.limits import MESH_SUFFIXES
from gelsim.shape.mesh_file import bodies_of, compare_bodies, read_part
from gelsim.units import KPA, MM

STANDING = ("mesh_unit", "mesh_scale", "press_side", "rotation_deg")
"""Fields of an object that say how the part in a mesh file stands."""


def inspect(path: Path, **standing: Any) -> dict[str, Any]:
    """The facts about a path, as plain values.

    Args:
        path: A result folder, a dataset, a press.npz, or an STL, OBJ, PLY, OFF or GLB file.
        standing: Of a mesh file: STANDING, as in a scene.
    Raises:
        SceneError: It does not exist, is none of these, or does not stand so.
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
        facts = {"kind": "mesh file"} | _mesh_facts(_part_of(path, standing))
    elif not path.exists():
        raise SceneError(f"{path}: there is no such file or folder")
    else:
        hint = "; a sensor file goes with --sensor" if path.suffix == ".toml" else ""
        raise SceneError(f"{path}: is none of what inspect reads: a result folder, a press.npz, an STL, OBJ, PLY, OFF or GLB file{hint}")
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


def draw(path: Path, out: Path, **standing: Any) -> None:
    """Draws what lies at the path into a PNG file; a mesh file from the gel's side too, with where it touches.

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
        surface = read_part(_part_of(path, standing)).surface
        sheet.draw_surface(out, surface.vertices, surface.faces.astype(np.int64), path.name)
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
        "time_s": press.time,
        "approach_mm": press.approach / MM,
        "normal_force_n": np.abs(press.force[:, 2]),
        "contact_area_mm2": press.contact_area / MM**2,
        "peak_pressure_kpa": press.contact_pressure.max() / KPA,
        "gel_surface": f"{len(press.gel.rest)} nodes, {len(press.gel.faces6)} six-node faces",
        "object_surface": f"{len(press.object.rest)} nodes, {len(press.object.faces6)} six-node faces",
        **({"smallest_jacobian": least} if np.isfinite(least := press.min_jacobian.min()) else {}),
        "largest_penetration_mm": press.penetration.max() / MM,
        "newton_iterations": press.newton_iterations,
    }


def _part_of(path: Path, standing: dict[str, Any]) -> Body:
    """The part in a mesh file as a rigid object."""
    return build_scene({"object": {"shape": "mesh", "mesh": str(path), "rigid": True} | standing}).object


def _mesh_facts(rigid: Body) -> dict[str, Any]:
    """What a press would make of a file: as it is read for a rigid object, and whether a soft one can be made of it."""
    part = read_part(rigid)
    surface = part.surface
    try:
        read_part(replace(rigid, rigid=False, shore_00=30.0))
        soft = "ok"
    except SceneError as error:
        soft = str(error)
    told = compare_bodies(surface)
    if told and told.faults and soft == "ok":  # as gelsim.mesh refuses it
        soft = f"no: {told.faults[0]}"
    edges, _ = edges_of(surface.faces, FACE_EDGES)
    lengths = np.linalg.norm(np.diff(surface.vertices[edges], axis=1)[:, 0], axis=1)
    return {
        "unit": rigid.mesh_unit,
        "vertices": len(surface.vertices),
        "triangles": part.done["file_faces"],
        "size_mm": np.ptp(surface.vertices, axis=0) / MM,
        "lowest_point_mm": part.done["apex_mm"],
        "watertight": not part.done["open_edges"],
        "open_edges": part.done["open_edges"],
        "outward": not {"turned_inside_out", "reoriented"} & set(part.done),
        "rigid": "ok",
        "soft": soft,
        "volume_mm3": (told.volume if told else enclosed_volume(surface)) / MM**3,
        "bodies": len(bodies_of(surface)),
        **({"notes": part.notes} if part.notes else {}),
        "edge_lengths_mm": np.percentile(lengths, [0, 50, 100]) / MM,
    }


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return ", ".join(_short(item) for item in value) or "none"
    if isinstance(value, dict):
        return "(" + ", ".join(f"{name} {_short(item)}" for name, item in value.items()) + ")"
    return str(value)
