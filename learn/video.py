"""Where presses come from when they are to be predicted: a video file, a folder of frames, an episode, a dataset. Reading is bounded.

A press lasts seconds. What is longer is refused with a word on how to cut it, before it is decoded where the file says its length, after
MOST_FRAMES frames where it does not. Frames are averaged to the network's size as they come, so memory does not grow with their size.
"""

from __future__ import annotations

import contextlib
import re
import subprocess
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gelsim.data.episodes import field_seen, gel_facts, load_dataset, read_episode
from gelsim.errors import GelsimError
from gelsim.scene.definition import Scene
from gelsim.scene.layers import load_scene
from learn.config import InputConfig, LearnError
from learn.data import UNKNOWN_GEL, Gel, gel_of
from learn.frames import as_wide, averaged, change_signal, find_press, fit_picture, levels_of
from learn.framing import Framing, at_scale, contact_centre, to_scale
from learn.recordings import Recording, record_episode, with_noise

MOST_SECONDS, MOST_FRAMES, MOST_PIXELS = 60.0, 1800, 2**25
"""A minute at 30 frames a second; pictures of up to 33 million pixels."""
HEADER_SECONDS = 30.0
"""Within which the decoder must say what a file is."""
FEWEST_FRAMES = 2
"""The no-contact frame, and one of the press."""
BLACK_LEVELS = 3.0
"""A picture darker than this on average shows no membrane [levels of 255]."""
PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


AS_IT_IS = Framing()


@dataclass(frozen=True, eq=False)
class Source:
    """One press to be predicted."""

    name: str
    recording: Recording
    true: float | None = None
    """Shore 00 where the source knows it."""
    gel: Gel = UNKNOWN_GEL
    """Of the sensor, where the source knows it: by its row, or by the scene.toml beside pictures of `gelsim render`."""
    note: str = ""
    """What was assumed of the pictures."""


def sources(
    path: Path,
    inputs: InputConfig,
    background: Path | None = None,
    start: float = 0.0,
    seconds: float | None = None,
    framing: Framing = AS_IT_IS,
) -> Iterator[tuple[str, Callable[[], Source]]]:
    """The presses of a path: the name of each, and what reads it, so that one that cannot be read does not end the others.

    Args:
        background: A picture of the sensor that touches nothing; episodes bring their own, a result of `gelsim render` begins with it, and
            of others it is found (`learn.frames.find_press`).
        start, seconds: The part of a video that is the press [s].
        framing: What of a video's or a folder's pictures is the gel, and their scale; episodes know theirs.
    Raises:
        LearnError, DatasetError: It cannot be read, is too long, too short or black; by the readers too.
    """
    if (path / "meta" / "info.json").is_file():
        dataset = load_dataset(path)
        for row in dataset.rows:
            yield f"{path}#{row['index']}", partial(_episode, dataset.folder / row["file"], f"{path}#{row['index']}", inputs)
    elif path.suffix == ".tar":
        yield str(path), partial(_episode, path, str(path), inputs)
    elif path.is_dir():
        rest = background or _rest_of(path)
        yield str(path), lambda: _recorded(path, lambda: _folder(path), inputs, rest, framing)
    elif path.is_file():
        yield str(path), lambda: _recorded(path, lambda: _video(path, start, seconds), inputs, background, framing)
    else:
        raise LearnError(f"{path}: no such file or folder")


def _episode(path: Path, name: str, inputs: InputConfig) -> Source:
    episode = read_episode(path)
    recording = with_noise(record_episode(episode, inputs), [3, episode.row["index"]], inputs)
    recording = to_scale(recording, episode.row.get("field_mm"), inputs)
    return _checked(Source(name, recording, episode.row["shore_00"], gel_of(episode.row.get("gel"))))


Frames = Callable[[], Iterator[NDArray[np.uint8]]]


def _recorded(path: Path, frames: Frames, inputs: InputConfig, background: Path | None, framing: Framing) -> Source:
    beside = _scene_beside(path)
    opened, given, picture = frames(), framing, inputs.picture
    with contextlib.closing(opened):  # type: ignore[type-var]
        first = list(islice(opened, 1))
        if first and beside is not None and framing.scale is None and framing.corners is None:
            framing = given = replace(framing, mm_per_px=field_seen(beside)[0] / first[0].shape[1])
        framing = framing.outlined(first[0]) if first else framing
        scale = framing.scale

        def whole(kept: NDArray[np.uint8]) -> NDArray[np.uint16]:
            return fit_picture(kept, picture) if scale is None else averaged(as_wide(kept, picture), picture)

        pictures = _seen(path, chain(first, opened), framing, whole)
        given_rest = None if background is None else levels_of(whole(framing.kept(_picture(background), str(background))))
    if len(pictures) + (background is not None) < FEWEST_FRAMES or len(pictures) == 0:
        what = "1 frame" if len(pictures) == 1 else f"{len(pictures)} frames"
        raise LearnError(f"{path}: {what}; a press takes at least {FEWEST_FRAMES}: the sensor untouched, then pressed")
    try:
        found = find_press(pictures, inputs, given_rest)
    except LearnError as error:
        raise LearnError(f"{path}: {error}") from None
    rest = pictures[found.rest] if given_rest is None else given_rest
    signal = found.signal
    read = slice(found.begin, found.end)
    if scale is not None:  # where the contact is, is known once all has been read: it is read again
        centre = contact_centre(pictures[read], rest, signal[read], inputs.deadband_levels)

        def around(kept: NDArray[np.uint8]) -> NDArray[np.uint16]:
            return at_scale(kept, picture, scale, centre)

        with contextlib.closing(frames()) as opened:  # type: ignore[type-var]
            pictures = _seen(path, opened, framing, around)
        rest = pictures[found.rest] if background is None else levels_of(around(framing.kept(_picture(background), str(background))))
        signal = change_signal(pictures, rest, inputs.deadband_levels)
    recording = Recording(rest, pictures[read], signal[read], scaled=scale is not None)
    notes = [] if framing is given else ["a border was cut off (--crop {} {} {} {})".format(*framing.crop or ())]
    notes += [found.note] if found.note else []
    gel = UNKNOWN_GEL if beside is None else gel_of(gel_facts(beside.gel))
    return _checked(Source(str(path), recording, gel=gel, note="; ".join(notes)))


def _seen(
    path: Path, frames: Iterable[NDArray[np.uint8]], framing: Framing, view: Callable[[NDArray[np.uint8]], NDArray[np.uint16]]
) -> NDArray[np.float32]:
    """One view [levels] of what is kept of each frame, shape (N, h, w, 3)."""
    pictures = []
    for frame in frames:
        if len(pictures) == MOST_FRAMES:
            raise LearnError(f"{path}: more than {MOST_FRAMES} frames; a press lasts seconds: cut it, or give --start and --seconds")
        kept = framing.kept(frame, str(path))
        framing.check_field(kept, str(path))
        pictures.append(view(kept))
    return levels_of(np.stack(pictures)) if pictures else np.empty((0, 0, 0, 3), np.float32)


def _scene_beside(path: Path) -> Scene | None:
    """The scene that a folder of `gelsim render` keeps; without one that can be read the pictures are still good."""
    try:
        return load_scene(path / "scene.toml")
    except GelsimError:
        return None


def _checked(source: Source) -> Source:
    if source.recording.pictures.mean() < BLACK_LEVELS:
        raise LearnError(f"{source.name}: is black (mean level {source.recording.pictures.mean():.1f} of 255): no light, or no membrane")
    return source


def _folder(path: Path) -> Iterator[NDArray[np.uint8]]:
    inside = path / "frames" if (path / "frames").is_dir() else path
    files = sorted(file for file in inside.iterdir() if file.suffix.lower() in PICTURES)
    if not files:
        raise LearnError(f"{path}: holds no pictures ({', '.join(PICTURES)}), no frames/ and no dataset")
    for file in files:
        yield _picture(file)


def _rest_of(path: Path) -> Path | None:
    """The gel untouched in a result of `gelsim render`: its first frame, though a flat object may leave a dome plainer than it was."""
    first = path / "frames" / "0000.png"
    return first if first.is_file() and (path / "scene.toml").is_file() else None


def _picture(path: Path) -> NDArray[np.uint8]:
    from PIL import Image

    try:
        with Image.open(path) as image:
            if image.width * image.height > MOST_PIXELS:
                raise LearnError(f"{path}: {image.width} × {image.height} pixels; allowed are {MOST_PIXELS} in all")
            return np.array(image.convert("RGB"))
    except LearnError:
        raise
    except Exception as error:  # a stranger's file: whatever its reader says, the answer is the same
        raise LearnError(f"{path}: is no picture that can be read ({' '.join(str(error).split())[:150]})") from None


def _video(path: Path, start: float, seconds: float | None) -> Iterator[NDArray[np.uint8]]:
    import imageio_ffmpeg

    if not (np.isfinite(start) and start >= 0):
        raise LearnError(f"--start {start:g} s: allowed is 0 s or later")
    if seconds is not None and not 0 < seconds <= MOST_SECONDS:
        raise LearnError(f"--seconds {seconds:g} s: allowed is more than 0, up to {MOST_SECONDS:g} s")
    # A file may be a playlist: what it names must be files too.
    decoder = [imageio_ffmpeg.get_ffmpeg_exe(), "-nostdin", "-hide_banner", "-protocol_whitelist", "file"]
    window = ["-ss", f"{start:.3f}"] + ([] if seconds is None else ["-t", f"{seconds:.3f}"])
    source = ["-i", str(path.absolute())]
    try:
        about = subprocess.run([*decoder, *source], capture_output=True, timeout=HEADER_SECONDS).stderr.decode(errors="replace")
    except (OSError, subprocess.TimeoutExpired) as error:
        raise LearnError(f"{path}: the decoder did not answer ({type(error).__name__})") from None
    said = re.search(r"Duration: (\d+):(\d+):([\d.]+)", about)
    length = int(said[1]) * 3600 + int(said[2]) * 60 + float(said[3]) if said else 0.0
    if seconds is None and length - start > MOST_SECONDS:
        raise LearnError(
            f"{path}: lasts {_duration(length - start)}; a press lasts seconds, allowed are {MOST_SECONDS:g} s: "
            "cut it, or give --start and --seconds"
        )
    if "Video:" not in about:
        raise LearnError(f"{path}: is no video that can be read")
    # Portable pixmaps bear their size: nothing has to be known of the stream beforehand.
    pixmaps = ["-an", "-sn", "-dn", "-fps_mode", "passthrough", "-f", "image2pipe", "-c:v", "ppm", "-"]
    command = [*decoder, "-loglevel", "quiet", *window, *source, *pixmaps]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        assert process.stdout is not None
        try:
            while process.stdout.readline(8) == b"P6\n":
                width, height = map(int, process.stdout.readline(32).split())
                if width * height > MOST_PIXELS:
                    raise LearnError(f"{path}: {width} × {height} pixels; allowed are {MOST_PIXELS} in all")
                process.stdout.readline(8)
                content = process.stdout.read(width * height * 3)
                if len(content) == width * height * 3:
                    yield np.frombuffer(content, np.uint8).reshape(height, width, 3)
        finally:
            process.kill()


def _duration(seconds: float) -> str:
    return f"{seconds / 3600:.1f} h" if seconds >= 3600 else f"{seconds / 60:.1f} min"
