"""The command line: `gelsim-learn train | eval | predict`. Nothing heavy is imported before a command needs it.

Exit codes: 0 done; 2 bad input, one line says what and what is allowed; 4 some of several videos gave no estimate.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

from gelsim import console
from gelsim.errors import GelsimError
from gelsim.scene.fields import field_types, parse_text
from learn import config as config_module
from learn.config import PRESETS, Config, LearnError, configure, sections

OK, INTERNAL, BAD_INPUT, PARTIAL, INTERRUPTED = 0, 1, 2, 4, 130

ABOUT = """\
gelsim-learn reads hardness (Shore 00) from videos of a tactile sensor that is pressed against something.

  gelsim-learn train --data DIR --out RUN                    our network
  gelsim-learn train --data DIR --out RUN --model paper --vgg-weights vgg16.pth
  torchrun --nproc-per-node 4 -m learn.cli train --data DIR --out RUN --workers 12
  gelsim-learn train --data SIM --real DIR --init varied --real-presses 20 --rate 1e-4 --steps 500 --out TUNED
  gelsim-learn eval --model RUN/model.pt --data DIR --out RUN/eval
  gelsim-learn predict --model RUN/model.pt press.mp4

What each means, and how far to trust it: docs/learner.md."""


class Parser(console.Parser):
    """The command line's."""

    wrong = LearnError


def main(arguments: list[str] | None = None) -> int:
    """Runs one command and returns its exit code."""
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        options = _parser().parse_all(arguments)
        return options.run(options)
    except GelsimError as error:
        line, code = " ".join(str(error).split()), BAD_INPUT
        kind = type(error).__name__
    except KeyboardInterrupt:
        line, code, kind = "interrupted; a training goes on with --resume", INTERRUPTED, "KeyboardInterrupt"
    except Exception as error:
        if "--debug" in arguments:
            raise
        if isinstance(error, OSError) and error.filename is not None:
            line, code = f"{error.filename}: {error.strerror}", BAD_INPUT
        else:
            line, code = f"internal error, {type(error).__name__}: {error} (a bug; run again with --debug for the trace)", INTERNAL
        line, kind = " ".join(line.split()), type(error).__name__
    print(f"gelsim-learn: {line}", file=sys.stderr)
    if "--json" in arguments:
        print(json.dumps({"error": line, "kind": kind, "exit_code": code}))
    return code


def _parser() -> Parser:
    parser = Parser(prog="gelsim-learn", description=ABOUT)
    parser.add_argument("--version", action=console.ShowVersion)
    commands = parser.add_subparsers(metavar="COMMAND", required=True, parser_class=Parser)
    train = commands.add_parser("train", help="train a network on presses")
    train.add_argument("--data", required=True, type=Path, metavar="DIR", help="a dataset of presses")
    train.add_argument("--real", type=Path, metavar="DIR", help="a second one, of real presses, mixed in at --real-ratio")
    train.add_argument("--out", required=True, type=Path, metavar="RUN", help="run folder")
    train.add_argument("--resume", action="store_true", help="go on with an interrupted run, by its own settings")
    train.add_argument("--force", action="store_true", help="begin again in an existing folder")
    train.add_argument("--init", metavar="CKPT", help="begin from this network, a checkpoint or the name of a shipped one (fine-tuning)")
    train.add_argument("--cache", type=Path, metavar="DIR", help="averaged pictures, which several runs may share (default: RUN/cache)")
    train.add_argument("--vgg-weights", type=Path, metavar="FILE", help="--model paper: VGG16 weights in torchvision's layout")
    train.add_argument("--preset", choices=tuple(PRESETS), help="settings to start from (default: paper with --model paper)")
    documented = console.field_docs(config_module)
    for name, kind in sections().items():
        group = train.add_argument_group(f"[{name}]")
        docs = documented[kind.__name__]
        for item in dataclasses.fields(kind):
            if item.default is not dataclasses.MISSING:
                shown = "x".join(map(str, item.default)) if isinstance(item.default, tuple) else str(item.default).lower()
                help_text = f"{docs.get(item.name, '')} (default: {shown})".strip().replace("%", "%%")
                group.add_argument("--" + item.name.replace("_", "-"), dest=f"config.{item.name}", metavar="VALUE", help=help_text)
    evaluate = commands.add_parser("eval", help="the table of the paper, plots and errors of a network on test presses")
    evaluate.add_argument(
        "--model", action="append", required=True, metavar="CKPT",
        help="a checkpoint, or the name of a shipped one; given more than once, they read as one",
    )  # fmt: skip
    evaluate.add_argument("--data", required=True, type=Path, metavar="DIR", help="a dataset with test splits")
    evaluate.add_argument("--out", type=Path, metavar="DIR", help="result folder (default: eval-DATA beside the checkpoint)")
    evaluate.add_argument("--row", action="append", default=[], metavar="SPLIT", help="test this split (default: the paper's rows)")
    evaluate.add_argument(
        "--cache", type=Path, metavar="DIR", help="averaged pictures of a training (default: cache beside the checkpoint)"
    )
    evaluate.add_argument("--workers", type=int, default=0, metavar="N", help="processes that read presses (default: this one alone)")
    bare = evaluate.add_mutually_exclusive_group()
    bare.add_argument("--no-baselines", action="store_true", help="leave the baselines out: with many presses they take their time")
    bare.add_argument(
        "--baselines-from", type=Path, metavar="DIR", help="the dataset whose split train the baselines learn from (default: --data)"
    )
    evaluate.add_argument("--force", action="store_true", help="write over an existing result")
    predict = commands.add_parser("predict", help="hardness and its spread from videos, folders of frames, episodes or datasets")
    predict.add_argument(
        "--model", action="append", metavar="CKPT",
        help="a checkpoint, or the name of a shipped one; given more than once, they read as one (default: default, which is "
        "paper2017, varied and families)",
    )  # fmt: skip
    predict.add_argument("videos", nargs="+", type=Path, metavar="VIDEO", help="a video, a folder of frames, an episode's tar, a dataset")
    predict.add_argument("--background", type=Path, metavar="FILE", help="a picture without contact (default: the first frame)")
    predict.add_argument("--start", type=float, default=0.0, metavar="S", help="where in the video the press begins [s] (default: 0)")
    predict.add_argument("--seconds", type=float, metavar="S", help="how long it lasts [s] (default: to the end)")
    predict.add_argument(
        "--crop",
        nargs=4,
        type=int,
        metavar=("LEFT", "TOP", "WIDTH", "HEIGHT"),
        help="what of the pictures is the gel [px] (default: all)",
    )
    predict.add_argument(
        "--corners", nargs=8, type=float, metavar=("X", "Y", *["…"] * 6),
        help="corners of a rectangle on the gel, clockwise from its top left [px]: the pictures are set upright by them",
    )  # fmt: skip
    predict.add_argument("--corners-mm", nargs=2, type=float, metavar=("WIDTH", "HEIGHT"), help="how large that rectangle is")
    predict.add_argument(
        "--mm-per-px", type=float, metavar="MM",
        help="how large a pixel is on the gel: the press is shown to the network at the scale that it knows (default: the picture, or what "
        "is cut out of it, is taken for 18.4 mm wide)",
    )  # fmt: skip
    predict.add_argument(
        "--sensor", metavar="NAME", help="whose gel it is: a sensor preset, or a sensor or scene file (default: what was recorded with it)"
    )
    predict.add_argument(
        "--identified", type=Path, metavar="DIR", help="what gelsim identify found for this press: told beside, and whether they disagree"
    )  # fmt: skip
    for command in (train, evaluate):
        command.add_argument(
            "--plan", metavar="FILE", help="of a dataset without pictures, which are drawn first: its plan, if it does not keep it"
        )
    for command, run in ((train, _train), (evaluate, _evaluate), (predict, _predict)):
        command.set_defaults(run=run, parser=command)
        command.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto", help="where to compute (default: auto)")
        said = command.add_mutually_exclusive_group() if command is predict else command
        said.add_argument("--json", action="store_true", help="print one JSON object on stdout and nothing else")
        if command is predict:
            said.add_argument("--json-lines", action="store_true", help="print a JSON object for each press as soon as it is read")
        command.add_argument("--debug", action="store_true", help="show the Python trace of an internal error")
    return parser


def _train(options: argparse.Namespace) -> int:
    given = {name.removeprefix("config."): text for name, text in vars(options).items() if name.startswith("config.") and text is not None}
    hints = {name: hint for kind in sections().values() for name, hint in field_types(kind).items()}
    changes = {name: parse_text(text, hints[name], name) for name, text in given.items()}
    if options.resume and options.init:
        raise LearnError("--init: a run that goes on has begun already; leave --init or --resume out")
    from learn import train
    from learn.predict import find_model
    from learn.recordings import Reading

    init = find_model(options.init, "--init") if options.init else None
    if options.resume:
        config = train.read_run(options.out)
        wanted = configure_from(config, changes)
        if wanted != configure_from(config, {key: value for key, value in changes.items() if key == "workers"}):
            raise LearnError(f"--resume goes on with the settings in {options.out / 'config.json'}; leave {', '.join(sorted(given))} out")
        config = wanted
    elif init:
        from learn.checkpoint import load

        begun = load(init).config
        config = configure_from(configure(options.preset or begun.model.model.replace("press", "default")), {})
        config = dataclasses.replace(configure_from(config, changes), input=begun.input, model=begun.model)
        fixed = {item.name for part in (begun.input, begun.model) for item in dataclasses.fields(part)} & set(changes)
        if fixed:
            raise LearnError(f"--init fixes the network: leave {', '.join(sorted(fixed))} out")
    else:
        config = configure(options.preset or ("paper" if changes.get("model") == "paper" else "default"), **changes)
    if config.model.model == "paper" and not (options.vgg_weights or options.init or options.resume):
        print("VGG16 starts from random weights: no --vgg-weights were given (the paper starts from ImageNet)", file=sys.stderr)
    with console.progress_bars() as progress:
        report = train.train(
            options.data, options.out, config, real=options.real, begin=train.Begin(init, options.vgg_weights), resume=options.resume,
            force=options.force, reading=Reading(options.cache, progress, plan=options.plan, device=options.device),
        )  # fmt: skip
    if report:
        line = f"{options.out / 'model.pt'}: step {report['step']}"
        if "validation_rmse" in report:
            line += f", RMSE {report['validation_rmse']:.2f} on {report['validation_presses']} validation presses"
            line += f" (training mean: {report['validation_rmse_of_mean']:.2f})"
        print(json.dumps(report) if options.json else line)
    return OK


def configure_from(config: Config, changes: dict[str, Any]) -> Config:
    """A config with some fields changed."""
    parts = {name: getattr(config, name) for name in sections()}
    flat = {item.name: getattr(part, item.name) for part in parts.values() for item in dataclasses.fields(part)}
    return configure(**(flat | changes))


def _evaluate(options: argparse.Namespace) -> int:
    from learn import evaluate
    from learn.predict import find_models
    from learn.recordings import Reading

    models = find_models(options.model)
    out = options.out or models[0].parent / f"eval-{options.data.resolve().name}"
    with console.progress_bars() as progress:
        report = evaluate.evaluate(
            models, options.data, out, rows=options.row, force=options.force,
            baselines_from=None if options.no_baselines else options.baselines_from or options.data,
            reading=Reading(options.cache, progress, options.workers, options.plan, options.device),
        )  # fmt: skip
    print(json.dumps(evaluate.without_nan(report)) if options.json else evaluate.table(report) + f"\n{out}")
    return OK


def _predict(options: argparse.Namespace) -> int:
    import numpy as np

    from learn import predict
    from learn.framing import CORNERS_MM, Corners, Framing

    if options.corners_mm and not options.corners:
        raise LearnError(CORNERS_MM)
    framing = Framing(
        crop=options.crop and tuple(options.crop),
        corners=options.corners and Corners(np.reshape(options.corners, (4, 2)), options.corners_mm and tuple(options.corners_mm)),
        mm_per_px=options.mm_per_px,
    )
    identified = None if options.identified is None else predict.read_identified(options.identified)
    if identified and len(options.videos) > 1:
        raise LearnError(f"--identified {options.identified}: is of one press; {len(options.videos)} were given")
    models = predict.find_models(options.model or ["default"])
    answers = []
    for answer in predict.predict(
        models, options.videos, background=options.background, start=options.start, seconds=options.seconds, sensor=options.sensor,
        framing=framing, device=options.device,
    ):  # fmt: skip
        answer = predict.beside(answer, identified) if identified else answer
        answers.append(answer)
        if options.json_lines:
            print(json.dumps(answer, allow_nan=False), flush=True)
        elif not options.json:
            failed = answer["status"] == "unreadable"
            print(predict.in_words(answer), file=sys.stderr if failed else sys.stdout, flush=True)
    if options.json:
        print(json.dumps({"presses": answers}, allow_nan=False))
    good = sum(answer["status"] == "ok" for answer in answers)
    return OK if good == len(answers) else PARTIAL if good else BAD_INPUT


if __name__ == "__main__":
    sys.exit(main())
