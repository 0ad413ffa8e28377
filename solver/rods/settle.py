"""Equilibrium of a rod with its weight and a smooth surface, from which a march begins."""

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

# The most steps that a rod's weight comes on in.
MOST_PARTS = 256
# The surface is at first so many times EI/L³ stiff, and then stiffer by so much at a time.
SOFT, STIFFER = 1e3, 10.0


def settle(brush: Brush, i: int, room: Room) -> bool:
    """Bring rod ``i`` of a brush into equilibrium with its loads and the surface without friction.

    The loads come on in equal steps over a soft surface, as few as will do, which is then made as
    stiff as it is. False where even many steps do not do. Friction at rest can be anything below
    its limit, so a rod begins with none, and what touches sticks. ``room`` is for one rod.
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
    """Shares of the load, each with the surface as it is then: of one stiffness all over, until
    it is stiff and the differences move the rod no longer."""
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
