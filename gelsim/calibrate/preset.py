"""A fitted sensor as a preset file, like those of assets/sensors/, with what was found and how well beside it."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gelsim.scene.definition import Scene
from gelsim.scene.layers import PRESET_SECTIONS

DIGITS = 6


def fitted_head(report: Mapping[str, Any], name: str) -> list[str]:
    """What stands above a sensor that was fitted."""
    fit, parts = report["fit"], report["parameters"]
    given = [
        f"{key} {entry['value']:.4g} ± {entry['sd']:.2g}"
        for key, entry in parts.items()
        if entry["state"] == "determined" and "shading" not in key
    ]
    count = sum(row["split"] == "train" for row in report["presses"])
    return [
        f"{name}: fitted by `gelsim calibrate` to {count} photographs of a pressed ball;",
        f"what is left between them and the fit is {fit['rms_levels']:.1f} levels of 255 (root mean square).",
        "Albedo, flake reflectance, white balance and exposure are conventions: no photograph tells them from the lights' powers.",
        "Determined by the photographs (value ± standard deviation):",
        *(f"  {text}" for text in given),
    ]


def write_preset(path: Path, scene: Scene, head: Sequence[str]) -> None:
    """Writes the preset as TOML; numbers with six digits, `head` as comments above them."""
    lines = [f"# {text}" for text in head]
    for section in PRESET_SECTIONS:
        lines += ["", f"[{section}]", *_keys(getattr(scene, section))]
        if section == "lights":
            for light in scene.lights.lights:
                lines += ["", "[[lights.lights]]", *_keys(light)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _keys(table: Any) -> list[str]:
    """A line for each field that is not the scene's default anyway; the first field of a table always, so that none is empty."""
    default, lines = type(table)(), []
    for number, item in enumerate(dataclasses.fields(table)):
        value = getattr(table, item.name)
        if item.name == "lights" or (number > 0 and value == getattr(default, item.name)) or value is None:
            continue
        lines.append(f"{item.name} = {json.dumps(_short(value))}")
    return lines


def _short(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_short(item) for item in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value
