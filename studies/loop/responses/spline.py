"""Cubic splines through equally spaced values in up to four axes."""

from __future__ import annotations

import math

import numpy as np

from ....solver.arrays import Array
from ....solver.compiled import njit

AXES = 4


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
    n_axes = len(sizes)
    weight = np.zeros((AXES, 4))
    first = np.zeros(AXES, dtype=np.int64)
    count = np.ones(AXES, dtype=np.int64)
    stride = np.zeros(AXES, dtype=np.int64)
    weight[:, 0] = 1.0
    step = 1
    for a in range(n_axes - 1, -1, -1):
        stride[a], count[a] = step, 4
        step *= sizes[a]
    for p in range(len(places)):
        for a in range(n_axes):
            first[a] = _cubic(places[p, a], sizes[a], weight[a])
        sum0 = sum1 = sum2 = 0.0
        for i in range(count[0]):
            at0 = (first[0] + i) * stride[0]
            for j in range(count[1]):
                at1 = at0 + (first[1] + j) * stride[1]
                w1 = weight[0, i] * weight[1, j]
                for k in range(count[2]):
                    at = at1 + (first[2] + k) * stride[2] + first[3] * stride[3]
                    w2 = w1 * weight[2, k]
                    if n_axes < AXES:
                        sum0 += w2 * flat[at, 0]
                        sum1 += w2 * flat[at, 1]
                        sum2 += w2 * flat[at, 2]
                        continue
                    w3, w4 = w2 * weight[3, 0], w2 * weight[3, 1]
                    w5, w6 = w2 * weight[3, 2], w2 * weight[3, 3]
                    sum0 += w3 * flat[at, 0] + w4 * flat[at + 1, 0]
                    sum0 += w5 * flat[at + 2, 0] + w6 * flat[at + 3, 0]
                    sum1 += w3 * flat[at, 1] + w4 * flat[at + 1, 1]
                    sum1 += w5 * flat[at + 2, 1] + w6 * flat[at + 3, 1]
                    sum2 += w3 * flat[at, 2] + w4 * flat[at + 1, 2]
                    sum2 += w5 * flat[at + 2, 2] + w6 * flat[at + 3, 2]
        out[p, 0], out[p, 1], out[p, 2] = sum0, sum1, sum2
