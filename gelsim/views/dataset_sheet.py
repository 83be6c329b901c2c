"""What a dataset holds: counts in words, and a sheet with hardness by shape, example frames and force over depth."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.data.episodes import Dataset, lit
from gelsim.results import Episode

EXAMPLES_A_GROUP = 3
"""Episodes of each group on the sheet."""
SHOWN = 5
"""Frames of an example: the no-contact frame, and evenly spread ones up to the last."""
CURVES = 60
"""Force-depth curves at most."""
HARDNESS_STEP = 10.0


def dataset_facts(data: Dataset) -> dict[str, Any]:
    """Counts by group, shape, hardness and split; failures by status."""
    rows = data.rows
    forces = [row["peak_force_n"] for row in rows if row["peak_force_n"] is not None]
    return {
        "domain": data.info.get("domain"),
        "plan": data.info.get("plan"),
        "seed": data.info.get("seed"),
        "pictures": "{} x {}".format(*data.info.get("resolution", ["?", "?"])),
        "episodes": len(rows),
        "frames": sum(row["frames"] for row in rows),
        "objects": len({row["object"] for row in rows}),
        "mechanics_runs": len({row["mechanics"] for row in rows}),
        "groups": _counts(row["group"] for row in rows),
        "motions": _counts(row["motion"] for row in rows),
        "shapes": _counts(row["shape"] for row in rows),
        "splits": {name: len(members) for name, members in data.splits.items() if members},
        "hardness": _counts(_hardness(row) for row in rows),
        "peak_force_n": [float(value) for value in np.percentile(forces, [0, 50, 100])] if forces else [],
        "failures": _counts(row.get("status", "?") for row in data.failures),
    }


def hardness_by_shape(data: Dataset) -> tuple[list[str], list[str], NDArray[np.int64]]:
    """Shapes, hardness classes, and how many episodes of each: (S, H)."""
    shapes = sorted({row["shape"] for row in data.rows})
    classes = sorted({_hardness(row) for row in data.rows}, key=lambda name: (not name[0].isdigit(), name.zfill(7)))
    table = np.zeros((len(shapes), len(classes)), np.int64)
    for row in data.rows:
        table[shapes.index(row["shape"]), classes.index(_hardness(row))] += 1
    return shapes, classes, table


def draw_dataset(out: Path, data: Dataset) -> None:
    """Draws the sheet into a PNG file."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    examples = _examples(data)
    figure = Figure(figsize=(13, 4.5 + 1.05 * len(examples)), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    parts: Any = figure.subfigures(2, 1, height_ratios=[4.5, max(1.05 * len(examples), 0.1)])
    top, bottom = parts
    left, right = top.subplots(1, 2)
    _draw_table(left, data)
    _draw_curves(right, data)
    if examples:
        axes = bottom.subplots(len(examples), SHOWN, squeeze=False)
        for line, (row, frames) in zip(axes, examples, strict=True):
            for axis, frame in zip(line, frames, strict=True):
                axis.imshow(frame, interpolation="nearest")
                axis.set_axis_off()
            line[0].set_title(_said(row), fontsize=7, loc="left", pad=2)
    figure.savefig(out)


def contact_sheet(data: Dataset, group: int, across: int = 6, down: int = 4, width: int = 120) -> NDArray[np.uint8]:
    """The last frames of a group's episodes side by side, each of another object while there are some: (H, W, 3)."""
    from PIL import Image

    chosen: list[int] = []
    seen: set[str] = set()
    members = [i for i, row in enumerate(data.rows) if row["group"] == group and lit(row)]
    for fresh in (True, False):
        for i in members:
            if len(chosen) < across * down and i not in chosen and (data.rows[i]["object"] not in seen or not fresh):
                chosen.append(i)
                seen.add(data.rows[i]["object"])
    pictures = []
    for i in sorted(chosen):
        frame = Image.fromarray(data.read(i).frames[-1])
        pictures.append(np.array(frame.resize((width, round(width * frame.height / frame.width)), Image.Resampling.LANCZOS)))
    if not pictures:
        return np.zeros((1, 1, 3), np.uint8)
    blank = np.full_like(pictures[0], 255)
    pictures += [blank] * (-len(pictures) % across)
    return np.concatenate([np.concatenate(pictures[i : i + across], axis=1) for i in range(0, len(pictures), across)], axis=0)


def _examples(data: Dataset) -> list[tuple[dict[str, Any], list[NDArray[np.uint8]]]]:
    found = []
    for group in sorted({row["group"] for row in data.rows}):
        members = [i for i, row in enumerate(data.rows) if row["group"] == group and lit(row)]
        for i in members[:: max(len(members) // EXAMPLES_A_GROUP, 1)][:EXAMPLES_A_GROUP]:
            episode = data.read(i)
            steps = np.linspace(0, len(episode.frames) - 1, SHOWN).round().astype(int)
            found.append((episode.row, [episode.background, *(episode.frames[k] for k in steps[1:])]))
    return found


def _draw_table(axis: Any, data: Dataset) -> None:
    shapes, classes, table = hardness_by_shape(data)
    axis.set_title("episodes by shape and hardness [Shore 00]", fontsize=9)
    if not table.size:
        return
    axis.imshow(table, cmap="Blues", aspect="auto", vmin=0)
    axis.set_xticks(range(len(classes)), classes, fontsize=7, rotation=45)
    axis.set_yticks(range(len(shapes)), shapes, fontsize=7)
    for (row, column), count in np.ndenumerate(table):
        if count:
            axis.text(
                column, row, str(count), ha="center", va="center", fontsize=6, color="white" if count > 0.6 * table.max() else "black"
            )


def _draw_curves(axis: Any, data: Dataset) -> None:
    axis.set_title("normal force over approach, colour = Shore 00 (black: none)", fontsize=9)
    axis.set_xlabel("approach [mm]", fontsize=8)
    axis.set_ylabel("force [N]", fontsize=8)
    from matplotlib import colormaps

    for i in range(0, len(data), max(len(data) // CURVES, 1)):
        episode = data.read(i)
        if np.isfinite(episode.approach).all() and np.isfinite(episode.force).all():
            axis.plot(episode.approach * 1e3, -episode.force[:, 2], lw=0.8, color=_colour(episode, colormaps["viridis"]))


def _colour(episode: Episode, colours: Any) -> Any:
    shore = episode.row["shore_00"]
    return "black" if shore is None else colours(shore / 100)


def _said(row: dict[str, Any]) -> str:
    hardness = "rigid" if row["rigid"] else "unknown" if row["shore_00"] is None else f"00-{row['shore_00']:g}"
    radius = f" R {row['radius_mm']:.3g}" if row["radius_mm"] else ""
    force = f", {row['peak_force_n']:.2g} N" if row["peak_force_n"] is not None else ""
    return f"{row['index']}: group {row['group']}, {row['shape']}{radius}, {hardness}, {row['motion']}{force}"


def _hardness(row: dict[str, Any]) -> str:
    if row["rigid"]:
        return "rigid"
    if row["shore_00"] is None:
        return "unknown"
    low = int(row["shore_00"] // HARDNESS_STEP * HARDNESS_STEP)
    return f"{low}-{low + int(HARDNESS_STEP)}"


def _counts(values: Any) -> dict[str, int]:
    return {str(key): count for key, count in sorted(Counter(values).items(), key=lambda item: str(item[0]))}
