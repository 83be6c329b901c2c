"""A gripper lifts an egg or a screw of unknown weight: it closes until its gels feel it, and grips harder where they feel it about to slip.

    MUJOCO_GL=egl python docs/examples/lift_by_touch.py            # out/lift_by_touch.mp4; a minute, and two once for the light
    MUJOCO_GL=egl python docs/examples/lift_by_touch.py --screw    # out/lift_by_touch_screw.mp4
    python docs/examples/lift_by_touch.py --quick                  # no video, no OpenGL

What is known to the controller are the forces on the two gels (`Pad.wrench`), nothing of what they hold. Shear over normal force nears the
coefficient of friction where it slips; from SLIPPING on the grip rises. `pip install "gelsim[mujoco]"`.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import mujoco
import numpy as np
import trimesh
from PIL import Image, ImageDraw

from gelsim.bench import mesh_parts
from gelsim.live.gripper import GEL, gripper
from gelsim.live.mujoco import Pad
from gelsim.pipeline.outputs import encode_video
from gelsim.scene.layers import build_scene

VIDEO, SCREW_VIDEO = Path("out/lift_by_touch.mp4"), Path("out/lift_by_touch_screw.mp4")
FPS = 25
MASS = 0.03
"""Of either [kg]; it weighs 0.29 N."""
FIRST_GRIP = 0.2
"""Normal force at which closing ends [N]: too little for this weight."""
SLIPPING = 0.35
"""Shear over normal force from which the grip rises; the gels' friction is 0.5."""
TIGHTER = 4.0
"""How fast it rises then [N/s]."""
GAIN = 0.05
"""Closing speed over force that is missing [m/s per N]."""
LIFT = 0.03
"""[m/s]"""


def felt(pads: list[Pad]) -> tuple[float, float]:
    """Normal and shear force [N], the mean of both gels."""
    wrenches = np.array([pad.wrench for pad in pads])
    return abs(float(wrenches[:, 2].mean())), float(np.hypot(wrenches[:, 0], wrenches[:, 1]).mean())


def screw(path: Path) -> Path:
    """A headless screw, M12 and 12 mm long, that stands on its end: an STL file."""
    rod = mesh_parts.made("thread 6").rotate((0, -90, 0)).translate((0, 0, 6)).to_mesh()
    trimesh.Trimesh(rod.vert_properties[:, :3], rod.tri_verts).export(path)
    return path


def main(quick: bool = False, tighter: float = TIGHTER, thing: str = "egg") -> dict[str, float]:
    """Closes, holds, lifts an "egg" or a "screw" by 5 mm (quick) or 40 mm.

    Returns:
        height_mm of it over the table, hand_mm likewise of the hand, grip_n at the end, peak_n; step_ms, processor time of a
        step in touch (mean), and mj_step_ms, of MuJoCo's own.
    """
    scene = build_scene(GEL | {"render": {"resolution": [160, 120]}, "camera": {"field_mm": [18.0, 13.5]}})
    with tempfile.TemporaryDirectory() as folder:
        model, data, touch = gripper(scene, MASS, screw(Path(folder) / "screw.stl") if thing == "screw" else None)
    view = None if quick else mujoco.Renderer(model, 240, 320)
    grip, peak, seen, took = FIRST_GRIP, 0.0, [], []
    closed = lifted = False
    while not lifted:
        normal, shear = felt(touch.pads)
        closed = closed or normal > 0.95 * FIRST_GRIP
        slipping = shear > SLIPPING * normal
        if closed and slipping:
            grip += tighter * model.opt.timestep
        data.actuator("close").ctrl = np.clip(GAIN * (grip - normal), -0.02, 0.02)
        data.actuator("lift").ctrl = LIFT if closed and not (slipping and tighter) else 0.0  # it waits for the grip
        began = time.process_time()
        touch.step()
        if closed:
            took.append(time.process_time() - began)
        peak = max(peak, normal)
        lifted = data.joint("lift").qpos[0] > (0.005 if quick else 0.04)
        if view is not None and data.time * FPS >= len(seen):
            view.update_scene(data, "view")
            seen.append(picture(view.render(), touch.pads, f"normal {normal:.2f} N   shear {shear:.2f} N   grip {grip:.2f} N"))
    if seen:
        video = SCREW_VIDEO if thing == "screw" else VIDEO
        video.parent.mkdir(exist_ok=True)
        encode_video(video, seen, FPS)
    height = float(data.qpos[2] - model.qpos0[2])
    hand = float(data.joint("lift").qpos[0])
    began = time.process_time()
    for _ in range(100):
        mujoco.mj_step(model, data)
    alone = (time.process_time() - began) / 100
    return {"height_mm": 1e3 * height, "hand_mm": 1e3 * hand, "grip_n": grip, "peak_n": peak} | {
        "step_ms": 1e3 * float(np.mean(took)),
        "mj_step_ms": 1e3 * alone,
    }


def picture(world: np.ndarray, pads: list[Pad], words: str) -> np.ndarray:
    """The scene, and beside it what both gels see."""
    whole = Image.fromarray(np.hstack([world, np.vstack([pad.image() for pad in pads])]))
    ImageDraw.Draw(whole).text((6, 4), words, fill="white")
    return np.asarray(whole)


if __name__ == "__main__":
    print(main(quick="--quick" in sys.argv[1:], thing="screw" if "--screw" in sys.argv[1:] else "egg"))
