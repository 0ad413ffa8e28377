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
LEAST_KNOWN = 5.0
"""A row is kept where its feature's error is less than one over this."""
LEAST_RISE = 1e-3
REST, FALL, RISE, UNUSED = range(4)
Phases = NDArray[np.int64]


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


def reduced(film: Film, p: Array, t_s: Array, y_m: Array, phase: Phases) -> Track:
    """Rows of frames at ``t_s`` near the track ``p`` (7,)."""
    sigma = deviation(film, p, t_s, phase)
    slopes = derivatives(film, p, t_s, phase) / sigma[:, None]
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


def derivatives(film: Film, p: Array, t_s: Array, phase: Phases) -> Array:
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


def deviation(film: Film, p: Array, t_s: Array, phase: Phases) -> Array:
    """Standard deviations (frames,) in m, with what an error of the time moves."""
    speed = derivatives(film, p, t_s, phase)[:, 0]
    return np.asarray(np.hypot(film.sigma_y_m, film.sigma_t_s * speed))
