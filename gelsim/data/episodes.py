"""Episodes on disk: one tar a press, and beside them what a training has to know of all of them. NumPy, Pillow and the standard library.

    meta/info.json        schema, domain, frame rate, size of the pictures, where they come from
    meta/episodes.jsonl   a row an episode, ordered by index        meta/failures.jsonl   index, seed, status, message
    meta/splits.json      name -> indices                           meta/stats.json       of the pixels of the split `train`
    episodes/00000/000123.tar   row.json, labels.npz, background.webp, frames/0000.webp …, and what else the maker gave (scene.toml, …)

An episode is a file that is renamed when it is whole, so there is no half of one; its tar repeats its row, so meta/ can be written again
from the episodes alone (`survey`). Pictures are lossless WebP (docs/datasets.md: why); PNG is read too. Equal pictures, as of an object
that stands still, are kept once: the others are hard links inside the tar. Nothing in a file depends on when, where or in which order it
was written. Files come from strangers: sizes are bounded, names inside a tar are looked up and never unpacked, and nothing is unpickled.
docs/datasets.md has the fields.
"""

from __future__ import annotations

import html
import io
import json
import tarfile
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import DatasetError, MaterialError
from gelsim.files import whole_file
from gelsim.results import Episode
from gelsim.scene import materials
from gelsim.scene.definition import Gel, Scene
from gelsim.scene.limits import LIMITS

SCHEMA = 1
FOLDER_OF = 1000
"""Episodes in a folder."""
LARGEST_FILE = 2**28
"""Bytes of one file in an episode, or of one in meta/ but for episodes.jsonl."""
MOST_FRAMES, MOST_PIXELS, MOST_MARKERS = 2000, 2**24, 20000
MOST_ROWS = 5_000_000
MOST_CLASSES = 20
SHORE_00 = (0, 100)
"""Of a durometer's scale, inclusive."""
DOMAINS = ("sim", "real")
MOTIONS = ("human", "robot")
_ROW: dict[str, tuple[type, ...]] = {
    "index": (int,), "object": (str,), "group": (int,), "shape": (str,), "radius_mm": (float, int, type(None)),
    "shore_00": (float, int, type(None)), "rigid": (bool,), "motion": (str,), "domain": (str,), "frames": (int,),
    "peak_force_n": (float, int, type(None)), "mechanics": (str,), "sensor": (str,), "file": (str,),
}  # fmt: skip
"""Every row has these; it may have more."""
_GEL: dict[str, tuple[float, float]] = {
    "thickness_mm": LIMITS["gel.thickness_mm"], "edge_thickness_mm": LIMITS["gel.edge_thickness_mm"], "shore_00": materials.SHORE_00_RANGE,
}  # fmt: skip
"""Inclusive bounds of a row's `gel`, which it need not have: without, nobody said which gel it was."""
_FIELD_MM = (1.0, 200.0)
"""Inclusive bounds of both sides of a row's `field_mm`: what the pictures show; without, their scale is not known."""
_LABELS = {"time": np.float64, "approach": np.float64, "force": np.float64, "marker_pixels": np.float32, "noise": np.float64}
"""As they are stored; a marker's place is kept to 1e-5 px."""


class Dataset:
    """A dataset on disk; episodes are read when they are asked for."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.info: dict[str, Any] = read_json(folder / "meta" / "info.json")
        if self.info.get("schema") != SCHEMA:
            raise DatasetError(f"{folder}: its schema is {self.info.get('schema')!r}; this version reads {SCHEMA}")
        self.rows: list[dict[str, Any]] = []
        """Of the finished episodes, ordered by index."""
        path = folder / "meta" / "episodes.jsonl"
        for number, row in enumerate(_json_lines(path), start=1):
            check_row(row, f"{path}: line {number}")
            self.rows.append(row)
        self.failures: list[dict[str, Any]] = list(_json_lines(folder / "meta" / "failures.jsonl"))
        self.splits: dict[str, list[int]] = read_json(folder / "meta" / "splits.json")
        self.stats: dict[str, Any] = read_json(folder / "meta" / "stats.json")
        self.positions = {row["index"]: position for position, row in enumerate(self.rows)}
        """Index of an episode (as in `splits`) -> its position in `rows`."""
        if len(self.positions) != len(self.rows):
            raise DatasetError(f"{path}: an index occurs twice")
        for name, members in self.splits.items():
            if not isinstance(members, list) or any(member not in self.positions for member in members):
                raise DatasetError(f"{folder / 'meta' / 'splits.json'}: {name!r} names an episode that is not there")

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[Episode]:
        """All episodes, one at a time in memory."""
        return (self.read(position) for position in range(len(self)))

    def read(self, position: int) -> Episode:
        """The episode of `rows[position]`.

        Raises:
            DatasetError: Its file is missing, damaged or not of the schema.
        """
        return read_episode(self._path(position))

    def member(self, position: int, name: str) -> bytes:
        """One file of an episode, such as scene.toml. Raises DatasetError where it is not there."""
        path = self._path(position)
        return read_members(path, [name])[name]

    def _repr_html_(self) -> str:
        """For notebooks: how many presses, their splits, and by shape what was pressed how hard."""
        splits = ", ".join(f"{name} {len(members)}" for name, members in self.splits.items() if members)
        frames = sum(row["frames"] for row in self.rows)
        lines = ["<tr><th>shape</th><th>presses</th><th>Shore 00</th><th>peak force [N]</th></tr>"]
        for shape in sorted({row["shape"] for row in self.rows}):
            rows = [row for row in self.rows if row["shape"] == shape]
            cells = shape, len(rows), *(_span(row[name] for row in rows) for name in ("shore_00", "peak_force_n"))
            lines.append("<tr>" + "".join(f"<td>{html.escape(str(cell))}</td>" for cell in cells) + "</tr>")
        told = html.escape(
            f"{self.folder}: {len(self)} presses, {frames} frames, failures: {len(self.failures)}; splits: {splits or 'none'}"
        )
        return f"<div>{told}<table>{''.join(lines)}</table></div>"

    def _path(self, position: int) -> Path:
        return self.folder / self.rows[position]["file"]


def load_dataset(path: str | Path) -> Dataset:
    """Opens a dataset that `gelsim dataset` made, or any other of the same schema.

    Raises:
        DatasetError: There is none, or it is damaged.
    """
    folder = Path(path)
    if not (folder / "meta" / "info.json").is_file():
        raise DatasetError(f"{folder}: is no dataset (it has no meta/info.json)")
    return Dataset(folder)


def _span(values: Iterable[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{min(known):.3g} to {max(known):.3g}" if known else "unknown"


# ---- one episode ----


def episode_file(index: int) -> str:
    """Where the episode of an index lies, relative to its dataset."""
    return f"episodes/{index // FOLDER_OF:05d}/{index:06d}.tar"


def check_row(row: object, where: str) -> None:
    """Raises DatasetError for a row that lacks a field or has one of another kind; `where` begins the message."""
    if not isinstance(row, dict):
        raise DatasetError(f"{where}: expected a table")
    for name, kinds in _ROW.items():
        if name not in row:
            raise DatasetError(f"{where}: {name} is missing")
        value = row[name]
        if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
            raise DatasetError(f"{where}: {name} = {value!r} is no {' or '.join(kind.__name__ for kind in kinds)}")
    for name, allowed in (("domain", DOMAINS), ("motion", MOTIONS)):
        if row[name] not in allowed:
            raise DatasetError(f"{where}: {name} = {row[name]!r}: allowed are {', '.join(allowed)}")
    if row["file"] != episode_file(row["index"]) or row["index"] < 0:
        raise DatasetError(f"{where}: file = {row['file']!r}: the episode {row['index']} lies in {episode_file(max(row['index'], 0))!r}")
    if "gel" in row:
        _check_gel(row["gel"], where)
    if "shore_00_range" in row:
        _check_range(row["shore_00_range"], where)
    rank = row.get("hardness_class", 0)
    if not isinstance(rank, int) or isinstance(rank, bool) or not 0 <= rank < MOST_CLASSES:
        raise DatasetError(f"{where}: hardness_class = {rank!r}: expected a whole number, 0 (the softest) … {MOST_CLASSES - 1}")
    stiffness = row.get("stiffness_n_mm")
    # A NaN is within no bounds.
    if stiffness is not None and (not isinstance(stiffness, (int, float)) or isinstance(stiffness, bool) or not 0 < stiffness < np.inf):
        raise DatasetError(f"{where}: stiffness_n_mm = {stiffness!r}: expected more than 0 N/mm, null where it is not known")
    if "field_mm" in row:
        _check_field(row["field_mm"], where)


def _check_range(bounds: object, where: str) -> None:
    low, high = SHORE_00
    ends = bounds if isinstance(bounds, list) and len(bounds) == 2 else [bounds]
    told: list[Any] = [end for end in ends if end is not None]
    # A NaN is within no bounds.
    right = all(isinstance(end, (int, float)) and not isinstance(end, bool) and low <= end <= high for end in told)
    if len(ends) != 2 or not told or not right or (len(told) == 2 and told[0] >= told[1]):
        raise DatasetError(f"{where}: shore_00_range = {bounds!r}: expected least and greatest, {low} … {high}, null where there is none")


def _check_field(field: object, where: str) -> None:
    low, high = _FIELD_MM
    sides = field if isinstance(field, list) and len(field) == 2 else [None]
    # A NaN is within no bounds.
    if not all(isinstance(side, (int, float)) and not isinstance(side, bool) and low <= side <= high for side in sides):
        raise DatasetError(f"{where}: field_mm = {field!r}: expected width and height, {low:g} … {high:g} mm each")


def _check_gel(gel: object, where: str) -> None:
    if not isinstance(gel, dict) or set(gel) != set(_GEL):
        raise DatasetError(f"{where}: gel = {gel!r}: expected a table of {', '.join(_GEL)}")
    for name, (low, high) in _GEL.items():
        value = gel[name]
        if value is None and name == "shore_00":
            continue
        # A NaN is within no bounds.
        if not isinstance(value, (int, float)) or isinstance(value, bool) or not low <= value <= high:
            raise DatasetError(f"{where}: gel.{name} = {value!r}: allowed is {low:g} … {high:g}{' mm' if name.endswith('_mm') else ''}")


def gel_facts(gel: Gel) -> dict[str, float | None]:
    """A row's `gel`: what a lab knows of its own; `shore_00` None where no reading has this gel's modulus."""
    if gel.shore_00 is not None:
        shore = gel.shore_00
    else:
        try:
            # What a reading means, `modulus_scale` says; a reading it does not change.
            shore = materials.shore_00_from_modulus(materials.youngs_modulus(replace(gel, modulus_scale=1.0)))
        except MaterialError:
            shore = None
    return {"thickness_mm": gel.thickness_mm, "edge_thickness_mm": gel.edge_mm, "shore_00": shore}


def field_seen(scene: Scene) -> list[float]:
    """A row's `field_mm`: width and height of the gel's surface at rest that the pictures show [mm]; pixels are square."""
    size = scene.render.resolution
    per_px = max(field / side for field, side in zip(scene.camera.field_mm, size, strict=True))
    return [round(per_px * side, 6) for side in size]


def lit(row: Mapping[str, Any]) -> bool:
    """Whether an episode has pictures: one without (pictures = false in its row) keeps mechanics and labels, and reads as 0 × 0 pixels."""
    return row.get("pictures", True) is not False


def write_episode(folder: Path, episode: Episode, members: Mapping[str, bytes] | None = None) -> Path:
    """Writes an episode whole: under a temporary name, then renamed.

    Args:
        folder: Of the dataset.
        members: More files to keep with it, name -> content.
    Raises:
        DatasetError: Its row is not of the schema, or it cannot be written (a full disk, a read-only folder).
    """
    check_row(episode.row, f"episode {episode.row.get('index')}")
    if lit(episode.row) != bool(episode.background.size):
        raise DatasetError(
            f"episode {episode.row['index']}: pictures of {episode.background.shape}, but pictures = {lit(episode.row)} in its row"
        )
    if episode.row["frames"] != len(episode.frames):
        raise DatasetError(f"episode {episode.row['index']}: its row says {episode.row['frames']} frames, it has {len(episode.frames)}")
    pictures: dict[bytes, bytes] = {}
    for picture in (episode.background, *episode.frames) if lit(episode.row) else ():
        if (pixels := picture.tobytes()) not in pictures:
            pictures[pixels] = webp(picture)
    files = {
        "row.json": _dumped({"row": episode.row, "sums": _sums(episode)}),
        "labels.npz": npz({name: np.asarray(getattr(episode, name), kind) for name, kind in _LABELS.items()}),
    }
    if lit(episode.row):
        files["background.webp"] = pictures[episode.background.tobytes()]
        files |= {f"frames/{number:04d}.webp": pictures[frame.tobytes()] for number, frame in enumerate(episode.frames)}
    path = folder / episode.row["file"]
    write_tar(path, files | dict(members or {}))
    return path


def read_episode(path: Path) -> Episode:
    """Raises DatasetError for a file that is missing, damaged or not of the schema."""
    with _opened(path) as tar:
        names = {member.name: member for member in tar}
        row = json.loads(_content(tar, names, "row.json"))["row"]
        check_row(row, f"{path}: row.json")
        count = sum(name.startswith("frames/") for name in names) if lit(row) else row["frames"]
        if not 0 < count <= MOST_FRAMES:
            raise DatasetError(f"{path}: holds {count} frames; allowed is 1 … {MOST_FRAMES}")
        with _npz(_content(tar, names, "labels.npz")) as file:
            labels = {name: np.asarray(file[name], np.float64) for name in _LABELS if name in file}
        if "marker_pixels" in labels and labels["marker_pixels"].shape[1:2] > (MOST_MARKERS,):
            raise DatasetError(f"{path}: more than {MOST_MARKERS} markers")
        if not lit(row):
            return Episode(np.zeros((count, 0, 0, 3), np.uint8), np.zeros((0, 0, 3), np.uint8), row=row, **labels)
        kind = "webp" if "background.webp" in names else "png"
        wanted = [f"background.{kind}", *(f"frames/{i:04d}.{kind}" for i in range(count))]
        kept = {name: names[name].linkname if name in names and names[name].islnk() else name for name in wanted}
        of_name = {name: _picture(_content(tar, names, name)) for name in dict.fromkeys(kept.values())}
        pictures = [of_name[kept[name]] for name in wanted]
        if len({picture.shape for picture in pictures}) > 1:
            raise DatasetError(f"{path}: its pictures are not of one size")
        return Episode(np.stack(pictures[1:]), pictures[0], row=row, **labels)


def read_members(path: Path, names: Sequence[str]) -> dict[str, bytes]:
    """Files of an episode by name. Raises DatasetError where one is not there."""
    with _opened(path) as tar:
        known = {member.name: member for member in tar}
        return {name: _content(tar, known, name) for name in names}


def webp(image: NDArray[np.uint8]) -> bytes:
    """A picture, lossless, at the least effort: a sixth of the time of a middling one for a quarter more bytes (docs/datasets.md)."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, format="WEBP", lossless=True, quality=20, method=0, exact=True)
    return buffer.getvalue()


def npz(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Named arrays, compressed: the same bytes for the same arrays."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def _picture(content: bytes) -> NDArray[np.uint8]:
    from PIL import Image

    # The header says how large it is; more is refused before it is unpacked.
    with Image.open(io.BytesIO(content), formats=("WEBP", "PNG")) as image:
        if image.width * image.height > MOST_PIXELS:
            raise DatasetError(f"a picture of {image.width} × {image.height} pixels; allowed are {MOST_PIXELS} in all")
        return np.array(image.convert("RGB"))


def write_tar(path: Path, files: Mapping[str, bytes]) -> None:
    """Writes files into an uncompressed tar whose bytes depend on them alone; renamed when whole. Raises DatasetError.

    Of equal files all but the first are hard links to it.
    """
    buffer, first = io.BytesIO(), dict[bytes, str]()
    with tarfile.open(fileobj=buffer, mode="w", format=tarfile.USTAR_FORMAT) as tar:
        for name, content in files.items():
            entry = tarfile.TarInfo(name)
            if (known := first.setdefault(content, name)) != name:
                entry.type, entry.linkname = tarfile.LNKTYPE, known
                tar.addfile(entry)
                continue
            entry.size = len(content)
            tar.addfile(entry, io.BytesIO(content))
        end = tar.offset + 2 * tarfile.BLOCKSIZE  # two empty blocks; tarfile would fill up to 10 kB
    _write_whole(path, buffer.getbuffer()[:end])


class _opened:
    """A tar to read, whatever is wrong with it said as a DatasetError."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> tarfile.TarFile:
        try:
            self._tar = tarfile.open(self._path, mode="r:")
        except (OSError, tarfile.TarError) as error:
            raise DatasetError(f"{self._path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
        return self._tar

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        self._tar.close()
        if isinstance(error, DatasetError) and str(self._path) not in str(error):
            raise DatasetError(f"{self._path}: {error}") from None
        damaged = (OSError, EOFError, ValueError, KeyError, TypeError, SyntaxError, tarfile.TarError, zipfile.BadZipFile, MemoryError)
        if isinstance(error, damaged):
            raise DatasetError(f"{self._path}: is damaged ({error})") from None


def _content(tar: tarfile.TarFile, known: Mapping[str, tarfile.TarInfo], name: str) -> bytes:
    if name in known and known[name].islnk():
        # To a file of the same archive, and of one step: what it names is a link no more.
        name = known[name].linkname
    if name not in known or not known[name].isreg():
        raise DatasetError(f"{name} is missing")
    if known[name].size > LARGEST_FILE:
        raise DatasetError(f"{name} has {known[name].size} bytes; allowed are {LARGEST_FILE}")
    file = tar.extractfile(known[name])
    assert file is not None
    return file.read()


def _npz(content: bytes) -> Any:
    """An archive of arrays whose unpacked size is bounded too."""
    with zipfile.ZipFile(io.BytesIO(content)) as file:
        if sum(item.file_size for item in file.infolist()) > LARGEST_FILE:
            raise DatasetError(f"labels.npz unpacks to more than {LARGEST_FILE} bytes")
    return np.load(io.BytesIO(content), allow_pickle=False)


def unpacked(content: bytes) -> dict[str, NDArray[Any]]:
    """The arrays of an npz archive, checked as everything else here. Raises DatasetError."""
    try:
        with _npz(content) as file:
            return {name: file[name] for name in file.files}
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise DatasetError(f"an archive of arrays is damaged ({error})") from None


# ---- meta ----


@dataclass(frozen=True)
class Survey:
    """What lies in the episodes' folder."""

    rows: list[dict[str, Any]]
    """Ordered by index."""
    sums: dict[int, dict[str, Any]]
    """Index -> sums over the episode's pixels."""


def survey(folder: Path) -> Survey:
    """Reads the rows out of the episodes themselves; half-written files of a run that was killed are removed."""
    rows, sums = [], {}
    for path in sorted((folder / "episodes").glob("[0-9]*/.*.partial")):
        path.unlink(missing_ok=True)
    for path in sorted((folder / "episodes").glob("[0-9]*/[0-9]*.tar")):
        with _opened(path) as tar:
            first = tar.next()
            if first is None or first.name != "row.json":
                raise DatasetError("row.json is missing")
            found = json.loads(_content(tar, {"row.json": first}, "row.json"))
            check_row(found["row"], "row.json")
            rows.append(found["row"])
            sums[found["row"]["index"]] = found["sums"]
    rows.sort(key=lambda row: row["index"])
    return Survey(rows, sums)


def write_meta(
    folder: Path, info: Mapping[str, Any], found: Survey, failures: Iterable[Mapping[str, Any]], splits: Mapping[str, Sequence[int]]
) -> None:
    """Writes meta/, each file whole; info.json last, so that a folder with one is a dataset.

    Raises:
        DatasetError: A file cannot be written.
    """
    meta = folder / "meta"
    _write_whole(meta / "episodes.jsonl", b"".join(_dumped(row) for row in found.rows))
    _write_whole(meta / "failures.jsonl", b"".join(_dumped(row) for row in sorted(failures, key=lambda row: row["index"])))
    _write_whole(meta / "splits.json", _dumped({name: list(members) for name, members in splits.items()}))
    _write_whole(meta / "stats.json", _dumped(_stats([found.sums[index] for index in splits.get("train", [])])))
    _write_whole(meta / "info.json", _dumped({"schema": SCHEMA, **info}, indent=2))


def _sums(episode: Episode) -> dict[str, Any]:
    """Whole numbers, so that it does not matter in which order they are added later; float64 holds them exactly up to 9e15."""
    background = _planes(episode.background)
    sums = np.zeros((2, 2, 3))
    same: dict[bytes, tuple[int, NDArray[np.uint8]]] = {}
    for frame in episode.frames:
        count, _ = same.get(pixels := frame.tobytes(), (0, frame))
        same[pixels] = count + 1, frame
    for count, frame in same.values():
        levels = _planes(frame)
        for of, values in zip(sums, (levels, levels - background), strict=True):
            of += count * np.stack([values.sum(axis=1), np.einsum("cp,cp->c", values, values)])
    levels, change = sums.astype(np.int64).tolist()
    return {"pixels": int(episode.frames[..., 0].size), "levels": levels, "change": change}


def _planes(picture: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Its channels one after the other, shape (3, H W)."""
    return np.ascontiguousarray(picture.reshape(-1, 3).T, np.float64)


def _stats(sums: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Mean and standard deviation by channel [levels of 255]: of the frames, and of their difference from the no-contact frame."""
    pixels = sum(part["pixels"] for part in sums)
    stats: dict[str, Any] = {"episodes": len(sums), "pixels": pixels}
    for name, words in (("levels", ("mean", "std")), ("change", ("change_mean", "change_std"))):
        first, second = ([sum(part[name][power][channel] for part in sums) / max(pixels, 1) for channel in range(3)] for power in (0, 1))
        stats[words[0]] = first
        stats[words[1]] = [float(np.sqrt(max(square - mean**2, 0.0))) for mean, square in zip(first, second, strict=True)]
    return stats


def _dumped(value: object, indent: int | None = None) -> bytes:
    return (json.dumps(value, indent=indent, allow_nan=False, ensure_ascii=False) + "\n").encode()


def read_json(path: Path) -> dict[str, Any]:
    """A table in a dataset's file, bounded in size. Raises DatasetError: it cannot be read, or holds something else."""
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise DatasetError(f"{path}: has {path.stat().st_size} bytes; allowed are {LARGEST_FILE}")
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise DatasetError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    if not isinstance(value, dict):
        raise DatasetError(f"{path}: holds no table")
    return value


def _json_lines(path: Path) -> Iterator[Any]:
    try:
        with path.open(encoding="utf-8") as file:
            for number, line in enumerate(file, start=1):
                if number > MOST_ROWS:
                    raise DatasetError(f"{path}: more than {MOST_ROWS} lines")
                yield json.loads(line)
    except (OSError, ValueError, RecursionError) as error:
        raise DatasetError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None


def _write_whole(path: Path, content: bytes | memoryview) -> None:
    try:
        with whole_file(path) as partial:
            partial.write_bytes(content)
    except OSError as error:
        raise DatasetError(f"{path}: cannot be written ({error.strerror or error})") from None
