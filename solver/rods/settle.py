"""Static equilibrium of a rod under its weight on a smooth surface, the start of a march."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from ..compiled import nth, write
from .chain import Chain, total_length
from .contact import FREE, STICKS, Friction, Obstacle, release
from .element import strains
from .joint import Brush, Group, Room, joint_step
from .motion import CONTACT

# Largest number of load steps for a rod's weight.
MOST_PARTS = 256
# First stiffness of the surface over EI/L³, and factor of its later increases.
SOFT, STIFFER = 1e3, 10.0


def settle(brush: Brush, i: int, room: Room) -> bool:
    """Bring rod ``i`` of a brush into equilibrium with its loads and the surface, without friction.

    The loads are applied in equal steps, as few as possible, over a soft surface, which is then
    stiffened. Returns False if even many steps fail. Static friction can be anything below its
    limit, so a rod starts with none, and its contact points stick. ``room`` is for one rod.
    """
    (law, rods, stack), parts = brush, 1
    still = law._replace(scheme=law.scheme._replace(inertia=False))
    chain, loads, now = nth(rods.chain, i), rods.loads[i].copy(), nth(stack, i)
    start, alone = (now.x.copy(), now.q.copy()), Group.apart(np.array([i]))
    while parts <= MOST_PARTS:
        done = 0
        stages = [*_loading(chain, law.surface, parts)]
        for share, plane in stages:
            rods.loads[i] = share * loads
            smooth = brush._replace(law=still._replace(surface=plane))
            if joint_step(smooth, alone, 0.0, room) < 0:
                break
            write(nth(room.new, 0), now)
            done += 1
        if done == len(stages):
            held = now.totals[CONTACT]
            now.totals[:] = 0.0
            now.totals[CONTACT] = held
            now.touch.state[now.touch.state != FREE] = STICKS
            now.touch.speed[:] = 0.0
            return True
        now.x[:], now.q[:] = start
        rods.loads[i] = loads
        for node in range(len(now.x)):
            release(now.touch, node)
        strains(chain, now.x, now.q, now.strain)
        parts *= 2
    return False


def _loading(chain: Chain, surface: Obstacle, parts: int) -> Iterator[tuple[float, Obstacle]]:
    """Shares of the load, each with its surface. The surface has one stiffness everywhere until it
    is so stiff that local differences no longer move the rod."""
    bending = float(chain.stiffness[0, 3:5].min())
    soft = min(surface.kn, SOFT * bending / float(total_length(chain)) ** 3)
    even = surface.relief._replace(factor=np.ones_like(surface.relief.factor))
    none = Friction(0.0, 0.0, 0.0)
    smooth = surface._replace(friction=none, kn=soft, relief=even)
    for k in range(1, parts + 1):
        yield k / parts, smooth
    steps = math.ceil(math.log(surface.kn / soft) / math.log(STIFFER))
    for k in range(1, steps + 1):
        yield 1.0, smooth._replace(kn=soft * (surface.kn / soft) ** (k / steps))
    if surface.relief.there:
        yield 1.0, surface._replace(friction=none)
