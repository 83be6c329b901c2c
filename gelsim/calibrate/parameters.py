"""What is fitted, as one vector: names, units, bounds and priors; and its way to a sensor preset.

A prior is what is believed of a parameter before any photograph: a normal distribution about its start. It keeps parameters that the
photographs do not determine at sensible values, and says which these are: those whose uncertainty hardly shrinks. Three scales cannot
be told apart by any photograph and are conventions: the coat's albedo and flake reflectance (against the lights' power), white balance
(against their colours), exposure.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gelsim.calibrate import model
from gelsim.calibrate.model import Shape
from gelsim.errors import SceneError
from gelsim.scene.definition import Camera, Coating, Gel, Light, Lights, Scene

Array = NDArray[np.float64]

ALBEDO, FLAKE, EXPOSURE = 0.5, 0.9, 100.0
GLOBALS = (
    "camera.mm_per_px",
    "camera.distance_mm",
    "gel.curvature",
    "gel.thickness_mm",
    "coating.specular",
    "coating.roughness",
    "camera.gamma",
    "camera.tilt_x_rad",
    "camera.tilt_y_rad",
    "contact.slip",
)
GEOMETRY = ("away_mm", "azimuth_rad", "z_mm", "turn_rad", "elevation_rad", "log_length", "log_height")
PRESS = ("x_mm", "y_mm", "depth_mm", "drag_x_mm", "drag_y_mm")
"""Of a press: where the ball's apex stands, how deep it is, and how far it has been dragged since it touched."""
VEIL_Z, VEIL_SIZE = -500.0, 150.0
"""The veil, light that comes from the sensor's inside in general, is a far square on the axis [mm]: no other light hides it."""

OUT_OF_VIEW = 1.0
"""Lights that start at least so far out, in half diagonals of the field, stand beside the picture at any height; the others below the gel,
nearer to the axis, as strips along the window's rim or in a narrow housing do."""
NEAREST, CLEAR_MM, BELOW_COAT_MM = 0.2, 0.5, 0.05
"""Of the lights below the gel: to the axis [half diagonals], from the gel's inner face [mm]; of those beside the picture, from the coat."""

# name -> (standard deviation of the prior, lowest, highest)
PRIORS = {
    "camera.mm_per_px": (0.15, 0.3, 3.0),  # relative to the start
    "camera.distance_mm": (10.0, 8.0, 200.0),
    "gel.curvature": (0.010, 0.0, 0.045),
    "gel.thickness_mm": (1.5, 1.5, 9.0),
    "coating.specular": (0.15, 0.0, 0.9),
    "coating.roughness": (0.12, 0.15, 1.0),
    "camera.gamma": (0.5, 0.4, 3.0),
    "camera.tilt_x_rad": (0.05, -0.35, 0.35),
    "camera.tilt_y_rad": (0.05, -0.35, 0.35),
    "contact.slip": (0.5, 0.0, 1.0),
    "away_mm": (0.5, OUT_OF_VIEW, 5.0),  # relative to half the field's diagonal: beside the picture
    "azimuth_rad": (0.5, -10.0, 10.0),
    "z_mm": (0.4, -2.5, -0.04),  # likewise
    "turn_rad": (0.3, -1.0, 1.0),
    "elevation_rad": (0.3, 0.0, 1.2),
    "log_length": (0.4, np.log(0.05), np.log(2.0)),  # likewise
    "log_height": (0.4, np.log(0.03), np.log(0.8)),  # likewise
}


@dataclass(frozen=True, eq=False)
class Parameters:
    """Values, priors and bounds of a sensor; presses are kept apart."""

    globals: Array
    """In the order of GLOBALS."""
    geometry: Array
    """Of each light but the veil, in the order of GEOMETRY, shape (L, 7)."""
    colours: Array
    """Flux of each light in R, G, B [exposure's inverse unit], the veil last, shape (L + 1, 3)."""
    half_field_mm: float
    """Half the field's diagonal at the start: the scale of the lights' priors."""
    half_width_px: float
    """Half the picture's width."""
    window: tuple[float, float, float]
    """Its thickness [mm] and index, and the gel's index."""
    gel_half_mm: tuple[float, float] = (0.0, 0.0)
    """Of the gel along x and y: a light there stays below its coat."""

    @property
    def vector(self) -> Array:
        return np.concatenate([part.ravel() for part in (self.globals, self.geometry, self.colours)])

    def with_vector(self, vector: Array) -> Parameters:
        parts: list[Array] = []
        start = 0
        for part in (self.globals, self.geometry, self.colours):
            parts.append(vector[start : start + part.size].reshape(part.shape))
            start += part.size
        return replace(self, globals=parts[0], geometry=parts[1], colours=parts[2])

    @property
    def names(self) -> list[str]:
        lights = light_names(self)
        return [
            *GLOBALS,
            *(f"lights.{name}.{what}" for name in lights[:-1] for what in GEOMETRY),
            *(f"lights.{name}.flux_{c}" for name in lights for c in "rgb"),
        ]

    def prior(self) -> tuple[Array, Array, Array]:
        """Standard deviations, lower and upper bounds about these values as the start, each of the vector's shape."""
        rows = [PRIORS[name] for name in GLOBALS]
        scale = self.globals[0]
        rows[0] = tuple(scale * part for part in rows[0])
        below = self.geometry[:, 0] < OUT_OF_VIEW * self.half_field_mm
        inner = GLOBALS.index("gel.thickness_mm")
        if below.any():
            # No thicker than leaves the lights below it their place.
            rows[inner] = (*rows[inner][:2], min(rows[inner][2], self.globals[inner] + CLEAR_MM))
        rows += [self._light_prior(name, bool(deep)) for deep in below for name in GEOMETRY]
        # The veil stands far off: its flux is of another size.
        rows += [(3 * float(part.max(initial=1e-6)), 0.0, np.inf) for part in (self.colours[:-1], self.colours[-1:]) for _ in part.flat]
        sd, low, high = np.array(rows).T
        return sd, low, high

    def _light_prior(self, name: str, below: bool) -> tuple[float, float, float]:
        sd, low, high = PRIORS[name]
        if below and name == "away_mm":
            low, high = NEAREST, OUT_OF_VIEW
        if below and name == "z_mm":
            high = -(self.globals[GLOBALS.index("gel.thickness_mm")] + CLEAR_MM) / self.half_field_mm
        scale, shift = self.half_field_mm, np.log(self.half_field_mm)
        if name in ("away_mm", "z_mm"):
            return scale * sd, scale * low, scale * high
        return (sd, low + shift, high + shift) if name.startswith("log") else (sd, low, high)

    def shape(self, balls_mm: Array) -> Shape:
        layers = ((self.window[0], self.window[1]), (float(self.globals[3]), self.window[2]))
        return Shape(
            self.globals[0], self.globals[1], layers, self.half_width_px, self.globals[2], balls_mm, (self.globals[7], self.globals[8])
        )

    def light(self, index: int) -> Array:
        """x, y, z, azimuth and elevation of its face, length, height of a light, for `model`; the veil is the last."""
        if index == len(self.geometry):
            return np.array([0.0, 0.0, VEIL_Z, 0.0, np.pi / 2, VEIL_SIZE, VEIL_SIZE])
        away, azimuth, z, turn, elevation, length, height = self.geometry[index]
        at = np.array([away * np.cos(azimuth), away * np.sin(azimuth)])
        if (np.abs(at) < self.gel_half_mm).all():
            z = min(z, float(model.dome(self.globals[2], at)[0]) - BELOW_COAT_MM)
        place = [*at, z]
        return np.array([*place, azimuth + np.pi + turn, elevation, np.exp(length), np.exp(height)])


def in_units(name: str, value: float, sd: float) -> tuple[str, float, float]:
    """A parameter as people read it: degrees for radians, millimetres for logarithms of them."""
    if name.endswith("_rad"):
        return name.removesuffix("rad") + "deg", float(np.degrees(value)), float(np.degrees(sd))
    group, _, what = name.rpartition(".log_")
    return (f"{group}.{what}_mm", float(np.exp(value)), float(np.exp(value) * sd)) if group else (name, value, sd)


def light_names(parameters: Parameters) -> list[str]:
    """A colour each, numbered where a colour comes twice."""
    names: list[str] = []
    for flux in parameters.colours[:-1]:
        share = flux / max(flux.max(), 1e-12)
        bright = "".join(c for c, part in zip("rgb", share, strict=True) if part > 0.6)
        name = {"r": "red", "g": "green", "b": "blue", "rg": "yellow", "rb": "magenta", "gb": "cyan"}.get(bright, "white")
        count = sum(known.rstrip("0123456789") == name for known in names)
        names.append(f"{name}{count + 1}" if count else name)
    return [*names, "veil"]


def to_scene(parameters: Parameters, start: Scene, resolution: tuple[int, int]) -> Scene:
    """The sensor as a scene: gel, camera, lights, coating; the rest is the start's."""
    px, distance, curvature, thickness, specular, roughness, gamma, about_x, about_y, _ = (float(value) for value in parameters.globals)
    foot = model.foot(parameters.shape(np.zeros(0)))
    lights = []
    for index, (name, flux) in enumerate(zip(light_names(parameters), parameters.colours, strict=True)):
        light = parameters.light(index)
        facing = model.facing(light)
        power = float(flux.max())
        lights.append(
            Light(
                name=name,
                position_mm=(float(light[0]), float(light[1]), float(light[2])),
                direction=tuple(round(float(part), 9) for part in facing),  # type: ignore[arg-type]
                size_mm=(float(light[5]), float(light[6])),
                rgb=tuple(float(part) / power for part in flux) if power > 0 else (1.0, 1.0, 1.0),  # type: ignore[arg-type]
                power=power,
            )
        )
    gel = dome_of(replace(start.gel, thickness_mm=thickness), curvature)
    camera = replace(
        start.camera,
        resolution=resolution,
        distance_mm=max(distance, start.lights.window_thickness_mm + gel.thickness_mm + model.LEAST_AIR_MM),
        field_mm=(px * resolution[0], px * resolution[1]),
        exposure=EXPOSURE,
        white_balance=(1.0, 1.0, 1.0),
        gamma=gamma,
        shading=(),
        tilt_deg=(float(np.degrees(about_x)), float(np.degrees(about_y))),
        offset_mm=(float(foot[0]), float(foot[1])),
        noise_sd=(0.0, 0.0, 0.0),
    )
    return start.replace(
        gel=gel,
        lights=replace(start.lights, lights=tuple(lights)),
        coating=Coating(
            albedo=(ALBEDO, ALBEDO, ALBEDO), specular=specular, roughness=roughness, flake_reflectance=(FLAKE, FLAKE, FLAKE), grain=0.0
        ),
        camera=camera,
        render=replace(start.render, resolution=resolution),
    )


def dome_of(gel: Gel, curvature: float) -> Gel:
    """That gel as a dome of a curvature [1/mm]; made thicker where its edge would vanish."""
    half = max(gel.size_mm) / 2
    if curvature * half < 1e-3:
        return replace(gel, profile="flat", radius_mm=None)
    root = np.sqrt(1 - min(curvature * half, 0.99) ** 2)
    drop = float(curvature * half**2 / (1 + root))
    thickness = max(gel.thickness_mm, drop + 0.2)
    return replace(gel, profile="dome", radius_mm=None, thickness_mm=thickness, edge_thickness_mm=thickness - drop)


def curvature_of(gel: Gel) -> float:
    """1/R_d [1/mm] of a gel's dome, 0 of a flat one."""
    if not gel.turned:
        raise SceneError(f'gel.profile = "{gel.profile}": calibration takes gels of one curvature, "flat", "dome" or "sphere"')
    drop, half = gel.thickness_mm - gel.edge_mm, gel.half_width_mm
    return 2 * drop / (half**2 + drop**2)


def empty_scene(gel: Gel, camera: Camera, lights: Lights) -> Scene:
    """A scene without markers to start from."""
    from gelsim.scene.definition import Markers, Press

    return Scene(gel=gel, camera=camera, lights=lights, markers=Markers(layout="none"), press=Press(depth_mm=0.1))
