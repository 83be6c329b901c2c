"""The fit's own picture against the renderer's, and its derivatives against central differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gelsim.calibrate import dent, drawing, model
from gelsim.calibrate.dent import THICKNESSES, DentFamily, Dents, effective_radius, solve_dents
from gelsim.calibrate.fit import Data, Evaluation
from gelsim.calibrate.parameters import Parameters, curvature_of, dome_of, empty_scene, to_scene
from gelsim.optics.camera import project
from gelsim.optics.rest import even_part, save_levels
from gelsim.scene.definition import Camera, Gel, Lights, Render
from gelsim.shape.shapes import gel_height

BALL_MM, CURVATURE, SIZE = 2.0, 1 / 40, (48, 36)
ROW, COLUMN = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
LEVELS = (200 - 40 * np.hypot(COLUMN - 24, ROW - 18) / 30 - 60 * (np.hypot(COLUMN % 8 - 4, ROW % 8 - 4) < 1.6))[..., None] * np.array(
    [0.9, 1, 0.8]
)
REST = model.Rest(np.rint(LEVELS), even_part(np.rint(LEVELS)))
"""A photograph with a vignette and dark dots."""
BALLS = np.array([BALL_MM, BALL_MM])
PRESSES = np.array([[0.9, -0.6, 0.9, 0.15, -0.08], [-3.0, 1.5, 0.6, -0.1, 0.05]])


def parameters() -> Parameters:
    """Three lights beside a picture of 12 x 9 mm, and a veil."""
    half = 7.5
    geometry = [
        [1.6 * half, azimuth, -0.7 * half, 0.1, 0.3, np.log(0.6 * half), np.log(0.2 * half)] for azimuth in np.radians([10.0, 130.0, 250.0])
    ]
    colours = np.array([[9.0, 0.5, 0.3], [0.4, 8.0, 0.6], [0.3, 0.7, 9.0], [900.0, 800.0, 900.0]])
    values = np.array([0.25, 30.0, CURVATURE, 2.4, 0.3, 0.45, 1.1, 0.03, -0.05, 0.3])
    return Parameters(values, np.array(geometry), colours, half, SIZE[0] / 2, (4.0, 1.49, 1.41))


@pytest.fixture(scope="module")
def dents() -> Dents:
    return solve_dents(Gel(size_mm=(20.0, 20.0)), effective_radius(BALL_MM, CURVATURE), True)


def pixels_of(press: int, near_mm: float = np.inf) -> Data:
    place = np.column_stack([COLUMN.ravel() - SIZE[0] / 2, ROW.ravel() - SIZE[1] / 2])
    place = place[np.hypot(*(0.25 * place - PRESSES[press, :2]).T) < near_mm]
    zero = np.zeros((len(place), 3))
    return Data(model.Pixels(place, np.full(len(place), press)), zero, zero + 1, np.zeros(len(place), int), REST, zero, BALLS)


def start_scene():
    return empty_scene(dome_of(Gel(size_mm=(20.0, 20.0)), CURVATURE), Camera(), Lights())


@pytest.mark.slow
@pytest.mark.parametrize("press", [-1, 0, 1])
def test_model_is_the_renderer_in_direct_mode(dents, press, tmp_path, monkeypatch):
    chosen = parameters()
    save_levels(LEVELS, tmp_path / "rest.png")
    scene = to_scene(chosen, start_scene(), SIZE)
    scene = scene.replace(camera=replace(scene.camera, rest=str(tmp_path / "rest.png")))
    assert curvature_of(scene.gel) == pytest.approx(CURVATURE, rel=1e-6)
    scene = scene.replace(render=Render(mode="direct", spp=576, resolution=SIZE))
    rest, drawn = drawing.draw(scene, dents.at(2.4, 0.3), BALL_MM, list(PRESSES))
    wanted = (rest if press < 0 else drawn[press]).astype(float)
    level = Evaluation(chosen, PRESSES, pixels_of(press), dents).level.reshape(wanted.shape)
    error = np.sqrt(((level - wanted) ** 2).mean())
    # 8-bit rounding gives 0.3 levels. The dent's shadow is a soft step here and a penumbra there, and a pixel at its rim sees one slope
    # here and an average there: 0.9 levels with that.
    assert error < 1.2
    if press < 0:
        return
    # Planted: a light 15 % of its distance farther out; dots that stay where they were.
    geometry = chosen.geometry.copy()
    geometry[1, 0] *= 1.15
    wrong = Evaluation(replace(chosen, geometry=geometry), PRESSES, pixels_of(press), dents).level.reshape(wanted.shape)
    monkeypatch.setattr(model, "rest_place", lambda shape, family, pixels, seen: pixels.place)
    stuck = Evaluation(chosen, PRESSES, pixels_of(press), dents).level.reshape(wanted.shape)
    assert min(np.sqrt(((each - wanted) ** 2).mean()) for each in (wrong, stuck)) > 1.15 * error


def agree(column: np.ndarray, central: np.ndarray, share: float = 0.98) -> bool:
    """Within 1 %, and a hundredth of the typical size, in that share: where a pixel lies on a kink (the rim of a shadow, a step of
    the tables, a flank that turns from the light) the one-sided difference is another number than the central one, and neither is wrong."""
    return float((np.abs(column - central) <= 0.01 * np.abs(central) + 0.01 * np.sqrt((central**2).mean())).mean()) > share


def test_derivatives_are_central_differences(dents):
    # Far from the dent nothing changes, whatever the sensor.
    chosen, data = parameters(), pixels_of(0, 1.8)
    # A second thickness, so that there is something to interpolate.
    pairs = [
        (family, replace(family, height=1.1 * family.height, slope=1.1 * family.slope)) for family in (dents.families[0], dents.slippery[0])
    ]
    dents = Dents(np.array([2.0, 3.0]), *pairs)
    here = Evaluation(chosen, PRESSES, data, dents)
    columns, own = here.sensor_columns(), here.press_columns()
    vector = chosen.vector
    for k in range(len(vector)):
        step = np.zeros_like(vector)
        step[k] = 1e-4 * max(abs(vector[k]), 0.1)
        above, below = (Evaluation(chosen.with_vector(vector + sign * step), PRESSES, data, dents).level.ravel() for sign in (1, -1))
        central = (above - below) / (2 * step[k])
        assert np.linalg.norm(central) > 0, chosen.names[k]
        assert agree(columns[:, :, k].ravel(), central), chosen.names[k]
        assert not agree(1.03 * columns[:, :, k].ravel(), central), chosen.names[k]
    for k in range(5):
        step = np.zeros_like(PRESSES)
        step[0, k] = 1e-3
        above, below = (Evaluation(chosen, PRESSES + sign * step, data, dents).level.ravel() for sign in (1, -1))
        central = (above - below) / 2e-3
        # A picture between pixels is linear piece by piece: where a dot's edge passes a pixel there is a kink.
        assert agree(own[:, :, k].ravel(), central, 0.9)
        # Planted: the derivative by another quantity.
        assert not agree(own[:, :, (k + 1) % 5].ravel(), central, 0.9)


def test_the_dent_conforms_to_the_ball(dents):
    """Where they touch, dome and dent together are the ball: z = -depth + ρ²/2R to second order, here on the dome's top."""
    depth, shape = 0.5, model.Shape(0.05, 30.0, ((4.0, 1.49), (2.4, 1.41)), 100.0, CURVATURE, BALLS)
    family = dents.at(2.4)
    rho = np.linspace(0.02, 0.6, 30)
    dented, _ = family.surface(rho, np.full(30, depth), effective_radius(BALLS[:1], CURVATURE))
    dome, _ = model.dome(shape.curvature, np.column_stack([rho, np.zeros(30)]))
    ball = -depth + BALL_MM - np.sqrt(BALL_MM**2 - rho**2)
    # The family presses a ball of R' = 1.905 mm into a plane; to fourth order the two differ by ρ⁴ (1/R'³ - 1/R³) / 8 = 0.3 µm at 0.6 mm.
    # The rest is the contact's own overlap and the tables' steps: 2 µm.
    assert np.abs(dented + dome - ball).max() < 2.5e-3


@pytest.mark.slow
def test_dents_between_the_solved_thicknesses():
    low, high = THICKNESSES[4:6]
    middle, rho = float(np.sqrt(low * high)), np.linspace(0, 5, 200)
    families = [dent.solve_family(Gel(thickness_mm=thickness), np.array([BALL_MM]), 1.6, dent.STICKS) for thickness in (low, middle, high)]

    def apart(family: DentFamily) -> float:
        pair = [each.surface(rho, np.full(200, 1.15), np.full(200, BALL_MM))[0] for each in (family, families[1])]
        return float(np.abs(pair[0] - pair[1]).max())

    # Linear in log h, over half a step of 0.09: the second difference of the tables gives 1 µm; each solution's own mesh 1.5 µm.
    assert apart(Dents(np.array([low, high]), (families[0], families[2])).at(middle)) < 4e-3
    # Planted: the thinner gel's dent in its place.
    assert apart(families[0]) > 4e-3


def test_a_veil_without_light_is_off():
    chosen = parameters()
    chosen.colours[-1] = 0
    scene = to_scene(chosen, start_scene(), SIZE)
    assert scene.lights.lights[-1].power == 0 and scene.lights.lights[0].power > 0


def test_rays_are_the_camera_s(dents):
    chosen = parameters()
    scene = to_scene(chosen, start_scene(), SIZE)
    start, slope = model.rays(chosen.shape(BALLS), pixels_of(-1).pixels.place)
    for height in (0.0, -1.0):
        points = np.column_stack([start + slope * height, np.full(len(start), height)])
        assert project(scene, points * 1e-3) == pytest.approx(pixels_of(-1).pixels.place + np.array(SIZE) / 2, abs=1e-6)


def test_a_light_within_the_gel_stays_below_its_coat(dents):
    """A light that the fit moves up beside the picture, where the dome has fallen: refused by the renderer, were it drawn there."""
    chosen = replace(parameters(), gel_half_mm=(10.0, 10.0))
    chosen.geometry[1, :3] = 8.8, np.pi, -0.5
    scene = to_scene(chosen, start_scene(), SIZE)
    z = scene.lights.lights[1].position_mm[2]
    coat = gel_height(scene.gel, np.array([[-8.8e-3, 0.0]]))[0] * 1e3
    assert coat - 0.1 < z < coat < -0.5
    # Beyond the gel it stays where it was.
    chosen.geometry[1, 0] = 11.0
    assert to_scene(chosen, start_scene(), SIZE).lights.lights[1].position_mm[2] == -0.5


def test_presses_of_two_balls_are_those_of_each_alone():
    """Of each pixel the ball of its own press decides: both presses in one evaluation, and each with its ball for all."""
    gel, two = Gel(size_mm=(20.0, 20.0)), np.array([2.0, 3.2])
    both = solve_dents(gel, effective_radius(two, CURVATURE), True)
    for press in (0, 1):
        alone = solve_dents(gel, effective_radius(two[press : press + 1], CURVATURE), True)
        data = pixels_of(press)
        mixed = Evaluation(parameters(), PRESSES, replace(data, balls_mm=two), both).level
        own = Evaluation(parameters(), PRESSES, replace(data, balls_mm=two[[press, press]]), alone).level
        # The row of the tables is counted through the balls: rounding.
        assert mixed == pytest.approx(own, abs=1e-6)
        # Planted: the other's ball.
        other = Evaluation(parameters(), PRESSES, replace(data, balls_mm=two[::-1]), both).level
        assert np.abs(other - own).max() > 1
