"""What a study is: a question, the axes it varies, what it measures, and the sentence that answers it; and a user's own as a TOML file.

An axis is a list of values (a grid over all of them) or a range {uniform = [a, b]}, {log_uniform = [a, b]}. Ranges are sampled together by
a Latin hypercube of `cases` points: each range is cut into that many slices of equal probability, and every slice is met once (McKay,
Beckman, Conover 1979, as in scipy). With both, the hypercube is repeated at each point of the grid. Left out: axes that depend on others,
but through the `layer` function of a ready-made study.
"""

from __future__ import annotations

import importlib
import itertools
import math
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from gelsim.errors import SceneError, within
from gelsim.scene.definition import Scene
from gelsim.scene.distributions import check_fields, field_kind
from gelsim.scene.fields import field_types, nearest
from gelsim.scene.layers import Layer, anchored, from_folder, nested, read_layer, read_toml
from gelsim.shape.mesh_file import check_file
from gelsim.study import STUDIES
from gelsim.study.metrics import METRICS
from gelsim.work.ledger import Row

Point = dict[str, Any]
"""Axis -> value: what distinguishes a case."""
RANGES = ("uniform", "log_uniform")
MOST_CASES = 10_000
_KEYS = ("question", "metrics", "fields", "x", "colour", "cases", "seed", "scene")


SAME = 1e-3
"""Relative difference of two values that an answer takes for one."""


def plain_answer(rows: Sequence[Row], study: Study) -> str:
    """Where the first metric is largest and smallest: all that can be said without knowing the question."""
    name = study.metrics[0]
    known = sorted((row for row in rows if row.get(name) is not None), key=lambda row: row[name])
    if not known:
        return "No case gave a number."

    def said(row: Row) -> str:
        """The value, and the axes on which it is had at one place alone: of the others it says nothing."""
        tied = [other for other in known if math.isclose(other[name], row[name], rel_tol=SAME)]
        places = [f"{axis} {shown(row[axis])}" for axis in study.axes if len({shown(other[axis]) for other in tied}) == 1]
        return f"{row[name]:.4g}" + (f" at {', '.join(places)}" if places else "")

    if len(known) > 1 and math.isclose(known[0][name], known[-1][name], rel_tol=SAME):
        return f"{METRICS[name].label}: {known[0][name]:.4g} in all cases."
    return f"{METRICS[name].label}: least, {said(known[0])}; most, {said(known[-1])}."


@dataclass(frozen=True)
class Study:
    """A what-if study."""

    name: str
    question: str
    axes: Mapping[str, Any]
    """Axis -> its values, or a range."""
    metrics: tuple[str, ...]
    """Names of gelsim.study.metrics; a plot each."""
    x: str
    """The axis along which is plotted."""
    colour: str | None = None
    """The axis whose values are told apart by colour; others are by dashes."""
    base: Layer = field(default_factory=dict)
    """The scene that all cases share."""
    layer: Callable[[Point], Layer] = nested
    """What a point adds to it; axes need not be fields of the scene."""
    cases: int = 0
    """Of the Latin hypercube; 0 where no axis is a range."""
    seed: int = 0
    """Of the Latin hypercube."""
    answer: Callable[[Sequence[Row], Study], str] = plain_answer
    method: str = ""
    """How it is measured, and what is left out."""
    quick: Mapping[str, Any] = field(default_factory=dict)
    """Fields of the study that --quick replaces."""

    def small(self) -> Study:
        """Its form of minutes. Raises SceneError where it has none."""
        if not self.quick:
            raise SceneError(
                f"--quick: study {self.name} has no small form; in a study of your own, fewer values and scene.fidelity = 'fast' make one"
            )
        return replace(self, **self.quick)

    def points(self) -> list[Point]:
        """The points of all cases, in the same order every time.

        Raises:
            SceneError: There are too many or none.
        """
        grid = {name: values for name, values in self.axes.items() if not isinstance(values, Mapping)}
        ranges = {name: values for name, values in self.axes.items() if isinstance(values, Mapping)}
        count = int(np.prod([len(values) for values in grid.values()], dtype=float)) * (self.cases if ranges else 1)
        if not 0 < count <= MOST_CASES:
            raise SceneError(f"study {self.name}: {count} cases; allowed are 1 … {MOST_CASES}")
        sampled: list[Point] = [{}]
        if ranges:
            from scipy.stats import qmc

            share = qmc.LatinHypercube(len(ranges), rng=np.random.default_rng(self.seed)).random(self.cases)
            sampled = [{name: quantile(r, u) for (name, r), u in zip(ranges.items(), line, strict=True)} for line in share.tolist()]
        corners = [dict(zip(grid, values, strict=True)) for values in itertools.product(*grid.values())]
        return [{name: (corner | drawn)[name] for name in self.axes} for corner in corners for drawn in sampled]


def quantile(table: Mapping[str, Any], share: float) -> float:
    """The value of a range below which a share of it lies."""
    low, high = table.get("uniform") or table["log_uniform"]
    if "uniform" in table:
        return float(low + share * (high - low))
    return float(low * (high / low) ** share)


def shown(value: Any) -> str:
    """A value of an axis in few characters."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def case_name(point: Point) -> str:
    """A point as the key of its case: the same for the same values."""
    return ", ".join(f"{axis} = {value!r}" for axis, value in point.items())


def load_study(name: str) -> Study:
    """A ready-made study by its name, or a user's own by the path of its TOML file.

    Raises:
        SceneError: There is none of that name, or the file is not what it should be; names the key.
    """
    if name in STUDIES:
        return importlib.import_module(STUDIES[name]).STUDY
    if not name.endswith(".toml"):
        raise SceneError(f"study {name!r}: known are {', '.join(STUDIES)}, or the path of a .toml file{nearest(name, STUDIES)}")
    path = Path(name)
    return _user_study(path, read_toml(path, "study"))


def _user_study(path: Path, table: dict[str, Any]) -> Study:
    where = f"study {path.name}"
    for key in table:
        if key not in _KEYS:
            of_scene = f"; {key} of a scene stands in [scene], or in [fields]" if key in field_types(Scene) else ""
            raise SceneError(f"{where}: unknown key {key!r}{of_scene or nearest(key, _KEYS) or '; known are ' + ', '.join(_KEYS)}")
    for key, kind, words in (("question", str, "a text"), ("metrics", list, "a list of names"), ("fields", dict, "a table")):
        if not isinstance(table.get(key), kind) or not table[key]:
            raise SceneError(f"{where}: {key} = {table.get(key)!r}: expected {words}")
    axes = {name: check_axis(f"{where}: fields", name, values) for name, values in table["fields"].items()}
    for name in table["metrics"]:
        if name not in METRICS:
            raise SceneError(f"{where}: metrics: {name!r} is none{nearest(str(name), METRICS)}; --list shows them all")
    x, colour = table.get("x", next(iter(axes))), table.get("colour")
    for key, axis in (("x", x), ("colour", colour)):
        if axis is not None and axis not in axes:
            raise SceneError(f"{where}: {key} = {axis!r}: allowed are the fields {', '.join(axes)}")
    ranged = any(isinstance(values, Mapping) for values in axes.values())
    cases = table.get("cases", 0)
    if type(cases) is not int or cases < 0 or ranged != bool(cases):
        need = "expected how many points of the ranges to take" if ranged else "it is for ranges, and no field has one"
        raise SceneError(f"{where}: cases = {table.get('cases')!r}: {need}")
    base: Any = table.get("scene", {})
    if isinstance(base, str):
        base = read_layer(path.parent / base)
    if not isinstance(base, dict):
        raise SceneError(f"{where}: scene = {base!r}: expected a table as in a scene file, or the path of one")
    axes = {
        name: values if isinstance(values, Mapping) else [from_folder(name, value, path.parent) for value in values]
        for name, values in axes.items()
    }
    base = anchored(base, path.parent)
    meshes = axes.get("object.mesh", [base["object"]["mesh"]] if "mesh" in base.get("object", {}) else [])
    for mesh in meshes:
        with within(where):
            check_file(base.get("object", {}) | ({"rigid": None} if "object.rigid" in axes else {}) | {"mesh": mesh})
    return Study(
        name=path.stem,
        question=table["question"],
        axes=axes,
        metrics=tuple(table["metrics"]),
        x=x,
        colour=colour,
        base=base,
        cases=cases,
        seed=int(table.get("seed", 0)),
    )


def check_axis(where: str, name: str, values: Any) -> Any:
    """The values or the range of a field, or a SceneError; `where` is what holds the field."""
    table, where = where, f"{where}.{name!r}"
    if name.startswith("lights.lights"):
        raise SceneError(
            f"{where}: single lights are not varied; give each layout a sensor file and list them: "
            '"sensor.preset" = ["a.toml", "b.toml"] of gelsim study (docs/extending.md)'
        )
    if isinstance(values, dict):
        kind = next(iter(values), "")
        if list(values) != [kind] or kind not in RANGES:
            raise SceneError(f"{where}: expected a list of values, or a range: {' or '.join(f'{{{r} = [a, b]}}' for r in RANGES)}")
        check_fields({name: values}, table)
        of_field = field_kind(name, where)
        if float not in (of_field.__args__ if isinstance(of_field, types.UnionType) else (of_field,)):
            if typing.get_origin(of_field) is tuple:
                parts = typing.get_args(of_field)
                said = "is a list" if Ellipsis in parts else {2: "is a pair", 3: "is a triple"}[len(parts)] + " of numbers"
                raise SceneError(f"{where}: {said}, so it has no range; gelsim study takes a list of its values")
            raise SceneError(f"{where}: takes no fractions, so it has no range; gelsim study takes a list of its values")
        return values
    if not isinstance(values, list) or not values:
        raise SceneError(f"{where} = {values!r}: expected a list of values, or a range")
    for value in values:
        check_fields({name: {"choice": [value]}}, table)
    return values
