"""Newton's method for a rod: size of the residual, and motion of the nodes by a step.

The iteration is `joint.joint_step`.
"""

from __future__ import annotations

import numpy as np

from ..arrays import Array
from ..compiled import njit
from .chain import Chain
from .rotation import exponential, multiply, normalise, write_middle

# Largest rotation of a node in a Newton step, in rad.
FURTHEST_RAD = 0.5


@njit
def excess(residual: Array, force: float, moment: float) -> float:
    """The greatest force or moment on free nodes, over the tolerances in N and N m."""
    most_force = most_moment = 0.0
    for i in range(1, len(residual)):
        for c in range(3):
            # NaN does not pass this comparison
            if not abs(residual[i, c]) <= most_force:
                most_force = abs(residual[i, c])
            if not abs(residual[i, 3 + c]) <= most_moment:
                most_moment = abs(residual[i, 3 + c])
    return max(most_force / force, most_moment / moment)


@njit
def place_nodes(
    chain: Chain, x: Array, q: Array, stretch: Array, change: Array, part: float
) -> None:
    """Write the positions ``x`` (n, 3) of free nodes, from the clamp on, for given strains.

    Γ of `element.measure` is ``stretch`` (e, 3 or more) plus ``part`` of its ``change``.
    """
    middle = np.empty((3, 3))
    for e in range(len(chain.length)):
        write_middle(q, e, middle)
        for i in range(3):
            along = 0.0
            for k in range(3):
                along += middle[i, k] * (stretch[e, k] + part * change[e, k])
            x[e + 1, i] = x[e, i] + chain.length[e] * along


@njit
def move(chain: Chain, x: Array, q: Array, solution: Array, part: float, foreseen: Array) -> None:
    """Move free nodes by ``part`` of Newton's step, limited to a rotation of 0.5 rad.

    Rotations follow the step. Positions are then those that give every element the stretch and
    shear ``foreseen`` (2, e, 3), see `element.foresee`. Straight displacements would stretch a
    turning element by the square of its angle, and so load its stiffest springs. Both agree to
    first order.
    """
    most = 0.0
    for i in range(1, len(x)):
        for c in range(3):
            most = max(most, abs(solution[i, 3 + c]))
    share, step = min(part, FURTHEST_RAD / most) if most > 0.0 else part, np.empty(4)
    for i in range(1, len(x)):
        w = solution[i]
        exponential(share * w[3], share * w[4], share * w[5], step)
        multiply(step, q[i], q[i])
        normalise(q[i])
    place_nodes(chain, x, q, foreseen[0], foreseen[1], share)
