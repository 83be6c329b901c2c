"""The light of one picture, traced in parallel on Mitsuba's vectorised variants (LLVM, CUDA) and differentiable there.

A pixel is the mean over `spp` paths of the radiance L along its ray in the gel (`optics.camera`):

    L = Σ_lights ∫ f cos θ V L_e cos θ' / r² dA  +  ∫ f cos θ L_in dω.

*Direct.* Every light is sampled once a path, evenly over the directions in which it is seen (Ureña, Fajardo, King 2013; by area, lamps
within millimetres of the coat speckle), its random numbers stratified over the pixel: no choice among lights, no colour noise. Its light is
counted as if nothing stood in the way; each path asks one light in turn whether something does, and what is hidden is taken off, times the
number of lights that share the asking (a difference estimator: without bias, exact where all is seen). A light within the window is also
seen in the window's outer face, by its mirror image times Fresnel's reflectance.
*Indirect.* What the membrane sends to itself, straight or by way of the window's outer face, is the radiance of a diffuse surface, known
at its vertices: L = ρ E / π, E from the direct light and two rounds of gathering (a third would add albedo³ of what returns, below 0.5 %).
What of it arrives is smooth and is gathered at the vertices that the camera sees: straight along cosine distributed rays; by way of the
window from places on the gel, without search. Paths interpolate it. So no path goes on after its first point, and no rare bright one is
left: flakes that the camera does not see scatter like pigment of their albedo. `bounces` > 0 follows paths that long instead, with the
whole coat at every vertex and the window by chance: slow and noisy, for tests and studies.
*Window.* The outer face reflects by Fresnel's equations and lets the rest go (housing and camera are black). The way through gel and
window is exact for what the coat scatters; for the mirror images of lights the window counts as gel of its apparent thickness. The window
is as wide as the gel.

Random numbers are the same for every membrane, so a video does not flicker. Derivatives see neither edges of shadows nor where an
indirect ray meets the membrane. Left out: shadows between the window's face and a light's mirror image, polarisation, housing.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.optics.camera import gel_ray, make_lens, sideways, solve_slope
from gelsim.optics.coating import flake_albedo, grain_pattern, marker_coverage
from gelsim.optics.lighting import mirror_height, mirrored_light
from gelsim.optics.scene_dict import mesh_arrays, moving_arrays
from gelsim.optics.spectra import light_colour
from gelsim.optics.stratified import grid_of, path_groups, path_sets
from gelsim.results import Membrane
from gelsim.scene.definition import Scene

OFFSET = 2e-3
"""Of a ray's start from the surface [mm], along the normal: Mitsuba's own is of this size here."""
GATHER_ROUNDS = 2
POOL_CELLS = 32
"""Along a side of the gel: what the window returns has travelled centimetres, finer detail is lost in it."""
VERTEX_GATHER_RAYS = 4
"""From a vertex in each round, and one sample on each light: what is gathered from is an average over many vertices."""
SEEN_GATHER_RAYS = (4, 64)
PATHS_A_RAY = 4
"""From a vertex that the camera sees: a ray for every so many paths that end about it, within these."""
PATHS_AT_ONCE = 2**26
"""A picture of more is drawn in rows, one part after the other: 12 bytes a path."""
FAR_SR = 1e-2
"""A light that is seen as smaller is sampled by area, which is as good there: a solid angle in single precision is off by 1e-6."""
GOLDEN = 0.6180339887
"""Steps of this share of a circle cover it evenly."""


class Tracer:
    """Camera, lights and coat of a scene on the device, ready to draw many membranes."""

    def __init__(self, mi: ModuleType, scene: Scene, spp: int, bounces: int = 0) -> None:
        import drjit as dr

        self.mi, self.dr, self.scene, self.bounces = mi, dr, scene, bounces
        self.values = self._values()
        coverage = marker_coverage(scene)
        self._coverage = self._texture(coverage) if coverage.any() else None
        grain = grain_pattern(scene)
        self._grain = self._texture(grain) if grain.size > 1 else None
        self._mesh: Any = None
        self._traced: Any = None
        self._cells: tuple[Any, Any, int] | None = None
        self.spp = math.prod(grid_of(spp))
        # Long paths need more numbers than the sets have.
        self._sampler = mi.load_dict({"type": "multijitter", "sample_count": self.spp}) if bounces else None
        sources = sum(2 if mirrored_light(scene, light) else 1 for light in scene.lights.lights)
        # Of a group's paths there is at least one in every grid that has as many columns.
        self._turns = 1 if bounces else max(min(sources, grid_of(spp)[0]), 1)
        groups = path_groups(spp, self._turns)
        self._turn = mi.UInt32(np.repeat(np.arange(self._turns), groups).astype(np.uint32))
        self._times = mi.Float(np.repeat(self.spp / groups, groups).astype(np.float32))
        self._sets: Any = None
        self._lots: tuple[int, Any] | None = None

    def _values(self) -> dict[str, Any]:
        """The numbers of lights, coat and camera, by their names in the scene file; what derivatives are taken by."""
        mi, scene = self.mi, self.scene
        values: dict[str, Any] = {}
        for i, light in enumerate(scene.lights.lights):
            values |= {
                f"lights.{i}.position_mm": mi.Point3f(light.position_mm),
                f"lights.{i}.direction": mi.Vector3f(light.direction),
                f"lights.{i}.size_mm": mi.Vector2f(light.size_mm),
                f"lights.{i}.rgb": mi.Color3f(light_colour(light)),
                f"lights.{i}.power": mi.Float(light.power),
            }
        values["coating.albedo"] = mi.Color3f(scene.coating.albedo)
        values["coating.specular"] = mi.Float(scene.coating.specular)
        values["coating.roughness"] = mi.Float(scene.coating.roughness)
        values["coating.flake_reflectance"] = mi.Color3f(scene.coating.flake_reflectance)
        values["camera.distance_mm"] = mi.Float(scene.camera.distance_mm)
        values["camera.offset_mm"] = mi.Vector2f(scene.camera.offset_mm)
        # Not literals: kernels are then shared between scenes.
        self.dr.make_opaque(values)
        return values

    def _texture(self, values: NDArray[np.float32]) -> Any:
        return self.mi.Texture2f(self.mi.TensorXf(np.ascontiguousarray(values[..., None])), use_accel=False)

    # ---- geometry ----

    def place(self, membrane: Membrane) -> None:
        """Makes the membrane the surface that is drawn."""
        mi, dr = self.mi, self.dr
        # All that the host has to do comes before the update, which waits for the frame that is being drawn.
        moved = moving_arrays(membrane)
        seen = np.flatnonzero(self._in_field(moved["vertex_positions"])).astype(np.uint32)
        if self._mesh is None or self._mesh.vertex_count() != len(membrane.positions):
            arrays = mesh_arrays(membrane)
            mesh = mi.Mesh("membrane", len(membrane.positions), len(membrane.faces), has_vertex_normals=True, has_vertex_texcoords=True)
            parameters = mi.traverse(mesh)
            for name, values in arrays.items():
                parameters[name] = values.ravel()
            parameters.update()
            pooled = self.scene.lights.window_reflection and self.scene.render.mode != "direct"
            self._cells = self._pool_cells(arrays["vertex_texcoords"]) if pooled else None
            self._uv = mi.Point2f(np.ascontiguousarray(arrays["vertex_texcoords"].T))
            self._mesh, self._traced = mesh, mi.load_dict({"type": "scene", "membrane": mesh})
        else:
            parameters = mi.traverse(self._traced)
            for name, values in moved.items():
                parameters[f"membrane.{name}"] = mi.Float(values.ravel())
            parameters.update()
        self._points = dr.unravel(mi.Point3f, self._mesh.vertex_positions_buffer())
        self._normals = dr.unravel(mi.Vector3f, self._mesh.vertex_normals_buffer())
        self._seen = mi.UInt32(seen)
        dr.eval(self._points, self._normals)

    def place_as(self, other: Tracer) -> None:
        """Draws the surface that another tracer of this gel and camera has placed, until that places one."""
        self._mesh, self._traced, self._cells, self._uv = other._mesh, other._traced, other._cells, other._uv
        self._points, self._normals, self._seen = other._points, other._normals, other._seen

    def _pool_cells(self, uv: NDArray[np.float32]) -> tuple[Any, Any, int]:
        """Vertices of each cell of the pool, with their shares of its mean, in rows of equal length, filled up with shares of 0."""
        column, row = np.minimum((uv * POOL_CELLS).astype(int), POOL_CELLS - 1).T
        cell = column + row * POOL_CELLS
        order, counts = np.argsort(cell, kind="stable"), np.bincount(cell, minlength=POOL_CELLS**2)
        longest = int(counts.max())
        members, share = np.zeros((POOL_CELLS**2, longest), np.uint32), np.zeros((POOL_CELLS**2, longest), np.float32)
        place = np.arange(len(cell)) - np.repeat(np.cumsum(counts) - counts, counts)
        members[cell[order], place], share[cell[order], place] = order, 1 / counts[cell[order]]
        return self.mi.UInt32(members.ravel()), self.mi.Float(share.ravel()), longest

    def _in_field(self, points: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Whether points [mm] are in the box that the camera's outermost rays span over their heights, or within two vertices of it."""
        width, height = self.scene.render.resolution
        rim = np.concatenate(
            [
                [[x, y] for x in np.linspace(0, width, 9) for y in (0, height)],
                [[x, y] for x in (0, width) for y in np.linspace(0, height, 9)],
            ]
        )
        origin, direction, _ = gel_ray(make_lens(self.scene, 1.0), rim[:, 0], rim[:, 1])
        x, y, z = np.ascontiguousarray(points.T)
        inside = np.ones(len(points), bool)
        for axis, places in enumerate((x, y)):
            margin = 2 * np.ptp(places) / np.sqrt(len(points))
            ends = [origin[axis] + direction[axis] / direction[2] * (level - origin[2]) for level in (z.min(), z.max())]
            inside &= (places > np.min(ends) - margin) & (places < np.max(ends) + margin)
        return inside

    # ---- coat ----

    def _coat(self, uv: Any) -> tuple[Any, Any]:
        """Grain and marker coverage at material coordinates."""
        one = self.mi.Float(1.0)
        grain = self._grain.eval(uv)[0] if self._grain else one
        return grain, self._coverage.eval(uv)[0] if self._coverage else 0.0 * one

    def _albedo(self, uv: Any) -> Any:
        """Of the coat where the camera does not look: all that it scatters, as if by pigment."""
        mi, values = self.mi, self.values
        grain, coverage = self._coat(uv)
        share = values["coating.specular"]
        total = (1 - share) * values["coating.albedo"]
        if self.scene.coating.specular > 0:
            total += share * flake_albedo(self.scene.coating.roughness) * values["coating.flake_reflectance"]
        return (1 - coverage) * self.dr.clip(grain * total, 0, 1) + coverage * mi.Color3f(self.scene.markers.albedo)

    def _reflectances(self, coat: tuple[Any, Any]) -> tuple[Any, Any]:
        """What multiplies the two numbers of `_lobes`: colours of pigment and paint, and of flakes."""
        mi, dr, values = self.mi, self.dr, self.values
        grain, coverage = coat
        share = values["coating.specular"]
        pigment = (1 - share) * dr.clip(grain * values["coating.albedo"], 0, 1) / dr.pi
        flakes = (1 - coverage) * share * dr.clip(grain * values["coating.flake_reflectance"], 0, 1)
        return (1 - coverage) * pigment + coverage * mi.Color3f(self.scene.markers.albedo / dr.pi), flakes

    def _lobes(self, normal: Any, to_eye: Any, to_light: Any) -> tuple[Any, Any]:
        """cos θ, and that times a white flake's reflection, for unit directions away from the surface; 0 where unlit or unseen."""
        mi, dr = self.mi, self.dr
        cos_eye, cos_light = dr.dot(normal, to_eye), dr.dot(normal, to_light)
        cosine = dr.select((cos_eye > 0) & (cos_light > 0), cos_light, 0.0)
        if self.scene.coating.specular == 0:
            return cosine, mi.Float(0.0)
        alpha = self.values["coating.roughness"]
        half = dr.normalize(to_eye + to_light)
        slope = dr.square(dr.dot(normal, half)) * (dr.square(alpha) - 1) + 1
        facets = dr.square(alpha) / (dr.pi * dr.square(slope))

        # G1/(2 cos) of Smith's shadowing, each.
        def seen(cosine: Any) -> Any:
            return 1 / (cosine + dr.sqrt(dr.square(alpha) + (1 - dr.square(alpha)) * dr.square(cosine)))

        return cosine, cosine * facets * seen(dr.maximum(cos_eye, 1e-4)) * seen(dr.maximum(cos_light, 1e-4))

    def _reflect(self, coat: tuple[Any, Any], normal: Any, to_eye: Any, to_light: Any) -> Any:
        """f cos θ for unit directions away from the surface."""
        return self._weighted(self._reflectances(coat), self._lobes(normal, to_eye, to_light))

    def _weighted(self, reflectances: tuple[Any, Any], received: tuple[Any, Any]) -> Any:
        """Radiance of what `_lobes` received."""
        total = reflectances[0] * received[0]
        return total if self.scene.coating.specular == 0 else total + reflectances[1] * received[1]

    # ---- light ----

    def _window_reflectance(self, cosine: Any) -> Any:
        """Of the window's outer face for light that is `cosine` steep in the gel."""
        dr, lights = self.dr, self.scene.lights
        sine_squared = (lights.gel_ior / lights.window_ior) ** 2 * (1 - dr.square(cosine))
        return self.mi.fresnel(dr.sqrt(dr.maximum(1 - sine_squared, 0)), self.mi.Float(1 / lights.window_ior))[0]

    def _illuminate(self, point: Any, normal: Any, receive: Any, sample: Any, turn: Any = 0, times: Any = 1) -> tuple[Any, ...]:
        """Σ over the lights of each number of `receive(direction)` times irradiance per cosine.

        Args:
            sample: A function that gives a point of the unit square.
            turn, times: Of as many lights as there are turns one is asked for its visibility, and what is hidden counts `times` as much.
        """
        mi, dr, values, scene = self.mi, self.dr, self.values, self.scene
        start = point + OFFSET * normal
        sources = []
        face = mirror_height(scene)
        for i, light in enumerate(scene.lights.lights):
            facing = dr.normalize(values[f"lights.{i}.direction"])
            upright = light.direction[0] == 0 and light.direction[1] == 0
            along = mi.Vector3f(1, 0, 0) if upright else dr.normalize(dr.cross(mi.Vector3f(0, 0, 1), facing))
            size = values[f"lights.{i}.size_mm"]
            # Φ is spread over the area as Φ (m + 1)/(2π A) cos^(m-1); A cancels against the density of places spread evenly over it.
            flux = values[f"lights.{i}.rgb"] * values[f"lights.{i}.power"] * ((light.lobe + 1) / (2 * dr.pi))
            middle, up = values[f"lights.{i}.position_mm"], dr.cross(facing, along)
            still = dr.detach
            where, denser = self._on_rectangle(still(middle - start), still(along), still(up), still(facing), still(size), sample())
            source, flux = middle + along * (where.x * size.x) + up * (where.y * size.y), flux * denser
            sources.append((source, facing, flux, light.lobe))
            if mirrored_light(scene, light):
                image = mi.Point3f(source.x, source.y, 2 * face - source.z)
                way = image - start
                cosine = -way.z / dr.norm(way)
                meets = start + way * ((face - start.z) / way.z)
                weight = dr.select(self._on_window(meets), self._window_reflectance(cosine), 0.0)
                sources.append((image, mi.Vector3f(facing.x, facing.y, -facing.z), flux * weight, light.lobe))
        total: tuple[Any, ...] = ()
        turns = 1 if isinstance(turn, int) else self._turns
        for first in range(0, len(sources), turns):
            asked: tuple[Any, Any, Any] | None = None
            for i, source in enumerate(sources[first : first + turns]):
                direction, distance, light = self._from(start, normal, *source, receive)
                total = tuple(old + new for old, new in zip(total, light, strict=True)) if total else light
                if asked is None:
                    # Where this group has no light for a lane's turn, it asks for nothing.
                    mine = (turn == 0) if turns > 1 else True
                    asked = direction, distance, tuple(dr.select(mine, part, 0.0) for part in light)
                else:
                    mine, parts = turn == i, zip(asked[2], light, strict=True)
                    asked = (
                        dr.select(mine, direction, asked[0]),
                        dr.select(mine, distance, asked[1]),
                        tuple(dr.select(mine, new, old) for old, new in parts),
                    )
            assert asked is not None
            ray = mi.Ray3f(dr.detach(start), dr.detach(asked[0]))
            ray.maxt = dr.detach(asked[1]) * (1 - 1e-4)
            hidden = self._traced.ray_test(ray, dr.any(dr.detach(asked[2][0]) > 0))
            total = tuple(old - dr.select(hidden, times * part, 0.0) for old, part in zip(total, asked[2], strict=True))
        return total

    def _on_rectangle(self, middle: Any, along: Any, up: Any, facing: Any, size: Any, sample: Any) -> tuple[Any, Any]:
        """A place on a rectangle, from -1/2 to 1/2 along its sides, evenly spread over the directions in which the origin sees it, and the
        density of places that are spread evenly over its area over that of these. In the names of Ureña et al. (2013), section 4.

        Args:
            along, up, facing: Unit vectors of its sides and its normal.
            sample: A point of the unit square.
        """
        mi, dr = self.mi, self.dr
        x0, y0, z = (dr.dot(middle, axis) for axis in (along, up, facing))
        x0, y0 = x0 - size.x / 2, y0 - size.y / 2
        x1, y1 = x0 + size.x, y0 + size.y
        z = dr.minimum(-abs(z), -1e-4)  # both sides are alike; in the rectangle's own plane nothing of it is seen
        # Of the planes through an edge and the origin: their normals' part along the rectangle's, and the angles between neighbours.
        b = [-y0 / dr.sqrt(y0 * y0 + z * z), x1 / dr.sqrt(x1 * x1 + z * z), y1 / dr.sqrt(y1 * y1 + z * z), -x0 / dr.sqrt(x0 * x0 + z * z)]
        g = [dr.acos(dr.clip(-one * next_one, -1, 1)) for one, next_one in zip(b, [*b[1:], b[0]], strict=True)]
        solid = g[0] + g[1] + g[2] + g[3] - 2 * dr.pi
        far = solid < FAR_SR
        turn = sample.x * solid + (2 * dr.pi - g[2] - g[3])
        slope = (dr.cos(turn) * b[0] - b[2]) / dr.sin(turn)
        cosine = dr.clip(dr.copysign(1 / dr.sqrt(slope * slope + b[0] * b[0]), slope), -1, 1)
        x = dr.clip(-cosine * z / dr.sqrt(dr.maximum(1 - cosine * cosine, 1e-9)), x0, x1)
        reach = dr.sqrt(x * x + z * z)
        low, high = y0 / dr.sqrt(reach * reach + y0 * y0), y1 / dr.sqrt(reach * reach + y1 * y1)
        height = low + sample.y * (high - low)
        y = dr.clip(height * reach / dr.sqrt(dr.maximum(1 - height * height, 1e-9)), y0, y1)
        x, y = dr.select(far, x0 + sample.x * size.x, x), dr.select(far, y0 + sample.y * size.y, y)
        squared = x * x + y * y + z * z
        denser = dr.select(far, 1.0, solid * squared * dr.sqrt(squared) / (size.x * size.y * -z))
        return mi.Point2f((x - x0) / size.x - 0.5, (y - y0) / size.y - 0.5), denser

    def _from(self, start: Any, normal: Any, source: Any, facing: Any, flux: Any, lobe: float, receive: Any) -> tuple[Any, Any, Any]:
        """Direction of a place on a light, its distance, and what is received from it if nothing stands in the way."""
        dr = self.dr
        way = source - start
        distance = dr.norm(way)
        direction = way / distance
        cosine = dr.maximum(-dr.dot(direction, facing), 0)
        emitted = cosine if lobe == 1.0 else dr.power(dr.maximum(cosine, 1e-6), lobe)
        strength = dr.select((cosine > 0) & (dr.dot(normal, direction) > 0), emitted / dr.square(distance), 0.0)
        light = flux * strength
        return direction, distance, tuple(light * part for part in receive(direction))

    def _on_window(self, point: Any) -> Any:
        width, height = self.scene.gel.size_mm
        return (abs(point.x) < width / 2) & (abs(point.y) < height / 2)

    def _next(self, start: Any, direction: Any, active: Any = True) -> tuple[Any, Any, Any]:
        """The ray that next meets the membrane, by way of the window's face if need be; what meets; and the share that gets there."""
        mi, dr, scene = self.mi, self.dr, self.scene
        ray = mi.Ray3f(dr.detach(start), dr.detach(direction))
        met = self._traced.ray_intersect_preliminary(ray, False, active=active)
        hit = met.is_valid()
        if not scene.lights.window_reflection:
            return ray, met, dr.select(hit, mi.Float(1.0), 0.0)
        lights = scene.lights
        down = -ray.d.z
        slope = mi.Vector2f(ray.d.x, ray.d.y) / dr.maximum(down, 1e-6)
        squared = dr.squared_norm(slope)
        # Snell between gel and window, by slopes.
        ratio = (lights.gel_ior / lights.window_ior) ** 2
        sine_squared = dr.minimum(ratio * squared / (1 + squared), 0.999)
        in_window = dr.sqrt(sine_squared / ((1 - sine_squared) * dr.maximum(squared, 1e-12)))
        place = mi.Point2f(ray.o.x, ray.o.y) + slope * (ray.o.z + scene.gel.thickness_mm)
        middle = place + slope * (in_window * lights.window_thickness_mm)
        again = active & ~hit & (down > 1e-4) & self._on_window(middle)
        place = place + slope * (2 * in_window * lights.window_thickness_mm)
        back = mi.Ray3f(mi.Point3f(place.x, place.y, -scene.gel.thickness_mm), mi.Vector3f(ray.d.x, ray.d.y, down))
        returned = self._traced.ray_intersect_preliminary(back, False, active=again)
        again &= returned.is_valid()
        share = dr.select(hit, 1.0, dr.select(again, self._window_reflectance(down), 0.0))
        ray.o, ray.d = dr.select(hit, ray.o, back.o), dr.select(hit, ray.d, back.d)
        return ray, dr.select(hit, met, returned), share

    def _gathered(self, met: Any, values: Any, active: Any) -> Any:
        """Colours that are known at the vertices (a flat array), interpolated where rays met the membrane."""
        mi, dr = self.mi, self.dr
        corner = dr.gather(mi.Vector3u, self._mesh.faces_buffer(), met.prim_index, active)
        first, second = met.prim_uv.x, met.prim_uv.y
        total = (1 - first - second) * dr.gather(mi.Color3f, values, corner.x, active)
        total += first * dr.gather(mi.Color3f, values, corner.y, active) + second * dr.gather(mi.Color3f, values, corner.z, active)
        return dr.select(active, total, 0.0)

    def _glow(self, seed: int) -> tuple[Any, Any]:
        """Radiance of the membrane as a diffuse surface: at its vertices, a flat array of RGB, and pooled for the window."""
        mi, dr = self.mi, self.dr
        albedo = self._albedo(self._uv) / dr.pi
        random = mi.PCG32(size=dr.width(self._points), initstate=seed)

        def cosine(way: Any) -> tuple[Any]:
            return (dr.maximum(dr.dot(self._normals, way), 0),)

        (direct,) = self._illuminate(self._points, self._normals, cosine, lambda: mi.Point2f(random.next_float32(), random.next_float32()))
        dr.eval(direct)
        glow = albedo * direct
        for turn in range(GATHER_ROUNDS):
            dr.eval(glow)
            (received,) = self._received(dr.ravel(glow), self._pool(glow), VERTEX_GATHER_RAYS, (seed, turn))
            glow = albedo * (direct + received)
        dr.eval(glow)
        return dr.ravel(glow), self._pool(glow)

    def _received(self, glow: Any, pool: Any, rays: int, seeds: tuple[int, int], lens: Any = None) -> tuple[Any, ...]:
        """What vertices receive of the membrane's own light: irradiance; with a camera also what flakes make of it, at what it sees."""
        mi, dr = self.mi, self.dr
        count = dr.width(self._points)
        chosen = None if lens is None else self._seen
        index = dr.arange(mi.UInt32, (count if chosen is None else dr.width(chosen)) * rays)
        number, ray = index // rays, mi.Float(index % rays)
        vertex = number if chosen is None else dr.gather(mi.UInt32, chosen, number)
        # One lattice for all, shifted by vertex.
        shift = mi.PCG32(size=dr.width(index) // rays, initstate=seeds[0], initseq=seeds[1] + 1)
        shifts = [dr.gather(mi.Float, dr.detach(value), number) for value in self._evaluated(shift.next_float32() for _ in range(4))]
        even, golden = (ray + shifts[0]) / rays, ray * GOLDEN
        square = mi.Point2f(even, golden + shifts[1] - dr.floor(golden + shifts[1]))
        where = mi.Point2f((ray + shifts[2]) / rays, golden + shifts[3] - dr.floor(golden + shifts[3]))
        point = dr.gather(mi.Point3f, dr.ravel(self._points), vertex)
        frame = mi.Frame3f(dr.gather(mi.Vector3f, dr.ravel(self._normals), vertex))
        to_eye = None
        if chosen is not None:
            # Once a vertex, not once a ray.
            there = self._to_eye(lens, dr.gather(mi.Point3f, dr.ravel(self._points), chosen))
            to_eye = dr.gather(mi.Vector3f, dr.ravel(there), number)

        def receive(way: Any) -> tuple[Any, ...]:
            if to_eye is None:
                return (dr.maximum(dr.dot(frame.n, way), 0),)
            return self._lobes(frame.n, to_eye, way)

        local = self._cosine_hemisphere(square)
        onward = frame.to_world(local)
        met = self._traced.ray_intersect_preliminary(mi.Ray3f(point + OFFSET * frame.n, onward), False)
        near = self._gathered(met, glow, met.is_valid()) * (dr.pi / dr.maximum(local.z, 1e-6))
        total = tuple(near * part for part in receive(onward))
        if pool is not None:
            returned = self._returned(point, frame.n, receive, where, pool)
            total = tuple(straight + back for straight, back in zip(total, returned, strict=True))
        # Scheduled together, or each channel's sum would trace all rays anew.
        dr.schedule(total)
        means = tuple(mi.Color3f(*(dr.block_sum(channel, rays) / rays for channel in part)) for part in total)
        if chosen is None:
            return means
        spread = []
        for part in means:
            whole = dr.zeros(mi.Float, 3 * count)
            dr.scatter(whole, part, chosen)
            spread.append(whole)
        return tuple(spread)

    def _evaluated(self, values: Any) -> list[Any]:
        values = list(values)
        self.dr.eval(values)
        return values

    def _to_eye(self, lens: Any, point: Any) -> Any:
        """Unit directions in the gel from points toward the pinhole."""
        mi, dr = self.mi, self.dr
        x, y = point.x - lens.foot[0], point.y - lens.foot[1]
        reach = dr.maximum(dr.sqrt(dr.square(x) + dr.square(y)), 1e-4)
        window, (gel, gel_index) = lens.layers
        slope = solve_slope(reach, lens.air, (window, (gel + point.z, gel_index)), dr.sqrt)
        in_gel = slope / dr.sqrt(gel_index**2 + (gel_index**2 - 1) * dr.square(slope))
        return dr.normalize(mi.Vector3f(-x / reach * in_gel, -y / reach * in_gel, -1))

    def _pool(self, glow: Any) -> Any:
        """What the window mirrors: `glow`, height and its slopes on a coarse grid of the gel, a texture of 6 channels; or None."""
        mi, dr = self.mi, self.dr
        if self._cells is None:
            return None
        members, share, longest = self._cells
        normal = self._normals
        sums = []
        for values in (*glow, self._points.z, -normal.x / normal.z, -normal.y / normal.z):
            # In a fixed order, so that the same membrane gives the same bits.
            sums.append(dr.block_sum(dr.gather(mi.Float, values, members) * share, longest))
        cell = dr.arange(mi.UInt32, POOL_CELLS**2) * 6
        means = dr.zeros(mi.Float, POOL_CELLS**2 * 6)
        for channel, values in enumerate(sums):
            dr.scatter(means, values, cell + channel)
        return mi.Texture2f(mi.TensorXf(means, (POOL_CELLS, POOL_CELLS, 6)), use_accel=False)

    def _returned(self, point: Any, normal: Any, receive: Any, where: Any, pool: Any) -> tuple[Any, ...]:
        """Light that the membrane sends to the window's outer face and that comes back, from a place of the gel: `where` in its square.

        The way between two points, by Snell through the window and back, has a slope s found by Newton's method from the paraxial one on.
        An area dA is seen under the solid angle s (1 − s dz/dr) / ((1 + s²)^(3/2) r ∂r/∂s) dA, dz/dr the slope of the gel there. A ray
        tells whether the membrane is in the way before the window.
        """
        mi, dr, lights = self.mi, self.dr, self.scene.lights
        width, height = self.scene.gel.size_mm
        depth = self.scene.gel.thickness_mm
        ratio = lights.window_ior / lights.gel_ior
        window = ((2 * lights.window_thickness_mm, ratio),)
        red, green, blue, level, slope_x, slope_y = pool.eval(where)
        apart = (where - 0.5) * mi.Vector2f(width, height) - mi.Point2f(point.x, point.y)
        reach = dr.maximum(dr.norm(apart), 1e-3)
        gel = point.z + level + 2 * depth
        slope = reach / (gel + 2 * lights.window_thickness_mm / ratio)
        for _ in range(3):
            value, rate = sideways(slope, gel, window, dr.sqrt)
            slope += (reach - value) / rate
        _, rate = sideways(slope, gel, window, dr.sqrt)
        cosine = dr.rsqrt(1 + dr.square(slope))
        direction = mi.Vector3f(apart.x / reach * slope * cosine, apart.y / reach * slope * cosine, -cosine)
        tilt = 1 - slope * (apart.x * slope_x + apart.y * slope_y) / reach
        angle = dr.maximum(tilt, 0) * slope * cosine**3 / (reach * rate) * (width * height)
        ray = mi.Ray3f(dr.detach(point + OFFSET * normal), dr.detach(direction))
        ray.maxt = dr.detach(point.z + depth) / dr.maximum(dr.detach(cosine), 1e-3)
        light = mi.Color3f(red, green, blue) * dr.select(self._traced.ray_test(ray), 0.0, self._window_reflectance(cosine) * angle)
        return tuple(light * part for part in receive(direction))

    def _cosine_hemisphere(self, square: Any) -> Any:
        """Cosine distributed directions, the square's first side the angle with the normal: it decides what the window returns."""
        dr, turn = self.dr, 2 * self.dr.pi * square.y
        radius = dr.sqrt(square.x)
        return self.mi.Vector3f(radius * dr.cos(turn), radius * dr.sin(turn), dr.sqrt(dr.maximum(1 - square.x, 0)))

    # ---- picture ----

    def picture(self, seed: int) -> Any:
        """Radiance of the placed membrane, a tensor (H, W, 3)."""
        mi, dr, scene = self.mi, self.dr, self.scene
        width, height = scene.render.resolution
        indirect = scene.render.mode != "direct"
        lens = make_lens(scene, 1.0, self.values["camera.distance_mm"], self.values["camera.offset_mm"], dr.sqrt)
        received = None
        if indirect and not self.bounces:
            rays = width * height * self.spp // (PATHS_A_RAY * max(dr.width(self._seen), 1))
            received = self._received(*self._glow(seed), int(np.clip(rays, *SEEN_GATHER_RAYS)), (seed, GATHER_ROUNDS), lens)
            dr.eval(received)
        rows = height if self.bounces else max(PATHS_AT_ONCE // (width * self.spp), 1)
        parts = [self._pixels(seed, lens, received, first * width, min(rows, height - first) * width) for first in range(0, height, rows)]
        return mi.TensorXf(parts[0] if len(parts) == 1 else dr.concat(parts), (height, width, 3))

    def _pixels(self, seed: int, lens: Any, received: Any, first: int, count: int) -> Any:
        """Radiance of `count` pixels from the first on, flat."""
        mi, dr, scene = self.mi, self.dr, self.scene
        width = scene.render.resolution[0]
        indirect = scene.render.mode != "direct"
        index = dr.arange(mi.UInt32, count * self.spp)
        # Not a literal: all parts of a picture share a kernel.
        pixel, path = index // self.spp + dr.opaque(mi.UInt32, first), index % self.spp
        sample = self._samples(seed, pixel, path)
        jitter = sample()
        # A pixel's paths share the lights.
        turn, times = dr.gather(mi.UInt32, self._turn, path), dr.gather(mi.Float, self._times, path)
        origin, direction, _ = gel_ray(lens, mi.Float(pixel % width) + jitter.x, mi.Float(pixel // width) + jitter.y, dr.sqrt)
        ray = mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*direction))
        met = self._traced.ray_intersect_preliminary(ray, True)
        found = met.compute_surface_interaction(ray)
        active, to_eye = found.is_valid(), -ray.d
        total, weight = mi.Color3f(0.0), mi.Color3f(1.0)
        for bounce in range(max(self.bounces, 1)):
            normal, point = found.sh_frame.n, found.p
            receive = functools.partial(self._lobes, normal, to_eye)
            reflectances = self._reflectances(self._coat(found.uv))
            light = self._illuminate(point, normal, receive, sample, turn, times)
            if received is not None:
                light = tuple(old + self._gathered(met, new, active) for old, new in zip(light, received, strict=True))
            total += dr.select(active, weight * self._weighted(reflectances, light), 0.0)
            if bounce >= self.bounces - 1 or not indirect:
                break
            local = self._cosine_hemisphere(sample())
            onward = mi.Frame3f(normal).to_world(local)
            weight *= dr.select(active, self._weighted(reflectances, receive(onward)) * (dr.pi / dr.maximum(local.z, 1e-6)), 0.0)
            ray, met, share = self._next(point + OFFSET * normal, onward, active)
            weight *= share
            active &= share > 0
            found = met.compute_surface_interaction(ray, active=active)
            to_eye = -ray.d
        # Scheduled together, or each channel's sum would trace all paths anew.
        dr.schedule(total)
        mean = [dr.block_sum(channel, self.spp) / self.spp for channel in total]
        return dr.ravel(mi.Color3f(*mean))

    def height(self) -> Any:
        """z of the placed membrane at the pixels' centres [mm], a tensor (H, W); NaN where the camera sees no gel."""
        mi, dr = self.mi, self.dr
        width, height = self.scene.render.resolution
        pixel = dr.arange(mi.UInt32, width * height)
        lens, found = make_lens(self.scene, 1.0), mi.Float(dr.nan)
        # A ray along an edge slips between its triangles; one a thousandth of a pixel beside it does not.
        for aside in (0.0, 1e-3):
            column, row = mi.Float(pixel % width) + 0.5 + aside, mi.Float(pixel // width) + 0.5 + 0.4 * aside
            origin, direction, _ = gel_ray(lens, column, row, dr.sqrt)
            ray = mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*direction))
            met = self._traced.ray_intersect_preliminary(ray, True, active=dr.isnan(found))
            found = dr.select(dr.isnan(found) & met.is_valid(), ray.o.z + met.t * ray.d.z, found)
        return mi.TensorXf(found + dr.zeros(mi.Float, width * height), (height, width))

    def _samples(self, seed: int, pixel: Any, path: Any) -> Callable[[], Any]:
        """A function that gives points of the unit square: first for the place in the pixel, then for the place on the lights.

        All lights get the same place, for their sum alone is seen.
        """
        mi, dr = self.mi, self.dr
        if self._sampler is not None:
            self._sampler.set_samples_per_wavefront(self.spp)
            self._sampler.seed(seed, dr.width(pixel))
            return self._sampler.next_2d
        if self._sets is None:
            sets = path_sets(self.spp, self._turns, 0)
            self._sets = len(sets), mi.Float(sets.ravel())
        count, values = self._sets
        if self._lots is None or self._lots[0] != seed:
            width, height = self.scene.render.resolution
            self._lots = seed, mi.UInt32(np.random.default_rng(seed).integers(count, size=width * height, dtype=np.uint32))
        x, y, across, up = dr.gather(mi.Vector4f, values, dr.gather(mi.UInt32, self._lots[1], pixel) * self.spp + path)
        points = [mi.Point2f(x, y), mi.Point2f(across, up)]
        return lambda: points.pop(0) if len(points) > 1 else points[0]
