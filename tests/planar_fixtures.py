"""Profiles for the tests of plane mechanics: structured, deterministic, of a few dozen triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelsim.fem.planar.assembly import PlanarSolids
from gelsim.fem.planar.elements import planar_quadrature
from gelsim.fem.planar.problem import PlanarProblem
from gelsim.fem.planar.recording import PlanarRecorder
from gelsim.fem.problem import isochoric_constants
from gelsim.fem.quasistatic import run_press
from gelsim.geometry import quadratic_faces
from gelsim.mesh.profiles import mesh_profiles
from gelsim.results import Deformation
from gelsim.scene import materials
from gelsim.scene.definition import Scene
from gelsim.scene.materials import ElasticMaterial

Array = NDArray[np.float64]


def grid(x: Array, z: Array, shake: float = 0.0) -> tuple[Array, NDArray[np.int32]]:
    """Nodes (N, 3) [mm], y = 0, and six-node triangles of a rectangle; `shake` moves inner vertices by that share of a cell."""
    points = np.stack(np.meshgrid(x, z, indexing="ij"), axis=-1).reshape(-1, 2)
    inner = ((points > points.min(0) + 1e-12) & (points < points.max(0) - 1e-12)).all(axis=1)
    cell = min(np.diff(x).min(), np.diff(z).min())
    points = points + shake * cell * np.random.default_rng(3).uniform(-1, 1, points.shape) * inner[:, None]
    number = np.arange(len(points)).reshape(len(x), len(z))
    a, b, c, d = number[:-1, :-1].ravel(), number[1:, :-1].ravel(), number[1:, 1:].ravel(), number[:-1, 1:].ravel()
    faces = np.vstack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    surface = quadratic_faces(np.insert(points, 1, 0.0, axis=1), faces)
    return surface.nodes, surface.faces


def solids_of(
    nodes: Array, triangles: NDArray[np.int32], material: ElasticMaterial, fixed: NDArray[np.bool_], turned: bool
) -> PlanarSolids:
    """One solid; `fixed` (N, 3) says which displacement components are prescribed; y always is."""
    fixed = fixed.copy()
    fixed[:, 1] = True
    law = np.tile(isochoric_constants(material), (len(triangles), 1))
    quadrature = planar_quadrature(nodes, triangles, turned)
    return PlanarSolids(nodes, triangles, quadrature, law, np.full(len(triangles), material.kappa * 1e-3), fixed, "cpu")


def press_of(scene: Scene, *, finer: float = 1.5, gel_end: float | None = None, depth_mm: float | None = None,
             tolerance: float = 1e-5) -> tuple[PlanarProblem, Deformation]:  # fmt: skip
    """A press as a profile; `depth_mm` for plane strain."""
    gel, body = mesh_profiles(scene, finer=finer, gel_end=gel_end)
    of_object = materials.object_materials(scene).get("body")
    problem = PlanarProblem(scene, gel, body, materials.gel_material(scene), of_object, depth_mm, tolerance=tolerance)
    return problem, run_press(problem, record=PlanarRecorder)
