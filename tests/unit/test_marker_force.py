"""Forces from markers: integrals, noise, and what is hidden, against closed forms; no mechanics."""

from __future__ import annotations

import numpy as np
import pytest

from gelsim.errors import SceneError
from gelsim.scene.layers import build_scene
from gelsim.study import marker_force
from gelsim.study.marker_force import RINGS, Field, cells, marker_cost, marker_forces, marker_noise
from gelsim.study.trial import Trial

RADIUS = 3.0e-3


def test_cells_are_those_of_voronoi(rng: np.random.Generator) -> None:
    y, x = np.mgrid[:9, :9] * 2.0
    grid = np.stack([x.ravel(), y.ravel()], axis=1)
    # Of a regular grid the triangles are not unique, the cells are.
    assert np.allclose(cells(grid).reshape(9, 9)[1:-1, 1:-1], 4.0, rtol=1e-9)
    points = grid + 0.4 * rng.standard_normal(grid.shape)
    middle = 4 * 9 + 4
    # By counting: which of a fine grid of places around it are nearest to the point in the middle.
    fine = np.stack(np.meshgrid(*[np.linspace(-3, 3, 301)] * 2), axis=-1).reshape(-1, 2) + points[middle]
    nearest = np.argmin(
        ((fine[:, None] - points[[n for n in range(81) if abs(points[n] - points[middle]).max() < 7]]) ** 2).sum(-1), axis=1
    )
    index = [n for n in range(81) if abs(points[n] - points[middle]).max() < 7].index(middle)
    # A step of 0.02 counts a cell with a perimeter of about 8 to 8 * 0.02 at worst.
    assert cells(points)[middle] == pytest.approx((nearest == index).sum() * 4e-4, abs=0.16)
    with pytest.raises(SceneError, match="markers.pitch_mm: 2 markers"):
        cells(grid[:2])


@pytest.fixture
def smooth(monkeypatch: pytest.MonkeyPatch) -> None:
    """Presses whose surface moves by F (x b, and a along x) of bells, so that a linear model of the motion knows the force exactly."""

    def field(trial: Trial, radius_mm: float, shear_share: float) -> Field:
        normal, shear = np.array([0.1, 0.3]), shear_share * np.array([0.1, 0.3])

        def displacement(points: np.ndarray) -> np.ndarray:
            bell = np.exp(-(points**2).sum(axis=-1) / (2 * (1.5e-3) ** 2))[..., None]
            sideways = points[..., :1] * bell * 0.1 * normal + 2e-4 * bell * shear
            up = -1e-3 * np.ones_like(bell) * (points**2).sum(axis=-1, keepdims=True) / RADIUS**2 * np.ones(2)
            return np.stack([sideways, points[..., 1:] * bell * 0.1 * normal, up], axis=-1)

        return Field(displacement, normal, shear, np.zeros((2, 2)), RADIUS)

    monkeypatch.setattr(marker_force, "press_field", field)


def trial(**markers: float) -> Trial:
    size = {"size_jitter": 0.0, "outline_jitter": 0.0, "jitter_mm": 0.0}
    return Trial(({"gel": {"profile": "flat"}, "markers": size | markers, "camera": {"resolution": [960, 720], "field_mm": [18.4, 13.8]}},))


@pytest.mark.usefixtures("smooth")
def test_a_force_is_as_uncertain_as_its_markers() -> None:
    dense = trial(pitch_mm=0.6, radius_mm=0.2)
    noise = marker_noise(dense.scene)[0]
    # 0.05 pixels of 19.2 µm, as stated: 0.29 sqrt(p / (π r)) = 0.0507.
    assert noise == pytest.approx(0.05 * 18.4e-3 / 960, rel=0.02)
    assert marker_noise(trial(radius_mm=0.05).scene)[0] == pytest.approx(2 * noise, rel=1e-9)
    # The sums approach integrals: the noise of a ring's is σ² times its cell times the integral of its hat squared over the plane.
    middle = marker_force._samples(dense, ((4.0, 0.4),), 0)[1][1][:, 1, 1].mean()
    r = np.linspace(0, RINGS[-1], 20_001)
    hat = np.interp(r, RINGS, [0, 1, 0, 0])
    expected = noise**2 * (0.6e-3) ** 2 * np.trapezoid(2 * np.pi * r * hat**2, r)
    assert middle == pytest.approx(expected, rel=0.03)  # the hat's kinks: a share of (0.6 / 1.8)², an eighth
    found = [marker_forces(trial(pitch_mm=pitch, radius_mm=0.1)) for pitch in (0.6, 3.5)]
    # Bells of 1.5 mm are summed exactly from a pitch of 0.6 (to exp(-2 π² (1.5 / 0.6)²)) and badly from 3.5.
    assert found[0].normal_error < 0.02 and found[0].shear_error < 0.02
    assert found[1].normal_error > 5 * found[0].normal_error and found[1].shear_error > 5 * found[0].shear_error


@pytest.mark.usefixtures("smooth")
def test_markers_hide_what_they_cover() -> None:
    cost = marker_cost(trial(pitch_mm=1.0, radius_mm=0.2))
    assert cost.hidden == pytest.approx(np.pi * 0.2**2, rel=1e-6)
    # Over a disc of radius a a height c r² is off by c (a² - ρ²), whose mean square is c² a⁴ / 3; it counts over the hidden share.
    expected = 1e-3 / RADIUS**2 * (0.2e-3) ** 2 * np.sqrt(cost.hidden / 3)
    # Of 28 discs a place one in five lies over the edge of what counts; the mean of 48 places is good to some per cent.
    assert cost.fill_error == pytest.approx(expected, rel=0.05)


@pytest.mark.usefixtures("smooth")
def test_few_markers_hide_as_much_each() -> None:
    """Of 7 x 6 on a small gel 22 lie at the rim, with open cells; the others have a whole square of the pitch."""
    small = trial(pitch_mm=1.6, radius_mm=0.15).beside({"gel.size_mm": [12.0, 10.0], "camera.field_mm": [9.6, 7.2]})
    assert marker_cost(small).hidden == pytest.approx(np.pi * 0.15**2 / 1.6**2, rel=1e-6)
    with pytest.raises(SceneError, match="gel.size_mm = 12 x 10 mm: .* allowed are sides of 13.8 mm and more"):
        marker_forces(small)


def test_a_press_needs_a_depth() -> None:
    with pytest.raises(SceneError, match="press.depth_mm is none"):
        marker_forces(Trial(({"press": {"depth_mm": "none"}, "object": {"rigid": True}},)))
    assert build_scene({}).markers.layout == "grid"
