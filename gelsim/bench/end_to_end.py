"""Section `end-to-end`: what a whole video costs and how far its last picture is from the best that this code can do.

*Scene.* The demo's: a cylinder of Shore 00-30, eleven frames, 320 x 240, without the camera's noise. *Settings.* Every fidelity of the
press with every setting of the light. *Error.* Root mean square of the 8-bit levels of the last picture against `reference` drawn by
eight pictures of 64 paths with other random numbers. Beside it what the press alone leaves, with a converged picture, and what the light
alone leaves, with the `reference` press. *Cost.* Seconds of the press plus frames times the seconds of one picture; kernels, meshes and
the light field are there. Not in it: the membrane, markers and files (about a second and a half, the same for all), and what is made once.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.bench.optics import seconds_a_call
from gelsim.bench.section import Case, Options, Row, Section
from gelsim.errors import SolveStatus
from gelsim.results import Deformation, Membrane
from gelsim.scene.definition import Render, Scene
from gelsim.scene.layers import build_scene

FRAMES = 11
LIGHT = (("direct", 4), ("path", 4), ("path", 16), ("path", 64), ("baked", 1))
BUDGETS = (1.0, 3.0, 10.0, 30.0, 100.0)


def _cases(options: Options) -> Iterator[Case]:
    size = (160, 120) if options.quick else (320, 240)
    best = "balanced" if options.quick else "reference"
    fidelities = ("fast", "balanced") if options.quick else ("fast", "balanced", "reference")
    for fidelity in fidelities:
        for mode, spp in LIGHT[:3] if options.quick else LIGHT:
            said = mode if mode == "baked" else f"{mode}, {spp}"
            yield Case(f"{fidelity}; {said}", functools.partial(_measure, fidelity, mode, spp, size, best))


def _scene(fidelity: str, mode: str, spp: int, size: tuple[int, int]) -> Scene:
    scene = build_scene(
        {"object": {"shape": "cylinder", "shore_00": 30.0}, "fidelity": fidelity, "press": {"frames": FRAMES}},
        {"camera": {"noise_sd": [0.0, 0.0, 0.0], "full_well": [0.0, 0.0, 0.0], "read_noise": [0.0, 0.0, 0.0]}},
    )
    return scene.replace(render=Render(mode, spp, size))


@functools.cache
def _pressed(fidelity: str, size: tuple[int, int]) -> tuple[Membrane, float]:
    """The last state's membrane, and the press's seconds: of the second time, when meshes and kernels are there."""
    from gelsim.pipeline import stages

    scene = _scene(fidelity, "path", 1, size)
    stages.press(scene)
    record = stages.Record()
    pressed: Deformation = stages.press(scene, record=record)
    return stages.membranes(scene, pressed)[-1], record.seconds["press"]


def _picture(fidelity: str, mode: str, spp: int, size: tuple[int, int]) -> Any:
    """A function from seed to the radiance of the fidelity's last state."""
    from gelsim.optics import choose_variant
    from gelsim.optics.bake import light_field
    from gelsim.optics.baked import BakedRenderer
    from gelsim.optics.render import Renderer

    scene, (membrane, _), variant = _scene(fidelity, mode, spp, size), _pressed(fidelity, size), choose_variant()
    if mode == "baked":
        baked = BakedRenderer(scene, light_field(scene, variant), variant)
        return lambda seed: baked.radiance(membrane)
    renderer = Renderer(scene, variant)
    return lambda seed: renderer.radiance(membrane, seed)


@functools.cache
def _converged(fidelity: str, size: tuple[int, int]) -> NDArray[np.uint8]:
    from gelsim.optics.isp import develop

    draw = _picture(fidelity, "path", 64, size)
    mean = np.stack([draw(1000 + seed) for seed in range(8)]).mean(axis=0, dtype=np.float64).astype(np.float32)
    return develop(_scene(fidelity, "path", 64, size), mean)


def _measure(fidelity: str, mode: str, spp: int, size: tuple[int, int], best: str) -> Row:
    from gelsim.optics.isp import develop

    start = time.perf_counter()
    draw, scene = _picture(fidelity, mode, spp, size), _scene(fidelity, mode, spp, size)
    truth = _converged(best, size)
    press, a_picture = _pressed(fidelity, size)[1], seconds_a_call(lambda: draw(0), least=1.0)
    error = _rms(develop(scene, draw(7)), truth)
    return {
        "status": SolveStatus.CONVERGED.name, "press_seconds": round(press, 2), "picture_ms": round(1e3 * a_picture, 1),
        "seconds": round(press + FRAMES * a_picture, 2), "levels_rms": round(error, 3),
        "press_rms": round(_rms(_converged(fidelity, size), truth), 3),
        "light_rms": round(_light_error(best, mode, spp, size), 3),
        "psnr_db": round(20 * np.log10(255 / max(error, 1e-3)), 1), "measured_in": round(time.perf_counter() - start, 1),
    }  # fmt: skip


@functools.cache
def _light_error(best: str, mode: str, spp: int, size: tuple[int, int]) -> float:
    """What a setting of the light leaves with the best press."""
    from gelsim.optics.isp import develop

    return _rms(develop(_scene(best, mode, spp, size), _picture(best, mode, spp, size)(7)), _converged(best, size))


def _rms(picture: NDArray[np.uint8], truth: NDArray[np.uint8]) -> float:
    return float(np.sqrt(np.mean((picture.astype(float) - truth) ** 2)))


def _judge(rows: list[Row]) -> list[Row]:
    """Marks what no other setting beats in both cost and error."""
    return [
        row | {"front": "" if any(o["seconds"] < row["seconds"] and o["levels_rms"] < row["levels_rms"] for o in rows) else "front"}
        for row in rows
        if "seconds" in row
    ]


def _remarks(rows: list[Row]) -> str:
    """What a budget buys, and what the best setting should spend more on."""
    said = []
    for budget in BUDGETS:
        within = [row for row in rows if row["seconds"] <= budget]
        if not within:
            said.append(f"Within {budget:g} s: nothing.")
            continue
        best = min(within, key=lambda row: row["levels_rms"])
        more = "the press" if best["press_rms"] > best["light_rms"] else "the light"
        said.append(
            f"Within {budget:g} s: `{best['name']}`, {best['levels_rms']:g} levels off in {best['seconds']:g} s; "
            f"most of what is left is {more}'s."
        )
    return " ".join(dict.fromkeys(said))


def _draw(rows: list[Row], out: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6.4, 4.2), layout="constrained")
    for fidelity, mark in (("fast", "o"), ("balanced", "s"), ("reference", "^")):
        some = [row for row in rows if row["name"].startswith(fidelity)]
        if some:
            axes.loglog([row["seconds"] for row in some], [row["levels_rms"] for row in some], mark, label=fidelity, markersize=7)
        for row in some:
            light = row["name"].partition("; ")[2]
            axes.annotate(light, (row["seconds"], row["levels_rms"]), textcoords="offset points", xytext=(5, 4), fontsize=7)
    front = sorted((row["seconds"], row["levels_rms"]) for row in rows if row["front"])
    axes.loglog(*zip(*front, strict=True), "-", color="0.6", zorder=0)
    axes.set(xlabel=f"seconds for {FRAMES} frames", ylabel="error of the last picture [levels of 255, RMS]")
    axes.grid(True, which="both", alpha=0.3)
    axes.legend(title="press")
    figure.savefig(out / "end_to_end.png", dpi=110)
    pyplot.close(figure)


SECTION = Section(
    title="End to end",
    columns=(
        ("press; light, paths a pixel", "name"), ("press [s]", "press_seconds"), ("picture [ms]", "picture_ms"), ("video [s]", "seconds"),
        ("error [levels, RMS]", "levels_rms"), ("the press's", "press_rms"), ("the light's", "light_rms"), ("PSNR [dB]", "psnr_db"),
        ("unbeaten", "front"),
    ),
    cases=_cases,
    judge=_judge,
    remarks=_remarks,
    draw=_draw,
)  # fmt: skip
