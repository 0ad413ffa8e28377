"""What does the film of one bounce say that does not hang on when its bristle was let go?

A track is at rest at y0, falls along a parabola, and rises along another; the impact between them
is too short to be seen. Seven numbers say all: the instant at which the fall's parabola is highest
and y0, which are nuisances, and five features (`FEATURES`), ratios that are plain where nothing is
missing:

- ``r``, the height of the rise over y0;
- ``a``, the logarithm of the rise's gravity over g;
- ``d``, the time from that instant to where the rise leaves the zero of heights, over √(2 y0/g);
- ``b``, the logarithm of the fall's gravity over g;
- ``h``, how far above y0 the fall's parabola is highest, over y0.

A bristle let go at rest falls from y0 at once: h is zero. One that is let go with a speed v, up or
down, falls as if from v²/(2 g) higher, and from another instant. That shows what the speed does to
second order alone, as v_i² = v² + 2 g y0 does; to first order it is another time of release. The
few frames between the release and that instant, which would tell up from down, are not used.

Few films tell all five: at 25 frames/s a fall from 50 mm has two or three frames. So a drop is not
reduced to estimates but to rows: the frames' least squares at the best track, linear there, the
nuisances projected out, and of the features as many orthonormal combinations as the frames know
(C. D. Rodgers, Inverse Methods for Atmospheric Sounding (2000), ch. 2: measurement space). The weak
prior that helps to find the best track is not in the rows, so it biases nothing but the place about
which they are linear.

Exposure and rolling shutter are left out: a frame is an instant, the same for all its lines.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...solver.bristle import Array

FEATURES = ("r", "a", "d", "b", "h")
PLAIN = np.array([0.0, 1.0, 0.0, 0.0])
"""a, d, b and h where nothing is missing."""
LOOSE = 0.1
"""How far from that the best track is looked for, as a standard deviation."""
LEAST_KNOWN = 5.0
"""A row is kept where its feature's error is less than one over this."""
RIVAL = 8.0
"""By how much the sum of squares of the best track must be less than any other's."""
APART_S = 0.004
LEAST_RISE = 1e-3
NEAR_RELEASE_S = 0.02
"""Frames nearer than that to the release, and more where it is fast, are not used."""
ZERO_M, ZERO_SHARE = 4e-3, 0.15
"""How far the surface may lie from the zero of heights, in m and as a share of y0: frames lower
than that might be on either side of an impact, and are not used."""
REST, FALL, RISE, UNUSED = range(4)
Phases = NDArray[np.int64]
BOUNCES = 6
CAP = 25.0
TURNS = 60


@dataclass(frozen=True)
class Film:
    """Frames of one drop: ``t_s``, ``y_m`` (frames,), their deviations in m and s, and gravity."""

    t_s: Array
    y_m: Array
    sigma_y_m: float
    sigma_t_s: float
    gravity_m_s2: float


@dataclass(frozen=True)
class Track:
    """The best track of a film and its rows.

    ``start_s`` of the fall, ``y0_m`` and ``features`` (5,) are those of the best track, and
    ``values`` (rows,) = ``weights`` (rows, 5) @ features + unit noise. ``leading`` (rows,) numbers
    the feature that a row is about, ``known`` (rows,) how well it tells it. ``misfit`` is the sum
    of squares that the ``freedom`` other combinations of frames leave.
    """

    start_s: float
    y0_m: float
    features: Array
    values: Array
    weights: Array
    leading: NDArray[np.int64]
    known: Array
    misfit: float
    freedom: int


def positions(p: Array, t_s: Array, phase: Phases, gravity_m_s2: float) -> Array:
    """Heights (frames,) for p = (start of the fall, y0, features) in each frame's phase."""
    start, y0, r, a, d, b, h = p
    since = t_s - start
    fall = y0 * (1.0 + h) - 0.5 * gravity_m_s2 * np.exp(b) * since**2
    slowing = gravity_m_s2 * np.exp(a)
    launched = since - d * np.sqrt(2.0 * y0 / gravity_m_s2)
    rise = np.sqrt(2.0 * slowing * max(r, LEAST_RISE) * y0) * launched - 0.5 * slowing * launched**2
    return np.asarray(np.choose(phase, [np.full_like(t_s, y0), fall, rise, np.zeros_like(t_s)]))


def events(p: Array, gravity_m_s2: float) -> tuple[float, float, float]:
    """Times at which the fall comes to zero, the rise leaves it, and comes back to it."""
    start, y0, r, a, d, b, h = p
    touch = start + np.sqrt(2.0 * y0 * max(1.0 + h, 0.1) / (gravity_m_s2 * np.exp(b)))
    launch = start + d * np.sqrt(2.0 * y0 / gravity_m_s2)
    aloft = 2.0 * np.sqrt(2.0 * max(r, LEAST_RISE) * y0 / (gravity_m_s2 * np.exp(a)))
    return float(touch), float(launch), float(launch + aloft)


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


def reduced(film: Film, p: Array, t_s: Array, y_m: Array, phase: Phases) -> Track:
    """Rows of frames at ``t_s`` near the track ``p`` (7,)."""
    sigma = _deviation(film, p, t_s, phase)
    slopes = _slopes(film, p, t_s, phase) / sigma[:, None]
    left = (y_m - positions(p, t_s, phase, film.gravity_m_s2)) / sigma
    frame, _ = np.linalg.qr(slopes[:, :2])
    rest = slopes[:, 2:] - frame @ (frame.T @ slopes[:, 2:])
    basis: list[Array] = []
    leading, known = [], []
    for k in range(len(FEATURES)):
        column = rest[:, k]
        for _ in range(2):  # once more against rounding
            for each in (*frame.T, *basis):
                column = column - each * (each @ column)
        size = float(np.linalg.norm(column))
        if size > LEAST_KNOWN:
            basis.append(column / size)
            leading.append(k)
            known.append(size)
    rows = np.array(basis).reshape(-1, len(t_s))
    weights = rows @ slopes[:, 2:]
    every = np.vstack([frame.T, rows])
    beyond = left - every.T @ (every @ left)
    return Track(
        start_s=float(p[0]),
        y0_m=float(p[1]),
        features=p[2:].copy(),
        values=rows @ left + weights @ p[2:],
        weights=weights,
        leading=np.array(leading, dtype=np.int64),
        known=np.array(known),
        misfit=float(beyond @ beyond),
        freedom=len(t_s) - len(every),
    )


def _slopes(film: Film, p: Array, t_s: Array, phase: Phases) -> Array:
    """Derivatives (frames, 7) of `positions`."""
    g = film.gravity_m_s2
    start, y0, r, a, d, b, h = p
    since, fast = t_s - start, g * np.exp(b)
    slowing, unit = g * np.exp(a), np.sqrt(2.0 * y0 / g)
    rise = max(r, LEAST_RISE)
    up, after = np.sqrt(2.0 * slowing * rise * y0), since - d * unit
    speed = up - slowing * after
    none, one = np.zeros_like(t_s), np.ones_like(t_s)
    resting = (none, one, none, none, none, none, none)
    falling = (fast * since, one * (1.0 + h), none, none, none, -0.5 * fast * since**2, one * y0)
    rising = (
        -speed,
        0.5 * (up * after - speed * d * unit) / y0,
        0.5 * up * after / rise,
        0.5 * (up - slowing * after) * after,
        -speed * unit,
        none,
        none,
    )
    parts = np.stack([np.stack(each, axis=1) for each in (resting, falling, rising)])
    return np.asarray(parts[phase, np.arange(len(t_s))])


def _deviation(film: Film, p: Array, t_s: Array, phase: Phases) -> Array:
    """Standard deviations (frames,) in m, with what an error of the time moves."""
    speed = _slopes(film, p, t_s, phase)[:, 0]
    return np.asarray(np.hypot(film.sigma_y_m, film.sigma_t_s * speed))


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
    sigma = _deviation(film, p, t, part)
    loose = np.array([0.0, 0.0, 0.1, *(1.0 / LOOSE for _ in PLAIN)])
    usual = np.array([0.0, 0.0, 0.5, *PLAIN])

    def left(q: Array) -> Array:
        seen = positions(q, t, part, film.gravity_m_s2)
        return np.concatenate([(y - seen) / sigma, loose * (usual - q)])

    now, damping = left(p), 1e-4
    for _ in range(TURNS):
        slopes = np.vstack([_slopes(film, p, t, part) / sigma[:, None], np.diag(loose)])
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
