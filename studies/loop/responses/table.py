"""A table of simulated drops over its axes, with cubic splines between its nodes.

The splines are evaluated by compiled code of this file's own: SciPy's `NdBSpline` gives the same
numbers to rounding. It takes 5 to 9 times as long where every drop has its own stiffness, 70 to 150
times as long where drops share it, and 300 times as long where many nodes of chance are read.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.ndimage import distance_transform_edt

from ....solver.arrays import Array
from ....solver.compiled import njit
from ....solver.errors import ComputationError

# What a table holds of a drop, and what is measured of it.
QUANTITIES = ("y1_m", "contact_time_s", "peak_force_N")
# Of a table: where a body stays in its dent for good, or sticks, no data lie.
MOST_LOST = 0.9
# How many axes a table may have, and of how many quantities splines are evaluated at a time.
AXES, AT_ONCE = 5, 3


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

    @cached_property
    def _ends(self) -> tuple[float, float]:
        return float(self._to(self.low)), float(self._to(self.high))

    def where(self, x: Array | float) -> Array:
        """Places of ``x`` in units of the spacing, held to the ends."""
        low, high = self._ends
        inside = self._to(np.clip(x, self.low, self.high))
        return np.asarray((inside - low) * ((self.n - 1) / (high - low)))


@dataclass(frozen=True)
class Table:
    """Simulated drops over ``axes``, the first two speed of impact (as height) and stiffness.

    ``coefficients`` (..., quantities) are those of cubic splines through what is tabulated, of as
    many quantities as `AT_ONCE` or a multiple of it: the logarithm of each of `QUANTITIES` over
    what a rigid bristle that loses nothing would give, or amounts of shapes (`force_curves`).
    """

    axes: tuple[Axis, ...]
    coefficients: Array

    def at(self, *places: Array) -> Array:
        """What is tabulated (quantities, ...) at places along the axes, arrays that broadcast."""
        where = [axis.where(x) for axis, x in zip(self.axes, places, strict=True)]
        shape = np.broadcast_shapes(*(each.shape for each in where))
        where = [np.atleast_2d(each) for each in where]
        if any(each.shape[-1] != 1 for each in where[1:]):
            where = [each[..., None] for each in where]
        *lead, row = np.broadcast_shapes(*(each.shape for each in where))
        others = [np.broadcast_to(each[..., 0], lead).ravel() for each in where[1:]]
        first = where[0]
        # what does not hang on the last axis of `lead` stands once for all along it
        along = 1 if first.shape[-2] == 1 else lead[-1]
        first = np.array(np.broadcast_to(first, (*lead[:-1], along, row))).reshape(-1, row)
        *sizes, count = self.coefficients.shape
        points = np.stack(others, axis=1) if others else np.zeros((math.prod(lead), 0))
        out = np.empty((count // AT_ONCE, len(points), row, AT_ONCE))
        rows = self.coefficients.reshape(-1, count)
        for i, part in enumerate(out):
            some = np.ascontiguousarray(rows[:, AT_ONCE * i : AT_ONCE * (i + 1)])
            evaluate(some, np.array(sizes), first, points, part)
        return np.asarray(np.moveaxis(out, -1, 1).reshape(count, *shape))

    def fixed(self, *places: float) -> Table:
        """What is tabulated at these places along all axes but the first two."""
        left, share = self.coefficients, np.empty(4)
        for axis, x in zip(self.axes[2:], places, strict=True):
            first = _cubic(float(axis.where(x)), left.shape[2], share)
            left = np.tensordot(share, left[:, :, first : first + 4], axes=(0, 2))
        return Table(self.axes[:2], left)

    def less(self, other: Table) -> Table:
        """What is tabulated less what another table has over the first two axes: weights along the
        others sum to one."""
        heights, kns, *_, count = other.coefficients.shape
        shape = heights, kns, *(1,) * len(self.axes[2:]), count
        return replace(self, coefficients=self.coefficients - other.coefficients.reshape(shape))


def mended(logs: Array) -> Array:
    """A table with what failed as at the nearest place where it did not.

    Raises ComputationError where nearly all of it failed.
    """
    lost = ~np.isfinite(logs).all(axis=-1)
    if not lost.any():
        return logs
    if lost.mean() > MOST_LOST:
        raise ComputationError(
            f"{lost.sum()} of {lost.size} drops of a table failed: the effect's bounds are too wide"
        )
    nearest = distance_transform_edt(lost, return_distances=False, return_indices=True)
    return np.asarray(logs[(*np.asarray(nearest),)])


def coefficients(values: Array, axes: int) -> Array:
    """Those of uniform cubic B-splines through ``values`` (n1, ..., quantities), (n1 + 2, ...).

    The first ``axes`` axes are interpolated, with de Boor's not-a-knot ends, so that slopes at
    the ends are free. Each needs four nodes or more.
    """
    out = np.asarray(values, dtype=float)
    for axis in range(axes):
        n = out.shape[axis]
        if n < 4:
            raise ValueError(f"a cubic spline needs four nodes along every axis, not {n}")
        matrix = np.zeros((n + 2, n + 2))
        for i in range(n):
            matrix[i, i : i + 3] = 1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0
        matrix[n, :5] = matrix[n + 1, -5:] = 1.0, -4.0, 6.0, -4.0, 1.0
        front = np.moveaxis(out, axis, 0).reshape(n, -1)
        solved = np.linalg.solve(matrix, np.vstack([front, np.zeros((2, front.shape[1]))]))
        shape = np.moveaxis(out, axis, 0).shape[1:]
        out = np.moveaxis(solved.reshape(n + 2, *shape), 0, axis)
    return np.ascontiguousarray(out)


@njit
def _cubic(place: float, count: int, out: Array) -> int:
    """Write the weights (4,) of the coefficients about a place to ``out``; number of the first."""
    cell = min(max(math.floor(place), 0), count - 4)
    x = place - cell
    y = 1.0 - x
    out[0] = y * y * y / 6.0
    out[1] = (4.0 - 6.0 * x * x + 3.0 * x * x * x) / 6.0
    out[2] = (4.0 - 6.0 * y * y + 3.0 * y * y * y) / 6.0
    out[3] = x * x * x / 6.0
    return cell


@njit
def evaluate(flat: Array, sizes: Array, first: Array, others: Array, out: Array) -> None:
    """Write the splines' values at places in units of the spacing to ``out`` (points, row, 3).

    ``flat`` (coefficients, 3) are `coefficients` of three quantities, their axes run together,
    ``sizes`` (axes,) how many there are along each. ``others`` (points, axes - 1) are places along
    all axes but the first. ``first`` (rows, row) are places along that: point p has those of row
    p // (points / rows), and goes through the other axes once for all of them.
    """
    # axes that a table lacks stand behind the first, with one coefficient each
    count, row = len(others), first.shape[1]
    beside = AXES - 1
    absent = AXES - len(sizes)
    weight = np.ones((beside, 4))
    begin = np.zeros(beside, dtype=np.int64)
    size = np.ones(beside, dtype=np.int64)
    size[absent:] = sizes[1:]
    n0, n1, n2 = min(size[0], 4), min(size[1], 4), min(size[2], 4)
    line = np.empty((sizes[0], 3))
    cell = np.empty(row, dtype=np.int64)
    share = np.empty((row, 4))
    low = high = 0
    for p in range(count):
        if p % (count // len(first)) == 0:
            for r in range(row):
                cell[r] = _cubic(first[p * len(first) // count, r], sizes[0], share[r])
            low, high = cell.min(), cell.max() + 4
        for a in range(absent, beside):
            begin[a] = _cubic(others[p, a - absent], size[a], weight[a])
        w0, w1, w2, w3 = weight[beside - 1]
        for i in range(low, high):
            if len(sizes) == 1:
                line[i] = flat[i]
                continue
            sum0 = sum1 = sum2 = 0.0
            for j in range(n0):
                at_j, share_j = i * size[0] + begin[0] + j, weight[0, j]
                for k in range(n1):
                    at_k, share_k = at_j * size[1] + begin[1] + k, share_j * weight[1, k]
                    for m in range(n2):
                        share_m = share_k * weight[2, m]
                        a = (at_k * size[2] + begin[2] + m) * size[3] + begin[3]
                        b, c, d = a + 1, a + 2, a + 3
                        sum0 += share_m * (
                            w0 * flat[a, 0] + w1 * flat[b, 0] + w2 * flat[c, 0] + w3 * flat[d, 0]
                        )
                        sum1 += share_m * (
                            w0 * flat[a, 1] + w1 * flat[b, 1] + w2 * flat[c, 1] + w3 * flat[d, 1]
                        )
                        sum2 += share_m * (
                            w0 * flat[a, 2] + w1 * flat[b, 2] + w2 * flat[c, 2] + w3 * flat[d, 2]
                        )
            line[i, 0], line[i, 1], line[i, 2] = sum0, sum1, sum2
        for r in range(row):
            for q in range(3):
                total = 0.0
                for i in range(4):
                    total += share[r, i] * line[cell[r] + i, q]
                out[p, r, q] = total
