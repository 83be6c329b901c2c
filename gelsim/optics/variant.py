"""Which Mitsuba variant this machine can run, found out without risk. The only place that selects one.

CUDA if it works, else LLVM, else scalar. Some builds of libLLVM end the whole process instead of raising an error (Debian's 14 and 15 do),
and a GPU's driver may lack OptiX: so each candidate renders a small picture in a child process first. The child's verdict is kept in the
cache folder, under a key that changes with the library, Mitsuba and Dr.Jit. The libLLVM that drew is the one that this process loads,
whichever variant it uses first.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import functools
import glob
import hashlib
import importlib.metadata
import json
import os
import platform
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from gelsim.errors import RenderError
from gelsim.files import cache_folder

TRIAL_SECONDS = 120
"""A child that has not drawn its 16 x 16 pixels by then (a first CUDA start compiles for half a minute) counts as failed."""

TRIAL = """
import sys, mitsuba as mi
mi.set_variant(sys.argv[1])
scene = mi.load_dict({"type": "scene", "integrator": {"type": "path"}, "light": {"type": "constant"}, "ball": {"type": "sphere"},
    "sensor": {"type": "perspective", "to_world": mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
    "film": {"type": "hdrfilm", "width": 16, "height": 16}, "sampler": {"type": "multijitter", "sample_count": 4}}})
import numpy as np
picture = np.array(mi.render(scene))
assert np.isfinite(picture).all() and 0.1 < picture.mean() < 2
print("drawn")
"""


@dataclass(frozen=True)
class VariantChoice:
    """A Mitsuba variant that was seen to work here."""

    name: str
    """For example "llvm_ad_rgb"."""
    reason: str
    """Why this one, for people: what was tried, and how it ended."""
    llvm_path: str | None = None
    """The library that LLVM variants use."""


SCALAR = VariantChoice("scalar_rgb", "needs no library")


def choose_variant(device: str = "auto") -> VariantChoice:
    """The fastest Mitsuba variant that works on this machine.

    Args:
        device: "auto" takes CUDA where it works; "cpu" never; "cuda" insists on it.
    Raises:
        RenderError: CUDA was asked for and does not work, or the device is unknown.
    """
    if device not in ("auto", "cpu", "cuda"):
        raise RenderError(f"device is {device!r}; allowed are 'auto', 'cpu', 'cuda'")
    return _choose(device, os.environ.get("DRJIT_LIBLLVM_PATH"))


def use_variant(choice: VariantChoice) -> ModuleType:
    """Selects the variant for this process and returns the module `mitsuba`: the only door to it, and to Dr.Jit.

    Raises:
        RenderError: The variant wants a library, and Dr.Jit was imported with another one.
    """
    # Dr.Jit loads a libLLVM once, when it is imported, whatever the variant: a later one of this process may be LLVM's.
    if "drjit" not in sys.modules and (library := choice.llvm_path or choose_variant("cpu").llvm_path):
        os.environ["DRJIT_LIBLLVM_PATH"] = library
    import mitsuba

    if choice.llvm_path and not _is_loaded(choice.llvm_path):
        loaded = ", ".join(filter(_is_loaded, llvm_libraries())) or "no libLLVM that is known here"
        raise RenderError(
            f"{choice.llvm_path} was chosen to draw, but Dr.Jit, imported before, has {loaded} loaded already and takes no other: "
            f"set DRJIT_LIBLLVM_PATH={choice.llvm_path}, or render by gelsim before anything imports mitsuba or drjit"
        )
    if mitsuba.variant() != choice.name:
        mitsuba.set_variant(choice.name)
        if "llvm" in choice.name and (threads := os.environ.get("OMP_NUM_THREADS", "")).isdigit():
            import drjit

            drjit.set_thread_count(int(threads))  # Dr.Jit itself takes all cores, whatever the environment says
    return mitsuba


def _is_loaded(library: str) -> bool:
    """Whether this process has the library loaded; Windows cannot be asked."""
    if sys.platform == "win32":
        return True
    try:
        ctypes.CDLL(library, mode=os.RTLD_NOLOAD)
    except OSError:
        return False
    return True


@functools.cache
def _choose(device: str, llvm_setting: str | None) -> VariantChoice:
    failures: list[str] = []
    if device != "cpu":
        if _has_nvidia():
            verdict = _try_variant("cuda_ad_rgb", None)
            if verdict is None:
                return VariantChoice("cuda_ad_rgb", "CUDA and OptiX drew a picture")
            failures.append(f"cuda_ad_rgb: {verdict}")
        elif device == "cuda":
            failures.append("cuda_ad_rgb: no NVIDIA driver found")
        if device == "cuda":
            raise RenderError(f"rendering on CUDA was asked for and is not possible ({failures[0]}); use --device cpu or auto")
    libraries = [llvm_setting] if llvm_setting else llvm_libraries()
    for library in libraries:
        verdict = _try_variant("llvm_ad_rgb", library)
        if verdict is None:
            return VariantChoice("llvm_ad_rgb", "; ".join([f"{library} drew a picture", *failures]), library)
        failures.append(f"{library}: {verdict}")
    if not libraries:
        failures.append("no libLLVM found (apt install libllvm19 makes rendering about three times faster)")
    return VariantChoice(SCALAR.name, "; ".join([*failures, SCALAR.reason]))


def llvm_libraries() -> list[str]:
    """Paths of libLLVM on this machine: first the virtual environment's own, then the system's, each newest first."""
    extension = {"Darwin": ".dylib", "Windows": ".dll"}.get(platform.system(), ".so")
    # A search of all that is below lib takes 0.2 s.
    private = [path for folder in ("lib", "lib/llvm") for path in glob.glob(f"{glob.escape(sys.prefix)}/{folder}/libLLVM*{extension}*")]
    folders = ["/usr/lib/*", "/usr/lib64", "/usr/lib/llvm-*/lib", "/usr/local/lib", "/opt/homebrew/opt/llvm*/lib"]
    system = [path for folder in folders for path in glob.glob(f"{folder}/libLLVM*{extension}*")]
    if not private and not system and (found := ctypes.util.find_library("LLVM")):
        system = [found]
    libraries: dict[str, str] = {}
    for paths in (private, system):
        for path in sorted(paths, key=_llvm_version, reverse=True):
            # Links to the same file are tried once; libLLVM-C and the like are other libraries.
            if re.match(r"libLLVM[-.\d]", Path(path).name):
                libraries.setdefault(os.path.realpath(path), path)
    return list(libraries.values())


def _llvm_version(path: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", Path(os.path.realpath(path)).name))


def _has_nvidia() -> bool:
    if platform.system() == "Windows":
        return ctypes.util.find_library("nvcuda") is not None
    return os.path.exists("/dev/nvidiactl") or os.path.exists("/dev/dxg")


def _try_variant(variant: str, library: str | None) -> str | None:
    """None if the variant draws a picture in a child process, else how it failed; remembered on disk."""
    record = _record_path(variant, library)
    try:
        return json.loads(record.read_text())["failure"]
    except (OSError, ValueError, KeyError):
        pass
    environment = dict(os.environ)
    if library:
        environment["DRJIT_LIBLLVM_PATH"] = library
    try:
        command = [sys.executable, "-c", TRIAL, variant]
        child = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=TRIAL_SECONDS)
    except subprocess.TimeoutExpired:
        return f"drew nothing within {TRIAL_SECONDS} s"
    if child.returncode == 0 and "drawn" in child.stdout:
        failure = None
    elif child.returncode < 0:
        failure = f"ended the process with signal {-child.returncode}"
    else:
        lines = child.stderr.strip().splitlines()
        failure = lines[-1][:200] if lines else f"exit code {child.returncode}"
    try:
        record.parent.mkdir(parents=True, exist_ok=True)
        partial = record.with_suffix(f".{os.getpid()}.partial")
        partial.write_text(json.dumps({"variant": variant, "library": library, "failure": failure}))
        partial.replace(record)
    except OSError:
        pass  # A cache that cannot be written costs a trial each time, nothing else.
    return failure


def _record_path(variant: str, library: str | None) -> Path:
    facts = [variant, library or "", platform.node(), *(importlib.metadata.version(name) for name in ("mitsuba", "drjit"))]
    if library and os.path.exists(library):
        facts += [os.path.realpath(library), str(os.stat(library).st_mtime_ns)]
    return cache_folder("variants") / f"{hashlib.sha256(json.dumps(facts).encode()).hexdigest()[:16]}.json"
