"""The stream of presses: a function of seed and position, padded, randomised as the settings say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import TINY

from gelsim.dataset import load_dataset
from learn.augment import Noise, choose_randomly, randomise
from learn.config import LearnError, configure
from learn.data import Archive, Steps, Stream, archive, camera_noise, choose, collate, record_episode, sides
from learn.frames import change_signal

CONFIG = configure(**TINY)


@pytest.fixture(scope="module")
def part(fake_data: Path) -> Archive:
    dataset = load_dataset(fake_data)
    return archive(dataset, sides(dataset, 0)[0], CONFIG.input)


def test_a_position_gives_the_same_press_whatever_came_before(part: Archive) -> None:
    one, other = Stream([part], CONFIG, False), Stream([part], CONFIG, False)
    presses = [one[position] for position in (3, 11, 200)]
    for press, again in zip(reversed(presses), [other[position] for position in (200, 11, 3)], strict=True):
        assert np.array_equal(press.pictures, again.pictures) and press.target == again.target
    assert not np.array_equal(presses[0].background, presses[1].background)


def test_every_press_comes_once_before_any_comes_again(part: Archive) -> None:
    stream = Stream([part], replace(CONFIG, augment=replace(CONFIG.augment, augment=False)), False)
    count = len(part) - stream.without_contact
    keys = [(stream[position].target, stream[position].signal[-1].round(6)) for position in range(2 * count)]
    assert len(set(map(str, keys[:count]))) == count


def test_real_presses_come_at_their_ratio(part: Archive, monkeypatch: pytest.MonkeyPatch) -> None:
    config = replace(CONFIG, train=replace(CONFIG.train, real_ratio=0.25))
    stream = Stream([part, part], config, False)
    pools: list[int] = []
    monkeypatch.setattr(stream, "draw", lambda pool, number, rng: pools.append(pool))
    for position in range(400):
        stream[position]
    assert sum(pools) == 100 and sum(pools[:40]) == 10


def test_devices_share_a_batch_without_overlap() -> None:
    alone = list(Steps(2, 5, 8))
    shares = [list(Steps(2, 5, 8, rank, 2)) for rank in (0, 1)]
    assert [sorted(a + b) for a, b in zip(*shares, strict=True)] == alone and alone[0][0] == 16
    with pytest.raises(LearnError, match="multiple"):
        Steps(0, 1, 9, 0, 2)


def test_the_cache_gives_what_memory_gives(fake_data: Path, part: Archive, tmp_path: Path) -> None:
    dataset = load_dataset(fake_data)
    indices = [row["index"] for row in part.rows]
    for _ in range(2):  # written, then mapped
        cached = archive(dataset, indices, CONFIG.input, tmp_path)
        for number in (0, len(part) - 1):
            a, b = part.recording(number), cached.recording(number)
            assert np.array_equal(a.pictures, b.pictures) and np.array_equal(a.background, b.background) and a.noise == b.noise
            assert np.array_equal(part.features(number), cached.features(number))


def test_padding_is_zero_and_lengths_say_so(part: Archive) -> None:
    stream = Stream([part], CONFIG, False)
    presses = [stream[position] for position in range(8)]
    batch = collate(presses, at_least=9)
    assert batch.pictures.shape == (8, 9, 3, 24, 32) and batch.lengths.tolist() == [len(press.pictures) for press in presses]
    for number, press in enumerate(presses):
        assert torch.equal(batch.pictures[number, 0], torch.from_numpy(press.pictures[0]).permute(2, 0, 1))
        assert not batch.pictures[number, len(press.pictures) :].any()


def test_noise_is_as_large_as_it_says(rng: np.random.Generator) -> None:
    noise = Noise(flat=0.5, shot=0.02)
    drawn = noise.draw(np.full((50, 40, 40, 3), 100.0, np.float32), rng)
    # Of 240,000 normal draws the standard deviation is known to 1/sqrt(2 n) = 0.14 %: 4 of these.
    assert drawn.std() == pytest.approx(np.sqrt(0.25 + 2.0), rel=6e-3) and drawn.mean() == pytest.approx(
        100, abs=4 * 1.5 / np.sqrt(240_000)
    )


def test_averaging_lowers_the_cameras_noise_by_the_root_of_the_pixels(fake_data: Path) -> None:
    episode = load_dataset(fake_data).read(0)  # noise of 1 level, 36 × 48 pixels
    assert camera_noise(episode, (18, 24)).flat == pytest.approx(0.5)
    assert record_episode(episode, CONFIG.input).noise.flat == pytest.approx(np.sqrt(24 * 32 / (36 * 48)))


def test_a_mirrored_sensor_with_swapped_colours_keeps_the_signal(part: Archive, rng: np.random.Generator) -> None:
    zero = {name: 0.0 for name in ("noise_levels", "gain", "gamma", "drift", "blur_px", "crop")}
    press = choose(part.recording(0), CONFIG.input, False)
    assert press is not None
    background, pictures = randomise(press.background, press.pictures, rng, replace(CONFIG.augment, **zero), Noise())
    # float32 means over 2,304 numbers of up to 255 levels.
    assert change_signal(pictures, background, 3.0) == pytest.approx(press.signal, rel=1e-4)


def test_lost_frames_never_leave_a_press_empty(rng: np.random.Generator) -> None:
    config = replace(CONFIG.augment, drop=0.9, thin=5, end_share=0.1)
    signal = np.linspace(0, 3, 9)
    for _ in range(200):
        chosen = choose_randomly(signal, rng, CONFIG.input, config, False)
        assert 1 <= len(chosen) <= CONFIG.input.frames and (np.diff(chosen) > 0).all()
