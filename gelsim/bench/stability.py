"""Section `stability`: named hard cases at `fast`, five load steps each, how each ended and a verdict.

A case is well if it converged, at the depth or force that it was to end at, with no element worse than LEAST_JACOBIAN, the surfaces
overlap by less than MOST_OVERLAP_UM, and the energy balance (gelsim/fem/energy.py) closes to MOST_DRIFT_PERCENT; pairs that must agree
(load steps, mirror images, precision of the factors, a spoiled mesh) say by how much they do.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from gelsim.bench.presses import SMOOTH, facts, press_case
from gelsim.bench.section import Case, Layer, Options, Row, Section
from gelsim.errors import PressEnd, SolveStatus
from gelsim.fem.problem import PressProblem
from gelsim.fem.quasistatic import run_press
from gelsim.geometry import TET_EDGES, TetMesh, jacobian_determinants, outer_faces, tet_quality, tet_volumes
from gelsim.pipeline import stages
from gelsim.pipeline.stages import MOST_OVERLAP_UM
from gelsim.scene import materials
from gelsim.scene.layers import build_scene

_SOLIDS: Layer = {"frames": 6, "symmetry": "mirror"}
"""Profiles ("auto") have fewer ways to fail."""


PLAIN = "ν 0.499, float32 factors, as always"
"""What others are held against."""

LONG = (
    "tilted block, its border inside the contact",
    "a thin-walled tube flattened by two thirds of its bore",
    "a rough surface",
    "stiff grains in a soft body",
    "25 kPa hemisphere R 25 until 9 N",
    "25 kPa hemisphere R 5, 18 mm deep",
)
"""Cases that a quick run leaves out: more than half of the section's time."""


def _cases(options: Options) -> Iterator[Case]:
    return (case for case in _all_cases() if not (options.quick and case.name in LONG))


def _all_cases() -> Iterator[Case]:
    def case(name: str, object: Layer | None = None, press: Layer | None = None, **sections: Layer) -> Case:
        scene = {"object": {"shape": "hemisphere"} | (object or {}), "press": _SOLIDS | (press or {}), "fidelity": "fast"} | sections
        return press_case(name, scene)

    plain = case(PLAIN)
    yield plain
    yield Case("the same with float64 factors", lambda: _in_float64(plain), plain.scene)
    stick: Layer = {"friction_coefficient": "stick"}
    for nu in (0.49, 0.4999, 0.49999):
        yield case(f"ν {nu} of both", {"poissons_ratio": nu}, gel={"poissons_ratio": nu})
    for gel, body in ((100.0, 1.0), (50.0, 5.0), (50.0, 5e3), (50.0, 5e4)):
        yield case(f"object {body:g} kPa on a gel of {gel:g} kPa", {"youngs_modulus_kpa": body}, gel={"youngs_modulus_kpa": gel})
    yield case("hemisphere R 2.5 into the dome", {"radius_mm": 2.5})
    yield case("rigid ball R 2.5, 1.2 mm deep", {"radius_mm": 2.5, "height_mm": 5.0, "rigid": True}, {"depth_mm": 1.2})
    yield case("sharp edge", {"shape": "edge"})
    yield case("sharp corner", {"shape": "corner"})
    yield case("sharp rigid corner", {"shape": "corner", "rigid": True}, {"depth_mm": 0.6})
    yield case("soft flat punch", {"shape": "punch", "radius_mm": 3.0})
    yield case("rigid flat punch, no friction", {"shape": "punch", "radius_mm": 3.0, "rigid": True}, {"depth_mm": 0.5}, contact=SMOOTH)
    yield case("rigid flat punch, stick", {"shape": "punch", "radius_mm": 3.0, "rigid": True}, {"depth_mm": 0.5}, contact=stick)
    yield case("tilt 20°", press={"tilt_deg": [0.0, 20.0]})
    low: Layer = {"height_mm": 6.0}  # a high body bends and hardly pulls at the gel
    yield case("2 mm shear, stick", low, {"shear_mm": [2.0, 0.0]}, contact=stick)
    yield case("2 mm shear, friction 0.5", low, {"shear_mm": [2.0, 0.0]}, contact={"friction_coefficient": 0.5})
    yield case("20° twist, friction 0.8", press={"twist_deg": 20.0})
    yield case("25 kPa hemisphere R 25 until 9 N", {"youngs_modulus_kpa": 25.0, "radius_mm": 25.0}, {"depth_mm": "none", "force_n": 9.0})
    yield case("25 kPa hemisphere R 5, 18 mm deep", {"youngs_modulus_kpa": 25.0}, {"depth_mm": 18.0})
    yield case("cylinder R 50 over the whole gel", {"shape": "cylinder", "radius_mm": 50.0}, {"depth_mm": 3.0}, gel={"profile": "flat"})
    yield case("half off the gel", press={"offset_mm": [12.5, 0.0]})
    yield case("tilted block, its border inside the contact", {"shape": "box"}, {"tilt_deg": [3.0, 5.0], "depth_mm": 0.6})
    yield case("cone", {"shape": "cone"})
    tube: Layer = {"shape": "tube", "radius_mm": 4.0, "height_mm": 10.0, "wall_mm": 0.8, "length_mm": 8.0, "shore_00": 20.0}
    yield case("a thin-walled tube flattened by two thirds of its bore", tube, {"depth_mm": 4.5}, gel={"profile": "flat", "shore_a": 40.0})
    yield case("a rough surface", {"shape": "rough", "amplitude_mm": 0.1, "wavelength_mm": 3.0, "width_mm": 6.0, "length_mm": 6.0,
                                   "height_mm": 6.0}, {"depth_mm": 0.5})  # fmt: skip
    yield case(
        "a skin of 1 mm, ten times stiffer", {"youngs_modulus_kpa": 60.0, "skin": {"thickness_mm": 1.0, "youngs_modulus_kpa": 600.0}}
    )
    grains: Layer = {"count": 3, "radius_mm": 1.2, "youngs_modulus_kpa": 5e3}
    yield case("stiff grains in a soft body", {"grains": grains})
    yield Case("a mesh of poor quality", lambda: _spoiled(plain.scene or {}), plain.scene)
    yield case("one load step", press={"frames": 2})
    yield case("50 load steps", press={"frames": 51})
    yield case("mirrored: offset and tilt +", press={"offset_mm": [2.0, 0.0], "tilt_deg": [0.0, 8.0]})
    yield case("mirrored: offset and tilt -", press={"offset_mm": [-2.0, 0.0], "tilt_deg": [0.0, -8.0]})


LEAST_JACOBIAN = 0.05
MOST_DRIFT_PERCENT = 3.0
"""Five steps: friction's loss is of second order in the step, up to 0.8 % at three steps in tests/invariance/test_press_balance.py."""

FEWEST_STEPS = 5
"""Load steps that the platen's work takes to be integrated so well."""

AGREEMENTS: dict[str, tuple[str, float, str]] = {
    "the same with float64 factors": (PLAIN, 0.05, "Newton's tolerance at `fast` is 0.03 %"),
    "one load step": ("50 load steps", 3.0, "one step sees the whole slip as one"),
    "mirrored: offset and tilt -": ("mirrored: offset and tilt +", 0.5, "the mesh is mirrored too, its numbering is not"),
    "a mesh of poor quality": (PLAIN, 5.0, "the bound of `fast`"),
}
"""Case: the one it must agree with in force, the bound [%], and why that."""


def _judged(rows: list[Row]) -> list[Row]:
    known = {row["name"]: row for row in rows}
    judged = []
    for row in rows:
        wrong, said = [], []
        if row["status"] != SolveStatus.CONVERGED.name:
            wrong.append(str(row.get("message") or row["status"]))
        else:
            for field, text, bad in (
                ("min_jacobian", "det F {:g}", row["min_jacobian"] < LEAST_JACOBIAN),
                ("penetration_um", "overlap {:g} µm", row["penetration_um"] > MOST_OVERLAP_UM),
                ("drift_percent", "energy drift {:g} %", row["states"] > FEWEST_STEPS and abs(row["drift_percent"]) > MOST_DRIFT_PERCENT),
            ):
                wrong += [text.format(row[field])] if bad else []
            short = not PressEnd(row["ended_by"]).wanted
            wrong += [f"ended at {row['approach_mm']:g} mm"] if short or row["states"] < row["states_wanted"] else []
        other, bound, _ = AGREEMENTS.get(row["name"], ("", 0.0, ""))
        if "force_n" in row and "force_n" in known.get(other, {}):
            apart = _apart(row["force_n"], known[other]["force_n"])
            (said if apart <= bound else wrong).append(f'{apart:.2g} % from "{other}" (bound {bound:g})')
        judged.append(row | {"verdict": "; ".join([*(f"NOT WELL: {text}" for text in wrong), *said]) or "well"})
    return judged


def _apart(force: list[float], other: list[float]) -> float:
    """Difference of two forces over the size of one [%]; of mirror images the sign of x does not count."""
    one, two = np.abs(force), np.abs(other)
    return 100 * float(np.linalg.norm(one - two) / np.linalg.norm(two))


def _remarks(rows: list[Row]) -> str:
    bad = [row["name"] for row in rows if row["verdict"].startswith("NOT")]
    limits = f"det F above {LEAST_JACOBIAN:g}, overlap below {MOST_OVERLAP_UM:g} µm, energy drift below {MOST_DRIFT_PERCENT:g} %"
    why = "; ".join(f"{name}: {bound:g} %, {reason}" for name, (_, bound, reason) in AGREEMENTS.items())
    return f"{len(rows) - len(bad)} of {len(rows)} are well ({limits}). Agreements: {why}." + (
        f" Not well: {'; '.join(bad)}." if bad else ""
    )


def _spoiled(scene: Layer) -> Row:
    """The scene on meshes of poor quality: inner vertices of both bodies moved as far as a quality of POOREST allows."""
    made = build_scene(scene)
    gel, body, placement = stages.bodies(made)
    assert isinstance(body, TetMesh)
    meshes = [spoil(mesh, np.random.default_rng(5)) for mesh in (gel, body)]
    problem = PressProblem(made, meshes[0], meshes[1], placement, materials.press_materials(made), "cpu")
    start = time.perf_counter()
    press = run_press(problem, throw=False)
    quality = [tet_quality(mesh.rest_positions, mesh.tets) for mesh in meshes]
    row: Row = {"fidelity": made.fidelity, "seconds": round(time.perf_counter() - start, 2)}
    row["smallest_quality"] = round(float(min(q.min() for q in quality)), 4)
    return row | facts(press, made.press.frames)


POOREST = 0.03
"""Mean-ratio quality of the worst tet; the mesher lets nothing below 0.02 through, and its own meshes reach 0.1 to 0.3."""


def spoil(mesh: TetMesh, rng: np.random.Generator) -> TetMesh:
    """A mesh whose inner vertices sit where, of twenty random places within their shortest edge, quality is poorest; its boundary stays."""
    nodes, tets = mesh.rest_positions.copy(), mesh.tets
    boundary = np.zeros(len(nodes), bool)
    boundary[np.unique(outer_faces(tets))] = True
    shift = np.zeros_like(nodes)
    around: dict[int, list[int]] = {}
    for number, four in enumerate(tets[:, :4]):
        for vertex in four:
            around.setdefault(int(vertex), []).append(number)
    for vertex, mine in around.items():
        if boundary[vertex]:
            continue
        near = tets[mine, :4]
        shortest = np.linalg.norm(nodes[near[near != vertex]] - nodes[vertex], axis=1).min()
        before, local, poorest = nodes[vertex].copy(), tets[mine][:, :4], np.inf
        best = before
        for _ in range(20):
            nodes[vertex] = before + shortest * rng.uniform(-1, 1, 3)
            quality = tet_quality(nodes, local).min() if tet_volumes(nodes, local).min() > 0 else 0.0
            if POOREST <= quality < poorest:
                best, poorest = nodes[vertex].copy(), quality
        nodes[vertex] = best
        shift[vertex] = nodes[vertex] - before
    while True:  # curved tets may fold where straight ones do not: their inner vertices go back
        nodes = mesh.rest_positions + shift
        for edge, middle in zip(TET_EDGES, tets[:, 4:].T, strict=True):
            nodes[middle] = mesh.rest_positions[middle] + 0.5 * shift[tets[:, edge]].sum(axis=1)
        size = jacobian_determinants(nodes, tets)
        folded = tets[size.min(axis=1) < 0.05 * np.abs(size).max(axis=1), :4]
        if not shift[folded].any():
            break
        shift[folded] = 0.0
    return TetMesh(nodes, tets, mesh.groups, mesh.symmetry)


def _in_float64(case: Case) -> Row:
    from gelsim.fem.linear import float64_factors

    with float64_factors():
        return case.measure()


SECTION = Section(
    title="Stability",
    columns=(
        ("case", "name"), ("ended", "status"), ("states", "states"), ("steps halved", "steps_halved"),
        ("Newton iterations", "newton_iterations"), ("smallest det F", "min_jacobian"), ("overlap [µm]", "penetration_um"),
        ("energy drift [%]", "drift_percent"), ("contact [mm²]", "contact_mm2"), ("force [N]", "force_n"),
        ("poorest tet", "smallest_quality"), ("seconds", "seconds"), ("verdict", "verdict"),
    ),
    cases=_cases,
    judge=_judged,
    remarks=_remarks,
)  # fmt: skip
