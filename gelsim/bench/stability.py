"""Section `stability`: named hard cases at `fast`, and how each ended."""

from __future__ import annotations

from collections.abc import Iterator

from gelsim.bench.presses import press_case
from gelsim.bench.section import Case, Layer, Options, Row, Section


def _cases(options: Options) -> Iterator[Case]:
    def case(name: str, object: Layer | None = None, press: Layer | None = None, **sections: Layer) -> Case:
        scene = {"object": {"shape": "hemisphere"} | (object or {}), "press": {"frames": 6} | (press or {}), "fidelity": "fast"} | sections
        return press_case(name, scene)

    plain = case("float32 factors, as always")
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
    yield case("rigid flat punch, stick", {"shape": "punch", "radius_mm": 3.0, "rigid": True}, {"depth_mm": 0.5}, contact=stick)
    yield case("tilt 20°", press={"tilt_deg": [0.0, 20.0]})
    yield case("2 mm shear, stick", press={"shear_mm": [2.0, 0.0]}, contact=stick)
    yield case("2 mm shear, friction 0.5", press={"shear_mm": [2.0, 0.0]}, contact={"friction_coefficient": 0.5})
    yield case("20° twist, friction 0.8", press={"twist_deg": 20.0})
    yield case("25 kPa hemisphere until 9 N", {"youngs_modulus_kpa": 25.0}, {"depth_mm": "none", "force_n": 9.0})
    yield case("cylinder R 50 over the whole gel", {"shape": "cylinder", "radius_mm": 50.0}, {"depth_mm": 0.6})
    yield case("half off the gel", press={"offset_mm": [11.0, 0.0]})
    yield case("tilted block, its border inside the contact", {"shape": "box"}, {"tilt_deg": [3.0, 5.0], "depth_mm": 0.6})
    yield case("cone", {"shape": "cone"})
    yield case("one load step", press={"frames": 2})
    yield case("50 load steps", press={"frames": 51})
    yield case("mirrored: offset and tilt +", press={"offset_mm": [2.0, 0.0], "tilt_deg": [0.0, 8.0]})
    yield case("mirrored: offset and tilt -", press={"offset_mm": [-2.0, 0.0], "tilt_deg": [0.0, -8.0]})


def _in_float64(case: Case) -> Row:
    from gelsim.fem.linear import float64_factors

    with float64_factors():
        return case.measure()


SECTION = Section(
    title="Stability",
    columns=(
        ("case", "name"), ("ended", "status"), ("states", "states"), ("steps halved", "steps_halved"),
        ("Newton iterations", "newton_iterations"), ("smallest det F", "min_jacobian"), ("overlap [µm]", "penetration_um"),
        ("force [N]", "force_n"), ("seconds", "seconds"),
    ),
    cases=_cases,
)  # fmt: skip
