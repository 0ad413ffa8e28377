"""What is tried where a drop fails: a shorter ITS."""

from __future__ import annotations

from collections.abc import Callable

from ...solver.batch import SHORTER
from ...solver.errors import ComputationError


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
