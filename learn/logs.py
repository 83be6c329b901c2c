"""Curves of a training: TensorBoard events, a CSV that anything reads, and a picture of it."""

from __future__ import annotations

import csv
from pathlib import Path

from tensorboardX import SummaryWriter

CURVES = "curves.csv"


class Curves:
    """Scalars by step, written as they come; a run that goes on drops what was written after the step it goes on from."""

    def __init__(self, folder: Path, first_step: int) -> None:
        self._path = folder / CURVES
        self._rows = [row for row in read_curves(folder) if row[0] < first_step] if first_step else []
        self._file = self._path.open("w", newline="", encoding="utf-8")
        self._csv = csv.writer(self._file)
        self._csv.writerow(("step", "name", "value"))
        self._csv.writerows((step, name, repr(value)) for step, name, value in self._rows)
        self._events = SummaryWriter(str(folder / "tensorboard"), purge_step=first_step or None, write_to_disk=True)

    def add(self, step: int, **values: float) -> None:
        for name, value in values.items():
            self._rows.append((step, name, value))
            self._csv.writerow((step, name, repr(value)))
            self._events.add_scalar(name, value, step)

    def draw(self) -> None:
        """Brings curves.csv and curves.png up to date."""
        self._file.flush()
        from matplotlib.figure import Figure

        names = sorted({name for _, name, _ in self._rows})
        figure = Figure(figsize=(4 * max(len(names), 1), 3), layout="constrained")
        for name, axes in zip(names, figure.subplots(1, max(len(names), 1), squeeze=False)[0], strict=False):
            points = [(step, value) for step, other, value in self._rows if other == name]
            axes.plot(*zip(*points, strict=True), linewidth=1)
            axes.set(title=name, xlabel="step")
            axes.grid(alpha=0.3)
        figure.savefig(self._path.with_suffix(".png"), dpi=100)

    def close(self) -> None:
        self._file.close()
        self._events.close()


def read_curves(folder: Path) -> list[tuple[int, str, float]]:
    """The rows (step, name, value) of a run's curves.csv; none where there is none."""
    try:
        with (folder / CURVES).open(newline="", encoding="utf-8") as file:
            return [(int(row["step"]), row["name"], float(row["value"])) for row in csv.DictReader(file)]
    except FileNotFoundError:
        return []
