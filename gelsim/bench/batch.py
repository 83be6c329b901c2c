"""Section `batch`: presses a second of many scenes solved side by side, against batch size and mesh, with the roofline beside it.

The scenes are the hemisphere of section `speed` with moduli from 100 to 400 kPa; the first is its 200 kPa, whose error against the
reference is shown. On CUDA where there is a device; else on the CPU, small. Making the problems (arrays of each scene; meshes are shared)
is not in the seconds but beside them. Each batch runs twice: for the total, and with a wait after each stage for the shares.

Roofline: bytes that the chosen algorithm cannot avoid (matrix and factor written once and read, element data and matrix at each assembly,
element data at each residual) over the measured bandwidth of a copy; what the factorisation computes is said in GFLOP/s.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import cache, partial
from typing import Any

import numpy as np

from gelsim import materials
from gelsim.bench.accuracy import press_errors
from gelsim.bench.presses import hemisphere
from gelsim.bench.section import Case, Options, Row, Section
from gelsim.errors import SolveStatus
from gelsim.scene_file import build_scene

_ROWS = {"nu": 0.499, "object_modulus_kPa": 200.0}
_STAGES = ("residual", "tangent", "factorise", "solve", "pattern", "march")


def _cases(options: Options) -> Iterator[Case]:
    from gelsim.fem import batch_device

    device = batch_device("auto")
    if device == "cpu":
        sizes: dict[str, tuple[int, ...]] = {"fast": (1, 4)}
    elif options.quick:
        sizes = {"balanced": (16,)}
    else:
        sizes = {"fast": (64, 256), "balanced": (1, 4, 16, 64, 128), "reference": (64,)}
    for fidelity, batches in sizes.items():
        for batch in batches:
            yield Case(f"quarter, {fidelity}, batch of {batch}", partial(_measure, "auto", fidelity, batch, device))
    if device != "cpu" and not options.quick:
        for batch in (4, 32):
            yield Case(f"whole body, balanced, batch of {batch}", partial(_measure, "none", "balanced", batch, device))


def _measure(symmetry: str, fidelity: str, batch: int, device: str) -> Row:
    from gelsim.fem.batch import Costs, run_batch
    from gelsim.fem.problem import PressProblem
    from gelsim.pipeline import bodies

    moduli = [200.0, *np.geomspace(100.0, 400.0, batch - 1)] if batch > 1 else [200.0]
    scenes = [build_scene(hemisphere(modulus, 0.499, symmetry=symmetry) | {"fidelity": fidelity}) for modulus in moduli]

    shared = bodies(scenes[0])

    def problems() -> list[Any]:
        return [PressProblem(scene, *shared, materials.gel_material(scene), materials.object_material(scene), device) for scene in scenes]

    run_batch(problems()[:2])  # kernels are compiled and loaded
    start = time.perf_counter()
    prepared = problems()
    middle = time.perf_counter()
    presses = run_batch(prepared)
    seconds = time.perf_counter() - middle
    del prepared
    costs = Costs()
    run_batch(problems(), costs=costs)
    failed = [press for press in presses if press.status is not SolveStatus.CONVERGED]
    bandwidth = _bandwidth(device)
    tens = {name: costs.calls.get(name, 0) * batch for name in ("residual", "tangent")}
    systems = costs.systems
    moved = 8.0 * systems["factorise"] * (costs.matrix_entries + costs.factor_entries) + 16.0 * systems["solve"] * costs.factor_entries
    moved += costs.element_bytes * (tens["residual"] + tens["tangent"]) + 16.0 * costs.matrix_entries * tens["tangent"]
    bound = moved / bandwidth
    row: Row = {
        "status": SolveStatus.CONVERGED.name if not failed else failed[0].status.name,
        "message": failed[0].message if failed else "",
        "device": device,
        "batch": batch,
        "unknowns": costs.unknowns,
        "seconds": round(seconds, 3),
        "prepare_seconds": round(middle - start, 3),
        "presses_per_second": round(batch / seconds, 2),
        "newton_iterations": round(float(np.mean([press.newton_iterations.sum() for press in presses])), 1),
        "factorisations": round(systems["factorise"] / batch, 1),
        "roofline_ms": round(1e3 * bound / batch, 2),
        "roofline_share": round(bound / seconds, 3),
        "bandwidth_gb_s": round(bandwidth / 1e9),
        "factor_gflops": round(systems["factorise"] * costs.factor_flops / costs.seconds["factorise"] / 1e9),
    }
    for name in _STAGES:
        row[f"{name}_ms"] = round(1e3 * costs.seconds.get(name, 0.0) / batch, 2)
    return row | press_errors(presses[0], name="hemisphere_force.csv", wanted=_ROWS)


@cache
def _bandwidth(device: str) -> float:
    """Bytes a second of a large copy, read and written."""
    import warp as wp

    count = 1 << (27 if device.startswith("cuda") else 23)
    a, b = (wp.zeros(count, dtype=wp.float64, device=device) for _ in range(2))
    best = np.inf
    for _ in range(5):
        wp.synchronize_device(device)
        start = time.perf_counter()
        wp.copy(a, b)
        wp.synchronize_device(device)
        best = min(best, time.perf_counter() - start)
    return 16.0 * count / best


SECTION = Section(
    title="Batches",
    columns=(
        ("case", "name"), ("device", "device"), ("unknowns", "unknowns"), ("presses a second", "presses_per_second"),
        ("force error, largest [%]", "force_error_percent"), ("Newton iterations a press", "newton_iterations"),
        ("factorisations", "factorisations"), ("factorise [ms]", "factorise_ms"), ("solve", "solve_ms"), ("residual", "residual_ms"),
        ("tangent", "tangent_ms"), ("pattern", "pattern_ms"), ("march", "march_ms"), ("roofline [ms]", "roofline_ms"),
        ("share reached", "roofline_share"), ("factor GFLOP/s", "factor_gflops"), ("prepare [s]", "prepare_seconds"),
    ),
    cases=_cases,
)  # fmt: skip
