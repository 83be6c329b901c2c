"""Where the milliseconds of a traced picture go, and how many baked ones a second: on the CPU or a GPU.

    python docs/studies/optics_speed.py --device cuda                     # 640x480, under a minute and a half on a GPU (without a bake)
    python docs/studies/optics_speed.py --device cpu --resolution 160x120
    python docs/studies/optics_speed.py --device cuda --video             # the last table alone, under a minute

*Whole.* `Renderer.radiance`: membrane to the device, picture back, each frame. *Parts.* The same with a part switched off, or a part
alone; each ends with a wait for the device. *Baked.* From the cache, or measured first. With `upload` the membrane goes to the device
and the picture comes back, each frame; with `launch` the membranes are there, and each frame is waited for; `in flight` 32 of them a
launch.
*Video.* Frames as `render_frames` yields them: membrane to the device, linear and 8-bit picture, heights and marker centres back, a new
membrane each frame, the next prepared while one is drawn.
The table of all modes with their errors is `gelsim bench --only optics`.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from gelsim.bench.optics import DENT, bench_scene, seconds_a_call
from gelsim.optics import bake, choose_variant, render_frames
from gelsim.optics.baked import BakedRenderer
from gelsim.optics.probes import dented_membrane
from gelsim.optics.render import Renderer
from gelsim.optics.variant import use_variant


class Unshadowed:
    """A traced scene in which nothing hides anything."""

    def __init__(self, scene: Any) -> None:
        self._scene = scene

    def __getattr__(self, name: str) -> Any:
        return getattr(self._scene, name)

    def ray_test(self, ray: Any, active: Any = True) -> Any:
        return ray.maxt < 0


def say(name: str, work: Callable[[], Any], note: str = "", frames: int = 1) -> None:
    milliseconds = 1e3 * seconds_a_call(work, 0.5) / frames
    print(f"| {name} | {milliseconds:.2f} | {1e3 / milliseconds:.0f} | {note} |", flush=True)


def noise(renderer: Renderer, membrane: Any) -> str:
    pictures = np.array([renderer.radiance(membrane, seed) for seed in range(4)])
    mean = pictures.mean(axis=0)
    lit = mean > 0.02 * mean.max()
    share = pictures.std(axis=0, ddof=1)[lit] / mean[lit]
    return f"noise: median {100 * np.median(share):.2f} %, rms {100 * np.sqrt(np.mean(share**2)):.2f} %"


def traced(variant: Any, size: tuple[int, int], membrane: Any) -> None:
    use_variant(variant)
    import drjit as dr

    for mode in ("path", "direct"):
        for spp in (1, 4, 16, 64):
            renderer = Renderer(bench_scene(size, mode, spp), variant)
            say(f"{mode}, {spp}, whole", partial(renderer.radiance, membrane), noise(renderer, membrane))
    tracer = Renderer(bench_scene(size, "path", 64), variant)._tracer
    direct = Renderer(bench_scene(size, "direct", 64), variant)._tracer

    def done(value: Any) -> None:
        dr.eval(value)
        dr.sync_thread()

    say("membrane to the device", lambda: done(tracer.place(membrane)))
    direct.place(membrane)
    say("path, 64, picture alone", lambda: done(tracer.picture(0)))
    say("direct, 64, picture alone", lambda: done(direct.picture(0)), "the difference: gathering at the vertices")
    say("gathering's first part", lambda: done(tracer._glow(0)), "the membrane's own radiance")
    say("heights, a ray a pixel", lambda: done(tracer.height()), "64 times that: the camera's rays")
    direct._traced = Unshadowed(direct._traced)
    say("direct, 64, no shadow rays", lambda: done(direct.picture(0)))
    start = time.perf_counter()
    value = tracer.picture(0)
    print(f"| tracing one picture in Python | {1e3 * (time.perf_counter() - start):.2f} | | before the device is waited for |")
    done(value)
    print("", flush=True)


def video(variant: Any, size: tuple[int, int], count: int = 16) -> None:
    membranes = [dented_membrane(bench_scene(size), DENT + number % 4) for number in range(count)]
    print("| video | ms a frame | frames a second | |\n|---|---|---|---|", flush=True)
    settings = [("path", 64), ("path", 16), ("direct", 64)]
    if bake.field_path(bench_scene(size)).exists():
        settings.append(("baked", 1))
    for mode, spp in settings:
        scene = bench_scene(size, mode, spp)
        renderer = BakedRenderer(scene, bake.light_field(scene, variant), variant) if mode == "baked" else Renderer(scene, variant)

        def draw(scene: Any = scene, renderer: Any = renderer) -> None:
            for _ in render_frames(scene, membranes, variant=variant, renderer=renderer):
                pass

        say(f"{mode}, {spp}", draw, frames=count)


def baked(variant: Any, size: tuple[int, int], membrane: Any) -> None:
    use_variant(variant)
    import drjit as dr

    scene = bench_scene(size)
    start = time.perf_counter()
    there = bake.field_path(scene).exists()
    field = bake.light_field(scene, variant)
    print(f"light field {'read' if there else 'measured'} in {time.perf_counter() - start:.1f} s; its errors {field.errors}\n")
    renderer = BakedRenderer(scene, field, variant)

    def launched(uploaded: Any) -> None:
        dr.eval(renderer.launch(uploaded))
        dr.sync_thread()

    print("| baked | ms a frame | frames a second | |\n|---|---|---|---|")
    say("upload, picture back", lambda: renderer.radiance(membrane))
    for frames, name in ((1, "launch, waited for"), (32, "in flight, 32 a launch")):
        uploaded = renderer.upload([dented_membrane(scene, DENT + number) for number in range(frames)])

        say(name, partial(launched, uploaded), frames=frames)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="auto", choices=("auto", "cpu", "cuda"))
    parser.add_argument("--resolution", default="640x480")
    parser.add_argument("--no-baked", action="store_true", help="leave out the light field, which may have to be measured first")
    parser.add_argument("--video", action="store_true", help="whole frames alone; baked if its light field is in the cache")
    given = parser.parse_args()
    width, height = map(int, given.resolution.split("x"))
    choice = choose_variant(given.device)
    if given.video:
        print(f"{choice.name}, {width} x {height}\n")
        video(choice, (width, height))
        raise SystemExit
    print(f"{choice.name}, {width} x {height}\n\n| traced | ms | a second | |\n|---|---|---|---|", flush=True)
    surface = dented_membrane(bench_scene((width, height)), DENT)
    traced(choice, (width, height), surface)
    if not given.no_baked:
        baked(choice, (width, height), surface)
    video(choice, (width, height))
