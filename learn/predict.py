"""`gelsim-learn predict`: what a press says about the hardness of what was pressed, how sure that is, and whether to trust it at all."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gelsim.data.episodes import gel_facts
from gelsim.errors import GelsimError
from gelsim.scene.layers import PRESET_SECTIONS, build_scene, load_scene, read_layer
from learn.config import LearnError
from learn.data import HARDEST, Gel, choose, gel_of
from learn.ensemble import Ensemble
from learn.estimate import pick_device
from learn.framing import FIELD_MM, Framing
from learn.video import AS_IT_IS, Source, sources

SHIPPED = {"default": ("paper2017", "varied", "families")}
"""Names that stand for several of the checkpoints in assets/models/, which read together."""

GEL_UNTOLD = "the gel is not known (--sensor tells it)"
SCALE_UNTOLD = f"the scale is not known (--mm-per-px tells it): taken for {FIELD_MM[0]:g} mm wide"

CERTAIN = 1.645
"""Standard deviations that hold 90 % of a normal distribution."""


def find_models(names: Sequence[str], flag: str = "--model") -> list[Path]:
    """Checkpoints by path, or by name among the shipped ones; `flag` is how they were asked for.

    Raises:
        LearnError: There is none.
    """
    parts = (part for name in names for part in ((name,) if Path(name).is_file() else SHIPPED.get(name, (name,))))
    return [_find(part, flag) for part in parts]


def _find(name: str, flag: str) -> Path:
    path = Path(name)
    if path.suffix or path.is_file():
        return path
    beside = Path(__file__).parent.parent
    places = [beside / folder / "models" / f"{name}.pt" for folder in ("gelsim/_assets", "assets")]
    for place in places:
        if place.is_file():
            return place
    raise LearnError(f"{flag} {name}: no such file, and no shipped checkpoint of this name; train one: gelsim-learn train")


def find_model(name: str, flag: str) -> Path:
    """As `find_models`, where it must be one."""
    found = find_models([name], flag)
    if len(found) > 1:
        raise LearnError(f"{flag} {name}: stands for {len(found)} networks; name one: {', '.join(path.stem for path in found)}")
    return found[0]


def gel_of_sensor(name: str) -> Gel:
    """The gel of a sensor preset, by name, or of a sensor or scene file.

    Raises:
        SceneError: There is none, or it cannot be used.
    """
    # A sensor file fills some sections of a scene; what it leaves out is no preset's.
    whole = name.endswith(".toml") and not set(read_layer(name)) <= set(PRESET_SECTIONS)
    scene = load_scene(name) if whole else build_scene({"sensor": {"preset": name}})
    return gel_of(gel_facts(scene.gel))


def predict(
    models: Sequence[Path],
    videos: Sequence[Path],
    *,
    background: Path | None = None,
    start: float = 0.0,
    seconds: float | None = None,
    sensor: str | None = None,
    framing: Framing = AS_IT_IS,
    device: str = "auto",
) -> Iterator[dict[str, Any]]:
    """One answer a press, as they come.

    Args:
        models: Checkpoints; of several the readings are one (`learn.ensemble`).
        framing: What of the pictures of videos and folders is the gel, and their scale.
        sensor: Whose gel it is (`gel_of_sensor`); None: what a press itself says of it, if anything.
    Yields:
        source, status ("ok", "no contact" or "unreadable"), note; when ok also shore_00, spread (None: the network knows none), frames,
        novelty (distance over the greatest that is usual; None: not fitted), unlike_training (by that or by the gel), true (None: unknown).
    Raises:
        LearnError, SceneError: The checkpoint or the sensor cannot be used, or the network takes no gel.
    """
    gel = None if sensor is None else gel_of_sensor(sensor)
    ensemble = Ensemble(models, pick_device(device))
    inputs = ensemble.inputs
    if gel is not None and not ensemble.asks_gel:
        raise LearnError(f"--sensor {sensor}: {models[0].name} takes no gel; leave it out")
    for video in videos:
        for name, read in _listed(video, inputs, background, start, seconds, framing):
            try:
                source = read()
            except GelsimError as error:
                yield {"source": name, "status": "unreadable", "note": str(error)}
                continue
            press = choose(source.recording, inputs, ensemble.repeat)
            if press is None:
                peak = float(source.recording.signal.max())
                note = (
                    f"no contact in {len(source.recording.pictures)} frames: the intensity changes by {peak:.3f} levels at most, "
                    f"contact begins at {inputs.contact_levels:g}"
                )
                yield {"source": source.name, "status": "no contact", "note": note, "true": source.true}
                continue
            press = replace(press, gel=source.gel if gel is None else gel)
            said = ensemble.read([press])
            mean, spread, distance = (float(part[0]) for part in (said.mean, said.spread, said.novelty))
            strange, odd_gel = distance > 1, ensemble.strange_gel(press.gel)
            untold = [GEL_UNTOLD] if ensemble.asks_gel and not np.isfinite(press.gel).all() else []
            untold += [] if press.scaled else [SCALE_UNTOLD]
            yield {
                "source": source.name,
                "status": "ok",
                "shore_00": mean,
                "spread": spread if np.isfinite(spread) else None,
                "frames": len(press.pictures),
                "novelty": distance if np.isfinite(distance) else None,
                "unlike_training": strange or bool(odd_gel),
                "true": source.true,
                "note": _note(source, mean, distance if strange else None, odd_gel + untold),
            }


def _listed(video: Path, *options: Any) -> Iterator[tuple[str, Callable[[], Source]]]:
    """The presses of a path; a path that has none is one that cannot be read."""
    try:
        yield from sources(video, *options)
    except GelsimError as error:

        def refuse(reason: GelsimError = error) -> Source:
            raise reason

        yield str(video), refuse


def _note(source: Source, mean: float, distance: float | None, more: list[str]) -> str:
    notes = [source.note] if source.note else []
    if distance is not None:
        notes.append(f"unlike anything it was trained on ({distance:.2g} times as far off as a press may be): do not trust this")
    if mean > HARDEST:
        notes.append(f"harder than any silicone it was trained on ({HARDEST:g})")
    return "; ".join(notes + more)


def read_identified(path: Path) -> tuple[float, float]:
    """Shore 00 and its standard deviation by the mechanics, from the report.json of `gelsim identify` or the folder that holds it.

    Raises:
        LearnError: It is no such report, or its modulus has no Shore 00.
    """
    file = path / "report.json" if path.is_dir() else path
    try:
        report = json.loads(file.read_text())
        shore, spread = float(report["shore_00"]), float(report["shore_00_sd"])
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise LearnError(
            f"--identified {path}: is no report of gelsim identify with a Shore 00 ({type(error).__name__}: {error})"
        ) from None
    return shore, spread


def beside(answer: dict[str, Any], identified: tuple[float, float]) -> dict[str, Any]:
    """An answer with what the mechanics say of the same press, and whether the two are further apart than 90 % of their differences.

    Adds identified_shore_00, identified_spread and, where the network knows a spread, disagree.
    """
    if answer["status"] != "ok":
        return answer
    shore, spread = identified
    answer = answer | {"identified_shore_00": shore, "identified_spread": spread}
    told = f"by the mechanics {shore:.1f} ± {spread:.1f}"
    if answer["spread"] is not None:
        answer["disagree"] = bool(abs(answer["shore_00"] - shore) > CERTAIN * np.hypot(answer["spread"], spread))
        told += ": the two disagree" if answer["disagree"] else ": the two agree"
    return answer | {"note": "; ".join(filter(None, (answer["note"], told)))}


def in_words(answer: dict[str, Any]) -> str:
    """One line for people."""
    if answer["status"] != "ok":
        text = answer["note"]
        return text if text.startswith(answer["source"]) else f"{answer['source']}: {text}"
    spread = "" if answer["spread"] is None else f" ± {answer['spread']:.1f}"
    true = "" if answer["true"] is None else f" (true: {answer['true']:.1f})"
    note = f"; {answer['note']}" if answer["note"] else ""
    return f"{answer['source']}: Shore 00 {answer['shore_00']:.1f}{spread}{true}{note}"
