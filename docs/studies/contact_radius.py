"""assets/reference/contact_radius.csv: contact radii by our own profiles, with edges of 0.04 mm where the other code has 0.05 to 0.2 mm.

    python docs/studies/contact_radius.py           (some minutes)
    python docs/studies/contact_radius.py solids    compares solid quarters with the file

The cases of assets/reference/{ball,hemisphere}_force.csv on the same disc. Two radii bracket the true one: that of the outermost Gauss
point with pressure, at most a Gauss distance too small, and that of the area of all such points, up to an edge too large, as multipliers
are linear over an edge. The file has their mean and half their distance, plus half a Gauss distance, as its error.
"""

from __future__ import annotations

import csv
import sys
from dataclasses import replace

import numpy as np

from gelsim import materials, pipeline
from gelsim.bench.presses import ball, hemisphere
from gelsim.fem.planar.problem import PlanarProblem
from gelsim.fem.planar.recording import PlanarRecorder
from gelsim.fem.quasistatic import run_press
from gelsim.profiles import mesh_profiles
from gelsim.scene_file import assets_folder, build_scene

FINER = 6.0
DISC = 12.5e-3


class Outermost(PlanarRecorder):
    """Notes the outermost loaded point of every state [mm]."""

    def keep(self, approach: float, newton_iterations: int, factorisations: int) -> None:
        super().keep(approach, newton_iterations, factorisations)
        contact, solids = self.problem.contact, self.problem.solids
        x = (solids.rest + solids.displacement.numpy())[contact.gel_faces][..., 0] @ contact.shape_values.T
        loaded = contact.pressure.numpy() > 0
        radii.append(float(x.ravel()[loaded].max()) if loaded.any() else 0.0)


radii: list[float] = []


def write() -> None:
    rows = []
    cases = [(nu, modulus) for nu in (0.49, 0.499) for modulus in (None, 50.0, 200.0)]
    for nu, modulus in cases:
        scene = build_scene(ball(nu) if modulus is None else hemisphere(modulus, nu))
        scene = scene.replace(press=replace(scene.press, symmetry="axisymmetric"))
        gel, body = mesh_profiles(scene, finer=FINER, gel_end=DISC)
        of_object = materials.object_materials(scene).get("body")
        problem = PlanarProblem(scene, gel, body, materials.gel_material(scene), of_object, None, tolerance=1e-6)
        problem.record = lambda problem=problem: Outermost(problem)  # type: ignore[method-assign]
        radii.clear()
        press = run_press(problem)
        edge = np.diff(np.sort(gel.nodes[np.unique(gel.groups["coated"][:, :2]), 0])).min() * 1e3
        for approach, area, outer, force in list(zip(press.approach, press.contact_area, radii, press.force[:, 2], strict=True))[1:]:
            whole = np.sqrt(area / np.pi) * 1e3
            error = abs(whole - outer) / 2 + edge / 8
            rows.append((nu, modulus or "rigid", f"{approach * 1e3:.1f}", f"{(whole + outer) / 2:.4f}", f"{error:.4f}", f"{-force:.6g}"))
        print(nu, modulus, problem.solids.unknowns, edge, rows[-10], flush=True)
    with (assets_folder() / "reference" / "contact_radius.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("nu", "object_modulus_kPa", "approach_mm", "contact_radius_mm", "error_mm", "force_N"))
        writer.writerows(rows)


def compare() -> None:
    with (assets_folder() / "reference" / "contact_radius.csv").open() as file:
        known = {(row["nu"], row["object_modulus_kPa"], row["approach_mm"]): row for row in csv.DictReader(file)}
    for fidelity in ("balanced", "reference"):
        for modulus in (50.0, 200.0):
            press = pipeline.press(build_scene(hemisphere(modulus, 0.499) | {"fidelity": fidelity}))
            rows = [known["0.499", str(modulus), f"{approach * 1e3:.1f}"] for approach in press.approach[1:]]
            radius = np.sqrt(press.contact_area[1:] / np.pi) * 1e3 / [float(row["contact_radius_mm"]) for row in rows] - 1
            force = -press.force[1:, 2] / [float(row["force_N"]) for row in rows] - 1
            print(fidelity, modulus, "radius %", np.round(100 * radius, 1), "force %", np.round(100 * force, 2), flush=True)


if __name__ == "__main__":
    compare() if sys.argv[1:] == ["solids"] else write()
