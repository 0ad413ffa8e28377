"""March of rods with steps that adapt to their error and to contact."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..arrays import Array, Integers
from ..compiled import njit, unowned
from .chain import Chain, System, chain_of
from .contact import Touch, no_touch
from .crossing import allowed_J, first_crossing
from .joint import WAITS, Law, Room, Waiting, joint_step, nothing_waits, sparse_solution
from .motion import STEP, TIME, Hub, Motion, Scheme, copy, fit_to_step, hub_of, rod, write
from .step import Scratch, step
from .tally import add_step

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


class Windows(NamedTuple):
    """Where the means of `tally.add_step` go: the first window's begin, their width in s, and sums
    (rods, w, `tally.COLUMNS`)."""

    begin_s: float
    width_s: float
    sums: Array


@njit
def march_apart(
    law: Law,
    chains: Chain,
    loads: Array,
    hubs: Hub,
    members: Integers,
    stack: Motion,
    other: Motion,
    system: System,
    scratch: Scratch,
    end_s: float,
    windows: Windows,
) -> int:
    """March the rods ``members`` of the stack to ``end_s``, each by itself; -1, or the first one
    whose step fails however short.

    The ``loads`` (rods, n, 6) and the ``place`` and ``attitude`` of ``hubs`` are stacked too;
    ``other``, ``system`` and ``scratch`` are room for one rod. Steps end at the hub's breaks.
    """
    law, chains, loads, hubs, stack = unowned((law, chains, loads, hubs, stack))
    other, system, scratch = unowned((other, system, scratch))
    for i in members:
        chain, now = chain_of(chains, i), rod(stack, i)
        hub = hub_of(hubs, i)
        allowed, lands = allowed_J(chain, law.scheme), False
        while now.totals[TIME] < end_s:
            until = next_end(hub, now.totals[TIME], end_s)
            left, wanted = until - now.totals[TIME], now.totals[STEP]
            h = equal_part(left, wanted)
            fit_to_step(now, h)
            count = step(
                chain, law.scheme, law.surface, loads[i], hub, now, other, h, system, scratch
            )
            if count < 0:
                now.totals[STEP] = 0.5 * h
                if now.totals[STEP] < SHORTEST_S:
                    return i
                continue
            following = judge(law.scheme, error_of(law.scheme, now, other, h), count, h, wanted)
            if following < 0.0:
                now.totals[STEP] = -following
                continue
            share = 1.0 if lands else first_crossing(law.surface, now, other, allowed)
            if share < NEARLY:
                now.totals[STEP], lands = h * share, True
                continue
            lands = False
            add_step(hub, now, other, windows.begin_s, windows.width_s, windows.sums[i])
            copy(other, now)
            now.totals[STEP] = following
            if h > 0.9999 * left:
                now.totals[TIME] = until
    return -1


@njit
def _look_at_all(
    law: Law, chains: Chain, members: Integers, stack: Motion, new: Motion, h: float
) -> tuple[float, float]:
    """The greatest error, and at which share of the step the first point crosses the surface."""
    most, share = 0.0, 1.0
    for k in range(len(members)):
        chain, old, now = chain_of(chains, members[k]), rod(stack, members[k]), rod(new, k)
        most = max(most, error_of(law.scheme, old, now, h))
        share = min(share, first_crossing(law.surface, old, now, allowed_J(chain, law.scheme)))
    return most, share


@njit
def _accept_all(
    hubs: Hub,
    members: Integers,
    stack: Motion,
    new: Motion,
    time_s: float,
    step_s: float,
    windows: Windows,
) -> None:
    for k in range(len(members)):
        i = members[k]
        hub = hub_of(hubs, i)
        now, following = rod(stack, i), rod(new, k)
        add_step(hub, now, following, windows.begin_s, windows.width_s, windows.sums[i])
        copy(following, now)
        now.totals[TIME], now.totals[STEP] = time_s, step_s


# What `_march_joint` goes on from: the time, the step wanted next, the step under way, and whether
# that ends where contact begins or ends.
AT, WANTED, UNDER_WAY, LANDS = range(4)


@njit
def _march_joint(
    law: Law,
    chains: Chain,
    loads: Array,
    hubs: Hub,
    members: Integers,
    pairs: Integers,
    stack: Motion,
    touch: Touch,
    now: Touch,
    end_s: float,
    windows: Windows,
    room: Room,
    progress: Array,
    waiting: Waiting,
    forces: Array,
) -> tuple[int, Waiting]:
    """March on from ``progress`` as `march_together`, or until an iteration waits for its
    ``forces``: the first is `WAITS` then."""
    law, chains, loads, hubs, stack = unowned((law, chains, loads, hubs, stack))
    pairs, touch, now, room = unowned((pairs, touch, now, room))
    hub = hub_of(hubs, 0)
    while progress[AT] < end_s:
        t = progress[AT]
        until = next_end(hub, t, end_s)
        left = until - t
        if waiting.iteration == 0:
            progress[UNDER_WAY] = equal_part(left, progress[WANTED])
            for i in members:
                fit_to_step(rod(stack, i), progress[UNDER_WAY])
        h = progress[UNDER_WAY]
        count, waiting = joint_step(
            law, chains, loads, hubs, members, pairs, stack, touch, now, h, room, waiting, forces
        )
        if count == WAITS:
            return WAITS, waiting
        if count < 0:
            progress[WANTED] = 0.5 * h
            if progress[WANTED] < SHORTEST_S:
                return members[0], waiting
            continue
        error, share = _look_at_all(law, chains, members, stack, room.new, h)
        following = judge(law.scheme, error, count, h, progress[WANTED])
        if following < 0.0:
            progress[WANTED] = -following
            continue
        if share < NEARLY and progress[LANDS] == 0.0:
            progress[WANTED], progress[LANDS] = h * share, 1.0
            continue
        progress[LANDS], progress[WANTED] = 0.0, following
        progress[AT] = until if h > 0.9999 * left else t + h
        _accept_all(hubs, members, stack, room.new, progress[AT], following, windows)
        write(now.elongation, touch.elongation)
        write(now.state, touch.state)
        write(now.speed, touch.speed)
        write(now.normal, touch.normal)
        write(now.friction, touch.friction)
    return -1, waiting


def march_together(
    law: Law,
    chains: Chain,
    loads: Array,
    hubs: Hub,
    members: Integers,
    pairs: Integers,
    stack: Motion,
    touch: Touch,
    end_s: float,
    windows: Windows,
    room: Room,
) -> int:
    """March rods that may touch each other to ``end_s`` with steps in common, see `march_apart`.

    ``pairs`` (p, 4) are the elements that may touch, rods counted among the members, and ``touch``
    is what their points remember; ``room`` is for as many rods, and as many pairs or more.
    """
    totals = stack.totals[members]
    progress = np.array([totals[0, TIME], totals[:, STEP].min(), 0.0, 0.0])
    now, waiting = no_touch(len(pairs), 2), nothing_waits()
    forces: Array = np.empty(0)
    while True:
        failed, waiting = _march_joint(
            law,
            chains,
            loads,
            hubs,
            members,
            pairs,
            stack,
            touch,
            now,
            end_s,
            windows,
            room,
            progress,
            waiting,
            forces,
        )
        if failed != WAITS:
            if failed >= 0:
                stack.totals[failed, STEP] = progress[WANTED]
            return failed
        forces = sparse_solution(waiting)
