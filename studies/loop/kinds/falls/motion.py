"""Motion of a fall with drag, in closed form, and the instant of release from a mean reading.

With drag of c v + k v² a mass, dv/dt = g − c v − k v², and from rest

    v(t) = 2 g tanh(D t / 2) / (D + c tanh(D t / 2)),  D² = c² + 4 k g

(L. D. Landau and E. M. Lifshitz, Mechanics, or any text on falls with drag). An accelerometer reads
g − dv/dt, which is zero at release; its mean from t to t' is g − (v(t') − v(t)) / (t' − t).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .....solver.arrays import Array
from .....solver.compiled import njit

LEAST_RATE_1_S = 1e-6
EARLIEST_S, LATEST_S = -0.1, 3.0
"""Bounds of the time from release to a record's first sample: a delay of the sensor's filter looks
like a release after it, and within 3 s a body falls 44 m."""
TURNS = 60


@njit
def speed(time_s: float, k_1_m: float, c_1_s: float, gravity_m_s2: float) -> float:
    """Speed downward in m/s at a time after release; before it, a vacuum's."""
    if time_s <= 0.0:
        return gravity_m_s2 * time_s
    rate = max(math.sqrt(c_1_s * c_1_s + 4.0 * k_1_m * gravity_m_s2), LEAST_RATE_1_S)
    share = math.tanh(0.5 * rate * time_s)
    return 2.0 * gravity_m_s2 * share / (rate + c_1_s * share)


@njit
def mean_reading(
    begin_s: float, end_s: float, k_1_m: float, c_1_s: float, gravity_m_s2: float
) -> float:
    """Mean reading in m/s² between two times after release, without the sensor's bias."""
    gained = speed(end_s, k_1_m, c_1_s, gravity_m_s2) - speed(begin_s, k_1_m, c_1_s, gravity_m_s2)
    return gravity_m_s2 - gained / (end_s - begin_s)


@njit
def _level(
    lead: float, begin: Array, end: Array, k: float, c: float, gravity: float
) -> tuple[float, float]:
    """Mean over bins of what they read, and its slope in the time from release to the first."""
    level = slope = 0.0
    for j in range(len(begin)):
        first = speed(lead + begin[j], k, c, gravity)
        last = speed(lead + end[j], k, c, gravity)
        level += gravity - (last - first) / (end[j] - begin[j])
        drag = last * (c + k * last) if last > 0.0 else 0.0
        drag -= first * (c + k * first) if first > 0.0 else 0.0
        slope += drag / (end[j] - begin[j])
    return level / len(begin), slope / len(begin)


@njit
def lead_s(
    level_m_s2: float, begin: Array, end: Array, k_1_m: float, c_1_s: float, gravity_m_s2: float
) -> float:
    """How long before the record's time zero the body was let go, for bins (n,) to read ``level``
    on average: at the nearer bound where no time does. The mean grows with that time.
    """
    low, high = EARLIEST_S, LATEST_S
    if _level(low, begin, end, k_1_m, c_1_s, gravity_m_s2)[0] >= level_m_s2:
        return low
    if _level(high, begin, end, k_1_m, c_1_s, gravity_m_s2)[0] <= level_m_s2:
        return high
    lead = 0.0
    for _ in range(TURNS):
        found, slope = _level(lead, begin, end, k_1_m, c_1_s, gravity_m_s2)
        if found > level_m_s2:
            high = lead
        else:
            low = lead
        tried = lead - (found - level_m_s2) / slope if slope > 0.0 else low - 1.0
        if not low < tried < high:
            tried = 0.5 * (low + high)
        if abs(tried - lead) < 1e-12:
            break
        lead = tried
    return lead


@njit
def predicted(
    bias: Array,
    k: Array,
    c: Array,
    gravity: float,
    begin: Array,
    end: Array,
    level: Array,
    starts: NDArray[np.int64],
    out: Array,
) -> None:
    """Mean readings ``out`` (points, bins) of points with ``bias``, ``k``, ``c`` (points,).

    Bins from ``begin`` to ``end`` (bins,) since their record's time zero; ``starts`` (falls + 1,)
    says where each fall's begin, ``level`` (falls,) what they read on average.
    """
    for i in range(len(k)):
        for fall in range(len(level)):
            first, last = starts[fall], starts[fall + 1]
            own = level[fall] - bias[i]
            lead = lead_s(own, begin[first:last], end[first:last], k[i], c[i], gravity)
            for j in range(first, last):
                out[i, j] = bias[i] + mean_reading(
                    lead + begin[j], lead + end[j], k[i], c[i], gravity
                )
