"""Measures a sensor's light field, once, and how far pictures made from it are from path-traced ones.

*Local part.* An integral over each lamp at every place and normal of the table (`optics.unshadowed`), exact at the nodes; then the colours
of a light are reduced to as few components as hold all but 0.3 % of it. What the paint of markers returns falls out.

*Light from elsewhere.* On bumpy probe membranes the difference of the two modes, path and direct, is fitted per channel by a gain times the
estimate of `optics.baked` and a smooth function of place (what the window throws back).

*Error.* Other membranes, with other shapes, are drawn both ways. They are used for nothing else.

The key of the cache holds all of the scene that decides the field, and the source of this package: what was measured with another light
transport is measured again.
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.metadata
import json
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.data import lightfield
from gelsim.data.lightfield import PACKET, LightField, read_field, write_field
from gelsim.files import cache_folder, digest
from gelsim.membrane.surface import rest_membrane
from gelsim.optics.baked import BakedRenderer, straight_rays
from gelsim.optics.isp import develop, without_noise
from gelsim.optics.probes import bumpy_membrane, dented_membrane
from gelsim.optics.render import Renderer, drawn_by
from gelsim.optics.spectra import light_colour
from gelsim.optics.unshadowed import unshadowed_light
from gelsim.optics.variant import VariantChoice
from gelsim.scene.definition import Render, Scene

NORMALS = 40
"""Of n_x and of n_y: steps of 0.05; a straight line across the end of a light's cosine errs by a 160th of the light's full strength."""
STEEPEST = 0.96
"""n_x and n_y of the outermost nodes: 74 degrees."""
PLACES = (20, 15)
"""Nodes of x and y: steps of 1 mm, over which a light 20 mm away bends from a straight line by 0.2 %."""
HEIGHTS_MM = (-0.4, -2.0)
"""Of the two layers; a dome's rim and a deep dent reach 3 mm."""
RANK_LEFT = 3e-3
PROBES, PROBE_SPP = 6, 16
UNSEEN, UNSEEN_SPP = 8, 16
"""Paths of each of two pictures of a membrane, whose noise is not the other's. With 8 a fingertip2017's worst is told as 43.3 dB, with 16
44.2, with 32 44.3."""
PROBE_RESOLUTION = 240
PROBE_SPACING = 0.16e-3
"""Of the membranes' grids [m], twice a press's: pictures of 44 other surfaces are then 46.9 dB from traced ones as with 0.08, in half the
time; 0.24 mm: 46.8."""

AFTER_LIGHT = (
    "resolution",
    "fps",
    "exposure",
    "white_balance",
    "noise_sd",
    "shading",
    "fresnel",
    "full_well",
    "read_noise",
    "tone",
    "gamma",
    "rest",
    "rest_smooth",
)
"""Of the camera's fields, those that `optics.isp` answers for: they change the picture and not the light."""

Progress = Callable[[str, int, int], None]


def light_field(scene: Scene, variant: VariantChoice, progress: Progress | None = None) -> LightField:
    """The scene's light field: from the cache, or measured now (seconds) and kept there."""
    path = field_path(scene)
    found = read_field(path)
    if found is None:
        found = measure(scene, variant, progress or _say)
        try:
            write_field(path, found)
        except OSError:
            pass  # A cache that cannot be written costs a bake each time, nothing else.
    return found


def settle_mode(scene: Scene) -> tuple[Scene, str | None]:
    """The scene with mode "auto" replaced by what is to be drawn, and why that; others as they are, and None."""
    if scene.render.mode != "auto":
        return scene, None
    found, least = read_field(field_path(scene)), scene.render.least_psnr_db
    worst = None if found is None else found.errors.get("psnr_worst_db")
    if found is None:
        mode, why = "path", "the sensor's light field is not measured yet; --mode baked does so, once"
    elif worst is None or worst < least:
        mode, why = "path", f"the sensor's light field is right to {worst} dB at its worst; asked was render.least_psnr_db = {least:g} dB"
    else:
        mode, why = "baked", f"the sensor's light field is measured, and right to {worst} dB at its worst; asked was {least:g} dB"
    return scene.replace(render=replace(scene.render, mode=mode)), why


def field_path(scene: Scene) -> Path:
    return cache_folder("lightfields") / f"{field_key(scene)}.npz"


def field_key(scene: Scene) -> str:
    """Hash of everything the field depends on; not the resolution, nor what comes after the light (exposure, noise)."""
    camera, gel = dataclasses.asdict(scene.camera), dataclasses.asdict(scene.gel)
    for later in AFTER_LIGHT:
        camera.pop(later, None)
    shape = {name: gel[name] for name in ("profile", "size_mm", "thickness_mm", "edge_thickness_mm", "radius_mm") if gel[name] is not None}
    if scene.gel.mesh is not None:
        shape |= {name: gel[name] for name in ("mesh_unit", "mesh_scale", "bonded_side")} | {"mesh": digest(Path(scene.gel.mesh))}
    coating = dataclasses.asdict(scene.coating)
    for pattern in ("grain", "grain_size_mm"):
        coating.pop(pattern, None)
    width, height = scene.render.resolution
    facts = [
        camera,
        shape,
        coating,
        dataclasses.asdict(scene.lights),
        scene.markers.albedo,
        round(width / height, 3),
        [importlib.metadata.version(name) for name in ("mitsuba", "drjit")],
    ]
    key = hashlib.sha256(json.dumps(facts, sort_keys=True).encode())
    folder = Path(__file__).parent
    for source in sorted([*folder.glob("*.py"), Path(lightfield.__file__)]):
        key.update(source.read_bytes())
    return key.hexdigest()[:32]


def measure(scene: Scene, variant: VariantChoice, progress: Progress = lambda *_: None) -> LightField:
    """Measures the field; what it cost and how far it is off stand in its `errors`."""
    start = time.perf_counter()
    scene = scene.replace(camera=replace(scene.camera, rest=None, rest_smooth=()))
    plain = scene.replace(markers=replace(scene.markers, layout="none"), coating=replace(scene.coating, grain=0.0))
    total = len(scene.lights.lights) + 2 * PROBES + UNSEEN
    done = 0

    def tick() -> None:
        nonlocal done
        done += 1
        progress("light field", done, total)

    whole = _fit_indirect(plain, variant, _measure_local(drawn_by(plain, variant), tick), tick)
    errors = _measure_error(plain, variant, whole, tick)
    errors["seconds"] = round(time.perf_counter() - start, 1)
    return replace(whole, errors=errors)


# ---- the local part ----


def _node_normals() -> NDArray[np.float64]:
    """Normals of the table's nodes, out of the gel, (M², 3); those beyond the steepest are drawn in to it."""
    axis = np.linspace(-STEEPEST, STEEPEST, NORMALS)
    ny, nx = np.meshgrid(axis, axis, indexing="ij")
    flat = np.stack([nx, ny], axis=-1).reshape(-1, 2)
    flat *= np.minimum(1, 0.985 / np.maximum(np.linalg.norm(flat, axis=1), 1e-9))[:, None]
    return np.column_stack([flat, np.sqrt(1 - (flat**2).sum(axis=1))])


def _measure_local(scene: Scene, tick: Callable[[], None]) -> LightField:
    """The field without light from elsewhere, for a coat without markers and grain."""
    from threadpoolctl import threadpool_limits

    places = _seen_places(scene)
    x, y = (np.linspace(low, high, count) for (low, high), count in zip(places, PLACES, strict=True))
    points = np.stack(np.meshgrid(HEIGHTS_MM, y, x, indexing="ij")[::-1], axis=-1).reshape(-1, 3)
    coat, size = scene.coating, (2, PLACES[1], PLACES[0], NORMALS, NORMALS)
    pigment = (1 - coat.specular) * np.clip(coat.albedo, 0, 1) / np.pi
    flakes = coat.specular * np.clip(coat.flake_reflectance, 0, 1)
    components, colours, light_of = [], [], []
    painted = coated = np.zeros(NORMALS**2)
    for number, light in enumerate(scene.lights.lights):
        # A thousand and more small products: threads would only wait for each other.
        with threadpool_limits(1):
            received, reflected = unshadowed_light(scene, light, points, -_node_normals())
        colour = light_colour(light)
        painted = painted + received.sum(axis=0) * (colour.sum() * scene.markers.albedo / np.pi)
        coated = coated + received.sum(axis=0) * (colour @ pigment) + reflected.sum(axis=0) * (colour @ flakes)
        # Of all that it sends, seen as E and F of unit colours: which two directions of colour hold how much of it.
        both = np.stack([received.ravel(), reflected.ravel()])
        shades = np.stack([colour * pigment, colour * flakes])
        power, axes = np.linalg.eigh(shades.T @ (both @ both.T) @ shades)
        for rank in (2, 1, 0):
            axis = axes[:, rank] * (1 if axes[:, rank].sum() >= 0 else -1)
            components.append((shades @ axis) @ both)
            colours.append(axis)
            light_of.append(number)
            if power[:rank].sum() <= RANK_LEFT**2 * power.sum():
                break
        tick()
    unused = -len(components) % PACKET
    table = np.stack([*components, *[np.zeros_like(components[0])] * unused], axis=-1).reshape(*size, -1).astype(np.float32)
    paint = np.clip(painted / np.maximum(coated, 1e-9 * coated.max()), 0, 10)
    return LightField(
        table, np.array(HEIGHTS_MM, np.float32), places.astype(np.float32), STEEPEST,
        np.array([*colours, *[np.zeros(3)] * unused], np.float32), np.array(light_of + [-1] * unused, np.int32),
        paint.reshape(NORMALS, NORMALS).astype(np.float32), np.zeros(3, np.float32), np.zeros((*size[1:3], 4), np.float32),
    )  # fmt: skip


def _seen_places(scene: Scene) -> NDArray[np.float64]:
    """First and last x, first and last y [mm] of what the camera sees of the gel at its highest and in the layers, shape (2, 2)."""
    width, height = scene.render.resolution
    along, ends = np.linspace(0, 1, 65), np.array([0.0, 1.0])
    column, row = np.concatenate([np.reshape(np.meshgrid(along, ends), (2, -1)), np.reshape(np.meshgrid(ends, along), (2, -1))], axis=1)
    rays = straight_rays(scene, column * width, row * height)
    met = np.concatenate([rays[:, :2] + rays[:, 2:] * z for z in (0.0, *HEIGHTS_MM)])
    return np.stack([met.min(axis=0), met.max(axis=0)], axis=1)


def _spline_basis(knots: list[NDArray], places: NDArray) -> NDArray[np.float64]:
    """Tensor cubic B-splines over x and y, x fastest: (N, splines of x times those of y)."""
    from scipy.interpolate import BSpline

    inside = [np.clip(places[:, axis], k[0], k[-1]) for axis, k in enumerate(knots)]
    along = [BSpline.design_matrix(value, k, 3).toarray() for value, k in zip(inside, knots, strict=True)]
    return (along[1][:, :, None] * along[0][:, None, :]).reshape(len(places), -1)


# ---- light from elsewhere, and the error ----


def _small(scene: Scene, mode: str, spp: int) -> Scene:
    width, height = scene.render.resolution
    return scene.replace(render=Render(mode, spp, (PROBE_RESOLUTION, round(PROBE_RESOLUTION * height / width))))


def _fit_indirect(scene: Scene, variant: VariantChoice, light_field: LightField, tick: Callable[[], None]) -> LightField:
    small = _small(scene, "path", PROBE_SPP)
    membranes = [rest_membrane(small, PROBE_SPACING), *(bumpy_membrane(small, seed, PROBE_SPACING) for seed in range(PROBES - 1))]
    renderers = [Renderer(_small(scene, mode, PROBE_SPP), variant) for mode in ("path", "direct")]
    traced, direct = [], []
    for membrane in membranes:
        for drawn, radiance in zip((traced, direct), Renderer.radiances(renderers, membrane, scene.seed), strict=True):
            drawn.append(radiance)
            tick()
    unit = BakedRenderer(small, replace(light_field, gains=np.ones(3, np.float32)), variant)
    bare = BakedRenderer(small, light_field, variant, indirect=False)
    (low_x, high_x), (low_y, high_y) = light_field.places.astype(float)
    knots = [np.r_[[a] * 3, np.linspace(a, b, 3), [b] * 3] for a, b in ((low_x, high_x), (low_y, high_y))]
    width, height = small.render.resolution
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    basis = _spline_basis(knots, straight_rays(small, column.ravel(), row.ravel())[:, :2])
    count = basis.shape[1]
    matrix, right = np.zeros((3, count + 1, count + 1)), np.zeros((3, count + 1))
    # In units of the picture's own brightness, so that the ridge below means the same for estimate and splines.
    unit_of = float(np.mean(direct))
    for number, membrane in enumerate(membranes):
        estimate = unit.radiance(membrane) - bare.radiance(membrane)
        wanted = traced[number] - direct[number]
        for channel in range(3):
            columns = np.column_stack([estimate[..., channel].ravel() / unit_of, 0.1 * basis])
            matrix[channel] += columns.T @ columns
            right[channel] += columns.T @ wanted[..., channel].ravel() / unit_of
    gains, veil = np.zeros(3, np.float32), np.zeros((*light_field.table.shape[1:3], 4), np.float32)
    x, y = np.linspace(low_x, high_x, PLACES[0]), np.linspace(low_y, high_y, PLACES[1])
    nodes = _spline_basis(knots, np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    for channel in range(3):
        ridge = 1e-6 * np.trace(matrix[channel]) / (count + 1) * np.eye(count + 1)
        solution = np.linalg.solve(matrix[channel] + ridge, right[channel])
        gains[channel] = solution[0]
        veil[..., channel] = (nodes @ solution[1:] * (0.1 * unit_of)).reshape(PLACES[1], PLACES[0])
    return replace(light_field, gains=gains, veil=veil)


def _measure_error(scene: Scene, variant: VariantChoice, light_field: LightField, tick: Callable[[], None]) -> dict[str, Any]:
    small = _small(scene, "path", UNSEEN_SPP)
    traced, baked = Renderer(small, variant), BakedRenderer(small, light_field, variant)
    quiet = without_noise(small)
    squared, distances, levels = [], [], []
    for seed in range(UNSEEN):
        membrane = dented_membrane(small, seed, PROBE_SPACING)
        light = [traced.radiance(membrane, seed=number) for number in (0, 1)]
        one, other, whole, drawn = (develop(quiet, picture) for picture in (*light, np.mean(light, axis=0), baked.radiance(membrane)))
        squared.append(np.mean((one.astype(float) - drawn) * (other.astype(float) - drawn)))  # their noise has no mean in it
        levels.append(np.abs(whole.astype(float) - drawn).ravel())
        distances.append(colour_difference(whole, drawn).ravel())
        tick()
    all_levels, all_distances = np.concatenate(levels), np.concatenate(distances)
    return {
        "membranes": UNSEEN,
        "psnr_db": round(float(10 * np.log10(255**2 / np.mean(squared))), 2),
        "psnr_worst_db": round(float(10 * np.log10(255**2 / np.max(squared))), 2),
        "delta_e_mean": round(float(all_distances.mean()), 3),
        "delta_e_p99": round(float(np.quantile(all_distances, 0.99)), 3),
        "levels_mean": round(float(all_levels.mean()), 3),
        "levels_p99": round(float(np.quantile(all_levels, 0.99)), 2),
    }


def colour_difference(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> NDArray[np.float64]:
    """ΔE2000 of each pixel of two 8-bit sRGB pictures, shape (H, W)."""
    import colour

    lab = [colour.XYZ_to_Lab(colour.sRGB_to_XYZ(picture / 255.0)) for picture in (one, other)]
    return np.asarray(colour.delta_E(*lab, method="CIE 2000"), np.float64)


def _say(stage: str, done: int, total: int) -> None:
    """A bar of its own where nobody gave one."""
    if sys.stderr.isatty():
        end = "\n" if done == total else ""
        print(f"\rmeasuring the sensor's light, once: {done}/{total} ", end=end, file=sys.stderr, flush=True)
