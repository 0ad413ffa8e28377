"""The highest place of the tip of a body in flight, and its time. Compiled.

The apex is the touch with a ceiling at the best height so far, see `clearance`.
"""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Array
from ..compiled import njit
from ..rigid import fallen, free_rotation, matrix_of
from .clearance import bending_bound, slant_bound, time_ahead, tip_height
from .motion import Motion
from .ringing import COMPACT_EVERY, GONE, ROUNDING_M, Ring, in_sight, ring_of

# What ringing may be left out of the search; the maximum is refined with all but rounding.
APEX_SEARCH_M = 5e-8
# How far a maximum may rise between two samples that look for it.
APEX_SAG_M = 1e-7
LOOKS = 8
# Samples are taken eight at a time, this many in a row, while the body's turning is a series: up
# to this angle, and to this error.
LANES = 8
MOST_SAMPLES = 128
EXPANDED_RAD, EXPANDED_M = 0.02, 1e-8
REFINEMENTS = 6


@njit
def apex(motion: Motion, until: float) -> tuple[float, float]:
    """Time and height of the highest place of the tip in [0, ``until``].

    Times from which the height could not reach the best so far are stepped over, the others sampled
    so finely that no maximum rises by more than `APEX_SAG_M` between samples. A first look at where
    the slow part of the motion is highest makes the best good from the start.
    """
    flyer = motion.flyer
    up, none = np.array([[0.0, 0.0, 1.0]]), np.zeros((0, 0))
    slant = slant_bound(motion, motion.attitude, up, until)
    ring = ring_of(motion, 0.0, APEX_SEARCH_M, slant, flyer.tip, none)
    best_t = _slow_apex(motion, ring, until)
    best, width = -math.inf, 0.0
    start = ring
    for sweep in range(2):
        t = 0.0 if sweep else best_t
        attitude, spin = free_rotation(
            motion.attitude, motion.spin, flyer.inertia, flyer.alpha, 0.0, t
        )
        if sweep:
            ring = start
        age = 0
        while True:
            step = 0.0
            if sweep:
                step = _below(motion, ring, t, attitude, spin, best)
            spacing = _spacing(motion, ring, t, spin)
            if step < LANES * spacing:
                ring = ring_of(motion, t, APEX_SEARCH_M, slant, flyer.tip, none)
                height, when, spacing, step = _highest_sample(
                    motion, ring, t, attitude, spin, until, not sweep
                )
                if height > best:
                    best, best_t, width = height, when, spacing
                age = 0
            elif age == COMPACT_EVERY:
                ring = ring_of(motion, t, APEX_SEARCH_M, slant, flyer.tip, none)
                age = 0
            later = t + step
            if not sweep or later >= until:
                break
            attitude, spin = free_rotation(attitude, spin, flyer.inertia, flyer.alpha, t, later)
            t = later
            age += 1
    return _refined(motion, max(best_t - width, 0.0), best_t, min(best_t + width, until))


@njit
def _rigid_apex(motion: Motion, until: float) -> float:
    """When the centre of mass is highest in [0, ``until``]."""
    speed = motion.velocity[2]
    if speed <= 0.0:
        return 0.0
    if motion.flyer.alpha == 0.0:
        return min(speed / motion.gravity, until)
    return min(math.log1p(motion.flyer.alpha * speed / motion.gravity) / motion.flyer.alpha, until)


@njit
def _slow_apex(motion: Motion, ring: Ring, until: float) -> float:
    """About when the tip is highest in [0, ``until``], but for ringing far below its rise."""
    flyer = motion.flyer
    n_terms = in_sight(ring, 0.1 * motion.gravity * until * until / 8.0)
    top = _rigid_apex(motion, until)
    best, best_t = -math.inf, top
    start, spacing = 0.0, until / LOOKS
    rate = 0.0
    for _ in range(2):
        for i in range(LOOKS + 2):
            t = min(start + i * spacing, until) if i <= LOOKS else top
            attitude, spin = free_rotation(
                motion.attitude, motion.spin, flyer.inertia, flyer.alpha, 0.0, t
            )
            height, rises = tip_height(motion, ring, n_terms, t, attitude, spin)
            if height > best:
                best, best_t, rate = height, t, rises
        start, spacing = max(best_t - spacing, 0.0), 2.0 * spacing / LOOKS
    fall = bending_bound(motion, ring, n_terms, best_t, _tip_alone(motion), motion.spin)
    return min(max(best_t + rate / fall, 0.0), until)


@njit
def _highest_sample(
    motion: Motion, ring: Ring, t: float, attitude: Array, spin: Array, until: float, about: bool
) -> tuple[float, float, float, float]:
    """The highest of some samples of the tip's height from ``t`` on, its time, their spacing, and
    how long they last; with ``about`` from before to after ``t``.

    Exponentials go from sample to sample by multiplication, in lanes; the attitude is expanded in
    time, to second order for the place of the tip and to first for its ringing.
    """
    flyer = motion.flyer
    count = len(ring.decay)
    x, w, inertia = matrix_of(attitude)[2], spin, flyer.inertia
    dw = np.zeros(3)
    for c in range(3):
        i, j = (c + 1) % 3, (c + 2) % 3
        if inertia[c] > 0.0:
            dw[c] = (inertia[i] - inertia[j]) * w[i] * w[j] / inertia[c]
        dw[c] -= flyer.alpha * w[c]
    dx, ddx = np.empty(3), np.empty(3)
    for c in range(3):
        i, j = (c + 1) % 3, (c + 2) % 3
        dx[c] = x[i] * w[j] - x[j] * w[i]
    for c in range(3):
        i, j = (c + 1) % 3, (c + 2) % 3
        ddx[c] = dx[i] * w[j] - dx[j] * w[i] + x[i] * dw[j] - x[j] * dw[i]
    spacing = _spacing(motion, ring, t, spin)
    size = math.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
    most = MOST_SAMPLES
    tumbling = math.sqrt(w[0] ** 2 + w[1] ** 2)
    # the cubic terms of the expansion stay below what is looked for
    cubic = size * size * (tumbling * abs(flyer.tip_place[2]) + size * ring.wide[count]) / 6.0
    if size * spacing * most > EXPANDED_RAD or cubic * (spacing * most) ** 3 > EXPANDED_M:
        longest = min(EXPANDED_RAD / size, (EXPANDED_M / cubic) ** (1.0 / 3.0))
        most = max(int(longest / spacing), 2)
    first = max(t - 0.5 * most * spacing, 0.0) if about else t
    lasts = min(until - first, (most - 1) * spacing)
    samples = min(most, math.ceil(lasts / spacing) + 1)
    spacing = lasts / max(samples - 1, 1)
    blocks = (samples + LANES - 1) // LANES
    heights = np.zeros(blocks * LANES)
    turning = np.zeros(blocks * LANES)
    real, imag = np.empty(LANES), np.empty(LANES)
    for j in range(count):
        start = ring.decay[j] * first
        if start < GONE:
            continue
        a0 = a1 = b0 = b1 = 0.0
        for c in range(3):
            a0 += x[c] * ring.cosine[j, c]
            a1 += x[c] * ring.sine[j, c]
            b0 += dx[c] * ring.cosine[j, c]
            b1 += dx[c] * ring.sine[j, c]
        size = math.exp(start)
        turn0, turn1 = (
            size * math.cos(ring.pitch[j] * first),
            size * math.sin(ring.pitch[j] * first),
        )
        size = math.exp(ring.decay[j] * spacing)
        f0, f1 = size * math.cos(ring.pitch[j] * spacing), size * math.sin(ring.pitch[j] * spacing)
        g0, g1 = 1.0, 0.0
        for k in range(LANES):
            real[k], imag[k] = turn0, turn1
            turn0, turn1 = turn0 * f0 - turn1 * f1, turn0 * f1 + turn1 * f0
            g0, g1 = g0 * f0 - g1 * f1, g0 * f1 + g1 * f0
        for b in range(blocks):
            for k in range(LANES):
                c, s = real[k], imag[k]
                heights[b * LANES + k] += a0 * c - a1 * s
                turning[b * LANES + k] += b0 * c - b1 * s
                real[k], imag[k] = c * g0 - s * g1, c * g1 + s * g0
    best, which = -math.inf, 0
    place = flyer.tip_place
    p = x[0] * place[0] + x[1] * place[1] + x[2] * place[2]
    dp = dx[0] * place[0] + dx[1] * place[1] + dx[2] * place[2]
    ddp = ddx[0] * place[0] + ddx[1] * place[1] + ddx[2] * place[2]
    at, speed = fallen(motion.position, motion.velocity, motion.gravity, flyer.alpha, t)
    drag = motion.gravity + flyer.alpha * speed[2]
    for i in range(samples):
        time = first + i * spacing - t
        heights[i] += at[2] + p + time * (speed[2] + dp + turning[i] + 0.5 * time * (ddp - drag))
    for i in range(samples):
        height = heights[i]
        if 0 < i < samples - 1 and height > heights[i - 1] and height >= heights[i + 1]:
            # the parabola's top, lest a lower wave win because a sample fell on its crest
            bent = 2.0 * height - heights[i - 1] - heights[i + 1]
            height += 0.125 * (heights[i + 1] - heights[i - 1]) ** 2 / bent
        if height > best:
            best, which = height, i
    return best, first + which * spacing, spacing, lasts


@njit
def _below(
    motion: Motion, ring: Ring, t: float, attitude: Array, spin: Array, ceiling: float
) -> float:
    """A time in which the tip does not rise to the ``ceiling``."""
    height, rate = tip_height(motion, ring, 0, t, attitude, spin)
    n_terms = in_sight(ring, ceiling - height)
    if n_terms:
        height, rate = tip_height(motion, ring, n_terms, t, attitude, spin)
    # gravity, which bending_bound has as a bound, pulls down
    bending = (
        bending_bound(motion, ring, n_terms, t, _tip_alone(motion), spin) - 2.0 * motion.gravity
    )
    return time_ahead(ceiling - height - ring.beyond[n_terms], -rate, bending)


@njit
def _tip_alone(motion: Motion) -> Array:
    return motion.flyer.tip_place.reshape(1, 3)


@njit
def _spacing(motion: Motion, ring: Ring, t: float, spin: Array) -> float:
    """A time between samples in which no maximum of the tip's height hides by `APEX_SAG_M`."""
    bending = bending_bound(motion, ring, len(ring.decay), t, _tip_alone(motion), spin)
    return math.sqrt(8.0 * APEX_SAG_M / bending)


@njit
def _refined(motion: Motion, left: float, best: float, right: float) -> tuple[float, float]:
    """Time and height of the highest place between ``left`` and ``right``, about ``best``: where
    the rate of rise is zero, by false position."""
    flyer, none = motion.flyer, np.zeros((0, 0))
    ring = ring_of(motion, left, ROUNDING_M, 1.0, flyer.tip, none)
    attitude, spin = free_rotation(
        motion.attitude, motion.spin, flyer.inertia, flyer.alpha, 0.0, left
    )
    t, top, top_t = best, -math.inf, best
    end_rate, end = 0.0, best
    for step in range(REFINEMENTS):
        turned, spun = free_rotation(attitude, spin, flyer.inertia, flyer.alpha, left, t)
        height, rate = tip_height(motion, ring, len(ring.decay), t, turned, spun)
        if height > top:
            top, top_t = height, t
        if rate == 0.0:
            break
        if step == 0:
            end, end_rate, t = t, rate, right if rate > 0.0 else left
            continue
        if rate * end_rate > 0.0:
            break
        now = t
        t = (end * rate - now * end_rate) / (rate - end_rate)
        end, end_rate = now, rate
    return top_t, top
