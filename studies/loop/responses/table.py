"""A table of simulated drops over its axes, with cubic splines between its nodes.

The splines are evaluated by compiled code of this file's own: SciPy's `NdBSpline` gives the same
numbers to rounding and takes 6 to 10 times as long.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

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

    def where(self, x: Array) -> Array:
        """Places of ``x`` in units of the spacing, held to the ends."""
        low, high = self._to(self.low), self._to(self.high)
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
        if _apart(where):
            return self._apart(where)
        spots = np.broadcast_arrays(*where)
        flat = np.stack([np.ravel(spot) for spot in spots], axis=1)
        *sizes, count = self.coefficients.shape
        out = np.empty((count // AT_ONCE, len(flat), AT_ONCE))
        rows = self.coefficients.reshape(-1, count)
        for i, part in enumerate(out):
            some = np.ascontiguousarray(rows[:, AT_ONCE * i : AT_ONCE * (i + 1)])
            evaluate(some, np.array(sizes), flat, part)
        return np.asarray(out.swapaxes(1, 2).reshape(count, *spots[0].shape))

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
    """Whether these are four arrays (..., nodes, drops), where no place along the first two axes
    differs between nodes, and none along the others between drops."""
    if len(where) != 4:
        return False
    deep = [np.atleast_2d(each).shape for each in where]
    return all(s[-2] == 1 for s in deep[:2]) and all(s[-1] == 1 for s in deep[2:])


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
def basis(places: Array, count: int) -> Array:
    """Weights (points, count) of the coefficients along one axis at ``places`` (points,)."""
    out = np.zeros((len(places), count))
    weight = np.zeros(4)
    for p in range(len(places)):
        first = _cubic(places[p], count, weight)
        out[p, first : first + 4] = weight
    return out


@njit
def evaluate(flat: Array, sizes: Array, places: Array, out: Array) -> None:
    """Write the splines' values at ``places`` (points, axes), in units of the spacing, to ``out``.

    ``flat`` (coefficients, 3) are `coefficients` of three quantities, their axes run together,
    ``sizes`` (axes,) how many there are along each, ``out`` is (points, 3).
    """
    # axes that are not there come first, with one coefficient each
    absent = AXES - len(sizes)
    weight = np.ones((AXES, 4))
    first = np.zeros(AXES, dtype=np.int64)
    size = np.ones(AXES, dtype=np.int64)
    size[absent:] = sizes
    n0, n1, n2, n3, _ = np.minimum(size, 4)
    for p in range(len(places)):
        for a in range(absent, AXES):
            first[a] = _cubic(places[p, a - absent], size[a], weight[a])
        w0, w1, w2, w3 = weight[AXES - 1]
        sum0 = sum1 = sum2 = 0.0
        for i in range(n0):
            at_i = first[0] + i
            for j in range(n1):
                at_j, share_j = at_i * size[1] + first[1] + j, weight[0, i] * weight[1, j]
                for k in range(n2):
                    at_k, share_k = at_j * size[2] + first[2] + k, share_j * weight[2, k]
                    for m in range(n3):
                        share = share_k * weight[3, m]
                        at = (at_k * size[3] + first[3] + m) * size[4] + first[4]
                        near = flat[at : at + 4]
                        sum0 += share * (
                            w0 * near[0, 0] + w1 * near[1, 0] + w2 * near[2, 0] + w3 * near[3, 0]
                        )
                        sum1 += share * (
                            w0 * near[0, 1] + w1 * near[1, 1] + w2 * near[2, 1] + w3 * near[3, 1]
                        )
                        sum2 += share * (
                            w0 * near[0, 2] + w1 * near[1, 2] + w2 * near[2, 2] + w3 * near[3, 2]
                        )
        out[p, 0], out[p, 1], out[p, 2] = sum0, sum1, sum2
