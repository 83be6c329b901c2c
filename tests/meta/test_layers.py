"""Imports point downward only, and heavy packages stay in their homes: read from the syntax trees, nothing is imported."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

# A module may import modules of lower layers and of its own package. Siblings of one layer do not import each other.
LAYERS = [
    {"errors", "units"},
    {"geometry", "materials", "ledger", "workers", "cluster", "files", "clough_tocher", "fields"},
    {"scene", "limits", "results"},
    {"scene_file", "markers", "console", "tables"},
    {"solids", "sizing", "mesh_file", "bisection"},
    {"shapes", "inclusions", "lightfield", "dataset", "motion", "metrics", "rim_edges", "distributions"},
    {"contact_area"},
    {"meshing", "gel_mesh", "profiles", "fem", "membrane", "optics"},
    {"outputs", "sensor_sheet", "dataset_sheet", "sheet", "press_page", "fidelity", "reductions"},
    {"pipeline", "inspection", "doctor", "randomize"},
    {"generate", "study", "calibrate", "durometer", "bench"},
    {"flags"},
    {"cli"},
    {"__main__", "__init__"},
]
# Pairs within a layer that may: the first uses the second.
HELPERS = {
    ("scene", "units"),
    ("cluster", "workers"),
    ("sizing", "solids"),
    ("mesh_file", "solids"),
    ("outputs", "sheet"),
    ("inclusions", "shapes"),
    ("scene", "limits"),
    ("motion", "dataset"),
    ("limits", "units"),
    # The light field is measured on membranes that no press made.
    ("optics", "membrane"),
}
HOMES = {"ray": {"cluster"}, "pytetwild": {"meshing"}, "warp": {"fem"}, "mitsuba": {"optics"}, "drjit": {"optics"}, "torch": set()}
LEARN_MAY_USE = set().union(*LAYERS[:6])
LEARN_DRAWS = ("recordings", "gelsim.generate.darkroom")
"""The one way from the learner to the simulator, taken inside a function: only where a dataset has no pictures."""


def level(module: str) -> int:
    return next(index for index, layer in enumerate(LAYERS) if module in layer)


def part(path: Path) -> str:
    """gelsim/fem/newton.py -> fem; gelsim/scene.py -> scene."""
    inside = path.relative_to(ROOT / "gelsim")
    return inside.parts[0] if len(inside.parts) > 1 else inside.stem


def imports(path: Path) -> list[str]:
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found += [f"gelsim.{alias.name}" for alias in node.names] if node.module == "gelsim" else [node.module or ""]
    return found


GELSIM = sorted((ROOT / "gelsim").rglob("*.py"))
LEARN = sorted((ROOT / "learn").rglob("*.py"))


def violations(here: str, names: list[str]) -> list[str]:
    wrong = []
    for name in names:
        top, _, rest = name.partition(".")
        if top == "learn":
            wrong.append(f"{here} imports learn")
        if top in HOMES and here not in HOMES[top]:
            wrong.append(f"{here} imports {top}, whose home is {' '.join(HOMES[top]) or 'learn'}")
        if top == "gelsim" and rest:
            other = rest.split(".")[0]
            if other != here and level(other) >= level(here) and (here, other) not in HELPERS:
                wrong.append(f"{here} imports {other}, which is not below it")
    return wrong


@pytest.mark.parametrize("path", GELSIM, ids=lambda path: str(path.relative_to(ROOT)))
def test_gelsim_imports_downward(path: Path) -> None:
    assert violations(part(path), imports(path)) == []


def test_learn_imports_only_the_light_layers() -> None:
    for path in LEARN:
        for name in imports(path):
            top, _, rest = name.partition(".")
            assert top not in ("warp", "mitsuba", "drjit", "pytetwild"), path
            allowed = rest.split(".")[0] in LEARN_MAY_USE | {""} or (path.stem, name) == LEARN_DRAWS
            assert top != "gelsim" or allowed, path


def test_learn_loads_the_simulator_only_to_draw() -> None:
    code = "import sys, learn.recordings, learn.cli; print([n for n in sys.modules if n.startswith('gelsim.generate') or n == 'mitsuba'])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert found.stdout.strip() == "[]"


def test_no_drawer_for_odds_and_ends() -> None:
    assert [path for path in GELSIM + LEARN if path.stem in ("utils", "common", "helpers", "misc")] == []


def test_planted_faults_are_found() -> None:
    assert violations("scene", ["gelsim.fem.newton"]) and violations("fem", ["gelsim.optics"]) and violations("shapes", ["warp"])
    assert violations("pipeline", ["learn.data"]) and not violations("cli", ["gelsim.pipeline", "gelsim"])
