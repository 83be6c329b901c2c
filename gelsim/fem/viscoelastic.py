"""What the solids remember: linear viscoelasticity of the isochoric stress, a Prony series, at finite strain. There only when asked for.

    S = S_vol + Ŝ - Σ g_i ∫ (1 - e^(-(t-s)/τ_i)) dŜ/ds ds = S_vol + (1 - Σ g_i) Ŝ + Σ Q_i,   Q_i = g_i ∫ e^(-(t-s)/τ_i) dŜ/ds ds

S second Piola stress, Ŝ = 2 ∂Ŵ/∂C that of the instantaneous isochoric law (Simo 1987, CMAME 60:153; Holzapfel 2000, Nonlinear Solid
Mechanics, §6.10). A step of Δt in which Ŝ goes linearly in time from Ŝ_n to Ŝ is exact by (Taylor, Pister and Goudreau 1970)

    Q_i = e^(-Δt/τ_i) Q_i,n + g_i a_i (Ŝ - Ŝ_n),   a_i = (1 - e^(-Δt/τ_i)) τ_i/Δt
    S = S_vol + γ Ŝ + H,   γ = 1 - Σ g_i (1 - a_i),   H = Σ e^(-Δt/τ_i) Q_i,n - g_i a_i Ŝ_n

so within a step the solid is elastic, of the law γ Ŵ with a given stress H: the potential γ Ŵ + H:C/2. The kernels of assembly.py do the
first with its constants times γ; those here add F H to the stress and G·H G' 1 to the matrix.

History lies at the quadrature points as 3 x 3 float64, in the rest frame, so that rotations need no care. Left out: viscosity of the
volume, and a stored energy of the branches (at finite strain the series has none that is agreed upon): `Solids.energy` is the potential of
the step. H is not traceless in the deformed frame; the pressure takes its trace up, at a volume change of order μ/κ.
"""

from __future__ import annotations

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gelsim.fem.elements import TetQuadrature
from gelsim.fem.pattern import PairPattern, add_block, pair_offset
from gelsim.scene.materials import OGDEN_TERMS

wp.set_module_options({"max_unroll": 1, "enable_backward": False})

Array = NDArray[np.float64]


@wp.kernel(enable_backward=False)
def history_force(
    tets: wp.array2d(dtype=wp.int32), displacement: wp.array(dtype=wp.vec3d), gradients: wp.array3d(dtype=wp.vec3d),
    weights: wp.array2d(dtype=wp.float64), history: wp.array2d(dtype=wp.mat33d), force: wp.array(dtype=wp.vec3d),
):  # fmt: skip
    """Adds ∫ F H : ∂F/∂u."""
    t = wp.tid()
    for q in range(weights.shape[1]):
        f = wp.identity(n=3, dtype=wp.float64)
        for a in range(10):
            f += wp.outer(displacement[tets[t, a]], gradients[t, q, a])
        stress = weights[t, q] * (f * history[t, q])
        for a in range(10):
            wp.atomic_add(force, tets[t, a], stress * gradients[t, q, a])


@wp.kernel(enable_backward=False)
def history_tangent(
    tets: wp.array2d(dtype=wp.int32), gradients: wp.array3d(dtype=wp.vec3d), weights: wp.array2d(dtype=wp.float64),
    history: wp.array2d(dtype=wp.mat33d), pattern: PairPattern, values: wp.array(dtype=wp.float64),
):  # fmt: skip
    """Adds the geometric stiffness of a given second Piola stress: ∫ G_a · H G_b 1."""
    t = wp.tid()
    for a in range(10):
        for b in range(a, 10):
            d = wp.float64(0.0)
            for q in range(weights.shape[1]):
                d += weights[t, q] * wp.dot(gradients[t, q, a], history[t, q] * gradients[t, q, b])
            add_block(pattern, values, tets[t, a], tets[t, b], pair_offset(pattern, tets[t, a], tets[t, b]), wp.diag(wp.vec3d(d, d, d)))


def prony_arrays(series: list[tuple[tuple[float, float], ...]]) -> tuple[Array, Array]:
    """Shares and times (T, K) of the Prony series of each tet, padded with terms of share 0."""
    longest = max(len(terms) for terms in series)
    padded = np.array([[*terms, *[(0.0, 1.0)] * (longest - len(terms))] for terms in series])
    return padded[..., 0], padded[..., 1]


def isochoric_stress(f: Array, law: Array) -> Array:
    """Ŝ = 2 ∂Ŵ/∂C [kPa] at deformation gradients (T, Q, 3, 3) of tets with constants `law` (T, 3 or 6), see `Solids`."""
    c = np.swapaxes(f, -1, -2) @ f
    j = np.linalg.det(f)[..., None, None]
    if law.shape[1] == 2 * OGDEN_TERMS:
        squares, axes = np.linalg.eigh(c)
        iso = squares**0.5 * j[..., 0] ** (-1 / 3)
        mu, alpha = law.reshape(-1, OGDEN_TERMS, 2).transpose(2, 0, 1)[:, :, None, :, None]
        powers = iso[..., None, :] ** alpha
        beta = (2 * mu / alpha * (powers - powers.mean(axis=-1, keepdims=True))).sum(axis=-2)
        return np.einsum("tqik,tqk,tqjk->tqij", axes, beta / squares, axes)
    first = np.trace(c, axis1=-2, axis2=-1)[..., None, None]
    c1, c2, c3 = law.T[:, :, None, None, None]
    excess = j ** (-2 / 3) * first - 3
    slope = c1 + excess * (2 * c2 + 3 * c3 * excess)
    return 2 * slope * j ** (-2 / 3) * (np.eye(3) - first / 3 * np.linalg.inv(c))


class Memory:
    """History of the tets of a `Solids`, and the constants of the present step.

    Args:
        tets: Nodes in the first ten columns, with their `quadrature`.
        law: (T, 3 or 6), the instantaneous constants. law_in_use: the kernels' own array of them, which each step rewrites.
        shares, times: (T, K) of the Prony series [1, s].
    """

    def __init__(self, tets: wp.array, quadrature: TetQuadrature, law: Array, law_in_use: wp.array, shares: Array, times: Array) -> None:
        self.quadrature, self.law, self.shares, self.times = quadrature, law, shares, times
        self._law_in_use, self._tets = law_in_use, tets
        device = law_in_use.device
        self._cells = tets.numpy()[:, :10]
        self._gradients = wp.array(quadrature.gradients, dtype=wp.vec3d, device=device)
        self._weights = wp.array(quadrature.weights, dtype=wp.float64, device=device)
        self._history = wp.zeros(quadrature.weights.shape, dtype=wp.mat33d, device=device)
        self.forget()

    def forget(self) -> None:
        """Back to rest, where nothing has ever happened."""
        points = (*self.quadrature.weights.shape, 3, 3)
        self.branches = np.zeros((self.shares.shape[1], *points))
        """Q_i of the last state that was kept, (K, T, Q, 3, 3) [kPa]."""
        self.stress = np.zeros(points)
        """Ŝ there, (T, Q, 3, 3) [kPa]."""
        self.begin(0.0)

    def begin(self, seconds: float) -> None:
        """Sets γ and H for a step of so long from the last state that was kept; may be called again with another length."""
        self._decay, self._gain = step_factors(self.shares, self.times, seconds)
        factor = 1.0 - (self.shares - self._gain).sum(axis=1)
        scale = np.ones(self.law.shape)
        scale[:, :: 2 if self.law.shape[1] == 2 * OGDEN_TERMS else 1] = factor[:, None]  # of Ogden's the moduli, not the exponents
        history = np.einsum("tk,ktqij->tqij", self._decay, self.branches)
        history -= self._gain.sum(axis=1)[:, None, None, None] * self.stress
        self._law_in_use.assign(self.law * scale)
        self._history.assign(history)

    def keep(self, displacement: Array) -> None:
        """The step that was begun ended at these displacements (N, 3) [mm]: from now on it is the past."""
        f = np.eye(3) + np.einsum("tni,tqnj->tqij", displacement[self._cells], self.quadrature.gradients, optimize=True)
        stress = isochoric_stress(f, self.law)
        self.branches = np.einsum("tk,ktqij->ktqij", self._decay, self.branches)
        self.branches += np.einsum("tk,tqij->ktqij", self._gain, stress - self.stress)
        self.stress = stress

    def add_force(self, displacement: wp.array, force: wp.array) -> None:
        inputs = [self._tets, displacement, self._gradients, self._weights, self._history, force]
        wp.launch(history_force, len(self._cells), inputs, device=force.device)

    def add_tangent(self, pairs: PairPattern, values: wp.array) -> None:
        inputs = [self._tets, self._gradients, self._weights, self._history, pairs, values]
        wp.launch(history_tangent, len(self._cells), inputs, device=values.device)


def step_factors(shares: Array, times: Array, seconds: float) -> tuple[Array, Array]:
    """e^(-Δt/τ) and g a, both as `shares`."""
    ratio = seconds / times
    average = np.where(ratio > 0.0, -np.expm1(-ratio) / np.where(ratio > 0.0, ratio, 1.0), 1.0)
    return np.exp(-ratio), shares * average
