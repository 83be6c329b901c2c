"""A sensor from its no-contact photograph alone: the preset that is nearest to it, with that photograph as its rest.

Gel, lamps, coat and camera stay the preset's, so what a press looks like is the preset's too; at rest it is the photograph. Its lamps are
made as bright as the photograph is: white balance and exposure change by as much as the preset's own rest would have to, to have the
photograph's mean in every colour. Left out: what the photograph says of where light comes from, which no rest tells
(docs/decisions/0005-rest-measured.md).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gelsim import optics
from gelsim.calibrate import dots
from gelsim.calibrate.photos import Photos
from gelsim.calibrate.preset import write_preset
from gelsim.data.metrics import picture_errors
from gelsim.errors import SceneError
from gelsim.membrane.surface import rest_membrane
from gelsim.optics.rest import even_part, rest_name, save_levels, untoned
from gelsim.pipeline import outputs
from gelsim.scene.definition import Scene
from gelsim.scene.layers import build_scene, is_preset

WIDTH, SPP = 96, 64
"""Of the picture whose mean is compared."""


def at_rest(photos: Photos, folder: outputs.ResultFolder, out: Path, sensor: str | None, device: str) -> dict[str, Any]:
    """Writes preset, rest and report of a folder without presses, and returns the report."""
    if sensor is None or not is_preset(sensor):
        raise SceneError(
            f"--sensor {sensor}: a no-contact photograph alone needs a preset to start from, the one nearest to your sensor; with "
            "photographs of presses a sensor is found without one"
        )
    preset = build_scene({"sensor": {"preset": sensor}, "markers": {"layout": "none"}})
    scene, warnings = _sized(_as_bright(preset, photos, device), photos), []
    if photos.markers:
        scene = dots.with_grid(scene, photos.no_contact, warnings)
    report: dict[str, Any] = {"parameters": {}, "presses": [], "warnings": warnings, "out": str(out), "sensor": sensor}
    folder.write(rest_name(out), lambda path: save_levels(photos.no_contact, path))
    shown = _picture(scene.replace(camera=replace(scene.camera, rest=str(out.parent / rest_name(out)))), device)
    errors = picture_errors(shown, photos.no_contact, photos.counted)
    report["scores"] = {"no_contact": {"count": 1, "whole": errors, "crop": errors}}
    report["choices"] = {"start": sensor, "exposure": scene.camera.exposure, "white_balance": scene.camera.white_balance}
    report["choices"] |= photos.lens_choice
    plain = outputs.plain_json(report)
    assert isinstance(plain, dict)
    folder.write("report.json", lambda path: outputs.write_report(path, plain))
    written = scene.replace(camera=replace(scene.camera, rest=rest_name(out)))
    head = [f"{out.stem}: the preset {sensor} with the no-contact photograph of another sensor, by `gelsim calibrate`."]
    folder.write(out.name, lambda path: write_preset(path, written, head))
    return plain


def _sized(scene: Scene, photos: Photos) -> Scene:
    """With the photographs' pixels and scale, and the gel that was given."""
    wide, high = photos.size
    per_px = photos.mm_per_px or scene.camera.field_mm[0] / wide
    camera = replace(
        scene.camera,
        resolution=photos.size,
        field_mm=(per_px * wide, per_px * high),
        rest=None,
        rest_smooth=(),
        shading=(),
        noise_sd=(0.0, 0.0, 0.0),
    )
    return scene.replace(gel=photos.gel or scene.gel, camera=camera, render=replace(scene.render, resolution=photos.size))


def _as_bright(scene: Scene, photos: Photos, device: str) -> Scene:
    wide, high = scene.camera.resolution
    small = scene.replace(render=replace(scene.render, resolution=(WIDTH, max(round(WIDTH * high / wide), 1)), spp=SPP))
    wanted, drawn = (untoned(scene, even_part(levels)).mean(axis=(0, 1)) for levels in (photos.no_contact, _picture(small, device)))
    gain = np.array(scene.camera.white_balance) * wanted / np.maximum(drawn, 1e-3)
    balance = tuple(float(part) for part in gain / gain.max())
    return scene.replace(camera=replace(scene.camera, exposure=scene.camera.exposure * float(gain.max()), white_balance=balance))


def _picture(scene: Scene, device: str) -> np.ndarray:
    return next(iter(optics.render_frames(scene, [rest_membrane(scene)], device=device))).image.astype(float)
