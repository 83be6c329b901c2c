"""Imports point downward only, and heavy packages stay in their homes: read from the syntax trees, nothing is imported."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest
from structure import ROOT, arrows, circles, imports, module_of, room

# A room may use those of lower layers, and itself. Siblings of one layer do not import each other.
LAYERS = [
    {"errors", "units"},
    {"geometry", "results", "scene", "work", "files"},
    {"shape", "console", "tables"},
    {"data", "membrane", "mesh", "fem"},
    {"optics"},
    {"live"},
    {"pipeline"},
    {"bench", "calibrate", "durometer", "generate", "study", "views"},
    {"identify"},
    {"cli"},
    {"__main__", "__init__"},
]
HOMES = {
    "ray": {"work"}, "pytetwild": {"mesh"}, "warp": {"fem", "live"}, "mitsuba": {"optics"}, "drjit": {"optics"}, "torch": {"live"},
    "mujoco": {"live"}, "newton": {"live"}, "gymnasium": {"live"}, "viser": {"views"},
}  # fmt: skip
"""Of packages; PyTorch's other one is the learner."""
LEARN_MAY_USE = set().union(*LAYERS[:3]) | {"data", "__init__"}
LEARN_DRAWS = ("learn.recordings", "gelsim.generate.darkroom")
"""The one way from the learner to the simulator, taken inside a function: only where a dataset has no pictures."""

GELSIM = sorted((ROOT / "gelsim").rglob("*.py"))
LEARN = sorted((ROOT / "learn").rglob("*.py"))


def level(name: str) -> int:
    return next(index for index, layer in enumerate(LAYERS) if name in layer)


def violations(here: str, names: list[str]) -> list[str]:
    wrong = []
    for name in names:
        top = name.partition(".")[0]
        if top == "learn":
            wrong.append(f"{here} imports learn")
        if here not in HOMES.get(top, {here}):
            wrong.append(f"{here} imports {top}, whose home is {', '.join(sorted(HOMES[top]))}")
        if top == "gelsim" and room(name) != here and level(room(name)) >= level(here):
            wrong.append(f"{here} imports {name}, which is not below it")
    return wrong


@pytest.mark.parametrize("path", GELSIM, ids=lambda path: str(path.relative_to(ROOT)))
def test_gelsim_imports_downward(path: Path) -> None:
    assert violations(room(module_of(path)), imports(path)) == []


def test_learn_imports_only_the_light_layers() -> None:
    drawn = []
    for path in LEARN:
        for name in imports(path):
            top = name.partition(".")[0]
            assert top not in ("warp", "mitsuba", "drjit", "pytetwild"), path
            if top == "gelsim" and room(name) not in LEARN_MAY_USE:
                drawn.append((module_of(path), name))
    assert drawn == [LEARN_DRAWS]  # no other, and it is no dead exception


def test_learn_loads_the_simulator_only_to_draw() -> None:
    code = "import sys, learn.recordings, learn.cli; print([n for n in sys.modules if n.startswith('gelsim.generate') or n == 'mitsuba'])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert found.stdout.strip() == "[]"


def test_no_circles() -> None:
    assert circles(arrows()) == []


def test_every_room_and_home_is_there() -> None:
    rooms = {room(module_of(path)) for path in GELSIM}
    assert set().union(*LAYERS) == rooms
    used = {(room(module_of(path)), name.partition(".")[0]) for path in GELSIM for name in [*imports(path), *imports_of_programs(path)]}
    assert {(home, package) for package, homes in HOMES.items() for home in homes} <= used


def imports_of_programs(path: Path) -> list[str]:
    """What the programs import that a file holds as texts, to be run in a process of their own: so mesh takes pytetwild."""
    texts = [node.value for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Constant) and isinstance(node.value, str)]
    lines = [line for text in texts for line in re.findall(r"^import ([\w, ]+)$", text, re.MULTILINE)]
    return [name for line in lines for name in line.split(", ")]


def test_no_drawer_for_odds_and_ends() -> None:
    assert [path for path in GELSIM + LEARN if path.stem in ("utils", "common", "helpers", "misc")] == []


def test_planted_faults_are_found() -> None:
    assert violations("scene", ["gelsim.fem.newton"]) and violations("fem", ["gelsim.optics"]) and violations("shape", ["warp"])
    assert violations("pipeline", ["learn.data"]) and not violations("cli", ["gelsim.pipeline", "gelsim.views.inspection"])
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": set()}) == [{"b", "c"}]
