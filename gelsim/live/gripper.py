"""A two-finger gripper with a gel on each finger over a table, an egg to lift, and that as a Gymnasium environment.

The fingers are coupled, as a parallel gripper's are. Both commands are speeds: of closing, and of the lift. What a policy sees is what
such a gripper has: forces and markers of both gels, and its own joints; pictures on demand. How heavy the thing is it has to feel.

Left out: an arm, cables, the time that a camera takes.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names come from compiled modules, whose types pyright does not know.

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from gelsim.live.environment import TactileEnv, between_fingers
from gelsim.live.mujoco import Touch
from gelsim.scene.definition import Scene
from gelsim.scene.layers import build_scene
from gelsim.units import MM

GEL = {
    "gel": {"profile": "flat", "youngs_modulus_kpa": 60.0},
    "object": {"shape": "hemisphere", "rigid": True},  # in its place comes the model's
    "contact": {"friction_coefficient": 0.5},
}
WORLD = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <visual><global offwidth="640" offheight="480"/><headlight diffuse=".5 .5 .5"/></visual>
  <worldbody>
    <light pos=".1 -.2 .4" dir="-.2 .4 -.8"/>
    <camera name="view" pos=".03 -.22 .07" xyaxes="1 .13 0 -.02 .15 1" fovy="40"/>
    <geom type="plane" size=".2 .2 .01" rgba=".35 .4 .45 1" solref=".004 1" priority="1"/>
    <body name="thing" pos="0 0 .016">
      <freejoint/>
      <geom type="ellipsoid" size=".0125 .0125 .016" rgba=".9 .85 .7 1" friction="0.5"/>
    </body>
    <body name="hand" pos="0 0 .016" gravcomp="1">
      <joint name="lift" type="slide" axis="0 0 1" range="0 .08" damping="1"/>
      <geom type="box" size=".05 .008 .005" pos="0 0 .045" mass=".5" rgba=".3 .3 .3 1" contype="0" conaffinity="0"/>
      <body name="left" pos="-.022 0 0" gravcomp="1">
        <joint name="left" type="slide" axis="1 0 0" range="0 .02" damping="1"/>
        <geom type="box" size=".003 .01 .02" pos="-.007 0 .02" mass=".1" rgba=".3 .3 .3 1" contype="0" conaffinity="0"/>
      </body>
      <body name="right" pos=".022 0 0" gravcomp="1">
        <joint name="right" type="slide" axis="-1 0 0" range="0 .02" damping="1"/>
        <geom type="box" size=".003 .01 .02" pos=".007 0 .02" mass=".1" rgba=".3 .3 .3 1" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="left" joint2="right" solref="0.004 1"/></equality>
  <actuator>
    <intvelocity name="close" joint="left" kp="4000" kv="60" actrange="0 .02" ctrlrange="-.02 .02"/>
    <intvelocity name="lift" joint="lift" kp="8000" kv="200" actrange="0 .08" ctrlrange="-.05 .05"/>
  </actuator>
</mujoco>
"""
PERIOD = 0.01
"""Between answers of a gel [s]."""
CLOSING, LIFTING = 0.02, 0.05
"""Speeds of the action ±1 [m/s]."""
LIFTED = 0.03
"""Height at which the thing counts as lifted [m]."""
CRUSHED = 3.0
"""Normal force that breaks it [N]."""
MASSES = 0.01, 0.04
"""Between which a reset draws the thing's mass [kg]."""
EPISODE_STEPS = 200
"""4 s."""


def gripper(scene: Scene, mass: float, part: Path | None = None) -> tuple[mujoco.MjModel, mujoco.MjData, Touch]:
    """Model, state and pads "left" and "right" of a gripper around a quail's egg; actuators "close" and "lift" [m/s].

    Args:
        mass: Of the egg [kg].
        part: An STL file [mm] of what stands there in place of the egg, z up, on z = 0.
    """
    spec = mujoco.MjSpec.from_string(WORLD)
    thing = spec.body("thing")
    (geom,) = thing.geoms
    geom.mass = mass
    if part is not None:
        spec.add_mesh(name="part", file=str(part), scale=[MM] * 3)
        geom.type, geom.meshname, geom.size = mujoco.mjtGeom.mjGEOM_MESH, "part", [0.0] * 3
        thing.pos = [0.0] * 3
    touch = between_fingers(spec, "thing", scene, PERIOD)
    return touch.model, touch.data, touch


class LiftEnv(TactileEnv):
    """Lift an egg of unknown mass without breaking it: "gelsim/Lift-v0".

    Action: closing and lifting speed, (2,), of ±1: ±0.02 and ±0.05 m/s. Observation: "markers" and "image" of `TactileEnv`; "force", on
    both gels in their frames [N], (2, 3); "joints", closing of both fingers and height of the hand [m], (2,). Reward: height gained [dm],
    and 1 where it is lifted or -1 where it breaks, which both end an episode. `info["mass"]` [kg] is what the policy does not see.
    """

    def __init__(self, scene: Scene | None = None, *, image: bool = False, render_mode: str | None = None) -> None:
        """Makes model and sensors.

        Args:
            scene: Of the gels; flat ones of 60 kPa with friction 0.5 by default.
            image, render_mode: As of `TactileEnv`.
        """
        *_, touch = gripper(scene or build_scene(GEL), mass=MASSES[0])
        measured: dict[str, spaces.Space] = {
            "force": spaces.Box(-1e3, 1e3, (2, 3), np.float32),
            "joints": spaces.Box(-1.0, 1.0, (2,), np.float32),
        }
        super().__init__(touch, measured, image=image, render_mode=render_mode)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self._thing = self.model.body("thing").id

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict[str, NDArray], dict[str, Any]]:
        self._clear(seed)
        mass = float(self.np_random.uniform(*MASSES))
        self.model.body_inertia[self._thing] *= mass / self.model.body_mass[self._thing]
        self.model.body_mass[self._thing] = mass
        self._steps = 0
        self.touch.step()
        return self._seen(), self._info()

    def step(self, action: NDArray) -> tuple[dict[str, NDArray], float, bool, bool, dict[str, Any]]:
        before = self._height()
        self.data.ctrl[:] = np.clip(action, -1, 1) * (CLOSING, LIFTING)
        broken = not self._go()
        self._steps += 1
        broken |= max(-pad.wrench[2] for pad in self.touch.pads) > CRUSHED
        lifted = self._height() > LIFTED and not broken
        reward = 10 * (self._height() - before) + lifted - broken
        return self._seen(), float(reward), bool(broken or lifted), self._steps >= EPISODE_STEPS, self._info()

    def measured(self) -> dict[str, NDArray]:
        closing = self.data.joint("left").qpos[0] + self.data.joint("right").qpos[0]
        return {
            "force": np.stack([pad.wrench[:3] for pad in self.touch.pads]).astype(np.float32),
            "joints": np.array([closing, self.data.joint("lift").qpos[0]], np.float32),
        }

    def _height(self) -> float:
        """Of the thing over where it rests [m]."""
        return float(self.data.qpos[2] - self.model.qpos0[2])

    def _info(self) -> dict[str, Any]:
        return {"height": self._height(), "mass": float(self.model.body_mass[self._thing])}
