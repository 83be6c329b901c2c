"""The modulus of an object from a force-depth curve: Gauss-Newton with the sensitivities of the press.

    python docs/examples/identify_modulus.py              # half a minute
    python docs/examples/identify_modulus.py --quick      # three states instead of eight

A soft hemisphere of unknown modulus is pressed into a gel that is known. Its force-depth curve is made by the simulator, on the same mesh
(so the fit is tested, not the mechanics), and 2 % of noise is put on every force. Each round presses once with the modulus guessed so far,
gets ∂F/∂ln E of every state with it, and solves the linear least-squares problem for ln E; weights are the noise's. The spread of the
estimate is that of the linearised problem, 1/√(Σ (∂F/∂ln E / σ)²). How well a curve says a modulus at all is in the same numbers:
∂ln F/∂ln E is one where all of the give is the object's, and falls to zero for an object much stiffer than the gel.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

import gelsim
from gelsim.scene.layers import build_scene

GEL_KPA = 60.0
TRUE_KPA = 130.0
FIRST_GUESS_KPA = 50.0
NOISE = 0.02
"""Standard deviation of a measured force over the force."""
SEED = 3
ROUNDS = 6
DONE = 1e-3
"""Change of ln E that ends the fit: a twentieth of what the noise leaves."""


def curve(modulus_kpa: float, frames: int) -> gelsim.PressSensitivity:
    """Forces of a press with an object of some modulus, and what they would be for a little more."""
    scene = build_scene(
        {
            "gel": {"profile": "flat", "youngs_modulus_kpa": GEL_KPA},
            "object": {"shape": "hemisphere", "radius_mm": 6.0, "youngs_modulus_kpa": modulus_kpa},
            "contact": {"friction_coefficient": 0.0},
            "press": {"depth_mm": 1.0, "force_n": "none", "frames": frames},
            "fidelity": "fast",
        }
    )
    return gelsim.press_sensitivity(scene)


def fit(measured: NDArray[np.float64], sigma: NDArray[np.float64], frames: int) -> tuple[float, float, list[float]]:
    """Modulus [kPa] whose curve is nearest to the measured forces [N], standard deviation of its logarithm, and the rounds' moduli."""
    modulus, spread, tried = FIRST_GUESS_KPA, np.inf, []
    for _ in range(ROUNDS):
        found = curve(modulus, frames)
        column = found.parameters.index("object_modulus_kpa")
        slope = modulus * found.force_gradient[1:, column] / sigma  # by ln E, in standard deviations
        rest = (measured - found.force[1:]) / sigma
        tried.append(modulus)
        change = float(slope @ rest / (slope @ slope))
        spread = float(1 / np.linalg.norm(slope))
        print(f"E = {modulus:7.2f} kPa: misfit {np.sqrt(np.mean(rest**2)):7.3f} σ", flush=True)
        modulus *= np.exp(np.clip(change, -1.0, 1.0))
        if abs(change) < DONE:
            break
    return modulus, spread, tried


def main(quick: bool = False) -> dict[str, Any]:
    """Makes a curve, fits it, prints the modulus with its uncertainty.

    Returns:
        modulus_kpa, spread (of ln E), true_kpa, rounds.
    """
    frames = 4 if quick else 9
    exact = curve(TRUE_KPA, frames).force[1:]
    sigma = NOISE * exact
    measured = exact + sigma * np.random.default_rng(SEED).standard_normal(len(exact))
    modulus, spread, tried = fit(measured, sigma, frames)
    print(f"E = {modulus:.1f} ± {modulus * spread:.1f} kPa (true: {TRUE_KPA:g}), {len(tried)} presses")
    return {"modulus_kpa": modulus, "spread": spread, "true_kpa": TRUE_KPA, "rounds": len(tried)}


if __name__ == "__main__":
    main(quick="--quick" in sys.argv[1:])
