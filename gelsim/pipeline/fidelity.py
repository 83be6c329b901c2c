"""The cheapest press that meets a target error: a fidelity is predicted, solved, asked for its own error, and refined where that is too
large.

A press estimates its error from itself (`gelsim.fem.indicator`); of the force that is on the safe side, by a factor of three to eight on
smooth bodies. Where a second, finer press was needed the two say more: their difference d is the coarser one's error but for the finer
one's, and with errors in proportion to η², of which the finer press has the share q of the coarser's, the finer one's is d q/(1 - q).
SAFETY times that is taken where it is smaller than the own estimate, but never less than a LEAST share of that: two meshes may agree by
chance.

Left out: error of the load steps, of the material and of the contact law; meshes between the three fidelities.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from gelsim.errors import SolveError, SolveStatus
from gelsim.results import Deformation, ErrorEstimate

# Fidelities from cheap to dear, with what presses tell of themselves: relative of the force, the medians of docs/validation.md, Accuracy;
# of the membrane [µm], of the scenes of docs/studies/error_estimate.py, which are solids.
PREDICTED = {
    "solid": {"fast": (0.03, 10.0), "balanced": (0.017, 3.0), "reference": (0.005, 3.0)},
    "profile": {"fast": (0.013, 10.0), "balanced": (0.0065, 3.0), "reference": (0.0035, 3.0)},
}
SAFETY = 2.0
LEAST = 0.1
COMPARED = 0.1
"""States are compared from this share of the largest force on: the first ones touch fewer elements than make a mesh."""


@dataclass(frozen=True)
class Target:
    """Errors to stay below; None does not matter."""

    force: float | None = None
    """Relative."""
    membrane_um: float | None = None
    """Root mean square over contact and neighbourhood."""

    def allows(self, force: float, membrane_um: float) -> bool:
        return (self.force is None or force <= self.force) and (self.membrane_um is None or membrane_um <= self.membrane_um)

    def __str__(self) -> str:
        parts = [f"{100 * self.force:g} % of the force"] if self.force is not None else []
        return " and ".join(parts + ([f"{self.membrane_um:g} µm of the membrane"] if self.membrane_um is not None else []))


@dataclass
class Chosen:
    """The press that was kept, and how it came to that."""

    press: Deformation
    fidelity: str
    why: str
    met: bool
    tried: list[dict[str, object]] = field(default_factory=list)


def press_to_target(target: Target, solve: Callable[[str], Deformation], kind: str = "solid") -> Chosen:
    """Solves at one fidelity after the other until the estimate meets the target, from the cheapest that is predicted to.

    The estimate of the press that is returned (its report's) is the one that was decided by.

    Args:
        solve: Presses at a fidelity.
        kind: "solid" or "profile", of what is predicted.
    Raises:
        SolveError: The first press failed. Where a finer one fails the coarser is returned, and its target is not met.
    """
    kept: Chosen | None = None
    tried: list[dict[str, object]] = []
    predicted = PREDICTED[kind]
    for name in list(predicted)[_first(target, predicted) :]:
        try:
            press = solve(name)
        except SolveError as error:
            if kept is None:
                raise
            return Chosen(kept.press, kept.fidelity, f"{name} could not be solved ({error})", False, tried)
        if kept is not None and press.status is not SolveStatus.CONVERGED:
            return Chosen(kept.press, kept.fidelity, f"{name} could not be solved ({press.message})", False, tried)
        how = "its own estimate"
        estimate = _estimate(press)
        if kept is not None:
            compared = _by_difference(kept.press, press)
            if compared < estimate.force:
                estimate, how = replace(estimate, force=compared), f"its difference from {kept.fidelity}"
                press = press.reporting(error_estimate=estimate)
        tried.append({"fidelity": name, "force": estimate.force, "membrane_um": estimate.membrane_um, "by": how})
        met = target.allows(estimate.force, estimate.membrane_um)
        said = f"{100 * estimate.force:.2g} % of force, {estimate.membrane_um:.2g} µm of membrane by {how}"
        kept = Chosen(press, name, f"target {target}: {said}", met, tried)
        if met or press.status is not SolveStatus.CONVERGED:
            break
    assert kept is not None
    return kept


def _first(target: Target, predicted: dict[str, tuple[float, float]]) -> int:
    """Where to begin: at the first fidelity that is predicted to say by itself that it is good enough, unless that is the finest.

    The two below it cost half as much together, and say more of the force by their difference.
    """
    last = len(predicted) - 1
    of_membrane = next(
        (i for i, (_, membrane) in enumerate(predicted.values()) if Target(None, target.membrane_um).allows(0, membrane)), last
    )
    if target.force is None:
        return of_membrane
    alone = next((i for i, told in enumerate(predicted.values()) if target.allows(*told)), last)
    return alone if alone < last else max(of_membrane - 1, 0)


def _estimate(press: Deformation) -> ErrorEstimate:
    assert press.report.error_estimate is not None  # every press has one
    return press.report.error_estimate


def _by_difference(coarse: Deformation, fine: Deformation) -> float:
    """Relative force error of `fine` from its difference to `coarse`, over the states that both have."""
    force, before = -fine.force[:, 2], -coarse.force[:, 2]
    count = min(len(force), len(before))
    same = np.isclose(fine.approach[:count], coarse.approach[:count], rtol=1e-9, atol=0.0)  # a press that ends at a force ends elsewhere
    same &= force[:count] >= COMPARED * force.max()
    own, jump, before_it = _estimate(fine).force, fine.report.stress_jump, coarse.report.stress_jump
    assert jump is not None and before_it is not None
    share = jump / before_it
    if not same.any() or not 0 < share < 1:
        return own
    difference = float(np.abs(before[:count][same] / force[:count][same] - 1).max())
    return max(SAFETY * difference * share / (1 - share), LEAST * own)
