"""What a press leaves behind: its states as they are found, and from them the `Deformation` of the whole body."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import SolveStatus
from gelsim.fem.elements import triangle_quadrature
from gelsim.fem.indicator import (
    DISTORTED,
    FORCE_ERROR_PER_JUMP,
    MEMBRANE_ERROR_PER_KINK,
    force_error,
    judged_states,
    stress_jump,
    surface_kink,
)
from gelsim.fem.problem import PressProblem
from gelsim.fem.self_contact import closing_gap
from gelsim.fem.touching import touching_area
from gelsim.geometry import QuadraticSurface, mirror_surface, split_faces
from gelsim.results import Deformation, ErrorEstimate, SolveReport, SurfaceMotion
from gelsim.scene.definition import Gel
from gelsim.scene.shape_table import SHAPES
from gelsim.shape.shapes import gel_height
from gelsim.units import KPA_PER_PA, MM_PER_M

Array = NDArray[np.float64]


class Recorder:
    """Keeps the states of a press."""

    def __init__(self, problem: PressProblem) -> None:
        self.problem = problem
        self.approach: list[float] = []
        self._time: list[float] = []
        self._numbers: dict[str, list[float]] = {}
        self._force: list[Array] = []
        self._pressure: list[Array] = []
        self._overlap: list[float] = []
        self._displacement: list[Array] = []
        self._clock = time.perf_counter()

    def keep(self, time_s: float, approach: float, newton_iterations: int, factorisations: int) -> None:
        """Records the present state, at a time [s] and an approach [m]; the counts are since the last one."""
        problem = self.problem
        now = time.perf_counter()
        area, pressure = self._contact()
        self.approach.append(approach)
        self._time.append(time_s)
        self._force.append(problem.contact_force())
        self._pressure.append(pressure)
        self._overlap.append(_mean_overlap(problem) / MM_PER_M)
        self._displacement.append(problem.solids.displacement.numpy() / MM_PER_M)
        numbers = {
            "contact_area": area,
            "min_jacobian": problem.solids.internal_force()[2],
            "penetration": problem.contact.overlap(problem.solids.positions()) / MM_PER_M,
            "newton_iterations": newton_iterations,
            "linear_iterations": factorisations,
            "seconds": now - self._clock,
        }
        for name, value in numbers.items():
            self._numbers.setdefault(name, []).append(value)
        self._clock = now

    def deformation(self, status: SolveStatus, message: str, steps_halved: int) -> Deformation:
        """Everything kept so far, reflected to the whole body."""
        problem = self.problem
        everything = np.array(self._displacement)
        gel_motion, object_motion, pressure = self._surfaces(everything)
        judged = judged_states(-np.array(self._force)[:, 2])
        jump = np.array([self._jump(everything[i]) for i in judged])
        approach, overlap = np.array(self.approach)[judged], np.array(self._overlap)[judged]
        of_force = force_error(jump, overlap, approach, self._per_jump(min(self._numbers["min_jacobian"])))
        # of the last state kept: after a failure the solids hold that one again
        kink = self._kink(everything[-1])
        hollow = not problem.scene.object.rigid and SHAPES[problem.scene.object.shape].hollow
        told = [*(_self_contact(object_motion) if hollow else []), *_beyond_border(problem.scene.gel, object_motion)]
        numbers = {name: np.array(values) for name, values in self._numbers.items()}
        for name in ("newton_iterations", "linear_iterations"):
            numbers[name] = numbers[name].astype(np.int32)
        return Deformation(
            approach=np.array(self.approach),
            time=np.array(self._time),
            force=np.array(self._force),
            contact_pressure=pressure,
            gel=gel_motion,
            object=object_motion,
            converged=np.ones(len(everything), bool),
            status=status,
            message=message,
            report=SolveReport(
                warnings=tuple(told),
                unknowns=problem.solids.unknowns,
                steps_halved=steps_halved,
                coat_n_per_m=problem.scene.gel.coat_n_per_m or None,
                symmetry=self._symmetry(),
                rigid_object=problem.scene.object.rigid,
                linear_solver=problem.linear_solver,
                factorisations=int(numbers["linear_iterations"].sum()),
                stress_jump=float(jump[-1]),
                error_estimate=ErrorEstimate(of_force, MEMBRANE_ERROR_PER_KINK * kink * 1e6),
            ),
            **numbers,
        )

    def _contact(self) -> tuple[float, Array]:
        return _area_and_pressure(self.problem)

    def _jump(self, displacement: Array) -> float:
        problem = self.problem
        return stress_jump(problem.solids.tets, problem.quadrature, problem.shear, displacement * MM_PER_M, problem.regions)

    def _per_jump(self, smallest_jacobian: float) -> float:
        return FORCE_ERROR_PER_JUMP["solid" if smallest_jacobian > DISTORTED else "profile"]

    def _kink(self, displacement: Array) -> float:
        gel = self.problem.gel
        return surface_kink(gel.rest_positions, gel.groups["coated"], displacement)

    def _symmetry(self) -> str | tuple[str, ...]:
        return tuple(sorted(self.problem.gel.symmetry))

    def _surfaces(self, everything: Array) -> tuple[SurfaceMotion, SurfaceMotion, Array]:
        """Motion of the gel's outer face and of the object's, and the pressure at the gel's nodes, all of the whole body."""
        problem = self.problem
        gel = problem.gel
        coated = np.unique(gel.groups["coated"])
        pressure = np.array(self._pressure)[:, coated]
        gel_motion, pressure = whole_surface(gel.surface("coated"), everything[:, coated], pressure, gel.symmetry)
        placed, moved = problem.object_surface(everything)
        object_motion, _ = whole_surface(placed, moved, np.zeros(moved.shape[:2]), gel.symmetry)
        return gel_motion, object_motion, pressure


def _self_contact(surface: SurfaceMotion) -> list[str]:
    found = closing_gap(surface.rest, surface.faces6[:, :3], surface.displacement)
    if found is None:
        return []
    state, gap = found
    return [f"the object comes to touch itself, which is not modelled: {gap * MM_PER_M:.2g} mm left in state {state}, maybe overrun later"]


def _beyond_border(gel: Gel, surface: SurfaceMotion) -> list[str]:
    """A note where the object, at the height of the gel's face or below, ends beyond the gel."""
    half = np.array(gel.size_mm) / 2 / MM_PER_M
    moved = surface.displacement[-1]
    # On average, as what ends flush with the gel bulges beyond it.
    place = surface.rest[:, :2] + moved[:, :2].mean(axis=0)
    nearest = np.clip(place, -half, half)
    low = surface.rest[:, 2] + moved[:, 2] < gel_height(gel, nearest)
    reach = np.abs(place - nearest).max(axis=1)[low].max(initial=0.0)
    if reach <= 0.1 * gel.thickness_mm / MM_PER_M:
        return []
    return [
        f"the object goes {reach * MM_PER_M:.2g} mm beyond the border of the gel (gel.size_mm = {gel.size_mm[0]:g} {gel.size_mm[1]:g} mm), "
        "whose sides are free: no housing beside it"
    ]


def _mean_overlap(problem: PressProblem) -> float:
    """Of the points in contact, weighted with the force that each carries [solver units of length]."""
    contact = problem.contact
    share = contact.rest_weight * np.asarray(contact.pressure.numpy(), np.float64)
    overlap = np.maximum(-contact.gap.numpy(), 0.0)
    return float((share * overlap)[share > 0].sum() / max(share.sum(), 1e-300))


def _area_and_pressure(problem: PressProblem) -> tuple[float, Array]:
    """Area in contact [m²] of the whole body as the camera sees it (projected on the window), and pressure [Pa] at all nodes.

    Projected, it is π a² of a round contact of radius a; along the curved membrane a ball of R = 5 mm at 1 mm would show 10 % more.
    """
    contact, solids = problem.contact, problem.solids
    x = solids.rest + solids.displacement.numpy()
    weight = contact.rest_weight.reshape(len(contact.slave_faces), -1)
    pressure = np.asarray(contact.pressure.numpy(), np.float64).reshape(weight.shape)
    # augmentation leaves half the penalty's smoothing as overlap
    opening = contact.gap.numpy().reshape(weight.shape) + problem.law.smoothing / 2
    area = touching_area(x, contact.slave_faces, opening, pressure) * problem.copies / MM_PER_M**2
    hats = _hats(triangle_quadrature(contact.points)[0])
    loads, nodes = (weight, weight * pressure), contact.slave_faces.ravel()
    total, carried = (np.bincount(nodes, (load @ hats).ravel(), solids.node_count) for load in loads)
    mean = carried / np.where(total > 0, total, 1.0)
    return float(area), mean / KPA_PER_PA


def _hats(bary: Array) -> Array:
    """Piecewise linear hat functions of the four sub-triangles of a six-node face, (Q, 6): positive weights to average with."""
    values = np.zeros((len(bary), 6))
    values[:, :3] = np.maximum(2 * bary - 1, 0.0)
    for side, (one, other, away) in enumerate(((0, 1, 2), (1, 2, 0), (2, 0, 1))):
        a, b = bary[:, one], bary[:, other]
        values[:, 3 + side] = np.where(a >= 0.5, 2 * b, np.where(b >= 0.5, 2 * a, np.maximum(1 - 2 * bary[:, away], 0.0)))
    return values


def whole_surface(surface: QuadraticSurface, displacement: Array, scalar: Array, symmetry: frozenset[str]) -> tuple[SurfaceMotion, Array]:
    """A surface with its displacement (N, G, 3) and a scalar field (N, G), reflected at the symmetry planes."""
    for axis in sorted(symmetry):
        column = "xy".index(axis)
        image = np.flatnonzero(np.abs(surface.nodes[:, column]) > 0)
        flipped = displacement[:, image].copy()
        flipped[..., column] *= -1
        displacement = np.concatenate([displacement, flipped], axis=1)
        scalar = np.concatenate([scalar, scalar[:, image]], axis=1)
        surface = mirror_surface(surface, axis)
        assert len(surface.nodes) == displacement.shape[1]
    return SurfaceMotion(surface.nodes, split_faces(surface.faces), displacement, surface.faces), scalar
