"""How the end section moves the contact points, and Newton's method where it is rigid.

The approach of the points changes by what few coordinates z of the section move them by, and these
answer to the points' forces by a compliance. In a rigid section every point moves with all
coordinates, and the overhead of general solvers is most of what a step would cost.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..compiled import njit
from .normal import PLASTIC
from .points import PointLaw, Points, PointTrial, Trial
from .step import point_force

NEWTON_LIMIT = 200
TOLERANCE = 1e-11
# A step that does not lessen the residual is halved down to this share of it.
SHORTEST = 0.1
# After so many iterations, as many as no smooth step needs, Newton's method may be jumping to and
# fro across a kink of the law: from then on it goes this share of its way.
JUMPING, EASED = 50, 0.3


class Section(NamedTuple):
    """How contact points move with the coordinates z (r,) of the section, and these with force.

    The approach of point i changes by -``values[i]`` (3, s) times the entries ``support[i]`` (s,)
    of z, and z answers by ``compliance`` (r, r) to the points' forces gathered along the same rows.
    ``inverse`` (r, r) of Newton's matrix is used from step to step while it serves; ``factored``
    (1,) says whether there is one. ``reach`` (r,) is how far a unit of each moves any point.
    ``predictor`` (2, r) holds z after the step before and how that changed it, from which the
    iteration starts. ``whole`` says that every point moves with all coordinates in their order.
    """

    support: NDArray[np.int64]
    values: Array
    compliance: Array
    inverse: Array
    factored: NDArray[np.bool_]
    reach: Array
    predictor: Array
    whole: bool


@njit
def new_section(support: NDArray[np.int64], values: Array, compliance: Array) -> Section:
    """A section before its first step."""
    r = len(compliance)
    reach = np.zeros(r)
    whole = support.shape[1] == r
    for i in range(len(support)):
        for a in range(support.shape[1]):
            whole = whole and support[i, a] == a
            for c in range(3):
                reach[support[i, a]] = max(reach[support[i, a]], abs(values[i, c, a]))
    factored, predictor = np.zeros(1, dtype=np.bool_), np.zeros((2, r))
    return Section(support, values, compliance, np.zeros((r, r)), factored, reach, predictor, whole)


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


@njit
def solve_rigid_section(points: Points, section: Section, trial: Trial) -> int:
    """As `section.solve_section`, where every point moves with all coordinates in their order.

    One pass over the points an iteration; points that do not touch cost one product.
    """
    n, r = len(points.weights), len(section.compliance)
    start, free, end, force = trial.start, trial.free, trial.end, trial.force
    memory, multiplier = trial.memory, trial.multiplier
    law, kt, mu, compliance = points.law, points.kt, points.mu, points.compliance
    dashpot, remembers = points.dashpot, points.law[0] >= PLASTIC
    end_weight, proximal, scale = points.end_weight, points.proximal, points.scale
    weights, values, z = points.weights, section.values, section.predictor[0]
    axes = 3 if mu > 0.0 else 1
    bound = section.reach
    step: Array = np.zeros(r)
    gathered, residual, old = np.empty(r), np.empty(r), z.copy()
    jacobian = np.empty((r, r))
    slopes = np.empty((n, 6))
    for a in range(r):  # as the step before changed it
        z[a] += section.predictor[1, a]
    reach = 0.0
    for i in range(n):
        reach = max(reach, abs(free[i, 0]))
        for c in range(axes):
            reach = max(reach, abs(free[i, c] - start[i, c]))
    before, share = math.inf, 1.0
    for iteration in range(NEWTON_LIMIT):
        gathered[:] = 0.0
        for i in range(n):
            normal = free[i, 0]
            for a in range(r):
                normal -= values[i, 0, a] * z[a]
            m = multiplier[i, 0]
            kept = memory[i, 2] if remembers else 0.0
            clear = normal + proximal * m <= 0.0 and start[i, 0] <= 0.0 and m == 0.0
            if clear and kept == 0.0:
                force[i, 0] = force[i, 1] = force[i, 2] = 0.0
                slopes[i, 0] = 0.0
                continue
            slip0 = slip1 = 0.0
            if mu > 0.0:
                slip0, slip1 = free[i, 1] - start[i, 1], free[i, 2] - start[i, 2]
                for a in range(r):
                    slip0 -= values[i, 1, a] * z[a]
                    slip1 -= values[i, 2, a] * z[a]
            at = PointLaw(law, kt, mu, scale[i], compliance, end_weight, proximal, dashpot)
            point = PointTrial(
                start[i, 0],
                normal,
                slip0,
                slip1,
                memory[i, 0],
                memory[i, 1],
                m,
                multiplier[i, 1],
                multiplier[i, 2],
                kept,
            )
            push = point_force(at, point)
            f, f0, f1 = push.n, push.t0, push.t1
            force[i, 0], force[i, 1], force[i, 2] = f, f0, f1
            slopes[i, 0], slopes[i, 1], slopes[i, 2] = push.n_s, push.t0_0, push.t1_1
            slopes[i, 3], slopes[i, 4], slopes[i, 5] = push.t0_1, push.t0_s, push.t1_s
            w = weights[i]
            for a in range(r):
                gathered[a] += w * f * values[i, 0, a]
            if mu > 0.0:
                for a in range(r):
                    gathered[a] += w * (f0 * values[i, 1, a] + f1 * values[i, 2, a])
        change = 0.0
        for a in range(r):
            total = z[a]
            for b in range(r):
                total -= section.compliance[a, b] * gathered[b]
            residual[a] = total
            change += bound[a] * abs(total)
        if change <= TOLERANCE * reach:
            for a in range(r):
                section.predictor[1, a] = z[a] - old[a]
            for i in range(n):
                for c in range(3):
                    total = free[i, c]
                    for a in range(r):
                        total -= values[i, c, a] * z[a]
                    end[i, c] = total
            return iteration + 1
        if change >= before and share > SHORTEST:
            share *= 0.5
            for a in range(r):
                z[a] += share * step[a]
            continue
        before, share = change, 1.0
        _section_jacobian(section, weights, slopes, axes, jacobian)
        _eliminate(jacobian, residual, step)
        eased = 1.0 if iteration < JUMPING else EASED
        for a in range(r):
            step[a] *= eased
            z[a] -= step[a]
    section.predictor[:] = 0.0
    return -1


@njit
def _section_jacobian(
    section: Section, weights: Array, slopes: Array, axes: int, jacobian: Array
) -> None:
    """Write d(residual)/dz (r, r) where points push back with `pushes`' ``slopes`` (n, 6)."""
    n, r = len(weights), len(section.compliance)
    values, compliance = section.values, section.compliance
    stiff, row = np.zeros((r, r)), np.empty(r)
    for i in range(n):
        k = weights[i] * slopes[i, 0]
        if k == 0.0:
            continue
        for a in range(r):
            left = k * values[i, 0, a]
            for b in range(r):
                stiff[a, b] += left * values[i, 0, b]
        if axes == 1:
            continue
        w = weights[i]
        k00, k11, k01 = w * slopes[i, 1], w * slopes[i, 2], w * slopes[i, 3]
        k0, k1 = w * slopes[i, 4], w * slopes[i, 5]
        for a in range(r):
            v1, v2 = values[i, 1, a], values[i, 2, a]
            left, left1, left2 = k0 * v1 + k1 * v2, k00 * v1 + k01 * v2, k01 * v1 + k11 * v2
            for b in range(r):
                pushed = left * values[i, 0, b] + left1 * values[i, 1, b] + left2 * values[i, 2, b]
                stiff[a, b] += pushed
    for a in range(r):
        row[:] = 0.0
        for c in range(r):
            for b in range(r):
                row[b] += compliance[a, c] * stiff[c, b]
        for b in range(r):
            jacobian[a, b] = row[b]
        jacobian[a, a] += 1.0


@njit
def _eliminate(matrix: Array, right: Array, x: Array) -> None:
    """Solve ``matrix`` x = ``right`` by Gauss's elimination with pivots; the matrix is used up.

    For the handful of unknowns of a rigid section, where LAPACK's overhead is most of a step.
    """
    n = len(right)
    x[:] = right
    for k in range(n):
        p = k
        for i in range(k + 1, n):
            if abs(matrix[i, k]) > abs(matrix[p, k]):
                p = i
        if p != k:
            for j in range(k, n):
                matrix[k, j], matrix[p, j] = matrix[p, j], matrix[k, j]
            x[k], x[p] = x[p], x[k]
        for i in range(k + 1, n):
            factor = matrix[i, k] / matrix[k, k]
            if factor != 0.0:
                for j in range(k + 1, n):
                    matrix[i, j] -= factor * matrix[k, j]
                x[i] -= factor * x[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            x[k] -= matrix[k, j] * x[j]
        x[k] /= matrix[k, k]
