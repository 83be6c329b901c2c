"""What this machine can run, found by trying, and what to install for more."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from typing import Any

from gelsim.errors import GelsimError
from gelsim.pipeline.stages import versions
from gelsim.scene.layers import preset_names

PACKAGES = (
    "gelsim", "numpy", "scipy", "warp-lang", "mitsuba", "drjit", "pytetwild", "mkl", "trimesh", "manifold3d", "OpenEXR",
    "colour-science", "matplotlib", "imageio-ffmpeg", "torch",
)  # fmt: skip
OPTIONAL = {"torch": "only learning needs it: pip install -e .[learn]"}

LIST_WARP_DEVICES = "import warp; warp.init(); print(', '.join(f'{device.alias}: {device.name}' for device in warp.get_devices()))"


def examine() -> dict[str, Any]:
    """Everything that decides what runs here, as plain values. Takes seconds: variants are tried in child processes."""
    advice: list[str] = []
    packages = versions(PACKAGES)
    for name, version in packages.items():
        if version is None and name not in ("gelsim", "mkl"):
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
        if isinstance(value, dict):
            items = [f"{name.replace('_', ' ')}: {_words(item)}" for name, item in value.items()]
            lines += [f"{key.replace('_', ' ') if item is items[0] else '':<14} {item}" for item in items]
        else:
            lines.append(f"{key.replace('_', ' '):<14} {_words(value)}")
    lines += [f"for more:      {text}" for text in facts["advice"]] or ["nothing to add: everything that gelsim can use is here"]
    return "\n".join(lines)


def _words(value: object) -> str:
    if value is None or value == []:
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def _rendering(advice: list[str]) -> dict[str, Any]:
    from gelsim import optics
    from gelsim.optics.variant import llvm_libraries

    facts: dict[str, Any] = {}
    try:
        choice, cpu = optics.choose_variant("auto"), optics.choose_variant("cpu")
        facts |= {"variant": choice.name, "why": choice.reason, "on_the_CPU": cpu.name}
    except (GelsimError, ImportError) as error:
        return {"variant": None, "why": str(error)}
    try:
        optics.choose_variant("cuda")
        facts["CUDA"] = "works"
    except GelsimError as error:
        facts["CUDA"] = str(error)
    facts["libLLVM_on_this_machine"] = llvm_libraries()
    if cpu.name.startswith("scalar"):
        setting = os.environ.get("DRJIT_LIBLLVM_PATH")
        advice.append(
            "rendering on the CPU is about three times faster with LLVM 16 or later: "
            + (
                f"DRJIT_LIBLLVM_PATH = {setting} is of no use, unset it or let it name such a library"
                if setting
                else "apt install libllvm19 (macOS: brew install llvm), or name the library in DRJIT_LIBLLVM_PATH"
            )
        )
    return facts


def _warp(advice: list[str]) -> dict[str, Any]:
    # In a child process: a driver that ends the process must not end the doctor.
    child = subprocess.run([sys.executable, "-c", LIST_WARP_DEVICES], capture_output=True, text=True)
    if child.returncode:
        lines = child.stderr.strip().splitlines()
        return {"Warp_devices": None, "why": lines[-1] if lines else f"Warp ended with exit code {child.returncode}"}
    devices = child.stdout.strip().splitlines()[-1]
    if "cuda" not in devices:
        advice.append("no NVIDIA GPU with its driver: --device cuda is not possible here")
        return {"Warp_devices": devices}
    from gelsim.fem.cudss import find_cudss

    library = find_cudss()
    if library is None:
        advice.append(
            "batches of presses on the GPU want cuDSS: pip install -e .[cuda] (with a CUDA 12 driver: pip install nvidia-cudss-cu12)"
        )
    return {"Warp_devices": devices, "cuDSS": library or "not found"}


def _solver(advice: list[str]) -> str:
    from gelsim.fem.linear import make_solver

    name = make_solver().name
    if "PARDISO" not in name and platform.machine().lower() in ("x86_64", "amd64"):
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
    from gelsim.files import cache_folder

    folder = cache_folder("meshes")
    nearest = next(path for path in (folder, *folder.parents) if path.exists())
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) if folder.exists() else 0
    return {"folder": str(folder), "writable": os.access(nearest, os.W_OK), "megabytes": round(size / 1e6, 1)}
