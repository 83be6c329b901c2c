"""The ways in which a press is tried, and what goes from one to the next: one table (`WAYS`), one driver (`tries`).

Left out: solving itself (`gelsim.fem.solve_press`), and how a march ends (`quasistatic`).
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace

from gelsim.errors import SolveStatus
from gelsim.fem.problem import MOST_WASTED
from gelsim.fem.quasistatic import PACE, SOON, Course
from gelsim.results import Deformation
from gelsim.scene.definition import Scene
from gelsim.scene.materials import gel_material
from gelsim.shape.rims import rims_on_gel
from gelsim.units import KPA_PER_PA

EDGE_POINTS = 12
"""Quadrature points on a face where sharp edges of a rigid object touch the gel, on meshes that resolve them: at `balanced` a star and a
prism overlap by 62 and 25 µm with six, in 185 and 56 iterations, with twelve by 19 and 19 in 50 and 44, for the same force; with 24 edges
are as straight, and a sticking sharp punch takes 82 iterations for 45."""
RIGID_POINTS, SOFT_POINTS, SHARP_POINTS = 24, 48, 96
"""The same at `fast`. Nineteen rigid random scenes overlap by 25, 16, 14, 12 µm in the median with 6, 12, 24, 48, in 756, 898, 696, 901
iterations; four loops of a ball's friction are 7.8, 11.6, 5.9, 3.8 % RMS off those of `balanced`. Soft objects' faces may be shorter than
the gel's, so that a middle of their sides pokes through between its points: of a hundred random scenes (`docs/studies/random_scenes.py
--seeds 4001 --scenes 100`) 74, 88, 96 % overlap by at most 20 µm with 12, 24, 48, in as many iterations. Where edges of soft objects touch
(SHARP_POINTS) more pokes through: of 26 scenes above 20 µm with 48, 18 are below with 96; 45 others take 18 % more processor time."""
CLOSE = 20e-6
"""Overlap [m] anywhere on faces, above which a press that came to its end without trouble is solved once more, with twice the points: of 22
such of a thousand random scenes (seeds 9001 to 9003) 16 are below it then. All with twice the points would take half as long again, and
rigid corners overlap by more (31 → 308 µm)."""


@dataclass(frozen=True)
class Try:
    """One way to solve a press."""

    contact_points: int = 6
    """Quadrature points on a face."""
    held: float = 0.0
    """Shear moduli of κ by which volume is held at points (`assembly.Solids.hold_volume`); above 0 steps are taken with more care too."""
    most_wasted: int = MOST_WASTED
    """Newton iterations of solves that failed, after which a march of it ends."""
    goes_on: bool = False
    """Begins where the try before it ended, not at rest."""
    coat_mm: float = 0.0
    """Thickness of a coat of the gel's own silicone, which a bare gel is given so that it does not crease (`coat.py`)."""

    def of(self, scene: Scene) -> Scene:
        """The scene as it is solved."""
        if not self.coat_mm:
            return scene
        return scene.replace(gel=replace(scene.gel, coat_n_per_m=self.coat_mm * KPA_PER_PA * gel_material(scene).youngs_modulus))


PLAIN, HELD, COATED = Try(), Try(EDGE_POINTS, held=20.0), Try(EDGE_POINTS, coat_mm=0.1)
GOES_ON = replace(HELD, goes_on=True, most_wasted=SOON)
WAYS = {
    "soft": (replace(PLAIN, most_wasted=SOON), GOES_ON, HELD),
    "rigid": (replace(PLAIN, most_wasted=PACE), GOES_ON, COATED),
}
"""The tries that a press of a soft object, or of a rigid one, may have, one after the other until one reaches its end: a soft body folds,
under a rigid one the gel's face creases. Of 91 rigid random scenes (seeds 9001 to 9003) the one whose first try wasted more than PACE and
ended overlaps by 133 µm; none needs the coat."""


def contact_points(scene: Scene) -> int:
    """Quadrature points on a face of the gel with which a press is tried first."""
    rigid = scene.object.rigid
    if scene.fidelity != "fast":
        return EDGE_POINTS if rigid and _edges_touch(scene) else PLAIN.contact_points
    return RIGID_POINTS if rigid else SHARP_POINTS if _edges_touch(scene) else SOFT_POINTS


def _edges_touch(scene: Scene) -> bool:
    return len(rims_on_gel(scene)) > 0


def ways(scene: Scene) -> list[Try]:
    """The tries of a scene. One whose gel has a coat is given no other."""
    points = contact_points(scene)
    those, bare = WAYS["rigid" if scene.object.rigid else "soft"], scene.gel.coat_n_per_m == 0.0
    return [replace(way, contact_points=max(way.contact_points, points)) for way in those if bare or not way.coat_mm]


def tries(scene: Scene, enough: Callable[[Deformation], bool] | None = None) -> Generator[tuple[Try, Course], Deformation, Deformation]:
    """Yields what to try and where it begins, is sent what became of it, and returns the press that got furthest.

    Where the approach of a force was found in several tries, all begin again to record the way there. Where a press overlaps by more than
    CLOSE, there is another, and the closer is returned.
    """
    all_ways = ways(scene)
    course, best, number, left, turns = Course(), None, 0, all_ways, []
    while left:
        way, *left = left
        if not way.goes_on:
            if best is not None and enough is not None and enough(best):
                break
            course.before, turns = None, []
        elif course.before is None:
            continue
        turns.append((way, 0.0 if course.before is None else 1e3 * course.before.approach))
        number, course.followed = number + 1, bool(left) and left[0].goes_on
        press = yield way, course
        press = _reported(press, turns, number)
        if course.searched:
            course.searched, left, best = False, all_ways, None
            continue
        best = further(best, press)
        if not press.lost:
            break
    assert best is not None
    end, overlap = best.report.ended_by, best.penetration.max()
    easy = number == 1 and best.report.steps_halved == 0
    if easy and overlap > CLOSE and end is not None and end.wanted:
        way = replace(all_ways[0], contact_points=2 * all_ways[0].contact_points)
        press = _reported((yield way, Course(found=(best.approach[-1], end, ""))), [(way, 0.0)], 2)
        if not press.lost and press.report.ended_by is end and press.penetration.max() < overlap:
            best = press
    return best


def _reported(press: Deformation, turns: Sequence[tuple[Try, float]], number: int) -> Deformation:
    """The press whose report says which try it is, and which led there: each with the approach [mm] that it went on from."""
    way = turns[-1][0]
    press = press.reporting(
        tried=number,
        contact_points=way.contact_points,
        went_on_from_mm=tuple(round(start, 4) for _, start in turns[1:]),
    )
    # those after a try with held volume have it too
    since = next((f" from {start:.4g} mm on" if start else "" for turn, start in turns if turn.held > 0.0), "")
    if way.held > 0.0:
        told = f"with {way.contact_points} contact points a face, and volume held at points{since}, which makes tets stiffer"
        press = press.warned(f"did not reach its end at first: solved {told}")
    if way.coat_mm > 0.0:
        press = press.warned(
            f"did not reach its end bare, as the gel's face creases at a rim: solved with a coat of {press.report.coat_n_per_m:.2g} N/m, "
            f"{way.coat_mm:g} mm of its own silicone, which bears some per cent more (gel.coat_n_per_m)"
        )
    return press


def further(before: Deformation | None, press: Deformation) -> Deformation:
    """Of two tries of one press the one to return."""
    if before is None:
        return press
    return max(before, press, key=lambda one: (not one.lost, one.status is SolveStatus.CONVERGED, one.time[-1], one.approach[-1]))
