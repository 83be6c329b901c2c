"""`gelsim dataset --real DIR`: recordings of a real sensor, in the schema of the simulated ones.

A press is a video, or a folder of pictures in the order of their names. Labels come from `labels.csv` beside them (columns: file, and any
of COLUMNS), and where there is none from the file's name, SHAPE[RADIUS]_HH_NUMBER, HH the Shore 00 reading, as the recordings of the 2017
paper are named; a folder whose name has "robot" in it was made by the robot. Frames are numbered from 0.

*The press in it.* c(t) = mean |frame - no-contact frame| over blocks of BLOCK × BLOCK pixels (noise averages out) and channels. The
no-contact frame, unless given, is the first one after which little changes for QUIET frames; the press begins where c exceeds BEGUN of its
largest value, less LEAD frames, and ends where c is largest, as the paper chose its frames. A recording in which c stays below LEAST is
listed as a failure.

Left out: scale and distortion of the camera, place of markers (K = 0): `gelsim calibrate` is for that.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.data.episodes import MOST_CLASSES, SHORE_00, episode_file, gel_facts, survey, write_episode, write_meta
from gelsim.data.video import MOST_FRAMES, MOST_PIXELS, VIDEOS, video_frames
from gelsim.errors import MaterialError, SceneError
from gelsim.generate.plan import SPLITS
from gelsim.results import Episode
from gelsim.scene import materials
from gelsim.scene.layers import build_scene
from gelsim.scene.shape_table import SHAPES
from gelsim.tables import read_csv

PICTURES = (".png", ".jpg", ".jpeg", ".bmp")
KEPT = 60
"""Frames of an episode at most: the last ones up to the peak."""
LEAD, QUIET = 2, 3
BLOCK = 8
BEGUN, CALM, LEAST = 0.05, 0.5, 1.0
"""Share of the largest change from which on a press has begun; mean changes [levels of 255] of what stands still, and of a press."""
HARDNESS = ("shore_00", "shore_a", "modulus_kpa", "shore_00_low", "shore_00_high", "hardness_class")
"""How hard an object is, by one of these; a class is a whole number, 0 the softest, and bounds may be one or two."""
COLUMNS = ("file", "object", "group", "shape", "radius_mm", *HARDNESS, "rigid", "motion", "force_n", "no_contact", "first", "last", "split")

Progress = Callable[[str, int, int], None]


def convert(
    source: Path, out: Path, *, resolution: tuple[int, int] = (320, 240), sensor: str | None = None, resume: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Converts a folder of recordings; returns what the command reports.

    Args:
        sensor: That took them, a preset or the path of a sensor file, from which rows have their gel; None: it is not known.
    Raises:
        SceneError: There is nothing to convert, labels.csv is wrong, or the folder cannot be used. DatasetError: it cannot be written.
    """
    if not source.is_dir():
        raise SceneError(f"--real {source}: is no folder")
    if out.exists() and (not out.is_dir() or any(out.iterdir())) and not resume:
        raise SceneError(f"--out {out}: is not empty; give --resume to go on, or another name")
    items = list(_recordings(source))
    if not items:
        raise SceneError(f"--real {source}: holds no videos ({', '.join(VIDEOS)}) and no folders of pictures")
    info = {
        "domain": "real", "fps": 30.0, "resolution": list(resolution), "noise": "own", "plan": None, "seed": None,
        "recordings": len(items),
    }  # fmt: skip
    eye = {"sensor": "real"} if sensor is None else _eye(sensor)
    done = {row["index"] for row in survey(out).rows} if resume else set()
    failures = []
    splits = _splits([labels for _, labels in items])
    for index, (path, labels) in enumerate(items):
        if index not in done:
            try:
                episode = read_recording(path, labels, index, resolution, eye, splits[index])
                write_episode(out, episode)
            except _Unusable as problem:
                failures.append({"index": index, "seed": None, "status": "UNUSABLE", "message": f"{path.relative_to(source)}: {problem}"})
        if progress:
            progress("recordings", index + 1, len(items))
    found = survey(out)
    write_meta(out, info, found, failures, {name: [row["index"] for row in found.rows if row.get("split") == name] for name in SPLITS})
    counts = {name: sum(row.get("split") == name for row in found.rows) for name in SPLITS}
    return {
        "out": str(out), "episodes": len(found.rows), "asked": len(items), "failed": len(failures), "failures": failures[:20],
        "splits": counts, "exit_code": 4 if len(failures) > 0.01 * len(items) else 0,
    }  # fmt: skip


def summary(report: dict[str, Any]) -> str:
    """A report in a few lines for people."""
    lines = [f"{report['out']}: {report['episodes']} of {report['asked']} recordings"]
    lines += [f"not used: {row['message']}" for row in report["failures"]]
    return "\n".join(lines)


def _eye(sensor: str) -> dict[str, Any]:
    """What rows say of the sensor: its name, without the folder it lies in, and its gel."""
    return {"sensor": Path(sensor).stem, "gel": gel_facts(build_scene({"sensor": {"preset": sensor}}).gel)}


class _Unusable(Exception):
    """A recording that shows no press, or cannot be read."""


# ---- what there is ----


def _recordings(source: Path) -> Iterator[tuple[Path, dict[str, Any]]]:
    table = _labels(source)
    if table is not None:
        for name, labels in table.items():
            yield source / name, labels
        return
    for path in sorted(source.rglob("*")):
        if path.is_file() and path.suffix.lower() in VIDEOS:
            yield path, labels_of_name(path.stem, "robot" in str(path.parent.relative_to(source)).lower())
        elif path.is_dir() and any(item.suffix.lower() in PICTURES for item in path.iterdir()):
            yield path, labels_of_name(path.name, "robot" in str(path.relative_to(source).parent).lower())


def labels_of_name(name: str, robot: bool = False) -> dict[str, Any]:
    """What SHAPE[RADIUS]_HH_NUMBER says. A shape of the table is group 1, another one with a hardness group 4, without one group 5."""
    fields = name.split("_")
    match = re.fullmatch(r"([A-Za-z-]+?)-?(\d+(?:\.\d+)?)?(?:mm)?", fields[0])
    word, radius = (match[1].lower(), match[2]) if match else (fields[0].lower(), None)
    hardness = float(fields[1]) if len(fields) > 1 and re.fullmatch(r"\d{2}", fields[1]) else None
    simple = next((name for name, row in SHAPES.items() if word.startswith(row.recorded_as)), None)
    shape, group = (simple, 1) if simple else (word or "unknown", 5 if hardness is None else 4)
    return {
        "object": "-".join(fields[:2]) if hardness is not None else fields[0], "group": group, "shape": shape,
        "radius_mm": float(radius) if radius else None, "shore_00": hardness, "rigid": False, "motion": "robot" if robot else "human",
    }  # fmt: skip


def _labels(source: Path) -> dict[str, dict[str, Any]] | None:
    path = source / "labels.csv"
    if not path.exists():
        return None
    _, rows = read_csv(path, known=COLUMNS)
    table: dict[str, dict[str, Any]] = {}
    for number, row in enumerate(rows, start=2):
        name = row["file"] or ""
        target = (source / name).resolve()
        if not name or not target.is_relative_to(source.resolve()) or not target.exists():
            raise SceneError(f"{path}: line {number}: file = {name!r}: there is no such recording in {source}")
        try:
            table[name] = _cells(row, labels_of_name(Path(name).stem, "robot" in name.lower()))
        except ValueError as error:
            raise SceneError(f"{path}: line {number}: {error}") from None
    return table


def _cells(row: dict[str, Any], labels: dict[str, Any]) -> dict[str, Any]:
    """Cells that say something, over what the file's name said."""
    numbers = {"radius_mm": float, "force_n": float, "group": int, "no_contact": int, "first": int, "last": int}
    for key, kind in numbers.items():
        if row.get(key):
            labels[key] = kind(row[key])
    labels |= _hardness({key: float(row[key]) for key in HARDNESS if row.get(key)})
    if not 1 <= labels["group"] <= 5:
        raise ValueError(f"group = {labels['group']}: allowed is 1 … 5")
    for key in ("object", "shape"):
        labels[key] = row.get(key) or labels[key]
    for key, allowed in (("rigid", ("true", "false")), ("motion", ("human", "robot")), ("split", SPLITS)):
        if row.get(key):
            if row[key] not in allowed:
                raise ValueError(f"{key} = {row[key]!r}: allowed are {', '.join(allowed)}")
            labels[key] = row[key] == "true" if key == "rigid" else row[key]
    if labels["rigid"]:
        labels["shore_00"] = None
    return labels


def _hardness(told: dict[str, float]) -> dict[str, Any]:
    """What a row keeps of one kind of `HARDNESS`: Shore 00, bounds of it, or a class; of another scale that reading too."""
    bounds = {name.removeprefix("shore_00_"): value for name, value in told.items() if name.startswith("shore_00_")}
    if len(told) - len(bounds) + bool(bounds) > 1:
        raise ValueError(f"{', '.join(sorted(told))}: give one of them (shore_00_low and shore_00_high are one)")
    for name, value in told.items():
        if name.startswith("shore_00") and not SHORE_00[0] <= value <= SHORE_00[1]:
            raise ValueError(f"{name} = {value:g}: allowed is {SHORE_00[0]} … {SHORE_00[1]}")
    if bounds:
        low, high = bounds.get("low"), bounds.get("high")
        if low is not None and high is not None and low >= high:
            raise ValueError(f"shore_00_low = {low:g}: must be below shore_00_high = {high:g}")
        return {"shore_00": None, "shore_00_range": [low, high]}
    if "hardness_class" in told:
        rank = told["hardness_class"]
        if rank not in range(MOST_CLASSES):
            raise ValueError(f"hardness_class = {rank:g}: allowed are whole numbers, 0 (the softest) … {MOST_CLASSES - 1}")
        return {"shore_00": None, "hardness_class": int(rank)}
    if "shore_a" in told:
        return {"shore_a": told["shore_a"]} | _by_modulus(materials.modulus_from_shore_a(told["shore_a"]))
    if "modulus_kpa" in told:
        return {"modulus_kpa": told["modulus_kpa"]} | _by_modulus(told["modulus_kpa"] * 1e3)
    return told


def _by_modulus(modulus: float) -> dict[str, Any]:
    """Shore 00 of a silicone of a Young's modulus [Pa]; above the scale that it is above, below likewise."""
    low, high = materials.SHORE_00_RANGE
    try:
        return {"shore_00": materials.shore_00_from_modulus(modulus)}
    except MaterialError:
        over = modulus > materials.modulus_from_shore_00(high)
        return {"shore_00": None, "shore_00_range": [high, None] if over else [None, low]}


def _splits(labels: list[dict[str, Any]]) -> list[str]:
    """Rows of the paper: every fourth hardness is held out, a tenth of the other objects validates; an object's presses stay together."""
    levels = sorted({item["shore_00"] for item in labels if item["shore_00"] is not None and item["group"] in (1, 2)})
    held = set(levels[2::4])
    found = []
    for item in labels:
        rows = {3: "vessels", 4: "complicated", 5: "natural"}
        share = int(hashlib.sha256(item["object"].encode()).hexdigest()[:8], 16) / 2**32
        split = rows.get(item["group"]) or ("novel_hardness" if item["shore_00"] in held else "validation" if share < 0.1 else "train")
        if item["motion"] == "robot" and item["group"] in (1, 2):
            split = "robot"
        found.append(item.get("split") or split)
    return found


# ---- one recording ----


def read_recording(path: Path, labels: dict[str, Any], index: int, resolution: tuple[int, int], eye: dict[str, Any], split: str) -> Episode:
    """The press in a recording; `eye`: fields of its row that say which sensor saw it."""
    frames, fps = _video(path, resolution) if path.is_file() else _pictures(path, resolution)
    first, last, quiet = find_press(frames, labels.get("no_contact"), labels.get("first"), labels.get("last"))
    shown = frames[first : last + 1]
    count = len(shown)
    row = {
        "index": index, **{key: labels[key] for key in ("object", "group", "shape", "radius_mm", "shore_00", "rigid", "motion")},
        **{key: labels[key] for key in ("shore_a", "modulus_kpa", "shore_00_range", "hardness_class") if key in labels},
        "domain": "real", "frames": count, "peak_force_n": labels.get("force_n"), "mechanics": f"real-{index:06d}", **eye,
        "file": episode_file(index), "split": split, "source": path.name,
    }  # fmt: skip
    unknown = np.full(count, np.nan)
    return Episode(shown, frames[quiet], np.arange(count) / fps, unknown, np.full((count, 3), np.nan), np.zeros((count, 0, 2)), row)


def find_press(
    frames: NDArray[np.uint8], no_contact: int | None = None, first: int | None = None, last: int | None = None
) -> tuple[int, int, int]:
    """First and last frame of the press, and the no-contact frame; those given are kept.

    Args:
        frames: (N, H, W, 3).
    """
    for name, value in (("no_contact", no_contact), ("first", first), ("last", last)):
        if value is not None and not 0 <= value < len(frames):
            raise _Unusable(f"{name} = {value}: it has {len(frames)} frames")
    count, height, width = (size - size % BLOCK if axis in (1, 2) else size for axis, size in enumerate(frames.shape[:3]))
    small = frames[:, :height, :width].reshape(count, height // BLOCK, BLOCK, width // BLOCK, BLOCK, 3).mean(axis=(2, 4), dtype=np.float32)
    if no_contact is None:
        steps = np.abs(np.diff(small, axis=0)).mean(axis=(1, 2, 3))
        calm = [i for i in range(max(len(steps) - QUIET, 0)) if steps[i : i + QUIET].max() < CALM]
        no_contact = calm[0] if calm else 0
    change = np.abs(small - small[no_contact]).mean(axis=(1, 2, 3))
    peak = int(np.argmax(change)) if last is None else last
    if change[peak] < LEAST:
        raise _Unusable(f"no press is seen: the mean change is at most {change[peak]:.2g} levels of 255")
    # Noise raises the change of every frame but one: what the calm ones have is no contact.
    floor = float(np.percentile(change[: peak + 1], 10))
    begun = np.flatnonzero(change[: peak + 1] > floor + BEGUN * (change[peak] - floor))
    start = max(int(begun[0]) - LEAD, 0) if first is None else first
    if start >= peak:
        raise _Unusable(f"the press would end at frame {peak}, before it begins at {start}")
    return max(start, peak + 1 - KEPT), peak, no_contact


def _video(path: Path, resolution: tuple[int, int]) -> tuple[NDArray[np.uint8], float]:
    try:
        return video_frames(path, resolution)
    except ValueError as error:
        raise _Unusable(str(error)) from None


def _pictures(path: Path, resolution: tuple[int, int]) -> tuple[NDArray[np.uint8], float]:
    from PIL import Image

    names = sorted(item for item in path.iterdir() if item.suffix.lower() in PICTURES)[:MOST_FRAMES]
    frames = []
    try:
        for name in names:
            with Image.open(name, formats=("PNG", "JPEG", "BMP")) as image:
                if image.width * image.height > MOST_PIXELS:
                    raise _Unusable(f"{name.name} has {image.width} × {image.height} pixels; allowed are {MOST_PIXELS} in all")
                frames.append(np.array(image.convert("RGB").resize(resolution, Image.Resampling.BOX)))
    except (OSError, ValueError, SyntaxError) as error:
        raise _Unusable(f"{error}") from None
    if len(frames) < 2:
        raise _Unusable("has fewer than two pictures")
    return np.stack(frames), 30.0
