"""The next touch of a body in flight, by conservative advancement (see `clearance`). Compiled.

A step is as long as surely nothing touches in it. Near the ground that time goes to zero, and the
shortest step is one in which nothing can dip below by more than `TOUCH_SEARCH_M`: between two
instants at which the clearance is above zero, w apart, it is less than M w²/8 below it, M being the
bound on its second derivative. So the search passes over no touch deeper than what ringing it
leaves out, and takes no more than √(M/8 `TOUCH_SEARCH_M`) steps a second.
"""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Array
from ..compiled import njit
from ..rigid import fallen, free_rotation
from .clearance import bending_bound, clearance_of, slant_bound
from .motion import Motion
from .ringing import COMPACT_EVERY, ROUNDING_M, Ring, grown, in_sight, ring_of

# What ringing may be left out of the search; the root is refined with all but rounding.
TOUCH_SEARCH_M = 1e-8
ROOT_STEPS = 100


@njit
def after_release(
    motion: Motion, normals: Array, offsets: Array, slowest: float
) -> tuple[float, bool]:
    """How long until the next touch, or one cannot be missed any more; and whether the impact is
    over by then.

    It is over where the centre of mass has turned to fall, or falls on and the body, whose
    ``slowest`` mode has that period, has had time to ring and not come back. A tip that rings down
    while the centre still rises belongs to the same impact.
    """
    gravity, rising = motion.gravity, motion.velocity[2]
    ringing = motion.reach.sum()
    longest = 2.0 * max(rising, 0.0) / gravity + math.sqrt(8.0 * ringing / gravity) + 1e-3
    # as long as turning can keep the tip up
    longest += 2.0 * math.sqrt(8.0 * np.abs(motion.flyer.places[:, 2]).max() / gravity)
    after = min(next_touch(motion, normals, offsets, longest), longest)
    if rising <= 0.0:
        return after, after > slowest
    speed = fallen(motion.position, motion.velocity, gravity, motion.flyer.alpha, after)[1]
    return after, speed[2] <= 0.0


@njit
def next_touch(motion: Motion, normals: Array, offsets: Array, until: float) -> float:
    """The first time in (0, ``until``] at which a point comes down through its plane, or infinity.

    A point that starts below its plane, on its way up, touches when it turns down before it got
    out.
    """
    flyer = motion.flyer
    t = 0.0
    attitude, spin = motion.attitude, motion.spin
    ring, rows, slack = _search_ring(motion, t, slant_bound(motion, attitude, normals, until))
    n_terms = len(ring.decay)
    above = False
    before, age = -math.inf, 0
    later, turned, spun = t, attitude, spin
    while True:
        # look at `later`, as closely as what comes out calls for
        while True:
            clear, _, safe = clearance_of(
                motion,
                ring,
                n_terms,
                rows,
                normals,
                offsets,
                later,
                turned,
                spun,
                ring.beyond[n_terms] + slack,
                bending_bound(motion, ring, n_terms, later, flyer.places, spun),
            )
            more = in_sight(ring, clear)
            if more <= n_terms:
                break
            n_terms = more
        if later > 0.0:
            if above and clear <= 0.0:
                found = _root(motion, normals, offsets, t, later, attitude, spin)
                if not math.isinf(found):
                    return found
            elif not above and clear < before:
                return later
        if later >= until:
            return math.inf
        above = above or clear > 0.0
        t, attitude, spin, before = later, turned, spun, clear
        if age == COMPACT_EVERY:
            slant = slant_bound(motion, attitude, normals, until - t)
            ring, rows, slack = _search_ring(motion, t, slant)
            age = 0
        age += 1
        n_terms = min(in_sight(ring, clear), len(ring.decay))
        bending = bending_bound(motion, ring, n_terms, t, flyer.places, spin)
        shortest = math.sqrt(8.0 * TOUCH_SEARCH_M / bending) if bending > 0.0 else until
        if clear <= 0.0:  # on its way out, until it turns
            shortest = min(shortest, ring.finest, until / 8.0)
        later = min(t + max(shortest, safe), until)
        turned, spun = free_rotation(attitude, spin, flyer.inertia, flyer.alpha, t, later)


@njit
def _search_ring(motion: Motion, t: float, slant: float) -> tuple[Ring, Array, float]:
    """The ring to search the next touch with, the points' rows on it, and what it may be off by.

    The section is taken as rigid, unless it is not nearly so.
    """
    flyer, slack = motion.flyer, 0.0
    for j in range(len(motion.rest)):
        slack += motion.rest[j] * grown(motion.powers[j], t)
    if slack <= TOUCH_SEARCH_M:
        ring = ring_of(motion, t, TOUCH_SEARCH_M, slant, motion.chart.fit, motion.chart.fit_speed)
        return ring, motion.chart.stiff, slack
    ring = ring_of(motion, t, TOUCH_SEARCH_M, slant, flyer.along, flyer.with_speed)
    return ring, flyer.rows, 0.0


@njit
def _root(
    motion: Motion,
    normals: Array,
    offsets: Array,
    left: float,
    right: float,
    attitude: Array,
    spin: Array,
) -> float:
    """Where the lowest clearance falls through zero about [left, right], or infinity: Newton's
    method, kept in a bracket.

    ``attitude`` and ``spin`` are those at ``left``. What saw the fall may have left something out,
    so that the bracket may have to be widened.
    """
    flyer = motion.flyer
    start, furthest = left, right + (right - left)
    ring = ring_of(motion, left, ROUNDING_M, 1.0, flyer.along, flyer.with_speed)
    n_terms = len(ring.decay)
    at, bracketed = right, False
    for _ in range(ROOT_STEPS):
        turned, spun = free_rotation(attitude, spin, flyer.inertia, flyer.alpha, start, at)
        clear, rate, _ = clearance_of(
            motion, ring, n_terms, flyer.rows, normals, offsets, at, turned, spun, 0.0, 0.0
        )
        if clear > 0.0:
            left = at
        else:
            bracketed, right = True, at
        newton = at - clear / rate if rate < 0.0 else math.inf
        if clear == 0.0 or abs(newton - at) <= 4e-16 * at:
            return at
        if not bracketed:
            if newton > furthest:
                return math.inf
        elif not left < newton < right:
            newton = 0.5 * (left + right)
            if right - left <= 4e-16 * right:
                return right
        at = newton
    return at
