"""Pictures averaged to the network's size, and frames chosen by intensity change."""

from __future__ import annotations

import numpy as np
import pytest

from learn.config import LearnError, configure
from learn.frames import FIXED_POINT, change_signal, equal_steps, find_press, fit_picture, levels_of, loading

INPUTS = configure().input


def test_averages_blocks_of_pixels_exactly(rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (24, 32, 3), dtype=np.uint8)
    blocks = image.reshape(6, 4, 8, 4, 3).mean(axis=(1, 3))
    # Half a unit of the fixed point, and float32 sums of 16 levels (1e-5).
    assert np.abs(levels_of(fit_picture(image, (6, 8))) - blocks).max() <= 0.5 / FIXED_POINT + 1e-4


def test_averaging_keeps_the_mean_where_pixels_are_shared(rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (24, 32, 3), dtype=np.uint8)
    assert levels_of(fit_picture(image, (18, 24))).mean() == pytest.approx(image.mean(), abs=0.5 / FIXED_POINT)


def test_cuts_to_the_proportions_and_turns_upright_pictures() -> None:
    image = np.zeros((30, 60, 3), np.uint8)
    image[:, 10:50] = 200  # the middle 4:3 part
    assert (levels_of(fit_picture(image, (12, 16))) == 200).all()
    assert (levels_of(fit_picture(np.rot90(image), (12, 16))) == 200).all()


def test_signal_does_not_count_noise() -> None:
    background = np.full((4, 4, 3), 100.0)
    pictures = np.stack([background, background + 2.0, background + 7.0])
    assert change_signal(pictures, background, 3.0) == pytest.approx([0, 0, 4])


def filmed(rng: np.random.Generator, strengths: list[float]) -> np.ndarray:
    """A dotted membrane with a dent of so many levels, which is as wide as it is deep."""
    y, x = np.mgrid[:24, :32]
    plain = 120 + 3 * np.sin(x / 2)[..., None] * np.ones(3)
    dent = [np.exp(-((x - 14) ** 2 + (y - 11) ** 2) / (8 + strength)) * (x - 14) / 4 for strength in strengths]
    return np.stack([plain + strength * part[..., None] for strength, part in zip(strengths, dent, strict=True)]) + rng.normal(
        scale=0.3, size=(len(strengths), 24, 32, 3)
    )


UP, DOWN = [0.0, 25.0, 45.0, 60.0], [45.0, 25.0, 0.0]
WAYS = {
    "a press": ([0.0, *UP, *DOWN], 0, 0, ""),
    "begun in contact": ([60.0, *DOWN, *UP, *DOWN], 3, 3, "starts in contact"),
    "begun in light contact": ([45.0, *DOWN[1:], *UP], 2, 2, "starts in contact"),
    "a weaker press before": ([0.0, 25.0, 45.0, 25.0, 0.0, *UP], 0, 4, "several presses"),
    "a weaker one after": ([*UP, *DOWN, 25.0, 45.0, 0.0], 0, 0, ""),
    "nothing": ([0.0] * 6, 0, 0, ""),
}


@pytest.mark.parametrize(("strengths", "rest", "begin", "words"), WAYS.values(), ids=list(WAYS))
def test_the_press_of_a_film_is_found(
    rng: np.random.Generator, strengths: list[float], rest: int, begin: int, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    film = filmed(rng, strengths)
    found = find_press(film, INPUTS)
    free = {number for number, strength in enumerate(strengths) if strength == 0.0}
    assert found.rest == rest or {found.rest, rest} <= free  # which of the free ones is plainest, noise decides
    assert found.begin == begin or {found.begin, begin} <= free
    assert words in found.note and bool(words) == bool(found.note)
    # Planted: the plainest frame is not sought.
    monkeypatch.setattr("learn.frames.structure", lambda picture: 0.0)
    if "starts" in words:
        assert find_press(film, INPUTS).rest == 0


def test_where_a_press_goes_on_to_slide_its_markers_are_not_read(rng: np.random.Generator) -> None:
    """Stripes two pixels wide, of cells of eight, move on by one in each of three more frames; where they do not, all is read."""
    film = filmed(rng, [*UP, 60.0, 60.0, 60.0]).repeat(3, axis=1).repeat(3, axis=2)
    stripes = 40.0 * (np.arange(96) // 2 % 2)[None, :, None] * np.ones((72, 1, 3))
    slid = film + np.stack([stripes] * 4 + [np.roll(stripes, shift, axis=1) for shift in (1, 2, 1)])
    found = find_press(slid, INPUTS)
    assert found.end == len(UP) and "from frame 4 on it is turned or slid" in found.note
    for pictures in (film, film + stripes):
        assert find_press(pictures, INPUTS).end == len(film) and not find_press(pictures, INPUTS).note


def test_a_press_that_is_only_let_go_is_none(rng: np.random.Generator) -> None:
    film = filmed(rng, [60.0, *DOWN, 0.0])
    with pytest.raises(LearnError, match="is let go, and not pressed again"):
        find_press(film, INPUTS)
    with pytest.raises(LearnError, match="is let go"):
        find_press(film, INPUTS, film[-1])


def test_loading_runs_from_contact_to_the_peak() -> None:
    signal = np.array([0, 0.01, 0.3, 1.0, 2.0, 4.0, 4.0, 3.0, 0.5])
    assert loading(signal, INPUTS).tolist() == [2, 3, 4, 5, 6]
    assert loading(signal, INPUTS, end_share=0.5).tolist() == [2, 3, 4]
    assert len(loading(np.zeros(5), INPUTS)) == 0


@pytest.mark.parametrize("count", [1, 2, 5, 9])
def test_chosen_frames_are_in_order_and_end_at_the_end(rng: np.random.Generator, count: int) -> None:
    signal = np.cumsum(rng.uniform(-0.2, 1.0, 12)).clip(0.1)
    among = np.arange(2, 11)
    for repeat in (True, False):
        chosen = equal_steps(signal, among, count, repeat)
        assert (np.diff(chosen) >= (0 if repeat else 1)).all() and chosen[-1] == among[-1] and set(chosen) <= set(among)
        assert len(chosen) == count if repeat else len(chosen) <= count


def test_speed_and_frame_rate_do_not_matter() -> None:
    """The same press recorded at constant speed and at a speed that doubles: the chosen frames show the same signal."""
    slow, bent = np.linspace(0, 5, 200) ** 1.5, np.linspace(0, np.sqrt(5), 300) ** 3
    found = [signal[equal_steps(signal, loading(signal, INPUTS), 5, repeat=True)] for signal in (slow, bent)]
    # Half a frame at the fastest place of each: max step of the signal / 2, twice.
    bound = (np.diff(slow).max() + np.diff(bent).max()) / 2 + 1e-9
    assert np.abs(found[0] - found[1]).max() <= bound
