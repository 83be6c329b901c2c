"""Colours from spectra: against sums by hand, and pictures by red, green and blue against Mitsuba's spectral renderer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gelsim.errors import SceneError
from gelsim.membrane.surface import moved_membrane
from gelsim.optics.render import ScalarRenderer
from gelsim.optics.scene_dict import scene_dict
from gelsim.optics.spectra import WAVELENGTHS, camera_sensitivities, led_spectrum, light_colour, reflectance_rgb, rgb_on_coat, spectrum_rgb
from gelsim.optics.variant import SCALAR, use_variant
from gelsim.scene.definition import Camera, Coating, Gel, Light, Lights, Markers, Render, Scene

BRONZE = 0.25 + 0.4 / (1 + np.exp(-(WAVELENGTHS - 560) / 35))
"""A strongly coloured coat: the worst case for three channels."""


def test_led_has_its_peak_its_width_and_its_flux():
    spectrum = led_spectrum(525.0, 32.0)
    assert WAVELENGTHS[np.argmax(spectrum)] == 525 and spectrum.sum() == pytest.approx(1)
    above = WAVELENGTHS[spectrum > spectrum.max() / 2]
    # A grid of 1 nm.
    assert np.ptp(above) == pytest.approx(32, abs=1.5)


def test_equal_energy_is_white_and_colours_land_in_their_channels():
    assert spectrum_rgb(np.full(401, 1 / 401)) == pytest.approx(np.ones(3))
    for channel, peak in enumerate((625.0, 525.0, 465.0)):
        assert np.argmax(light_colour(Light(peak_nm=peak, width_nm=20.0))) == channel
    assert light_colour(Light(rgb=(0.1, 0.2, 0.3))) == pytest.approx([0.1, 0.2, 0.3])


@pytest.mark.parametrize("value", [float("nan"), -0.1, float("inf")])
def test_a_spectrum_that_is_none_is_refused(value):
    broken = np.full(401, 1.0)
    broken[145] = value
    with pytest.raises(SceneError, match=r"spectrum is .* at 525 nm"):
        spectrum_rgb(broken)
    with pytest.raises(SceneError, match="peak_nm"):
        Scene(lights=Lights((Light(peak_nm=value, width_nm=20.0),)))
    with pytest.raises(SceneError, match="width_nm"):
        Scene(lights=Lights((Light(peak_nm=525.0),)))


def spectral(mi, values):
    return {"type": "spectrum", "value": [(float(w), float(v)) for w, v in zip(WAVELENGTHS[::2], values[::2], strict=True)]}


def spectral_picture(mi, scene, membrane, reflectance, spp):
    """By Mitsuba in full spectra; one channel for each of the camera's sensitivities."""
    parts = scene_dict(scene.replace(render=replace(scene.render, spp=spp)))
    for i, light in enumerate(scene.lights.lights):
        area = np.pi * light.size_mm[0] * light.size_mm[1]
        parts[f"light_{i}"]["emitter"]["radiance"] = spectral(mi, light.power / area * led_spectrum(light.peak_nm, light.width_nm))
    parts["coating"] = {"type": "diffuse", "reflectance": spectral(mi, reflectance)}
    film = {"type": "specfilm", "width": 48, "height": 36, "component_format": "float32", "rfilter": {"type": "box"}}
    for name, curve in zip("abc", camera_sensitivities().T, strict=True):
        film[f"channel_{name}"] = spectral(mi, curve)
    parts["camera"]["film"] = film
    renderer = ScalarRenderer(mi, scene, parts)
    renderer._spp = spp
    return renderer.radiance(membrane, 0)


@pytest.mark.slow
def test_three_channels_against_all_wavelengths():
    leds = ((625.0, 18.0), (525.0, 32.0), (465.0, 22.0))
    places = ((12.0, 0.0, -4.0), (-6.0, 10.4, -4.0), (-6.0, -10.4, -4.0))
    lights = tuple(
        Light(f"led {peak:g}", place, (-place[0], -place[1], 4.0), (4.0, 2.0), power=50.0, peak_nm=peak, width_nm=width)
        for (peak, width), place in zip(leds, places, strict=True)
    )
    mean_light = sum(led_spectrum(peak, width) for peak, width in leds)
    scene = Scene(
        gel=Gel(profile="flat", size_mm=(12.0, 12.0)),
        camera=Camera(field_mm=(8.0, 6.0)),
        lights=Lights(lights),
        coating=Coating(albedo=tuple(reflectance_rgb(BRONZE, mean_light))),
        markers=Markers(layout="none"),
        render=Render("path", 256, (48, 36)),
    )

    def dent(places):
        bell = 0.8e-3 * np.exp(-(places**2).sum(axis=1) / 2e-6)
        return np.stack([0 * bell, 0 * bell, -bell], axis=1)

    membrane = moved_membrane(scene, dent)
    mi = use_variant(SCALAR)
    by_channels = ScalarRenderer(mi, scene, scene_dict(scene)).radiance(membrane, 0).astype(float)
    mi.set_variant("scalar_spectral")
    try:
        whole = spectral_picture(mi, scene, membrane, BRONZE, 1024).astype(float)
        grey = spectral_picture(mi, scene, membrane, np.full(401, 0.5), 1024).astype(float)
    finally:
        use_variant(SCALAR)
    flat = scene.replace(coating=Coating(albedo=(0.5, 0.5, 0.5)))
    grey_channels = ScalarRenderer(mi, flat, scene_dict(flat)).radiance(membrane, 0).astype(float)
    assert whole.shape == by_channels.shape

    def tiles(image):
        return image.reshape(3, 12, 4, 12, 3).mean(axis=(1, 3))

    # A grey coat: exact but for noise, once the film's own scale is taken out of each channel.
    scale = grey_channels.mean(axis=(0, 1)) / grey.mean(axis=(0, 1))
    grey_error = np.abs(tiles(grey) * scale / tiles(grey_channels) - 1)
    assert grey_error.max() < 0.01
    # A bronze coat, one albedo for three lamps; then with the lamps' colours on that coat: what is left comes of inter-reflection, some
    # percent of the light in this dent, whose colour errs by the spread of R within a channel, a quarter; and of noise, as for grey.
    albedo = np.array(scene.coating.albedo)
    on_coat = tuple(
        replace(light, peak_nm=None, width_nm=None, rgb=tuple(rgb_on_coat(led_spectrum(light.peak_nm, light.width_nm), BRONZE, albedo)))
        for light in scene.lights.lights
    )
    fitted = scene.replace(lights=Lights(on_coat))
    by_fitted = ScalarRenderer(mi, fitted, scene_dict(fitted)).radiance(membrane, 0).astype(float)
    error = np.abs(tiles(whole) * scale / tiles(by_channels) - 1)
    fitted_error = np.abs(tiles(whole) * scale / tiles(by_fitted) - 1)
    for name, values in (("grey", grey_error), ("bronze", error), ("bronze, fitted", fitted_error)):
        print(f"{name}: mean {values.mean():.4f}, largest {values.max():.4f}")
    assert fitted_error.max() < 0.015 and error.max() > 5 * fitted_error.max()
