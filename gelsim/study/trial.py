"""One case of a study: its scene, and its press, membranes and pictures, each computed when a metric first asks for it, and once.

Metrics that need derivatives ask for the same case with other fields (`beside`); trials that were made so are kept, so that two metrics
which need the same neighbour share its press.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import SolveError, SolveStatus
from gelsim.results import Deformation, Frame, Membrane
from gelsim.scene.definition import Scene
from gelsim.scene.layers import Layer, build_scene, nested

T = TypeVar("T")


class Trial:
    """A scene to be measured.

    Args:
        layers: Of the scene, the last beats.
        device: "auto", "cpu" or "cuda".
    Raises:
        SceneError: They make no scene.
    """

    def __init__(self, layers: Sequence[Layer], device: str = "auto") -> None:
        self.scene: Scene = build_scene(*layers)
        self._layers, self.device = tuple(layers), device
        self._family: dict[str, Trial] = {}
        self._computed: dict[Any, Any] = {}

    def beside(self, fields: Mapping[str, Any]) -> Trial:
        """The same case with other values of some fields, by full name."""
        key = json.dumps(fields, sort_keys=True)
        if key not in self._family:
            other = Trial((*self._layers, nested(fields)), self.device)
            self._family[key] = other
        return self._family[key]

    def once(self, compute: Callable[..., T], *arguments: Any) -> T:
        """compute(self, *arguments), kept for who asks next."""
        key = (compute, arguments)
        if key not in self._computed:
            self._computed[key] = compute(self, *arguments)
        return self._computed[key]

    @cached_property
    def press(self) -> Deformation:
        """Raises SolveError where it did not come to its end."""
        from gelsim.pipeline import stages

        press = stages.press(self.scene, device=self.device, throw=False)
        if press.status is not SolveStatus.CONVERGED:
            raise SolveError(press.message or press.status.value, press)
        return press

    @cached_property
    def membranes(self) -> list[Membrane]:
        """Of every recorded state."""
        from gelsim.pipeline import stages

        return stages.membranes(self.scene, self.press)

    @cached_property
    def frames(self) -> list[Frame]:
        """Of every recorded state."""
        return self.draw(self.membranes)

    @cached_property
    def rest(self) -> Frame:
        """The picture without contact."""
        from gelsim.membrane.surface import rest_membrane

        return self.draw([rest_membrane(self.scene)])[0]

    def draw(self, membranes: Sequence[Membrane]) -> list[Frame]:
        """Pictures of membranes of the scene's gel."""
        from gelsim import optics

        return list(optics.render_frames(self.scene, membranes, device=self.device))

    def heights(self, state: int) -> NDArray[np.float64]:
        """Rest height taken from the height of the membrane that each pixel sees, at a recorded state [m], (H, W); NaN beside the gel."""
        from gelsim import optics
        from gelsim.membrane.surface import rest_membrane

        rest = optics.height_map(self.scene, rest_membrane(self.scene))
        return (optics.height_map(self.scene, self.membranes[state]) - rest).astype(np.float64)

    @property
    def force(self) -> NDArray[np.float64]:
        """Normal force of every recorded state [N]."""
        return -self.press.force[:, 2]
