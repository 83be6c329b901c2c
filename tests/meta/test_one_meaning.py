"""A constant that travels between modules has one value: MM = 1e-3 here and 1e3 there is a factor of a million, one wrong import away.

A name that only its own module uses is its room's word (STATES, REACH): those may be told apart by where they stand.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping

from structure import ROOT, module_of


def numbers(tree: ast.Module) -> dict[str, float]:
    """Upper-case names that a module gives a number as it stands, be it inside a conversion such as wp.constant(0.1)."""
    found = {}
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        value = node.value if isinstance(node, (ast.Assign, ast.AnnAssign)) else None
        while isinstance(value, ast.Call) and len(value.args) == 1:
            value = value.args[0]
        try:
            number = ast.literal_eval(value) if value is not None else None
        except ValueError:
            continue
        if isinstance(number, (int, float)):
            found |= {target.id: float(number) for target in targets if isinstance(target, ast.Name) and target.id.isupper()}
    return found


def ambiguous(texts: Mapping[str, str]) -> dict[str, dict[str, float]]:
    """Names that some module imports and that two modules give different numbers: name -> module -> number."""
    trees = {module: ast.parse(text) for module, text in texts.items()}
    taken = {alias.name for tree in trees.values() for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) for alias in node.names}
    said: dict[str, dict[str, float]] = {}
    for module, tree in trees.items():
        for name, number in numbers(tree).items():
            said.setdefault(name, {})[module] = number
    return {name: by_module for name, by_module in said.items() if name in taken and len(set(by_module.values())) > 1}


def test_a_constant_that_is_imported_has_one_value() -> None:
    assert ambiguous({module_of(path): path.read_text() for path in sorted((ROOT / "gelsim").rglob("*.py"))}) == {}


def test_planted_fault_is_found() -> None:
    user = "from units import MM\n"
    assert ambiguous({"units": "MM = 1e-3", "light": "MM: float = wp.constant(1e3)", "user": user}) == {"MM": {"units": 1e-3, "light": 1e3}}
    assert ambiguous({"units": "MM = 1e-3", "light": "MM = 0.001", "user": user}) == {}
    assert ambiguous({"one": "STATES = 8", "other": "STATES = 9", "user": user}) == {}  # no one imports it
