"""Friction's law has one home, gelsim/fem/friction.py: changed there, it is changed for all."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import warp as wp

from gelsim.fem import contact_kernels, friction
from gelsim.fem.contact import ContactLaw
from gelsim.live.sensor import LiveSensor
from gelsim.scene.layers import build_scene

MU, SHARE = 0.5, 0.5
"""Planted: a bound of SHARE μ p."""


def test_kernels_compile_it() -> None:
    assert contact_kernels.slip_bound.func is friction.slip_bound
    assert contact_kernels.slip_bound_slope.func is friction.slip_bound_slope


def test_arrays_keep_their_precision() -> None:
    for kind in (np.float32, np.float64):
        assert friction.slip_bounds(MU, np.ones(2, kind)).dtype == kind


def test_slope_is_the_derivative() -> None:
    p, h = np.linspace(0.5, 20.0, 40), 1e-4

    def slope(h: float) -> np.ndarray:
        return (friction.slip_bounds(MU, p + h) - friction.slip_bounds(MU, p - h)) / (2 * h)

    # rounding of bounds up to 10 over 2 h, and what is cut off: of 2 h it is four times as much
    cut = np.abs(slope(2 * h) - slope(h)).max()
    found = np.broadcast_to(friction.slip_bound_slope(MU, p), p.shape).astype(float)
    assert found == pytest.approx(slope(h), abs=20 * np.finfo(float).eps / h + cut)


SCALE = 11.0


def falling(mu: Any, p: Any) -> Any:
    return mu * p / np.cbrt((p + np.float64(1.0)) / np.float64(SCALE))


def test_kernels_and_arrays_read_a_law_alike_as_the_head_of_the_file_says() -> None:
    compiled = wp.func(falling)

    @wp.kernel
    def ask(p: wp.array(dtype=wp.float64), bound: wp.array(dtype=wp.float64)):  # type: ignore[valid-type]
        i = wp.tid()
        bound[i] = compiled(wp.float64(0.5), p[i])

    p = np.linspace(0.5, 20.0, 40)
    bound = wp.zeros(len(p), dtype=wp.float64, device="cpu")
    wp.launch(ask, len(p), [wp.array(p, dtype=wp.float64, device="cpu"), bound], device="cpu")
    assert bound.numpy() == pytest.approx(np.asarray(falling(0.5, p), float), rel=1e-12)


def bounds() -> np.ndarray:
    """What a profile's contact bears at 3 kPa, and tangential over normal force of a sliding ball by a live sensor's patch and its step."""
    body = {"shape": "hemisphere", "rigid": True, "radius_mm": 3.0}
    scene = {"gel": {"profile": "flat"}, "object": body, "contact": {"friction_coefficient": MU}}
    sensor = LiveSensor(build_scene(scene), image=False)
    sensor.step((0.0, 0.0, -0.4e-3, 1.0, 0.0, 0.0, 0.0), 0.01)
    patch = sensor.patch().wrench(np.array([1e-3, 0.0, 0.0, 0.0, 0.0, 0.0]))
    dragged = sensor.step((1e-3, 0.0, -0.4e-3, 1.0, 0.0, 0.0, 0.0), 0.01).force
    return np.array([ContactLaw(1.0, 1.0, MU, 1.0).borne(np.array([3.0]))[0], *(force[0] / -force[2] for force in (patch, dragged))])


def test_profiles_and_live_ask_it(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = bounds()
    assert plain[0] == pytest.approx(3.0 * MU, rel=0.01)
    assert MU < plain[1] < 1.03 * MU  # by the slopes under the ball: (1 + s²)^(3/4), s² from 0 to 2 · 0.4 / 3 (test_live_patch.py)
    assert MU < plain[2] < 1.03 * 1.1 * MU  # and a ball that slides pushes up the gel before it (test_live.py)
    monkeypatch.setattr(friction, "slip_bound", lambda mu, p: SHARE * mu * p)
    found = bounds()
    assert found[:2] == pytest.approx(SHARE * plain[:2], rel=0.01)  # all of it slides, cells at the rim another way (test_live_patch.py)
    # On the face that is pushed up, 0.04 steep, the normal pressure is more by μ 0.04, which goes with μ too: (1 - SHARE) MU 0.04 besides
    assert found[2] == pytest.approx(SHARE * plain[2], rel=0.02)
