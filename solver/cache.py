"""Disk cache of costly arrays (bases, factors, tables), shared between runs.

The files are in the user's cache, in a folder named after the sources that affect them. A file
appears whole or not at all and holds plain numbers. One that cannot be read is made again.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import numpy as np

from .arrays import Array
from .compiled import cache_folder

KEY, DIGEST = "key", "sha256"
# Lock for writing files, one thread at a time.
WRITING = threading.Lock()
PART = ".part"
# A half-written file older than this was abandoned.
PART_S = 3600.0


def cached(key: str, make: Callable[[], Mapping[str, Array]]) -> dict[str, Array]:
    """Arrays by name, as ``make`` returns them, read from disk if an earlier run made them.

    ``key`` describes everything, besides the solver's sources, that they depend on.
    """
    return cached_each([key], lambda _: [make()])[0]


def cached_each(
    keys: Sequence[str], make: Callable[[list[int]], Iterable[Mapping[str, Array]]]
) -> list[dict[str, Array]]:
    """As `cached` for several keys; ``make`` receives the indices of all missing ones."""
    found = [load(key) for key in keys]
    missing = [i for i, each in enumerate(found) if each is None]
    for i, made in zip(missing, make(missing) if missing else (), strict=True):
        arrays = {name: np.asarray(value) for name, value in made.items()}
        store(keys[i], arrays)
        found[i] = arrays
    return [each for each in found if each is not None]


def load(key: str) -> dict[str, Array] | None:
    """The arrays stored under ``key``, or None."""
    with contextlib.suppress(OSError, ValueError):
        arrays = read_arrays(_path(key))
        if str(arrays.pop(KEY, None)) == key:
            return arrays
    return None


def store(key: str, arrays: Mapping[str, Array]) -> None:
    """Store ``arrays``; if the disk is full or write-protected nothing is stored."""
    with contextlib.suppress(OSError):
        _forget_parts(_path(key).parent)
        write_arrays(_path(key), {KEY: np.array(key), **arrays})


def read_arrays(path: Path) -> dict[str, Array]:
    """Arrays written by `write_arrays`; OSError, or ValueError if the file holds anything else."""
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except OSError:
        raise
    except Exception as error:  # zip readers fail in many ways on other files
        raise ValueError(f"{path} is not whole") from error
    if not all(isinstance(array, np.ndarray) for array in arrays.values()):
        raise ValueError(f"{path} holds more than arrays")
    if str(arrays.pop(DIGEST, None)) != _digest(arrays):
        raise ValueError(f"{path} is not what was written")
    return arrays


def _digest(arrays: Mapping[str, Array]) -> str:
    """Digest of names, types, shapes and contents."""
    found = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        found.update(f"{name} {array.dtype.str} {arrays[name].shape}".encode())
        found.update(array.tobytes())
    return found.hexdigest()


def write_arrays(path: Path, arrays: Mapping[str, Array]) -> None:
    """Write arrays with their digest to a temporary file, sync, rename it to ``path``; OSError."""
    arrays = {**arrays, DIGEST: np.array(_digest(arrays))}
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, suffix=PART)
    try:
        with WRITING, os.fdopen(handle, "wb") as part:
            np.savez(part, **cast(dict[str, Any], arrays))
            part.flush()
            os.fsync(part.fileno())
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


@lru_cache(maxsize=8)
def _forget_parts(folder: Path) -> None:
    """Remove, once, half-written files of runs that were killed."""
    for part in folder.glob(f"*{PART}"):
        with contextlib.suppress(OSError):
            if time.time() - part.stat().st_mtime > PART_S:
                part.unlink()


@lru_cache(maxsize=8)
def sources(*paths: Path) -> str:
    """A digest of source files, and of all files in folders, for cache keys."""
    files = [file for path in paths for file in (sorted(path.rglob("*.py")) or [path])]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


def _path(key: str) -> Path:
    name = hashlib.sha256(key.encode()).hexdigest()[:24]
    return cache_folder() / "arrays" / f"{name}.npz"
