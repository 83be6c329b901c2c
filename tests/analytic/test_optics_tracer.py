"""The traced light against closed forms, against Mitsuba's own reflectances, and against brute force that shares none of its shortcuts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gelsim.membrane.surface import rest_membrane
from gelsim.optics import choose_variant
from gelsim.optics.coating import coating_dict, flake_albedo
from gelsim.optics.fresnel import critical_angle, diffuse_return, reflectance
from gelsim.optics.reference import irradiance, lambert_plane
from gelsim.optics.render import native
from gelsim.optics.tracer import Tracer
from gelsim.optics.variant import use_variant
from gelsim.scene.definition import Camera, Coating, Gel, Light, Lights, Markers, Render, Scene

COATS = [Coating(albedo=(0.9, 0.5, 0.1)), Coating(specular=0.25, roughness=0.45), Coating(specular=1.0, roughness=0.15)]


@pytest.fixture
def mi():
    choice = choose_variant()
    if choice.name.startswith("scalar"):
        pytest.skip("this machine has neither CUDA nor a working LLVM")
    return use_variant(choice)


def small_plane(**sections) -> Scene:
    lights = (
        Light("red", (12.0, 2.0, -4.0), (-12.0, 0.0, 3.0), (6.0, 2.0), (1.0, 0.2, 0.1), 100.0),
        Light("blue", (-3.0, -12.0, -5.0), (0.0, 12.0, 2.0), (5.0, 3.0), (0.1, 0.3, 1.0), 80.0),
    )
    scene = Scene(
        gel=Gel(profile="flat", size_mm=(12.0, 12.0), thickness_mm=2.0),
        camera=Camera(field_mm=(8.0, 6.0)),
        lights=Lights(lights, window_thickness_mm=4.0),
        markers=Markers(layout="none"),
        render=Render("path", 16, (32, 24)),
    )
    return scene.replace(**sections)


def dented(scene: Scene, depth_mm: float = 1.0):
    """A round dent 1 mm wide: walls up to 31 degrees steep see each other and the window."""
    rest = rest_membrane(scene)
    x, y = rest.positions[:, 0] * 1e3, rest.positions[:, 1] * 1e3
    bell = depth_mm * np.exp(-(x**2 + y**2) / 2)
    normals = np.stack([-x * bell, -y * bell, np.ones_like(bell)], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return replace(rest, positions=rest.positions - np.stack([0 * x, 0 * x, bell * 1e-3], axis=1), normals=normals)


def pictures(mi, scene, membrane, seeds=4, spp=16, bounces=0):
    tracer = Tracer(mi, scene, spp, bounces)
    tracer.place(membrane)
    return np.array([tracer.picture(seed).numpy() for seed in range(seeds)], float)


# ---- Fresnel ----


def test_fresnel_at_normal_incidence_and_at_the_critical_angle():
    assert reflectance(1.0, 1.0, 1.4906) == pytest.approx((0.4906 / 2.4906) ** 2, rel=1e-12)
    assert reflectance(1.0, 1.4906, 1.0) == pytest.approx(reflectance(1.0, 1.0, 1.4906), rel=1e-12)
    angle = critical_angle(1.4906, 1.0)
    assert np.degrees(angle) == pytest.approx(42.13, abs=0.01)
    # Just beyond everything, a hundredth of a degree before clearly less: R falls with the square root there.
    assert reflectance(np.cos(angle + 1e-6), 1.4906, 1.0) == pytest.approx(1.0, abs=1e-12)
    assert reflectance(np.cos(angle - 1.7e-4), 1.4906, 1.0) < 0.95
    # At Brewster's angle only one polarisation is reflected: half of ((1 - n²)/(1 + n²))².
    assert reflectance(np.cos(np.arctan(1.5)), 1.0, 1.5) == pytest.approx(0.5 * (1.25 / 3.25) ** 2, rel=1e-12)


def test_diffuse_return_is_walshs_formula():
    n = 1.41
    outside = (
        0.5
        + (n - 1) * (3 * n + 1) / (6 * (n + 1) ** 2)
        + n**2 * (n**2 - 1) ** 2 / (n**2 + 1) ** 3 * np.log((n - 1) / (n + 1))
        - 2 * n**3 * (n**2 + 2 * n - 1) / ((n**2 + 1) * (n**4 - 1))
        + 8 * n**4 * (n**4 + 1) / ((n**2 + 1) * (n**4 - 1) ** 2) * np.log(n)
    )
    assert diffuse_return(n, 1.0) == pytest.approx(1 - (1 - outside) / n**2, abs=1e-4)


def test_the_tracers_fresnel_is_the_closed_form(mi):
    scene = small_plane(lights=replace(small_plane().lights, window_reflection=True))
    cosine = np.linspace(0.01, 1.0, 500)
    # Gel to window to air: Snell, then the window's own face.
    in_window = np.sqrt(1 - (1.41 / 1.49) ** 2 * (1 - cosine**2))
    traced = np.array(Tracer(mi, scene, 16)._window_reflectance(mi.Float(cosine)))
    # float32 near the critical angle: sqrt of a rounding error of 1e-7.
    assert np.abs(traced - reflectance(in_window, 1.49, 1.0)).max() < 1e-3
    assert np.abs(traced - reflectance(cosine, 1.41, 1.0)).max() > 1e-3  # planted: the window's index forgotten


# ---- coat ----


def directions(count, rng):
    """Of the upper hemisphere, uniform in the cosine."""
    cosine, turn = rng.uniform(0.05, 1.0, count), rng.uniform(0, 2 * np.pi, count)
    sine = np.sqrt(1 - cosine**2)
    return np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine])


@pytest.mark.parametrize("coating", COATS)
def test_coat_is_reciprocal_and_mitsubas(mi, rng, coating):
    scene = small_plane(coating=coating)
    tracer = Tracer(mi, scene, 16)
    eye, light = directions(2000, rng), directions(2000, rng)
    normal, coat = mi.Vector3f(0, 0, 1), (mi.Float(1.0), mi.Float(0.0))

    def reflect(first, second):
        return np.array(tracer._reflect(coat, normal, mi.Vector3f(first), mi.Vector3f(second)))

    there, back = reflect(eye, light) / light[2], reflect(light, eye) / eye[2]
    # float32, some forty operations.
    assert np.allclose(there, back, rtol=1e-5)
    # Planted: the cosine at the light left in.
    assert not np.allclose(there * light[2], back * eye[2], rtol=1e-5)
    bsdf = mi.load_dict(native(mi, coating_dict(scene)))
    si = mi.SurfaceInteraction3f()
    si.wi, si.sh_frame = mi.Vector3f(eye), mi.Frame3f(mi.Vector3f(0, 0, 1))
    theirs = np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(light)))
    assert np.allclose(reflect(eye, light), theirs, rtol=2e-3, atol=1e-6)
    # Planted: half a percent more is seen by both.
    assert not np.allclose(1.005 * reflect(eye, light), theirs, rtol=2e-3, atol=1e-6)


@pytest.mark.parametrize("coating", COATS)
def test_no_coat_returns_more_than_it_gets(mi, coating):
    """White furnace: under a sky of radiance 1 each direction gets back at most 1; the mean is the albedo that indirect light uses."""
    from scipy.stats import qmc

    white = replace(coating, albedo=(1.0, 1.0, 1.0), flake_reflectance=(1.0, 1.0, 1.0))
    tracer = Tracer(mi, small_plane(coating=white), 16)
    first, second, third = qmc.Sobol(3, rng=1).random_base2(18).T

    def hemisphere(square, turn):
        radius = np.sqrt(square)
        return np.stack([radius * np.cos(2 * np.pi * turn), radius * np.sin(2 * np.pi * turn), np.sqrt(1 - square)])

    light = hemisphere(first, second)
    returned = []
    for cosine in (0.2, 0.5, 0.8, 1.0):
        eye = mi.Vector3f(float(np.sqrt(1 - cosine**2)), 0, cosine)
        value = np.array(tracer._reflect((mi.Float(1.0), mi.Float(0.0)), mi.Vector3f(0, 0, 1), eye, mi.Vector3f(light)))[0]
        returned.append(np.mean(value * np.pi / light[2]))
    # Quasi-random means of a lobe as narrow as 0.15 are good to a percent.
    assert max(returned) < 1.01 and min(returned) > 0.5
    eye = hemisphere(third, np.zeros_like(third))
    value = np.array(tracer._reflect((mi.Float(1.0), mi.Float(0.0)), mi.Vector3f(0, 0, 1), mi.Vector3f(eye), mi.Vector3f(light)))[0]
    # Cosine-distributed on both sides.
    mean = np.mean(value * np.pi / light[2])
    expected = (1 - coating.specular) + coating.specular * flake_albedo(coating.roughness)
    assert mean == pytest.approx(expected, abs=0.01)
    # Planted: 3 % more than there is.
    assert 1.03 * mean != pytest.approx(expected, abs=0.01)


# ---- window ----


def test_all_light_beyond_the_critical_angle_comes_back(mi):
    """A wide gel of even glow over a thin window: it returns the share of Walsh's formula."""
    scene = small_plane(
        gel=Gel(profile="flat", size_mm=(40.0, 40.0), thickness_mm=0.5),
        lights=replace(small_plane().lights, window_thickness_mm=0.5, window_ior=1.41, window_reflection=True),
    )
    tracer = Tracer(mi, scene, 16)
    tracer.place(rest_membrane(scene))
    count = 400_000
    random = mi.PCG32(size=count, initstate=3)
    pool = mi.Texture2f(mi.TensorXf(np.tile(np.float32([1, 1, 1, 0, 0, 0]), (32, 32, 1))), use_accel=False)
    point = mi.Point3f(np.tile(np.float32([[0.1], [0.2], [0.0]]), (1, count)))
    normal = mi.Vector3f(0, 0, -1)

    def cosine(way):
        return (mi.Float(-way.z),)

    where = mi.Point2f(random.next_float32(), random.next_float32())
    got = np.array(tracer._returned(point, normal, cosine, where, pool)[0])[0]
    error = got.std() / np.sqrt(count)
    # Beyond 20 mm = 84 degrees the gel has ended: cos² = 1 % of a cosine's light is missing at most.
    expected = np.pi * diffuse_return(1.41, 1.0)
    assert expected * 0.985 - 5 * error < got.mean() < expected + 5 * error and error < 0.01 * expected
    wrong = np.pi * diffuse_return(1.33, 1.0)  # planted: water
    assert abs(got.mean() - wrong) > 5 * error + 0.015 * wrong


def test_a_light_seen_in_the_window(mi):
    """One small lamp that faces away from the gel: what arrives is its mirror image's light times Fresnel's reflectance."""
    lamp = Light("away", (1.0, 0.5, -3.0), (0.0, 0.0, -1.0), (0.2, 0.2), (1.0, 1.0, 1.0), 50.0)
    scene = small_plane(
        lights=Lights((lamp,), window_thickness_mm=4.0, window_ior=1.41, gel_ior=1.41, window_reflection=True),
        render=Render("direct", 16, (32, 24)),
    )
    got = pictures(mi, scene, rest_membrane(scene), seeds=2).mean(axis=0)
    image = replace(lamp, position_mm=(1.0, 0.5, -9.0), direction=(0.0, 0.0, 1.0))
    mirrored = lambert_plane(scene.replace(lights=Lights((image,), 4.0, 1.41, 1.41)))
    from gelsim.optics.camera import pixel_rays

    origin, direction = pixel_rays(scene)
    points = origin - direction * (origin[..., 2:] / direction[..., 2:])
    way = np.array(image.position_mm) - points * 1e3
    share = reflectance(-way[..., 2] / np.linalg.norm(way, axis=-1), 1.41, 1.0)
    # The lamp is 0.2 mm wide at 9 mm or more, the image smooth over a pixel of 0.25 mm: second order, 1e-3, but for the kink at the
    # critical angle.
    relative = np.abs(got[..., 0] / (mirrored[..., 0] * share) - 1)
    assert np.median(relative) < 2e-3 and (relative < 0.02).mean() > 0.9
    assert np.median(np.abs(got[..., 0] / mirrored[..., 0] - 1)) > 0.5  # planted: a perfect mirror


def test_lobe_of_a_lamp(mi):
    """A lensed lamp: cos^8, its flux unchanged."""
    lamp = Light("lensed", (2.0, 0.0, -5.0), (-2.0, 0.0, 5.0), (1.0, 1.0), power=10.0, lobe=8.0)
    scene = small_plane(lights=Lights((lamp,)), render=Render("direct", 16, (32, 24)))
    got, expected = pictures(mi, scene, rest_membrane(scene)).mean(axis=0), lambert_plane(scene)
    # 64 samples of a lamp whose light varies by 10 % over its face: 1 %; 8 cells a side leave 1e-3.
    assert np.median(np.abs(got / expected - 1)) < 0.01
    plain = lambert_plane(scene.replace(lights=Lights((replace(lamp, lobe=1.0),))))
    assert np.median(np.abs(got / plain - 1)) > 0.05
    # All of it arrives on a plane that is wide enough: flux 10 mW.
    x = np.linspace(-60, 60, 601) * 1e-3
    points = np.stack([*np.meshgrid(x, x), np.zeros((601, 601))], axis=-1)
    upward = replace(lamp, direction=(0.0, 0.0, 1.0))
    assert irradiance(upward, points, np.array([0, 0, -1.0]), 2)[..., 0].sum() * 0.2**2 == pytest.approx(10.0, rel=1e-3)


# ---- all of it ----


def test_lamps_near_and_far_are_the_sum_over_their_places(mi, monkeypatch):
    """One whose edge comes within 1 mm of the coat, one across the axis, one that is seen as 2e-5 sr; each alone, against the sum over its
    cells (120 a side: of the near ones good to 0.1 %)."""
    lamps = {
        "near": Light("near", (3.0, 0.0, -5.0), (-1.0, 0.5, 0.0), (9.0, 8.0), (1.0, 1.0, 1.0), 20.0),
        "across": Light("across", (0.5, 0.0, -3.0), (-0.2, 0.0, 1.0), (8.0, 4.0), (1.0, 1.0, 1.0), 20.0),
        "far": Light("far", (60.0, 0.0, -200.0), (-0.3, 0.0, 1.0), (1.0, 1.0), (1.0, 1.0, 1.0), 1e4),
    }

    def compared(name: str) -> tuple[float, float]:
        """The picture's light over the sum's, and the noise of a pixel of 16 paths over its light."""
        lights = Lights((lamps[name],), window_thickness_mm=4.0, window_reflection=False)
        scene = small_plane(lights=lights, coating=Coating(specular=0.0, grain=0.0), render=Render("direct", 16, (32, 24)))
        drawn, wanted = pictures(mi, scene, rest_membrane(scene), seeds=8), lambert_plane(scene, 120)
        lit = wanted.mean(axis=2) > 0.05 * wanted.max()
        return drawn.mean(axis=0)[lit].sum() / wanted[lit].sum(), (drawn.std(axis=0, ddof=1)[lit] / wanted[lit]).mean()

    for name, most in (("near", 0.02), ("across", 0.02), ("far", 1e-4)):
        whole, noise = compared(name)
        # 0.8, 0.7 and 0.001 % of noise here; of 6,000 pixels' mean a hundredth of it.
        assert whole == pytest.approx(1, abs=2e-3) and noise < most, name
    monkeypatch.setattr("gelsim.optics.tracer.FAR_SR", 1e9)  # planted: all by area, 12 and 4 %
    assert compared("near")[1] > 0.05 and compared("across")[1] > 0.02
    monkeypatch.setattr("gelsim.optics.tracer.FAR_SR", 0.0)  # planted: none, of angles in single precision
    assert compared("far")[1] > 1e-3


@pytest.mark.parametrize("specular", [0.0, 0.25])
@pytest.mark.parametrize("window", [False, True])
def test_path_is_brute_force(mi, window, specular):
    """Against paths of five vertices with the whole coat at each: no vertices' glow, no pooled window light, no drawn occlusion."""
    scene = small_plane(coating=Coating(albedo=(0.6, 0.5, 0.4), specular=specular, roughness=0.45))
    scene = scene.replace(lights=replace(scene.lights, window_reflection=window))
    membrane = dented(scene)
    fast = pictures(mi, scene, membrane, seeds=32)
    brute = pictures(mi, scene, membrane, seeds=4, spp=256, bounces=5)

    def tiles(image):
        return image.reshape(*image.shape[:-3], 3, 8, 4, 8, 3).mean(axis=(-4, -2))

    a, b = tiles(fast), tiles(brute)
    error = np.sqrt(a.var(axis=0, ddof=1) / 32 + b.var(axis=0, ddof=1) / 4).mean() / b.mean()
    difference = a.mean(axis=0) / b.mean(axis=0) - 1
    # What is known to differ: two rounds of gathering, flakes that scatter evenly out of sight, a pooled window: see docs/optics.md.
    allowed = 0.01 if specular else 0.005
    assert np.abs(difference).max() < allowed + 5 * error and error < 0.003
    # Planted: without inter-reflection the dent is darker by more than that.
    dark = tiles(pictures(mi, scene.replace(render=replace(scene.render, mode="direct")), membrane)).mean(axis=0)
    assert np.abs(dark / b.mean(axis=0) - 1).max() > allowed + 5 * error


# ---- how it is computed ----


def test_a_pictures_paths_are_traced_once(mi):
    """All channels in one launch. Without the schedule before the sums each channel's sum traced all paths anew: three times the time."""
    import drjit as dr

    scene = small_plane()
    tracer = Tracer(mi, scene, 16)
    tracer.place(dented(scene))
    dr.eval(tracer.picture(0))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        dr.eval(tracer.picture(0))
        launches = [entry for entry in dr.kernel_history([dr.KernelType.JIT]) if entry["size"] == 32 * 24 * 16]
    assert len(launches) == 1


def test_a_picture_in_parts_is_the_picture(mi, monkeypatch):
    scene = small_plane()
    (whole,) = pictures(mi, scene, dented(scene), seeds=1)
    # Seven of 24 rows at once, 3 in the last part.
    monkeypatch.setattr("gelsim.optics.tracer.PATHS_AT_ONCE", 7 * 32 * 16 + 5)
    (parts,) = pictures(mi, scene, dented(scene), seeds=1)
    assert np.array_equal(whole, parts) and np.ptp(whole) > 0
