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
from learn.frames import FIXED_POINT, change_signal, loading
from learn.framing import FIELD_MM, signal_to_scale, to_scale
from learn.recordings import Archive, Noise, Reading, Recording, archive, camera_noise, record_episode
from learn.stream import Stream, share

CONFIG = configure(**TINY)
STILL = replace(
    CONFIG.augment,
    **{name: 0.0 for name in ("noise_levels", "gain", "gamma", "drift", "blur_px", "crop")},
    mirror=False,
    swap_colours=False,
)


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
    stack, swapped = torch.rand(2, 4, 3, 6, 8) * 255, replace(STILL, mirror=True, swap_colours=True)
    seen = randomise(stack, looks(2, size=[(-1, 1), (1, -1)], colours=np.eye(3)[[(2, 0, 1), (0, 1, 2)]]), [(0.0, 0.0)] * 2, swapped)
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


def test_turned_by_a_right_angle_and_made_as_large_a_picture_stands_upright() -> None:
    stack = torch.rand(1, 2, 3, 8, 8) * 255
    seen = randomise(stack, looks(1, turn=np.pi / 2), [(0.0, 0.0)], replace(STILL, turn_deg=90.0))
    assert torch.allclose(seen, stack.rot90(-1, (-2, -1)), atol=1e-3) or torch.allclose(seen, stack.rot90(1, (-2, -1)), atol=1e-3)
    # Pixels are square where the picture is not: a disc stays a disc.
    y, x = torch.meshgrid(torch.arange(24.0) - 11.5, torch.arange(32.0) - 15.5, indexing="ij")
    disc = (200 * torch.exp(-(x**2 + y**2) / 20)).expand(1, 2, 3, 24, 32).contiguous()
    turned = randomise(disc, looks(1, turn=0.7), [(0.0, 0.0)], replace(STILL, turn_deg=90.0))
    # Linear between pixels: off by an eighth of the second derivative, 200 / 10 / 8 in either direction.
    assert (turned - disc).abs().max() < 5


def test_a_border_is_of_one_colour_and_what_lies_within_stays() -> None:
    stack = torch.full((1, 2, 3, 8, 8), 100.0)
    drawn = looks(1, border=(-0.5, -1.0, 1.0, 0.75), painted=(10.0, 20.0, 30.0))
    seen = randomise(stack, drawn, [(0.0, 0.0)], replace(STILL, border=1.0, crop=0.1))[0, 1]
    assert torch.equal(seen[:, :7, 2:], torch.full((3, 7, 6), 100.0))
    assert all(torch.equal(seen[:, at, :].mean(dim=1), torch.tensor([10.0, 20.0, 30.0])) for at in (7,))
    assert torch.equal(seen[:, :, :2], torch.tensor([10.0, 20.0, 30.0])[:, None, None].expand(3, 8, 2))


@pytest.mark.parametrize("corner", [0.5, 1.0])
def test_a_window_with_round_corners_shows_what_lies_within_its_arcs(corner: float) -> None:
    """30 × 18 pixels of 40 × 24, corners of half and all of the shorter half: at 1 the ends are half discs."""
    stack, half = torch.full((1, 2, 3, 24, 40), 100.0), (15.0, 9.0)
    drawn = looks(1, border=(-0.75, -0.75, 0.75, 0.75), round=corner, painted=(10.0, 20.0, 30.0))
    seen = randomise(stack, drawn, [(0.0, 0.0)], replace(STILL, border=1.0, crop=0.1))[0]
    y, x = np.meshgrid(np.arange(24.0) - 11.5, np.arange(40.0) - 19.5, indexing="ij")
    past = [np.maximum(np.abs(along) - side + 9 * corner, 0) for along, side in ((x, half[0]), (y, half[1]))]
    within = torch.from_numpy(np.hypot(*past) < 9 * corner)
    # By the middles of pixels, none of which lies on an arc. Planted, the corners left sharp: 8 and 32 pixels too many.
    assert torch.equal(seen[1, 0] > 50, within) and torch.equal(seen[0, 2] < 50, ~within)
    assert 30 * 18 - int(within.sum()) == pytest.approx((4 - np.pi) * (9 * corner) ** 2, abs=6)


def test_masks_of_all_kinds_are_drawn(rng: np.random.Generator) -> None:
    drawn = np.array([draw_look(rng, replace(CONFIG.augment, border=1.0)) for _ in range(300)])
    corners, sides = drawn["round"], np.abs(drawn["border"])
    # Of 300 at a third a standard deviation is 8.2: four of them.
    assert all(abs(count - 100) < 33 for count in ((corners == 0).sum(), (corners == 1).sum(), ((corners > 0) & (corners < 1)).sum()))
    # Discs are as wide as high, in pictures of 4 : 3.
    assert np.allclose(sides[corners == 1][:, 0] * 4, sides[corners == 1][:, 1] * 3)


def test_dirt_stays_with_the_sensor_through_a_press_and_is_anothers_of_another() -> None:
    stack = torch.rand(2, 4, 3, 36, 48, generator=torch.Generator().manual_seed(1)) * 50 + 100
    passed = randomise(stack, looks(2, dirt=(0.2, 0.2)), [(0.0, 0.0)] * 2, replace(STILL, dirt=0.2)) / stack
    # Of float32's rounding at 100 levels; planted, dirt drawn anew for each picture is off by its contrast.
    assert torch.allclose(passed, passed[:, :1, :1].expand_as(passed), atol=1e-5)
    # Smears take up to 0.2, a speck up to 0.4 of the rest.
    assert 0.8 * 0.6 - 1e-5 < passed.min() < 0.9 and passed.max() < 1 and passed.std() > 0.01
    assert (passed[0] - passed[1]).std() > 0.01
    # There and back through the tone curve.
    assert torch.allclose(randomise(stack, looks(2), [(0.0, 0.0)] * 2, replace(STILL, dirt=0.2)), stack, atol=1e-3)


def test_colours_become_mixtures_and_a_shade_is_brightest_where_its_exponent_says() -> None:
    stack = torch.rand(1, 2, 3, 6, 8) * 50
    white = randomise(stack, looks(1, colours=np.full((3, 3), 1 / 3)), [(0.0, 0.0)], replace(STILL, mix=1.0))
    assert torch.allclose(white, stack.mean(dim=2, keepdim=True).expand_as(stack), atol=1e-3)
    shade = np.zeros((3, 5))
    shade[1, 0] = 0.5
    seen = randomise(stack, looks(1, shade=shade), [(0.0, 0.0)], replace(STILL, shade=0.5)) / stack
    assert torch.allclose(seen[:, :, 1], torch.linspace(-0.5, 0.5, 8).exp().expand(1, 2, 6, 8), rtol=1e-4)
    assert torch.allclose(seen[:, :, [0, 2]], torch.ones(1, 2, 2, 6, 8), rtol=1e-4)


@pytest.mark.parametrize("field", [(9.2, 6.9), (18.4, 13.8), (27.6, 20.7)])
def test_a_training_sees_a_press_of_known_scale_as_a_test_does(field: tuple[float, float]) -> None:
    """A dent off the middle, drawn on pictures that show half, all, and one and a half of what the network sees."""
    inputs = configure(picture=(48, 64), frames=2).input
    y, x = np.meshgrid(np.arange(48.0), np.arange(64.0), indexing="ij")
    wide = 6 * FIELD_MM[0] / field[0]  # the same dent in millimetres
    dent = 60 * np.exp(-((x - 44) ** 2 + (y - 20) ** 2) / (2 * wide**2))[..., None] * (1, 0.5, -0.5)
    background = np.full((48, 64, 3), 110.0, np.float32)
    recording = Recording(background, np.float32(background + dent[None] * np.array([0.5, 1.0])[:, None, None, None]), np.array([0.5, 1.0]))
    told = to_scale(recording, field, inputs)
    stack = torch.from_numpy(np.concatenate([background[None], recording.pictures])).movedim(-1, 1)[None]
    look = looks(1, scaled=True, size=FIELD_MM[0] / field[0])
    seen = randomise(stack, look, [(0.0, 0.0)], STILL, inputs.deadband_levels)[0].movedim(1, -1).numpy()
    assert told.scaled and np.abs(told.background - seen[0]).max() < 1e-3
    # One averages where the other interpolates: an eighth of the second derivative, half a pixel of the slope of 60 / 6 / sqrt(e) each way.
    assert np.abs(told.pictures - seen[1:]).max() < 5 and np.abs(told.pictures - seen[1:]).mean() < 0.6
    assert to_scale(recording, None, inputs) is recording


@pytest.mark.parametrize("field", [(9.2, 6.9), (27.6, 20.7)])
def test_a_training_begins_a_press_of_known_scale_where_a_test_does(field: tuple[float, float], part: Archive) -> None:
    """A dent that grows from nothing, so that its first pictures hang on what of the change counts as contact."""
    config = configure(augment=False, picture=(48, 64), frames=6)
    y, x = np.meshgrid(np.arange(48.0), np.arange(64.0), indexing="ij")
    dent = np.exp(-((x - 36) ** 2 + (y - 22) ** 2) / (2 * (6 * FIELD_MM[0] / field[0]) ** 2))[..., None]
    pictures = np.float32(110 + dent * np.linspace(0, 9, 40)[:, None, None, None] * np.ones(3))
    signal = change_signal(pictures, pictures[0], config.input.deadband_levels)
    stored = np.rint(np.concatenate([pictures[:1], pictures]) * FIXED_POINT).astype(np.uint16)
    row = part.rows[0] | {"field_mm": list(field)}
    press = Archive([row], np.zeros(1, np.int64), stored, [signal], [part.features[0]], [Noise()])
    (tested,) = held_presses(press, config.input, False, 0)
    assert tested is not None
    trained = Stream([press], config).batch((0,))
    count = len(tested.signal)
    assert int(trained.lengths[0]) == count
    # Frames are 9 / 39 levels apart at the dent's middle; chosen alike, pictures differ as in the test above, here by a tenth of its dent.
    assert np.abs(trained.pictures[0, :count].movedim(1, -1).numpy() - tested.pictures).max() < 0.8
    # planted: by the whole picture's change the first is chosen elsewhere
    among = loading(signal, config.input)
    assert abs(int(among[0]) - int(loading(signal_to_scale(signal, field, config.input), config.input)[0])) >= 2


def test_scales_are_hidden_from_as_many_presses_as_asked_and_some_begin_in_contact(rng: np.random.Generator) -> None:
    config = replace(CONFIG.augment, hide_scale=0.4, late=0.5)
    drawn = [draw_look(rng, config, 12.0) for _ in range(400)]
    # Of 400 at 0.4 a standard deviation is 9.8: four of them.
    assert abs(sum(bool(look["scaled"]) for look in drawn) - 240) < 40
    assert not any(draw_look(rng, config, None)["scaled"] for _ in range(20))
    begun = [choose_randomly(np.linspace(0, 3, 31), rng, CONFIG.input, config, False) for _ in range(400)]
    late = [(chosen, empty) for chosen, empty in begun if empty]
    assert abs(len(late) - 200) < 40 and all(chosen.min() >= empty for chosen, empty in late) and max(empty for _, empty in late) <= 12


def test_lost_frames_never_leave_a_press_empty(rng: np.random.Generator) -> None:
    config = replace(CONFIG.augment, drop=0.9, thin=5, end_share=0.1)
    signal = np.linspace(0, 3, 9)
    for _ in range(200):
        chosen, empty = choose_randomly(signal, rng, CONFIG.input, config, False)
        assert 1 <= len(chosen) <= CONFIG.input.frames and (np.diff(chosen) > 0).all() and empty == 0


def test_a_codec_leaves_flat_blocks_and_multiples_of_its_step() -> None:
    stack = torch.rand(2, 2, 3, 18, 25, generator=torch.Generator().manual_seed(1)) * 6 + 100
    drawn = looks(2, codec=(0.0, 12.0), block=(3, 3))
    seen = randomise(stack, drawn, [(0.0, 0.0)] * 2, replace(STILL, codec_levels=12.0))
    # There and back in float32, of 255 levels.
    assert torch.allclose(seen[0], stack[0], atol=1e-3)
    tile = seen[1, 0, 0, :3, :3]
    # Of the noise, 1.7 levels a wave, nothing reaches half of a step of 12; the mean is a multiple of 12 / 3.
    assert torch.allclose(tile, tile.mean().expand(3, 3), atol=1e-3) and float(tile.mean()) == pytest.approx(
        4 * round(float(tile.mean()) / 4), abs=1e-3
    )


def test_a_texture_is_where_a_press_touches_and_grows_with_it() -> None:
    stack = torch.full((1, 3, 3, 48, 64), 100.0)
    stack[:, 1, :, :, :20] += 10
    stack[:, 2, :, :, :20] += 20
    drawn = looks(1, relief=[[30.0, 0.0], [0.0, 30.0], [0.0, 0.0]], grain=4)
    left = (randomise(stack, drawn, [(0.0, 0.0)], replace(STILL, texture=1.0)) - stack)[0]
    assert torch.equal(left[0], torch.zeros_like(left[0])) and left[:, :, :, 40:].abs().max() == 0 and left[:, 2].abs().max() == 0
    assert left[2, 0, :, :12].std() > 1 and torch.allclose(left[1, 0, :, :12], left[2, 0, :, :12] / 2, atol=1e-3)


def test_what_a_press_shows_does_not_hang_on_its_neighbours(part: Archive) -> None:
    """So a batch is the same on one device and shared by several: with all that is drawn, and fields of different scales."""
    names = ("picture", "widths", "frames", "hidden")
    strong = configure("families", **{name: value for name, value in TINY.items() if name in names}).augment
    config = replace(CONFIG, augment=strong)
    rows = [row | {"field_mm": [12.0 + 3 * (number % 4), 9.0 + 2.25 * (number % 4)]} for number, row in enumerate(part.rows)]
    stream = Stream([replace(part, rows=rows)], config)
    whole = stream.batch(range(12))
    assert 0 < int(whole.scaled.sum()) < 12
    for position in range(12):
        alone = stream.batch((position,))
        # The same sums in another order, of 255 levels; where a codec rounds, rarely a whole step of one block.
        away = (alone.pictures[0] - whole.pictures[position]).abs()
        assert float(away.mean()) < 1e-2 and float((away > 1e-2).float().mean()) < 0.02
