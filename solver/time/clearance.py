"""Clearance of a body in flight over the ground, and a time without touch. Compiled.

An instant with clearance c, rate c' and a bound M on the second derivative is followed by a time in
which c + c' t - ½ M t² stays positive (conservative advancement: Mirtich, PhD thesis, Berkeley
1996).
"""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Array
from ..compiled import njit
from ..rigid import fallen, free_rotation, matrix_of
from .motion import Motion
from .ringing import Ring, coordinates, ring_of, swung


@njit
def _turning(places: Array, inertia: Array, spin: Array) -> float:
    """A bound on the acceleration of any of ``places`` (n, 3) by turning.

    On the axis what a spin about it does to the tumbling nearly cancels what it does to a point
    that tumbles; off it, every term counts.
    """
    far, wide = 0.0, 0.0
    for i in range(len(places)):
        wide = max(wide, math.sqrt(places[i, 0] ** 2 + places[i, 1] ** 2))
        far = max(far, abs(places[i, 2]))
    x, y, z = spin[0], spin[1], spin[2]
    dx = (inertia[1] - inertia[2]) * y * z / inertia[0] if inertia[0] > 0.0 else 0.0
    dy = (inertia[2] - inertia[0]) * z * x / inertia[1] if inertia[1] > 0.0 else 0.0
    dz = (inertia[0] - inertia[1]) * x * y / inertia[2] if inertia[2] > 0.0 else 0.0
    tumbling = x * x + y * y
    on_axis = math.sqrt((dy + x * z) ** 2 + (dx - y * z) ** 2 + tumbling * tumbling)
    off_axis = tumbling + z * z + math.sqrt(dx * dx + dy * dy + dz * dz)
    return far * on_axis + wide * off_axis


@njit
def bending_bound(
    motion: Motion, ring: Ring, count: int, t: float, places: Array, spin: Array
) -> float:
    """A bound on the second derivative of the clearance of ``places`` (n, 3), by all that was
    evaluated."""
    alpha, v, x, y, z = motion.flyer.alpha, motion.velocity, spin[0], spin[1], spin[2]
    size, tumbling = math.sqrt(x * x + y * y + z * z), math.sqrt(x * x + y * y)
    total = motion.gravity + _turning(places, motion.flyer.inertia, spin) + ring.bend[count]
    # what rings across the axis comes along the normal as the axis turns, or the body about it
    swept = tumbling + abs(z) * ring.slant
    total += 2.0 * swept * (ring.rush[count] + (size + alpha) * ring.wide[count])
    if alpha > 0.0:
        total += motion.gravity + alpha * math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
        total += alpha * size * math.sqrt((places**2).sum(axis=1).max())
    return total


@njit
def time_ahead(clear: float, rate: float, bending: float) -> float:
    """The time in which clear + rate t - ½ bending t² stays positive."""
    if clear <= 0.0:
        return 0.0
    inside = rate * rate + 2.0 * bending * clear
    if inside < 0.0:
        return math.inf
    root = math.sqrt(inside)
    if rate <= 0.0:
        return 2.0 * clear / (root - rate) if root > rate else math.inf
    return (rate + root) / bending if bending > 0.0 else math.inf


@njit
def slant_bound(motion: Motion, attitude: Array, normals: Array, time: float) -> float:
    """A bound for ``time`` on the sine of the angle between the axis and the ``normals``."""
    spin, rotation = motion.spin, matrix_of(attitude)
    most = 0.0
    for i in range(len(normals)):
        along = 0.0
        for c in range(3):
            along += normals[i, c] * rotation[c, 2]
        most = max(most, math.sqrt(max(1.0 - along * along, 0.0)))
    # the axis of a top that is not quite symmetric does not turn at quite the same rate
    return min(1.0, most + 1.1 * time * math.sqrt(spin[0] ** 2 + spin[1] ** 2))


@njit
def clearance_of(
    motion: Motion,
    ring: Ring,
    count: int,
    rows: Array,
    normals: Array,
    offsets: Array,
    t: float,
    attitude: Array,
    spin: Array,
    slack: float,
    bending: float,
) -> tuple[float, float, float]:
    """The smallest clearance of any point from its plane, its rate, and a time without touch.

    For the time, clearances are less by ``slack`` and their second derivatives -``bending``.
    """
    flyer = motion.flyer
    position, velocity = fallen(motion.position, motion.velocity, motion.gravity, flyer.alpha, t)
    rotation = matrix_of(attitude)
    places = flyer.places
    moved, speed = swung(motion, ring, count, rows, t)
    least, falls, safe = math.inf, 0.0, math.inf
    n0 = n1 = n2 = w0 = w1 = w2 = height = rise = 0.0
    for i in range(len(places)):
        same = i > 0
        for c in range(3):
            same = same and normals[i, c] == normals[i - 1, c]
        if not same:
            x, y, z = normals[i, 0], normals[i, 1], normals[i, 2]
            n0 = rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z
            n1 = rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z
            n2 = rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z
            # the rate of n · (ω × q) is (n × ω) · q
            w0 = n1 * spin[2] - n2 * spin[1]
            w1 = n2 * spin[0] - n0 * spin[2]
            w2 = n0 * spin[1] - n1 * spin[0]
            height = x * position[0] + y * position[1] + z * position[2]
            rise = x * velocity[0] + y * velocity[1] + z * velocity[2]
        q0 = places[i, 0] + moved[3 * i]
        q1 = places[i, 1] + moved[3 * i + 1]
        q2 = places[i, 2] + moved[3 * i + 2]
        clear = height - offsets[i] + n0 * q0 + n1 * q1 + n2 * q2
        rate = rise + n0 * speed[3 * i] + n1 * speed[3 * i + 1] + n2 * speed[3 * i + 2]
        rate += w0 * q0 + w1 * q1 + w2 * q2
        if clear < least:
            least, falls = clear, rate
        safe = min(safe, time_ahead(clear - slack, rate, bending))
    return least, falls, safe


@njit
def tip_height(
    motion: Motion, ring: Ring, count: int, t: float, attitude: Array, spin: Array
) -> tuple[float, float]:
    """Height of the middle of the end section, and its rate."""
    flyer = motion.flyer
    position, velocity = fallen(motion.position, motion.velocity, motion.gravity, flyer.alpha, t)
    moved, speed = np.empty(3), np.empty(3)
    coordinates(ring, count, t, moved, speed)
    rotation = matrix_of(attitude)
    x, y, z = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    for c in range(3):
        moved[c] += flyer.tip_place[c]
    height = position[2] + x * moved[0] + y * moved[1] + z * moved[2]
    rate = velocity[2] + x * speed[0] + y * speed[1] + z * speed[2]
    rate += (y * spin[2] - z * spin[1]) * moved[0]
    rate += (z * spin[0] - x * spin[2]) * moved[1]
    rate += (x * spin[1] - y * spin[0]) * moved[2]
    return height, rate


@njit
def trace(motion: Motion, normals: Array, offsets: Array, times: Array) -> Array:
    """Heights of the tip's middle and of the centre, and the lowest clearance at times (k,)."""
    flyer, none = motion.flyer, np.zeros((0, 0))
    out = np.empty((len(times), 3))
    attitude, spin, before = motion.attitude, motion.spin, 0.0
    tips = ring_of(motion, 0.0, 0.0, 1.0, flyer.tip, none)
    points = ring_of(motion, 0.0, 0.0, 1.0, flyer.along, flyer.with_speed)
    count = len(points.decay)
    for i in range(len(times)):
        t = times[i]
        attitude, spin = free_rotation(attitude, spin, flyer.inertia, flyer.alpha, before, t)
        before = t
        centre, _ = fallen(motion.position, motion.velocity, motion.gravity, flyer.alpha, t)
        out[i, 0] = tip_height(motion, tips, count, t, attitude, spin)[0]
        out[i, 1] = centre[2]
        out[i, 2] = clearance_of(
            motion, points, count, flyer.rows, normals, offsets, t, attitude, spin, 0.0, 0.0
        )[0]
    return out
