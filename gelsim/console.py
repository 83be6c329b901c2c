"""What the two command lines share: one-line errors that name the nearest flag, bars for long work, and fields' documentation as help."""

from __future__ import annotations

import argparse
import ast
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn

from gelsim.errors import GelsimError, SceneError
from gelsim.scene.fields import nearest

TOLD_EVERY = 60.0
"""Seconds between the lines that say how far long work is where no terminal shows a bar."""
BAR = "{desc:<22} {bar:30} {n_fmt}/{total_fmt} {elapsed}<{remaining} {rate_inv_fmt}"


class Parser(argparse.ArgumentParser):
    """argparse with one-line errors that name the nearest flag; commands set their own parser as the default `parser`."""

    wrong: type[GelsimError] = SceneError
    """What is raised."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**({"allow_abbrev": False, "formatter_class": argparse.RawDescriptionHelpFormatter} | options))

    def error(self, message: str) -> NoReturn:
        raise self.wrong(message.replace("argument ", "flag ", 1) if message.startswith("argument ") else message)

    def parse_all(self, arguments: list[str]) -> argparse.Namespace:
        """Parse, and refuse what is left over.

        Raises:
            GelsimError: (of kind `wrong`) An unknown flag, or a flag without its value.
        """
        options, rest = self.parse_known_args(arguments)
        if rest:
            known = [flag for action in options.parser._actions for flag in action.option_strings]
            name = rest[0].split("=")[0]
            if not name.startswith("-"):
                scene = f"; did you mean --scene {name}?" if "--scene" in known else ""
                raise self.wrong(f"{name!r} belongs to no flag{scene}")
            raise self.wrong(f"unknown flag {name!r}{nearest(name, known)}")
        return options


class ShowVersion(argparse.Action):
    """A flag that prints which gelsim is installed; looked up only then, as that takes a tenth of what help may."""

    def __init__(self, option_strings: list[str], dest: str) -> None:
        super().__init__(option_strings, argparse.SUPPRESS, nargs=0, help="print the version")

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        import importlib.metadata

        print(f"{parser.prog} {importlib.metadata.version('gelsim')}")
        parser.exit()


def field_docs(module: ModuleType) -> dict[str, dict[str, str]]:
    """Class name -> field -> the string under it, read from the module's source: Python keeps no docstrings of fields."""
    assert module.__file__
    docs: dict[str, dict[str, str]] = {}
    for node in ast.parse(Path(module.__file__).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ClassDef):
            docs[node.name] = {
                field.target.id: " ".join(text.value.value.split())
                for field, text in zip(node.body, node.body[1:], strict=False)
                if isinstance(field, ast.AnnAssign)
                and isinstance(field.target, ast.Name)
                and isinstance(text, ast.Expr)
                and isinstance(text.value, ast.Constant)
                and isinstance(text.value.value, str)
            }
    return docs


def _lines() -> Callable[[str, int, int], None]:
    """Says how far a stage is, at most every TOLD_EVERY seconds: a log of a short run stays empty."""
    told = time.monotonic()
    begun: dict[str, tuple[int, float]] = {}

    def say(stage: str, done: int, total: int) -> None:
        nonlocal told
        now = time.monotonic()
        first, since = begun.setdefault(stage, (done, now))  # what a run before made says nothing of the rate
        if now - told >= TOLD_EVERY:
            told = now
            rate = f", {(now - since) / (done - first):.2g} s each" if done > first else ""
            print(f"{stage}: {done} of {total}{rate}", file=sys.stderr, flush=True)

    return say


@contextmanager
def progress_bars() -> Iterator[Callable[[str, int, int], None] | None]:
    """A bar on stderr for each stage; a line a minute where that is a file, and nothing where only stdout is one."""
    if not sys.stderr.isatty():
        yield _lines()
        return
    if not sys.stdout.isatty():
        yield None
        return
    from tqdm import tqdm

    bars: dict[str, tqdm] = {}

    def show(stage: str, done: int, total: int) -> None:
        if stage not in bars:
            for bar in bars.values():
                bar.close()
            # What is there at the first call a run before made: the rate is of this one.
            bars[stage] = tqdm(total=total, desc=stage, initial=done, file=sys.stderr, bar_format=BAR)
        bars[stage].n = done
        bars[stage].refresh()

    try:
        yield show
    finally:
        for bar in bars.values():
            bar.close()
