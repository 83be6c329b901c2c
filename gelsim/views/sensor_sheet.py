"""What-is-this picture of a sensor: where lamps, camera, window and gel are, and the picture without contact."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gelsim import optics
from gelsim.membrane.surface import rest_membrane
from gelsim.optics.camera import pixel_rays
from gelsim.optics.lighting import light_pose
from gelsim.optics.spectra import light_colour
from gelsim.scene.definition import Light, Scene
from gelsim.shape.shapes import gel_height

INK = "#22303c"


def sensor_facts(scene: Scene) -> dict[str, Any]:
    """The sensor in numbers, as plain values."""
    gel, camera, markers = scene.gel, scene.camera, scene.markers
    return {
        "gel": f"{gel.profile}, {gel.size_mm[0]:g} x {gel.size_mm[1]:g} x {gel.thickness_mm:g} mm",
        "window": f"{scene.lights.window_thickness_mm:g} mm, index {scene.lights.window_ior:g}",
        "camera": f"{camera.resolution[0]} x {camera.resolution[1]} px, field {camera.field_mm[0]:g} x {camera.field_mm[1]:g} mm, "
        f"{camera.distance_mm:g} mm from the gel's surface",
        "lights": ", ".join(light.name for light in scene.lights.lights),
        "coating": f"albedo {scene.coating.albedo[0]:g} {scene.coating.albedo[1]:g} {scene.coating.albedo[2]:g}, "
        f"flakes {scene.coating.specular:g} of roughness {scene.coating.roughness:g}",
        "markers": "none" if markers.layout == "none" else f"{markers.layout}, {2 * markers.radius_mm:g} mm every {markers.pitch_mm:g} mm",
    }


def draw_sensor(path: Path, scene: Scene, device: str = "auto") -> None:
    """Draws section, plan and no-contact frame of a sensor into a PNG file."""
    from matplotlib.figure import Figure

    (frame,) = optics.render_frames(scene, [rest_membrane(scene)], device=device)
    figure = Figure(figsize=(13.0, 3.9), dpi=90, facecolor="white", layout="constrained")
    section, plan, picture = figure.subplots(1, 3, width_ratios=(1.25, 1.0, 1.25))
    _draw_section(section, scene)
    _draw_plan(plan, scene)
    picture.imshow(frame.image, interpolation="nearest")
    picture.set_title("no contact", fontsize=10, color=INK)
    picture.set_axis_off()
    figure.suptitle(
        f"{scene.sensor.preset}: {sensor_facts(scene)['gel']}, markers {sensor_facts(scene)['markers']}", fontsize=11, color=INK
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, format="png")


def _drawn_lights(scene: Scene) -> tuple[list[Light], str]:
    """Those that stand at the sensor, and what is said of those too far off to be drawn with it."""
    reach = 3 * max(*scene.gel.size_mm, scene.camera.distance_mm)
    away = [(light, float(np.linalg.norm(light.position_mm))) for light in scene.lights.lights]
    far = ", ".join(f"{light.name} at {distance:g} mm" for light, distance in away if distance > reach)
    return [light for light, distance in away if distance <= reach], f"not drawn: {far}" if far else ""


def _shown(rgb: Any) -> Any:
    return np.clip(np.array(rgb) / max(np.max(rgb), 1e-9), 0, 1) ** (1 / 2.2)


def _draw_section(axes: Any, scene: Scene) -> None:
    """Everything projected on y = 0; z grows upward, so the camera is below."""
    gel, lights, camera = scene.gel, scene.lights, scene.camera
    half = gel.size_mm[0] / 2
    x = np.linspace(-half, half, 101)
    top = gel_height(gel, np.column_stack([x, 0 * x]) * 1e-3) * 1e3
    axes.fill_between(x, -gel.thickness_mm, top, color="#cfe3ee", label="gel")
    outer = -gel.thickness_mm - lights.window_thickness_mm
    axes.fill_between([-half, half], outer, -gel.thickness_mm, color="#e7edc9", label="window")
    axes.plot(x, top, color=INK, linewidth=2)
    origin, direction = pixel_rays(scene)
    middle = origin.shape[0] // 2
    for column in (0, origin.shape[1] // 2, -1):
        start = origin[middle, column] * 1e3
        end = start + direction[middle, column] * (-start[2] / direction[middle, column, 2])
        axes.plot([camera.offset_mm[0], start[0], end[0]], [-camera.distance_mm, start[2], end[2]], color="#888888", linewidth=0.8)
    axes.plot(camera.offset_mm[0], -camera.distance_mm, "^", color=INK, markersize=8)
    axes.annotate("camera", (camera.offset_mm[0], -camera.distance_mm), textcoords="offset points", xytext=(8, -3), fontsize=8, color=INK)
    lamps, far = _drawn_lights(scene)
    for light in lamps:
        corners = light_pose(light) @ np.array([[-1, 1, 1, -1], [-1, -1, 1, 1], [0, 0, 0, 0], [1, 1, 1, 1]], float)
        axes.fill(corners[0], corners[2], color=_shown(light_colour(light)), edgecolor=INK, linewidth=0.8)
        normal = light_pose(light)[:3, 2] * 4
        axes.annotate(
            "",
            (light.position_mm[0] + normal[0], light.position_mm[2] + normal[2]),
            (light.position_mm[0], light.position_mm[2]),
            arrowprops={"arrowstyle": "->", "color": INK},
        )
    axes.text(0.02, 0.02, far, transform=axes.transAxes, fontsize=8, color=INK)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title("section: lamps, window, gel, the camera's rays", fontsize=10, color=INK)
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("z [mm]")


def _draw_plan(axes: Any, scene: Scene) -> None:
    """As the camera looks: x right, y down."""
    for (width, height), style in ((scene.gel.size_mm, "-"), (scene.camera.field_mm, "--")):
        axes.plot(np.array([-1, 1, 1, -1, -1]) * width / 2, np.array([-1, -1, 1, 1, -1]) * height / 2, style, color=INK, linewidth=1)
    lamps = _drawn_lights(scene)[0]
    for light in lamps:
        corners = light_pose(light) @ np.array([[-1, 1, 1, -1], [-1, -1, 1, 1], [0, 0, 0, 0], [1, 1, 1, 1]], float)
        axes.fill(corners[0], corners[1], color=_shown(light_colour(light)), edgecolor=INK, linewidth=0.8)
    axes.invert_yaxis()
    _name_lamps(axes, lamps)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title("plan: gel, field (dashed), lamps", fontsize=10, color=INK)
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("y [mm]")


def _name_lamps(axes: Any, lamps: list[Light]) -> None:
    """Names at the left and right edges, in the order of their lamps from above: none lies on another, however near the lamps are."""
    # A letter takes about a fiftieth of the plan's width.
    room = min(0.05 + 0.02 * max((len(light.name) for light in lamps), default=0), 0.35)
    axes.margins(x=room / (1 - 2 * room))
    for edge, align, members in (
        (0.02, "left", [light for light in lamps if light.position_mm[0] < 0]),
        (0.98, "right", [light for light in lamps if light.position_mm[0] >= 0]),
    ):
        for place, light in enumerate(sorted(members, key=lambda light: light.position_mm[1])):
            axes.annotate(
                light.name,
                light.position_mm[:2],
                textcoords="axes fraction",
                xytext=(edge, 1 - (place + 0.5) / len(members)),
                ha=align,
                va="center",
                fontsize=8,
                color=INK,
                arrowprops={"arrowstyle": "-", "color": INK, "linewidth": 0.5, "relpos": (1.0 if align == "left" else 0.0, 0.5)},
            )
