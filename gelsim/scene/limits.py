"""What the fields of a scene may be: words to choose from, the bounds of every number, and the check of a section against both."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping

from gelsim.errors import SceneError, within
from gelsim.scene import materials
from gelsim.scene.fields import nearest, whats, which
from gelsim.scene.shape_table import SHAPES
from gelsim.units import MESH_UNITS, unit_of

CHOICES: dict[str, Collection[str]] = {
    "fidelity": ("live", "fast", "balanced", "reference"),
    "gel.profile": ("dome", "flat", "sphere", "cylinder", "mesh"),
    "gel.mesh_unit": tuple(MESH_UNITS),
    "gel.bonded_side": ("bottom", "top", "left", "right", "front", "back"),
    "object.shape": SHAPES.keys(),
    "object.mesh_unit": tuple(MESH_UNITS),
    "object.press_side": ("bottom", "top", "left", "right", "front", "back"),
    "object.law": materials.LAWS,
    "press.touch_at": ("apex", "centre"),
    "press.symmetry": ("auto", "axisymmetric", "plane-strain", "mirror", "none"),
    "markers.layout": ("grid", "random", "list", "none"),
    "camera.tone": ("srgb", "linear"),
    "render.mode": ("baked", "path", "direct", "auto"),
}

MESH_SUFFIXES = (".stl", ".obj", ".ply", ".off", ".glb")
"""Of files that object.mesh may name."""
REST_TERMS = {3 * (degree + 1) * (degree + 2) // 2: degree for degree in range(4)}
"""Numbers of camera.rest_smooth, and the degree that they are of."""
SHADING_DEGREES = {degree * (degree + 3) // 2: degree for degree in range(1, 7)}
"""Terms of a polynomial over the picture without its constant -> its degree."""

# Inclusive bounds of every number in a field, in the unit of its name. Only Shore readings have no row: their relations bound them.
LIMITS: dict[str, tuple[float, float]] = {
    "seed": (0, 2**32 - 1),
    "target_error": (1e-4, 0.5),
    "target_membrane_um": (0.01, 1000),
    "gel.size_mm": (5, 100),
    "gel.thickness_mm": (0.5, 20),
    "gel.edge_thickness_mm": (0.05, 20),
    "gel.radius_mm": (1, 1e5),
    "gel.youngs_modulus_kpa": (1, 1e7),
    "gel.modulus_scale": (0.05, 20),
    "gel.poissons_ratio": (0, 0.49999),
    "gel.coat_n_per_m": (0, 1000),
    "gel.prony_g": (0, 1),
    "gel.prony_tau_s": (1e-6, 1e6),
    "object.radius_mm": (0.5, 50),
    "object.height_mm": (1, 100),
    "object.width_mm": (0.5, 100),
    "object.length_mm": (0.5, 100),
    "object.angle_deg": (10, 170),
    "object.wall_mm": (0.2, 50),
    "object.edge_radius_mm": (0, 5),
    "gel.mesh_scale": (1e-6, 1e6),
    "object.mesh_scale": (1e-6, 1e6),
    "object.rotation_deg": (-360, 360),
    "object.amplitude_mm": (0, 5),
    "object.wavelength_mm": (0.5, 50),
    "object.pattern_seed": (0, 2**32 - 1),
    "object.youngs_modulus_kpa": (1, 1e7),
    "object.modulus_scale": (0.05, 20),
    "object.poissons_ratio": (0, 0.49999),
    "object.prony_g": (0, 1),
    "object.prony_tau_s": (1e-6, 1e6),
    "object.skin.thickness_mm": (0, 20),
    "object.skin.youngs_modulus_kpa": (1, 1e7),
    "object.skin.modulus_scale": (0.05, 20),
    "object.grains.count": (0, 500),
    "object.grains.radius_mm": (0.1, 20),
    "object.grains.seed": (0, 2**32 - 1),
    "object.grains.youngs_modulus_kpa": (1, 1e7),
    "object.grains.modulus_scale": (0.05, 20),
    "object.law_constants.c2_over_c1": (-1, 10),
    "object.law_constants.c3_over_c1": (-1, 10),
    "object.law_constants.alpha": (-25, 25),
    "object.law_constants.weight": (0, 1),
    "contact.friction_coefficient": (0, 10),
    "press.depth_mm": (1e-3, 50),
    "press.force_n": (1e-3, 1000),
    "press.frames": (2, 1000),
    "press.tilt_deg": (-90, 90),
    "press.offset_mm": (-50, 50),
    "press.shear_mm": (-10, 10),
    "press.twist_deg": (-90, 90),
    "press.speed_mm_s": (1e-3, 1000),
    "press.hold_s": (0, 1e5),
    "press.path.duration_s": (1e-3, 1e5),
    "press.path.depth_mm": (-50, 50),
    "press.path.force_n": (1e-3, 1000),
    "press.path.shear_mm": (-50, 50),
    "press.path.twist_deg": (-180, 180),
    "press.path.tilt_deg": (-90, 90),
    "camera.resolution": (16, 4096),
    "camera.field_mm": (1, 100),
    "camera.distance_mm": (1, 1000),
    "camera.fps": (0.1, 1000),
    "camera.exposure": (1e-6, 1e6),
    "camera.white_balance": (0, 100),
    "camera.noise_sd": (0, 255),
    "camera.gamma": (0.2, 5),
    "camera.offset_mm": (-100, 100),
    "camera.tilt_deg": (-45, 45),
    "camera.distortion": (-1, 1),
    "camera.full_well": (0, 1e7),
    "camera.read_noise": (0, 1),
    "camera.shading": (-10, 10),
    "camera.rest_smooth": (-10, 10),
    "lights.window_thickness_mm": (0, 50),
    "lights.window_ior": (1, 3),
    "lights.gel_ior": (1, 3),
    "lights.lights.position_mm": (-1000, 1000),
    "lights.lights.direction": (-1e6, 1e6),
    "lights.lights.size_mm": (0.01, 200),
    # Light of flux 1 and of one wavelength is 5.9 (`optics.spectra`), a little more by `rgb_on_coat`; 255 is a colour on another scale.
    "lights.lights.rgb": (0, 10),
    "lights.lights.power": (0, 1e9),
    "lights.lights.lobe": (1, 100),
    "lights.lights.peak_nm": (400, 700),
    "lights.lights.width_nm": (5, 100),
    "coating.albedo": (0, 1),
    "coating.specular": (0, 1),
    "coating.roughness": (0.01, 1),
    "coating.flake_reflectance": (0, 1),
    "coating.grain": (0, 1),
    "coating.grain_size_mm": (0.01, 10),
    "markers.pitch_mm": (0.2, 50),
    "markers.radius_mm": (0.02, 10),
    "markers.tilt_deg": (-180, 180),
    "markers.offset_mm": (-50, 50),
    "markers.jitter_mm": (0, 10),
    "markers.size_jitter": (0, 1),
    "markers.outline_jitter": (0, 1),
    "markers.albedo": (0, 1),
    "markers.seed": (0, 2**32 - 1),
    "render.least_psnr_db": (10, 80),
    "render.spp": (1, 65536),
    "render.resolution": (16, 4096),
}


def check_limits(
    section: object, name: str = "", choices: Mapping[str, Collection[str]] = CHOICES, limits: Mapping[str, tuple[float, float]] = LIMITS
) -> None:
    """Raises SceneError where a field of a section, or of one inside it, is beyond choices or limits; `name` is the section's own."""
    for item in dataclasses.fields(section):  # type: ignore[arg-type]
        full = f"{name}.{item.name}" if name else item.name
        value = getattr(section, item.name)
        unit = unit_of(item.name)
        if dataclasses.is_dataclass(value):
            check_limits(value, full, choices, limits)
        elif isinstance(value, tuple) and value and dataclasses.is_dataclass(value[0]):
            for index, part in enumerate(value):
                with within(which(value, index, whats(full))):
                    check_limits(part, full, choices, limits)
        if full in choices and value not in choices[full]:
            hint = nearest(str(value), choices[full])
            if full == "object.shape" and str(value).lower().endswith(MESH_SUFFIXES):
                hint = f"; a file is object.mesh = {value!r} (--mesh {value})"
            raise SceneError(f"{full} = {value!r}: allowed are {', '.join(choices[full])}{hint}")
        if full in limits:
            low, high = limits[full]
            if any(not low <= number <= high for number in _numbers(value)):
                shown = " ".join(f"{number:g}" for number in _numbers(value))
                turns = "; object.press_side and object.rotation_deg turn another side to the gel" if full == "press.tilt_deg" else ""
                raise SceneError(f"{full} = {shown}{_spaced(unit)}: allowed is {low:g} … {high:g}{_spaced(unit)}{turns}")


def _numbers(value: object) -> list[float]:
    if isinstance(value, tuple):
        return [number for item in value for number in _numbers(item)]
    return [value] if isinstance(value, (int, float)) and not isinstance(value, bool) else []


def _spaced(unit: str) -> str:
    return f" {unit}" if unit else ""
