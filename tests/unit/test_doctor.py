"""gelsim doctor: it answers wherever it runs, and says what to do about what is missing."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from gelsim import optics
from gelsim.cli import doctor
from gelsim.errors import RenderError
from gelsim.optics import variant


@pytest.fixture(autouse=True)
def without_llvm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/nonexistent/libLLVM.so")
    monkeypatch.setenv("GELSIM_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(variant, "_has_nvidia", lambda: False)
    variant._choose.cache_clear()


def test_a_machine_without_llvm_and_cuda_renders_with_the_scalar_variant() -> None:
    facts = doctor.examine()
    assert json.loads(json.dumps(facts)) == facts
    assert facts["rendering"]["variant"] == "scalar_rgb" and "/nonexistent" in facts["rendering"]["why"]
    assert any("DRJIT_LIBLLVM_PATH = /nonexistent/libLLVM.so is of no use" in text for text in facts["advice"])
    assert facts["mechanics"]["Warp_devices"].startswith("cpu") and facts["cache"]["writable"]
    text = doctor.describe(facts)
    assert "variant: scalar_rgb" in text and "for more:" in text and "None" not in text


def test_what_is_not_installed_is_named_and_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(device: str) -> None:
        raise RenderError("no Mitsuba here")

    monkeypatch.setattr(optics, "choose_variant", refuse)
    monkeypatch.setattr(doctor, "LIST_WARP_DEVICES", "import no_such_module")
    monkeypatch.setattr(doctor, "PACKAGES", ("numpy", "no-such-package"))
    facts = doctor.examine()
    assert facts["rendering"] == {"variant": None, "why": "no Mitsuba here"}
    assert "no_such_module" in facts["mechanics"]["why"]
    assert any("no-such-package is not installed" in text for text in facts["advice"])
    assert "no-such-package MISSING" in doctor.describe(facts)
