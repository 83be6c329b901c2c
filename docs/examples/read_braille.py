"""A soft fingertip slides over a word in Braille and reads it: pressed as hard as its gel says, read from where its gel touches.

    MUJOCO_GL=egl python docs/examples/read_braille.py       # out/read_braille.mp4; a minute, and two once for the light
    python docs/examples/read_braille.py --quick             # no video, no OpenGL

Dots of 0.5 mm on a plate are small for the live sensor, whose cells are 0.2 mm: where they are it says well, their forces are 16 % off
(docs/live.md). `pip install "gelsim[mujoco]"`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image, ImageDraw

from gelsim.live.mujoco import Pad, Touch, add_pad
from gelsim.pipeline.outputs import encode_video
from gelsim.scene.layers import build_scene

VIDEO = Path("out/read_braille.mp4")
FPS = 25
WORD = "gel"
LETTERS = {"e": (1, 5), "g": (1, 2, 4, 5), "i": (2, 4), "l": (1, 2, 3), "m": (1, 3, 4), "s": (2, 3, 4)}
"""Dots of each letter: 1, 2, 3 down the left side, 4, 5, 6 down the right."""
PITCH, LETTER, DOT, ROUND = 2.34e-3, 6.2e-3, 0.5e-3, 0.77e-3
"""Between dots and between letters, height of a dot and the radius of its ball [m]."""
PRESS = 0.5
"""Normal force [N]."""
SPEED, GAIN = 0.02, 0.02
"""Of the slide [m/s]; speed down over force that is missing [m/s per N]."""
PAPER = 0.2e-3
"""Cell of the map of what was touched [m]."""
WORLD = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <visual><global offwidth="640" offheight="480"/></visual>
  <worldbody>
    <light pos="0 -.1 .2" dir="0 .4 -.8"/>
    <camera name="view" pos=".006 -.06 .03" xyaxes="1 0 0 0 .45 .9" fovy="42"/>
    <body name="plate"><geom type="box" size=".02 .006 .001" pos=".006 0 -.001" rgba=".9 .9 .85 1"/></body>
    <body name="finger" pos="-.006 0 .0015" gravcomp="1">
      <joint name="along" type="slide" axis="1 0 0"/>
      <joint name="down" type="slide" axis="0 0 -1"/>
      <geom type="box" size=".006 .006 .004" pos="0 0 .008" mass=".1" rgba=".3 .3 .3 1" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator>
    <intvelocity name="along" joint="along" kp="4000" kv="40" actrange="-.1 .1"/>
    <intvelocity name="down" joint="down" kp="4000" kv="40" actrange="-.1 .1"/>
  </actuator>
</mujoco>
"""


def spots(letter: int) -> np.ndarray:
    """Where the six dots of a letter can be on the plate [m], (6, 2)."""
    return np.array([[letter * LETTER + (dot // 3 - 0.5) * PITCH, (1 - dot % 3) * PITCH] for dot in range(6)])


def read(relief: np.ndarray, first: np.ndarray) -> str:
    """The word on a map of heights [m], (rows, columns) of PAPER from `first` [m] on; "?" for no letter that is known."""
    word = ""
    for letter in range(len(WORD)):
        columns, rows = np.round((spots(letter) - first) / PAPER).astype(int).T
        dots = tuple(int(dot) + 1 for dot in np.flatnonzero(relief[rows, columns] > DOT / 2))
        word += next((name for name, known in LETTERS.items() if known == dots), "?")
    return word


def main(quick: bool = False) -> dict[str, object]:
    """Lowers the finger beside the word and slides over it.

    Returns:
        read, the word; force_n, mean and standard deviation of the normal force while it slides.
    """
    scene = build_scene({"contact": {"friction_coefficient": 0.2}, "object": {"rigid": True}, "render": {"resolution": [320, 240]}})
    spec = mujoco.MjSpec.from_string(WORLD)
    for letter, name in enumerate(WORD):
        for x, y in spots(letter)[np.array(LETTERS[name]) - 1]:
            spec.body("plate").add_geom(size=[ROUND, 0, 0], pos=[x, y, DOT - ROUND], rgba=[0.9, 0.9, 0.85, 1])
    add_pad(spec, spec.body("finger"), "pad", scene, against="plate", quat=(0, 1, 0, 0))
    model = spec.compile()
    data = mujoco.MjData(model)
    pad = Pad(model, "pad", "plate", scene)
    touch = Touch(model, data, [pad])
    view = None if quick else mujoco.Renderer(model, 240, 320)
    first, relief = np.array([-0.012, -0.008]), np.zeros((81, 181))
    forces, seen = [], []
    while data.joint("along").qpos[0] < LETTER * len(WORD):
        normal = abs(float(pad.wrench[2]))
        data.actuator("down").ctrl = np.clip(GAIN * (PRESS - normal), -0.02, 0.02)
        sliding = bool(forces) or normal > 0.9 * PRESS
        data.actuator("along").ctrl = SPEED if sliding else 0.0
        touch.step()
        assert pad.frame is not None
        if sliding:
            forces.append(normal)
            rows, columns = np.nonzero(pad.frame.contact)
            turn, at = data.site_xmat[pad.site].reshape(3, 3), data.site_xpos[pad.site]
            cells = np.column_stack([pad.sensor.x[columns], pad.sensor.y[rows], pad.frame.height[rows, columns]]) @ turn.T + at
            column, row = np.round((cells[:, :2] - first) / PAPER).astype(int).T
            inside = (row >= 0) & (row < len(relief)) & (column >= 0) & (column < relief.shape[1])
            relief[row[inside], column[inside]] = cells[inside, 2]
        if view is not None and data.time * FPS >= len(seen):
            view.update_scene(data, "view")
            seen.append(picture(view.render(), pad.image(), relief, f"{normal:.2f} N"))
    if seen:
        VIDEO.parent.mkdir(exist_ok=True)
        encode_video(VIDEO, seen, FPS)
    return {"read": read(relief, first), "force_n": (float(np.mean(forces)), float(np.std(forces)))}


def picture(world: np.ndarray, gel: np.ndarray, relief: np.ndarray, words: str) -> np.ndarray:
    """The scene, what the gel sees, and below the relief that it has felt so far."""
    page = Image.fromarray((255 * np.clip(relief[::-1] / DOT, 0, 1)).astype(np.uint8)).resize((640, 286)).convert("RGB")
    whole = Image.fromarray(np.vstack([np.hstack([world, gel]), np.asarray(page)]))
    ImageDraw.Draw(whole).text((6, 4), words, fill="white")
    return np.asarray(whole)


if __name__ == "__main__":
    print(main(quick="--quick" in sys.argv[1:]))
