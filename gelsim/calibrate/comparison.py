"""`gelsim compare`: photographs of known presses beside the sensor's own pictures of them, with what is between them.

A press is a row of presses.csv (`calibrate.photos`): what was pressed, where it touched and how deep. A ball's dent is that of its
axisymmetric press, moved to its place (`calibrate.dent`); of a ball place or depth may be missing, and are then found from the photograph:
three numbers by least squares on the renderer's own pictures, and where there are markers two more, how far it was dragged. Any other
object is pressed at its place, rows that differ in depth alone in one press. In place of a sensor there may be pictures drawn before,
paired with photographs by their names.

Place: where the pixel's ray meets the gel's surface at rest. Left out: a shape's place found from its photograph.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim import optics
from gelsim.calibrate import drawing, pictures, start
from gelsim.calibrate.dent import SHALLOWEST, DentFamily, distinct, effective_radius, solve_family
from gelsim.calibrate.parameters import PRESS, curvature_of
from gelsim.calibrate.photos import Photos, read_photos
from gelsim.calibrate.reading import SUFFIXES, Reader
from gelsim.data.metrics import picture_errors, said
from gelsim.errors import SceneError
from gelsim.membrane.surface import membrane_states, rest_membrane
from gelsim.optics.camera import seen_places
from gelsim.optics.isp import without_noise
from gelsim.optics.render import Renderer
from gelsim.optics.rest import resized, rest_pictures
from gelsim.pipeline import outputs, stages
from gelsim.results import Membrane
from gelsim.scene.definition import Press, Scene
from gelsim.scene.layers import build_scene
from gelsim.tables import write_csv
from gelsim.units import MM

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

SPP = 64
FOUND_WIDTH, FOUND_SPP = 120, 16
"""Of the pictures in which a place or a depth is sought."""
ROUNDS, STEP_MM = 8, 0.03
"""Of the search: steps of least squares, and those of its differences."""
ROWS = 24
"""On the sheet at most."""
SCORES = ("l1", "mse", "ssim", "psnr_db")


@dataclass(frozen=True)
class Drawing:
    """How presses are drawn: by a sensor (a preset or a sensor file), with this friction between object and gel, by this mode."""

    sensor: str
    friction: float | str = 0.8
    mode: str = "path"


def compare(
    folder: Path, out: Path, drawn: Drawing | Path, *, force: bool = False, device: str = "auto", progress: Progress | None = None
) -> dict[str, Any]:
    """Writes compare.png, compare.csv and report.json into `out`, and returns the report.

    Args:
        folder: Of photographs, as `calibrate.photos` describes.
        drawn: How their presses are drawn; or a folder of pictures that were (a result folder, or its frames/).
        force: Write over earlier files of these names.
    Raises:
        SceneError: Bad input, before anything is computed. SolveError: a press finds no equilibrium.
    """
    show = progress or (lambda stage, done, total: None)
    outputs.check_free(out, (out / name for name in ("compare.png", "compare.csv", "report.json")), force=force)
    photos = read_photos(folder)
    if not photos.files:
        raise SceneError(f"--photos {folder}: no photograph besides no_contact")
    if isinstance(drawn, Path):
        shown, rest = _drawn_before(drawn, photos), None
        presses: list[dict[str, Any]] = [{} for _ in photos.files]
    else:
        scene = _scene(drawn, photos)
        dents = _dents(scene, photos)
        presses = _presses(scene, photos, dents, device, show)
        membranes = [rest_membrane(scene), *_membranes(scene, photos, presses, dents, device, show)]
        frames = optics.render_frames(scene, membranes, device=device, progress=lambda done, total: show("render", done, total))
        rest, *shown = (frame.image.astype(float) for frame in frames)
    rows = _rows(photos, presses, shown)
    report: dict[str, Any] = {
        "out": str(out), "sensor": None if isinstance(drawn, Path) else drawn.sensor,
        "frames": str(drawn) if isinstance(drawn, Path) else None, "presses": rows,
        "scores": {key: {name: float(np.mean([row[key][name] for row in rows])) for name in SCORES} for key in ("drawn", "no_contact")},
    }  # fmt: skip
    if rest is not None:
        report["scores"]["rest"] = picture_errors(rest, photos.no_contact, photos.counted)
    report["mse_of_no_contact"] = report["scores"]["drawn"]["mse"] / max(report["scores"]["no_contact"]["mse"], 1e-12)
    plain = outputs.plain_json(report)
    assert isinstance(plain, dict)
    target = outputs.ResultFolder(out, resume=True)
    target.write("compare.png", lambda path: _sheet(path, photos, rest, shown, rows))
    target.write("compare.csv", lambda path: write_csv(path, [_flat(row) for row in plain["presses"]]))
    target.write("report.json", lambda path: outputs.write_report(path, plain))
    return plain


def summary(report: Mapping[str, Any]) -> str:
    """A report in a few lines for people."""
    lines = [f"{report['out']}: {len(report['presses'])} photographs"]
    for name, score in report["scores"].items():
        lines.append(said({"drawn": "drawn", "no_contact": "no contact instead", "rest": "without contact"}[name], score))
    return "\n".join(lines)


# ---- what was pressed, where, how deep ----


def _scene(drawn: Drawing, photos: Photos) -> Scene:
    """The sensor, drawn at the photographs' size, without noise."""
    scene = build_scene(
        {"sensor": {"preset": drawn.sensor}, "contact": {"friction_coefficient": drawn.friction}, "press": {"depth_mm": 0.1}},
        {"render": {"mode": drawn.mode, "spp": SPP, "resolution": list(photos.size)}},
    )
    # A picture's expectation, not one of its draws, is compared.
    scene = without_noise(scene.replace(gel=photos.gel or scene.gel))
    if scene.camera.has_rest:
        rest_pictures(scene)  # of another aspect than the photographs: refused before anything is solved
    return scene


def _presses(scene: Scene, photos: Photos, dents: DentFamily | None, device: str, show: Progress) -> list[dict[str, Any]]:
    """Of each press x_mm and y_mm of its first touch, and the rest of PRESS; whether they were found."""
    found = np.zeros((len(photos.files), len(PRESS)))
    found[:, :2] = np.nan
    given = np.isfinite(photos.hints[:, :2]).all(axis=1)
    found[given, :2] = seen_places(scene, photos.hints[given, :2]) / MM
    found[:, 2] = photos.hints[:, 2]
    missing = np.asarray(np.isnan(found).any(axis=1), bool)
    for index in np.flatnonzero(missing & np.isnan(photos.balls_mm)):
        raise SceneError(
            f"presses.csv: {photos.files[index]}: col_px, row_px and depth_mm of a press that is not a ball's must be given: only a "
            "ball's are found from its photograph"
        )
    if missing.any():
        assert dents is not None
        if photos.markers:  # which show what a hand has dragged
            found[missing, 3:] = np.nan
        found[missing] = _search(scene, photos.only(missing), found[missing], dents, device, show)
    return [dict(zip(PRESS, map(float, row), strict=True)) | {"found": bool(lost)} for row, lost in zip(found, missing, strict=True)]


def _dents(scene: Scene, photos: Photos) -> DentFamily | None:
    """Of the balls among the presses, if any."""
    balls = photos.balls_mm[np.isfinite(photos.balls_mm)]
    if len(balls) == 0:
        return None
    radii = distinct(effective_radius(balls, curvature_of(scene.gel)))
    return solve_family(scene.gel, radii, scene.gel.thickness_mm, scene.contact)


def _search(scene: Scene, photos: Photos, known: Array, dents: DentFamily, device: str, show: Progress) -> Array:
    """Balls' presses, shape (P, 5): what is NaN in `known` is found, the rest stays."""
    wide, high = photos.size
    size = min(wide, FOUND_WIDTH), round(min(wide, FOUND_WIDTH) * high / wide)
    seen = np.array([resized(picture, size) for picture in photos.pictures])
    mask = np.repeat(np.where(photos.counted, 255.0, 0.0)[..., None], 3, axis=2)
    rest, counted = resized(photos.no_contact, size), resized(mask, size)[..., 0] > 254
    contacts, sure = start.find_contacts(rest, seen, counted)
    for index in np.flatnonzero(~sure):
        raise SceneError(f"{photos.files[index]}: no contact can be seen in it: give col_px, row_px and depth_mm in presses.csv")
    per_px = scene.camera.field_mm[0] / size[0]
    small = scene.replace(render=replace(scene.render, resolution=size, spp=FOUND_SPP, mode="direct"))
    deepest = np.full(len(seen), 0.75 * scene.gel.thickness_mm)
    begun = start.rough_presses(seen_places(small, contacts[:, :2]) / MM, contacts[:, 2] * per_px, photos.balls_mm, deepest)
    places = np.where(np.isnan(known), begun, known)
    free = np.isnan(known)
    rows, columns = np.mgrid[: size[1], : size[0]] + 0.5
    near = np.hypot(columns - contacts[:, 0, None, None], rows - contacts[:, 1, None, None]) <= start.FELT * contacts[:, 2, None, None]

    variant = optics.choose_variant(device)
    renderer = Renderer(small, variant)

    def pictures_of(membranes: Sequence[Membrane]) -> Array:
        return np.array([frame.image for frame in optics.render_frames(small, membranes, variant=variant, renderer=renderer)], float)

    # What the press changes, in either: a preset's rest need not be this sensor's.
    still = pictures_of([rest_membrane(small)])

    def drawn(presses: Array) -> Array:
        dented = [_ball(small, dents, ball, press) for ball, press in zip(photos.balls_mm, presses, strict=True)]
        return (pictures_of(dented) - still) * (near & counted)[..., None]

    wanted = (seen - rest) * (near & counted)[..., None]
    damping = np.full(len(seen), 1e-2)
    here = drawn(places)
    cost = ((wanted - here) ** 2).sum(axis=(1, 2, 3))
    for done in range(ROUNDS):
        show("search", done, ROUNDS)
        columns_of = np.zeros((*here.shape, len(PRESS)))
        for k in np.flatnonzero(free.any(axis=0)):
            moved = places.copy()
            moved[:, k] += STEP_MM
            columns_of[..., k] = (drawn(moved) - here) / STEP_MM
        trial = places.copy()
        for index in range(len(seen)):
            some = np.flatnonzero(free[index])
            jacobian = columns_of[index].reshape(-1, len(PRESS))[:, some]
            normal = jacobian.T @ jacobian
            normal += damping[index] * np.diag(np.diag(normal) + 1e-9)
            trial[index, some] += np.clip(np.linalg.solve(normal, jacobian.T @ (wanted - here)[index].ravel()), -0.5, 0.5)
        trial[:, 2] = np.clip(trial[:, 2], 2 * SHALLOWEST, 0.75 * scene.gel.thickness_mm)
        there = drawn(trial)
        new = ((wanted - there) ** 2).sum(axis=(1, 2, 3))
        better = new < cost
        places[better], here[better], cost[better] = trial[better], there[better], new[better]
        damping = np.where(better, damping / 5, damping * 10)
    show("search", ROUNDS, ROUNDS)
    return places


def _ball(scene: Scene, dents: DentFamily, ball_mm: float, press: Array) -> Membrane:
    """The surface under a ball that touched first at press[:2] [mm]; the rest of `press` is that of PRESS."""
    apex = press[:2] * (1 + ball_mm * curvature_of(scene.gel))
    return drawing.dented(scene, dents, ball_mm, np.array([*apex, *press[2:]]))


def _membranes(
    scene: Scene, photos: Photos, presses: Sequence[Mapping[str, Any]], dents: DentFamily | None, device: str, show: Progress
) -> list[Membrane]:  # fmt: skip
    """The surface at every press."""
    balls = photos.balls_mm
    at = [np.array([press[name] for name in PRESS]) for press in presses]
    surfaces: dict[int, Membrane] = {}
    if dents is not None:
        surfaces |= {int(index): _ball(scene, dents, balls[index], at[index]) for index in np.flatnonzero(np.isfinite(balls))}
    groups: dict[Any, list[int]] = {}
    for index in np.flatnonzero(np.isnan(balls)):
        groups.setdefault((photos.bodies[index], *at[index][:2]), []).append(int(index))
    for number, ((body, x, y), members) in enumerate(groups.items()):
        show("press", number, len(groups))
        depths = [at[index][2] for index in members]
        pressed = scene.replace(
            object=body, press=Press(depth_mm=max(depths), force_n=None, frames=10, offset_mm=(float(x), float(y)), touch_at="centre")
        )
        deformation = stages.press(pressed, device=device)
        surfaces |= zip(members, membrane_states(scene, _at_depths(deformation, depths)), strict=True)
        show("press", number + 1, len(groups))
    return [surfaces[index] for index in range(len(balls))]


def _at_depths(deformation: Any, depths_mm: Sequence[float]) -> Any:
    """The press at these depths, linear between its recorded states."""
    place = np.interp(np.array(depths_mm) * MM, deformation.approach, np.arange(len(deformation.approach)))
    low = np.minimum(place.astype(int), len(deformation.approach) - 2)
    share = (place - low)[:, None, None]
    moved = deformation.gel.displacement
    return replace(deformation, gel=replace(deformation.gel, displacement=(1 - share) * moved[low] + share * moved[low + 1]))


def _drawn_before(frames: Path, photos: Photos) -> list[Array]:
    """Of each photograph the picture of its name."""
    folder = frames / "frames" if (frames / "frames").is_dir() else frames
    if not folder.is_dir():
        raise SceneError(f"--frames {frames}: is no folder")
    there = {path.stem: path.name for path in sorted(folder.iterdir()) if path.suffix.lower() in SUFFIXES}
    reader, found = Reader(folder), []
    for name in photos.files:
        stem = Path(name).stem
        if stem not in there:
            raise SceneError(f"--frames {folder}: holds no picture {stem!r} for {name}: pictures are paired by their names")
        picture = reader.levels(there[stem])
        if picture.shape != photos.no_contact.shape:
            (h, w), (wide, high) = picture.shape[:2], photos.size
            raise SceneError(f"{folder / there[stem]}: is {w} x {h} px, but the photographs are {wide} x {high} px")
        found.append(picture)
    return found


# ---- what is said of them ----


def _rows(photos: Photos, presses: Sequence[Mapping[str, Any]], shown: Sequence[Array]) -> list[dict[str, Any]]:
    rows = []
    for name, body, press, picture, seen in zip(photos.files, photos.bodies, presses, shown, photos.pictures, strict=True):
        rows.append(
            {"file": name, "shape": body.shape, **press}
            | {
                "drawn": picture_errors(picture, seen, photos.counted),
                "no_contact": picture_errors(photos.no_contact, seen, photos.counted),
            }
        )
    return rows


def _flat(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row of the table: scores by their own name, those of no contact marked."""
    plain = {key: value for key, value in row.items() if not isinstance(value, dict)}
    return plain | row["drawn"] | {f"no_contact_{key}": value for key, value in row["no_contact"].items()}


def _sheet(path: Path, photos: Photos, rest: Array | None, shown: Sequence[Array], rows: Sequence[Mapping[str, Any]]) -> None:
    """The presses, or ROWS of them spread evenly; the rest above them."""
    some = np.unique(np.linspace(0, len(rows) - 1, ROWS).round().astype(int))
    seen, drawn = [photos.pictures[index] for index in some], [shown[index] for index in some]
    captions = []
    for index in some:
        row = rows[index]
        place = f", depth {row['depth_mm']:.2f} mm{' (found)' if row['found'] else ''}" if "depth_mm" in row else ""
        captions.append(
            f"{row['file']}: {row['shape']}{place}; MSE {row['drawn']['mse']:.0f} (no contact {row['no_contact']['mse']:.0f}), "
            f"PSNR {row['drawn']['psnr_db']:.1f} dB, SSIM {row['drawn']['ssim']:.3f}"
        )
    if rest is not None:
        seen, drawn, captions = [photos.no_contact, *seen], [rest, *drawn], ["without contact", *captions]
    still = [photos.no_contact] * len(seen)
    columns = (
        ("photograph", seen),
        ("drawn", drawn),
        (f"photograph - drawn, x {pictures.GAIN:g}", pictures.residuals(seen, drawn)),
        (f"photograph - no contact, x {pictures.GAIN:g}", pictures.residuals(seen, still)),
    )
    pictures.draw_comparison(path, columns, captions)
