"""Newton's method for the contact forces of a step, on the coordinates of the end section.

The approach of the points changes by what few coordinates z of the section move them by, and these
answer to the points' forces by a compliance: z = C g(f(z)), with g the forces gathered along the
rows that move the points.
"""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Array
from ..compiled import njit
from .normal import PLASTIC
from .points import PointLaw, Points, PointTrial, Trial
from .rigid_section import (
    EASED,
    JUMPING,
    NEWTON_LIMIT,
    SHORTEST,
    TOLERANCE,
    Section,
    section_moves,
    solve_rigid_section,
)
from .step import point_force

# Newton's inverse is renewed where an iteration leaves more than this share of the residual.
SLOW = 0.2


@njit
def _gathered_forces(
    points: Points, section: Section, trial: Trial, z: Array, slopes: Array, gathered: Array
) -> None:
    """Write the points' forces with their ``slopes`` (n, 6) at ``z``, and gather them (r,).

    Points that do not touch cost one product.
    """
    n, s = section.support.shape
    support, values, weights = section.support, section.values, points.weights
    start, free, force = trial.start, trial.free, trial.force
    memory, multiplier = trial.memory, trial.multiplier
    law, scale, proximal = points.law, points.scale, points.proximal
    rubs, remembers = points.mu > 0.0, points.law[0] >= PLASTIC
    gathered[:] = 0.0
    for i in range(n):
        end = free[i, 0]
        for a in range(s):
            end -= values[i, 0, a] * z[support[i, a]]
        m = multiplier[i, 0]
        kept = memory[i, 2] if remembers else 0.0
        clear = end + proximal * m <= 0.0 and start[i, 0] <= 0.0 and m == 0.0
        if clear and kept == 0.0:
            force[i, 0] = force[i, 1] = force[i, 2] = 0.0
            for c in range(6):
                slopes[i, c] = 0.0
            continue
        slip0 = slip1 = 0.0
        if rubs:
            slip0, slip1 = free[i, 1] - start[i, 1], free[i, 2] - start[i, 2]
            for a in range(s):
                moved = z[support[i, a]]
                slip0 -= values[i, 1, a] * moved
                slip1 -= values[i, 2, a] * moved
        push = point_force(
            PointLaw(
                law,
                points.kt,
                points.mu,
                scale[i],
                points.compliance,
                points.end_weight,
                proximal,
                points.dashpot,
            ),
            PointTrial(
                start[i, 0],
                end,
                slip0,
                slip1,
                memory[i, 0],
                memory[i, 1],
                m,
                multiplier[i, 1],
                multiplier[i, 2],
                kept,
            ),
        )
        force[i, 0], force[i, 1], force[i, 2] = push.n, push.t0, push.t1
        slopes[i, 0], slopes[i, 1], slopes[i, 2] = push.n_s, push.t0_0, push.t1_1
        slopes[i, 3], slopes[i, 4], slopes[i, 5] = push.t0_1, push.t0_s, push.t1_s
        f, f0, f1 = weights[i] * push.n, weights[i] * push.t0, weights[i] * push.t1
        if rubs:
            for a in range(s):
                pushed = f * values[i, 0, a] + f0 * values[i, 1, a] + f1 * values[i, 2, a]
                gathered[support[i, a]] += pushed
        else:
            for a in range(s):
                gathered[support[i, a]] += f * values[i, 0, a]


@njit
def _tangent(section: Section, weights: Array, slopes: Array) -> Array:
    """How gathered forces change with z (r, r) where points push back with ``slopes``."""
    n, s = section.support.shape
    support, values = section.support, section.values
    r = len(section.compliance)
    stiff = np.zeros((r, r))
    for i in range(n):
        k, k00, k11 = slopes[i, 0], slopes[i, 1], slopes[i, 2]
        k01, k0, k1 = slopes[i, 3], slopes[i, 4], slopes[i, 5]
        w = weights[i]
        axes = 3 if k00 != 0.0 or k11 != 0.0 or k0 != 0.0 or k1 != 0.0 else 1
        if axes == 1 and k == 0.0:
            continue
        if axes == 1:
            for a in range(s):
                left = w * k * values[i, 0, a]
                if left != 0.0:
                    row = support[i, a]
                    for b in range(s):
                        stiff[row, support[i, b]] += left * values[i, 0, b]
            continue
        k, k00, k11, k01, k0, k1 = w * k, w * k00, w * k11, w * k01, w * k0, w * k1
        for a in range(s):
            v0, v1, v2 = values[i, 0, a], values[i, 1, a], values[i, 2, a]
            left = k * v0 + k0 * v1 + k1 * v2
            left1, left2 = k00 * v1 + k01 * v2, k01 * v1 + k11 * v2
            if left != 0.0 or left1 != 0.0 or left2 != 0.0:
                row = support[i, a]
                for b in range(s):
                    pushed = left * values[i, 0, b] + left1 * values[i, 1, b]
                    stiff[row, support[i, b]] += pushed + left2 * values[i, 2, b]
    return stiff


@njit
def _invert(section: Section, stiff: Array) -> None:
    """Write the inverse of Newton's matrix 1 + C ``stiff``, by way of the rows that are pushed."""
    r = len(stiff)
    pushed = np.zeros(r, dtype=np.bool_)
    for a in range(r):
        for b in range(r):
            if stiff[a, b] != 0.0:
                pushed[a] = pushed[b] = True
    inner = np.flatnonzero(pushed)
    m = len(inner)
    product = np.zeros((m, r))
    for k in range(m):
        column = section.compliance[:, inner[k]].copy()
        for j in range(m):
            factor = stiff[inner[k], inner[j]]
            if factor != 0.0:
                for a in range(r):
                    product[j, a] += factor * column[a]
    core = np.empty((m, m))
    for j in range(m):
        for k in range(m):
            core[k, j] = product[j, inner[k]]
        core[j, j] += 1.0
    answer = np.linalg.inv(core).T @ product
    inverse = section.inverse
    inverse[:, :] = 0.0
    for a in range(r):
        inverse[a, a] = 1.0
        for k in range(m):
            inverse[a, inner[k]] -= answer[k, a]
    section.factored[0] = True


@njit
def solve_section(points: Points, section: Section, trial: Trial) -> int:
    """Write the ``trial``'s force, and its approach at the end; the number of iterations.

    Minus one where they do not converge. Newton's inverse is renewed where it makes the residual
    fall too slowly. Where all points move with all coordinates, `solve_rigid_section` does the
    same, in half to two thirds of the time: 1000 leaning drops of a beam, 81 points on six
    coordinates, take 1.3 to 1.5 s by it and 1.8 to 2.0 s by way of the support and an inverse.
    """
    if section.whole:
        return solve_rigid_section(points, section, trial)
    n, r = len(points.weights), len(section.compliance)
    start, free, end = trial.start, trial.free, trial.end
    axes = 3 if points.mu > 0.0 else 1
    old = section.predictor[0].copy()
    z = old + section.predictor[1]
    step: Array = np.zeros(r)
    gathered, slopes = np.empty(r), np.empty((n, 6))
    far = 0.0
    for i in range(n):
        far = max(far, abs(free[i, 0]))
        for c in range(axes):
            far = max(far, abs(free[i, c] - start[i, c]))
    before, share = math.inf, 1.0
    for iteration in range(NEWTON_LIMIT):
        _gathered_forces(points, section, trial, z, slopes, gathered)
        residual = z - section.compliance @ gathered
        change = (section.reach * np.abs(residual)).max()
        if change <= TOLERANCE * far:
            section.predictor[0], section.predictor[1] = z, z - old
            section_moves(section, z, 3, end)
            for i in range(n):
                for c in range(3):
                    end[i, c] = free[i, c] - end[i, c]
            return iteration + 1
        if change >= before and share > SHORTEST:
            share *= 0.5
            z += share * step
            continue
        if not section.factored[0] or change > SLOW * before or iteration >= JUMPING:
            _invert(section, _tangent(section, points.weights, slopes))
        before, share = change, 1.0
        step = section.inverse @ residual
        if iteration >= JUMPING:
            step *= EASED
        z -= step
    section.factored[0] = False
    section.predictor[:] = 0.0
    return -1
