"""A hand whose two gels hold a peg over a hole that is up to 1 mm aside, and that as a Gymnasium environment.

The peg is steel, 6 mm thick, its end a flat dome of 1.2 mm; the hole is 0.2 mm wider. Where the end rests on the rim it is pushed aside,
and the peg turns in the gels: force and torque on them say where it rests. Contact of peg and plate is MuJoCo's.

Left out: an arm, the time that a camera takes, a peg held askew.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names come from compiled modules, whose types pyright does not know.

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from gelsim.live.environment import TactileEnv, between_fingers
from gelsim.live.mujoco import Touch
from gelsim.scene.definition import Scene
from gelsim.scene.layers import build_scene

STIFF_GEL = {
    "gel": {"profile": "flat", "youngs_modulus_kpa": 200.0, "size_mm": [18.0, 18.0]},
    "object": {"shape": "hemisphere", "rigid": True},  # in its place comes the model's
    "contact": {"friction_coefficient": 0.5},
    "camera": {"field_mm": [16.0, 12.0]},
}
WORLD = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <visual><global offwidth="640" offheight="480"/><headlight diffuse=".5 .5 .5"/><map znear=".1"/></visual>
  <default><geom solref=".01 1" friction=".4" rgba=".7 .7 .75 1"/></default>
  <statistic center="0 0 .02" extent=".1"/>
  <worldbody>
    <light pos=".1 -.2 .4" dir="-.2 .4 -.8" castshadow="false"/>
    <camera name="view" pos=".011 -.07 .036" xyaxes="1 .16 0 -.06 .38 .92" fovy="42"/>
    <geom type="plane" size=".2 .2 .01" pos="0 0 -.012" rgba=".35 .4 .45 1" contype="0" conaffinity="0"/>
    <body name="plate"/>
    <body name="peg" pos="0 0 .0195">
      <freejoint/>
      <geom type="box" size=".005 .004 .004" mass=".006" rgba=".9 .6 .3 1"/>
      <geom type="cylinder" size=".003" fromto="0 0 -.0173 0 0 -.004" mass=".003" rgba=".9 .6 .3 1"/>
      <geom type="ellipsoid" size=".003 .003 .0012" pos="0 0 -.0173" mass=".0002" rgba=".9 .6 .3 1"/>
    </body>
    <body name="hand" pos="0 0 .0195" gravcomp="1">
      <joint name="x" type="slide" axis="1 0 0" damping="1"/>
      <joint name="y" type="slide" axis="0 1 0" damping="1"/>
      <joint name="z" type="slide" axis="0 0 1" damping="1"/>
      <geom type="box" size=".03 .008 .005" pos="0 0 .035" mass=".5" rgba=".3 .3 .3 1" contype="0" conaffinity="0"/>
      <body name="left" pos="-.0052 0 0" gravcomp="1">
        <joint name="left" type="slide" axis="1 0 0" range="0 .015" damping="1"/>
        <geom type="box" size=".003 .009 .018" pos="-.0054 0 .012" mass=".1" rgba=".3 .3 .3 1" contype="0" conaffinity="0"/>
      </body>
      <body name="right" pos=".0052 0 0" gravcomp="1">
        <joint name="right" type="slide" axis="-1 0 0" range="0 .015" damping="1"/>
        <geom type="box" size=".003 .009 .018" pos=".0054 0 .012" mass=".1" rgba=".3 .3 .3 1" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="left" joint2="right" solref="0.004 1"/><weld name="held" body1="peg"/></equality>
  <actuator>
    <intvelocity name="x" joint="x" kp="8000" kv="200" actrange="-.01 .01"/>
    <intvelocity name="y" joint="y" kp="8000" kv="200" actrange="-.01 .01"/>
    <intvelocity name="z" joint="z" kp="8000" kv="200" actrange="-.02 .02"/>
    <intvelocity name="close" joint="left" kp="4000" kv="60" actrange="0 .015"/>
  </actuator>
</mujoco>
"""
TIP = 0.0185
"""From the hand's middle down to the peg's end [m]."""
HOLE, RIM = 3.1e-3, 6e-3
"""Inner radius of the hole, and width of the sixteen boxes about it [m]."""
SIDES = 16
OFFSET = 1e-3
"""The farthest that the hole is aside [m]."""
SPEED = 0.005
"""Of the action ±1 [m/s]."""
INSERTED = 0.005
"""Depth of the end in the hole at which the peg is in [m]."""
GRIP, GRIPPING = 5.0, 0.004
"""Normal force that the hand closes to [N]; speed over force that is missing [m/s per N]."""
SETTLING = 200
"""Steps of the model."""
MOST_PUSH = 2.0
"""Force down that breaks peg or plate [N]."""
EPISODE_STEPS = 200
"""4 s."""


def inserter(scene: Scene) -> Touch:
    """Model, state and pads "left" and "right" around a peg over a hole; actuators "x", "y", "z", "close" [m/s].

    The equality "held" keeps the peg in place until it is gripped.
    """
    spec = mujoco.MjSpec.from_string(WORLD)
    half = HOLE * np.tan(np.pi / SIDES)
    for angle in 2 * np.pi * np.arange(SIDES) / SIDES:
        out = (HOLE + RIM) * np.array([np.cos(angle), np.sin(angle), 0.0])
        turn = [np.cos(angle / 2), 0, 0, np.sin(angle / 2)]
        size = [RIM, half * (1 + 2 * RIM / HOLE), RIM]
        spec.body("plate").add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=size, pos=out - [0, 0, RIM], quat=turn)
    return between_fingers(spec, "peg", scene)


class InsertEnv(TactileEnv):
    """Put a peg into a hole that is up to 1 mm aside: "gelsim/Insert-v0".

    Action: speed of the hand along x, y, z, (3,), of ±1: ±5 mm/s. Observation: "markers" and "image" of `TactileEnv`; "wrench", what the
    peg exerts on both gels together since the reset, in the hand's frame about its middle [N, N m], (6,); "joints", where the hand is
    from where it began [m], (3,). Reward: depth gained over 5 mm, and 1 where the peg is in or -1 where more than 2 N push on it, or the
    gels are squeezed deeper than they answer for; all end an episode. `info["offset"]` [m], (2,), is what the policy does not see;
    `info["depth"]` [m]; `info["is_success"]`.
    """

    def __init__(self, scene: Scene | None = None, *, image: bool = False, render_mode: str | None = None) -> None:
        """Makes model and sensors.

        Args:
            scene: Of the gels; flat ones of 200 kPa with friction 0.5 by default.
            image, render_mode: As of `TactileEnv`.
        """
        measured: dict[str, spaces.Space] = {
            "wrench": spaces.Box(-1e3, 1e3, (6,), np.float32),
            "joints": spaces.Box(-1.0, 1.0, (3,), np.float32),
        }
        super().__init__(inserter(scene or build_scene(STIFF_GEL)), measured, image=image, render_mode=render_mode)
        self.action_space = spaces.Box(-1.0, 1.0, (3,), np.float32)
        self._weight = np.zeros(6)
        self._grip()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict[str, NDArray], dict[str, Any]]:
        self._clear(seed)
        angle, radius = self.np_random.uniform(0, 2 * np.pi), OFFSET * np.sqrt(self.np_random.uniform())
        self._offset = radius * np.array([np.cos(angle), np.sin(angle)])
        self.model.body("plate").pos[:2] = self._offset
        self.touch.state = self._gripped
        self._steps = 0
        return self._seen(), self._info()

    def step(self, action: NDArray) -> tuple[dict[str, NDArray], float, bool, bool, dict[str, Any]]:
        before = self._depth()
        self.data.ctrl[:3] = np.clip(action, -1, 1) * SPEED
        broken = not self._go() or bool(self.wrench()[2] > MOST_PUSH)
        self._steps += 1
        entered = self._depth() > INSERTED and not broken
        reward = (self._depth() - before) / INSERTED + entered - broken
        info = self._info() | {"is_success": entered}
        return self._seen(), float(reward), broken or entered, self._steps >= EPISODE_STEPS, info

    def _grip(self) -> None:
        """Closes on the peg, which a reset then returns to."""
        while (missing := GRIP + np.mean([pad.wrench[2] for pad in self.touch.pads])) > 0.05 * GRIP:
            self.data.actuator("close").ctrl = min(GRIPPING * missing, SPEED)
            self.touch.step()
        self.data.actuator("close").ctrl = 0.0
        self.data.eq_active[self.model.equality("held").id] = 0
        for _ in range(SETTLING):
            self.touch.step()
        self._weight = self.wrench()
        self._gripped = self.touch.state

    def measured(self) -> dict[str, NDArray]:
        joints = [self.data.joint(name).qpos[0] for name in "xyz"]
        return {"wrench": self.wrench().astype(np.float32), "joints": np.array(joints, np.float32)}

    def wrench(self) -> NDArray:
        """On both gels together since the reset, in the hand's frame about its middle [N, N m], (6,)."""
        total, middle = -self._weight, self.data.body("hand").xpos
        for pad in self.touch.pads:
            turn, arm = self.data.site_xmat[pad.site].reshape(3, 3), self.data.site_xpos[pad.site] - middle
            force, torque = turn @ pad.wrench[:3], turn @ pad.wrench[3:]
            total = total + np.concatenate([force, torque + np.cross(arm, force)])
        return total

    def _depth(self) -> float:
        """Of the peg's end below the plate's face [m]."""
        peg = self.data.body("peg")
        return float(TIP * peg.xmat[8] - peg.xpos[2])

    def _info(self) -> dict[str, Any]:
        return {"offset": self._offset.copy(), "depth": self._depth(), "is_success": False}
