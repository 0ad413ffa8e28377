"""How does friction's spring at one point stick and give way over a step?"""

from __future__ import annotations

import math

from ..compiled import njit


@njit
def tangential_stiffness(kt: float, scale: float, series: float) -> float:
    """The tangential spring seen through the compliance ``series``; infinite where both allow."""
    stiffness = scale * kt
    return 1.0 / (1.0 / stiffness + series) if series > 0.0 else stiffness


@njit
def friction_force(
    stiffness: float,
    limit: float,
    e0: float,
    e1: float,
    slip0: float,
    slip1: float,
    part: float,
    soft: float,
    m0: float,
    m1: float,
) -> tuple[float, float, float, bool]:
    """Friction (2,) by return mapping, d T / d slip while it sticks, and whether it slides.

    (e0, e1) is the spring's elongation at the start, (slip0, slip1) the change of drive over the
    step, ``part`` the share of it after which the law is asked (½ or 1), ``limit`` is μ N.
    """
    compliance = part * soft
    if not math.isinf(stiffness):
        compliance += 1.0 / stiffness
    t0 = (e0 + part * (slip0 + soft * m0)) / compliance
    t1 = (e1 + part * (slip1 + soft * m1)) / compliance
    size = math.hypot(t0, t1)
    if size <= limit:
        return t0, t1, part / compliance, False
    return limit * t0 / size, limit * t1 / size, part / compliance * limit / size, True
