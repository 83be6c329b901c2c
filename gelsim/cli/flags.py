"""Every field of the scene as a flag of the command line, with the field's documentation as its help.

A field `object.radius_mm` is `--object.radius-mm`; fields of [object] and [press] also go by their own name, `--radius-mm`, and a few
others have the short names in SHORT. What the flags say becomes one layer of the scene (`gelsim.scene.layers`), the one that beats all
others.
"""

from __future__ import annotations

import argparse
import dataclasses
import re
import typing
from typing import Any

from gelsim import console
from gelsim.errors import SceneError
from gelsim.scene import definition
from gelsim.scene.definition import STIFFNESS, Scene
from gelsim.scene.fields import field_types, parse_text
from gelsim.scene.layers import PRESET_SECTIONS, Layer
from gelsim.scene.limits import CHOICES
from gelsim.units import unit_of

SHORT = {
    "sensor.preset": "--sensor",
    "contact.friction_coefficient": "--friction",
    "render.resolution": "--resolution",
    "render.mode": "--mode",
    "render.spp": "--spp",
}
OWN_NAME = ("object", "press")
"""Sections whose fields are flags by their own name too."""


class Parser(console.Parser):
    """The command line's, with numbers and their names as people write them."""

    def __init__(self, **options: Any) -> None:
        super().__init__(formatter_class=_Formatter, **options)
        # argparse takes -1e-3 and -1,2 for flags unless told otherwise.
        self._negative_number_matcher = re.compile(r"-[\d.]")


class _Formatter(argparse.RawDescriptionHelpFormatter):
    def _format_args(self, action: argparse.Action, default_metavar: str) -> str:
        # A field of two or three numbers: "X Y", not "X Y [X Y ...]".
        return str(action.metavar) if action.nargs == "+" else super()._format_args(action, default_metavar)


def add_scene_flags(parser: argparse.ArgumentParser) -> None:
    """Adds a flag for every field of the scene, grouped by section."""
    docs = console.field_docs(definition)
    for section, kind in field_types(Scene).items():
        if not dataclasses.is_dataclass(kind):
            _add(parser, section, kind, docs["Scene"].get(section, ""), getattr(Scene, section))
            continue
        group = parser.add_argument_group(f"[{section}]")
        assert isinstance(kind, type)
        if section == "object":
            group.add_argument("--shore", metavar="N", help="hardness of the object, a number on the scale named by --shore-scale")
            group.add_argument("--shore-scale", choices=("00", "A"), default=None, help="scale of --shore: 00 (the default) or A")
        for item in dataclasses.fields(kind):
            inner = field_types(kind)[item.name]
            if dataclasses.is_dataclass(inner):  # a table within a section
                assert isinstance(inner, type)
                for part in dataclasses.fields(inner):
                    doc = docs[inner.__name__].get(part.name, "")
                    _add(group, f"{section}.{item.name}.{part.name}", field_types(inner)[part.name], doc, part.default or None)
                continue
            doc = docs[kind.__name__].get(item.name, "")
            _add(group, f"{section}.{item.name}", inner, doc, item.default, section in PRESET_SECTIONS)


def layer_of(options: argparse.Namespace) -> Layer:
    """The flags that were given, as a layer.

    Raises:
        SceneError: --shore-scale without --shore, or a hardness of what is rigid.
    """
    layer: Layer = {}
    for name, text in vars(options).items():
        section = name.split(".")[0]
        if text is None or section not in field_types(Scene):
            continue
        kind, table = field_types(Scene)[section], layer
        *path, key = name.split(".")
        for step, below in zip(path, name.split(".")[1:], strict=True):
            table, kind = table.setdefault(step, {}), field_types(kind)[below]
        table[key] = parse_text(text, kind, name)
    if options.shore is not None:
        key = "shore_a" if options.shore_scale == "A" else "shore_00"
        layer.setdefault("object", {})[key] = parse_text(options.shore, float, "--shore")
    elif options.shore_scale is not None:
        raise SceneError(f"flag --shore-scale {options.shore_scale}: give the number too, --shore N")
    body = layer.get("object", {})
    if body.get("rigid") is True and (hardness := [name for name in STIFFNESS if name in body]):
        raise SceneError(f"flag --rigid: a rigid object has no hardness, and object.{hardness[0]} was given too")
    return layer


def _add(parser: Any, name: str, hint: Any, doc: str, default: Any, from_preset: bool = False) -> None:
    section, _, key = name.partition(".")
    flags = ["--" + name.replace("_", "-")]
    if section in OWN_NAME:
        flags.append("--" + key.replace("_", "-"))
    if name in SHORT:
        flags.append(SHORT[name])
    words: dict[str, Any] = {"dest": name, "default": None}
    if hint is bool:
        words |= {"nargs": "?", "const": "true", "metavar": "true|false"}
    elif typing.get_origin(hint) is tuple:
        inner = typing.get_args(hint)
        metavar = "WxH" if key == "resolution" else "TOML" if dataclasses.is_dataclass(inner[0]) else " ".join("XYZ"[: len(inner)])
        if inner == (float, ...):
            metavar = "NUMBER"
        words |= {"nargs": "+", "metavar": metavar}
    else:
        words["metavar"] = (unit_of(key) or {int: "N", float: "NUMBER"}.get(hint, "TEXT")).replace(" ", "-").upper().replace("°", "DEG")
    if name in CHOICES:
        words["metavar"] = "{" + ",".join(CHOICES[name]) + "}"
    help_text = f"{doc} {_default_words(default, from_preset)}".strip().replace("%", "%%")
    parser.add_argument(*flags[::-1], help=help_text, **words)


def _default_words(default: Any, from_preset: bool) -> str:
    if from_preset:
        return "(default: the preset's)"
    if default is None or default is dataclasses.MISSING or default == ():
        return ""
    shown = " ".join(str(item) for item in default) if isinstance(default, tuple) else str(default)
    return f"(default: {shown.lower() if isinstance(default, bool) else shown})"
