"""Array types of signatures: NumPy arrays of floating-point numbers, of integers, of flags."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
Integers = NDArray[np.integer]
Flags = NDArray[np.bool_]
