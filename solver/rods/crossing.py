"""Where in a time step contact begins or ends.

A step that ends deep in the surface takes the force at its end for its whole length, and one that
starts there and ends far above loses what the springs held. Either changes the energy, by about
what the point's spring holds at the end that touches. A step that ends where the point crosses the
surface does not.
"""

from __future__ import annotations

import numpy as np

from ..compiled import njit
from .chain import Chain, total_length
from .contact import FREE, Obstacle, point_gap
from .motion import Motion, Scheme
from .rotation import write_matrix

# A step goes so much beyond the crossing, and is never shorter than this share of itself.
BEYOND, LEAST_SHARE = 1.02, 0.02


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
            gap = max(point_gap(surface, k, free.x[i], matrix), 0.0)
            share = (gap if begins else depth) / (gap + depth)
            least = min(least, max(BEYOND * share, LEAST_SHARE))
    return least
