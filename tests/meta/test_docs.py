"""What a build of the site (`make docs`) does not see: names that an API page asks for in vain, and links of the README."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

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
    assert list(missing_names("::: gelsim.pipeline\n    options:\n      members: [press, presss]")) == ["gelsim.pipeline.presss"]


def test_the_readme_points_at_what_there_is() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    told = re.findall(r"\]\(([^)#:]+)\)", text) + re.findall(r"`(docs/[\w./]+)`", text)
    assert len(told) > 10 and [target for target in told if not (ROOT / target).exists()] == []
