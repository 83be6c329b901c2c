"""Derivatives of a picture with respect to lights, coating and camera, by reverse-mode differentiation of `optics.tracer` (Dr.Jit).

For a picture L(p) and weights w of its shape: d(Σ w L)/dp for every number of the named fields, at the cost of a few pictures. The random
numbers are held. Where an edge of a shadow or of the membrane moves, and where a gathered ray meets the membrane, the derivative is left
out (see `optics.tracer`); so is the flakes' albedo as a function of their roughness in what the camera does not see. Tests hold it against
central differences.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import RenderError, SceneError
from gelsim.optics.tracer import Tracer
from gelsim.optics.variant import VariantChoice, use_variant
from gelsim.results import Membrane
from gelsim.scene.definition import Scene


def picture_gradient(
    scene: Scene,
    membrane: Membrane,
    names: Sequence[str],
    weights: NDArray[np.floating],
    variant: VariantChoice,
    seed: int = 0,
) -> tuple[NDArray[np.float32], dict[str, NDArray[np.float64]]]:
    """A picture, and the derivatives of its weighted sum.

    Args:
        names: Of "lights.N.position_mm", ".direction", ".size_mm", ".rgb", ".power", "coating.albedo", ".specular", ".roughness",
            ".flake_reflectance", "camera.distance_mm", ".offset_mm"; N counts the lights from 0.
        weights: Of each channel of each pixel, shape (H, W, 3).
        variant: One that differentiates: "llvm_ad_rgb" or "cuda_ad_rgb".
    Returns:
        Linear radiance (H, W, 3), and by name the derivative by each of the field's numbers in the unit of its name, shape (1,) to (3,).
    Raises:
        RenderError: The variant does not differentiate.
        SceneError: An unknown name, or weights of another shape than the picture.
    """
    if "_ad_" not in variant.name:
        raise RenderError(f"{variant.name} does not differentiate; llvm_ad_rgb and cuda_ad_rgb do (gelsim doctor says what is missing)")
    width, height = scene.render.resolution
    if np.shape(weights) != (height, width, 3):
        raise SceneError(f"weights have the shape {np.shape(weights)}: expected that of the picture, {(height, width, 3)}")
    mi = use_variant(variant)
    import drjit as dr

    tracer = Tracer(mi, scene, scene.render.spp)
    for name in names:
        if name not in tracer.values:
            raise SceneError(f"{name!r} is no field to differentiate by; known are {', '.join(tracer.values)}")
        dr.enable_grad(tracer.values[name])
    tracer.place(membrane)
    picture = tracer.picture(seed)
    dr.backward(dr.sum(picture * mi.TensorXf(np.asarray(weights, np.float32)), axis=None))
    slopes = {name: np.array(dr.grad(tracer.values[name]), np.float64).ravel() for name in names}
    return np.array(dr.detach(picture), np.float32), slopes
