"""The folder of photographs that `gelsim calibrate` and `gelsim compare` read: photos.toml, presses.csv, pictures; checked at once.

photos.toml: KEYS, of which `no_contact` is required, and `ball_radius_mm` where a press does not say its own. presses.csv, if any: COLUMNS,
and any plain field of [object] by its own name, which a press then has in place of the ball; any cell but the file may be empty. Without it
every other picture of the folder is a press. Places are those of the photograph as it lies there, whatever is cut out of it. How a picture
is read, cut out and set upright: `calibrate.reading`. All of them are then on the sRGB scale, on which errors are counted.
"""

from __future__ import annotations

import dataclasses
import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.calibrate.dent import BALL
from gelsim.calibrate.dots import blobs
from gelsim.calibrate.edges import lens_of_edges
from gelsim.calibrate.lens import RANGE, Lens, fitted_lens
from gelsim.calibrate.reading import SUFFIXES, Reader
from gelsim.data.corners import Corners, check_corners
from gelsim.errors import GelsimError, SceneError
from gelsim.scene.definition import Body, Gel, Scene
from gelsim.scene.fields import convert, field_types, nearest, parse_text
from gelsim.scene.layers import build_scene, from_folder
from gelsim.tables import read_csv

Array = NDArray[np.float64]

KEYS = {
    "ball_radius_mm": float, "no_contact": str | tuple[str, ...], "mm_per_px": float, "gel": dict, "markers": bool, "linear": bool,
    "order": str, "crop_px": tuple[int, int, int, int], "corners_px": list, "corners_mm": tuple[float, float], "mask": str,
    "lens_k": float,
}  # fmt: skip
NUMBERS = ("col_px", "row_px", "contact_radius_px", "depth_mm")
"""Columns that are NaN where a cell is empty."""
OBJECT = tuple(item.name for item in dataclasses.fields(Body) if item.name not in ("law_constants", "skin", "grains"))
"""Columns that make a press one of another object."""
COLUMNS = ("file", *NUMBERS, "split", *OBJECT)
MOST_PHOTOS, MOST_PIXELS = 400, 400_000_000
"""Bounds of a folder: pictures, and pixels of them all."""
BALL_MM, SCALE = (0.5, 50.0), (1e-3, 1.0)
"""Allowed ball radii [mm] and scales [mm/px]."""
UNLIKE = 12.0
"""Mean difference [levels] at which two photographs without contact are of two sensors: on the sets of ../shared/real the one differs from
the median of all by 1.6, 1.6 and 5.0, those of two sets by 32 to 44."""


@dataclass(frozen=True, eq=False)
class Photos:
    """Everything that the photographs say."""

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
    bodies: list[Body]
    """What was pressed."""
    counted: NDArray[np.bool_]
    """Pixels that show gel, shape (H, W)."""
    mm_per_px: float | None
    gel: Gel | None
    markers: bool
    lens: Lens | None = None
    """Its distortion was taken out of all pictures."""

    @property
    def lens_choice(self) -> dict[str, Any]:
        """For reports: what was taken out, its standard deviation, and what told of it."""
        if self.lens is None:
            return {"lens_k": 0.0}
        return {"lens_k": round(self.lens.k, 4), "lens_k_sd": round(self.lens.sd, 4), "lens_by": self.lens.by}

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [px]."""
        return self.no_contact.shape[1], self.no_contact.shape[0]

    @property
    def balls_mm(self) -> Array:
        """Radius of each press's ball, NaN of another object, shape (P,)."""
        return np.array([body.radius_mm if body.shape == BALL and body.rigid else math.nan for body in self.bodies])

    def only(self, which: NDArray[np.bool_]) -> Photos:
        """Those presses alone."""
        some = np.flatnonzero(which)
        return dataclasses.replace(
            self, pictures=self.pictures[some], files=[self.files[index] for index in some], test=self.test[some], hints=self.hints[some],
            radii=self.radii[some], bodies=[self.bodies[index] for index in some],
        )  # fmt: skip


def read_photos(folder: Path) -> Photos:
    """Reads and checks a folder.

    Raises:
        SceneError: The first thing that is wrong, with file, field, value and what is allowed.
    """
    settings = _settings(folder / "photos.toml")
    reader = Reader(folder, *(settings.get(key, default) for key, default in (("linear", False), ("order", "rgb"))))
    first = reader.levels(settings["no_contact"][0])
    height, width = first.shape[:2]
    rows = _rows(folder, reader, settings, {"col_px": width, "row_px": height})
    reader.crop = settings.get("crop_px")
    reader.corners = Corners(settings["corners_px"], settings.get("corners_mm")) if "corners_px" in settings else None
    reader.lens = _lens(settings, first)
    if len(rows) + 1 > MOST_PHOTOS:
        raise SceneError(f"--photos {folder}: {len(rows) + 1} pictures; at most {MOST_PHOTOS} are taken")
    if width * height * (len(rows) + 1) > MOST_PIXELS:
        raise SceneError(f"--photos {folder}: more than {MOST_PIXELS // 10**6} million pixels in all; scale the pictures down")
    no_contact = _no_contact(folder, reader, settings["no_contact"])
    pictures = np.empty((len(rows), *no_contact.shape))
    for index, row in enumerate(rows):
        picture = reader.levels(row["file"])
        if picture.shape != no_contact.shape:
            (h, w), (h0, w0) = picture.shape[:2], no_contact.shape[:2]
            raise SceneError(f"{folder / row['file']}: is {w} x {h} px, but no_contact is {w0} x {h0} px; all pictures are of one size")
        pictures[index] = picture
    marked = np.array([[row["col_px"], row["row_px"]] for row in rows]).reshape(-1, 2)
    places = [reader.place(mark) for mark in marked]
    grown = [reader.scale(np.where(np.isnan(mark), [width / 2, height / 2], mark)) for mark in marked]
    return Photos(
        no_contact=no_contact,
        pictures=pictures,
        files=[row["file"] for row in rows],
        test=np.array([row["split"] == "test" for row in rows], bool),
        hints=np.array([[*place, row["depth_mm"]] for place, row in zip(places, rows, strict=True)]).reshape(-1, 3),
        radii=np.array([row["contact_radius_px"] * scale for row, scale in zip(rows, grown, strict=True)]),
        bodies=[row["body"] for row in rows],
        counted=_counted(reader, settings, no_contact),
        mm_per_px=reader.mm_per_px or _straight_scale(settings.get("mm_per_px"), reader.lens),
        gel=settings.get("gel"),
        markers=settings.get("markers", False),
        lens=reader.lens,
    )


def _lens(settings: dict[str, Any], photo: Array) -> Lens | None:
    """As given, else as markers of a whole photograph (H, W, 3) show it, or of one without any the gel's edges."""
    size, k = (photo.shape[1], photo.shape[0]), settings.get("lens_k")
    if k is not None:
        return Lens(k, size) if k else None
    if "crop_px" in settings:
        return None
    return fitted_lens(blobs(photo)[0], size) if settings.get("markers") else lens_of_edges(photo, settings.get("corners_px"))


def _straight_scale(mm_per_px: float | None, lens: Lens | None) -> float | None:
    return mm_per_px * lens.scale if mm_per_px and lens else mm_per_px


def _no_contact(folder: Path, reader: Reader, names: tuple[str, ...]) -> Array:
    """Of several photographs the median; they must be of one sensor."""
    levels = [reader.levels(name) for name in names]
    for name, picture in zip(names[1:], levels[1:], strict=True):
        if picture.shape != levels[0].shape:
            raise SceneError(f"{folder / name}: no_contact names pictures of two sizes: {names[0]} and {name}")
        apart = float(np.abs(picture - levels[0]).mean())
        if apart > UNLIKE:
            raise SceneError(
                f"{folder / 'photos.toml'}: no_contact: {names[0]} and {name} differ by {apart:.0f} levels on the mean, those of one "
                f"sensor by less than {UNLIKE:g}: are they of two sensors, or is one pressed?"
            )
    return levels[0] if len(levels) == 1 else np.median(levels, axis=0)


def _counted(reader: Reader, settings: dict[str, Any], no_contact: Array) -> NDArray[np.bool_]:
    """Pixels that show gel: where the mask, cut out as the pictures are, is brighter than half."""
    shape = no_contact.shape[:2]
    if "mask" not in settings:
        return np.ones(shape, bool)
    where = f"{reader.folder / 'photos.toml'}: mask = {settings['mask']!r}"
    shown = reader.levels(settings["mask"]).mean(axis=2) > 127.5
    if shown.shape != shape:
        raise SceneError(f"{where} is {shown.shape[1]} x {shown.shape[0]} px where the pictures are {shape[1]} x {shape[0]} px")
    if shown.mean() < 0.05:
        hidden = 100 * (1 - shown.mean())
        raise SceneError(f"{where} hides {hidden:.0f} % of the picture: white is gel, black is left out; at least 5 % must be white")
    return shown


def _settings(path: Path) -> dict[str, Any]:
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror}); it names no_contact") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SceneError(f"{path}: is not TOML ({error})") from None
    for key, value in table.items():
        if key not in KEYS:
            raise SceneError(f"{path}: unknown key {key!r}{nearest(key, KEYS) or '; known are ' + ', '.join(KEYS)}")
        if key == "no_contact" and isinstance(value, str):
            value = [value]
        if key not in ("gel", "corners_px"):
            table[key] = convert(value, tuple[str, ...] if key == "no_contact" else KEYS[key], f"{path}: {key}")
    if not table.get("no_contact"):
        raise SceneError(f"{path}: no_contact is missing; it is required")
    for key, (low, high), unit in (("ball_radius_mm", BALL_MM, "mm"), ("mm_per_px", SCALE, "mm/px")):
        if key in table and not low <= table[key] <= high:
            raise SceneError(f"{path}: {key} = {table[key]:g} {unit}: allowed is {low:g} … {high:g} {unit}")
    if table.get("order", "rgb") not in ("rgb", "bgr"):
        raise SceneError(f'{path}: order = {table["order"]!r}: allowed are "rgb" and "bgr"')
    _check_cut(table, path)
    if "gel" in table:
        try:
            table["gel"] = Scene(gel=convert(table["gel"], Gel, "gel")).gel
        except GelsimError as error:
            raise SceneError(f"{path}: {error}") from None
    return table


def _check_cut(table: dict[str, Any], path: Path) -> None:
    """What is cut out of the photographs."""
    if "crop_px" in table:
        left, top, wide, high = table["crop_px"]
        if min(left, top) < 0 or min(wide, high) < 1:
            raise SceneError(f"{path}: crop_px = {left} {top} {wide} {high}: left and top are 0 or more, width and height more than 0 px")
    if "corners_px" in table:
        if "crop_px" in table:
            raise SceneError(f"{path}: crop_px and corners_px exclude each other: corners cut out too")
        pairs = [convert(pair, tuple[float, float], f"{path}: corners_px") for pair in table["corners_px"]]
        if len(pairs) != 4:
            raise SceneError(f"{path}: corners_px has {len(pairs)} corners; give four, each [column, row]")
        table["corners_px"] = np.array(pairs)
        check_corners(table["corners_px"], f"{path}: corners_px")
    if "lens_k" in table:
        if "crop_px" in table:
            raise SceneError(f"{path}: lens_k is of whole photographs: take crop_px away, or straighten the pictures before")
        if not RANGE[0] <= table["lens_k"] <= RANGE[1]:
            raise SceneError(f"{path}: lens_k = {table['lens_k']}: allowed is {RANGE[0]:g} … {RANGE[1]:g}")
    if "corners_mm" in table:
        if "corners_px" not in table or "mm_per_px" in table:
            raise SceneError(f"{path}: corners_mm is the size of corners_px's rectangle, in place of mm_per_px")
        if min(table["corners_mm"]) <= 0:
            raise SceneError(f"{path}: corners_mm = {table['corners_mm'][0]:g} {table['corners_mm'][1]:g} mm: allowed is more than 0 mm")


def _rows(folder: Path, reader: Reader, settings: dict[str, Any], sides: dict[str, int]) -> list[dict[str, Any]]:
    """A row for each press; `sides`: of the photographs [px], by the column that counts along them."""
    path = folder / "presses.csv"
    others = {*settings["no_contact"], settings.get("mask", "")}
    if not path.exists():
        names = sorted(item.name for item in folder.iterdir() if item.suffix.lower() in SUFFIXES)
        names += [name for file in sorted(folder.glob("*.npz")) for name in reader.names_within(file)]
        where = str(folder / "photos.toml")
        return [
            {"file": name, **dict.fromkeys(NUMBERS, math.nan), "split": "", "body": _body({}, settings, folder, where)}
            for name in names
            if name not in others
        ]
    header, lines = read_csv(path, known=COLUMNS)
    rows, seen = [], set()
    for number, line in enumerate(lines, start=2):
        where = f"{path}: line {number}"
        if None in line or any(value is None for value in line.values()):
            raise SceneError(f"{where} has not {len(header)} cells, as the first line has")
        row: dict[str, Any] = {"file": line["file"].strip(), "split": (line.get("split") or "").strip()}
        if not row["file"]:
            raise SceneError(f"{where}: file is empty")
        if row["file"] in others:
            raise SceneError(f"{where}: file = {row['file']!r} is no press: photos.toml names it as no_contact or mask; take it out of one")
        if row["file"] in seen:
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
        given = {key: line[key].strip() for key in OBJECT if (line.get(key) or "").strip()}
        row["body"] = _body(given, settings, folder, where)
        rows.append(row)
    return rows


def _body(given: dict[str, str], settings: dict[str, Any], folder: Path, where: str) -> Body:
    """What was pressed: the ball of photos.toml, changed by a row's cells; rigid unless they say otherwise or give a hardness."""
    fields = {key: from_folder(f"object.{key}", parse_text(text, field_types(Body)[key], key), folder) for key, text in given.items()}
    ball = fields.get("shape", BALL) == BALL and "mesh" not in fields
    if ball and "radius_mm" not in fields:
        if "ball_radius_mm" not in settings:
            raise SceneError(f"{where}: ball_radius_mm is missing: give it in photos.toml, or radius_mm of each press in presses.csv")
        fields["radius_mm"] = settings["ball_radius_mm"]
    if ball:
        fields = {"shape": BALL, "height_mm": 2 * fields["radius_mm"]} | fields
    try:
        scene = build_scene({"object": {"rigid": True} | fields, "press": {"depth_mm": 0.1}})
    except GelsimError as error:
        raise SceneError(f"{where}: {error}") from None
    return scene.object
