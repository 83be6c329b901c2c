"""The baked gel: a flat elastic layer bonded to its window, whose answer to tractions is known in closed form for every wave.

Under a traction exp(i k·x) on its outer face a layer of thickness h moves by the same wave. Along k and z, with u_l = i V, t_l = i T,
Navier's equations have four solutions, (V, W) = (1, ±1) e^{±kz} and (κ ± kz, kz) e^{±kz}, κ = 3 - 4ν; V = W = 0 at z = -h and the traction
at z = 0 give their shares, a 4 × 4 system. Across k the layer shears alone: u_s = t_s tanh(kh) / Gk. All are 1/Gk times a function of kh
alone, tabulated once; a coat of stiffness S bears 4/3 S k² u_l and 1/3 S k² u_s of the traction. Displacement from traction is then a
product in Fourier space (`Window.moved`). Tractions are looked for on a window of the grid around the contact: convolution with the answer
to one cell, on twice the window's cells, is there what the whole grid gives.

The linear answer is read as a field in space: the height above x is u_z(x), and the material point X sits at x = X + u_t(x). With friction
the height is read nearer to X (`Window.led`), as the face is drawn along and its slopes with it. The layer is as thick as the gel at the
centre of pressure; under load, where friction keeps the face from spreading, as stiff as one thinner by THINNING of the mean indentation
(`held_back`). What forces are more than that is learnt (gelsim/live/stiffening.py).

Contact without penetration is solved by conjugate gradients with bounds (Polonsky and Keer 1999). Friction (gelsim/fem/friction.py) is
incremental: where |q| is below its bound the gel moves with the object, elsewhere q opposes the slip; with p given that is a minimum over
discs, found by spectral projected gradients (Birgin, Martínez and Raydan 2000). Both alternate, as shear lifts the surface and pressure
spreads it. The bound is that of the face, which slopes (`slip_limit`); what sticks goes along with the object, and takes with it how far it
was drawn (`carried_along`): left at its place, loops of a sheared ball enclose a tenth to a fifth more.

Along itself the face is followed to second order (`Window.bending`). At a height g over a plane, pressure p and friction τ ask of the flat
layer under that plane the tangential traction

    τ + p∇g + div(gσ),   σ = -pI + 2G(ε + tr ε I),   and the face is at u_t + g(τ/G - ∇u_z);

of the first p∇g is what a slope adds to the force too. What the bulk does to second order is left out, and taken to undo half: with all of
it markers are off by as much as with none, the other way. τ/G, rough at a contact's edge, is left out, and strains are smoothed over the
deepest indentation: of shorter waves the series does not converge, and their part in it grows from round to round.

Left out: the gel's side faces (the layer is periodic with the gel's size), change of thickness over the contact but for the force that it
asks for (`work_and_less`), what else second order does to heights and pressure, inertia, viscosity. Units here: mm, kPa (so mN), single
precision.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from gelsim.fem import friction as coulomb

T = TypeVar("T")
Values = NDArray[np.float32]

CELL_MM = 0.2
"""Of the grid, at most."""
THINNING = 0.35
"""Of the mean indentation, where friction holds all of the face's spreading back: least squares over forces of balls of R 3 to 12 mm
pressed straight down with friction of 0.2 to 1, which leaves 2 %. 0.27, whatever friction holds, leaves as much there, and 6 % of a ball
that slides (0.6 mm to and fro), which has no thinning."""
LED = 0.69
"""Share of `Window.led` that is taken: least squares over heights of punches, frusta, tori, tubes, wedges and balls at `balanced`, which
leaves 0.33 of the squares."""
THINNER = 0.1
"""Of the thickness: the step of a difference quotient."""
BENT = 0.5
"""Share of `Window.bending` that is taken: chosen on a frictionless ball of R 6 mm; of the drawn presses of the benchmark those tried are
nearest with 0.25 to 0.5."""
GAP_TOLERANCE = 1e-3
"""Of the deepest overlap: gaps left in the contact, RMS."""
SLIP_TOLERANCE = 2e-3
"""What a step of G/h times the slip would still change, over the bounds, and over that step of all motion along the face."""
ROUNDS = 12
"""Between pressure, shear and thickness, at most."""
SETTLED = 5e-4
"""Relative change of the pressure, and of the thickness, at which the rounds end."""
NODES = 0.01
"""Relative distance of the thicknesses whose answers are computed; between two they are interpolated."""
WIDE = 4.0
"""Thicknesses of a soft object's layer, after which it is repeated."""
KEPT = 256
"""Answers of windows and thicknesses that a layer keeps, 0.2 MB each for 128 × 128 cells."""
ALONE = 2**18
"""Multiplications in a product of real matrices up to which OpenBLAS takes one thread. Two, on busy cores, made a step ten times slower."""
PUNCH_TOLERANCE = 0.05
"""Of the motion that is asked of some cells, RMS."""
STEPS = 200
"""Of a gradient method, at most."""
TINY = 1e-30
"""Which nothing is divided by."""
STICK = 1e3
"""Coefficient of friction that stands for "stick"."""
LOOKS = 3
"""For the place of a material point: u_t falls by half over a thickness at least, so each gains a factor of three or more."""
_WAVES = np.concatenate([[0.0], np.geomspace(1e-3, 300.0, 3000)])


@lru_cache(maxsize=8)
def waves(poissons_ratio: float) -> tuple[NDArray[np.float64], ...]:
    """c(kh) of u = c t / Gk at `_WAVES`: (V by T, V by N, W by N) and across; 0 at 0, where the whole layer moves.

    W by T is V by N (Betti).
    """
    a, kappa = _WAVES[1:], 3.0 - 4.0 * poissons_ratio
    stretch = poissons_ratio / (1.0 - 2.0 * poissons_ratio)

    def at(z: NDArray[np.float64]) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        """V, W and the tractions T, N over Gk of the four solutions at kz = z; those that fall with z are 1 at the window."""
        up, down, one = np.exp(z), np.exp(-(z + a)), np.ones_like(a)
        v = np.stack([up, (kappa + z) * up, down, (kappa - z) * down])
        w = np.stack([up, z * up, -down, z * down])
        dv = np.stack([up, (kappa + 1 + z) * up, -down, -(kappa + 1 - z) * down])
        dw = np.stack([up, (one + z) * up, down, (one - z) * down])
        return v, w, dv + w, 2.0 * (dw + stretch * (dw - v))

    v, w, t, n = at(np.zeros_like(a))
    below_v, below_w, _, _ = at(-a)
    system = np.moveaxis(np.stack([below_v, below_w, t, n]), 2, 0)
    shares = np.linalg.solve(system, np.broadcast_to(np.eye(4)[:, 2:], (len(a), 4, 2)))
    by_v, by_w = (np.einsum("ai,aij->aj", top.T, shares) for top in (v, w))
    found = by_v[:, 0], by_v[:, 1], by_w[:, 1], np.tanh(a)
    return tuple(np.concatenate([[0.0], values]) for values in found)


@dataclass(frozen=True)
class Elastic:
    """Of the gel, or of a soft object."""

    shear_kpa: float
    poissons_ratio: float
    coat_n_per_m: float = 0.0
    """E t of the sheet on its face (`gelsim.fem.coat`)."""


class Layer:
    """A grid of cells over the gel, (rows, columns), and what tractions on them do. Displacements [mm], tractions [kPa]."""

    def __init__(self, size_mm: tuple[float, float], material: Elastic, cell_mm: float = CELL_MM) -> None:
        counts = [2 * int(fft.next_fast_len(int(np.ceil(side / cell_mm / 2)), real=True) or 1) for side in size_mm]
        self.material, self.shape = material, (counts[1], counts[0])
        self.cell = size_mm[0] / counts[0], size_mm[1] / counts[1]
        self.x, self.y = (
            cell * np.arange(0.5 - count / 2, count / 2, dtype=np.float64) for count, cell in zip(counts, self.cell, strict=True)
        )
        """Of the cells' middles [mm]."""
        self._nodes: dict[tuple[tuple[int, int], int], Values] = {}
        self._spaces: dict[int, Values] = {}

    def window(self, shape: tuple[int, int], thickness: float) -> Window:
        """What tractions on so many rows and columns, wherever they lie, do there, of a layer of some thickness [mm].

        Not an approximation: no traction is outside, and twice as many cells keep the window's images apart.
        """
        padded = min(2 * shape[0], self.shape[0]), min(2 * shape[1], self.shape[1])
        return Window(self, shape, padded, thickness, self.answers(padded, thickness))

    def answers(self, padded: tuple[int, int], thickness: float) -> Values:
        """Of a thickness [mm], as `_node` has them."""
        place = math.log(thickness) / math.log1p(NODES)
        node = math.floor(place)
        share: Any = np.float32(place - node)
        return (1 - share) * self._node(padded, node) + share * self._node(padded, node + 1)

    def _node(self, shape: tuple[int, int], node: int) -> Values:
        """The answers over the waves of a grid of a shape, of the thickness (1 + NODES)^node, (11, rows / 2 + 1, columns / 2 + 1).

        Of u_z by p, u_x by q_x, u_y by q_y; by the parities of their outcome, u_x by q_y (4), u_x by p (2) and u_y by p (2): `Window`.
        """
        if (shape, node) in self._nodes:
            return self._nodes[shape, node]
        found = within(self._space(node), shape)[:, : shape[0] // 2 + 1]
        (zz, xx, yy, xy), (xz, yz) = found[:4].real, found[4:].imag
        return keep(self._nodes, (shape, node), np.stack([zz, xx, yy, -xy, xy, xy, -xy, -xz, xz, -yz, yz]), KEPT)

    def under(self, material: Elastic, thickness: float) -> Layer:
        """Another layer over the same cells, so wide that one of this thickness [mm] does not end."""
        other = copy.copy(self)
        counts = [2 * int(fft.next_fast_len(int(np.ceil(WIDE * thickness / cell / 2)), real=True) or 1) for cell in self.cell]
        other.material, other.shape = material, (max(counts[1], self.shape[0]), max(counts[0], self.shape[1]))
        other._nodes, other._spaces = {}, {}
        return other

    def _space(self, node: int) -> Values:
        """The same as the motion of every cell by a traction on the first, (6, rows, columns)."""
        if node in self._spaces:
            return self._spaces[node]
        moved: Any = fft.irfft2(self.spectrum(node), self.shape)
        return keep(self._spaces, node, moved, KEPT)

    def spectrum(self, node: int) -> NDArray[np.complex64]:
        """The same over the waves exp(i k·x) of the whole grid, (6, rows, columns / 2 + 1)."""
        shear, nu, thickness = self.material.shear_kpa, self.material.poissons_ratio, (1 + NODES) ** node
        kx = 2 * np.pi * fft.rfftfreq(self.shape[1], self.cell[0])[None, :]
        ky = 2 * np.pi * fft.fftfreq(self.shape[0], self.cell[1])[:, None]
        k = np.hypot(kx, ky)
        scale = np.divide(1.0, shear * k, out=np.zeros_like(k), where=k > 0)
        along, mixed, normal, across = (scale * np.interp(k * thickness, _WAVES, table) for table in waves(nu))
        along[0, 0] = across[0, 0] = thickness / shear
        normal[0, 0] = thickness / shear * (1 - 2 * nu) / (2 - 2 * nu)
        coat = self.material.coat_n_per_m * k**2
        held = 1 / (1 + 4 / 3 * coat * along)
        along, mixed, normal, across = along * held, mixed * held, normal - 4 / 3 * coat * held * mixed**2, across / (1 + coat / 3 * across)
        cx, cy = (np.divide(way, k, out=np.zeros_like(k), where=k > 0) for way in (kx, ky))
        # A wave of two cells has no direction to and fro.
        odd = (np.arange(k.shape[1])[None, :] != self.shape[1] // 2) & (np.arange(k.shape[0])[:, None] != self.shape[0] // 2)
        xx, yy, xy = along * cx**2 + across * cy**2, along * cy**2 + across * cx**2, (along - across) * cx * cy * odd
        xx[0, 0] = yy[0, 0] = thickness / shear
        return np.stack([normal, xx, yy, xy, 1j * mixed * cx * odd, 1j * mixed * cy * odd]).astype(np.complex64)


def within(space: Values, shape: tuple[int, int]) -> NDArray[np.complex64]:
    """Waves of a grid of a shape, (..., rows, columns / 2 + 1), by what a traction on the first cell of a larger one moves."""
    for axis, count in zip((-2, -1), shape, strict=True):
        if count < space.shape[axis]:
            space = np.moveaxis(space, axis, 0)
            cut = np.zeros((count, *space.shape[1:]), np.float32)
            reach = np.arange(1 - count // 2, count // 2)
            cut[reach] = space[reach]
            space = np.moveaxis(cut, 0, axis)
    return fft.rfft2(space)  # type: ignore[return-value]


def keep(table: dict[Any, T], key: Any, value: T, most: int) -> T:
    """Puts a value into a table, from which the oldest goes where it holds `most`."""
    if len(table) >= most:
        del table[next(iter(table))]
    table[key] = value
    return value


def _blur(count: int, width: float) -> Values:
    """Means over neighbours in a row of `count`, weighted by a Gaussian of a standard deviation [cells], (count, count)."""
    apart = np.arange(count, dtype=np.float32)
    share = np.exp(-0.5 * ((apart[:, None] - apart) / np.float32(max(width, 0.1))) ** 2)
    return share / share.sum(axis=1, keepdims=True)


@lru_cache(maxsize=64)
def _waves_of(count: int, padded: int) -> tuple[Values, Values]:
    """Cosines and sines about the middle of `count` cells, of the waves of `padded` of them: from half of the cells to half of the waves
    (2, padded / 2 + 1, count / 2), and back."""
    half, waves = (count + 1) // 2, np.arange(padded // 2 + 1)
    turns = 2 * np.pi / padded * np.outer(waves, np.arange(half) - (count - 1) / 2)
    there = np.stack([np.cos(turns), np.sin(turns)])
    back = np.where(waves % (padded // 2) == 0, 1.0, 2.0) / padded * there.transpose(0, 2, 1)
    if count % 2:
        there[:, :, -1] /= 2  # the middle is its own mirror image
    return there.astype(np.float32), back.astype(np.float32)


def _halves(values: Values, axis: int) -> tuple[Values, Values]:
    """One half of values (..., rows, columns) along an axis, -2 or -1, and the other, mirrored; the middle is in both."""
    half = (values.shape[axis] + 1) // 2
    if axis == -1:
        return values[..., :half], values[..., ::-1][..., :half]
    return values[..., :half, :], values[..., ::-1, :][..., :half, :]


def _folded(values: Values, axis: int) -> Values:
    """The even part of values along an axis, twice, and the odd one, on half of the cells: (2, ...)."""
    one, other = _halves(values, axis)
    found = np.empty((2, *one.shape), np.float32)
    np.add(one, other, out=found[0])
    np.subtract(one, other, out=found[1])
    return found


def _unfolded(parts: Values, axis: int, count: int) -> Values:
    """Even and odd part together, on all of the cells along an axis."""
    shape = list(parts.shape[1:])
    shape[axis] = count
    found = np.empty(shape, np.float32)
    one, other = _halves(found, axis)
    np.subtract(parts[0], parts[1], out=other)
    np.add(parts[0], parts[1], out=one)
    return found


shared = lru_cache(maxsize=8)(Layer)
"""The layer of a size and a material, whose tables all sensors with such a gel use."""


@dataclass(frozen=True, eq=False)
class Window:
    """Some rows and columns of a layer's grid.

    Waves are cosines and sines, not exponentials: (2, 2, ..., rows, columns), even and odd along y, even and odd along x. An answer that is
    odd along an axis takes even to odd, and odd to even with the other sign. They are about the window's middle, and found by products of
    real matrices; or, of a large window, about its first cell, by an FFT.
    """

    layer: Layer
    shape: tuple[int, int]
    padded: tuple[int, int]
    thickness: float
    answers: Values

    @property
    def stiffness(self) -> float:
        """Of the softest wave, along the face [kPa/mm]: a step along the slip that no search overshoots."""
        return self.layer.material.shear_kpa / self.thickness

    def at(self, thickness: float) -> Window:
        """The same of another thickness [mm]."""
        return self.layer.window(self.shape, thickness)

    @cached_property
    def _small(self) -> bool:
        """Whether each product of matrices is one that stays on its thread."""
        (rows, columns), waves = self.shape, [count // 2 + 1 for count in self.padded]
        return max(rows * (columns + 1) // 2, waves[0] * (rows + 1) // 2) * waves[1] <= ALONE

    def _there(self, values: Values) -> Values:
        many = (1,) * (values.ndim - 2)
        if self._small:
            (rows, _), (columns, _) = (_waves_of(*counts) for counts in zip(self.shape, self.padded, strict=True))
            along_x = _folded(values, -1) @ columns.transpose(0, 2, 1).reshape(2, *many, *columns.shape[:0:-1])
            return rows.reshape(2, 1, *many, *rows.shape[1:]) @ _folded(along_x, -2)
        waves: Any = fft.rfft2(values, self.padded)
        half = self.padded[0] // 2 + 1
        one: Any = waves[..., :half, :]
        other: Any = np.concatenate([waves[..., :1, :], waves[..., : half - 2 : -1, :]], axis=-2)  # of the opposite wave along y
        found = np.empty((2, 2, *one.shape), np.float32)
        np.add(one.real, other.real, out=found[0, 0])
        np.add(one.imag, other.imag, out=found[0, 1])
        np.subtract(other.imag, one.imag, out=found[1, 0])
        np.subtract(other.real, one.real, out=found[1, 1])
        found *= np.array([[0.5, -0.5], [0.5, 0.5]], np.float32).reshape(2, 2, *many, 1, 1)
        return found

    def _back(self, waves: Values) -> Values:
        many = (1,) * (waves.ndim - 4)
        if self._small:
            (_, rows), (_, columns) = (_waves_of(*counts) for counts in zip(self.shape, self.padded, strict=True))
            along_x = _unfolded(rows.reshape(2, 1, *many, *rows.shape[1:]) @ waves, -2, self.shape[0])
            return _unfolded(along_x @ columns.transpose(0, 2, 1).reshape(2, *many, *columns.shape[:0:-1]), -1, self.shape[1])
        half, below = waves.shape[-2], np.s_[..., -2:0:-1, :]  # rows of negative waves, as those of the positive ones
        whole = np.empty((*waves.shape[2:-2], self.padded[0], waves.shape[-1]), np.complex64)
        np.subtract(waves[0, 0], waves[1, 1], out=whole.real[..., :half, :])
        np.add(waves[0, 1], waves[1, 0], out=whole.imag[..., :half, :])
        np.add(waves[0, 0][below], waves[1, 1][below], out=whole.real[..., half:, :])
        np.subtract(waves[0, 1][below], waves[1, 0][below], out=whole.imag[..., half:, :])
        np.negative(whole.imag, out=whole.imag)
        return fft.irfft2(whole, self.padded)[..., : self.shape[0], : self.shape[1]]  # type: ignore[return-value]

    def moved(self, pressure: Values, shear: Values) -> Values:
        """Displacement u of all tractions together [mm], (3, rows, columns)."""
        zz, xx, yy, xy, xz, yz = self._parts
        waves = self._there(np.concatenate([shear, pressure[None]]))
        x, y, p = waves[:, :, 0], waves[:, :, 1], waves[:, :, 2]
        found = np.empty_like(waves)
        found[:, :, 2] = xz * x[:, ::-1] + yz * y[::-1] - zz * p
        found[:, :, 0] = xx * x + xy * y[::-1, ::-1] + xz * p[:, ::-1]
        found[:, :, 1] = xy * x[::-1, ::-1] + yy * y + yz * p[::-1]
        return self._back(found)

    def sunk(self, pressure: Values) -> Values:
        """How deep a pressure alone presses the face [mm]."""
        return self._back(self.answers[0] * self._there(pressure))

    def alone(self, tractions: Values) -> Values:
        """How deep a pressure presses the face, and how far a traction along x moves it along x, each alone [mm]: one or two, likewise."""
        return self._back(self.answers[: len(tractions)] * self._there(tractions))

    def dragged(self, shear: Values) -> Values:
        """How far tangential tractions (2, rows, columns) alone move the face along itself [mm], likewise."""
        _, xx, yy, xy, _, _ = self._parts
        waves = self._there(shear)
        x, y = waves[:, :, 0], waves[:, :, 1]
        found = np.empty_like(waves)
        found[:, :, 0] = xx * x + xy * y[::-1, ::-1]
        found[:, :, 1] = xy * x[::-1, ::-1] + yy * y
        return self._back(found)

    def bending(self, pressure: Values, moved: Values, rest: Values) -> tuple[Values, Values]:
        """What its own motion does to a face along itself, to second order: tractions [kPa] that act on it as if it were flat, and a motion
        beside theirs [mm], each (2, rows, columns).

        Args:
            pressure, moved: Of the face, and its displacement.
            rest: Its height before [mm].
        """
        height = moved[2] + (rest - level(pressure, rest))
        modulus: Any = np.float32(self.layer.material.shear_kpa)
        deepest = max(-float(moved[2].min(initial=0.0)), 0.0)
        rows, columns = (_blur(count, deepest / cell) for count, cell in zip(self.shape, self.layer.cell[::-1], strict=True))
        (xx, yx), (xy, yy) = self.slope(rows @ moved[:2] @ columns.T)
        mean = 2 * modulus * (xx + yy) - pressure
        skew: Any = height * (modulus * (xy + yx))
        along: Any = np.stack([height * (2 * modulus * xx + mean), skew, height * (2 * modulus * yy + mean)])
        by_x, by_y = self.slope(along)
        return np.float32(BENT) * (pressure * self.slope(height) + by_x[:2] + by_y[1:]), self.carried(moved, height)

    def carried(self, moved: Values, height: Values) -> Values:
        """Of `bending`, the motion, by the face's height over where the pressure's centre was at rest [mm]."""
        return np.float32(-BENT) * height * self.slope(moved[2])

    def led(self, pressure: Values, moved: Values, rest: Values) -> Values:
        """How much higher the face is over a place [mm] when its height is that of the point which has come there: -u_t · ∇height.

        Motion that the contact has as a whole, along the gel and about its centre, takes the dent with it and only counts against the slope
        of the face at rest. Where it touches nothing may change; that asks for a pressure, which is not in here.

        Args:
            pressure, moved, rest: As of `bending`, of the linear layer.
        """
        total, ways = float(pressure.sum()), (self.layer.x, self.layer.y[:, None])
        x, y = ((way - (pressure * way).sum() / total).astype(np.float32) for way in ways)
        apart = moved[:2] - np.einsum("ij,kij->k", pressure, moved[:2])[:, None, None] / total
        inertia = float((pressure * (x**2 + y**2)).sum())
        turned = np.float32((pressure * (x * apart[1] - y * apart[0])).sum() / max(inertia, 1e-9))
        apart[0] += turned * y
        apart[1] -= turned * x
        return np.float32(-LED) * (apart * self.slope(moved[2]) + moved[:2] * self.slope(rest)).sum(axis=0)

    def slope(self, values: Any) -> Values:
        """Of values (..., rows, columns) along x and y, (2, ..., rows, columns); at the rim half of it."""
        found: Any = np.zeros((2, *values.shape), np.float32)
        for change, axis, cell in zip(found, (-1, -2), self.layer.cell, strict=True):
            to, before = change.swapaxes(axis, 0), values.swapaxes(axis, 0)
            if len(before) > 1:
                np.subtract(before[2:], before[:-2], out=to[1:-1])
                np.subtract(before[1], before[0], out=to[0])
                np.subtract(before[-1], before[-2], out=to[-1])
            change *= np.float32(0.5 / cell)
        return found

    def lifted(self, shear: Values) -> Values:
        """u_z of tangential tractions [mm]."""
        *_, xz, yz = self._parts
        waves = self._there(shear)
        found: Any = xz * waves[:, ::-1, 0] + yz * waves[::-1, :, 1]
        return self._back(found)

    @property
    def _parts(self) -> tuple[Values, ...]:
        """The answers, by the parities of their outcome those that change them."""
        ways = self.answers
        return ways[0], ways[1], ways[2], ways[3:7].reshape(2, 2, *ways.shape[1:]), ways[7:9], ways[9:, None]


@dataclass(frozen=True, eq=False)
class SoftBody:
    """A soft object over a window: a layer of its own, whose face moves as a whole too (gelsim/live/soft.py)."""

    layer: Layer
    thickness: float
    """Of that [mm]."""
    low: float
    """How high its face is above the apex, where pressure is, in the mean [mm]."""
    compliance: NDArray[np.float64]
    """Of that motion, linear before angular, by forces and torques about the apex, (6, 6) [mm, rad by mN, mN mm]."""
    apex: NDArray[np.float64]
    """Where it lies, (2,) [mm]."""
    x: NDArray[np.float64]
    """Of the window's columns [mm]."""
    y: NDArray[np.float64]
    """Of its rows."""
    squash: float = 0.0
    """By how much it is lower over the contact, in the mean, for which the compliance is [mm]."""

    def motion(self, cell: float, pressure: Values | None, shear: Values | None) -> NDArray[np.float64]:
        """The motion by tractions on the layer, whose opposites act here, (6,) [mm, rad]; `cell`: its area [mm²]."""
        wrench = np.zeros(6)
        if pressure is not None:
            by_x, by_y = pressure.sum(axis=0), pressure.sum(axis=1)
            wrench[2:5] = by_x.sum(), by_y @ self._beside[1], -(by_x @ self._beside[0])
        if shear is not None:
            wrench[:2] = -shear.sum(axis=(1, 2))
            wrench[5] = shear[0].sum(axis=1) @ self._beside[1] - shear[1].sum(axis=0) @ self._beside[0]
        return cell * (self.compliance @ wrench)

    def along(self, motion: NDArray[np.float64]) -> Values:
        """Of its face along the layer, (2, rows, columns) [mm]."""
        x, y = self._beside
        return np.stack(np.broadcast_arrays(motion[0] - motion[5] * y[:, None], motion[1] + motion[5] * x)).astype(np.float32)

    def up(self, motion: NDArray[np.float64]) -> Values:
        """Away from the layer, (rows, columns) [mm]."""
        x, y = self._beside
        return (motion[2] + motion[3] * y[:, None] - motion[4] * x).astype(np.float32)

    @cached_property
    def _beside(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Of columns and rows from the apex [mm]."""
        return self.x - self.apex[0], self.y - self.apex[1]


@dataclass(frozen=True, eq=False)
class Facing(Window):
    """A window against a soft object: how far tractions move the two apart."""

    body: SoftBody

    def _motion(self, pressure: Values | None, shear: Values | None) -> NDArray[np.float64]:
        return self.body.motion(self.layer.cell[0] * self.layer.cell[1], pressure, shear)

    def moved(self, pressure: Values, shear: Values) -> Values:
        found, motion = super().moved(pressure, shear), self._motion(pressure, shear)
        found[:2] -= self.body.along(motion)
        found[2] -= self.body.up(motion)
        return found

    def sunk(self, pressure: Values) -> Values:
        return super().sunk(pressure) + self.body.up(self._motion(pressure, None))

    def alone(self, tractions: Values) -> Values:
        found = super().alone(tractions)
        found[0] += self.body.up(self._motion(tractions[0], None))
        if len(tractions) > 1:
            shear = np.stack([tractions[1], np.zeros_like(tractions[1])])
            found[1] -= self.body.along(self._motion(None, shear))[0]
        return found

    def dragged(self, shear: Values) -> Values:
        return super().dragged(shear) - self.body.along(self._motion(None, shear))

    def lifted(self, shear: Values) -> Values:
        return super().lifted(shear) - self.body.up(self._motion(None, shear))


def against(window: Window, body: SoftBody | None) -> Window:
    """A window against what it touches; None is rigid."""
    return window if body is None else _facing(window, body, window.answers)


def without(window: Window, body: SoftBody) -> Facing:
    """A soft object over a window whose layer does not move."""
    return _facing(window, body, np.zeros_like(window.answers))


def _facing(window: Window, body: SoftBody, answers: Values) -> Facing:
    opposite = body.layer.answers(window.padded, body.thickness)
    opposite[7:] *= -1  # of faces that look at each other
    return Facing(window.layer, window.shape, window.padded, window.thickness, answers + opposite, body)


def pressure(window: Window, room: Values, start: Values, known: Values | None = None) -> tuple[Values, Values]:
    """The pressure p ≥ 0 [kPa] under which gap = room + sunk(p) ≥ 0 and p gap = 0; and that gap.

    Args:
        room: Gap that the face has without it [mm]; negative where the object would overlap.
        start: A first guess, p ≥ 0.
        known: Its gap, room + sunk(start), if that is known; of `room` then the deepest overlap counts alone.
    """
    deepest = -float(room.min())
    if deepest <= 0.0:
        return np.zeros_like(room), room
    # The contact lies where there is overlap or was pressure; what else joins is found by the overlap that it comes to.
    p, gap = start, known
    if not p.any():
        p, gap = np.where(room < 0, np.float32(window.layer.material.shear_kpa * 1e-3), np.float32(0.0)), None
    if gap is None:
        gap = room + window.sunk(p)
    way, before = np.zeros_like(p), 0.0
    for _ in range(STEPS):
        held = p > 0
        inside = np.where(held, gap, 0.0)
        size = float(np.vdot(inside, inside))
        overlap = ~held & (gap < 0)
        worst = -float(gap[overlap].min()) if overlap.any() else 0.0
        if size <= (GAP_TOLERANCE * deepest) ** 2 * held.sum() and worst <= 3 * GAP_TOLERANCE * deepest:
            break
        way = inside + np.float32(size / before if before else 0.0) * np.where(held, way, 0.0)
        answer = window.sunk(way)
        steep = float(np.vdot(answer, way))
        if steep <= 0.0:  # nothing in contact yet, or no more than rounding is left
            step = window.stiffness
        else:
            step = float(np.vdot(inside, way)) / steep
        moved = p - np.float32(step) * way
        left = moved < 0
        if left.any() or overlap.any():
            p, held = np.maximum(moved, 0.0), p
            p[overlap] -= np.float32(step) * gap[overlap]
            gap = gap + window.sunk(p - held)
            before = 0.0 if overlap.any() else size
        else:
            p, gap, before = moved, gap - np.float32(step) * answer, size
    return p, gap


def work_and_less(window: Window, pressure: Values) -> tuple[float, float]:
    """Σ p · sunk(p) [kPa mm] over the cells, and by how much it is less of a layer that is thinner [per mm]."""
    work, thinner = (float(np.vdot(pressure, one.sunk(pressure))) for one in (window, window.at((1 - THINNER) * window.thickness)))
    return work, (work - thinner) / (THINNER * window.thickness)


def held_back(window: Window, pressure: Values, spread: Values, dragged: Values) -> float:
    """What share of the face's spreading away from the pressure's centre is taken back by shear, 0 to 1.

    Args:
        spread, dragged: Motion along the face by pressure, and by shear, (2, rows, columns) [mm].
    """
    rows, columns = (cell * np.arange(count, dtype=np.float32) for cell, count in zip(window.layer.cell[::-1], window.shape, strict=True))
    total = max(float(pressure.sum()), TINY)
    x = pressure * (columns - np.float32(float(pressure.sum(axis=0) @ columns) / total))
    y = pressure * (rows - np.float32(float(pressure.sum(axis=1) @ rows) / total))[:, None]
    out, back = (float(np.vdot(x, way[0]) + np.vdot(y, way[1])) for way in (spread, dragged))
    return min(max(-back / out, 0.0), 1.0) if out > 0.0 else 0.0


def slip_limit(friction: float, pressure: Any, shear: Any, slope: Any) -> Any:
    """Bound of the tractions q along the gel [kPa], by Coulomb's law in the plane of the face.

    There a normal pressure P and a shear f, both over the gel's area, make p = P - f · ∇g and q = f + ∇g (f · ∇g), and bounds are those of
    the face's area: up and down the slope |q| ≤ μP (1 + |∇g|²), across it the root of that; here a circle of the same area.

    Args:
        pressure, shear: p and q, of which q is known about.
        slope: ∇g of the face, one for each axis.
    """
    if friction >= STICK:
        return coulomb.slip_bound(friction, pressure)
    steep = 1.0 + slope[0] ** 2 + slope[1] ** 2
    normal = pressure + (shear[0] * slope[0] + shear[1] * slope[1]) / steep
    return coulomb.slip_bound(friction, 0.5 * (normal + abs(normal))) * steep**0.75 * (pressure > 0)


def bounded(q: Values, bound: Values) -> Values:
    """Tangential tractions (2, rows, columns), cut to a length (rows, columns)."""
    length = np.sqrt(q[0] ** 2 + q[1] ** 2)
    return q * np.minimum(bound / np.maximum(length, np.float32(TINY)), np.float32(1.0))


def shear(window: Window, slip: Values, bound: Values, start: Values, away: float) -> tuple[Values, Values]:
    """Tangential tractions q, |q| ≤ bound [kPa], (2, rows, columns): slip is 0 where |q| < bound, else against q; and that slip.

    Args:
        slip: Under the first guess [mm], likewise.
        bound: Of friction, (rows, columns).
        start: A first guess, |start| ≤ bound.
        away: Slip that there is without tractions, over all cells that touch, root of the sum of squares [mm].
    """
    softest: Any = np.float32(window.stiffness)
    step: Any = softest
    touching = bound > 0
    allowed = SLIP_TOLERANCE * min(float(softest) * away, float(np.linalg.norm(bound)))
    q = start
    for _ in range(STEPS):
        held = slip * touching
        if float(np.linalg.norm(bounded(q - softest * held, bound) - q)) <= allowed:
            break
        way = bounded(q - step * held, bound) - q
        moved = window.dragged(way)
        answer = moved * touching
        steep = float(np.vdot(answer, way))
        if steep <= 0.0:  # no more than rounding is left
            break
        part: Any = np.float32(min(1.0, -float(np.vdot(held, way)) / steep))
        q, slip = q + part * way, slip + part * moved
        step = np.float32(steep / float(np.vdot(answer, answer)))
    return q, slip


def punch(window: Window, cells: NDArray[np.bool_], motion: Values) -> Values:
    """Tractions on some cells that move them so [kPa, or per mm], by conjugate gradients; 0 on the others.

    Args:
        motion: Down [mm], and perhaps along x: (1 or 2, rows, columns).
    Returns:
        A pressure, and perhaps a traction along x: likewise.
    """

    def size_of(one: Values, other: Values) -> Any:
        return np.einsum("kij,kij->k", one, other)[:, None, None]

    left: Values = motion * cells
    traction, way, size = np.zeros_like(left), left, size_of(left, left)
    allowed = PUNCH_TOLERANCE**2 * size
    least: Any = np.float32(TINY)
    for _ in range(STEPS):
        if (size <= allowed).all():
            break
        moved = window.alone(way) * cells
        step = size / np.maximum(size_of(way, moved), least)
        traction, left = traction + step * way, left - step * moved
        before, size = size, size_of(left, left)
        way = left + size / np.maximum(before, least) * way
    return traction


def level(pressure: Values, rest: Values) -> Any:
    """Height of the gel at rest [mm] where the pressure's centre is."""
    return np.float32((pressure * rest).sum() / max(float(pressure.sum()), TINY))


def carried_share(pressure: Any, overlap: Any, down: Any) -> Any:
    """By what share of its way the object takes cells along: all of what touched before.

    Of what comes to touch on the way as much of it as is pressed in: tractions that come together are then alike, as under an oblique load,
    where nothing slips that they hold (Mindlin and Deresiewicz 1953).

    Args:
        pressure: Before.
        overlap: That there would be now without any more of it [mm].
        down: How far the object came down on the way [mm].
    """
    share = (overlap / down.clip(min=TINY)).clip(min=0.0, max=1.0)
    return share + (pressure > 0) * (1.0 - share)


def carried_along(values: Values, drift: Values, cell: tuple[float, float]) -> Values:
    """Motion along the face (2, rows, columns) [mm] of what is now at each place, once all has gone along by a drift (likewise)."""
    if not drift.any():
        return values
    row, column = np.indices(values.shape[1:])
    return smooth_between(values, row - drift[1] / cell[1], column - drift[0] / cell[0]).astype(np.float32, copy=False) + drift


def smooth_between(values: NDArray[np.floating], row: NDArray[np.float64], column: NDArray[np.float64]) -> NDArray[np.floating]:
    """As `between`, by cubic convolution (Keys 1981, a = -1/2), which is right to the third order where that is to the second: between
    four cells of 0.2 mm under a ball of R 3 mm that is 3 µm off."""
    rows, columns = values.shape[-2:]
    row, column = np.clip(row, 0.0, rows - 1.0), np.clip(column, 0.0, columns - 1.0)
    up, left = np.minimum(row.astype(np.intp), rows - 2), np.minimum(column.astype(np.intp), columns - 2)
    down, right = (keys((way - first).astype(values.dtype)) for way, first in ((row, up), (column, left)))
    flat = values.reshape(*values.shape[:-2], -1)
    across = [np.clip(left + i, 0, columns - 1) for i in range(-1, 3)]
    found = 0.0
    for i, share in enumerate(down):
        line = np.clip(up + i - 1, 0, rows - 1) * columns
        found = found + share * sum(flat.take(line + place, axis=-1) * part for place, part in zip(across, right, strict=True))
    return found  # type: ignore[return-value]


def keys(t: Any) -> list[Any]:
    """Shares of the four values around a place that is t, 0 to 1, behind the second."""
    return [((2 - t) * t - 1) * t * 0.5, ((3 * t - 5) * t * t + 2) * 0.5, ((4 - 3 * t) * t + 1) * t * 0.5, (t - 1) * t * t * 0.5]


def between(values: NDArray[np.floating], row: NDArray[np.float64], column: NDArray[np.float64]) -> NDArray[np.floating]:
    """Values of a grid (..., rows, columns) between its places, bilinear, (..., *shape of row); beyond it those of its rim."""
    rows, columns = values.shape[-2:]
    row, column = np.clip(row, 0.0, rows - 1.0), np.clip(column, 0.0, columns - 1.0)
    up, left = np.minimum(row.astype(np.intp), rows - 2), np.minimum(column.astype(np.intp), columns - 2)
    down, right = (row - up).astype(values.dtype), (column - left).astype(values.dtype)
    corner, flat = up * columns + left, values.reshape(*values.shape[:-2], -1)
    upper, lower = ((one := flat.take(corner + i, axis=-1)) + right * (flat.take(corner + i + 1, axis=-1) - one) for i in (0, columns))
    return upper + down * (lower - upper)
