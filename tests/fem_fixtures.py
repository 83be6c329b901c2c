"""Presses for the tests of the mechanics, on the structured meshes of gelsim.bench.structured."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gelsim.bench.structured import box_mesh, flat_gel, quarter_disc, soft_cap
from gelsim.errors import SolveStatus
from gelsim.fem.equilibrium import equilibrium, residual_of, solids_of, tangent_of
from gelsim.fem.problem import Numerics, PressProblem
from gelsim.fem.quasistatic import run_press
from gelsim.geometry import QuadraticSurface, TetMesh, mirror, mirror_surface
from gelsim.results import Deformation
from gelsim.scene import materials
from gelsim.scene.definition import Body, Contact, Gel, Press, Scene
from gelsim.shape import shapes

__all__ = ["box_mesh", "equilibrium", "flat_gel", "quarter_disc", "residual_of", "soft_cap", "solids_of", "tangent_of"]
wp.config.quiet = True
Array = NDArray[np.float64]
MM = MILLI = 1e-3
E_GEL = 50.0  # kPa, the gel of the reference solutions
TOLERANCE = 1e-5  # Newton's in the tests: finer than "fast" has it, so that what is compared is the equations and not where Newton stops


def cap_scene(
    modulus_kpa: float, depth_mm: float, frames: int, friction: float | str = 0.0, gel_kpa: float = E_GEL, **press: object
) -> Scene:
    """`soft_cap` on the flat gel."""
    return Scene(
        gel=Gel(profile="flat", youngs_modulus_kpa=gel_kpa),
        object=Body(shape="hemisphere", radius_mm=5.0, height_mm=8.0, youngs_modulus_kpa=modulus_kpa),
        contact=Contact(friction_coefficient=friction),
        press=Press(depth_mm=depth_mm, force_n=None, frames=frames, **press),  # type: ignore[arg-type]
        fidelity="fast",
    )


def ball_scene(depth_mm: float, frames: int, nu: float = 0.499, friction: float | str = 0.0, radius_mm: float = 5.0,
               modulus_kpa: float = E_GEL, fidelity: str = "fast", **press: object) -> Scene:  # fmt: skip
    """A rigid ball on the flat gel of the reference solutions."""
    return Scene(
        gel=Gel(profile="flat", youngs_modulus_kpa=modulus_kpa, poissons_ratio=nu),
        object=Body(shape="hemisphere", radius_mm=radius_mm, height_mm=10.0, rigid=True),
        contact=Contact(friction_coefficient=friction),
        press=Press(depth_mm=depth_mm, force_n=None, frames=frames, **press),  # type: ignore[arg-type]
        fidelity=fidelity,
    )


def problem_of(scene: Scene, gel: TetMesh, body: TetMesh | QuadraticSurface, **points: Any) -> PressProblem:
    surface = body if isinstance(body, QuadraticSurface) else body.surface("contact")
    given = scene, gel, body, shapes.placement(scene, surface), materials.press_materials(scene), "cpu"
    problem = PressProblem(*given, Numerics(tolerance=TOLERANCE, **points))
    # Contact multipliers take over from a rough solution, so how rough it is shows in the end: with rough steps a whole ball and its
    # quarter differ by up to 0.9 µm of 300.
    problem.options = replace(problem.options, exact_after=0)
    return problem


@lru_cache
def rigid_quarter(scene: Scene) -> QuadraticSurface:
    return shapes.rigid_surface(scene, frozenset("xy"))


def rigid_body(scene: Scene, gel: TetMesh) -> QuadraticSurface:
    """The object's surface, cut where the gel is; the whole one is the quarter mirrored, so that both see the same facets."""
    surface = rigid_quarter(scene)
    for axis in sorted({"x", "y"} - gel.symmetry):
        surface = mirror_surface(surface, axis)
    return surface


@lru_cache
def ball_press(scene: Scene, fine_mm: float = 0.5, reach_mm: float = 2.5, whole: str = "") -> tuple[PressProblem, Deformation]:
    """A solved press on the structured gel, and the problem in its last state."""
    gel = flat_gel(fine_mm, reach_mm, whole=whole)
    return solved(problem_of(scene, gel, rigid_body(scene, gel)))


@lru_cache
def cap_press(scene: Scene, whole: str = "") -> tuple[PressProblem, Deformation]:
    """The same of `soft_cap`."""
    body = soft_cap()
    for axis in whole:
        body = mirror(body, axis)
    return solved(problem_of(scene, flat_gel(0.7, 2.1, whole=whole), body))


def solved(problem: PressProblem) -> tuple[PressProblem, Deformation]:
    deformation = run_press(problem)
    assert deformation.status is SolveStatus.CONVERGED
    return problem, deformation
