"""sheet.png: a press at a glance. Frames in a row; below them the membrane's height, force and area against approach or time, a section,
the meshes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.results import Deformation, Frame, SurfaceMotion
from gelsim.scene.definition import Scene
from gelsim.scene.materials import hardness_label
from gelsim.scene.shape_table import SHAPES
from gelsim.units import KPA, MM

FRAMES_SHOWN = 6
PANEL_ASPECT = 0.75
"""Height over width of the panels below the frames."""
GEL_COLOUR, OBJECT_COLOUR, INK = "#7a8fa6", "#d9a26b", "#22272e"
SECTION_OFFSET = 1e-6
"""The section is cut this far [m] beside y = 0, where symmetric meshes have nodes and a cut through them would be ambiguous."""

Array = NDArray[np.float64]


def describe_scene(scene: Scene) -> str:
    """The press in one line."""
    body, press = scene.object, scene.press
    size = f", R {body.radius_mm:g} mm" if SHAPES[body.shape].has_radius else ""
    name = Path(body.mesh).name if body.mesh else body.shape
    hardness = "rigid" if body.rigid else hardness_label(body)
    friction = scene.contact.friction_coefficient
    contact = f"friction {friction}" if isinstance(friction, str) else f"friction {friction:g}"
    tilt = "" if press.tilt_deg == (0.0, 0.0) else f", tilt {press.tilt_deg[0]:g}° {press.tilt_deg[1]:g}°"
    return f"{name}{size}, {hardness}, into a gel of {hardness_label(scene.gel)} ({Path(scene.sensor.preset).stem}), {contact}{tilt}"


def draw_sheet(path: Path, scene: Scene, deformation: Deformation, frames: list[Frame]) -> None:
    """Draws the sheet of a press.

    Args:
        path: PNG file.
        frames: One for each recorded state.
    """
    from matplotlib.figure import Figure

    chosen = np.unique(np.linspace(0, len(frames) - 1, FRAMES_SHOWN).round().astype(int))
    height, width = frames[0].image.shape[:2]
    total, margin, gap = 16.0, 0.2, 0.08  # inches
    picture = (total - 2 * margin - (len(chosen) - 1) * gap) / len(chosen)
    top = 0.75 + picture * height / width
    figure = Figure(figsize=(total, top + 3.75), dpi=110, facecolor="white")
    place = _Inches(figure)
    figure.text(0.5, 1 - 0.14 / (top + 3.75), describe_scene(scene), ha="center", va="top", fontsize=13, color=INK)
    for column, index in enumerate(chosen):
        axes = place(margin + column * (picture + gap), top, picture, picture * height / width)
        axes.imshow(frames[index].image, interpolation="antialiased", aspect="auto")
        axes.set_axis_off()
        force = abs(deformation.force[index, 2])
        axes.set_title(f"{deformation.approach[index] / MM:.2f} mm   {force:.2f} N", fontsize=10, color=INK, pad=3)
    below, high = top + 3.1, PANEL_ASPECT * 3.3
    heights = place(0.65, below, 2.95, high)
    draw_height(heights, place(3.65, below, 0.1, high), scene, frames, deformation.telling)
    draw_force(place(5.1, below, 2.6, high), deformation)
    draw_section(place(8.75, below, 3.3, high), scene, deformation)
    draw_meshes(place(12.4, below, 3.3, high), scene, deformation)
    figure.savefig(path, format="png", pil_kwargs={"compress_level": 1})  # a fifth larger, 0.4 s sooner


class _Inches:
    """Puts axes on a figure by their left edge, lower edge (from the top), width and height in inches."""

    def __init__(self, figure: Any) -> None:
        self.figure = figure

    def __call__(self, left: float, lower: float, width: float, height: float) -> Any:
        across, down = self.figure.get_size_inches()
        return self.figure.add_axes((left / across, 1 - lower / down, width / across, height / down))


def draw_mechanics(path: Path, scene: Scene, deformation: Deformation) -> None:
    """The sheet of a press without pictures: force, section, meshes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 3.9), dpi=110, facecolor="white")
    place = _Inches(figure)
    figure.suptitle(describe_scene(scene), fontsize=12, color=INK)
    high = PANEL_ASPECT * 3.3
    draw_force(place(0.7, 3.3, 2.9, high), deformation)
    draw_section(place(4.7, 3.3, 3.3, high), scene, deformation)
    draw_meshes(place(8.4, 3.3, 3.3, high), scene, deformation)
    figure.savefig(path, format="png")


def draw_height(axes: Any, scale: Any, scene: Scene, frames: list[Frame], state: int) -> None:
    """How far the membrane's height differs between a frame and the first, as the camera sees it; `scale` holds the colour bar."""
    from gelsim.optics.camera import pixel_size

    rows, columns = frames[0].height.shape
    half_x, half_y = 0.5 * columns * pixel_size(scene) / MM, 0.5 * rows * pixel_size(scene) / MM
    shown = (frames[state].height - frames[0].height) / MM
    picture = axes.imshow(shown, extent=(-half_x, half_x, half_y, -half_y), cmap="viridis", interpolation="nearest", aspect="auto")
    axes.figure.colorbar(picture, cax=scale)
    if np.isfinite(shown).all() and np.ptp(shown) > 0:
        axes.contour(
            np.linspace(-half_x, half_x, columns), np.linspace(-half_y, half_y, rows), shown, 8, colors="white", linewidths=0.4, alpha=0.6
        )
    axes.set_title(f"membrane height, {'last' if state == len(frames) - 1 else f'state {state}'} minus first [mm]", fontsize=10, color=INK)
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("y [mm]", labelpad=0)


def draw_force(axes: Any, deformation: Deformation) -> None:
    """Normal and tangential force, and contact area, against approach, or time where the object does not always go deeper."""
    name, along = deformation.along
    axes.plot(along, -deformation.force[:, 2], "o-", color=INK, markersize=4, label="normal force [N]")
    tangential = np.hypot(deformation.force[:, 0], deformation.force[:, 1])
    if tangential.max() > 1e-3 * np.abs(deformation.force[:, 2]).max():
        axes.plot(along, tangential, "o--", color="#2f7f5f", markersize=3, label="tangential force [N]")
    axes.set_xlabel(name)
    axes.set_ylabel("force [N]", labelpad=1)
    axes.set_title(f"force and area against {name.split()[0]}", fontsize=10, color=INK)
    area = axes.twinx()
    area.plot(along, deformation.contact_area / MM**2, "s-", color="#b5562b", markersize=3, label="contact area [mm²]")
    area.set_ylabel("contact area [mm²]", color="#b5562b", labelpad=1)
    area.tick_params(colors="#b5562b")
    handles = [*axes.get_lines(), *area.get_lines()]
    axes.legend(handles, [line.get_label() for line in handles], fontsize=8, loc="upper left" if name[0] == "a" else "best", frameon=False)
    for side in (axes, area):
        side.set_ylim(bottom=0)
        side.spines["top"].set_visible(False)
    axes.grid(alpha=0.25)


def draw_section(axes: Any, scene: Scene, deformation: Deformation) -> None:
    """Gel and object cut at y = 0 in the state that shows the press best."""
    from matplotlib.collections import LineCollection

    state = deformation.telling
    window = -scene.gel.thickness_mm
    view = 0.26 * scene.gel.size_mm[0]
    for motion, colour in ((deformation.object, OBJECT_COLOUR), (deformation.gel, GEL_COLOUR)):
        for index, style in ((0, ":"), (state, "-")):
            segments = list(section_segments(motion, index) / MM)
            ink, width = (colour, 1.8) if style == "-" else (INK, 0.7)
            axes.add_collection(LineCollection(segments, colors=ink, linewidths=width, linestyles=style, capstyle="round", zorder=3))
    gel = section_segments(deformation.gel, state) / MM
    if len(gel):
        outline = gel.reshape(-1, 2)[np.argsort(gel.reshape(-1, 2)[:, 0])]
        axes.fill_between(outline[:, 0], window, outline[:, 1], color=GEL_COLOUR, alpha=0.3, linewidth=0)
    for loop in closed_loops(section_segments(deformation.object, state) / MM):
        axes.fill(loop[:, 0], loop[:, 1], color=OBJECT_COLOUR, alpha=0.3, linewidth=0)
    axes.axhspan(window - 1.0, window, color="#dfe6ee", zorder=0)
    axes.text(0.0, window - 0.5, "window", ha="center", va="center", fontsize=8, color=INK)
    axes.set_xlim(-view, view)
    axes.set_ylim(window - 1.0, window - 1.0 + 2 * view * PANEL_ASPECT)
    axes.set_aspect("equal")
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("z [mm]", labelpad=0)
    shown = "last" if state == len(deformation.approach) - 1 else f"state {state}"
    axes.set_title(f"section at y = 0: first touch (dotted), {shown}", fontsize=10, color=INK)


def draw_meshes(axes: Any, scene: Scene, deformation: Deformation) -> None:
    """Both surfaces' meshes in the state that shows the press best, the object lifted off the gel, the gel coloured by pressure."""
    import matplotlib
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_rgb

    azimuth, elevation = np.radians(-24.0), np.radians(28.0)
    right = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    away = np.array([-np.sin(azimuth) * np.cos(elevation), np.cos(azimuth) * np.cos(elevation), -np.sin(elevation)])
    up = np.cross(right, away)
    light = np.array([-0.35, -0.5, 0.8]) / np.linalg.norm([-0.35, -0.5, 0.8])
    pressure = deformation.contact_pressure[deformation.telling] / KPA
    peak = float(pressure.max())
    lift = 0.28 * scene.gel.size_mm[1] * MM
    low, wide = np.inf, 0.0
    for motion, base, raised in ((deformation.gel, GEL_COLOUR, 0.0), (deformation.object, OBJECT_COLOUR, lift)):
        points = motion.rest + motion.displacement[deformation.telling] + np.array([0.0, 0.0, raised])
        triangles = motion.faces6[:, :3]
        corners = points[triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        towards = normals @ away < 0.0
        triangles, corners, normals = triangles[towards], corners[towards], normals[towards]
        colour = np.tile(to_rgb(base), (len(triangles), 1))
        if motion is deformation.gel and peak > 0:
            share = pressure[triangles].mean(axis=1) / peak
            hot = matplotlib.colormaps["inferno_r"](0.15 + 0.7 * share)[:, :3]
            colour = np.where(share[:, None] > 0.01, hot, colour)
        colour = np.clip(colour * (0.6 + 0.4 * np.abs(normals @ light))[:, None], 0, 1)
        order = np.argsort(-(corners.mean(axis=1) @ away))
        shown = np.stack([corners @ right, corners @ up], axis=-1)[order] / MM
        axes.add_collection(PolyCollection(list(shown), facecolors=colour[order], edgecolors=colour[order] * 0.7, linewidths=0.35))
        low, wide = min(low, shown[..., 1].min()), max(wide, np.abs(shown[..., 0]).max())
    axes.set_xlim(-wide, wide)
    axes.set_ylim(low, low + 2 * wide * PANEL_ASPECT)
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title(f"meshes, apart; contact pressure up to {peak:.1f} kPa", fontsize=10, color=INK)


def draw_surface(path: Path, vertices: Array, faces: NDArray[np.int64], title: str) -> None:
    """Draws a triangle surface from three sides.

    Args:
        path: PNG file.
        vertices: (V, 3) [m].
        faces: (F, 3).
    """
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_rgb
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 4.4), dpi=110, facecolor="white")
    place = _Inches(figure)
    figure.suptitle(title, fontsize=12, color=INK)
    views = {
        "front: x right, z up": ("x", "z"),
        "side: y right, z up": ("y", "z"),
        "from below, as the gel sees it; + touches first": ("x", "y"),
    }
    corners = vertices[faces] / MM
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    for column, (name, letters) in enumerate(views.items()):
        axes = place(0.6 + 3.9 * column, 3.9, 3.2, 3.2)
        a, b = ("xyz".index(letter) for letter in letters)
        away = {"xz": (0, 1, 0), "yz": (-1, 0, 0), "xy": (0, 0, 1)}[letters[0] + letters[1]]
        depth = corners.mean(axis=1) @ np.array(away, float)
        order = np.argsort(-depth)
        shade = (0.5 + 0.5 * np.abs(normals @ np.array(away, float)))[:, None]
        colour = (np.array(to_rgb(OBJECT_COLOUR)) * shade)[order]
        axes.add_collection(PolyCollection(list(corners[order][:, :, [a, b]]), facecolors=colour, edgecolors=colour * 0.75, linewidths=0.3))
        axes.autoscale_view()
        axes.plot(0.0, 0.0, "+", color=INK, markersize=11, markeredgewidth=1.6, zorder=3)
        axes.set_aspect("equal")
        if letters == ("x", "y"):
            axes.invert_yaxis()
        axes.set_title(name, fontsize=10, color=INK)
        axes.set_xlabel(f"{letters[0]} [mm]")
        axes.set_ylabel(f"{letters[1]} [mm]", labelpad=0)
    figure.savefig(path, format="png")


def section_segments(motion: SurfaceMotion, index: int) -> Array:
    """Where a surface in one state crosses the plane y = 0: segments (S, 2, 2) of x, z [m]."""
    points = motion.rest + motion.displacement[index]
    y = points[:, 1] - SECTION_OFFSET
    corners = y[motion.faces]
    crossing = motion.faces[(corners.min(axis=1) < 0) & (corners.max(axis=1) > 0)]
    ends = []
    for a, b in ((0, 1), (1, 2), (2, 0)):
        start, end = crossing[:, a], crossing[:, b]
        with np.errstate(divide="ignore", invalid="ignore"):
            share = y[start] / (y[start] - y[end])
        between = (y[start] < 0) != (y[end] < 0)
        place = points[start] + np.where(between, share, 0.0)[:, None] * (points[end] - points[start])
        ends.append((between, place[:, [0, 2]]))
    # A triangle that crosses has exactly two edges that do.
    between = np.stack([item[0] for item in ends], axis=1)
    places = np.stack([item[1] for item in ends], axis=1)
    return places[between].reshape(-1, 2, 2)


def closed_loops(segments: Array, tolerance: float = 1e-6) -> list[Array]:
    """Segments (S, 2, 2) strung together into polylines (K, 2) by their common ends."""
    ends = [[tuple(end) for end in pair] for pair in np.round(segments / tolerance).astype(np.int64).tolist()]
    at: dict[tuple[int, ...], list[int]] = {}
    for index, pair in enumerate(ends):
        for end in pair:
            at.setdefault(end, []).append(index)
    # A segment with a loose end starts an open line there; where none is left, only closed loops remain.
    starts = [(index, side) for index, pair in enumerate(ends) for side in (0, 1) if len(at[pair[side]]) == 1]
    starts += [(index, 0) for index in range(len(ends))]
    left = set(range(len(segments)))
    loops = []
    for index, side in starts:
        if index not in left:
            continue
        line = [segments[index][side]]
        following: int | None = index
        while following is not None:
            index = following
            left.discard(index)
            line.append(segments[index][1 - side])
            corner = ends[index][1 - side]
            following = next((other for other in at[corner] if other in left), None)
            if following is not None:
                side = ends[following].index(corner)
        loops.append(np.array(line))
    return loops
