"""Equations of the pages, for mkdocs: a fenced block `math` holds LaTeX and is set as MathML, which browsers draw without a script."""

from __future__ import annotations

import re

from latex2mathml.converter import convert


def on_page_markdown(markdown: str, **_: object) -> str:
    """Called by mkdocs with each page's text."""
    return re.sub(r"^```math\n(.*?)\n```$", lambda found: convert(found[1], display="block"), markdown, flags=re.DOTALL | re.MULTILINE)
