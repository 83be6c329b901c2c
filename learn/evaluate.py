"""`gelsim-learn eval`: the table of the paper with our numbers beside its own, and where the errors are.

Each test row of the dataset's splits: the network and the baselines (which learn from the split `train` of the dataset or of another),
count, R², RMSE with 95 % intervals over objects. Presses are seen to their peak, with their camera's noise drawn. A press without visible
contact is not left out: its estimate is the network's mean of the training, and it is counted.
"""

from __future__ import annotations

import csv
import json
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gelsim.data.episodes import Dataset, load_dataset
from gelsim.files import whole_file
from learn import plots, scores
from learn.baselines import NAMES, Baselines, fit_baselines, over_time
from learn.config import InputConfig, LearnError
from learn.data import held_presses
from learn.ensemble import Ensemble
from learn.estimate import pick_device
from learn.recordings import CACHE, PLAIN, Archive, Reading, archive
from learn.splits import TEST_ROWS, TRAIN, VALIDATION, check_splits

# Yuan et al., ICRA 2017, Table I and section V-B: videos, R², RMSE. It gives no numbers of natural objects.
PUBLISHED: dict[str, tuple[int | None, float, float]] = {
    "novel_hardness": (1398, 0.9564, 5.18),
    "novel_shape": (73, 0.7868, 11.05),
    "robot": (683, 0.8524, 10.28),
    "vessels": (None, 0.57, 19.3),
    "complicated": (None, 0.39, 18.2),
}
TITLES = {
    "novel_hardness": "trained shape, novel hardness", "novel_shape": "novel shapes", "robot": "trained samples, robot gripper",
    "vessels": "simple vessels (group 3)", "complicated": "complicated shapes (group 4)", "natural": "natural objects (group 5)",
}  # fmt: skip
FIRM_N = 0.5
"""Presses that end at less hardly dent the gel: a row's error is also given without them [N]."""
HARDNESS_BANDS, FORCE_BANDS = (0, 20, 40, 60, 70, 80, 100), (0, FIRM_N, 1, 2, 5, 10, 1000)
RADIUS_BANDS_MM = (0, 3, 4, 5, 8, 15, 30, 1000)
CHUNK = 64
"""Episodes in memory at once."""
FEWEST = 3
"""Presses that a baseline learns from."""


def evaluate(
    models: Sequence[Path],
    data: Path,
    out: Path,
    *,
    rows: Sequence[str] = (),
    force: bool = False,
    baselines_from: Path | None = None,
    reading: Reading = PLAIN,
) -> dict[str, Any]:
    """Writes table.md, report.json, predictions.csv and plots into `out`.

    Args:
        models: Checkpoints; of several the readings are one (`learn.ensemble`).
        rows: Splits to test; empty: the paper's rows that the dataset has, `validation` when it has none.
        baselines_from: The dataset whose split `train` the baselines learn from, which may be `data`; None: there are none.
        reading: Of recordings, and where the networks are; without a cache the first run's own is taken, where there is one.
    Returns:
        What report.json holds.
    Raises:
        LearnError, DatasetError: Something in the input cannot be used.
    """
    if out.exists() and any(out.iterdir()) and not force:
        raise LearnError(f"--out {out}: exists; give --force to write over it")
    dataset, ensemble = load_dataset(data), Ensemble(models, pick_device(reading.device))
    check_splits(dataset.rows, dataset.splits)
    teacher = None if baselines_from is None else dataset if baselines_from == data else load_dataset(baselines_from)
    if teacher is not None and teacher is not dataset and len(_known(teacher)) < FEWEST:
        raise LearnError(f"--baselines-from {baselines_from}: its split train has fewer than {FEWEST} presses of known hardness")
    chosen = list(rows) or [name for name in TEST_ROWS if dataset.splits.get(name)] or [VALIDATION]
    for name in chosen:
        if not dataset.splits.get(name):
            raise LearnError(f"eval: {data} has no split {name!r}; it has {', '.join(name for name in dataset.splits) or 'none'}")
    out.mkdir(parents=True, exist_ok=True)
    own = models[0].parent / CACHE
    cache = reading.cache or (own if own.is_dir() else None)
    scratch = Path(tempfile.mkdtemp(prefix="gelsim-learn-")) if cache is None else None
    try:
        return _evaluate(dataset, ensemble, models, out, chosen, teacher, replace(reading, cache=cache or scratch))
    finally:
        if scratch is not None:
            shutil.rmtree(scratch, ignore_errors=True)


def _evaluate(
    dataset: Dataset, ensemble: Ensemble, models: Sequence[Path], out: Path, chosen: Sequence[str], teacher: Dataset | None,
    reading: Reading,
) -> dict[str, Any]:  # fmt: skip
    inputs = ensemble.inputs
    everything = archive(dataset, [row["index"] for row in dataset.rows], inputs, reading)
    learnt = _learn_baselines(archive(teacher, _known(teacher), inputs, reading), inputs) if teacher is not None else None
    total = sum(len(dataset.splits[name]) for name in chosen)
    found: dict[str, list[dict[str, Any]]] = {}
    done = 0
    for name in chosen:
        found[name] = []
        for start in range(0, len(dataset.splits[name]), CHUNK):
            part = everything.only([dataset.positions[index] for index in dataset.splits[name][start : start + CHUNK]])
            found[name] += _predict(part, ensemble, learnt)
            done = done + len(dataset.splits[name][start : start + CHUNK])
            if reading.progress:
                reading.progress("evaluating", done, total)
    report: dict[str, Any] = {
        "models": [
            {"model": path.name, "step": kept.step, "training": kept.provenance}
            for path, kept in zip(models, ensemble.checkpoints, strict=True)
        ],
        "data": dataset.folder.resolve().name,
        "domain": dataset.info.get("domain"),
        "baselines_from": teacher.folder.resolve().name if learnt is not None and teacher is not None else None,
        "rows": {},
    }
    for name, predictions in found.items():
        report["rows"][name] = _row_report(name, predictions, learnt is not None)
    everything = [prediction for predictions in found.values() for prediction in predictions if prediction["true"] is not None]
    if everything:
        report["all"] = _details(everything)
        report["told_apart"] = scores.told_apart(_column(everything, "true"), _column(everything, "estimate"))
    _write(out, report, found)
    return report


def table(report: dict[str, Any]) -> str:
    """The rows as a Markdown table, published numbers beside."""
    lines = [
        f"Test presses of `{report['data']}` ({report['domain']}); brackets: 95 % interval over objects. Published: real recordings.",
        "",
        f"| row | published: n, R², RMSE | presses, objects | R² | RMSE | RMSE of presses ≥ {FIRM_N:g} N | "
        + " | ".join(f"RMSE, {name}" for name in NAMES)
        + " |",
        "|---|---|---|---|---|---|" + "---|" * len(NAMES),
    ]
    for name, row in report["rows"].items():
        known = PUBLISHED.get(name)
        published = f"{known[0] or '—'}, {known[1]}, {known[2]}" if known else "—"
        if "rmse" not in row:
            lines.append(f"| {TITLES.get(name, name)} | {published} | {row['presses']} | — | — | — |" + " — |" * len(NAMES))
            continue
        bare = [f"{row['baselines'][other]['rmse']:.1f}" if row["baselines"] else "—" for other in NAMES]
        cells = [
            TITLES.get(name, name),
            published,
            f"{row['presses']}, {row['objects']}",
            _with_interval(row["r2"], row["r2_interval"], 2),
            _with_interval(row["rmse"], row["rmse_interval"], 1),
            f"{_with_interval(row['firm']['rmse'], row['firm']['rmse_interval'], 1)}, {row['firm']['presses']}" if "firm" in row else "—",
            *bare,
        ]
        lines.append("| " + " | ".join(cells) + " |")
    for name, row in report["rows"].items():
        for shape, order in row.get("ranking", {}).items():
            lines += ["", f"{TITLES.get(name, name)}, {shape}: Spearman {order['spearman']:.2f} over {order['objects']} objects."]
        if row["without_contact"]:
            lines += [
                "",
                f"{TITLES.get(name, name)}: {row['without_contact']} presses show no contact; their estimate is the training mean.",
            ]
    return "\n".join(lines) + "\n"


def _known(dataset: Dataset) -> list[int]:
    """The training presses of known hardness."""
    return [index for index in dataset.splits.get(TRAIN, []) if dataset.rows[dataset.positions[index]]["shore_00"] is not None]


def _learn_baselines(part: Archive, inputs: InputConfig) -> Baselines | None:
    if len(part) < FEWEST:
        return None
    curves = list(zip(part.signals, part.features, strict=True))
    return fit_baselines(curves, np.array([row["shore_00"] for row in part.rows], float), inputs)


def _predict(part: Archive, ensemble: Ensemble, learnt: Baselines | None) -> list[dict[str, Any]]:
    presses = held_presses(part, ensemble.inputs, ensemble.repeat, ensemble.seed)
    seen = [number for number, press in enumerate(presses) if press is not None]
    reading = ensemble.unread(len(presses))
    if seen:
        said = ensemble.read([press for press in presses if press is not None])
        for kept, found in ((reading.mean, said.mean), (reading.spread, said.spread), (reading.novelty, said.novelty)):
            kept[seen] = found
    odd_gel = [press is not None and bool(ensemble.strange_gel(press.gel)) for press in presses]
    curves = [over_time(curve, ensemble.inputs) for curve in zip(part.signals, part.features, strict=True)]
    bare = {name: learnt.predict(name, curves) for name in NAMES} if learnt else {}
    return [
        {
            "row": row,
            "true": None if row["shore_00"] is None else float(row["shore_00"]),
            "estimate": float(reading.mean[number]),
            "spread": float(reading.spread[number]),
            "novelty": float(reading.novelty[number]),
            "contact": presses[number] is not None,
            "unlike": bool(reading.novelty[number] > 1) or odd_gel[number],
            **{name: float(values[number]) for name, values in bare.items()},
        }
        for number, row in enumerate(part.rows)
    ]


def _column(predictions: Sequence[dict[str, Any]], name: str) -> scores.Array:
    return np.array([prediction[name] for prediction in predictions], float)


def _row_report(name: str, predictions: list[dict[str, Any]], with_baselines: bool) -> dict[str, Any]:
    known = [prediction for prediction in predictions if prediction["true"] is not None]
    report: dict[str, Any] = {
        "presses": len(predictions),
        "without_contact": sum(not prediction["contact"] for prediction in predictions),
        "unlike_training": sum(prediction["unlike"] for prediction in predictions),
    }
    rigid = [prediction["estimate"] for prediction in predictions if prediction["row"]["rigid"]]
    if rigid:
        report["rigid"] = {"presses": len(rigid), "over_80": float(np.mean([value > 80 for value in rigid]))}
    if name == "natural":
        report["ranking"] = scores.ranking([prediction["row"] for prediction in predictions], _column(predictions, "estimate"))
    if not known:
        return report
    true, objects = _column(known, "true"), [prediction["row"]["object"] for prediction in known]
    report |= scores.errors(true, _column(known, "estimate"), objects)
    report["baselines"] = {other: scores.errors(true, _column(known, other), objects) for other in NAMES} if with_baselines else {}
    report["calibration"] = _calibration(known)
    forces = [prediction["row"]["peak_force_n"] for prediction in known]
    firm = [prediction for prediction, force in zip(known, forces, strict=True) if force is not None and force >= FIRM_N]
    if firm:
        report["firm"] = scores.errors(
            _column(firm, "true"), _column(firm, "estimate"), [prediction["row"]["object"] for prediction in firm]
        )
    return report


def _details(known: list[dict[str, Any]]) -> dict[str, Any]:
    true, said = _column(known, "true"), _column(known, "estimate")
    rows = [prediction["row"] for prediction in known]
    keys = {
        "shape": [row["shape"] for row in rows],
        "radius": ["—" if row["radius_mm"] is None else _band(row["radius_mm"], RADIUS_BANDS_MM) + " mm" for row in rows],
        "hardness": [_band(row["shore_00"], HARDNESS_BANDS) for row in rows],
        "force": ["unknown" if row["peak_force_n"] is None else _band(row["peak_force_n"], FORCE_BANDS) + " N" for row in rows],
    }
    report: dict[str, Any] = {f"by_{name}": scores.error_by(true, said, values) for name, values in keys.items()}
    report["calibration"] = _calibration(known)
    return report


def _calibration(known: list[dict[str, Any]]) -> dict[str, Any] | None:
    spread = _column(known, "spread")
    if not np.isfinite(spread).all():
        return None
    return scores.calibration(_column(known, "true"), _column(known, "estimate"), spread)


def _band(value: float, edges: Sequence[float]) -> str:
    number = int(np.clip(np.searchsorted(edges, value, side="right") - 1, 0, len(edges) - 2))
    return f"{edges[number]:g}–{edges[number + 1]:g}"


def _with_interval(value: float, interval: Sequence[float], digits: int) -> str:
    if np.isnan(value):
        return "—"
    return f"{value:.{digits}f}" + ("" if np.isnan(interval[0]) else f" [{interval[0]:.{digits}f}, {interval[1]:.{digits}f}]")


def _write(out: Path, report: dict[str, Any], found: dict[str, list[dict[str, Any]]]) -> None:
    (out / "table.md").write_text(table(report), encoding="utf-8")
    with whole_file(out / "report.json") as partial:
        partial.write_text(json.dumps(without_nan(report), indent=2) + "\n", encoding="utf-8")
    with (out / "predictions.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        names = ["true", "estimate", "spread", "novelty", "contact"]
        writer.writerow(["split", "index", "object", "shape", "radius_mm", "peak_force_n", *names])
        for split, predictions in found.items():
            for prediction in predictions:
                row = [prediction["row"][key] for key in ("index", "object", "shape", "radius_mm", "peak_force_n")]
                writer.writerow([split, *row, *(prediction[name] for name in names)])
    for split, predictions in found.items():
        known = [prediction for prediction in predictions if prediction["true"] is not None]
        if known:
            plots.against_truth(
                out / f"{split}.png", TITLES.get(split, split), *(_column(known, name) for name in ("true", "estimate", "spread"))
            )
    everything = [prediction for predictions in found.values() for prediction in predictions if prediction["true"] is not None]
    if everything and np.isfinite(_column(everything, "spread")).all():
        plots.spread_honesty(out / "calibration.png", *(_column(everything, name) for name in ("true", "estimate", "spread")))
    if everything:
        plots.errors_by(out / "errors.png", {name: report["all"][f"by_{name}"] for name in ("shape", "radius", "hardness", "force")})


def without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: without_nan(part) for key, part in value.items()}
    if isinstance(value, list):
        return [without_nan(part) for part in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
