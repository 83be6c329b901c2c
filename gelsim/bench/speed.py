"""Section `speed`: the coupled hemisphere as a profile, as a quarter and as a whole body, with the error beside the seconds.

Seconds are wall seconds of the solve alone, kernels compiled and meshes cached before; a busy machine makes them longer.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from gelsim.bench.accuracy import FIDELITIES, press_errors
from gelsim.bench.presses import hemisphere, press_case
from gelsim.bench.section import Case, Options, Section

_ROWS = {"nu": 0.499, "object_modulus_kPa": 200.0}


def _cases(options: Options) -> Iterator[Case]:
    for symmetry, said in (("auto", "profile, found by itself"), ("mirror", "quarter"), ("none", "whole body")):
        for fidelity in () if options.quick and symmetry == "none" else FIDELITIES[:2]:
            scene = hemisphere(200.0, 0.499, symmetry=symmetry) | {"fidelity": fidelity}
            errors = partial(press_errors, name="hemisphere_force.csv", wanted=_ROWS, modulus="200.0")
            yield press_case(f"hemisphere, {said}, {fidelity}", scene, errors)


SECTION = Section(
    title="Speed",
    columns=(
        ("case", "name"), ("unknowns", "unknowns"), ("Newton iterations", "newton_iterations"), ("factorisations", "factorisations"),
        ("force error, largest [%]", "force_error_percent"), ("seconds", "seconds"),
    ),
    cases=_cases,
)  # fmt: skip
