"""Cache of costly arrays (bases, factors, tables) that one run makes and later runs use.

They lie under the user's cache, in a folder named after the sources that could change them. A file
appears whole or not at all, holds plain numbers, and one that cannot be read is made again.
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
# Held while a file is written, by one thread at a time.
WRITING = threading.Lock()
PART = ".part"
# No file takes so long to write.
PART_S = 3600.0


def cached(key: str, make: Callable[[], Mapping[str, Array]]) -> dict[str, Array]:
    """Arrays by name, as ``make`` gives them, from disk where they were made before.

    ``key`` says everything, beside the solver's sources, that they depend on.
    """
    return cached_each([key], lambda _: [make()])[0]


def cached_each(
    keys: Sequence[str], make: Callable[[list[int]], Iterable[Mapping[str, Array]]]
) -> list[dict[str, Array]]:
    """As `cached` of several keys; ``make`` is given the places of all that are missing."""
    found = [load(key) for key in keys]
    missing = [i for i, each in enumerate(found) if each is None]
    for i, made in zip(missing, make(missing) if missing else (), strict=True):
        arrays = {name: np.asarray(value) for name, value in made.items()}
        store(keys[i], arrays)
        found[i] = arrays
    return [each for each in found if each is not None]


def load(key: str) -> dict[str, Array] | None:
    """What was stored under ``key``, or None."""
    with contextlib.suppress(OSError, ValueError):
        arrays = read_arrays(_path(key))
        if str(arrays.pop(KEY, None)) == key:
            return arrays
    return None


def store(key: str, arrays: Mapping[str, Array]) -> None:
    """Keep ``arrays``; a disk that is full or may not be written keeps nothing."""
    with contextlib.suppress(OSError):
        _forget_parts(_path(key).parent)
        write_arrays(_path(key), {KEY: np.array(key), **arrays})


def read_arrays(path: Path) -> dict[str, Array]:
    """What `write_arrays` wrote; OSError, or ValueError where the file does not hold that."""
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except OSError:
        raise
    except Exception as error:  # readers of zip files fail in many ways on what is none
        raise ValueError(f"{path} is not whole") from error
    if not all(isinstance(array, np.ndarray) for array in arrays.values()):
        raise ValueError(f"{path} holds more than arrays")
    if str(arrays.pop(DIGEST, None)) != _digest(arrays):
        raise ValueError(f"{path} is not what was written")
    return arrays


def _digest(arrays: Mapping[str, Array]) -> str:
    """Of names, types, shapes and contents."""
    found = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        found.update(f"{name} {array.dtype.str} {arrays[name].shape}".encode())
        found.update(array.tobytes())
    return found.hexdigest()


def write_arrays(path: Path, arrays: Mapping[str, Array]) -> None:
    """Write arrays with their digest beside ``path``, see them on the disk, then give the file its
    name; OSError."""
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
    """Remove, once, what runs that were killed left half-written."""
    for part in folder.glob(f"*{PART}"):
        with contextlib.suppress(OSError):
            if time.time() - part.stat().st_mtime > PART_S:
                part.unlink()


@lru_cache(maxsize=8)
def sources(*paths: Path) -> str:
    """A digest of source files, and of all in folders, for keys of what they make."""
    files = [file for path in paths for file in (sorted(path.rglob("*.py")) or [path])]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


def _path(key: str) -> Path:
    name = hashlib.sha256(key.encode()).hexdigest()[:24]
    return cache_folder() / "arrays" / f"{name}.npz"
