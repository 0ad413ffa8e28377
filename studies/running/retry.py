"""What is tried where drops fail: halves of a batch until one stands alone, then a shorter ITS."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...solver.bristle import Array
from ...solver.errors import ComputationError

# Parts of the ITS that are tried where contact forces do not converge.
SHORTER = (0.5, 0.2)


def with_shorter_its[Found](run: Callable[[float], Found], its_s: float) -> Found:
    """What ``run`` gives at ``its_s`` or, where it fails there, at the longest part that serves.

    Raises the ComputationError of the shortest.
    """
    *longer, shortest = (part * its_s for part in (1.0, *SHORTER))
    for its in longer:
        try:
            return run(its)
        except ComputationError:
            continue
    return run(shortest)


def drop_by_drop(
    run: Callable[[slice, float], Array], n: int, its_s: float, failed: Array
) -> Array:
    """Rows (n, ...) of ``run`` for ``n`` drops, which is told which of them and the ITS.

    A batch that fails is halved; a drop that fails alone takes a shorter ITS, and has ``failed``
    (...) in its row where none serves.
    """

    def rows(which: slice) -> Array:
        first, last = which.start, which.stop
        if last - first > 1:
            try:
                return run(which, its_s)
            except ComputationError:
                middle = first + (last - first) // 2
            return np.concatenate([rows(slice(first, middle)), rows(slice(middle, last))])
        try:
            return with_shorter_its(lambda its: run(which, its), its_s)
        except ComputationError:
            return failed[None]

    return rows(slice(0, n))
