"""How well are real things ranked by hardness? Videos of everyday things in three classes, read by networks that saw none of them.

    python docs/studies/hand_presses.py FOLDER --mm-per-px 0.058 --sensor gelsight_mini [--model default] [--sheet forty.png]

FOLDER holds labels.csv (file, object, thing, hardness_rank: 0 soft, 1 moderately hard, 2 hard). Each video is decoded once and read by each
network with gel and scale told, with either, and with neither. Things are split in two by the parity of their place in the alphabet:
choices are made on the first half, the second is held back. Spearman is by object (the mean of its videos' readings), the areas under the
curve by video; one in which no press is found counts as the mean of the others. --csv writes every reading; --sheet draws forty videos,
evenly taken: untouched, pressed, the change tripled, and what the first network says of them, told gel and scale. "unlike" is the share of
videos that are called unlike the training, "not soft" that among things of the other two classes.
"""

import argparse
import csv
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from learn.config import LearnError
from learn.data import UNKNOWN_GEL, Press, choose
from learn.ensemble import Ensemble
from learn.estimate import pick_device
from learn.framing import Framing
from learn.predict import find_models, gel_of_sensor
from learn.scores import spearman
from learn.video import AS_IT_IS, sources

HARD, MODERATE, SOFT = 2, 1, 0


def presses(files: list[Path], ensemble: Ensemble, framing: Framing) -> Iterator[Press | None]:
    """The press of each video as the networks see it; None: none is found."""
    for file in files:
        ((_, read),) = sources(file, ensemble.inputs, framing=framing)
        try:
            yield choose(read().recording, ensemble.inputs, ensemble.repeat)
        except LearnError as error:
            print(error, file=sys.stderr)
            yield None


def area(readings: np.ndarray, above: np.ndarray, below: np.ndarray) -> float:
    """Of the pairs of one that should read higher and one that should read lower, the share that does; ties count half."""
    over = readings[above][:, None] - readings[below][None]
    return float(np.mean((over > 0) + 0.5 * (over == 0)))


def sheet(path: Path, presses: list[Press], words: list[str]) -> None:
    """Draws presses with a line each, four beside each other."""
    from PIL import Image, ImageDraw

    tiles = []
    for press, line in zip(presses, words, strict=True):
        last = press.pictures[-1]
        parts = [press.background, last, 128 + 3 * (last - press.background)]
        tile = Image.fromarray(np.hstack(parts).clip(0, 255).astype(np.uint8))
        framed = Image.new("RGB", (tile.width + 6, tile.height + 20), "white")
        framed.paste(tile, (0, 16))
        ImageDraw.Draw(framed).text((2, 2), line, fill="black")
        tiles.append(np.asarray(framed))
    rows = [np.hstack(tiles[first : first + 4]) for first in range(0, len(tiles) - len(tiles) % 4, 4)]
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.vstack(rows)).save(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--model", action="append", help="a checkpoint, or the name of one that is shipped; may be given several times")
    parser.add_argument("--mm-per-px", type=float, required=True)
    parser.add_argument("--sensor", required=True)
    parser.add_argument("--csv", type=Path, help="where every reading is written")
    parser.add_argument("--sheet", type=Path, help="where forty presses are drawn")
    options = parser.parse_args()
    with (options.folder / "labels.csv").open(newline="") as opened:
        rows = list(csv.DictReader(opened))
    files = [options.folder / row["file"] for row in rows]
    ranks = np.array([int(row["hardness_rank"]) for row in rows])
    things = sorted({row["thing"] for row in rows})
    half = np.array([things.index(row["thing"]) % 2 for row in rows])
    networks = {name: Ensemble(find_models([name]), pick_device("auto")) for name in options.model or ["default"]}
    gel, kept = gel_of_sensor(options.sensor), []
    print("| network | told | half | Spearman by object | hard, soft | hard, moderate | moderate, soft | unlike | not soft | spread |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for scale in (Framing(mm_per_px=options.mm_per_px), AS_IT_IS):
        seen = list(presses(files, next(iter(networks.values())), scale))
        touching = [number for number, press in enumerate(seen) if press is not None]
        for told in (gel, UNKNOWN_GEL):
            words = ", ".join(name for name, known in (("gel", told is gel), ("scale", scale is not AS_IT_IS)) if known) or "nothing"
            for name, ensemble in networks.items():
                said = [ensemble.read([replace(press, gel=told)]) for press in seen if press is not None]
                if options.sheet and not kept:
                    shown = [touching[int(place)] for place in np.linspace(0, len(touching) - 1, 40)]
                    of = {number: part for number, part in zip(touching, said, strict=True)}
                    lines = [f"{rows[n]['object']} (class {ranks[n]} of 0 to 2): Shore 00 {of[n].mean[0]:.0f} +- {of[n].spread[0]:.0f}"
                             for n in shown]  # fmt: skip
                    sheet(options.sheet, [press for n in shown if (press := seen[n]) is not None], lines)
                readings = np.full(len(rows), np.mean([part.mean[0] for part in said]))
                readings[touching] = [part.mean[0] for part in said]
                for part in (0, 1):
                    here = np.flatnonzero(half == part)
                    bodies = sorted({rows[number]["object"] for number in here})
                    of_body = [[number for number in here if rows[number]["object"] == body] for body in bodies]
                    ranked = spearman([ranks[group[0]] for group in of_body], [readings[group].mean() for group in of_body])
                    hard, moderate, soft = (here[ranks[here] == rank] for rank in (HARD, MODERATE, SOFT))
                    areas = (area(readings, *pair) for pair in ((hard, soft), (hard, moderate), (moderate, soft)))
                    inside = {number: part for number, part in zip(touching, said, strict=True) if number in here}
                    strange = {number: part.novelty[0] > 1 for number, part in inside.items()}
                    firm = [alarm for number, alarm in strange.items() if ranks[number] != SOFT]
                    spread = np.mean([part.spread[0] for part in inside.values()])
                    strange_share, firm_share = 100 * np.mean(list(strange.values())), 100 * np.mean(firm)
                    print(f"| {name} | {words} | {'second' if part else 'first'} | {ranked:.2f} | " + " | ".join(f"{a:.2f}" for a in areas)
                          + f" | {strange_share:.0f} % | {firm_share:.0f} % | {spread:.1f} |", flush=True)  # fmt: skip
                kept += [{"network": name, "told": words, "file": row["file"], "reading": f"{reading:.1f}"}
                         for row, reading in zip(rows, readings, strict=True)]  # fmt: skip
    if options.csv:
        with options.csv.open("w", newline="") as opened:
            writer = csv.DictWriter(opened, list(kept[0]))
            writer.writeheader()
            writer.writerows(kept)


if __name__ == "__main__":
    main()
