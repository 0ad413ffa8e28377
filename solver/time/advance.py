"""Vector operations of a time step in one pass each.

Plain array expressions would read the vectors forty times, which costs as much as the solve.
"""

from __future__ import annotations

import numpy as np

from ..arrays import Array
from ..compiled import njit


@njit
def balance(
    weight: Array,
    now: tuple[Array, Array, Array, Array, Array],
    shares: tuple[float, float, float, float],
) -> Array:
    """weight - K u less the ``shares`` of M v, M a, K v, K a; ``now`` is (Ku, Mv, Ma, Kv, Ka)."""
    ku, mv, ma, kv, ka = now
    of_mv, of_ma, of_kv, of_ka = shares
    out = np.empty_like(ku)
    for i in range(len(ku)):
        inertia = of_mv * mv[i] + of_ma * ma[i]
        out[i] = weight[i] - inertia - ku[i] - of_kv * kv[i] - of_ka * ka[i]
    return out


@njit
def newmark(
    x: Array, v: Array, a: Array, after: Array, h: float, beta: float, gamma: float
) -> tuple[Array, Array]:
    """Newmark's formulas: x and v after a step, with the acceleration ``after`` at its end."""
    later, faster = np.empty_like(x), np.empty_like(x)
    for i in range(len(x)):
        early = a[i]
        late = after[i]
        later[i] = x[i] + h * v[i] + h * h * ((0.5 - beta) * early + beta * late)
        faster[i] = v[i] + h * ((1.0 - gamma) * early + gamma * late)
    return later, faster


@njit
def combine(x: Array, columns: Array, amounts: Array) -> None:
    """Add ``columns`` (n, r), in Fortran order, times ``amounts`` (r,) to x; zeros are skipped."""
    used = np.flatnonzero(amounts)
    k = 0
    while k + 4 <= len(used):
        a, b, c, d = used[k], used[k + 1], used[k + 2], used[k + 3]
        of_a, of_b, of_c, of_d = amounts[a], amounts[b], amounts[c], amounts[d]
        in_a, in_b, in_c, in_d = columns[:, a], columns[:, b], columns[:, c], columns[:, d]
        for i in range(len(x)):
            x[i] += of_a * in_a[i] + of_b * in_b[i] + of_c * in_c[i] + of_d * in_d[i]
        k += 4
    while k < len(used):
        of_a, in_a = amounts[used[k]], columns[:, used[k]]
        for i in range(len(x)):
            x[i] += of_a * in_a[i]
        k += 1
