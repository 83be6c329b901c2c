"""A scene made ready for Newton: one numbering for both bodies, their supports, materials and contact, in solver units.

The gel is bonded to its window, the object's base to its platen; a node on a mirror plane stays on it. A rigid object has four nodes, which
are driven (contact.RigidContact).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gelsim.fem.assembly import Solids
from gelsim.fem.coat import coat_of_faces
from gelsim.fem.contact import ContactLaw, RigidContact, SurfaceContact, body_shares
from gelsim.fem.elements import tet_quadrature_data
from gelsim.fem.field import distance_field
from gelsim.fem.newton import Newton, NewtonOptions
from gelsim.fem.pattern import split_pressures
from gelsim.fem.viscoelastic import Memory, prony_arrays
from gelsim.geometry import QuadraticSurface, TetMesh
from gelsim.scene.definition import Scene
from gelsim.scene.materials import OGDEN_TERMS, ElasticMaterial
from gelsim.units import KPA_PER_PA, MM_PER_M

Array = NDArray[np.float64]
MILLINEWTON = 1e-3  # N per solver force unit

# k·h of the contact penalty over E of the softest body, and its smoothing: 100 makes the pressure ripple, 10 costs augmentations.
PENALTY_PER_MODULUS = 30.0
# Augmentation leaves half the smoothing as overlap: 0.25 µm makes a press of 0.1 mm 0.3 % too soft, profiles have 0.025 µm.
PENALTY_SMOOTHING_MM = {"fast": 5e-4, "balanced": 5e-4, "reference": 5e-5}
# k_t·h of friction over E. With 30 a nut takes 65 iterations where two ways took 220; shear, twist and tilted flats take a third more, and
# a sticking punch is 1.5 % off, not 0.6 (`gelsim bench --only closed-forms`).
STICK_PER_MODULUS = 10.0
MOST_WASTED = 600  # Newton iterations of solves that failed, in one march: minutes; a step halved to the smallest takes 100 to 210
TOLERANCES = {"fast": 1e-3, "balanced": 1e-4, "reference": 1e-6}  # imbalance left by Newton; a force is off by a fraction of it


@dataclass(frozen=True)
class Numerics:
    """How a press is made discrete, and how long Newton tries."""

    tet_points: int = 4
    contact_points: int = 6
    """Quadrature points on a face."""
    held: float = 0.0
    """Part of κ, in shear moduli, by which volume is held at points (`Solids.hold_volume`), of half of κ at most."""
    tolerance: float | None = None
    """Of Newton (`NewtonOptions`); None: the fidelity's."""
    most_wasted: int = MOST_WASTED
    """Newton iterations of solves that failed, after which a march ends."""
    patient: bool = True
    """Of its solves (`NewtonOptions`)."""


class PressProblem:
    """A scene made ready for Newton: numbering, supports, materials, contact.

    `materials`: the gel's, then those of the object's regions 0, 1, 2, …, unless it is rigid (`press_materials`).
    """

    most_wasted = MOST_WASTED
    pivot: Array = np.zeros(3)
    """About what the object turns, where it first touches [mm]: its apex, or with press.touch_at = "centre" what lies there."""

    def __init__(self, scene: Scene, gel: TetMesh, body: TetMesh | QuadraticSurface, placement: tuple[Array, Array],
                 materials: Sequence[ElasticMaterial], device: str, numerics: Numerics = Numerics()) -> None:  # fmt: skip
        self.scene, self.gel, self.body = scene, gel, body
        rotation, translation = placement
        self.pivot = np.array([*scene.press.offset_mm, translation[2] * MM_PER_M])
        gel_rest = gel.rest_positions * MM_PER_M
        n = len(gel_rest)
        if isinstance(body, TetMesh):
            nodes = body.rest_positions
        else:
            nodes = np.vstack([np.zeros(3), np.eye(3)]) * RigidContact.SIDE / MM_PER_M
        object_rest = (nodes @ np.asarray(rotation).T + np.asarray(translation)) * MM_PER_M
        rest = np.concatenate([gel_rest, object_rest])
        self.object_nodes = np.arange(n, len(rest))
        fixed = np.zeros((len(rest), 3), bool)
        fixed[gel.groups["bonded"]] = True
        if "sliding" in gel.groups:  # the middle of a specimen between two platens
            fixed[gel.groups["sliding"], 2] = True
        for axis, column in (("x", 0), ("y", 1)):
            if axis in gel.symmetry:
                fixed[:, column] |= np.abs(rest[:, column]) < 1e-9
        meshes: list[tuple[TetMesh, list[ElasticMaterial], int]] = [(gel, list(materials[:1]), 0)]
        if isinstance(body, TetMesh):
            self.driven = n + np.unique(body.groups["base"])
            meshes.append((body, list(materials[1:]), n))
        else:
            self.driven = self.object_nodes
        fixed[self.driven] = True

        parts, of_tets = [], []
        ogden = any(material.law == "ogden" for _, several, _ in meshes for material in several)
        for mesh, several, shift in meshes:
            data = tet_quadrature_data(TetMesh((rest[shift : shift + len(mesh.rest_positions)]), mesh.tets), numerics.tet_points)
            law = np.array([isochoric_constants(material, ogden) for material in several])[mesh.regions]
            kappa = np.array([material.kappa * KPA_PER_PA for material in several])[mesh.regions]
            parts.append((mesh.tets + shift, data, law, kappa))
            of_tets += [several[region] for region in mesh.regions]
        data = parts[0][1]
        if len(parts) > 1:
            data = type(data)(*(np.concatenate([getattr(p[1], f) for p in parts]) for f in ("gradients", "weights")), data.pressure_shape)
        tets, law, kappa = (np.concatenate([p[i] for p in parts]) for i in (0, 2, 3))
        tets = tets.astype(np.int32)
        # parts of one material are one solid; between two, bodies or parts, stress and pressure may jump
        kinds = list(dict.fromkeys(of_tets))
        shift = np.concatenate([np.zeros(len(parts[0][0]), int), *(np.ones(len(p[0]), int) for p in parts[1:])])
        self.regions = np.array([kinds.index(material) for material in of_tets], np.int32) + len(kinds) * shift.astype(np.int32)
        pressures, copies = split_pressures(tets, self.regions, len(rest))
        rest, fixed = np.concatenate([rest, rest[copies]]), np.concatenate([fixed, fixed[copies]])
        self.solids = Solids(rest, tets, data, law, kappa, fixed, device, pressures)
        self.quadrature = data
        self.shear = np.array([material.mu * KPA_PER_PA for material in of_tets])
        self.held, self.most_wasted = numerics.held, numerics.most_wasted
        if self.held > 0.0:
            self.solids.hold_volume(np.minimum(self.held * self.shear, 0.5 * kappa))
        softest = min(material.youngs_modulus for _, several, _ in meshes for material in several) * KPA_PER_PA
        self.memory: Memory | None = None
        if any(material.prony for _, several, _ in meshes for material in several):
            self.memory = self.solids.remember(*prony_arrays([material.prony for material in of_tets]))
        stiffness = PENALTY_PER_MODULUS * softest
        friction = ContactLaw.coefficient(scene.contact)
        self.law = ContactLaw(stiffness, PENALTY_SMOOTHING_MM[scene.fidelity], friction, STICK_PER_MODULUS * softest)
        coated = gel.groups["coated"]
        if scene.gel.coat_n_per_m > 0.0:
            self.solids.coat = coat_of_faces(coated, rest, scene.gel.coat_n_per_m, device)
        if isinstance(body, TetMesh):
            faces = (body.groups["contact"] + n).astype(np.int32)
            self.contact = SurfaceContact(coated, faces, rest, self.law, device, numerics.contact_points, gel.symmetry)
        else:
            field = distance_field(scene)
            self.contact = RigidContact(coated, self.driven, rest, field, self.law, device, numerics.contact_points, gel.symmetry)
        tolerance, folds = numerics.tolerance or TOLERANCES[scene.fidelity], isinstance(body, TetMesh)
        options = NewtonOptions(tolerance, patient=numerics.patient, folds=folds)
        self.options = options if numerics.patient else options.brief
        self.copies = 2 ** len(gel.symmetry)

    @cached_property
    def newton(self) -> Newton:
        """The solver of this press by itself."""
        return Newton(self.solids, self.contact, self.options)

    @cached_property
    def linear_solver(self) -> str:
        """Name of what solves its equations, for the report."""
        return self.newton.system.direct.name

    def object_surface(self, displacement: Array) -> tuple[QuadraticSurface, Array]:
        """The object's outer faces in place at rest [m], and how they move (S, G, 3) where all nodes move by (S, N, 3)."""
        body = self.body
        if isinstance(body, TetMesh):
            used, faces = np.unique(body.groups["contact"]), body.surface("contact").faces
            nodes = self.object_nodes[used]
            return QuadraticSurface(self.solids.rest[nodes] / MM_PER_M, faces), displacement[:, nodes]
        shares = body_shares(body.nodes * MM_PER_M / RigidContact.SIDE)[:, :4]
        return QuadraticSurface(shares @ self.solids.rest[self.driven] / MM_PER_M, body.faces), shares @ displacement[:, self.driven]

    def reset(self) -> None:
        """Back to rest, with nothing remembered of contact."""
        self.solids.set_state((np.zeros_like(self.solids.rest), np.zeros(self.solids.node_count)))
        self.contact.forget()
        if self.memory is not None:
            self.memory.forget()

    def contact_force(self) -> Array:
        """Force on the gel by the object [N], the whole body's."""
        c = self.contact
        pressure = c.pressure.numpy()[:, None]
        local = np.where(pressure > 0, pressure * c.normal.numpy(), 0.0) + (c.traction.numpy() if c.frictional else 0.0)
        return self._across_planes((c.rest_weight[:, None] * local).sum(0) * self.copies)

    def support_force(self) -> Array:
        """Reaction [N] of the window on the gel, for the force balance: equal and opposite to `contact_force` at equilibrium."""
        internal, _, _ = self.solids.internal_force()
        force = internal[np.unique(self.gel.groups["bonded"])].sum(0) * self.copies
        return self._across_planes(force)

    def _across_planes(self, force: Array) -> Array:
        """Newton [N] of the whole body: of a part between mirror planes, components across them cancel."""
        for axis, column in (("x", 0), ("y", 1)):
            if axis in self.gel.symmetry:
                force[column] = 0.0
        return force * MILLINEWTON


def isochoric_constants(material: ElasticMaterial, ogden: bool = False) -> Array:
    """The constants [kPa] that `Solids` takes: (c₁, c₂, c₃), or of an Ogden law (μ₁, α₁, …), padded with terms of μ = 0.

    `ogden`: in Ogden's form whatever the law, for a neo-Hookean solid beside one of Ogden's; α = 2 is the same law.
    """
    if material.law == "ogden" or ogden:
        assert material.law != "yeoh", "a cubic has no Ogden form"
        alpha, weight = np.reshape(material.constants, (-1, 2)).T if material.law == "ogden" else ([2.0], [1.0])
        constants = np.tile([0.0, 2.0], OGDEN_TERMS)
        constants[: 2 * len(alpha)] = np.column_stack([material.mu * KPA_PER_PA * np.asarray(weight), alpha]).ravel()
        return constants
    return material.mu / 2 * KPA_PER_PA * np.array([1.0, *(material.constants or (0.0, 0.0))])
