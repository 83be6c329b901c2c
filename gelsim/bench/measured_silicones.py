"""Section `measured-silicones`: compression of silicone cylinders between platens, measured by others; errors as they are.

The data are not in the project: --data or $GELSIM_DATA names their folder, in which silicone_phantoms/NAME/*.csv and
silicone_phantoms/hyperelastic_parameters.json hold the tests of cylinders 50 x 30 mm (Dawood et al., CC BY 4.0). The specimen sticks to the
platens, slides on them with a friction coefficient, or slides freely (closed form). Modulus, Yeoh's c₂/c₁ and the height lost before the
platen is in full touch are fitted to strains of 5 to 25 % by least squares over the forces.

Left out: tests' own error (two specimens of each silicone; their spread is in the table), viscosity.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from gelsim.bench.section import Case, Options, Row, Section
from gelsim.bench.structured import Array, quarter_disc
from gelsim.errors import SolveError, SolveStatus
from gelsim.fem.problem import Numerics, PressProblem
from gelsim.fem.quasistatic import run_press
from gelsim.fem.strategy import HELD
from gelsim.geometry import TetMesh, quadratic_faces
from gelsim.scene.definition import Body, Contact, Gel, Press, Scene
from gelsim.scene.materials import ElasticMaterial
from gelsim.units import MM

PHANTOMS = Path("silicone_phantoms")
RADIUS_MM, HEIGHT_MM = 25.0, 30.0
STRAINS = 0.05, 0.25
"""Range of the fit: below, the platen is not in full touch; the last is what a press of 2 mm does to 8 mm of silicone."""
RATIOS = 0.0, 0.15, 0.3
"""Yeoh's c₂/c₁ of the curves that fits interpolate between."""
FRICTIONS: dict[str, float | str] = {"sticking": "stick", "friction 0.3": 0.3}
_STEP = 0.02
"""Strain between states; the last lies beyond the fit's range by the largest lost height."""
_LAST = 0.26
_LOST_MM = np.linspace(-0.6, 1.2, 73)
"""Heights tried; below zero where the test was zeroed after first touch."""


def specimen() -> TetMesh:
    """A quarter of the upper half of a cylinder, its middle plane sliding; its top and its flank may touch the platen."""
    half = HEIGHT_MM / 2
    z = half * (np.array([0, 0.25, 0.45, 0.62, 0.76, 0.87, 0.94, 1.0]) - 1.0)
    mesh = quarter_disc(RADIUS_MM, 8, z, ("sliding", "top", "flank"))
    groups = {
        "bonded": np.zeros((0, 6), np.int32),
        "sliding": mesh.groups["sliding"],
        "coated": np.vstack([mesh.groups["top"], mesh.groups["flank"]]),
    }
    return TetMesh(mesh.rest_positions, mesh.tets, groups, mesh.symmetry)


@lru_cache
def platen_curve(friction: float | str, ratio: float) -> tuple[Array, Array]:
    """Engineering strains, and force [N] at E = 1 kPa, of the cylinder between platens; a law of Yeoh with c₂/c₁ = `ratio`."""
    depth = _LAST * HEIGHT_MM / 2
    scene = Scene(
        gel=Gel(profile="flat", youngs_modulus_kpa=100.0, size_mm=(60.0, 60.0), thickness_mm=HEIGHT_MM / 2),
        object=Body(shape="flat", rigid=True, width_mm=4 * RADIUS_MM, length_mm=4 * RADIUS_MM),
        contact=Contact(friction_coefficient=friction),
        press=Press(depth_mm=depth, force_n=None, frames=1 + round(_LAST / _STEP)),
        fidelity="balanced",
    )
    side = 2 * RADIUS_MM * MM
    corners = np.array([[0, 0, 0], [side, 0, 0], [side, side, 0], [0, side, 0]])
    platen = quadratic_faces(corners, np.array([[0, 2, 1], [0, 3, 2]], np.int32))
    material = ElasticMaterial.from_modulus(100e3, 0.499, "yeoh", (ratio, 0.0)) if ratio else ElasticMaterial.from_modulus(100e3, 0.499)
    # where friction lets the rim roll onto the platen its tets are crushed to det F = 0.2, and fold where volume is held at vertices alone
    held = Numerics(contact_points=HELD.contact_points, held=HELD.held)
    press = run_press(PressProblem(scene, specimen(), platen, (np.eye(3), np.zeros(3)), [material], "cpu", held), throw=False)
    strain = press.approach / (HEIGHT_MM / 2 * MM)
    if press.status is not SolveStatus.CONVERGED and strain[-1] < STRAINS[1]:
        raise SolveError(f"cylinder between platens, friction {friction}, c₂/c₁ {ratio}: stopped {press.message}", press)
    return strain, -press.force[:, 2] / 100.0


def smooth_curve(ratio: float) -> tuple[Array, Array]:
    """The same without friction: the incompressible bar of physics.md §5.7."""
    strain = np.linspace(0, _LAST, 1 + round(_LAST / _STEP))
    stretch = 1 - strain
    stress = (stretch**-2 - stretch) / 3 * (1 + 2 * ratio * (stretch**2 + 2 / stretch - 3))
    return strain, stress * np.pi * RADIUS_MM**2 * 1e-3


@dataclass(frozen=True)
class Fit:
    """Modulus [kPa], c₂/c₁, height lost [mm], and the RMS difference over the greatest force."""

    modulus: float
    ratio: float
    lost_mm: float
    rms: float


def fit(compression_mm: Array, force: Array, friction: str, yeoh: bool) -> Fit:
    """Least squares over the forces; the modulus is linear, the other two are looked for on a grid."""
    best = Fit(0.0, 0.0, 0.0, np.inf)
    for ratio in np.linspace(RATIOS[0], RATIOS[-1], 121) if yeoh else (0.0,):
        strains, curve = _curve(friction, float(ratio))
        for lost in _LOST_MM:
            strain = (compression_mm - lost) / (HEIGHT_MM - lost)
            chosen = (strain >= STRAINS[0]) & (strain <= STRAINS[1])
            unit, wanted = np.interp(strain[chosen], strains, curve), force[chosen]
            modulus = float((unit * wanted).sum() / (unit**2).sum())
            rms = float(np.sqrt(np.mean((modulus * unit - wanted) ** 2)) / wanted.max())
            if rms < best.rms:
                best = Fit(modulus, float(ratio), float(lost), rms)
    return best


def _curve(friction: str, ratio: float) -> tuple[Array, Array]:
    if friction == "smooth":
        return smooth_curve(ratio)
    strains = platen_curve(FRICTIONS[friction], 0.0)[0]
    if ratio == 0.0:
        return platen_curve(FRICTIONS[friction], 0.0)
    forces = np.array([np.interp(strains, *platen_curve(FRICTIONS[friction], r)) for r in RATIOS])
    place = int(np.clip(np.searchsorted(RATIOS, ratio) - 1, 0, len(RATIOS) - 2))
    share = (ratio - RATIOS[place]) / (RATIOS[place + 1] - RATIOS[place])
    return strains, (1 - share) * forces[place] + share * forces[place + 1]


def compression_curve(path: Path) -> tuple[Array, Array]:
    """Compression [mm] and force [N] of one test, rising strains only."""
    lines = path.read_text().splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("Time"))
    table = np.array([[float(cell) for cell in line.split(",")[1:3]] for line in lines[start + 1 :] if line.strip()])
    return table[:, 0], table[:, 1]


def _silicone_cases(options: Options) -> Iterator[Case]:
    folder = None if options.data is None else options.data / PHANTOMS
    if folder is None or not folder.is_dir():
        return
    names = sorted((path.name for path in folder.iterdir() if path.is_dir()), key=_thinner)
    for name in names[::6] if options.quick else names:
        yield Case(name, partial(_silicone_row, folder, name))


def _thinner(name: str) -> tuple[str, float]:
    """Sorts EF10_12_5T by its base, then by the share of thinner."""
    base, share = name.rstrip("T").split("_", 1)
    return base, float(share.replace("_", "."))


def _silicone_row(folder: Path, name: str) -> Row:
    tests = [compression_curve(path) for path in sorted((folder / name).glob("*.csv"))]
    published = json.loads((folder / "hyperelastic_parameters.json").read_text())["engineering"][name]["Yeoh_o2"]["parameters"]
    row: Row = {"status": SolveStatus.CONVERGED.name, "tests": len(tests), "published_kpa": round(6 * published[0], 1)}
    row["published_ratio"] = round(published[1] / published[0], 2)
    try:
        for label, friction, yeoh in (
            ("smooth", "smooth", True), ("smooth_neo", "smooth", False), ("stick", "sticking", True), ("stick_neo", "sticking", False),
            ("slide", "friction 0.3", True),
        ):  # fmt: skip
            fits = [fit(*test, friction, yeoh) for test in tests]
            row |= {
                f"{label}_kpa": round(float(np.mean([f.modulus for f in fits])), 1),
                f"{label}_ratio": round(float(np.mean([f.ratio for f in fits])), 2),
                f"{label}_rms_percent": round(100 * float(np.mean([f.rms for f in fits])), 1),
                f"{label}_lost_mm": round(float(np.mean([f.lost_mm for f in fits])), 2),
                f"{label}_spread_percent": round(100 * float(np.ptp([f.modulus for f in fits]) / np.mean([f.modulus for f in fits])), 1),
            }
    except SolveError as error:
        return row | {"status": "SolveError", "message": str(error)}
    return row


def _fitted(rows: list[Row]) -> list[Row]:
    """Those of which no fit failed."""
    return [row for row in rows if row["status"] == SolveStatus.CONVERGED.name]


def _silicone_remarks(rows: list[Row]) -> str:
    rows = _fitted(rows)
    if not rows:
        return ""
    stiffer = np.array([row["smooth_kpa"] / row["stick_kpa"] for row in rows])
    slide = np.array([row["smooth_kpa"] / row["slide_kpa"] for row in rows])
    medians = {name: float(np.median([row[f"{name}_rms_percent"] for row in rows])) for name in ("stick_neo", "stick", "slide", "smooth")}
    return (
        f"A reading that forgets the platens' friction is {100 * (np.median(stiffer) - 1):.0f} % too stiff if the silicone sticks "
        f"({100 * (stiffer.min() - 1):.0f} to {100 * (stiffer.max() - 1):.0f}), {100 * (np.median(slide) - 1):.0f} % if it slides at 0.3. "
        f"Left over, median RMS in % of the greatest force: one modulus, sticking {medians['stick_neo']:.1f}; with c₂/c₁ (0 or more) "
        f"sticking {medians['stick']:.1f}, friction 0.3 {medians['slide']:.1f}, none {medians['smooth']:.1f}. The published constants are "
        "fitted over all strains, without friction."
    )


def _draw(rows: list[Row], folder: Path) -> None:
    """measured-silicones.png: the modulus of every silicone as each reading has it."""
    rows = _fitted(rows)
    if not rows:
        return
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 4), layout="constrained")
    axes = figure.add_subplot()
    place = np.arange(len(rows))
    for field, label, mark in (
        ("published_kpa", "published, 6 c₁, all strains", "x"), ("smooth_kpa", "no friction", "^"),
        ("slide_kpa", "friction 0.3", "s"), ("stick_kpa", "sticking", "o"),
    ):  # fmt: skip
        axes.plot(place, [row[field] for row in rows], mark, label=label, ms=5, mfc="none")
    axes.set_xticks(place, [row["name"] for row in rows], rotation=60, ha="right", fontsize=7)
    axes.set(ylabel="E [kPa]", yscale="log", title="small-strain modulus of silicones from compression")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(folder / "measured-silicones.png", dpi=140)


SECTION = Section(
    title="Measured: silicone cylinders between platens",
    columns=(
        ("silicone", "name"), ("E, no friction [kPa]", "smooth_kpa"), ("E, friction 0.3", "slide_kpa"), ("E, sticking", "stick_kpa"),
        ("c₂/c₁, sticking", "stick_ratio"), ("RMS [% of greatest force]", "stick_rms_percent"), ("… neo-Hookean", "stick_neo_rms_percent"),
        ("… no friction", "smooth_rms_percent"), ("height lost [mm]", "stick_lost_mm"), ("two tests differ [%]", "stick_spread_percent"),
        ("6 c₁ published", "published_kpa"),
    ),
    cases=_silicone_cases,
    needs="--data DIR or $GELSIM_DATA, a folder of measured data that holds silicone_phantoms/",
    remarks=_silicone_remarks,
    draw=_draw,
)  # fmt: skip
