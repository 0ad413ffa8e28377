"""March of rods with steps that adapt to their error and to contact, compiled."""

from __future__ import annotations

import math

from ..arrays import Array
from ..compiled import njit
from .chain import Chain, chain_of, new_system
from .contact import Surface
from .crossing import allowed_J, first_crossing
from .motion import STEP, TIME, Hub, Motion, Scheme, copy, fit_to_step, rod
from .step import new_scratch, step
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
def _error(scheme: Scheme, old: Motion, new: Motion, h: float) -> float:
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
def _next_end(hub: Hub, t_s: float, end_s: float) -> float:
    """The hub's next break, or the end where that comes first or all but at once."""
    for at in hub.breaks:
        if t_s + SHORTEST_S < at < end_s - SHORTEST_S:
            return at
    return end_s


@njit
def march_all(
    chains: Chain,
    scheme: Scheme,
    surface: Surface,
    loads: Array,
    hubs: Hub,
    stack: Motion,
    other: Motion,
    end_s: float,
    sums: Array,
) -> int:
    """March every stacked rod to ``end_s``; -1, or the first rod whose step fails however short.

    The ``loads`` (rods, n, 6) and the ``place`` and ``attitude`` of ``hubs`` are stacked too;
    ``other`` is room for one rod. Steps end at the hub's breaks. ``sums`` are those of
    `tally.add_step`, of windows of equal width from now on to the end.
    """
    system, scratch = new_system(stack.x.shape[1]), new_scratch(stack.x.shape[1])
    begin_s = stack.totals[0, TIME]
    width_s = (end_s - begin_s) / len(sums)
    for i in range(len(stack.x)):
        chain, now = chain_of(chains, i), rod(stack, i)
        hub = Hub(hubs.breaks, hubs.coefficients, hubs.place[i], hubs.attitude[i])
        allowed, lands = allowed_J(chain, scheme), False
        while now.totals[TIME] < end_s:
            until = _next_end(hub, now.totals[TIME], end_s)
            left, wanted = until - now.totals[TIME], now.totals[STEP]
            h = left / math.ceil(left / wanted * (1.0 - 1e-9))
            fit_to_step(now, h)
            count = step(chain, scheme, surface, loads[i], hub, now, other, h, system, scratch)
            if count < 0:
                now.totals[STEP] = 0.5 * h
                if now.totals[STEP] < SHORTEST_S:
                    return i
                continue
            error = _error(scheme, now, other, h)
            change = MOST_CHANGE
            if error > 0.0:
                change = AIM * (scheme.error_m / error) ** (1.0 / 3.0)
                change = min(max(change, LEAST_CHANGE), MOST_CHANGE)
            if error > TOO_MUCH * scheme.error_m and h > SHORTEST_S:
                now.totals[STEP] = h * min(change, 0.5)
                continue
            share = 1.0 if lands else first_crossing(surface, now, other, allowed)
            if share < NEARLY:
                now.totals[STEP], lands = h * share, True
                continue
            lands = False
            if count > MANY:
                change = min(change, 1.0)
            add_step(surface, hub, now, other, begin_s, width_s, sums)
            copy(other, now)
            # a step that was shortened to end in time tells less of the next one's length
            now.totals[STEP] = h * change if change < 1.0 else max(wanted, h * change)
            if h > 0.9999 * left:
                now.totals[TIME] = until
    return -1
