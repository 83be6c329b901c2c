"""From spectra to the numbers of red, green and blue that the renderer multiplies: LEDs, camera sensitivities, reflectances.

An LED (Ohno 2005, the model of colour-science): S(λ) ∝ (g + 2 g⁵)/3, g = exp(−((λ − λ₀)/Δ)²), λ₀ the peak, scaled here to a flux of 1; it
falls to one half where g = 0.8086, so its full width at half maximum is 0.922 Δ. A camera's channel c of sensitivity s_c sees

    rgb_c = ∫ S s_c dλ / mean(s_c),

so that light of the same power at every wavelength is (1, 1, 1): white balance to equal energy. A coat of reflectance R(λ) under all lamps
together has the albedo a_c = ∫ R S s_c dλ / ∫ S s_c dλ. The renderer multiplies by channel. On a grey coat that is exact. On a coloured one
several lamps share one albedo; a lamp's colour ∫ R S s_c dλ / a_c (`rgb_on_coat`) makes the first reflection exact again, and what is left
is the further ones' (docs/optics.md gives both errors against a spectral render). Sensitivities: Nikon 5100 (NPL; Darrodi et al. 2015) from
colour-science, a stand-in for the sensors' own cameras, whose curves are not published. Left out: phosphor-converted white LEDs (give
`rgb`), fluorescence, dispersion.
"""

from __future__ import annotations

import functools
import math
import warnings

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelsim.errors import SceneError
from gelsim.scene.definition import Light

OHNO_WIDTH = 2 * math.sqrt(-math.log(0.80861))
"""Full width at half maximum over Δ: g + 2 g⁵ = 3/2 at g = 0.80861."""

WAVELENGTHS = np.arange(380.0, 781.0, 1.0)
"""[nm] of every spectrum here."""

CAMERA = "Nikon 5100 (NPL)"


def led_spectrum(peak_nm: float, width_nm: float) -> NDArray[np.float64]:
    """Spectral flux of an LED of flux 1 [1/nm] at `WAVELENGTHS`.

    Args:
        peak_nm: Wavelength of the maximum.
        width_nm: Full width at half maximum.
    """
    colour = _colour()
    shape = colour.SpectralShape(WAVELENGTHS[0], WAVELENGTHS[-1], 1.0)
    values = colour.sd_single_led(peak_nm, shape, "Ohno 2005", half_spectral_width=width_nm / OHNO_WIDTH).values
    return values / values.sum()


@functools.cache
def camera_sensitivities() -> NDArray[np.float64]:
    """Relative sensitivities of red, green and blue at `WAVELENGTHS`, each of mean 1; shape (N, 3)."""
    measured = _colour().MSDS_CAMERA_SENSITIVITIES[CAMERA]
    channels = np.stack([np.interp(WAVELENGTHS, measured.wavelengths, column) for column in measured.values.T], axis=1)
    return channels / channels.mean(axis=0)


def spectrum_rgb(flux: ArrayLike) -> NDArray[np.float64]:
    """What the camera sees of a spectral flux [1/nm] at `WAVELENGTHS`, shape (3,); (1, 1, 1) for equal energy of total 1.

    Raises:
        SceneError: The spectrum has another length, or a value that is negative or not a number.
    """
    return _checked(flux, "spectrum") @ camera_sensitivities()


def reflectance_rgb(reflectance: ArrayLike, flux: ArrayLike) -> NDArray[np.float64]:
    """Albedo of a coat of spectral reflectance (0…1 at `WAVELENGTHS`) under a light of spectral flux, shape (3,).

    Raises:
        SceneError: As for `spectrum_rgb`; a reflectance above 1; a channel that sees nothing of the light.
    """
    checked = _checked(reflectance, "reflectance")
    if checked.max() > 1:
        raise SceneError(f"reflectance reaches {checked.max():g}: allowed is 0 … 1")
    seen = spectrum_rgb(flux)
    if not seen.all():
        raise SceneError("spectrum gives no light to one of the camera's channels: the coat has no albedo there")
    return spectrum_rgb(checked * np.asarray(flux, float)) / seen


def rgb_on_coat(flux: ArrayLike, reflectance: ArrayLike, albedo: ArrayLike) -> NDArray[np.float64]:
    """Colour to give a light so that, times the albedo, a coat of spectral reflectance looks right under it; shape (3,).

    Raises:
        SceneError: As for `spectrum_rgb`.
    """
    return spectrum_rgb(_checked(reflectance, "reflectance") * _checked(flux, "spectrum")) / np.asarray(albedo, float)


def light_colour(light: Light) -> NDArray[np.float64]:
    """Linear colour of a light: its `rgb`, or what its LED spectrum is to the camera; shape (3,)."""
    if light.peak_nm is None or light.width_nm is None:
        return np.array(light.rgb, float)
    return _led_rgb(light.peak_nm, light.width_nm).copy()


@functools.cache
def _led_rgb(peak_nm: float, width_nm: float) -> NDArray[np.float64]:
    return spectrum_rgb(led_spectrum(peak_nm, width_nm))


def _checked(values: ArrayLike, what: str) -> NDArray[np.float64]:
    spectrum = np.asarray(values, float)
    if spectrum.shape != WAVELENGTHS.shape:
        first, last = WAVELENGTHS[0], WAVELENGTHS[-1]
        raise SceneError(f"{what} has the shape {spectrum.shape}: expected {len(WAVELENGTHS)} values, for {first:g} … {last:g} nm")
    bad = ~(np.isfinite(spectrum) & (spectrum >= 0))
    if bad.any():
        place = int(np.argmax(bad))
        raise SceneError(f"{what} is {spectrum[place]} at {WAVELENGTHS[place]:g} nm: expected finite values of 0 or more")
    return spectrum


def _colour():
    with warnings.catch_warnings():
        # Of optional packages that it would like to have.
        warnings.simplefilter("ignore")
        import colour
    return colour
