"""Frames of a video by ffmpeg, which scales and counts, so that memory is bounded whatever a file says; it may name no other file."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

VIDEOS = (".avi", ".mp4", ".mov", ".mkv", ".m4v", ".webm")
LONGEST_SECONDS, MOST_FRAMES, MOST_PIXELS = 60.0, 1800, 2**23
FFMPEG_SECONDS = 300.0


def video_size(path: Path) -> tuple[int, int]:
    """Width and height [px] of a video. Raises ValueError: in words, that it cannot be read."""
    import imageio_ffmpeg

    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-nostdin", "-hide_banner", "-protocol_whitelist", "file,pipe", "-i", f"file:{path}"]
    try:
        said = subprocess.run(command, capture_output=True, timeout=FFMPEG_SECONDS).stderr.decode(errors="replace")
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ValueError(f"ffmpeg did not read it ({type(error).__name__})") from None
    found = re.search(r"Video:.*?\b(\d{2,5})x(\d{2,5})\b", said)
    if not found:
        raise ValueError(f"cannot be read as a video ({(said.strip().splitlines() or ['no word of ffmpeg'])[-1]})")
    return int(found[1]), int(found[2])


def video_frames(path: Path, resolution: tuple[int, int], most: int = MOST_FRAMES) -> tuple[NDArray[np.uint8], float]:
    """The first frames (N, H, W, 3), `most` at most, at a width and height, and their rate [1/s].

    Raises:
        ValueError: In words, that there are fewer than two.
    """
    import imageio_ffmpeg

    width, height = resolution
    command = [
        imageio_ffmpeg.get_ffmpeg_exe(), "-nostdin", "-hide_banner", "-protocol_whitelist", "file,pipe", "-max_pixels", str(MOST_PIXELS),
        "-t", f"{LONGEST_SECONDS:g}", "-i", f"file:{path}", "-frames:v", f"{min(most, MOST_FRAMES)}",
        "-vf", f"scale={width}:{height}:flags=area",
        "-f", "rawvideo", "-pix_fmt", "rgb24", "-",
    ]  # fmt: skip
    try:
        done = subprocess.run(command, capture_output=True, timeout=FFMPEG_SECONDS)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ValueError(f"ffmpeg did not read it ({type(error).__name__})") from None
    said = done.stderr.decode(errors="replace")
    count = len(done.stdout) // (width * height * 3)
    if done.returncode or count < 2:
        lines = said.strip().splitlines()
        raise ValueError(f"cannot be read as a video of two or more frames ({lines[-1] if lines else 'no word of ffmpeg'})")
    rate = re.search(r"Video:.* ([\d.]+) fps", said)
    frames = np.frombuffer(done.stdout, np.uint8, count * width * height * 3).reshape(count, height, width, 3)
    return frames, float(rate[1]) if rate and float(rate[1]) > 0 else 30.0
