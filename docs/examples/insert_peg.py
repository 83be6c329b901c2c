"""A hand puts a peg into a hole that is up to 1 mm aside: it moves away from where its two gels feel the peg's end rest on the rim.

    MUJOCO_GL=egl python docs/examples/insert_peg.py      # out/insert_peg.mp4, docs/images/gallery_insert.jpg; 3.5 minutes on two cores
    python docs/examples/insert_peg.py --quick            # 3 offsets, no video, no OpenGL

What is known to the controller is the wrench on the gels (`InsertEnv`), nothing of the hole. Blind to all of it but the push it stays
where it is and pushes; blind to that too it goes straight down. `pip install "gelsim[mujoco]"`.
"""

from __future__ import annotations

import os
import sys
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from functools import lru_cache
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from gelsim.live.insertion import SPEED, STIFF_GEL, TIP, InsertEnv
from gelsim.pipeline.outputs import encode_video
from gelsim.scene.layers import build_scene

VIDEO, PICTURE = Path("out/insert_peg.mp4"), Path("docs/images/gallery_insert.jpg")
FPS = 25
PUSH = 0.5
"""Force down [N]."""
SOFT = 0.01
"""Speed down over force that is missing [m/s per N]."""
AWAY, YIELD = 1.0, 0.004
"""Speed aside over the distance of where the end rests [1/s], over the force aside [m/s per N]."""
REACH = 0.003
"""Radius of the peg: it rests no farther out [m]."""
SHOWN = 1
"""Which offset the video shows."""


def touch(wrench: np.ndarray) -> np.ndarray:
    """Speed of the hand [m/s], (3,), from force and torque on the gels [N, N m], (6,)."""
    force, torque = wrench[:3], wrench[3:]
    rest = np.array([-torque[1] - TIP * force[0], torque[0] - TIP * force[1]]) / max(force[2], PUSH / 5)  # of the peg's end, from its axis
    rest *= min(1.0, REACH / max(np.hypot(*rest), 1e-9))
    return np.array([*(YIELD * force[:2] - AWAY * rest), SOFT * (force[2] - PUSH)])


def push(wrench: np.ndarray) -> np.ndarray:
    """The same, which does not feel where the end rests."""
    return touch(wrench) * [0, 0, 1]


def down(wrench: np.ndarray) -> np.ndarray:
    """Which feels nothing."""
    return np.array([0, 0, -SPEED])


POLICIES = {"touch": touch, "push": push, "down": down}


@lru_cache(maxsize=1)
def environment(video: bool) -> InsertEnv:
    return InsertEnv(build_scene(STIFF_GEL | {"render": {"resolution": [160, 120]}}), render_mode="rgb_array" if video else None)


def episode(policy: str, seed: int, video: bool) -> tuple[bool, float, float]:
    """Whether the peg came in, the greatest push [N], and how long it took [s]; with `video` it is written."""
    env, over, shown, most = environment(video), False, [], 0.0
    seen, info = env.reset(seed=seed)
    while not over:
        seen, _, done, late, info = env.step(POLICIES[policy](seen["wrench"]) / SPEED)
        over, most = done or late, max(most, float(env.wrench()[2]))
        if video:
            shown.append(picture(env, seen["wrench"]))
    if video:
        VIDEO.parent.mkdir(exist_ok=True)
        encode_video(VIDEO, shown[::2], FPS)
        sheet = [shown[i] for i in np.linspace(0, len(shown) - 1, 4, dtype=int)]
        Image.fromarray(np.hstack([np.vstack(sheet[:2]), np.vstack(sheet[2:])])).save(PICTURE, quality=80)
    return info["is_success"], most, env.data.time


def main(quick: bool = False, processes: int = 1) -> dict[str, dict[str, float]]:
    """The three on the same offsets.

    Returns:
        For each: tried, entered, how many pegs were in after 4 s; most_n, the greatest push; seconds, until a peg was in (mean).
    """
    tried = 3 if quick else 20
    asked = [(name, seed, not quick and (name, seed) == ("touch", SHOWN)) for name in POLICIES for seed in range(tried)]
    with ProcessPoolExecutor(processes) if processes > 1 else nullcontext() as pool:
        done = list((map if pool is None else pool.map)(episode, *zip(*asked, strict=True)))
    found = {}
    for number, name in enumerate(POLICIES):
        ends, pushes, times = zip(*done[number * tried : (number + 1) * tried], strict=True)
        in_time = [time for time, entered in zip(times, ends, strict=True) if entered]
        found[name] = {"tried": tried, "entered": sum(ends), "most_n": max(pushes), "seconds": float(np.mean(in_time or [np.nan]))}
    return found


def picture(env: InsertEnv, wrench: np.ndarray) -> np.ndarray:
    """The scene, and beside it what both gels see."""
    world = env.render()
    assert world is not None
    whole = Image.fromarray(np.hstack([world, np.vstack([pad.image() for pad in env.touch.pads])]))
    words = f"aside {wrench[0]:+.2f}, {wrench[1]:+.2f} N   push {wrench[2]:.2f} N   {1e3 * env.data.joint('z').qpos[0]:.1f} mm"
    ImageDraw.Draw(whole).text((6, 4), words, fill="white")
    return np.asarray(whole)


if __name__ == "__main__":
    for name, row in main(quick="--quick" in sys.argv[1:], processes=os.cpu_count() or 1).items():
        print(name, row)
