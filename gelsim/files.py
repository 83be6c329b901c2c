"""A file is whole or not there: it is written under another name beside its own, and renamed at the end. Whether it is the same. Caches."""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Where to write: what is there at the end becomes `path`; after an error nothing is left, and an older `path` stays as it was.

    Raises:
        OSError: The folder cannot be made, or the file not renamed.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}-{os.getpid()}.partial")
    try:
        yield partial
        os.replace(partial, path)
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)


def cache_folder(kind: str) -> Path:
    """Where files of a kind are kept: in $GELSIM_CACHE, or the user's cache folder; never inside the repository."""
    from platformdirs import user_cache_dir

    return Path(os.environ.get("GELSIM_CACHE") or user_cache_dir("gelsim")) / kind


def digest(path: Path) -> str:
    """SHA-256 of what a file holds, in hex; nothing where it cannot be read: who needs it says so."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return ""
