"""A modulus found again from pictures alone, and with force: `gelsim identify` on presses that other meshes and another renderer made.

    OMP_NUM_THREADS=2 python docs/studies/identify.py [--out out/identify-study] [--truth reference] [--fidelity balanced] [--only NAME]
    OMP_NUM_THREADS=2 python docs/studies/identify.py --photos ../shared/real/mini_markers --fidelity fast

The recordings: pressed at `reference`, traced (`path`), with camera noise; approach, place and hardness are told to nobody. What is said
is compared with what was pressed. Rows marked "wrong" are told something that is not so, to show what that costs.

`--photos`: photographs of a real GelSight Mini under a steel ball of R 2.5 mm, those kept for testing (`contacts.csv`), each with the
picture without contact as a recording of its own; steel must read as hard as the scale goes, or be at its end.
"""

from __future__ import annotations

import argparse
import csv
import shutil
import time
from pathlib import Path
from typing import Any

from gelsim.identify.run import identify
from gelsim.pipeline import stages
from gelsim.scene.layers import Layer, build_scene

BALL: Layer = {"shape": "hemisphere", "radius_mm": 6.0}
ROD: Layer = {"shape": "cylinder", "radius_mm": 5.0}
CASES: dict[str, dict[str, Any]] = {
    "ball 20": {"object": BALL, "shore": 20.0, "depth_mm": 1.4},
    "ball 40": {"object": BALL, "shore": 40.0, "depth_mm": 1.2, "force": True},
    "ball 60": {"object": BALL, "shore": 60.0, "depth_mm": 1.0},
    "ball 40, off centre": {"object": BALL, "shore": 40.0, "depth_mm": 1.2, "offset_mm": [1.5, -1.0]},
    "rod 30": {"object": ROD, "shore": 30.0, "depth_mm": 1.2, "force": True},
    "rod 50, off centre": {"object": ROD, "shore": 50.0, "depth_mm": 1.0, "offset_mm": [-1.0, 0.7]},
    "ball 40, wrong friction": {"object": BALL, "shore": 40.0, "depth_mm": 1.2, "told": {"contact": {"friction_coefficient": 0.4}}},
    "ball 40, wrong gel": {"object": BALL, "shore": 40.0, "depth_mm": 1.2, "told": {"gel": {"modulus_scale": 1.1}}},
}
STICKY = {"friction_coefficient": 0.8}
NOISE = {"noise_sd": [2.0, 2.0, 2.0]}
COLUMNS = (
    "case",
    "told",
    "shore_00",
    "off",
    "sd",
    "approach_off_mm",
    "place_off_mm",
    "force_off_percent",
    "unexplained_percent",
    "seconds",
)


def record(folder: Path, case: dict[str, Any], truth: str) -> None:
    """Makes the case's recording, unless it is there."""
    if (folder / "report.json").exists():
        return
    press = {"depth_mm": case["depth_mm"], "force_n": "none", "frames": 12, "offset_mm": case.get("offset_mm", [0.0, 0.0])}
    scene = build_scene(
        {
            "object": case["object"] | {"shore_00": case["shore"]},
            "contact": STICKY,
            "press": press,
            "fidelity": truth,
        },
        {"camera": NOISE, "render": {"mode": "path", "resolution": [320, 240], "spp": 64}},
    )
    stages.run(scene, folder, force=True)


def forces_of(folder: Path) -> Path:
    """The press's own forces, as a force gauge beside the sensor would have written them."""
    from gelsim.pipeline.outputs import read_press

    press, path = read_press(folder / "press.npz"), folder / "forces.csv"
    with open(path, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["picture", "force_n"])
        writer.writerows(enumerate(-press.force[:, 2]))
    return path


def row(name: str, case: dict[str, Any], folder: Path, fidelity: str, with_force: bool) -> dict[str, Any]:
    """What is said of a recording beside what is true."""
    from gelsim.pipeline.outputs import read_press

    told = build_scene({"object": case["object"], "contact": STICKY, "fidelity": fidelity}, case.get("told", {}))
    forces, begin = forces_of(folder) if with_force else None, time.perf_counter()
    said = identify(folder, told, forces=forces)
    press, last = read_press(folder / "press.npz"), said["pictures"][-1]
    place = case.get("offset_mm", [0.0, 0.0])
    return {
        "case": name, "told": "pictures, force" if with_force else "pictures", "shore_00": said["shore_00"],
        "off": said["shore_00"] - case["shore"], "sd": said["shore_00_sd"],
        "approach_off_mm": last["approach_mm"] - 1e3 * press.approach[last["picture"]],
        "place_off_mm": max(abs(a - b) for a, b in zip(said["place_mm"], place, strict=True)),
        "force_off_percent": 100 * (last["force_n"] / -press.force[last["picture"], 2] - 1),
        "unexplained_percent": 100 * said["unexplained"], "seconds": time.perf_counter() - begin,
    }  # fmt: skip


def photographed(photos: Path, out: Path, fidelity: str, most: int) -> None:
    """Prints what is said of a steel ball in real photographs, a line each."""
    with open(photos / "contacts.csv", newline="") as file:
        names = [line["file"] for line in csv.DictReader(file) if line["half"] == "test"][:most]
    scene = build_scene(
        {"sensor": {"preset": "gelsight_mini_markers"}, "object": {"shape": "hemisphere", "radius_mm": 2.5}, "fidelity": fidelity},
        {"contact": STICKY},
    )
    for name in names:
        folder = out / "photos" / Path(name).stem
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copy(photos / "no_contact.png", folder / "0.png")
        shutil.copy(photos / name, folder / "1.png")
        begin, said = time.process_time(), identify(folder, scene)
        last = said["pictures"][-1]
        hard = f"Shore 00 {said['shore_00'] or float('nan'):.1f}, E {said['youngs_modulus_kpa']:.0f} kPa"
        pressed = f"{last['approach_mm']:.2f} mm, {last['force_n']:.2f} N, {100 * said['unexplained']:.0f} % not explained"
        print(f"{name}: {hard}, {pressed}, {time.process_time() - begin:.0f} s", flush=True)


def main(out: Path, truth: str, fidelity: str, only: str | None) -> None:
    """Prints a line a case, and writes identify.csv."""
    rows = []
    for name, case in CASES.items():
        if only is not None and only != name:
            continue
        same = next(other for other, of in CASES.items() if {**of, "told": 0, "force": 0} == {**case, "told": 0, "force": 0})
        folder = out / same.replace(", ", "-").replace(" ", "-")
        record(folder, case, truth)
        for with_force in (False, True) if case.get("force") else (False,):
            rows.append(row(name, case, folder, fidelity, with_force))
            print("  ".join(f"{value:9.3f}" if isinstance(value, float) else f"{value:<24}" for value in rows[-1].values()), flush=True)
    with open(out / "identify.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/identify-study"))
    parser.add_argument("--truth", default="reference", choices=("fast", "balanced", "reference"))
    parser.add_argument("--fidelity", default="balanced", choices=("fast", "balanced", "reference"))
    parser.add_argument("--only", choices=tuple(CASES))
    parser.add_argument("--photos", type=Path)
    parser.add_argument("--most", type=int, default=4, help="photographs at most")
    options = parser.parse_args()
    if options.photos:
        photographed(options.photos, options.out, options.fidelity, options.most)
        raise SystemExit
    main(options.out, options.truth, options.fidelity, options.only)
