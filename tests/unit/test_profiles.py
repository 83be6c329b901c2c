"""Profiles of gel and object: closed, right side out, on the exact shape, the same every time; and which reduction a scene gets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gelsim.errors import SceneError
from gelsim.fem.planar.elements import planar_quadrature
from gelsim.geometry import PlanarMesh
from gelsim.mesh.profiles import gel_radius, mesh_profiles
from gelsim.mesh.reductions import choose_reduction
from gelsim.scene.definition import Body, Gel, Grains, Press, Scene
from gelsim.scene.shape_table import SHAPES

BODIES = [
    Body(shape="hemisphere"), Body(shape="hemisphere", radius_mm=50.0), Body(shape="cone"), Body(shape="punch", radius_mm=3.0),
    Body(shape="frustum", radius_mm=2.0), Body(shape="cylinder"), Body(shape="edge"), Body(shape="flat"),
]  # fmt: skip


def measure(mesh: PlanarMesh, turned: bool) -> tuple[float, float]:
    """Area of the profile or volume of the turned body, by elements and by the boundary integral of what is in groups and on the axis."""
    weights = planar_quadrature(np.insert(mesh.nodes, 1, 0.0, axis=1), mesh.triangles, turned).weights
    from gelsim.fem.planar.elements import edge_gradient, edge_quadrature, edge_shape

    place, rule = edge_quadrature(4)
    x = mesh.nodes[np.vstack(list(mesh.groups.values()))]
    at = np.einsum("qn,eni->eqi", edge_shape(place), x)
    along = np.einsum("qn,eni->eqi", edge_gradient(place), x)
    # ∮ x dz = area, ∮ x²/2 dz = volume per radian; the axis adds nothing
    return float(weights.sum()), float(((at[..., 0] ** 2 / 2 if turned else at[..., 0]) * along[..., 1] * rule).sum())


@pytest.mark.parametrize("fidelity", ["fast", "balanced"])
@pytest.mark.parametrize("body", BODIES, ids=lambda body: f"{body.shape}-{body.radius_mm:g}")
def test_profiles_fill_what_they_bound(body: Body, fidelity: str) -> None:
    turned = SHAPES[body.shape].turned
    scene = Scene(gel=Gel(profile="dome" if turned else "flat"), object=body, fidelity=fidelity)
    for mesh, deep in zip(mesh_profiles(scene), (True, False), strict=True):
        inside, around = measure(mesh, turned)
        assert inside == pytest.approx(around, rel=1e-12) and inside > 0
        corners = mesh.nodes[mesh.triangles[:, :3]]
        sides = corners[:, [1, 2, 0]] - corners
        area = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]) / 2
        quality = 4 * np.sqrt(3) * area / (sides**2).sum((1, 2))
        assert quality.min() > 0.25  # a right triangle of equal legs has 0.87; a dome's rim and bisection halve that
        assert (mesh.nodes[:, 1].max() == 0.0) if deep else (mesh.nodes[:, 1].min() == 0.0)
    again = mesh_profiles(scene)
    assert all(np.array_equal(a.nodes, b.nodes) for a, b in zip(mesh_profiles(scene), again, strict=True))


def test_curved_edges_lie_on_the_ball() -> None:
    for rigid in (False, True):
        mesh = mesh_profiles(Scene(object=Body(shape="hemisphere", rigid=rigid, height_mm=25.0)))[1]
        nodes = mesh.nodes[np.unique(mesh.groups["contact"])]
        cap = nodes[nodes[:, 1] < 5e-3 - 1e-12]
        assert len(cap) > 30 and np.abs(np.hypot(cap[:, 0], cap[:, 1] - 5e-3) - 5e-3).max() < 1e-15


def test_a_rim_that_touches_ends_an_edge_of_the_gel() -> None:
    gel, _ = mesh_profiles(Scene(gel=Gel(profile="flat"), object=Body(shape="punch", radius_mm=3.0)))
    vertices = gel.nodes[np.unique(gel.groups["coated"][:, :2])]
    assert np.abs(vertices[:, 0] - 3e-3).min() < 1e-15
    edges = gel.nodes[gel.groups["coated"][:, :2]][:, :, 0]
    at_rim = np.abs(edges - 3e-3).min(axis=1) < 1e-12
    assert np.ptp(edges[at_rim], axis=1).max() < 0.3e-3 < np.ptp(edges, axis=1).max()


def test_disc_has_the_area_of_the_gel() -> None:
    assert np.pi * gel_radius(Scene(gel=Gel(size_mm=(20.0, 30.0)))) ** 2 == pytest.approx(6e-4)


def scene_of(
    shape: str = "hemisphere", gel: Gel | None = None, fidelity: str = "balanced", body: dict | None = None, **press: object
) -> Scene:  # type: ignore[type-arg]
    return Scene(object=Body(shape=shape, **(body or {})), gel=gel or Gel(), press=Press(**press), fidelity=fidelity)  # type: ignore[arg-type]


def test_auto_takes_a_profile_where_its_error_is_small() -> None:
    flat = Gel(profile="flat")
    assert all(
        choose_reduction(scene_of(shape, body={"radius_mm": 3.0})).kind == "axisymmetric"
        for shape in ("hemisphere", "cone", "punch", "frustum")
    )
    assert choose_reduction(scene_of(gel=flat, offset_mm=(1.0, 0.0))).kind == "axisymmetric"
    for scene in (
        scene_of("cylinder"), scene_of("corner"), scene_of(tilt_deg=(0.0, 3.0)), scene_of(shear_mm=(0.1, 0.0)),
        scene_of(offset_mm=(1.0, 0.0)),
        scene_of(gel=flat, offset_mm=(4.0, 0.0)), scene_of(body={"radius_mm": 50.0}), scene_of(symmetry="mirror"),
        scene_of(body={"grains": Grains(count=2, radius_mm=0.5, youngs_modulus_kpa=50.0)}), scene_of("cylinder", gel=flat),
    ):  # fmt: skip
        found = choose_reduction(scene)
        assert found.kind == ("none" if scene.object.grains.count else "mirror") and not found.planar and found.reason
    assert choose_reduction(scene_of(twist_deg=3.0)).kind == choose_reduction(scene_of(symmetry="none")).kind == "none"


def test_finer_fidelity_allows_less() -> None:
    def kind(fidelity: str) -> str:
        return choose_reduction(scene_of(gel=Gel(profile="flat"), fidelity=fidelity, body={"radius_mm": 10.0})).kind

    assert [kind(f) for f in ("fast", "balanced", "reference")] == ["axisymmetric", "axisymmetric", "mirror"]


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        (scene_of("cylinder", symmetry="axisymmetric"), "press.symmetry = 'axisymmetric': object.shape = 'cylinder'"),
        (scene_of(symmetry="axisymmetric", twist_deg=2.0), "press.twist_deg = 2"),
        (scene_of("cylinder", symmetry="plane-strain"), "gel.profile = 'dome'"),
        (scene_of("box", gel=Gel(profile="flat"), symmetry="plane-strain"), "15 mm long, the gel 25 mm"),
        (scene_of("edge", gel=Gel(profile="flat"), symmetry="plane-strain", shear_mm=(0.2, 0.0)), "press.shear_mm = [0.2, 0]"),
    ],
)
def test_what_does_not_reduce_is_said(scene: Scene, words: str) -> None:
    with pytest.raises(SceneError) as caught:
        choose_reduction(scene)
    assert words in str(caught.value) and "allowed" in str(caught.value)


def test_override_is_taken() -> None:
    scene = scene_of("cylinder", gel=Gel(profile="flat"), symmetry="plane-strain")
    assert choose_reduction(scene).kind == "plane-strain" and choose_reduction(scene).error > 0.2
    big = scene_of(body={"radius_mm": 50.0}, symmetry="axisymmetric")
    assert choose_reduction(big).kind == "axisymmetric"
    assert choose_reduction(replace(big, fidelity="fast")).error > 0.02
