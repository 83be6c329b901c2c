"""How the coating reflects: pigment, metal flakes and markers, in material coordinates. Pure data.

    f = (1 − m) [ (1 − s) g ρ / π  +  s g f_flake ]  +  m ρ_m / π

ρ the pigment's albedo, s the flakes' share, f_flake a GGX microfacet conductor of constant reflectance and width α (Walter et al. 2007), m
the share of a texel that markers cover, ρ_m their albedo, and g the coat's fixed grain (mean 1). Left out: layering and the flakes' own
sparkle, the coat's translucency (it is opaque), and polarisation.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from gelsim.membrane.markers import OUTLINE_HARMONICS, marker_layout
from gelsim.scene.definition import Scene

TEXEL = 0.0125e-3
"""Of the marker and grain textures [m]: a third of a default pixel; a marker of 0.2 mm spans 32."""


def marker_coverage(scene: Scene) -> NDArray[np.float32]:
    """Share of each texel that markers cover, as `layout_coverage`; none of it where the rest is given and shows them."""
    coverage = layout_coverage(scene)
    return np.zeros_like(coverage) if scene.camera.has_rest else coverage


def layout_coverage(scene: Scene) -> NDArray[np.float32]:
    """Share of each texel within markers' outlines, shape (rows, columns): row 0 is y = -size/2, column 0 is x = -size/2."""
    width, height = np.array(scene.gel.size_mm) * 1e-3
    columns, rows = int(np.ceil(width / TEXEL)), int(np.ceil(height / TEXEL))
    step = np.array([width / columns, height / rows])
    coverage = np.zeros((rows, columns), np.float32)
    layout = marker_layout(scene)
    for centre, radius, outline in zip(layout.centres, layout.radii, layout.outline, strict=True):
        reach = 2 * radius + step.max()
        low = np.maximum(np.floor((centre - reach + [width / 2, height / 2]) / step).astype(int), 0)
        high = np.minimum(np.ceil((centre + reach + [width / 2, height / 2]) / step).astype(int), [columns, rows])
        x = (np.arange(low[0], high[0]) + 0.5) * step[0] - width / 2 - centre[0]
        y = (np.arange(low[1], high[1]) + 0.5) * step[1] - height / 2 - centre[1]
        distance = np.maximum(np.hypot(x, y[:, None]), 1e-9)
        # exp(-i φ), and its powers one after the other, for the harmonics follow each other: cheaper than exponentials of the angle.
        turn = (x - 1j * y[:, None]) / distance
        power, wave = turn ** int(OUTLINE_HARMONICS[0]), np.zeros(turn.shape, complex)
        for amplitude in outline:
            wave += amplitude * power
            power *= turn
        edge = radius * (1 + np.real(wave))
        # Anti-aliased: a straight edge through a texel covers it in proportion to its distance, within a texel's width.
        patch = coverage[low[1] : high[1], low[0] : high[0]]
        np.maximum(patch, np.clip((edge - distance) / step.mean() + 0.5, 0, 1), out=patch)
    return coverage


def grain_pattern(scene: Scene) -> NDArray[np.float32]:
    """Relative reflectance of the coat, mean 1, shape (rows, columns), or (1, 1) without grain; a photograph of the rest shows its own."""
    coating = scene.coating
    if coating.grain == 0 or scene.camera.has_rest:
        return np.ones((1, 1), np.float32)
    from scipy.ndimage import gaussian_filter

    # A quarter of the grain as texel: finer would add nothing.
    texel_mm = coating.grain_size_mm / 4
    columns, rows = (int(np.ceil(side / texel_mm)) for side in scene.gel.size_mm)
    pattern = gaussian_filter(np.random.default_rng([scene.markers.seed, 1]).standard_normal((rows, columns)), 1.5, mode="wrap")
    return np.clip(1 + coating.grain * (pattern - pattern.mean()) / pattern.std(), 0, None).astype(np.float32)


@functools.cache
def flake_albedo(roughness: float, count: int = 64) -> float:
    """Share of a white sky that lossless flakes reflect into all directions together (they reflect once).

    A facet of slope (x, y) is seen from a direction v with the density D max(v·h, 0) G1 / (v·n); what it reflects to l escapes with G1(l).
    Weighed by the cosine of v, mean over it and over facets drawn from D cos, by the midpoint rule: good to about 0.0005.
    """
    middles = (np.arange(count) + 0.5) / count
    cosine, share, turn = (axis.ravel() for axis in np.meshgrid(middles, middles, middles))
    seen = np.stack([np.sqrt(1 - cosine**2), np.zeros_like(cosine), cosine], axis=-1)
    # D cos has the distribution function t/(t + α²) of t = tan².
    tangent = roughness * np.sqrt(share / (1 - share))
    facet = np.stack([tangent * np.cos(2 * np.pi * turn), tangent * np.sin(2 * np.pi * turn), np.ones_like(turn)], axis=-1)
    facet /= np.linalg.norm(facet, axis=-1, keepdims=True)
    facing = (seen * facet).sum(axis=-1)
    out = 2 * facing[:, None] * facet - seen

    def escape(cos: NDArray) -> NDArray:
        return 2 * cos / (cos + np.sqrt(roughness**2 + (1 - roughness**2) * cos**2))

    weight = 2 * facing * escape(cosine) * escape(np.clip(out[:, 2], 0, None)) / facet[:, 2]
    return float(np.mean(np.where((facing > 0) & (out[:, 2] > 0), weight, 0.0)))


def coating_dict(scene: Scene) -> dict:
    """The membrane's reflectance, for `scene_dict`."""
    coating, markers = scene.coating, scene.markers
    grain = grain_pattern(scene)[..., None]
    coat: dict = {"type": "diffuse", "reflectance": _texture(np.clip(grain * coating.albedo, 0, 1))}
    if coating.specular > 0:
        flakes = {
            "type": "roughconductor",
            "distribution": "ggx",
            "alpha": coating.roughness,
            # "none" reflects everything; the colour is then specular_reflectance alone.
            "material": "none",
            "specular_reflectance": _texture(np.clip(grain * coating.flake_reflectance, 0, 1)),
        }
        coat = {"type": "blendbsdf", "weight": coating.specular, "pigment": coat, "flakes": flakes}
    coverage = marker_coverage(scene)
    if not coverage.any():
        return coat
    paint = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [markers.albedo] * 3}}
    return {"type": "blendbsdf", "weight": _texture(coverage[..., None]), "coat": coat, "marker": paint}


def _texture(values: NDArray) -> dict:
    """A texture of linear values over material coordinates; its first row is v = 0, a constant if it has one texel."""
    if values.shape[:2] == (1, 1):
        return {"type": "rgb", "value": values[0, 0].tolist()}
    return {"type": "bitmap", "bitmap": np.ascontiguousarray(values, np.float32), "raw": True, "wrap_mode": "clamp"}
