"""What `error_estimate` of report.json is worth: estimates against the errors of the same presses on a finer mesh than `reference`.

    python docs/studies/error_estimate.py [--case "ball" "edge 200" …] [--out out/error_estimate] [--processes N]

Every case is pressed at the three fidelities and once on a mesh with 1.4 times as many edges in contact as `reference` (about three times
its unknowns), which stands for the truth. "Effectivity" is estimate over true error: above 1 the estimate is on the safe side. The force is
that of the last state. The membrane is compared at 121 x 121 points of the gel's outer surface, root mean square of the displacement
vector's error over the points that move by more than 5 % of the largest motion: contact and neighbourhood. A run that was stopped goes on
where it was: solved presses lie in --out. With --processes presses are solved side by side, each on one thread. The table is printed, and
written to table.md in --out.

Left out: errors that all meshes share (load steps, contact law, the object's geometry).
"""

from __future__ import annotations

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from gelsim.bench.presses import ball, hemisphere
from gelsim.errors import GelsimError
from gelsim.fem.indicator import MOVING
from gelsim.mesh import sizing
from gelsim.pipeline import outputs, stages
from gelsim.scene.layers import build_scene
from gelsim.work.workers import in_environment, settings

Layer = dict[str, Any]
LEVELS = ("fast", "balanced", "reference", "truth")
REFERENCE = sizing.SIZES["reference"]
TRUTH = replace(
    REFERENCE, divisions=1.4 * REFERENCE.divisions, finest=REFERENCE.finest / 1.4, rim=REFERENCE.rim / 1.4,
    coarsest_contact=REFERENCE.coarsest_contact / 1.4, growth=0.6, gel_far=2.5e-3, object_far=3.5e-3,
)  # fmt: skip


def _smooth(body: Layer, **press: Any) -> Layer:
    """A frictionless press into the reference gel, 0.8 mm in four steps."""
    made = hemisphere(200.0, 0.499, frames=5, depth_mm=0.8)
    return made | {"object": body, "press": made["press"] | press}


SILICONE: Layer = {"youngs_modulus_kpa": 200.0}
CASES: dict[str, Layer] = {
    "ball": ball(0.499) | {"press": ball(0.499)["press"] | {"frames": 6}},
    "hemisphere 200": hemisphere(200.0, 0.499, frames=6),
    "hemisphere 50": hemisphere(50.0, 0.499, frames=6),
    "cylinder 200": _smooth({"shape": "cylinder", "radius_mm": 5.0} | SILICONE),
    "edge 200": _smooth({"shape": "edge"} | SILICONE),
    "soft punch": _smooth({"shape": "punch", "radius_mm": 3.0} | SILICONE),
    "rigid punch": _smooth({"shape": "punch", "radius_mm": 3.0, "height_mm": 5.0, "rigid": True}, depth_mm=0.5),
    "box 200": _smooth({"shape": "box"} | SILICONE),
    "ball into the dome, friction": {
        "object": {"shape": "hemisphere", "radius_mm": 4.0, "height_mm": 8.0, "rigid": True},
        "press": {"depth_mm": 0.8, "force_n": "none", "frames": 5},
    },
}


def solve(case: str, level: str, folder: Path) -> dict[str, Any]:
    """Force [N], surface displacements (P, 3) [m] and estimates of the last state."""
    path = folder / f"{case.replace(' ', '_').replace(',', '')}_{level}.npz"
    if not path.exists():
        sizing.SIZES["reference"] = TRUTH if level == "truth" else REFERENCE
        fidelity = "reference" if level == "truth" else level
        press = stages.press(build_scene(CASES[case] | {"press": CASES[case]["press"] | {"symmetry": "mirror"}, "fidelity": fidelity}))
        half = press.gel.rest[:, :2].max() - 1e-9
        line = np.linspace(-half, half, 121)
        points = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
        estimate: Any = press.report.error_estimate
        folder.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part.npz")
        np.savez(
            part, force=-press.force[-1, 2], surface=outputs.sample_surface(press.gel, points)[1][-1], of_force=estimate.force,
            of_membrane_um=estimate.membrane_um, unknowns=press.report.unknowns,
        )  # fmt: skip
        part.replace(path)
    with np.load(path) as stored:
        return {name: stored[name] for name in stored.files}


def solve_all(cases: list[str], folder: Path, processes: int) -> None:
    """Fills the folder; a press that cannot be solved is told and left out."""
    with in_environment(settings(1)), ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        asked = {pool.submit(solve, case, level, folder): (case, level) for level in reversed(LEVELS) for case in cases}  # longest first
        for done in as_completed(asked):
            error = done.exception()
            print(*asked[done], f"{type(error).__name__}: {error}" if error else "solved", file=sys.stderr, flush=True)


def main(cases: list[str], folder: Path, processes: int = 1) -> list[dict[str, Any]]:
    """Prints and writes the table and returns its rows."""
    rows, lines = [], []

    def say(line: str) -> None:
        print(line, flush=True)
        lines.append(line)

    if processes > 1:
        solve_all(cases, folder, processes)
    say("| case | fidelity | unknowns | force error [%] | estimate [%] | effectivity | membrane error [µm] | estimate [µm] | effectivity |")
    say("|---|---|---|---|---|---|---|---|---|")
    for case in cases:
        try:
            truth = solve(case, LEVELS[-1], folder)
        except GelsimError as error:
            say(f"| {case} | the finer mesh: {error} |  |  |  |  |  |  |  |")
            continue
        motion = np.linalg.norm(truth["surface"], axis=1)
        near = motion > MOVING * motion.max()
        for level in LEVELS[:-1]:
            try:
                found = solve(case, level, folder)
            except GelsimError as error:
                say(f"| {case} | {level}: {error} |  |  |  |  |  |  |  |")
                continue
            force = abs(float(found["force"] / truth["force"] - 1))
            membrane = 1e6 * float(np.sqrt(((found["surface"] - truth["surface"])[near] ** 2).sum(1).mean()))
            row = {
                "case": case, "fidelity": level, "unknowns": int(found["unknowns"]), "force": force, "of_force": float(found["of_force"]),
                "membrane": membrane, "of_membrane": float(found["of_membrane_um"]),
            }  # fmt: skip
            rows.append(row)
            safe = row["of_force"] / force, row["of_membrane"] / membrane
            say(
                f"| {case} | {level} | {row['unknowns']} | {100 * force:.2f} | {100 * row['of_force']:.1f} | {safe[0]:.1f} "
                f"| {membrane:.1f} | {row['of_membrane']:.1f} | {safe[1]:.1f} |"
            )
    for level in LEVELS[:-1]:
        part = [row for row in rows if row["fidelity"] == level]
        if part:
            medians = np.median([[row["of_force"], row["of_membrane"]] for row in part], axis=0)
            print(f"{level}: median of the estimates {100 * medians[0]:.2g} % of force, {medians[1]:.2g} µm of the membrane")
    (folder / "table.md").write_text("\n".join(lines) + "\n")
    return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--case", nargs="+", default=list(CASES), choices=list(CASES))
    parser.add_argument("--out", type=Path, default=Path("out/error_estimate"))
    parser.add_argument("--processes", type=int, default=1)
    arguments = parser.parse_args()
    main(arguments.case, arguments.out, arguments.processes)
