"""How the pictures of a video show the gel: what is kept of them, set upright, and its scale.

The networks know presses in pictures FIELD_MM wide and high. Of pictures whose scale is told, that much is cut out around the contact;
what a smaller picture lacks is filled with its border, in which nothing changes. Without a scale the whole picture is taken for FIELD_MM.
A border that is black, or of one colour, is found and cut off. Left out: finding the gel in other surroundings, or the scale in the
pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gelsim.data.corners import Corners, check_corners
from gelsim.errors import SceneError
from learn.config import InputConfig, LearnError
from learn.frames import as_wide, averaged, change_signal, levels_of
from learn.recordings import Recording

FIELD_MM = (18.4, 13.8)
"""Of the sensor in the plans that the shipped networks are trained on, of which training cuts out 85 to 100 %."""
CORNERS_MM = "--corners-mm is the size of the rectangle of --corners, in place of --mm-per-px"
SCALES = (1e-3, 1.0)
"""Of mm_per_px."""
DARK, EVEN, MOST, THICK = 24, 6, 0.95, 0.02
"""Level that no pixel of a black border exceeds; by how many one of another colour varies, but for what a codec leaves of the gel's edge,
and for how much of it; and the share of the picture's side below which a border is left. No first frame of 152 real videos and none of 67
photographs (hand_presses and others) loses anything by these."""
FIELDS_MM = (4.0, 200.0)
"""Widths of what is kept: of less a press cannot be told, more is no tactile sensor."""


@dataclass(frozen=True, eq=False)
class Framing:
    """What of each frame is the gel, and how large that is.

    Args:
        crop: Left, top, width and height [px] of what is kept.
        corners: Of a rectangle on the gel, which is set upright.
        mm_per_px: Of the frames, or of what is cut out; not where the corners say it.
    """

    crop: tuple[int, int, int, int] | None = None
    corners: Corners | None = None
    mm_per_px: float | None = None

    def __post_init__(self) -> None:
        """Raises LearnError: They do not go together, or are none."""
        if self.crop and self.corners is not None:
            raise LearnError("--crop and --corners exclude each other: corners cut out too")
        if self.crop and (min(self.crop[:2]) < 0 or min(self.crop[2:]) <= 0):
            said = " ".join(map(str, self.crop))
            raise LearnError(f"--crop {said}: left and top are 0 px or more, width and height more than 0 px")
        size_mm = self.corners.size_mm if self.corners else None
        if size_mm and self.mm_per_px is not None:
            raise LearnError(CORNERS_MM)
        if size_mm and not all(0.0 < side <= FIELDS_MM[1] for side in size_mm):
            said = " ".join(f"{side:g}" for side in size_mm)
            raise LearnError(f"--corners-mm {said} mm: allowed is more than 0 mm, up to {FIELDS_MM[1]:g} mm")
        if self.mm_per_px is not None and not SCALES[0] <= self.mm_per_px <= SCALES[1]:
            raise LearnError(f"--mm-per-px {self.mm_per_px:g}: allowed is {SCALES[0]:g} … {SCALES[1]:g} (a picture {FIELD_MM[0]:g} mm wide "
                             f"of 640 px has {FIELD_MM[0] / 640:.3g})")  # fmt: skip
        if self.corners is not None:
            try:
                check_corners(self.corners.places, "--corners")
            except SceneError as error:
                raise LearnError(str(error)) from None

    def kept(self, frame: NDArray[np.uint8], name: str) -> NDArray[np.uint8]:
        """What is kept of a frame (H, W, 3).

        Raises:
            LearnError: The frame does not reach so far.
        """
        height, width = frame.shape[:2]
        if self.crop:
            left, top, wide, high = self.crop
            if left + wide > width or top + high > height:
                raise LearnError(f"--crop {left} {top} {wide} {high} reaches beyond {name}, which is {width} x {height} px")
            return frame[top : top + high, left : left + wide]
        if self.corners is None:
            return frame
        if not ((self.corners.places >= 0) & (self.corners.places <= [width, height])).all():
            raise LearnError(f"--corners: one lies outside {name}, which is {width} x {height} px")
        from PIL import Image

        coefficients = self.corners.homography.ravel()[:8].tolist()
        upright = Image.fromarray(frame).transform(self.corners.size, Image.Transform.PERSPECTIVE, coefficients, Image.Resampling.BILINEAR)
        return np.asarray(upright)

    @property
    def scale(self) -> float | None:
        """Millimetres of a pixel of what is kept, None where it is not known."""
        return self.corners.mm_per_px if self.corners and self.corners.size_mm else self.mm_per_px

    def outlined(self, frame: NDArray[np.uint8]) -> Framing:
        """With the border of a frame (H, W, 3), black or all of one colour, cut off, where nothing says what to keep and there is one."""
        if self.crop or self.corners is not None:
            return self
        dark = frame.max(axis=2) <= DARK
        spans = []
        for axis, last in ((0, frame[0, -1]), (1, frame[-1, 0])):
            size = frame.shape[1 - axis]
            begin, end = _border(frame, dark, frame[0, 0], axis), size - _border(frame[::-1, ::-1], dark[::-1, ::-1], last, axis)
            if begin >= end:
                return self
            spans.append((begin, end) if max(begin, size - end) > THICK * size else (0, size))
        (left, right), (top, bottom) = spans
        whole = (right - left, bottom - top) == frame.shape[1::-1]
        return self if whole else replace(self, crop=(left, top, right - left, bottom - top))

    def check_field(self, kept: NDArray[np.uint8], name: str) -> None:
        """Raises LearnError: What is kept of a frame is too small or too large to be a sensor's."""
        if self.scale is None:
            return
        wide, high = kept.shape[1] * self.scale, kept.shape[0] * self.scale
        if not all(FIELDS_MM[0] <= side <= FIELDS_MM[1] for side in (wide, high)):
            allowed = f"allowed is {FIELDS_MM[0]:g} … {FIELDS_MM[1]:g} mm a side"
            raise LearnError(f"{name}: {kept.shape[1]} x {kept.shape[0]} px of {self.scale:g} mm are {wide:.3g} x {high:.3g} mm; {allowed}")


def _border(frame: NDArray[np.uint8], dark: NDArray[np.bool_], corner: NDArray[np.uint8], axis: int) -> int:
    """How many of a frame's first columns (`axis` 0) or rows are black, or of the corner's colour up to where that jumps along most of the
    line: where an even part of the gel ends, shading or a dent begins."""
    lines = np.moveaxis(frame.astype(int), 1 - axis, 0)
    even = np.moveaxis(dark, 1 - axis, 0) | (np.abs(lines - corner) <= EVEN).all(axis=2)
    outside = dark.all(axis=axis), even.mean(axis=1) > MOST
    black, coloured = (int(np.argmin(np.append(lines_outside, False))) for lines_outside in outside)
    if 0 < coloured < len(lines) - 1:
        jump = np.abs(lines[coloured + 1] - lines[coloured - 1]).max(axis=1)
        if (jump > EVEN).mean() > 0.5:
            return coloured
    return black


def at_scale(kept: NDArray, picture: tuple[int, int], scale: float, centre: tuple[float, float]) -> NDArray[np.uint16]:
    """The network's picture (rows, columns) of FIELD_MM of what is kept of a frame, as `learn.frames.fit_picture` gives it of all.

    Args:
        scale: Millimetres of a pixel of what is kept.
        centre: Of what is cut out, (x, y) as shares of its sides.
    """
    kept = as_wide(kept, picture)
    per_mm = picture[0] / FIELD_MM[1], picture[1] / FIELD_MM[0]
    rows, columns = (max(round(side * scale * density), 1) for side, density in zip(kept.shape, per_mm, strict=False))
    whole = averaged(kept, (rows, columns))
    return whole[np.ix_(_span(rows, picture[0], centre[1]), _span(columns, picture[1], centre[0]))]


def shown_mm(field: Sequence[float], picture: tuple[int, int]) -> float:
    """Width [mm] of the network's picture of a camera's that shows `field` [mm], as `learn.frames.fit_picture` cuts it."""
    wide, high = sorted(field, reverse=True) if picture[1] > picture[0] else field
    return min(wide, high * picture[1] / picture[0])


def signal_to_scale(signal: NDArray[np.float64], field: Sequence[float] | None, inputs: InputConfig) -> NDArray[np.float64]:
    """Intensity changes of pictures that show `field` [mm] as those of FIELD_MM have them, where what changes is within both."""
    return signal if field is None else signal * (shown_mm(field, inputs.picture) / FIELD_MM[0]) ** 2


def to_scale(recording: Recording, field: Sequence[float] | None, inputs: InputConfig) -> Recording:
    """A recording of pictures that show `field` [mm], at the network's scale around its contact; as it is where the field is not known."""
    if field is None:
        return recording
    scale = shown_mm(field, inputs.picture) / inputs.picture[1]
    if abs(scale * inputs.picture[1] / FIELD_MM[0] - 1) < 1e-3:
        return replace(recording, scaled=True)
    centre = contact_centre(recording.pictures, recording.background, recording.signal, inputs.deadband_levels)

    def seen(picture: NDArray[np.float32]) -> NDArray[np.float32]:
        return levels_of(at_scale(picture.clip(0, 255), inputs.picture, scale, centre))

    pictures, background = np.stack([seen(picture) for picture in recording.pictures]), seen(recording.background)
    signal = change_signal(pictures, background, inputs.deadband_levels)
    return replace(recording, background=background, pictures=pictures, signal=signal, scaled=True)


def _span(length: int, size: int, centre: float) -> NDArray[np.intp]:
    """`size` of the indices 0 … `length` - 1 about a place; where there are fewer, all in the middle and their ends repeated."""
    begin = int(np.clip(round(centre * length - size / 2), 0, length - size)) if size < length else (length - size) // 2
    return np.clip(np.arange(begin, begin + size), 0, length - 1)


def contact_centre(
    pictures: NDArray[np.floating], empty: NDArray[np.floating], signal: NDArray[np.floating], deadband: float
) -> tuple[float, float]:
    """Where pictures (N, h, w, 3) of a press have changed most, (x, y) as shares of the sides: the centre of the largest change's."""
    change = np.maximum(np.abs(pictures[int(np.argmax(signal))] - empty) - deadband, 0.0).sum(axis=2)
    if not change.any():
        return 0.5, 0.5
    across, down = (float(((np.arange(len(part)) + 0.5) * part).sum() / part.sum() / len(part)) for part in (change.sum(0), change.sum(1)))
    return across, down
