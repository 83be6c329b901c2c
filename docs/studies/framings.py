"""Is a press read alike however its video is framed? Real videos as they are, and the same in a border, oblique, halved, cut, begun late.

    python docs/studies/framings.py FOLDER --mm-per-px 0.058 [--sensor gelsight_mini] [--videos 24]

Each framing is read as it comes, and told of: by crop, corners and scale. Prints how far the readings lie from those as it is, and how
many gave none. Three are of other times: a video that begins at its largest change, lets go and then shows the press, one that shows it
twice, and one of which two thirds of the frames are lost.
"""

import argparse
from collections.abc import Callable, Iterable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image

from gelsim.data.corners import Corners
from learn.framing import Framing
from learn.predict import find_models, predict
from learn.video import _video  # pyright: ignore[reportPrivateUsage]

EVERY = 3  # frames: as much as the network chooses from, in a third of the time
BORDER = (60, 80), (100, 40)  # above and below, left and right [px]
ASIDE = Corners(np.array([[60.0, 40.0], [400.0, 70.0], [380.0, 330.0], [90.0, 310.0]]))  # corners of the picture in one of 480 x 380 px

TOUCHED, TWICE, LOST = "begun in contact", "shown twice", "two frames of three lost"


def oblique(frame: np.ndarray) -> np.ndarray:
    """The frame as a camera sees it that looks from aside."""
    height, width = frame.shape[:2]
    wide, high = ASIDE.size
    back = np.linalg.inv(ASIDE.homography @ np.diag([wide / width, high / height, 1.0]))
    coefficients = (back / back[2, 2]).ravel()[:8].tolist()
    return np.asarray(Image.fromarray(frame).transform((480, 380), Image.Transform.PERSPECTIVE, coefficients, Image.Resampling.BICUBIC))


def framings(size: tuple[int, int], mm: float, contact: int) -> list[tuple[str, Callable[[np.ndarray], np.ndarray], Framing]]:
    """How a frame of so many columns and rows, with the contact in a column, is changed, and what is told of it."""
    width, height = size
    (above, below), (left, right) = BORDER

    def bordered(frame: np.ndarray, level: int = 90) -> np.ndarray:
        return np.pad(frame, ((above, below), (left, right), (0, 0)), constant_values=level)

    def framed(frame: np.ndarray) -> np.ndarray:
        whole, grain = bordered(frame), np.random.default_rng(0).integers(-30, 31, (height + above + below, width + left + right, 1))
        within = np.pad(np.ones(frame.shape[:2], bool), ((above, below), (left, right)))
        return np.where(within[..., None], whole, whole + grain).astype(np.uint8)

    def halved(frame: np.ndarray) -> np.ndarray:
        return np.asarray(Image.fromarray(frame).resize((width // 2, height // 2), Image.Resampling.BOX))

    def cut(frame: np.ndarray) -> np.ndarray:
        return frame[height // 8 : -height // 8, width // 8 : -width // 8]

    def at_its_border(frame: np.ndarray) -> np.ndarray:
        return frame[:, contact:] if contact < width // 2 else frame[:, :contact]

    crop, corners = (left, above, width, height), Corners(ASIDE.places, (width * mm, height * mm))
    return [
        ("in a grey border, which is found", bordered, Framing()),
        ("in a black border, which is found", lambda frame: bordered(frame, 0), Framing()),
        ("in a border with grain", framed, Framing()),
        ("in a border with grain, --crop", framed, Framing(crop=crop)),
        ("in a border with grain, --crop --mm-per-px", framed, Framing(crop=crop, mm_per_px=mm)),
        ("in a border with grain, --mm-per-px", framed, Framing(mm_per_px=mm)),
        ("oblique", oblique, Framing()),
        ("oblique, --corners --corners-mm", oblique, Framing(corners=corners)),
        ("of half the pixels, --mm-per-px", halved, Framing(mm_per_px=2 * mm)),
        ("three quarters of it", cut, Framing()),
        ("three quarters of it, --mm-per-px", cut, Framing(mm_per_px=mm)),
        ("half of the contact, at the border", at_its_border, Framing()),
        ("half of the contact, at the border, --mm-per-px", at_its_border, Framing(mm_per_px=mm)),
        (TOUCHED, np.asarray, Framing()),
        (TWICE, np.asarray, Framing()),
        (LOST, np.asarray, Framing()),
    ]


def read(frames: Iterable[np.ndarray], framing: Framing, sensor: str | None) -> float:
    """What the shipped networks read from frames [Shore 00]; NaN: nothing."""
    with TemporaryDirectory() as folder:
        for number, frame in enumerate(frames):
            Image.fromarray(np.ascontiguousarray(frame)).save(Path(folder) / f"{number:04d}.png", compress_level=1)
        (answer,) = predict(find_models(["default"]), [Path(folder)], framing=framing, sensor=sensor, device="cpu")
    return answer.get("shore_00", np.nan)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--mm-per-px", type=float, required=True)
    parser.add_argument("--sensor")
    parser.add_argument("--videos", type=int, default=24)
    options = parser.parse_args()
    files = sorted(path for path in options.folder.iterdir() if path.suffix.lower() in (".mov", ".mp4", ".avi", ".mkv"))
    files = [files[int(place)] for place in np.linspace(0, len(files) - 1, min(options.videos, len(files)))]
    away: dict[int, list[float]] = {}
    names: list[str] = []
    for file in files:
        frames = list(_video(file, 0.0, None))[::EVERY]
        found = []
        peak = int(np.argmax([np.abs(frame.astype(float) - frames[0]).mean() for frame in frames]))
        changed = np.maximum(np.abs(frames[peak].astype(float) - frames[0]).mean(axis=2) - 5.0, 0.0).sum(axis=0)
        kinds = framings(frames[0].shape[1::-1], options.mm_per_px, int(np.average(np.arange(len(changed)), weights=changed)))
        names = [name for name, _, _ in kinds]
        kept = [frame for frame, chance in zip(frames, np.random.default_rng(0).random(len(frames)), strict=True) if chance < 1 / 3]
        orders = {TOUCHED: frames[peak:] + frames, TWICE: frames + frames, LOST: frames[:1] + kept}
        for name, change, framing in [("as it is", np.asarray, Framing()), *kinds]:
            found.append(read(map(change, orders.get(name, frames)), framing, options.sensor))
        for number, reading in enumerate(found[1:]):
            away.setdefault(number, []).append(abs(reading - found[0]))
        print(f"{file.name}: {found[0]:.1f}; " + ", ".join(f"{reading:.1f}" for reading in found[1:]), flush=True)
    print("\n| framing, and what is told | median [Shore 00] | 90 % | no reading |\n|---|---|---|---|")
    for number, name in enumerate(names):
        none = int(np.isnan(away[number]).sum())
        print(f"| {name} | {np.nanmedian(away[number]):.1f} | {np.nanpercentile(away[number], 90):.1f} | {none} |")


if __name__ == "__main__":
    main()
