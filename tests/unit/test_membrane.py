"""The coated surface against the finite-element surface it comes from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import RectBivariateSpline

from gelsim.membrane.surface import membrane_states, rest_membrane
from gelsim.results import Deformation, SurfaceMotion
from gelsim.scene.definition import Gel, Markers, Scene
from gelsim.shape.shapes import gel_height

DEPTH, WIDTH = 0.6e-3, 1.2e-3
"""Of the synthetic dent [m]; its steepest slope is 0.6 DEPTH/WIDTH = 17 degrees."""


def bell(x, y):
    return np.exp(-((x - 1e-3) ** 2 + (y + 0.5e-3) ** 2) / (2 * WIDTH**2))


def dent(x, y):
    """Displacement [m], shape (..., 3): down, and toward the centre's right."""
    return bell(x, y)[..., None] * np.array([0.2e-3, 0.1e-3, -DEPTH])


def quadratic_faces(half: float, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Places (x, y) and six-node faces of a regular triangulation whose neighbouring nodes are `spacing` apart."""
    count = 2 * round(half / spacing) + 1
    x, y = np.meshgrid(*[np.linspace(-half, half, count)] * 2)

    def index(row, column):
        return row * count + column

    r, c = (a.ravel() for a in np.meshgrid(np.arange(0, count - 1, 2), np.arange(0, count - 1, 2), indexing="ij"))
    lower = [index(r, c), index(r, c + 2), index(r + 2, c + 2), index(r, c + 1), index(r + 1, c + 2), index(r + 1, c + 1)]
    upper = [index(r, c), index(r + 2, c + 2), index(r + 2, c), index(r + 1, c + 1), index(r + 2, c + 1), index(r + 1, c)]
    return np.column_stack([x.ravel(), y.ravel()]), np.concatenate([np.stack(lower, 1), np.stack(upper, 1)])


def pressed(scene: Scene, places: np.ndarray, faces6: np.ndarray, fields: list[np.ndarray]) -> Deformation:
    rest = np.column_stack([places, gel_height(scene.gel, places)])
    states = len(fields)
    none, whole = np.zeros(states), np.zeros(states, np.int32)
    motion = SurfaceMotion(rest, np.zeros((0, 3), np.int32), np.array(fields), faces6)
    vectors, pressure = np.zeros((states, 3)), np.zeros((states, len(places)))
    return Deformation(none, none, vectors, none, pressure, motion, motion, none, none, whole, whole, none, np.ones(states, bool))


@pytest.fixture
def scene() -> Scene:
    return Scene(gel=Gel(size_mm=(12.0, 12.0), edge_thickness_mm=2.0), markers=Markers(jitter_mm=0.05))


@pytest.mark.parametrize("spacing_mm", [0.1, 0.3])
def test_membrane_against_the_element_surface(scene, spacing_mm):
    """What C1 interpolation changes: micrometres at the coarsest node spacing allowed in a contact, and the true dent is met as well."""
    places, faces6 = quadratic_faces(6e-3, spacing_mm * 1e-3)
    nodal = dent(*places.T)
    (membrane,) = membrane_states(scene, pressed(scene, places, faces6, [nodal]))
    rest = rest_membrane(scene)
    moved = membrane.positions - rest.positions
    x, y = rest.positions[:, :2].T
    # Third derivatives of the bell reach 1.4 / WIDTH³. Quadratic interpolation with nodes h apart errs by up to h³ √3/27 · max|f'''| ·
    # DEPTH along a line. In the plane three such terms add up, and the gradients estimated at the nodes err as much again: six.
    bound = 6 * (spacing_mm * 1e-3) ** 3 * np.sqrt(3) / 27 * 1.4 / WIDTH**3 * DEPTH
    assert np.abs(moved - dent(x, y))[:, 2].max() < bound

    # The element surface itself, at three points inside each face: shape functions of a six-node triangle.
    corners = np.array([[0.6, 0.2, 0.2], [0.2, 0.6, 0.2], [1 / 3, 1 / 3, 1 / 3]])
    a, b, c = corners.T
    shape = np.stack([a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1), 4 * a * b, 4 * b * c, 4 * c * a], axis=1)
    element = np.einsum("qi,fic->fqc", shape, nodal[faces6]).reshape(-1, 3)
    where = np.einsum("qi,fic->fqc", shape, places[faces6]).reshape(-1, 2)
    side = int(np.sqrt(len(moved)))
    axis = np.linspace(-6e-3, 6e-3, side)
    drawn = RectBivariateSpline(axis, axis, moved[:, 2].reshape(side, side)).ev(where[:, 1], where[:, 0])
    # Both err by the bound against the true dent: 0.2 µm at 0.1 mm, 5 µm at 0.3 mm, the coarsest spacing in a contact.
    assert np.abs(drawn - element[:, 2]).max() < 2 * bound

    # Planted: a dent 1 % deeper must not pass.
    assert np.abs(1.01 * moved - dent(x, y))[:, 2].max() > bound


def test_normals_are_the_dents(scene):
    flat = scene.replace(gel=replace(scene.gel, profile="flat"))
    places, faces6 = quadratic_faces(6e-3, 0.2e-3)
    straight = dent(*places.T) * [0, 0, 1]
    (membrane,) = membrane_states(flat, pressed(flat, places, faces6, [straight]))
    x, y = membrane.positions[:, :2].T
    depth = -DEPTH * bell(x, y)
    exact = np.stack([depth * (x - 1e-3) / WIDTH**2, depth * (y + 0.5e-3) / WIDTH**2, np.ones_like(x)], axis=1)
    exact /= np.linalg.norm(exact, axis=1, keepdims=True)
    angle = np.degrees(np.arccos(np.clip((membrane.normals * exact).sum(axis=1), -1, 1)))
    # Gradients of a quadratic interpolant with h = 0.2 mm err by h²/3 · f''' = 0.2²/3 · 1.4 · 0.6 / 1.2³ = 0.0065 = 0.4 degrees at worst.
    assert angle.max() < 0.4
    assert np.linalg.norm(membrane.normals, axis=1) == pytest.approx(np.ones(len(x)), abs=1e-12)


def test_nothing_moved_is_the_rest_membrane(scene):
    places, faces6 = quadratic_faces(6e-3, 0.3e-3)
    still, _ = membrane_states(scene, pressed(scene, places, faces6, [np.zeros((len(places), 3)), dent(*places.T)]))
    rest = rest_membrane(scene)
    for name in ("positions", "normals", "uv", "faces", "marker_centres"):
        assert np.array_equal(getattr(still, name), getattr(rest, name))


def test_markers_move_with_the_material(scene):
    places, faces6 = quadratic_faces(6e-3, 0.1e-3)
    (membrane,) = membrane_states(scene, pressed(scene, places, faces6, [dent(*places.T)]))
    centres = rest_membrane(scene).marker_centres
    # As above for h = 0.1 mm: 6 h³ √3/27 · 1.4/WIDTH³ · DEPTH = 0.2 µm.
    assert membrane.marker_centres == pytest.approx(centres + dent(*centres[:, :2].T), abs=0.2e-6)
    # The pitch is 1.3 mm before jitter: 9 x 9 markers fit on 12 mm.
    assert len(centres) == 81


def test_rest_surface_faces_out_of_the_gel(scene):
    rest = rest_membrane(scene)
    a, b, c = (rest.positions[rest.faces[:, i]] for i in range(3))
    assert np.all(np.cross(b - a, c - a)[:, 2] > 0) and np.all(rest.normals[:, 2] > 0.9)
    assert rest.uv.min() == 0 and rest.uv.max() == 1
