"""What the Gymnasium environments of hands with gels share; importing it registers them: "gelsim/Lift-v0" and "gelsim/Insert-v0"."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names come from compiled modules, whose types pyright does not know.

from __future__ import annotations

from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from gelsim.errors import SceneError
from gelsim.live.mujoco import Pad, Touch, add_pad
from gelsim.scene.definition import Scene

CONTROL_STEPS = 10
"""Steps of the model to one of an environment: 20 ms."""

gymnasium.register("gelsim/Lift-v0", entry_point="gelsim.live.gripper:LiftEnv")
gymnasium.register("gelsim/Insert-v0", entry_point="gelsim.live.insertion:InsertEnv")


def between_fingers(spec: mujoco.MjSpec, thing: str, scene: Scene, period: float = 0.0) -> Touch:
    """Compiles a model whose bodies "left" and "right" hold the body `thing`, with pads "left" and "right" on them.

    Args:
        period: Between answers of a gel [s], as of `Touch`.
    """
    sides = {"left": 0.5**0.5, "right": -(0.5**0.5)}  # z of each gel points at the other
    for side, turn in sides.items():
        add_pad(spec, spec.body(side), f"{side}_pad", scene, against=thing, quat=(0.5**0.5, 0.0, turn, 0.0))
    model = spec.compile()
    return Touch(model, mujoco.MjData(model), [Pad(model, f"{side}_pad", thing, scene) for side in sides], period)


class TactileEnv(gymnasium.Env):
    """A model whose two pads feel. Observed are the motion of their markers [px], (2, K, 2), 0 where one is out of the picture, with
    `image` their pictures, (2, H, W, 3), and what `measured` gives."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 50}

    def __init__(self, touch: Touch, measured: dict[str, spaces.Space], *, image: bool, render_mode: str | None) -> None:
        """Takes a model with a camera "view".

        Args:
            measured: Spaces of what is observed beside markers and pictures.
            image: Pictures in the observation; a sensor's first measures its light, seconds.
            render_mode: None, or "rgb_array": `render()` draws the scene, which needs OpenGL.
        """
        self.model, self.data, self.touch = touch.model, touch.data, touch
        self.render_mode, self._image = render_mode, image
        self._rest = self._read()
        self._renderer: mujoco.Renderer | None = None
        seen: dict[str, spaces.Space] = {"markers": spaces.Box(-1e4, 1e4, self._rest.shape, np.float32)} | measured
        if image:
            seen["image"] = spaces.Box(0, 255, (2, *touch.pads[0].image().shape), np.uint8)
        self.observation_space = spaces.Dict(seen)

    def measured(self) -> dict[str, NDArray]:
        """What is observed beside markers and pictures, now."""
        raise NotImplementedError

    def render(self) -> NDArray[np.uint8] | None:  # type: ignore[override]
        """The scene, (240, 320, 3)."""
        if self.render_mode is None:
            return None
        if self._renderer is None:
            self._renderer = mujoco.Renderer(self.model, 240, 320)
        self._renderer.update_scene(self.data, "view")
        return self._renderer.render()

    def close(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _go(self) -> bool:
        """One step of the environment; False where the gels were squeezed deeper than they answer for."""
        try:
            for _ in range(CONTROL_STEPS):
                self.touch.step()
        except SceneError:
            return False
        return True

    def _clear(self, seed: int | None) -> None:
        """Model and pads as they were made."""
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        self.touch.reset()

    def _read(self) -> NDArray:
        """Marker centres of both gels now [px], (2, K, 2)."""
        return np.stack([pad.sensor.marker_pixels() for pad in self.touch.pads])

    def _seen(self) -> dict[str, Any]:
        seen = {"markers": np.nan_to_num(self._read() - self._rest).astype(np.float32)} | self.measured()
        if self._image:
            seen["image"] = np.stack([pad.image() for pad in self.touch.pads])
        return seen
