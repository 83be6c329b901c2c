"""Contact finite elements: gel and object, solved together. `rigid_placement`, `solve_press`, `solve_batch` and `differentiate_press` are
the doors; the rest is behind them."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gelsim.geometry import PlanarMesh, QuadraticSurface, TetMesh
from gelsim.results import Deformation, PressSensitivity
from gelsim.scene.definition import Scene

if TYPE_CHECKING:
    from gelsim.fem.batch import Costs
    from gelsim.fem.problem import PressProblem
    from gelsim.fem.quasistatic import Course
    from gelsim.fem.strategy import Try


@cache
def quiet_warp() -> None:
    """Keeps Warp's greeting, its compiler's progress, and that there is no GPU, off the terminal; before anything of it is used."""
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    sys.stderr.flush()
    kept = os.dup(2)
    with tempfile.TemporaryFile() as said:  # its library writes that line to the standard error itself
        os.dup2(said.fileno(), 2)
        try:
            wp.init()
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            said.seek(0)
            os.write(2, b"".join(line for line in said if b"Could not find or load the NVIDIA CUDA driver" not in line))


def rigid_placement(scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where a rigid object, its edges rounded, first touches the gel (`field.placement`)."""
    quiet_warp()
    from gelsim.fem.field import placement

    return placement(scene)


def solve_press(
    scene: Scene,
    gel: TetMesh,
    body: TetMesh | QuadraticSurface,
    placement: tuple,
    *,
    device: str = "auto",
    progress: Callable[[int, int], None] | None = None,
    enough: Callable[[Deformation], bool] | None = None,
) -> Deformation:
    """Solves a press; one that ends where no equilibrium is found is tried again (`strategy.ways`); the one that got furthest is returned.

    The second try goes on from where the first stands, with twelve contact points a face at least and volume held at points too; where that
    does not get there soon, the third begins at rest: so under a soft object, with a coat of the gel under a rigid one. Volume held at
    points keeps crushed tets from folding, a coat a face from creasing, and either makes a press a few per cent stiffer
    (docs/mechanics.md). What overlaps is solved again with more points. The press's report says so.

    Args:
        gel: The gel's mesh; its `symmetry` must be the body's.
        body: The object's mesh, or only its surface where it is rigid; in the object's frame.
        placement: Rotation (3, 3) and translation (3,) [m] that bring it to first touch.
        device: "auto" and "cpu" run here; "cuda" solves on the GPU (as a batch of one), or without cuDSS only assembles there.
        progress: Called with (states recorded, states wanted).
        enough: Whether a press has got so far that it need not begin at rest again, should it end; tries that go on it has still.
    """
    quiet_warp()
    from gelsim.fem.batch import run_batch
    from gelsim.fem.quasistatic import run_press
    from gelsim.fem.strategy import tries

    name = "cuda:0" if device == "cuda" else "cpu"
    marching = tries(scene, enough)
    way, course = next(marching)
    while True:
        problem = _problem(way, scene, gel, body, placement, name)
        if name != "cpu" and problem.memory is None and solves_on_gpu():
            press = run_batch([problem], courses=[course], states=progress)[0]
        else:
            press = run_press(problem, course=course, progress=progress, throw=False)
        try:
            way, course = marching.send(press)
        except StopIteration as end:
            return end.value


def _problem(
    way: Try, scene: Scene, gel: TetMesh, body: TetMesh | QuadraticSurface, placement: tuple, device: str, *, patient: bool | None = None
) -> PressProblem:
    """A press as a try discretises it; `patient` None: where volume is held from rest on."""
    from gelsim.fem.problem import Numerics, PressProblem
    from gelsim.scene.materials import press_materials

    patient = (way.held > 0.0 and not way.goes_on) if patient is None else patient
    numerics = Numerics(contact_points=way.contact_points, held=way.held, most_wasted=way.most_wasted, patient=patient)
    return PressProblem(way.of(scene), gel, body, placement, press_materials(scene), device, numerics)


def solves_on_gpu() -> bool:
    """Whether a press on "cuda" is solved there, not only assembled."""
    from gelsim.fem.cudss import find_cudss

    return find_cudss() is not None


def batch_device(device: str) -> str:
    """Warp's name of the device for a batch: "auto" is CUDA where there is one."""
    import warp as wp

    if device == "cpu" or (device == "auto" and not wp.is_cuda_available()):
        return "cpu"
    return "cuda:0"


def solve_batch(
    bodies: Sequence[tuple], *, device: str, progress: Callable[[int, int], None] | None = None, costs: Costs | None = None
) -> list[Deformation]:
    """Solves presses with the same meshes side by side; those that end where no equilibrium is found have another try as by `solve_press`.

    Args:
        bodies: Of each press the scene, gel, body and placement, as `solve_press` takes them.
        device: "cpu" or "cuda:0".
        progress: Called with (presses done, presses).
        costs: A `batch.Costs`, filled with where the time went.
    """
    quiet_warp()
    from gelsim.fem.batch import run_batch
    from gelsim.fem.strategy import tries

    done: dict[int, Deformation] = {}
    marching = [tries(scene) for scene, *_ in bodies]
    asked = {number: next(one) for number, one in enumerate(marching)}
    while asked:
        groups: dict[Try, dict[int, Course]] = {}
        for number, (way, course) in asked.items():
            groups.setdefault(way, {})[number] = course
        left, asked = len(asked), {}
        for way, several in groups.items():
            problems, start = [], time.perf_counter()
            for number in several:
                scene, gel, body, placement = bodies[number]
                problems.append(_problem(way, scene, gel, body, placement, device))
            if costs is not None:
                costs.seconds["prepare"] = costs.seconds.get("prepare", 0.0) + time.perf_counter() - start
            told = None if progress is None else partial(_told, progress, len(bodies) - left, len(bodies))
            left -= len(several)
            for number, press in zip(several, run_batch(problems, courses=list(several.values()), progress=told, costs=costs), strict=True):
                try:
                    asked[number] = marching[number].send(press)
                except StopIteration as end:
                    done[number] = end.value
    return [done[number] for number in range(len(bodies))]


def _told(progress: Callable[[int, int], None], before: int, all_of_them: int, done: int, _: int) -> None:
    """Tells how many presses of a batch are done, `before` of them in an earlier try."""
    progress(before + done, all_of_them)


def differentiate_press(
    scene: Scene,
    gel: TetMesh,
    body: TetMesh | QuadraticSurface,
    placement: tuple,
    *,
    nodes: NDArray[np.integer],
    shares: NDArray[np.float64],
) -> PressSensitivity:
    """Solves a press on the CPU, and differentiates force and surface heights at every recorded state (`sensitivity.py`).

    Args:
        gel, body, placement: As of `solve_press`.
        nodes: The gel's nodes (Q, K) whose heights are mixed by `shares` (Q, K).
    Raises:
        SceneError: The scene has friction or viscosity. gelsim.errors.SolveError: the press failed, or a state could not be refined.
    """
    quiet_warp()
    from gelsim.fem.sensitivity import press_sensitivity
    from gelsim.fem.strategy import PLAIN, contact_points
    from gelsim.scene.materials import press_materials

    problem = _problem(replace(PLAIN, contact_points=contact_points(scene)), scene, gel, body, placement, "cpu", patient=True)
    return press_sensitivity(problem, [m.youngs_modulus * 1e-3 for m in press_materials(scene)], list(zip(nodes, shares, strict=True)))


def solve_planar(
    scene: Scene,
    gel: PlanarMesh,
    body: PlanarMesh,
    *,
    depth_mm: float | None,
    progress: Callable[[int, int], None] | None = None,
    throw: bool = True,
) -> Deformation:
    """Solves a press that reduces to a plane; what comes back is the whole body's. Always on the CPU: it is too small for a GPU.

    Args:
        gel, body: Profiles as they just touch; a rigid body's has edges only.
        depth_mm: Length along y in plane strain; None for bodies of revolution.
    Raises:
        gelsim.errors.SolveError: (with `throw`) Newton failed at the smallest step; carries what was solved.
    """
    quiet_warp()
    from gelsim.fem.planar.problem import PlanarProblem
    from gelsim.fem.planar.recording import PlanarRecorder
    from gelsim.fem.quasistatic import run_press
    from gelsim.scene.materials import gel_material, object_materials

    problem = PlanarProblem(scene, gel, body, gel_material(scene), object_materials(scene).get("body"), depth_mm)
    return run_press(problem, record=PlanarRecorder, progress=progress, throw=throw)
