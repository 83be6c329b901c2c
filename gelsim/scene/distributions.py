"""Distributions over the fields of a scene, as plans and studies write them: checked, and drawn from.

A field of the scene, by its full name, has a value or a distribution:

    {uniform = [a, b]}  {log_uniform = [a, b]}  {normal = [mean, sd], within = [a, b]}  {integers = [a, b]}
    {uniform = [a, b], without = [[c, d], ...]}      but not between c and d; of log_uniform too
    {choice = [...], weights = [...]}
    {cycle = [...]}     the values in turn, by the number of what is drawn
    {chance = p, then = …, else = …}      and any of them with  relative = "times" | "plus"  of what the field is without it;

a list gives every component its own. `lights.lights.power` is every light's, each for itself.

Left out: dependence between fields.
"""

from __future__ import annotations

import dataclasses
import math
import typing
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gelsim.errors import SceneError
from gelsim.scene.definition import Scene
from gelsim.scene.fields import field_types, nearest
from gelsim.scene.layers import Layer
from gelsim.scene.limits import CHOICES, LIMITS
from gelsim.units import unit_of

DRAWS = ("uniform", "log_uniform", "normal", "integers", "choice", "cycle", "chance")
MODIFIERS = {
    "uniform": ("without",), "log_uniform": ("without",), "normal": ("within",), "choice": ("weights",), "chance": ("then", "else"),
}  # fmt: skip
TRIES = 1000
"""Of a truncated normal, before its range is said to be impossible."""


def check_distribution(value: Any, where: str, name: str | None = None) -> None:
    """Raises SceneError where a distribution is malformed, or can give what the scene field `name` does not allow."""
    if isinstance(value, list):
        for number, item in enumerate(value):
            check_distribution(item, f"{where}[{number}]", name)
        return
    if not isinstance(value, dict):
        _check_value(value, where, name)
        return
    kinds = [key for key in value if key in DRAWS]
    if len(kinds) != 1:
        found = f"has {' and '.join(kinds)}" if kinds else f"has none of them{nearest(next(iter(value), ''), DRAWS)}"
        raise SceneError(f"{where}: a distribution is one of {', '.join(DRAWS)}; this {found}")
    kind = kinds[0]
    extra = [key for key in value if key not in (kind, "relative", *MODIFIERS.get(kind, ()))]
    if extra:
        raise SceneError(f"{where}: {kind} has no {extra[0]!r}")
    relative = value.get("relative")
    if relative not in (None, "times", "plus"):
        raise SceneError(f'{where}: relative = {relative!r}: allowed are "times" and "plus"')
    limited = None if relative else name
    argument = value[kind]
    if kind in ("choice", "cycle"):
        if not isinstance(argument, list) or not argument:
            raise SceneError(f"{where}: {kind} = {argument!r}: expected a list of values")
        for item in argument:
            _check_value(item, where, limited)
        weights = value.get("weights")
        fits = isinstance(weights, list) and len(weights) == len(argument) and all(is_number(w) and w >= 0 for w in weights)
        if weights is not None and not (fits and sum(weights)):
            raise SceneError(f"{where}: weights = {weights!r}: expected {len(argument)} numbers of 0 or more, not all 0")
    elif kind == "chance":
        if not is_number(argument) or not 0 <= argument <= 1:
            raise SceneError(f"{where}: chance = {argument!r}: allowed is 0 … 1")
        if "then" not in value or ("else" not in value and relative is None):
            raise SceneError(f"{where}: chance needs then = … and else = …")
        for branch in ("then", "else"):
            if branch in value:
                check_distribution(value[branch], f"{where}.{branch}", limited)
    else:
        _check_range(kind, value, where, limited)


def _check_range(kind: str, value: Layer, where: str, name: str | None) -> None:
    pairs = [(kind, value[kind])] + ([("within", value.get("within"))] if kind == "normal" else [])
    for key, pair in pairs:
        if not isinstance(pair, list) or len(pair) != 2 or not all(is_number(item) for item in pair):
            raise SceneError(f"{where}: {key} = {pair!r}: expected two numbers")
    low, high = value["within"] if kind == "normal" else value[kind]
    if low > high:
        raise SceneError(f"{where}: {pairs[-1][0]} = [{low:g}, {high:g}]: the first is above the second")
    if kind == "log_uniform" and low <= 0:
        raise SceneError(f"{where}: log_uniform = [{low:g}, {high:g}]: both must be above 0")
    if kind == "integers" and not (isinstance(low, int) and isinstance(high, int)):
        raise SceneError(f"{where}: integers = [{low:g}, {high:g}]: expected whole numbers")
    if kind == "normal":
        mean, deviation = value["normal"]
        # Beyond four standard deviations less than one of ten thousand draws falls: such a range was not meant.
        if deviation < 0 or mean + 4 * deviation < low or mean - 4 * deviation > high:
            raise SceneError(f"{where}: normal = [{mean:g}, {deviation:g}] hardly ever falls within [{low:g}, {high:g}]")
    if "without" in value:
        _check_gaps(value["without"], low, high, where)
    for end in (low, high):
        _check_value(end, where, name)


def _check_gaps(gaps: Any, low: float, high: float, where: str) -> None:
    pairs = isinstance(gaps, list) and all(isinstance(gap, list) and len(gap) == 2 and all(map(is_number, gap)) for gap in gaps)
    ends = [low, *(end for gap in gaps for end in gap), high] if pairs else []
    if not pairs or ends != sorted(ends) or sum(ends[1::2]) - sum(ends[::2]) <= 0:
        raise SceneError(f"{where}: without = {gaps!r}: expected ascending pairs within [{low:g}, {high:g}] that leave something")


def _check_value(value: Any, where: str, name: str | None) -> None:
    """A single value against what the scene allows for the field."""
    if isinstance(value, float) and not math.isfinite(value):
        raise SceneError(f"{where} = {value}: expected a finite number")
    if name is None:
        return
    if name in CHOICES and value not in tuple(CHOICES[name]):
        raise SceneError(f"{where} = {value!r}: allowed for {name} are {', '.join(CHOICES[name])}{nearest(str(value), CHOICES[name])}")
    if name in LIMITS and is_number(value):
        low, high = LIMITS[name]
        unit = unit_of(name.rpartition(".")[2])
        if not low <= value <= high:
            raise SceneError(f"{where} = {value:g}: allowed for {name} is {low:g} … {high:g}{f' {unit}' if unit else ''}")


def is_number(value: object) -> bool:
    """Whether it is a finite number; True and False are none."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def draw(value: Any, rng: np.random.Generator, number: int = 0, base: Any = None) -> Any:
    """A value of a distribution that was checked: plain numbers, texts and lists.

    Args:
        number: Of what is drawn, for `cycle`.
        base: What the field is without it, for `relative`.
    """
    if isinstance(value, list):
        bases = base if isinstance(base, (list, tuple)) else [base] * len(value)
        return [draw(item, rng, number, part) for item, part in zip(value, bases, strict=True)]
    if not isinstance(value, dict):
        return value
    if isinstance(base, (list, tuple)) and value.get("relative"):
        return [draw(value, rng, number, part) for part in base]
    kind = next(key for key in value if key in DRAWS)
    argument = value[kind]
    if kind == "uniform":
        drawn: Any = _between(rng, argument, value.get("without", ()))
    elif kind == "log_uniform":
        drawn = float(np.exp(_between(rng, np.log(argument), [np.log(gap) for gap in value.get("without", ())])))
    elif kind == "integers":
        drawn = int(rng.integers(argument[0], argument[1] + 1))
    elif kind == "cycle":
        drawn = argument[number % len(argument)]
    elif kind == "choice":
        weights = value.get("weights")
        share = None if weights is None else np.array(weights, float) / sum(weights)
        drawn = argument[int(rng.choice(len(argument), p=share))]
    elif kind == "chance":
        branch = "then" if rng.random() < argument else "else"
        drawn = draw(value[branch], rng, number) if branch in value else {"times": 1.0, "plus": 0.0}[value["relative"]]
    else:
        low, high = value["within"]
        drawn = next(
            (x for x in rng.normal(argument[0], argument[1], TRIES).tolist() if low <= x <= high), min(max(argument[0], low), high)
        )
    if value.get("relative") == "times":
        return drawn * base
    if value.get("relative") == "plus":
        return drawn + base
    return drawn


def _between(rng: np.random.Generator, ends: Sequence[float], gaps: Sequence[Sequence[float]]) -> float:
    """Evenly between two ends, but in none of the gaps (ascending): the gaps are shut, and opened again below what was drawn."""
    drawn = float(rng.uniform(ends[0], ends[1] - sum(last - first for first, last in gaps)))
    for first, last in gaps:
        drawn += last - first if drawn >= first else 0.0
    return drawn


def field_kind(name: str, full: str) -> Any:
    """The type of a field of the scene, or a SceneError that begins with `full`."""
    kind: Any = Scene
    for key in name.split("."):
        if kind is None or not dataclasses.is_dataclass(kind) or key not in field_types(kind):  # type: ignore[arg-type]
            known = [] if kind is None or not dataclasses.is_dataclass(kind) else list(field_types(kind))  # type: ignore[arg-type]
            raise SceneError(f"{full}: unknown field{nearest(key, known)}")
        kind = field_types(kind)[key]  # type: ignore[arg-type]
        if typing.get_origin(kind) is tuple and dataclasses.is_dataclass(typing.get_args(kind)[0]):
            kind = typing.get_args(kind)[0]
    if dataclasses.is_dataclass(kind):
        raise SceneError(f"{full}: is a whole table; name one field of it")
    return kind


def check_fields(table: Mapping[str, Any], where: str, sections: tuple[str, ...] | None = None) -> None:
    """Raises SceneError for a name that is no field of the scene (or of other `sections`), or a distribution that is wrong."""
    if not isinstance(table, Mapping):
        raise SceneError(f"{where} = {table!r}: expected a table of fields")
    for name, value in table.items():
        full = f"{where}.{name!r}"
        field_kind(name, full)
        if sections is not None and name.split(".")[0] not in sections:
            raise SceneError(f"{full}: here only {', '.join(sections)} may be drawn")
        check_distribution(value, full, name)


def draw_fields(table: Mapping[str, Any], rng: np.random.Generator, number: int = 0, base: Scene | None = None) -> Layer:
    """A layer of a scene from distributions by full name; `base` is what "times" and "plus" refer to."""
    layer: Layer = {}
    lights = [dataclasses.asdict(light) for light in base.lights.lights] if base is not None else []
    for name, value in table.items():
        *path, key = name.split(".")
        if path == ["lights", "lights"]:
            for light in lights:
                light[key] = draw(value, rng, number, light[key])
            layer.setdefault("lights", {})["lights"] = [{k: v for k, v in light.items() if v is not None} for light in lights]
            continue
        target, current = layer, base
        for step in path:
            target = target.setdefault(step, {})
            current = getattr(current, step) if current is not None else None
        target[key] = draw(value, rng, number, getattr(current, key) if current is not None else None)
    return layer
