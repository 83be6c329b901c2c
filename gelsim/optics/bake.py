"""Measures a sensor's light field with the path tracer, once, and how far pictures made from it are from path-traced ones.

*Local part.* One picture holds a hundred thousand measurements: every pixel sees a tile of its own, at one height, whose shading normal is
chosen freely, so all normals are visited at all places, and nothing casts a shadow or sends light to another. For every normal of the table
a cubic B-spline in place is fitted by least squares, for each of two heights and each light by itself; then the colours of a light are
reduced to as few components as hold all but 0.3 % of it. What the paint of markers returns is measured likewise.

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
from gelsim.files import cache_folder
from gelsim.membrane.surface import rest_membrane
from gelsim.optics.baked import BakedRenderer, straight_rays
from gelsim.optics.isp import develop, without_noise
from gelsim.optics.probes import bumpy_membrane, dented_membrane
from gelsim.optics.render import Renderer
from gelsim.optics.variant import VariantChoice
from gelsim.results import Membrane
from gelsim.scene.definition import Coating, Render, Scene

NORMALS = 40
"""Of n_x and of n_y: steps of 0.05; a straight line across the end of a light's cosine errs by a 160th of the light's full strength."""
STEEPEST = 0.96
"""n_x and n_y of the outermost nodes: 74 degrees."""
PLACES = (20, 15)
"""Nodes of x and y: steps of 1 mm, over which a light 20 mm away bends from a straight line by 0.2 %."""
SPLINES = (9, 8)
"""Cubic B-splines over x and y in the fit."""
TILE_SPP, TILE_PICTURES = 16, 3
"""Baked pictures of a Mini's six strips are 39.5 dB from traced ones, with 4 paths a pixel 34.6, with 64 40.2 (in twice the time)."""
HEIGHTS_MM = (-0.4, -2.0)
"""Of the two layers; a dome's rim and a deep dent reach 3 mm."""
RANK_LEFT = 3e-3
PROBES, PROBE_SPP = 6, 16
UNSEEN, UNSEEN_SPP = 8, 32
"""Paths of each of two pictures of a membrane, whose noise is not the other's."""
PROBE_RESOLUTION = 240

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
    """The scene's light field: from the cache, or measured now (a minute or two) and kept there."""
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
    digest = hashlib.sha256(json.dumps(facts, sort_keys=True).encode())
    folder = Path(__file__).parent
    for source in sorted([*folder.glob("*.py"), Path(lightfield.__file__)]):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:32]


def measure(scene: Scene, variant: VariantChoice, progress: Progress = lambda *_: None) -> LightField:
    """Measures the field; what it cost and how far it is off stand in its `errors`."""
    start = time.perf_counter()
    scene = scene.replace(camera=replace(scene.camera, rest=None, rest_smooth=()))
    plain = scene.replace(markers=replace(scene.markers, layout="none"), coating=replace(scene.coating, grain=0.0))
    total = len(scene.lights.lights) * len(HEIGHTS_MM) * TILE_PICTURES + len(HEIGHTS_MM) + 2 * PROBES + UNSEEN
    done = 0

    def tick() -> None:
        nonlocal done
        done += 1
        progress("light field", done, total)

    table, places, colours, light_of = _measure_local(plain, variant, tick)
    size = table.shape[4]
    unfitted = LightField(
        table, np.array(HEIGHTS_MM, np.float32), places, STEEPEST, colours, light_of, np.zeros((size, size), np.float32),
        np.zeros(3, np.float32), np.zeros((*table.shape[1:3], 4), np.float32),
    )  # fmt: skip
    with_paint = replace(unfitted, paint=_measure_paint(plain, variant, unfitted, tick))
    whole = _fit_indirect(plain, variant, with_paint, tick)
    errors = _measure_error(plain, variant, whole, tick)
    errors["seconds"] = round(time.perf_counter() - start, 1)
    return replace(whole, errors=errors)


# ---- the local part ----


def _tile_scene(scene: Scene) -> Scene:
    """At a resolution of whole blocks of tiles, each block with every normal once."""
    width, height = scene.render.resolution
    across = 16 * NORMALS
    down = max(round(across * height / width / NORMALS), 2) * NORMALS
    return scene.replace(render=replace(scene.render, mode="direct", spp=TILE_SPP, resolution=(across, down)))


def _tiles(scene: Scene, z_mm: float, rng: np.random.Generator) -> tuple[Membrane, NDArray[np.int64], NDArray[np.float64]]:
    """A sheet of flat tiles, one a pixel; the table's node that each shows, shape (H, W); and the pixels' places [mm], (H, W, 2)."""
    width, height = scene.render.resolution
    column, row = np.meshgrid(np.arange(width + 1.0), np.arange(height + 1.0))
    rays = straight_rays(scene, column.ravel(), row.ravel())
    corners = (rays[:, :2] + rays[:, 2:] * z_mm).reshape(height + 1, width + 1, 2)
    places = (corners[1:, 1:] + corners[:-1, :-1] + corners[1:, :-1] + corners[:-1, 1:]) / 4
    blocks = [[rng.permutation(NORMALS**2).reshape(NORMALS, NORMALS) for _ in range(width // NORMALS)] for _ in range(height // NORMALS)]
    node = np.block(blocks)
    four = np.stack([corners[:-1, :-1], corners[:-1, 1:], corners[1:, 1:], corners[1:, :-1]], axis=2).reshape(-1, 2)
    positions = np.column_stack([four, np.full(len(four), z_mm)]) * 1e-3
    normals = np.repeat(_node_normals()[node.ravel()], 4, axis=0)
    first = 4 * np.arange(width * height)[:, None]
    faces = np.concatenate([first + [0, 1, 2], first + [0, 2, 3]]).astype(np.int32)
    uv = np.full((len(four), 2), 0.5)
    return Membrane(positions, normals, uv, faces, np.zeros((0, 3))), node, places


def _node_normals() -> NDArray[np.float64]:
    """Normals of the table's nodes, out of the gel, (M², 3); those beyond the steepest are drawn in to it."""
    axis = np.linspace(-STEEPEST, STEEPEST, NORMALS)
    ny, nx = np.meshgrid(axis, axis, indexing="ij")
    flat = np.stack([nx, ny], axis=-1).reshape(-1, 2)
    flat *= np.minimum(1, 0.985 / np.maximum(np.linalg.norm(flat, axis=1), 1e-9))[:, None]
    return np.column_stack([flat, np.sqrt(1 - (flat**2).sum(axis=1))])


def _measure_local(
    scene: Scene, variant: VariantChoice, tick: Callable[[], None]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]:
    from threadpoolctl import threadpool_limits

    tiled = _tile_scene(scene)
    rng = np.random.default_rng(0)
    sheets = [[_tiles(tiled, z, rng) for _ in range(TILE_PICTURES)] for z in HEIGHTS_MM]
    # The layers' own places, and those of the gel at its highest, which are a little wider.
    width, height = tiled.render.resolution
    corner_rays = straight_rays(tiled, np.array([0.0, width, 0.0, width]), np.array([0.0, 0.0, height, height]))
    everywhere = np.concatenate([corner_rays[:, :2], *(places.reshape(-1, 2) for layer in sheets for _, _, places in layer)])
    low, high = everywhere.min(axis=0), everywhere.max(axis=0)
    lights = tiled.lights.lights
    renderers = [Renderer(tiled.replace(lights=replace(tiled.lights, lights=(light,))), variant) for light in lights]
    pictures: list[list[list[NDArray]]] = [[[] for _ in sheets] for _ in lights]
    for level, layer in enumerate(sheets):
        for number, (sheet, _, _) in enumerate(layer):
            for light, drawn in zip(pictures, Renderer.radiances(renderers, sheet, seed=number), strict=True):
                light[level].append(drawn)
                tick()
    layers = []
    for level, layer in enumerate(sheets):
        nodes = np.concatenate([node.ravel() for _, node, _ in layer])
        order = np.argsort(nodes, kind="stable")
        places = np.concatenate([places.reshape(-1, 2) for _, _, places in layer])[order].reshape(NORMALS**2, -1, 2)
        seen = [np.concatenate([p.reshape(-1, 3) for p in light[level]])[order].reshape(NORMALS**2, -1, 3) for light in pictures]
        # A thousand and more small products: threads would only wait for each other.
        with threadpool_limits(1):
            layers.append(_fit_places(places, np.concatenate(seen, axis=2), low, high))
    # (2, R, C, M², lights, 3)
    values = np.stack(layers).reshape(2, PLACES[1], PLACES[0], NORMALS**2, len(lights), 3)
    components, colours, light_of = [], [], []
    for number in range(len(lights)):
        flat = values[..., number, :].reshape(-1, 3)
        power, axes = np.linalg.eigh(flat.T @ flat)
        for rank in (2, 1, 0):
            colour = axes[:, rank] * (1 if axes[:, rank].sum() >= 0 else -1)
            components.append(flat @ colour)
            colours.append(colour)
            light_of.append(number)
            if power[:rank].sum() <= RANK_LEFT**2 * power.sum():
                break
    unused = -len(components) % PACKET
    table = np.stack([*components, *[np.zeros_like(components[0])] * unused], axis=-1)
    table = table.reshape(2, PLACES[1], PLACES[0], NORMALS, NORMALS, -1).astype(np.float32)
    colour_rows = np.array([*colours, *[np.zeros(3)] * unused], np.float32)
    return table, np.stack([low, high], axis=1).astype(np.float32), colour_rows, np.array(light_of + [-1] * unused, np.int32)


def _fit_places(places: NDArray, seen: NDArray, low: NDArray, high: NDArray) -> NDArray[np.float64]:
    """Least squares in place for every normal: places (M², S, 2), seen (M², S, Q) to values at the table's places (R, C, M², Q)."""
    knots = [np.r_[[a] * 3, np.linspace(a, b, count - 2), [b] * 3] for a, b, count in zip(low, high, SPLINES, strict=True)]
    count = SPLINES[0] * SPLINES[1]
    # Second differences of the coefficients weigh a hundredth of a sample each: they settle what few samples leave open.
    bend = [np.diff(np.eye(count), 2, axis=0) for count in SPLINES]
    stiff = [np.kron(np.eye(SPLINES[1]), bend[0]), np.kron(bend[1], np.eye(SPLINES[0]))]
    wiggle = sum(part.T @ part for part in stiff)
    coefficients = np.empty((len(places), count, seen.shape[2]))
    for first in range(0, len(places), 100):
        chosen = slice(first, first + 100)
        basis = _spline_basis(knots, places[chosen].reshape(-1, 2)).reshape(-1, places.shape[1], count)
        normal = basis.transpose(0, 2, 1) @ basis
        scale = np.trace(normal, axis1=1, axis2=2)[:, None, None] / count
        coefficients[chosen] = np.linalg.solve(normal + 1e-2 * scale * wiggle, basis.transpose(0, 2, 1) @ seen[chosen])
    x, y = (np.linspace(a, b, n) for a, b, n in zip(low, high, PLACES, strict=True))
    nodes = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return np.tensordot(_spline_basis(knots, nodes), coefficients, axes=(1, 1))


def _spline_basis(knots: list[NDArray], places: NDArray) -> NDArray[np.float64]:
    """Tensor cubic B-splines, x fastest: (N, SPLINES[0] * SPLINES[1])."""
    from scipy.interpolate import BSpline

    inside = [np.clip(places[:, axis], k[0], k[-1]) for axis, k in enumerate(knots)]
    along = [BSpline.design_matrix(value, k, 3).toarray() for value, k in zip(inside, knots, strict=True)]
    return (along[1][:, :, None] * along[0][:, None, :]).reshape(len(places), -1)


def _measure_paint(scene: Scene, variant: VariantChoice, light_field: LightField, tick: Callable[[], None]) -> NDArray[np.float32]:
    """By normal, what markers' paint returns as share of what the coat does: mean over places and channels."""
    paint = scene.markers.albedo
    tiled = _tile_scene(scene.replace(coating=Coating(albedo=(paint, paint, paint), specular=0.0)))
    renderer = Renderer(tiled, variant)
    painted, coated = np.zeros(NORMALS**2), np.zeros(NORMALS**2)
    rng = np.random.default_rng(1)
    for z in HEIGHTS_MM:
        sheet, node, places = _tiles(tiled, z, rng)
        picture = renderer.radiance(sheet).sum(axis=2)
        points = np.column_stack([places.reshape(-1, 2), np.full(node.size, z)])
        coat = (light_field.local(points, _node_normals()[node.ravel()]) @ light_field.colours).sum(axis=1)
        painted += np.bincount(node.ravel(), picture.ravel(), NORMALS**2)
        coated += np.bincount(node.ravel(), coat, NORMALS**2)
        tick()
    ratio = np.clip(painted / np.maximum(coated, 1e-9 * coated.max()), 0, 10)
    return ratio.reshape(NORMALS, NORMALS).astype(np.float32)


# ---- light from elsewhere, and the error ----


def _small(scene: Scene, mode: str, spp: int) -> Scene:
    width, height = scene.render.resolution
    return scene.replace(render=Render(mode, spp, (PROBE_RESOLUTION, round(PROBE_RESOLUTION * height / width))))


def _fit_indirect(scene: Scene, variant: VariantChoice, light_field: LightField, tick: Callable[[], None]) -> LightField:
    small = _small(scene, "path", PROBE_SPP)
    membranes = [rest_membrane(small), *(bumpy_membrane(small, seed) for seed in range(PROBES - 1))]
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
        membrane = dented_membrane(small, seed)
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
