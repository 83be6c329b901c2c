"""gelsim: a tactile simulator that joins contact finite elements with light transport.

    scene = gelsim.load_scene("scenes/press_cylinder.toml")
    press = gelsim.press(scene)
    frames = gelsim.render(scene, press)

Names are looked up when they are first used, so that importing the package costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gelsim.data.episodes import load_dataset
    from gelsim.errors import GelsimError, SceneError, SolveError
    from gelsim.live.batch import BatchFrame, LiveBatch
    from gelsim.live.sensor import LiveFrame, LiveSensor
    from gelsim.pipeline.poses import press_many
    from gelsim.pipeline.stages import press, press_sensitivity, render, simulate
    from gelsim.results import Deformation, Episode, Frame, Membrane, PressSensitivity
    from gelsim.scene.definition import Scene
    from gelsim.scene.layers import load_scene

_HOMES = {
    "BatchFrame": "gelsim.live.batch",
    "Deformation": "gelsim.results",
    "Episode": "gelsim.results",
    "Frame": "gelsim.results",
    "GelsimError": "gelsim.errors",
    "LiveBatch": "gelsim.live.batch",
    "LiveFrame": "gelsim.live.sensor",
    "LiveSensor": "gelsim.live.sensor",
    "Membrane": "gelsim.results",
    "PressSensitivity": "gelsim.results",
    "Scene": "gelsim.scene.definition",
    "SceneError": "gelsim.errors",
    "SolveError": "gelsim.errors",
    "load_dataset": "gelsim.data.episodes",
    "load_scene": "gelsim.scene.layers",
    "press": "gelsim.pipeline.stages",
    "press_many": "gelsim.pipeline.poses",
    "press_sensitivity": "gelsim.pipeline.stages",
    "render": "gelsim.pipeline.stages",
    "simulate": "gelsim.pipeline.stages",
}

__all__ = [
    "BatchFrame",
    "Deformation",
    "Episode",
    "Frame",
    "GelsimError",
    "LiveBatch",
    "LiveFrame",
    "LiveSensor",
    "Membrane",
    "PressSensitivity",
    "Scene",
    "SceneError",
    "SolveError",
    "load_dataset",
    "load_scene",
    "press",
    "press_many",
    "press_sensitivity",
    "render",
    "simulate",
]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'gelsim' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)
