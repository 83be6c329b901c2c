"""A surface that comes to touch itself is seen in time, and only then."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gelsim.fem.self_contact import closing_gap
from gelsim.scene.definition import Body
from gelsim.shape.shapes import object_surface


def squashed(body: Body, shares: list[float]) -> tuple[int, float] | None:
    """The tube's ring squashed toward its neck, all of it in proportion to its height below it."""
    surface = object_surface(body, edge_length=2e-3, chord=1e-4)
    up = np.maximum(9e-3 - surface.vertices[:, 2], 0.0)
    shift = np.zeros((len(shares), *surface.vertices.shape))
    shift[:, :, 2] = np.array(shares)[:, None] * up
    return closing_gap(surface.vertices, surface.faces, shift)


TUBE = Body(shape="tube", height_mm=14, length_mm=8, wall_mm=1.0)


def test_a_flattened_tube_is_told_before_it_closes() -> None:
    # the bore is 8 mm high: with steps of 0.3 its height goes 5.6, 3.2, 0.8 mm, and the next step would close it
    found = squashed(TUBE, [0.0, 0.3, 0.6, 0.9])
    assert found is not None
    state, gap = found
    assert state == 3
    # a tenth of the bore's height over the middles of the facets, which lie up to (2 mm)²/(8·4 mm) inside it and up to 1 mm off its top
    assert 0.6e-3 < gap < 0.8e-3


def test_a_tube_that_is_only_pressed_is_not() -> None:
    assert squashed(TUBE, [0.0, 0.1, 0.2, 0.3]) is None


@pytest.mark.parametrize("shape", ["hemisphere", "box", "torus"])
def test_shapes_without_a_hollow_have_nothing_to_touch(shape: str) -> None:
    body = replace(TUBE, shape=shape, length_mm=None)
    assert squashed(body, [0.0, 0.3, 0.6, 0.9]) is None
