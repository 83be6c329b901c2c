"""The motion of a gel's outer surface, small enough to keep of every press: from it any sensor's light is drawn later. Plain NumPy.

Kept are the solved states of the surface's nodes: rest places x, y and displacements as whole numbers of STEP, each state as its difference
from what the two before it lead to expect (u₁ + (u₁ - u₀) r, r the ratio of the approaches' steps), high and low bytes apart, compressed by
LZMA. The difference is of rounded values, so errors do not add up: every component is off by half a STEP at most, a displacement by
√3/2 STEP = 0.9 µm, and its place by √2/2 STEP. Between two states a displacement is interpolated in approach by monotone cubics
(Fritsch and Carlson 1980); what that is off by is measured in docs/datasets.md.

Left out: the object's surface, pressures inside the contact, the rest height z, which is the gel's own (`gelsim.shape.shapes.gel_height`).
"""

from __future__ import annotations

import lzma
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gelsim.data.episodes import npz, unpacked
from gelsim.errors import DatasetError
from gelsim.results import Deformation

STEP = 1e-6
"""[m] Displacements and rest places are whole numbers of this."""
LARGEST = 64 * 2**20
"""Bytes of an archive's numbers, unpacked."""


@dataclass(frozen=True, eq=False)
class Motion:
    """S states of a press: the first is first touch, without force."""

    approach: NDArray[np.float64]
    """[m], ascending, shape (S,)."""
    force: NDArray[np.float64]
    """On the gel by the object [N], shape (S, 3)."""
    contact_area: NDArray[np.float64]
    """Projected on the window [m²], shape (S,)."""
    rest: NDArray[np.float64]
    """x and y of the outer surface's nodes [m], shape (G, 2)."""
    displacement: NDArray[np.float64]
    """[m], shape (S, G, 3)."""

    @classmethod
    def of_press(cls, press: Deformation) -> Motion:
        """Of the solved states of a press that moved on."""
        keep = np.flatnonzero(np.diff(press.approach, prepend=-1.0) > 0)
        return cls(press.approach[keep], press.force[keep], press.contact_area[keep], press.gel.rest[:, :2], press.gel.displacement[keep])

    def until(self, approach: float) -> Motion:
        """The states that a press ending there [m] needs: one beyond it, where there is one."""
        count = min(int(np.searchsorted(self.approach, approach * (1 - 1e-12))) + 1, len(self.approach))
        return replace(self, **{name: getattr(self, name)[:count] for name in ("approach", "force", "contact_area", "displacement")})

    def at(self, approach: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Displacements (N, G, 3) [m] and forces (N, 3) [N] at approaches (N,) [m]; before first touch they are those at first touch."""
        wanted = np.clip(approach, self.approach[0], self.approach[-1])
        if len(self.approach) == 1:
            return np.repeat(self.displacement, len(wanted), axis=0), np.repeat(self.force, len(wanted), axis=0)
        from scipy.interpolate import PchipInterpolator

        return PchipInterpolator(self.approach, self.displacement)(wanted), PchipInterpolator(self.approach, self.force)(wanted)


def pack(motion: Motion) -> bytes:
    """mechanics.npz of a motion: the same bytes for the same motion."""
    whole = np.rint(motion.displacement / STEP).astype(np.int64)
    places = np.rint(motion.rest / STEP).astype(np.int32)
    if np.abs(whole).max(initial=0) >= 2**15:
        raise DatasetError(f"a displacement of {np.abs(motion.displacement).max() * 1e3:g} mm does not fit into the archive (32 mm)")
    # By place, so that neighbours in the file are neighbours on the gel: strips of 1 mm, each run through along y.
    order = np.lexsort((places[:, 1], places[:, 0] // 1000))
    whole, places = whole[:, order], places[order]
    left = whole - np.rint(_expected(motion.approach, whole)).astype(np.int64)
    numbers = np.concatenate([np.diff(places, axis=0, prepend=0).T.ravel(), left.transpose(0, 2, 1).ravel()]).astype(np.int32)
    # The window of preset 6, 8 MiB, holds all of them; to clear one of 64 MiB takes ten times as long as what is done in it.
    packed = lzma.compress(_planes(numbers), format=lzma.FORMAT_ALONE, preset=6)
    return npz({
        "schema": np.array(1), "approach": motion.approach, "force": motion.force, "contact_area": motion.contact_area,
        "shape": np.array(whole.shape), "step_m": np.array(STEP), "numbers": np.frombuffer(packed, np.uint8),
    })  # fmt: skip


def unpack(content: bytes) -> Motion:
    """The motion in a mechanics.npz.

    Raises:
        DatasetError: It is none, or damaged.
    """
    stored = unpacked(content)
    try:
        states, nodes, three = (int(n) for n in stored["shape"])
        size = 2 * nodes + states * nodes * three
        if stored["schema"] != 1 or three != 3 or not 0 < states or not 0 < nodes or 4 * size > LARGEST:
            raise DatasetError(
                f"mechanics.npz: {states} states of {nodes} nodes, schema {stored['schema']}, are not what this version reads"
            )
        raw = lzma.LZMADecompressor(lzma.FORMAT_ALONE, memlimit=2**28).decompress(stored["numbers"].tobytes(), max_length=4 * size + 1)
        numbers = _from_planes(raw, size)
        places = np.cumsum(numbers[: 2 * nodes].reshape(2, nodes).T, axis=0)
        left = numbers[2 * nodes :].reshape(states, 3, nodes).transpose(0, 2, 1)
        whole = np.zeros((states, nodes, 3), np.int64)
        for state in range(states):
            whole[state] = left[state] + np.rint(_expected(stored["approach"][: state + 1], whole[: state + 1])[state]).astype(np.int64)
        step = np.float64(stored["step_m"])
        return Motion(stored["approach"], stored["force"], stored["contact_area"], np.float64(step) * places, np.float64(step) * whole)
    except (KeyError, ValueError, TypeError, lzma.LZMAError, EOFError) as error:
        raise DatasetError(f"mechanics.npz: is damaged ({error})") from None


def _expected(approach: NDArray[np.float64], whole: NDArray[np.int64]) -> NDArray[np.float64]:
    """What each state's two predecessors lead to expect; of the first nothing, of the second the first."""
    guess = np.zeros(whole.shape)
    for state in range(1, len(whole)):
        guess[state] = whole[state - 1]
        if state > 1:
            ratio = (approach[state] - approach[state - 1]) / (approach[state - 1] - approach[state - 2])
            guess[state] += ratio * (whole[state - 1] - whole[state - 2])
    return guess


def _planes(numbers: NDArray[np.int32]) -> bytes:
    """Signs folded into the lowest bit, then bytes of equal weight together: the upper ones are nearly all zero."""
    folded = (2 * np.abs(numbers.astype(np.int64)) - (numbers < 0)).astype("<u4")
    return folded.view(np.uint8).reshape(-1, 4).T.tobytes()


def _from_planes(raw: bytes, count: int) -> NDArray[np.int64]:
    folded = np.frombuffer(raw, np.uint8).reshape(4, count).T.copy().view("<u4").ravel().astype(np.int64)
    return np.where(folded % 2, -(folded + 1) // 2, folded // 2)
