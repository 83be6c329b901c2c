"""Scenes as TOML files, and how the layers of a scene lie on each other: defaults < sensor preset < file < flags.

A layer is a nested dictionary with the keys of the dataclasses in `gelsim.scene.definition`. A later layer beats an earlier one field by
field, with two exceptions: of shore_00, shore_a and youngs_modulus_kpa in a table the one given last displaces whichever came before, and
another law displaces the constants of the one before. TOML has no null; the text "none" stands for it (`depth_mm = "none"`).
The [expect] table of a scene file is no part of the scene: it is checked and left behind (`gelsim.scene.expectation`).
"""

from __future__ import annotations

import dataclasses
import os
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from gelsim.errors import MaterialError, SceneError, within
from gelsim.scene.definition import STIFFNESS, Grains, LawConstants, Scene, Sensor, Skin
from gelsim.scene.expectation import Expectation, read_expectation
from gelsim.scene.fields import field_types, known_key, nearest

PRESET_SECTIONS = ("gel", "camera", "lights", "coating", "markers")
"""What a sensor preset may fill."""

PATHS = ("object.mesh", "gel.mesh", "press.path_csv", "sensor.preset", "camera.rest", "markers.places")
"""Fields that name a file: relative to the file that they stand in."""

Layer = dict[str, Any]


def assets_folder() -> Path:
    """The shipped assets: inside the package when it was installed from a wheel, beside it in a working tree."""
    inside = Path(__file__).parent.parent / "_assets"
    return inside if inside.is_dir() else Path(__file__).parents[2] / "assets"


def preset_names() -> list[str]:
    """Names of the shipped sensor presets."""
    return sorted(path.stem for path in (assets_folder() / "sensors").glob("*.toml"))


def is_preset(sensor: str) -> bool:
    """Whether that names a preset or a sensor file."""
    return sensor in preset_names() or sensor.endswith(".toml")


def load_scene(path: str | Path) -> Scene:
    """Read a scene file.

    Args:
        path: A TOML file. Paths in it (`PATHS`) are relative to its folder.
    Raises:
        SceneError: No such file, not TOML, an unknown key, or a field out of range; MaterialError for a hardness out of range.
    """
    return build_scene(read_layer(path))


def build_scene(*layers: Layer) -> Scene:
    """A scene from layers, the last beats; the preset that they name lies below them all.

    Paths in them are taken from the working folder and made absolute: the scene is the same when it is read elsewhere.

    Raises:
        SceneError: As for `load_scene`.
    """
    for layer in layers:
        _check_layer(layer)
    layers = tuple(_of_a_file(anchored(layer, Path.cwd())) for layer in layers)
    preset = Sensor().preset
    for layer in layers:
        preset = layer.get("sensor", {}).get("preset", preset)
    merged: Layer = {}
    below = _preset_layer(preset)
    for layer in (below, *layers):
        for key, value in layer.items():
            if isinstance(value, dict):
                merged[key] = _overlaid(merged.get(key, {}), value)
            else:
                merged[key] = value
    press = merged.get("press", {})
    # what is given alone is reached
    if "force_n" not in press and str(press.get("depth_mm")).lower() != "none":
        merged["press"] = {**press, "force_n": None}
    elif "depth_mm" not in press and isinstance(press.get("force_n"), (int, float)):
        merged["press"] = {**press, "depth_mm": None}
    try:
        return Scene(**merged)
    except (SceneError, MaterialError) as error:
        if str(error) == _error_of(below):
            raise type(error)(f"{_preset_named(preset)}: {error}") from None
        raise


def _of_a_file(layer: Layer) -> Layer:
    """A layer in which a mesh that comes without a shape says the shape."""
    body = layer.get("object", {})
    alone = isinstance(body, dict) and isinstance(body.get("mesh"), str) and body["mesh"].lower() != "none" and "shape" not in body
    return layer | {"object": body | {"shape": "mesh"}} if alone else layer


def _error_of(layer: Layer) -> str:
    """What is wrong with a layer by itself, "" if nothing is."""
    try:
        Scene(**layer)
    except (SceneError, MaterialError) as error:
        return str(error)
    return ""


def _overlaid(below: Layer, above: Layer) -> Layer:
    """One table on another."""
    table = dict(below)
    if any(name in above for name in STIFFNESS):
        for name in STIFFNESS:
            table.pop(name, None)
    if "law" in table and above.get("law", table["law"]) != table["law"]:
        table.pop("law_constants", None)
    for name, value in above.items():
        inner = table.get(name)
        table[name] = _overlaid(inner, value) if isinstance(value, dict) and isinstance(inner, dict) else value
    return table


def nested(fields: Mapping[str, Any]) -> Layer:
    """A layer of a scene from values by full name, such as "gel.thickness_mm"."""
    layer: Layer = {}
    for name, value in fields.items():
        *path, key = name.split(".")
        table = layer
        for step in path:
            table = table.setdefault(step, {})
        table[key] = value
    return layer


def read_layer(path: str | Path) -> Layer:
    """One TOML file as a layer, with the paths in it made absolute; without its [expect]."""
    path = Path(path)
    layer = read_toml(path, "scene file")
    read_expectation(layer.pop("expect", {}))
    _check_layer(layer)
    return anchored(layer, path.parent.resolve())


def load_expectation(path: str | Path) -> Expectation:
    """The [expect] table of a scene file; nothing is expected where it has none.

    Raises:
        SceneError: No such file, not TOML, or a table that cannot be read.
    """
    return read_expectation(read_toml(Path(path), "scene file").get("expect", {}))


def anchored(layer: Layer, folder: Path) -> Layer:
    """A layer whose paths were relative to a folder."""
    found = dict(layer)
    for section, key in (name.split(".") for name in PATHS):
        table = layer.get(section)
        if isinstance(table, dict) and key in table:
            found[section] = table | {key: from_folder(f"{section}.{key}", table[key], folder)}
    return found


def from_folder(name: str, value: Any, folder: Path) -> Any:
    """A field's value; a path is taken from `folder`."""
    if name not in PATHS or not isinstance(value, str):
        return value
    is_path = value.endswith(".toml") if name == "sensor.preset" else value.lower() != "none"
    return os.path.normpath(folder / value) if is_path else value


def scene_table(scene: Scene) -> Layer:
    """A scene as nested plain values, None as "none": what `dump_scene` writes and report.json carries."""

    def plain(value: Any) -> Any:
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            # A hardness that is not given is left out: two of the three keys in one layer would be an error. So are constants of a law.
            unset = STIFFNESS if not isinstance(value, LawConstants) else tuple(field_types(LawConstants))
            pairs = ((item.name, getattr(value, item.name)) for item in dataclasses.fields(value))
            absent = (LawConstants(), Skin(), Grains())
            kept = {name: inner for name, inner in pairs if not (name in unset and inner in (None, ())) and inner not in absent}
            return {name: plain(inner) for name, inner in kept.items()}
        if isinstance(value, tuple):
            return [plain(item) for item in value]
        return "none" if value is None else value

    table = plain(scene)
    # TOML wants the plain keys of a table before its sub-tables.
    return dict(sorted(table.items(), key=lambda pair: isinstance(pair[1], dict)))


def dump_scene(scene: Scene) -> str:
    """A scene as TOML, every field written out: reading it gives an equal scene."""
    import tomli_w

    return tomli_w.dumps(scene_table(scene))


def read_toml(path: Path, what: str) -> Layer:
    """A TOML file's table; `what` names the file in errors.

    Raises:
        SceneError: It cannot be read, or is not TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SceneError(f"{what} {str(path)!r} cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SceneError(f"{what} {str(path)!r} is not TOML: {error}") from None


def _preset_layer(preset: object) -> Layer:
    if not isinstance(preset, str):
        raise SceneError(f"sensor.preset = {preset!r}: expected a preset's name or the path of a sensor file")
    path = Path(preset)
    if path.suffix != ".toml":
        path = assets_folder() / "sensors" / f"{preset}.toml"
        if preset not in preset_names():
            known = preset_names()
            raise SceneError(f"sensor.preset = {preset!r}: known are {', '.join(known)}, or a path ending in .toml{nearest(preset, known)}")
    layer = read_toml(path, "sensor preset")
    with within(_preset_named(preset)):
        _check_layer(layer, PRESET_SECTIONS)
    return anchored(layer, path.parent.resolve())


def _preset_named(preset: object) -> str:
    """A shipped sensor or a sensor file in errors, as it was asked for."""
    return f"sensor preset {preset!r}"


_INSIDE = {"lights": "; each light is a [[lights.lights]]", "sensor": '; its field is preset = "NAME or FILE.toml"'}
"""What was probably meant where a section is not a table."""


def _check_layer(layer: Layer, sections: Iterable[str] | None = None) -> None:
    """Unknown keys and two hardnesses at once: what can only be seen layer by layer."""
    for key, value in layer.items():
        known_key(key, Scene, "")
        if sections is not None and key not in sections:
            raise SceneError(f"{key!r} does not belong in a sensor preset: it fills {', '.join(sections)}")
        kind = field_types(Scene)[key]
        if not dataclasses.is_dataclass(kind):
            continue
        if not isinstance(value, dict):
            shown = "[…]" if isinstance(value, list) else repr(value)
            raise SceneError(f"{key} = {shown}: expected a table, [{key}]{_INSIDE.get(key, '')}")
        for name in value:
            known_key(name, kind, key)  # type: ignore[arg-type]
        given = [name for name in STIFFNESS if name in value]
        if len(given) > 1:
            raise SceneError(
                f"{' and '.join(f'{key}.{name} = {value[name]}' for name in given)}: give exactly one of {', '.join(STIFFNESS)}"
            )
