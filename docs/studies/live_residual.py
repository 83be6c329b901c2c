"""Learns what the live sensor's layer lacks of finite elements: of displacement (`gelsim.live.residual`) and of forces
(`gelsim.live.stiffening`), assets/models/live_residual.npz and live_stiffening.npz.

    python docs/studies/live_residual.py press OUT [--numbers 0 400]      # seconds to minutes each; kept in OUT, goes on where it was
    python docs/studies/live_residual.py gather OUT [--processes 2]       # OUT/states.npz
    python docs/studies/live_residual.py train OUT [--device cuda]        # OUT/live_residual.npz, and errors of what was held back
    python docs/studies/live_residual.py fit OUT                          # OUT/live_stiffening.npz, likewise; seconds

Presses are those of live's table (`gelsim.bench.live_presses`) of other seeds, a third of them by other shapes and parts, half on gels of
1.5 to 4 mm, as deep over their thickness. The rigid object goes the same way before the live sensor. Finite elements' displacement is taken
over places in space, as the layer's is. Loss: root mean squares of heights and of motion along the face over their bounds in that table,
within 1.5 contact radii, and a third of them beyond; of normal forces over their bounds, Huber's. A press in eight is held back.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gelsim.bench import live, live_presses, mesh_parts
from gelsim.bench.section import Layer
from gelsim.errors import GelsimError
from gelsim.live import residual, stiffening
from gelsim.live.sensor import LiveSensor
from gelsim.membrane.clough_tocher import Interpolation
from gelsim.scene.definition import Scene
from gelsim.units import MM, MM_PER_M

FIRST_SEED, OF_A_SEED = 141, 72
"""Presses of live's table are of seed 40."""
OTHERS = ("punch", "cone", "frustum", "torus", "edge", "corner")
THICKNESS_MM = 1.5, 4.0
CROP = 96
"""Cells across, of what the network is trained on."""
HELD_BACK = 8
"""Of so many presses one."""
BEYOND = 1 / 3
"""Weight of places beyond `live.NEAR` contact radii."""
REACH = 18
"""Cells beyond, that count."""
TABLE = "table.npz"
MOST_OVERLAP_M = 1e-4
"""Of states that are learnt from: with more, finite elements are no truth."""
LEAST_UM = 0.1
"""Errors below it are not looked for."""
LEAST_N = 1e-7
"""Of shear forces, which nothing is divided by."""
HIDDEN, FIT_STEPS, FIT_RATE, DECAY = 16, 3000, 5e-3, 0.3
"""Of `fit`: leaving out a fifth of the presses five times, 94.9, 95.3, 93.5 % of normal forces are within their bounds with a decay of 0.1,
0.3, 1, and 93.9, 94.9 % with a width of 8, 32."""
WARMUP, AVERAGED = 0.05, 0.998
"""Of the training; and how much of the mean of the weights, which is kept, is left by a step."""


def draw(number: int) -> tuple[str, Layer]:
    """Press number `number`, as `live_presses.draw` tells one."""
    seed, index = FIRST_SEED + number // OF_A_SEED, number % OF_A_SEED
    name, drawn = live_presses.draw(index, seed)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1, index)))
    if rng.random() < 1 / 3:
        if rng.random() < 0.5:
            body = mesh_parts.draw(int(rng.integers(10_000)), seed)["object"]
            body = {key: body[key] for key in ("shape", "mesh", "rotation_deg")}
            name = f"{body['mesh']} instead of {name}"
        else:
            shape = str(rng.choice(OTHERS))
            body = {"shape": shape, "height_mm": 10.0, "rotation_deg": [0.0, 0.0, float(rng.integers(180))]}
            if shape in ("punch", "cone", "frustum", "torus"):
                body["radius_mm"] = round(float(rng.uniform(1.5, 4.0)), 2)
            if shape in ("frustum", "cone", "edge"):
                body["angle_deg"] = round(float(rng.uniform(70.0, 140.0) if shape != "frustum" else rng.uniform(60.0, 90.0)), 1)
            if shape == "torus":
                body["wall_mm"] = round(float(rng.uniform(0.8, 3.0)), 2)
            elif shape == "edge":
                body |= {"width_mm": 8.0, "length_mm": round(float(rng.uniform(4.0, 10.0)), 2)}
            if shape != "torus":
                body["edge_radius_mm"] = round(float(rng.uniform(0.1, 0.3)), 2)
            name = f"{shape} instead of {name}"
        drawn["object"] = body | {"rigid": True}
        if (drawn["press"].get("depth_mm") or 0) > live_presses.RIMMED * live_presses.THICKNESS_MM:
            drawn["press"] |= {"depth_mm": live_presses.RIMMED * live_presses.THICKNESS_MM, "frames": 6}
    if rng.random() < 0.5:
        thickness = round(float(rng.uniform(*THICKNESS_MM)), 2)
        share, press = thickness / live_presses.THICKNESS_MM, drawn["press"]
        drawn["gel"] = {"profile": "flat", "thickness_mm": thickness}
        if "path" in press:
            press["path"] = [
                {key: _times(value, share) if key.endswith("_mm") else value for key, value in leg.items()} for leg in press["path"]
            ]
        else:
            drawn["press"] = press | {key: _times(press[key], share) for key in ("depth_mm", "shear_mm") if key in press}
    return name, drawn


def _times(value: Any, share: float) -> Any:
    return [part * share for part in value] if isinstance(value, list) else value * share


def pressed(folder: Path, number: int) -> str:
    """Solves one, if it is not kept, and says how that went."""
    name, drawn = draw(number)
    start = time.perf_counter()
    try:
        press = live_presses.solved(drawn, folder, live.TRUTH)
    except GelsimError as error:
        return f"{number} {name}: {error}"
    return f"{number} {name}: {press.status.name}, {len(press.approach)} states, {time.perf_counter() - start:.0f} s"


# ---- what is learnt from ----


def states(scene: Scene, truth: Any) -> list[dict[str, Any]]:
    """Of a press's states: what the network sees, what it is asked for, and how much each cell counts, (6 or 3, CROP, CROP)."""
    sensor = LiveSensor(scene, image=False)
    found = []
    for number, (turn, shift) in enumerate(live.poses(scene, truth)):
        frame = sensor.step([*shift, *Rotation.from_matrix(turn).as_quat()[[3, 0, 1, 2]]], 1.0)
        if number == 0 or not frame.contact.any() or truth.contact_area[number] <= 0 or truth.penetration[number] > MOST_OVERLAP_M:
            continue
        found.append(_state(scene, sensor, frame._state, truth, number))
    return found


def _state(scene: Scene, sensor: LiveSensor, state: Any, truth: Any, number: int) -> dict[str, Any]:
    thickness, known = scene.gel.thickness_mm, state.learnt
    seen = known.seen(*state.whole)
    rows, columns = known.shape
    step = np.array(scene.gel.size_mm) / (columns, rows)
    middle, near = live.near(truth, number)
    middle, near = middle * MM_PER_M, near * MM_PER_M
    place = np.round(middle / step + np.array([columns, rows]) / 2 - CROP / 2).astype(int) // 2 * 2  # column, row of the crop's first cell
    x, y = (step[i] * (place[i] + np.arange(CROP) + 0.5 - count / 2) for i, count in enumerate((columns, rows)))
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    away = np.hypot(*(places - middle).T)
    now = truth.gel.rest + truth.gel.displacement[number]
    half = np.array(scene.gel.size_mm) / 2 - step
    inside = (np.abs(places) < half).all(axis=1) & (away < near + REACH * step.max())
    surface = Interpolation(now[:, :2])
    moved = surface.operator(places[inside] * MM) @ surface.with_gradients(
        np.column_stack([truth.gel.displacement[number][:, :2], now[:, 2]])
    )
    rest = sensor._read(sensor._rest, places[inside])
    shown = np.stack([*(sensor._read(part, places[inside]) for part in state.field)]).T
    lacks = moved * MM_PER_M - shown
    lacks[:, 2] -= rest
    wanted, weight = np.zeros((CROP * CROP, 3), np.float32), np.zeros(CROP * CROP, np.float32)
    wanted[inside] = lacks / thickness
    weight[inside] = np.where(away[inside] < near, 1.0, BEYOND)
    cropped = np.zeros((6, CROP, CROP), np.float16)
    ways = [slice(max(0, start), min(count, start + CROP)) for start, count in ((place[1], rows), (place[0], columns))]
    to = [slice(way.start - start, way.stop - start) for way, start in zip(ways, (place[1], place[0]), strict=True)]
    cropped[:, to[0], to[1]] = seen[:, ways[0], ways[1]]
    return {
        "seen": cropped,
        "wanted": wanted.T.reshape(3, CROP, CROP).astype(np.float16),
        "weight": weight.reshape(CROP, CROP).astype(np.float16),
        "share": float(truth.approach[number]) * MM_PER_M / thickness,
        "thickness": thickness,
        **felt(state),
        "force": truth.force[number],
    }


def felt(state: Any) -> dict[str, Any]:
    """x of `stiffening`, and what the layer bears [N], (3,)."""
    newton = 1e3 * MM**2 * state.window.layer.cell[0] * state.window.layer.cell[1]  # from kPa
    along = (state.shear + state.pressure * state.slope).sum(axis=(1, 2))
    return {"x": state.measures, "layer": newton * np.array([*along, -state.pressure.sum()], float)}


def _gathered(job: tuple[Path, int, bool]) -> list[dict[str, Any]]:
    folder, number, of_table = job
    _, drawn = live_presses.draw(number) if of_table else draw(number)
    if not live_presses.kept_at(drawn, folder, live.TRUTH).exists():
        return []
    scene = mesh_parts.built(drawn, folder)
    try:
        found = states(scene, live_presses.solved(drawn, folder, live.TRUTH))
    except GelsimError as error:
        print(f"{number}: {error}", file=sys.stderr)
        return []
    return [one | {"number": number} for one in found]


def gather(folder: Path, numbers: range, processes: int, of_table: bool) -> None:
    out = folder / (TABLE if of_table else "states.npz")
    jobs = [(folder, number, of_table) for number in numbers]
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        found = [one for some in pool.map(_gathered, jobs) for one in some]
    np.savez(out, **{key: np.stack([one[key] for one in found]) for key in found[0]})
    print(f"{out}: {len(found)} states of {len({one['number'] for one in found})} presses")


# ---- training ----


class Training:
    """States on a device, and how far a network is off on them."""

    def __init__(self, path: Path, device: str) -> None:
        self.kept = dict(np.load(path))
        self.device = device
        self.data = {key: torch.as_tensor(values, device=device) for key, values in self.kept.items()}
        shares = [0.0, *live_presses.SHARES]
        asked = [live.BOUNDS[key][1] for key in ("height_um", "marker_um")]
        found = np.array([np.interp(self.kept["share"], shares, [0.5 * of[0], *of]) for of in asked])
        self.bounds = torch.as_tensor(found, device=device, dtype=torch.float32)

    def numbers(self, values: NDArray[np.intp]) -> Any:
        return torch.as_tensor(values, device=self.device)

    def errors(self, found: Any, which: Any) -> Any:
        """Of heights and of motion along the face, root mean squares [µm] of each state, (2, states)."""
        off = (found.float() - self.data["wanted"][which].float()) * self.data["thickness"][which].float()[:, None, None, None] * 1e3
        weight = self.data["weight"][which].float()
        square = torch.stack([off[:, 2].square(), off[:, :2].square().sum(dim=1)])
        return ((square * weight).sum(dim=(2, 3)) / weight.sum(dim=(1, 2)) + LEAST_UM**2).sqrt()

    def tell(self, values: list[Any], what: str, among: NDArray[np.intp]) -> None:
        """Prints median and ninth decile, of the layer alone and with the network."""
        rows, kernels = [], [residual.Kernel(*values[i : i + 2]) for i in range(0, len(values), 2)]
        with torch.no_grad():
            for some in np.array_split(among, math.ceil(len(among) / 64)):
                which = self.numbers(some)
                seen = self.data["seen"][which].float()
                rows.append(torch.cat([self.errors(0 * seen[:, :3], which), self.errors(network(seen, kernels), which)]).cpu().numpy())
        found = np.concatenate(rows, axis=1)
        for share in live_presses.SHARES:
            close = np.abs(self.kept["share"][among] - share) < live_presses.STEP / 2
            if close.any():
                said = [", ".join(f"{value:.1f}" for value in np.percentile(row[close], (50, 90))) for row in found]
                print(f"  {what} {share:g} ({close.sum()}): heights {said[0]} -> {said[2]}; along {said[1]} -> {said[3]}", flush=True)


def turned(values: Any, way: int, vectors: tuple[int, ...]) -> Any:
    """Fields mirrored along x (1) and y (2), and x and y exchanged (4): numbers of their components along x, before those along y."""
    along = list(vectors)
    across = [i + 1 for i in along]
    values = values.clone()
    if way & 1:
        values = values.flip(-1)
        values[:, along] *= -1
    if way & 2:
        values = values.flip(-2)
        values[:, across] *= -1
    if way & 4:
        values = values.transpose(-1, -2).clone()
        values[:, along + across] = values[:, across + along]
    return values


class Symmetric:
    """Kernels that answer turned and mirrored fields by turned and mirrored ones: the mean of what the eight ways make of any kernels.

    Hidden channels are eight times as many as fields, the images of each under the eight ways, which every way permutes.
    """

    def __init__(self, width: int, depth: int, device: str) -> None:
        self.ends = [self._of_fields(*of) for of in (((0, 4), 6), ((0,), 3))]
        first = self.ends[0]
        then = [[next(i for i in range(8) if torch.equal(first[way] @ first[other], first[i])) for other in range(8)] for way in range(8)]
        regular = torch.stack([torch.eye(8)[:, then[way]] for way in range(8)])
        hidden = torch.stack([torch.kron(way.contiguous(), torch.eye(width // 8)) for way in regular])
        kinds = [self.ends[0], *[hidden] * (depth + 1), self.ends[1]]
        self.kinds = [kind.to(device) for kind in kinds]
        self.values: list[Any] = []
        for i, (of, to) in enumerate(pairwise(kinds)):
            gain = 1.0 if i == 0 else 0.3 if i <= depth else 0.01
            size = len(to[0]), len(of[0])
            self.values += [torch.randn(*size, 3, 3) * gain * (2 / (9 * size[1])) ** 0.5 * 8**0.5, torch.zeros(size[0], 1, 1)]
        self.values = [value.to(device).requires_grad_() for value in self.values]

    @staticmethod
    def _of_fields(vectors: tuple[int, ...], count: int) -> Any:
        """What the eight ways do to fields taken in fours, (8, 4 count, 4 count)."""
        unit = residual.spread(torch.eye(4 * count)[:, :, None, None])
        return torch.stack([residual.in_fours(turned(unit, way, vectors))[:, :, 0, 0].T for way in range(8)])

    def kernels(self) -> list[residual.Kernel]:
        found = []
        for i, (of, to) in enumerate(pairwise(self.kinds)):
            weights, bias = self.values[2 * i : 2 * i + 2]
            ways = [torch.einsum("oa,abij,pb->opij", to[way], turned(weights, way, ()), of[way]) for way in range(8)]
            images = [torch.einsum("oa,aij->oij", to[way], bias) for way in range(8)]
            found.append(residual.Kernel(sum(ways) / 8, sum(images) / 8))
        return found


def network(seen: Any, kernels: list[residual.Kernel]) -> Any:
    return residual.answer(seen, kernels, partial(torch.nn.functional.conv2d, padding=1))


def train(options: argparse.Namespace) -> None:
    torch.manual_seed(0)
    rng = np.random.default_rng(0)
    folder: Path = options.folder
    states = Training(folder / "states.npz", options.device)
    held = states.kept["number"] % HELD_BACK == 0
    back, front = np.flatnonzero(held), np.flatnonzero(~held)
    net = Symmetric(options.width, options.depth, options.device)
    average = [part.detach().clone() for kernel in net.kernels() for part in (kernel.weights, kernel.bias)]
    optimizer = torch.optim.AdamW(net.values, lr=options.rate, weight_decay=1e-4)
    start = time.perf_counter()
    for step in range(options.steps):
        done = max(step / options.steps, (time.perf_counter() - start) / options.seconds)
        if done >= 1.0:
            break
        for group in optimizer.param_groups:
            group["lr"] = options.rate * min(done / WARMUP, 1.0) * 0.5 * (1.0 + math.cos(math.pi * done)) + 1e-6
        which, by = states.numbers(rng.choice(front, options.batch)), tuple(int(i) for i in rng.integers(2, size=2))
        kernels = net.kernels()
        found = network(states.data["seen"][which].float().roll(by, (2, 3)), kernels).roll((-by[0], -by[1]), (2, 3))
        loss = (states.errors(found, which) / states.bounds[:, which]).sum(dim=0).mean()
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.values, 1.0)
        optimizer.step()
        now = [part for kernel in kernels for part in (kernel.weights, kernel.bias)]
        for mean, value in zip(average, now, strict=True):
            mean.lerp_(value.detach(), 1 - min(AVERAGED, (1 + step) / (10 + step)))
        if (step + 1) % max(1, options.steps // 5) == 0:
            print(f"step {step + 1}: loss {loss.item():.3f}, {time.perf_counter() - start:.0f} s", flush=True)
            states.tell(average, "trained on", rng.choice(front, min(len(front), 512), replace=False))
            states.tell(average, "held back", back)
    kept = {f"{part}{i}": average[2 * i + j].cpu().numpy() for i in range(len(average) // 2) for j, part in enumerate(("weights", "bias"))}
    path = folder / Path(residual.WEIGHTS).name
    np.savez_compressed(path, **{key: value.astype(np.float16) for key, value in kept.items()})
    print(f"{path}: {step + 1} steps in {time.perf_counter() - start:.0f} s", flush=True)
    states.tell(average, "held back", back)
    if (folder / TABLE).exists():
        table = Training(folder / TABLE, options.device)
        table.tell(average, "live's table", np.arange(len(table.kept["share"])))


# ---- forces ----


class Forces:
    """States, and how far forces are off on them."""

    def __init__(self, path: Path) -> None:
        self.kept = dict(np.load(path))
        self.x, self.layer, self.force = (torch.as_tensor(self.kept[key], dtype=torch.float32) for key in ("x", "layer", "force"))
        asked = [np.interp(self.kept["share"], live_presses.SHARES, live.BOUNDS[key][1]) for key in ("force_percent", "shear_percent")]
        self.bounds = torch.as_tensor(np.stack(asked) / 100, dtype=torch.float32)
        along = self.force[:, :2].norm(dim=1)
        self.sheared = along > live.LEAST_SHEAR * -self.force[:, 2]

    def over(self, law: stiffening.Law) -> Any:
        """Relative errors over their bounds of the normal force, and of the shear where there is any, else 0: (2, states)."""
        off = (1.0 + law(self.x))[:, None] * self.layer - self.force
        normal, along = -off[:, 2] / self.force[:, 2], off[:, :2].square().sum(dim=1).clip(min=LEAST_N**2).sqrt()
        off = torch.stack([normal, along / self.force[:, :2].norm(dim=1).clip(min=LEAST_N) * self.sheared])
        return off / self.bounds

    def tell(self, law: stiffening.Law, what: str, among: NDArray[np.bool_]) -> None:
        """Prints how many are within their bounds, of the layer alone and with the law."""
        still = replace(law, layers=tuple((0 * weights, 0 * bias) for weights, bias in law.layers))
        with torch.no_grad():
            alone, known = (self.over(one).abs().numpy() <= 1.0 for one in (still, law))
        for share in live_presses.SHARES:
            close = among & (np.abs(self.kept["share"] - share) < live_presses.STEP / 2)
            for some, name, i in ((close, "normal", 0), (close & self.sheared.numpy(), "shear", 1)):
                if some.any():
                    print(
                        f"  {what} {share:g}, {name}: of {some.sum()} within {alone[i][some].sum()} -> {known[i][some].sum()}", flush=True
                    )


def fit(options: argparse.Namespace) -> None:
    torch.manual_seed(0)
    forces = Forces(options.folder / "states.npz")
    held = forces.kept["number"] % HELD_BACK == 0
    front = torch.as_tensor(~held)
    x = forces.x[front]
    mean, spread = x.mean(dim=0), x.std(dim=0)
    sizes = [x.shape[1], HIDDEN, HIDDEN, 1]
    values = [part for of, to in pairwise(sizes) for part in (torch.randn(to, of) * (0.1 if to == 1 else 1.0) / of**0.5, torch.zeros(to))]
    values = [value.requires_grad_() for value in values]

    def law(least: Any = -math.inf, most: Any = math.inf) -> stiffening.Law:
        first, beside = values[0] / spread, values[1] - (values[0] / spread) @ mean
        layers = ((first, beside), *((values[i], values[i + 1]) for i in range(2, len(values), 2)))
        return stiffening.Law(x.amin(dim=0), x.amax(dim=0), least, most, layers)

    optimizer = torch.optim.AdamW(values, lr=FIT_RATE, weight_decay=DECAY)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, FIT_STEPS)
    for _ in range(FIT_STEPS):
        over = forces.over(law())[0, front]
        loss = torch.nn.functional.huber_loss(over, torch.zeros_like(over))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    answers = law()(x)
    found = law(answers.min(), answers.max())
    parts = {f"{part}{i}": layer[j] for i, layer in enumerate(found.layers) for j, part in enumerate(("weights", "bias"))}
    ends = {end: getattr(found, end) for end in ("low", "high", "least", "most")}
    path = options.folder / Path(stiffening.NUMBERS).name
    np.savez_compressed(path, **{key: np.float32(value.detach()) for key, value in (ends | parts).items()})
    print(path)
    forces.tell(found, "trained on", ~held)
    forces.tell(found, "held back", held)
    if (options.folder / TABLE).exists():
        table = Forces(options.folder / TABLE)
        table.tell(found, "live's table", np.ones(len(table.x), bool))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("press", "gather", "train", "fit"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--numbers", type=int, nargs=2, default=(0, 400), metavar=("FIRST", "LAST"))
    parser.add_argument("--table", action="store_true", help=f"gather live's own presses instead, kept in FOLDER too, into {TABLE}")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--width", type=int, default=48)
    parser.add_argument("--depth", type=int, default=4)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--rate", type=float, default=2e-3)
    parser.add_argument("--seconds", type=float, default=math.inf, help="training ends by then")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    if options.what == "press":
        for number in range(*options.numbers):
            print(pressed(options.folder, number), flush=True)
    elif options.what == "gather":
        gather(options.folder, range(live_presses.SOFT) if options.table else range(*options.numbers), options.processes, options.table)
    else:
        {"train": train, "fit": fit}[options.what](options)


if __name__ == "__main__":
    main()
