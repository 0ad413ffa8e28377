"""Fall of a rigid body before it touches, and its rise after, in a vacuum and in air."""

from __future__ import annotations

import math

import numpy as np

from .arrays import Array
from .compiled import njit
from .errors import ComputationError

LEAST_DRAG_1_M = 1e-12
"""With less drag over mass a body moves as in a vacuum: 1 m changes by one part in 10^12."""


def free_fall(height_m: float, gravity_m_s2: float, alpha_1_s: float) -> tuple[float, float]:
    """Time and speed of a rigid fall from rest through ``height_m`` (Eq. 1 for zero alpha)."""
    if alpha_1_s == 0.0:
        speed = math.sqrt(2.0 * gravity_m_s2 * height_m)
        return speed / gravity_m_s2, speed
    from scipy.optimize import brentq

    def beyond(t_s: float) -> float:
        return float(falling(t_s, gravity_m_s2, 0.0, alpha_1_s, 0.0)[0]) - height_m

    # upper bound: the times in a vacuum and at the final speed, added
    latest = math.sqrt(2.0 * height_m / gravity_m_s2) + height_m * alpha_1_s / gravity_m_s2
    t = float(brentq(beyond, 0.0, 1.01 * latest, xtol=1e-16))
    return t, float(falling(t, gravity_m_s2, 0.0, alpha_1_s, 0.0)[1])


def dragged_fall(
    height_m: float, gravity_m_s2: float, speed_m_s: float, drag_1_m: float
) -> tuple[float, float]:
    """Time and speed of a fall through ``height_m`` with a downward initial speed.

    ``drag_1_m`` is quadratic drag over mass. An upward start rises first. The speed follows
    v' = g - k v², whose solution is v_∞ tanh (tan on the way up), v_∞² = g / k. Raises
    ComputationError if the initial speed exceeds v_∞.
    """
    g, k, v0 = gravity_m_s2, drag_1_m, speed_m_s
    speed = math.sqrt(_end_speed2(height_m, g, v0, k))
    if k < LEAST_DRAG_1_M:
        return (speed - v0) / g, speed
    limit = math.sqrt(g / k)
    if v0 >= limit:
        raise ComputationError(
            f"the bristle is released at {v0:g} m/s, above its {limit:.3g} m/s of steady fall"
        )
    early = math.atan(-min(v0, 0.0) / limit) * limit / g
    v0 = max(v0, 0.0)
    # atanh(v/v∞) - atanh(v0/v∞) by its addition theorem
    turned = math.atanh((speed - v0) * limit / (limit**2 - speed * v0))
    return early + turned * limit / g, speed


def fallen(
    height_m: Array | float, gravity_m_s2: float, speed_m_s: Array | float, drag_1_m: Array | float
) -> Array:
    """Height of a fall from rest in a vacuum with the final speed of `dragged_fall`.

    Arrays broadcast. A start above the speed of steady fall is slowed.
    """
    return _end_speed2(height_m, gravity_m_s2, speed_m_s, drag_1_m) / (2.0 * gravity_m_s2)


def _end_speed2(
    height_m: Array | float, gravity_m_s2: float, speed_m_s: Array | float, drag_1_m: Array | float
) -> Array:
    """Squared speed at the end of `dragged_fall`, for arrays that broadcast."""
    h, v0 = np.asarray(height_m), np.asarray(speed_m_s)
    k = np.maximum(drag_1_m, LEAST_DRAG_1_M)
    limit2 = gravity_m_s2 / k
    higher = h + np.where(v0 < 0.0, np.log1p(v0**2 / limit2) / (2.0 * k), 0.0)
    start2 = np.where(v0 < 0.0, 0.0, v0**2)
    # v∞² - v² = (v∞² - v0²) exp(-2 k h), without cancellation
    slowed = start2 - (limit2 - start2) * np.expm1(-2.0 * k * higher)
    freely = v0**2 + 2.0 * gravity_m_s2 * h
    return np.where(np.asarray(drag_1_m) < LEAST_DRAG_1_M, freely, slowed)


def risen(height_m: Array | float, drag_1_m: Array | float) -> Array:
    """Height that a body reaches with drag ``drag_1_m`` over mass, if without drag it would reach
    ``height_m``.

    Arrays broadcast.
    """
    k = np.maximum(drag_1_m, LEAST_DRAG_1_M)
    slowed = np.log1p(2.0 * k * height_m) / (2.0 * k)
    return np.where(np.asarray(drag_1_m) < LEAST_DRAG_1_M, height_m, slowed)


@njit
def falling(
    t_s: float, gravity_m_s2: float, speed_m_s: float, alpha_1_s: float, drag_1_m: float
) -> tuple[float, float]:
    """Distance fallen after ``t_s`` and the speed then, both positive downward like ``speed_m_s``,
    the initial speed. The distance is negative while an upward start is above its origin.

    Mass-proportional damping ``alpha_1_s`` or quadratic drag over mass ``drag_1_m`` acts.
    """
    if drag_1_m == 0.0 and alpha_1_s == 0.0:
        return speed_m_s * t_s + 0.5 * gravity_m_s2 * t_s * t_s, speed_m_s + gravity_m_s2 * t_s
    if drag_1_m == 0.0:
        decayed = -math.expm1(-alpha_1_s * t_s) / alpha_1_s
        path = speed_m_s * decayed + gravity_m_s2 * (t_s - decayed) / alpha_1_s
        return path, speed_m_s * math.exp(-alpha_1_s * t_s) + gravity_m_s2 * decayed
    limit = math.sqrt(gravity_m_s2 / drag_1_m)
    rate = gravity_m_s2 / limit
    start, risen_by, t = 0.0, 0.0, t_s
    if speed_m_s >= 0.0:
        start = math.atanh(speed_m_s / limit)
    else:
        angle = math.atan(speed_m_s / limit)
        if t_s <= -angle / rate:
            now = angle + rate * t_s
            path = math.log(math.cos(angle) / math.cos(now)) / drag_1_m
            return path, limit * math.tan(now)
        t, risen_by = t_s + angle / rate, math.log(math.cos(angle)) / drag_1_m
    path = math.log(math.cosh(start + rate * t) / math.cosh(start)) / drag_1_m
    return risen_by + path, limit * math.tanh(start + rate * t)
