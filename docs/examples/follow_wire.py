"""A finger slides along a bent wire, and a network learns from an expert how to keep hold of it: with the gel's picture, and without.

    python docs/examples/follow_wire.py            # docs/images/gallery_wire.png; 6 minutes of a processor, and the light's
    python docs/examples/follow_wire.py --quick    # a little by the gel's heights in place of its picture, which need no light

As a gripper follows a cable (She et al., RSS 2020), with one of its two gels, on a rigid wire. The expert knows the wire. Three networks,
the same but for what is withheld from them (it is zero), learn its speeds aside from the same touches in the same number of steps; each has
to follow another wire. `pip install "gelsim[learn]"`.

Left out: hands, cables that give way, the gel's side faces where the wire crosses them.
"""

from __future__ import annotations

import os
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from functools import lru_cache, partial
from math import sqrt
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import torch
from manifold3d import CrossSection
from matplotlib.figure import Figure
from numpy.typing import NDArray
from torch import nn
from trimesh import Trimesh

import gelsim
from gelsim.scene.layers import build_scene
from gelsim.shape.shapes import load_mesh
from gelsim.units import MM, MM_PER_M

Array = NDArray[np.float64]

FIGURE = Path(__file__).parents[1] / "images" / "gallery_wire.png"
GEL = {
    "gel": {"profile": "flat", "size_mm": [16.0, 12.0]},
    "contact": {"friction_coefficient": 0.3},
    "camera": {"field_mm": [12.0, 9.0]},
    "render": {"resolution": [80, 60]},
}
RADIUS, LENGTH, DEEP = 1.0, 120.0, 0.3
"""Of the wire, and how far the finger presses it into the gel [mm]."""
WAVES = ((4.0, 37.0), (2.0, 23.0))
"""Height and length of the waves that it is bent by [mm]."""
HELD = 3.0
"""Distance of the wire from the gel's middle at which it is lost [mm]."""
TRAVEL, SPEED, PERIOD = 24.0, 20.0, 0.02
"""How far the finger goes [mm], how fast [mm/s], and how often it is told [s]."""
STEPS = round(TRAVEL / SPEED / PERIOD)
GAIN, FASTEST = 5.0, 30.0
"""Of the expert: speed aside over the distance of the wire [1/s], and at most [mm/s]."""
SHAKEN, SHAKES = 15.0, 5
"""By how much its hand shakes while others learn [mm/s], and for how many steps each time."""
NOISE = 2.0
"""Of the camera [levels of 255]."""
INPUTS = {"joints": (0.0, 0.0), "joints and force": (1.0, 0.0), "joints and picture": (0.0, 1.0)}
"""What a network is given of force and picture."""
BATCH = 64
SHOWN = 4
"""Ways of each that are drawn."""


@dataclass(frozen=True)
class Seen:
    """What the finger knows at a step."""

    numbers: Array
    """How far it has come [mm / 10], (2,), and the force [N], (3,)."""
    picture: NDArray[np.float32]
    """What differs from the picture at rest, (channels, 30, 40)."""


class Wire:
    """Bent at random."""

    def __init__(self, seed: int) -> None:
        self._phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, len(WAVES))

    def middle(self, x: Array | float) -> Array:
        """y at an x [mm]."""
        return sum(high * np.sin(2 * np.pi * x / long + phase) for (high, long), phase in zip(WAVES, self._phases, strict=True))

    def slope(self, x: Array | float) -> Array:
        return (self.middle(x + 0.01) - self.middle(x - 0.01)) / 0.02

    def surface(self) -> Trimesh:
        """[mm]"""
        rod = CrossSection.circle(RADIUS, 16).extrude(LENGTH, int(4 * LENGTH)).warp_batch(self._bent).to_mesh()
        return Trimesh(rod.vert_properties[:, :3], rod.tri_verts)

    def _bent(self, points: Array) -> Array:
        x, slope = points[:, 2], self.slope(points[:, 2])
        aside = points[:, 1] / np.hypot(1, slope)
        return np.column_stack([x - slope * aside, self.middle(x) + aside, points[:, 0]])


LEARNT, OTHER = Wire(0), Wire(1)


class Finger:
    """With a gel, on a wire."""

    def __init__(self, wire: Wire, image: bool) -> None:
        self.wire, self.rng, bent = wire, np.random.default_rng(0), wire.surface()
        with tempfile.TemporaryDirectory() as folder:
            bent.export(path := Path(folder) / "wire.stl")
            scene = build_scene(GEL, {"object": {"shape": "mesh", "mesh": str(path), "rigid": True, "edge_radius_mm": 0.1}})
            self._sensor = gelsim.LiveSensor(scene, image=image)
            self._origin = (bent.vertices.min(axis=0) - load_mesh(scene.object).vertices.min(axis=0) * MM_PER_M)[:2]
        self._rest = self._sensor.image().astype(float) if image else None

    def start(self) -> Seen:
        """Somewhere on the wire, up to 1 mm aside."""
        self._sensor.reset()
        x = self.rng.uniform(10, LENGTH - 10 - TRAVEL)
        self.at = self.began = np.array([x, self.wire.middle(x) + self.rng.uniform(-1, 1)])
        return self._look()

    def step(self, aside: float) -> Seen:
        """On by SPEED, and aside by another [mm/s]."""
        self.at = self.at + PERIOD * np.array([SPEED, aside])
        return self._look()

    @property
    def off(self) -> float:
        """Of the wire from the gel's middle, along y [mm]."""
        return float(self.wire.middle(self.at[0]) - self.at[1])

    @property
    def expert(self) -> float:
        """Speed aside [mm/s] of who knows the wire."""
        return float(np.clip(SPEED * self.wire.slope(self.at[0]) + GAIN * self.off, -FASTEST, FASTEST))

    def _look(self) -> Seen:
        place = np.array([*(self._origin - self.at), -DEEP]) * MM
        frame = self._sensor.step((*place, 1.0, 0.0, 0.0, 0.0), PERIOD)
        if self._rest is None:
            picture = frame.height[..., None] / 1e-4
        else:
            assert frame.image is not None
            picture = (frame.image - self._rest + self.rng.normal(0, NOISE, self._rest.shape)) / 64
        rows, columns, channels = picture.shape
        small = picture.reshape(rows // 2, 2, columns // 2, 2, channels).mean(axis=(1, 3)).transpose(2, 0, 1)
        return Seen(np.array([*(self.at - self.began) / 10, *frame.force]), small.astype(np.float32))


class Follower(nn.Module):
    """From what the finger knows to its speed aside, over FASTEST."""

    def __init__(self, channels: int, given: tuple[float, float]) -> None:
        super().__init__()
        force, picture = given
        self.register_buffer("_numbers", torch.tensor([1, 1, force, force, force]))
        self._picture = picture
        self._eye = nn.Sequential(
            *(nn.Conv2d(channels, 16, 5, 2, 2), nn.ReLU(), nn.Conv2d(16, 16, 3, 2, 1), nn.ReLU()),
            *(nn.Flatten(), nn.Linear(16 * 8 * 10, 32), nn.ReLU()),
        )
        self._head = nn.Sequential(nn.Linear(32 + 5, 64), nn.ReLU(), nn.Linear(64, 1))

    def forward(self, numbers: torch.Tensor, pictures: torch.Tensor) -> torch.Tensor:
        return self._head(torch.cat([self._eye(self._picture * pictures), self._numbers * numbers], 1))[:, 0]

    @torch.no_grad()
    def speed(self, seen: Seen) -> float:
        """Aside [mm/s]."""
        asked = self(torch.tensor(seen.numbers, dtype=torch.float32)[None], torch.tensor(seen.picture)[None])
        return FASTEST * float(asked.clip(-1, 1))


Lessons = tuple[torch.Tensor, torch.Tensor, torch.Tensor]


def lessons(finger: Finger, episodes: int) -> Lessons:
    """What the expert saw and did while its hand shook: numbers, pictures, speeds over FASTEST."""
    seen, done = [], []
    for episode in range(episodes):
        now = finger.start()
        for step in range(STEPS):
            if step % SHAKES == 0:
                shaken = finger.rng.normal(0, SHAKEN)
            seen.append(now)
            done.append(finger.expert / FASTEST)
            now = finger.step(finger.expert + shaken)
        say("lessons", episode + 1, episodes)
    numbers, pictures = np.stack([one.numbers for one in seen]), np.stack([one.picture for one in seen])
    return torch.tensor(numbers, dtype=torch.float32), torch.tensor(pictures), torch.tensor(done, dtype=torch.float32)


def taught(given: tuple[float, float], seed: int, known: Lessons, updates: int) -> Follower:
    """A network that does as the expert did."""
    torch.manual_seed(seed)
    *seen, done = known
    network = Follower(seen[1].shape[1], given)
    adam = torch.optim.Adam(network.parameters(), lr=1e-3)
    for _ in range(updates):
        some = torch.randint(len(done), (BATCH,))
        loss = (network(*(part[some] for part in seen)) - done[some]).square().mean()
        adam.zero_grad()
        loss.backward()
        adam.step()
    return network


def followed(finger: Finger, network: Follower) -> Array:
    """Where the finger was [mm], (steps + 1, 2), before it lost the wire, or in all STEPS."""
    seen = finger.start()
    way = [finger.at]
    while len(way) <= STEPS:
        seen = finger.step(network.speed(seen))
        if abs(finger.off) >= HELD:
            break
        way.append(finger.at)
    return np.array(way)


@lru_cache(maxsize=1)
def other(image: bool) -> Finger:
    """On the wire that no network has learnt on."""
    return Finger(OTHER, image)


def trial(asked: tuple[str, int], known: Lessons, updates: int, tries: int, image: bool) -> list[Array]:
    """How a network of some inputs and a seed follows the other wire; all of a seed begin at the same places."""
    torch.set_num_threads(1)
    name, seed = asked
    network, finger = taught(INPUTS[name], seed, known, updates), other(image)
    finger.rng = np.random.default_rng(100 + seed)
    return [followed(finger, network) for _ in range(tries)]


def wilson(hits: int, tries: int) -> tuple[float, float]:
    """The 95 % interval of a share."""
    z2, share = 1.96**2, hits / tries
    half = sqrt(z2 * share * (1 - share) / tries + z2**2 / 4 / tries**2)
    return (share + z2 / 2 / tries - half) / (1 + z2 / tries), (share + z2 / 2 / tries + half) / (1 + z2 / tries)


def say(what: str, done: int, total: int) -> None:
    print(f"\r{what}: {done}/{total}", end="\n" if done == total else "", file=sys.stderr, flush=True)


def main(quick: bool = False, processes: int = 1, path: Path = FIGURE) -> dict[str, list[int]]:
    """Learns by three seeds each and follows the other wire from 20 places each, and draws the first of them; quick: one and two.

    Returns:
        For each of INPUTS: how many steps the wire was held in each try; STEPS is all the way.
    """
    episodes, updates, tries, seeds = (4, 200, 2, 1) if quick else (24, 1500, 20, 3)
    known = lessons(Finger(LEARNT, not quick), episodes)
    asked = [(name, seed) for seed in range(seeds) for name in INPUTS]
    learn, ways = partial(trial, known=known, updates=updates, tries=tries, image=not quick), []
    spawn = get_context("spawn")  # the light's threads do not outlive a fork
    with ProcessPoolExecutor(processes, spawn) if processes > 1 else nullcontext() as pool:
        for found in (map if pool is None else pool.map)(learn, asked):
            ways.append(found)
            say("networks", len(ways), len(asked))
    draw(path, ways[: len(INPUTS)])
    return {name: [len(way) - 1 for found in ways[number :: len(INPUTS)] for way in found] for number, name in enumerate(INPUTS)}


def draw(path: Path, ways: list[list[Array]]) -> None:
    """The other wire, as wide as a finger may be off, and the first ways of each of INPUTS along it."""
    figure = Figure(figsize=(8, 1.9), dpi=100, layout="constrained")
    axes = figure.add_subplot(aspect="equal", xlabel="x [mm]", ylabel="y [mm]", xlim=(0, LENGTH))
    x = np.linspace(0, LENGTH, 500)
    y = OTHER.middle(x)
    axes.fill_between(x, y - HELD, y + HELD, color="0.93")
    axes.plot(x, y, color="0.6", linewidth=4)
    for name, found, colour in zip(INPUTS, ways, ("C1", "C3", "C0"), strict=True):
        for number, way in enumerate(found[:SHOWN]):
            axes.plot(*way.T, color=colour, linewidth=1.5, label=name if number == 0 else None)
            axes.plot(*way[-1], "o" if len(way) > STEPS else "x", color=colour)
    figure.legend(loc="outside upper center", ncols=len(INPUTS), frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)


if __name__ == "__main__":
    for name, held in main(quick="--quick" in sys.argv[1:], processes=os.cpu_count() or 1).items():
        print("{}: {} of {}, {:.0%} to {:.0%}".format(name, held.count(STEPS), len(held), *wilson(held.count(STEPS), len(held))))
