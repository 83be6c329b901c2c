"""Making datasets: trajectories, light that changes after its bake, workers that die, folders that cannot be used; at the end, slow, whole
datasets of a tiny plan: killed, resumed, with one and two workers."""

from __future__ import annotations

import atexit
import multiprocessing
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dataset_fixtures import TINY, contents, formula_field, put_fields

from gelsim import generate as generating
from gelsim.data import firmness
from gelsim.data.episodes import load_dataset
from gelsim.data.lightfield import write_field
from gelsim.data.motion import Motion
from gelsim.errors import DatasetError, SceneError, SolveStatus
from gelsim.generate import recording, run
from gelsim.generate.done import Done
from gelsim.generate.light import relit
from gelsim.generate.plan import Catalogue, EpisodeDraw, load_plan
from gelsim.generate.relight import relight, sensor_scene
from gelsim.generate.run import Book, Extent, Hands, generate, make_worker, report_of
from gelsim.optics import bake
from gelsim.results import Deformation
from gelsim.scene.definition import Body
from gelsim.scene.layers import build_scene
from gelsim.work import workers
from gelsim.work.workers import LocalCrew, WorkError, work_through


def drawn(**fields: Any) -> EpisodeDraw:
    plain: dict[str, Any] = {"index": 0, "end": 1.0, "frames": 25, "lead": 2, "hold": 3, "unevenness": 0.5, "layer": {}}
    return EpisodeDraw(**(plain | {"rng": np.random.default_rng(4)} | fields))


def test_a_robot_closes_at_its_speed_and_stays():
    path = recording.trajectory("robot", 1.5e-3, 6e-3, 30.0, drawn())
    moving = path[(path > 0) & (path < 1.5e-3)]
    np.testing.assert_allclose(np.diff(moving), 6e-3 / 30, rtol=1e-9)
    assert len(path) == 25 and (path[:2] == 0).all() and (path[-3:] == 1.5e-3).all() and path[2] <= 6e-3 / 30


def test_a_hand_takes_its_frames_unevenly_and_never_goes_back():
    path = recording.trajectory("human", 2e-3, 1.0, 30.0, drawn())
    steps = np.diff(path[1:-3])
    assert len(path) == 25 and (steps > 0).all() and path.max() == 2e-3
    assert steps.max() / steps.min() > 1.5
    even = np.diff(recording.trajectory("human", 2e-3, 1.0, 30.0, drawn(unevenness=0.0))[1:-3])
    np.testing.assert_allclose(even, even[0], rtol=1e-9)


def test_relit_is_what_a_field_of_the_other_lights_would_be():
    """The direct light exactly; planted: two lights exchanged are another field."""
    before = Catalogue(load_plan(TINY), 0).sensor_scene(0)
    lights = tuple(
        replace(light, power=light.power * gain, rgb=(0.5 * light.rgb[0], *light.rgb[1:]))
        for light, gain in zip(before.lights.lights, (1.3, 0.7, 1.0, 2.0), strict=True)
    )
    after = before.replace(lights=replace(before.lights, lights=lights))
    field = relit(formula_field(before), before, after)
    wanted = formula_field(after)
    # One product of float32 numbers.
    np.testing.assert_allclose(field.colours, wanted.colours, rtol=4e-7)
    swapped = after.replace(lights=replace(after.lights, lights=(lights[1], lights[0], *lights[2:])))
    with pytest.raises(SceneError, match="may change the powers and colours"):
        relit(formula_field(before), before, swapped)
    # Half of every light: half of the veil too, which is known for all lights together.
    half = before.replace(lights=replace(before.lights, lights=tuple(replace(li, power=0.5 * li.power) for li in before.lights.lights)))
    np.testing.assert_allclose(relit(formula_field(before), before, half).veil, 0.5 * formula_field(before).veil, rtol=1e-6)


def test_a_plan_that_presses_along_a_path_is_refused(tmp_path: Path):
    (tmp_path / "path.csv").write_text("t_s,x_mm,y_mm,z_mm\n0,0,0,0\n1,0,0,-0.2\n")
    plan = load_plan(TINY)
    fields = {**plan.press_fields, "press.depth_mm": "none", "press.force_n": "none", "press.path_csv": str(tmp_path / "path.csv")}
    with pytest.raises(SceneError, match=r"press.depth_mm = none: presses of a plan go to a depth"):
        Catalogue(replace(plan, press_fields=fields), 0).press(0)


@pytest.mark.parametrize("change", [{"camera": {"distance_mm": 41.0}}, {"coating": {"roughness": 0.2}}, {"gel": {"thickness_mm": 2.0}}])
def test_what_needs_another_bake_is_refused(change: dict[str, Any]):
    before = Catalogue(load_plan(TINY), 0).sensor_scene(0)
    after = build_scene({"render": {"resolution": [48, 36], "mode": "baked"}, "markers": {"pitch_mm": 3.0}}, change)
    with pytest.raises(SceneError, match="it changed more"):
        relit(formula_field(before), before, after)


def test_states_follow_the_expected_travel():
    hard = build_scene({"object": {"shape": "hemisphere", "rigid": True, "radius_mm": 5.0}, "press": {"depth_mm": 1.4, "force_n": 0.5}})
    soft = build_scene({"object": {"shape": "hemisphere", "shore_00": 10.0, "radius_mm": 25.0}, "press": {"depth_mm": 1.4}})
    # Measured: this ball carries 0.5 N at about 0.6 mm (assets/reference, scaled to this gel); the estimate may be off by two.
    assert 0.2e-3 < recording.expected_travel(hard) < 1.2e-3
    assert recording.resolved(hard).press.frames > recording.resolved(soft).press.frames == recording.STATES + 1


# ---- workers ----


def make_echo(*_: object):
    return lambda handful: Done(handful, rows=[({"index": number}, {}) for number in handful])


def make_dying(*_: object):
    def work(handful):
        if handful == (3,):
            os._exit(9)
        return Done(handful)

    return work


def first_to_make(path: Path) -> bool:
    try:
        path.touch(exist_ok=False)
    except FileExistsError:
        return False
    return True


def make_faulting(folder: Path):
    """Both of the first two workers fault in the middle of their second piece, and would not end by themselves."""
    number = next(number for number in range(9) if first_to_make(folder / str(number)))
    while not (folder / "1").exists():  # or the other's first piece might be the last one left
        time.sleep(0.01)
    done = []

    def work(handful):
        done.append(handful)
        if number < 2 and len(done) == 2:
            atexit.register(time.sleep, 1000.0)
            (folder / f"{number} faulted").touch()
            raise RuntimeError("an illegal memory access was encountered")
        return Done(handful)

    return work


def make_counting(*_: object):
    from threadpoolctl import threadpool_info

    return lambda handful: Done(handful, rows=[({pool["internal_api"]: pool["num_threads"] for pool in threadpool_info()}, {})])


def make_seeing(*_: object):
    return lambda handful: Done(
        handful, rows=[({"sees": os.environ["CUDA_VISIBLE_DEVICES"], "share": os.environ.get(workers.MPS_SHARE)}, {})]
    )


def make_still_born(how: str):
    if how == "exit":
        os._exit(7)
    atexit.register(time.sleep, 1000.0)
    raise OSError("no GPU")


def make_killed(*_: object):
    """Every piece ends its worker, piece 0 by an error that a pipe might have had."""

    def work(handful):
        if handful == (0,):
            raise BrokenPipeError("the work's own")
        os._exit(9)

    return work


def lost(handful, status: str, message: str) -> Done:
    return Done(handful, failures=[{"status": status, "message": message}])


def test_every_handful_is_done_once():
    handfuls = [(number,) for number in range(9)]
    done = list(work_through(handfuls, LocalCrew(2), make_echo, (), lost))
    assert sorted(item.handful for item in done) == handfuls


def test_a_worker_that_dies_is_replaced_and_its_press_listed():
    done = {item.handful: item for item in work_through([(n,) for n in range(6)], LocalCrew(2), make_dying, (), lost)}
    assert set(done) == {(n,) for n in range(6)}
    assert done[3,].failures == [{"status": "DIED", "message": "its process ended with code 9"}]
    assert all(not item.failures for handful, item in done.items() if handful != (3,))


def test_pieces_that_all_end_their_workers_are_all_listed(monkeypatch: pytest.MonkeyPatch):
    """That none ever answers is not taken for a crew that cannot begin, nor an error of the work's own for one of its pipe."""
    monkeypatch.setattr(workers, "PATIENCE", 0.0)
    done = list(work_through([(0,), (1,)], LocalCrew(2), make_killed, (), lost))
    assert sorted((item.handful, item.failures[0]["status"]) for item in done) == [((0,), "DIED"), ((1,), "DIED")]


@pytest.mark.parametrize("threads", [1, 2])
def test_a_worker_has_the_threads_that_it_was_given(threads: int):
    before = dict(os.environ)
    (done,) = work_through([(0,)], LocalCrew(2, threads), make_counting, (), lost)
    pools = done.rows[0][0]
    assert pools and set(pools.values()) == {threads}
    assert dict(os.environ) == before


@pytest.mark.parametrize(("said", "share"), [(None, "50"), ("25", "25")])
def test_gpus_are_given_in_turn_and_shared(said: str | None, share: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv(workers.MPS_SHARE, raising=False)
    if said:
        monkeypatch.setenv(workers.MPS_SHARE, said)
    done = [item.rows[0][0] for item in work_through([(n,) for n in range(3)], LocalCrew(3, gpus=("0", "7")), make_seeing, (), lost)]
    assert {item["sees"] for item in done} <= {"0", "7"} and {item["share"] for item in done} == {share}


@pytest.mark.parametrize(("gpus", "seen"), [((), ""), (None, "3")])
def test_workers_without_gpus_see_none(gpus: tuple[str, ...] | None, seen: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "3")
    (done,) = work_through([(0,)], LocalCrew(1, gpus=gpus), make_seeing, (), lost)
    assert done.rows[0][0]["sees"] == seen


@pytest.mark.parametrize(
    ("gpus", "cores", "solves", "cudss", "workers", "count"),
    [
        ([], 16, True, True, None, 16),
        (["0"], 16, True, True, None, 32),
        (["0"], 16, False, True, None, 16),
        (["0"], 16, True, False, None, 16),
        (["0"], 32, True, True, None, 40),
        (["0", "1"], 32, True, True, None, 64),
        (["0"], 16, True, True, 3, 3),
    ],
)
def test_how_many_work(
    gpus: list[str], cores: int, solves: bool, cudss: bool, workers: int | None, count: int, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(run.os, "cpu_count", lambda: cores)
    monkeypatch.setattr(run, "gpus_of", lambda device: gpus)
    monkeypatch.setattr("gelsim.fem.solves_on_gpu", lambda: cudss)
    crew = Hands("cuda", workers).crew(solves)
    assert isinstance(crew, LocalCrew) and crew.count == count and crew.gpus == gpus


@pytest.mark.parametrize("gpus", [(), ("0",)])
def test_workers_with_a_gpu_are_told_so(gpus: tuple[str, ...], monkeypatch: pytest.MonkeyPatch):
    told: list[bool] = []
    monkeypatch.setattr(workers, "_Process", lambda make, arguments, environment, on_gpu: told.append(on_gpu))
    LocalCrew(2, gpus=gpus).start(0, make_echo, ())
    assert told == [bool(gpus)]


@pytest.mark.parametrize(("on_gpu", "begun"), [(True, ["cuInit", "flags 4"]), (False, [])])
def test_a_worker_sleeps_while_it_waits_for_its_gpu(on_gpu: bool, begun: list[str], monkeypatch: pytest.MonkeyPatch):
    called: list[str] = []
    cuda = SimpleNamespace(
        cuInit=lambda flags: called.append("cuInit") or 0,
        cuDevicePrimaryCtxSetFlags_v2=lambda device, flags: called.append(f"flags {flags.value}") or 0,
    )
    monkeypatch.setattr(workers.ctypes, "CDLL", lambda name: cuda)
    monkeypatch.setattr(workers, "end_with", lambda parent: None)
    here, there = multiprocessing.Pipe()
    there.close()

    def make() -> workers.Work[None]:
        called.append("make")
        return lambda handful: None

    workers._serve(here, make, (), 0, on_gpu)
    assert called == [*begun, "make"]


def test_without_cuda_nothing_is_asked_to_sleep(monkeypatch: pytest.MonkeyPatch):
    def none(name: str):
        raise OSError(name)

    monkeypatch.setattr(workers.ctypes, "CDLL", none)
    workers.wait_asleep()
    no_device = SimpleNamespace(cuInit=lambda flags: 100)  # CUDA_ERROR_NO_DEVICE; it has nothing else to be called
    monkeypatch.setattr(workers.ctypes, "CDLL", lambda name: no_device)
    workers.wait_asleep()


@pytest.mark.parametrize("how", ["exit", "raise"])
def test_workers_that_never_begin_end_the_run(how: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(workers, "PATIENCE", 0.0)
    begun = time.monotonic()
    with pytest.raises(WorkError, match="[34] workers ended before they had begun"):
        list(work_through([(n,) for n in range(9)], LocalCrew(2), make_still_born, (how,), lost))
    assert time.monotonic() - begun < 30.0


def test_a_fault_that_ends_all_costs_no_piece(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    begun = time.monotonic()
    handfuls = [(number,) for number in range(6)]
    done = list(work_through(handfuls, LocalCrew(2), make_faulting, (tmp_path,), lost, still=True))
    assert sorted(item.handful for item in done) == handfuls and not any(item.failures for item in done)
    assert len(list(tmp_path.glob("* faulted"))) == 2 and time.monotonic() - begun < 30.0 < workers.STILL  # nobody was waited for


# ---- folders ----


def test_what_is_asked_for_is_known_before_any_scene_is_built(monkeypatch: pytest.MonkeyPatch):
    """A hundred thousand scenes would take ten minutes before the first press."""
    catalogue = Catalogue(load_plan("families"), 5)
    splits = [catalogue.press(number).split for number in range(60)]
    assert [catalogue.split(number) for number in range(60)] == splits
    monkeypatch.setattr(Catalogue, "press", lambda *_: pytest.fail("a press was drawn whole"))
    assert list(Extent(60, test=0).presses(catalogue)) == [n for n, split in enumerate(splits) if split in ("train", "validation")]


def test_families_are_seen_8_to_40_mm_wide_and_8_to_60_times_a_second():
    catalogue = Catalogue(load_plan("families"), 0)
    wide = [catalogue.sensor_scene(number).camera.field_mm[0] for number in range(catalogue.plan.sensors)]
    assert min(wide) == 8.0 and max(wide) == 40.0 and sorted(set(wide))[-2] == 32.0
    rates = [catalogue.episode(catalogue.press(number), 0).layer["camera"]["fps"] for number in range(60)]
    # Of 60 log-uniform draws none in an end of a tenth: 0.9^60 = 0.2 %. Planted, the presets' own rates: 25, 30 and 60.
    assert 8 <= min(rates) < 8 * 7.5**0.1 and 60 / 7.5**0.1 < max(rates) <= 60
    press = catalogue.press(0)
    scene = press.scene.replace(camera=replace(press.scene.camera, fps=rates[0]))
    assert bake.field_key(scene) == bake.field_key(press.scene)


def test_rows_tell_what_a_durometer_reads_and_how_firm_it_is():
    x, y = (axis.ravel() * 1e-3 for axis in np.meshgrid(np.arange(5.0), np.arange(5.0)))
    places, share = np.column_stack([x, y]), np.array([0.0, 0.5, 1.0])
    pressed = share[:, None, None] * np.column_stack([0 * x, 0 * x, -1e-3 - 0.1 * x])
    motion = Motion(share * 2e-3, share[:, None] * np.array([0.0, 0.0, -2.0]), share * 1e-5, places, pressed)

    def row(plan: str, wanted: Callable[[Body], bool]) -> tuple[Body, dict[str, Any]]:
        catalogue = Catalogue(load_plan(plan), 0)
        press = next(press for press in map(catalogue.press, range(500)) if wanted(press.scene.object))
        return press.scene.object, recording.record(catalogue, press, 0, motion, None).episode.row

    foam, of_foam = row("families", lambda body: body.poissons_ratio < 0.3 and not body.rigid)
    assert of_foam["shore_00"] == firmness.shore_00(foam) != foam.shore_00 == of_foam["body_shore_00"]
    # A skin of Shore A 20 or more on flesh of 00-10 to 55, a millimetre thick.
    tomato, of_tomato = row("paper2017", lambda body: body.shape == "tomato")
    assert of_tomato["shore_00"] > of_tomato["body_shore_00"] + 3 and of_tomato["stiffness_n_mm"] == pytest.approx(
        firmness.stiffness(tomato)
    )
    for shape, rigid in (("candy", False), ("hemisphere", True)):
        _, told = row("paper2017", lambda body, shape=shape, rigid=rigid: body.shape == shape and body.rigid == rigid)
        assert told["shore_00"] is None and told["stiffness_n_mm"] is None and (told["body_shore_00"] is None) == rigid


def test_folders_that_cannot_be_used(tmp_path: Path):
    (tmp_path / "file").write_text("")
    with pytest.raises(SceneError, match="is a file"):
        generate(TINY, Extent(2), tmp_path / "file")
    with pytest.raises(SceneError, match="not empty; give --resume"):
        generate(TINY, Extent(2), tmp_path)
    with pytest.raises(SceneError, match="holds files but no dataset"):
        generate(TINY, Extent(2), tmp_path, resume=True)
    with pytest.raises(DatasetError, match="cannot be written"):
        generate(TINY, Extent(2), tmp_path / "file" / "below")
    for wrong, said in (
        ({"episodes": 0}, "--episodes 0"),
        ({"test": -1}, "--test-episodes -1"),
        ({"train": -1}, "--train-episodes -1"),
    ):
        with pytest.raises(SceneError, match=said):
            Extent(**({"episodes": 2} | wrong))
    for hands, said in ((Hands(workers=0), "--workers 0"), (Hands("tpu"), "--device tpu")):
        with pytest.raises(SceneError, match=said):
            generate(TINY, Extent(2), tmp_path / "new", hands=hands)
    assert not (tmp_path / "new").exists()


def test_a_full_disk_ends_the_work_with_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    class Studio:
        def __init__(self, device: str) -> None:
            pass

    def full(*_: object) -> None:
        raise DatasetError(f"{tmp_path}: cannot be written (No space left on device)")

    monkeypatch.setattr("gelsim.generate.run.Studio", Studio)
    monkeypatch.setattr(recording, "solve", lambda press, device: recording.Solved(None, {}))  # type: ignore[arg-type]
    monkeypatch.setattr(recording, "record", full)
    done = make_worker(TINY, 0, tmp_path, {0: [0, 1]}, "cpu")((0,))
    assert done.error is not None and "No space left on device" in done.error and not done.rows


def test_a_press_that_fails_is_listed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("gelsim.generate.run.Studio", lambda device: None)

    def failing(press: object, device: str) -> recording.Solved:
        raise recording.PressFailed("NONFINITE", "not a number")

    monkeypatch.setattr(recording, "solve", failing)
    done = make_worker(TINY, 5, tmp_path, {4: [0, 1]}, "cpu")((4,))
    assert done.error is None
    assert done.failures == [
        {"index": 8, "indices": [8, 9], "seed": 5, "press": 4, "status": "NONFINITE", "message": "not a number"}
    ]  # fmt: skip


@pytest.mark.parametrize("force_n, depth_mm, kept", [(None, 1.6, True), (None, 1.7, False), (1.6, 4.0, True), (1.7, 4.0, False)])
def test_a_press_that_finds_no_equilibrium_further_on(deformation: Deformation, force_n: float | None, depth_mm: float, kept: bool):
    """It went 1.0 mm with 1.0 N: 0.6 of 1.6 mm or of 1.6 N is enough, and more wanted of both is not."""
    scene = Catalogue(load_plan(TINY), 0).press(0).scene
    scene = scene.replace(press=replace(scene.press, depth_mm=depth_mm, force_n=force_n))
    stopped = replace(deformation, status=SolveStatus.MAX_ITERATIONS, message="stopped")
    if kept:
        assert recording.checked(stopped, scene).approach[-1] == 1e-3
    else:
        with pytest.raises(recording.PressFailed, match="stopped"):
            recording.checked(stopped, scene)
    assert recording.checked(deformation, scene).approach[-1] == 1e-3


# ---- whole datasets ----


def run_of(out: Path, episodes: int, workers: int) -> list[str]:
    """The command that makes the tiny dataset."""
    given = {"--plan": TINY, "--seed": 3, "--out": out, "--workers": workers, "--episodes": episodes}
    return [sys.executable, "-m", "gelsim", "dataset", "--resume", *(str(part) for item in given.items() for part in item)]


@pytest.mark.slow
def test_killed_ten_times_at_random_moments(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("GELSIM_CACHE", str(tmp_path / "cache"))
    put_fields(TINY, 3)
    episodes, killed, random = 60, tmp_path / "killed", np.random.default_rng(5)
    for _ in range(10):
        # Told by episodes and not by seconds: a fast machine makes a dozen a second, and all sixty would be done before the tenth kill.
        enough = len(list(killed.rglob("*.tar"))) + random.integers(3)
        with subprocess.Popen(run_of(killed, episodes, 2), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as child:
            until = time.monotonic() + 60
            while len(list(killed.rglob("*.tar"))) < enough and time.monotonic() < until:
                time.sleep(0.005)
            time.sleep(random.uniform(0.0, 0.1))
            assert child.poll() is None  # else nothing is killed
            child.kill()
        time.sleep(1.0)  # until the workers have noticed
        for episode in load_dataset(killed):  # each is whole
            assert len(episode.frames) == len(episode.approach) == episode.row["frames"]
    assert len(load_dataset(killed)) < episodes  # none of the kills came too late
    generate(TINY, Extent(episodes), killed, seed=3, hands=Hands(workers=2), resume=True)
    generate(TINY, Extent(episodes), tmp_path / "whole", seed=3, hands=Hands(workers=1))
    assert contents(killed) == contents(tmp_path / "whole")


@pytest.mark.slow
def test_a_disk_that_takes_no_more_ends_the_run_and_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Files above a size are refused, as a full disk refuses them."""
    monkeypatch.setenv("GELSIM_CACHE", str(tmp_path / "cache"))
    put_fields(TINY, 3)
    generate(TINY, Extent(6), tmp_path / "whole", seed=3, hands=Hands(workers=1))
    sizes = sorted(path.stat().st_size for path in (tmp_path / "whole").rglob("*.tar"))
    assert sizes[0] < sizes[-1]
    most = (sizes[-1] - 1, resource.RLIM_INFINITY)
    done = subprocess.run(
        run_of(tmp_path / "full", 6, 1), capture_output=True, text=True, timeout=300,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, most),
    )  # fmt: skip
    assert done.returncode == 2 and "cannot be written" in done.stderr and "Traceback" not in done.stderr
    there = load_dataset(tmp_path / "full")
    assert len(there) < 6 and all(len(episode.frames) == episode.row["frames"] for episode in there)
    generate(TINY, Extent(6), tmp_path / "full", seed=3, hands=Hands(workers=1), resume=True)
    assert contents(tmp_path / "full") == contents(tmp_path / "whole")


@pytest.mark.slow
def test_killed_and_resumed_is_the_same_as_one_or_two_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("GELSIM_CACHE", str(tmp_path / "cache"))
    put_fields(TINY, 3)
    told: list[tuple[str, int, int]] = []
    report = generate(TINY, Extent(6), tmp_path / "two", seed=3, hands=Hands(workers=2), progress=lambda *args: told.append(args))
    assert report["episodes"] == 6 and report["failed"] == 0 and report["exit_code"] == 0 and told[-1] == ("episodes", 6, 6)
    assert "6 of 6 episodes" in generating.summary(report)

    command = run_of(tmp_path / "killed", 6, workers=1)
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as child:
        until = time.monotonic() + 120
        while not list((tmp_path / "killed").rglob("*.tar")) and time.monotonic() < until:
            time.sleep(0.02)
        os.kill(child.pid, signal.SIGKILL)
    halfway = load_dataset(tmp_path / "killed")  # readable, though its manifest may lag behind
    assert len(halfway) < 6
    with pytest.raises(SceneError, match="its seed is 3"):
        generate(TINY, Extent(6), tmp_path / "killed", seed=4, resume=True)
    time.sleep(1.0)  # until the killed one's worker has noticed
    generate(TINY, Extent(4), tmp_path / "killed", seed=3, hands=Hands(workers=1), resume=True)
    generate(TINY, Extent(6), tmp_path / "killed", seed=3, hands=Hands(workers=1), resume=True)
    assert contents(tmp_path / "killed") == contents(tmp_path / "two")

    data = load_dataset(tmp_path / "two")
    for episode in data:
        assert episode.frames.shape[1:] == (36, 48, 3) and (episode.frames[0] == episode.background).all()
        assert (episode.frames[-1] != episode.background).any() and -episode.force[-1, 2] == pytest.approx(
            episode.row["peak_force_n"], abs=1e-6
        )
        assert (np.diff(episode.approach) >= 0).all() and episode.noise.shape == (3, 3)

    # Mechanics first and light later are the same files; the folder without light takes no episodes with it.
    dark = tmp_path / "dark"
    assert generate(TINY, Extent(6), dark, seed=3, hands=Hands(workers=2), light=False)["episodes"] == 6
    # Without test rows: the others, as they are; given again without the limit, the rest is made.
    assert generate(TINY, Extent(6, test=2), tmp_path / "part", seed=3, hands=Hands(workers=1), light=False)["failed"] == 0
    told_of = {folder: [(row["index"], row["split"]) for row in load_dataset(folder).rows] for folder in (dark, tmp_path / "part")}
    assert told_of[tmp_path / "part"] == [each for each in told_of[dark] if each[0] < 2 or each[1] == "train"] != told_of[dark]
    tests = [each for each in told_of[dark] if each[1] != "train"]
    report = generate(TINY, Extent(6, train=0), tmp_path / "tests", seed=3, hands=Hands(workers=1), light=False)
    assert report["asked"] == len(tests) > 0 and f"{6 - len(tests)} left out by" in generating.summary(report)
    assert [(row["index"], row["split"]) for row in load_dataset(tmp_path / "tests").rows] == tests
    generate(TINY, Extent(6), tmp_path / "part", seed=3, hands=Hands(workers=1), light=False, resume=True)
    assert contents(tmp_path / "part") == contents(dark)
    with pytest.raises(SceneError, match="its resolution is"):
        generate(TINY, Extent(6), dark, seed=3, hands=Hands(workers=1), resume=True)
    with pytest.raises(SceneError, match="not what it was made from"):
        relight(dark, None, tmp_path / "late", plan="mini")
    assert relight(dark, None, tmp_path / "late", plan=TINY, hands=Hands(workers=2))["episodes"] == 6
    late, once = (contents(tmp_path / name / "episodes") for name in ("late", "two"))
    assert late == once and contents(dark / "episodes") != once

    # The same presses, seen by the same kind of sensor with other draws: mechanics and labels stay, pictures do not.
    for position in range(len(data)):
        scene = sensor_scene(data, position, "fingertip2017")
        write_field(bake.field_path(scene), formula_field(scene))
    report = relight(tmp_path / "two", "fingertip2017", tmp_path / "other", plan=TINY, seed=8, hands=Hands(workers=1))
    other = load_dataset(tmp_path / "other")
    assert report["episodes"] == 6 and other.splits == data.splits
    for first, second in zip(data, other, strict=True):
        np.testing.assert_array_equal(first.force, second.force)
        assert first.row["mechanics"] == second.row["mechanics"] and (first.frames != second.frames).any()


def test_a_report_counts_the_episodes_that_there_are(tmp_path: Path) -> None:
    """Of a dataset whose indices have gaps, as one has that was cut off or where presses failed."""
    book = Book(tmp_path, {}, resume=False)
    book.rows = {index: {"index": index, "split": "train"} for index in (0, 2, 9)}
    book.failures = {7: {"index": 7}}
    report = report_of(book, Path("out"), {0, 2, 7}, 0, 1, 3600.0)
    assert (report["episodes"], report["failed"], report["asked"], report["episodes_per_hour"]) == (2, 1, 3, 3.0)
    assert report_of(book, Path("out"), range(3), 0, 1, 1.0)["episodes"] == 2
    assert report["presses_ended_early"] == []
    book.rows[2] |= {"ended_early": "stopped", "mechanics": "000001"}
    assert report_of(book, Path("out"), range(3), 0, 1, 1.0)["presses_ended_early"] == [1]
