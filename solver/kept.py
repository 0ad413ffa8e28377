"""Which dear arrays did an earlier run make that can be used again?

They lie under the user's cache, in a folder named after the sources that could change them. A file
appears whole or not at all, holds plain numbers, and one that cannot be read is made again.
"""

from __future__ import annotations

import contextlib
import hashlib
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import numpy as np

from .bodies.base import Array
from .compiled import cache_folder

KEY = "key"


def kept(key: str, make: Callable[[], Mapping[str, Array]]) -> dict[str, Array]:
    """Arrays by name, as ``make`` gives them, from disk where they were made before.

    ``key`` says everything, beside the solver's sources, that they depend on.
    """
    found = load(key)
    if found is None:
        found = {name: np.asarray(value) for name, value in make().items()}
        store(key, found)
    return found


def load(key: str) -> dict[str, Array] | None:
    """What was stored under ``key``, or None."""
    try:
        with np.load(_path(key), allow_pickle=False) as file:
            if str(file[KEY]) == key:
                return {name: file[name] for name in file.files if name != KEY}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        pass
    return None


def store(key: str, arrays: Mapping[str, Array]) -> None:
    """Keep ``arrays``; a disk that is full or may not be written keeps nothing."""
    path = _path(key)
    with contextlib.suppress(OSError):
        path.parent.mkdir(exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as part:
            try:
                np.savez(part, **cast(dict[str, Any], {KEY: np.array(key), **arrays}))
            except BaseException:
                Path(part.name).unlink()
                raise
        Path(part.name).replace(path)


@lru_cache(maxsize=8)
def sources(*paths: Path) -> str:
    """A digest of source files, and of all in folders, for keys of what they make."""
    files = [file for path in paths for file in (sorted(path.rglob("*.py")) or [path])]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


def _path(key: str) -> Path:
    name = hashlib.sha256(key.encode()).hexdigest()[:24]
    return cache_folder() / "arrays" / f"{name}.npz"
