"""A photograph, wherever it lies, as the levels that are worked with: RGB on the sRGB scale, cut out or set upright.

A name is a picture's file (PNG, JPG, EXR), `FILE.npz:ARRAY:NUMBER` (`FILE.npz:ARRAY` of an array that holds one picture), or
`VIDEO:NUMBER`, a frame of it; numbers begin at 0. Four corners, clockwise from the top left, are those of a rectangle on the gel: what they
enclose is set upright by the one homography that takes it to a rectangle of square pixels. Left out: raw camera formats, pictures of 16
bits, which are read as 8.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gelsim.calibrate.lens import Lens
from gelsim.data.corners import Corners
from gelsim.data.video import MOST_FRAMES, VIDEOS, video_frames, video_size
from gelsim.errors import SceneError
from gelsim.optics.srgb import srgb_tone

Array = NDArray[np.float64]

SUFFIXES = (".png", ".jpg", ".jpeg", ".exr")
SIDE = (32, 4096)
"""Smallest and largest width and height [px]."""


@dataclass
class Reader:
    """Pictures of one folder, all read alike."""

    folder: Path
    linear: bool = False
    """Values are proportional to light; those of EXR files always are."""
    order: str = "rgb"
    crop: tuple[int, int, int, int] | None = None
    """Left, top, width and height [px] of what is kept."""
    corners: Corners | None = None
    lens: Lens | None = None
    """Its distortion is taken out; then nothing is cropped."""
    _open: dict[Path, NDArray] = field(default_factory=dict)

    @property
    def mm_per_px(self) -> float | None:
        """Of the picture that is set upright by corners whose size is known."""
        return self._upright.mm_per_px if self._upright else None

    def levels(self, name: str) -> Array:
        """Levels 0 … 255 on the sRGB scale, shape (H, W, 3).

        Raises:
            SceneError: It cannot be read, is too small or too large, or holds no number; the crop or a corner lies outside it.
        """
        values, linear = self._values(name)
        self._check_size(values, name)
        if not np.isfinite(values).all():
            raise SceneError(f"{self.folder / name}: holds values that are not finite")
        values = values[..., ::-1] if self.order == "bgr" else values
        levels = 255 * np.asarray(srgb_tone(values) if linear else values, np.float64)
        if self.lens is not None and self.corners is None and levels.shape[1::-1] == self.lens.size:
            levels = self.lens.straightened(levels)
        levels = self._cut(levels, name)
        self._check_size(levels, name)
        return levels

    def place(self, point: Array) -> Array:
        """(column, row) of the photograph [px] as (column, row) of the picture that is worked with, shape (2,)."""
        if self.lens is not None:
            point = self.lens.straight(np.asarray(point))
        if self._upright is not None:
            moved = np.linalg.inv(self._upright.homography) @ [*point, 1.0]
            return moved[:2] / moved[2]
        return point - self.crop[:2] if self.crop else point

    def scale(self, point: Array) -> float:
        """How many of its pixels are one of the photograph's there, on the mean over directions."""
        steps = np.array([[0.5, 0], [0, 0.5]])
        a, b = (self.place(point + step) - self.place(point - step) for step in steps)
        return float(np.sqrt(abs(a[0] * b[1] - a[1] * b[0])))

    def names_within(self, file: Path) -> list[str]:
        """Of an archive or a video, the names of all its pictures."""
        if file.suffix.lower() in VIDEOS:
            return [f"{file.name}:{index}" for index in range(len(self._video(file)))]
        names = []
        for key, array in self._archive(file).items():
            if array.ndim == 4:
                names += [f"{file.name}:{key}:{index}" for index in range(len(array))]
        return names

    @property
    def _upright(self) -> Corners | None:
        """The corners where a pinhole would have seen them."""
        if self.corners is None or self.lens is None:
            return self.corners
        return Corners(self.lens.straight(self.corners.places), self.corners.size_mm)

    # ---- from the file ----

    def _values(self, name: str) -> tuple[NDArray, bool]:
        """As they lie there, 0 … 1, shape (H, W, 3), and whether they are proportional to light."""
        path, _, inner = name.partition(":")
        suffix, file = Path(path).suffix.lower(), self.folder / path
        if suffix == ".npz":
            return self._of_archive(file, inner, name), self.linear
        if suffix in VIDEOS:
            return self._of_video(file, inner), self.linear
        try:
            if suffix == ".exr":
                import OpenEXR

                with OpenEXR.File(str(self.folder / name)) as opened:
                    parts = opened.channels().items()
                    return np.asarray(next(part for key, part in parts if key in ("RGB", "RGBA")).pixels, float)[..., :3], True
            from PIL import Image

            with Image.open(self.folder / name) as image:
                if not all(SIDE[0] <= side <= SIDE[1] for side in image.size):  # before it is decoded
                    return np.zeros((image.height, image.width, 1)), False
                return np.asarray(image.convert("RGB"), float) / 255, self.linear
        except Exception as error:  # Pillow and OpenEXR raise many kinds for a damaged file
            raise SceneError(f"{self.folder / name}: is not a picture that can be read ({type(error).__name__}: {error})") from None

    def _archive(self, file: Path) -> dict[str, NDArray]:
        try:
            with np.load(file, allow_pickle=False) as data:
                return {key: data[key] for key in data.files}
        except Exception as error:
            raise SceneError(f"{file}: is not an .npz file that can be read ({type(error).__name__}: {error})") from None

    def _of_archive(self, file: Path, inner: str, name: str) -> NDArray:
        key, _, number = inner.partition(":")
        if file not in self._open:
            self._open |= {file / key: array for key, array in self._archive(file).items()} | {file: np.zeros(0)}
        array = self._open.get(file / key)
        if array is None:
            known = ", ".join(sorted(path.name for path in self._open if path.parent == file))
            raise SceneError(f"{self.folder / name}: holds no array {key!r}; known are {known}: FILE.npz:ARRAY:NUMBER")
        if array.ndim == 4:
            array = array[_number(number, len(array), self.folder / name)]
        if array.ndim != 3 or array.shape[2] != 3 or array.dtype.kind not in "uf":
            said = f"is {array.dtype} of shape {array.shape}; allowed is (N, H, W, 3) or (H, W, 3), uint8 or float"
            raise SceneError(f"{self.folder / name}: {said}")
        return np.asarray(array, float) / (np.iinfo(array.dtype).max if array.dtype.kind == "u" else 1)

    def _of_video(self, file: Path, inner: str) -> NDArray:
        frames = self._video(file)
        return frames[_number(inner, len(frames), file)] / 255

    def _video(self, file: Path) -> NDArray:
        if file not in self._open:
            try:
                size = video_size(file)
                bytes_each = 3 * size[0] * size[1]
                self._open[file] = video_frames(file, size, min(MOST_FRAMES, max(2 * 10**9 // bytes_each, 2)))[0]
            except ValueError as error:
                raise SceneError(f"{file}: {error}") from None
        return self._open[file]

    def _check_size(self, values: NDArray, name: str) -> None:
        height, width = values.shape[:2]
        if not (SIDE[0] <= width <= SIDE[1] and SIDE[0] <= height <= SIDE[1]):
            raise SceneError(f"{self.folder / name}: is {width} x {height} px; allowed are {SIDE[0]} … {SIDE[1]} px a side")

    # ---- to the picture that is worked with ----

    def _cut(self, levels: Array, name: str) -> Array:
        height, width = levels.shape[:2]
        if self.corners is not None:
            for column, row in self.corners.places:
                if not (0 <= column <= width and 0 <= row <= height):
                    raise SceneError(f"corners_px: {column:g} {row:g} lies outside {name}, which is {width} x {height} px")
            return self._set_upright(levels)
        if self.crop:
            left, top, wide, high = self.crop
            if left + wide > width or top + high > height:
                said = f"crop_px = {left} {top} {wide} {high} (left, top, width, height)"
                raise SceneError(f"{said} reaches beyond {name}, which is {width} x {height} px")
            return levels[top : top + high, left : left + wide]
        return levels

    def _set_upright(self, levels: Array) -> Array:
        from scipy.ndimage import map_coordinates

        upright = self._upright
        assert upright is not None
        wide, high = upright.size
        row, column = np.mgrid[:high, :wide] + 0.5
        x, y, w = np.einsum("ij,jhw->ihw", upright.homography, np.stack([column, row, np.ones_like(row)]))
        seen = np.stack([x / w, y / w], axis=-1)
        seen = self.lens.seen(seen) if self.lens else seen
        at = np.stack([seen[..., 1] - 0.5, seen[..., 0] - 0.5])
        return np.stack([np.clip(map_coordinates(levels[..., c], at, order=3, mode="nearest"), 0, 255) for c in range(3)], axis=-1)


def _number(text: str, count: int, where: Path) -> int:
    if not re.fullmatch(r"\d+", text) or int(text) >= count:
        raise SceneError(f"{where}: {text!r} is no number of a picture there; allowed is 0 … {count - 1}")
    return int(text)
