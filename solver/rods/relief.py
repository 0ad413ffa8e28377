"""A rough surface under rods: heights over the plane z = 0, and local contact stiffness."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from ..arrays import Array
from ..compiled import njit
from ..errors import InputError

# Least number of nodes along each side: a cubic spline spans four.
FEWEST = 4


class Relief(NamedTuple):
    """Heights for compiled code, if ``there`` are any.

    ``coefficients`` (ny, nx) in m are those of a periodic bicubic spline on a grid of ``spacing``
    m, ``factor`` (ny, nx) is the contact stiffness at each node over Kn.
    """

    there: bool
    coefficients: Array
    spacing: float
    factor: Array


@dataclass(frozen=True, eq=False)
class RoughPlane:
    """A periodic field of heights over z = 0, with local contact stiffness.

    Node (j, i) is at x = i spacing, y = j spacing; the tile repeats without end.

    Parameters
    ----------
    heights_m : (ny, nx), in m; 4 or more along each side
    spacing_m : of the grid in x and y
    factor : (ny, nx), contact stiffness at each node over Kn

    Raises
    ------
    InputError : an array is too small or not finite, the shapes differ, or a factor or the spacing
        is not positive
    """

    heights_m: Array
    spacing_m: float
    factor: Array

    def __post_init__(self) -> None:
        shape = np.shape(self.heights_m)
        if len(shape) != 2 or min(shape) < FEWEST or np.shape(self.factor) != shape:
            raise InputError(f"a rough plane needs two equal grids of {FEWEST} by {FEWEST} or more")
        if not (np.all(np.isfinite(self.heights_m)) and np.all(np.isfinite(self.factor))):
            raise InputError("the heights and the factors of a rough plane must be finite")
        if not (np.min(self.factor) > 0.0 and 0.0 < self.spacing_m < math.inf):
            raise InputError("the factors and the spacing of a rough plane must be positive")

    def compiled(self) -> Relief:
        """For compiled code."""
        spline = ndimage.spline_filter(np.asarray(self.heights_m, float), 3, mode="grid-wrap")
        factor = np.ascontiguousarray(self.factor, dtype=float)
        return Relief(True, np.ascontiguousarray(spline), float(self.spacing_m), factor)


def no_relief() -> Relief:
    """The relief of a smooth plane."""
    return Relief(False, np.zeros((1, 1)), 1.0, np.ones((1, 1)))


def highest_m(relief: Relief) -> float:
    """An upper bound on the heights: a spline lies between its least and greatest coefficients."""
    return float(relief.coefficients.max())


@njit
def _weights(t: float, value: Array, slope: Array) -> None:
    """Write values and slopes (4,) of the cubic B-splines that are nonzero at ``t`` in [0, 1],
    counted from the second one's node."""
    u = 1.0 - t
    value[0], value[3] = u * u * u / 6.0, t * t * t / 6.0
    value[1] = (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0
    value[2] = (4.0 - 6.0 * u * u + 3.0 * u * u * u) / 6.0
    slope[0], slope[3] = -0.5 * u * u, 0.5 * t * t
    slope[1] = -2.0 * t + 1.5 * t * t
    slope[2] = 2.0 * u - 1.5 * u * u


@njit
def look(relief: Relief, x: float, y: float, normal: Array, grows: Array) -> tuple[float, float]:
    """Height in m of the surface at a place, and the factor of the contact stiffness, linear
    between nodes.

    Writes the unit ``normal`` (3,) and the factor's gradient ``grows`` (3,) per m.
    """
    rows, columns = relief.coefficients.shape
    across, along = x / relief.spacing, y / relief.spacing
    i, j = math.floor(across), math.floor(along)
    values, slopes = np.empty((2, 4)), np.empty((2, 4))
    _weights(across - i, values[0], slopes[0])
    _weights(along - j, values[1], slopes[1])
    height = rise_x = rise_y = 0.0
    for b in range(4):
        row = (j - 1 + b) % rows
        for a in range(4):
            entry = relief.coefficients[row, (i - 1 + a) % columns]
            height += entry * values[0, a] * values[1, b]
            rise_x += entry * slopes[0, a] * values[1, b]
            rise_y += entry * values[0, a] * slopes[1, b]
    rise_x /= relief.spacing
    rise_y /= relief.spacing
    size = math.sqrt(1.0 + rise_x * rise_x + rise_y * rise_y)
    normal[0], normal[1], normal[2] = -rise_x / size, -rise_y / size, 1.0 / size
    right, above, s, t = (i + 1) % columns, (j + 1) % rows, across - i, along - j
    i, j = i % columns, j % rows
    low, high = relief.factor[j], relief.factor[above]
    near, far = (1.0 - t) * low[i] + t * high[i], (1.0 - t) * low[right] + t * high[right]
    factor = (1.0 - s) * near + s * far
    grows[0] = (far - near) / relief.spacing
    grows[1] = (1.0 - s) * (high[i] - low[i]) + s * (high[right] - low[right])
    grows[1] /= relief.spacing
    grows[2] = 0.0
    return height, factor
