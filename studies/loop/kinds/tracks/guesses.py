"""Where a film's first impact may be: pairs of parabolas about instants that are tried in turn.

With the instant given, two parabolas of one gravity that meet at the surface are fitted, before
which the body may be held and after which it bounces on by the same ratio.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .....solver.arrays import Array
from .....solver.compiled import njit
from .flight import bouncing
from .rows import Film

CAP = 25.0
"""The most that a frame's square counts."""
LATER = 0.2
"""Weight of the frames after the second impact, whose bounces are guessed by the first."""
LEAST_FRAMES, MOST_FRAMES = 5, 400
"""Of a film: with more, every second or third is enough to try instants."""
LOW = 0.35
"""Frames lower than that, as a share of the heights' range, may be beside an impact."""
SHORT_FRAMES = 8
"""With fewer frames in the fall from a film's greatest height an impact may be between any two."""
RATIOS = (0.15, 0.4, 0.65, 0.9)


@dataclass(frozen=True)
class Guess:
    """Two parabolas: instant of the impact, speeds before and after, surface, gravity."""

    cost: float
    t_s: float
    before_m_s: float
    after_m_s: float
    floor_m: float
    gravity_m_s2: float

    @property
    def ratio(self) -> float:
        """Of the squares of the speeds."""
        return (self.after_m_s / self.before_m_s) ** 2


def guesses(film: Film, gravity: float, loose: float, lowest: bool = False) -> list[Guess]:
    """Pairs of parabolas about instants of the impact, the likeliest first.

    Instants are tried all through the film where its frames are so few that an impact may be
    between any two; beside the ``lowest`` frames alone, where that is asked for or they are many.
    """
    every = -(-len(film.t_s) // MOST_FRAMES)
    t, y = film.t_s[::every], film.y_m[::every]
    high = float(np.ptp(y))
    if high <= 0.0 or len(t) < LEAST_FRAMES:
        return []
    frame = float(np.median(np.diff(t)))
    lasts = np.sqrt(2.0 * high / gravity)
    step = min(frame / 4.0, lasts / 40.0)
    if lowest or lasts > SHORT_FRAMES * frame:
        before = int(lasts / (2.0 * frame)) + 1
        low = [i for i in np.flatnonzero(y < y.min() + LOW * high) if _is_lowest(y, i, before)]
        tried = [np.arange(t[max(i - 1, 0)], t[min(i + 1, len(t) - 1)], step) for i in low]
        instants = np.concatenate(tried) if tried else np.zeros(0)
    else:
        instants = np.arange(t[0], t[-1], step)
    sigma = np.hypot(film.sigma_y_m, 0.01 * high)
    sigma = np.hypot(sigma, 0.5 * step * np.sqrt(2.0 * gravity * high))
    floor = np.array([film.floor_m, film.floor_loose_m])
    made = _parabolas(t, y, sigma, instants, step, np.array([gravity, loose * gravity]), floor)
    order = np.argsort(made[:, 0])
    return [
        Guess(float(made[i, 0]), float(instants[i]), *(float(x) for x in made[i, 1:]))
        for i in order
        if np.isfinite(made[i, 0])
    ]


def _is_lowest(y: Array, i: int, before: int) -> bool:
    """Whether no frame next to i, or beyond it, is lower, and some of those ``before`` it are so
    much higher that the body is not at rest."""
    fell = y[max(i - before, 0) : i + 1].max() > y.min() + 0.1 * (y.max() - y.min())
    return bool(fell and y[i] <= y[max(i - 2, 0) : i + 3].min())


@njit
def _parabolas(
    t: Array, y: Array, sigma: float, instants: Array, step: float, gravity: Array, floor: Array
) -> Array:
    """For each instant of the impact (instants, 5): the cost, the speeds before and after, the
    surface and gravity; the cost is infinite where none fit. ``gravity`` and ``floor`` are what is
    expected and how loosely."""
    out = np.full((len(instants), 5), np.inf)
    for n in range(len(instants)):
        for ratio in RATIOS:
            for held in (True, False):
                x = np.array([0.0, 0.0, floor[0], gravity[0]])
                cost = _fitted(t, y, sigma, instants[n], step, ratio, held, gravity, floor, x)
                if cost < out[n, 0]:
                    out[n, 0] = cost
                    out[n, 1:] = x
    return out


@njit
def _fitted(
    t: Array,
    y: Array,
    sigma: float,
    impact: float,
    step: float,
    ratio: float,
    held: bool,
    gravity: Array,
    floor: Array,
    x: Array,
) -> float:
    """Fits speeds before and after, surface and gravity, x (4,), in place; gives the cost."""
    since = impact - t[0]
    margin = 0.5 * step
    if since <= margin:
        return np.inf
    above = y[0] - floor[0]
    x[0] = above / since + 0.5 * x[3] * since
    if held and x[0] < x[3] * since:
        x[0] = np.sqrt(2.0 * x[3] * max(above, 1e-9))
    if x[0] <= 0.0:
        return np.inf
    x[1] = np.sqrt(ratio) * x[0]
    for _ in range(3):
        normal, right = np.zeros((4, 4)), np.zeros(4)
        falls, rises = 0, 0
        for i in range(len(t)):
            row = np.zeros(4)
            tau = impact - t[i]
            if tau > margin:
                falls += not (held and tau > x[0] / x[3])
                before = min(tau, x[0] / x[3]) if held else tau
                row[0], row[3] = before, -0.5 * before * before
            elif tau < -margin and -tau < 2.0 * x[1] / x[3] - margin:
                row[1], row[3] = -tau, -0.5 * tau * tau
                rises += 1
            else:
                continue
            row[2] = 1.0
            residual = (y[i] - x[2] - _height(tau, held, x)) / sigma
            for k in range(4):
                right[k] += row[k] / sigma * residual
                for m in range(4):
                    normal[k, m] += row[k] * row[m] / sigma**2
        if rises == 0 or falls == 0:
            return np.inf
        normal[2, 2] += 1.0 / floor[1] ** 2
        right[2] += (floor[0] - x[2]) / floor[1] ** 2
        normal[3, 3] += 1.0 / gravity[1] ** 2
        right[3] += (gravity[0] - x[3]) / gravity[1] ** 2
        for k in range(4):
            normal[k, k] *= 1.0 + 1e-9
        x += np.linalg.solve(normal, right)
        if not (x[0] > 0.0 and x[1] > 0.0 and x[3] > 0.2 * gravity[0]):
            return np.inf
        x[3] = min(x[3], 5.0 * gravity[0])
    cost = ((x[2] - floor[0]) / floor[1]) ** 2 + ((x[3] - gravity[0]) / gravity[1]) ** 2
    later = np.sqrt(sigma**2 + (0.05 * x[0] ** 2 / (2.0 * x[3])) ** 2)
    for i in range(len(t)):
        tau = impact - t[i]
        weight, error = 1.0, sigma
        if tau > 0.0 or -tau < 2.0 * x[1] / x[3]:
            height = _height(tau, held, x)
        else:
            weight, error = LATER, later
            ratio_seen = min((x[1] / x[0]) ** 2, 1.0)
            rest, v = -tau - 2.0 * x[1] / x[3], x[1] * np.sqrt(ratio_seen)
            height = bouncing(rest, v, ratio_seen, x[3])
        cost += weight * min(((y[i] - x[2] - height) / error) ** 2, CAP)
    return cost


@njit
def _height(tau: float, held: bool, x: Array) -> float:
    """Over the surface, ``tau`` before the impact (negative: after it)."""
    if tau <= 0.0:
        return -x[1] * tau - 0.5 * x[3] * tau * tau
    if held:
        tau = min(tau, x[0] / x[3])
    return x[0] * tau - 0.5 * x[3] * tau * tau
