"""Does `gelsim calibrate` find a sensor that is known? Photographs drawn by the renderer, noise added, a start that knows nothing of it.

    python docs/studies/calibrate_self.py --out out/calibrate_self [--presses 16] [--size 160x120] [--fem 2] [--markers]

The sensor: a dome of 45 mm radius and 3.2 mm thickness, three lights at other places and of other sizes than any start, a coat of a fifth
flakes, inter-reflection on. Balls of 2.5 mm, or of the radii of `--balls` in turn, at places and depths drawn by lot; every fourth is for
testing. `--fem` N: the dents of the first N test presses are solved in three dimensions on the dome, not taken from the family that the fit
uses. Noise: 1.5 levels, then 8 bits. `--markers`: black dots of 0.25 mm radius every 2 mm move with the gel.
Prints each parameter with its truth and its distance in standard deviations, and writes found.csv.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np
from PIL import Image

from gelsim.calibrate import calibrate, drawing
from gelsim.calibrate.dent import effective_radius, solve_dents
from gelsim.calibrate.parameters import GEOMETRY, GLOBALS, Parameters, dome_of, empty_scene, in_units, to_scene
from gelsim.pipeline import stages
from gelsim.scene.definition import Body, Camera, Gel, Lights, Markers, Press, Render

BALL_MM, THICKNESS_MM, CURVATURE, FIELD_MM = 2.5, 3.2, 1 / 45, 18.0
NOISE = 1.5


def truth(width: int, height: int) -> Parameters:
    half = 0.5 * FIELD_MM * np.hypot(1, height / width)
    places = [(1.5, 25.0, -0.75, 0.35, 0.55, 0.18), (1.7, 140.0, -0.6, 0.3, 0.7, 0.15), (1.45, 268.0, -0.85, 0.45, 0.45, 0.2)]
    lights = [[a * half, np.radians(b), c * half, 0.0, d, np.log(e * half), np.log(f * half)] for a, b, c, d, e, f in places]
    colours = np.array([[16.0, 1.0, 0.6], [0.8, 17.0, 1.2], [0.5, 1.4, 14.0], [1500.0, 1500.0, 1700.0]])
    values = np.array([FIELD_MM / width, 34.0, CURVATURE, THICKNESS_MM, 0.2, 0.45, 1.0, 0.0, 0.0, 0.0])
    return Parameters(values, np.array(lights), colours, half, width / 2, (4.0, 1.49, 1.41))


def write_photos(  # noqa: PLR0913 - a keyword for each flag of its command
    folder: Path, width: int, height: int, count: int, *, fem: int = 0, spp: int = 144, seed: int = 1, markers: bool = False,
    gel_known: bool = False, balls: tuple[float, ...] = (BALL_MM,),
) -> tuple[Parameters, np.ndarray]:  # fmt: skip
    """Draws the photographs; returns the sensor and the presses (x, y, depth [mm])."""
    rng = np.random.default_rng(seed)
    sensor = truth(width, height)
    gel = Gel(thickness_mm=THICKNESS_MM)
    base = empty_scene(dome_of(gel, CURVATURE), Camera(), Lights())
    scene = to_scene(sensor, base, (width, height)).replace(render=Render(resolution=(width, height), spp=spp))
    if markers:
        scene = scene.replace(markers=Markers(layout="grid", pitch_mm=2.0, radius_mm=0.25))
    reach = 0.5 * FIELD_MM * np.array([1, height / width]) - 2.2
    # Spread evenly: shuffled strata along both axes.
    strata = np.stack([rng.permutation(count), rng.permutation(count)], axis=1)
    presses = np.column_stack([(2 * (strata + rng.random((count, 2))) / count - 1) * reach, rng.uniform(0.5, 1.2, count)])
    test = np.arange(count) % 4 == 3
    radii = np.resize(balls, count)
    dents = solve_dents(gel, effective_radius(radii, CURVATURE), True)
    rest, pictures = drawing.draw(scene, dents.at(THICKNESS_MM), radii, list(presses))
    for index in np.flatnonzero(test)[:fem]:
        x, y, depth = (float(value) for value in presses[index])
        solid = scene.replace(
            object=Body(shape="hemisphere", rigid=True, radius_mm=float(radii[index]), height_mm=6.0),
            press=Press(depth_mm=depth, force_n=None, frames=6, offset_mm=(x, y)),
        )
        deformation, frames = stages.simulate(solid)
        difference = frames[-1].image.astype(float) - pictures[index]
        print(f"press {index}, solved in three dimensions: {np.sqrt((difference**2).mean()):.2f} levels from the family's picture")
        pictures[index] = frames[-1].image
    folder.mkdir(parents=True, exist_ok=True)
    for name, picture in [("rest.png", rest), *((f"press_{i:02d}.png", picture) for i, picture in enumerate(pictures))]:
        noisy = picture + NOISE * rng.standard_normal(picture.shape)
        Image.fromarray(np.rint(np.clip(noisy, 0, 255)).astype(np.uint8)).save(folder / name)
    with (folder / "presses.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["file", "split", "radius_mm"])
        table.writerows([f"press_{i:02d}.png", "test" if test[i] else "train", radii[i]] for i in range(count))
    settings = f'ball_radius_mm = {BALL_MM}\nno_contact = "rest.png"\nmm_per_px = {FIELD_MM / width}\nmarkers = {str(markers).lower()}\n'
    if gel_known:
        thick, thin = scene.gel.thickness_mm, scene.gel.edge_thickness_mm
        settings += f'[gel]\nprofile = "dome"\nthickness_mm = {thick}\nedge_thickness_mm = {thin}\n'
    (folder / "photos.toml").write_text(settings, encoding="utf-8")
    return sensor, presses


def compare(report: dict, sensor: Parameters, presses: np.ndarray) -> list[tuple[str, float, float, float, str]]:
    """Name, truth, found, standard deviation and state of each parameter; lights by the nearest direction."""
    found = report["parameters"]
    rows = []
    for name, value in zip(GLOBALS, sensor.globals, strict=True):
        shown, wanted, _ = in_units(name, float(value), 0.0)
        if found[shown]["state"] != "given":
            rows.append((shown, wanted, found[shown]["value"], found[shown]["sd"], found[shown]["state"]))
    names = report["fit"]["lights"][:-1]
    angles = np.array([np.radians(found[f"lights.{name}.azimuth_deg"]["value"]) for name in names])
    for light in sensor.geometry:
        away = np.angle(np.exp(1j * (angles - light[1])))
        name = names[int(np.abs(away).argmin())]
        for what, value in zip(GEOMETRY, light, strict=True):
            shown, wanted, _ = in_units(f"lights.{name}.{what}", float(value), 0.0)
            entry = found[shown]
            # Azimuths are the same after a full turn.
            got = wanted + float(np.degrees(away[np.abs(away).argmin()])) if what == "azimuth_rad" else entry["value"]
            rows.append((shown, wanted, got, entry["sd"], entry["state"]))
    for row, press in zip(report["presses"], presses, strict=True):
        for k, what in enumerate(("x_mm", "y_mm", "depth_mm")):
            rows.append((f"{row['file']}.{what}", float(press[k]), [*row["offset_mm"], row["depth_mm"]][k], row["sd_mm"][k], row["split"]))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--presses", type=int, default=16)
    parser.add_argument("--size", default="160x120")
    parser.add_argument("--fem", type=int, default=0)
    parser.add_argument("--markers", action="store_true")
    parser.add_argument("--spp", type=int, default=144)
    parser.add_argument("--balls", type=float, nargs="+", default=[BALL_MM], metavar="MM", help="radii, one after the other")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    width, height = (int(part) for part in options.size.split("x"))
    sensor, presses = write_photos(
        options.out / "photos", width, height, options.presses,
        fem=options.fem, spp=options.spp, seed=options.seed, markers=options.markers, balls=tuple(options.balls),
    )  # fmt: skip
    report = calibrate(options.out / "photos", options.out / "sensor.toml", sensor="self", force=True)
    rows = compare(report, sensor, presses)
    with (options.out / "found.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["parameter", "truth", "found", "sd", "distance_sd", "state"])
        for name, wanted, got, sd, state in rows:
            table.writerow([name, f"{wanted:.5g}", f"{got:.5g}", f"{sd:.2g}", f"{(got - wanted) / max(sd, 1e-9):.2f}", state])
            if not name.startswith("press_"):
                print(f"{name:26s} truth {wanted:9.4f} found {got:9.4f} ± {sd:7.4f}  {(got - wanted) / max(sd, 1e-9):6.1f} sd  {state}")
    apart = np.array(
        [[abs(got - wanted), abs(got - wanted) / max(sd, 1e-9)] for name, wanted, got, sd, _ in rows if name.startswith("press_")]
    )
    print(f"presses: median error {1e3 * np.median(apart[:, 0]):.0f} µm; within 2 sd {100 * (apart[:, 1] < 2).mean():.0f} %")
    for split, score in report["scores"].items():
        print(split, {name: round(value, 3) for name, value in score["whole"].items()})


if __name__ == "__main__":
    main()
