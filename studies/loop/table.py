"""A table of simulated drops over its axes, with cubic splines between its nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt

from ...solver.bristle import Array
from ...solver.errors import ComputationError
from .spline import evaluate

# What a table holds of a drop, and what is measured of it.
QUANTITIES = ("y1_m", "contact_time_s", "peak_force_N")


@dataclass(frozen=True)
class Axis:
    """Equally spaced values along a table's side, by themselves, their logarithm or their root."""

    low: float
    high: float
    n: int
    how: str = "even"

    def _to(self, x: Array | float) -> Array:
        x = np.asarray(x, dtype=float)
        return np.log(x) if self.how == "log" else np.sqrt(x) if self.how == "root" else x

    def nodes(self) -> Array:
        """The values (n,)."""
        even = np.linspace(self._to(self.low), self._to(self.high), self.n)
        return np.exp(even) if self.how == "log" else even**2 if self.how == "root" else even

    def where(self, x: Array) -> Array:
        """Places of ``x`` in units of the spacing, held to the ends."""
        low, high = self._to(self.low), self._to(self.high)
        inside = self._to(np.clip(x, self.low, self.high))
        return np.asarray((inside - low) * ((self.n - 1) / (high - low)))


@dataclass(frozen=True)
class Table:
    """Simulated drops over ``axes``, the first two speed of impact (as height) and stiffness.

    ``coefficients`` (..., quantities) are those of cubic splines through the logarithm of each
    quantity over what a rigid bristle that loses nothing would give.
    """

    axes: tuple[Axis, ...]
    coefficients: Array

    def at(self, *places: Array) -> Array:
        """Logarithms (quantities, ...) at places along the axes, arrays that broadcast."""
        spots = np.broadcast_arrays(
            *(axis.where(x) for axis, x in zip(self.axes, places, strict=True))
        )
        flat = np.stack([np.ravel(spot) for spot in spots], axis=1)
        sizes = np.array(self.coefficients.shape[:-1])
        out = np.empty((len(flat), len(QUANTITIES)))
        evaluate(self.coefficients.reshape(-1, len(QUANTITIES)), sizes, flat, out)
        return np.asarray(out.T.reshape(len(QUANTITIES), *spots[0].shape))


def mended(logs: Array) -> Array:
    """A table with what failed as at the nearest place where it did not.

    Raises ComputationError where more than half of it failed.
    """
    lost = ~np.isfinite(logs).all(axis=-1)
    if not lost.any():
        return logs
    if lost.mean() > 0.5:
        raise ComputationError(
            f"{lost.sum()} of {lost.size} drops of a table failed: the effect's bounds are too wide"
        )
    nearest = distance_transform_edt(lost, return_distances=False, return_indices=True)
    return np.asarray(logs[(*np.asarray(nearest),)])
