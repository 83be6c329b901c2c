"""Two dozen parts as people bring them, each a mesh file of a few lines, pressed into a GelSight Mini by one command each.

python docs/examples/parts.py                    # out/parts/NAME.stl [mm], and the command that presses each
python docs/examples/parts.py --render           # runs these commands, one after the other; docs/images/parts.jpg
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import trimesh
from manifold3d import CrossSection, FillRule, JoinType, Manifold, OpType
from matplotlib.textpath import TextPath
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont

Array = NDArray[np.float64]
ROOT = Path(__file__).parents[2]
FIGURE = ROOT / "docs" / "images" / "parts.jpg"
ROUND = 32
"""Corners of a circle; of a wire a third."""
COLUMNS, TILE = 6, (240, 180)


# ------------------------------------------------------------------------------------------------ what parts are made of
def disc(radius: float, x: float = 0.0, y: float = 0.0, corners: int = ROUND) -> CrossSection:
    return CrossSection.circle(radius, corners).translate((x, y))


def bar(width: float, length: float, x: float = 0.0, y: float = 0.0) -> CrossSection:
    return CrossSection.square((width, length), True).translate((x, y))


def polygon(corners: ArrayLike) -> CrossSection:
    return CrossSection([np.asarray(corners, float)], FillRule.NonZero)


def text(words: str, size: float, x: float = 0.0, y: float = 0.0) -> CrossSection:
    """Words about a middle."""
    outlines = TextPath((0, 0), words, size=size).to_polygons(closed_only=True)
    drawn = CrossSection([outline[:-1] for outline in outlines], FillRule.EvenOdd)
    left, low, right, high = drawn.bounds()
    return drawn.translate((x - (left + right) / 2, y - (low + high) / 2))


def plate(outline: CrossSection, height: float, rounding: float) -> Manifold:
    """From z = 0 up, its edges rounded, in steps too small to be felt."""
    angle = np.radians([0, 20, 40, 60, 90])
    steps = rounding * np.stack([1 - np.cos(angle), 1 - np.sin(angle)], 1)
    return joined([outline.offset(-inset, JoinType.Miter).extrude(height - 2 * lift).translate((0, 0, lift)) for inset, lift in steps])


def struck(outline: CrossSection, height: float, draft: float = np.radians(15)) -> Manifold:
    """Relief as steep as one can be struck, from z = 0 up (Johnson, Encyclopedia of Coin and Medal Technology: Coin Relief)."""
    spread, thin = height * np.tan(draft), 1e-3
    face = outline.offset(-spread / 2, JoinType.Miter).extrude(thin)
    return face.minkowski_sum(Manifold.cylinder(height - thin, spread, 0, 12))


def turned(outline: ArrayLike) -> Manifold:
    """Turned about z, from (radius, z) along its outline upward."""
    return polygon(outline).revolve(2 * ROUND)


def bent(solid: Manifold, edge: float, move: Callable[[Array], Array]) -> Manifold:
    """Its points (N, 3) moved, after its edges were cut to a length."""
    return solid.refine_to_length(edge).warp_batch(lambda points: move(np.array(points)))


def rod(radius: Callable[[Array, Array], Array], length: float, edge: float) -> Manifold:
    """Lying along x, its radius by angle and place along it."""

    def move(points: Array) -> Array:
        angle = np.arctan2(points[:, 1], points[:, 0])
        points[:, :2] *= radius(angle, points[:, 2])[:, None]
        return points

    return bent(Manifold.cylinder(length, 1.0, circular_segments=3 * ROUND, center=True), edge, move).rotate((0, 90, 0))


def wire(points: ArrayLike, radius: float) -> Manifold:
    """Round, along points (N, 3)."""
    balls = [Manifold.sphere(radius, ROUND // 2).translate(point) for point in np.asarray(points, float)]
    return joined([Manifold.batch_hull(pair) for pair in zip(balls, balls[1:], strict=False)])


def joined(parts: Sequence[Manifold]) -> Manifold:
    return Manifold.batch_boolean(list(parts), OpType.Add)


def around(count: int) -> Array:
    """Angles [degrees] evenly around a circle."""
    return 360 * np.arange(count) / count


def triangle_wave(turns: Array) -> Array:
    """0 at whole numbers, 1 halfway."""
    return 1 - np.abs(2 * (turns % 1) - 1)


# ------------------------------------------------------------------------------------------------ parts [mm], face up
def screw() -> Manifold:
    head = turned([(0, 0), (4.5, 0), (4.5, 0.8), (4.2, 1.5), (3.5, 2.1), (2.5, 2.5), (1.2, 2.7), (0, 2.75)])
    cross = joined([Manifold.extrude(bar(*arm), 2.0, scale_top=(1.8, 1.8)) for arm in ((2.8, 0.7), (0.7, 2.8))])
    return head + Manifold.cylinder(8, 2).translate((0, 0, -8)) - cross.translate((0, 0, 0.9))


def nut() -> Manifold:
    hexagon = disc(10 / np.sqrt(3), corners=6).extrude(5)
    bevels = turned([(0, 0), (5, 0), (6, 0.6), (6, 4.4), (5, 5), (0, 5)])
    hole = turned([(0, 0), (3.2, 0), (2.5, 0.7), (2.5, 4.3), (3.2, 5), (0, 5)])
    return (hexagon ^ bevels) - hole


def thread() -> Manifold:
    return rod(lambda angle, z: 4 - 0.75 * triangle_wave(z / 1.25 - angle / (2 * np.pi)).clip(0.1, 0.9), 15, 0.3)


def knurl() -> Manifold:
    def radius(angle: Array, z: Array) -> Array:
        turns, along = 26 * angle / (2 * np.pi), z / 1.4
        return 4.5 + 0.5 * np.minimum(triangle_wave(turns + along), triangle_wave(turns - along)).clip(0, 0.8)

    return rod(radius, 14, 0.25)


def drill() -> Manifold:
    return rod(lambda angle, z: 3 - 1.2 * np.cos(angle - 2 * np.pi * z / 13) ** 8, 16, 0.25)


def jack() -> Manifold:
    cone = [(0, 0), (0.5, 0), (1.7, 1.6), (1.1, 3.2), (1.75, 3.6)]
    rings = [(radius, z + shift) for z in (4.2, 7.2) for radius, shift in ((1.75, 0), (1.55, 0.05), (1.55, 0.75), (1.75, 0.8))]
    return turned([*cone, *rings, (1.75, 13), (0, 13)]).translate((0, 0, -6.5)).rotate((0, 90, 0))


def key() -> Manifold:
    cuts = [
        (-2, 1.9),
        (-1, 1.9),
        (0, 0.9),
        (0.8, 0.9),
        (1.6, 1.6),
        (2.6, 0.4),
        (3.2, 0.4),
        (4, 1.2),
        (5, 0.7),
        (5.6, 0.7),
        (6.6, 1.5),
        (7.2, 1.5),
    ]
    blade = polygon([(-5, -1.9), (7.2, -1.9), (8.4, -0.4), *reversed(cuts), (-5, 1.9)])
    whole = plate((disc(4.2, -4.6) + blade) - disc(1.3, -6.4), 1.6, 0.25)
    return whole - bar(9.5, 0.7, 4.3, -0.7).extrude(0.5).translate((0, 0, 1.2))


def coin() -> Manifold:
    blank = turned([(0, 0), (6.5, 0), (6.5, 1.7), (5.7, 1.7), (5.62, 1.4), (0, 1.4)])
    return joined([blank, *(struck(words, 0.25).translate((0, 0, 1.4)) for words in (text("50", 5.5, 0, 0.8), text("GELS", 1.8, 0, -3.2)))])


def brick() -> Manifold:
    studs = CrossSection.compose([disc(2.4, x, y) for x in (-4, 4) for y in (-4, 4)])
    return plate(bar(15.8, 15.8), 5, 0.2) + plate(studs, 2.7, 0.2).translate((0, 0, 4))


def letters() -> Manifold:
    return plate(bar(18, 12), 2, 0.3) + plate(text("GEL", 8.5), 2, 0.3).translate((0, 0, 1))


def small_print() -> Manifold:
    return plate(bar(18, 12), 2, 0.3) + text("gelsim", 4.5).extrude(1).translate((0, 0, 1.6))


def gear() -> Manifold:
    teeth, module = 18, 0.65
    base = teeth * module / 2 * np.cos(np.radians(20))
    roll = np.linspace(0, np.sqrt(((teeth / 2 + 1) * module / base) ** 2 - 1), 6)
    half = np.pi / (2 * teeth) + np.tan(np.radians(20)) - np.radians(20) - (roll - np.arctan(roll))  # involutes of the base circle
    reach = base * np.hypot(1, roll)
    flank = np.stack([np.r_[3, reach, reach[::-1], 3], np.r_[half[0], half, -half[::-1], -half[0]]])
    tooth = polygon((flank[0] * [np.cos(flank[1]), np.sin(flank[1])]).T[::-1])
    outline = CrossSection.batch_boolean([tooth.rotate(a) for a in around(teeth)] + [disc((teeth / 2 - 1.25) * module)], OpType.Add)
    holes = CrossSection.compose([disc(0.9, 3.3).rotate(a) for a in around(6)])
    return plate(outline - holes - (disc(1.5) + bar(0.9, 0.9, 0, 1.6)), 3, 0.12)


def leaf() -> Manifold:
    along = np.linspace(0, 1, 40)
    half = 4.4 * np.sin(np.pi * along**0.8) ** 0.9 * (1 - 0.3 * along)
    blade = polygon(np.vstack([np.stack([17 * along - 8.5, -half], 1), np.stack([17 * along - 8.5, half], 1)[-2:0:-1]]))

    def move(points: Array) -> Array:
        x, y, top = points[:, 0], np.abs(points[:, 1]), points[:, 2] > 0
        middle = np.exp(-((y / 0.25) ** 2))
        side = 0.6 * np.exp(-((((x - 0.9 * y) % 1.9 - 0.95) / 0.22) ** 2))
        points[:, 2] += 0.4 * np.where(top, np.maximum(middle, side), 0) - 0.01 * y**2
        return points

    return bent((blade + bar(2, 0.6, -9)).extrude(0.8), 0.3, move)


def weave() -> Manifold:
    def yarn(sign: int) -> Manifold:
        def move(points: Array) -> Array:
            points[:, 2] += sign * 0.5 * np.cos(np.pi * points[:, 0] / 2)
            return points

        return bent(Manifold.cylinder(9, 0.85, circular_segments=16, center=True).rotate((0, 90, 0)), 0.5, move)

    yarns = [yarn((-1) ** i).translate((0, 2 * i, 0)) for i in range(-2, 3)]
    return joined([*yarns, *(yarn(-((-1) ** i)).rotate((0, 0, 90)).translate((2 * i, 0, 0)) for i in range(-2, 3))])


def spring() -> Manifold:
    angle = np.linspace(-7, 7, 14 * 12) * np.pi
    return wire(np.stack([2.2 * angle / (2 * np.pi), 3.5 * np.sin(angle), -3.5 * np.cos(angle)], 1), 0.6)


def wrench() -> Manifold:
    jaw = disc(5.4 / np.sqrt(3), corners=6).rotate(30) + bar(7, 5.4, 3.5)
    return plate((disc(5.6, 2.5) + bar(14, 4.5, -5)) - jaw.rotate(15).translate((3, 0)), 3, 0.25)


def rope() -> Manifold:
    def strand(phase: float) -> Manifold:
        def move(points: Array) -> Array:
            angle = 2 * np.pi * points[:, 0] / 14 + phase
            points[:, 1:] += 1.5 * np.stack([np.cos(angle), np.sin(angle)], 1)
            return points

        yarns = rod(lambda angle, z: 1.6 + 0.12 * np.abs(np.cos(4 * angle + 2 * np.pi * z / 5)), 20, 0.4)
        return bent(yarns, 1.0, move)

    return joined([strand(np.radians(phase)) for phase in around(3) + 90]) ^ Manifold.cube((18, 9, 9), True)


def clip() -> Manifold:
    def arc(x: float, y: float, radius: float, start: float) -> Array:
        angle = np.radians(start) - np.linspace(0, np.pi, 16)
        return np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle), 0 * angle], 1)

    bends = arc(4, 0, 1.2, 90), arc(-5, 0.65, 1.85, -90), arc(5.5, 0, 2.5, 90)
    return wire(np.vstack([(-3, 1.2, 0), *bends, (-3, -2.5, 0)]), 0.4)


def bearing() -> Manifold:
    cage = plate(disc(6.5, corners=2 * ROUND) - disc(2.6), 1.6, 0.2)
    balls = [Manifold.sphere(1.35, ROUND).translate((4.5, 0, 0.8)).rotate((0, 0, a)) for a in around(9)]
    return joined([cage, *balls])


def washer() -> Manifold:
    teeth = [plate(bar(2.2, 1.5), 0.9, 0.15).rotate((25, 0, 0)).translate((5.2, 0, 0)).rotate((0, 0, a)) for a in around(12)]
    return joined([plate(disc(4.6) - disc(3.1), 0.9, 0.15), *teeth])


def button() -> Manifold:
    angle = np.linspace(-90, 90, 13)
    rim = np.stack([5.4 + 1.1 * np.cos(np.radians(angle)), 1.2 + 1.1 * np.sin(np.radians(angle))], 1)
    holes = joined([Manifold.cylinder(4, 0.8).translate((x, y, -1)) for x in (-1.3, 1.3) for y in (-1.3, 1.3)])
    return turned([(0, 0.1), *rim, (4.4, 2.1), (0, 2.1)]) - holes


def die() -> Manifold:
    pips = [Manifold.sphere(1.4, ROUND).translate((x, y, 11.8)) for x, y in ((0, 0), (3, 3), (3, -3), (-3, 3), (-3, -3))]
    return plate(bar(11, 11), 11, 0.4) - joined(pips)


def golf_ball() -> Manifold:
    """Its top, of 43 mm across with 336 dimples."""
    count = np.arange(50)
    z, angle = 1 - (2 * count + 1) / 336, np.pi * (1 + np.sqrt(5)) * count
    places = 27.65 * np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], 1)
    ball = Manifold.sphere(21.3, 6 * ROUND) - joined([Manifold.sphere(6.6, 3 * ROUND).translate(place) for place in places])
    return ball ^ Manifold.cylinder(30, 9.5, circular_segments=2 * ROUND)


def braille() -> Manifold:
    cells = (0, 1, 3, 4), (0, 4), (0, 1, 2)  # g, e, l
    places = [(6.2 * (i - 1) + 2.5 * (dot // 3) - 1.25, 2.5 * (1 - dot % 3)) for i, cell in enumerate(cells) for dot in cell]
    dots = [Manifold.sphere(0.85, ROUND).translate((*place, 1.65)) for place in places]
    return plate(bar(20, 12), 2, 0.3) + joined(dots)


PARTS: dict[str, Callable[[], Manifold]] = {
    "screw": screw, "nut": nut, "thread": thread, "knurl": knurl, "drill": drill, "jack plug": jack,
    "key": key, "coin": coin, "brick": brick, "letters": letters, "small print": small_print, "gear": gear,
    "leaf": leaf, "weave": weave, "spring": spring, "wrench": wrench, "rope": rope, "clip": clip,
    "bearing": bearing, "washer": washer, "button": button, "die": die, "golf ball": golf_ball, "braille": braille,
}  # fmt: skip


# ------------------------------------------------------------------------------------------------ files and pictures
def write(name: str, folder: Path) -> Path:
    """The part as an STL file, whose single precision cannot tell slivers apart."""
    solid = PARTS[name]().simplify(1e-3).to_mesh64()
    path = folder / f"{name.replace(' ', '_')}.stl"
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.Trimesh(solid.vert_properties[:, :3], solid.tri_verts).export(path)
    return path


def command(mesh: Path, out: Path) -> str:
    return (
        f"gelsim render --mesh {mesh} --rigid --press-side top --sensor gelsight_mini --depth-mm 0.5 --frames 2 --fidelity fast --out {out}"
    )


def render(line: str) -> float:
    """Runs a command; its processor time [s]."""
    before = os.times()
    subprocess.run([sys.executable, "-m", *shlex.split(line), "--force"], check=True, stdout=subprocess.DEVNULL)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def draw(path: Path, folder: Path, seconds: dict[str, float]) -> None:
    """The last picture of each part, its name and seconds on it."""
    across, down = TILE
    font = ImageFont.load_default(13)
    sheet = Image.new("RGB", (across * COLUMNS, down * -(-len(seconds) // COLUMNS)))
    pen = ImageDraw.Draw(sheet)
    for number, (name, took) in enumerate(seconds.items()):
        corner = across * (number % COLUMNS), down * (number // COLUMNS)
        with Image.open(folder / name.replace(" ", "_") / "frames" / "0001.png") as picture:
            sheet.paste(picture.convert("RGB").resize(TILE, Image.Resampling.LANCZOS), corner)
        pen.text((corner[0] + 5, corner[1] + 3), f"{name}  {took:.0f} s", fill="white", font=font)
    sheet.save(path, quality=88)


def main(quick: bool = False, path: Path = FIGURE, folder: Path = ROOT / "out" / "parts", shown: bool = True) -> dict[str, float]:
    """Writes the files, presses each part if it is to be shown; quick: one of them.

    Returns:
        Part -> processor time [s] of its command.
    """
    meshes = {name: write(name, folder) for name in PARTS}
    seconds = {}
    for name, mesh in list(meshes.items())[: 1 if quick else None]:
        line = command(mesh, folder / mesh.stem)
        print(line, flush=True)
        if shown:
            seconds[name] = render(line)
            wall = json.loads((folder / mesh.stem / "report.json").read_text())["seconds"]
            stages = ", ".join(f"{stage} {took:.1f}" for stage, took in wall.items())
            print(f"{name}: {seconds[name]:.1f} s of processor time; wall: {stages}", flush=True)
    if shown:
        draw(path, folder, seconds)
    return seconds


if __name__ == "__main__":
    main(shown="--render" in sys.argv)
