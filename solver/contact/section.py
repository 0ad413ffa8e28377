"""Newton's method for the contact forces of a step, on the coordinates of the end section.

The approach of the points changes by what few coordinates z of the section move them by, and these
answer to the points' forces by a compliance: z = C g(f(z)), with g the forces gathered along the
rows that move the points.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..compiled import inlined, njit
from .points import Points, Trial
from .step import point_force

NEWTON_LIMIT = 200
TOLERANCE = 1e-11
# A step that does not lessen the residual is halved down to this share of it.
SHORTEST = 0.1
# After so many iterations, as many as no smooth step needs, Newton's method may be jumping to and
# fro across a kink of the law: from then on it goes this share of its way.
JUMPING, EASED = 50, 0.3
# The inverse of Newton's matrix is renewed where an iteration leaves more than this share of the
# residual.
SLOW = 0.2


class Section(NamedTuple):
    """How contact points move with the coordinates z (r,) of the section, and these with force.

    The approach of point i changes by -``values[i]`` (3, s) times the entries ``support[i]`` (s,)
    of z, and z answers by ``compliance`` (r, r) to the points' forces gathered along the same rows.
    ``inverse`` (r, r) of Newton's matrix is used from step to step while it serves; ``factored``
    (1,) says whether there is one. ``reach`` (r,) is how far a unit of each moves any point.
    ``predictor`` (2, r) holds z after the step before and how that changed it, from which the
    iteration starts.
    """

    support: NDArray[np.int64]
    values: Array
    compliance: Array
    inverse: Array
    factored: NDArray[np.bool_]
    reach: Array
    predictor: Array


@njit
def new_section(support: NDArray[np.int64], values: Array, compliance: Array) -> Section:
    """A section before its first step."""
    r = len(compliance)
    reach = np.zeros(r)
    for i in range(len(support)):
        for a in range(support.shape[1]):
            for c in range(3):
                reach[support[i, a]] = max(reach[support[i, a]], abs(values[i, c, a]))
    factored, predictor = np.zeros(1, dtype=np.bool_), np.zeros((2, r))
    return Section(support, values, compliance, np.zeros((r, r)), factored, reach, predictor)


@njit
def section_moves(section: Section, z: Array, axes: int, moved: Array) -> None:
    """Write what ``z`` moves the points by along the first ``axes`` of their frames (n, 3)."""
    n, s = section.support.shape
    support, values = section.support, section.values
    for i in range(n):
        for c in range(axes):
            total = 0.0
            for a in range(s):
                total += values[i, c, a] * z[support[i, a]]
            moved[i, c] = total


@njit
def section_gathers(section: Section, weights: Array, force: Array) -> Array:
    """Forces (n, 3) along the local frames as loads (r,) on the section's coordinates."""
    n, s = section.support.shape
    support, values = section.support, section.values
    gathered = np.zeros(len(section.compliance))
    for i in range(n):
        if force[i, 0] == 0.0:
            continue
        for c in range(3):
            pushed = weights[i] * force[i, c]
            if pushed != 0.0:
                for a in range(s):
                    gathered[support[i, a]] += values[i, c, a] * pushed
    return gathered


@inlined
def _write_end(section: Section, trial: Trial, z: Array, i: int, axis: int) -> None:
    """Write the approach at the end of the step of point ``i`` along one axis, at ``z``."""
    moved = 0.0
    for a in range(section.support.shape[1]):
        moved += section.values[i, axis, a] * z[section.support[i, a]]
    trial.end[i, axis] = trial.free[i, axis] - moved


@njit
def _gathered_forces(
    points: Points, section: Section, trial: Trial, z: Array, tangents: Array, gathered: Array
) -> None:
    """Write the points' forces at ``z``, their ``tangents`` (n, 3, 3), and the loads (r,) that they
    are on the section's coordinates.

    Points that do not touch cost one product.
    """
    n, s = section.support.shape
    support, values, weights = section.support, section.values, points.weights
    force = trial.force
    axes = 3 if points.mu > 0.0 else 1
    gathered[:] = 0.0
    for i in range(n):
        _write_end(section, trial, z, i, 0)
        m, kept = trial.multiplier[i, 0], trial.memory[i, 2]
        clear = trial.end[i, 0] + points.proximal * m <= 0.0 and trial.start[i, 0] <= 0.0
        if clear and m == 0.0 and kept == 0.0:
            force[i] = 0.0
            tangents[i] = 0.0
            continue
        for c in range(1, axes):
            _write_end(section, trial, z, i, c)
        point_force(points, trial, i, tangents[i])
        for c in range(axes):
            pushed = weights[i] * force[i, c]
            for a in range(s):
                gathered[support[i, a]] += values[i, c, a] * pushed


@njit
def _jacobian(points: Points, section: Section, tangents: Array) -> Array:
    """Newton's matrix 1 + C k (r, r), with k the change of the gathered forces with z."""
    n, s = section.support.shape
    support, values = section.support, section.values
    axes = 3 if points.mu > 0.0 else 1
    stiff = np.zeros_like(section.compliance)
    for i in range(n):
        for d in range(axes):
            for a in range(s):
                left = 0.0
                for c in range(axes):
                    left += points.weights[i] * tangents[i, c, d] * values[i, c, a]
                if left != 0.0:
                    for b in range(s):
                        stiff[support[i, a], support[i, b]] += left * values[i, d, b]
    return np.eye(len(stiff)) + section.compliance @ stiff


@njit
def solve_section(points: Points, section: Section, trial: Trial) -> int:
    """Write the ``trial``'s force, and its approach at the end; the number of iterations.

    Minus one where they do not converge.
    """
    n, r = len(points.weights), len(section.compliance)
    start, free, end = trial.start, trial.free, trial.end
    axes = 3 if points.mu > 0.0 else 1
    old = section.predictor[0].copy()
    z = old + section.predictor[1]
    step, gathered, tangents = np.zeros(r), np.empty(r), np.empty((n, 3, 3))
    far = 0.0
    for i in range(n):
        far = max(far, abs(free[i, 0]))
        for c in range(axes):
            far = max(far, abs(free[i, c] - start[i, c]))
    before, share = math.inf, 1.0
    for iteration in range(NEWTON_LIMIT):
        _gathered_forces(points, section, trial, z, tangents, gathered)
        residual = z - section.compliance @ gathered
        change = np.abs(section.reach * residual).max()
        if not change > TOLERANCE * far:  # nor where it is not finite, which a march looks for
            section.predictor[0], section.predictor[1] = z, z - old
            section_moves(section, z, 3, end)
            end[:, :] = free - end
            return iteration + 1
        if change >= before and share > SHORTEST:
            share *= 0.5
            z += share * step
            continue
        stale = not section.factored[0] or change > SLOW * before or iteration >= JUMPING
        if stale:
            section.inverse[:, :] = np.linalg.inv(_jacobian(points, section, tangents))
            section.factored[0] = True
        step[:] = section.inverse @ residual
        before, share = change, 1.0
        if iteration >= JUMPING:
            step *= EASED
        z -= step
    section.factored[0] = False
    section.predictor[:] = 0.0
    return -1
