"""The ways in which a press is tried, and what goes from one to the next: one table (`ways`), one driver (`tries`).

Left out: solving itself (`gelsim.fem.solve_press`), and how a march ends (`quasistatic`).
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gelsim.errors import SolveStatus
from gelsim.fem.quasistatic import Course
from gelsim.results import Deformation
from gelsim.scene.definition import Body, Scene
from gelsim.shape.outlines import fine_feature
from gelsim.shape.shapes import sharp_edges


@dataclass(frozen=True)
class Try:
    """One way to solve a press."""

    contact_points: int = 6
    """Quadrature points on a face."""
    on_object: bool = False
    """The points are those of the object's faces and look for the gel's, not the other way round."""
    held: float = 0.0
    """Shear moduli of κ by which volume is held at points (`assembly.Solids.hold_volume`); above 0 steps are taken with more care too."""
    most_wasted: int | None = None
    """Newton iterations of solves that failed, after which a march of it ends; None: `problem.MOST_WASTED`."""
    friction: tuple[float, float] | None = None
    """The smallest μ, and the one that stands for sticking; None leaves the scene's."""
    goes_on: bool = False
    """Begins where the try before it ended, not at rest."""


STICK = 10.0
"""μ that stands for sticking where that failed: without any bound a point that lifts off drops its whole traction at once, and where a
step's solution lies on that jump Newton finds none."""

GRIP = 0.3
"""μ from which on friction holds a soft tip: with less it slides away in its own folds, and Newton with it. Least μ of the last try."""

SOON = 30
"""Failed iterations after which another try goes on from where one stands: some two solves."""

PLAIN, HELD, GRIPPED = Try(), Try(12, held=20.0, friction=(0.0, STICK)), Try(12, held=20.0, friction=(GRIP, STICK))

NUDGE = 0.003
"""μ that holds a smooth tip in its place which nothing else holds; of the normal force it changes a thousandth or so."""

SLIDING = Try(12, on_object=True)
"""The first try of a smooth soft object that nothing holds sideways, and of a ring or a block with waves that friction holds: few of the
gel's points on each of its smaller faces warp these, and their tangent sees its tip slide away (docs/mechanics.md, *The mode that slides*,
*Presses that stumble*)."""

NUDGED = replace(SLIDING, friction=(NUDGE, STICK), goes_on=True)


def tries(
    scene: Scene, symmetry: frozenset[str], enough: Callable[[Deformation], bool] | None = None
) -> Generator[tuple[Try, Course], Deformation, Deformation]:
    """Yields what to try and where it begins, is sent what became of it, and returns the press that got furthest.

    Where the approach of a force was found in several tries, all begin again to record the way there.
    """
    course, best, number, left, turns = Course(), None, 0, ways(scene, symmetry), []
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
        _note(press, scene, turns, number)
        if course.searched:
            course.searched, left, best = False, ways(scene, symmetry), None
            continue
        best = further(best, press)
        if not press.lost:
            break
    assert best is not None
    return best


def ways(scene: Scene, symmetry: frozenset[str] = frozenset()) -> list[Try]:
    """The tries that a scene may have, one after the other until one reaches its end; `symmetry`: the planes that its meshes are cut at."""
    friction = scene.contact.friction_coefficient
    if isinstance(friction, str) or (scene.object.rigid and friction >= GRIP):
        return [PLAIN, replace(HELD, goes_on=True, most_wasted=SOON), HELD]
    if friction < GRIP:
        first = [PLAIN]
        if _slides(scene.object, symmetry):
            nudged = [replace(SLIDING, most_wasted=SOON), NUDGED] if friction < NUDGE else [SLIDING]
            first = [*nudged, replace(PLAIN, goes_on=True)]
        return [*first, replace(HELD, goes_on=True, most_wasted=SOON), HELD, GRIPPED]
    first = [SLIDING, PLAIN] if _uneven(scene.object) else [PLAIN, replace(PLAIN, on_object=True)]
    gels, objects = HELD, replace(HELD, on_object=True)
    on = [replace(way, goes_on=number > 0, most_wasted=SOON) for number, way in enumerate([*first, gels, objects])]
    return [*on, gels, *(replace(way, goes_on=True, most_wasted=SOON) for way in (objects, gels)), objects]


def _slides(body: Body, symmetry: frozenset[str]) -> bool:
    """Whether a smooth soft object's tip finds its place on the gel by itself where there is hardly any friction to hold it."""
    return not body.rigid and not symmetry >= {"x", "y"} and not len(sharp_edges(body))


def _uneven(body: Body) -> bool:
    """Whether an object has waves of its own, or is a ring: its small faces bend more than the gel's."""
    return fine_feature(body) < np.inf


def tried(scene: Scene, way: Try) -> Scene:
    """The scene as it is solved."""
    if way.friction is None:
        return scene
    asked, (least, stick) = scene.contact.friction_coefficient, way.friction
    friction = max(asked, least) if isinstance(asked, float | int) else stick
    return scene if friction == asked else scene.replace(contact=replace(scene.contact, friction_coefficient=friction))


def _note(press: Deformation, scene: Scene, turns: Sequence[tuple[Try, float]], number: int) -> None:
    """Tells in a press's info which try it is, and which led there: each with the approach [mm] that it went on from."""
    way = turns[-1][0]
    press.info["tried"] = number
    press.info["contact_points"], press.info["contact_points_on"] = way.contact_points, "object" if way.on_object else "gel"
    if len(turns) > 1:
        press.info["went_on_from_mm"] = [round(start, 4) for _, start in turns[1:]]
    # those after a try with held volume have it too
    since = next((f" from {start:.4g} mm on" if start else "" for turn, start in turns if turn.held > 0.0), "")
    if way.held > 0.0:
        told = f"with twice the contact points, and volume held at points{since}, which makes tets stiffer"
        press.warn(f"did not reach its end at first: solved {told}")
    asked = scene.contact.friction_coefficient
    solved = [tried(scene, turn).contact.friction_coefficient for turn, _ in turns]
    press.info["friction_coefficient"] = solved[-1]
    if other := [number for number, friction in enumerate(solved) if friction != asked]:
        start, after = turns[other[0]][1], other[-1] + 1
        where = f" from {start:.4g} mm on" if start else ""
        if after < len(turns):
            where = f" from {start:.4g} to {turns[after][1]:.4g} mm"
        instead = " and ".join(dict.fromkeys(f"{solved[number]:g}" for number in other))
        press.warn(f"with a friction coefficient of {asked} no equilibrium was found on its way: solved with {instead} instead{where}")


def further(before: Deformation | None, press: Deformation) -> Deformation:
    """Of two tries of one press the one to return."""
    if before is None:
        return press
    return max(before, press, key=lambda one: (not one.lost, one.status is SolveStatus.CONVERGED, one.time[-1], one.approach[-1]))
