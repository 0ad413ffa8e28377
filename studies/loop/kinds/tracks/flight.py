"""Heights of a body that is held, falls and bounces under gravity and quadratic drag.

The impact is an instant or, between landing and launch, a short time that is not looked into. A
track of n bounces is described by `HEAD` + n `len(BOUNCE)` numbers: the instant ``t`` (s), speed
``v`` (m/s) and level ``z`` (m) at the end of the fall, then features that are zero where nothing is
missing, and for every bounce three more:

- ``h``, the height that the body is held at over z, over v²/(2 g), less one;
- ``b``, the logarithm of the fall's gravity over g;
- ``u``, drag over weight at the end of the fall;
- ``r``, the square of the speed after the bounce over that before it;
- ``a``, the logarithm of the gravity after it over g;
- ``d``, how long it touches (s).

Drag over mass and speed squared is k = u g e^b/v², of the whole track. With it a body is
g τ² F(k g τ²) below its highest point, where F(s) = ln cosh √s / s on the way down and the same
function of −s on the way up (Lamb, Dynamics (1923), §94); F and its like are analytic at zero, so
drag may come out negative.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .....solver.arrays import Array
from .....solver.compiled import njit

HEAD = ("t", "v", "z", "h", "b", "u")
BOUNCE = ("r", "a", "d")
UNUSED, HELD, FALL, RISE = -3, -2, -1, 0
"""Phases of a frame; a rise after bounce j has the phase RISE + j."""
Phases = NDArray[np.int64]
STEPS, BOUNCE_STEPS = (1e-6, 1e-5, 1e-6, 1e-5, 1e-5, 1e-5), (1e-5, 1e-5, 1e-6)
"""Of differences, for the numbers of `HEAD` and `BOUNCE`."""
LEAST_R, MOST_U = 1e-4, 0.98


@njit
def below_top(s: float) -> float:
    """F(s) of the module's description."""
    if abs(s) < 0.1:
        return 0.5 + s * (-1 / 12 + s * (1 / 45 + s * (-17 / 2520 + s * 31 / 14175)))
    if s > 0.0:
        x = math.sqrt(s)
        return (x + math.log1p(math.exp(-2.0 * x)) - math.log(2.0)) / s
    return -math.log(math.cos(min(math.sqrt(-s), 1.5))) / -s


@njit
def stretched(u: float) -> float:
    """artanh √u / √u, by which drag over weight u lengthens the time from the highest point."""
    if abs(u) < 0.05:
        return 1 + u * (1 / 3 + u * (1 / 5 + u * (1 / 7 + u * (1 / 9 + u / 11))))
    if u > 0.0:
        return math.atanh(math.sqrt(min(u, MOST_U))) / math.sqrt(min(u, MOST_U))
    return math.atan(math.sqrt(-u)) / math.sqrt(-u)


@njit
def heightened(u: float) -> float:
    """−ln(1 − u) / u, by which drag raises the highest point that a speed comes from."""
    if abs(u) < 1e-12:
        return 1.0
    return -math.log1p(-min(u, MOST_U)) / min(u, MOST_U)


@njit
def fall_of(p: Array, g: float) -> tuple[float, float, float, float]:
    """Instant and level of the fall's highest point, its gravity, and drag over mass (1/m)."""
    t, v, z, u = p[0], p[1], p[2], p[5]
    falling = g * math.exp(p[4])
    top = z + v * v / (2.0 * falling) * heightened(u)
    return t - v / falling * stretched(u), top, falling, u * falling / (v * v)


@njit
def rises_of(p: Array, g: float) -> Array:
    """For every bounce (bounces, 7): landing and launch, highest point and its level, gravity, the
    speed before, and the landing after."""
    n = (len(p) - 6) // 3
    out = np.empty((n, 7))
    k = fall_of(p, g)[3]
    t, before = p[0], p[1]
    for j in range(n):
        r, a, d = p[6 + 3 * j], p[7 + 3 * j], p[8 + 3 * j]
        slowing = g * math.exp(a)
        up = before * math.sqrt(max(r, LEAST_R))
        u = k * up * up / slowing
        high = up * up / (2.0 * slowing) * heightened(-u)
        apex = t + d + up / slowing * stretched(-u)
        x = 2.0 * k * high
        back = math.sqrt(2.0 * slowing * high * (-math.expm1(-x) / x if abs(x) > 1e-12 else 1.0))
        again = apex + back / slowing * stretched(k * back * back / slowing)
        out[j, 0], out[j, 1], out[j, 2], out[j, 3] = t, t + d, apex, p[2] + high
        out[j, 4], out[j, 5], out[j, 6] = slowing, before, again
        t, before = again, back
    return out


@njit
def heights(p: Array, t_s: Array, phase: Phases, g: float) -> Array:
    """Heights (frames,) of the track in each frame's phase; zero in those that are not used."""
    top_s, top, falling, k = fall_of(p, g)
    rises = rises_of(p, g)
    out = np.zeros(len(t_s))
    for i in range(len(t_s)):
        if phase[i] == HELD:
            out[i] = p[2] + (1.0 + p[3]) * p[1] * p[1] / (2.0 * g)
        elif phase[i] == FALL:
            since = t_s[i] - top_s
            s = k * falling * since * abs(since)
            out[i] = top - falling * since * since * below_top(s)
        elif phase[i] >= RISE:
            each = rises[phase[i]]
            since = t_s[i] - each[2]
            s = k * each[4] * since * abs(since)
            out[i] = each[3] - each[4] * since * since * below_top(s)
    return out


@njit
def bouncing(since_s: float, speed: float, ratio: float, g: float) -> float:
    """Height of a point that left with a speed and bounces by the same ratio of squares."""
    for _ in range(8):
        if since_s < 2.0 * speed / g:
            return speed * since_s - 0.5 * g * since_s * since_s
        since_s -= 2.0 * speed / g
        speed *= math.sqrt(ratio)
    return 0.0


@njit
def derivatives(p: Array, t_s: Array, phase: Phases, g: float) -> Array:
    """Derivatives (frames, numbers) of `heights`, by central differences."""
    out = np.empty((len(t_s), len(p)))
    for k in range(len(p)):
        step = STEPS[k] if k < 6 else BOUNCE_STEPS[(k - 6) % 3]
        near, far = p.copy(), p.copy()
        near[k] -= step
        far[k] += step
        after, before = heights(far, t_s, phase, g), heights(near, t_s, phase, g)
        out[:, k] = (after - before) / (2.0 * step)
    return out


def released(speed_m_s: Array, g: float, start_m_s: Array, drag_1_m: Array) -> Array:
    """Height (...,) from which a body let go with a downward speed comes to ``speed_m_s``.

    The inverse of `solver.fall.fallen`; arrays broadcast. Never less than a hundredth of what it
    is without drag.
    """
    k = np.maximum(drag_1_m, 1e-9)
    fast2 = np.minimum(k * speed_m_s**2 / g, MOST_U)
    start2 = np.minimum(k * np.asarray(start_m_s) ** 2 / g, MOST_U)
    higher = (np.log1p(-start2) - np.log1p(-fast2)) / (2.0 * k)
    return np.maximum(higher, 0.005 * speed_m_s**2 / g)
