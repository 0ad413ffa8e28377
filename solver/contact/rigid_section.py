"""How are the contact forces of a step found where the end section is rigid?

Every point then moves with the same few coordinates, and the overhead of general solvers is most of
what a step would cost.
"""

from __future__ import annotations

import math

import numpy as np

from ..bodies.base import Array
from ..compiled import njit
from .normal import PLASTIC
from .step import Points, Section, pushes

NEWTON_LIMIT = 200
TOLERANCE = 1e-11
# A step that does not lessen the residual is halved down to this share of it.
SHORTEST = 0.1
# After so many iterations, as many as no smooth step needs, Newton's method may be jumping to and
# fro across a kink of the law: from then on it goes this share of its way.
JUMPING, EASED = 50, 0.3


@njit
def solve_rigid_section(
    points: Points,
    section: Section,
    start: Array,
    free: Array,
    memory: Array,
    multiplier: Array,
    force: Array,
    end: Array,
) -> int:
    """As `solve_section`, where every point moves with all coordinates in their order.

    One pass over the points an iteration; points that do not touch cost one product.
    """
    n, r = len(points.weights), len(section.response)
    law, kt, mu, series = points.law, points.kt, points.mu, points.series
    drag, remembers = points.drag, points.law[0] >= PLASTIC
    end_weight, soft, scale, weights = (
        points.end_weight,
        points.soft,
        points.scale,
        points.weights,
    )
    values, response, z = section.values, section.response, section.guess[0]
    axes = 3 if mu > 0.0 else 1
    widest = section.widest
    step: Array = np.zeros(r)
    gathered, residual, old = np.empty(r), np.empty(r), z.copy()
    jacobian = np.empty((r, r))
    slopes = np.empty((n, 6))
    for a in range(r):  # as the step before changed it
        z[a] += section.guess[1, a]
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
            clear = normal + soft * m <= 0.0 and start[i, 0] <= 0.0 and m == 0.0
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
            f, f0, f1, k, k00, k11, k01, k0, k1 = pushes(
                law,
                drag,
                kt,
                mu,
                scale[i],
                series,
                end_weight,
                soft,
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
            force[i, 0], force[i, 1], force[i, 2] = f, f0, f1
            slopes[i, 0], slopes[i, 1], slopes[i, 2] = k, k00, k11
            slopes[i, 3], slopes[i, 4], slopes[i, 5] = k01, k0, k1
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
                total -= response[a, b] * gathered[b]
            residual[a] = total
            change += widest[a] * abs(total)
        if change <= TOLERANCE * reach:
            for a in range(r):
                section.guess[1, a] = z[a] - old[a]
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
    section.guess[:] = 0.0
    return -1


@njit
def _section_jacobian(
    section: Section, weights: Array, slopes: Array, axes: int, jacobian: Array
) -> None:
    """Write d(residual)/dz (r, r) where points push back with `pushes`' ``slopes`` (n, 6)."""
    n, r = len(weights), len(section.response)
    values, response = section.values, section.response
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
                row[b] += response[a, c] * stiff[c, b]
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
