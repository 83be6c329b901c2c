"""Each ready-made study says what physics says, in its quick form."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gelsim.errors import SceneError
from gelsim.membrane.surface import GRID_SPACING, rest_membrane
from gelsim.optics import height_map
from gelsim.optics.camera import pixel_size
from gelsim.optics.srgb import srgb_tone
from gelsim.results import Frame, Membrane
from gelsim.scene.layers import nested
from gelsim.scene.materials import modulus_from_shore_00
from gelsim.study import runner, visible
from gelsim.study.definition import load_study
from gelsim.study.discrimination import RADIUS_UNKNOWN, SLOPE_NOISE, combine, sensitivity
from gelsim.study.marker_force import press_field
from gelsim.study.photometric import exposed
from gelsim.study.texture import WAVELENGTH, texture_signal
from gelsim.study.trial import Trial
from gelsim.study.visible import BELL, DEEP, smallest_dent
from gelsim.work.ledger import Row

Array = NDArray[np.float64]


def rows(name: str, out: Path) -> list[Row]:
    """Of the quick form; no case failed."""
    told = runner.run(load_study(name).small(), out)
    assert told["failed"] == []
    return list(runner.Ledger(out / runner.RESULTS, resume=True).rows.values())


def long_2011(modulus: float, radius: float, depth: float, thickness: float) -> float:
    """Force [N] on a ball pressed without friction into a bonded incompressible layer (Long et al. 2011), good to a few per cent."""
    chi = (radius * depth / thickness**2) ** 1.5
    alpha = 10.05 - 0.63 * np.sqrt(thickness / radius) * (3.1 + (thickness / radius) ** 2)
    beta = 4.8 - 4.23 * (thickness / radius) ** 2
    hertz = 16 / 9 * modulus * np.sqrt(radius) * depth**1.5
    return hertz * (1 + 1.15 * chi ** (1 / 3) + alpha * chi + beta * chi**2) / (1 + 2.3 * chi)


@pytest.mark.slow
def test_a_thicker_gel_gives_way_and_spreads_and_is_squeezed_out_less(tmp_path: Path) -> None:
    thin, middle, thick = sorted(rows("gel-thickness", tmp_path), key=lambda row: row["gel.thickness_mm"])
    assert thin["force_n"] > middle["force_n"] > thick["force_n"]
    # A half-space's dent (Hertz: a = sqrt(R d)) has fallen to a tenth at about 4 a / (3 π 0.1) from the apex; a layer's is narrower.
    assert thick["dent_reach_mm"] < np.sqrt(4.0 * 0.5) * (4 / (3 * np.pi * 0.1) - 1)
    assert thin["dent_reach_mm"] < middle["dent_reach_mm"] < thick["dent_reach_mm"]
    # An incompressible half-space's surface does not move sideways (Boussinesq, ν = 0.5); a thin layer is squeezed out from under the ball.
    assert thin["marker_motion_um"] > middle["marker_motion_um"] > thick["marker_motion_um"]
    # The same press without friction, against a formula of others: it is good to 4 %, `fast` to 2 % (docs/validation.md).
    study = load_study("gel-thickness")
    point = {"gel.thickness_mm": 2.4, "object.radius_mm": 4.0, "contact.friction_coefficient": 0.0}
    force = Trial((study.base, nested(point)), "cpu").force[-1]
    assert force == pytest.approx(long_2011(modulus_from_shore_00(17.0), 4e-3, 0.5e-3, 2.4e-3), rel=0.06)


@pytest.mark.slow
def test_a_gel_sees_best_what_is_as_soft_as_itself(tmp_path: Path) -> None:
    seen = {(row["gel.shore_00"], row["object.shore_00"]): row for row in rows("gel-hardness", tmp_path)}
    told = {pair: row["slope_equal_force"] for pair, row in seen.items()}
    # Springs in series and Hertz's contact: slopes are κ a f(r/a), so that at equal force their length over the picture, κ a², changes by
    # S = (x / (1 + x))^(1/3) / (1 + x) for a relative change of the modulus, x = E / E_gel, and a Shore point changes that by the slope of
    # ln E. A bonded layer is stiffer than x says, by up to three.
    shores = np.array([17.0, 80.0])
    by_point = np.array([np.log(modulus_from_shore_00(h + 0.5) / modulus_from_shore_00(h - 0.5)) for h in shores])
    for gel in (17, 45):
        found = np.array([told[gel, int(shore)] for shore in shores])
        expected = []
        for stiffer in (1.0, 3.0):
            x = np.array([modulus_from_shore_00(h) for h in shores]) / (stiffer * modulus_from_shore_00(gel))
            signal = by_point * (x / (1 + x)) ** (1 / 3) / (1 + x)
            expected.append(signal[-1] / signal[0])
        # The share of the softest object's signal that is left at the hardest lies between the two, widened by a third as it goes deep.
        assert min(expected) / 1.33 < found[-1] / found[0] < max(expected) * 1.33
    # The rule: a hard gel loses less by hard objects than a soft one, and a gel of 17 is left with less than half of its best above 70; of
    # who does not know the radius, less than a quarter.
    assert told[45, 80] / told[17, 80] > 1.3 * told[45, 17] / told[17, 17]
    assert told[17, 80] < 0.5 * told[17, 17]
    assert seen[17, 80]["slope_unknown_radius"] < 0.25 * seen[17, 17]["slope_unknown_radius"]
    for row in seen.values():
        known = min(row["slope_equal_depth"], row["slope_equal_force"])
        assert row["slope_unknown_radius"] <= row["slope_unknown_press"] <= known


def hertz_slopes(shore: float, force: float, radius: float) -> Array:
    """Slopes of a half-space of Shore 00-17 under an elastic ball (Hertz; Johnson 1985, eq. 3.42), on pixels of 0.115 mm.

    Within the contact they are κ r, κ = E / (E + E_gel) / R, outside κ a by r/a alone: a picture holds κ and a, and no third number.
    """
    gel, body, pixel = modulus_from_shore_00(17.0), modulus_from_shore_00(shore), 0.115e-3
    a = (0.75 * force * radius * 0.75 * (1 / gel + 1 / body)) ** (1 / 3)
    y, x = (np.mgrid[:120, :160] - np.array([59.5, 79.5])[:, None, None]) * pixel
    r, out = np.hypot(x, y), np.maximum(np.hypot(x, y), a)
    outside = -((2 * a**2 - out**2) * np.arcsin(a / out) + a * np.sqrt(out**2 - a**2)) / np.pi
    height = body / (body + gel) / radius * np.where(r < a, r**2 / 2 - a**2, outside)
    return np.dstack(tuple(np.gradient(height, pixel)))


def test_hertz_hides_hardness_behind_force_and_radius() -> None:
    """κ and a are two numbers for three unknowns: of who knows the radius to a share s is left (d ln κ/dH) / s, whatever the noise."""
    force, radius, step = 0.3, 8e-3, 1e-3
    modulus = modulus_from_shore_00
    left_over = []
    for shore in (17.0, 50.0, 86.0):
        by_log = 2 * 0.01 / np.log(modulus(shore + 0.01) / modulus(shore - 0.01))  # Shore points per ln E
        seen = combine(
            (hertz_slopes(shore + step * by_log, force, radius) - hertz_slopes(shore - step * by_log, force, radius)) / (2 * step * by_log),
            (hertz_slopes(shore, force * (1 + step), radius) - hertz_slopes(shore, force * (1 - step), radius)) / (2 * step),
            (hertz_slopes(shore, force, radius * (1 + step)) - hertz_slopes(shore, force, radius * (1 - step))) / (2 * step),
            0.0,
            1 / SLOPE_NOISE**2,
        )
        share = modulus(17.0) / (modulus(17.0) + modulus(shore))
        # Steps of 0.001 move the contact's edge by a hundredth of a pixel; what three unlike edges leave is of second order in that, of the
        # hundred times larger change that is projected away.
        assert seen.unknown_radius == pytest.approx(share / by_log / RADIUS_UNKNOWN, rel=0.01)
        # Planted: a radius that is known.
        assert seen.unknown_press > 50 * seen.unknown_radius
        left_over.append(seen.unknown_radius)
    # What the paper says of a gel of 17 above 70: a seventh of what is seen of objects as soft as the gel.
    assert left_over[2] < left_over[0] / 7


@pytest.mark.slow
def test_pictures_and_slopes_are_weighed_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    def draw(trial: Trial, membranes: list[Membrane]) -> list[Frame]:
        """Pictures whose levels are 100 + 50 times the slopes in x (red) and y (green)."""
        pixel, drawn = pixel_size(trial.scene), []
        for each in membranes:
            height = np.nan_to_num(height_map(trial.scene, each) - height_map(trial.scene, rest_membrane(trial.scene))).astype(float)
            down, right = np.gradient(height, pixel)
            levels = 100 + 50 * np.dstack([right, down, np.zeros_like(down)])
            drawn.append(
                Frame((levels / 255).astype(np.float32), np.zeros((1, 1, 3), np.uint8), height.astype(np.float32), np.zeros((0, 2)))
            )
        return drawn

    monkeypatch.setattr(Trial, "draw", draw)
    study = load_study("gel-hardness")
    camera = {"tone": "linear", "exposure": 1.0, "white_balance": [1.0] * 3, "shading": [], "noise_sd": [4.0, 4.0, 4.0]}
    trial = Trial((study.base, {"gel": {"shore_00": 17}, "object": {"shore_00": 40}, "camera": camera, "fidelity": "fast"}), "cpu")
    picture, slope = sensitivity(trial, "picture"), sensitivity(trial, "slope")
    # Levels over their noise are 50 / 4 times the slopes, slopes over theirs 1 / SLOPE_NOISE. Heights are single precision: of 1 mm, 1e-7
    # of a pixel of 0.1 mm and in a difference of slopes of 1e-3, 1e-3 at most.
    share = 50 / 4 * SLOPE_NOISE
    for name in ("equal_depth", "equal_force", "unknown_press"):
        assert getattr(picture, name) == pytest.approx(share * getattr(slope, name), rel=2e-3)
    # `change` is a mean over three channels here, of which one is still; touched are the same two.
    assert picture.change == pytest.approx(share * slope.change, rel=2e-3)
    with pytest.raises(SceneError, match="without noise everything"):
        sensitivity(trial.beside({"camera.noise_sd": [0.0, 0.0, 0.0]}), "picture")


@pytest.mark.slow
def test_three_colours_show_what_three_white_lights_cannot(tmp_path: Path) -> None:
    coloured, white = sorted(rows("light-layout", tmp_path), key=lambda row: row["colours"])
    # White lights from all around give one number a pixel, for two unknowns: the direction of the slope is lost, so the normal's error is
    # most of the slope itself. Three colours give three.
    assert coloured["normal_error_deg"] < 0.5 * white["normal_error_deg"]
    assert coloured["height_error_um"] < 0.5 * white["height_error_um"]


@pytest.mark.slow
def test_markers_tell_the_force_as_a_bonded_layer_does(tmp_path: Path) -> None:
    fine, coarse = sorted(rows("markers", tmp_path), key=lambda row: row["markers.pitch_mm"])
    # Two cells of 3 mm have a contact of 3 to 4 mm across between them: the sums are no integrals any more.
    assert fine["marker_normal_error_pct"] < 5 and fine["marker_shear_error_pct"] < 3
    assert coarse["marker_normal_error_pct"] > 2 * fine["marker_normal_error_pct"]
    assert coarse["marker_shear_error_pct"] > 2 * fine["marker_shear_error_pct"]
    assert fine["marker_fill_error_um"] > 2 * coarse["marker_fill_error_um"]
    # Reciprocity of the bonded layer, F_shear = G/t ∫ u dA and F_normal = G/t² ∫ (x - c)·u dA, in a press that is shallow enough and far
    # from the rim: at 0.05 mm `fast` is within 2 % (a gel of 25 mm loses 7 % of the second integral at its rim).
    study = load_study("markers")
    field = press_field(Trial((study.base, {"press": {"depth_mm": 0.1}, "gel": {"size_mm": [40.0, 40.0]}}), "cpu"), 4.0, 0.4)
    modulus, thick, step = modulus_from_shore_00(17.0) / 3, 2.4e-3, 0.1e-3
    at = np.stack(np.meshgrid(*[np.arange(-19.9e-3, 19.9e-3, step)] * 2), axis=-1).reshape(-1, 2)
    moved = field.at(at)[:, 1]
    shear, normal = moved[:, 0].sum() * step**2, ((at - field.middle[1]) * moved[:, :2]).sum() * step**2
    assert modulus / thick * shear == pytest.approx(field.shear[1], rel=0.02)
    assert modulus / thick**2 * normal == pytest.approx(field.normal[1], rel=0.025)


@pytest.mark.slow
def test_a_shiny_coat_shows_texture_and_loses_walls(tmp_path: Path) -> None:
    matt, shiny = sorted(rows("coating", tmp_path), key=lambda row: row["coating.specular"])
    # A lobe of slopes of 0.15 answers to a slope more steeply than a cosine under 60°, and is dark where a wall leaves it.
    assert shiny["texture_signal_per_um"] > 2 * matt["texture_signal_per_um"]
    assert shiny["steep_normal_error_deg"] > 1.3 * matt["steep_normal_error_deg"]


def test_texture_on_a_matt_coat_is_lamberts_cosine() -> None:
    place = np.array([-25.0, 0.0, -14.0])
    lamp = {"position_mm": place.tolist(), "direction": (-place).tolist(), "size_mm": [1.0, 1.0], "power": 100.0}
    base = {"gel": {"profile": "flat"}, "lights": {"lights": [lamp]}, "coating": {"albedo": [0.5] * 3, "specular": 0.0, "grain": 0.0}}
    sight = {"markers": {"layout": "none"}, "render": {"mode": "direct", "resolution": [160, 120], "spp": 16}}
    trial = Trial((base, sight, {"camera": {"noise_sd": [2.0, 1.4, 2.5], "shading": []}}), "cpu")
    width = trial.scene.camera.field_mm[0] / 160
    x, y = np.meshgrid((np.arange(160) - 79.5) * width, (np.arange(120) - 59.5) * width)
    # A slope s along the light changes the cosine n·l by a share s tan θ, θ its angle to the normal; the wave's slope has, any way,
    # k A / 2 as root mean square. The membrane's normals are central differences of step h, which shows sin(k h) / (k h) of it.
    angle = np.hypot(x - place[0], y - place[1]) / -place[2]
    k, h = 2 * np.pi / WAVELENGTH, GRID_SPACING
    contrast = angle * k / 2 * np.sin(k * h) / (k * h)
    scene = exposed(trial.scene, trial.rest)
    linear = trial.rest.radiance * scene.camera.exposure * np.array(scene.camera.white_balance)
    slope = 255 * (srgb_tone(linear * 1.001) - srgb_tone(linear * 0.999)) / 0.002
    expected = np.sqrt(((slope * contrast[..., None] / np.array([2.0, 1.4, 2.5])) ** 2).sum(axis=-1).mean())
    # What a pixel of 0.115 mm and straight edges of the grid average out is (k width)² / 24 and (k h)² / 12 of it each way, 4 % together.
    assert scene.camera.gamma == 1.0 and texture_signal(trial) == pytest.approx(expected * 0.96, rel=0.04)


@pytest.mark.slow
def test_a_camera_sees_less_with_noise_and_large_pixels(tmp_path: Path) -> None:
    seen = {(row["columns"], row["noise"]): row for row in rows("camera", tmp_path)}
    for columns in (60, 120):
        quiet, loud = seen[columns, 1.0], seen[columns, 2.0]
        assert loud["smallest_dent_um"] == pytest.approx(2 * quiet["smallest_dent_um"], rel=1e-4)
        assert quiet["smallest_dent_deep_um"] > quiet["smallest_dent_um"]
    # Four pixels in place of one halve what is seen, and more where a pixel (0.31 mm) averages over the bell's two flanks.
    assert seen[60, 1.0]["smallest_dent_um"] > 2 * seen[120, 1.0]["smallest_dent_um"]


def test_the_smallest_dent_by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    y, x = np.mgrid[-60:60, -80:80] * 25e-6
    # A change that is a bell itself, as of a coat that darkens by depth: all integrals are known.
    bell = np.exp(-(x**2 + y**2) / (2 * BELL**2))[..., None] * np.array([1e6, 0.0, 0.0])
    monkeypatch.setattr(visible, "_change", lambda trial: (bell, 25e-6))
    layers = {"camera": {"noise_sd": [2.0, 1.0, 1.0], "resolution": [960, 720], "field_mm": [18.4, 13.8], "distance_mm": 40.0}}
    pixel, trial = 18.4e-3 / 960, Trial((layers,), "cpu")
    # Σ over pixels of bell² is π BELL² / p², and pixels and a disc of diameter c widen the bell by p²/12 and c²/16 each way (variances).
    for defocus in (0.0, DEEP):
        wide = BELL**2 + pixel**2 / 12 + (2e-3 * defocus / 40e-3) ** 2 / 16
        dprime = 1e6 / 2.0 * np.sqrt(np.pi / wide) * BELL**2 / pixel
        # What is left out of a widened bell is of fourth order, (c / 4 BELL)⁴ = 0.0002.
        assert smallest_dent(trial, defocus) == pytest.approx(3 / dprime, rel=5e-4)
    assert smallest_dent(trial, DEEP) > 1.005 * smallest_dent(trial, 0.0)
