"""The table of `gelsim.data.firmness`, by the virtual durometer: ball tips that stick in blocks of 12 mm, foams, skinned and layered ones.

    python docs/studies/firmness_table.py assets/reference/firmness.csv          makes it; a quarter of an hour of one core
    python docs/studies/firmness_table.py --between                              off by how much, at blocks between those of the table

Labels are compared at moduli of 00-5 to 00-80, with presses of the `reference` mesh.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from gelsim import durometer
from gelsim.data import firmness
from gelsim.durometer import SCALES, TESTER, Curve, Sample
from gelsim.scene import materials
from gelsim.scene.definition import Body, Skin
from gelsim.tables import write_csv
from gelsim.units import MM


def row(sample: Sample) -> dict[str, float | str]:
    """c at depths and the 5 mm ball's force over modulus [mm²], of which a line of the table is made; empty where a press did not come."""
    tip, depths = SCALES["00"], np.array(firmness.DEPTHS_MM) * MM
    curve, ball = durometer.sample_curve(tip, depths[-1], sample), durometer.sample_curve(TESTER, TESTER.travel, sample)
    told: dict[str, float | str] = {"poissons_ratio": sample.poissons_ratio, "skin_ratio": sample.skin_ratio, "skin_mm": sample.skin_mm}
    for name, depth in zip(firmness.DEPTHS_MM, depths, strict=True):
        reached = depth <= curve.depth[-1] * (1 + 1e-9)
        told[f"{name:g}"] = f"{curve.at(depth) / (tip.tip_radius**0.5 * depth**1.5):.4f}" if reached else ""
    return told | {"ball": f"{ball.at(TESTER.travel) / MM**2:.4f}"}


def main(out: Path) -> None:
    samples = [Sample(nu) for nu in firmness.POISSONS_RATIOS]
    samples += [Sample(skin_mm=skin, skin_ratio=ratio) for ratio in firmness.SKIN_RATIOS[1:] for skin in firmness.SKINS_MM[1:]]
    samples += [Sample(skin_mm=skin, skin_ratio=ratio) for ratio in firmness.LAYER_RATIOS[:-1] for skin in firmness.LAYERS_MM]
    rows = []
    for sample in samples:
        rows.append(row(sample))
        print(*rows[-1].values(), flush=True)
    write_csv(out, rows)


def stands_alike(curve: Curve, silicone: Curve, modulus: float) -> float:
    """Shore 00 of the silicone that reads as a block of a modulus [Pa] does, by presses of both."""
    tip = SCALES["00"]
    readings = np.linspace(0.0, 98.0, 9801)
    over = np.array([modulus * curve.at(tip.depth(h)) - tip.spring(h) for h in readings])
    depth = tip.depth(float(np.interp(0.0, -over, readings)))
    return materials.shore_00_from_modulus(modulus * curve.at(depth) / silicone.at(depth))


def between() -> None:
    """Labels by the table against direct presses."""
    tip, deepest = SCALES["00"], firmness.DEPTHS_MM[-1] * MM

    def pressed(sample: Sample) -> Curve:
        return durometer.sample_curve(tip, deepest, sample, fidelity="reference")

    silicone = pressed(Sample())
    samples = [Sample(nu) for nu in (0.05, 0.15, 0.25, 0.35)]
    samples += [Sample(skin_mm=skin, skin_ratio=ratio) for skin, ratio in ((0.375, 3.0), (0.9, 6.0), (1.1, 12.0), (1.3, 24.0))]
    samples += [Sample(skin_mm=skin, skin_ratio=ratio) for skin, ratio in ((1.75, 0.35), (2.2, 0.18), (3.5, 0.09), (5.0, 0.7))]
    print("nu      skin  ratio   most off [Shore 00]   of 5 mm ball")
    for sample in samples:
        curve, ball, off = pressed(sample), durometer.sample_curve(TESTER, TESTER.travel, sample, fidelity="reference"), []
        for shore in (5.0, 10.0, 20.0, 35.0, 50.0, 65.0, 80.0):
            modulus = materials.modulus_from_shore_00(shore)
            skin = Skin(sample.skin_mm, youngs_modulus_kpa=sample.skin_ratio * modulus / 1e3) if sample.skin_mm else Skin()
            body = Body(shore_00=shore, poissons_ratio=min(sample.poissons_ratio, 0.4999), skin=skin)
            told, stiff = firmness.shore_00(body), firmness.stiffness(body)
            if told is not None and stiff is not None:
                off.append((told - stands_alike(curve, silicone, modulus), stiff / (modulus * ball.at(TESTER.travel) / MM / 1e6 * 1e3) - 1))
        shores, stiffs = np.array(off).T
        print(f"{sample.poissons_ratio:<7g} {sample.skin_mm:<5g} {sample.skin_ratio:<7g} {np.abs(shores).max():<21.2f} "
              f"{np.abs(stiffs).max():.1%}", flush=True)  # fmt: skip


if __name__ == "__main__":
    between() if sys.argv[1:] == ["--between"] else main(Path(sys.argv[1]))
