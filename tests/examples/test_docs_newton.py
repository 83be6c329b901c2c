"""What the page says about Newton and Isaac Lab runs: the first whole, the second on a stand-in for the little of it that is called."""

from __future__ import annotations

import re
import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation


def blocks(repository: Path, heading: str) -> list[str]:
    page = (repository / "docs" / "robot.md").read_text(encoding="utf-8")
    return re.findall(r"```python\n(.*?)```", page.partition(f"\n## {heading}\n")[2].partition("\n## ")[0], re.DOTALL)


def test_a_ball_rests_in_newton(repository: Path) -> None:
    pytest.importorskip("newton")
    done = runpy.run_path(str(repository / "docs" / "studies" / "rest_in_newton.py"))["main"](["SolverXPBD"])
    assert len(done) == 2
    for row in done.values():
        assert row["off"] < 0.007  # tests/unit/test_live_newton.py derives it
        assert row["ms"] > 2 * row["own_ms"]  # it takes two steps of the solver at least


def test_the_page_shows_what_the_example_does(repository: Path) -> None:
    (code,) = blocks(repository, "In Newton")
    example = (repository / "docs" / "studies" / "rest_in_newton.py").read_text(encoding="utf-8")
    for line in code.replace('Pad(model, "pad", "ball", scene)', "pad").splitlines():
        assert line.partition("  #")[0].replace("[pad])", "[pad], period)") in example


class Sensor:
    """The part of Isaac Lab's sensors that theirs call: isaaclab/sensors/sensor_base.py at 3.0."""

    def __init__(self, cfg: SimpleNamespace) -> None:
        self.cfg, self.device, self._num_envs = cfg, "cpu", 2
        self.outdated, self._sim_physics_dt = [True, True], 0.005

    num_instances = property(lambda self: self._num_envs)

    def _initialize_impl(self) -> None: ...

    def reset(self, env_ids: object = None, env_mask: object = None) -> None:
        self.outdated = [True, True]

    def _resolve_indices_and_mask(self, env_ids: object, env_mask: object) -> object:
        return wp.array([index in env_ids for index in range(2)], dtype=wp.bool, device="cpu")  # type: ignore[operator]

    def _update_outdated_buffers(self) -> None:
        self._update_buffers_impl(wp.array(self.outdated, dtype=wp.bool, device="cpu"))  # type: ignore[attr-defined]
        self.outdated = [False, False]


POSES: dict[str, np.ndarray] = {}


class View:
    def __init__(self, path: str, device: str) -> None:
        self.path = path

    def get_world_poses(self) -> tuple[SimpleNamespace, SimpleNamespace]:
        import torch

        poses = torch.tensor(POSES[self.path], dtype=torch.float32)
        return SimpleNamespace(torch=poses[:, :3]), SimpleNamespace(torch=poses[:, 3:])


def subtract_frame_transforms(*poses: object) -> tuple[object, object]:
    """isaaclab/utils/math.py: the pose of the second frame in the first; quaternions x, y, z, w."""
    import torch

    gel, turn, thing, other = (pose.numpy().astype(float) for pose in poses)  # type: ignore[attr-defined]
    back = Rotation.from_quat(turn).inv()
    return torch.tensor(back.apply(thing - gel)).float(), torch.tensor((back * Rotation.from_quat(other)).as_quat()).float()


def test_the_code_for_isaac_lab_asks_each_sensor_at_its_pose(repository: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Isaac Lab itself is not here: two environments, one gel upright, one turned anyhow, feel the same press."""
    torch = pytest.importorskip("torch")
    found = {
        name: ModuleType(name)
        for name in ("isaaclab", "isaaclab.sensors", "isaaclab.sim", "isaaclab.sim.views", "isaaclab.utils", "isaaclab.utils.math")
    }
    for name, module in found.items():
        monkeypatch.setitem(sys.modules, name, module)
    found["isaaclab.sensors"].SensorBase = Sensor  # type: ignore[attr-defined]
    found["isaaclab.sensors"].SensorBaseCfg = object  # type: ignore[attr-defined]
    found["isaaclab.sim.views"].FrameView = View  # type: ignore[attr-defined]
    found["isaaclab.utils"].configclass = lambda cls: cls  # type: ignore[attr-defined]
    found["isaaclab.utils.math"].subtract_frame_transforms = subtract_frame_transforms  # type: ignore[attr-defined]
    monkeypatch.chdir(repository)
    (code,) = blocks(repository, "In Isaac Lab")
    names: dict = {"__name__": "page"}
    exec(code, names)
    turn = Rotation.from_rotvec([0.3, -1.2, 2.0])
    pressed = np.array([1e-4, 0, -3e-4])
    POSES["gel"] = np.array([[0, 0, 0, 0, 0, 0, 1], [0.1, 0.2, 0.3, *turn.as_quat()]])
    POSES["ball"] = np.array([[*pressed, 0, 0, 0, 1], [*(turn.apply(pressed) + [0.1, 0.2, 0.3]), *turn.as_quat()]])
    cfg = names["GelCfg"]()
    cfg.prim_path, cfg.object_path, cfg.scene, cfg.update_period = "gel", "ball", "scenes/press_ball_rigid.toml", 0.01
    gel = names["Gel"](cfg)
    gel._initialize_impl()
    wrenches = gel.data.numpy().copy()
    assert wrenches[0, 2] < -0.01
    # poses of 0.3 m in single precision are known to 3e-8 m, of 3e-4 m that the ball is deep
    assert np.abs(wrenches[1, :3] - wrenches[0, :3]).max() < 1e-3 * -wrenches[0, 2]
    POSES["ball"][:, 2] += 0.01
    gel.reset([0])
    gel.outdated = [True, False]
    after = gel.data.numpy()
    assert (after[0] == 0).all() and (after[1] == wrenches[1]).all()
    assert torch.is_tensor(gel.data)
