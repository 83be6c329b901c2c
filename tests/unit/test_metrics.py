"""Picture errors against numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from gelsim.data.metrics import picture_errors


def test_equal_pictures(rng):
    picture = rng.uniform(0, 255, (20, 30, 3))
    errors = picture_errors(picture, picture)
    assert errors["l1"] == errors["mse"] == 0 and errors["ssim"] == pytest.approx(1, abs=1e-12) and errors["psnr_db"] == np.inf


def test_a_constant_shift():
    a, b = np.full((16, 16, 3), 100.0), np.full((16, 16, 3), 110.0)
    errors = picture_errors(a, b)
    assert errors["l1"] == 10 and errors["mse"] == 100 and errors["psnr_db"] == pytest.approx(20 * np.log10(25.5))
    # Without structure SSIM is its luminance term alone: (2 ab + C1) / (a² + b² + C1), C1 = 2.55².
    assert errors["ssim"] == pytest.approx((22000 + 6.5025) / (22100 + 6.5025), rel=1e-9)


def test_an_inverted_pattern_has_negative_structure(rng):
    pattern = rng.normal(0, 20, (40, 40, 1)) * np.ones(3)
    errors = picture_errors(128 + pattern, 128 - pattern)
    # Zero-mean windows would give -1 / (1 + C2 / 2σ²) = -0.93; the windows' own means are off by up to σ / sqrt(29).
    assert -1 < errors["ssim"] < -0.8
