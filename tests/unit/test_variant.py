"""The choice of a Mitsuba variant, and that LLVM is the one that was seen to draw, in whatever order variants come."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from gelsim.errors import RenderError
from gelsim.optics import VariantChoice, choose_variant, variant

DRAW = """
import contextlib, sys
from gelsim.membrane.surface import rest_membrane
from gelsim.optics import choose_variant
from gelsim.optics.arrays import choose_arrays
from gelsim.optics.render import Renderer
from gelsim.optics.variant import VariantChoice, use_variant
from gelsim.scene.definition import Gel, Light, Lights, Render, Scene

cpu = choose_variant("cpu")
if sys.argv[1] == "arrays":
    choose_arrays(cpu)
else:
    with contextlib.suppress(ImportError):  # no CUDA here; Dr.Jit is imported all the same
        use_variant(VariantChoice(sys.argv[1], "first"))
light = Light("lamp", (20.0, 0.0, -10.0), (-20.0, 0.0, 10.0), (10.0, 2.0))
scene = Scene(gel=Gel(profile="flat"), lights=Lights((light,)), render=Render("direct", 4, (16, 16)))
assert Renderer(scene, cpu).radiance(rest_membrane(scene)).mean() > 0
print(cpu.name, "drew")
"""

LATE = """
import os, drjit
del os.environ["DRJIT_LIBLLVM_PATH"]
from gelsim.errors import RenderError
from gelsim.optics.variant import choose_variant, use_variant
try:
    use_variant(choose_variant("cpu"))
except RenderError as error:
    print(error)
"""


def child(code: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Without what this process may have named already."""
    unnamed = {name: value for name, value in os.environ.items() if name != "DRJIT_LIBLLVM_PATH"}
    return subprocess.run([sys.executable, "-c", code, *arguments], env={**unnamed, **environment}, capture_output=True, text=True)


def test_variant_of_this_machine_is_named_with_its_reason():
    choice = choose_variant("cpu")
    assert choice.name in ("llvm_ad_rgb", "scalar_rgb") and choice.reason
    with pytest.raises(RenderError, match="device"):
        choose_variant("tpu")


def test_broken_llvm_is_found_out_in_a_child(tmp_path, monkeypatch):
    """A library that cannot be loaded costs a child process, not this one; the verdict is remembered."""
    monkeypatch.setenv("GELSIM_CACHE", str(tmp_path / "cache"))
    fake = tmp_path / "libLLVM.so"
    fake.write_bytes(b"not a library")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(fake))
    choice = choose_variant("cpu")
    assert choice.name == "scalar_rgb" and str(fake) in choice.reason
    assert len(list((tmp_path / "cache").rglob("*.json"))) == 1
    monkeypatch.setattr(variant.subprocess, "run", lambda *args, **options: pytest.fail("tried again"))
    variant._choose.cache_clear()
    assert choose_variant("cpu") == choice
    assert isinstance(choice, VariantChoice)
    variant._choose.cache_clear()


@pytest.mark.parametrize("first", ["scalar_rgb", "cuda_ad_rgb", "arrays"])
def test_llvm_draws_whatever_the_process_used_first(first):
    """Where the system has LLVM 14 or 15 and nothing newer, Dr.Jit by itself loads that one, and drawing would end the process."""
    done = child(DRAW, first)
    assert done.returncode == 0 and "drew" in done.stdout, done.stderr


def test_another_library_loaded_before_is_said_in_words():
    """A process that imports Dr.Jit by itself: with another library of this machine, with none, and with the right one."""
    wanted = variant._choose("cpu", None).llvm_path
    if wanted is None:
        pytest.skip("this machine has no working LLVM")
    others = {path: path for path in variant.llvm_libraries() if path != wanted}
    for other, said in [*others.items()][:1] + [("/nonexistent", "no libLLVM")]:
        done = child(LATE, DRJIT_LIBLLVM_PATH=other)
        assert done.returncode == 0 and f"{wanted} was chosen to draw" in done.stdout and f"has {said}" in done.stdout, done.stderr
    assert child(LATE, DRJIT_LIBLLVM_PATH=wanted).stdout == ""
