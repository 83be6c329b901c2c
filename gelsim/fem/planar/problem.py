"""A press in the plane made ready for Newton: what `gelsim.fem.problem` is for solids.

Of a body of revolution one radian is solved, in plane strain a millimetre of depth of the half x ≥ 0; `copies` makes the whole of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gelsim.fem.coat import coat_of_edges
from gelsim.fem.contact import ContactLaw
from gelsim.fem.newton import NewtonOptions
from gelsim.fem.planar.assembly import PlanarSolids
from gelsim.fem.planar.contact import EdgeContact
from gelsim.fem.planar.elements import PlanarQuadrature, planar_quadrature
from gelsim.fem.problem import (
    MILLINEWTON,
    PENALTY_PER_MODULUS,
    STICK_PER_MODULUS,
    TOLERANCES,
    PressProblem,
    isochoric_constants,
)
from gelsim.geometry import PlanarMesh
from gelsim.scene.definition import Scene
from gelsim.scene.materials import ElasticMaterial
from gelsim.units import KPA_PER_PA, MM_PER_M

Array = NDArray[np.float64]

# ε of the penalty. Augmentation leaves an overlap of ε/2: with 0.5 µm a press of 0.1 mm is 0.4 % too soft, and Newton takes more steps.
SMOOTHING_MM = 5e-5


class PlanarProblem(PressProblem):
    """`PressProblem` of two profiles: its methods, and what they need.

    Args:
        gel, body: As they just touch; a `body` without triangles is rigid.
        gel_material: Of each of the gel's regions, where it has several.
        depth_mm: How long the bodies are along y in plane strain; None for bodies of revolution.
    """

    def __init__(self, scene: Scene, gel: PlanarMesh, body: PlanarMesh, gel_material: ElasticMaterial | Sequence[ElasticMaterial],
                 object_material: ElasticMaterial | None, depth_mm: float | None, *, tolerance: float | None = None) -> None:  # fmt: skip
        self.scene, self.object_material, self.held = scene, object_material, 0.0
        self.gel, self.body = gel, body  # type: ignore[assignment]
        self.turned, self.depth_mm = depth_mm is None, depth_mm
        self.copies = 2 * np.pi if depth_mm is None else 2 * depth_mm
        n = len(gel.nodes)
        rest = np.insert(np.vstack([gel.nodes, body.nodes]) * MM_PER_M, 1, 0.0, axis=1)
        self.object_nodes = np.arange(n, len(rest))
        fixed = np.zeros((len(rest), 3), bool)
        fixed[:, 1] = True
        fixed[np.abs(rest[:, 0]) < 1e-9, 0] = True
        fixed[gel.groups["bonded"]] = True
        kinds = [gel_material] if isinstance(gel_material, ElasticMaterial) else list(gel_material)
        triangles, self.regions = [gel.triangles], gel.regions
        if len(body.triangles):
            assert object_material is not None
            self.driven = n + np.unique(body.groups["base"])
            triangles.append(body.triangles + n)
            self.regions = np.concatenate([gel.regions, np.full(len(body.triangles), len(kinds), np.int32)])
            kinds.append(object_material)
        else:
            self.driven = self.object_nodes
        fixed[self.driven] = True

        ogden = any(material.law == "ogden" for material in kinds)

        def each(values: Sequence[Array] | Sequence[float]) -> Array:
            return np.array(values)[self.regions]

        everything = np.concatenate(triangles).astype(np.int32)
        self.quadrature: PlanarQuadrature = planar_quadrature(rest, everything, self.turned)
        law = each([isochoric_constants(material, ogden) for material in kinds])
        self.solids = PlanarSolids(rest, everything, self.quadrature, law, each([m.kappa * KPA_PER_PA for m in kinds]), fixed, "cpu")
        if scene.gel.coat_n_per_m > 0.0:
            self.solids.coat = coat_of_edges(gel.groups["coated"], rest, scene.gel.coat_n_per_m, self.turned)
        self.memory = None
        self.shear = each([material.mu * KPA_PER_PA for material in kinds])
        softest = min(material.youngs_modulus for material in kinds) * KPA_PER_PA
        friction = ContactLaw.coefficient(scene.contact)
        self.law = ContactLaw(PENALTY_PER_MODULUS * softest, SMOOTHING_MM, friction, STICK_PER_MODULUS * softest)
        edges = (body.groups["contact"] + n).astype(np.int32)
        self.contact = EdgeContact(gel.groups["coated"], edges, rest, self.law, self.turned)
        self.options = NewtonOptions(tolerance or TOLERANCES[scene.fidelity])

    def _across_planes(self, force: Array) -> Array:
        """Newton [N] of the whole body: across the axis, or the plane x = 0, forces cancel."""
        return np.array([0.0, 0.0, force[2] * MILLINEWTON])
