"""The array type that signatures name: NumPy's, of floating-point numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
