"""The scene: everything that decides a press and its pictures, as frozen dataclasses.

One set of names: a field here is a key of the scene file and a flag of the command line, unit suffix included (docs/decisions/0001).
Stages convert to SI where they read (`gelsim.units`). No arrays: a scene is hashable and prints whole.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

Vec2 = tuple[float, float]
Vec3 = tuple[float, float, float]


@dataclass(frozen=True)
class Sensor:
    preset: str = "fingertip2017"
    """A preset of assets/sensors/, or the path of a sensor file; gel, camera, lights, coating and markers below override it."""


@dataclass(frozen=True)
class Gel:
    profile: str = "dome"
    """"dome" | "flat"."""
    size_mm: Vec2 = (25.0, 25.0)
    thickness_mm: float = 2.4
    """The maximum, at the centre; the inner face is bonded to the rigid window."""
    edge_thickness_mm: float = 1.0
    """Thickness at the middle of each edge (dome only)."""
    shore_00: float | None = 17.0
    """Exactly one of shore_00, shore_a, youngs_modulus_kpa."""
    shore_a: float | None = None
    youngs_modulus_kpa: float | None = None
    modulus_scale: float = 1.0
    """Multiplies the modulus that a Shore value gives: the literature disagrees by 2 (docs/physics.md)."""
    poissons_ratio: float = 0.499


@dataclass(frozen=True)
class Body:
    """The pressed object, [object] in the scene file. Frame: apex at the origin, base at z = height."""

    shape: str = "cylinder"
    radius_mm: float = 5.0
    height_mm: float = 25.0
    """From the contact apex to the base on the platen."""
    width_mm: float = 25.0
    """Across, of flat, box, edge and corner blocks."""
    angle_deg: float = 90.0
    """Included angle of edge, corner and cone; of frustum: between flank and base, see docs."""
    mesh: str | None = None
    mesh_unit: str = "mm"
    """"mm" | "cm" | "m" | "in"."""
    rigid: bool = False
    shore_00: float | None = 30.0
    """Exactly one of shore_00, shore_a, youngs_modulus_kpa, unless rigid."""
    shore_a: float | None = None
    youngs_modulus_kpa: float | None = None
    modulus_scale: float = 1.0
    poissons_ratio: float = 0.499
    law: str = "neo-hookean"
    law_constants: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class Contact:
    friction_coefficient: float | str = 0.8
    """0 = frictionless, "stick" = no sliding."""


@dataclass(frozen=True)
class Press:
    depth_mm: float | None = 1.0
    """Total approach of the object's base from first touch."""
    force_n: float | None = 9.0
    """Stop early at this normal force; either may be left out, not both."""
    frames: int = 10
    tilt_deg: Vec2 = (0.0, 0.0)
    offset_mm: Vec2 = (0.0, 0.0)
    shear_mm: Vec2 = (0.0, 0.0)
    twist_deg: float = 0.0
    speed_mm_s: float = 6.0


@dataclass(frozen=True)
class Camera:
    """The sensor's camera: a pinhole on the axis, in air behind the window; equations in docs/optics.md."""

    resolution: tuple[int, int] = (960, 720)
    """Of the real camera; what is rendered is [render] resolution, with the same field."""
    field_mm: Vec2 = (18.4, 13.8)
    """Width and height of the gel's surface seen at rest. Pixels are square: a picture of another aspect shows a little more."""
    distance_mm: float = 40.0
    """From the pinhole, through air, window and gel, to the undeformed outer gel surface."""
    fps: float = 30.0
    exposure: float = 1.0
    """Image value (1 = white) of a radiance of 1; fixed, so that frames and presses can be compared."""
    white_balance: Vec3 = (1.0, 1.0, 1.0)
    """Gains of red, green and blue."""
    noise_sd: Vec3 = (0.0, 0.0, 0.0)
    """Standard deviation of the camera's noise in red, green and blue [levels of 255]; 0 = none."""


@dataclass(frozen=True)
class Light:
    """One coloured emitter: a Lambertian rectangle inside the window."""

    name: str = "light"
    position_mm: Vec3 = (0.0, 0.0, 0.0)
    """Of its centre; z < 0 is inside the sensor."""
    direction: Vec3 = (0.0, 0.0, 1.0)
    """It faces there; any length but zero."""
    size_mm: Vec2 = (1.0, 1.0)
    """Along the gel, and across."""
    rgb: Vec3 = (1.0, 1.0, 1.0)
    """Colour as the camera sees it on a white surface (linear)."""
    power: float = 1.0
    """Radiant flux of a channel whose rgb is 1 [mW; only ratios matter, camera.exposure sets the scale]."""


@dataclass(frozen=True)
class Lights:
    lights: tuple[Light, ...] = ()
    window_thickness_mm: float = 4.0
    window_ior: float = 1.49
    gel_ior: float = 1.41


@dataclass(frozen=True)
class Coating:
    """The opaque reflective skin, seen from inside: a diffuse pigment and a lobe of metal flakes."""

    albedo: Vec3 = (0.5, 0.5, 0.5)
    """Of the diffuse part."""
    specular: float = 0.0
    """Share of the semi-specular flake lobe, 0…1."""
    roughness: float = 0.3
    """GGX width of the flakes' slopes."""
    flake_reflectance: Vec3 = (0.9, 0.9, 0.9)
    """Of a flake at normal incidence; about 0.9 is aluminium."""
    grain: float = 0.0
    """Relative standard deviation of the fixed pattern in the coat's reflectance."""
    grain_size_mm: float = 0.1


@dataclass(frozen=True)
class Markers:
    layout: str = "grid"
    """"grid" | "none"."""
    pitch_mm: float = 1.3
    radius_mm: float = 0.2
    tilt_deg: float = 0.0
    """Of the rows, about z."""
    jitter_mm: float = 0.0
    """Standard deviation of a marker's place in x and in y."""
    size_jitter: float = 0.0
    """Relative standard deviation of a marker's radius."""
    outline_jitter: float = 0.0
    """Relative standard deviation of a marker's outline about its circle."""
    albedo: float = 0.03
    seed: int = 0
    """Of the jitter: the markers belong to the sensor, not to the press."""


@dataclass(frozen=True)
class Render:
    mode: str = "path"
    """"path": with inter-reflection | "direct": light that comes straight from the emitters."""
    spp: int = 16
    """Light paths a pixel."""
    resolution: tuple[int, int] = (480, 360)


@dataclass(frozen=True)
class Scene:
    sensor: Sensor = field(default_factory=Sensor)
    gel: Gel = field(default_factory=Gel)
    object: Body = field(default_factory=Body)
    contact: Contact = field(default_factory=Contact)
    press: Press = field(default_factory=Press)
    camera: Camera = field(default_factory=Camera)
    lights: Lights = field(default_factory=Lights)
    coating: Coating = field(default_factory=Coating)
    markers: Markers = field(default_factory=Markers)
    render: Render = field(default_factory=Render)
    fidelity: str = "balanced"
    """"fast" | "balanced" | "reference"."""
    seed: int = 0

    def replace(self, **sections: object) -> "Scene":
        """A copy with whole sections replaced."""
        return replace(self, **sections)  # type: ignore[arg-type]
