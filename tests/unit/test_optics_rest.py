"""A measured rest: at rest the photograph itself; what is painted moves, what is the optics' stays, the change is the renderer's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage
from test_baked import VARIANTS, dragged, even_field, flat_scene, shift
from test_lightfield import linear_field
from test_optics import imaged_centroids

from gelsim.errors import SceneError
from gelsim.membrane.surface import rest_membrane
from gelsim.optics import baked_kernels, render_frames, rest_places
from gelsim.optics.baked import BakedRenderer
from gelsim.optics.camera import project
from gelsim.optics.isp import develop
from gelsim.optics.variant import SCALAR
from gelsim.results import Frame, Membrane
from gelsim.scene.definition import Camera, Markers, Render, Scene
from gelsim.scene.layers import load_scene

SIZE = (160, 120)
PLACES = np.stack(np.meshgrid(np.arange(-2.0, 2.1, 1.0), np.arange(-1.5, 1.6, 1.0)), axis=-1).reshape(-1, 2)
"""Of the dots [mm]."""


def photographed(folder: Path, mode: str, **camera: object) -> Scene:
    """A sensor whose photograph has a strong vignette and black dots of 0.2 mm, none of which its scene file knows."""
    plain = flat_scene(render=Render(mode, 4, SIZE), markers=Markers(layout="none"))
    row, column = np.mgrid[:120, :160] + 0.5
    away = np.hypot(column - 80, row - 60) / 100
    levels = 140 * np.stack([1 - 0.5 * away**2, 1 - 0.3 * away, 1 - 0.4 * column / 160], axis=-1)
    for place in project(plain, np.column_stack([PLACES, 0 * PLACES[:, 0]]) * 1e-3):
        levels *= np.clip(np.hypot(column - place[0], row - place[1]) - 5.3 + 0.5, 0.2, 1)[..., None]
    Image.fromarray(np.rint(levels).astype(np.uint8)).save(folder / "rest.png")
    exposure = 300.0 if mode != "baked" else 0.02
    return plain.replace(camera=replace(plain.camera, rest=str(folder / "rest.png"), exposure=exposure, **camera))


def drawn(scene: Scene, *membranes: Membrane, variant=VARIANTS[-1], even: bool = False) -> list[Frame]:
    field = even_field() if even else linear_field()
    renderer = BakedRenderer(scene, field, variant, shadows=False, indirect=False) if scene.render.mode == "baked" else None
    return list(render_frames(scene, membranes, variant=variant, renderer=renderer))


@pytest.mark.parametrize("variant", VARIANTS, ids=lambda v: v.name)
@pytest.mark.parametrize("mode", ["path", "direct", "baked"])
def test_at_rest_it_is_the_photograph(tmp_path, mode, variant):
    if variant is SCALAR and mode == "direct":
        pytest.skip("scalar variants draw path and direct by the same lines here")
    scene = photographed(tmp_path, mode)
    rest = rest_membrane(scene)
    photo = np.asarray(Image.open(tmp_path / "rest.png")).astype(int)
    bent, flat = drawn(scene, dragged(scene), rest, variant=variant)
    # A twentieth of a level by single precision in the places, over edges of 30 levels a pixel: some round to the neighbouring level.
    apart = np.abs(flat.image.astype(int) - photo)
    assert apart.max() <= 1 and (apart > 0).mean() < 0.01
    assert np.abs(bent.image.astype(int) - photo).max() > 20
    # Planted: a photograph two pixels off.
    assert np.abs(flat.image.astype(int) - np.roll(photo, 2, axis=1)).max() > 20


@pytest.mark.parametrize("variant", VARIANTS, ids=lambda v: v.name)
@pytest.mark.parametrize("mode", ["path", "baked"])
def test_dots_move_with_the_membrane_and_the_vignette_stays(tmp_path, mode, variant, monkeypatch):
    # Without light the picture is the photograph, moved.
    scene = photographed(tmp_path, mode)
    scene = scene.replace(camera=replace(scene.camera, exposure=1e-6))
    points = np.column_stack([PLACES, 0 * PLACES[:, 0]]) * 1e-3
    wanted = project(scene, shift(points))
    moved = np.hypot(*(wanted - project(scene, points)).T)
    assert moved.max() > 5

    def errors(image: np.ndarray) -> np.ndarray:
        even = ndimage.gaussian_filter(ndimage.percentile_filter(image[..., 1].astype(float), 80, size=25), 4)
        dark = np.clip(0.7 - image[..., 1] / even, 0, None)
        row, column = np.mgrid[:120, :160] + 0.5
        found = []
        for place in wanted:
            weight = dark * (np.hypot(column - place[0], row - place[1]) < 9)
            found.append(np.hypot((weight * column).sum() / weight.sum() - place[0], (weight * row).sum() / weight.sum() - place[1]))
        return np.array(found)

    (bent,) = drawn(scene, dragged(scene), variant=variant)
    # A disc's middle in a bent surface is up to 0.1 px from its centre's image (test_baked), rounded levels add 0.05 px.
    assert errors(bent.image).max() < 0.25
    # The vignette has not moved: between the dots the levels are what they were, to its slope of 0.5 levels over 0.3 of a pixel.
    photo = np.asarray(Image.open(tmp_path / "rest.png")).astype(float)
    between = (bent.image[..., 0] > 60) & (photo[..., 0] > 60)
    upper = [ndimage.percentile_filter(each[..., 0].astype(float), 80, size=9) for each in (bent.image, photo)]
    assert np.abs(upper[0] - upper[1])[between].max() < 4
    # Planted: paint that stays where it was.
    for module in (rest_places, baked_kernels):
        monkeypatch.setattr(module, "place_at_rest", lambda ar, st, nodes, seen, column, row: [ar.real(column) + 0.5, ar.real(row) + 0.5])
    (stuck,) = drawn(scene, dragged(scene), variant=variant)
    assert errors(stuck.image).max() > 1


def test_the_change_is_the_renderers(tmp_path):
    """On an even photograph, tone linear: level = photograph + 255 · exposure · (L − L⁰)."""
    scene = photographed(tmp_path, "path", tone="linear")
    Image.new("RGB", SIZE, (100, 120, 90)).save(tmp_path / "even.png")
    scene = scene.replace(camera=replace(scene.camera, rest=str(tmp_path / "even.png"), exposure=60.0))
    bent, flat = drawn(scene, dragged(scene), rest_membrane(scene))
    wanted = np.clip(np.array([100, 120, 90]) + 255 * 60 * (bent.radiance - flat.radiance), 0, 255)
    assert np.abs(wanted - 100).max() > 30
    assert np.abs(bent.image - wanted).max() <= 0.51
    # Planted: a hundredth more light.
    assert np.abs(bent.image - (wanted + 0.05 * (wanted - [100, 120, 90]))).max() > 1


def test_a_sensor_file_finds_its_photograph_beside_it_and_errors_name_the_field(tmp_path):
    scene = photographed(tmp_path, "path")
    (tmp_path / "own.toml").write_text('[camera]\nrest = "rest.png"\n')
    (tmp_path / "scene.toml").write_text('[sensor]\npreset = "own.toml"\n')
    assert load_scene(tmp_path / "scene.toml").camera.rest == str(tmp_path / "rest.png")
    (tmp_path / "torn.png").write_bytes(b"not a picture")

    def refused(camera: Camera, size: tuple[int, int] = SIZE) -> str:
        other = scene.replace(camera=camera, render=Render("path", 4, size))
        with pytest.raises(SceneError) as error:
            list(render_frames(other, [rest_membrane(other)]))
        return str(error.value)

    assert "camera.rest" in refused(replace(scene.camera, rest=str(tmp_path / "none.png")))
    assert "not a picture" in refused(replace(scene.camera, rest=str(tmp_path / "torn.png")))
    assert "160 x 120 px, but render.resolution = 100 100" in refused(scene.camera, (100, 100))
    with pytest.raises(SceneError, match="camera.rest"):
        develop(scene, np.zeros((120, 160, 3), np.float32))


def test_a_finer_picture_and_a_coarser_one_are_the_photograph(tmp_path):
    for size in ((320, 240), (80, 60)):
        scene = photographed(tmp_path, "path")
        scene = scene.replace(render=Render("path", 1, size))
        (frame,) = drawn(scene, rest_membrane(scene))
        shrunk = np.asarray(Image.fromarray(frame.image).resize((40, 30), Image.Resampling.BOX)).astype(int)
        wanted = np.asarray(Image.open(tmp_path / "rest.png").resize((40, 30), Image.Resampling.BOX)).astype(int)
        assert np.abs(shrunk - wanted).max() <= 3


def test_where_no_gel_is_seen_the_photograph_stays(tmp_path):
    scene = photographed(tmp_path, "path")
    scene = scene.replace(gel=replace(scene.gel, size_mm=(5.0, 5.0)), camera=replace(scene.camera, field_mm=(8.0, 6.0)))
    bent, flat = drawn(scene, dragged(scene), rest_membrane(scene))
    photo = np.asarray(Image.open(tmp_path / "rest.png")).astype(int)
    # A pixel at the gel's rim sees a little of it.
    blank = ndimage.binary_erosion(np.isnan(bent.height) & np.isnan(flat.height), iterations=2)
    assert blank.mean() > 0.3 and np.abs(bent.image.astype(int) - photo)[blank].max() <= 1


def test_imaged_centroids_are_near_projections():
    """What the bound of 0.25 px above rests on."""
    scene = flat_scene(markers=Markers(pitch_mm=1.0, radius_mm=0.2), render=Render("path", 1, SIZE))
    rest = rest_membrane(scene)
    apart = imaged_centroids(scene, shift) - project(scene, shift(rest.marker_centres))
    assert np.nanmax(np.abs(apart)) < 0.2


@pytest.mark.parametrize("mode", ["path", "baked"])
def test_a_smooth_rest_is_its_numbers_with_the_markers_painted_on_it(mode):
    numbers = np.zeros((6, 3))
    numbers[:4] = np.log([0.5, 0.4, 0.6]), [0.2, -0.1, 0.0], [0.1, 0.1, -0.2], [-0.4, -0.4, -0.4]
    numbers[5] = -0.3, -0.2, -0.4
    plain = flat_scene(render=Render(mode, 4, SIZE), markers=Markers(layout="none"))
    camera = replace(plain.camera, rest_smooth=tuple(numbers.ravel()), exposure=1e-6)
    row, column = np.mgrid[:120, :160] + 0.5
    u, v = column / 80 - 1, row / 60 - 1
    wanted = 255 * np.exp(np.stack([np.ones_like(u), u, v, u**2, u * v, v**2], axis=-1) @ numbers)
    (flat,) = drawn(plain.replace(camera=camera), rest_membrane(plain))
    assert np.abs(flat.image - wanted).max() <= 1
    # Planted: upside down.
    assert np.abs(flat.image - wanted[::-1]).max() > 2
    dotted = plain.replace(camera=camera, markers=Markers(pitch_mm=1.0, radius_mm=0.2, offset_mm=(0.3, -0.2)))
    for membrane in (rest_membrane(dotted), dragged(dotted)):
        (frame,) = drawn(dotted, membrane)
        places = frame.marker_pixels[np.isfinite(frame.marker_pixels).all(axis=1)]
        places = places[(np.abs(places - [80, 60]) < [70, 50]).all(axis=1)].astype(int)
        # Within the dots, and half a pitch beside them.
        assert frame.image[places[:, 1], places[:, 0]].max() < 70 < 0.6 * frame.image[places[:, 1] - 8, places[:, 0] - 8].min() + 40


def test_a_smooth_rest_of_other_numbers_is_refused(tmp_path):
    with pytest.raises(SceneError, match="camera.rest_smooth has 7 numbers: .* are 3, 9, 18, 30, or none"):
        Scene(camera=Camera(rest_smooth=(0.0,) * 7))
    with pytest.raises(SceneError, match="exclude each other"):
        Scene(camera=Camera(rest_smooth=(0.0,) * 3, rest="rest.png"))
