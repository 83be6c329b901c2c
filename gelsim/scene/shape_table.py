"""The shapes that an object may have, one row each: all that is asked of a shape but for its geometry.

What a scene may say of a shape, how its meshes, its reduction and its warnings go, what a row of a dataset and a sheet say of it: each asks
here, by `SHAPES[body.shape]`, and none of them names a shape. Lines, arcs and waves are in `gelsim.shape.outlines`, under the same names.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True)
class Shape:
    """A row. What it leaves out is as of a plain block."""

    made: Literal["turned", "drawn", "planes", "relief", "file"]
    """turned: a profile about z. drawn: a profile along y. planes: a convex body between them. relief: a block with an uneven underside.
    file: the facets of a mesh file."""
    convex: bool = True
    """So that a press may reduce to the profile, and the coarse surface be a hull. Of reliefs and files nobody asks."""
    hollow: bool = False
    """Its surface may come to touch itself, of which a press then warns; that of others is convex, or opens wide. A file's may."""
    mirror: str = "xy"
    """Its mirror planes: "x" is the plane x = 0."""
    ridge: bool = False
    """What touches first is straight along y."""

    sizes: tuple[str, ...] = ()
    """The fields of [object] that it reads beside height_mm. Rows of datasets, the sheet and `gelsim live` tell its size by radius_mm,
    where that is one: best that of what touches."""
    has_parts: bool = False
    """It may have a skin and grains."""
    width_mm: float = 25.0
    """Along x, where the scene says nothing and the radius does not say it."""
    length_mm: float = 25.0
    """Along y, likewise."""
    angle_deg: float | None = None
    """Where the scene says nothing; None: it has none."""
    angles_deg: tuple[float, float] = (0.0, 180.0)
    """Allowed, where that is less than of any shape."""
    wall: float = 0.0
    """Thickness of its wall over radius_mm, where the scene says nothing; 0: it has none."""
    most_wall: float = 0.0
    """The largest that is allowed, likewise."""
    least_height: tuple[float, float] = (0.0, 0.0)
    """Over radius_mm and over the wall, to be added: at less there is no foot."""
    edge_radius_mm: float = 0.1
    """Of a rigid one's rims and edges, where the scene says nothing: undefined edges are broken by 0.1 to 0.3 mm (ISO 13715)."""
    soft_edge: bool = False
    """A soft one may be given a radius of its edges, too."""
    least_soft_radius_mm: float = 0.0
    """The smallest of which `fast` fills and presses a soft one; at less it may only be rigid."""
    skin: Mapping[str, float] = field(default_factory=dict)
    """Fields of the skin of a soft one, where the scene says nothing."""
    grains: Mapping[str, float] = field(default_factory=dict)
    """Of its grains, likewise."""

    tip_mm: float | None = 50.0
    """Radius of curvature of its lowest point, roughly; None: radius_mm is it. Presses of a dataset are spaced by it."""
    recorded_as: tuple[str, ...] = ()
    """First letters of the names of real recordings of it."""

    @property
    def has_radius(self) -> bool:
        return "radius_mm" in self.sizes

    @property
    def turned(self) -> bool:
        return self.made == "turned"

    @property
    def drawn(self) -> bool:
        return self.made == "drawn"

    @property
    def relief(self) -> bool:
        return self.made == "relief"

    @property
    def bumpy(self) -> bool:
        """Curved both ways within a wave's length: coarser faces do not follow that."""
        return self.relief and not self.ridge


BLOCK = ("width_mm", "length_mm")
WAVY = (*BLOCK, "amplitude_mm", "wavelength_mm")

SHAPES: dict[str, Shape] = {
    "flat": Shape("drawn", sizes=BLOCK, has_parts=True, recorded_as=("flat", "plane")),
    "hemisphere": Shape(
        "turned", sizes=("radius_mm",), has_parts=True, least_soft_radius_mm=2.5, tip_mm=None, recorded_as=("hemi", "sphere", "ball")
    ),
    "cylinder": Shape(
        "drawn", sizes=("radius_mm", "length_mm"), ridge=True, has_parts=True, least_soft_radius_mm=2.5, tip_mm=None, recorded_as=("cyl",)
    ),
    "edge": Shape("drawn", sizes=(*BLOCK, "angle_deg"), ridge=True, has_parts=True, angle_deg=90.0, tip_mm=1.0, recorded_as=("edge",)),
    "corner": Shape("planes", sizes=("width_mm",), mirror="x", soft_edge=True, tip_mm=0.7, recorded_as=("corner",)),
    "cone": Shape("turned", sizes=("radius_mm", "angle_deg"), has_parts=True, angle_deg=90.0, tip_mm=1.0),
    "box": Shape("drawn", sizes=BLOCK, has_parts=True, width_mm=10.0, length_mm=15.0),
    "frustum": Shape("turned", sizes=("radius_mm", "angle_deg"), has_parts=True, angle_deg=75.0, angles_deg=(45.0, 90.0)),
    "punch": Shape("turned", sizes=("radius_mm",), has_parts=True, edge_radius_mm=0.0),
    "tube": Shape(
        "drawn", sizes=("radius_mm", "length_mm", "wall_mm"), convex=False, hollow=True, ridge=True, wall=0.2, most_wall=0.9,
        least_height=(1.8, 0.0), tip_mm=None,
    ),
    "shell": Shape(
        "turned", sizes=("radius_mm", "wall_mm"), convex=False, hollow=True, wall=0.2, most_wall=0.9, least_height=(1.0, 0.0), tip_mm=None
    ),
    "torus": Shape("turned", sizes=("radius_mm", "wall_mm"), convex=False, wall=0.5, most_wall=2.0, least_height=(0.0, 0.5)),
    "tomato": Shape(
        "turned", sizes=("radius_mm",), convex=False, has_parts=True, least_height=(1.8, 0.0), skin={"thickness_mm": 0.5, "shore_a": 20.0},
        tip_mm=None,
    ),
    "candy": Shape("drawn", sizes=BLOCK, has_parts=True, width_mm=10.0, length_mm=10.0, grains={"count": 20, "shore_a": 45.0}),
    "wave": Shape("relief", sizes=WAVY, ridge=True, width_mm=10.0, length_mm=10.0, tip_mm=4.0),
    "emboss": Shape("relief", sizes=WAVY, width_mm=10.0, length_mm=10.0, tip_mm=4.0),
    "rough": Shape("relief", sizes=(*WAVY, "pattern_seed"), mirror="", width_mm=10.0, length_mm=10.0, tip_mm=4.0),
    "mesh": Shape("file", sizes=("mesh", "mesh_unit", "mesh_scale", "mesh_repair"), hollow=True, mirror=""),
}  # fmt: skip
