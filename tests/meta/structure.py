"""The structure of the code as its imports have it: rooms, arrows between them, circles of files. Read from the syntax trees.

    python tests/meta/structure.py [FOLDER]      the counts, and every circle

A room is a package of `gelsim/` or a file at its top; an arrow is a pair of rooms of which the first imports the second; a circle is a
set of files that import each other, at the top of a file or inside a function. What only types need (`if TYPE_CHECKING:`) counts too.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterable
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[2]


def room(module: str) -> str:
    """gelsim.fem.newton -> fem; gelsim.errors -> errors; gelsim itself -> __init__."""
    return (module.split(".") + ["__init__"])[1]


def module_of(path: Path, root: Path = ROOT) -> str:
    """gelsim/fem/newton.py -> gelsim.fem.newton; gelsim/fem/__init__.py -> gelsim.fem."""
    return ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__")


def imports(path: Path, modules: Iterable[str] = ()) -> list[str]:
    """What a file imports. A name taken from a package is a module where `modules` has it: `from gelsim.fem import contact`."""
    found, known = [], set(modules)
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0 and node.module, f"{path}: relative import"
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                found.append(inner if inner in known or node.module == "gelsim" else node.module)
    return list(dict.fromkeys(found))


def arrows(root: Path = ROOT) -> dict[str, set[str]]:
    """Each module of gelsim with those of gelsim that it imports."""
    files = {module_of(path, root): path for path in sorted((root / "gelsim").rglob("*.py"))}
    return {name: {other for other in imports(path, files) if other in files and other != name} for name, path in files.items()}


def circles(graph: dict[str, set[str]]) -> list[set[str]]:
    """The sets of modules that reach each other."""

    def reached(start: str) -> set[str]:
        seen, left = set(), [start]
        while left:
            fresh = graph[left.pop()] - seen
            seen |= fresh
            left += fresh
        return seen

    reach = {name: reached(name) for name in graph}
    found = [frozenset(other for other in reach[name] if name in reach[other]) for name in graph if name in reach[name]]
    return [set(circle) for circle in dict.fromkeys(found)]


def main(root: Path) -> None:
    """Prints the counts."""
    graph = arrows(root)
    rooms = {room(name) for name in graph if name != "gelsim"}
    between = {(room(name), room(other)) for name, others in graph.items() for other in others} - {(one, one) for one in rooms}
    round_and_round = circles(graph)
    print(f"{len(rooms)} rooms, {len(between)} arrows between them, {len(round_and_round)} circles of files")
    print(f"{len(list((root / 'gelsim').glob('*.py')))} files at the top of gelsim/, {len(graph)} in all")
    for circle in round_and_round:
        print("circle:", *sorted(circle))
    if not round_and_round:
        steps = list(TopologicalSorter({one: {b for a, b in between if a == one} for one in rooms}).static_order())
        print("from the ground up:", *steps)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT)
