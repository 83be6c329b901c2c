"""A contact sheet of each group of a dataset: last frames of presses of different objects, with shape and hardness beneath.

    python docs/studies/group_sheets.py DATASET --out docs/images --columns 6 --rows 2

Writes dataset_group_N.jpg for each group that the dataset has.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from PIL import Image, ImageDraw

from gelsim.data.episodes import Dataset, load_dataset

WIDTH = 213
CAPTION = 14


def chosen(data: Dataset, group: int, count: int) -> list[int]:
    """Positions of the deepest presses of up to `count` objects of a group, in turn over its shapes."""
    best: dict[str, int] = {}
    for position, row in enumerate(data.rows):
        if row["group"] == group:
            known = best.get(row["object"])
            if known is None or row["peak_force_n"] > data.rows[known]["peak_force_n"]:
                best[row["object"]] = position
    shapes: dict[str, list[int]] = {}
    for position in best.values():
        shapes.setdefault(data.rows[position]["shape"], []).append(position)
    found: list[int] = []
    while len(found) < count and any(shapes.values()):
        found += [members.pop(0) for members in shapes.values() if members]
    return found[:count]


def caption(row: dict[str, object]) -> str:
    hardness = "rigid" if row["rigid"] else f"00-{row['body_shore_00']:.0f}"
    radius = f" R {row['radius_mm']:.3g}" if row["radius_mm"] else ""
    return f"{row['shape']}{radius}, {hardness}, {row['peak_force_n']:.1f} N"


def sheet(data: Dataset, positions: list[int], columns: int) -> Image.Image:
    width, height = data.info["resolution"]
    tall = round(WIDTH * height / width)
    rows = -(-len(positions) // columns)
    made = Image.new("RGB", (columns * WIDTH, rows * (tall + CAPTION)), "white")
    draw = ImageDraw.Draw(made)
    for number, position in enumerate(positions):
        x, y = number % columns * WIDTH, number // columns * (tall + CAPTION)
        made.paste(Image.fromarray(data.read(position).frames[-1]).resize((WIDTH, tall), Image.Resampling.LANCZOS), (x, y))
        draw.text((x + 2, y + tall + 1), caption(data.rows[position]), fill="black")
    return made


def main(dataset: Path, out: Path, columns: int, rows: int) -> list[Path]:
    """Files written."""
    data, written = load_dataset(dataset), []
    out.mkdir(parents=True, exist_ok=True)
    for group in sorted({row["group"] for row in data.rows}):
        path = out / f"dataset_group_{group}.jpg"
        sheet(data, chosen(data, group, columns * rows), columns).save(path, quality=88)
        written.append(path)
    return written


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    parser.add_argument("--columns", type=int, default=6)
    parser.add_argument("--rows", type=int, default=2)
    print(*main(**vars(parser.parse_args())), sep="\n")
