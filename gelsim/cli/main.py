"""The command line, `gelsim COMMAND` (what each writes: README.md).

Exit codes: 0 done; 2 bad input, one line says which field, its value and what is allowed; 3 the numbers did not come out, what was solved
is kept; 4 part of a batch failed. Nothing heavy is imported before a command needs it, so that --help is instant.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from functools import partial
from pathlib import Path
from typing import Any

from gelsim.bench import SECTIONS
from gelsim.cli.flags import Parser, add_scene_flags, layer_of
from gelsim.console import ShowVersion, progress_bars
from gelsim.errors import GelsimError, SceneError, SolveError
from gelsim.scene.definition import Scene
from gelsim.scene.layers import build_scene, read_layer, scene_table
from gelsim.scene.limits import CHOICES, LIMITS
from gelsim.study import STUDIES

OK, INTERNAL, BAD_INPUT, NUMERICS, PARTIAL, INTERRUPTED = 0, 1, 2, 3, 4, 130

ABOUT = """\
gelsim computes what a GelSight tactile sensor sees: finite elements of the gel and the object in contact, then light transport.

  gelsim render --shape cylinder --shore 30              a soft cylinder, as a tactile video with all its numbers
  gelsim render --shape hemisphere --rigid --radius-mm 4 --depth-mm 0.6
  gelsim press --scene scenes/press_edge_tilted.toml     the mechanics alone
  gelsim live                                            a page in the browser: press by hand
  gelsim inspect out/cylinder-00-30                      what a result, a press.npz or a mesh file holds
  gelsim doctor                                          what this machine can run
"""
USAGE = "%(prog)s [--scene FILE] [--shape SHAPE] [--shore N] [any field of the scene as a flag] [--out DIR]"
RENDER_EXAMPLES = """\
examples:
  gelsim render --shape cylinder --shore 30 --out out/demo
  gelsim render --shape punch --radius-mm 3 --shore 45 --shore-scale A --force-n 5 --depth-mm none
  gelsim render --scene scenes/press_ball_rigid.toml --sensor gelsight_mini --resolution 640x480 --spp 64 --exr

A flag beats the scene file, the file beats the sensor's preset, the preset beats the defaults."""
BENCH_EXAMPLES = """\
examples:
  gelsim bench --quick
  gelsim bench --only stability --only speed --out out/stability
  gelsim bench --out out/bench --resume --page docs/tables.markdown     what is missing, then the page's tables

Writes bench.md (the tables), one CSV a section, results.jsonl (a line a case) and plots."""
CALIBRATE_EXAMPLES = """\
examples:
  gelsim calibrate --photos photos/ --sensor mine --out out/mine/sensor.toml
  gelsim render --sensor out/mine/sensor.toml --shape hemisphere --rigid --radius-mm 2 --depth-mm 0.8

What the folder must hold and how far to trust the result: docs/calibrate.md."""
COMPARE_EXAMPLES = """\
examples:
  gelsim compare --sensor out/mine/sensor.toml --photos photos/ --out out/compare
  gelsim compare --frames out/demo --photos recording/           pictures drawn before, paired with photographs by their names

presses.csv says what was pressed, where and how deep; of balls place and depth may be missing. docs/calibrate.md."""
IDENTIFY_USAGE = "%(prog)s VIDEO --sensor NAME --shape SHAPE [any field of the scene as a flag] [--out DIR]"
IDENTIFY_EXAMPLES = """\
examples:
  gelsim identify press.mp4 --sensor out/mine/sensor.toml --shape hemisphere --radius-mm 8 --friction 0.8
  gelsim identify out/demo --scene out/demo/scene.toml --forces forces.csv

The shape is known, the hardness and how deep each picture is are not. How far to trust it: docs/identify.md."""
DUROMETER_EXAMPLES = """\
examples:
  gelsim durometer --shore 30                       the modulus that reads 00-30
  gelsim durometer --modulus-kpa 100 --friction 0   what a block of 100 kPa reads under a tip that slides
  gelsim durometer --modulus-kpa 100 --skin-mm 1 --skin-kpa 800      and under a skin, as a tomato's
  gelsim durometer --out out/durometer              the whole scale beside the published relations: table and plot
  gelsim durometer --shore 40 --foot --friction 0.15   with the foot on the block, both sliding

A tip is pressed into a block of 12 mm by finite elements; how far to trust a reading: docs/physics.md."""
DATASET_EXAMPLES = """\
examples:
  gelsim dataset --plan paper2017 --episodes 300 --out out/data
  gelsim dataset --plan paper2017 --episodes 7000 --out out/data --resume        goes on where it was killed, or with more
  gelsim dataset --real recordings/ --out out/real                                videos named SHAPE[RADIUS]_HH_NUMBER.avi, or labels.csv
  gelsim dataset --light-of out/data --sensor gelsight_mini --out out/mini        the same presses, another sensor
  gelsim inspect out/data --out out/data.png

Plans, what they draw, and what the folder holds: docs/datasets.md. Exit code 4: more than 1 % of the episodes failed."""
STUDY_EXAMPLES = """\
examples:
  gelsim study --list                                    the ready-made studies, and what can be measured
  gelsim study gel-hardness --out out/gel-hardness --workers 2
  gelsim study mine.toml --resume                        a study of your own: docs/extending.md

Writes index.html (one page with all in it), study.csv, study.png, study.md and results.jsonl (a line a case)."""
OPTIMISE_EXAMPLES = """\
examples:
  gelsim optimise dent_reach_mm --within gel.thickness_mm=1:5 --within gel.shore_00=5:40 --shape hemisphere --rigid --depth-mm 0.5
  gelsim optimise most:texture_signal_per_um --also steep_normal_error_deg --within coating.specular=0:1 --within coating.roughness=0.1:0.6

Metrics: gelsim study --list. Any field of the scene is a flag, as for render. Writes index.html, study.csv, study.png,
results.jsonl (a line an evaluation), and sensor.toml and scene.toml of the best."""
LIVE_EXAMPLES = """\
examples:
  gelsim live                                            a rigid ball over the default sensor; open the address that it prints
  gelsim live --sensor gelsight_mini --shape torus --radius-mm 4 --friction 1.2
  gelsim live --record out/hand                          what is done, as frames, markers, forces and motion
  gelsim render --scene out/hand/0000/scene.toml --path-csv out/hand/0000/motion.csv      the same by finite elements and traced light

Drag an arrow to move the object, an arc to turn it. Needs viser: pip install "gelsim[live]". How far to trust it: docs/live.md."""
PRESS_EXAMPLES = """\
examples:
  gelsim press --shape hemisphere --radius-mm 10 --shore 50 --out out/press
  gelsim press --scene scenes/press_ball_rigid.toml --probe points.csv     (points.csv: x_mm,y_mm)

A flag beats the scene file, the file beats the sensor's preset, the preset beats the defaults."""


def main(arguments: list[str] | None = None) -> int:
    """Runs one command and returns its exit code."""
    arguments = sys.argv[1:] if arguments is None else arguments
    debug = "--debug" in arguments
    wants_json = "--json" in arguments
    with _clean_stdout(wants_json) as answer:
        options = argparse.Namespace()
        try:
            options = _parser().parse_all(arguments)
            options.typed = shlex.join(["gelsim", *arguments])
            result = options.run(options)
            if wants_json:
                answer(result)
            sys.stdout.flush()
            return result.get("exit_code", OK)
        except SolveError as error:
            return _fail(error, NUMERICS, debug, answer if wants_json else None)
        except GelsimError as error:
            return _fail(error, BAD_INPUT, debug, answer if wants_json else None)
        except KeyboardInterrupt:
            kept = "resume" in options and Path(options.out).exists()
            print("gelsim: interrupted" + ("; what is done is kept: --resume goes on" if kept else ""), file=sys.stderr)
            return INTERRUPTED
        except BrokenPipeError:
            # Whoever read the output has seen enough; Python would complain once more when it flushes at its end.
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            return OK
        except Exception as error:
            if isinstance(error, OSError) and error.filename is not None:  # a folder that cannot be made, a full disk
                return _fail(error, BAD_INPUT, debug, answer if wants_json else None, f"{error.filename}: {error.strerror}")
            hint = f"internal error, {type(error).__name__}: {error} (a bug; run again with --debug for the trace)"
            return _fail(error, INTERNAL, debug, answer if wants_json else None, hint)


def _parser() -> Parser:
    parser = Parser(prog="gelsim", description=ABOUT)
    parser.add_argument("--version", action=ShowVersion)
    commands = parser.add_subparsers(metavar="COMMAND", required=True, parser_class=Parser)
    render = commands.add_parser("render", help="scene to tactile video: meshes, mechanics, light", epilog=RENDER_EXAMPLES, usage=USAGE)
    _add_common(render, _render)
    render.add_argument("--exr", action="store_true", help="also write the linear radiance of each frame, radiance/NNNN.exr")
    press = commands.add_parser("press", help="the mechanics alone: press.npz and report.json", epilog=PRESS_EXAMPLES, usage=USAGE)
    _add_common(press, _press)
    press.add_argument("--probe", metavar="FILE.csv", help="sample the gel's outer surface at rest points x_mm,y_mm; writes probe.csv")
    for command in (render, press):
        add_scene_flags(command)
    bench = commands.add_parser("bench", help="what has to be shown of mechanics and light: tables and plots", epilog=BENCH_EXAMPLES)
    bench.add_argument("--quick", action="store_true", help="fewer cases, none at `reference`: minutes instead of hours")
    bench.add_argument(
        "--only", action="append", choices=tuple(SECTIONS), metavar="SECTION", help=f"of {', '.join(SECTIONS)} (default: all)"
    )
    bench.add_argument("--out", metavar="DIR", default="out/bench", help="result folder (default: out/bench)")
    bench.add_argument("--page", metavar="FILE.md", help="also put the tables in their places in this page")
    bench.add_argument("--data", metavar="DIR", help="folder of measured data (default: $GELSIM_DATA); sections without it say so")
    bench.add_argument("--limit", type=int, metavar="N", help="stop after N new cases; --resume goes on")
    bench.add_argument("--workers", type=int, default=1, metavar="N", help="processes, each on one thread (default: 1)")
    _add_again(bench)
    _add_output_flags(bench, _bench)
    calibrate = commands.add_parser("calibrate", help="fit a sensor's optics to photographs of a pressed ball", epilog=CALIBRATE_EXAMPLES)
    calibrate.add_argument("--photos", required=True, metavar="DIR", help="pictures, photos.toml and, if wanted, presses.csv")
    calibrate.add_argument("--sensor", metavar="NAME", help="a preset to start from (gel, window, camera), or a name for a new sensor")
    calibrate.add_argument("--out", required=True, metavar="FILE.toml", help="the preset; report.json and pictures go beside it")
    calibrate.add_argument("--force", action="store_true", help="write over earlier files of these names")
    calibrate.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto", help="where to render (default: auto)")
    _add_output_flags(calibrate, _calibrate)
    compare = commands.add_parser("compare", help="photographs beside a sensor's pictures of the same presses", epilog=COMPARE_EXAMPLES)
    compare.add_argument("--photos", required=True, metavar="DIR", help="pictures, photos.toml and presses.csv")
    compare.add_argument("--sensor", metavar="NAME", help="a sensor preset, or the path of a sensor file")
    compare.add_argument("--frames", metavar="DIR", help="instead: a result folder, or a folder of pictures")
    compare.add_argument("--friction", default="0.8", metavar="MU", help="between object and gel, 0 … 10 or stick (default: 0.8)")
    compare.add_argument("--mode", choices=("path", "direct", "baked"), default="path", help="of the renderer (default: path)")
    compare.add_argument("--out", metavar="DIR", default="out/compare", help="where compare.png, .csv and report.json go")
    compare.add_argument("--force", action="store_true", help="write over earlier files of these names")
    compare.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto", help="where to compute (default: auto)")
    _add_output_flags(compare, _compare)
    identify = commands.add_parser(
        "identify", help="an object's hardness from the video of a press, by the mechanics", epilog=IDENTIFY_EXAMPLES, usage=IDENTIFY_USAGE
    )
    identify.add_argument(
        "source", metavar="VIDEO", help="a video, a folder of pictures or an episode; it begins with the sensor untouched"
    )
    identify.add_argument("--scene", metavar="FILE", help="sensor, shape and friction from a scene file (TOML)")
    identify.add_argument("--crop", type=int, nargs=4, metavar=("LEFT", "TOP", "WIDTH", "HEIGHT"), help="what shows the gel [px]")
    identify.add_argument("--forces", metavar="FILE.csv", help="measured normal forces: picture (from 0), force_n")
    identify.add_argument("--force-sd", type=float, default=0.02, metavar="N", help="their standard deviation [N] (default: 0.02)")
    identify.add_argument(
        "--out", metavar="DIR", default="out/identify", help="where report.json and identify.png go (default: out/identify)"
    )
    identify.add_argument("--force", action="store_true", help="write over earlier files of these names")
    identify.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto", help="where to compute (default: auto)")
    _add_output_flags(identify, _identify)
    add_scene_flags(identify)
    durometer = commands.add_parser("durometer", help="the virtual durometer: Shore reading to modulus and back", epilog=DUROMETER_EXAMPLES)
    wanted = durometer.add_mutually_exclusive_group()
    wanted.add_argument("--modulus-kpa", type=float, metavar="E", help="Young's modulus of the block [kPa]: what does it read?")
    wanted.add_argument("--shore", type=float, metavar="H", help="a reading: of which modulus?")
    durometer.add_argument("--scale", choices=("00", "A"), default="00", help="type of durometer (default: 00)")
    durometer.add_argument("--friction", default="stick", metavar="MU", help="of tip and foot on the block, 0 … 10 or stick (default)")
    durometer.add_argument(
        "--poissons-ratio", type=float, metavar="NU", help="of the block, 0 … 0.49999: a foam's is 0 to 0.3 (default: 0.4999)"
    )
    durometer.add_argument("--skin-mm", type=float, metavar="T", help="thickness of a skin on the block, with --skin-kpa and --modulus-kpa")
    durometer.add_argument("--skin-kpa", type=float, metavar="E", help="its Young's modulus [kPa]")
    durometer.add_argument("--foot", action="store_true", help="the foot rests on the block too, with the stand's dead load")
    durometer.add_argument(
        "--fidelity", choices=("fast", "balanced", "reference"), default="balanced", help="of the mesh (default: balanced)"
    )
    durometer.add_argument("--out", metavar="DIR", help="without a value: where durometer-SCALE.csv and .png go (default: only shown)")
    _add_output_flags(durometer, _durometer)
    dataset = commands.add_parser("dataset", help="many episodes of a plan, for learning", epilog=DATASET_EXAMPLES)
    dataset.add_argument("--plan", metavar="NAME", help="a plan, or the path of a TOML file (default: paper2017)")
    dataset.add_argument("--real", metavar="DIR", help="instead of a plan: a folder of recordings of a real sensor, converted")
    dataset.add_argument(
        "--light-of", metavar="DIR", help="instead: a simulated dataset, its presses seen by another sensor, or drawn at last"
    )
    dataset.add_argument(
        "--sensor", metavar="NAME", help="a sensor preset or file; with --light-of (default: the plan's own) or --real (whose gel it is)"
    )
    dataset.add_argument("--no-light", action="store_true", help="mechanics and labels only, no pictures: --light-of draws them later")
    dataset.add_argument("--episodes", type=int, metavar="N", help="how many, counted from the first; needed with a plan")
    dataset.add_argument(
        "--test-episodes",
        type=int,
        metavar="N",
        help="take test rows from the first N episodes only; beyond, presses are left out that no training sees (default: all)",
    )
    dataset.add_argument(
        "--train-episodes",
        type=int,
        metavar="N",
        help="likewise presses to train on and to validate: 0 makes test rows alone (default: all)",
    )
    dataset.add_argument("--out", metavar="DIR", required=True, help="folder of the dataset")
    dataset.add_argument("--seed", type=int, metavar="N", default=0, help="another number, another dataset (default: 0)")
    dataset.add_argument("--workers", type=int, metavar="K", help="processes (default: one per core, two where GPUs solve presses)")
    dataset.add_argument("--ray", metavar="ADDRESS", help="instead of processes here: a Ray cluster, host:port, auto or local")
    dataset.add_argument("--resume", action="store_true", help="go on in an existing folder: episodes that are done are kept")
    dataset.add_argument(
        "--device", choices=("cpu", "cuda"), default="cpu", help="where presses are solved and light is measured or traced (default: cpu)"
    )
    _add_output_flags(dataset, _dataset)
    study = commands.add_parser("study", help="what would another sensor see? a sweep over scene fields", epilog=STUDY_EXAMPLES)
    study.add_argument("name", nargs="?", metavar="NAME", help=f"of {', '.join(STUDIES)}, or the path of a TOML file")
    study.add_argument("--list", action="store_true", help="say what the ready-made studies ask, and what can be measured")
    study.add_argument("--out", metavar="DIR", help="result folder (default: out/study-NAME)")
    study.add_argument("--quick", action="store_true", help="the study's small form")
    study.add_argument("--workers", type=int, default=1, metavar="N", help="processes (default: 1)")
    study.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto", help="where to compute (default: auto)")
    _add_again(study)
    _add_output_flags(study, _study)
    optimise = commands.add_parser("optimise", help="the scene that is best by a metric, within bounds", epilog=OPTIMISE_EXAMPLES,
                                   usage="%(prog)s METRIC --within FIELD=LOW:HIGH [any field of the scene as a flag]")  # fmt: skip
    optimise.add_argument("goal", metavar="METRIC", help="what should be least; most:METRIC for the most")
    optimise.add_argument(
        "--within", action="append", required=True, metavar="FIELD=LOW:HIGH", help="a number to vary; :log for its logarithm"
    )
    optimise.add_argument("--also", metavar="METRIC", help="a second metric: shows the front of the two")
    optimise.add_argument("--scene", metavar="FILE", help="start from a scene file (TOML)")
    optimise.add_argument("--evaluations", type=int, default=60, metavar="N", help="at most (default: 60); 8 a field are samples")
    optimise.add_argument("--workers", type=int, default=1, metavar="N", help="processes for the samples (default: 1)")
    optimise.add_argument("--out", metavar="DIR", help="result folder (default: out/optimise-METRIC)")
    optimise.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto", help="where to compute (default: auto)")
    _add_again(optimise, resume="go on in an existing folder, also with more evaluations")
    add_scene_flags(optimise)
    _add_output_flags(optimise, _optimise)
    live = commands.add_parser("live", help="a page in the browser: press by hand, and see what the sensor sees", epilog=LIVE_EXAMPLES,
                               usage="%(prog)s [--scene FILE] [any field of the scene as a flag] [--record DIR]")  # fmt: skip
    live.add_argument("--scene", metavar="FILE", help="sensor, friction and first object from a scene file (default: a rigid ball)")
    live.add_argument("--port", type=int, default=8080, metavar="N", help="of the page, on this machine only (default: 8080, or the next)")
    live.add_argument("--record", metavar="DIR", help="write what is done, a folder for each sensor and object: docs/live.md")
    live.add_argument("--video-device", type=int, metavar="N", help="show the picture of camera N of this machine beside it")
    live.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto", help="where pictures are drawn (default: auto)")
    _add_output_flags(live, _live)
    add_scene_flags(live)
    inspect = commands.add_parser("inspect", help="say and draw what a result folder, a press.npz, a mesh file or a sensor is")
    inspect.add_argument("path", nargs="?", help="a result folder, a press.npz, or an STL, OBJ, PLY, OFF or GLB file")
    inspect.add_argument("--sensor", metavar="NAME", help="instead of a path: a sensor preset, or the path of a sensor file")
    inspect.add_argument("--out", metavar="FILE.png", help="where to draw it (default: not drawn)")
    inspect.add_argument(
        "--html",
        nargs="?",
        const="",
        metavar="FILE.html",
        help="of a press: one page with both bodies in 3D, pictures and force; works offline (default: page.html beside press.npz)",
    )
    inspect.add_argument("--vtu", metavar="DIR", help="of a press: surfaces by state for ParaView, press.pvd")
    inspect.add_argument("--mesh-unit", choices=CHOICES["object.mesh_unit"], help="unit of a mesh file (default: mm)")
    inspect.add_argument("--mesh-scale", type=float, metavar="NUMBER", help="multiplies a mesh file's numbers (default: 1)")
    inspect.add_argument(
        "--press-side", choices=CHOICES["object.press_side"], help="side of a mesh file's part that faces the gel (bottom)"
    )
    inspect.add_argument("--rotation-deg", type=float, nargs=3, metavar=("X", "Y", "Z"), help="turn it about x, then y, then z")
    inspect.add_argument("--force", action="store_true", help="write over an existing --out")
    doctor = commands.add_parser("doctor", help="what this machine can run, and what to install for more")
    for command, run in ((inspect, _inspect), (doctor, _doctor)):
        _add_output_flags(command, run)
    return parser


def _add_output_flags(parser: Parser, run: Callable[[argparse.Namespace], dict[str, Any]]) -> None:
    parser.set_defaults(run=run, parser=parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout and nothing else")
    parser.add_argument("--debug", action="store_true", help="show the Python trace of an error")


def _add_again(
    parser: Parser,
    force: str = "begin again in an existing folder",
    resume: str = "go on in an existing folder: cases that are done are kept",
) -> None:
    """What to do with an --out that is there already."""
    again = parser.add_mutually_exclusive_group()
    again.add_argument("--force", action="store_true", help=force)
    again.add_argument("--resume", action="store_true", help=resume)


def _add_common(parser: Parser, run: Callable[[argparse.Namespace], dict[str, Any]]) -> None:
    parser.add_argument("--scene", metavar="FILE", help="start from a scene file (TOML)")
    parser.add_argument("--out", metavar="DIR", help="result folder (default: out/SHAPE-HARDNESS)")
    parser.add_argument(
        "--poses",
        metavar="FILE.csv",
        help="many presses in one run: columns are fields of the scene (offset_mm, press.tilt_deg, …), a row a pose; a folder of each "
        "in --out, named by the column name or counted, and poses.csv of what they gave (default: out/SHAPE-HARDNESS-poses)",
    )
    parser.add_argument("--workers", type=int, metavar="N", help="processes that share --poses (default: one per core, one on a GPU)")
    _add_again(
        parser,
        force="replace the results in an existing folder; other files in it stay",
        resume="go on in an existing folder of the same scene: a press there is not solved again",
    )
    parser.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto", help="where to compute (default: auto)")
    _add_output_flags(parser, run)


def _scene(options: argparse.Namespace) -> Scene:
    return build_scene(*([read_layer(options.scene)] if options.scene else []), layer_of(options))


def _default_folder(scene: Scene) -> Path:
    body = scene.object
    if body.rigid:
        hardness = "rigid"
    elif body.youngs_modulus_kpa is not None:
        hardness = f"{body.youngs_modulus_kpa:g}kpa"
    else:
        hardness = f"00-{body.shore_00:g}" if body.shore_00 is not None else f"a-{body.shore_a:g}"
    name = Path(body.mesh).stem if body.mesh else body.shape
    return Path("out") / f"{name}-{hardness}"


def _press(options: argparse.Namespace) -> dict[str, Any]:
    return _run(options, render=False)


def _render(options: argparse.Namespace) -> dict[str, Any]:
    return _run(options, render=True)


def _run(options: argparse.Namespace, render: bool) -> dict[str, Any]:
    scene = _scene(options)
    probe = getattr(options, "probe", None)
    from gelsim.pipeline import stages

    wanted = stages.Wanted(render, getattr(options, "exr", False), Path(probe) if probe else None)
    run = partial(stages.run, wanted=wanted, force=options.force, resume=options.resume, device=options.device)
    if options.poses:
        return _run_poses(options, scene, run, render)
    if options.workers is not None:
        raise SceneError("--workers: they share the poses of --poses")
    with progress_bars() as progress:
        report = run(scene, Path(options.out) if options.out else _default_folder(scene), progress=progress)
    if not options.json:
        print(stages.summary(report))
    return report


def _run_poses(options: argparse.Namespace, scene: Scene, run: Callable[[Scene, Path], dict[str, Any]], drawn: bool) -> dict[str, Any]:
    from gelsim.pipeline import poses

    out = Path(options.out) if options.out else _default_folder(scene).with_name(f"{_default_folder(scene).name}-poses")
    table = poses.read_poses(Path(options.poses), scene)
    workers = options.workers
    if workers is None:
        workers = 1 if options.device == "cuda" or (drawn and _draws_on_gpu(options.device)) else os.cpu_count() or 1
    with progress_bars() as progress:
        result = poses.run_many(
            table, out, run, drawn=drawn, force=options.force, resume=options.resume, workers=workers, progress=progress
        )
    if not options.json:
        rate = f", {result['seconds_a_pose']:.2f} s each" if result["made"] else ""
        print(f"{result['out']}/{poses.TABLE}: {result['poses']} poses, {result['made']} made now{rate}")
    for item in result["failed"]:
        print(f"gelsim: failed: {item['pose']}: {item['message']}", file=sys.stderr)
    return result | ({"exit_code": PARTIAL} if result["failed"] else {})


def _draws_on_gpu(device: str) -> bool:
    from gelsim.optics import choose_variant

    return choose_variant(device).name.startswith("cuda")


def _live(options: argparse.Namespace) -> dict[str, Any]:
    if options.scene is None and getattr(options, "object.rigid") is None:
        setattr(options, "object.rigid", "true")  # as if it had been typed: a hardness beside it is an error
    ball = {"object": {"shape": "hemisphere", "radius_mm": 4.0, "height_mm": 10.0}}
    scene = build_scene(read_layer(options.scene) if options.scene else ball, layer_of(options))
    try:
        from gelsim.views.live_page import LivePage
    except ModuleNotFoundError as error:
        raise SceneError(f'live: {error.name} is not installed (pip install "gelsim[live]")') from None
    with progress_bars() as progress:
        page = LivePage(
            scene,
            port=options.port,
            record=Path(options.record) if options.record else None,
            video_device=options.video_device,
            device=options.device,
            progress=progress,
        )
        print("Open the address in a browser; Ctrl-C ends it.", flush=True)
        with suppress(KeyboardInterrupt):
            page.run()
    page.close()
    recorded = page.recording.frames if page.recording else 0
    if not options.json and options.record:
        print(f"{options.record}: {recorded} frames")
    return {"record": options.record, "frames": recorded}


def _inspect(options: argparse.Namespace) -> dict[str, Any]:
    from gelsim.views import inspection

    if (options.path is None) == (options.sensor is None):
        raise SceneError("inspect: give a path, or --sensor NAME")
    if options.out and Path(options.out).suffix.lower() != ".png":
        raise SceneError(f"--out {options.out}: what is drawn is a .png")
    sensor = build_scene({"sensor": {"preset": options.sensor}}) if options.sensor else None
    standing = {name: getattr(options, name) for name in inspection.STANDING if getattr(options, name) is not None}
    facts = inspection.inspect(Path(options.path), **standing) if sensor is None else inspection.inspect_sensor(sensor)
    if options.html == "":
        given = Path(options.path or ".")
        options.html = str((given if given.is_dir() else given.parent) / "page.html")
    for flag in ("out", "html", "vtu"):
        given = getattr(options, flag)
        if given and Path(given).exists() and not options.force:
            raise SceneError(f"--{flag} {given}: exists; give --force to write over it")
    if options.html or options.vtu:
        if sensor is not None:
            raise SceneError("--html, --vtu: they show a press; give the path of one in place of --sensor")
        facts |= inspection.export(Path(options.path), html=options.html, series=options.vtu)
    if options.out:
        out = Path(options.out)
        if sensor is None:
            inspection.draw(Path(options.path), out, **standing)
        else:
            inspection.draw_sensor(sensor, out)
        facts["drawing"] = str(out)
    if not options.json:
        print(inspection.describe(facts))
    return facts


def _bench(options: argparse.Namespace) -> dict[str, Any]:
    from gelsim.bench import runner
    from gelsim.bench.section import Options

    sections = tuple(options.only) if options.only else None
    asked = Options(sections, options.quick, **({"data": Path(options.data)} if options.data else {}))
    with progress_bars() as progress:
        result = runner.run(
            Path(options.out),
            asked,
            resume=options.resume,
            force=options.force,
            limit=options.limit,
            page=Path(options.page) if options.page else None,
            workers=options.workers,
            progress=progress,
        )
    if not options.json:
        print((Path(options.out) / "bench.md").read_text())
    return result


def _calibrate(options: argparse.Namespace) -> dict[str, Any]:
    from gelsim import calibrate

    with progress_bars() as progress:
        report = calibrate.calibrate(
            Path(options.photos), Path(options.out), sensor=options.sensor, force=options.force, device=options.device, progress=progress
        )
    if not options.json:
        print(calibrate.summary(report))
    return report


def _compare(options: argparse.Namespace) -> dict[str, Any]:
    from gelsim.calibrate import comparison

    if (options.sensor is None) == (options.frames is None):
        raise SceneError("compare: give --sensor NAME, or --frames DIR with pictures that were drawn before")
    friction = _friction(options.friction)
    drawn = Path(options.frames) if options.frames else comparison.Drawing(options.sensor, friction, options.mode)
    with progress_bars() as progress:
        report = comparison.compare(
            Path(options.photos), Path(options.out), drawn, force=options.force, device=options.device, progress=progress
        )
    if not options.json:
        print(comparison.summary(report))
    return report


def _identify(options: argparse.Namespace) -> dict[str, Any]:
    from gelsim.identify import run

    out = Path(options.out)
    run.check_free(out, force=options.force)
    with progress_bars() as progress:
        report = run.identify(
            Path(options.source),
            _scene(options),
            crop=tuple(options.crop) if options.crop else None,
            forces=Path(options.forces) if options.forces else None,
            force_sd=options.force_sd,
            device=options.device,
            progress=progress,
        )
    run.write(report, out)
    if not options.json:
        print(run.summary(report))
    return run.told(report)


def _durometer(options: argparse.Namespace) -> dict[str, Any]:
    from gelsim import durometer
    from gelsim.pipeline.outputs import ResultFolder

    friction, given = _friction(options.friction), (options.modulus_kpa, options.skin_mm, options.skin_kpa)
    if given[1:] != (None, None) and None in given:
        raise SceneError("durometer: --skin-mm, --skin-kpa and --modulus-kpa go together")
    if options.modulus_kpa is None and options.shore is None:
        if options.poissons_ratio is not None:
            raise SceneError("--poissons-ratio goes with --shore or --modulus-kpa")
        if options.out:
            ResultFolder(Path(options.out), resume=True)  # the whole scale takes minutes
        with progress_bars() as progress:
            rows = durometer.compare(options.scale, options.fidelity, progress=progress, foot=options.foot)
        if options.out:
            durometer.write(Path(options.out), rows, options.scale)
        if not options.json:
            print(durometer.summary(rows, options.scale))
        return {"scale": options.scale, "rows": rows}
    nu = durometer.POISSONS_RATIO if options.poissons_ratio is None else options.poissons_ratio
    low, high = LIMITS["object.poissons_ratio"]
    if not low <= nu <= high:
        raise SceneError(f"--poissons-ratio {nu:g}: allowed is {low:g} … {high:g}")
    if options.out:
        raise SceneError("durometer: --out DIR goes with the whole scale, without --shore and --modulus-kpa")
    found: dict[str, Any] = {"scale": options.scale, "friction": options.friction, "foot": options.foot}
    if options.modulus_kpa is not None:
        if options.foot:
            raise SceneError("--foot goes with --shore, or with the whole scale: its press is made for a reading")
        found["modulus_kpa"] = options.modulus_kpa
        skin = durometer.NO_SKIN
        if options.skin_mm is not None:
            if not (0 < options.skin_mm < durometer.BLOCK_MM and options.skin_kpa > 0 and options.modulus_kpa > 0):
                said = f"--skin-mm {options.skin_mm:g} mm, --skin-kpa {options.skin_kpa:g} kPa on {options.modulus_kpa:g} kPa"
                raise SceneError(f"durometer: {said}: allowed are more than 0, and less than the block's {durometer.BLOCK_MM:g} mm")
            skin = options.skin_mm, options.skin_kpa / options.modulus_kpa
            found |= {"skin_mm": options.skin_mm, "skin_kpa": options.skin_kpa}
        found["reading"] = durometer.reading(options.modulus_kpa * 1e3, options.scale, friction, options.fidelity, nu, skin)
    else:
        found["reading"] = options.shore
        found["modulus_kpa"] = durometer.modulus(options.shore, options.scale, friction, options.fidelity, options.foot, nu) / 1e3
    others = durometer.relations(found["reading"], options.scale)
    found["relations_kpa"] = {name: None if each is None else each / 1e3 for name, each in others.items()}
    if not options.json:
        said = ", ".join(f"{name} {each:.4g}" for name, each in found["relations_kpa"].items() if each is not None)
        print(f"Shore {options.scale} {found['reading']:.4g}: E = {found['modulus_kpa']:.4g} kPa (closed forms at that reading: {said})")
    return found


def _friction(text: str) -> float | str:
    low, high = LIMITS["contact.friction_coefficient"]
    try:
        if text == "stick" or low <= float(text) <= high:
            return text if text == "stick" else float(text)
    except ValueError:
        pass
    raise SceneError(f'--friction {text}: allowed is {low:g} … {high:g}, or "stick"')


def _dataset(options: argparse.Namespace) -> dict[str, Any]:
    if sum(given is not None for given in (options.episodes, options.light_of, options.real)) > 1:
        raise SceneError("dataset: --episodes N of a plan, --light-of DIR and --real DIR exclude each other")
    for flag, most in (("test", options.test_episodes), ("train", options.train_episodes)):
        if most is not None and (options.light_of or options.real):
            raise SceneError(f"dataset: --{flag}-episodes N goes with a plan")
    if options.real:
        from gelsim.generate import real

        with progress_bars() as progress:
            report = real.convert(Path(options.real), Path(options.out), sensor=options.sensor, resume=options.resume, progress=progress)
        if not options.json:
            print(real.summary(report))
        return report
    from gelsim import generate

    if options.sensor is not None and options.light_of is None:
        raise SceneError("dataset: --sensor NAME goes with --light-of DIR or --real DIR; a plan says which sensors it has")
    if options.no_light and options.light_of is not None:
        raise SceneError("dataset: --no-light and --light-of exclude each other")
    hands = generate.Hands(options.device, options.workers, options.ray)
    if options.light_of:
        from gelsim.generate.relight import relight

        with progress_bars() as progress:
            report = relight(
                Path(options.light_of), options.sensor, Path(options.out), plan=options.plan, seed=options.seed, hands=hands,
                resume=options.resume, progress=progress,
            )  # fmt: skip
        if not options.json:
            print(generate.summary(report))
        return report
    if options.episodes is None:
        raise SceneError("dataset: give --episodes N, --real DIR, or --light-of DIR")
    with progress_bars() as progress:
        report = generate.generate(
            options.plan or "paper2017",
            generate.Extent(options.episodes, test=options.test_episodes, train=options.train_episodes),
            Path(options.out),
            seed=options.seed,
            hands=hands,
            light=not options.no_light,
            resume=options.resume,
            progress=progress,
        )
    if not options.json:
        print(generate.summary(report))
    return report


def _study(options: argparse.Namespace) -> dict[str, Any]:
    from gelsim.study import definition, runner
    from gelsim.study.metrics import METRICS

    if options.list:
        known = {
            "studies": {name: definition.load_study(name).question for name in STUDIES},
            "metrics": {name: metric.label for name, metric in METRICS.items()},
        }
        if not options.json:
            for title, table in known.items():
                print(f"{title}:", *(f"  {name:<36} {said}" for name, said in table.items()), sep="\n")
        return known
    if options.name is None:
        raise SceneError(f"study: give a NAME, of {', '.join(STUDIES)} or a TOML file, or --list")
    study = definition.load_study(options.name)
    given = [options.name, *(["--quick"] if options.quick else []), *([f"--workers {options.workers}"] if options.workers > 1 else [])]
    with progress_bars() as progress:
        result = runner.run(
            study.small() if options.quick else study,
            Path(options.out or f"out/study-{study.name}"),
            resume=options.resume,
            force=options.force,
            workers=options.workers,
            device=options.device,
            command=" ".join(["gelsim study", *given]),
            progress=progress,
        )
    if not options.json:
        print(f"{result['question']}\n{result['answer']}\n{result['out']}/index.html: {result['cases']} cases")
    for item in result["failed"]:
        print(f"gelsim: failed: {item['case']}: {item['message']}", file=sys.stderr)
    return result | ({"exit_code": PARTIAL} if result["failed"] else {})


def _optimise(options: argparse.Namespace) -> dict[str, Any]:
    from gelsim.study import optimise

    goals = [optimise.parse_goal(text) for text in (options.goal, options.also) if text]
    bounds = dict(optimise.parse_bounds(text) for text in options.within)
    base = scene_table(_scene(options))
    with progress_bars() as progress:
        result = optimise.optimise(
            optimise.Problem(goals, bounds, base, options.evaluations),
            Path(options.out or f"out/optimise-{goals[0].metric}"),
            resume=options.resume,
            force=options.force,
            workers=options.workers,
            device=options.device,
            command=options.typed,
            progress=progress,
        )
    if not options.json:
        print(f"{result['question']}\n{result['answer']}\n{result['out']}/index.html: {result['cases']} evaluations")
    return result


def _doctor(options: argparse.Namespace) -> dict[str, Any]:
    from gelsim.cli import doctor

    facts = doctor.examine()
    if not options.json:
        print(doctor.describe(facts))
    return facts


@contextmanager
def _clean_stdout(wanted: bool) -> Iterator[Callable[[dict[str, Any]], None]]:
    """While it lasts, what libraries print on stdout goes to stderr; the function it gives prints the one JSON object."""
    if not wanted:
        yield lambda result: None
        return
    sys.stdout.flush()
    kept = os.dup(1)
    os.dup2(2, 1)
    answers: list[dict[str, Any]] = []
    try:
        # Descriptor 1 for compiled libraries, sys.stdout for Python ones.
        with redirect_stdout(sys.stderr):
            yield answers.append
    finally:
        sys.stdout.flush()
        os.dup2(kept, 1)
        os.close(kept)
        for result in answers:
            try:
                print(json.dumps(result, allow_nan=False), flush=True)
            except BrokenPipeError:
                os.dup2(os.open(os.devnull, os.O_WRONLY), 1)


def _fail(error: Exception, code: int, debug: bool, answer: Callable[[dict[str, Any]], None] | None, message: str | None = None) -> int:
    if debug:
        import traceback

        traceback.print_exception(error)
    line = " ".join((message or str(error)).split())
    print(f"gelsim: {line}", file=sys.stderr)
    if answer:
        answer({"error": line, "kind": type(error).__name__, "exit_code": code})
    return code


if __name__ == "__main__":
    sys.exit(main())
