"""Which track explains the film of one bounce best, and is it the only one?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...solver.bristle import Array
from .track_rows import (
    FALL,
    LEAST_RISE,
    PLAIN,
    REST,
    RISE,
    UNUSED,
    Film,
    Phases,
    Track,
    derivatives,
    deviation,
    events,
    positions,
    reduced,
)

LOOSE = 0.1
"""How far from `PLAIN` the best track is looked for, as a standard deviation."""
RIVAL = 8.0
"""By how much the sum of squares of the best track must be less than any other's."""
APART_S = 0.004
NEAR_RELEASE_S = 0.02
"""Frames nearer than that to the release, and more where it is fast, are not used."""
ZERO_M, ZERO_SHARE = 4e-3, 0.15
"""How far the surface may lie from the zero of heights, in m and as a share of y0: frames lower
than that might be on either side of an impact, and are not used."""
BOUNCES = 6
CAP = 25.0
TURNS = 60


def track(film: Film) -> Track | None:
    """The best track of a film.

    None where no frame shows the rest, too few the bounce, or two tracks that differ fit alike:
    what a frame is, fall or rise, is then a guess.
    """
    found = [each for each in (_settled(film, start) for start in _starts(film)) if each]
    if not found:
        return None
    found.sort(key=lambda each: each[0])
    cost, p, phase = found[0]
    for other, q, _ in found[1:]:
        if other < cost + RIVAL and abs(q[0] - p[0]) > APART_S:
            return None
    used = phase != UNUSED
    return reduced(film, p, film.t_s[used], film.y_m[used], phase[used])


def _phases(film: Film, p: Array) -> Phases:
    """What each frame (frames,) shows; none near the release or an impact serves."""
    touch, launch, again = events(p, film.gravity_m_s2)
    speed = np.sqrt(2.0 * film.gravity_m_s2 * p[1])
    low = min(ZERO_M, ZERO_SHARE * p[1]) + 3.0 * film.sigma_y_m
    near = low / speed + 3.0 * film.sigma_t_s + 1e-3
    back = near / np.sqrt(max(p[2], LEAST_RISE)) + 0.01 * (again - launch)
    early = NEAR_RELEASE_S + np.sqrt(2.0 * max(p[6], 0.0) * p[1] / film.gravity_m_s2)
    t, phase = film.t_s, np.full(len(film.t_s), UNUSED)
    phase[t < p[0] - early] = REST
    phase[(t > p[0] + early) & (t < touch - near)] = FALL
    phase[(t > max(launch, touch) + near) & (t < again - back)] = RISE
    phase[film.y_m < low] = UNUSED
    return phase


def _settled(film: Film, start: Array) -> tuple[float, Array, Phases] | None:
    """The cost of the best track near ``start``, that track, and its frames' phases."""
    p = start
    for _ in range(3):
        phase = _phases(film, p)
        used = phase != UNUSED
        if not (phase == RISE).any() or used.sum() < 3 or not (phase == REST).any():
            return None
        p = _least(film, p, used, phase)
        if p[1] <= 0.0 or p[2] <= LEAST_RISE:
            return None
    return _cost(film, p), p, phase


def _least(film: Film, p: Array, used: NDArray[np.bool_], phase: Phases) -> Array:
    """The track (7,) of least squares over the frames used, by Levenberg's and Marquardt's way."""
    t, y, part = film.t_s[used], film.y_m[used], phase[used]
    sigma = deviation(film, p, t, part)
    loose = np.array([0.0, 0.0, 0.1, *(1.0 / LOOSE for _ in PLAIN)])
    usual = np.array([0.0, 0.0, 0.5, *PLAIN])

    def left(q: Array) -> Array:
        seen = positions(q, t, part, film.gravity_m_s2)
        return np.concatenate([(y - seen) / sigma, loose * (usual - q)])

    now, damping = left(p), 1e-4
    for _ in range(TURNS):
        slopes = np.vstack([derivatives(film, p, t, part) / sigma[:, None], np.diag(loose)])
        normal, push = slopes.T @ slopes, slopes.T @ now
        gained = 0.0
        while damping < 1e8 and not gained:
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), push)
            new = p + step
            new[1:3] = np.maximum(new[1:3], 0.2 * p[1:3])
            after = left(new)
            gained = max(float(now @ now - after @ after), 0.0)
            damping *= 0.1 if gained else 10.0
        if not gained:
            break
        p, now = new, after
        if gained < 1e-6:
            break
    return p


def _cost(film: Film, p: Array) -> float:
    """How badly a track fits all frames: bounded, those after its second impact counting little."""
    seen = _bouncing(film, p[0:1, None], p[1:2, None], p[2:3, None])
    _, launch, again = events(p, film.gravity_m_s2)
    early = film.t_s < again
    phase = np.where(film.t_s > launch, RISE, np.where(film.t_s > p[0], FALL, REST))
    y = np.where(early, positions(p, film.t_s, phase, film.gravity_m_s2), seen[0])
    speed = np.sqrt(2.0 * film.gravity_m_s2 * p[1])
    sigma = np.where(early, film.sigma_y_m, np.hypot(film.sigma_y_m, 0.005 * speed + 0.05 * p[1]))
    squares = np.minimum(((film.y_m - y) / sigma) ** 2, CAP)
    loose = float(np.sum(((p[3:] - PLAIN) / LOOSE) ** 2))
    return float(np.sum(np.where(early, 1.0, 0.2) * squares)) + loose


def _bouncing(film: Film, release: Array, y0: Array, r: Array) -> Array:
    """Heights (..., frames) of a point that bounces by the same share each time."""
    g = film.gravity_m_s2
    since = np.maximum(film.t_s - release, 0.0)
    y = y0 - 0.5 * g * since**2
    begin, speed = np.sqrt(2.0 * y0 / g), np.sqrt(2.0 * g * y0)
    for _ in range(BOUNCES):
        speed = speed * np.sqrt(r)
        after = since - begin
        y = np.where(after > 0.0, speed * after - 0.5 * g * after**2, y)
        begin = begin + 2.0 * speed / g
    return np.maximum(y, 0.0)


def _starts(film: Film) -> list[Array]:
    """Tracks to begin from: the best of a grid of release times and rises, three that differ."""
    t, y = film.t_s, film.y_m
    high = float(np.median(y[:3])) if len(y) > 4 else float(y[0])
    low = np.flatnonzero(y < 0.6 * high)
    if high <= 0.0 or not len(low) or low[0] == 0:
        return []
    first, unit = float(t[low[0]]), float(np.sqrt(2.0 * high / film.gravity_m_s2))
    step = float(np.median(np.diff(t)))
    begin = max(float(t[0]), first - 3.0 * unit - step)
    releases = np.linspace(begin, first, max(int((first - begin) / 1e-3), 40))
    mean = np.array([y[t <= each].mean() for each in releases])
    r = np.linspace(0.05, 1.05, 51) ** 2
    p = np.broadcast_arrays(releases[:, None, None], mean[:, None, None], r[None, :, None])
    seen = _bouncing(film, *p)
    second = p[0] + unit * (1.0 + 2.0 * np.sqrt(p[2]))
    sigma = np.hypot(film.sigma_y_m + 0.01 * high, 0.002 * np.sqrt(2 * film.gravity_m_s2 * high))
    squares = np.minimum(((y - seen) / sigma) ** 2, CAP)
    cost = np.sum(np.where(t < second, 1.0, 0.2) * squares, axis=2)
    order = np.argsort(cost.min(axis=1))
    chosen: list[int] = []
    for i in order:
        if all(abs(releases[i] - releases[j]) > 0.01 for j in chosen):
            chosen.append(int(i))
        if len(chosen) == 3:
            break
    best = [(releases[i], mean[i], r[int(np.argmin(cost[i]))]) for i in chosen]
    return [np.array([*each, *PLAIN]) for each in best]
