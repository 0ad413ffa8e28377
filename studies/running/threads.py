"""Work over the cores of one process, by threads that take turns."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

from ...solver.compiled import has_turn, in_turn


def in_threads[Item, Found](
    function: Callable[[Item], Found], items: Sequence[Item]
) -> Iterator[Found]:
    """What ``function`` makes of each item, in their order, by as many threads as there are cores.

    One computes at a time, but for what compiled code does in `compiled.meanwhile`. Called in a
    thread that has its turn already, it does all there.
    """
    if has_turn():
        yield from map(function, items)
        return

    def in_its_turn(item: Item) -> Found:
        with in_turn():
            return function(item)

    threads = ThreadPoolExecutor(os.process_cpu_count())
    try:
        yield from threads.map(in_its_turn, items)
    except BaseException as error:
        # who is interrupted does not wait for what threads compute
        threads.shutdown(not isinstance(error, KeyboardInterrupt), cancel_futures=True)
        raise
    threads.shutdown()
