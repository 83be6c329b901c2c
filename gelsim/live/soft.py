"""A soft object as contact with the gel feels it: a layer as thick as the object is where it touches, on springs.

What tractions over the contact move is what they move of a wide layer of the object's material, bonded where the object is held, and beside
it a motion of the contact as a whole, by their force and torque about the apex: six numbers by six. These are the object's own linear
finite elements' (`gelsim.fem.compliance`) under tractions as of a ball pressed SHARES of the gel's thickness deep, less what the layer does
under the same. Pressure acts along the face's normals: what is almost incompressible is held by that as it is squeezed aside. The
layer is as thick as the object over the centre of pressure, thinned like the gel. The motion as a whole stiffens as the object gets lower,
as a neo-Hookean column does: without, low punches of 2 mm have 14 % too little force, with it 4 %. A load on an apex that has gone aside
bends the object further, as it does a rod: without that, shear forces of balls are 5 to 20 % and of a box 30 % too large.

Left out: what else the object's shape does to the surface (rims, walls; those thinner than WALL are refused; sides that bulge,
`gelsim.live.press.OF_LOW_EDGED`), contact elsewhere than about the apex.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import SceneError
from gelsim.fem.compliance import HeldBody
from gelsim.live.layer import Elastic, Layer, SoftBody, without
from gelsim.mesh.body_mesh import mesh_object
from gelsim.scene import materials
from gelsim.scene.definition import Press, Scene
from gelsim.units import KPA_PER_PA

Array = NDArray[np.float64]

SHARES = (0.05, 0.1, 0.2, 0.4, 0.6)
"""Of the gel's thickness: what of the surface is less high above the apex are the contacts whose motion is known; between them it goes by
their mean height. The second is where walls are looked for, the third as deep as the mesh is fine. Presses 100 to 111 of
`gelsim bench --only live`: forces 2.6 % off in the median, at half of all 2.7, at double 3.4, of
0.1 alone 3.3, and a slab of R 20 mm, 4 mm high, 13 %."""
WALLS = 0.1
"""Of a face's area, what is seen of it from below, at least; with less it is a wall, which nothing presses."""
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
    lows: Array
    """Mean heights of contacts above the apex, (K,) [mm]."""
    compliances: Array
    """Their motion beyond the layer's, linear before angular, by forces and torques about the apex, in the object's frame, (K, 6, 6)
    [mm, rad by mN, mN mm]."""
    height: float
    """From the apex to where it is held [mm]."""

    def placed(self, turn: Array, apex: Array, load: float, x: Array, y: Array, low: float, thickness: float, squash: float) -> SoftBody:
        """The object over columns x and rows y of the gel, turned by (3, 3), its apex over (x, y) [mm], under a load [mN].

        Args:
            low, thickness, squash: As of `SoftBody` [mm].
        Raises:
            SceneError: It leans by more than LEAN_DEG, or is pressed flat.
        """
        check_lean("pose", turn[2, 2])
        check_flat("pose", thickness, self.height)
        compliance = self.compliance(turn, *(np.asarray(value, float) for value in (load, low, squash)))
        return SoftBody(self.layer, thickness, low, compliance, apex, x, y, squash)

    def compliance(self, turn: Any, load: Any, low: Any, squash: Any) -> Any:
        """Of the object's motion as a whole, so placed: as of `SoftBody`, (..., 6, 6); for arrays of NumPy or torch alike."""
        apart = (self.lows[1:] - self.lows[:-1]).clip(1e-9, None)  # none under a flat face
        shares = ((low[..., None] - self.lows[:-1]) / apart).clip(0.0, 1.0)
        steps = self.compliances[1:] - self.compliances[:-1]
        left = (1.0 - squash / self.height).clip(0.0, None)
        column = 3.0 * left**2 / (1.0 + left + left**2)  # neo-Hookean: G (1/left² - left) for 3G (1 - left)
        own = (self.compliances[0] + (shares @ steps.reshape(-1, 36)).reshape(*low.shape, 6, 6)) * column[..., None, None]
        # A load sinks by half of ∫ ψ² where the apex goes aside (of shear it does not: Haringx 1948), so along x and y a push grows by
        # `bowed` of how far it goes, and so on: a series, whose sum is by the inverse of a matrix of two rows.
        turns = own[..., [4, 3], [0, 1]] / own[..., [0, 1], [0, 1]]
        bowed = BOW * self.height * load[..., None] * turns**2
        grown = own[..., :2, :2] * bowed[..., None, :]
        mean, apart = (grown[..., 0, 0] + grown[..., 1, 1]) / 2, (grown[..., 0, 0] - grown[..., 1, 1]) / 2
        mixed = grown[..., 0, 1] * grown[..., 1, 0]
        held = (MOST_LOAD / (abs(mean) + (apart**2 + mixed) ** 0.5).clip(1e-9, None)).clip(None, 1.0)  # by the larger eigenvalue
        rest = 1.0 - 2.0 * held * mean
        whole = rest + held**2 * (mean**2 - apart**2 - mixed)
        aside = own[..., :2, :]
        push = bowed[..., :, None] * (rest[..., None, None] * aside + held[..., None, None] * (grown @ aside))
        own = own + (held / whole)[..., None, None] * (own[..., :, :2] @ push)
        blocks = own.reshape(*low.shape, 2, 3, 2, 3).swapaxes(-3, -2)
        turned = turn[..., None, None, :, :] @ blocks @ turn.swapaxes(-1, -2)[..., None, None, :, :]
        return turned.swapaxes(-3, -2).reshape(*low.shape, 6, 6)


def check_lean(where: str, upright: float) -> None:
    """Raises SceneError where a soft object leans by more than LEAN_DEG; `upright`: its axis along z."""
    if upright < math.cos(math.radians(LEAN_DEG)):
        lean = math.degrees(math.acos(np.clip(upright, -1.0, 1.0)))
        raise SceneError(
            f"{where}: the object leans by {lean:.0f}°; a soft one is known about its apex, so allowed are {LEAN_DEG:g}°; "
            "turn it by object.rotation_deg, or set object.rigid = true"
        )


def check_flat(where: str, thickness: float, height: float, least: float = 0.0) -> None:
    """Raises SceneError where no more than `least` of a soft object's height is left as its layer's thickness [mm]."""
    if thickness <= least:
        raise SceneError(f"{where}: the soft object, {height:g} mm high, is pressed flat; press less deep, or make it higher")


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
    press = Press(depth_mm=SHARES[2] * thickness, force_n=None)
    body = HeldBody(mesh_object(scene.replace(press=press, fidelity="fast", target_error=None, target_membrane_um=None)), material)
    x, y, z = body.points.T
    over = [cell * count / 2 for cell, count in zip(gel.cell, gel.shape[::-1], strict=True)]
    pressed = (np.abs(x) < over[0]) & (np.abs(y) < over[1])  # beside the gel nothing touches
    pressed &= -body.areas > WALLS * np.linalg.norm(body.facing, axis=1)
    weights = np.sqrt(np.maximum(np.outer(SHARES, [thickness]) - z, 0.0)) * np.where(pressed, -body.areas, 0.0)
    _check_walls(body, weights[1], thickness)
    ways = modes(x, y)
    gram = np.einsum("sq,qic,qjc->sij", weights, ways, ways)
    tractions = np.einsum("sq,qic,sij->sjqc", weights, ways, np.linalg.inv(gram))  # a unit force or torque each
    forces = tractions.copy()
    # Along the normals; of torques too, a sheared ball would roll: the face is flattened, and heights are up to 100 µm off.
    forces[:, 2, pressed, :2] += tractions[:, 2, pressed, 2:] * (body.facing[pressed, :2] / body.areas[pressed, None])
    works = body.work(forces.reshape(-1, *forces.shape[2:])).reshape(len(SHARES), 6, len(SHARES), 6)
    layer = gel.under(Elastic(material.mu * KPA_PER_PA, material.poissons_ratio), body.height)
    lows = weights @ z / weights.sum(axis=1)
    moved = [works[i, :, i] - _of_layer(layer, gel, body, tractions[i], lows[i]) for i in range(len(SHARES))]
    return Spring(layer, lows, np.array([(one + one.T) / 2 for one in moved]), body.height)


def _of_layer(layer: Layer, gel: Layer, body: HeldBody, forces: Array, low: float) -> Array:
    """What forces (6, Q, 3) on a body's points do on the motion by each, were it a layer over the gel's cells, (6, 6) [mN mm]."""
    x, y, _ = body.points.T
    reach = np.abs(body.points[(forces != 0).any(axis=(0, 2)), :2]).max(axis=0)
    shape = 2 * math.ceil(reach[1] / gel.cell[1]), 2 * math.ceil(reach[0] / gel.cell[0])
    ends = [cell * (np.arange(count + 1) - count / 2) for count, cell in zip(shape, gel.cell[::-1], strict=True)]
    binned = np.array([[np.histogram2d(y, x, ends, weights=way)[0] for way in force.T] for force in forces], np.float32)
    still = SoftBody(layer, body.height - low, low, np.zeros((6, 6)), np.zeros(2), ends[1][1:], ends[0][1:])
    alone = without(layer.window(shape, 1.0), still)
    # Forces act on the object, tractions on what faces it.
    apart = np.array([alone.moved(-one[2], one[:2]) for one in binned / np.float32(gel.cell[0] * gel.cell[1])])
    return np.einsum("icyx,jcyx->ij", binned, apart)


def _check_walls(body: HeldBody, weights: Array, thickness: float) -> None:
    """Raises SceneError where over the contact an object is thinner than WALL of the gel's thickness [mm]."""
    x, y, z = body.points.T
    reach = np.abs(body.points[weights > 0, :2]).max(axis=0)
    inside = (np.abs(x) <= reach[0]) & (np.abs(y) <= reach[1]) & (body.areas > 0) & (z < (SHARES[1] + WALL) * thickness)
    if body.areas @ inside > FEW * -body.areas @ (weights > 0):
        raise SceneError(
            f"object: over the contact it is thinner than {WALL * thickness:.2g} mm, {WALL:g} of gel.thickness_mm: a live sensor has no "
            "thin soft walls; make it thicker, set object.rigid = true, or use finite elements (gelsim.press)"
        )
