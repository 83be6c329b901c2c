"""What a build of the site (`make docs`) does not see: members of an API page and parameters of a docstring that are not, README links."""

from __future__ import annotations

import ast
import re
import runpy
from collections.abc import Iterator
from pathlib import Path

import pytest

import gelsim
from gelsim import console
from gelsim.scene import definition
from gelsim.study import STUDIES

ROOT = Path(__file__).parents[2]


def missing_names(page: str) -> Iterator[str]:
    """Members of an API page that their module does not define: mkdocstrings leaves them out without a word."""
    for module, members in re.findall(r"^::: ([\w.]+)\n {4}options:\n {6}members: \[(.*)\]$", page, re.MULTILINE):
        path = ROOT / module.replace(".", "/")
        tree = ast.parse((path / "__init__.py" if path.is_dir() else path.with_suffix(".py")).read_text(encoding="utf-8"))
        defined = {node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
        defined |= {node.target.id for node in tree.body if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)}
        yield from (f"{module}.{name}" for name in members.split(", ") if name not in defined)


def test_api_pages_name_what_there_is() -> None:
    pages = {path.name: path.read_text(encoding="utf-8") for path in sorted((ROOT / "docs" / "api").glob("*.md"))}
    # Each list of members is of the form that is checked.
    assert sum(page.count("members:") for page in pages.values()) == sum(
        len(re.findall(r"^ {6}members: \[.*\]$", page, re.MULTILINE)) for page in pages.values()
    )
    assert {name: list(missing_names(page)) for name, page in pages.items() if list(missing_names(page))} == {}
    assert list(missing_names("::: gelsim.pipeline.stages\n    options:\n      members: [press, presss]")) == [
        "gelsim.pipeline.stages.presss"
    ]


def unknown_parameters(source: str) -> Iterator[str]:
    """Names in the Args of docstrings that their function does not take; "a, b: ..." speaks of two."""
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.FunctionDef | ast.ClassDef) or "Args:\n" not in (text := ast.get_docstring(node) or ""):
            continue
        made = next((part for part in node.body if isinstance(part, ast.FunctionDef) and part.name == "__init__"), None)
        function = node if isinstance(node, ast.FunctionDef) else made
        if function is None:  # a dataclass: its fields are its parameters
            taken = {part.target.id for part in node.body if isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name)}
        else:
            given = function.args
            taken = {part.arg for part in (*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg) if part}
        section = re.split(r"^\S", text.split("Args:\n", 1)[1], maxsplit=1, flags=re.MULTILINE)[0]
        told = re.findall(r"^ {4}\*{0,2}(\w+(?:, \w+)*): ", section, re.MULTILINE)
        yield from (f"{node.name}: {name}" for line in told for name in line.split(", ") if name not in taken)


def test_documented_parameters_exist() -> None:
    paths = sorted(path for package in ("gelsim", "learn") for path in (ROOT / package).rglob("*.py"))
    found = {path.name: list(unknown_parameters(path.read_text(encoding="utf-8"))) for path in paths}
    assert {name: wrong for name, wrong in found.items() if wrong} == {}
    text = "Does.\n\n    Args:\n        a, c: Both.\n            more: words\n        b: It.\n    Returns:\n        d: e\n    "
    faulty = f'def f(a, *, b):\n    """{text}"""\n'
    assert list(unknown_parameters(faulty)) == ["f: c"]


def test_every_study_has_its_section_and_its_quick_form_is_run() -> None:
    sections = (ROOT / "docs" / "studies.md").read_text(encoding="utf-8").split("\n## ")
    tests = (ROOT / "tests" / "analytic" / "test_studies.py").read_text(encoding="utf-8")
    for name in STUDIES:
        (section,) = (text for text in sections if text.startswith(f"{name}\n"))
        assert f"![{name}](images/study_{name}.png)" in section
        assert re.search(rf"^    gelsim study {name}( --workers \d+)?$", section, re.MULTILINE)
        assert re.search(r"^\d+ cases, \d+ s in all, 2 cores", section, re.MULTILINE)
        assert f'rows("{name}", tmp_path)' in tests, f"{name} --quick is not run"


REPORTED = {"contact.slip", "energy.stored_j"}
"""Of a report.json, not of the code."""


def names_in_code() -> dict[str, set[str]]:
    """What modules and classes define, by the module's or the class's own name; and the fields of a scene by section."""
    found = {section: set(fields) for section, fields in console.field_docs(definition).items()}
    found |= {name.lower(): fields for name, fields in found.items()}
    for path in (path for package in ("gelsim", "learn") for path in (ROOT / package).rglob("*.py")):
        found.setdefault(path.parent.name, set()).add(path.stem)
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for home, node in [(path.stem, tree), *((part.name, part) for part in tree.body if isinstance(part, ast.ClassDef))]:
            names = found.setdefault(home, set())
            for part in node.body:
                names |= {part.name} if isinstance(part, ast.FunctionDef | ast.ClassDef) else set()
                names |= {name.id for name in ast.walk(part) if isinstance(name, ast.Name) and isinstance(name.ctx, ast.Store)}
            found[path.stem] |= names  # an object is often called as its module: trial.frames
    return found | {"gelsim": {*gelsim.__all__, "NAME"}}


def unknown_names(page: str, known: dict[str, set[str]]) -> list[str]:
    """`module.function`, `Class.method`, `section.field` of a page that are not there; of other names nothing is said."""
    told = re.findall(r"`(?:[a-z_]+\.)*(\w+)\.(\w+)`", page)
    files = {"py", "md", "json", "toml", "csv", "png", "npz", "html", "jsonl", "npy", "txt", "stl", "cff"}
    return [
        f"{home}.{name}" for home, name in told if home in known and name not in known[home] | files and f"{home}.{name}" not in REPORTED
    ]


def test_what_pages_name_of_the_code_is_there() -> None:
    known = names_in_code()
    pages = {path.name: path.read_text(encoding="utf-8") for path in sorted((ROOT / "docs").rglob("*.md"))}
    assert {name: unknown_names(page, known) for name, page in pages.items() if unknown_names(page, known)} == {}
    assert sum(len(re.findall(r"`\w+\.\w+`", page)) for page in pages.values()) > 100
    assert unknown_names("`strategy.tries`, `Newton.solve`, `strategy.weighs`, `camera.rust`", known) == ["strategy.weighs", "camera.rust"]


def test_the_readme_points_at_what_there_is() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    told = re.findall(r"\]\(([^)#:]+)\)", text) + re.findall(r"`(docs/[\w./]+)`", text)
    assert len(told) > 4 and [target for target in told if not (ROOT / target).exists()] == []


def test_a_figure_without_its_command_is_warned_of() -> None:
    """The hook of `make docs`, whose warnings are errors; latex2mathml, which it sets equations with, is of the extra `docs`."""
    pytest.importorskip("latex2mathml")
    found = runpy.run_path(str(ROOT / "docs" / "hooks.py"))["without_command"]
    table, command = "| case | error |\n|---|---|\n| ball | 1.2 % |", "    gelsim bench --only accuracy"
    assert list(found(f"{command}\n\nSo far it is off.\n\n{table}")) == []
    assert list(found(f"{command}\n\nOne.\n\nTwo.\n\n{table}")) == ["| case | error |"]
    assert list(found("![a plot](images/plot.png)\n\nNothing.")) == ["![a plot](images/plot.png)"]
    assert list(found("| field | what |\n|---|---|\n| a | words |")) == []
    assert list(found((ROOT / "README.md").read_text(encoding="utf-8"))) == []
