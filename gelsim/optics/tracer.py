"""The light of one picture, traced in parallel on Mitsuba's vectorised variants (LLVM, CUDA) and differentiable there.

A pixel is the mean over `spp` paths of the radiance L along its ray in the gel (`optics.camera`):

    L = Σ_lights ∫ f cos θ V L_e cos θ' / r² dA  +  ∫ f cos θ L_in dω.

*Direct.* Every light is sampled once a path, by area, its random numbers stratified over the pixel: no choice among lights, no colour
noise. A light within the window is also seen in the window's outer face, by its mirror image times Fresnel's reflectance.
*Indirect.* What the membrane sends to itself, straight or by way of the window's outer face, is the radiance of a diffuse surface, known
at its vertices: L = ρ E / π, E from the direct light and two rounds of gathering (a third would add albedo³ of what returns, below 0.5 %).
Straight: one direction a path, cosine distributed. By way of the window: a sum over patches of the gel, without rays. So a path ends after
one bounce, and no rare bright path is left: flakes that the camera does not see scatter like pigment of their albedo. `bounces` > 0 follows
paths that long instead, with the whole coat at every vertex and the window by chance: slow and noisy, for tests and studies.
*Window.* The outer face reflects by Fresnel's equations and lets the rest go (housing and camera are black). The way through gel and
window is exact for what the coat scatters; for the mirror images of lights the window counts as gel of its apparent thickness. The window
is as wide as the gel.

Random numbers are the same for every membrane, so a video does not flicker. Derivatives see neither edges of shadows nor where an
indirect ray meets the membrane. Left out: shadows between the window's face and a light's mirror image, polarisation, housing.
"""

from __future__ import annotations

import functools
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.optics.camera import gel_ray, make_lens, sideways
from gelsim.optics.coating import flake_albedo, grain_pattern, marker_coverage
from gelsim.optics.scene_dict import mesh_arrays
from gelsim.optics.spectra import light_colour
from gelsim.results import Membrane
from gelsim.scene import Scene

OFFSET = 2e-3
"""Of a ray's start from the surface [mm], along the normal: Mitsuba's own is of this size here."""
GATHER_ROUNDS = 2
POOL_CELLS = 32
"""Along a side of the gel: what the window returns has travelled centimetres, finer detail is lost in it."""
PATCHES = 3
"""Along a side of the gel; with 16 paths a pixel's light from the window is a sum over 9 x 16 places."""
VERTEX_GATHER_RAYS = 4
"""From a vertex, and one sample on each light. Vertices are 0.08 mm apart, and a pixel averages over as many as it has paths."""


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
        self._sampler = mi.load_dict({"type": "multijitter", "sample_count": spp})
        # Rounded up to what can be laid out as a grid.
        self.spp = self._sampler.sample_count()

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
        mi = self.mi
        arrays = mesh_arrays(membrane)
        if self._mesh is None or self._mesh.vertex_count() != len(arrays["vertex_positions"]):
            count = len(arrays["vertex_positions"])
            mesh = mi.Mesh("membrane", count, len(arrays["faces"]), has_vertex_normals=True, has_vertex_texcoords=True)
            parameters = mi.traverse(mesh)
            for name, values in arrays.items():
                parameters[name] = values.ravel()
            parameters.update()
            self._mesh, self._traced = mesh, mi.load_dict({"type": "scene", "membrane": mesh})
        else:
            parameters = mi.traverse(self._traced)
            parameters["membrane.vertex_positions"] = arrays["vertex_positions"].ravel()
            parameters["membrane.vertex_normals"] = arrays["vertex_normals"].ravel()
            parameters.update()
        self._points = mi.Point3f(np.ascontiguousarray(arrays["vertex_positions"].T))
        self._normals = mi.Vector3f(np.ascontiguousarray(arrays["vertex_normals"].T))
        self._uv = mi.Point2f(np.ascontiguousarray(arrays["vertex_texcoords"].T))

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

    def _reflect(self, coat: tuple[Any, Any], normal: Any, to_eye: Any, to_light: Any) -> Any:
        """f cos θ for unit directions away from the surface."""
        mi, dr, values = self.mi, self.dr, self.values
        grain, coverage = coat
        cos_eye, cos_light = dr.dot(normal, to_eye), dr.dot(normal, to_light)
        lit = (cos_eye > 0) & (cos_light > 0)
        share = values["coating.specular"]
        pigment = (1 - share) * dr.clip(grain * values["coating.albedo"], 0, 1) / dr.pi
        total = (1 - coverage) * pigment + coverage * mi.Color3f(self.scene.markers.albedo / dr.pi)
        if self.scene.coating.specular > 0:
            alpha = values["coating.roughness"]
            half = dr.normalize(to_eye + to_light)
            slope = dr.square(dr.dot(normal, half)) * (dr.square(alpha) - 1) + 1
            facets = dr.square(alpha) / (dr.pi * dr.square(slope))

            # G1/(2 cos) of Smith's shadowing, each.
            def seen(cosine: Any) -> Any:
                return 1 / (cosine + dr.sqrt(dr.square(alpha) + (1 - dr.square(alpha)) * dr.square(cosine)))

            flakes = facets * seen(dr.maximum(cos_eye, 1e-4)) * seen(dr.maximum(cos_light, 1e-4))
            total += (1 - coverage) * share * flakes * dr.clip(grain * values["coating.flake_reflectance"], 0, 1)
        return dr.select(lit, total * cos_light, 0.0)

    # ---- light ----

    def _window_reflectance(self, cosine: Any) -> Any:
        """Of the window's outer face for light that is `cosine` steep in the gel."""
        dr, lights = self.dr, self.scene.lights
        sine_squared = (lights.gel_ior / lights.window_ior) ** 2 * (1 - dr.square(cosine))
        return self.mi.fresnel(dr.sqrt(dr.maximum(1 - sine_squared, 0)), self.mi.Float(1 / lights.window_ior))[0]

    def _illuminate(self, point: Any, normal: Any, receive: Any, sample: Any) -> Any:
        """Σ over the lights of `receive(direction)` times irradiance per cosine; `sample()` gives a point of the unit square."""
        mi, dr, values, scene = self.mi, self.dr, self.values, self.scene
        start = point + OFFSET * normal
        total = mi.Color3f(0.0)
        face = -(scene.gel.thickness_mm + scene.lights.window_thickness_mm * scene.lights.gel_ior / scene.lights.window_ior)
        for i, light in enumerate(scene.lights.lights):
            facing = dr.normalize(values[f"lights.{i}.direction"])
            upright = light.direction[0] == 0 and light.direction[1] == 0
            along = mi.Vector3f(1, 0, 0) if upright else dr.normalize(dr.cross(mi.Vector3f(0, 0, 1), facing))
            size = values[f"lights.{i}.size_mm"]
            # Φ is spread over the area as Φ (m + 1)/(2π A) cos^(m-1); A cancels against the sampling density.
            flux = values[f"lights.{i}.rgb"] * values[f"lights.{i}.power"] * ((light.lobe + 1) / (2 * dr.pi))
            where = sample() - 0.5
            source = values[f"lights.{i}.position_mm"] + along * (where.x * size.x) + dr.cross(facing, along) * (where.y * size.y)
            total += self._from(start, normal, source, facing, flux, light.lobe, receive)
            if scene.lights.window_reflection and light.position_mm[2] > face:
                image = mi.Point3f(source.x, source.y, 2 * face - source.z)
                way = image - start
                cosine = -way.z / dr.norm(way)
                meets = start + way * ((face - start.z) / way.z)
                weight = dr.select(self._on_window(meets), self._window_reflectance(cosine), 0.0)
                total += self._from(start, normal, image, mi.Vector3f(facing.x, facing.y, -facing.z), flux * weight, light.lobe, receive)
        return total

    def _from(self, start: Any, normal: Any, source: Any, facing: Any, flux: Any, lobe: float, receive: Any) -> Any:
        mi, dr = self.mi, self.dr
        way = source - start
        distance = dr.norm(way)
        direction = way / distance
        cosine = dr.maximum(-dr.dot(direction, facing), 0)
        emitted = cosine if lobe == 1.0 else dr.power(dr.maximum(cosine, 1e-6), lobe)
        active = (cosine > 0) & (dr.dot(normal, direction) > 0)
        ray = mi.Ray3f(dr.detach(start), dr.detach(direction))
        ray.maxt = dr.detach(distance) * (1 - 1e-4)
        active &= ~self._traced.ray_test(ray, active)
        return dr.select(active, flux * (emitted / dr.square(distance)) * receive(direction), 0.0)

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

    def _gathered(self, met: Any, share: Any, glow: Any) -> Any:
        """What the membrane sends from where rays met it: `glow` at the vertices, interpolated over the triangle."""
        mi, dr = self.mi, self.dr
        active = share > 0
        corner = dr.gather(mi.Vector3u, self._mesh.faces_buffer(), met.prim_index, active)
        first, second = met.prim_uv.x, met.prim_uv.y
        total = (1 - first - second) * dr.gather(mi.Color3f, glow, corner.x, active)
        total += first * dr.gather(mi.Color3f, glow, corner.y, active) + second * dr.gather(mi.Color3f, glow, corner.z, active)
        return dr.select(active, total * share, 0.0)

    def _glow(self) -> tuple[Any, Any]:
        """Radiance of the membrane as a diffuse surface: at its vertices, a flat array of RGB, and pooled for the window."""
        mi, dr = self.mi, self.dr
        point, normal = self._points, self._normals
        count = dr.width(point)
        albedo = self._albedo(self._uv) / dr.pi

        random = mi.PCG32(size=count, initstate=self.scene.seed)

        def cosine(way: Any) -> Any:
            return dr.maximum(dr.dot(normal, way), 0)

        def random_point() -> Any:
            return mi.Point2f(random.next_float32(), random.next_float32())

        direct = self._illuminate(point, normal, cosine, random_point)
        dr.eval(direct)
        glow = albedo * direct
        pool = self._pool(glow)
        # All gathering rays at once, ordered by vertex.
        rays = VERTEX_GATHER_RAYS
        index = dr.arange(mi.UInt32, count * rays)
        vertex = index // rays
        turns = mi.PCG32(size=count * rays, initstate=self.scene.seed + 1)
        frame = mi.Frame3f(dr.gather(mi.Vector3f, dr.ravel(normal), vertex))
        start = dr.gather(mi.Point3f, dr.ravel(point), vertex) + OFFSET * frame.n
        for _ in range(GATHER_ROUNDS):
            square = mi.Point2f((mi.Float(index % rays) + turns.next_float32()) / rays, turns.next_float32())
            ray = mi.Ray3f(start, frame.to_world(self._cosine_hemisphere(square)))
            met = self._traced.ray_intersect_preliminary(ray, False)
            near = self._gathered(met, dr.select(met.is_valid(), mi.Float(1.0), 0.0), dr.ravel(glow))
            received = mi.Color3f(*(dr.block_sum(channel, rays) for channel in near)) * (dr.pi / rays)
            if pool is not None:
                received += self._returned(point, normal, cosine, random_point, pool)
            glow = albedo * (direct + received)
            dr.eval(glow)
            pool = self._pool(glow)
        return dr.ravel(glow), pool

    def _pool(self, glow: Any) -> Any:
        """What the window mirrors: `glow`, height and its slopes on a coarse grid of the gel, a texture of 6 channels; or None."""
        mi, dr = self.mi, self.dr
        if not self.scene.lights.window_reflection:
            return None
        cell = dr.minimum(mi.UInt32(self._uv.x * POOL_CELLS), POOL_CELLS - 1)
        cell += dr.minimum(mi.UInt32(self._uv.y * POOL_CELLS), POOL_CELLS - 1) * POOL_CELLS
        normal = self._normals
        count, sums = dr.zeros(mi.Float, POOL_CELLS**2), dr.zeros(mi.Float, POOL_CELLS**2 * 6)
        dr.scatter_reduce(dr.ReduceOp.Add, count, dr.ones(mi.Float, dr.width(cell)), cell)
        for channel, values in enumerate((*glow, self._points.z, -normal.x / normal.z, -normal.y / normal.z)):
            dr.scatter_reduce(dr.ReduceOp.Add, sums, values, cell * 6 + channel)
        means = sums / dr.gather(mi.Float, count, dr.arange(mi.UInt32, POOL_CELLS**2 * 6) // 6)
        return mi.Texture2f(mi.TensorXf(means, (POOL_CELLS, POOL_CELLS, 6)), use_accel=False)

    def _returned(self, point: Any, normal: Any, receive: Any, sample: Any, pool: Any) -> Any:
        """Light that the membrane sends to the window's outer face and that comes back: Σ over patches of the gel, a place drawn in each.

        The way between two points, by Snell through the window and back, has a slope s found by Newton's method from the paraxial one on.
        An area dA is seen under the solid angle s (1 − s dz/dr) / ((1 + s²)^(3/2) r ∂r/∂s) dA, dz/dr the slope of the gel there. One ray
        tells whether the membrane is in the way, along a direction drawn in proportion to what comes along it.
        """
        mi, dr, lights = self.mi, self.dr, self.scene.lights
        width, height = self.scene.gel.size_mm
        depth = self.scene.gel.thickness_mm
        ratio = lights.window_ior / lights.gel_ior
        window = ((2 * lights.window_thickness_mm, ratio),)
        total, chosen, sum_ = mi.Color3f(0.0), mi.Vector3f(0, 0, -1), mi.Float(1e-20)
        lot = sample().x
        for patch in range(PATCHES**2):
            place = (mi.Point2f(patch % PATCHES, patch // PATCHES) + sample()) / PATCHES
            red, green, blue, level, slope_x, slope_y = pool.eval(place)
            apart = (place - 0.5) * mi.Vector2f(width, height) - mi.Point2f(point.x, point.y)
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
            angle = dr.maximum(tilt, 0) * slope * cosine**3 / (reach * rate) * (width * height / PATCHES**2)
            light = receive(direction) * mi.Color3f(red, green, blue) * (self._window_reflectance(cosine) * angle)
            total += light
            weight = dr.detach(dr.mean(light))
            sum_ += weight
            share = weight / sum_
            take = lot < share
            chosen = dr.select(take, dr.detach(direction), chosen)
            lot = dr.select(take, lot / share, (lot - share) / dr.maximum(1 - share, 1e-12))
        ray = mi.Ray3f(dr.detach(point + OFFSET * normal), chosen)
        ray.maxt = dr.detach(point.z + depth) / dr.maximum(-chosen.z, 1e-3)
        return dr.select(self._traced.ray_test(ray), 0.0, total)

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
        glow, pool = self._glow() if indirect and not self.bounces else (None, None)
        sampler = self._sampler
        sampler.set_samples_per_wavefront(self.spp)
        sampler.seed(seed, width * height * self.spp)
        pixel = dr.arange(mi.UInt32, width * height * self.spp) // self.spp
        jitter = sampler.next_2d()
        lens = make_lens(scene, 1.0, self.values["camera.distance_mm"], self.values["camera.offset_mm"], dr.sqrt)
        origin, direction, _ = gel_ray(lens, mi.Float(pixel % width) + jitter.x, mi.Float(pixel // width) + jitter.y, dr.sqrt)
        ray = mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*direction))
        found = self._traced.ray_intersect(ray)
        active, to_eye = found.is_valid(), -ray.d
        total, weight = mi.Color3f(0.0), mi.Color3f(1.0)
        for bounce in range(max(self.bounces, 1)):
            normal, point = found.sh_frame.n, found.p
            receive = functools.partial(self._reflect, self._coat(found.uv), normal, to_eye)
            total += dr.select(active, weight * self._illuminate(point, normal, receive, sampler.next_2d), 0.0)
            if not indirect or (self.bounces and bounce == self.bounces - 1):
                break
            local = self._cosine_hemisphere(sampler.next_2d())
            onward = mi.Frame3f(normal).to_world(local)
            weight *= dr.select(active, receive(onward) * (dr.pi / dr.maximum(local.z, 1e-6)), 0.0)
            if glow is not None:
                straight = mi.Ray3f(dr.detach(point + OFFSET * normal), dr.detach(onward))
                met = self._traced.ray_intersect_preliminary(straight, False, active=active)
                total += weight * self._gathered(met, dr.select(met.is_valid(), mi.Float(1.0), 0.0), glow)
                if pool is not None:
                    total += dr.select(active, self._returned(point, normal, receive, sampler.next_2d, pool), 0.0)
                break
            ray, met, share = self._next(point + OFFSET * normal, onward, active)
            weight *= share
            active &= share > 0
            found = met.compute_surface_interaction(ray, active=active)
            to_eye = -ray.d
        mean = [dr.block_sum(channel, self.spp) / self.spp for channel in total]
        return mi.TensorXf(dr.ravel(mi.Color3f(*mean)), (height, width, 3))
