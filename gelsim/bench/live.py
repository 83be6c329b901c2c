"""Section `live`: `fidelity = "live"` beside our own finite elements, on the drawn presses of `live_presses` and on loops.

Each press is solved at `TRUTH` and walked by the live sensor; both are compared at three depths, on a regular net of places within 1.5
contact radii of the contact's middle (radius of the disc of the finite elements' contact area). Height: of the surface over places in
space. Markers: motion along the gel of the material points there. Shear force: of the vectors, where it is over 2 % of the normal force.
Picture: by the sensor's baked light, of the pixels there; the light has an error of its own (docs/optics.md). Some presses are solved at
`FINER` too: what `TRUTH` is off by itself. A loop begins and ends beside the gel, so that the work done is what friction took; finite
elements tell that by itself, as a sum over slips, in which what is stored and given back again has no rounding of steps.

What is solved is kept in the result folder: with it all rows are measured again in a minute.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache, partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gelsim import fem
from gelsim.bench import live_presses, mesh_parts
from gelsim.bench.live_presses import SHARES, THICKNESS_MM
from gelsim.bench.motion import loop_area
from gelsim.bench.report import table
from gelsim.bench.section import KEPT_FOLDER, Case, Layer, Options, Row, Section
from gelsim.data.metrics import picture_errors
from gelsim.errors import SolveStatus
from gelsim.live.sensor import LiveSensor, part_way
from gelsim.membrane.clough_tocher import Interpolation
from gelsim.pipeline import stages
from gelsim.pipeline.outputs import surface_shares
from gelsim.results import Deformation
from gelsim.scene.definition import Scene
from gelsim.units import MM

Array = NDArray[np.float64]

COUNT, QUICK_COUNT, SOFT_COUNT = live_presses.SOFT, 1, 12
TRUTH, FINER = "balanced", "reference"
TWICE = range(0, COUNT, 17)
"""Presses that are solved at `FINER` too: one of each kind."""
NEAR = 1.5
"""Contact radii."""
NET = 24
"""Places across."""
LEAST_SHEAR = 0.02
"""Of the normal force."""
BOUNDS: dict[str, tuple[str, tuple[float, float, float]]] = {
    "height_um": ("height, RMS [µm]", (2.0, 5.0, 12.0)),
    "force_percent": ("normal force [%]", (3.0, 5.0, 10.0)),
    "shear_percent": ("shear force [%]", (10.0, 10.0, 10.0)),
    "marker_um": ("markers, RMS [µm]", (10.0, 25.0, 40.0)),
    "picture_db": ("picture [dB]", (38.0, 35.0, 32.0)),
}
"""What is asked, by `SHARES`: at most so much, of pictures at least."""
SOFTER = 2.0
"""Times as much may soft objects be off."""
WANTED = 0.9
"""Of the presses."""
COMMAND = "`gelsim bench --only live`"
WORST = 10

BALL: Layer = {"shape": "hemisphere", "radius_mm": 5.0, "height_mm": 12.0, "rigid": True}
LOOPS: dict[str, list[Layer]] = {
    "shear ± 0.06 mm, partial slip": [{"shear_mm": [x, 0.0]} for x in (0.06, -0.06, 0.06, -0.06)],
    "shear ± 0.2 mm": [{"shear_mm": [x, 0.0]} for x in (0.2, -0.2, 0.2)],
    "shear ± 0.6 mm": [{"shear_mm": [x, 0.0]} for x in (0.6, -0.6, 0.6)],
    "twist ± 6°": [{"twist_deg": x} for x in (6.0, -6.0, 6.0)],
    "twist ± 20°": [{"twist_deg": x} for x in (20.0, -20.0, 20.0)],
    "sheared 0.3 mm, to 0.8 mm, lifted": [{"shear_mm": [0.3, 0.0]}, {"depth_mm": 0.8}],
}
"""Ways of a ball of R 5 mm, 0.6 mm deep, friction 0.3, before it is lifted off. Of the shears the area counts from the first turn to where
the ball is there again; of the others all that friction took."""
STATES = 8
"""Of a leg."""
WORK_PIECES = 4
"""Of the way between two of them, where work is summed up: with one 6 %, with two 3 % of it is missing where the ball is lifted off."""


# ---- presses ----


@lru_cache(maxsize=2)
def _solved(index: int, seed: int, fidelity: str, folder: Path) -> tuple[Scene, Deformation]:
    _, drawn = live_presses.draw(index, seed)
    if fidelity == stages.LIVE:
        scene = mesh_parts.built(drawn, folder)
        return scene, stages.press(scene.replace(fidelity=fidelity))
    return mesh_parts.built(drawn, folder), live_presses.solved(drawn, folder, fidelity)


def measured(index: int, share: float, folder: Path, seed: int = live_presses.SEED, by: tuple[str, str] = (stages.LIVE, TRUTH)) -> Row:
    """Errors of a press at one depth, by one fidelity against another."""
    (scene, press), (_, truth) = (_solved(index, seed, fidelity, folder) for fidelity in by)
    kind, motion = live_presses.kind_of(index)
    row: Row = {"index": index, "kind": kind, "motion": motion, "share": share, "by": by[0], "soft": index >= live_presses.SOFT}
    state = _state(scene, share)
    for one, name in ((truth, by[1]), (press, by[0])):
        if state >= len(one.approach):
            return row | {"status": "SolveError", "message": f"{name} ended before: {one.message}"}
    found = compared(scene, press, truth, state)
    own = truth.report.error_estimate
    if own is not None:
        found |= {"own_percent": 100 * own.force, "own_um": own.membrane_um}
    row |= {key: float(f"{value:.3g}") for key, value in found.items()}
    return row | {"status": SolveStatus.CONVERGED.name, "over": float(f"{excess(row):.3g}")}


def _state(scene: Scene, share: float) -> int:
    """Number of the last state at a depth."""
    return int(np.flatnonzero(np.abs(live_presses.approaches(scene) - share * THICKNESS_MM * MM) < 1e-6 * MM)[-1])


def compared(scene: Scene, press: Deformation, truth: Deformation, state: int) -> dict[str, float]:
    """Errors of a press at a state: lengths in µm, forces in per cent of the truth's, and dB of the picture."""
    middle, radius = near(truth, state)
    net = np.linspace(-radius, radius, NET)
    places = middle + np.stack(np.meshgrid(net, net), axis=-1).reshape(-1, 2)
    inside = np.hypot(*(places - middle).T) < radius
    places = places[inside & (np.abs(places) < np.abs(truth.gel.rest[:, :2]).max(axis=0) - radius / NET).all(axis=1)]
    height = heights_over(press, state, places) - heights_over(truth, state, places)
    force, wanted = press.force[state], truth.force[state]
    drawn, known = (picture(scene, one, state) for one in (press, truth))
    found = {
        "force_n": -wanted[2],
        "height_um": _rms(height) * 1e6,
        "force_percent": 100 * (force[2] / wanted[2] - 1),
        "marker_um": _rms(np.linalg.norm(_moved(press, state, places) - _moved(truth, state, places), axis=1)) * 1e6,
        "motion_um": float(np.linalg.norm(_moved(truth, state, places), axis=1).max()) * 1e6,
        "area_percent": 100 * (press.contact_area[state] / truth.contact_area[state] - 1),
        "picture_db": picture_errors(drawn, known, _pixels(scene, middle, radius))["psnr_db"],
    }
    if np.linalg.norm(wanted[:2]) > LEAST_SHEAR * abs(wanted[2]):
        found["shear_percent"] = 100 * float(np.linalg.norm(force[:2] - wanted[:2]) / np.linalg.norm(wanted[:2]))
    return {key: float(value) for key, value in found.items()}


def near(press: Deformation, state: int) -> tuple[Array, float]:
    """Middle of the contact's pressure (x, y) [m], and the radius [m] around it that counts."""
    now = press.gel.rest + press.gel.displacement[state]
    corners = now[press.gel.faces, :2]
    edges = corners[:, 1:] - corners[:, :1]
    areas = np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]) / 2
    pressure = np.maximum(press.contact_pressure[state], 0.0)[press.gel.faces].mean(axis=1) * areas
    middle = (pressure[:, None] * corners.mean(axis=1)).sum(axis=0) / pressure.sum()
    return middle, NEAR * float(np.sqrt(press.contact_area[state] / np.pi))


def heights_over(press: Deformation, state: int, places: Array) -> Array:
    """z of a press's membrane over places in space (M, 2) [m], (M,)."""
    now = press.gel.rest + press.gel.displacement[state]
    surface = Interpolation(now[:, :2])
    return (surface.operator(places) @ surface.with_gradients(now[:, 2:]))[:, 0]


def _moved(press: Deformation, state: int, places: Array) -> Array:
    """How far the material points that rest over places (M, 2) [m] have moved along the gel, (M, 2) [m]."""
    nodes, shares = surface_shares(press.gel.rest, press.gel.faces6, places)
    return np.einsum("pk,pkc->pc", shares, press.gel.displacement[state][nodes, :2])


def picture(scene: Scene, press: Deformation, state: int) -> NDArray[np.uint8]:
    """A state as the camera sees it, by baked light."""
    from gelsim.optics.isp import develop

    only = slice(state, state + 1)
    alone = replace(press, gel=replace(press.gel, displacement=press.gel.displacement[only]))
    return develop(scene, _renderer(scene.replace(object=Scene().object, press=Scene().press, contact=Scene().contact)).radiance(
        stages.membranes(scene, alone)[0]))  # fmt: skip


@lru_cache(maxsize=2)
def _renderer(scene: Scene) -> Any:
    """Of a sensor."""
    from gelsim.optics import choose_variant
    from gelsim.optics.bake import light_field
    from gelsim.optics.baked import BakedRenderer

    variant = choose_variant()
    return BakedRenderer(scene, light_field(scene, variant), variant)


def _pixels(scene: Scene, middle: Array, radius: float) -> NDArray[np.bool_]:
    """The pixels (H, W) that see places within a radius of the middle."""
    from gelsim.optics.camera import seen_places

    width, height = scene.render.resolution
    centres = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1, dtype=np.float64).reshape(-1, 2)
    return (np.hypot(*(seen_places(scene, centres) - middle).T) < radius).reshape(height, width)


def _rms(values: NDArray) -> float:
    return float(np.sqrt(np.mean(np.asarray(values, float) ** 2)))


def bound(key: str, share: float, soft: bool) -> float:
    """What is asked of a quantity at a depth."""
    rigid = BOUNDS[key][1][SHARES.index(share)]
    if not soft:
        return rigid
    return rigid - 20 * np.log10(SOFTER) if key == "picture_db" else SOFTER * rigid


def excess(row: Row) -> float:
    """The largest error over its bound."""
    found = [0.0]
    for key in BOUNDS.keys() & row.keys():
        most = bound(key, row["share"], row.get("soft", False))
        found.append(float(abs(row[key]) / most if key != "picture_db" else 10 ** ((most - row[key]) / 20)))
    return max(found)


# ---- loops ----


def looped(name: str, folder: Path) -> Row:
    """Area of a loop [µJ], by finite elements and by the live sensor."""
    path = [{"depth_mm": 0.6}, *LOOPS[name], {"depth_mm": -0.01}]
    drawn: Layer = {
        "gel": {"profile": "flat", "thickness_mm": THICKNESS_MM},
        "object": BALL,
        "contact": {"friction_coefficient": 0.3},
        "press": {"path": path, "frames": STATES * len(path) + 1},
    }
    truth = live_presses.solved(drawn, folder, TRUTH)
    if truth.report.energy is None or truth.status is not SolveStatus.CONVERGED:
        return {"status": "SolveError", "message": truth.message}
    scene = mesh_parts.built(drawn, folder)
    if name.startswith("shear ±"):
        first, last = 2 * STATES, 4 * STATES
        found, wanted = walked(scene, truth)[first:last], loop_area(truth, first, last)
    else:
        found, wanted = walked(scene, truth, WORK_PIECES), truth.report.energy.dissipated_j
    row = {"work_uj": wanted * 1e6, "live_uj": found.sum() * 1e6, "work_percent": 100 * (found.sum() / wanted - 1)}
    return {"status": SolveStatus.CONVERGED.name} | {key: float(f"{value:.3g}") for key, value in row.items()}


def walked(scene: Scene, press: Deformation, pieces: int = 1) -> Array:
    """Work [J] of the object on the live sensor's gel, the way of a press, from each of its N states to the next, by the trapezoidal rule
    over so many pieces of the way, (pieces (N - 1),)."""
    sensor, work, before = LiveSensor(scene, image=False), [], None
    states = list(poses(scene, press))
    way = [part_way(*ends, part / pieces) for ends in pairwise(states) for part in range(pieces)]
    for turn, shift in [*way, states[-1]]:
        frame = sensor.step([*shift, *Rotation.from_matrix(turn).as_quat()[[3, 0, 1, 2]]], 1.0)
        now = turn, shift, np.concatenate([frame.force, frame.torque])
        if before is not None:
            rotation = turn @ before[0].T  # about the origin, after which the rest is a shift
            motion = np.concatenate([shift - rotation @ before[1], Rotation.from_matrix(rotation).as_rotvec()])
            work.append((now[2] + before[2]) @ motion / 2)
        before = now
    return np.array(work)


def poses(scene: Scene, press: Deformation) -> Iterator[tuple[Array, Array]]:
    """Turn (3, 3) and shift (3,) [m] of a rigid object's own frame at each state of its press."""
    turn, shift = fem.rigid_placement(scene)
    rest = press.object.rest - press.object.rest.mean(axis=0)
    for moved in press.object.displacement:
        now = press.object.rest + moved
        left, _, right = np.linalg.svd((now - now.mean(axis=0)).T @ rest)
        by = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
        yield by @ turn, by @ (shift - press.object.rest.mean(axis=0)) + now.mean(axis=0)


# ---- table ----


def _cases(options: Options) -> Iterator[Case]:
    for index in range(QUICK_COUNT if options.quick else COUNT + SOFT_COUNT):
        name, _ = live_presses.draw(index)
        for share in live_presses.shares_of(index):
            yield Case(f"{index:02d} {name}: {share:g}", partial(measured, index, share, options.kept), same=f"{index}")
    for index in () if options.quick else TWICE:
        for share in live_presses.shares_of(index):
            measure = partial(measured, index, share, options.kept, by=(TRUTH, FINER))
            yield Case(f"{index:02d} {TRUTH}: {share:g}", measure, same=f"{index} {FINER}")
    for name in list(LOOPS)[:1] if options.quick else LOOPS:
        yield Case(f"loop: {name}", partial(looped, name, options.kept))


def _of_live(rows: list[Row]) -> list[Row]:
    return [row for row in rows if row.get("by") == stages.LIVE]


def _listed(rows: list[Row]) -> list[Row]:
    """The worst presses."""
    return sorted((row for row in _of_live(rows) if "over" in row), key=lambda row: -row["over"])[:WORST]


def _remarks(rows: list[Row]) -> str:
    live = _of_live(rows)
    lines = [f"Above: the {WORST} worst, by the largest error over its bound. Of all that have finite elements ({COMMAND}):", ""]
    columns = (
        ("depth / thickness", "share"), ("", "what"), ("bound", "bound"), ("within", "within"), ("median", "median"),
        ("90 of 100", "most"), ("worst", "worst"), (f"{TRUTH} off {FINER}: median, worst", "own"),
    )  # fmt: skip
    soft, rigid = ([row for row in live if row.get("soft", False) is wanted] for wanted in (True, False))
    lines += table(columns, summary(rigid, [row for row in rows if row.get("by") == TRUTH]))
    for title, some in (("Of these the balls", [row for row in rigid if row.get("kind") == "ball"]), ("Soft objects", soft)):
        if some:
            lines += ["", f"{title} ({COMMAND}):", "", *table(columns[:-1], summary(some, []))]
    ended = [row["name"] for row in live if "over" not in row]
    lines += ["", f"{len(ended)} of {len(live)} rows have no finite elements: {'; '.join(ended) or 'none'}."]
    loops = [row for row in rows if "work_uj" in row]
    if loops:
        lines[-1] += f" Loops ({COMMAND}):"
        of_loops = (("way", "name"), (f"work, {TRUTH} [µJ]", "work_uj"), ("live [µJ]", "live_uj"), ("off [%]", "work_percent"))
        lines += ["", *table(of_loops, loops)]
    return "\n".join(lines)


def draw(rows: list[Row], out: Path) -> None:
    """Writes live_worst.jpg: the worst presses, as finite elements and the live sensor have them, and where heights are off."""
    import matplotlib.pyplot as plt
    from matplotlib.patches import Circle

    worst = _listed(rows)
    if not worst:
        return
    figure, axes = plt.subplots(len(worst), 3, figsize=(6.2, 1.5 * len(worst)), squeeze=False, layout="constrained")
    for line, row in zip(axes, worst, strict=True):
        (scene, truth), (_, press) = (
            _solved(row["index"], live_presses.SEED, fidelity, out / KEPT_FOLDER) for fidelity in (TRUTH, stages.LIVE)
        )
        state = _state(scene, row["share"])
        for axis, one in zip(line, (truth, press), strict=False):
            axis.imshow(picture(scene, one, state))
        middle, radius = near(truth, state)
        net = 2 * radius * np.linspace(-1, 1, 61)
        places = (middle + np.stack(np.meshgrid(net, net), axis=-1)).reshape(-1, 2)
        off = (heights_over(press, state, places) - heights_over(truth, state, places)).reshape(61, 61) * 1e6
        most = np.percentile(np.abs(off[np.hypot(*np.meshgrid(net, net)) < radius]), 99)
        shown = line[2].imshow(off, cmap="RdBu_r", vmin=-most, vmax=most, origin="lower", extent=[1e3 * net[0], 1e3 * net[-1]] * 2)
        line[2].add_patch(Circle((0, 0), 1e3 * radius, fill=False, lw=0.5))
        figure.colorbar(shown, ax=line[2]).ax.tick_params(labelsize=6)
        line[0].set_title(row["name"], fontsize=6, loc="left")
        for axis in line:
            axis.set_xticks([])
            axis.set_yticks([])
    axes[0][1].set_title("live", fontsize=6)
    axes[0][2].set_title("height off [µm]", fontsize=6)
    figure.savefig(out / "live_worst.jpg", dpi=100, pil_kwargs={"quality": 85})
    plt.close(figure)


def summary(live: list[Row], own: list[Row]) -> list[Row]:
    """By depth and quantity, of rigid or of soft objects: how many presses are within the bound, and how the errors are spread."""
    found: list[Row] = []
    for share in SHARES:
        for key, (what, _) in BOUNDS.items():
            values, ours = ([abs(row[key]) for row in some if row.get("share") == share and key in row] for some in (live, own))
            if not values:
                continue
            least = key == "picture_db"
            asked = bound(key, share, live[0].get("soft", False))
            within = sum(value >= asked if least else value <= asked for value in values)
            worst, most = (min, 100 * (1 - WANTED)) if least else (max, 100 * WANTED)
            found.append({
                "share": share, "what": what, "bound": f"{'≥' if least else '≤'} {asked:.3g}", "within": f"{within} of {len(values)}",
                "median": f"{np.median(values):.3g}", "most": f"{np.percentile(values, most):.3g}", "worst": f"{worst(values):.3g}",
                "own": f"{np.median(ours):.3g}, {worst(ours):.3g}" if ours else "",
            })  # fmt: skip
    return found


SECTION = Section(
    title="Live: beside finite elements",
    columns=(
        ("press: depth / thickness", "name"),
        ("force [N]", "force_n"),
        *((what, key) for key, (what, _) in BOUNDS.items()),
        ("error over bound", "over"),
    ),
    cases=_cases,
    listed=_listed,
    remarks=_remarks,
    draw=draw,
)
