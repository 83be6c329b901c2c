"""Section `optics`: what a picture costs and how far it is from the converged one, by mode and paths; stock Mitsuba beside it.

*Scene.* The undeformed sensor's preset with two dents by geometry (`optics.probes`), as membrane; no mechanics.
*Error.* Root mean square of the 8-bit levels against the mean of many `path` pictures with other random numbers, over all pixels and
channels. *Noise.* Standard deviation over seeds divided by the mean, median over pixels and channels.
*Others.* `stock` is the same scene (without the window's reflection) by Mitsuba's own path integrator. `Agarwal` is the set-up of Agarwal
et al. (ICRA 2021) by Mitsuba's path integrator: diffuse coat behind a rough dielectric (GGX 0.3, index 1.5403), three area lights outside
it, so that a light is found by chance only. Their scene holds one plane; here it holds our membrane. Their pictures differ, so only noise
and time are compared. `Taxim` (Si and Yuan 2022), where the `taxim` package and JAX are installed, is its picture of a ball, with
its own calibrated sensor and size, without and with shadows; it takes a height map, is not random, and is compared by time alone.
*To 2 %.* From a set-up's last row: noise falls as the paths' power seen between first and last row, the square root at least (what chance
gives); time as a line through both.
"""

from __future__ import annotations

import functools
import importlib.util
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.bench.section import Case, Options, Row, Section
from gelsim.errors import RenderError, SolveStatus
from gelsim.scene.definition import Render, Scene
from gelsim.scene.layers import build_scene

SENSOR = "fingertip2017"
DENT = 9
"""Two bodies at once, with cast shadows; not among those a bake judges itself by."""
SEEDS = 4
GOAL = 0.02
TAXIM_BALL_MM, TAXIM_PIXEL_MM = 4.0, 0.0295
"""Of the ball, chosen; of its sensor, as its calibration says."""
Draw = Callable[[int], NDArray[np.float32]]


def _cases(options: Options) -> Iterator[Case]:
    size = (160, 120) if options.quick else (640, 480)
    for mode in ("path", "direct"):
        for spp in (1, 4, 16) if options.quick else (1, 4, 16, 64):
            yield Case(f"{mode}, {spp}", functools.partial(_measure, mode, spp, size))
    if not options.quick:
        yield Case("baked", functools.partial(_measure, "baked", 1, size))
    for setup in ("stock", "Agarwal"):
        for spp in (4, 16) if options.quick else (16, 64):
            yield Case(f"{setup}, {spp}", functools.partial(_measure, setup, spp, size))
    if all(map(importlib.util.find_spec, ("taxim", "jax"))):
        for shadows in (False, True):
            yield Case(f"Taxim{', shadows' if shadows else ''}", functools.partial(_measure_taxim, shadows))


def _measure_taxim(shadows: bool) -> Row:
    """A ball of 4 mm pressed 1 mm deep, from the object's height over its lowest point [mm] to the picture on the host."""
    simulator = importlib.import_module("taxim").Taxim(backend="jax")
    x, y = np.meshgrid(np.arange(simulator.width) - simulator.width / 2, np.arange(simulator.height) - simulator.height / 2)
    inside = TAXIM_BALL_MM**2 - (x**2 + y**2) * TAXIM_PIXEL_MM**2
    height = (TAXIM_BALL_MM - np.sqrt(np.maximum(inside, 0.0))).astype(np.float32)
    seconds = seconds_a_call(lambda: np.asarray(simulator.render(height, with_shadow=shadows, press_depth=1.0)))
    return {"status": SolveStatus.CONVERGED.name, "setup": "Taxim", "ms": round(1e3 * seconds, 2), "variant": "jax"}


def _measure(setup: str, spp: int, size: tuple[int, int]) -> Row:
    scene = bench_scene(size)
    draw = drawing(setup, spp, size)
    pictures = np.array([draw(seed) for seed in range(SEEDS if setup != "baked" else 1)])
    milliseconds = 1e3 * seconds_a_call(lambda: draw(0))
    row: Row = {"status": SolveStatus.CONVERGED.name, "setup": setup, "spp": spp, "ms": round(milliseconds, 2), "variant": _variant().name}
    if setup != "baked":
        mean = pictures.mean(axis=0, dtype=np.float64)
        lit = mean > 0.02 * mean.max(axis=(0, 1))
        noise = float(np.median(pictures.std(axis=0, ddof=1, dtype=np.float64)[lit] / mean[lit]))
        row["noise_percent"] = round(100 * noise, 3)
    if setup not in ("stock", "Agarwal"):
        from gelsim.optics.isp import develop

        levels = develop(scene, pictures[0]).astype(float) - develop(scene, converged(size))
        row["levels_rms"] = round(float(np.sqrt(np.mean(levels**2))), 3)
        row["psnr_db"] = round(20 * math.log10(255 / row["levels_rms"]), 1)
    return row


def bench_scene(size: tuple[int, int], mode: str = "path", spp: int = 64) -> Scene:
    """The section's scene; without the camera's noise, which hides what is asked."""
    return build_scene({"sensor": {"preset": SENSOR}, "camera": {"noise_sd": [0.0, 0.0, 0.0]}}).replace(render=Render(mode, spp, size))


def seconds_a_call(work: Callable[[], Any], least: float = 1.5) -> float:
    """Median over as many calls as fill `least` seconds, three at least, after two that compile."""
    for _ in range(2):
        work()
    seconds: list[float] = []
    while len(seconds) < 3 or (sum(seconds) < least and len(seconds) < 200):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return float(np.median(seconds))


@functools.cache
def _variant() -> Any:
    from gelsim.optics import choose_variant

    choice = choose_variant()
    if choice.name.startswith("scalar"):
        raise RenderError("the optics section needs libLLVM or CUDA; `gelsim doctor` says what to install")
    return choice


@functools.cache
def _membrane() -> Any:
    from gelsim.optics.probes import dented_membrane

    return dented_membrane(bench_scene((640, 480)), DENT)


def drawing(setup: str, spp: int, size: tuple[int, int]) -> Draw:
    """A function from seed to radiance (H, W, 3) on the host; what is made once a sensor is made before."""
    from gelsim.optics.bake import light_field
    from gelsim.optics.baked import BakedRenderer
    from gelsim.optics.render import Renderer
    from gelsim.optics.variant import use_variant

    variant, membrane = _variant(), _membrane()
    if setup == "baked":
        baked = BakedRenderer(bench_scene(size), light_field(bench_scene(size), variant), variant)
        return lambda seed: baked.radiance(membrane)
    if setup in ("path", "direct"):
        renderer = Renderer(bench_scene(size, setup, spp), variant)
        return lambda seed: renderer.radiance(membrane, seed)
    mi = use_variant(variant)
    stock = (_stock if setup == "stock" else _agarwal)(mi, size)
    return lambda seed: np.array(mi.render(stock, spp=spp, seed=seed), np.float32)


@functools.cache
def converged(size: tuple[int, int]) -> NDArray[np.float32]:
    """Mean of 8 pictures of 64 paths."""
    draw = drawing("path", 64, size)
    return np.array([draw(1000 + seed) for seed in range(8)]).mean(axis=0, dtype=np.float64).astype(np.float32)


def _stock(mi: ModuleType, size: tuple[int, int]) -> Any:
    """The scene as scalar variants draw it."""
    from gelsim.optics.render import membrane_mesh, native
    from gelsim.optics.scene_dict import mesh_arrays, scene_dict

    scene = bench_scene(size)
    parts = {name: native(mi, part) for name, part in scene_dict(scene).items()}
    coating = mi.load_dict(parts.pop("coating"))
    return mi.load_dict({**parts, "membrane": membrane_mesh(mi, mesh_arrays(_membrane(), scene), coating)})


def _agarwal(mi: ModuleType, size: tuple[int, int]) -> Any:
    """Numbers from their published scene file: coat, core, lights and camera about the optical axis, here z; the membrane is at z = 0."""
    from gelsim.optics.render import membrane_mesh
    from gelsim.optics.scene_dict import mesh_arrays

    turn = mi.ScalarTransform4f
    scene = bench_scene(size)
    coat = mi.load_dict({"type": "twosided", "coat": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.506, 0.397, 0.453]}}})
    parts: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 5, "hide_emitters": True},
        "membrane": membrane_mesh(mi, mesh_arrays(_membrane()), coat),
        "core": {
            "type": "rectangle",
            "to_world": turn().translate([0, 0, -scene.gel.thickness_mm]).rotate([1, 0, 0], 180).scale(20.0),
            "bsdf": {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.3, "int_ior": 1.5403, "ext_ior": 1.0},
        },
        "camera": {
            "type": "perspective",
            "fov": math.degrees(2 * math.atan(scene.camera.field_mm[0] / 2 / 41.05)),
            "to_world": turn().look_at([0, 0, -41.05], [0, 0, 0], [0, -1, 0]),
            "film": {"type": "hdrfilm", "width": size[0], "height": size[1], "pixel_format": "rgb", "rfilter": {"type": "box"}},
            "sampler": {"type": "multijitter", "sample_count": 16},
        },
    }
    for number, radiance in enumerate(([5.237, 0.0, 0.0], [0.171, 6.735, 0.0], [0.0, 0.0, 6.839])):
        # A rectangle looks along +z; it is raised to look at the axis and 19 degrees toward the gel.
        pose = turn().rotate([0, 0, 1], 120.0 * number).translate([0, -12.59, -8.793]).rotate([1, 0, 0], -71.0).scale([6.0, 4.45, 1.0])
        light = {"type": "area", "radiance": {"type": "rgb", "value": radiance}}
        parts[f"light_{number}"] = {"type": "rectangle", "to_world": pose, "emitter": light}
    return mi.load_dict(parts)


def _judge(rows: list[Row]) -> list[Row]:
    """Paths and time to the goal, at each set-up's last row."""
    judged = [dict(row) for row in rows]
    for setup in dict.fromkeys(row.get("setup") for row in judged):
        some = [row for row in judged if row.get("setup") == setup and row.get("noise_percent")]
        if len(some) < 2:
            continue
        first, last = some[0], some[-1]
        paths = math.log(last["spp"] / first["spp"])
        fall = math.log(first["noise_percent"] / last["noise_percent"]) / paths
        needed = max(math.ceil(last["spp"] * (last["noise_percent"] / (100 * GOAL)) ** (1 / max(fall, 0.5))), 1)
        a_path = (last["ms"] - first["ms"]) / (last["spp"] - first["spp"])
        last["paths_to_goal"] = needed
        last["ms_to_goal"] = round(max(last["ms"] + a_path * (needed - last["spp"]), 0.0), 1)
    return judged


def _draw(rows: list[Row], out: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6.4, 4.2), layout="constrained")
    for setup, mark in (("path", "o-"), ("direct", "s-"), ("baked", "*")):
        some = [row for row in rows if row.get("setup") == setup]
        if some:
            axes.loglog([row["ms"] for row in some], [row["levels_rms"] for row in some], mark, label=setup, markersize=7)
        for row in some if setup != "baked" else []:
            axes.annotate(str(row["spp"]), (row["ms"], row["levels_rms"]), textcoords="offset points", xytext=(5, 5), fontsize=8)
    axes.set(xlabel="milliseconds a picture", ylabel="error against converged path [levels of 255, RMS]")
    axes.grid(True, which="both", alpha=0.3)
    axes.legend(title="mode; numbers: paths a pixel")
    figure.savefig(out / "optics_speed_error.png", dpi=110)
    pyplot.close(figure)


SECTION = Section(
    title="Light",
    columns=(
        ("set-up, paths a pixel", "name"), ("ms a picture", "ms"), ("noise, median [%]", "noise_percent"),
        ("error [levels, RMS]", "levels_rms"), ("PSNR [dB]", "psnr_db"), ("paths to 2 %", "paths_to_goal"),
        ("ms to 2 %", "ms_to_goal"), ("variant", "variant"),
    ),
    cases=_cases,
    judge=_judge,
    draw=_draw,
)  # fmt: skip
