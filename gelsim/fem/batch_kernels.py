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


LANES = 128
"""Threads that share a scene's sums and maxima: each goes through every so many nodes, a second launch takes the lanes together."""


@wp.kernel(enable_backward=False)
def balance(
    internal: wp.array(dtype=wp.vec3d), external: wp.array(dtype=wp.vec3d), volume: wp.array(dtype=wp.float64),
    vertex_volume: wp.array(dtype=wp.float64), equation: wp.array2d(dtype=wp.int32), nodes: wp.int32,
    jacobian: wp.array(dtype=wp.float64), elements: wp.int32, lanes: wp.int32, step: wp.array(dtype=wp.float64),
    residual: wp.array(dtype=wp.float64), sizes: wp.array2d(dtype=wp.float64),
):  # fmt: skip
    """The equations; of each scene's lane the largest unbalanced, contact (on free nodes) and internal force, volume error, -det F, 1 where
    something is not finite, and the work of the forces on `step` (see `work`)."""
    lane = wp.tid()
    scene = lane // lanes
    unbalanced = wp.float64(0.0)
    contact = wp.float64(0.0)
    inside = wp.float64(0.0)
    error = wp.float64(0.0)
    broken = wp.float64(0.0)
    turned = wp.float64(-1.0e30)
    done = wp.float64(0.0)
    k = lane % lanes
    while k < nodes:
        i = scene * nodes + k
        for c in range(3):
            force = internal[i][c] + external[i][c]
            if equation[i, c] >= 0:
                residual[equation[i, c]] = force
                done += force * step[equation[i, c]]
                unbalanced = wp.max(unbalanced, wp.abs(force))
                contact = wp.max(contact, wp.abs(external[i][c]))
                if not wp.isfinite(force):
                    broken = wp.float64(1.0)
            inside = wp.max(inside, wp.abs(internal[i][c]))
        if equation[i, 3] >= 0:
            residual[equation[i, 3]] = volume[i]
            error = wp.max(error, wp.abs(volume[i] / vertex_volume[i]))
            if not wp.isfinite(volume[i]):
                broken = wp.float64(1.0)
        k += lanes
    e = lane % lanes
    while e < elements:
        turned = wp.max(turned, -jacobian[scene * elements + e])
        e += lanes
    sizes[0, lane] = unbalanced
    sizes[1, lane] = contact
    sizes[2, lane] = inside
    sizes[3, lane] = error
    sizes[4, lane] = turned
    sizes[5, lane] = broken
    sizes[6, lane] = done


@wp.kernel(enable_backward=False)
def largest(lanes: wp.int32, sizes: wp.array2d(dtype=wp.float64), of_scene: wp.array2d(dtype=wp.float64)):
    """The largest of a scene's lanes, row by row."""
    c, scene = wp.tid()
    most = sizes[c, scene * lanes]
    for lane in range(1, lanes):
        most = wp.max(most, sizes[c, scene * lanes + lane])
    of_scene[c, scene] = most


@wp.kernel(enable_backward=False)
def work(
    residual: wp.array(dtype=wp.float64), step: wp.array(dtype=wp.float64), equation: wp.array2d(dtype=wp.int32), nodes: wp.int32,
    lanes: wp.int32, total: wp.array(dtype=wp.float64),
):  # fmt: skip
    """R·step over the displacements of each scene's lane; NaN where a step holds one."""
    lane = wp.tid()
    sum = wp.float64(0.0)
    k = lane % lanes
    while k < nodes:
        i = (lane // lanes) * nodes + k
        for c in range(3):
            e = equation[i, c]
            if e >= 0:
                sum += residual[e] * step[e]
        k += lanes
    total[lane] = sum


@wp.kernel(enable_backward=False)
def stiffen(
    original: wp.array(dtype=wp.float64), diagonal: wp.array(dtype=wp.int32), entries: wp.int32, share: wp.array(dtype=wp.float64),
    values: wp.array(dtype=wp.float64),
):  # fmt: skip
    """Values of the original matrices with some of their diagonal greater by a share of itself, a share each scene."""
    scene, k = wp.tid()
    i = scene * entries + diagonal[k]
    values[i] = original[i] + share[scene] * wp.abs(original[i])
