"""Array types of signatures: NumPy arrays of floating-point numbers, of integers, of flags."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
Integers = NDArray[np.integer]
Flags = NDArray[np.bool_]


def zeros[Record](record: Callable[..., Record], *shapes: int | tuple[int, ...]) -> Record:
    """A record whose arrays have these shapes."""
    return record(*(np.zeros(shape) for shape in shapes))
