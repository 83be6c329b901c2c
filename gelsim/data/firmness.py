"""What a durometer reads on what an object is made of, and how firm that is: labels of a dataset's rows, out of a table.

    F(d) = E √R d^1.5 c(d)

is the force of a ball tip of radius R that sticks, d deep in a block of 12 mm on a rigid plate: of the object's material, under its skin
where it has one. E is the block's modulus; c depends on its Poisson's ratio, and on the skin's thickness and its modulus over E. The table
is `gelsim.durometer`'s (`python docs/studies/firmness_table.py`), piecewise linear in ν, in the thickness, and in logarithms of the rest.

*Shore 00.* On the block the durometer's tip stands at the depth d at which F is its spring's force; the label is that of the silicone in
which it stands as deep, E' = E c(d) / c_silicone(d): silicones keep the reading that they are called by, whatever modulus it stands for.
A block too soft for any reading bears the tip's whole travel, and is compared there.

*Stiffness.* F/d of a ball of 5 mm across, 1 mm deep, of the modulus that the press has.

Left out: the object's form (a wall that gives way, a small body), grains (what is read depends on where), skins on foam, and soft ones
thinner than the first of LAYERS_MM, through which the tip is stopped.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root_scalar

from gelsim.errors import MaterialError
from gelsim.scene import materials
from gelsim.scene.definition import Body
from gelsim.scene.layers import assets_folder
from gelsim.tables import read_csv
from gelsim.units import MM

Array = NDArray[np.float64]

DEPTHS_MM = (0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.25, 2.54)
POISSONS_RATIOS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.45, 0.48, 0.4999)
SKIN_RATIOS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
SKINS_MM = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5)
LAYER_RATIOS = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0)
LAYERS_MM = (1.5, 2.0, 2.5, 3.0, 4.0, 6.0)
"""Of skins softer than what is below, over a core."""
SILICONE = 0.49
"""Poisson's ratio from which on a material is silicone, and a skin's is tabulated."""
HIGHEST = 98.0
"""Reading."""


@dataclass(frozen=True, eq=False)
class Blocks:
    """c at DEPTHS_MM, and the force over modulus of the ball of 5 mm [mm²], of blocks without and with a skin."""

    bare: Array
    """Of POISSONS_RATIOS, shape (P, D + 1): ln c, at last that of the ball's; NaN where no press came."""
    skinned: Array
    """Of SKIN_RATIOS and SKINS_MM, shape (Q, S, D + 1), likewise."""
    layered: Array
    """Of LAYER_RATIOS and LAYERS_MM."""


@lru_cache
def blocks() -> Blocks:
    """The table."""
    _, rows = read_csv(assets_folder() / "reference" / "firmness.csv")
    keys, names = ("poissons_ratio", "skin_ratio", "skin_mm"), [*(f"{depth:g}" for depth in DEPTHS_MM), "ball"]
    of = {tuple(float(row[key]) for key in keys): np.log([float(row[name] or "nan") for name in names]) for row in rows}
    bare, silicone = [of[nu, 1.0, 0.0] for nu in POISSONS_RATIOS], POISSONS_RATIOS[-1]
    plain = bare[-1]
    skinned, layered = (
        [[plain if ratio == 1 or not skin else of[silicone, ratio, skin] for skin in skins] for ratio in ratios]
        for ratios, skins in ((SKIN_RATIOS, SKINS_MM), (LAYER_RATIOS, LAYERS_MM))
    )
    return Blocks(np.array(bare), np.array(skinned), np.array(layered))


def shore_00(body: Body) -> float | None:
    """The label; None of a rigid object, one with grains or a skin that the table has not, and what reads above HIGHEST.

    It is of the reading, not of the modulus that a press takes it for: `modulus_scale` does not change it.
    """
    if body.rigid:
        return None
    plain = body.poissons_ratio >= SILICONE and materials.parts(body) == ("body",)
    if plain and body.shore_00 is not None:
        return body.shore_00
    nominal = replace(body, modulus_scale=1.0, skin=replace(body.skin, modulus_scale=1.0))
    modulus, block = materials.youngs_modulus(nominal), _block(nominal)
    try:
        return None if block is None else materials.shore_00_from_modulus(modulus if plain else _alike(modulus, block))
    except MaterialError:
        return None


def stiffness(body: Body) -> float | None:
    """F/d [N/mm]; None as of `shore_00`, but for the highest."""
    block = None if body.rigid else _block(body)
    return None if block is None else materials.youngs_modulus(body) * 1e-6 * float(np.exp(block[-1]))


def _block(body: Body) -> Array | None:
    """A soft object's row of the table, shape (D + 1,); None: there is none."""
    table, parts = blocks(), materials.parts(body)
    if parts == ("body",):
        return np.array([np.interp(body.poissons_ratio, POISSONS_RATIOS, column) for column in table.bare.T])
    if parts != ("body", "skin") or body.poissons_ratio < SILICONE:
        return None
    ratio = materials.youngs_modulus(body.skin) / materials.youngs_modulus(body)
    known, ratios, skins = (table.skinned, SKIN_RATIOS, SKINS_MM) if ratio >= 1.0 else (table.layered, LAYER_RATIOS, LAYERS_MM)
    if not ratios[0] <= ratio <= ratios[-1] or not skins[0] <= body.skin.thickness_mm <= skins[-1]:
        return None
    of_ratio = np.array([[np.interp(body.skin.thickness_mm, skins, column) for column in part.T] for part in known])
    return np.array([np.interp(np.log(ratio), np.log(ratios), column) for column in of_ratio.T])


def _alike(modulus: float, block: Array) -> float:
    """Modulus [Pa] of the silicone in which the durometer's tip stands as deep.

    Raises:
        MaterialError: It reads above HIGHEST, or the tip stands deeper than presses came.
    """

    def share(row: Array, depth: float) -> float:
        return float(np.exp(np.interp(np.log(depth / MM), np.log(DEPTHS_MM), row[:-1])))

    def force(reading: float) -> float:
        depth = materials.TRAVEL * (1 - reading / 100)
        return modulus * np.sqrt(materials.TIP_RADIUS) * depth**1.5 * share(block, depth)

    def spring(reading: float) -> float:
        return materials.SPRING_PRELOAD + materials.SPRING_RATE * reading

    deepest = max(depth for depth, known in zip(DEPTHS_MM, np.isfinite(block), strict=False) if known)
    low, high = max(100 * (1 - deepest * MM / materials.TRAVEL), 0.0), HIGHEST
    if force(high) > spring(high) or (deepest < DEPTHS_MM[-1] and force(low) < spring(low)):
        raise MaterialError(f"E = {modulus * 1e-3:g} kPa: what a durometer reads on it is outside the table")
    # The block's force falls as the reading grows, the spring's grows; at 0 the first may be the less.
    found = low if force(low) <= spring(low) else root_scalar(lambda reading: force(reading) - spring(reading), bracket=(low, high)).root
    depth = materials.TRAVEL * (1 - found / 100)
    return modulus * share(block, depth) / share(blocks().bare[-1], depth)
