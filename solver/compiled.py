"""How is numerical code compiled, and where is the result kept?

Numba keeps compiled functions on disk but looks at their own file alone to see whether they are
stale. The cache's folder is therefore named after all sources that compiled code may read from.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
import time
from functools import cache
from pathlib import Path
from typing import Protocol, cast

import numba

KEPT_S = 7 * 86400.0
# Folders of the package that compiled code takes nothing from.
APART = ("effects", "finite")


class Decorator(Protocol):
    """What leaves a function's signature as it is."""

    def __call__[Function](self, function: Function) -> Function: ...


@cache
def cache_folder() -> Path:
    """The folder for this version of the sources, under the user's cache or, failing that, /tmp.

    It is looked for once: what a process makes belongs to the sources that it began with.
    """
    digest = hashlib.sha256()
    here = Path(__file__).parent
    for path in sorted(here.rglob("*.py")):
        if path.relative_to(here).parts[0] not in APART:
            digest.update(path.read_bytes())
    home = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
    name = digest.hexdigest()[:16]
    for root in (Path(home) if home else Path.home() / ".cache", Path(tempfile.gettempdir())):
        folder = root / "bristle" / f"compiled-{os.getuid()}" / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            _forget_old(folder)
            return folder
    return Path(tempfile.mkdtemp(prefix="bristle-"))


def _forget_old(folder: Path) -> None:
    """Drop caches that no process has begun with for a week."""
    folder.touch()
    for path in folder.parent.iterdir():
        if time.time() - path.stat().st_mtime > KEPT_S:
            shutil.rmtree(path, ignore_errors=True)


numba.config.CACHE_DIR = str(cache_folder())

njit = cast(Decorator, numba.njit(cache=True, nogil=True))
