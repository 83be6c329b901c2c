"""A rigid object's rims have their radius where a press reduces to a profile, too."""

from __future__ import annotations

import numpy as np
import pytest

from gelsim.mesh.profiles import mesh_profiles
from gelsim.scene.layers import build_scene
from gelsim.shape.outlines import edge_radius, profile, rounded
from gelsim.units import MM


def outline(shape: str, rim_mm: float, **fields: float) -> tuple[np.ndarray, tuple]:
    body = build_scene({"object": {"shape": shape, "rigid": True, "edge_radius_mm": rim_mm} | fields}).object
    segments = rounded(profile(body), edge_radius(body))
    return np.vstack([segment.samples() for segment in segments]) / MM, segments


@pytest.mark.parametrize(
    ("shape", "fields"), [("punch", {"radius_mm": 2.0}), ("frustum", {"radius_mm": 2.0, "angle_deg": 60.0}), ("cone", {"radius_mm": 4.0})]
)
def test_rims_and_tips_are_arcs_that_touch_their_lines(shape: str, fields: dict[str, float]) -> None:
    points, segments = outline(shape, 0.3, **fields)
    arcs = [segment for segment in segments if segment.radius]
    assert [arc.radius / MM for arc in arcs] == pytest.approx([0.3] * len(arcs)) and arcs
    for one, other in zip(segments[:-1], segments[1:], strict=True):
        assert one.end == pytest.approx(other.start) and one.way(1) == pytest.approx(other.way(0), abs=1e-9)
    assert points[:, 1].min() == pytest.approx(0.0, abs=1e-12) and points[0] == pytest.approx([0.0, 0.0])
    if shape == "punch":  # the flat ends a radius before the rim
        assert segments[0].end[0] / MM == pytest.approx(1.7)
    if shape == "cone":  # a ball, whose centre lies a radius above the apex
        assert arcs[0].centre == pytest.approx((0.0, 0.3 * MM))


def test_a_rim_of_no_radius_stays_sharp() -> None:
    assert outline("punch", 0.0, radius_mm=2.0)[0] == pytest.approx(np.array([[0, 0], [2, 0], [2, 0], [2, 25]]), abs=1e-9)


def test_a_press_as_a_profile_has_them() -> None:
    """It once was the sharp punch's, 9 % too stiff."""
    scene = build_scene({
        "object": {"shape": "punch", "rigid": True, "radius_mm": 2.0, "edge_radius_mm": 0.3},
        "gel": {"profile": "flat"}, "press": {"depth_mm": 0.3, "symmetry": "axisymmetric"}, "fidelity": "fast",
    })  # fmt: skip
    _, body = mesh_profiles(scene)
    nodes = body.nodes / MM
    rim = nodes[(nodes[:, 0] > 1.7 + 1e-6) & (nodes[:, 1] < 0.3 - 1e-6)]
    assert len(rim) > 4 and np.hypot(rim[:, 0] - 1.7, rim[:, 1] - 0.3) == pytest.approx(0.3, abs=1e-9)
