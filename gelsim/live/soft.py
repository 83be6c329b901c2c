"""A soft object as contact with the gel feels it: a layer as thick as the object is high, on springs.

What tractions over the contact move is what they move of a wide layer of the object's material, bonded where the object is held, and beside
it a motion of the contact as a whole, by their force and torque about the apex: six numbers by six. These are the object's own linear
finite elements' (`gelsim.fem.compliance`) under tractions as those of a ball pressed SHARE of the gel's thickness deep, less what the layer
does under the same. A load on an apex that has gone aside bends the object further, as it does a rod: without that, shear forces of
balls are 5 to 20 % and of a box 30 % too large.

Left out: what else the object's shape does to the surface (rims, walls; those thinner than WALL are refused), large strains, contact
elsewhere than about the apex.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import SceneError
from gelsim.fem.compliance import HeldBody
from gelsim.live.layer import Elastic, Layer, SoftBody, nearest_node, without
from gelsim.mesh.body_mesh import mesh_object
from gelsim.scene import materials
from gelsim.scene.definition import Press, Scene
from gelsim.units import KPA_PER_PA

Array = NDArray[np.float64]

SHARE = 0.1
"""Of the gel's thickness: what of the surface is less high above the apex is the contact whose motion counts."""
WALL, FEW = 0.5, 0.1
"""Of the gel's thickness: walls thinner than that; and what share of the contact's area may look up within it."""
LEAN_DEG = 20.0
"""Of the object, at most. Springs of where a leaning one touches first are better on balls (shear force 4 % off, not 9), and worse on a
cylinder whose rim touches first (heights 26 µm off, not 16)."""
BOW = 8 / 15
"""Of a rod that is held at one end and turned by θ at the other, by a force there: ∫ ψ² = BOW height θ², ψ the turn of its sections."""
MOST_LOAD = 0.95
"""Of the load under which it would go aside by itself: under more the gel holds it, and it bends as under that."""


@dataclass(frozen=True)
class Spring:
    """Of a soft object."""

    layer: Layer
    """Of its material, over the gel's cells."""
    node: int
    """Of its thickness (`SoftBody`)."""
    compliance: Array
    """Motion of the contact beyond the layer's, linear before angular, by forces and torques about the apex, in the object's frame, (6, 6)
    [mm, rad by mN, mN mm]."""
    height: float
    """From the apex to where it is held [mm]."""

    def placed(self, turn: Array, apex: Array, load: float, x: Array, y: Array) -> SoftBody:
        """The object over columns x and rows y of the gel, turned by (3, 3), its apex over (x, y) [mm], under a load [mN].

        Raises:
            SceneError: It leans by more than LEAN_DEG.
        """
        if turn[2, 2] < math.cos(math.radians(LEAN_DEG)):
            lean = math.degrees(math.acos(np.clip(turn[2, 2], -1.0, 1.0)))
            raise SceneError(
                f"pose: the object leans by {lean:.0f}°; a soft one is known about its apex, so allowed are {LEAN_DEG:g}°; "
                "turn it by object.rotation_deg, or set object.rigid = true"
            )
        # A load sinks by half of ∫ ψ² where the apex goes aside (of shear it does not: Haringx 1948).
        turns = np.array([self.compliance[4, 0] / self.compliance[0, 0], self.compliance[3, 1] / self.compliance[1, 1], 0, 0, 0, 0])
        bowed = self.compliance * (BOW * load * self.height * turns**2)
        bowed *= min(1.0, MOST_LOAD / max(np.abs(np.linalg.eigvals(bowed)).max(), 1e-9))
        both = np.kron(np.eye(2), turn)
        compliance = both @ np.linalg.solve(np.eye(6) - bowed, self.compliance) @ both.T
        return SoftBody(self.layer, self.node, compliance, apex, x, y)


def modes(x: Array, y: Array) -> Array:
    """How places beside the apex move by each of three shifts and three turns, (*shape, 6, 3)."""
    one, none = np.ones_like(x), np.zeros_like(x)
    ways = (one, none, none), (none, one, none), (none, none, one), (none, none, y), (none, none, -x), (-y, x, none)
    return np.stack([np.stack(way, axis=-1) for way in ways], axis=-2)


def spring(scene: Scene, gel: Layer) -> Spring:
    """Of a scene's soft object: half a second, and of a new shape some more for its mesh.

    Args:
        gel: On whose cells it is.
    Raises:
        SceneError, MeshingError: Its shape makes no solid, or over the contact it is thinner than WALL.
    """
    material, thickness = materials.object_material(scene), scene.gel.thickness_mm
    assert material is not None
    press = Press(depth_mm=2 * SHARE * thickness, force_n=None)
    body = HeldBody(mesh_object(scene.replace(press=press, fidelity="fast", target_error=None, target_membrane_um=None)), material)
    x, y, z = body.points.T
    weights = np.sqrt(np.maximum(SHARE * thickness - z, 0.0)) * np.maximum(-body.areas, 0.0)
    over = [cell * count / 2 for cell, count in zip(gel.cell, gel.shape[::-1], strict=True)]
    weights *= (np.abs(x) < over[0]) & (np.abs(y) < over[1])  # beside the gel nothing touches
    reach = np.abs(body.points[weights > 0, :2]).max(axis=0)
    inside = (np.abs(x) <= reach[0]) & (np.abs(y) <= reach[1]) & (body.areas > 0) & (z < (SHARE + WALL) * thickness)
    if body.areas @ inside > FEW * -body.areas @ (weights > 0):
        raise SceneError(
            f"object: over the contact it is thinner than {WALL * thickness:.2g} mm, {WALL:g} of gel.thickness_mm: a live sensor has no "
            "thin soft walls; make it thicker, set object.rigid = true, or use finite elements (gelsim.press)"
        )
    ways = modes(x, y)
    gram = np.einsum("q,qic,qjc->ij", weights, ways, ways)
    forces = np.einsum("q,qic,ij->jqc", weights, ways, np.linalg.inv(gram))  # a unit force or torque each
    node = nearest_node(body.height)
    layer = gel.under(Elastic(material.mu * KPA_PER_PA, material.poissons_ratio), body.height)
    shape = 2 * math.ceil(reach[1] / gel.cell[1]), 2 * math.ceil(reach[0] / gel.cell[0])
    ends = [cell * (np.arange(count + 1) - count / 2) for count, cell in zip(shape, gel.cell[::-1], strict=True)]
    binned = np.array([[np.histogram2d(y, x, ends, weights=way)[0] for way in force.T] for force in forces], np.float32)
    alone = without(layer.window(shape, 1.0), SoftBody(layer, node, np.zeros((6, 6)), np.zeros(2), ends[1][1:], ends[0][1:]))
    # Forces act on the object, tractions on what faces it.
    apart = np.array([alone.moved(-one[2], one[:2]) for one in binned / np.float32(gel.cell[0] * gel.cell[1])])
    found = body.work(forces) - np.einsum("icyx,jcyx->ij", binned, apart)
    return Spring(layer, node, (found + found.T) / 2, body.height)
