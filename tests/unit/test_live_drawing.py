"""A live sensor's coated surface on the backend that draws, beside the membrane by NumPy; and its picture's coarser inter-reflection."""

from __future__ import annotations

import numpy as np
import pytest
from test_baked import VARIANTS, flat_scene
from test_lightfield import linear_field

from gelsim.live import layer as gel_layer
from gelsim.live.drawing import INDIRECT_CELL, Surface
from gelsim.live.sensor import LiveSensor
from gelsim.membrane.surface import Grid
from gelsim.optics.arrays import choose_arrays
from gelsim.optics.baked import BakedRenderer
from gelsim.scene.definition import Body, Gel
from gelsim.units import MM_PER_M


def pressed(**gel: object) -> LiveSensor:
    """A ball pressed and drawn along."""
    ball = Body(shape="hemisphere", radius_mm=2.0, height_mm=4.0, rigid=True)
    sensor = LiveSensor(flat_scene(gel=Gel(**({"size_mm": (8.0, 8.0)} | gel)), object=ball), image=False)  # type: ignore[arg-type]
    for x, z in ((0.5, -0.4), (0.5, -0.8), (0.9, -0.8)):
        sensor.step((x * 1e-3, 0.4e-3, z * 1e-3, 1.0, 0.0, 0.0, 0.0), 0.01)
    return sensor


@pytest.mark.parametrize("variant", VARIANTS, ids=lambda v: v.name)
@pytest.mark.parametrize(
    "gel", [{"profile": "flat"}, {"profile": "dome", "edge_thickness_mm": 1.6}, {"profile": "cylinder", "radius_mm": 12.0}]
)
def test_the_surface_is_the_membrane(variant, gel: dict, monkeypatch: pytest.MonkeyPatch) -> None:
    """To single precision; on domes to what the rest height is off between nodes, 1 µm and its slope, but for the kink in their corners."""
    sensor = pressed(**gel)
    grid = Grid(sensor._scene.gel, gel_layer.CELL_MM * 1e-3)
    known = grid.membrane(sensor.displaced(grid.places), np.zeros((0, 3)))
    middle = np.linalg.norm(grid.places, axis=1) < 3.6e-3

    def apart() -> tuple[float, float]:
        """Places [mm], normals."""
        arrays = choose_arrays(variant)
        places, normals = Surface(arrays, sensor._scene.gel, sensor._layer).under(sensor._state.shown)
        off = arrays.numpy(places).reshape(-1, 4)[:, :3] - known.positions * MM_PER_M
        turned = arrays.numpy(normals).reshape(-1, 2) - known.normals[:, :2]
        return float(np.abs(off[middle]).max()), float(np.abs(turned[middle]).max())

    assert np.less(apart(), (2e-6, 1e-5) if gel["profile"] == "flat" else (1.2e-3, 2e-3)).all()
    monkeypatch.setattr(gel_layer, "LOOKS", 1)  # planted
    assert np.greater(apart(), 1e-2).all()


@pytest.mark.parametrize("variant", VARIANTS, ids=lambda v: v.name)
def test_coarser_inter_reflection_is_not_seen(variant) -> None:
    sensor = pressed(size_mm=(16.0, 16.0), profile="flat")
    field = linear_field()
    scene, surface = sensor._scene, Surface(choose_arrays(variant), sensor._scene.gel, sensor._layer)

    def picture(**cell: float) -> np.ndarray:
        renderer = BakedRenderer(scene, field, variant, **cell)
        renderer.upload([surface.still])
        return renderer.fetch(renderer.launch(surface.under(sensor._state.shown)))[0]

    fine = picture()

    def off(cell: float) -> float:
        return float(np.sqrt(np.nanmean((picture(cell=cell) - fine) ** 2)) / np.nanmean(fine))

    assert off(INDIRECT_CELL) < 0.003 < off(1.6)
