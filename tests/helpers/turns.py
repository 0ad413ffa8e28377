"""Processes of xdist do not compile the same function, or make the same table, side by side.

Who comes second waits, and finds on disk what the first has made. Begun with an empty cache, two
processes would otherwise spend their first minutes on the same march.
"""

from __future__ import annotations

import fcntl
import hashlib
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from numba.core.dispatcher import Dispatcher

from bristle.solver import cache
from bristle.solver.compiled import cache_folder

_HELD = threading.local()
# Taken before a turn by the threads of this process, of which Numba lets one compile at a time.
_COMPILING = threading.RLock()


@contextmanager
def turn(name: str) -> Iterator[None]:
    """Nobody else is inside for this ``name``; whoever is may enter again."""
    held = _HELD.__dict__.setdefault("names", set())
    if name in held:
        yield
        return
    path = cache_folder() / f"turn-{hashlib.sha256(name.encode()).hexdigest()[:16]}"
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        held.add(name)
        try:
            yield
        finally:
            held.remove(name)


def take_turns() -> None:
    """From now on in this process; modules that import `cache.cached` have to come later."""
    compile_, cached = Dispatcher.compile, cache.cached

    def compile_in_turn(self: Any, signature: Any) -> Any:
        with _COMPILING, turn(f"{self.py_func.__module__}.{self.py_func.__qualname__}"):
            return compile_(self, signature)

    def cached_in_turn(key: str, make: Callable[[], Any]) -> Any:
        with turn(key):
            return cached(key, make)

    Dispatcher.compile = compile_in_turn
    cache.cached = cached_in_turn
