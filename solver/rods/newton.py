"""A rod in Newton's method: what counts as no residual, and how nodes move by a step.

The iteration is `joint.joint_step`.
"""

from __future__ import annotations

import numpy as np

from ..arrays import Array
from ..compiled import njit
from .chain import Chain
from .element import foresee, measure
from .rotation import exponential, multiply, normalise

# Newton's step turns no node by more, in rad.
FURTHEST_RAD = 0.5
# A residual counts as none below this share of EI/L², or where it is the rounding of coordinates
# that the stiffest springs of an element feel.
NEAR, ROUNDING = 1e-8, 2e-15


@njit
def force_tolerance(chain: Chain, x: Array, rate: float) -> float:
    """A force in N that is nothing to this rod: moments are compared with it times the length.

    ``rate``, β over the time step, stiffens it against rounding too.
    """
    total = stiffest = farthest = 0.0
    for e in range(len(chain.length)):
        total += chain.length[e]
        for c in range(3):
            farthest = max(farthest, abs(x[e, c]), abs(x[e + 1, c]))
            stiffest = max(stiffest, chain.stiffness[e, c] / chain.length[e])
    bending = min(chain.stiffness[0, 3], chain.stiffness[0, 4]) / (total * total)
    return NEAR * bending + ROUNDING * (1.0 + rate) * stiffest * (farthest + total)


@njit
def excess(residual: Array, force: float, moment: float) -> float:
    """The greatest force or moment on nodes that are free, over those in N and in N m that count as
    none."""
    most_force = most_moment = 0.0
    for i in range(1, len(residual)):
        for c in range(3):
            # one that is no number is not lost in a maximum
            if not abs(residual[i, c]) <= most_force:
                most_force = abs(residual[i, c])
            if not abs(residual[i, 3 + c]) <= most_moment:
                most_moment = abs(residual[i, 3 + c])
    return max(most_force / force, most_moment / moment)


@njit
def move(chain: Chain, x: Array, q: Array, solution: Array, part: float, target: Array) -> None:
    """Move free nodes by ``part`` of Newton's step, or less: none turns by more than 0.5 rad.

    Rotations take the step as it is. Positions are then those that give every element the stretch
    and the shear which the step foresees, from the clamp on: straight displacements would stretch
    an element that turns, by the square of its angle, and set off its stiffest springs. Both agree
    to first order. ``target`` (e, 3) is room.
    """
    most = 0.0
    for i in range(1, len(x)):
        for c in range(3):
            most = max(most, abs(solution[i, 3 + c]))
    share = min(part, FURTHEST_RAD / most) if most > 0.0 else part
    middle, strain, step = np.empty((3, 3)), np.empty(6), np.empty(4)
    for e in range(len(chain.length)):
        foresee(chain, x, q, e, solution, share, middle, strain, target[e])
    for i in range(1, len(x)):
        w = solution[i]
        exponential(share * w[3], share * w[4], share * w[5], step)
        multiply(step, q[i], q[i])
        normalise(q[i])
    for e in range(len(chain.length)):
        measure(x, q, e, chain.length[e], middle, strain)
        for i in range(3):
            along = 0.0
            for k in range(3):
                along += middle[i, k] * target[e, k]
            x[e + 1, i] = x[e, i] + chain.length[e] * along
