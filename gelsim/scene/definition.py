"""The scene: everything that decides a press and its pictures, as frozen dataclasses.

One set of names: a field here is a key of the scene file and a flag of the command line, unit suffix included (docs/decisions/0001).
Stages convert to SI where they read (`gelsim.units`). No arrays: a scene is hashable and prints whole. A `Scene` that exists is valid:
types, ranges and contradictions are checked when it is made, and an error names the field, its value with unit and what is allowed.
`gelsim.scene.fields` converts, `gelsim.scene.limits` bounds each field by itself, what contradicts another is found here;
`gelsim.scene.layers` reads and writes TOML. The string under a field is its documentation and the help text of its flag.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field, replace

from gelsim.errors import MaterialError, SceneError, within
from gelsim.scene import materials
from gelsim.scene.fields import convert, field_types, share, which
from gelsim.scene.limits import LIMITS, REST_TERMS, SHADING_DEGREES, check_limits
from gelsim.scene.measured_path import measured_path
from gelsim.scene.shape_table import SHAPES

Vec2 = tuple[float, float]
Vec3 = tuple[float, float, float]


@dataclass(frozen=True)
class Sensor:
    preset: str = "fingertip2017"
    """A preset of assets/sensors/, or the path of a sensor file; gel, camera, lights, coating and markers below override it."""


@dataclass(frozen=True)
class Gel:
    profile: str = "dome"
    """"dome" | "flat" | "sphere" | "cylinder", whose axis lies along y | "mesh": the pad in the file named by mesh."""
    size_mm: Vec2 = (25.0, 25.0)
    thickness_mm: float = 2.4
    """The maximum, at the centre; the inner face is bonded to the rigid window."""
    edge_thickness_mm: float = 1.0
    """Thickness at the middle of each edge (dome only)."""
    radius_mm: float | None = None
    """Of curvature of the outer face (sphere and cylinder only)."""
    mesh: str | None = None
    """A closed STL, OBJ, PLY, OFF or GLB file (profile "mesh"): what of it stands over size_mm is the gel, thickness_mm at its thickest."""
    mesh_unit: str = "mm"
    """"mm" | "cm" | "m" | "in"."""
    mesh_scale: float = 1.0
    """Multiplies the file's numbers."""
    bonded_side: str = "bottom"
    """Which side of the file is flat and bonded: "bottom" (the lowest z), "top", "left" (the lowest x), "right", "front", "back"."""
    shore_00: float | None = None
    """Hardness, 1 to 99. Exactly one of shore_00, shore_a, youngs_modulus_kpa; none means Shore 00-17."""
    shore_a: float | None = None
    """Hardness on the A scale, 20 to 80."""
    youngs_modulus_kpa: float | None = None
    """Small-strain Young's modulus, given instead of a hardness."""
    modulus_scale: float = 1.0
    """Multiplies the modulus that a Shore value gives: the literature disagrees by 2 (docs/physics.md)."""
    poissons_ratio: float = 0.499
    """0 to 0.49999; silicone is 0.499 to 0.4999."""
    prony_g: tuple[float, ...] = ()
    """Shares of the shear modulus that relax, one for each prony_tau_s, of sum below 1; the hardness is then that of a fast press."""
    prony_tau_s: tuple[float, ...] = ()
    """Times in which they relax; none = no viscosity."""
    coat_n_per_m: float = 0.0
    """How much the coat resists being stretched: its Young's modulus times its thickness; 0.02 mm of 0.25 MPa make 5 N/m."""

    def __post_init__(self) -> None:
        _default_hardness(self, 17.0)

    @property
    def turned(self) -> bool:
        """Whether its outer face is one of revolution about z."""
        return self.profile in ("flat", "dome", "sphere")

    @property
    def half_width_mm(self) -> float:
        """From the middle to where the thickness is `edge_mm`: to a short side, of a cylinder to one along its axis."""
        return (self.size_mm[0] if self.profile == "cylinder" else max(self.size_mm)) / 2

    @property
    def edge_mm(self) -> float:
        """Thickness at the middle of an edge, of a cylinder of those along its axis."""
        if self.profile == "dome":
            return self.edge_thickness_mm
        if self.radius_mm is None:
            return self.thickness_mm
        return self.thickness_mm - self.radius_mm + math.sqrt(max(self.radius_mm**2 - self.half_width_mm**2, 0.0))


@dataclass(frozen=True)
class LawConstants:
    """The shape of the object's stress-strain curve; its small-strain modulus is the one given by a hardness (docs/decisions/0002)."""

    c2_over_c1: float | None = None
    """Yeoh's second constant over the first; the first is mu/2."""
    c3_over_c1: float | None = None
    """Yeoh's third constant over the first."""
    alpha: tuple[float, ...] = ()
    """Exponents of an Ogden law, one to three, of W = sum 2 mu/alpha^2 (l1^alpha + l2^alpha + l3^alpha - 3); 2 is neo-Hookean."""
    weight: tuple[float, ...] = ()
    """Share of the shear modulus of each alpha, of sum 1; left out for a single alpha."""


@dataclass(frozen=True)
class Skin:
    """An outer layer of the object, of a hardness of its own; law, Poisson's ratio and viscosity are the object's."""

    thickness_mm: float = 0.0
    """Measured inward from the surface, but for the base; 0 = no skin."""
    shore_00: float | None = None
    """Hardness, 1 to 99. A skin gives exactly one of shore_00, shore_a, youngs_modulus_kpa."""
    shore_a: float | None = None
    """Hardness on the A scale, 20 to 80."""
    youngs_modulus_kpa: float | None = None
    """Small-strain Young's modulus, given instead of a hardness."""
    modulus_scale: float = 1.0
    """Multiplies the modulus that a Shore value gives."""


@dataclass(frozen=True)
class Grains:
    """Balls of a hardness of their own inside the object, at random places that neither touch each other nor the surface."""

    count: int = 0
    """How many; 0 = none."""
    radius_mm: float = 1.0
    """Of each."""
    seed: int = 0
    """Of their places."""
    shore_00: float | None = None
    """Hardness, 1 to 99. Grains give exactly one of shore_00, shore_a, youngs_modulus_kpa."""
    shore_a: float | None = None
    """Hardness on the A scale, 20 to 80."""
    youngs_modulus_kpa: float | None = None
    """Small-strain Young's modulus, given instead of a hardness."""
    modulus_scale: float = 1.0
    """Multiplies the modulus that a Shore value gives."""


@dataclass(frozen=True)
class Body:
    """The pressed object, [object] in the scene file. Frame: apex at the origin, base at z = height."""

    shape: str = "cylinder"
    """flat: a block 25 x 25 mm. box: a block width_mm x length_mm. hemisphere: a ball's end on a straight round foot. cylinder: a rod
    lying along y, its curved side down, on a straight block. punch: a flat-ended round rod, sharp rim. frustum: a truncated cone, narrow
    flat end down. cone: apex down, on a straight foot. edge: a wedge, its ridge along y. corner: of a cube, one vertex down. tube: hollow,
    lying along y under a narrower foot. shell: a ball's hollow end under a hollow foot, the cup's bottom down. torus: a ring lying on a
    round block. tomato: a ball with a skin under a narrower foot. candy: a box with grains. Blocks width_mm x length_mm with an uneven
    underside: wave (ridges along y), emboss (a grid of round dots), rough (random). mesh: the file named by mesh."""
    radius_mm: float = 5.0
    """Of hemisphere, cylinder, punch, tube, shell and tomato (outside), of a cone's foot, a frustum's narrow end, a torus' middle line."""
    height_mm: float = 25.0
    """From the contact apex to the base on the platen."""
    width_mm: float | None = None
    """Along x, of flat, edge, corner (25 by default), box, candy, wave, emboss and rough (10)."""
    length_mm: float | None = None
    """Along y, of flat, edge, cylinder, tube (25 by default), box (15), candy, wave, emboss and rough (10)."""
    angle_deg: float | None = None
    """Edge and cone: the angle they include (90 by default). Frustum: between flank and base plane (75); 90 is a punch."""
    wall_mm: float | None = None
    """Thickness of the wall of tube and shell (a fifth of radius_mm by default), and of a torus' ring (half of it)."""
    amplitude_mm: float = 0.2
    """From top to bottom, of wave and emboss; of rough the standard deviation of its heights."""
    wavelength_mm: float = 3.0
    """Of wave and emboss; of rough the shortest, the longest is four times that."""
    pattern_seed: int = 0
    """Of rough: another number, another surface."""
    mesh: str | None = None
    """An STL, OBJ, PLY, OFF or GLB file (shape = "mesh"), its lowest point the contact apex. Closed for a soft object; a rigid one may be
    an open scan, have holes, and be larger than the gel."""
    mesh_unit: str = "mm"
    """"mm" | "cm" | "m" | "in"; GLB files are in m by their standard."""
    mesh_scale: float = 1.0
    """Multiplies the file's numbers."""
    mesh_repair: bool = False
    """True: open edges of a soft object's file are closed by fans of triangles. A rigid one's always are; both are said."""
    press_side: str = "bottom"
    """Which side faces the gel: "bottom" (the lowest z), "top", "left" (the lowest x), "right", "front" (the lowest y), "back". Acts
    before rotation_deg. A soft object that is turned is a mesh, and held at a plane 10 % of its height below its farthest point."""
    rotation_deg: Vec3 = (0.0, 0.0, 0.0)
    """Of the object about x, then y, then z, before its apex is found; press.tilt_deg turns it about the apex."""
    edge_radius_mm: float | None = None
    """Radius of a rigid object's rims and edges (0.1 by default, 0.2 at `fast`, a quarter of its smallest feature at most, 0 for a punch;
    0: as sharp as can be resolved, 0.04), and of a soft corner (0 by default: sharp)."""
    rigid: bool = False
    """True: the object does not deform; no finite elements for it, only its surface."""
    shore_00: float | None = None
    """Hardness, 1 to 99. Exactly one of shore_00, shore_a, youngs_modulus_kpa unless rigid; none means Shore 00-30."""
    shore_a: float | None = None
    """Hardness on the A scale, 20 to 80."""
    youngs_modulus_kpa: float | None = None
    """Small-strain Young's modulus, given instead of a hardness."""
    modulus_scale: float = 1.0
    """Multiplies the modulus that a Shore value gives."""
    poissons_ratio: float = 0.499
    """0 to 0.49999; silicone is 0.499 to 0.4999."""
    law: str = "neo-hookean"
    """Elastic law (its isochoric part); yeoh and ogden need their constants in law_constants."""
    law_constants: LawConstants = field(default_factory=LawConstants)
    prony_g: tuple[float, ...] = ()
    """Shares of the shear modulus that relax, one for each prony_tau_s, of sum below 1; the hardness is then that of a fast press."""
    prony_tau_s: tuple[float, ...] = ()
    """Times in which they relax; none = no viscosity."""
    skin: Skin = field(default_factory=Skin)
    grains: Grains = field(default_factory=Grains)

    def __post_init__(self) -> None:
        if self.rigid:
            return
        _default_hardness(self, 30.0)
        row = SHAPES.get(self.shape) if isinstance(self.shape, str) else None  # what it is is checked later
        for name, part in (("skin", Skin), ("grains", Grains)):
            if row and getattr(self, name) == part():
                object.__setattr__(self, name, part(**getattr(row, name)))


@dataclass(frozen=True)
class Contact:
    friction_coefficient: float | str = 0.8
    """0 = frictionless, "stick" = no sliding."""


@dataclass(frozen=True)
class Waypoint:
    """Where the object goes next on a path; what is left out stays as it is."""

    duration_s: float = 1.0
    """How long that takes."""
    depth_mm: float | None = None
    """Approach of the object's base from first touch, linear in time; below 0 it is lifted off."""
    force_n: float | None = None
    """Instead of a depth: the normal force, linear in time; the approach follows."""
    shear_mm: Vec2 | None = None
    """Tangential travel from first touch."""
    twist_deg: float | None = None
    """Turn about z."""
    tilt_deg: Vec2 | None = None
    """Of the object about x, then y; it begins as press.tilt_deg."""


@dataclass(frozen=True)
class Press:
    depth_mm: float | None = 1.0
    """Total approach of the object's base from first touch."""
    force_n: float | None = 9.0
    """Stop early at this normal force; either may be left out, not both. What is given without the other is reached: a depth whatever
    the force, a force however deep. Several, such as [1, 2, 5]: a path of one second to each."""
    frames: int = 10
    """Recorded states, the first is first touch: equally spaced in approach; of path in time, its waypoints among them (one each at least);
    of path_csv equally spaced in time."""
    path: tuple[Waypoint, ...] = ()
    """Instead of depth_mm, force_n, shear_mm, twist_deg and hold_s: waypoints one after the other, each with duration_s (1) and any of
    depth_mm or force_n, shear_mm, twist_deg, tilt_deg, as [[press.path]] tables (docs/mechanics.md, Paths). Linear between; what one leaves
    out stays."""
    path_csv: str | None = None
    """Instead: a file with the object's apex as it was measured, t_s, x_mm, y_mm, z_mm and rx_deg, ry_deg, rz_deg, in the frame of
    docs/conventions.md; its first row says offset_mm and tilt_deg. Every row is gone through."""
    tilt_deg: Vec2 = (0.0, 0.0)
    """Of the object about x, then y, through its apex; to turn another side to the gel give object.press_side or object.rotation_deg."""
    offset_mm: Vec2 = (0.0, 0.0)
    """Of what touch_at says from the gel's centre."""
    touch_at: str = "apex"
    """"apex": offset_mm is that of the object's apex, which may not be where a tilted one touches. "centre": that of where it does."""
    shear_mm: Vec2 = (0.0, 0.0)
    """Tangential travel of the object's base, applied in proportion to the approach; a tall soft object bends before it slides."""
    twist_deg: float = 0.0
    """Turn about z, applied in proportion to the approach."""
    speed_mm_s: float = 6.0
    """Approach speed: sets the time stamps, and how far a material with prony_g relaxes meanwhile; there is no inertia."""
    hold_s: float = 0.0
    """How long the object then stays where it is, while gel and object relax where they have prony_g: one more recorded state."""
    symmetry: str = "auto"
    """What is solved. "axisymmetric" | "plane-strain": a profile; "mirror": half or a quarter where object, gel and motion share mirror
    planes; "none": the whole. "auto": the smallest of these whose own error is small (docs/mechanics.md)."""

    def __post_init__(self) -> None:
        several = self.force_n
        if isinstance(several, list | tuple):
            if self.path or self.path_csv or self.depth_mm not in (Press.depth_mm, None, "none"):
                raise SceneError(f"press.force_n = {list(several)}: several forces are a path of their own; leave out depth_mm and path")
            object.__setattr__(self, "path", tuple(Waypoint(force_n=force) for force in several))
            object.__setattr__(self, "force_n", None)
        if self.path or self.path_csv not in (None, "none"):
            for name in ("depth_mm", "force_n"):
                if getattr(self, name) == getattr(Press, name):
                    object.__setattr__(self, name, None)


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
    gamma: float = 1.0
    """Exponent on the sRGB curve; above 1 the picture is darker and of more contrast."""
    shading: tuple[float, ...] = ()
    """A smooth gain over the picture: exponents of red, green and blue for each of u, v, u^2, uv, v^2, ... (docs/optics.md); none = 1."""
    noise_sd: Vec3 = (0.0, 0.0, 0.0)
    """Standard deviation of the camera's noise in red, green and blue after the tone curve [levels of 255]; 0 = none."""
    offset_mm: Vec2 = (0.0, 0.0)
    """Of the pinhole from the gel's axis."""
    tilt_deg: Vec2 = (0.0, 0.0)
    """Of the camera about x and y through its pinhole."""
    distortion: Vec2 = (0.0, 0.0)
    """Radial, k1 and k2: a point rho half diagonals from the picture's centre looks where rho (1 + k1 rho^2 + k2 rho^4) would."""
    fresnel: bool = False
    """True: the window reflects away a little more of slanting rays (relative to the picture's centre; below 1 % for 40 degrees)."""
    full_well: Vec3 = (0.0, 0.0, 0.0)
    """Electrons of a white pixel in red, green and blue: shot noise has a variance of that of the number of electrons; 0 = none."""
    read_noise: Vec3 = (0.0, 0.0, 0.0)
    """Standard deviation of the noise before the tone curve in red, green and blue [share of white]; 0 = none."""
    tone: str = "srgb"
    """"srgb": IEC 61966-2-1 | "linear": none."""
    rest: str | None = None
    """A photograph without contact (PNG, JPG): frames are this picture, changed by what a press changes (docs/optics.md). It shows markers
    and grain of its own; [markers] then only says where their centres are."""
    rest_smooth: tuple[float, ...] = ()
    """In place of a photograph a smooth rest, with [markers] painted on it: exponents of red, green and blue for each of 1, u, v, u^2, uv,
    v^2, ... of a level over 255 (docs/optics.md)."""

    @property
    def has_rest(self) -> bool:
        """Whether the picture without contact is given, and not the lights' affair."""
        return self.rest is not None or bool(self.rest_smooth)


@dataclass(frozen=True)
class Light:
    """One coloured emitter: a Lambertian rectangle inside the window."""

    name: str = "light"
    position_mm: Vec3 = (0.0, 0.0, -5.0)
    """Of its centre; z < 0: inside the sensor."""
    direction: Vec3 = (0.0, 0.0, 1.0)
    """It faces there; any length but zero."""
    size_mm: Vec2 = (1.0, 1.0)
    """Along the gel, and across."""
    rgb: Vec3 = (1.0, 1.0, 1.0)
    """Colour as the camera sees it on a white surface: linear, 0 to 10, not all 0; it multiplies power."""
    power: float = 1.0
    """Radiant flux of a channel whose rgb is 1 [mW; only ratios matter, camera.exposure sets the scale]."""
    lobe: float = 1.0
    """Its intensity falls as cos^lobe: 1 is Lambertian, a lensed LED 2 to 20."""
    peak_nm: float | None = None
    """Peak wavelength of an LED: with width_nm it gives the colour instead of rgb."""
    width_nm: float | None = None
    """Full width at half maximum of its spectrum."""


@dataclass(frozen=True)
class Lights:
    lights: tuple[Light, ...] = ()
    """Every light as a table of name, position_mm, direction, size_mm, rgb, power, …: docs/extending.md. Given here they replace all of the
    preset's."""
    window_thickness_mm: float = 4.0
    """Of the rigid plate behind the gel."""
    window_ior: float = 1.49
    """Refractive index of the window."""
    gel_ior: float = 1.41
    """Refractive index of the gel."""
    window_reflection: bool = False
    """True: the window's face to the air throws light back (Fresnel; all of it beyond 42 degrees), that of the lights and of the coat."""


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
    """"grid" | "random": as many as a grid has, no two nearer than 2.5 radii | "list": those of places | "none"."""
    places: str | None = None
    """Of layout "list": a CSV file of x_mm, y_mm and, if wanted, radius_mm."""
    pitch_mm: float = 1.3
    radius_mm: float = 0.2
    tilt_deg: float = 0.0
    """Of the rows, about z."""
    offset_mm: Vec2 = (0.0, 0.0)
    """Of the grid from the gel's centre."""
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
    """"path": traced, with inter-reflection | "direct": traced, light straight from the emitters | "baked": path, from the sensor's light
    field, which is measured once | "auto": baked where that is measured and right to least_psnr_db, else path."""
    spp: int = 16
    """Light paths a pixel, rounded up to a nearly square grid; on scalar variants until every light gets the same number."""
    resolution: tuple[int, int] = (480, 360)
    least_psnr_db: float = 40.0
    """Mode "auto" takes a light field whose worst picture, of those it was judged by, is no farther from path."""


@dataclass(frozen=True)
class Scene:
    """A whole press. Raises SceneError or MaterialError when a field is wrong or contradicts another."""

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
    """"live" | "fast" | "balanced" | "reference": how fine meshes and load steps are; live has none (docs/live.md)."""
    target_error: float | str | None = None
    """Relative error of the force to stay below, 0.02 or "2%": the fidelity is chosen by it, and the one given is not used."""
    target_membrane_um: float | None = None
    """Error (root mean square) of the membrane to stay below, alone or beside target_error; chooses the fidelity likewise."""
    seed: int = 0
    """Of everything random: marker jitter, light sampling."""

    def __post_init__(self) -> None:
        for item in dataclasses.fields(self):
            object.__setattr__(self, item.name, convert(getattr(self, item.name), field_types(Scene)[item.name], item.name))
        if isinstance(self.target_error, str):
            object.__setattr__(self, "target_error", share(self.target_error, "target_error"))
        if self.press.path_csv is not None:
            _begin_as_measured(self.press)
        _check(self)

    def replace(self, **sections: object) -> Scene:
        """A copy with whole sections replaced, checked like any other."""
        return replace(self, **sections)  # type: ignore[arg-type]


# ---- checks ----

STIFFNESS = ("shore_00", "shore_a", "youngs_modulus_kpa")
"""Of these a gel or an object gives exactly one."""


def _default_hardness(section: Gel | Body, shore_00: float) -> None:
    if all(getattr(section, name) is None for name in STIFFNESS):
        object.__setattr__(section, "shore_00", shore_00)


def _check_curved(gel: Gel) -> None:
    """A radius where there is one to be given, and a gel that reaches its border."""
    if (gel.profile == "mesh") != (gel.mesh is not None):
        given = f"gel.profile = {gel.profile!r} and gel.mesh = {gel.mesh!r}"
        raise SceneError(f'{given}: profile "mesh" needs an STL, OBJ, PLY, OFF or GLB file, the others have none')
    curved = gel.profile in ("sphere", "cylinder")
    if curved and gel.radius_mm is None:
        raise SceneError(f'gel.radius_mm is missing: gel.profile = "{gel.profile}" needs the radius of its outer face [mm]')
    if gel.radius_mm is None:
        return
    if not curved:
        raise SceneError(f'gel.radius_mm = {gel.radius_mm:g} mm is for gel.profile = "sphere" or "cylinder", not "{gel.profile}"')
    half, drop = gel.half_width_mm, gel.thickness_mm - LIMITS["gel.edge_thickness_mm"][0]
    least = (half**2 + drop**2) / (2 * drop) if drop < half else half
    if gel.radius_mm < least:
        raise SceneError(
            f"gel.radius_mm = {gel.radius_mm:g} mm: a {gel.profile} {2 * half:g} mm wide and {gel.thickness_mm:g} mm thick ends before its "
            f"border; allowed: {least:.4g} mm or more (or a smaller gel.size_mm, a larger gel.thickness_mm)"
        )


def _check(scene: Scene) -> None:
    check_limits(scene)
    gel, body, press = scene.gel, scene.object, scene.press
    _check_hardness("gel", gel)
    _check_hardness("object", body)
    _check_edge(body)
    _check_parts(body)
    for name, section in (("gel", gel), ("object", body)):
        try:
            materials.prony_series(section)
        except MaterialError as error:
            raise MaterialError(f"{name}.{error}") from None
    if gel.profile == "dome" and gel.edge_thickness_mm > gel.thickness_mm:
        raise SceneError(
            f"gel.edge_thickness_mm = {gel.edge_thickness_mm:g} mm: a dome is no thicker there than "
            f"gel.thickness_mm = {gel.thickness_mm:g} mm"
        )
    _check_curved(gel)
    _check_object(body)
    try:
        materials.law_shape(body.law, body.law_constants)
    except MaterialError as error:
        raise MaterialError(f"object.law_constants.{error}") from None
    friction = scene.contact.friction_coefficient
    if isinstance(friction, str) and friction != "stick":
        raise SceneError(f'contact.friction_coefficient = {friction!r}: allowed is a number of 0 or more, or "stick"')
    if press.path or press.path_csv is not None:
        _check_path(scene)
    elif press.depth_mm is None and press.force_n is None:
        raise SceneError("press.depth_mm and press.force_n are both none: give one, or both to stop at what comes first")
    elif press.depth_mm is not None:
        _check_depth(scene, "press.depth_mm", press.depth_mm)
    for axis, offset, size in zip("xy", press.offset_mm, gel.size_mm, strict=True):
        if abs(offset) > 0.5 * size:
            raise SceneError(f"press.offset_mm = {offset:g} mm along {axis}: the gel ends at {0.5 * size:g} mm from its centre")
    _check_optics(scene)
    if (scene.markers.layout == "list") != (scene.markers.places is not None):
        given = f"markers.layout = {scene.markers.layout!r} and markers.places = {scene.markers.places!r}"
        raise SceneError(f'{given}: layout "list" needs a file, the others have none')
    if scene.markers.layout not in ("none", "list") and 2.0 * scene.markers.radius_mm >= scene.markers.pitch_mm:
        raise SceneError(
            f"markers.radius_mm = {scene.markers.radius_mm:g} mm: markers overlap unless it is less than half of "
            f"markers.pitch_mm = {scene.markers.pitch_mm:g} mm"
        )


def _check_depth(scene: Scene, name: str, depth_mm: float) -> None:
    gel, body = scene.gel, scene.object
    if depth_mm >= body.height_mm and SHAPES[body.shape].made != "file":
        raise SceneError(f"{name} = {depth_mm:g} mm: it must be less than object.height_mm = {body.height_mm:g} mm")
    if body.rigid and depth_mm > 0.8 * gel.thickness_mm:
        raise SceneError(
            f"{name} = {depth_mm:g} mm: a rigid object may go at most 0.8 of gel.thickness_mm deep, {0.8 * gel.thickness_mm:g} mm"
        )


def _check_path(scene: Scene) -> None:
    press = scene.press
    named = "press.path" if press.path else "press.path_csv"
    if press.path and press.path_csv is not None:
        raise SceneError("press.path and press.path_csv are both given: give one")
    for name in ("depth_mm", "force_n", "shear_mm", "twist_deg", "hold_s"):
        value = getattr(press, name)
        if value is not None and value != getattr(Press, name):
            raise SceneError(f"press.{name} = {value}: {named} says the motion; give one of the two")
    if press.path_csv is not None:
        return
    if press.frames <= len(press.path):
        least = len(press.path) + 1
        raise SceneError(
            f"press.frames = {press.frames}: a path of {len(press.path)} waypoints records them all; allowed is {least} or more"
        )
    for index, point in enumerate(press.path):
        with within(which(press.path, index, "waypoint")):
            if point.depth_mm is not None and point.force_n is not None:
                raise SceneError(f"press.path.depth_mm = {point.depth_mm:g} mm and press.path.force_n = {point.force_n:g} N: give one")
            if point.depth_mm is not None:
                _check_depth(scene, "press.path.depth_mm", point.depth_mm)


def _begin_as_measured(press: Press) -> None:
    """Offset and tilt of a measured path are those of its first row."""
    assert press.path_csv is not None
    _, x, y, _, about_x, about_y, _ = measured_path(press.path_csv)[0]
    for name, measured in (("offset_mm", (x, y)), ("tilt_deg", (about_x, about_y))):
        measured = tuple(float(number) for number in measured)
        if getattr(press, name) not in (getattr(Press, name), measured):
            raise SceneError(f"press.{name} = {getattr(press, name)}: press.path_csv begins at {measured}; leave it out")
        object.__setattr__(press, name, measured)


def _check_hardness(name: str, section: Gel | Body | Skin | Grains) -> None:
    given = [key for key in STIFFNESS if getattr(section, key) is not None]
    if len(given) > 1:
        values = " and ".join(f"{name}.{key} = {getattr(section, key):g}" for key in given)
        raise SceneError(f"{values}: give exactly one of {', '.join(STIFFNESS)}")
    if given:
        try:
            materials.youngs_modulus(section)
        except MaterialError as error:
            raise MaterialError(f"{name}.{given[0]}: {error}") from None


def _check_edge(body: Body) -> None:
    """A soft object's edge radius: of shapes that are made with one."""
    if not body.rigid and body.edge_radius_mm is not None and not SHAPES[body.shape].soft_edge:
        may = ", ".join(shape for shape, row in SHAPES.items() if row.soft_edge)
        raise SceneError(
            f'object.edge_radius_mm = {body.edge_radius_mm:g} mm: of soft shapes {may} has one, shape = "{body.shape}" none; leave it '
            "out, or set object.rigid = true"
        )


def _check_parts(body: Body) -> None:
    """Skin and grains: there with a hardness, or not there at all."""
    for name, part, key in (("object.skin", body.skin, "thickness_mm"), ("object.grains", body.grains, "count")):
        _check_hardness(name, part)
        given = [f"{name}.{item} = {getattr(part, item):g}" for item in STIFFNESS if getattr(part, item) is not None]
        present = name.split(".")[1] in materials.parts(body)
        if present and not given:
            raise SceneError(f"{name} has no hardness: give exactly one of {', '.join(STIFFNESS)}")
        if present and not SHAPES[body.shape].has_parts:
            may = ", ".join(shape for shape, row in SHAPES.items() if row.has_parts)
            raise SceneError(f'{name}.{key} = {getattr(part, key):g}: shape = "{body.shape}" has none; allowed for {may}')
        if given and not present:
            raise SceneError(f"{given[0]}, but {name}.{key} = 0: give {key} too, or neither")


def _check_optics(scene: Scene) -> None:
    shading = len(scene.camera.shading)
    if shading and (shading % 3 or shading // 3 not in SHADING_DEGREES):
        allowed = ", ".join(str(3 * count) for count in SHADING_DEGREES)
        raise SceneError(f"camera.shading has {shading} numbers: red, green and blue of every term of a degree are {allowed}, or none")
    smooth = len(scene.camera.rest_smooth)
    if smooth not in (0, *REST_TERMS):
        allowed = ", ".join(str(count) for count in REST_TERMS)
        raise SceneError(f"camera.rest_smooth has {smooth} numbers: red, green and blue of every term of a degree are {allowed}, or none")
    if smooth and scene.camera.rest is not None:
        raise SceneError(f"camera.rest = {scene.camera.rest!r} and camera.rest_smooth exclude each other: give one of them")
    for index, light in enumerate(scene.lights.lights):
        with within(which(scene.lights.lights, index)):
            _check_light(light)
    inside = scene.lights.window_thickness_mm + scene.gel.thickness_mm
    if scene.camera.distance_mm <= inside:
        raise SceneError(
            f"camera.distance_mm = {scene.camera.distance_mm:g} mm: the camera stands behind window and gel, "
            f"so it must exceed {inside:g} mm"
        )
    first, second = scene.camera.distortion
    if any(1 + 3 * first * share + 5 * second * share**2 <= 0 for share in (i / 50 for i in range(51))):
        raise SceneError(
            f"camera.distortion = {first:g} {second:g}: the picture would fold back within its corners; nearer to 0 is allowed"
        )
    _check_view(scene)


def _check_light(light: Light) -> None:
    if (light.peak_nm is None) != (light.width_nm is None):
        given, missing = ("peak_nm", "width_nm") if light.width_nm is None else ("width_nm", "peak_nm")
        raise SceneError(
            f"lights.lights.{given} = {getattr(light, given):g} nm, but {missing} is missing: an LED has both; give both or neither"
        )
    if light.peak_nm is None and not any(light.rgb):
        raise SceneError("lights.lights.rgb = 0 0 0 is no colour: give one above 0; a light that is off has power = 0")
    if light.position_mm[2] >= 0:
        raise SceneError(
            f"lights.lights.position_mm has z = {light.position_mm[2]:g} mm; the gel's outer face is z = 0, lights stand below it"
        )
    if light.direction == (0.0, 0.0, 0.0):
        raise SceneError("lights.lights.direction = 0 0 0 points nowhere; give any other")


def _check_view(scene: Scene) -> None:
    """The middle of what the camera sees must lie within half a field of the gel."""
    camera, lights, gel = scene.camera, scene.lights, scene.gel
    about_x, about_y = (math.radians(angle) for angle in camera.tilt_deg)
    air = camera.distance_mm - lights.window_thickness_mm - gel.thickness_mm
    centre = []
    for offset, slope in zip(camera.offset_mm, (math.tan(about_y), -math.tan(about_x) / math.cos(about_y)), strict=True):
        # Near the axis a path of length t in a medium of index n goes sideways as t/n does in air: enough to tell gel from no gel.
        centre.append(offset + slope * (air + lights.window_thickness_mm / lights.window_ior + gel.thickness_mm / lights.gel_ior))
    if any(abs(place) > (size + field) / 2 for place, size, field in zip(centre, gel.size_mm, camera.field_mm, strict=True)):
        raise SceneError(
            f"camera.offset_mm = {camera.offset_mm[0]:g} {camera.offset_mm[1]:g} mm and camera.tilt_deg = {camera.tilt_deg[0]:g} "
            f"{camera.tilt_deg[1]:g}: the camera looks at ({centre[0]:.3g}, {centre[1]:.3g}) mm and sees no gel, which ends at "
            f"({gel.size_mm[0] / 2:g}, {gel.size_mm[1] / 2:g}) mm"
        )


def unread_sizes(body: Body) -> list[str]:
    """What a body says of its size that its shape does not read, a sentence each."""
    row = SHAPES[body.shape]
    others = dict.fromkeys(name for shape in SHAPES.values() for name in shape.sizes if name not in row.sizes)
    read = ", ".join(("height_mm", *row.sizes))
    said = [name for name in others if getattr(body, name) != getattr(Body, name)]
    return [f"object.{name} = {getattr(body, name)} is not read: a {body.shape} has {read}" for name in said]


def _check_object(body: Body) -> None:
    row = SHAPES[body.shape]
    turned = next((key for key in ("press_side", "rotation_deg") if getattr(body, key) != getattr(Body, key)), None)
    inner = "skin" if body.skin.thickness_mm else "grains" if body.grains.count else ""
    if turned and inner and not body.rigid:
        raise SceneError(
            f"object.{turned} = {getattr(body, turned)}: an object with object.{inner} cannot be turned; leave one of them out"
        )
    if (row.made == "file") != (body.mesh is not None):
        if body.mesh is None:
            raise SceneError('object.mesh is missing: shape = "mesh" needs an STL, OBJ, PLY, OFF or GLB file')
        raise SceneError(f'object.mesh = {body.mesh!r} is given, but object.shape = {body.shape!r}: say shape = "mesh"')
    if row.wall and body.wall_mm is not None:
        most = row.most_wall * body.radius_mm
        if body.wall_mm > most:
            raise SceneError(f"object.wall_mm = {body.wall_mm:g} mm: allowed for a {body.shape} of that radius_mm is up to {most:g} mm")
    low, high = row.angles_deg
    if body.angle_deg is not None and not low <= body.angle_deg <= high:
        raise SceneError(f"object.angle_deg = {body.angle_deg:g}°: allowed for a {body.shape} is {low:g} … {high:g}°")
    of_radius, of_wall = row.least_height
    tall = of_radius * body.radius_mm + of_wall * (body.wall_mm or row.wall * body.radius_mm)
    if body.height_mm <= tall:
        raise SceneError(f"object.height_mm = {body.height_mm:g} mm: a {body.shape} needs more than {tall:g} mm, and a foot above that")
    steepest = 1.5 / math.pi  # of amplitude over wavelength: slopes of 56 degrees
    if row.relief and body.amplitude_mm > steepest * body.wavelength_mm:
        raise SceneError(
            f"object.amplitude_mm = {body.amplitude_mm:g} mm: allowed is up to {steepest * body.wavelength_mm:.3g} mm, "
            f"0.48 of object.wavelength_mm = {body.wavelength_mm:g} mm"
        )
    if not body.rigid and body.radius_mm < row.least_soft_radius_mm:
        allowed = f"{row.least_soft_radius_mm:g} … {LIMITS['object.radius_mm'][1]:g} mm"
        raise SceneError(f"object.radius_mm = {body.radius_mm:g} mm: allowed for a soft {body.shape} is {allowed}")
