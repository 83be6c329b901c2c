"""The command line: flags become scene fields; bad input is one line, exit code 2, and nothing on disk."""

from __future__ import annotations

import importlib.metadata
import json
import struct
from collections.abc import Iterator
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any

import pytest
import trimesh

from gelsim import console
from gelsim.cli import main as cli
from gelsim.cli.flags import Parser, add_scene_flags, layer_of
from gelsim.errors import SolveError, SolveStatus
from gelsim.optics import variant
from gelsim.pipeline import stages
from gelsim.results import Deformation, ErrorEstimate, SolveReport
from gelsim.scene.definition import Scene
from gelsim.scene.fields import field_types
from gelsim.scene.layers import build_scene


@pytest.fixture(autouse=True)
def in_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def scene_of(*flags: str) -> Scene:
    parser = Parser(prog="gelsim")
    parser.set_defaults(parser=parser)
    add_scene_flags(parser)
    return build_scene(layer_of(parser.parse_all(list(flags))))


def write_stl(path: Path, triangles: list[list[tuple[float, float, float]]]) -> None:
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *(number for point in triangle for number in point), 0) for triangle in triangles)
    path.write_bytes(b"\0" * 80 + struct.pack("<I", len(triangles)) + body)


def box(size: float, faces: int = 12) -> list[list[tuple[float, float, float]]]:
    """A closed box; with fewer than 12 faces an open one."""
    corners = [(x * size, y * size, z * size) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return [[corners[i] for i in triangle] for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))][:faces]


@pytest.mark.parametrize("module", ["gelsim.cli.main", "learn.cli"])
def test_the_version_is_that_of_the_package(module: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        importlib.import_module(module).main(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out.split()[1:] == [importlib.metadata.version("gelsim")]


def test_flags_are_fields() -> None:
    scene = scene_of(
        "--shape", "punch", "--radius-mm", "3", "--rigid", "--gel.thickness-mm", "3", "--object.poissons-ratio", "0.49",
        "--depth-mm", "none", "--force-n", "5", "--tilt-deg", "-1.5", "2e0", "--offset-mm", "-1e-1,2", "--resolution", "640x480",
        "--sensor", "fingertip2017", "--friction", "stick", "--spp", "8", "--fidelity", "fast", "--seed", "7", "--symmetry", "none",
    )  # fmt: skip
    assert (scene.object.shape, scene.object.radius_mm, scene.object.rigid, scene.object.poissons_ratio) == ("punch", 3.0, True, 0.49)
    assert (scene.press.depth_mm, scene.press.force_n, scene.press.symmetry) == (None, 5.0, "none")
    assert (scene.press.tilt_deg, scene.press.offset_mm) == ((-1.5, 2.0), (-0.1, 2.0))
    assert (scene.gel.thickness_mm, scene.render.resolution, scene.render.spp) == (3.0, (640, 480), 8)
    assert (scene.contact.friction_coefficient, scene.fidelity, scene.seed) == ("stick", "fast", 7)


@pytest.mark.parametrize("several", ["1,2,5", "[1, 2, 5]"])
def test_a_flag_takes_a_list_as_a_scene_file_has_it(several: str) -> None:
    assert [point.force_n for point in scene_of("--force-n", several).press.path] == [1.0, 2.0, 5.0]
    assert scene_of("--offset-mm", "[1, -2]").press.offset_mm == (1.0, -2.0)


def test_shore_flag_takes_a_scale() -> None:
    assert scene_of("--shore", "45").object.shore_00 == 45.0
    hard = scene_of("--shore", "45", "--shore-scale", "A").object
    assert (hard.shore_00, hard.shore_a) == (None, 45.0)


def test_lights_can_be_given_as_toml() -> None:
    lights = scene_of("--lights.lights", "[{name = 'red', rgb = [1, 0, 0]}]").lights.lights
    assert [light.name for light in lights] == ["red"]


def test_every_field_is_a_flag_with_help() -> None:
    parser = Parser(prog="gelsim")
    add_scene_flags(parser)
    helps = {flag: action.help for action in parser._actions for flag in action.option_strings}

    def names(kind: type, above: str) -> Iterator[str]:
        for name, inner in field_types(kind).items():
            yield from names(inner, f"{above}{name}.") if is_dataclass(inner) else [f"{above}{name}"]  # type: ignore[arg-type]

    for name in names(Scene, ""):
        assert "--" + name.replace("_", "-") in helps
    undocumented = [flag for flag, text in helps.items() if flag.startswith("--object.") and not (text or "").split("(")[0].strip()]
    assert undocumented == []


BAD = {
    "a file in place of a flag": (["press.toml"], "'press.toml' belongs to no flag; did you mean --scene press.toml?"),
    "unknown flag": (["--shap", "flat"], "unknown flag '--shap'; did you mean '--shape'"),
    "unknown shape": (["--shape", "cylindre"], "did you mean 'cylinder'"),
    "negative radius": (["--radius-mm", "-5"], "object.radius_mm = -5 mm: allowed is"),
    "Shore 130": (["--shore", "130"], "Shore 00 reading 130"),
    "both moduli": (["--shore", "30", "--object.youngs-modulus-kpa", "100"], "give exactly one of"),
    "scale alone": (["--shore-scale", "A"], "give the number too"),
    "depth": (["--depth-mm", "30"], "press.depth_mm = 30 mm: it must be less than object.height_mm"),
    "no number": (["--radius-mm", "big"], "object.radius_mm = 'big': expected a number"),
    "missing value": (["--radius-mm"], "--radius-mm"),
    "missing scene": (["--scene", "nowhere.toml"], "nowhere.toml"),
    "missing mesh": (["--shape", "mesh", "--mesh", "nowhere.stl"], "nowhere.stl"),
    "device": (["--device", "tpu"], "--device"),
    "resolution": (["--resolution", "640"], "render.resolution"),
    "out is a file": (["--out", "file.txt"], "is a file, not a folder"),
    "out below a file": (["--out", "file.txt/deep"], "cannot be written to"),
    "out is full": (["--out", "full"], "not empty; give --force"),
    "open mesh": (["--shape", "mesh", "--mesh", "open.stl"], "open.stl"),
    "depth of a file": (["--shape", "mesh", "--mesh", "cube.stl", "--depth-mm", "10"], "cube.stl', 10 mm"),
    "metres": (["--shape", "mesh", "--mesh", "metres.stl"], "read in mm"),
}


@pytest.mark.parametrize("name", BAD)
@pytest.mark.parametrize("command", ["press", "render"])
def test_bad_input_is_one_line_and_leaves_nothing(name: str, command: str, capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    flags, expected = BAD[name]
    (tmp_path / "file.txt").write_text("a file")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "old.txt").write_text("an earlier result")
    write_stl(tmp_path / "open.stl", box(10.0, faces=11))
    write_stl(tmp_path / "metres.stl", box(0.01))
    write_stl(tmp_path / "cube.stl", box(10.0))
    before = sorted(tmp_path.rglob("*"))
    assert cli.main([command, *flags]) == cli.BAD_INPUT
    output = capfd.readouterr()
    assert output.out == "" and expected in output.err
    assert output.err.count("\n") == 1 and "Traceback" not in output.err
    assert sorted(tmp_path.rglob("*")) == before


def test_json_is_the_only_thing_on_stdout(capfd: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["press", "--shore", "130", "--json"]) == cli.BAD_INPUT
    answer = json.loads(capfd.readouterr().out)
    assert answer["exit_code"] == 2 and "Shore 00 reading 130" in answer["error"]


def test_debug_shows_the_trace(capfd: pytest.CaptureFixture[str]) -> None:
    cli.main(["press", "--shore", "130", "--debug"])
    assert "Traceback" in capfd.readouterr().err


def test_unsolved_press_exits_3_and_keeps_what_was_solved(
    deformation: Deformation, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    from dataclasses import replace

    stopped = replace(deformation, status=SolveStatus.MAX_ITERATIONS)

    def give_up(*_: object, **__: object) -> Deformation:
        raise SolveError("press stopped at step 3: residual 0.2 N", stopped)

    monkeypatch.setattr(stages, "press", give_up)
    assert cli.main(["render", "--out", "kept"]) == cli.NUMERICS
    assert "residual 0.2 N (what was solved is in kept)" in capfd.readouterr().err
    assert sorted(path.name for path in (tmp_path / "kept").iterdir()) == ["press.npz", "report.json", "scene.toml"]
    report = json.loads((tmp_path / "kept/report.json").read_text())
    assert report["error"].startswith("press stopped") and report["status"] == SolveStatus.MAX_ITERATIONS.value
    # What is kept cannot be taken for a whole press.
    monkeypatch.setattr(stages, "press", lambda *_, **__: deformation)
    assert cli.main(["press", "--out", "kept", "--resume"]) == cli.OK
    assert json.loads((tmp_path / "kept/report.json").read_text())["status"] == SolveStatus.CONVERGED.value


def test_resume_takes_the_press_of_the_same_scene(
    deformation: Deformation, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(stages, "press", lambda *_, **__: deformation)
    assert cli.main(["press", "--out", "a"]) == cli.OK

    def never(*_: object, **__: object) -> Deformation:
        raise AssertionError("solved again")

    monkeypatch.setattr(stages, "press", never)
    assert cli.main(["press", "--out", "a", "--resume"]) == cli.OK
    assert cli.main(["press", "--out", "a", "--resume", "--shore", "31"]) == cli.BAD_INPUT
    assert "made with another [object]" in capfd.readouterr().err


def test_resume_tells_of_the_press_what_was_told_when_it_was_solved(
    deformation: Deformation, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from dataclasses import replace

    def solve(*_: object, record: stages.Record, **__: object) -> Deformation:
        record.meshes["gel"] = {"tets": 7}
        record.choices["symmetry"] = ["x"]
        record.warnings.append("goes over the border")
        return replace(deformation, report=SolveReport(tried=2, warnings=("held",), error_estimate=ErrorEstimate(0.015, 2.0)))

    monkeypatch.setattr(stages, "press", solve)
    assert cli.main(["press", "--out", "a"]) == cli.OK
    first = json.loads((tmp_path / "a/report.json").read_text())
    assert first["warnings"] == ["goes over the border", "held"] and first["error_estimate"] == {"force": 0.015, "membrane_um": 2.0}
    monkeypatch.setattr(stages, "press", lambda *_, **__: pytest.fail("solved again"))
    assert cli.main(["press", "--out", "a", "--resume"]) == cli.OK
    again = json.loads((tmp_path / "a/report.json").read_text())
    assert again["choices"].pop("press") == "taken from the folder (--resume)"
    for name in ("meshes", "choices", "warnings", "error_estimate", "error_estimate_note", "final"):
        assert again[name] == first[name], name


def test_resume_knows_a_mesh_file_by_what_is_in_it(
    deformation: Deformation, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(stages, "press", lambda *_, **__: deformation)
    flags = ["press", "--shape", "mesh", "--mesh", str(tmp_path / "part.stl"), "--out", "a"]
    trimesh.creation.box((4e-3, 4e-3, 3e-3)).export(tmp_path / "part.stl")
    assert cli.main(flags) == cli.OK and cli.main([*flags, "--resume"]) == cli.OK
    trimesh.creation.box((4e-3, 4e-3, 2e-3)).export(tmp_path / "part.stl")
    assert cli.main([*flags, "--resume"]) == cli.BAD_INPUT and "made with another" in capfd.readouterr().err
    (tmp_path / "part.stl").unlink()
    assert cli.main([*flags, "--resume"]) == cli.BAD_INPUT


def test_resume_with_other_light_leaves_no_picture_of_the_one_before_and_takes_none_away_before_it_has_others(
    deformation: Deformation, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(stages, "press", lambda *_, **__: deformation)
    monkeypatch.setattr(stages, "_choose_renderer", lambda scene, *_: (scene, None))
    monkeypatch.setattr(stages, "_write_pictures", lambda folder, *_: folder.write("sheet.png", lambda path: path.write_text("new")))
    monkeypatch.setattr(stages, "render", lambda *_, **__: [])
    assert cli.main(["render", "--out", "a"]) == cli.OK
    (tmp_path / "a/radiance").mkdir()
    (tmp_path / "a/sheet.png").write_text("old")
    before = (tmp_path / "a/scene.toml").read_text()

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as cut:
        cut.setattr(stages, "render", interrupted)
        assert cli.main(["render", "--out", "a", "--spp", "7", "--resume"]) == cli.INTERRUPTED
    assert (tmp_path / "a/scene.toml").read_text() == before and (tmp_path / "a/sheet.png").read_text() == "old"
    assert cli.main(["press", "--out", "a", "--spp", "7", "--resume"]) == cli.OK  # the mechanics alone: they are the same
    assert (tmp_path / "a/scene.toml").read_text() == before and (tmp_path / "a/radiance").exists()
    assert cli.main(["render", "--out", "a", "--resume"]) == cli.OK and (tmp_path / "a/radiance").exists()
    assert cli.main(["render", "--out", "a", "--spp", "7", "--resume"]) == cli.OK
    assert "spp = 7" in (tmp_path / "a/scene.toml").read_text() and not (tmp_path / "a/radiance").exists()
    assert (tmp_path / "a/sheet.png").read_text() == "new"


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        (["press", "--rigid", "--shore", "30"], "a rigid object has no hardness, and object.shore_00 was given too"),
        (["press", "--force", "--resume"], "--resume: not allowed with argument --force"),
        (["dataset", "--episodes", "2", "--seed", "-1", "--out", "a"], "--seed -1: allowed is 0 or more"),
        (["dataset", "--episodes", "1000000000000", "--out", "a"], "--episodes 1000000000000: allowed is 1"),
        (["dataset", "--light-of", "a", "--real", "b", "--out", "c"], "exclude each other"),
        (["durometer", "--shore", "30", "--out", "a"], "--out DIR goes with the whole scale"),
        (["durometer", "--out", "file/below"], "--out file/below: cannot be written to"),
        (["study", "gel-hardness", "--out", "file"], "--out file: cannot be written to"),
        (["inspect", "sensor.toml"], "a sensor file goes with --sensor"),
        (["inspect", "part.stl", "--out", "a.foo"], "what is drawn is a .png"),
        (["inspect", "part.stl", "--out", "file/a.png"], "file: "),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(
    command: list[str], expected: str, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("in the way")
    (tmp_path / "sensor.toml").write_text("")
    trimesh.creation.box((4, 4, 3)).export(tmp_path / "part.stl")
    before = sorted(tmp_path.iterdir())
    assert cli.main(command) == cli.BAD_INPUT
    said = capfd.readouterr().err
    assert expected in said and "internal error" not in said and said.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    ("flags", "expected"), [(["--lights.lights", "[]"], "lights.lights is empty"), (["--device", "cuda"], "CUDA was asked for")]
)
def test_what_cannot_be_drawn_is_known_before_the_press(
    flags: list[str], expected: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(stages, "press", lambda *_, **__: pytest.fail("solved for nothing"))
    monkeypatch.setattr(variant, "_has_nvidia", lambda: False)
    variant._choose.cache_clear()
    assert cli.main(["render", *flags]) == cli.BAD_INPUT
    assert expected in capfd.readouterr().err and list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_render_writes_everything(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    flags = [
        "--shape", "hemisphere", "--rigid", "--depth-mm", "0.2", "--frames", "3", "--fidelity", "fast", "--spp", "2",
        "--resolution", "64x48",
    ]  # fmt: skip
    assert cli.main(["render", *flags, "--gel.profile", "flat", "--out", "a", "--exr", "--json"]) == cli.OK
    report = json.loads(capfd.readouterr().out)
    names = {"frames", "radiance", "video.mp4", "height.npz", "markers.csv", "sheet.png", "scene.toml", "press.npz", "report.json"}
    assert {path.name for path in (tmp_path / "a").iterdir()} == names
    assert report == json.loads((tmp_path / "a/report.json").read_text())
    assert report["choices"]["variant"] and report["final"]["normal_force_n"] > 0
    assert cli.main(["inspect", "a", "--out", "a.png"]) == cli.OK


def test_a_log_says_how_far_long_work_is(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Where no terminal shows a bar: nothing of a short run, then a line a minute."""
    now = [0.0]
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])
    with console.progress_bars() as progress:
        assert progress is not None
        for now[0] in (0.0, 59.0, 61.0, 62.0, 130.0):
            progress("press", int(now[0]), 200)
    assert capsys.readouterr() == ("", "press: 61 of 200, 1 s each\npress: 130 of 200, 1 s each\n")


def test_a_rate_counts_what_this_run_made(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """A run that goes on at 500 of 600 and makes ten in 100 s, after a start of 30 s: 10 s each, in a log and on a terminal."""
    from tqdm import tqdm

    now, bars = [30.0], []
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])
    with console.progress_bars() as progress:
        assert progress is not None
        progress("episodes", 500, 600)
        now[0] = 130.0
        progress("episodes", 510, 600)
    assert capsys.readouterr().err == "episodes: 510 of 600, 10 s each\n"

    class Clocked(tqdm):
        def __init__(self, **options: Any) -> None:
            super().__init__(**options)
            self._time = lambda: now[0]
            self.start_t, bars[:] = now[0], [self]

    now[0] = 30.0
    monkeypatch.setattr("tqdm.tqdm", Clocked)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    with console.progress_bars() as progress:
        assert progress is not None
        progress("episodes", 500, 600)
        now[0] = 130.0
        progress("episodes", 510, 600)
        told = bars[0].format_dict
    assert (told["n"] - told["initial"]) / told["elapsed"] == pytest.approx(0.1)
