"""Pictures of a made-up press are what they were, within their noise (`picture_check`), and the faults that are planted here are seen.

A failure writes image, reference, difference and maps of p-values into out/golden/NAME.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from picture_check import Reference, compare, write_failure
from shown_scenes import KEPT, NEW, SHOWN, draw, marker_places, seeds, shown_scene, variants

from gelsim.membrane.markers import MarkerLayout
from gelsim.optics import coating
from gelsim.optics.variant import VariantChoice
from gelsim.scene.definition import Scene

FOLDER = Path(__file__).parent
PAIRS = [(name, family) for name, shown in SHOWN.items() for family in shown.families]


def variant_of(family: str) -> VariantChoice:
    found = variants()
    if family not in found:
        pytest.skip(f"Mitsuba's {family} variant does not draw on this machine")
    return found[family]


def reference(name: str) -> Reference:
    return Reference.load(FOLDER / f"{name}.npz")


@pytest.mark.parametrize(("name", "family"), PAIRS)
def test_picture_has_not_moved(name: str, family: str, regenerate: bool, repository: Path) -> None:
    variant, scene = variant_of(family), shown_scene(SHOWN[name])
    if regenerate:
        if family != SHOWN[name].families[0]:
            pytest.skip(f"{name}: the reference is drawn by {SHOWN[name].families[0]}")
        Reference.of(draw(scene, seeds(0, KEPT), variant), marker_places(scene)).save(FOLDER / f"{name}.npz")
        pytest.skip(f"{name}: written anew from {KEPT} pictures")
    kept = reference(name)
    found = compare(kept, draw(scene, seeds(1, NEW), variant))
    if found.faults:
        write_failure(repository / "out" / "golden" / f"{name}-{family}", kept, found)
    assert found.faults == []


def removed_marker(scene: Scene, patch: pytest.MonkeyPatch) -> Scene:
    """The one that is next to the picture's middle."""
    whole = coating.marker_layout(scene)
    keep = np.arange(len(whole.radii)) != np.hypot(*whole.centres.T).argmin()
    patch.setattr(coating, "marker_layout", lambda _: MarkerLayout(whole.centres[keep], whole.radii[keep], whole.outline[keep]))
    return scene


def shifted_marker(scene: Scene, patch: pytest.MonkeyPatch) -> Scene:
    """The same one, by a tenth of a pixel (5.75 µm)."""
    whole = coating.marker_layout(scene)
    centres = whole.centres.copy()
    centres[np.hypot(*whole.centres.T).argmin(), 0] += 5.75e-6
    patch.setattr(coating, "marker_layout", lambda _: replace(whole, centres=centres))
    return scene


def rotated_light(scene: Scene, patch: pytest.MonkeyPatch) -> Scene:
    """The first, about its own place: 2 degrees within the window's plane."""
    first, *others = scene.lights.lights
    cosine, sine = np.cos(np.radians(2.0)), np.sin(np.radians(2.0))
    x, y, z = first.direction
    turned = replace(first, direction=(cosine * x - sine * y, sine * x + cosine * y, z))
    return scene.replace(lights=replace(scene.lights, lights=(turned, *others)))


def brighter_coat(scene: Scene, patch: pytest.MonkeyPatch) -> Scene:
    """Albedo + 2 %."""
    red, green, blue = scene.coating.albedo
    return scene.replace(coating=replace(scene.coating, albedo=(1.02 * red, 1.02 * green, 1.02 * blue)))


FAULTS = {
    "removed_marker": (removed_marker, "missing"),
    "shifted_marker": (shifted_marker, "markers: 1 moved"),
    "rotated_light": (rotated_light, "tiles of "),
    "brighter_coat": (brighter_coat, "tiles of "),
}


PLANTED = [
    # All of them where there is least noise, and the faintest where there is most.
    pytest.param(name, fault, marks=[] if name == "direct" or (name, fault) == ("path", "rotated_light") else [pytest.mark.slow])
    for name in SHOWN
    for fault in FAULTS
]


@pytest.mark.parametrize(("name", "fault"), PLANTED)
def test_planted_fault_is_seen(name: str, fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    variant = variant_of(SHOWN[name].families[0])
    plant, told = FAULTS[fault]
    scene = plant(shown_scene(SHOWN[name]), monkeypatch)
    kept = reference(name)
    found = compare(kept, draw(scene, seeds(2, NEW), variant))
    assert any(told in line for line in found.faults), found.faults
    write_failure(tmp_path, kept, found)
    assert {path.name for path in tmp_path.iterdir()} == {
        "image.png", "reference.png", "difference.png", "p_value_1.png", "p_value_16.png", "p_value_60.png", "faults.json"
    }  # fmt: skip


@pytest.mark.parametrize("name", SHOWN)
def test_golden_pictures_hold_markers_and_stay_small(name: str) -> None:
    kept = reference(name)
    assert kept.mean.shape == (120, 160, 3) and kept.count == KEPT and len(kept.markers) == 35
    assert sum(path.stat().st_size for path in FOLDER.glob("*.npz")) < 2**20
