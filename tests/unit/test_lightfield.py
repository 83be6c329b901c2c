"""The table of a sensor's light, its file and its cache."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gelsim.data.lightfield import LightField, read_field, write_field
from gelsim.generate.run import measure_lights
from gelsim.optics import bake
from gelsim.optics.variant import SCALAR
from gelsim.pipeline import stages
from gelsim.scene.definition import Camera, Coating, Light, Lights, Render, Scene

SLOPES = np.array([0.3, -0.2, 0.5, -0.4])
"""Of the linear table by x, y [1/mm], n_x, n_y."""


def linear_field(rows: int = 5, columns: int = 6, size: int = 9) -> LightField:
    """One component, 10 + slopes · (x, y, n_x, n_y) + 0.7 z, white; no light from elsewhere."""
    x, y, n = np.linspace(-4, 4, columns), np.linspace(-3, 3, rows), np.linspace(-0.9, 0.9, size)
    z = np.array([-0.4, -2.0])
    grid = np.meshgrid(z, y, x, n, n, indexing="ij")
    table = np.zeros((2, rows, columns, size, size, 4), np.float32)
    table[..., 0] = 10 + SLOPES[0] * grid[2] + SLOPES[1] * grid[1] + SLOPES[2] * grid[4] + SLOPES[3] * grid[3] + 0.7 * grid[0]
    return LightField(
        table,
        z.astype(np.float32),
        np.array([[-4, 4], [-3, 3]], np.float32),
        0.9,
        np.array([[1, 1, 1], [0, 0, 0], [0, 0, 0], [0, 0, 0]], np.float32),
        np.array([0, -1, -1, -1], np.int32),
        np.full((size, size), 0.1, np.float32),
        np.zeros(3, np.float32),
        np.zeros((rows, columns, 4), np.float32),
        {"psnr_db": 50.0},
    )


def linear_value(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    return 10 + points[:, :2] @ SLOPES[:2] + normals[:, :2] @ SLOPES[2:] + 0.7 * points[:, 2]


def random_places(count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    points = rng.uniform([-4, -3, -3], [4, 3, 0], (count, 3))
    flat = rng.uniform(-0.6, 0.6, (count, 2))
    return points, np.column_stack([flat, np.sqrt(1 - (flat**2).sum(axis=1))])


def test_linear_field_is_met_everywhere():
    points, normals = random_places(500)
    found = linear_field().local(points, normals)[:, 0]
    # Nodes are float32: 20 times its rounding, six terms.
    bound = 20 * 6 * np.finfo(np.float32).eps
    assert np.abs(found - linear_value(points, normals)).max() < bound
    # Planted: rows and columns of the place exchanged in the table.
    turned = linear_field(6, 6)
    turned = replace(turned, table=turned.table.transpose(0, 2, 1, 3, 4, 5))
    assert np.abs(turned.local(points, normals)[:, 0] - linear_value(points, normals)).max() > 0.1


def test_field_survives_its_file(tmp_path):
    path = tmp_path / "folder" / "field.npz"
    field = linear_field()
    write_field(path, field)
    again = read_field(path)
    assert again is not None and np.array_equal(again.table, field.table) and again.errors == {"psnr_db": 50.0} and again.normals == 0.9
    assert list(path.parent.iterdir()) == [path]
    assert read_field(tmp_path / "none.npz") is None


@pytest.mark.parametrize("damage", ["cut", "flipped", "empty", "text"])
def test_damaged_file_is_no_field(tmp_path, damage):
    path = tmp_path / "field.npz"
    write_field(path, linear_field())
    data = bytearray(path.read_bytes())
    if damage == "flipped":
        # In the middle of the table, which is most of the file.
        data[len(data) // 2] ^= 1
    path.write_bytes({"cut": data[: len(data) // 2], "flipped": data, "empty": b"", "text": b"not an archive"}[damage])
    assert read_field(path) is None


def lit_scene() -> Scene:
    lights = (Light("a", (20.0, 3.0, -8.0), (-20.0, 0.0, 8.0)), Light("b", (-20.0, 0.0, -8.0), (20.0, 0.0, 8.0)))
    return Scene(lights=Lights(lights), render=Render("baked", resolution=(160, 120)))


def test_field_is_measured_once_and_again_when_damaged(tmp_path, monkeypatch):
    monkeypatch.setenv("GELSIM_CACHE", str(tmp_path))
    calls = []
    monkeypatch.setattr(bake, "measure", lambda scene, variant, progress: calls.append(scene) or linear_field())
    scene = lit_scene()
    for _ in range(2):
        bake.light_field(scene, SCALAR)
    assert len(calls) == 1
    path = bake.field_path(scene)
    path.write_bytes(path.read_bytes()[:1000])
    bake.light_field(scene, SCALAR)
    assert len(calls) == 2 and read_field(path) is not None
    # A folder that cannot be written costs the cache, not the field.
    monkeypatch.setenv("GELSIM_CACHE", str(path))
    assert bake.light_field(scene, SCALAR).normals == 0.9 and len(calls) == 3


def test_an_interrupted_bake_keeps_the_sensors_that_are_done(tmp_path, monkeypatch):
    """Three sensors, stopped in the second: what goes on measures the second and the third alone."""
    monkeypatch.setenv("GELSIM_CACHE", str(tmp_path))
    sensors = [lit_scene(), *(lit_scene().replace(render=Render("baked", resolution=(160, height))) for height in (100, 80))]
    calls = []

    def measured(scene, variant, progress):
        calls.append(sensors.index(scene))
        if calls == [0, 1]:
            raise KeyboardInterrupt
        return linear_field()

    monkeypatch.setattr(bake, "measure", measured)
    with pytest.raises(KeyboardInterrupt):
        measure_lights(sensors, "cpu", None)
    measure_lights(sensors, "cpu", None)
    assert calls == [0, 1, 1, 2]


def test_auto_takes_a_field_that_is_measured_and_good_enough(tmp_path, monkeypatch):
    monkeypatch.setenv("GELSIM_CACHE", str(tmp_path))
    scene = lit_scene()
    scene = scene.replace(render=replace(scene.render, mode="auto"))

    def record_of(scene: Scene) -> tuple[str, dict]:
        record = stages.Record()
        monkeypatch.setattr(stages, "membranes", lambda scene, deformation, record: [])
        assert stages.render(scene, None, device="cpu", record=record) == []  # type: ignore[arg-type]
        return record.choices["mode"]["chosen"], record.choices

    chosen, choices = record_of(scene)
    assert chosen == "path" and "not measured yet" in choices["mode"]["why"] and "light_field" not in choices
    write_field(bake.field_path(scene), replace(linear_field(), errors={"psnr_worst_db": 44.0}))
    chosen, choices = record_of(scene)
    assert chosen == "baked" and "44.0 dB" in choices["mode"]["why"] and choices["light_field"] == {"psnr_worst_db": 44.0}
    finer = scene.replace(render=replace(scene.render, least_psnr_db=45.0))
    assert record_of(finer)[0] == "path" and "least_psnr_db = 45 dB" in record_of(finer)[1]["mode"]["why"]
    # A bake that does not say how good it is; what was asked for by name stays.
    write_field(bake.field_path(scene), replace(linear_field(), errors={}))
    assert record_of(scene)[0] == "path"
    for mode in ("path", "direct", "baked"):
        named = scene.replace(render=replace(scene.render, mode=mode))
        assert bake.settle_mode(named) == (named, None)


def test_key_follows_what_decides_the_light():
    scene = lit_scene()
    key = bake.field_key(scene)
    same = [
        scene.replace(render=Render("path", 99, (640, 480))),
        scene.replace(camera=Camera(exposure=2.0, noise_sd=(1.0, 1.0, 1.0), resolution=(320, 240))),
        scene.replace(gel=replace(scene.gel, shore_00=None, youngs_modulus_kpa=99.0)),
        scene.replace(markers=replace(scene.markers, pitch_mm=2.0)),
        scene.replace(press=replace(scene.press, depth_mm=0.5)),
    ]
    assert {bake.field_key(other) for other in same} == {key}
    moved = (replace(scene.lights.lights[0], position_mm=(20.0, 3.01, -8.0)), scene.lights.lights[1])
    other = [
        scene.replace(lights=Lights(moved)),
        scene.replace(coating=Coating(albedo=(0.5, 0.5, 0.51))),
        scene.replace(camera=Camera(distance_mm=40.1)),
        scene.replace(gel=replace(scene.gel, thickness_mm=2.5)),
        scene.replace(render=Render("baked", resolution=(160, 100))),
    ]
    keys = [bake.field_key(one) for one in other]
    assert key not in keys and len(set(keys)) == len(keys)
