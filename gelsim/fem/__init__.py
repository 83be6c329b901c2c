"""Contact finite elements: gel and object, solved together. `solve_press` is the door; everything else is behind it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from gelsim.geometry import QuadraticSurface, TetMesh
from gelsim.materials import ElasticMaterial
from gelsim.results import Deformation
from gelsim.scene import Scene


def solve_press(
    scene: Scene,
    gel: TetMesh,
    body: TetMesh | QuadraticSurface,
    placement: tuple,
    *,
    gel_material: ElasticMaterial,
    object_material: ElasticMaterial | None,
    part_materials: Sequence[ElasticMaterial] = (),
    device: str = "auto",
    progress: Callable[[int, int], None] | None = None,
    throw: bool = True,
) -> Deformation:
    """Solves a press.

    Args:
        gel: The gel's mesh; its `symmetry` must be the body's.
        body: The object's mesh, or only its surface where it is rigid; in the object's frame.
        placement: Rotation (3, 3) and translation (3,) [m] that bring it to first touch.
        object_material: None for a rigid object.
        part_materials: Of the object's regions 1, 2, … (skin, grains).
        device: "auto" and "cpu" run here; "cuda" assembles on the GPU.
        progress: Called with (states recorded, states wanted).
    Raises:
        SolveError: (with `throw`) Newton failed at the smallest step; carries what was solved.
    """
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    from gelsim.fem.problem import PressProblem
    from gelsim.fem.quasistatic import run_press

    name = "cuda:0" if device == "cuda" else "cpu"
    problem = PressProblem(scene, gel, body, placement, gel_material, object_material, name, part_materials=part_materials)
    return run_press(problem, progress=progress, throw=throw)
