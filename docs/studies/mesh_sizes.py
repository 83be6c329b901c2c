"""How the error of a press falls with the number of unknowns: the study that the sizes in gelsim/mesh/sizing.py were chosen from.

    python docs/studies/mesh_sizes.py [--fidelity fast balanced reference] [--case ball 50 200 punch] [--set growth=0.6 finest=1.2e-4 ...]

Flat gel of 50 kPa, ν = 0.499, R = 5 mm, no friction, 1 mm deep in ten steps: a rigid ball ("ball") and silicone hemispheres of 50 and
200 kPa; and a rigid flat punch of 3 mm that sticks, 0.5 mm deep in six steps. A quarter is solved; unknowns are those of the quarter,
"whole" is the nodes of the whole bodies. Compared with the axisymmetric code of assets/reference; its force is good to 0.1 % (ball), 0.5 %
(hemisphere) and 0.3 % (punch, 1.331 N), its contact radius to a quarter of a mesh edge of 0.05 to 0.2 mm, its profile to 2 µm. The largest
errors from 0.3 mm on are reported (below, fewer than three edges at `fast` lie across the contact), "force_end" is the last state's.
The profile's error is the RMS over the nodes of the gel's outer face within 8 mm.

Left out: what is random in a filling; run twice with an empty cache (GELSIM_CACHE) to see it.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np

from gelsim import fem
from gelsim.mesh import body_mesh, gel_mesh, sizing
from gelsim.scene.definition import Body, Contact, Gel, Press, Scene
from gelsim.shape import shapes

REFERENCE = Path(__file__).parents[2] / "assets" / "reference"
PUNCH_FORCE = 1.331  # N at 0.5 mm


def scene_of(case: str, fidelity: str) -> Scene:
    gel = Gel(profile="flat", shore_00=None, youngs_modulus_kpa=50, poissons_ratio=0.499)
    contact, press = Contact(friction_coefficient=0.0), Press(depth_mm=1.0, force_n=None, frames=11)
    if case == "punch":
        body = Body(shape="punch", radius_mm=3, height_mm=5, rigid=True, shore_00=None)
        contact, press = Contact(friction_coefficient="stick"), Press(depth_mm=0.5, force_n=None, frames=6)
    elif case == "ball":
        body = Body(shape="hemisphere", radius_mm=5, height_mm=10, rigid=True, shore_00=None)
    else:
        body = Body(shape="hemisphere", radius_mm=5, height_mm=25, shore_00=None, youngs_modulus_kpa=float(case), poissons_ratio=0.499)
    return Scene(gel=gel, object=body, contact=contact, press=press, fidelity=fidelity)


def reference(case: str) -> tuple[dict[float, tuple[float, float]], dict[float, np.ndarray]]:
    """Force [N] and contact radius [mm] by depth [mm]; rest radius and uz [mm] of the outer face by depth."""
    rigid = case == "ball"
    key = "depth_mm" if rigid else "approach_mm"
    curve, profile = {}, defaultdict(list)
    with open(REFERENCE / ("ball_force.csv" if rigid else "hemisphere_force.csv")) as file:
        for row in csv.DictReader(file):
            if float(row["nu"]) == 0.499 and (rigid or row["object_modulus_kPa"] == case):
                curve[round(float(row[key]), 3)] = float(row["force_N"]), float(row["contact_radius_mm"])
    if case in ("ball", "200"):
        with open(REFERENCE / ("ball_profile_nu0.499.csv" if rigid else "hemisphere_gel_profile_nu0.499_E200.csv")) as file:
            for row in csv.DictReader(file):
                profile[round(float(row[key]), 3)].append((float(row["r_mm"]), float(row["u_z_mm"])))
    return curve, {depth: np.array(points) for depth, points in profile.items()}


def main(fidelity: str, case: str) -> dict[str, float]:
    scene = scene_of(case, fidelity)
    planes = shapes.press_symmetry(scene)
    start = time.perf_counter()
    gel = gel_mesh.mesh_gel(scene, planes)
    rigid = scene.object.rigid
    body = shapes.rigid_surface(scene, planes) if rigid else body_mesh.mesh_object(scene, planes)
    meshed = time.perf_counter()
    place = shapes.placement(scene, body if rigid else body.surface("contact"))
    press = fem.solve_press(scene, gel, body, place)
    solved = time.perf_counter()
    whole = sum(np.prod([2.0 - (node[axis] == 0.0) for axis in (0, 1)]) for mesh in ([gel] if rigid else [gel, body])
                for node in mesh.rest_positions)  # fmt: skip
    row: dict[str, float] = {
        "gel": len(gel.rest_positions), "object": 0 if rigid else len(body.rest_positions), "whole": whole,
        "unknowns": press.report.unknowns, "mesh_s": meshed - start, "solve_s": solved - meshed, "states": len(press.approach),
    }  # fmt: skip
    if case == "punch":
        row |= {"force": 100 * (-press.force[-1, 2] / PUNCH_FORCE - 1), "overlap": press.penetration[-1] * 1e6}
        return row
    curve, profile = reference(case)
    rest = np.hypot(*press.gel.rest[:, :2].T) * 1e3
    near = rest < 8.0
    force, radius, shape = [], [], []
    for i, approach in enumerate(press.approach):
        depth = round(approach * 1e3, 3)
        if depth >= 0.3 and depth in curve:
            force.append(100 * (-press.force[i, 2] / curve[depth][0] - 1))
            radius.append(100 * (np.sqrt(press.contact_area[i] / np.pi) * 1e3 / curve[depth][1] - 1))
        if depth >= 0.3 and depth in profile:
            wanted = np.interp(rest[near], *profile[depth].T)
            shape.append(1e3 * np.sqrt(np.mean((press.gel.displacement[i, near, 2] * 1e3 - wanted) ** 2)))
    row |= {"force": max(force, key=abs), "force_end": force[-1],
            "radius": max(radius, key=abs), "radius_rms": np.sqrt(np.mean(np.square(radius))), "profile": max(shape, default=np.nan),
            "overlap": press.penetration.max() * 1e6}  # fmt: skip
    return row


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--fidelity", nargs="+", default=["fast", "balanced", "reference"])
    parser.add_argument("--case", nargs="+", default=["ball", "50", "200", "punch"])
    parser.add_argument("--set", nargs="*", default=[], help="fields of MeshSizes, in metres")
    arguments = parser.parse_args()
    for fidelity in arguments.fidelity:
        changed = {name: float(value) for name, value in (item.split("=") for item in arguments.set)}
        sizing.SIZES[fidelity] = replace(sizing.SIZES[fidelity], **changed)
        for case in arguments.case:
            row = main(fidelity, case)
            print(f"| {fidelity} | {case} |", " | ".join(f"{name} {value:.4g}" for name, value in row.items()), "|", flush=True)
