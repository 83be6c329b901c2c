"""Section `batch`: presses a second of many scenes solved side by side, against batch size and mesh, with the roofline beside it.

The scenes are the hemisphere of section `speed` with moduli from 100 to 400 kPa; the first is its 200 kPa, whose error against the
reference is shown. On CUDA where there is a device; else on the CPU, small. Each batch runs twice: for the total, from meshes to results,
and with a wait after each stage for the shares.

Roofline: bytes that the chosen algorithm cannot avoid (matrix and factor written once and read, element data and matrix at each assembly,
element data at each residual) over the measured bandwidth of a copy.
"""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from gelsim.bench.accuracy import press_errors
from gelsim.bench.presses import hemisphere
from gelsim.bench.section import Case, Options, Row, Section
from gelsim.errors import SolveStatus
from gelsim.scene.layers import build_scene

_ROWS = {"nu": 0.499, "object_modulus_kPa": 200.0}
_STAGES = ("residual", "tangent", "factorise", "solve", "pattern", "march", "prepare")


def _cases(options: Options) -> Iterator[Case]:
    from gelsim.fem import batch_device

    device = batch_device("auto")
    if device == "cpu":
        sizes: dict[str, tuple[int, ...]] = {"fast": (1, 4)}
    elif options.quick:
        sizes = {"balanced": (16,)}
    else:
        sizes = {"fast": (16, 64), "balanced": (1, 4, 16, 64), "reference": (16,)}
    for fidelity, batches in sizes.items():
        for batch in batches:
            yield Case(f"quarter, {fidelity}, batch of {batch}", partial(_measure, "mirror", fidelity, batch, device))
    if device != "cpu" and not options.quick:
        yield Case("whole body, balanced, batch of 4", partial(_measure, "none", "balanced", 4, device))
        yield Case("quarter, balanced, 3 processes with a batch of 64", partial(_side_by_side, 3, "balanced", 64, device))


def _scenes(symmetry: str, fidelity: str, batch: int) -> list[Any]:
    """Hemispheres of many moduli on one pair of meshes, ready for `solve_batch`; the first is the reference's."""
    from gelsim.pipeline.stages import bodies

    moduli = [200.0, *np.geomspace(100.0, 400.0, batch - 1)] if batch > 1 else [200.0]
    scenes = [build_scene(hemisphere(modulus, 0.499, symmetry=symmetry) | {"fidelity": fidelity}) for modulus in moduli]
    shared = bodies(scenes[0])
    return [(scene, *shared) for scene in scenes]


def _side_by_side(processes: int, fidelity: str, batch: int, device: str) -> Row:
    """Several processes on one device: while one decides, the others compute."""
    context = multiprocessing.get_context("spawn")
    ready, done = context.Barrier(processes + 1), context.Barrier(processes + 1)
    children = [context.Process(target=_child, args=(fidelity, batch, device, ready, done)) for _ in range(processes)]
    for child in children:
        child.start()
    ready.wait(300)
    start = time.perf_counter()
    done.wait(600)
    seconds = time.perf_counter() - start
    for child in children:
        child.join()
    return {
        "status": SolveStatus.CONVERGED.name,
        "device": device,
        "batch": batch,
        "seconds": round(seconds, 3),
        "presses_per_second": round(processes * batch / seconds, 2),
    }


def _child(fidelity: str, batch: int, device: str, ready: Any, done: Any) -> None:
    from gelsim.fem import solve_batch

    scenes = _scenes("mirror", fidelity, batch)
    solve_batch(scenes[:2], device=device)
    ready.wait(300)
    presses = solve_batch(scenes, device=device)
    if any(press.status is not SolveStatus.CONVERGED for press in presses):
        done.abort()
    done.wait(600)


def _measure(symmetry: str, fidelity: str, batch: int, device: str) -> Row:
    from gelsim.fem import solve_batch
    from gelsim.fem.batch import Costs, copy_bandwidth

    prepared = _scenes(symmetry, fidelity, batch)
    solve_batch(prepared[:2], device=device)  # kernels are compiled and loaded
    costs = Costs()
    start = time.perf_counter()
    presses = solve_batch(prepared, device=device)
    seconds = time.perf_counter() - start
    solve_batch(prepared, device=device, costs=costs)
    failed = {number: press for number, press in enumerate(presses) if press.status is not SolveStatus.CONVERGED}
    bandwidth = copy_bandwidth(device)
    tens = {name: costs.calls.get(name, 0) * batch for name in ("residual", "tangent")}
    systems = costs.systems
    moved = 8.0 * systems["factorise"] * (costs.matrix_entries + costs.factor_entries) + 16.0 * systems["solve"] * costs.factor_entries
    moved += costs.element_bytes * (tens["residual"] + tens["tangent"]) + 16.0 * costs.matrix_entries * tens["tangent"]
    bound = moved / bandwidth
    row: Row = {
        "status": next((press.status.name for press in failed.values()), SolveStatus.CONVERGED.name),
        "message": "; ".join(f"{number}: {press.message}" for number, press in failed.items()),
        "failed": len(failed),
        "tried_again": sum(press.report.tried != 1 for press in presses),
        "device": device,
        "batch": batch,
        "unknowns": costs.unknowns,
        "seconds": round(seconds, 3),
        "presses_per_second": round(batch / seconds, 2),
        "newton_iterations": round(float(np.mean([press.newton_iterations.sum() for press in presses])), 1),
        "factorisations": round(systems["factorise"] / batch, 1),
        "roofline_ms": round(1e3 * bound / batch, 2),
        "roofline_share": round(bound / seconds, 3),
        "bandwidth_gb_s": round(bandwidth / 1e9),
    }
    for name in _STAGES:
        row[f"{name}_ms"] = round(1e3 * costs.seconds.get(name, 0.0) / batch, 2)
    return row | press_errors(presses[0], name="hemisphere_force.csv", wanted=_ROWS, modulus="200.0")


SECTION = Section(
    title="Batches",
    columns=(
        ("case", "name"), ("device", "device"), ("unknowns", "unknowns"), ("presses a second", "presses_per_second"),
        ("stopped early", "failed"), ("tried again", "tried_again"),
        ("force error, largest [%]", "force_error_percent"), ("Newton iterations a press", "newton_iterations"),
        ("factorisations", "factorisations"), ("factorise [ms]", "factorise_ms"), ("solve", "solve_ms"), ("residual", "residual_ms"),
        ("tangent", "tangent_ms"), ("pattern", "pattern_ms"), ("march", "march_ms"), ("roofline [ms]", "roofline_ms"),
        ("share reached", "roofline_share"), ("prepare [ms]", "prepare_ms"),
    ),
    cases=_cases,
)  # fmt: skip
