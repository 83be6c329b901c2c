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

from gelsim.cli.main import main
from gelsim.membrane.surface import rest_membrane
from gelsim.optics import render_frames
from gelsim.scene.definition import Light, Lights
from gelsim.scene.layers import build_scene, preset_names
from gelsim.views.sensor_sheet import _draw_plan

SHIPPED = ("digit", "fingertip2017", "gelsight_mini")


@pytest.mark.parametrize("name", SHIPPED)
def test_no_contact_is_mid_grey_in_the_middle(name):
    assert name in preset_names()
    scene = build_scene({"sensor": {"preset": name}, "render": {"resolution": [64, 48], "spp": 4}, "markers": {"layout": "none"}})
    (frame,) = render_frames(scene, [rest_membrane(scene)])
    middle = frame.image[16:32, 24:40].mean(axis=(0, 1))
    # Each file promises 95 to 125; DIGIT's three lamps do not make grey, so each of its channels may be 25 off.
    slack = 25 if name == "digit" else 0
    assert 95 <= middle.mean() <= 125 and 95 - slack <= middle.min() and middle.max() <= 125 + slack
    # Planted: half the exposure is seen.
    dark = scene.replace(camera=replace(scene.camera, exposure=scene.camera.exposure / 2))
    assert next(iter(render_frames(dark, [rest_membrane(dark)]))).image[16:32, 24:40].mean() < 95


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
