"""The mechanics archive: what is off by how much, how large it is, and what a damaged one says."""

from __future__ import annotations

import numpy as np
import pytest

from gelsim.data.motion import STEP, Motion, pack, unpack
from gelsim.errors import DatasetError


def dented(nodes: int = 4000, states: int = 13) -> Motion:
    """A ball's dent that grows: as many nodes and states as the largest presses of `fast` have."""
    rng = np.random.default_rng(1)
    rest = rng.uniform(-12.5e-3, 12.5e-3, (nodes, 2))
    approach = np.linspace(0, 2e-3, states)
    radius = np.linalg.norm(rest - [1e-3, 0], axis=1)
    displacement = np.zeros((states, nodes, 3))
    for state, depth in enumerate(approach):
        wide = np.sqrt(2 * 8e-3 * max(depth, 1e-9))
        displacement[state, :, 2] = -depth * np.exp(-((radius / (1.5 * wide + 1e-4)) ** 2))
        displacement[state, :, :2] = rest * depth * 5 * np.exp(-((radius / 4e-3) ** 2))[:, None]
    return Motion(approach, np.outer(approach, [0.0, 0.1, -2e3]), approach * 1e-2, rest, displacement)


def order_of(made: Motion, read: Motion) -> np.ndarray:
    """Positions in `made` of the nodes of `read`: both sorted by their rounded places."""
    first, second = (np.rint(m.rest / STEP).astype(int) for m in (made, read))
    order = np.empty(len(first), int)
    order[np.lexsort(second.T)] = np.lexsort(first.T)
    return order


def test_errors_are_half_a_step_and_size_is_small():
    made = dented()
    content = pack(made)
    read = unpack(content)
    order = order_of(made, read)
    # Rounding to whole steps: half a step a component, root three of that for a displacement; 1e-9 for float64 at 1 mm.
    off = np.linalg.norm(read.displacement - made.displacement[:, order], axis=2).max()
    assert 0.1 * STEP < off <= np.sqrt(3) / 2 * STEP * (1 + 1e-9) < 2e-6
    assert np.abs(read.rest - made.rest[order]).max() <= STEP / 2 * (1 + 1e-9)
    np.testing.assert_array_equal(read.force, made.force)
    # The bound of the issue; rest places at random cost more than a mesh's.
    assert len(content) <= 40_000
    assert pack(made) == content and pack(read) == content


def test_between_states_it_is_monotone_and_exact_for_a_straight_path():
    made = dented()
    straight = Motion(
        made.approach, made.force, made.contact_area, made.rest, np.multiply.outer(made.approach, made.displacement[-1] * 500)
    )
    at = np.array([0.0, 0.3e-3, 1.234e-3, 2e-3])
    displacement, force = straight.at(at)
    np.testing.assert_allclose(displacement, np.multiply.outer(at, made.displacement[-1] * 500), atol=1e-15)
    np.testing.assert_allclose(force[:, 2], -2e3 * at, atol=1e-12)
    path = made.at(np.linspace(0, 2e-3, 50))[0][:, :, 2]
    assert (np.diff(path, axis=0) <= 1e-18).all()


def test_an_end_point_keeps_one_state_beyond():
    made = dented()
    short = made.until(0.9e-3)
    assert short.approach[-2] < 0.9e-3 <= short.approach[-1] and len(made.until(2e-3).approach) == 13
    assert len(made.until(made.approach[4]).approach) == 5


def test_damage_and_excess_are_one_clear_error(monkeypatch):
    content = pack(dented(50, 3))
    for broken in (b"", content[: len(content) // 2], b"PK\x03\x04nothing"):
        with pytest.raises(DatasetError, match="damaged"):
            unpack(broken)
    monkeypatch.setattr("gelsim.data.motion.LARGEST", 1000)
    with pytest.raises(DatasetError, match="3 states of 50 nodes"):
        unpack(content)
    far = dented(50, 3)
    far.displacement[:] = 0.05
    with pytest.raises(DatasetError, match="50 mm does not fit"):
        pack(far)
