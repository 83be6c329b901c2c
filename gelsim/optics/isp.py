"""From radiance to the 8-bit picture the sensor's camera delivers: shading, exposure, white balance, noise, tone curve.

    x_c = exposure · gain_c · shading_c · L_c,   x_c += √(x_c / N_c + σ_c²) · normal,   level = 255 · tone(x_c)^gamma + s_c · normal,

shading by `optics.shading`, N the electrons of a white pixel (shot noise; normal in place of Poisson: at N x = 100 electrons the skewness
is 0.1), σ the read noise before the tone curve, s noise after it, as it is measured on finished pictures. Tone: sRGB after
IEC 61966-2-1, or none. Clipped, rounded. The exposure is the preset's, never automatic, so that frames and presses can be compared. Of a
sensor with a photograph of its rest, the first x_c is that of `optics.rest`.

Written in `optics.arrays`: where the light was drawn the picture is developed too. Random numbers are a hash of pixel, frame and seed
(pcg3d, Jarzynski and Olano 2020), so that they are the same in any order and on any backend; normal ones by Box and Muller. Left out:
Bayer mosaic, compression, crosstalk between the colours, fixed-pattern noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import SceneError
from gelsim.optics.arrays import Arrays, NumPyArrays, Values, grid_corners, mixed
from gelsim.optics.camera import window_transmission
from gelsim.optics.rest import rest_tables
from gelsim.optics.shading import shading_gain
from gelsim.optics.srgb import SRGB_FOOT
from gelsim.scene.definition import Scene


@dataclass(frozen=True)
class Pipeline:
    """What a camera's pipeline consists of: kernels are made for it, its numbers are in tables."""

    by_pixel: bool
    """Whether the gain differs between pixels."""
    early_noise: bool
    """Before the tone curve."""
    late_noise: bool
    """After it."""
    srgb: bool
    bent: bool
    """Whether there is an exponent on the curve."""
    rest: tuple[int, int] = (0, 0)
    """Columns and rows of a photograph of the rest."""


def without_noise(scene: Scene) -> Scene:
    """With a camera that shows the expectation of each picture, not one of its draws."""
    none = (0.0, 0.0, 0.0)
    return scene.replace(camera=replace(scene.camera, noise_sd=none, full_well=none, read_noise=none))


def develop(scene: Scene, radiance: NDArray[np.float32], index: int = 0) -> NDArray[np.uint8]:
    """The 8-bit picture of a linear one.

    Args:
        radiance: Linear RGB, shape (H, W, 3), of the scene's render resolution where the camera has shading or Fresnel losses.
        index: The frame's number in its press: noise differs from frame to frame, and is the same again for the same scene.seed.
    Returns:
        Shape (H, W, 3).
    Raises:
        SceneError: The sensor has a photograph of its rest, which only a membrane can move: `render_frames` does.
    """
    if scene.camera.has_rest:
        given = "camera.rest_smooth" if scene.camera.rest is None else f"camera.rest = {scene.camera.rest!r}"
        raise SceneError(f"{given}: radiance alone cannot be developed with it; give the sensor without")
    arrays = NumPyArrays()
    pipeline, tables = camera_pipeline(scene, arrays)
    colour = [np.ascontiguousarray(radiance[..., channel], np.float32).ravel() for channel in range(3)]
    pixel = arrays.range(len(colour[0]))
    words = develop_pixels(arrays, pipeline, tables, colour, pixel, pixel * 0, frame_keys(scene, [index]))
    return as_picture(packed_bytes(arrays, words), radiance.shape[:2])


def camera_pipeline(scene: Scene, arrays: Arrays) -> tuple[Pipeline, dict[str, Any]]:
    """The scene's pipeline, and its numbers on the backend.

    "gain": by channel, or by channel and pixel. "camera": shot, read and late noise by channel, exponent.
    """
    camera = scene.camera
    gain = camera_gain(scene)
    electrons = np.array(camera.full_well)
    shot = np.divide(1.0, electrons, out=np.zeros(3), where=electrons > 0)
    numbers = np.concatenate([shot, np.square(camera.read_noise), camera.noise_sd, [camera.gamma]])
    early, late = any(camera.full_well) or any(camera.read_noise), any(camera.noise_sd)
    by_pixel = gain.shape[:2] != (1, 1)
    rest = scene.render.resolution if camera.has_rest else (0, 0)
    pipeline = Pipeline(by_pixel, early, late, camera.tone == "srgb", camera.gamma != 1.0, rest)
    gain = gain.reshape(-1, 3).T
    return pipeline, {"gain": arrays.floats(gain) if by_pixel else arrays.numbers(gain), "camera": arrays.numbers(numbers)}


def camera_gain(scene: Scene) -> NDArray[np.float64]:
    """Exposure, white balance, shading and what the window passes, of each pixel: shape (H, W, 3), or (1, 1, 3) where it is the same."""
    gain = shading_gain(scene) * (scene.camera.exposure * np.array(scene.camera.white_balance))
    return gain * window_transmission(scene)[..., None] if scene.camera.fresnel else gain


def rest_on(scene: Scene, arrays: Arrays, still: NDArray[np.floating]) -> dict[str, Values]:
    """The tables of `optics.rest` on the backend; `still`: the radiance of the membrane at rest, shape (H, W, 3)."""
    return {name: arrays.floats(values) for name, values in rest_tables(scene, still * camera_gain(scene)).items()}


def frame_keys(scene: Scene, indices: list[int]) -> NDArray[np.uint32]:
    """What makes the noise of frames their own, two words each."""
    return np.concatenate([np.random.SeedSequence([scene.seed, index]).generate_state(2) for index in indices]).astype(np.uint32)


def develop_pixels(
    ar: Arrays, pipeline: Pipeline, t: dict[str, Any], colour: list[Values], pixel: Values, frame: Values, keys: Values,
    came: list[Values] | None = None,
) -> Values:  # fmt: skip
    """8-bit red, green and blue in the low three bytes of a word, for every lane.

    Args:
        t: Of `camera_pipeline`.
        colour: Radiance by channel.
        pixel, frame: Number of the pixel in its frame, and of the frame in `keys` (words, of `frame_keys`).
        came: Column and row [px] in the picture at rest of the coat that is seen, where there is a photograph of it.
    """
    number, gain = t["camera"], t["gain"]
    pixels = len(gain) // 3
    levels = [a * (ar.gather(gain, pixel + c * pixels) if pipeline.by_pixel else gain[c]) for c, a in enumerate(colour)]
    if came is not None:
        columns, rows = pipeline.rest
        even = ar.packet(t["rest_even"], pixel, 4)
        paint = mixed(ar, t["rest_paint"], grid_corners(ar, came[0] - 0.5, came[1] - 0.5, columns, rows, pixel * 0), 4)
        levels = [paint[c] * (even[c] + a) for c, a in enumerate(levels)]
    if pipeline.early_noise:
        normal = _normals(ar, pixel, frame, keys, 0)
        levels = [a + ar.sqrt(ar.maximum(a, 0.0) * number[c] + number[3 + c]) * normal[c] for c, a in enumerate(levels)]
    levels = [ar.minimum(ar.maximum(a, 0.0), 1.0) for a in levels]
    if pipeline.srgb:
        levels = [ar.select(a <= SRGB_FOOT, 12.92 * a, 1.055 * ar.power(ar.maximum(a, SRGB_FOOT), 1 / 2.4) - 0.055) for a in levels]
    if pipeline.bent:
        levels = [ar.power(ar.maximum(a, 1e-6), number[9]) for a in levels]
    levels = [255.0 * a for a in levels]
    if pipeline.late_noise:
        normal = _normals(ar, pixel, frame, keys, 1)
        levels = [a + number[6 + c] * normal[c] for c, a in enumerate(levels)]
    red, green, blue = (ar.words(ar.whole(ar.minimum(ar.maximum(a, 0.0), 255.0) + 0.5)) for a in levels)
    return red | (green << 8) | (blue << 16)


def _normals(ar: Arrays, pixel: Values, frame: Values, keys: Values, draw: int) -> list[Values]:
    """Three standard normal numbers a lane."""
    v = [ar.words(pixel), ar.gather(keys, frame * 2), ar.gather(keys, frame * 2 + 1) + draw]
    v = [a * 1664525 + 1013904223 for a in v]
    for turn in range(2):
        for i in range(3):
            v[i] = v[i] + v[(i + 1) % 3] * v[(i + 2) % 3]
        if turn == 0:
            v = [a ^ (a >> 16) for a in v]
    # 23 bits a radius, up to 5.8 standard deviations; 16 bits an angle.
    near, far = (ar.sqrt(-2.0 * ar.log((ar.real(word >> 9) + 0.5) * 2.0**-23)) for word in v[:2])
    one, other = (ar.real(half) * (2 * np.pi / 65536) for half in (v[2] & 0xFFFF, v[2] >> 16))
    return [near * ar.cos(one), near * ar.sin(one), far * ar.cos(other)]


def packed_bytes(ar: Arrays, words: Values) -> Values:
    """The low three bytes of each word, one after the other: four of them make three words."""
    last = len(words) - 1
    lane = ar.range(-(-len(words) // 4) * 3)
    place = lane - lane // 3 * 3
    first = lane // 3 * 4 + place
    shift = ar.words(place * 8)
    low, high = (ar.gather(words, ar.minimum(at, last)) for at in (first, first + 1))
    return (low >> shift) | (high << (24 - shift))


def as_picture(packed: NDArray[np.uint32], shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """What `packed_bytes` packed, on the host: shape (*shape, 3)."""
    return packed.astype("<u4", copy=False).view(np.uint8)[: 3 * int(np.prod(shape))].reshape(*shape, 3)


class Developer:
    """`develop` on the backend that drew the picture, made ready once."""

    def __init__(self, scene: Scene, arrays: Arrays, rest: dict[str, Values] | None = None) -> None:
        """`rest`: Of `rest_on`, of a sensor with a photograph."""
        self._scene, self._arrays = scene, arrays
        pipeline, self._tables = camera_pipeline(scene, arrays)
        self._tables |= rest or {}

        def developed(tables: dict[str, Any], radiance: Values, keys: Values, came: Values | None) -> Values:
            pixel = arrays.range(len(radiance) // 3)
            colour = [arrays.gather(radiance, pixel * 3 + channel) for channel in range(3)]
            place = None if came is None else list(arrays.packet(came, pixel, 2))
            return packed_bytes(arrays, develop_pixels(arrays, pipeline, tables, colour, pixel, pixel * 0, keys, place))

        self._developed: Any = arrays.compiled(developed)

    def __call__(self, radiance: Values, index: int, came: Values | None = None) -> Values:
        """Of interleaved red, green and blue of all pixels; for `as_picture`. `came`: of `RestPlaces`."""
        return self._developed(self._tables, radiance, self._arrays.words(frame_keys(self._scene, [index])), came)
