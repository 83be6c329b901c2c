"""For mkdocs: equations are set, and a figure without its command is warned of.

A fenced block `math` holds LaTeX and becomes MathML, which browsers draw without a script. A picture, or a table of which half of the cells
begin with a number, wants a command in it or in the two lines, blank ones not counted, before or after it; or the words "by hand" (none is
kept) or "by definition" (nothing was measured).
"""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from types import SimpleNamespace

from latex2mathml.converter import convert

COMMAND = re.compile(
    r"(`|^    |^)(time )?(gelsim(-learn)? \w|python |make \w|docs/studies/|tests/)|pytest |`--\w|[bB]y hand|[bB]y definition", re.MULTILINE
)
CELL = re.compile(r"\*{0,2}[<±+−-]?\d")
NEAR = 2


def on_page_markdown(markdown: str, page: SimpleNamespace, **_: object) -> str:
    """Called by mkdocs with each page's text."""
    for line in without_command(markdown):
        logging.getLogger("mkdocs").warning("%s: no command within two lines of %r", page.file.src_uri, line)
    return re.sub(r"^```math\n(.*?)\n```$", lambda found: convert(found[1], display="block"), markdown, flags=re.DOTALL | re.MULTILINE)


def without_command(markdown: str) -> Iterator[str]:
    """First lines of pictures and tables of numbers that no command stands beside."""
    lines = [line for line in markdown.split("\n") if line.strip()]
    kind = ["table" if line.startswith("|") else "picture" if line.startswith("![") else "" for line in lines]
    at = 0
    while at < len(lines):
        end = at + 1
        while end < len(lines) and kind[end] == kind[at]:
            end += 1
        if kind[at] == "picture" or (kind[at] == "table" and _counts(lines[at + 2 : end])):
            around = lines[max(at - NEAR, 0) : end + NEAR]
            if not COMMAND.search("\n".join(around)):
                yield lines[at]
        at = end


def _counts(rows: list[str]) -> bool:
    cells = [cell.strip() for row in rows for cell in row.strip("|").split("|")[1:]]
    return sum(bool(CELL.match(cell)) for cell in cells) * 2 > len(cells)
