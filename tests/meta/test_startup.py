"""Importing gelsim and asking for help cost nothing."""

from __future__ import annotations

import resource
import subprocess
import sys

import pytest

HEAVY = ("warp", "mitsuba", "drjit", "pytetwild", "torch", "numpy", "scipy", "matplotlib", "trimesh")


def test_import_loads_nothing_heavy() -> None:
    code = "import sys, gelsim; gelsim.load_scene, gelsim.Scene; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert [name for name in HEAVY if name in loaded] == []


def test_public_names_exist() -> None:
    import gelsim

    assert all(getattr(gelsim, name) is not None for name in gelsim.__all__)
    with pytest.raises(AttributeError):
        _ = gelsim.nonsense  # type: ignore[attr-defined]


@pytest.mark.parametrize("arguments", [["--help"], ["render", "--help"]])
def test_help_is_instant(arguments: list[str]) -> None:
    times = []
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run([sys.executable, "-m", "gelsim", *arguments], capture_output=True, text=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        times.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
        assert done.returncode == 0 and "--shape" in done.stdout
    # The promise of the command line: under half a second. Of the processor: where something else has it, the command only waits.
    assert min(times) < 0.5
