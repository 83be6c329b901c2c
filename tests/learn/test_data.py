"""The stream of presses: a function of seed and position, padded, randomised as the settings say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import TINY

from gelsim.data.episodes import load_dataset
from learn import recordings
from learn.augment import LOOK, choose_randomly, draw_look, randomise
from learn.config import LearnError, configure
from learn.data import Batch, choose, collate, gel_of, held_presses, sides
from learn.recordings import Archive, Noise, Reading, archive, camera_noise, record_episode
from learn.stream import Stream, share

CONFIG = configure(**TINY)
STILL = replace(CONFIG.augment, **{name: 0.0 for name in ("noise_levels", "gain", "gamma", "drift", "blur_px", "crop")})


@pytest.fixture(scope="module")
def part(fake_data: Path) -> Archive:
    dataset = load_dataset(fake_data)
    return archive(dataset, sides(dataset, 0)[0], CONFIG.input)


def same(one: Batch, number: int, other: Batch, at: int) -> bool:
    return all(
        torch.equal(getattr(one, name)[number], getattr(other, name)[at]) for name in ("pictures", "background", "signal", "lengths")
    )


def test_a_position_gives_the_same_press_whatever_came_before_and_beside(part: Archive) -> None:
    one = Stream([part], CONFIG).batch((3, 11, 200))
    other = Stream([part], CONFIG)
    pair, last = other.batch((200, 11)), other.batch((3,))
    assert same(one, 2, pair, 0) and same(one, 1, pair, 1) and same(one, 0, last, 0)
    assert not torch.equal(one.background[0], one.background[1])


def test_every_press_comes_once_before_any_comes_again(part: Archive) -> None:
    stream = Stream([part], CONFIG)
    count = len(part) - stream.without_contact
    members = [stream.member(position) for position in range(2 * count)]
    assert len(set(members[:count])) == len(set(members[count:])) == count and members[:count] != members[count:]


def test_real_presses_come_at_their_ratio(part: Archive) -> None:
    config = replace(CONFIG, train=replace(CONFIG.train, real_ratio=0.25))
    stream = Stream([part, part], config)
    pools = [stream.member(position)[0] for position in range(400)]
    assert sum(pools) == 100 and sum(pools[:40]) == 10


def test_without_randomisation_a_press_comes_as_a_test_sees_it(part: Archive) -> None:
    """But for the camera's noise, which is left out here by hand."""
    quiet = replace(part, noises=[Noise()] * len(part))
    stream = Stream([quiet], replace(CONFIG, augment=replace(CONFIG.augment, augment=False)))
    batch = stream.batch(range(5))
    for slot in range(5):
        press = choose(quiet.recording(stream.member(slot)[1]), CONFIG.input, False)
        assert press is not None and batch.lengths[slot] == len(press.pictures)
        alone = collate([press], CONFIG.input.frames)
        assert torch.equal(batch.pictures[slot], alone.pictures[0]) and torch.equal(batch.background[slot], alone.background[0])
        # float32 means over 2,304 numbers of up to 255 levels.
        assert torch.allclose(batch.signal[slot], alone.signal[0], rtol=1e-4)


def test_gels_are_those_of_the_rows_and_hidden_at_their_share(part: Archive) -> None:
    stream, positions = Stream([part], CONFIG), range(400)
    gels = stream.batch(positions).gel
    wanted = torch.tensor([gel_of(part.rows[stream.member(position)[1]]["gel"]) for position in positions])
    hidden = torch.isnan(gels).any(dim=1)
    assert torch.isnan(gels[hidden]).all() and torch.equal(gels[~hidden], wanted[~hidden]) and len(wanted.unique(dim=0)) == 2
    # Of 400 draws at 0.2: four standard deviations of their share.
    assert float(hidden.double().mean()) == pytest.approx(CONFIG.augment.hide_gel, abs=4 * np.sqrt(0.2 * 0.8 / 400))
    # By the press's own generator, whatever is drawn beside it.
    alone = torch.cat([Stream([part], CONFIG).batch((position,)).gel for position in range(30)])
    assert torch.equal(alone.isnan(), gels[:30].isnan()) and torch.equal(alone.nan_to_num(), gels[:30].nan_to_num())
    for changes, share_hidden in (({"hide_gel": 0.0}, 0), ({"hide_gel": 1.0}, 1), ({"hide_gel": 1.0, "augment": False}, 0)):
        found = Stream([part], replace(CONFIG, augment=replace(CONFIG.augment, **changes))).batch(range(20)).gel
        assert float(found.isnan().double().mean()) == share_hidden


def test_hiding_the_gel_changes_no_picture(part: Archive) -> None:
    never = replace(CONFIG, augment=replace(CONFIG.augment, hide_gel=0.0))
    one, other = (Stream([part], config).batch(range(20)) for config in (CONFIG, never))
    assert one.gel.isnan().any() and all(same(one, slot, other, slot) for slot in range(20))


def test_a_test_is_told_the_gel_of_its_row_and_none_where_there_is_none(part: Archive) -> None:
    rows = [{key: value for key, value in row.items() if key != "gel" or number} for number, row in enumerate(part.rows)]
    presses = held_presses(replace(part, rows=rows), CONFIG.input, False, 0)
    told = [press.gel for press in presses if press is not None]
    assert np.isnan(told[0]).all() and told[1] == gel_of(rows[1]["gel"]) and told[1] != told[2]
    assert collate([press for press in presses[:2] if press is not None]).gel.isnan().all(dim=1).tolist() == [True, False]
    assert np.isnan(gel_of({"thickness_mm": 2.0, "edge_thickness_mm": 1.0, "shore_00": None})).all()


def test_devices_share_a_batch_without_overlap() -> None:
    alone = [list(share(step, 8)) for step in (2, 3, 4)]
    shares = [[list(share(step, 8, rank, 2)) for step in (2, 3, 4)] for rank in (0, 1)]
    assert [sorted(a + b) for a, b in zip(*shares, strict=True)] == alone and alone[0][0] == 16
    with pytest.raises(LearnError, match="multiple"):
        share(0, 9, 0, 2)


@pytest.mark.parametrize("workers", [0, 2])
def test_the_cache_gives_what_memory_gives(fake_data: Path, part: Archive, tmp_path: Path, workers: int) -> None:
    dataset = load_dataset(fake_data)
    indices = [row["index"] for row in part.rows]
    for _ in range(2):  # written, then mapped
        cached = archive(dataset, indices, CONFIG.input, Reading(tmp_path, workers=workers))
        for number in (0, len(part) - 1):
            a, b = part.recording(number), cached.recording(number)
            assert np.array_equal(a.pictures, b.pictures) and np.array_equal(a.background, b.background) and a.noise == b.noise
            assert np.array_equal(part.features[number], cached.features[number])
    archive(dataset, indices[:3], CONFIG.input, Reading(tmp_path))  # another choice of the same dataset reads nothing anew
    assert len([path for path in tmp_path.iterdir() if path.is_dir()]) == 1


@pytest.mark.parametrize("workers", [0, 2])
def test_a_cache_that_was_interrupted_goes_on(
    fake_data: Path, part: Archive, tmp_path: Path, workers: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was read before the end of a run is not read again; half a file counts for nothing."""
    dataset = load_dataset(fake_data)
    indices = [row["index"] for row in dataset.rows]
    told: list[int] = []

    def stop(what: str, done: int, count: int) -> None:
        told.append(done)
        if len(told) == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr(recordings, "_AT_ONCE", 2)
    with pytest.raises(KeyboardInterrupt):
        archive(dataset, indices, CONFIG.input, Reading(tmp_path, stop, workers))
    (half,) = tmp_path.glob("*.partial")
    done = sorted(half.glob("[0-9]*.npz"))
    assert len(done) == 3 < len(dataset.rows) / 2
    done[0].write_bytes(done[0].read_bytes()[:100])

    again: list[int] = []
    cached = archive(dataset, indices, CONFIG.input, Reading(tmp_path, lambda what, done, count: again.append(done), workers))
    assert again[0] >= 3 * 2 and again[-1] == len(dataset.rows)  # two whole files count, and the first handful that is read
    assert len(again) <= (len(dataset.rows) + 1) // 2 - 2
    whole = archive(dataset, indices, CONFIG.input)
    for number in range(len(whole)):
        assert np.array_equal(whole.stored(number), cached.stored(number))
        assert np.array_equal(whole.features[number], cached.features[number])
    assert not list(tmp_path.glob("*.partial")) and len(list(tmp_path.glob("*/*"))) == 2


def test_padding_is_zero_and_lengths_say_so(part: Archive) -> None:
    presses = [choose(part.recording(number), CONFIG.input, False) for number in range(8)]
    batch = collate([press for press in presses if press is not None], at_least=9)
    assert batch.pictures.shape == (8, 9, 3, 24, 32)
    for number, press in enumerate(presses):
        assert press is not None and batch.lengths[number] == len(press.pictures)
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


def looks(count: int, **changes: object) -> np.ndarray:
    """Looks that change nothing but what is given."""
    found = np.zeros(count, LOOK)
    for number in range(count):
        found[number] = draw_look(np.random.default_rng(number), replace(CONFIG.augment, augment=False))
    for name, value in changes.items():
        found[name] = value
    return found


def test_noise_of_a_batch_is_as_large_as_it_says() -> None:
    stack = torch.full((2, 25, 3, 40, 40), 100.0)
    drawn = randomise(stack, looks(2, noise=(0.0, 1.2)), [(0.5, 0.02), (0.0, 0.0)], STILL)
    # Of 120,000 normal draws the standard deviation is known to 1/sqrt(2 n) = 0.2 %: 4 of these.
    assert float(drawn[0].std()) == pytest.approx(1.5, rel=8e-3) and float(drawn[1].std()) == pytest.approx(1.2, rel=8e-3)
    assert not torch.equal(drawn[0, 0], drawn[0, 1])


def test_a_mirrored_sensor_with_swapped_colours_keeps_its_numbers() -> None:
    stack = torch.rand(2, 4, 3, 6, 8) * 255
    seen = randomise(stack, looks(2, size=[(-1, 1), (1, -1)], colours=[(2, 0, 1), (0, 1, 2)]), [(0.0, 0.0)] * 2, STILL)
    # The interpolation's weights are 1 and 0 up to float32; of 255 levels.
    assert torch.allclose(seen[0], stack[0].flip(-1)[:, [2, 0, 1]], atol=1e-3) and torch.allclose(seen[1], stack[1].flip(-2), atol=1e-3)


def test_a_cut_enlarges_what_it_shows() -> None:
    """A plane stays a plane: at the place of each new pixel it has the value that was there."""
    rows, columns = 24, 32
    y, x = torch.meshgrid(torch.arange(rows) + 0.5, torch.arange(columns) + 0.5, indexing="ij")
    stack = (2 * x + 3 * y).expand(1, 2, 3, rows, columns).contiguous()
    config = replace(STILL, crop=0.5)
    seen = randomise(stack, looks(1, size=0.5, centre=(0.25, -0.125)), [(0.0, 0.0)], config)
    there = 2 * (16 + 4 + (x - 16) / 2) + 3 * (12 - 1.5 + (y - 12) / 2)
    assert torch.allclose(seen[0, 0, 0], there, atol=1e-3)


def test_tone_gain_drift_and_blur() -> None:
    stack = torch.full((1, 2, 3, 9, 9), 127.5)
    one = replace(STILL, blur_px=1.0)
    seen = randomise(stack, looks(1, exponent=2.0, gain=(1.0, 0.5, 2.0), drift=1.1, blur=1.0), [(0.0, 0.0)], one)
    found = seen[0, :, :, 4, 4].tolist()
    assert found[0] == pytest.approx([63.75, 31.875, 127.5], rel=1e-5) and found[1] == pytest.approx([70.125, 35.0625, 140.25], rel=1e-5)
    dot = torch.zeros(1, 2, 3, 9, 9)
    dot[..., 4, 4] = 100
    blurred = randomise(dot, looks(1, blur=1.0), [(0.0, 0.0)], one)[0, 0, 0]
    weights = np.exp(-0.5 * np.arange(-3, 4) ** 2.0)
    # Powers of a float32.
    assert float(blurred[4, 3]) == pytest.approx(100 * weights[2] * weights[3] / weights.sum() ** 2, rel=1e-5)
    assert torch.equal(randomise(dot, looks(1, blur=0.1), [(0.0, 0.0)], one), dot)


def test_lost_frames_never_leave_a_press_empty(rng: np.random.Generator) -> None:
    config = replace(CONFIG.augment, drop=0.9, thin=5, end_share=0.1)
    signal = np.linspace(0, 3, 9)
    for _ in range(200):
        chosen = choose_randomly(signal, rng, CONFIG.input, config, False)
        assert 1 <= len(chosen) <= CONFIG.input.frames and (np.diff(chosen) > 0).all()
