"""A lens's distortion is found from the gel's edges, with its standard deviation, and taken out of what corners cut out too."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gelsim.calibrate import edges
from gelsim.calibrate.dots import blobs
from gelsim.calibrate.edges import gel_edges, lens_of_edges, straightened
from gelsim.calibrate.lens import Lens, fitted_lens, numbered, unbent
from gelsim.calibrate.photos import Photos, read_photos

REAL = Path(__file__).parents[3] / "shared" / "real"
SIZE = (320, 240)
HALF = (0.56, 0.42)
"""Of the gel [half diagonals]: all of its edges are in the picture by every lens here."""


def turned(places: np.ndarray, turn_deg: float) -> np.ndarray:
    turn = np.radians(turn_deg)
    return places @ np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])


def photo(k: float, outline: str = "box", noise: float = 1.5, vignette: float = 1.0, turn_deg: float = 3.0, seed: int = 0) -> np.ndarray:
    """A coat of three colours, dark to the corners (vignette 3: a twentieth there), beside a darker housing; levels (H, W, 3)."""
    row, column = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
    seen = (np.stack([column, row], axis=-1) - np.array(SIZE) / 2) / np.hypot(*SIZE) * 2
    at = turned(unbent(seen, k), turn_deg)
    away = {
        "box": np.minimum(HALF[0] - np.abs(at[..., 0]), HALF[1] - np.abs(at[..., 1])),
        "round": HALF[1] - np.hypot(at[..., 0], at[..., 1]),
        "out of sight": 0 * at[..., 0] + 1,
    }[outline]
    inside = 1 / (1 + np.exp(-away / 0.006))  # blurred as by a Gaussian of 2 px
    colours = np.stack([120 + 60 * seen[..., 0], 130 - 50 * seen[..., 1], 120 + 40 * seen[..., 1] - 40 * seen[..., 0]], axis=-1)
    levels = colours * (np.exp(-vignette * (seen**2).sum(axis=-1)) * (0.25 + 0.75 * inside))[..., None]
    return np.clip(np.rint(levels + np.random.default_rng(seed).normal(0, noise, levels.shape)), 0, 255)


def expected_sd(noise: float, vignette: float) -> float:
    """Of k. Noise of n levels moves the steepest place by e = n √(3/16π)/b³ / (√3 C / √2π s³) [px], b the finder's blur, s that and the
    edge's, C the step. An edge at d, as long as 2 t, bows by k d t²; a parabola through N places of error e is off by e / √(4N/45)."""
    step = 0.75 * 120 * np.exp(-vignette * sum(half**2 for half in HALF))  # in a corner of the gel
    blur = np.hypot(edges.BLUR, 0.006 * np.pi / np.sqrt(3) * 200)
    error = noise * np.sqrt(3 / (16 * np.pi)) / edges.BLUR**3 / (np.sqrt(3) * step / np.sqrt(2 * np.pi) / blur**3)
    bow, count = 200 * HALF[0] * HALF[1] ** 2, 2 * HALF[1] * 200 / edges.STEP
    return error / (bow * np.sqrt(4 * count / 45))


@pytest.mark.parametrize("k", [0.3, 0.08, -0.1])
@pytest.mark.parametrize(("noise", "vignette"), [(1.5, 1.0), (4.0, 1.0), (1.5, 3.0)])
def test_it_is_found_from_the_gels_edges(k: float, noise: float, vignette: float, monkeypatch: pytest.MonkeyPatch) -> None:
    picture = photo(k, noise=noise, vignette=vignette)
    lens = lens_of_edges(picture)
    # of the worst edge alone, times four
    assert lens is not None and lens.by == "edges" and lens.k == pytest.approx(k, abs=4 * expected_sd(noise, vignette))
    assert abs(lens.k - k) < 5 * lens.sd
    # planted: a lens the other way about
    monkeypatch.setattr(edges, "unbent", lambda seen, k: unbent(seen, -k))
    wrong = lens_of_edges(picture)
    assert wrong is None or abs(wrong.k - k) > 4 * expected_sd(noise, vignette)


def test_a_large_photograph_shows_it_too() -> None:
    """The same picture four times as large: its edges are as blurred, and too wide to be taken for any as they are."""
    large = np.asarray(Image.fromarray(photo(0.3).astype(np.uint8)).resize((4 * SIZE[0], 4 * SIZE[1]), Image.Resampling.BICUBIC), float)
    lens = lens_of_edges(large[:-2, :-2])  # no multiple of the factor
    assert lens is not None and lens.size == (1278, 958) and lens.k == pytest.approx(0.3, abs=4 * expected_sd(1.5, 1.0))


def test_its_standard_deviation_is_that_of_its_errors() -> None:
    off = []
    for seed in range(16):
        found = straightened(gel_edges(photo(0.08, seed=seed, noise=3.0)), SIZE)
        assert found is not None
        off.append((found[0] - 0.08) / found[1])
    # the mean square of 16 has a standard deviation of √(2/16); half of it and twice 1 is what a jackknife of four edges is good for
    assert 0.4 < np.sqrt(np.mean(np.square(off))) < 2


@pytest.mark.parametrize(
    "picture",
    [
        photo(0.0),
        photo(0.0, noise=4.0, vignette=3.0),
        *(photo(k, outline, vignette=vignette) for k in (0.0, 0.3) for outline in ("round", "out of sight") for vignette in (0.5, 3.0)),
        np.full((*SIZE[::-1], 3), 120.0),
    ],
)
def test_a_straight_picture_a_round_gel_or_none_in_sight_tell_of_none(picture: np.ndarray) -> None:
    assert lens_of_edges(picture) is None


def test_one_edge_tells_of_none() -> None:
    seen = gel_edges(photo(0.3))
    assert len(seen) == 4 and straightened(seen[:1], SIZE) is None and straightened(seen[:2], SIZE) is not None


def test_photographs_are_straightened_and_corners_with_them(tmp_path: Path) -> None:
    k, turn = 0.3, 8.0
    for name in ("rest.png", "a.png"):
        Image.fromarray(photo(k, turn_deg=turn).astype(np.uint8)).save(tmp_path / name)
    lens = Lens(k, SIZE)

    def seen(world: np.ndarray) -> np.ndarray:
        """Where the photograph shows places of the gel [half diagonals]."""
        away = turned(world, -turn)
        return np.array(SIZE) / 2 + away * (1 + k * (away**2).sum(axis=-1, keepdims=True)) * np.hypot(*SIZE) / 2

    corners = seen(np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * HALF)
    side, middle = seen(np.array([[HALF[0], 0], [0.0, HALF[1] / 2]]))
    (tmp_path / "presses.csv").write_text(f"file,col_px,row_px\na.png,{side[0]},{side[1]}\n")

    def read(more: str) -> Photos:
        (tmp_path / "photos.toml").write_text(f'no_contact = "rest.png"\nball_radius_mm = 3\n{more}')
        return read_photos(tmp_path)

    found, plain = (read(f"corners_px = {corners.tolist()}{more}") for more in ("", "\nlens_k = 0"))
    assert found.lens is not None and found.lens.k == pytest.approx(k, abs=4 * expected_sd(1.5, 1.0))
    assert found.lens_choice["lens_by"] == "edges" and 0 < found.lens_choice["lens_k_sd"] < k / 4
    # A side's middle lies on the upright picture's rim: a place of the photograph is known to 0.1 px, here as many pixels as the sides say.
    assert found.hints[0, :2] == pytest.approx([found.size[0], found.size[1] / 2], abs=0.5)
    # planted: without the lens it lies off by the side's bow, k d t² = 0.3 * 0.56 * 0.42² half diagonals of 200 px
    assert plain.lens is None and plain.size[0] - plain.hints[0, 0] > 0.8 * k * HALF[0] * HALF[1] ** 2 * 200
    # and the picture is the gel alone, to its rim
    rim = np.concatenate([found.no_contact[2:-2, 3], found.no_contact[2:-2, -4], found.no_contact[3, 2:-2], found.no_contact[-4, 2:-2]])
    assert rim.mean() > 2 * photo(k, turn_deg=turn)[:3].mean()
    assert lens.straight(middle) == pytest.approx(Lens(found.lens.k, SIZE).straight(middle), abs=0.5)
    assert read("crop_px = [0, 0, 200, 200]").lens is None and read("lens_k = 0").lens is None
    whole = read("mm_per_px = 0.05")
    assert whole.lens is None or whole.lens.k == pytest.approx(k, abs=4 * expected_sd(1.5, 1.0))


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["mini_markers/no_contact.png", "dots427/no_contact.jpg"])
def test_rows_of_real_dots_are_straightened_as_their_grid_says(name: str) -> None:
    """No real set shows two edges of its gel. Rows of dots are straight lines too, of which the grid's homography was not fitted."""
    path = REAL / name
    if not path.exists():
        pytest.skip(f"needs {path}")
    levels = np.asarray(Image.open(path).convert("RGB"), float)
    size = (levels.shape[1], levels.shape[0])
    assert lens_of_edges(levels) is None
    dots = blobs(levels)[0]
    places, numbers = numbered(dots, np.array(size) / 2)
    rows = [places[numbers[:, axis] == line] for axis in (0, 1) for line in np.unique(numbers[:, axis])]
    found, grid = straightened([row for row in rows if len(row) >= 5], size), fitted_lens(dots, size)
    assert found is not None and grid is not None
    print(f"{name}: k by rows {found[0]:.3f} +- {found[1]:.3f}, by the grid {grid.k:.3f} +- {grid.sd:.3f}")
    assert found[0] > 4 * found[1] and abs(found[0] - grid.k) < 3 * np.hypot(found[1], grid.sd)
