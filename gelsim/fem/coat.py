"""The coat of the gel: a thin sheet that bears tension along its outer face and bends freely. There only where a gel has one.

Its energy is that of an incompressible neo-Hookean sheet of thickness t and Young's modulus E, of which it only knows the product E t:

    W = (E t/6) (tr C + 1/det C - 3)   per area at rest,   C = Fᵀ F,   F (3 x 2) from the face at rest to where it is,

so, with g a node's gradient along the face, a = F C⁻¹ g and n the normal, nodes i and j have

    f_i = (E t/3) (F g_i - a_i/det C),   K_ij = (E t/3) ((g_i·g_j) 1 + (2 a_i a_jᵀ + a_j a_iᵀ - (a_i·a_j) n nᵀ)/det C)

times the area, as a_i·a_j = g_i·C⁻¹ g_j. Faces of six nodes are four flat triangles each, edges of three nodes two straight pieces: what
the solid's own faces leave free between their nodes is held too. In the plane the stretches are λ₁ along the edge and λ₂ = r/R around the
axis, or 1, and tr C = λ₁² + λ₂², det C = (λ₁ λ₂)².

A bare neo-Hookean face creases where it is squeezed below 0.65 of its length (Hong, Zhao and Suo 2009), at any wavelength, so that the
finer the mesh the more ways it finds; a coat resists the shorter ones. Left out: its thickness, bending (without it wrinkles are as short
as the faces allow), viscosity, and that it might tear or come off. Solver units: kPa·mm, which is N/m.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gelsim.fem.pattern import PairPattern, add_block, pair_offset

wp.set_module_options({"max_unroll": 1, "enable_backward": False})

Array = NDArray[np.float64]


@wp.func
def stored(mu: wp.float64, trace: wp.float64, det: wp.float64) -> wp.float64:
    """W of a piece whose E t/3 times the area is mu, by tr C and det C."""
    return wp.float64(0.5) * mu * (trace - wp.float64(2.0) + (wp.float64(1.0) - det) / det)


@wp.func
def sheet(triangles: wp.array2d(dtype=wp.int32), toward: wp.array(dtype=wp.mat22d), rest: wp.array(dtype=wp.vec3d),
          displacement: wp.array(dtype=wp.vec3d), t: wp.int32):  # fmt: skip
    """F by its two columns; `toward` the inverse of a triangle's sides at rest, in its plane."""
    a = triangles[t, 0]
    b = triangles[t, 1]
    c = triangles[t, 2]
    along = rest[b] + displacement[b] - rest[a] - displacement[a]
    across = rest[c] + displacement[c] - rest[a] - displacement[a]
    d = toward[t]
    return along * d[0, 0] + across * d[1, 0], along * d[0, 1] + across * d[1, 1]


@wp.func
def duals(f1: wp.vec3d, f2: wp.vec3d):
    """det C and the columns of F C⁻¹."""
    c11 = wp.dot(f1, f1)
    c12 = wp.dot(f1, f2)
    c22 = wp.dot(f2, f2)
    det = c11 * c22 - c12 * c12
    return det, (f1 * c22 - f2 * c12) / det, (f2 * c11 - f1 * c12) / det


@wp.func
def corner_gradient(d: wp.mat22d, corner: wp.int32) -> wp.vec2d:
    if corner == 0:
        return wp.vec2d(-d[0, 0] - d[1, 0], -d[0, 1] - d[1, 1])
    return wp.vec2d(d[corner - 1, 0], d[corner - 1, 1])


@wp.kernel(enable_backward=False)
def sheet_force(
    triangles: wp.array2d(dtype=wp.int32), toward: wp.array(dtype=wp.mat22d), weights: wp.array(dtype=wp.float64),
    rest: wp.array(dtype=wp.vec3d), displacement: wp.array(dtype=wp.vec3d),
    force: wp.array(dtype=wp.vec3d), energy: wp.array(dtype=wp.float64),
):  # fmt: skip
    """Adds ∂W/∂u, and keeps each triangle's W."""
    t = wp.tid()
    f1, f2 = sheet(triangles, toward, rest, displacement, t)
    det, dual1, dual2 = duals(f1, f2)
    mu = weights[t]
    energy[t] = stored(mu, wp.dot(f1, f1) + wp.dot(f2, f2), det)
    p1 = mu * (f1 - dual1 / det)
    p2 = mu * (f2 - dual2 / det)
    for corner in range(3):
        g = corner_gradient(toward[t], corner)
        wp.atomic_add(force, triangles[t, corner], p1 * g[0] + p2 * g[1])


@wp.kernel(enable_backward=False)
def sheet_tangent(
    triangles: wp.array2d(dtype=wp.int32), toward: wp.array(dtype=wp.mat22d), weights: wp.array(dtype=wp.float64),
    rest: wp.array(dtype=wp.vec3d), displacement: wp.array(dtype=wp.vec3d),
    pattern: PairPattern, values: wp.array(dtype=wp.float64),
):  # fmt: skip
    """Adds ∂²W/∂u²."""
    t = wp.tid()
    f1, f2 = sheet(triangles, toward, rest, displacement, t)
    det, dual1, dual2 = duals(f1, f2)
    mu = weights[t]
    n = wp.normalize(wp.cross(f1, f2))
    normals = wp.outer(n, n)
    for i in range(3):
        gi = corner_gradient(toward[t], i)
        ai = dual1 * gi[0] + dual2 * gi[1]
        for j in range(i, 3):
            gj = corner_gradient(toward[t], j)
            aj = dual1 * gj[0] + dual2 * gj[1]
            d = wp.dot(gi, gj)
            block = wp.diag(wp.vec3d(d, d, d)) + (wp.float64(2.0) * wp.outer(ai, aj) + wp.outer(aj, ai) - wp.dot(ai, aj) * normals) / det
            a = triangles[t, i]
            b = triangles[t, j]
            add_block(pattern, values, a, b, pair_offset(pattern, a, b), mu * block)


@wp.func
def stretches(pieces: wp.array2d(dtype=wp.int32), lengths: wp.array(dtype=wp.float64), radii: wp.array(dtype=wp.float64),
              rest: wp.array(dtype=wp.vec3d), displacement: wp.array(dtype=wp.vec3d), t: wp.int32):  # fmt: skip
    """λ₁, λ₂ and the piece's direction; a piece of radius 0 at rest is one in plane strain."""
    a = pieces[t, 0]
    b = pieces[t, 1]
    way = rest[b] + displacement[b] - rest[a] - displacement[a]
    length = wp.length(way)
    around = wp.float64(1.0)
    if radii[t] > wp.float64(0.0):
        around += wp.float64(0.5) * (displacement[a][0] + displacement[b][0]) / radii[t]
    return length / lengths[t], around, way / length


@wp.kernel(enable_backward=False)
def edge_force(
    pieces: wp.array2d(dtype=wp.int32), lengths: wp.array(dtype=wp.float64), radii: wp.array(dtype=wp.float64),
    weights: wp.array(dtype=wp.float64), rest: wp.array(dtype=wp.vec3d),
    displacement: wp.array(dtype=wp.vec3d), force: wp.array(dtype=wp.vec3d), energy: wp.array(dtype=wp.float64),
):  # fmt: skip
    """`sheet_force` of pieces of an edge."""
    t = wp.tid()
    one, two, way = stretches(pieces, lengths, radii, rest, displacement, t)
    det = one * one * two * two
    mu = weights[t]
    energy[t] = stored(mu, one * one + two * two, det)
    along = way * (mu * (one - wp.float64(1.0) / (det * one)) / lengths[t])
    around = wp.float64(0.0)
    if radii[t] > wp.float64(0.0):
        around = wp.float64(0.5) * mu * (two - wp.float64(1.0) / (det * two)) / radii[t]
    out = wp.vec3d(around, wp.float64(0.0), wp.float64(0.0))
    wp.atomic_add(force, pieces[t, 0], out - along)
    wp.atomic_add(force, pieces[t, 1], out + along)


@wp.kernel(enable_backward=False)
def edge_tangent(
    pieces: wp.array2d(dtype=wp.int32), lengths: wp.array(dtype=wp.float64), radii: wp.array(dtype=wp.float64),
    weights: wp.array(dtype=wp.float64), rest: wp.array(dtype=wp.vec3d),
    displacement: wp.array(dtype=wp.vec3d), pattern: PairPattern, values: wp.array(dtype=wp.float64),
):  # fmt: skip
    """`sheet_tangent` of pieces of an edge."""
    t = wp.tid()
    one, two, way = stretches(pieces, lengths, radii, rest, displacement, t)
    det = one * one * two * two
    mu = weights[t]
    single = wp.float64(1.0)
    three = wp.float64(3.0)
    slope = mu * (one - single / (det * one))
    by_one = mu * (single + three / (det * one * one))
    mixed = mu * wp.float64(2.0) / (det * one * two)
    by_two = mu * (single + three / (det * two * two))
    turning = (wp.identity(n=3, dtype=wp.float64) - wp.outer(way, way)) * (slope / (one * lengths[t] * lengths[t]))
    half = wp.float64(0.0)
    if radii[t] > wp.float64(0.0):
        half = wp.float64(0.5) / radii[t]
    around = wp.vec3d(half, wp.float64(0.0), wp.float64(0.0))
    for i in range(2):
        si = wp.float64(2 * i - 1)
        along_i = way * (si / lengths[t])
        for j in range(i, 2):
            sj = wp.float64(2 * j - 1)
            along_j = way * (sj / lengths[t])
            block = by_one * wp.outer(along_i, along_j) + by_two * wp.outer(around, around) + (si * sj) * turning
            block += mixed * (wp.outer(along_i, around) + wp.outer(around, along_j))
            a = pieces[t, i]
            b = pieces[t, j]
            add_block(pattern, values, a, b, pair_offset(pattern, a, b), block)


class Coat:
    """The coat of some pieces of the gel's outer face.

    Args:
        kernels: `sheet_force` and `sheet_tangent`, or those of edges.
        pieces: (P, 3 or 2) of a numbering whose nodes lie at `rest` (N, 3) [mm].
        constants: What the kernels take of each piece; last E t/3 times its area [mN·mm].
    """

    def __init__(self, kernels: tuple, pieces: NDArray[np.integer], constants: Sequence[Array], rest: Array, device: str) -> None:
        self.kernels, self.device = kernels, device
        self.pieces, self.constants, self.rest = pieces, constants, rest
        self._inputs = [
            wp.array(pieces, dtype=wp.int32, device=device),
            *(wp.array(each, dtype=wp.mat22d if each.ndim == 3 else wp.float64, device=device) for each in constants),
            wp.array(rest, dtype=wp.vec3d, device=device),
        ]
        self._energy = wp.zeros(len(pieces), dtype=wp.float64, device=device)

    @staticmethod
    def join(coats: Sequence[Coat | None]) -> Coat | None:
        """Those of many solids with the same pieces as one, nodes of one after those of the other; None where none has one."""
        first = next((coat for coat in coats if coat is not None), None)
        if first is None:
            return None
        without = Coat(first.kernels, first.pieces, [*first.constants[:-1], 0.0 * first.constants[-1]], first.rest, first.device)
        each = [coat or without for coat in coats]
        pieces = np.concatenate([coat.pieces + number * len(coat.rest) for number, coat in enumerate(each)])
        constants = [np.concatenate(of_all) for of_all in zip(*(coat.constants for coat in each), strict=True)]
        return Coat(first.kernels, pieces, constants, np.concatenate([coat.rest for coat in each]), first.device)

    def energy(self) -> float:
        """W at the displacements of the last `add_force` [mN·mm]."""
        return float(self._energy.numpy().sum())

    def add_force(self, displacement: wp.array, force: wp.array) -> None:
        """Adds its forces [mN] at displacements (N, 3) [mm]."""
        wp.launch(self.kernels[0], len(self.pieces), [*self._inputs, displacement, force, self._energy], device=self.device)

    def add_tangent(self, displacement: wp.array, pairs: PairPattern, values: wp.array) -> None:
        """Adds ∂²W/∂u² to the matrix."""
        wp.launch(self.kernels[1], len(self.pieces), [*self._inputs, displacement, pairs, values], device=self.device)


def coat_of_faces(faces: NDArray[np.integer], rest: Array, stiffness: float, device: str) -> Coat:
    """Of faces of six nodes (F, 6), E t in N/m: triangles, the inverses of their sides at rest in their plane, and their areas."""
    triangles = np.concatenate([faces[:, corners] for corners in ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5))])
    first, second, third = np.moveaxis(rest[triangles], 1, 0)
    _, sides = np.linalg.qr(np.stack([second - first, third - first], axis=2))
    area = 0.5 * np.abs(sides[:, 0, 0] * sides[:, 1, 1])
    return Coat((sheet_force, sheet_tangent), triangles, [np.linalg.inv(sides), stiffness / 3 * area], rest, device)


def coat_of_edges(edges: NDArray[np.integer], rest: Array, stiffness: float, turned: bool) -> Coat:
    """Of edges of three nodes (E, 3) in the plane y = 0, per radian about the axis (`turned`) or per millimetre of depth."""
    pieces = np.concatenate([edges[:, ends] for ends in ((0, 2), (2, 1))])
    first, second = np.moveaxis(rest[pieces], 1, 0)
    length, radius = np.linalg.norm(second - first, axis=1), 0.5 * (first + second)[:, 0]
    weight = stiffness / 3 * length * (radius if turned else 1.0)
    return Coat((edge_force, edge_tangent), pieces, [length, radius if turned else 0.0 * radius, weight], rest, "cpu")
