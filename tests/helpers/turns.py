"""Processes of xdist do not compile the same function, or make the same table, side by side.

Who comes second waits, and finds on disk what the first has made. Begun with an empty cache, two
processes would otherwise spend their first minutes on the same march.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from numba.core.dispatcher import Dispatcher

from bristle.solver import cache
from bristle.solver.compiled import cache_folder

# By any thread of this process: one that waited for another would keep it from its turn.
_HELD: set[str] = set()
# Taken before a turn by the threads of this process, of which Numba lets one compile at a time.
_COMPILING = threading.RLock()


@contextlib.contextmanager
def turn(name: str) -> Iterator[None]:
    """No other process is inside for this ``name``; the one that is may enter again."""
    if name in _HELD:
        yield
        return
    path = cache_folder() / f"turn-{hashlib.sha256(name.encode()).hexdigest()[:16]}"
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        _HELD.add(name)
        try:
            yield
        finally:
            _HELD.discard(name)


def take_turns() -> None:
    """From now on in this process; modules that import `cache.cached_each` have to come later."""
    compile_, cached_each = Dispatcher.compile, cache.cached_each

    def compile_in_turn(self: Any, signature: Any) -> Any:
        with _COMPILING, turn(f"{self.py_func.__module__}.{self.py_func.__qualname__}"):
            return compile_(self, signature)

    def cached_in_turn(keys: Sequence[str], make: Callable[[list[int]], Any]) -> Any:
        with contextlib.ExitStack() as turns:
            for key in sorted(keys):  # all in one order, so that nobody waits in a circle
                if cache.load(key) is None:
                    turns.enter_context(turn(key))
            return cached_each(keys, make)

    Dispatcher.compile = compile_in_turn
    cache.cached_each = cached_in_turn
