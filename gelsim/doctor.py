"""What this machine can run, found by trying, and what to install for more."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
import sys
from typing import Any

from gelsim.errors import GelsimError
from gelsim.scene_file import preset_names

PACKAGES = (
    "gelsim", "numpy", "scipy", "warp-lang", "mitsuba", "drjit", "pytetwild", "pyvista", "mkl", "trimesh", "manifold3d", "OpenEXR",
    "colour-science", "matplotlib", "imageio-ffmpeg", "torch",
)  # fmt: skip
OPTIONAL = {"torch": "learning: pip install -e .[learn]", "mkl": "a faster linear solver, x86-64 only: pip install mkl"}

LIST_WARP_DEVICES = "import warp; warp.init(); print(', '.join(f'{device.alias}: {device.name}' for device in warp.get_devices()))"


def examine() -> dict[str, Any]:
    """Everything that decides what runs here, as plain values. Takes seconds: variants are tried in child processes."""
    advice: list[str] = []
    packages = {name: _version(name) for name in PACKAGES}
    for name, version in packages.items():
        if version is None and name != "gelsim":
            advice.append(f"{name} is not installed ({OPTIONAL.get(name, 'needed: pip install -c constraints.txt -e .')})")
    rendering, warp, solver = _rendering(advice), _warp(advice), _solver(advice)
    return {
        "python": f"{platform.python_version()} ({sys.executable})",
        "system": f"{platform.platform()}, {os.cpu_count()} cores",
        "packages": packages,
        "rendering": rendering,
        "mechanics": warp,
        "linear_solver": solver,
        "video": _video(advice),
        "presets": preset_names(),
        "cache": _cache(),
        "advice": advice,
    }


def describe(facts: dict[str, Any]) -> str:
    """The facts as lines for people."""
    lines = []
    for key, value in facts.items():
        if key == "advice":
            continue
        if key == "packages":
            value = ", ".join(f"{name} {version or 'MISSING'}" for name, version in value.items())
        elif isinstance(value, dict):
            value = "; ".join(f"{name.replace('_', ' ')}: {item}" for name, item in value.items())
        elif isinstance(value, list):
            value = ", ".join(value)
        lines.append(f"{key.replace('_', ' '):<14} {value}")
    lines += [f"for more:      {text}" for text in facts["advice"]] or ["nothing to add: everything that gelsim can use is here"]
    return "\n".join(lines)


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def _rendering(advice: list[str]) -> dict[str, Any]:
    from gelsim import optics
    from gelsim.optics.variant import llvm_libraries

    facts: dict[str, Any] = {"libLLVM_found": llvm_libraries()}
    try:
        choice = optics.choose_variant("auto")
        facts |= {"variant": choice.name, "reason": choice.reason, "libLLVM_used": choice.llvm_path}
        cpu = optics.choose_variant("cpu")
        facts["on_cpu"] = cpu.name
    except (GelsimError, ImportError) as error:
        return facts | {"variant": None, "reason": str(error)}
    try:
        optics.choose_variant("cuda")
        facts["cuda_and_optix"] = "work"
    except GelsimError as error:
        facts["cuda_and_optix"] = str(error)
    if cpu.name.startswith("scalar"):
        advice.append(
            "rendering on the CPU is about three times faster with LLVM 16 or later: apt install libllvm19 (or brew install llvm), "
            "or name the library in DRJIT_LIBLLVM_PATH"
        )
    return facts


def _warp(advice: list[str]) -> dict[str, Any]:
    # In a child process: a driver that ends the process must not end the doctor.
    child = subprocess.run([sys.executable, "-c", LIST_WARP_DEVICES], capture_output=True, text=True)
    if child.returncode:
        lines = child.stderr.strip().splitlines()
        return {"devices": "none", "reason": lines[-1] if lines else f"Warp ended with exit code {child.returncode}"}
    devices = child.stdout.strip().splitlines()[-1]
    if "cuda" not in devices:
        advice.append("the mechanics run on the CPU; with an NVIDIA GPU and its driver --device cuda would work")
    return {"Warp_devices": devices}


def _solver(advice: list[str]) -> str:
    from gelsim.fem.linear import make_solver

    name = make_solver().name
    if "PARDISO" not in name:
        advice.append("the linear solver is several times faster with Intel MKL (x86-64): pip install mkl")
    return name


def _video(advice: list[str]) -> str:
    try:
        import imageio_ffmpeg

        return f"ffmpeg {imageio_ffmpeg.get_ffmpeg_version()}"
    except (ImportError, RuntimeError) as error:
        advice.append(f"no ffmpeg ({error}): video.mp4 cannot be written")
        return "none"


def _cache() -> dict[str, Any]:
    from gelsim.meshing import cache_folder

    folder = cache_folder()
    nearest = next(path for path in (folder, *folder.parents) if path.exists())
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) if folder.exists() else 0
    return {"folder": str(folder), "writable": os.access(nearest, os.W_OK), "megabytes": round(size / 1e6, 1)}
