"""The structure of the code as its imports have it: rooms, arrows between them, circles of files. Read from the syntax trees.

    python tests/meta/structure.py [FOLDER]                                 the counts, and every circle
    python tests/meta/structure.py --svg docs/images/architecture.svg       the picture of docs/index.md; make docs draws it too

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


def between_rooms(graph: dict[str, set[str]]) -> set[tuple[str, str]]:
    """The arrows between rooms."""
    pairs = {(room(name), room(other)) for name, others in graph.items() for other in others}
    return {(one, other) for one, other in pairs if one != other}


def picture(root: Path = ROOT) -> str:
    """SVG of the rooms, each a row above the highest that it imports, without the entrances and without lines that longer ways imply."""
    graph = arrows(root) | {module_of(path, root): set(imports(path)) for path in (root / "learn").glob("*.py")}
    learner = {(one, other) for one, others in graph.items() for other in others if one.startswith("learn") and other.startswith("gelsim.")}
    inner = between_rooms({name: others for name, others in graph.items() if name.startswith("gelsim")})
    below: dict[str, set[str]] = {}
    for one, other in inner | {("learn", room(other)) for _, other in learner}:
        if not {one, other} & {"__init__", "__main__"}:
            below.setdefault(one, set()).add(other)
            below.setdefault(other, set())
    reach: dict[str, set[str]] = {}
    row: dict[str, int] = {}
    for name in TopologicalSorter(below).static_order():
        reach[name] = below[name].union(*(reach[other] for other in below[name]))
        row[name] = max((row[other] + 1 for other in below[name]), default=0)
    rows = [sorted(name for name in row if row[name] == number) for number in range(max(row.values()) + 1)]
    wide, high, gap, rim = 110, 30, 34, 16
    width, height = max(len(names) for names in rows) * (wide + rim) + rim, len(rows) * (high + gap) + rim
    place: dict[str, tuple[float, int]] = {}
    for number, names in enumerate(rows):
        # above the middle of what it uses, so that lines are short
        names.sort(key=lambda name: (sum(place[other][0] for other in below[name]) / max(len(below[name]), 1), name))
        top = height - rim - high - number * (high + gap)
        place |= {name: (width / len(names) * (at + 0.5), top) for at, name in enumerate(names)}
    lines, boxes, words = [], [], []
    for name, (x, y) in place.items():
        boxes.append(f'<rect x="{x - wide / 2:.0f}" y="{y}" width="{wide}" height="{high}" rx="4"/>')
        words.append(f'<text x="{x:.0f}" y="{y + 20}">{name}</text>')
        for other in sorted(below[name]):
            if not any(other in reach[third] for third in below[name]):
                to_x, to_y = place[other]
                bend = (y + high + to_y) / 2
                lines.append(f'<path d="M{x:.0f} {y + high} C{x:.0f} {bend:.0f} {to_x:.0f} {bend:.0f} {to_x:.0f} {to_y}"/>')
    return "\n".join([
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="14">',
        f'<rect width="{width}" height="{height}" fill="white"/>',
        '<g fill="none" stroke="#999">', *lines, "</g>",
        '<g fill="#eef3fa" stroke="#345">', *boxes, "</g>",
        '<g fill="#123" text-anchor="middle">', *words, "</g></svg>\n",
    ])  # fmt: skip


def main(root: Path) -> None:
    """Prints the counts."""
    graph = arrows(root)
    rooms = {room(name) for name in graph if name != "gelsim"}
    between = between_rooms(graph)
    round_and_round = circles(graph)
    print(f"{len(rooms)} rooms, {len(between)} arrows between them, {len(round_and_round)} circles of files")
    print(f"{len(list((root / 'gelsim').glob('*.py')))} files at the top of gelsim/, {len(graph)} in all")
    for circle in round_and_round:
        print("circle:", *sorted(circle))
    if not round_and_round:
        steps = list(TopologicalSorter({one: {b for a, b in between if a == one} for one in rooms}).static_order())
        print("from the ground up:", *steps)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--svg"]:
        Path(sys.argv[2]).write_text(picture(), encoding="utf-8")
    else:
        main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT)
