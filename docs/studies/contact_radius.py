"""assets/reference/contact_radius.csv: contact radii by our own profiles, edges of 0.03 to 0.05 mm where the other code has 0.05 to 0.2.

    python docs/studies/contact_radius.py 18        in so many processes: 18 presses of up to two minutes each, alone
    python docs/studies/contact_radius.py solids 3  compares solid quarters with the file, on so many meshes of each object

The cases of assets/reference/{ball,hemisphere}_force.csv on the same disc. Each is solved on three meshes, whose vertices lie elsewhere
when contact ends between two: the file has the mean of their radii (`gelsim/fem/planar/touching.py`), and as its error the largest
distance from it. The force is the finest mesh's.
"""

from __future__ import annotations

import csv
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from gelsim.bench.accuracy import reference_table
from gelsim.bench.presses import ball, hemisphere
from gelsim.fem import touching
from gelsim.fem.planar.problem import PlanarProblem
from gelsim.fem.planar.recording import PlanarRecorder
from gelsim.fem.quasistatic import run_press
from gelsim.mesh.profiles import mesh_profiles
from gelsim.pipeline import stages
from gelsim.scene import materials
from gelsim.scene.layers import assets_folder, build_scene
from gelsim.work.workers import in_environment, settings

Array = NDArray[np.float64]

FINER = (5.0, 6.5, 8.0)
DISC = 12.5e-3


def solve(nu: float, modulus: float | None, finer: float) -> tuple[Array, Array, Array]:
    """Approach [m], radius [mm] and force [N] of all states but the first."""
    scene = build_scene(ball(nu) if modulus is None else hemisphere(modulus, nu))
    scene = scene.replace(press=replace(scene.press, symmetry="axisymmetric"))
    of_object = materials.object_materials(scene).get("body")
    gel, body = mesh_profiles(scene, finer=finer, gel_end=DISC)
    press = run_press(
        PlanarProblem(scene, gel, body, materials.gel_material(scene), of_object, None, tolerance=1e-6), record=PlanarRecorder
    )
    radius = np.sqrt(press.contact_area / np.pi) * 1e3
    print(nu, modulus, finer, press.report.unknowns, radius.round(4), flush=True)
    return press.approach[1:], radius[1:], -press.force[1:, 2]


def write(processes: int) -> None:
    cases = [(nu, modulus) for nu in (0.49, 0.499) for modulus in (None, 50.0, 200.0)]
    with in_environment(settings(1)), ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        asked = {(case, finer): pool.submit(solve, *case, finer) for finer in reversed(FINER) for case in cases}
        solved = {key: future.result() for key, future in asked.items()}
    rows = []
    for case in cases:
        approaches, _, forces = solved[case, FINER[-1]]
        radii = np.transpose([solved[case, finer][1] for finer in FINER])
        for approach, found, force in zip(approaches, radii, forces, strict=True):
            error = np.abs(found - found.mean()).max()
            name = (case[0], case[1] or "rigid", f"{approach * 1e3:.1f}")
            rows.append((*name, f"{found.mean():.4f}", f"{error:.4f}", f"{force:.6g}"))
    with (assets_folder() / "reference" / "contact_radius.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("nu", "object_modulus_kPa", "approach_mm", "contact_radius_mm", "error_mm", "force_N"))
        writer.writerows(rows)


def compare(draws: int) -> None:
    """fTetWild's meshes are drawn by lot: each draw fills a cache of its own. Beside what a press tells stand both readings of it."""
    by_gap, seen = touching._by_gap, []

    def told(nodes: Array, bary: Array, gap: Array, loaded: NDArray[np.bool_], counted: float) -> float | None:
        beyond = by_gap(nodes, bary, gap, loaded, counted)
        seen.append((counted, counted if beyond is None else beyond))
        return beyond

    touching._by_gap = told
    with (assets_folder() / "reference" / "contact_radius.csv").open() as file:
        known = {(row["nu"], row["object_modulus_kPa"], row["approach_mm"]): row for row in csv.DictReader(file)}
    other = {(row["nu"], row["object_modulus_kPa"], row["approach_mm"]): row["force_N"] for row in reference_table("hemisphere_force.csv")}
    for fidelity in ("fast", "balanced", "reference"):
        radii, forces, others, apart = [], [], [], []
        for _ in range(draws):
            of_draw: list[Array] = []
            with TemporaryDirectory() as cache, in_environment({"GELSIM_CACHE": cache}):
                for modulus in (50.0, 200.0):
                    seen.clear()
                    press = stages.press(build_scene(hemisphere(modulus, 0.499, symmetry="mirror") | {"fidelity": fidelity}))
                    rows = [known["0.499", str(modulus), f"{approach * 1e3:.1f}"] for approach in press.approach[1:]]
                    radius = np.sqrt(press.contact_area[1:] / np.pi) * 1e3 / [float(row["contact_radius_mm"]) for row in rows] - 1
                    of_draw.append(100 * radius)
                    known_mm = np.array([float(row["contact_radius_mm"]) for row in rows])
                    apart.append(100 * (np.sqrt(4 * np.array(seen[-len(rows) :]) / np.pi) / known_mm[:, None] - 1))
                    forces.append(100 * (-press.force[1:, 2] / [float(row["force_N"]) for row in rows] - 1))
                    theirs = [other[0.499, modulus, round(float(row["approach_mm"]), 4)] for row in rows]
                    others.append(100 * (-press.force[1:, 2] / theirs - 1))
            radii.append(np.concatenate(of_draw))
        largest = [round(float(np.abs(of_draw).max()), 1) for of_draw in radii]
        rms, force = (float(np.sqrt(np.mean(np.square(radii)))), float(np.abs(forces).max()))
        points, gap = np.sqrt(np.mean(np.square(np.concatenate(apart)), axis=0))
        told_apart = f"(by points {points:.2f}, by the gap {gap:.2f})"
        theirs = float(np.abs(others).max())
        print(f"{fidelity}: radius {rms:.2f} % RMS {told_apart}, largest of each draw {largest} %; force {force:.2f} % at most", end=", ")
        print(f"{theirs:.2f} % off the other code's", flush=True)


if __name__ == "__main__":
    compare(int(*sys.argv[2:] or "1")) if sys.argv[1:2] == ["solids"] else write(int(*sys.argv[1:] or "1"))
