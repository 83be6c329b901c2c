"""Stiffness of the coupled hemisphere (whole body, no friction) against sliding sideways on the gel: the weakest modes of Newton's matrix.

    python docs/studies/sliding_mode.py [--points 6] [--coarser 1.3] [--on-object]

At each converged state, of S = A + Bᵀ C⁻¹ B (displacements, pressures eliminated; each unknown counted in units of its diagonal): how many
eigenvalues are negative, the two smallest, and the same two without contact's geometric stiffness. Then of the weakest mode, scaled to a
largest displacement of 1: twice the energy [mN/mm] in gel, object, contact's normal and its geometric part, and how far point and foot
slide on each other. `--points`: of contact on a face. `--on-object`: these are the object's faces, not the gel's; with 12 what a press
begins with. `--coarser`: `sizing.OBJECT_COARSER`; another one makes another mesh of the object. The object's mesh is drawn by lot
(fTetWild) and then cached: another draw gives other numbers.
"""

from __future__ import annotations

import argparse
import functools

import numpy as np
import scipy.sparse as sp
import warp as wp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from gelsim.errors import SolveStatus
from gelsim.fem import strategy
from gelsim.fem.linear import PardisoSolver
from gelsim.fem.newton import Newton, NewtonReport
from gelsim.mesh import sizing
from gelsim.mesh.sizing import OBJECT_COARSER
from gelsim.pipeline import stages
from gelsim.scene.layers import build_scene

Array = NDArray[np.float64]
FAR = 2.0  # mm, reach of the search for contact


def symmetric(newton: Newton, values: Array) -> sp.csr_matrix:
    """The whole matrix of the upper triangle's values."""
    assert newton.pattern is not None
    count = len(newton.pattern.indptr) - 1
    upper = sp.csr_matrix((values, newton.pattern.indices, newton.pattern.indptr), shape=(count, count))
    return (upper + sp.triu(upper, 1).T).tocsr()


def weakest(newton: Newton, values: Array, count: int = 2) -> tuple[int, Array, Array]:
    """Negative eigenvalues of S, its `count` of least size in ascending order, and the mode of the first, of all unknowns (N,)."""
    moves = newton.displacement_unknown > 0.0
    matrix = symmetric(newton, values)
    unit = np.sqrt(np.abs(matrix.diagonal()[moves]))
    direct = PardisoSolver()
    assert newton.pattern is not None
    direct.analyse(newton.pattern.indptr, newton.pattern.indices, values)
    direct.factorise(values)

    def inverse(x: Array) -> Array:
        right = np.zeros(len(moves))
        right[moves] = x.ravel() * unit
        return direct.solve(right)[moves] * unit

    operator = LinearOperator((len(unit),) * 2, matvec=inverse)  # type: ignore[call-arg]
    found, vectors = eigsh(operator, k=count, which="LM", tol=1e-4)
    order = np.argsort(1.0 / found)
    mode = np.zeros(len(moves))
    mode[moves] = vectors[:, order[0]] / unit
    mode[~moves] = splu((-matrix[~moves][:, ~moves]).tocsc()).solve(matrix[~moves][:, moves] @ mode[moves])
    return direct.negative - int((~moves).sum()), 1.0 / found[order], mode


def shares(newton: Newton, mode: Array, whole: Array, plain: Array) -> tuple[float, ...]:
    """Twice the energy [mN/mm] of the mode in gel and object (volume held), contact's normal and geometric part; and the slip."""
    solids, contact = newton.solids, newton.contact
    assert newton.pattern is not None
    mode = mode / np.abs(mode[newton.displacement_unknown > 0.0]).max()

    def energy(values: Array) -> float:
        return float(mode @ (symmetric(newton, values) @ mode))

    bodies = wp.zeros(len(newton.pattern.indices), dtype=wp.float64)
    solids.add_tangent(newton.pattern.pairs, bodies)
    bodies_of = connected_components(sp.csr_matrix((np.ones(solids.tets.size), (np.repeat(solids.tets[:, 0], 10), solids.tets.ravel())),
                                                   shape=(solids.node_count,) * 2), directed=False)[1]  # fmt: skip
    of_gel = bodies_of == bodies_of[solids.tets[0, 0]]  # its tets are the first ones
    owner = np.nonzero(solids.free)[0]
    gel_values = np.where(np.repeat(of_gel[owner], np.diff(newton.pattern.indptr)), bodies.numpy(), 0.0)
    touching = np.flatnonzero(contact.pressure.numpy() > 0.0)
    unit = np.eye(3)
    # relative motion of every point in contact, axis by axis
    face, xi, normal = contact.face.numpy()[touching], contact.place.numpy()[touching, :2], contact.normal.numpy()[touching]
    move = np.column_stack(
        [
            contact._relative_motion(touching, np.tile(axis, (len(touching), 1)), face, xi, solids.equation, solids.unknowns) @ mode
            for axis in unit
        ]
    )
    move -= (move * normal).sum(axis=1, keepdims=True) * normal
    slip = float(np.sqrt((move**2).sum(axis=1).mean()))
    gel = energy(gel_values)
    return gel, energy(bodies.numpy()) - gel, energy(plain) - energy(bodies.numpy()), energy(whole) - energy(plain), slip


def watch(solve):  # type: ignore[no-untyped-def]
    """Newton's `solve` that prints a row of the table after each state solved to the tolerance."""

    @functools.wraps(solve)
    def watched(newton: Newton, reach: float, tolerance: float | None = None, go: bool = True) -> NewtonReport:
        report = solve(newton, reach, tolerance, go)
        if not go or tolerance is not None or report.status is not SolveStatus.CONVERGED:
            return report
        newton.residual(FAR, freeze=True)
        plain, whole = newton.tangent(False).copy(), newton.tangent(True)  # which is good until the next
        negative, least, mode = weakest(newton, whole)
        bare = weakest(newton, plain)[1]
        contact = newton.contact
        touching = np.flatnonzero(contact.pressure.numpy() > 0.0)
        faces = len(np.unique(touching // contact.points)), len(np.unique(contact.face.numpy()[touching]))
        numbers = (
            f"{np.abs(newton.solids.displacement.numpy()[:, 2]).max():.2f}", str(report.iterations), str(negative),
            ", ".join(f"{1e5 * value:.1f}" for value in least), ", ".join(f"{1e5 * value:.1f}" for value in bare),
            f"{faces[0]}, {faces[1]}", *(f"{share:.1f}" for share in shares(newton, mode, whole, plain)),
        )  # fmt: skip
        print("| " + " | ".join(numbers) + " |", flush=True)
        return report

    return watched


def main(points: int, coarser: float, on_object: bool) -> None:
    sizing.OBJECT_COARSER = coarser
    strategy.ways = lambda *_: [strategy.Try(points, on_object=on_object)]
    Newton.solve = watch(Newton.solve)
    scene = build_scene({
        "gel": {"profile": "flat", "youngs_modulus_kpa": 50.0, "poissons_ratio": 0.499},
        "object": {"shape": "hemisphere", "radius_mm": 5.0, "youngs_modulus_kpa": 200.0, "poissons_ratio": 0.499},
        "contact": {"friction_coefficient": 0.0},
        "press": {"depth_mm": 1.0, "force_n": "none", "frames": 11, "symmetry": "none"},
        "fidelity": "balanced",
    })  # fmt: skip
    print("| approach [mm] | iterations | negative | smallest [1e-5] | without geometric | faces with points, those they find "
          "| gel | object | normal | geometric | slip |\n|---|---|---|---|---|---|---|---|---|---|---|")  # fmt: skip
    press = stages.press(scene, throw=False)
    print(f"{press.info['unknowns']} unknowns, {press.newton_iterations.sum()} iterations, {press.status.value}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=6)
    parser.add_argument("--coarser", type=float, default=OBJECT_COARSER)
    parser.add_argument("--on-object", action="store_true")
    options = parser.parse_args()
    main(options.points, options.coarser, options.on_object)
