"""March of rods with steps that adapt to their error and to contact.

A step that ends deep in the surface takes the force at its end for its whole length, and one that
starts there and ends far above loses what the springs held. Either changes the energy, by about
what the point's spring holds at the end that touches. A step that ends where the point crosses the
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

# A step changes by these factors at most, aims at this share of the error it may have, and is
# taken again where it has so many times that.
LEAST_CHANGE, MOST_CHANGE, AIM, TOO_MUCH = 0.2, 1.6, 0.8, 2.0
SHORTEST_S = 1e-9
# A step is taken again up to where contact begins or ends if that is before this share of it.
NEARLY = 0.9
# It goes so much beyond the crossing, and is never shorter than this share of itself.
BEYOND, LEAST_SHARE = 1.02, 0.02
# An iteration count from which on steps do not grow.
MANY = 8


@njit
def error_of(scheme: Scheme, half: Array, old: Motion, new: Motion, h: float) -> float:
    """The greatest local error in m of a node's place, and of what twist moves the rim of its
    section of half sides ``half`` (2,) by: (β - 1/6) h³ times the acceleration's rate (Zienkiewicz
    and Xie, Earthquake Engng Struct. Dyn. 20 (1991) 871)."""
    most = 0.0
    for i in range(1, len(new.x)):
        square = (half[1] * (new.auxiliary[i, 5] - old.auxiliary[i, 5])) ** 2
        for c in range(3):
            square += (new.auxiliary[i, c] - old.auxiliary[i, c]) ** 2
        most = max(most, square)
    return abs(scheme.beta - 1.0 / 6.0) * h * h * math.sqrt(most)


@njit
def next_end(hub: Hub, t_s: float, end_s: float) -> float:
    """The hub's next break, or the end where that comes first or all but at once."""
    for at in hub.breaks:
        if t_s + SHORTEST_S < at < end_s - SHORTEST_S:
            return at
    return end_s


@njit
def equal_part(left_s: float, wanted_s: float) -> float:
    """The longest step in s, up to the wanted one, of which a whole number fill what is left."""
    return left_s / math.ceil(left_s / wanted_s * (1.0 - 1e-9))


@njit
def judge(scheme: Scheme, error: float, iterations: int, h: float, wanted: float) -> float:
    """The next step after one of ``h`` seconds with such an error; negative where this one is to be
    taken again, with as many seconds."""
    change = MOST_CHANGE
    if error > 0.0:
        change = AIM * (scheme.error_m / error) ** (1.0 / 3.0)
        change = min(max(change, LEAST_CHANGE), MOST_CHANGE)
    if error > TOO_MUCH * scheme.error_m and h > SHORTEST_S:
        return -h * min(change, 0.5)
    if iterations > MANY:
        change = min(change, 1.0)
    # a step that was shortened to end in time tells less of the next one's length
    return h * change if change < 1.0 else max(wanted, h * change)


@njit
def allowed_J(chain: Chain, scheme: Scheme) -> float:
    """The energy that contact may hold at the end of a step in which it begins, or at the begin of
    one in which it ends: the work of a force EI/L² over the error that a step may have."""
    bending = min(chain.stiffness[0, 3], chain.stiffness[0, 4])
    return scheme.error_m * bending / total_length(chain) ** 2


@njit
def first_crossing(surface: Obstacle, old: Motion, new: Motion, allowed: float) -> float:
    """The share of a step, at most 1, after which a point has just crossed the surface: the
    first one whose spring holds more than is ``allowed``, in J, at the end that touches."""
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
    """The greatest error, and at which share of the step the first point crosses the surface."""
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
    """March ``rods`` to ``end_s``, so many ``together`` with steps in common; -1, or one of those
    where a step fails however short.

    Pairs are between rods that march together, by their numbers there. The room is for as many
    rods, and as many pairs or more. Steps end at the hub's breaks.
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
                # the next one ends where contact begins or ends
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
                # where the rod was in Newton's method is of no more use
                stress = greatest_stress(law.between, chain, now, scratch.elements, scratch.x)
                now.totals[STRESS] = max(now.totals[STRESS], stress)
            write(room.touch, group.touch)
    return -1
