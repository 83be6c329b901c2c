"""What holds for every scene, hardness, motion and dataset row there can be; drawn by Hypothesis, the same ones each time."""

from __future__ import annotations

import dataclasses
import json
import tomllib
import typing
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelsim.data.episodes import check_row, gel_facts
from gelsim.errors import DatasetError, GelsimError
from gelsim.scene import materials
from gelsim.scene.definition import Gel, Press, Scene, Waypoint
from gelsim.scene.fields import field_types
from gelsim.scene.layers import build_scene, dump_scene, nested
from gelsim.scene.limits import CHOICES, LIMITS
from gelsim.scene.motion import motion, shared_out, straight

drawn = settings(derandomize=True, database=None, max_examples=150, deadline=None)

SECTIONS = {name: kind for name, kind in field_types(Scene).items() if dataclasses.is_dataclass(kind)}
NUMBERS = sorted(f"{section}.{name}" for section, kind in SECTIONS.items() for name in field_types(kind) if f"{section}.{name}" in LIMITS)
WORDS = sorted(name for name in CHOICES if "." in name)


def value_within(name: str) -> st.SearchStrategy[Any]:
    """Values of a number field within its limits, of the kind and the length that the field has."""
    section, field = name.split(".")
    hint = field_types(SECTIONS[section])[field]
    low, high = LIMITS[name]
    hints = typing.get_args(hint) or (hint,)
    whole = int in hints and float not in hints
    number = st.integers(int(low), int(high)) if whole else st.floats(low, high, allow_nan=False)
    items = typing.get_args(hint) if typing.get_origin(hint) is tuple else ()
    if not items:
        return number
    return st.lists(number, max_size=4) if items[-1] is Ellipsis else st.tuples(*[number] * len(items)).map(list)


fields_within = st.lists(st.sampled_from([*NUMBERS, *WORDS]), min_size=1, max_size=5, unique=True).flatmap(
    lambda names: st.fixed_dictionaries({n: st.sampled_from(sorted(CHOICES[n])) if n in WORDS else value_within(n) for n in names})
)
scalars = (st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8))
anything = st.one_of(*scalars, st.lists(st.floats(), max_size=3), st.just({}))


@drawn
@given(fields_within)
def test_a_scene_is_read_as_it_was_written(fields: dict[str, Any]) -> None:
    """Or refused in words that name a field: fields may not go together, but nothing else happens."""
    try:
        scene = build_scene(nested(fields))
    except GelsimError as error:
        assert any(name.split(".")[-1] in str(error) for name in (*NUMBERS, *WORDS)), error
        return
    assert build_scene(tomllib.loads(dump_scene(scene))) == scene


@drawn
@given(st.dictionaries(st.sampled_from([*NUMBERS, *WORDS]), anything, min_size=1, max_size=3))
def test_whatever_is_given_is_refused_in_words_or_read(fields: dict[str, Any]) -> None:
    try:
        build_scene(nested(fields))
    except GelsimError as error:
        assert "\n" not in str(error) and len(str(error)) < 600


@drawn
@given(st.floats(*materials.SHORE_00_RANGE))
def test_a_reading_of_a_modulus_of_a_reading_is_that_reading(shore: float) -> None:
    assert materials.shore_00_from_modulus(materials.modulus_from_shore_00(shore)) == pytest.approx(shore, abs=1e-6)


waypoints = st.lists(
    st.builds(
        Waypoint,
        duration_s=st.floats(0.01, 10),
        depth_mm=st.floats(0.0, 2.0),
        shear_mm=st.tuples(st.floats(-2, 2), st.floats(-2, 2)),
        twist_deg=st.floats(-20, 20),
    ),
    min_size=1,
    max_size=6,
)


@drawn
@given(waypoints, st.integers(8, 60))
def test_a_path_is_passed_through(path: list[Waypoint], frames: int) -> None:
    """Every waypoint is a recorded state; legs join; there are as many states as were asked for."""
    way = motion(Press(path=tuple(path), frames=frames))
    assert way is not None and len(way.recorded) == frames and way.recorded[0] == 0.0
    assert (np.diff(way.recorded) > 0.0).all()
    for leg, point in enumerate(path, start=1):
        assert np.isclose(way.recorded, way.time[leg], rtol=1e-12).any()
        approach, _, shear, turn = way.at(leg, float(way.time[leg]))
        assert (approach, *shear, turn[2]) == pytest.approx((point.depth_mm, *point.shear_mm, point.twist_deg))  # type: ignore[misc]
        if leg < len(path):
            assert way.at(leg + 1, float(way.time[leg]))[0] == pytest.approx(approach)


@drawn
@given(st.integers(0, 50), st.lists(st.floats(0.01, 100), min_size=1, max_size=6))
def test_states_are_shared_out_whole(more: int, seconds: list[float]) -> None:
    counts = shared_out(len(seconds) + more, np.array(seconds))
    assert sum(counts) == len(seconds) + more and min(counts) >= 1


@drawn
@given(st.floats(0.1, 5), st.floats(-2, 2), st.floats(0.1, 0.9))
def test_a_motion_that_is_cut_off_stays_there(depth: float, shear: float, share: float) -> None:
    way = straight(Press(shear_mm=(shear, 0.0), hold_s=1.0, frames=7), depth)
    time = share * float(way.time[1])
    cut, there = way.stays_from(1, time), way.at(1, time)
    assert cut.at(1, time)[0] == pytest.approx(there[0]) and cut.at(2, float(cut.time[2]))[2] == pytest.approx(there[2])
    assert cut.time[-1] - cut.time[1] == pytest.approx(1.0)


@drawn
@given(st.dictionaries(st.sampled_from(["id", "file", "shore_00", "shape", "gel", "split", "frames"]), anything))
def test_a_row_of_a_dataset_is_read_or_refused_in_words(row: dict[str, Any]) -> None:
    try:
        check_row(row, "row 1")
    except DatasetError as error:
        assert "row 1" in str(error)


@drawn
@given(st.floats(0.5, 20), st.floats(5, 80))
def test_what_a_row_says_of_a_gel_survives_json(thickness: float, shore: float) -> None:
    facts = gel_facts(Gel(profile="flat", thickness_mm=thickness, shore_00=shore))
    assert json.loads(json.dumps(facts)) == facts and facts["edge_thickness_mm"] == thickness
