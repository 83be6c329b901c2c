"""Warp kernels of a batch of presses: what Newton's method needs of each scene, with unknowns and nodes of one scene after the other."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"max_unroll": 1, "enable_backward": False})


@wp.kernel(enable_backward=False)
def move(
    start_displacement: wp.array(dtype=wp.vec3d), start_pressure: wp.array(dtype=wp.float64), step: wp.array(dtype=wp.float64),
    fraction: wp.array(dtype=wp.float64), equation: wp.array2d(dtype=wp.int32), nodes: wp.int32,
    displacement: wp.array(dtype=wp.vec3d), pressure: wp.array(dtype=wp.float64),
):  # fmt: skip
    """State = start + fraction · step, the fraction its scene's."""
    i = wp.tid()
    f = fraction[i // nodes]
    u = start_displacement[i]
    for c in range(3):
        if equation[i, c] >= 0:
            u[c] += f * step[equation[i, c]]
    displacement[i] = u
    p = start_pressure[i]
    if equation[i, 3] >= 0:
        p += f * step[equation[i, 3]]
    pressure[i] = p


@wp.kernel(enable_backward=False)
def positions(rest: wp.array(dtype=wp.vec3d), displacement: wp.array(dtype=wp.vec3d), x: wp.array(dtype=wp.vec3d)):
    i = wp.tid()
    x[i] = rest[i] + displacement[i]


@wp.kernel(enable_backward=False)
def balance(
    internal: wp.array(dtype=wp.vec3d), external: wp.array(dtype=wp.vec3d), volume: wp.array(dtype=wp.float64),
    vertex_volume: wp.array(dtype=wp.float64), equation: wp.array2d(dtype=wp.int32), nodes: wp.int32,
    residual: wp.array(dtype=wp.float64), sizes: wp.array2d(dtype=wp.float64),
):  # fmt: skip
    """The equations, and of each scene the largest unbalanced, contact and internal force and the largest volume error."""
    i = wp.tid()
    scene = i // nodes
    for c in range(3):
        force = internal[i][c] + external[i][c]
        if equation[i, c] >= 0:
            residual[equation[i, c]] = force
            wp.atomic_max(sizes, scene, 0, wp.abs(force))
            if not wp.isfinite(force):
                sizes[scene, 4] = wp.float64(1.0)
        wp.atomic_max(sizes, scene, 1, wp.abs(external[i][c]))
        wp.atomic_max(sizes, scene, 2, wp.abs(internal[i][c]))
    if equation[i, 3] >= 0:
        residual[equation[i, 3]] = volume[i]
        wp.atomic_max(sizes, scene, 3, wp.abs(volume[i] / vertex_volume[i]))
        if not wp.isfinite(volume[i]):
            sizes[scene, 4] = wp.float64(1.0)


@wp.kernel(enable_backward=False)
def least(jacobian: wp.array(dtype=wp.float64), elements: wp.int32, smallest: wp.array(dtype=wp.float64)):
    i = wp.tid()
    wp.atomic_min(smallest, i // elements, jacobian[i])


@wp.kernel(enable_backward=False)
def work(
    residual: wp.array(dtype=wp.float64), step: wp.array(dtype=wp.float64), equation: wp.array2d(dtype=wp.int32), nodes: wp.int32,
    total: wp.array(dtype=wp.float64),
):  # fmt: skip
    """R·step over the displacements of each scene; NaN where a step holds one."""
    i = wp.tid()
    sum = wp.float64(0.0)
    for c in range(3):
        e = equation[i, c]
        if e >= 0:
            sum += residual[e] * step[e]
    wp.atomic_add(total, i // nodes, sum)
