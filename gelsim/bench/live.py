"""Sections `live` and `live-rate`: what `gelsim.LiveSensor` answers beside our own finite elements, and how fast.

Each case is a rigid press solved with `balanced`, and the same way walked by the live sensor; both are compared at three depths, within
1.5 contact radii of the contact's middle (radius of the disc of the finite elements' contact area). Height: of the surface over places
in space. Sideways: motion along the gel of the material points there, which markers show. The finite elements have an error of their
own, which `error_estimate` of their report puts at some per cent of the force (docs/validation.md).
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from gelsim import fem
from gelsim.bench.section import Case, Layer, Options, Row, Section
from gelsim.errors import SolveStatus
from gelsim.live.sensor import LiveFrame, LiveSensor
from gelsim.membrane.clough_tocher import Interpolation
from gelsim.pipeline import stages
from gelsim.results import Deformation
from gelsim.scene.definition import Scene
from gelsim.scene.layers import assets_folder, build_scene
from gelsim.units import MM

Array = NDArray[np.float64]

THICKNESS_MM = 2.4
SHARES = (0.1, 0.25, 0.4)
"""Of the thickness, where both are compared."""
FRAMES = 9
"""First touch and eight steps: each share is one of them."""
NEAR = 1.5
"""Contact radii."""

BALL = {"shape": "hemisphere", "height_mm": 12.0}
PRESSES: dict[str, Layer] = {
    "ball R 3": {"object": {**BALL, "radius_mm": 3.0}},
    "ball R 8": {"object": {**BALL, "radius_mm": 8.0}},
    "ball R 8, no friction": {"object": {**BALL, "radius_mm": 8.0}, "contact": {"friction_coefficient": 0.0}},
    "ball R 5, 5 mm off centre": {"object": {**BALL, "radius_mm": 5.0}, "press": {"offset_mm": [4.0, 3.0]}},
    "ball R 5, sheared by half its depth": {"object": {**BALL, "radius_mm": 5.0}, "press": {"shear_mm": [0.48, 0.0]}},
    "ball R 5, sheared by its depth": {"object": {**BALL, "radius_mm": 5.0}, "press": {"shear_mm": [0.96, 0.0]}},
    "dome, ball R 5": {"gel": {"profile": "dome"}, "object": {**BALL, "radius_mm": 5.0}},
    "dome, ball R 5, 5 mm off centre": {
        "gel": {"profile": "dome"},
        "object": {**BALL, "radius_mm": 5.0},
        "press": {"offset_mm": [4.0, 3.0]},
    },
    "box 6 × 8, rims": {"object": {"shape": "box", "width_mm": 6.0, "length_mm": 8.0, "height_mm": 8.0}},
    "cylinder R 5, 10 long": {"object": {"shape": "cylinder", "radius_mm": 5.0, "length_mm": 10.0, "height_mm": 10.0}},
    "emboss 8 × 8, dots of 0.2": {"object": {"shape": "emboss", "width_mm": 8.0, "length_mm": 8.0, "height_mm": 6.0}},
    "hexagonal nut, a mesh file": {"object": {"shape": "mesh", "mesh": str(assets_folder() / "meshes" / "hex_nut.stl")}},
}
QUICK = ("ball R 8", "ball R 5, sheared by half its depth")


def scene_of(name: str) -> Scene:
    """The scene of a press: the paper's sensor with a flat gel unless it says otherwise, friction 0.5."""
    base: Layer = {
        "gel": {"profile": "flat", "thickness_mm": THICKNESS_MM},
        "object": {"rigid": True},
        "contact": {"friction_coefficient": 0.5},
        "press": {"depth_mm": SHARES[-1] * THICKNESS_MM, "frames": FRAMES},
        "render": {"resolution": [320, 240]},
    }
    return build_scene(base, PRESSES[name])


def way(scene: Scene, approach: Array) -> list[Array]:
    """Poses of a press's object at approaches [m]; without twist."""
    from scipy.spatial.transform import Rotation

    turn, shift = fem.rigid_placement(scene)
    quaternion = Rotation.from_matrix(turn).as_quat()[[3, 0, 1, 2]]
    assert scene.press.depth_mm is not None
    along = np.array([*scene.press.shear_mm, -scene.press.depth_mm]) / scene.press.depth_mm
    return [np.array([*(shift + along * gone), *quaternion]) for gone in approach]


@lru_cache(maxsize=2)
def _both(name: str) -> tuple[Deformation, LiveSensor, list[LiveFrame], list[Array]]:
    """The press, and the live sensor's frames and displacements of the gel's nodes on the same way."""
    scene = scene_of(name)
    press = stages.press(scene, throw=False)
    sensor = LiveSensor(scene, image=False)
    frames, moved = [], []
    for pose in way(scene, press.approach):
        frames.append(sensor.step(pose, 1.0 / scene.camera.fps))
        moved.append(sensor.displaced(press.gel.rest[:, :2]))
    return press, sensor, frames, moved


def compared(name: str, share: float) -> Row:
    """Errors of the live sensor at one depth."""
    press, sensor, frames, moved = _both(name)
    depth = share * THICKNESS_MM * MM
    state = int(np.argmin(np.abs(press.approach - depth)))
    if abs(press.approach[state] - depth) > 1e-6 * MM:
        return {"status": "SolveError", "message": f"not reached: {press.message}"}
    frame, solved, motion = frames[state], press.force[state], press.gel.displacement[state]
    now = press.gel.rest + motion
    weight = np.maximum(press.contact_pressure[state], 0.0)
    middle = (weight[:, None] * now[:, :2]).sum(axis=0) / weight.sum()
    radius = NEAR * float(np.sqrt(press.contact_area[state] / np.pi))
    x, y = np.meshgrid(sensor.x, sensor.y)
    near = np.hypot(x - middle[0], y - middle[1]) < radius
    height = heights_over(press, state, np.column_stack([x[near], y[near]]))
    rest = np.hypot(*(press.gel.rest[:, :2] - middle).T) < radius
    sideways = (moved[state] - motion)[rest, :2]
    row: Row = {
        "status": SolveStatus.CONVERGED.name,
        "share": share,
        "force_n": float(-solved[2]),
        "height_um": _rms(frame.height[near] - height) * 1e6,
        "force_percent": float(100 * (frame.force[2] / solved[2] - 1)),
        "marker_um": _rms(np.linalg.norm(sideways, axis=1)) * 1e6,
        "motion_um": float(np.linalg.norm(motion[rest, :2], axis=1).max()) * 1e6,
    }
    if np.linalg.norm(solved[:2]) > 0.02 * abs(solved[2]):
        row["shear_percent"] = float(100 * np.linalg.norm(frame.force[:2] - solved[:2]) / np.linalg.norm(solved[:2]))
    return {key: float(f"{value:.3g}") if isinstance(value, float) else value for key, value in row.items()}


def heights_over(press: Deformation, state: int, places: Array) -> Array:
    """z of a press's membrane over places in space (M, 2) [m], (M,)."""
    now = press.gel.rest + press.gel.displacement[state]
    surface = Interpolation(now[:, :2])
    return (surface.operator(places) @ surface.with_gradients(now[:, 2:]))[:, 0]


def _rms(values: NDArray) -> float:
    return float(np.sqrt(np.mean(np.asarray(values, float) ** 2)))


def _cases(options: Options) -> Iterator[Case]:
    for name in QUICK if options.quick else PRESSES:
        for share in SHARES:
            yield Case(f"{name}: {share:g}", partial(compared, name, share))


def _remarks(rows: list[Row]) -> str:
    lines = []
    for share in SHARES:
        part = [row for row in rows if row.get("share") == share]
        if part:
            worst = {key: max(abs(row[key]) for row in part if key in row) for key in ("height_um", "force_percent", "marker_um")}
            middle = {key: float(np.median([abs(row[key]) for row in part if key in row])) for key in worst}
            lines.append(
                f"At {share:g} of the thickness, median and worst of {len(part)}: height {middle['height_um']:.3g} and "
                f"{worst['height_um']:.3g} µm, force {middle['force_percent']:.3g} and {worst['force_percent']:.3g} %, markers "
                f"{middle['marker_um']:.3g} and {worst['marker_um']:.3g} µm."
            )
    return "\n".join(lines)


SECTION = Section(
    title="Live: beside finite elements",
    columns=(
        ("press: depth / thickness", "name"),
        ("force [N]", "force_n"),
        ("height, RMS [µm]", "height_um"),
        ("force [%]", "force_percent"),
        ("shear force [%]", "shear_percent"),
        ("markers, RMS [µm]", "marker_um"),
        ("of their motion [µm]", "motion_um"),
    ),
    cases=_cases,
    remarks=_remarks,
)
