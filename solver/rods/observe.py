"""Output quantities of rods: forces, moments, stress, energy."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..arrays import Array, Integers
from ..compiled import njit, nth
from .chain import Chain
from .contact import SLIDES, Obstacle, SectionPose, lowest
from .element import Elements, load_elements
from .motion import CONTACT, FRICTION, HUB_WORK, MATERIAL, STEPS, STRESS, Motion, energies
from .pairs import Between
from .rotation import write_matrix


@njit
def clearance(surface: Obstacle, now: Motion) -> float:
    """Gap in m of a rod's lowest free section; infinite without a surface."""
    least, matrix = np.inf, np.empty((3, 3))
    for k in range(1, len(now.x)):
        if surface.there:
            write_matrix(now.q[k], matrix)
            least = min(least, lowest(surface, SectionPose(now.x[k], matrix)))
    return least


# The column of `Seen.energy` whose zero is arbitrary.
POTENTIAL = 3


class Seen(NamedTuple):
    """Output of n rods.

    ``x`` (n, nodes, 3) and ``q`` (n, nodes, 4) are the nodes' positions and quaternions, ``moment``
    (n, nodes, 3) the bending moments there about the section's axes. ``reaction`` (n, 6) is the
    clamp's load on the rod. ``surface`` (n, 3) holds normal force, friction and state, ``energy``
    (n, 8) the fields of `frame.RodEnergy` without the first, and the number of steps. ``stress``
    (n,) is the greatest bending stress since the last frame.
    """

    x: Array
    q: Array
    moment: Array
    reaction: Array
    surface: Array
    energy: Array
    stress: Array


@njit
def write_moments(chain: Chain, now: Motion, elements: Elements, moment: Array) -> None:
    """Write the bending moments (n, 3) at a rod's nodes about the section's axes."""
    load_elements(chain, now.x, now.q, now.strain, 0.0, elements)
    matrix = np.empty((3, 3))
    for k in range(len(now.x)):
        write_matrix(now.q[k], matrix)
        for c in range(3):
            moment[k, c] = 0.0
            for d in range(3):
                # load of the element after the clamp, or of the one before any other node
                load = -elements.ends[0, 0, 3 + d] if k == 0 else elements.ends[k - 1, 1, 3 + d]
                moment[k, c] += matrix[d, c] * load


@njit
def greatest_stress(
    law: Between, chain: Chain, now: Motion, elements: Elements, moment: Array
) -> float:
    """Greatest bending stress in Pa of a rod (`section.RodSection.bending_stress_Pa`)."""
    write_moments(chain, now, elements, moment)
    thin, wide = law.half
    most = 0.0
    for k in range(len(moment)):
        about_1, about_2 = abs(moment[k, 0]), abs(moment[k, 1])
        if law.round:
            stress = 4.0 * math.hypot(about_1, about_2) / (math.pi * thin**3)
        else:
            stress = 0.75 * (about_1 / wide + about_2 / thin) / (thin * wide)
        most = max(most, stress)
    return most


@njit
def observe(chains: Chain, gravity: Array, stack: Motion, members: Integers) -> Seen:
    """Output of the stacked rods with the numbers ``members`` (n,)."""
    rods, nodes = len(members), stack.x.shape[1]
    moment, met = np.zeros((rods, nodes, 3)), np.zeros((rods, 3))
    energy, e = np.zeros((rods, 8)), nodes - 1
    middle, ends, rows = np.empty((e, 3, 3)), np.empty((e, 2, 6)), np.empty((2, e, 6))
    elements = Elements(middle, rows[0], rows[1], ends, middle)
    for i in range(rods):
        chain, now = nth(chains, members[i]), nth(stack, members[i])
        write_moments(chain, now, elements, moment[i])
        meet(now, met[i])
        energy[i, 0], energy[i, 4] = now.totals[HUB_WORK], now.totals[CONTACT]
        energy[i, 1], energy[i, 2], energy[i, 3] = energies(chain, now, gravity)
        energy[i, 5], energy[i, 6] = now.totals[MATERIAL], now.totals[FRICTION]
        energy[i, 7] = now.totals[STEPS]
    x, q, reaction = stack.x[members], stack.q[members], stack.reaction[members]
    return Seen(x, q, moment, reaction, met, energy, stack.totals[members, STRESS])


@njit
def meet(now: Motion, out: Array) -> None:
    """Write the normal force, the size of the friction, and whether the rod is free, sticks, or
    slides."""
    push, sliding = np.zeros(3), 0.0
    touch = now.touch
    for k in range(len(now.x)):
        for p in range(touch.normal.shape[1]):
            out[0] += touch.normal[k, p]
            sliding += touch.normal[k, p] if touch.state[k, p] == SLIDES else 0.0
            square = 0.0
            for c in range(3):
                square += touch.elongation[k, p, c] ** 2
            if square > 0.0:
                for c in range(3):
                    push[c] += touch.friction[k, p] * touch.elongation[k, p, c] / np.sqrt(square)
    out[1] = np.sqrt(push[0] ** 2 + push[1] ** 2 + push[2] ** 2)
    if out[0] > 0.0:
        out[2] = 2.0 if sliding > 0.5 * out[0] else 1.0
