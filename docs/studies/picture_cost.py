"""What a picture costs by WebP's settings: milliseconds of one core to write and to read, and kilobytes, over frames of a dataset.

    python docs/studies/picture_cost.py assets/mini

All are lossless; every fifth frame of some episodes is taken, without those that are equal to the one before.
"""

from __future__ import annotations

import argparse
import io
import time
from pathlib import Path

import numpy as np
from PIL import Image

from gelsim.data.episodes import load_dataset

SETTINGS = ((0, 20), (1, 20), (1, 40), (2, 40), (3, 40), (4, 75))
"""method, quality: of effort, for all is kept."""


def main(folder: Path, episodes: int = 6) -> list[dict[str, float]]:
    """Rows: method, quality, ms to write, ms to read, kilobytes, each a mean over frames."""
    data, frames = load_dataset(folder), []
    for position in range(0, len(data), max(len(data) // episodes, 1)):
        drawn = data.read(position).frames
        frames += [drawn[i] for i in range(1, len(drawn), 5) if (drawn[i] != drawn[i - 1]).any()]
    rows = []
    for method, quality in SETTINGS:
        start, files = time.process_time(), []
        for frame in frames:
            buffer = io.BytesIO()
            Image.fromarray(frame).save(buffer, format="WEBP", lossless=True, exact=True, method=method, quality=quality)
            files.append(buffer.getvalue())
        middle = time.process_time()
        read = [np.array(Image.open(io.BytesIO(file))) for file in files]
        end = time.process_time()
        assert all(np.array_equal(one, other) for one, other in zip(read, frames, strict=True))
        each = 1e3 / len(frames)
        rows.append({
            "method": method, "quality": quality, "write_ms": round((middle - start) * each, 1), "read_ms": round((end - middle) * each, 1),
            "kilobytes": round(sum(map(len, files)) * each / 1e6, 1),
        })  # fmt: skip
        print(rows[-1], flush=True)
    return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset", type=Path)
    main(parser.parse_args().dataset)
