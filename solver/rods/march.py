"""Time integration of rods with steps that adapt to their error and to contact.

A step that ends deep in the surface applies the force at its end over its whole length. One that
starts there and ends far above loses the springs' energy. Either changes the energy by about what
the point's spring stores at the end in contact. A step that ends where the point crosses the
surface does not.
"""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Array
from ..compiled import njit, nth, unowned, within, write
from .chain import Chain, total_length
from .contact import FREE, Obstacle, SectionPose, point_gap
from .joint import Brush, Group, Room, joint_step
from .motion import STEP, STRESS, TIME, Hub, Motion, Scheme, fit_to_step
from .observe import greatest_stress
from .rotation import write_matrix
from .tally import Windows, add_step

# Bounds on a step's change, its aim as a share of the allowed error, and the share that repeats it.
LEAST_CHANGE, MOST_CHANGE, AIM, TOO_MUCH = 0.2, 1.6, 0.8, 2.0
SHORTEST_S = 1e-9
# A step is repeated up to where contact begins or ends, if that is before this share of it.
NEARLY = 0.9
# The repeated step passes the crossing by `BEYOND`, and is at least `LEAST_SHARE` of the first.
BEYOND, LEAST_SHARE = 1.02, 0.02
# From this iteration count on steps do not grow.
MANY = 8


@njit
def error_of(scheme: Scheme, half: Array, old: Motion, new: Motion, h: float) -> float:
    """The greatest local error in m of a node's position, and of the rim's motion by twist for a
    section of half sides ``half`` (2,).

    It is (β - 1/6) h³ times the rate of the acceleration (Zienkiewicz and Xie, Earthquake Engng
    Struct. Dyn. 20 (1991) 871).
    """
    most = 0.0
    for i in range(1, len(new.x)):
        square = (half[1] * (new.auxiliary[i, 5] - old.auxiliary[i, 5])) ** 2
        for c in range(3):
            square += (new.auxiliary[i, c] - old.auxiliary[i, c]) ** 2
        most = max(most, square)
    return abs(scheme.beta - 1.0 / 6.0) * h * h * math.sqrt(most)


@njit
def next_end(hub: Hub, t_s: float, end_s: float) -> float:
    """The hub's next break, or the end if that is earlier or nearly so."""
    for at in hub.breaks:
        if t_s + SHORTEST_S < at < end_s - SHORTEST_S:
            return at
    return end_s


@njit
def equal_part(left_s: float, wanted_s: float) -> float:
    """The longest step in s, at most the wanted one, that divides the time left equally."""
    return left_s / math.ceil(left_s / wanted_s * (1.0 - 1e-9))


@njit
def judge(scheme: Scheme, error: float, iterations: int, h: float, wanted: float) -> float:
    """Next length in s after a step of ``h`` s; negative if that step must be repeated with it."""
    change = MOST_CHANGE
    if error > 0.0:
        change = AIM * (scheme.error_m / error) ** (1.0 / 3.0)
        change = min(max(change, LEAST_CHANGE), MOST_CHANGE)
    if error > TOO_MUCH * scheme.error_m and h > SHORTEST_S:
        return -h * min(change, 0.5)
    if iterations > MANY:
        change = min(change, 1.0)
    # a step shortened to meet an end says little about the next one's length
    return h * change if change < 1.0 else max(wanted, h * change)


@njit
def allowed_J(chain: Chain, scheme: Scheme) -> float:
    """The energy that contact may store at the end of a step in which it begins, or at the start of
    one in which it ends: the work of a force EI/L² over the allowed error of a step."""
    bending = min(chain.stiffness[0, 3], chain.stiffness[0, 4])
    return scheme.error_m * bending / total_length(chain) ** 2


@njit
def first_crossing(surface: Obstacle, old: Motion, new: Motion, allowed: float) -> float:
    """Share of a step, at most 1, at which the first point crosses the surface.

    Only points whose spring stores more than ``allowed`` J at the end in contact count.
    """
    least = 1.0
    if not surface.there:
        return least
    matrix, touch, was = np.empty((3, 3)), new.touch, old.touch
    for i in range(1, len(new.x)):
        for k in range(len(surface.rim)):
            begins = was.state[i, k] == FREE and touch.state[i, k] != FREE
            ends = was.state[i, k] != FREE and touch.state[i, k] == FREE
            normal = touch.normal[i, k] + was.normal[i, k]
            if not (begins or ends) or 0.5 * normal * normal <= allowed * surface.kn:
                continue
            free, depth = (old if begins else new), normal / surface.kn
            write_matrix(free.q[i], matrix)
            gap = max(point_gap(surface, k, SectionPose(free.x[i], matrix)), 0.0)
            share = (gap if begins else depth) / (gap + depth)
            least = min(least, max(BEYOND * share, LEAST_SHARE))
    return least


@within
def _look_at_all(brush: Brush, group: Group, new: Motion, h: float) -> tuple[float, float]:
    """The greatest error, and the share of the step at which a point first crosses the surface."""
    scheme, most, share = brush.law.scheme, 0.0, 1.0
    for k in range(len(group.members)):
        old, now = nth(brush.stack, group.members[k]), nth(new, k)
        most = max(most, error_of(scheme, brush.law.between.half, old, now, h))
        allowed = allowed_J(nth(brush.rods.chain, group.members[k]), scheme)
        share = min(share, first_crossing(brush.law.surface, old, now, allowed))
    return most, share


@njit
def march(
    brush: Brush, rods: Group, together: int, end_s: float, windows: Windows, room: Room
) -> int:
    """March ``rods`` to ``end_s``, ``together`` of them at a time with common steps.

    Returns -1, or the number of a rod whose step fails however short it is. Pairs are between rods
    that march together, by their numbers there. ``room`` is for that many rods, and at least that
    many pairs. Steps end at the hub's breaks.
    """
    brush, rods, room = unowned((brush, rods, room))
    law, stack = brush.law, brush.stack
    for first in range(0, len(rods.members), together):
        members = rods.members[first : first + together]
        group = Group(members, rods.pairs, rods.touch)
        t, wanted, lands = stack.totals[members[0], TIME], math.inf, False
        for i in members:
            wanted = min(wanted, stack.totals[i, STEP])
        while t < end_s:
            until = next_end(law.hub, t, end_s)
            h = equal_part(until - t, wanted)
            for i in members:
                fit_to_step(nth(stack, i), h)
            count = joint_step(brush, group, h, room)
            if count < 0:
                wanted = 0.5 * h
                if wanted < SHORTEST_S:
                    stack.totals[members[0], STEP] = wanted
                    return members[0]
                continue
            error, share = _look_at_all(brush, group, room.new, h)
            following = judge(law.scheme, error, count, h, wanted)
            if following < 0.0:
                wanted = -following
                continue
            if share < NEARLY and not lands:
                # the repeated step ends where contact begins or ends
                wanted, lands = h * share, True
                continue
            lands, wanted = False, following
            t = until if h > 0.9999 * (until - t) else t + h
            for k in range(len(members)):
                now, new = nth(stack, members[k]), nth(room.new, k)
                add_step(law.hub, now, new, windows, members[k])
                write(new, now)
                now.totals[TIME], now.totals[STEP] = t, wanted
                chain, scratch = nth(brush.rods.chain, members[k]), nth(room.scratches, k)
                # Newton's method no longer needs the saved pose
                stress = greatest_stress(law.between, chain, now, scratch.elements, scratch.x)
                now.totals[STRESS] = max(now.totals[STRESS], stress)
            write(room.touch, group.touch)
    return -1
