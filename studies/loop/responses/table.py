"""A table of simulated drops over its axes, with cubic splines between its nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt

from ....solver.arrays import Array
from ....solver.errors import ComputationError
from .spline import AXES, basis, evaluate

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
        where = [axis.where(x) for axis, x in zip(self.axes, places, strict=True)]
        if len(where) == AXES and _apart(where):
            return self._apart(where)
        spots = np.broadcast_arrays(*where)
        flat = np.stack([np.ravel(spot) for spot in spots], axis=1)
        sizes = np.array(self.coefficients.shape[:-1])
        out = np.empty((len(flat), len(QUANTITIES)))
        evaluate(self.coefficients.reshape(-1, len(QUANTITIES)), sizes, flat, out)
        return np.asarray(out.T.reshape(len(QUANTITIES), *spots[0].shape))

    def _apart(self, where: list[Array]) -> Array:
        """`at` where the first two axes hang on the drop alone, the others on chance's node alone:
        a table over the latter is made for each drop, and read for all nodes."""
        lead = np.broadcast_shapes(*(each.shape[:-2] for each in map(np.atleast_2d, where)))
        drops = max(each.shape[-1] for each in map(np.atleast_2d, where[:2]))
        nodes = max(each.shape[-2] for each in map(np.atleast_2d, where[2:]))
        shapes = 2 * [(*lead, 1, drops)] + 2 * [(*lead, nodes, 1)]
        counts = self.coefficients.shape
        one, two, three, four = (
            basis(np.broadcast_to(place, shape).reshape(-1), count)
            for place, shape, count in zip(where, shapes, counts[:-1], strict=True)
        )
        by_drop = np.einsum("pi,pj->pij", one, two).reshape(len(one), -1)
        by_node = np.einsum("pk,pl->pkl", three, four).reshape(-1, nodes, counts[2] * counts[3])
        own = by_drop @ self.coefficients.reshape(by_drop.shape[1], -1)
        own = own.reshape(-1, drops, counts[2] * counts[3], counts[-1]).swapaxes(1, 2)
        found = by_node @ own.reshape(*own.shape[:2], -1)
        return np.moveaxis(found.reshape(*lead, nodes, drops, counts[-1]), -1, 0)


def _apart(where: list[Array]) -> bool:
    """Whether no place along the first two axes differs between nodes, and none along the others
    between drops, of arrays (..., nodes, drops)."""
    deep = [np.atleast_2d(each).shape for each in where]
    return all(s[-2] == 1 for s in deep[:2]) and all(s[-1] == 1 for s in deep[2:])


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
