"""Equilibrium of a rod with its weight and a smooth surface, from which a march begins."""

from __future__ import annotations

from ..arrays import Array
from .chain import Chain, new_system
from .contact import Surface, release
from .motion import CONTACT, Hub, Motion, Scheme, copy, set_strains
from .step import new_scratch, step

# The most steps that a rod's weight comes on in.
MOST_PARTS = 256


def settle(
    chain: Chain,
    scheme: Scheme,
    surface: Surface,
    loads: Array,
    hub: Hub,
    now: Motion,
    other: Motion,
) -> bool:
    """Bring a rod into equilibrium with dead loads (n, 6) and the surface without friction.

    The loads come on in equal steps, as few as will do; False where even many do not. Two states
    of contact would serve friction at rest, so it begins with none. ``other`` is room.
    """
    still, smooth = scheme._replace(inertia=False), surface._replace(static=0.0, kinetic=0.0)
    system, scratch = new_system(len(now.x)), new_scratch(len(now.x))
    start, parts = (now.x.copy(), now.q.copy()), 1
    while parts <= MOST_PARTS:
        done = 0
        while done < parts:
            load = loads * ((done + 1) / parts)
            if step(chain, still, smooth, load, hub, now, other, 0.0, system, scratch) < 0:
                break
            copy(other, now)
            done += 1
        if done == parts:
            held = now.totals[CONTACT]
            now.totals[:] = 0.0
            now.totals[CONTACT] = held
            return True
        now.x[:], now.q[:] = start
        for node in range(len(now.x)):
            release(now.touch, node)
        set_strains(chain, now)
        parts *= 2
    return False
