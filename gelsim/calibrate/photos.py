"""The folder of photographs that `gelsim calibrate` reads: photos.toml, presses.csv, pictures; checked before anything is computed.

photos.toml: `ball_radius_mm`, `no_contact` (both required), `mm_per_px`, `gel` (a [gel] section), `markers`, `linear`. presses.csv, if any:
file, col_px, row_px, contact_radius_px, depth_mm, split; any cell but the file may be empty. Without it every other picture of the folder
is a press. A picture is 8-bit sRGB unless `linear` says that its values are proportional to light; those, and EXR files, are put on the
sRGB scale, on which errors are counted. Left out: raw camera formats, pictures of 16 bits, which are read as 8.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import GelsimError, SceneError
from gelsim.optics.isp import srgb_tone
from gelsim.scene.definition import Gel, Scene
from gelsim.scene.fields import convert, nearest
from gelsim.tables import read_csv

Array = NDArray[np.float64]

KEYS = {"ball_radius_mm": float, "no_contact": str, "mm_per_px": float, "gel": dict, "markers": bool, "linear": bool}
COLUMNS = ("file", "col_px", "row_px", "contact_radius_px", "depth_mm", "split")
NUMBERS = ("col_px", "row_px", "contact_radius_px", "depth_mm")
"""Of them those that are numbers, NaN where a cell is empty."""
SUFFIXES = (".png", ".jpg", ".jpeg", ".exr")
SIDE = (32, 4096)
"""Smallest and largest width and height [px]."""
MOST_PHOTOS, MOST_PIXELS = 400, 400_000_000
"""Bounds of a folder: pictures, and pixels of them all."""
BALL_MM, SCALE = (0.5, 50.0), (1e-3, 1.0)
"""Allowed ball radii [mm] and scales [mm/px]."""


@dataclass(frozen=True, eq=False)
class Photos:
    """Everything that the photographs say."""

    ball_mm: float
    no_contact: Array
    """Levels 0 … 255 on the sRGB scale, shape (H, W, 3)."""
    pictures: Array
    """Of each press, shape (P, H, W, 3)."""
    files: list[str]
    test: NDArray[np.bool_]
    """Presses that are predicted, not fitted."""
    hints: Array
    """col [px], row [px], depth [mm] of each press, NaN where not given, shape (P, 3)."""
    radii: Array
    """Of the contacts, as a person marked them [px], NaN where not given, shape (P,)."""
    mm_per_px: float | None
    gel: Gel | None
    markers: bool

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [px]."""
        return self.no_contact.shape[1], self.no_contact.shape[0]


def read_photos(folder: Path) -> Photos:
    """Reads and checks a folder.

    Raises:
        SceneError: The first thing that is wrong, with file, field, value and what is allowed.
    """
    settings = _settings(folder / "photos.toml")
    linear = settings.get("linear", False)
    first = _picture(folder / settings["no_contact"], linear)
    rows = _rows(folder, settings["no_contact"], {"col_px": first.shape[1], "row_px": first.shape[0]})
    if len(rows) + 1 > MOST_PHOTOS:
        raise SceneError(f"--photos {folder}: {len(rows) + 1} pictures; at most {MOST_PHOTOS} are taken")
    if first.size // 3 * (len(rows) + 1) > MOST_PIXELS:
        raise SceneError(f"--photos {folder}: more than {MOST_PIXELS // 10**6} million pixels in all; scale the pictures down")
    pictures = np.empty((len(rows), *first.shape))
    for index, row in enumerate(rows):
        picture = _picture(folder / row["file"], linear)
        if picture.shape != first.shape:
            (h, w), (h0, w0) = picture.shape[:2], first.shape[:2]
            raise SceneError(f"{folder / row['file']}: is {w} x {h} px, but no_contact is {w0} x {h0} px; all pictures are of one size")
        pictures[index] = picture
    test = np.array([row["split"] == "test" for row in rows])
    if len(rows) == 0 or test.all():
        raise SceneError(f"--photos {folder}: no press to fit to; at least one picture besides no_contact that is not split = test")
    hints = np.array([[row["col_px"], row["row_px"], row["depth_mm"]] for row in rows])
    return Photos(
        ball_mm=settings["ball_radius_mm"],
        no_contact=first,
        pictures=pictures,
        files=[row["file"] for row in rows],
        test=test,
        hints=hints,
        radii=np.array([row["contact_radius_px"] for row in rows]),
        mm_per_px=settings.get("mm_per_px"),
        gel=settings.get("gel"),
        markers=settings.get("markers", False),
    )


def _settings(path: Path) -> dict[str, Any]:
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror}); it names ball_radius_mm and no_contact") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SceneError(f"{path}: is not TOML ({error})") from None
    for key, value in table.items():
        if key not in KEYS:
            raise SceneError(f"{path}: unknown key {key!r}{nearest(key, KEYS) or '; known are ' + ', '.join(KEYS)}")
        if key != "gel":
            table[key] = convert(value, KEYS[key], f"{path}: {key}")
    for key in ("ball_radius_mm", "no_contact"):
        if key not in table:
            raise SceneError(f"{path}: {key} is missing; ball_radius_mm and no_contact are required")
    for key, (low, high), unit in (("ball_radius_mm", BALL_MM, "mm"), ("mm_per_px", SCALE, "mm/px")):
        if key in table and not low <= table[key] <= high:
            raise SceneError(f"{path}: {key} = {table[key]:g} {unit}: allowed is {low:g} … {high:g} {unit}")
    if "gel" in table:
        try:
            table["gel"] = Scene(gel=convert(table["gel"], Gel, "gel")).gel
        except GelsimError as error:
            raise SceneError(f"{path}: {error}") from None
    return table


def _rows(folder: Path, no_contact: str, sides: dict[str, int]) -> list[dict[str, Any]]:
    """A row for each press; `sides`: of the pictures [px], by the column that counts along them."""
    path = folder / "presses.csv"
    if not path.exists():
        names = sorted(item.name for item in folder.iterdir() if item.suffix.lower() in SUFFIXES and item.name != no_contact)
        return [{"file": name, **dict.fromkeys(NUMBERS, math.nan), "split": ""} for name in names]
    header, lines = read_csv(path, known=COLUMNS)
    rows, seen = [], set()
    for number, line in enumerate(lines, start=2):
        where = f"{path}: line {number}"
        if None in line or any(value is None for value in line.values()):
            raise SceneError(f"{where} has not {len(header)} cells, as the first line has")
        row: dict[str, Any] = {"file": line["file"].strip(), "split": (line.get("split") or "").strip()}
        if not row["file"]:
            raise SceneError(f"{where}: file is empty")
        if row["file"] in seen or row["file"] == no_contact:
            raise SceneError(f"{where}: file = {row['file']!r} comes twice")
        seen.add(row["file"])
        if row["split"] not in ("", "train", "test"):
            raise SceneError(f"{where}: split = {row['split']!r}; allowed are train, test, or nothing")
        for name in NUMBERS:
            text = (line.get(name) or "").strip()
            try:
                row[name] = float(text) if text else math.nan
            except ValueError:
                raise SceneError(f"{where}: {name} = {text!r} is not a number") from None
            if text and not math.isfinite(row[name]):
                raise SceneError(f"{where}: {name} = {text} is not finite")
            if text and name in sides and not 0 <= row[name] <= sides[name]:
                raise SceneError(f"{where}: {name} = {row[name]:g} px: allowed is 0 … {sides[name]} px, the picture")
        if row["depth_mm"] <= 0:
            raise SceneError(f"{where}: depth_mm = {row['depth_mm']:g} mm: allowed is more than 0 mm")
        widest = max(sides.values()) / 2
        if not (math.isnan(row["contact_radius_px"]) or 0 < row["contact_radius_px"] <= widest):
            raise SceneError(f"{where}: contact_radius_px = {row['contact_radius_px']:g} px: allowed is more than 0, up to {widest:g} px")
        rows.append(row)
    return rows


def _picture(path: Path, linear: bool) -> Array:
    """Levels 0 … 255 on the sRGB scale, shape (H, W, 3)."""
    try:
        if path.suffix.lower() == ".exr":
            import OpenEXR

            with OpenEXR.File(str(path)) as file:
                values = np.asarray(next(part for name, part in file.channels().items() if name in ("RGB", "RGBA")).pixels, float)[..., :3]
            linear = True
        else:
            from PIL import Image

            with Image.open(path) as image:
                if not all(SIDE[0] <= side <= SIDE[1] for side in image.size):
                    _refuse_size(path, image.size)
                values = np.asarray(image.convert("RGB"), float) / 255
    except SceneError:
        raise
    except Exception as error:  # Pillow and OpenEXR raise many kinds for a damaged file
        raise SceneError(f"{path}: is not a picture that can be read ({type(error).__name__}: {error})") from None
    if not all(SIDE[0] <= side <= SIDE[1] for side in values.shape[:2]):
        _refuse_size(path, (values.shape[1], values.shape[0]))
    if not np.isfinite(values).all():
        raise SceneError(f"{path}: holds values that are not finite")
    return np.asarray(255 * (srgb_tone(values) if linear else values), np.float64)


def _refuse_size(path: Path, size: tuple[int, int]) -> None:
    raise SceneError(f"{path}: is {size[0]} x {size[1]} px; allowed are {SIDE[0]} … {SIDE[1]} px a side")
