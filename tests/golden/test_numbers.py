"""Every shipped scene is solved to its end, without visible overlap, and gives the numbers of its [expect] table.

Shown to bite: a number that is off, a tet turned inside out, friction of the wrong sign.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scene_numbers import draws, expected, measured, moved, rewrite

from gelsim.errors import GelsimError, SolveStatus
from gelsim.fem import solve_press
from gelsim.geometry import TetMesh
from gelsim.pipeline import stages
from gelsim.scene.definition import Scene
from gelsim.scene.expectation import Expectation, Expected
from gelsim.scene.layers import load_expectation, load_scene

SCENES = sorted((Path(__file__).parents[2] / "scenes").glob("*.toml"))
SHEARED = SCENES[0].with_name("press_punch_shear.toml")


@pytest.mark.slow
@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_numbers_of_a_shipped_scene(path: Path, regenerate: bool) -> None:
    scene = load_scene(path)
    if regenerate:
        found = draws(scene)
        rewrite(path, {name: expected([numbers[name] for numbers in found]) for name in load_expectation(path).numbers()})
        pytest.skip(f"{path.name}: [expect] written anew, from {len(found)} draws")
    press = stages.press(scene, device="cpu")
    assert press.status is SolveStatus.CONVERGED and len(press.approach) == scene.press.frames
    assert (press.min_jacobian > 0).all()
    # The promise: a pixel of the real camera is 19 µm wide, so an overlap below 20 µm is not seen. Found: 0.3 to 14 µm; a rigid rod: 53 µm.
    assert press.penetration.max() < 20e-6
    # What is pressed deeper pushes harder; the first state is first touch.
    assert press.force[0, 2] == 0 and (np.diff(press.force[:, 2]) < 0).all()
    expectation = load_expectation(path)
    assert len(expectation.numbers()) >= 6
    assert moved(expectation, measured(scene, press)) == []


def test_margin_of_known_draws() -> None:
    # Of four draws 1, 2, 3, 4: mean 2.5, s = √(5/3) = 1.291; t of 3 degrees of freedom is beyond 39.7 with a likelihood of 3.5e-5 (tables:
    # 22.2 at 2e-4, falling with the cube), so the margin is about 42 · 1.291 · √1.25.
    found = expected([1.0, 2.0, 3.0, 4.0])
    assert found.value == 2.5 and found.spread == 1.3
    assert found.margin == pytest.approx(22.204 * (2e-4 / 3e-5) ** (1 / 3) * 1.291 * 1.25**0.5, rel=0.01)
    assert expected([2.0]) == Expected(2.0, 0.0, 2e-3)


def test_regenerating_keeps_comments(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text("# Why.\n[expect]   # of what\nforce_n = { value = 1.0, spread = 0.1, margin = 0.2 }   # newton\n", encoding="utf-8")
    rewrite(path, {"force_n": Expected(2.5, 0.01, 0.03), "picture_mean": Expected(1.0, 0.0, 0.1)})
    wanted = "# Why.\n[expect]   # of what\nforce_n = { value = 2.5, spread = 0.01, margin = 0.03 }   # newton\n"
    assert path.read_text(encoding="utf-8") == wanted


def test_number_that_is_off_is_told() -> None:
    expectation = Expectation(force_n=Expected(1.0, 0.001, 0.01))
    assert moved(expectation, {"force_n": 1.009, "contact_area_mm2": 7.0}) == []
    for wrong in (1.011, 0.989, np.nan):
        (told,) = moved(expectation, {"force_n": wrong})
        assert told.startswith("force_n = ") and "± 0.01" in told


def solved(scene: Scene, gel: TetMesh, body: TetMesh, placement: tuple) -> list[str]:
    """What is wrong with a press of these meshes, held against the scene's [expect]; [] if nothing is."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            press = solve_press(scene, gel, body, placement, device="cpu")
        except GelsimError as error:
            return [f"refused: {error}"]
    if press.status is not SolveStatus.CONVERGED or not (press.min_jacobian > 0).all():
        return [f"{press.status}: {press.message}"]
    return moved(load_expectation(SHEARED), measured(scene, press))


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["tet", "friction"])
def test_planted_fault_of_the_solid_is_rejected(fault: str) -> None:
    scene = load_scene(SHEARED)
    gel, body, placement = stages.bodies(scene)
    assert isinstance(body, TetMesh)
    if fault == "tet":
        # The first one turned inside out: two corners change places, and the middles of edges go with them.
        tets = body.tets.copy()
        tets[0] = tets[0][[1, 0, 2, 3, 4, 6, 5, 8, 7, 9]]
        body = replace(body, tets=tets)
    else:
        # The scene's own check refuses it, so it is put past that: the force of friction gets the sign of the slip.
        contact = replace(scene.contact)
        object.__setattr__(contact, "friction_coefficient", -float(scene.contact.friction_coefficient))
        object.__setattr__(scene, "contact", contact)
    told = solved(scene, gel, body, placement)
    print(told)
    assert told != []
