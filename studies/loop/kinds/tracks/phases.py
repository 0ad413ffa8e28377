"""What each frame of a film shows: the body held, its fall, a rise, or nothing that is sure."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .....solver.arrays import Array
from .flight import FALL, HEAD, HELD, RISE, UNUSED, Phases, fall_of, rises_of
from .rows import Film

NEAR_RELEASE_S = 0.02
"""Frames nearer than that to the release, and more where it is fast, are not used: a hand opens."""
NEAR_IMPACT_S = 1e-3
ZERO_M, ZERO_SHARE = 2e-3, 0.1
"""How far the surface may lie from where it seems, in m and as a share of the fall's height:
frames that pass that in less time may be on either side of an impact, and are not used."""
ON_PARABOLA = 0.1
"""How far frames before the highest point may be from the fall's parabola, as a share of how far
below that point they are, for a body that was let go before them."""
MOVING = 3.5
"""Standard errors from none beyond which a body that is held is moved, and not used until it falls.
"""
LEAST_HELD = 3
LEAST_RATIO = 0.01
"""Of the squares of speeds: with less the body stays."""


def phases(film: Film, p: Array) -> tuple[Phases, bool]:
    """What each frame (frames,) shows, and whether some show the body held.

    None near the release, an impact or a mistaken mark serves.
    """
    t, g = film.t_s, film.gravity_m_s2
    top_s, top_m, falling, _ = fall_of(p, g)
    rises = rises_of(p, g)
    phase = np.full(len(t), UNUSED)
    end = p[0] - _near(film, p[1]) if len(rises) else np.inf
    phase[t < end] = FALL
    before = t < top_s - NEAR_RELEASE_S
    level = np.median(film.y_m[before]) if before.any() else top_m
    early = NEAR_RELEASE_S + math.sqrt(2.0 * max(top_m - float(level), 0.0) / falling)
    # thrown up in view, the parabola has its highest point in the film
    below, gap = top_m - film.y_m[before], 0.5 * falling * (t[before] - top_s) ** 2
    thrown = before.sum() >= LEAST_HELD and np.median(np.abs(below - gap)) < max(
        ON_PARABOLA * np.median(np.abs(below)), film.sigma_y_m
    )
    held = False
    if not thrown:
        phase[t < top_s + early] = UNUSED
        if (t < top_s - early).sum() >= LEAST_HELD or t[0] < top_s - early - 0.02:
            still = _is_still(film, t < top_s - early)
            phase[t < top_s - early] = HELD if still else UNUSED
            held = still
    for j in range(len(rises)):
        launch, before_m_s, again = rises[j, 1], rises[j, 5], rises[j, 6]
        near = _near(film, before_m_s)
        ratio = max(p[len(HEAD) + 3 * j], LEAST_RATIO)
        back = near / np.sqrt(ratio) + 0.01 * (again - launch)
        phase[(t > launch + near) & (t < again - back)] = RISE + j
    return phase, held


def _is_still(film: Film, held: NDArray[np.bool_]) -> bool:
    """Whether a line through heights before the release is level, within their own scatter."""
    t_s, y_m = film.t_s[held], film.y_m[held]
    if len(t_s) <= LEAST_HELD:
        return bool(np.ptp(y_m) < 2.0 * MOVING * film.sigma_y_m)
    since = t_s - t_s.mean()
    slope = float(since @ y_m) / float(since @ since)
    residual = y_m - y_m.mean() - slope * since
    sigma = math.sqrt(float(residual @ residual) / (len(t_s) - 2) / float(since @ since))
    return abs(slope) < MOVING * max(sigma, film.sigma_y_m / math.sqrt(float(since @ since)))


def _near(film: Film, speed_m_s: float) -> float:
    """How long before or after an impact a frame may be on either side of it."""
    g = film.gravity_m_s2
    low = 3.0 * film.sigma_y_m + min(ZERO_M, ZERO_SHARE * speed_m_s**2 / (2.0 * g))
    return NEAR_IMPACT_S + 3.0 * film.sigma_t_s + low / max(speed_m_s, 1e-3)
