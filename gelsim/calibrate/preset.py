"""A fitted sensor as a preset file, like those of assets/sensors/, with what was found and how well beside it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gelsim.scene import Scene
from gelsim.scene_file import PRESET_SECTIONS, scene_table

DIGITS = 6


def write_preset(path: Path, scene: Scene, report: Mapping[str, Any], name: str) -> None:
    """Writes the preset as TOML; numbers with six digits."""
    import tomli_w

    table = scene_table(scene)
    sections = {section: _short(table[section]) for section in PRESET_SECTIONS}
    fit, parts = report["fit"], report["parameters"]
    given = [
        f"{key} {entry['value']:.4g} ± {entry['sd']:.2g}"
        for key, entry in parts.items()
        if entry["state"] == "determined" and "shading" not in key
    ]
    count = sum(row["split"] == "train" for row in report["presses"])
    lines = [
        f"# {name}: fitted by `gelsim calibrate` to {count} photographs of a pressed ball;",
        f"# what is left between them and the fit is {fit['rms_levels']:.1f} levels of 255 (root mean square).",
        "# Albedo, flake reflectance, white balance and exposure are conventions: no photograph tells them from the lights' powers.",
        "# Determined by the photographs (value ± standard deviation):",
        *(f"#   {text}" for text in given),
    ]
    path.write_text("\n".join(lines) + "\n\n" + tomli_w.dumps(sections), encoding="utf-8")


def _short(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _short(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_short(item) for item in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value
