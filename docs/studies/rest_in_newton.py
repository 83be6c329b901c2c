"""A ball falls on a gel in Newton and comes to rest: by which force, and what its steps cost beside the solver's own.

    python docs/studies/rest_in_newton.py                   # seconds; Newton's kernels are compiled once, a minute
    python docs/studies/rest_in_newton.py SolverMuJoCo      # which wants MuJoCo and mujoco-warp 3.17

Milliseconds are of the processor. `pip install "gelsim[newton]"`; on a machine with a GPU the model is on it, the gel is not.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from time import process_time

import newton
import numpy as np

from gelsim.live.newton import Pad, Touch, add_pad
from gelsim.scene.layers import build_scene

RADIUS, MASS, FALL = 0.004, 0.005, 3e-4
STEP = 0.002
SECONDS = 0.6
SOLVERS = "SolverXPBD", "SolverSemiImplicit", "SolverFeatherstone"
GEL = {
    "gel": {"profile": "flat", "youngs_modulus_kpa": 60.0, "size_mm": [16.0, 16.0]},
    "camera": {"field_mm": [12.0, 9.0]},
    "object": {"rigid": True},
}


def fall(name: str, period: float = 0.0) -> dict[str, float]:
    """Force of the gel over the weight, less 1, at most in the last 0.1 s; milliseconds a step, with the gel and by the solver alone."""
    scene = build_scene(GEL)
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -9.81))
    ball = builder.add_body(xform=((0.0, 0.0, RADIUS + FALL), (0.0, 0.0, 0.0, 1.0)), label="ball")
    cfg = newton.ModelBuilder.ShapeConfig(density=MASS / (4 / 3 * np.pi * RADIUS**3))
    builder.add_shape_sphere(ball, radius=RADIUS, cfg=cfg)
    add_pad(builder, -1, "pad", scene, against=ball)  # on the world; z, out of the gel, points up
    model = builder.finalize()
    solver, pad = getattr(newton.solvers, name)(model), Pad(model, "pad", "ball", scene)
    touch = Touch(solver, [pad], period)
    pipeline = newton.CollisionPipeline(model)
    contacts = pipeline.contacts()
    state, after, spare = model.state(), model.state(), model.state()
    solver.step(spare, after, None, contacts, STEP)  # compiles
    forces, spent, own = [], [], []
    for _ in range(round(SECONDS / STEP)):
        state.clear_forces()
        pipeline.collide(state, contacts)
        spare.assign(state)  # XPBD changes the state that it begins with
        began = process_time()
        solver.step(spare, after, None, contacts, STEP)
        between = process_time()
        touch.step(state, after, None, contacts, STEP)
        own.append(between - began)
        spent.append(process_time() - between)
        forces.append(pad.wrench[2])
        state, after = after, state
    off = np.array(forces[-50:]) / -(MASS * 9.81) - 1
    return {"off": float(np.abs(off).max()), "ms": 1e3 * float(np.mean(spent)), "own_ms": 1e3 * float(np.mean(own))}


def main(names: Sequence[str] = SOLVERS) -> dict[str, dict[str, float]]:
    """One row for each solver and period."""
    found = {}
    print("solver and period             force off    a step [ms]    Newton's own [ms]")
    for name in names:
        for period in (0.0, 0.02):
            row = found[f"{name}, {1e3 * period:2.0f} ms"] = fall(name, period)
            print(f"{name}, {1e3 * period:2.0f} ms".ljust(32), f"{row['off']:.2%}    {row['ms']:8.2f}         {row['own_ms']:8.2f}")
    return found


if __name__ == "__main__":
    main(sys.argv[1:] or SOLVERS)
