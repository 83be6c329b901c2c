"""A sensor's rest as it was photographed: a rendered picture is that photograph, changed by what the renderer says the press changes.

    x_c = m_c(q) · [B_c + g_c (L_c − L⁰_c)],      m = P / B,

in the units in which the camera's pipeline (`optics.isp`) goes on. P is the photograph without contact, its tone curve undone; B its even
part, which is the optics' (vignette, glow of light guides, dark corners) and stays where it is; m the rest of it, painted on the coat
(dots, scratches, dust) and moves with it: q is where in the picture at rest the piece of coat appeared that a pixel sees now. L and L⁰ are
the drawn radiance with and without the press, by the same mode and the same random numbers, without markers and grain; g the pipeline's
gain. So nothing is asked of the lights but what a press changes: a membrane at rest is the photograph, whatever the lights are.

Without a photograph the rest may be smooth: B is 255 exp(Σ a_kc u^i v^j), i + j up to 3, u and v from −1 to 1 across and down the picture,
and m the scene's markers, painted on it. Of a photograph even and painted are told apart by size: B is a high percentile of the levels over
windows of an EVENth of the picture's width, smoothed (docs/decisions/0005-rest-measured.md). Where a pixel sees no gel the photograph
stays. Left out: fine dirt on the lens, which moves as if it were painted; a pixel's even light where the lights were changed after the
photograph (`relight`): only the change then has the new lights."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import SceneError
from gelsim.optics.camera import gel_ray, make_lens
from gelsim.optics.coating import layout_coverage
from gelsim.optics.shading import shading_basis
from gelsim.optics.srgb import srgb_linear, srgb_tone
from gelsim.scene.definition import Scene
from gelsim.scene.limits import REST_TERMS
from gelsim.shape.shapes import gel_height

EVEN = 8
"""Windows across the picture; docs/decisions/0005-rest-measured.md has the figures."""
UPPER = 65.0
"""Percentile of a window: dots are dark and cover less than the rest of it."""
COARSE = 160
"""Width [px] that the even part is looked for at: it holds nothing finer."""
DARKEST = 1e-4
"""Even light below this share of white is taken as this: of what is black nothing can be told."""


SUBPIXELS = 4
"""Along each side of a pixel, where a smooth rest's markers are looked for."""


def rest_pictures(scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The picture without contact, and its even part, at the size of the rendered one: levels 0 … 255, each of shape (H, W, 3).

    Raises:
        SceneError: It cannot be read, or has another aspect than the rendered picture.
    """
    if scene.camera.rest is None:
        even = smooth_levels(scene.camera.rest_smooth, scene.render.resolution)
        return toned(scene, untoned(scene, even) * _marker_paint(scene)), even
    levels = _photograph(str(scene.camera.rest))
    (height, width), (columns, rows) = levels.shape[:2], scene.render.resolution
    if abs(width * rows - height * columns) > max(width, columns):
        raise SceneError(
            f"camera.rest = {scene.camera.rest!r} is {width} x {height} px, but render.resolution = {columns} {rows}: "
            f"a sensor with a photograph is drawn at the photograph's aspect"
        )
    levels = resized(levels, (columns, rows))
    return levels, even_part(levels)


def smooth_levels(coefficients: tuple[float, ...], size: tuple[int, int]) -> NDArray[np.float64]:
    """Levels 0 … 255 of camera.rest_smooth, shape (H, W, 3)."""
    table = np.array(coefficients).reshape(-1, 3)
    level = np.exp(smooth_basis(size, REST_TERMS[table.size]) @ table)
    return np.minimum(255 * level, 255.0).reshape(size[1], size[0], 3)


def smooth_basis(size: tuple[int, int], degree: int) -> NDArray[np.float64]:
    """1, u, v, u², uv, … of all pixels' middles, row by row."""
    width, height = size
    v, u = np.mgrid[:height, :width]
    terms = shading_basis((2 * u.ravel() + 1) / width - 1, (2 * v.ravel() + 1) / height - 1, degree)
    return np.column_stack([np.ones(len(terms)), terms])


def _marker_paint(scene: Scene) -> NDArray[np.float64]:
    """Light of the markers over that of the coat beside them, shape (H, W, 1)."""
    width, height = scene.render.resolution
    if scene.markers.layout == "none":
        return np.ones((height, width, 1))
    column, row = np.meshgrid(*((np.arange(SUBPIXELS * side) + 0.5) / SUBPIXELS for side in (width, height)))
    origin, direction, _ = gel_ray(make_lens(scene), column.ravel(), row.ravel())
    at, z = np.zeros((column.size, 2)), np.zeros(column.size)
    for _ in range(3):  # where the ray meets the gel at rest
        at = np.stack([o + (z - origin[2]) / direction[2] * d for o, d in zip(origin[:2], direction[:2], strict=True)], axis=1)
        z = gel_height(scene.gel, at)
    coverage = layout_coverage(scene)
    size = np.array(scene.gel.size_mm) * 1e-3
    texel = np.floor((at / size + 0.5) * coverage.shape[::-1]).astype(int)
    inside = np.all((texel >= 0) & (texel < coverage.shape[::-1]), axis=1)
    covered = np.zeros(len(at))
    covered[inside] = coverage[texel[inside, 1], texel[inside, 0]]
    share = covered.reshape(height, SUBPIXELS, width, SUBPIXELS).mean(axis=(1, 3))
    return 1 - share[..., None] * (1 - min(scene.markers.albedo / max(float(np.mean(scene.coating.albedo)), 1e-6), 1.0))


@lru_cache(maxsize=4)
def _photograph(path: str) -> NDArray[np.float64]:
    from PIL import Image

    try:
        with Image.open(path) as image:
            return np.asarray(image.convert("RGB"), np.float64)
    except OSError as error:  # Pillow's own for what is no picture is one
        raise SceneError(f"camera.rest = {path!r}: is not a picture that can be read ({error.strerror or error})") from None


def save_levels(levels: NDArray[np.float64], path: Path) -> NDArray[np.float64]:
    """Writes levels 0 … 255 as a PNG, and returns them as they then are."""
    from PIL import Image

    rounded = np.rint(np.clip(levels, 0, 255)).astype(np.uint8)
    Image.fromarray(rounded).save(path, format="PNG")
    return rounded.astype(np.float64)


def rest_name(sensor: Path) -> str:
    """Of the photograph that belongs to a sensor file, beside it."""
    return f"{sensor.stem}_rest.png"


def resized(levels: NDArray[np.float64], size: tuple[int, int]) -> NDArray[np.float64]:
    """Means over the new pixels, or between the old ones where the new are finer."""
    from PIL import Image

    if (levels.shape[1], levels.shape[0]) == tuple(size):
        return levels
    way = Image.Resampling.BOX if size[0] < levels.shape[1] else Image.Resampling.BICUBIC
    parts = [np.asarray(Image.fromarray(np.float32(levels[..., c])).resize(size, way)) for c in range(3)]
    return np.clip(np.stack(parts, axis=-1).astype(np.float64), 0, 255)


def even_part(levels: NDArray[np.float64]) -> NDArray[np.float64]:
    """What of a picture at rest is the optics', of the same shape (H, W, 3)."""
    from scipy import ndimage

    height, width = levels.shape[:2]
    small = resized(levels, (COARSE, max(round(COARSE * height / width), 1))) if width > COARSE else levels
    side = small.shape[1] // EVEN | 1
    upper = np.stack([ndimage.percentile_filter(small[..., c], UPPER, size=side) for c in range(3)], axis=-1)
    return resized(ndimage.gaussian_filter(upper, (side / 3, side / 3, 0)), (width, height))


def untoned(scene: Scene, levels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values before the tone curve and its exponent, of levels 0 … 255."""
    value = np.clip(levels / 255, 0, 1) ** (1 / scene.camera.gamma)
    return value if scene.camera.tone == "linear" else srgb_linear(value)


def toned(scene: Scene, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Levels 0 … 255 of values before the tone curve, the inverse of `untoned`."""
    value = srgb_tone(values) if scene.camera.tone == "srgb" else np.clip(values, 0, 1)
    return 255 * value**scene.camera.gamma


def rest_tables(scene: Scene, gained: NDArray[np.floating]) -> dict[str, NDArray[np.float32]]:
    """What the image pipeline needs of the photograph, four numbers a pixel.

    Args:
        gained: Radiance at rest times the pipeline's gain, shape (H, W, 3); NaN or 0 where the camera sees no gel.
    Returns:
        "rest_even": B − g L⁰, and "rest_paint": m.
    """
    levels, even = rest_pictures(scene)
    even = np.maximum(untoned(scene, even), DARKEST)
    tables = {"rest_even": even - gained, "rest_paint": untoned(scene, levels) / even}
    return {name: _fours(values) for name, values in tables.items()}


def _fours(values: NDArray[np.float64]) -> NDArray[np.float32]:
    return np.concatenate([values, np.zeros((*values.shape[:2], 1))], axis=2).astype(np.float32)
