"""What people look at: photographs beside predictions, what is left between them, and where the fit began."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

MOST_ROWS = 6
"""Presses shown."""
PIXELS = 320
"""Width of a tile."""
GAIN = 4.0
"""Residuals are shown magnified, about grey."""


def draw_comparison(path: Path, columns: Sequence[tuple[str, Sequence[NDArray]]], captions: Sequence[str]) -> None:
    """Tiles: a column of pictures under each title, a caption beside each row."""
    _tiles(path, columns, captions)


def residuals(photos: Sequence[NDArray], predicted: Sequence[NDArray]) -> list[NDArray]:
    """Photograph minus prediction, times GAIN about grey."""
    return [np.clip(128 + GAIN * (np.asarray(a, float) - b), 0, 255) for a, b in zip(photos, predicted, strict=True)]


def draw_residuals(path: Path, photos: Sequence[NDArray], predicted: Sequence[NDArray], captions: Sequence[str]) -> None:
    """Photograph minus prediction, times GAIN about grey, and its size over all colours."""
    sizes = [
        np.repeat(np.clip(GAIN * np.abs(np.asarray(a, float) - b).mean(axis=2, keepdims=True), 0, 255), 3, axis=2)
        for a, b in zip(photos, predicted, strict=True)
    ]
    _tiles(
        path,
        ((f"photograph - prediction, x {GAIN:g}", residuals(photos, predicted)), (f"mean of |difference|, x {GAIN:g}", sizes)),
        captions,
    )


def _tiles(path: Path, columns: Sequence[tuple[str, Sequence[NDArray]]], captions: Sequence[str]) -> None:
    from PIL import Image, ImageDraw

    height, width = columns[0][1][0].shape[:2]
    tile = (PIXELS, round(PIXELS * height / width))
    head, foot = 18, 16
    sheet = Image.new("RGB", (len(columns) * (tile[0] + 4), head + len(captions) * (tile[1] + foot)), "white")
    pen = ImageDraw.Draw(sheet)
    for i, (title, pictures) in enumerate(columns):
        pen.text((i * (tile[0] + 4) + 2, 3), title, fill="black")
        for j, picture in enumerate(pictures):
            image = Image.fromarray(np.rint(np.clip(picture, 0, 255)).astype(np.uint8))
            sheet.paste(image.resize(tile, Image.Resampling.BILINEAR), (i * (tile[0] + 4), head + j * (tile[1] + foot)))
    for j, caption in enumerate(captions):
        pen.text((2, head + j * (tile[1] + foot) + tile[1] + 2), caption, fill="black")
    sheet.save(path, format="PNG")
