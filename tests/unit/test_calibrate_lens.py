"""A lens's distortion is found from a grid of dots, and taken out of pictures, places and scale."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gelsim.calibrate.dots import blobs
from gelsim.calibrate.lens import Lens, fitted_lens
from gelsim.calibrate.photos import Photos, read_photos
from gelsim.errors import SceneError

SIZE = (320, 240)
PITCH = 24.0


def grid(k: float, noise: float = 0.0) -> np.ndarray:
    """Dots of a turned grid, seen by a lens whose straight picture is of the photograph's own scale, (K, 2)."""
    at = np.stack(np.meshgrid(np.arange(-12, 13), np.arange(-12, 13)), axis=-1).reshape(-1, 2) * PITCH
    turn = np.radians(7.0)
    away = at @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) / np.hypot(*SIZE) * 2
    seen = np.array(SIZE) / 2 + away * (1 + k * (away**2).sum(axis=1, keepdims=True)) * np.hypot(*SIZE) / 2
    seen += noise * np.random.default_rng(3).normal(size=seen.shape)
    return seen[((seen > 6) & (seen < np.array(SIZE) - 6)).all(axis=1) & (np.hypot(*away.T) < 1.2)]


@pytest.mark.parametrize("k", [0.3, 0.08, -0.1])
def test_it_is_found_from_a_grid(k: float) -> None:
    exact, noisy = fitted_lens(grid(k), SIZE), fitted_lens(grid(k, 0.3), SIZE)
    assert exact is not None and exact.k == pytest.approx(k, abs=1e-6)
    # 0.3 px are 0.0015 half diagonals; a hundred dots, of which those beyond half the radius tell of k, as |u|^3
    assert noisy is not None and noisy.k == pytest.approx(k, abs=3 * 0.0015 / np.sqrt(50) / 0.5**3)


def test_a_straight_grid_or_few_dots_tell_of_none() -> None:
    assert fitted_lens(grid(0.0, 0.3), SIZE) is None and fitted_lens(grid(0.3)[:15], SIZE) is None
    assert fitted_lens(np.zeros((0, 2)), SIZE) is None


@pytest.mark.parametrize("k", [0.3, -0.1])
def test_places_go_both_ways_and_all_of_the_straight_picture_was_seen(k: float) -> None:
    lens = Lens(k, SIZE)
    places = np.random.default_rng(1).uniform(0, SIZE, (50, 2))
    assert lens.straight(lens.seen(places)) == pytest.approx(places, abs=1e-9)
    rim = lens.seen(np.array([[0.0, 0.0], [SIZE[0] / 2, 0.0], [0.0, SIZE[1] / 2], [SIZE[0], SIZE[1]]]))
    assert rim.min() > -1e-6 and (rim < np.array(SIZE) + 1e-6).all()
    # as large as that allows: something of the rim lies on the photograph's own
    assert min(rim.min(), (np.array(SIZE) - rim).min()) == pytest.approx(0.0, abs=1e-6)
    step = lens.seen(np.array([[160.5, 120.0], [159.5, 120.0]]))
    assert np.ptp(step[:, 0]) == pytest.approx(lens.scale, rel=1e-4)


def dotted(k: float) -> np.ndarray:
    """A photograph of that grid."""
    row, column = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
    picture = np.full((*SIZE[::-1], 3), 170.0)
    for x, y in grid(k):
        picture -= 120 * np.exp(-((((column - x) ** 2 + (row - y) ** 2) / 2 / 2.2**2) ** 2))[..., None]
    return picture.clip(0, 255).astype(np.uint8)


def test_photographs_are_straightened_where_markers_show_how(tmp_path: Path) -> None:
    k, mark = 0.3, (250.0, 60.0)
    for name in ("rest.png", "a.png"):
        Image.fromarray(dotted(k)).save(tmp_path / name)
    (tmp_path / "presses.csv").write_text(f"file,col_px,row_px\na.png,{mark[0]},{mark[1]}\n")

    def read(more: str) -> Photos:
        (tmp_path / "photos.toml").write_text(f'no_contact = "rest.png"\nball_radius_mm = 3\nmm_per_px = 0.05\n{more}')
        return read_photos(tmp_path)

    found, told, plain = read("markers = true"), read(f"lens_k = {k}"), read("markers = true\nlens_k = 0")
    assert found.lens and told.lens and plain.lens is None
    assert found.lens.k == pytest.approx(k, abs=0.02) and found.lens.by == "markers" and told.lens.k == k
    lens = Lens(k, SIZE)
    assert told.hints[0, :2] == pytest.approx(lens.straight(np.array(mark))) and plain.hints[0, :2] == pytest.approx(mark)
    assert told.mm_per_px == pytest.approx(0.05 * lens.scale)
    # its dots are those of no lens then; planted: a lens the other way about leaves twice the distortion

    assert fitted_lens(blobs(told.no_contact)[0], SIZE) is None
    crooked = fitted_lens(blobs(read("lens_k = -0.1").no_contact)[0], SIZE)
    assert crooked is not None and crooked.k > k
    assert read("markers = true\ncrop_px = [0, 0, 100, 100]").lens is None
    Image.fromarray(dotted(0.0)).save(tmp_path / "rest.png")
    assert read("markers = true").lens is None
    for wrong, said in (
        ("lens_k = 3", "allowed is -0.14"),
        ('lens_k = "dots"', "lens_k"),
        ("lens_k = 0.1\ncrop_px = [0, 0, 100, 100]", "lens_k is of whole photographs"),
    ):
        with pytest.raises(SceneError, match=said):
            read(wrong)
