"""The result folder: what each file of a press or a render holds (interfaces: README.md), written whole or not at all.

Every file is written under a temporary name and renamed. A folder is made only when there is something to put into it, and one that holds
results already is refused unless the caller says `force` (replace them) or `resume` (go on).
"""

from __future__ import annotations

import csv
import dataclasses
import json
import math
import os
import shutil
import subprocess
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import SceneError, SolveStatus
from gelsim.results import Deformation, Frame, SolveReport, SurfaceMotion
from gelsim.scene.definition import Scene
from gelsim.scene.layers import dump_scene
from gelsim.tables import read_csv
from gelsim.units import MM

PICTURES = "frames", "radiance", "video.mp4", "height.npz", "markers.csv", "sheet.png"
"""Names of what is drawn into a result folder."""
RESULTS = "scene.toml", "report.json", "press.npz", "probe.csv", *PICTURES
"""Names that gelsim writes into a result folder; `force` removes these and nothing else."""

ACCOUNT = {"meshes": dict, "choices": dict, "warnings": list, "info": dict, "mesh_sha256": str}
"""What press.npz holds for the report of a press that is taken from it (`stages.Record`, `SolveReport`), and of its mesh file."""

VIDEO_SECONDS = 2.5
"""A press lasts about this long in video.mp4 (in truth: depth over speed, 0.2 s): long enough to look at ten frames."""
VIDEO_FPS = (4, 30)
"""Bounds of the video's frame rate."""


def check_free(out: Path, paths: Iterable[Path], *, force: bool) -> None:
    """Raises SceneError where one of the files that go to `out` exists already, without `force`."""
    for path in paths:
        if path.exists() and not force:
            raise SceneError(f"--out {out}: {path} exists; give --force to write over it, or another folder")


class ResultFolder:
    """A folder that comes into being with its first whole file."""

    def __init__(self, path: Path, *, force: bool = False, resume: bool = False) -> None:
        """Checks that results can go there; writes nothing that stays.

        Raises:
            SceneError: It holds files and neither `force` nor `resume` was given, is no folder, or cannot be written to.
        """
        self.path = path
        try:
            if path.exists() and not path.is_dir():
                raise SceneError(f"--out {path}: is a file, not a folder")
            if path.is_dir() and any(path.iterdir()) and not (force or resume):
                raise SceneError(
                    f"--out {path}: the folder is not empty; give --force to replace results in it, --resume to go on, or another name"
                )
            # In a folder that is there: one made for the trial and removed again may be another worker's to write into.
            there = next(folder for folder in (path, *path.parents) if folder.exists())
            trial = there / f".gelsim-{os.getpid()}.partial"
            trial.touch()
            trial.unlink()
        except OSError as error:
            raise SceneError(f"--out {path}: cannot be written to ({error.strerror}); give another folder") from None

    def remove(self, names: Iterable[str] = RESULTS) -> None:
        """Removes earlier results."""
        for name in names:
            target = self.path / name
            shutil.rmtree(target) if target.is_dir() and not target.is_symlink() else target.unlink(missing_ok=True)

    def write(self, name: str, writer: Callable[[Path], object]) -> Path:
        """Lets `writer` make a file or a folder under a temporary name and renames it to `name` when it is whole."""
        target = self.path / name
        partial = target.with_name(f".{target.stem}-{os.getpid()}.partial{target.suffix}")
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            writer(partial)
            if target.is_dir():
                shutil.rmtree(target)
            os.replace(partial, target)
        except OSError as error:
            raise SceneError(f"{target}: cannot be written ({error.strerror or error})") from None
        finally:
            if partial.is_dir():
                shutil.rmtree(partial)
            else:
                partial.unlink(missing_ok=True)
        return target


# ---- press ----


def press_arrays(scene: Scene, deformation: Deformation) -> dict[str, NDArray]:
    """The arrays of press.npz: name -> array in SI units (table in README.md)."""
    d = deformation
    return {
        "approach": d.approach,
        "time": d.time,
        "force": d.force,
        "contact_area": d.contact_area,
        "contact_pressure": d.contact_pressure,
        "gel_rest": d.gel.rest,
        "gel_faces": d.gel.faces,
        "gel_faces6": d.gel.faces6,
        "gel_displacement": d.gel.displacement,
        "object_rest": d.object.rest,
        "object_faces": d.object.faces,
        "object_faces6": d.object.faces6,
        "object_displacement": d.object.displacement,
        "min_jacobian": d.min_jacobian,
        "penetration": d.penetration,
        "newton_iterations": d.newton_iterations,
        "linear_iterations": d.linear_iterations,
        "seconds": d.seconds,
        "converged": d.converged,
        "status": np.array(d.status.name),
    }


def write_press(path: Path, scene: Scene, deformation: Deformation, account: Mapping[str, Any] | None = None) -> None:
    """Writes press.npz; `account` is what report.json is to say of a press that is taken from here."""
    told = np.array(json.dumps(plain_json(account or {}), allow_nan=False))
    _write_arrays(path, press_arrays(scene, deformation) | {"account": told})


def _write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """An .npz file as by NumPy's `savez_compressed`, in less than half its time, and no larger by 1 %."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as kept:
        for name, array in arrays.items():
            with kept.open(f"{name}.npy", "w", force_zip64=True) as file:
                np.lib.format.write_array(file, np.asanyarray(array), allow_pickle=False)


def read_account(path: Path) -> dict[str, Any]:
    """The `account` that a press.npz was written with; empty where it has none.

    Raises:
        SceneError: The file is missing or holds something else.
    """
    try:
        with np.load(path, allow_pickle=False) as data:
            account = json.loads(str(data["account"])) if "account" in data.files else {}
        if not isinstance(account, dict) or any(type(account.get(name, kind())) is not kind for name, kind in ACCOUNT.items()):
            raise ValueError("its account is none")
        solve_report(account)
    except (OSError, ValueError, KeyError, TypeError, RecursionError, zipfile.BadZipFile) as error:
        raise SceneError(f"{path}: is not a press.npz of gelsim ({error})") from None
    return account


def solve_report(account: Mapping[str, Any]) -> SolveReport:
    """The report that an account holds."""
    return SolveReport.from_table(account.get("info", {}))


def read_press(path: Path) -> Deformation:
    """A press.npz as it was solved.

    Raises:
        SceneError: The file is missing or holds something else.
    """
    try:
        with np.load(path, allow_pickle=False) as data:
            stored = {name: data[name] for name in data.files}
        gel, body = (
            SurfaceMotion(stored[f"{side}_rest"], stored[f"{side}_faces"], stored[f"{side}_displacement"], stored[f"{side}_faces6"])
            for side in ("gel", "object")
        )
        named = {item.name: stored[item.name] for item in dataclasses.fields(Deformation) if item.name in stored and item.name != "status"}
        return Deformation(gel=gel, object=body, status=SolveStatus[str(stored["status"])], **named)
    except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
        raise SceneError(f"{path}: is not a press.npz of gelsim ({error})") from None


def read_probe_points(path: Path) -> NDArray[np.float64]:
    """Rest points (P, 2) [m] from a CSV file with the columns x_mm, y_mm.

    Raises:
        SceneError: No such file, other columns, or a cell that is no finite number.
    """
    _, rows = read_csv(path, f"--probe {path}")
    points = []
    for number, row in enumerate(rows, start=2):
        try:
            point = (float(row["x_mm"]), float(row["y_mm"]))
        except KeyError:
            raise SceneError(f"--probe {path}: the first line must name the columns x_mm,y_mm") from None
        except (TypeError, ValueError):
            raise SceneError(f"--probe {path}: line {number} is not two numbers") from None
        if not all(map(math.isfinite, point)):
            raise SceneError(f"--probe {path}: line {number} is not finite")
        points.append(point)
    if not points:
        raise SceneError(f"--probe {path}: holds no points")
    return np.array(points) * MM


def check_probe_points(points: NDArray[np.float64], scene: Scene, name: str = "--probe") -> None:
    """Raises SceneError for a point that is not on the gel; `name` is where the points come from."""
    half = 0.5 * np.array(scene.gel.size_mm) * MM
    outside = np.flatnonzero((np.abs(points) > half).any(axis=1))
    if len(outside):
        x, y = points[outside[0]] / MM
        raise SceneError(
            f"{name}: point {outside[0] + 1} at x = {x:g} mm, y = {y:g} mm is off the gel: "
            f"it ends at ±{half[0] / MM:g}, ±{half[1] / MM:g} mm"
        )


def sample_surface(motion: SurfaceMotion, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rest positions and displacements of a surface at rest points (x, y), by the shape functions of its six-node faces.

    Exact at nodes, and for displacements that are quadratic in a face.

    Args:
        motion: A surface that is a graph over x, y at rest, such as the gel's outer face.
        points: (P, 2) [m].
    Returns:
        Rest positions (P, 3) [m] and displacements (N, P, 3) [m].
    """
    nodes, value = surface_shares(motion.rest, motion.faces6, points)
    rest = np.einsum("pk,pkc->pc", value, motion.rest[nodes])
    return rest, np.einsum("pk,npkc->npc", value, motion.displacement[:, nodes])


def surface_shares(
    rest: NDArray[np.float64], faces6: NDArray[np.int32], points: NDArray[np.float64]
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """The nodes (P, 6) of the faces that hold some rest points (P, 2) [m], and their shares (P, 6) in what a field is there.

    The face that holds a point is found from its corners; its place in the face by Newton's method on the quadratic map, so that mid-side
    nodes that are off the middle count.

    Args:
        rest: (G, 3) [m], and faces6 (F, 6), of a surface that is a graph over x, y.
    """
    corners = rest[faces6[:, :3], :2]
    edge_s, edge_t = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    determinant = edge_s[:, 0] * edge_t[:, 1] - edge_s[:, 1] * edge_t[:, 0]
    usable = np.abs(determinant) > 1e-9 * np.abs(determinant).max()
    faces = faces6[usable]
    corners, edge_s, edge_t, determinant = corners[usable], edge_s[usable], edge_t[usable], determinant[usable]
    chosen = np.empty(len(points), np.int64)
    place = np.empty((len(points), 2))
    for i, point in enumerate(points):
        away = point - corners[:, 0]
        s = (away[:, 0] * edge_t[:, 1] - away[:, 1] * edge_t[:, 0]) / determinant
        t = (edge_s[:, 0] * away[:, 1] - edge_s[:, 1] * away[:, 0]) / determinant
        chosen[i] = np.argmax(np.minimum(np.minimum(s, t), 1.0 - s - t))
        place[i] = s[chosen[i]], t[chosen[i]]
    nodes = faces[chosen]
    rest_xy = rest[nodes, :2]
    # The map differs from its straight part by the mid-side nodes' small shifts: Newton is done after two or three rounds; six are free.
    for _ in range(6):
        value, slope = _face_shape(place)
        residual = np.einsum("pk,pkc->pc", value, rest_xy) - points
        place -= np.linalg.solve(np.einsum("pkd,pkc->pcd", slope, rest_xy), residual[..., None])[..., 0]
    return nodes, _face_shape(place)[0]


def _face_shape(place: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Quadratic shape functions (P, 6) of a six-node face and their slopes (P, 6, 2) at (s, t) (P, 2)."""
    s, t = place.T
    r = 1.0 - s - t
    value = np.stack([r * (2 * r - 1), s * (2 * s - 1), t * (2 * t - 1), 4 * r * s, 4 * s * t, 4 * t * r], axis=1)
    zero = np.zeros_like(s)
    along_s = np.stack([1 - 4 * r, 4 * s - 1, zero, 4 * (r - s), 4 * t, -4 * t], axis=1)
    along_t = np.stack([1 - 4 * r, zero, 4 * t - 1, -4 * s, 4 * s, 4 * (r - t)], axis=1)
    return value, np.stack([along_s, along_t], axis=2)


def write_probe(path: Path, deformation: Deformation, points: NDArray[np.float64]) -> None:
    """Writes probe.csv: the gel's outer surface at rest points (P, 2) [m], every frame."""
    rest, displacement = sample_surface(deformation.gel, points)
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["frame", "x_mm", "y_mm", "ux_mm", "uy_mm", "uz_mm", "z_mm"])
        for frame, moved in enumerate(displacement):
            for point, start, u in zip(points, rest, moved, strict=True):
                numbers = [*point, *u, start[2] + u[2]]
                table.writerow([frame, *(f"{number / MM:.9g}" for number in numbers)])


# ---- render ----


def write_image(path: Path, image: NDArray[np.uint8]) -> None:
    """Writes an 8-bit sRGB picture, lossless."""
    from PIL import Image

    Image.fromarray(image).save(path, format="PNG")


def write_radiance(path: Path, radiance: NDArray[np.float32]) -> None:
    """Writes linear RGB as an OpenEXR file."""
    import OpenEXR

    pixels = np.ascontiguousarray(radiance, np.float32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"RGB": pixels}) as file:
        file.write(str(path))


def write_frames(path: Path, frames: Sequence[Frame]) -> None:
    """Writes a folder of NNNN.png."""
    path.mkdir()
    for index, frame in enumerate(frames):
        write_image(path / f"{index:04d}.png", frame.image)


def write_radiances(path: Path, frames: Sequence[Frame]) -> None:
    """Writes a folder of NNNN.exr."""
    path.mkdir()
    for index, frame in enumerate(frames):
        write_radiance(path / f"{index:04d}.exr", frame.radiance)


def video_fps(frames: int) -> int:
    """Frames a second of video.mp4, so that the press takes about VIDEO_SECONDS."""
    low, high = VIDEO_FPS
    return int(min(max(round(frames / VIDEO_SECONDS), low), high))


def write_video(path: Path, frames: Sequence[Frame]) -> None:
    """Writes the video of a press.

    Raises:
        OSError: ffmpeg failed.
    """
    encode_video(path, [frame.image for frame in frames], video_fps(len(frames)))


def encode_video(path: Path, images: Sequence[NDArray[np.uint8]], fps: int) -> None:
    """Writes an MP4 that browsers play: H.264, 4:2:0, even sizes, index at the front.

    Args:
        images: 8-bit sRGB, (H, W, 3) each.
        fps: Frames a second.
    Raises:
        OSError: ffmpeg failed.
    """
    import imageio_ffmpeg

    images = [_even(image) for image in images]
    height, width = images[0].shape[:2]
    command = [
        imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error",
        "-f", "rawvideo", "-pixel_format", "rgb24", "-video_size", f"{width}x{height}", "-framerate", str(fps),
        "-i", "-",
        "-vf", "scale=out_color_matrix=bt709:out_range=tv,format=yuv420p", "-c:v", "libx264", "-crf", "14", "-threads", "2",
        "-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709", "-movflags", "+faststart", "-f", "mp4", str(path),
    ]  # fmt: skip
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        assert child.stdin is not None and child.stderr is not None
        try:
            for image in images:
                child.stdin.write(image.tobytes())
            child.stdin.close()
        except BrokenPipeError:
            pass  # ffmpeg gave up; its message and exit code say why
        message = child.stderr.read().decode(errors="replace").strip()
    if child.returncode:
        raise OSError(f"ffmpeg: {message[-300:]}")


def _even(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """4:2:0 colour needs even sizes: an odd last row or column is doubled."""
    height, width = image.shape[:2]
    return np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")


def write_heights(path: Path, frames: Sequence[Frame]) -> None:
    """Writes height.npz: `height` (N, H, W) float32 [m], z of the membrane seen by each pixel, NaN where there is no gel."""
    _write_arrays(path, {"height": np.stack([frame.height for frame in frames])})


MARKER_COLUMNS = ("frame", "id", "col", "row")
"""Of markers.csv."""


def write_markers(path: Path, frames: Iterable[Frame]) -> None:
    """Writes markers.csv: frame, id, col, row [px] of every marker's centre; markers outside the picture are left out."""
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(MARKER_COLUMNS)
        for index, frame in enumerate(frames):
            table.writerows(marker_rows(index, frame.marker_pixels))


def marker_rows(index: int, marker_pixels: NDArray[np.float64]) -> Iterator[tuple[int, int, str, str]]:
    """Lines of markers.csv for frame `index`, of markers at (column, row) [px], (K, 2)."""
    for marker in np.flatnonzero(np.isfinite(marker_pixels).all(axis=1)):
        col, row = marker_pixels[marker]
        yield index, int(marker), f"{col:.4f}", f"{row:.4f}"


# ---- both ----


def write_scene(path: Path, scene: Scene) -> None:
    """Writes scene.toml, every field resolved."""
    path.write_text(dump_scene(scene), encoding="utf-8")


def write_report(path: Path, report: Mapping[str, object]) -> None:
    """Writes report.json."""
    path.write_text(json.dumps(report, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def plain_json(value: object) -> object:
    """A value with NumPy numbers and arrays made plain, and numbers that JSON does not know (NaN, infinity) made null."""
    if isinstance(value, dict):
        return {str(key): plain_json(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, set, frozenset, np.ndarray)):
        return [plain_json(item) for item in (sorted(value) if isinstance(value, (set, frozenset)) else value)]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, (str, int, float, bool)) else str(value)
