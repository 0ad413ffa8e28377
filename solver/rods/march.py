"""March of rods with steps that adapt to their error and to contact."""

from __future__ import annotations

import math

from ..arrays import Integers
from ..compiled import njit, nth, unowned, within
from .contact import Touch
from .crossing import allowed_J, first_crossing
from .joint import Room, joint_step
from .motion import STEP, TIME, ClampedRod, Hub, Motion, Scheme, copy, copy_touch, fit_to_step
from .step import Law
from .tally import Windows, add_step

# A step changes by these factors at most, aims at this share of the error it may have, and is
# taken again where it has so many times that.
LEAST_CHANGE, MOST_CHANGE, AIM, TOO_MUCH = 0.2, 1.6, 0.8, 2.0
SHORTEST_S = 1e-9
# A step is taken again up to where contact begins or ends if that is before this share of it.
NEARLY = 0.9
# An iteration count from which on steps do not grow.
MANY = 8


@njit
def error_of(scheme: Scheme, old: Motion, new: Motion, h: float) -> float:
    """The greatest local error in m of a node's place: (β - 1/6) h³ times the acceleration's
    rate (Zienkiewicz and Xie, Earthquake Engng Struct. Dyn. 20 (1991) 871)."""
    most = 0.0
    for i in range(1, len(new.x)):
        square = 0.0
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


@within
def _look_at_all(
    law: Law, rods: ClampedRod, members: Integers, stack: Motion, new: Motion, h: float
) -> tuple[float, float]:
    """The greatest error, and at which share of the step the first point crosses the surface."""
    most, share = 0.0, 1.0
    for k in range(len(members)):
        old, now = nth(stack, members[k]), nth(new, k)
        most = max(most, error_of(law.scheme, old, now, h))
        allowed = allowed_J(nth(rods.chain, members[k]), law.scheme)
        share = min(share, first_crossing(law.surface, old, now, allowed))
    return most, share


@njit
def march(
    law: Law,
    rods: ClampedRod,
    members: Integers,
    together: int,
    pairs: Integers,
    stack: Motion,
    touch: Touch,
    end_s: float,
    windows: Windows,
    room: Room,
) -> int:
    """March the rods ``members`` of the stack to ``end_s``, so many ``together`` with steps in
    common; -1, or one of those where a step fails however short.

    ``rods`` are stacked too. ``pairs`` (p, 4) are the elements that may touch, rods counted among
    those that march together, and ``touch`` is what their points remember; ``room`` is for as many
    rods, and as many pairs or more. Steps end at the hub's breaks.
    """
    law, rods, stack, pairs, touch, room = unowned((law, rods, stack, pairs, touch, room))
    for first in range(0, len(members), together):
        group = members[first : first + together]
        t, wanted, lands = stack.totals[group[0], TIME], math.inf, False
        for i in group:
            wanted = min(wanted, stack.totals[i, STEP])
        while t < end_s:
            until = next_end(law.hub, t, end_s)
            h = equal_part(until - t, wanted)
            for i in group:
                fit_to_step(nth(stack, i), h)
            count = joint_step(law, rods, group, pairs, stack, touch, h, room)
            if count < 0:
                wanted = 0.5 * h
                if wanted < SHORTEST_S:
                    stack.totals[group[0], STEP] = wanted
                    return group[0]
                continue
            error, share = _look_at_all(law, rods, group, stack, room.new, h)
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
            for k in range(len(group)):
                now, new = nth(stack, group[k]), nth(room.new, k)
                add_step(law.hub, now, new, windows, group[k])
                copy(new, now)
                now.totals[TIME], now.totals[STEP] = t, wanted
            copy_touch(room.touch, touch)
    return -1
