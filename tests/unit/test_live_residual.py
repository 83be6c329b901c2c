"""What the live sensor's layer lacks: the network's own laws, and presses of finite elements that it was not trained on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import gelsim
from gelsim.bench import live
from gelsim.live import residual
from gelsim.live.layer import Elastic, Layer, Values
from gelsim.live.residual import Kernel, Residual
from gelsim.live.sensor import LiveSensor, State
from gelsim.scene.definition import Scene
from gelsim.scene.layers import build_scene

GEL = Elastic(20.0, 0.499)
BOX = {"shape": "box", "width_mm": 4.0, "length_mm": 6.0, "height_mm": 6.0, "edge_radius_mm": 0.2, "rigid": True}


def scene(**gel: object) -> Scene:
    made = {"profile": "flat", "thickness_mm": 2.4, **gel}
    return build_scene({"gel": made, "object": BOX, "contact": {"friction_coefficient": 0.5}, "fidelity": "live"})


def pressed(of: Scene) -> State:
    """A box, pressed beside the middle and drawn along."""
    sensor = LiveSensor(of, image=False)
    for x, z in ((0.9, -0.3), (0.9, -0.6), (1.1, -0.6)):
        frame = sensor.step((x * 1e-3, -0.7e-3, z * 1e-3, 1.0, 0.0, 0.0, 0.0), 0.01)
    return frame._state


def test_of_nothing_it_makes_nothing() -> None:
    """Layer by layer, whatever the biases: a gel at rest is left as it is."""
    rng = np.random.default_rng(0)
    sizes = (24, 8, 8, 12)
    made = [Kernel(rng.standard_normal((b, a, 3, 3)), rng.standard_normal((b, 1, 1))) for a, b in zip(sizes, sizes[1:], strict=False)]
    assert not residual.answer(np.zeros((6, 8, 10)), made, residual.convolved).any()
    assert residual.answer(np.ones((6, 8, 10)), made, residual.convolved).any()
    kept = residual.kernels()
    assert all(np.isfinite(part).all() for kernel in kept for part in (kernel.weights, kernel.bias))
    assert residual.REACH >= 2 * len(kept) + 1  # cells to each side that one hangs on


def test_fields_in_fours_and_back() -> None:
    values = np.arange(3 * 4 * 6).reshape(3, 4, 6)
    fours = residual.in_fours(values)
    assert fours.shape == (12, 2, 3) and (fours[:3] == values[:, ::2, ::2]).all() and (fours[3:6] == values[:, ::2, 1::2]).all()
    assert (residual.spread(fours) == values).all()


@pytest.mark.parametrize("thickness", [2.4, 1.7, 4.25])
def test_around_the_contact_it_is_what_it_is_over_all(thickness: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sensor's, of a part of its grid, beside a batch's, of all of it and in PyTorch, to single precision."""
    torch = pytest.importorskip("torch")
    from gelsim.live.batch_layer import Residuals

    state = pressed(scene(thickness_mm=thickness, size_mm=(24.0, 20.0)))
    fields = state.whole
    many = Residuals(state.learnt, "cpu")(*(torch.as_tensor(np.stack([0 * part, part])) for part in fields)).numpy()
    found = state.learnt(*fields)
    assert not many[0].any() and np.abs(found).max() > 5e-3
    assert np.abs(many[1] - found).max() < 1e-5 * np.abs(found).max()
    monkeypatch.setattr(residual, "REACH", 2)  # planted: what is seen ends too soon
    assert np.abs(many[1] - state.learnt(*fields)).max() > 1e-3 * np.abs(found).max()


def test_mirrored_and_turned_it_is_mirrored_and_turned() -> None:
    grid = Layer((16.0, 16.0), GEL)
    known = Residual(grid, 2.4)
    x, y = (way.astype(np.float32) for way in np.meshgrid(grid.x, grid.y))
    near = np.exp(-((x - 1.5) ** 2 + 2 * (y + 0.5) ** 2) / 4)
    moved = np.stack([0.2 * x * near, -0.1 * y * near + 0.05 * near, -0.5 * near])
    pressure, shear = 20 * np.clip(near - 0.4, 0, None), 5 * np.stack([np.clip(near - 0.4, 0, None), 0.3 * np.clip(near - 0.4, 0, None)])
    found = known(moved, pressure, shear)
    scale = np.abs(found).max()
    assert scale > 5e-3

    def mirrored(values: Values) -> Values:
        other = values[..., ::-1].copy()
        other[0] *= -1
        return other

    def exchanged(values: Values) -> Values:
        return values.swapaxes(-1, -2)[[1, 0, *range(2, len(values))]].copy()

    assert np.abs(known(mirrored(moved), pressure[:, ::-1], mirrored(shear)) - mirrored(found)).max() < 1e-2 * scale  # weights of 11 bits
    assert np.abs(known(exchanged(moved), pressure.T, exchanged(shear)) - exchanged(found)).max() < 1e-2 * scale
    assert np.abs(mirrored(found) - found).max() > 0.5 * scale  # planted: not mirrored


def test_twice_the_gel_moves_twice_as_far() -> None:
    """Similarity: lengths by two, moduli and tractions by three."""
    small, large = Layer((16.0, 16.0), GEL), Layer((32.0, 32.0), replace(GEL, shear_kpa=60.0), cell_mm=0.4)
    x, y = np.meshgrid(small.x, small.y)
    near = np.exp(-(x**2 + y**2) / 4).astype(np.float32)
    moved, pressure = np.stack([0.1 * near, 0 * near, -0.5 * near]), 20 * np.clip(near - 0.4, 0, None)
    shear = np.stack([0.2 * pressure, 0 * pressure])
    found = Residual(small, 2.4)(moved, pressure, shear)
    np.testing.assert_allclose(Residual(large, 4.8)(2 * moved, 3 * pressure, 3 * shear), 2 * found, rtol=0, atol=1e-5)
    assert np.abs(found).max() > 5e-3


def test_what_touches_is_not_lifted_into_the_object() -> None:
    state = pressed(scene())
    higher = (state.shown - state.field)[2]
    touching = state.over(state.pressure, higher.shape) > 0
    assert higher[touching].max() <= 0.0 and higher[~touching].max() > 5e-3


@pytest.mark.parametrize(
    ("body", "depth"),
    [({"shape": "hemisphere", "radius_mm": 3.0, "height_mm": 8.0, "rigid": True}, 0.96), (BOX, 0.72)],
    ids=["ball", "box"],
)
def test_the_face_is_nearer_to_finite_elements(body: dict, depth: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Motion along the face by a quarter at least, and heights, around the contact."""
    base = {"gel": {"profile": "flat", "thickness_mm": 2.4}, "contact": {"friction_coefficient": 0.5}, "object": body}
    made = build_scene(base | {"press": {"depth_mm": depth, "frames": 2}, "render": {"resolution": [160, 120]}})
    truth = gelsim.press(made.replace(fidelity="fast"))

    def off() -> tuple[float, float]:
        press = gelsim.press(made.replace(fidelity="live"))
        middle, radius = live.near(truth, -1)
        net = np.linspace(-radius, radius, live.NET)
        places = middle + np.stack(np.meshgrid(net, net), axis=-1).reshape(-1, 2)
        along = live._moved(press, -1, places) - live._moved(truth, -1, places)
        up = live.heights_over(press, -1, places) - live.heights_over(truth, -1, places)
        return float(np.sqrt((along**2).sum(axis=1).mean())), float(np.sqrt((up**2).mean()))

    found = off()
    monkeypatch.setattr(Residual, "__call__", lambda self, moved, *_: np.zeros_like(moved))  # planted
    alone = off()
    assert found[0] < 0.75 * alone[0] and found[1] < alone[1]
