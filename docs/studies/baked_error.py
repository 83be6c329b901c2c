"""How far `baked` pictures are from converged `path` ones, on presses the light field was not made from; and what a frame costs.

    python docs/studies/baked_error.py                        # 44 surfaces, some 20 minutes; --quick: 4
    python docs/studies/baked_error.py --sensor fingertip2017 --worst worst.png
    python docs/studies/baked_error.py --speed --device cuda  # frames a second, everything on the device; --rest: over a measured rest

*Surfaces.* 20 solved presses (`fast`: rigid and soft balls, cylinders, boxes, cones, edges, corners, punches, rods, tilted, off the centre)
and 24 dents by geometry (`optics.probes.dented_membrane`: balls, rods, boxes, wedges and rings, up to 1.2 mm deep, seeds the bake does not
use). Nothing in the bake was chosen by them.
*Reference.* The mean of 8 `path` pictures of 16 paths a pixel, each with its own random numbers. Its noise, part of every difference, is
told by its two halves.
*Measures.* On 8-bit sRGB without camera noise, markers and grain included: PSNR over all pixels and channels, ΔE2000 by pixel.
"""

from __future__ import annotations

import argparse
import multiprocessing
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import SolveError
from gelsim.optics import choose_variant, light_field, render_frames
from gelsim.optics.bake import UNSEEN, colour_difference
from gelsim.optics.baked import BakedRenderer
from gelsim.optics.isp import develop, without_noise
from gelsim.optics.probes import dented_membrane
from gelsim.optics.render import Renderer
from gelsim.optics.variant import use_variant
from gelsim.pipeline import stages
from gelsim.results import Membrane
from gelsim.scene.definition import Render, Scene
from gelsim.scene.layers import build_scene
from gelsim.work.workers import in_environment, settings

REFERENCE_SPP, REFERENCE_PICTURES = 16, 8
PRESSES: list[dict[str, Any]] = [
    {"object": {"shape": "hemisphere", "rigid": True, "radius_mm": 2.0, "height_mm": 5.0}, "press": {"depth_mm": 0.8}},
    {"object": {"shape": "hemisphere", "rigid": True, "radius_mm": 4.0}, "press": {"depth_mm": 1.0}},
    {"object": {"shape": "hemisphere", "rigid": True, "radius_mm": 6.0}, "press": {"depth_mm": 1.0, "offset_mm": [4.0, -3.0]}},
    {"object": {"shape": "hemisphere", "rigid": True, "radius_mm": 3.0}, "press": {"depth_mm": 0.8, "offset_mm": [-5.0, 3.0]}},
    {"object": {"shape": "hemisphere", "shore_00": 30.0, "radius_mm": 5.0}, "press": {"depth_mm": 1.2}},
    {"object": {"shape": "hemisphere", "shore_00": 60.0, "radius_mm": 10.0}, "press": {"depth_mm": 1.0}},
    {"object": {"shape": "cylinder", "rigid": True, "radius_mm": 3.0}, "press": {"depth_mm": 0.8}},
    {"object": {"shape": "cylinder", "rigid": True, "radius_mm": 2.0}, "press": {"depth_mm": 0.7, "tilt_deg": [4.0, 0.0]}},
    {"object": {"shape": "cylinder", "shore_00": 40.0, "radius_mm": 5.0}, "press": {"depth_mm": 1.0}},
    {"object": {"shape": "box", "rigid": True, "width_mm": 5.0, "length_mm": 4.0}, "press": {"depth_mm": 0.6}},
    {"object": {"shape": "box", "rigid": True, "width_mm": 6.0, "length_mm": 6.0}, "press": {"depth_mm": 0.7, "tilt_deg": [3.0, 5.0]}},
    {"object": {"shape": "cone", "rigid": True}, "press": {"depth_mm": 0.8}},
    {"object": {"shape": "cone", "rigid": True}, "press": {"depth_mm": 0.6, "offset_mm": [3.0, 3.0]}},
    {"object": {"shape": "edge", "rigid": True}, "press": {"depth_mm": 0.6}},
    {"object": {"shape": "edge", "rigid": True}, "press": {"depth_mm": 0.5, "tilt_deg": [3.0, 0.0]}},
    {"object": {"shape": "corner", "rigid": True}, "press": {"depth_mm": 0.6}},
    {"object": {"shape": "punch", "rigid": True, "radius_mm": 3.0}, "press": {"depth_mm": 0.6}},
    {"object": {"shape": "punch", "rigid": True, "radius_mm": 2.0}, "press": {"depth_mm": 0.5, "offset_mm": [-4.0, 2.0]}},
    {"object": {"shape": "frustum", "rigid": True}, "press": {"depth_mm": 0.6}},
    {"object": {"shape": "hemisphere", "rigid": True, "radius_mm": 4.0}, "press": {"depth_mm": 0.8, "shear_mm": [1.0, 0.5]}},
]
DENTS = 24


def sensor_scene(sensor: str, resolution: tuple[int, int], layer: dict[str, Any] | None = None) -> Scene:
    layer = layer or {}
    press = {"frames": 3} | layer.get("press", {})
    parts = {"sensor": {"preset": sensor}, "fidelity": "fast", "press": press, "object": layer.get("object", {"shape": "hemisphere"})}
    scene = build_scene(parts | {"render": {"resolution": list(resolution)}})
    # The camera's noise is the same for both and hides what is asked.
    return without_noise(scene)


def surfaces(sensor: str, resolution: tuple[int, int], quick: bool, workers: int = 1) -> Iterator[tuple[str, Membrane]]:
    """Names and deepest membranes of all dents and presses."""
    scene = sensor_scene(sensor, resolution)
    # The bake judges itself by the first seeds.
    for seed in range(UNSEEN, UNSEEN + (2 if quick else DENTS)):
        yield f"dent {seed}", dented_membrane(scene, seed)
    solve = partial(pressed, sensor, resolution)
    numbers = range(2 if quick else len(PRESSES))
    if workers < 2:
        yield from (found for found in map(solve, numbers) if found)
        return
    with in_environment(settings(1)), ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        solved = list(pool.map(solve, numbers))
    yield from (found for found in solved if found)


def pressed(sensor: str, resolution: tuple[int, int], number: int) -> tuple[str, Membrane] | None:
    """Name and deepest membrane of a press; None where it was not solved."""
    layer = PRESSES[number]
    scene = sensor_scene(sensor, resolution, layer)
    name = f"{layer['object']['shape']} {number}"
    try:
        return name, stages.membranes(scene, stages.press(scene))[-1]
    except SolveError as error:
        print(f"{name} is left out: {error}", flush=True)
        return None


def study(sensor: str, resolution: tuple[int, int], device: str, quick: bool, worst: Path | None, workers: int = 1) -> dict[str, float]:
    variant = choose_variant(device)
    base = sensor_scene(sensor, resolution)
    field = light_field(base, variant)
    print(f"{sensor}: bake {field.errors}", flush=True)
    traced = Renderer(base.replace(render=Render("path", REFERENCE_SPP, resolution)), variant)
    baked = BakedRenderer(base, field, variant)
    rows, pictures = [], []
    print("| surface | PSNR [dB] | noise of path [dB] | ΔE2000 mean | 99 % | worst levels, 99.9 % |\n|---|---|---|---|---|---|", flush=True)
    for name, membrane in surfaces(sensor, resolution, quick, workers):
        pictures_of = [traced.radiance(membrane, seed).astype(float) for seed in range(1, REFERENCE_PICTURES + 1)]
        halves = [np.mean(pictures_of[first::2], axis=0) for first in (0, 1)]
        true, drawn = develop(base, sum(halves) / 2), develop(base, baked.radiance(membrane))
        distance = colour_difference(true, drawn)
        levels = np.abs(true.astype(float) - drawn)
        # The mean of two halves is off by half of what they differ by: 6 dB less.
        noise = psnr(*(develop(base, half) for half in halves)) + 20 * np.log10(2)
        rows.append((psnr(true, drawn), noise, distance.mean(), np.quantile(distance, 0.99), np.quantile(levels, 0.999)))
        pictures.append((true, drawn))
        print(f"| {name} | " + " | ".join(f"{value:.2f}" for value in rows[-1]) + " |", flush=True)
    table = np.array(rows)
    squared = 10 ** (-table[:, 0] / 10)
    result = {
        "surfaces": len(rows),
        "psnr_db": float(-10 * np.log10(squared.mean())),
        "psnr_worst_db": float(table[:, 0].min()),
        "path_noise_db": float(-10 * np.log10((10 ** (-table[:, 1] / 10)).mean())),
        "delta_e_mean": float(table[:, 2].mean()),
        "delta_e_mean_worst": float(table[:, 2].max()),
        "delta_e_p99_worst": float(table[:, 3].max()),
    }
    if worst is not None:
        from PIL import Image

        true, drawn = pictures[int(table[:, 0].argmin())]
        difference = np.clip(128 + 4 * (drawn.astype(float) - true), 0, 255).astype(np.uint8)
        Image.fromarray(np.concatenate([true, drawn, difference], axis=1)).save(worst)
        print(f"{worst}: path, baked, 128 + 4 times the difference of the worst surface")
    print({key: round(value, 3) for key, value in result.items()}, flush=True)
    return result


def psnr(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> float:
    return float(10 * np.log10(255**2 / max(np.mean((one.astype(float) - other) ** 2), 1e-6)))


def speed(sensor: str, resolution: tuple[int, int], device: str, batch: int, repeats: int = 30, rest: bool = False) -> dict[str, float]:
    """Milliseconds a frame, best and median.

    Launch alone (membranes on the device); with upload and linear picture and heights on the host; the same with the 8-bit picture, its
    noise drawn; and frames of a video as `render_frames` yields them, marker centres included, one prepared while another is drawn.
    """
    variant = choose_variant(device)
    use_variant(variant)
    import drjit as dr

    scene = sensor_scene(sensor, resolution)
    # What a rest holds costs nothing, that there is one does.
    evenly = (-0.7, -0.7, -0.7) if rest else scene.camera.rest_smooth
    scene = scene.replace(camera=replace(scene.camera, noise_sd=(2.0, 2.0, 2.0), rest_smooth=evenly))
    field = light_field(scene, variant)
    renderer = BakedRenderer(scene, field, variant)
    membranes = [dented_membrane(scene, UNSEEN + number) for number in range(batch)]
    uploaded = renderer.upload(membranes)

    def launch() -> None:
        dr.eval(renderer.launch(uploaded))
        dr.sync_thread()

    def whole() -> None:
        renderer.pictures(membranes)

    def to_bits() -> None:
        renderer.frames(membranes)

    video = [dented_membrane(scene, UNSEEN + number) for number in range(10)]

    def whole_frames() -> None:
        for _ in render_frames(scene, video, variant=variant, light_field=field, renderer=renderer):
            pass

    result: dict[str, float] = {"batch": batch}
    works = {"launch": (launch, batch), "radiance": (whole, batch), "image": (to_bits, batch), "video": (whole_frames, len(video))}
    for name, (work, frames) in works.items():
        for _ in range(3):  # the first traces and compiles
            work()
        seconds = []
        for _ in range(repeats):
            start = time.perf_counter()
            work()
            seconds.append(time.perf_counter() - start)
        result |= {f"{name}_ms": 1e3 * min(seconds) / frames, f"{name}_median_ms": 1e3 * float(np.median(seconds)) / frames}
    result["launch_per_second"] = 1e3 / result["launch_median_ms"]
    print(variant.name, sensor, resolution, {key: round(value, 3) for key, value in result.items()}, flush=True)
    return result


def main(quick: bool = False) -> dict[str, float]:
    return study("fingertip2017", (160, 120) if quick else (640, 480), "auto", quick, None)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sensor", default="fingertip2017")
    parser.add_argument("--resolution", help="of the pictures: 320x240, for --speed 640x480")
    parser.add_argument("--device", default="auto", choices=("auto", "cpu", "cuda"))
    parser.add_argument("--batch", type=int, default=0, help="frames a launch; 0: 1 on the CPU, 32 on CUDA")
    parser.add_argument("--worst", type=Path)
    parser.add_argument("--workers", type=int, default=1, help="processes that solve the presses")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--speed", action="store_true")
    parser.add_argument("--rest", action="store_true", help="of --speed: with a measured rest")
    given = parser.parse_args()
    width, height = map(int, (given.resolution or ("640x480" if given.speed else "320x240")).split("x"))
    if given.speed:
        frames = given.batch or (32 if choose_variant(given.device).name.startswith("cuda") else 1)
        speed(given.sensor, (width, height), given.device, frames, rest=given.rest)
    else:
        study(given.sensor, (width, height), given.device, given.quick, given.worst, given.workers)
