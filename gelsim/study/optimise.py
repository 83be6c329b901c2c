"""`gelsim optimise`: the scene that is best by a metric within bounds of some fields, or what two metrics cost each other.

Bounds are mapped to the unit cube (of the logarithm where asked for). First a Latin hypercube of SAMPLES points a field, in parallel, then
the simplex method of Nelder and Mead (1965; scipy, with bounds): no derivatives, since presses give none and pictures are noisy. With one
metric it begins at the best sample, and, while evaluations are left, at the next of the best STARTS. With two it goes down

    max_i w_i f_i + AUGMENTED Σ_i w_i f_i,    f_i the metric's place between the best and the worst of the samples

(the augmented Chebyshev norm of Steuer and Choo 1983, which also finds what lies in a hollow of the front) for each of WEIGHTS; the front
is what nothing else that was evaluated beats in both. It is a front of evaluated scenes, so it is never better than the true one.

All choices follow from the metrics found so far, so a run that was stopped goes on by walking the same path again over the finished lines
of results.jsonl. A scene that cannot be, or fails, counts as worst. Last, NEIGHBOURS of the best, so near it that the metric itself cannot
tell, with other seeds: what differs between them is the chance of meshes and of noise, and a gain below that is none. Left out: gradients
of the renderer; proof that an optimum is global.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gelsim.errors import SceneError
from gelsim.scene.fields import nearest
from gelsim.scene.layers import PRESET_SECTIONS, Layer, build_scene, dump_scene, scene_table
from gelsim.study import report
from gelsim.study.definition import Point, Study, case_name, check_axis, quantile, shown
from gelsim.study.metrics import METRICS
from gelsim.study.runner import DONE, RESULTS, case_of, measured
from gelsim.work.ledger import Ledger, Row
from gelsim.work.workers import check_count

SAMPLES = 8
STARTS = 3
WEIGHTS = (1.0, 0.0, 0.5, 0.25, 0.75)
"""Of the first metric; the second has the rest."""
AUGMENTED = 0.05
FIRST_STEP = 0.15
"""Of the simplex, along each field."""
CLOSE = 1e-3
"""The simplex stops when it is smaller, in the unit cube and in f; neighbours are that far, along each field."""
NEIGHBOURS = 4


@dataclass(frozen=True)
class Goal:
    metric: str
    most: bool = False
    """Large values are wanted."""

    def cost(self, row: Row) -> float:
        """Least is best; infinite where the case gave no number."""
        value = row.get(self.metric) if row["status"] == DONE else None
        return math.inf if value is None else -value if self.most else value

    def __str__(self) -> str:
        return f"{'most' if self.most else 'least'} {self.metric}"


def parse_goal(text: str) -> Goal:
    """ "METRIC" and "least:METRIC", or "most:METRIC".

    Raises:
        SceneError: There is no such metric.
    """
    way, _, name = text.rpartition(":")
    if way not in ("", "least", "most"):
        raise SceneError(f"{text!r}: expected METRIC (the least of it), or most:METRIC")
    if name not in METRICS:
        raise SceneError(f"metric {name!r}{nearest(name, METRICS) or ': gelsim study --list shows them all'}")
    return Goal(name, way == "most")


def parse_bounds(text: str) -> tuple[str, dict[str, list[float]]]:
    """ "FIELD=LOW:HIGH", or "FIELD=LOW:HIGH:log", as the axis of a study.

    Raises:
        SceneError: It is not of that form, or no field that has such values.
    """
    name, _, words = text.partition("=")
    low, _, rest = words.partition(":")
    high, _, scale = rest.partition(":")
    try:
        ends = [float(low), float(high)]
    except ValueError:
        ends = []
    if scale not in ("", "log") or not ends or not ends[0] < ends[1] or (scale and ends[0] <= 0):
        raise SceneError(f"--within {text!r}: expected FIELD=LOW:HIGH, such as gel.thickness_mm=1:5, or FIELD=LOW:HIGH:log above 0")
    axis = {"log_uniform" if scale else "uniform": ends}
    return name, check_axis("--within", name, axis)


@dataclass(frozen=True)
class Problem:
    """What is sought."""

    goals: Sequence[Goal]
    """One, or two for a front; the best is of the first."""
    bounds: Mapping[str, Any]
    """Field -> its range, as `parse_bounds` gives it."""
    base: Layer
    """What all scenes share."""
    evaluations: int = 60
    """At most; 8 a field are samples, and 4 the neighbours of the best."""


def optimise(
    problem: Problem, out: Path, *, resume: bool = False, force: bool = False, workers: int = 1, device: str = "auto", command: str = "",
    progress: Callable[[str, int, int], None] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Searches, and writes results.jsonl, study.csv, study.png, index.html, and sensor.toml and scene.toml of the best.

    Args:
        workers: Processes for the samples; what follows is one after the other.
    Returns:
        What the page says, with `best` and `front`, rows of the table, and for each goal `scatter`, largest less smallest of the best and
        its neighbours (None where none gave a number), and `gain`, of the best over the best sample.
    Raises:
        SceneError: Too few evaluations, `out` holds results already and neither `resume` nor `force` was given, or no scene gave a number.
    """
    check_count(workers)
    goals, bounds, base, evaluations = problem.goals, problem.bounds, problem.base, problem.evaluations
    samples = SAMPLES * len(bounds)
    least = samples + NEIGHBOURS
    if evaluations <= least:
        raise SceneError(
            f"--evaluations {evaluations}: {samples} samples, {SAMPLES} a field, come before the search, "
            f"and {NEIGHBOURS} scenes at its end; allowed is more than {least}"
        )
    study = Study(
        "optimise", _question(goals, bounds), bounds, tuple(goal.metric for goal in goals), next(iter(bounds)), base=base,
        cases=samples, seed=build_scene(base).seed, method=METHOD,
    )  # fmt: skip
    search = _Search(study, Ledger(out / RESULTS, resume=resume, force=force), device, evaluations - NEIGHBOURS, progress)
    sampled = search.rows([{name: _rounded(value) for name, value in point.items()} for point in study.points()], workers)
    known = [row for row in sampled if all(math.isfinite(goal.cost(row)) for goal in goals)]
    if not known:
        raise SceneError(f"none of {len(sampled)} scenes gave a number; the first: {sampled[0]['message']}")
    scales = [(min(costs), max(costs)) for costs in ([goal.cost(row) for row in known] for goal in goals)]
    places = [(low, (high - low) or 1.0) for low, high in scales]

    def merit(row: Row, weight: float) -> float:
        f = [(goal.cost(row) - low) / span for goal, (low, span) in zip(goals, places, strict=True)]
        weighted = [w * value if w else 0.0 for w, value in zip((weight, 1 - weight), f, strict=False)]
        return f[0] if len(goals) == 1 else max(weighted) + AUGMENTED * sum(weighted)

    runs = [(1.0, rank) for rank in range(min(STARTS, len(known)))] if len(goals) == 1 else [(weight, 0) for weight in WEIGHTS]
    for number, (weight, rank) in enumerate(runs):
        begin = sorted(known if len(goals) == 1 else search.known(), key=lambda row, w=weight: merit(row, w))[rank]
        left = evaluations - NEIGHBOURS - len(search.seen)
        # With one metric the next run is for what the one before left.
        budget = left if len(goals) == 1 else left // (len(runs) - number)
        search.descend(begin, lambda row, w=weight: merit(row, w), budget)
    rows = list(search.seen.values())
    best = min(rows, key=goals[0].cost)
    shown_rows = front(rows, goals)
    near = [best, *search.beside(best)]
    doubts = {goal.metric: _doubt(goal, near, known, shown_rows[-1] if goal is not goals[0] else best) for goal in goals}
    facts = {
        "out": str(out), "study": study.name, "question": study.question, "answer": _answer(goals, bounds, best, shown_rows, doubts),
        "cases": len(rows), "failed": [{"case": row["key"], "message": row["message"]} for row in rows if row["status"] != DONE],
        "case_seconds": round(sum(row["seconds"] for row in rows), 1), "command": command, "best": best, "front": shown_rows,
        "scatter": {name: scatter for name, (scatter, _) in doubts.items()}, "gain": {name: gain for name, (_, gain) in doubts.items()},
    }  # fmt: skip
    chosen = {id(row) for row in shown_rows}
    table = [row | {"evaluation": number, "front": int(id(row) in chosen)} for number, row in enumerate(rows, start=1)]
    report.write(out, dataclasses.replace(study, axes=dict(bounds)), table, facts, lambda path, _, kept: draw(path, goals, bounds, kept))
    _write_best(out, case_of(study, {name: best[name] for name in bounds}, device).layers, command)
    return facts


METHOD = (
    "Sampled by a Latin hypercube, then refined by the simplex method of Nelder and Mead within the bounds, with two metrics for several "
    "weights of an augmented Chebyshev norm. The best is that of all evaluated scenes, and the front what none of them beats in both: "
    "neither is proved to be global. At last four scenes a thousandth of each range beside the best, with other seeds, are evaluated: they "
    "differ by the chance of meshing and by noise, and a gain below that is none."
)


def front(rows: Sequence[Row], goals: Sequence[Goal]) -> list[Row]:
    """Rows that no other beats in one goal without losing in another, by the first goal; of equal ones the first."""
    kept: list[Row] = []
    least = math.inf
    for row in sorted(rows, key=lambda row: tuple(goal.cost(row) for goal in goals)):
        # By rising cost of the first goal, only what lowers the last one is worth having.
        cost = goals[-1].cost(row)
        if cost < least and math.isfinite(goals[0].cost(row)):
            kept.append(row)
            least = cost
    return kept


class _Search:
    """The evaluated scenes in the order of a search, with what is known from before."""

    def __init__(self, study: Study, ledger: Ledger, device: str, budget: int, progress: Callable[[str, int, int], None] | None) -> None:
        self.seen: dict[str, Row] = {}
        self._study, self._ledger, self._device, self._budget, self._progress = study, ledger, device, budget, progress

    def known(self) -> list[Row]:
        return [row for row in self.seen.values() if row["status"] == DONE]

    def rows(self, points: Sequence[Point], workers: int = 1) -> list[Row]:
        """Of points; those that are not known are computed."""
        keys, todo = [], []
        for point in points:
            try:
                case = case_of(self._study, point, self._device)
            except SceneError as error:
                # No scene is no reason to end the search; it is known at once, and not kept.
                key = case_name(point)
                self._ledger.rows[key] = {"key": key, **point, "status": "SceneError", "message": str(error), "seconds": 0.0}
            else:
                key = case.key
                # What failed in an earlier run is tried again, as in a study.
                if key not in self.seen and self._ledger.rows.get(key, {}).get("status") != DONE:
                    todo.append(case)
            keys.append(key)
        for done, row in enumerate(measured(todo, workers), start=1):
            self._ledger.add(row)
            if self._progress:
                self._progress("optimise", min(len(self.seen) + done, self._budget), self._budget)
        for key in keys:
            self.seen[key] = self._ledger.rows[key]
        return [self.seen[key] for key in keys]

    def beside(self, row: Row) -> list[Row]:
        """NEIGHBOURS of a row, CLOSE along every field and with other seeds; they are no candidates."""
        rng, axes = np.random.default_rng(0), self._study.axes
        seen, places = dict(self.seen), {name: _share(axes[name], row[name]) for name in axes}
        points = []
        for number in range(1, NEIGHBOURS + 1):
            near = {}
            for name, place in places.items():
                step = CLOSE * rng.choice((-1, 1))
                inside = place + step if 0 <= place + step <= 1 else place - step
                near[name] = _rounded(quantile(axes[name], inside))
            points.append(near | {"seed": self._study.seed + number})
        found = self.rows(points)
        self.seen = seen
        return found

    def descend(self, begin: Row, merit: Callable[[Row], float], budget: int) -> None:
        """The simplex method from a row, with at most `budget` evaluations."""
        from scipy.optimize import minimize

        axes = self._study.axes
        if budget <= len(axes):
            return
        start = np.array([_share(axes[name], begin[name]) for name in axes])
        step = np.where(start < 0.5, FIRST_STEP, -FIRST_STEP)

        def cost(place: np.ndarray) -> float:
            point = {name: _rounded(quantile(axes[name], float(u))) for name, u in zip(axes, np.clip(place, 0, 1), strict=True)}
            return merit(self.rows([point])[0])

        options = {"maxfev": budget, "xatol": CLOSE, "fatol": CLOSE**2, "initial_simplex": np.vstack([start, start + np.diag(step)])}
        minimize(cost, start, method="Nelder-Mead", bounds=[(0.0, 1.0)] * len(axes), options=options)


def _doubt(goal: Goal, near: Sequence[Row], sampled: Sequence[Row], best: Row) -> tuple[float | None, float]:
    """How far apart a metric is where nothing but chance differs, and what the search gained over the best sample."""
    costs = [cost for cost in map(goal.cost, near) if math.isfinite(cost)]
    return max(costs) - min(costs) if len(costs) > 1 else None, min(map(goal.cost, sampled)) - goal.cost(best)


def _share(axis: Mapping[str, Any], value: float) -> float:
    """Where a value lies in its range: the inverse of `quantile`."""
    low, high = axis.get("uniform") or axis["log_uniform"]
    if "uniform" in axis:
        return (value - low) / (high - low)
    return math.log(value / low) / math.log(high / low)


def _rounded(value: float) -> float:
    """So that a point is short to name, and the start of a descent is the row it came from."""
    return float(f"{value:.6g}")


def _question(goals: Sequence[Goal], bounds: Mapping[str, Any]) -> str:
    cost = f", and what does it cost to have the {goals[1]}" if len(goals) > 1 else ""
    wanted = f"give{'' if len(bounds) > 1 else 's'} the {goals[0]}{cost}"
    return f"Which {' and '.join(bounds)} {wanted}?"


def _answer(
    goals: Sequence[Goal], bounds: Mapping[str, Any], best: Row, found: Sequence[Row], doubts: Mapping[str, tuple[float | None, float]]
) -> str:
    def said(row: Row, mine: Goal) -> str:
        others = "".join(f" (with {goal.metric} {row[goal.metric]:.4g})" for goal in goals if goal is not mine)
        return f"The {mine} is {row[mine.metric]:.4g}{others} at " + ", ".join(f"{name} {shown(row[name])}" for name in bounds)

    text = said(best, goals[0])
    ends = [name for name, axis in bounds.items() if not 0.005 < _share(axis, best[name]) < 0.995]
    text += f" (at the bound of {' and '.join(ends)}; beyond it may be better)." if ends else "."
    if len(goals) > 1:
        text += f" {said(found[-1], goals[1])}. {len(found)} scenes are on the front between them."
    for name, (scatter, gain) in doubts.items():
        if scatter is None:
            text += f" How far chance alone moves {name} is not known: no scene beside the best gave a number."
        else:
            text += f" The search gained {gain:.2g} of {name} over the best of its samples; where only chance differs, scenes are up to "
            text += f"{scatter:.2g} apart" + (", so this is no gain." if gain <= scatter else ".")
    return text


def _write_best(out: Path, layers: Sequence[Layer], command: str) -> None:
    import tomli_w

    scene = build_scene(*layers)
    table = scene_table(scene)
    sensor = tomli_w.dumps({section: table[section] for section in PRESET_SECTIONS})
    (out / "sensor.toml").write_text(f"# Best of: {command}\n{sensor}", encoding="utf-8")
    (out / "scene.toml").write_text(dump_scene(scene), encoding="utf-8")


def draw(path: Path, goals: Sequence[Goal], bounds: Mapping[str, Any], rows: Sequence[Row]) -> None:
    """The front, or the best so far by evaluation; and the first metric against each field."""
    from matplotlib.figure import Figure

    columns = min(3, 1 + len(bounds))
    lines = -(-(1 + len(bounds)) // columns)
    figure = Figure(figsize=(4.2 * columns, 3.4 * lines), dpi=90, facecolor="white", layout="constrained")
    panels = figure.subplots(lines, columns, squeeze=False).ravel()
    first, last = goals[0], goals[-1]
    chosen = sorted((row for row in rows if row["front"]), key=lambda row: row[first.metric])
    number, value = [row["evaluation"] for row in rows], [row[first.metric] for row in rows]
    if len(goals) > 1:
        panels[0].plot(value, [row[last.metric] for row in rows], "o", markersize=3, color="0.7", label="evaluated")
        panels[0].plot(*zip(*((row[first.metric], row[last.metric]) for row in chosen), strict=True), "o-", markersize=4, label="front")
        panels[0].set(xlabel=METRICS[first.metric].label, ylabel=METRICS[last.metric].label)
    else:
        panels[0].plot(number, value, "o", markersize=3, color="0.7", label="evaluated")
        panels[0].plot(number, (np.maximum if first.most else np.minimum).accumulate(value), "-", label="best so far")
        panels[0].set(xlabel="evaluation", ylabel=METRICS[first.metric].label)
    panels[0].legend(fontsize=7)
    for panel, (name, axis) in zip(panels[1:], bounds.items(), strict=False):
        panel.plot([row[name] for row in rows], value, "o", markersize=3, color="0.7")
        panel.plot([row[name] for row in chosen], [row[first.metric] for row in chosen], "o", markersize=4)
        panel.set(xlabel=name, ylabel=METRICS[first.metric].label, xscale="log" if "log_uniform" in axis else "linear")
    for panel in panels[1 + len(bounds) :]:
        panel.set_axis_off()
    for panel in panels:
        panel.grid(alpha=0.25)
        panel.tick_params(labelsize=8)
    figure.savefig(path, format="png")
