"""The numbers of a scene's [expect] table: how they are measured, how far they scatter from mesh to mesh, and the margin that follows.

fTetWild draws a soft object's mesh by lot, so a press that is solved anew is another sample. From n draws of mean m and standard deviation
s the next one, x, differs by (x - m) / (s √(1 + 1/n)), which is Student's t of n - 1 degrees of freedom. The margin is where that is less
likely than `FALSE_ALARM`, plus what two solvers that both stop in time may differ by (`SOLVED_TO`), all there is where no mesh is drawn.
The press's own error estimate (force: 0.6 to 5 %) is no part of it: that error is the same in every draw, and a net as wide would let a
changed solver through. One that is right and different is a reason to regenerate.

    python -m pytest tests/golden --regenerate -m slow -k shipped_scene        all five tables, DRAWS meshes each
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import stats

from gelsim.membrane.surface import membrane_states, rest_membrane
from gelsim.optics import choose_variant, render_frames
from gelsim.pipeline import stages
from gelsim.results import Deformation
from gelsim.scene.definition import Render, Scene
from gelsim.scene.expectation import Expectation, Expected

DRAWS = 8
"""Of an object's mesh. Fewer make wide margins, for t has long tails then: n = 4: 47 s, 8: 10 s, 16: 6 s."""
FALSE_ALARM = 3e-5
"""Of one number: once in a thousand runs of the thirty numbers of five scenes."""
SOLVED_TO = 1e-3
"""Relative: forces balance to 1e-4 of the contact force (`gelsim.fem.newton`) in their largest entry, and sums of thousands of them to ten
times that at worst."""


def measured(scene: Scene, press: Deformation) -> dict[str, float]:
    """The numbers of the last state, by their names in [expect]; of pictures none where LLVM does not draw.

    The picture is small and of few paths, for its mean is all that counts, of direct light and without the window's reflection. Mitsuba's
    scalar variants draw one light a path by lot: of so few paths their noise alone is a change of 7 levels.
    """
    variant = choose_variant("cpu")
    shown = scene.replace(render=Render("direct", 4, (160, 120)), lights=replace(scene.lights, window_reflection=False))
    rest, membrane = rest_membrane(scene), membrane_states(scene, press)[-1]
    dragged = np.array(scene.press.shear_mm) / max(np.hypot(*scene.press.shear_mm), 1e-12)
    found = {
        "force_n": -press.force[-1, 2],
        "shear_force_n": press.force[-1, :2] @ dragged,
        "contact_area_mm2": press.contact_area[-1] * 1e6,
        "indentation_mm": (rest.positions - membrane.positions)[:, 2].max() * 1e3,
        "marker_shift_mm": np.hypot(*(membrane.marker_centres - rest.marker_centres)[:, :2].T).mean() * 1e3,
    }
    if not variant.name.startswith("scalar"):
        background, picture = (frame.image.astype(float) for frame in render_frames(shown, [rest, membrane], variant=variant))
        found |= {"picture_mean": picture.mean(), "picture_change": np.abs(picture - background).mean()}
    return {name: float(number) for name, number in found.items()}


def moved(expectation: Expectation, found: dict[str, float]) -> list[str]:
    """Which of the numbers that were found are off by more than their margins, in words."""
    return [
        f"{name} = {found[name]:.6g}, expected {number.value:g} ± {number.margin:g} (scatter {number.spread:g})"
        for name, number in expectation.numbers().items()
        if name in found and not abs(found[name] - number.value) <= number.margin  # also what is no number
    ]


def expected(draws: list[float]) -> Expected:
    """What to expect after these draws; a single one is of a scene without a mesh drawn by lot."""
    count, mean = len(draws), float(np.mean(draws))
    spread = float(np.std(draws, ddof=1)) if count > 1 else 0.0
    scatter = float(stats.t.isf(FALSE_ALARM / 2, count - 1)) * spread * np.sqrt(1 + 1 / count) if count > 1 else 0.0
    return Expected(_rounded(mean, 6), _rounded(spread, 2), _rounded(scatter + SOLVED_TO * abs(mean), 3))


def _rounded(number: float, digits: int) -> float:
    return float(f"{number:.{digits}g}")


def draws(scene: Scene) -> list[dict[str, float]]:
    """The numbers of `DRAWS` presses, each with a mesh of its own; of one press where the object is rigid and no mesh is drawn."""
    found = []
    for _ in range(1 if scene.object.rigid else DRAWS):
        with own_cache():
            press = stages.press(scene, device="cpu")
        found.append(measured(scene, press))
    return found


@contextmanager
def own_cache() -> Iterator[None]:
    """Meshes are drawn anew within."""
    choose_variant("cpu")  # what was found out about it lies in the cache too
    before = os.environ.get("GELSIM_CACHE")
    with tempfile.TemporaryDirectory() as folder:
        os.environ["GELSIM_CACHE"] = folder
        try:
            yield
        finally:
            if before is None:
                del os.environ["GELSIM_CACHE"]
            else:
                os.environ["GELSIM_CACHE"] = before


def rewrite(path: Path, numbers: dict[str, Expected]) -> None:
    """New numbers in the [expect] table of a scene file; every other character of it stays. Those that the table does not name are left."""
    text = path.read_text(encoding="utf-8")
    for name, number in numbers.items():
        line = f"{{ value = {number.value!r}, spread = {number.spread!r}, margin = {number.margin!r} }}"
        text = re.sub(rf"(?m)^({name} = )\{{[^}}]*\}}", rf"\g<1>{line}", text)
    path.write_text(text, encoding="utf-8")
