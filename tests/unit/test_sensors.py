"""The shipped sensors: each is lit as its file says, and is drawn with its facts."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image

from gelsim.calibrate import drawing
from gelsim.calibrate.dent import effective_radius, solve_family
from gelsim.calibrate.parameters import curvature_of
from gelsim.cli.main import main
from gelsim.membrane.surface import rest_membrane
from gelsim.optics import render_frames
from gelsim.scene.definition import Light, Lights
from gelsim.scene.layers import build_scene, preset_names
from gelsim.views.sensor_sheet import _draw_plan


def test_no_contact_is_mid_grey_in_the_middle():
    name = "fingertip2017"
    assert name in preset_names()
    scene = build_scene({"sensor": {"preset": name}, "render": {"resolution": [64, 48], "spp": 4}, "markers": {"layout": "none"}})
    (frame,) = render_frames(scene, [rest_membrane(scene)])
    middle = frame.image[16:32, 24:40].mean(axis=(0, 1))
    assert 95 <= middle.min() and middle.max() <= 125  # as its file promises
    # Planted: half the exposure is seen.
    dark = scene.replace(camera=replace(scene.camera, exposure=scene.camera.exposure / 2))
    assert next(iter(render_frames(dark, [rest_membrane(dark)]))).image[16:32, 24:40].mean() < 95


def test_a_dent_of_the_fingertip_has_its_lamps_on_its_flanks():
    """As photographs of this kind of sensor are described (no public one is known): red from one side, white-blue from the one that faces
    it, the crown as grey as at rest; a ball of 4 mm, 0.8 mm deep."""
    table = {"sensor": {"preset": "fingertip2017"}, "render": {"resolution": [160, 120], "spp": 16}, "markers": {"layout": "none"}}
    scene = build_scene(table)
    radius = effective_radius(np.array(4.0), curvature_of(scene.gel))
    dents = solve_family(scene.gel, np.array([float(radius)]), scene.gel.thickness_mm)
    dented = drawing.dented(scene, dents, 4.0, np.array([0, 0, 0.8, 0, 0]))
    rest, pressed = (frame.image.astype(float) for frame in render_frames(scene, [rest_membrane(scene), dented]))
    row, column = np.mgrid[:120, :160] + 0.5
    across, down = (column - 80) * 0.115, (row - 60) * 0.115
    flank, change = (np.abs(down) < 0.5) & (np.abs(across) > 1.2) & (np.abs(across) < 2.0), pressed - rest
    right, left = (change[flank & (np.sign(across) == side)].mean(axis=0) for side in (1, -1))
    # Averaged over 90 pixels noise is 0.2 levels; 8 is what inter-reflection and flakes are worth together (docs/optics.md).
    assert right[0] > 8 and max(right[1:]) < -8 and left[2] > 8 and left[1] > 8 and abs(left[0]) < left[2]
    assert np.abs(change[np.hypot(across, down) < 0.4].mean(axis=0)).max() < 8
    # Planted: the lamps exchanged.
    assert not (left[0] > 8 and max(left[1:]) < -8)


def test_the_mini_rests_as_a_real_one_and_its_dents_have_its_colours():
    """Against means of the photographs of `docs/studies/mini_preset.py`: the even part's quarters; the change in eight directions from the
    middles of 20 balls' contacts, right first, then clockwise, between 0.5 and 1.1 of their radius."""
    table = {"sensor": {"preset": "gelsight_mini"}, "render": {"resolution": [160, 120], "spp": 16}, "camera": {"noise_sd": [0, 0, 0]}}
    scene = build_scene(table)
    dents = solve_family(scene.gel, np.array([2.5]), scene.gel.thickness_mm)
    dented = drawing.dented(scene, dents, 2.5, np.array([0, 0, 0.95, 0, 0]))
    rest, pressed = (frame.image.astype(float) for frame in render_frames(scene, [rest_membrane(scene), dented]))
    wanted = [[(71.9, 120.7, 125.1), (67.0, 120.6, 128.9)], [(99.7, 116.7, 104.1), (96.1, 118.1, 109.0)]]
    assert rest.reshape(2, 60, 2, 80, 3).mean(axis=(1, 3)) == pytest.approx(np.array(wanted), abs=3)  # 30 numbers leave 3.5 RMS at a pixel
    row, column = np.mgrid[:120, :160] + 0.5
    away, turn = np.hypot(column - 80, row - 60), np.arctan2(row - 60, column - 80)
    near, change = (away > 7) & (away < 15), pressed - rest
    eighths = [near & (np.abs(np.angle(np.exp(1j * (turn - k * np.pi / 4)))) < np.pi / 8) for k in range(8)]
    shown = np.array([change[eighth].mean(axis=0) for eighth in eighths])
    real = np.array(
        [(-2, 46, 11), (-38, 38, 33), (-49, 4, 34), (-30, -32, 19), (10, -44, -8), (39, -38, -32), (40, -6, -32), (29, 30, -19)]
    )
    alike = [np.corrcoef(shown[:, colour], real[:, colour])[0, 1] for colour in range(3)]
    assert min(alike) > 0.97
    # Planted: the dent turned by an eighth.
    assert min(np.corrcoef(np.roll(shown, 1, axis=0)[:, colour], real[:, colour])[0, 1] for colour in range(3)) < 0.8
    # Round: what changes by a quarter of the most reaches as far across as down, to a tenth.
    size = np.abs(change).sum(axis=2)
    spread = np.argwhere(size > 0.25 * size.max()).std(axis=0)
    assert spread[0] == pytest.approx(spread[1], rel=0.1)


def test_the_digit_rests_as_a_real_one_and_its_dents_have_its_colours():
    """Against photographs of `docs/studies/digit_preset.py`, on their side: the resting picture's quarters; of three balls the
    change in eight directions from the contact's middle, right first, then clockwise, between 0.35 and 0.95 of 1.45 mm."""
    table = {"sensor": {"preset": "digit"}, "render": {"resolution": [160, 120], "spp": 32}, "camera": {"noise_sd": [0, 0, 0]}}
    scene = build_scene(table)
    dents = solve_family(scene.gel, effective_radius(np.array([3.0]), curvature_of(scene.gel)), scene.gel.thickness_mm)
    presses = [np.array([*place, 0, 0]) for place in ((2.68, -3.1, 0.75), (-2.04, 3.96, 0.86), (1.53, 1.73, 0.8))]
    rest, drawn = drawing.draw(scene, dents, 3.0, presses)
    wanted = [[(123, 72, 112), (146, 116, 105)], [(33, 99, 76), (85, 119, 85)]]
    quarters = rest.reshape(2, 60, 2, 80, 3).mean(axis=(1, 3))
    assert quarters == pytest.approx(np.array(wanted), abs=10)  # what 30 numbers leave at a pixel, RMS: a mean leaves no more
    assert quarters[::-1] != pytest.approx(np.array(wanted), abs=10)  # planted
    real = np.array(
        [
            [(22, 5, -32), (48, -1, -20), (47, -7, 3), (17, -7, 26), (-53, 1, 25), (-86, 5, 4), (-74, 9, -22), (-35, 11, -38)],
            [(11, 1, -31), (7, -25, -16), (-4, -38, 3), (-13, -39, 30), (-17, -28, 51), (-14, -4, 41), (-8, 15, 7), (4, 17, -23)],
            [(64, 9, -33), (66, -22, -18), (46, -42, 7), (17, -39, 34), (-11, -17, 46), (-38, 15, 21), (-35, 36, -16), (23, 34, -40)],
        ]
    )
    row, column = np.mgrid[:120, :160] + 0.5
    shown = []
    for picture, press in zip(drawn, presses, strict=True):
        x, y = press[:2] / scene.camera.field_mm[0] * 160 + (80, 60)
        away, turn = np.hypot(column - x, row - y) * scene.camera.field_mm[0] / 160, np.arctan2(row - y, column - x)
        near = (away > 0.35 * 1.45) & (away < 0.95 * 1.45)
        eighths = [near & (np.abs(np.angle(np.exp(1j * (turn - k * np.pi / 4)))) < np.pi / 8) for k in range(8)]
        shown.append([(picture.astype(float) - rest)[eighth].mean(axis=0) for eighth in eighths])
    assert np.corrcoef(np.ravel(shown), real.ravel())[0, 1] > 0.9
    # Planted: the sensor turned by a quarter under the same presses; red and blue exchanged.
    assert np.corrcoef(np.roll(shown, 2, axis=1).ravel(), real.ravel())[0, 1] < 0.6
    assert np.corrcoef(np.array(shown)[..., ::-1].ravel(), real.ravel())[0, 1] < 0.6


def test_the_calibrated_sensor_looks_like_its_photograph():
    scene = build_scene({"sensor": {"preset": "taxim"}, "render": {"resolution": [64, 48], "spp": 16}})
    (frame,) = render_frames(scene, [rest_membrane(scene)])
    quarters = frame.image.reshape(2, 24, 2, 32, 3).mean(axis=(1, 3))
    # Mean levels of the quarters of the median of the photographs that were fitted to: green top left, red right, blue bottom left. The
    # fit leaves 5 levels root mean square at a pixel, most of it finer than a quarter; rounding and the renderer's noise 0.1 of a mean.
    wanted = [[(127.9, 158.3, 133.6), (151.0, 119.9, 140.2)], [(126.9, 115.3, 193.8), (154.4, 115.3, 151.5)]]
    assert quarters == pytest.approx(np.array(wanted), abs=4)
    # Planted: red and green exchanged.
    assert quarters[..., [1, 0, 2]] != pytest.approx(np.array(wanted), abs=4)


def test_inspect_draws_a_sensor(tmp_path, capsys):
    out = tmp_path / "mini.png"
    assert main(["inspect", "--sensor", "gelsight_mini", "--out", str(out), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["kind"] == "sensor" and "25.25 x 20.75 x 4.25 mm" in facts["gel"] and facts["drawing"] == str(out)
    with Image.open(out) as drawing:
        assert drawing.size[0] > 800


def test_names_of_lamps_beside_each_other_do_not_overlap():
    strip = tuple(Light(f"lamp number {i}", (14.0 + 0.3 * (i % 2), 0.5 * i, -6.0), (-1.0, 0.0, 0.5)) for i in range(6))
    scenes = [build_scene({"sensor": {"preset": name}}) for name in preset_names()]
    for scene in (*scenes, scenes[0].replace(lights=Lights(strip))):
        figure = Figure(figsize=(3.7, 3.9), dpi=90, layout="constrained")
        axes = figure.subplots()
        _draw_plan(axes, scene)
        figure.draw_without_rendering()
        named = {text.get_text(): Text.get_window_extent(text) for text in axes.texts}
        frame = axes.get_window_extent()
        assert set(named) == {light.name for light in scene.lights.lights if light.name != "veil"}
        assert not [pair for pair in itertools.combinations(named, 2) if named[pair[0]].overlaps(named[pair[1]])]
        assert all(frame.x0 <= box.x0 and box.x1 <= frame.x1 and frame.y0 <= box.y0 and box.y1 <= frame.y1 for box in named.values())


def test_inspect_wants_one_thing(capsys):
    assert main(["inspect"]) == 2 and "--sensor NAME" in capsys.readouterr().err
    assert main(["inspect", "x.stl", "--sensor", "digit"]) == 2
    assert main(["inspect", "--sensor", "digitt"]) == 2 and "did you mean 'digit'" in capsys.readouterr().err
