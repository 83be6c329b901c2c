"""Which part of a press is solved: a profile where the scene reduces to one, else what its mirror planes leave, else the whole.

"auto" takes the smallest model whose own error, estimated beforehand, is below `ALLOWED` of the scene's fidelity:

- **axisymmetric**: a body of revolution pressed along its axis. The gel is no disc but a rectangle; a disc of the same area stands for it.
  With b the distance from the undeformed overlap to the nearest border and T the gel's thickness, the force on inscribed and circumscribed
  discs of a square differs from that by less than 4 exp(-2 b/T) (rigid balls and soft hemispheres of R = 5 to 50 mm, flat gels of 2.4 and
  5 mm, presses of 0.5 and 1 mm: docs/mechanics.md); the square lies between the two.
- **plane strain**: a straight profile as long as the gel. Its ends are free, and the gel's: the pressure falls off there over a length that
  does not grow with the bodies', so the error is as measured on 25 mm against solids, times 25 mm over the length.

Left out: twist and tangential travel in the plane, bodies of several materials, viscosity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gelsim.errors import SceneError
from gelsim.mesh.profiles import overlap
from gelsim.scene.definition import Scene
from gelsim.scene.motion import widest
from gelsim.scene.shape_table import SHAPES
from gelsim.shape.orientation import is_reoriented
from gelsim.shape.shapes import press_symmetry
from gelsim.units import MM

ALLOWED = {"fast": 0.02, "balanced": 0.007, "reference": 0.003}
"""Relative force error that a reduction may add."""
PLANE_STRAIN_AT_25_MM = {"soft": 0.30, "rigid": 0.25}
"""Relative force error of plane strain on a gel of 25 mm against solids, rounded up (docs/mechanics.md)."""


@dataclass(frozen=True)
class Reduction:
    """What is solved, and why."""

    kind: str
    """"axisymmetric", "plane-strain", "mirror" or "none"."""
    planes: frozenset[str]
    """Mirror planes of the solids; none of a profile."""
    error: float
    """Relative force error that it is estimated to add."""
    reason: str

    @property
    def planar(self) -> bool:
        return self.kind in ("axisymmetric", "plane-strain")


def choose_reduction(scene: Scene) -> Reduction:
    """The reduction that press.symmetry names, or for "auto" the smallest one that its error estimate allows.

    Raises:
        SceneError: The scene does not reduce to what press.symmetry names.
    """
    wanted, allowed = scene.press.symmetry, ALLOWED[scene.fidelity]
    refused = []
    for kind in ("axisymmetric", "plane-strain"):
        if wanted not in ("auto", kind):
            continue
        against = _against(scene, kind)
        if against and wanted == kind:
            raise SceneError(f"press.symmetry = {wanted!r}: {against}; allowed here are auto, mirror and none")
        if against:
            continue
        error = _axisymmetric_error(scene) if kind == "axisymmetric" else _plane_strain_error(scene)
        if wanted == kind:
            return Reduction(kind, frozenset(), error, "as press.symmetry says")
        if error <= allowed:
            return Reduction(kind, frozenset(), error, f"its estimated error in force, {error:.2g}, is below {allowed:g}")
        refused.append(f"{kind} would be off by up to {error:.2g} in force, {allowed:g} is allowed")
    return solids(scene, "; ".join(refused) or ("as press.symmetry says" if wanted != "auto" else "the scene does not reduce to a profile"))


def solids(scene: Scene, reason: str) -> Reduction:
    """What the mirror planes leave of both solids."""
    planes = press_symmetry(scene)
    return Reduction("mirror" if planes else "none", planes, 0.0, reason)


def _against(scene: Scene, kind: str) -> str:
    """Why the scene does not reduce to that, or ""."""
    press, body, gel = scene.press, scene.object, scene.gel
    way = widest(scene)
    if way.turns[:2].any():
        return "the object is tilted"
    if way.sideways.any():
        return f"it goes sideways, press.shear_mm = [{way.sideways[0]:g}, {way.sideways[1]:g}] at most"
    if is_reoriented(body):
        return "object.press_side and object.rotation_deg turn the object"
    if way.turns[2]:
        return f"press.twist_deg = {press.twist_deg:g} twists the object" if press.twist_deg else "press.path twists the object"
    if not body.rigid and (body.skin.thickness_mm or body.grains.count):
        return "the object has parts of several materials"
    if gel.prony_g or (body.prony_g and not body.rigid):
        return "a material relaxes (prony_g)"
    made = "turned" if kind == "axisymmetric" else "drawn"
    shapes = [name for name, row in SHAPES.items() if row.made == made and row.convex]  # as gelsim.mesh.profiles wants it
    if body.shape not in shapes:
        return f"object.shape = {body.shape!r} is none of {', '.join(shapes)}"
    if kind == "axisymmetric":
        if not gel.turned:
            return f"gel.profile = {gel.profile!r} is not turned about its axis"
        if any(press.offset_mm) and gel.profile != "flat":
            return f"press.offset_mm = [{press.offset_mm[0]:g}, {press.offset_mm[1]:g}] mm on a gel that is not flat"
        return ""
    if gel.profile != "flat":
        return f"gel.profile = {gel.profile!r} is not flat"
    if any(press.offset_mm):
        return f"press.offset_mm = [{press.offset_mm[0]:g}, {press.offset_mm[1]:g}] is not zero"
    length_mm = body.length_mm or SHAPES[body.shape].length_mm
    if length_mm < gel.size_mm[1]:
        return f"the object is {length_mm:g} mm long, the gel {gel.size_mm[1]:g} mm"
    return ""


def _axisymmetric_error(scene: Scene) -> float:
    border = min(size / 2 - abs(offset) for size, offset in zip(scene.gel.size_mm, scene.press.offset_mm, strict=True))
    return float(4.0 * np.exp(-2.0 * max(border - overlap(scene) / MM, 0.0) / scene.gel.thickness_mm))


def _plane_strain_error(scene: Scene) -> float:
    return PLANE_STRAIN_AT_25_MM["rigid" if scene.object.rigid else "soft"] * 25.0 / scene.gel.size_mm[1]
