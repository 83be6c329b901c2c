"""Gels with a curved outer face: a sphere is the dome of its radius, and that of a file; a plate on a cylinder is a cylinder on a plate."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from manifold3d import Manifold

from gelsim.errors import SceneError
from gelsim.geometry import jacobian_determinants
from gelsim.mesh.gel_mesh import mesh_gel
from gelsim.optics import choose_variant
from gelsim.optics.isp import develop
from gelsim.optics.render import Renderer
from gelsim.pipeline import stages
from gelsim.results import Deformation
from gelsim.scene.definition import Body, Contact, Gel, Press, Render, Scene
from gelsim.scene.layers import build_scene
from gelsim.shape.orientation import turned
from gelsim.shape.shapes import gel_height

MODULUS_KPA, RADIUS_MM, LENGTH_MM = 100.0, 20.0, 20.0
PLATE = Body(shape="box", rigid=True, width_mm=14.0, length_mm=24.0, height_mm=5.0)


def pressed(gel: Gel, body: Body, depth_mm: float = 0.1) -> Deformation:
    return stages.press(Scene(gel=gel, object=body, press=Press(depth_mm=depth_mm, frames=3), contact=Contact(friction_coefficient=0.0)))


def pad(profile: str, radius_mm: float | None = None) -> Gel:
    """As thick as it is wide: a narrow contact does not see the window much."""
    return Gel(profile=profile, radius_mm=radius_mm, size_mm=(12.0, LENGTH_MM), thickness_mm=8.0, youngs_modulus_kpa=MODULUS_KPA)


def test_a_sphere_is_the_dome_of_its_radius() -> None:
    half, drop = 12.5, 1.4
    ball = Body(shape="hemisphere", rigid=True, radius_mm=5.0)
    dome, sphere = (
        pressed(Gel(edge_thickness_mm=1.0), ball),
        pressed(Gel(profile="sphere", radius_mm=(half**2 + drop**2) / (2 * drop)), ball),
    )
    assert sphere.force[-1, 2] == pytest.approx(dome.force[-1, 2], rel=1e-6)


def test_a_plate_on_a_cylinder_is_a_cylinder_on_a_plate() -> None:
    """Their gap is the same function of x, so to first order in the slopes (here 0.3 at most, at the border) is all that follows."""
    plate = pressed(pad("cylinder", RADIUS_MM), PLATE)
    rod = pressed(pad("flat"), Body(shape="cylinder", rigid=True, radius_mm=RADIUS_MM, length_mm=24.0))
    # the cylinder's gel thins by 0.9 of 8 mm to its sides, beside the contact of 1.2 mm half width. Measured: 0.5 and 0.1 %
    assert plate.force[-1, 2] == pytest.approx(rod.force[-1, 2], rel=0.01)
    assert plate.contact_area[-1] == pytest.approx(rod.contact_area[-1], rel=0.01)
    # Hertz's half width at that force on a half-space; by 8 mm of thickness, 7 half widths, off by some (b/T)^2 = 2 %. Measured: 2.2 %
    per_length = -plate.force[-1, 2] / (LENGTH_MM * 1e-3)
    hertz = np.sqrt(4 * per_length * RADIUS_MM * 1e-3 / (np.pi * MODULUS_KPA * 1e3 / (1 - 0.499**2)))
    half_width = plate.contact_area[-1] / (2 * LENGTH_MM * 1e-3)
    assert half_width == pytest.approx(hertz, rel=0.04)
    # planted: of a radius a tenth larger the width would be 5 % off
    assert abs(half_width / (hertz * np.sqrt(1.1)) - 1) > 0.02 and abs(half_width / (hertz / np.sqrt(1.1)) - 1) > 0.04


def block(x: float, y: float, z: float) -> Manifold:
    """Of these sides, its base in the middle of z = 0."""
    return Manifold.cube([x, y, z], True).translate([0, 0, z / 2])


def cap(radius: float, size: float, thickness: float) -> Manifold:
    """Of a sphere of 256 segments, as CAD programs write it: 854 triangles of 1.4 mm."""
    return block(size, size, 2 * thickness) ^ Manifold.sphere(radius, 256).translate([0, 0, thickness - radius])


def written(folder: Path, solid: Manifold, name: str = "pad.stl", scale: float = 1.0) -> str:
    found = solid.to_mesh64()
    path = folder / name
    trimesh.Trimesh(found.vert_properties[:, :3] * scale, found.tri_verts, process=False).export(path)
    return str(path)


def test_a_pad_from_a_file_is_the_sphere_that_it_was_made_from(tmp_path: Path) -> None:
    """Force and picture of a press; 0.01 % and 0.2 levels were found, of facets alone normals would be up to 0.7 degrees off."""
    path = written(tmp_path, cap(57.0, 20.0, 2.4))
    own = {"size_mm": [20.0, 20.0], "thickness_mm": 2.4}
    layer = {
        "fidelity": "fast",
        "object": {"shape": "hemisphere", "rigid": True, "radius_mm": 5.0},
        "press": {"depth_mm": 0.8, "frames": 2, "symmetry": "none"},
        "render": {"resolution": [160, 120]},
    }
    forces, pictures = [], []
    for gel in ({"profile": "sphere", "radius_mm": 57.0}, {"profile": "mesh", "mesh": path}):
        scene = build_scene(layer | {"gel": own | gel})
        deformation = stages.press(scene)
        renderer = Renderer(scene.replace(render=Render("path", 16, (160, 120))), choose_variant("cpu"))
        membrane = stages.membranes(scene, deformation)[-1]
        forces.append(deformation.force[-1, 2])
        pictures.append([develop(scene, renderer.radiance(membrane, seed)).astype(float) for seed in (0, 1)])
    assert forces[1] == pytest.approx(forces[0], rel=0.005)
    noise = np.sqrt(np.mean((pictures[0][0] - pictures[0][1]) ** 2))
    # The same random numbers: what differs is the surface.
    assert np.sqrt(np.mean((pictures[1][0] - pictures[0][0]) ** 2)) < noise


@pytest.mark.parametrize("offset_mm", [(0.0, 0.0), (-4.0, 3.0)])
def test_a_pad_without_mirror_planes_is_meshed_as_it_is(tmp_path: Path, offset_mm: tuple[float, float]) -> None:
    # A block under a cylinder that leans: high at one side, a ridge along neither axis. Given upside down and in cm.
    ridge = Manifold.cylinder(60.0, 40.0, 40.0, 256, True).rotate([90, 0, 0]).translate([0, 0, -37.0]).rotate([0, 4, 20])
    solid = block(16.0, 14.0, 8.0) ^ ridge
    top = solid.bounding_box()[5]
    path = written(tmp_path, solid.rotate([180, 0, 0]), scale=0.1)
    gel = Gel("mesh", (16.0, 14.0), top, mesh=path, mesh_unit="cm", bonded_side="top")
    scene = Scene(gel=gel, object=Body(shape="hemisphere", rigid=True, radius_mm=3.0), press=Press(depth_mm=0.3, offset_mm=offset_mm))
    mesh = mesh_gel(scene)
    assert jacobian_determinants(mesh.rest_positions, mesh.tets).min() > 0
    vertices = mesh.rest_positions[np.unique(mesh.groups["coated"][:, :3])]
    assert np.abs(vertices[:, 2] - gel_height(gel, vertices[:, :2])).max() < 1e-12
    assert vertices[:, 0].min() < -7.9e-3 and vertices[:, 0].max() > 7.9e-3 and np.ptp(vertices[:, 2]) > 0.5e-3
    # All on the cylinder, in its own frame; its facets of 1 mm are 3 µm off.
    own = (vertices * 1e3 + [0, 0, top]) @ turned((0.0, 4.0, 20.0)) + [0, 0, 37.0]
    assert np.abs(np.hypot(own[:, 0], own[:, 2]) - 40.0).max() < 0.005


@pytest.mark.parametrize(
    ("solid", "gel", "message"),
    [
        (lambda: block(20, 20, 2.4), {"profile": "dome"}, 'profile "mesh" needs an STL'),
        (lambda: block(20, 20, 2.4), {"mesh": "nowhere.stl"}, "cannot be read .No such file"),
        (lambda: block(20, 20, 2.4), {"mesh_unit": "m"}, "is 2400 mm thick.*gel.mesh_unit"),
        (lambda: block(20, 20, 2.4), {"size_mm": (21.0, 20.0)}, "the bottom face of .* is 20 x 20 mm"),
        (lambda: block(20, 20, 2.4), {"bonded_side": "left"}, "the left face of .* is 2.4 x 20 mm"),
        (lambda: block(20, 20, 2.4), {"thickness_mm": 3.0}, "is 2.4 mm thick"),
        (lambda: block(20, 20, 2.4).rotate([5, 0, 0]), {}, "no flat bottom face"),
        (lambda: Manifold.cylinder(2.4, 10.0), {}, "lacks 21.*a rectangle that it fills"),
        (lambda: block(20, 20, 2.4) - block(2, 2, 2.4), {}, "lacks 1 % of gel.size_mm"),
        (lambda: block(20, 20, 2.4) - block(8, 8, 1.4).translate([0, 0, 0.5]), {}, "64 mm. of it hang over"),
        (lambda: block(20, 20, 2.0) + block(8, 8, 2.4), {}, "an upright step at"),
        (lambda: block(20, 20, 2.4).trim_by_plane([-0.12, 0, -1], -1.2 / np.hypot(0.12, 1)), {}, "thins out to 0 mm"),
    ],
)
def test_a_file_that_is_no_pad(tmp_path: Path, solid: Callable[[], Manifold], gel: dict, message: str) -> None:
    fields = {"profile": "mesh", "size_mm": (20.0, 20.0), "thickness_mm": 2.4, "mesh": written(tmp_path, solid())} | gel
    with pytest.raises(SceneError, match=message) as told:
        gel_height(Scene(gel=Gel(**fields)).gel, np.zeros((1, 2)))
    assert "\n" not in str(told.value)


def test_an_open_pad_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, block(20, 20, 2.4))
    mesh = trimesh.load_mesh(path)
    trimesh.Trimesh(mesh.vertices, mesh.faces[1:], process=False).export(path)
    with pytest.raises(SceneError, match="is not closed .3 open edges"):
        gel_height(Gel("mesh", (20.0, 20.0), 2.4, mesh=path), np.zeros((1, 2)))


@pytest.mark.parametrize(
    ("gel", "message"),
    [
        ({"profile": "cylinder"}, "gel.radius_mm is missing"),
        ({"profile": "flat", "radius_mm": 20.0}, 'gel.radius_mm = 20 mm is for gel.profile = "sphere" or "cylinder"'),
        ({"profile": "sphere", "radius_mm": 20.0}, "allowed: 34.42 mm or more"),
        ({"profile": "cylinder", "radius_mm": 5.0, "size_mm": (12.0, 20.0), "thickness_mm": 8.0}, "allowed: 6 mm or more"),
    ],
)
def test_a_radius_that_is_none(gel: dict, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        Scene(gel=Gel(**gel))
