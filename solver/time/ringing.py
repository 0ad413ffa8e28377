"""Ringing of a body in flight, as far as it matters. Compiled.

What cannot reach the ground is not evaluated: it lessens the clearance by its bound.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..arrays import Array
from ..compiled import njit
from .motion import Motion

SAMPLES_PER_PERIOD = 16
# Oscillations below this share of the largest do not set the shortest step.
LOUD = 1e-3
# Ringing stays out of sight while it is less than this share of the clearance.
OUT_OF_SIGHT = 0.25
# Exponents below which an exponential is nothing.
GONE = -80.0
# What ringing may be left out where roots and maxima are refined: rounding.
ROUNDING_M = 1e-13
# Steps of a search after which ringing that has died away is left out.
COMPACT_EVERY = 8


class Ring(NamedTuple):
    """Some exponentials of a motion, and what they do to k coordinates.

    Coordinate c moves by Σ exp(``decay`` t) (``cosine`` cos(``pitch`` t) - ``sine`` sin(…)), the
    tables (e, k). From the time on that the ring was made for, those from the j-th on together move
    no more than ``beyond[j]`` along the ground's normal, those before it have second derivatives
    below ``bend[j]`` along it, and reach ``wide[j]`` and speed ``rush[j]`` anywhere. ``finest`` is
    a time that resolves the fastest that is not much quieter than the largest, ``slant`` bounds the
    sine of the angle between the axis and the normal.
    """

    decay: Array
    pitch: Array
    cosine: Array
    sine: Array
    beyond: Array
    bend: Array
    wide: Array
    rush: Array
    finest: float
    slant: float


@njit
def grown(power: complex, t: float) -> float:
    """The size of exp(``power`` t)."""
    exponent = power.real * t
    return math.exp(exponent) if exponent > GONE else 0.0


@njit
def ring_of(
    motion: Motion, t: float, allowed: float, slant: float, along: Array, with_speed: Array
) -> Ring:
    """The ring of coordinates ``along`` and ``with_speed`` (k, modes) from ``t`` on.

    What is left out moves nothing by more than ``allowed``. ``slant`` bounds the share of motion
    across the axis that is motion along the ground's normal.
    """
    powers, e = motion.powers, len(motion.powers)
    swing = np.empty(e)
    for j in range(e):
        swing[j] = motion.reach[j] * grown(powers[j], t)
    least = _quiet_level(swing, allowed)
    chosen = np.empty(e, dtype=np.int64)
    count = 0
    for j in range(e):
        if swing[j] > least:
            chosen[count] = j
            count += 1
    k = len(along)
    decay, pitch = np.empty(count), np.empty(count)
    cosine, sine = np.empty((count, k)), np.empty((count, k))
    beyond, bend = np.zeros(count + 1), np.zeros(count + 1)
    wide, rush = np.zeros(count + 1), np.zeros(count + 1)
    quick = with_speed.size > 0
    largest, fastest = swing.max() if e else 0.0, 0.0
    for j in range(count):
        i = chosen[j]
        power, amount, mode = powers[i], motion.amounts[i], motion.modes[i]
        decay[j], pitch[j] = power.real, power.imag
        for c in range(k):
            cosine[j, c] = along[c, mode] * amount.real
            sine[j, c] = along[c, mode] * amount.imag
        if quick:
            pushed = power * amount
            for c in range(k):
                cosine[j, c] += with_speed[c, mode] * pushed.real
                sine[j, c] += with_speed[c, mode] * pushed.imag
        size = math.sqrt(power.real * power.real + power.imag * power.imag)
        up = swing[i]
        if swing[i] > 0.0:
            up = min(up, up * (motion.reach_up[i] / motion.reach[i] + slant))
        beyond[j] = up
        bend[j + 1] = bend[j] + up * size * size
        wide[j + 1] = wide[j] + swing[i]
        rush[j + 1] = rush[j] + swing[i] * size
        if swing[i] > LOUD * largest:
            fastest = max(fastest, abs(power.imag))
    for j in range(count - 1, -1, -1):
        beyond[j] += beyond[j + 1]
    spin = motion.spin
    fastest = max(fastest, math.sqrt(spin[0] ** 2 + spin[1] ** 2 + spin[2] ** 2))
    finest = 2.0 * math.pi / fastest / SAMPLES_PER_PERIOD if fastest > 0.0 else math.inf
    return Ring(decay, pitch, cosine, sine, beyond, bend, wide, rush, finest, slant)


@njit
def _quiet_level(swing: Array, allowed: float) -> float:
    """A level such that all ``swing`` (e,) up to it together are no more than ``allowed``."""
    level = allowed / max(len(swing), 1)
    while level > 0.0:
        total = 0.0
        for j in range(len(swing)):
            if swing[j] <= 2.0 * level:
                total += swing[j]
        if total > allowed or 2.0 * level > allowed:
            return level
        level *= 2.0
    return 0.0


@njit
def in_sight(ring: Ring, clear: float) -> int:
    """How many exponentials must be evaluated for the others to be out of sight of ``clear``."""
    count = len(ring.decay)
    allowed = OUT_OF_SIGHT * clear
    while count > 0 and ring.beyond[count - 1] <= allowed:
        count -= 1
    return count


@njit
def coordinates(ring: Ring, count: int, t: float, moved: Array, speed: Array) -> None:
    """Write the coordinates (k,) and their rates by the first ``count`` exponentials."""
    moved[:] = 0.0
    speed[:] = 0.0
    k = len(moved)
    for j in range(count):
        exponent = ring.decay[j] * t
        if exponent < GONE:
            continue
        size = math.exp(exponent)
        c, s = size, 0.0
        if ring.pitch[j] != 0.0:
            c, s = size * math.cos(ring.pitch[j] * t), size * math.sin(ring.pitch[j] * t)
        dc = ring.decay[j] * c - ring.pitch[j] * s
        ds = ring.decay[j] * s + ring.pitch[j] * c
        for a in range(k):
            moved[a] += ring.cosine[j, a] * c - ring.sine[j, a] * s
            speed[a] += ring.cosine[j, a] * dc - ring.sine[j, a] * ds


@njit
def _product(rows: Array, x: Array, out: Array) -> None:
    """Write ``rows`` @ ``x``; of many columns by BLAS, of few without its overhead."""
    if rows.shape[1] > 16:
        out[:] = rows @ x
        return
    for i in range(len(rows)):
        total = 0.0
        for c in range(rows.shape[1]):
            total += rows[i, c] * x[c]
        out[i] = total


@njit
def swung(motion: Motion, ring: Ring, count: int, rows: Array, t: float) -> tuple[Array, Array]:
    """Displacement of every point (3 n,) in body axes and its rate, as the ``ring`` sees it."""
    k = ring.cosine.shape[1]
    moved, speed = np.empty(k), np.empty(k)
    coordinates(ring, count, t, moved, speed)
    if rows.size == 0:
        return moved, speed
    places, rates = np.empty(len(rows)), np.empty(len(rows))
    _product(rows, moved, places)
    _product(rows, speed, rates)
    return places, rates
