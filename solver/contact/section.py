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
from ..compiled import njit
from .normal import internal
from .points import Points, PointTrial, Trial, law_at
from .step import point_force

NEWTON_LIMIT = 200
TOLERANCE = 1e-11
# A step that does not lessen the residual is halved down to this share of it.
SHORTEST = 0.1
# After so many iterations, as many as no smooth step needs, Newton's method may be jumping to and
# fro across a kink of the law: from then on it goes this share of its way, but all of it where the
# step before left no more than `STRAIGHT` of the residual, so that it met no kink.
JUMPING, EASED, STRAIGHT = 50, 0.3, 0.75
# The inverse of Newton's matrix is renewed where an iteration leaves more than this share of the
# residual; of so few coordinates, as a rigid section has, the matrix is solved with each time.
SLOW, FEW = 0.2, 8


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
    rubs = points.mu > 0.0
    gathered[:] = 0.0
    for i in range(n):
        end = free[i, 0]
        for a in range(s):
            end -= values[i, 0, a] * z[support[i, a]]
        m = multiplier[i, 0]
        remembered = internal(points, memory, i)
        clear = end + points.proximal * m <= 0.0 and start[i, 0] <= 0.0 and m == 0.0
        if clear and remembered == 0.0:
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
        response = point_force(
            law_at(points, i),
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
                remembered,
            ),
        )
        force[i, 0], force[i, 1], force[i, 2] = response.n, response.t0, response.t1
        slopes[i, 0], slopes[i, 1], slopes[i, 2] = response.n_s, response.t0_0, response.t1_1
        slopes[i, 3], slopes[i, 4], slopes[i, 5] = response.t0_1, response.t0_s, response.t1_s
        f, f0, f1 = weights[i] * response.n, weights[i] * response.t0, weights[i] * response.t1
        if rubs:
            for a in range(s):
                pushed = f * values[i, 0, a] + f0 * values[i, 1, a] + f1 * values[i, 2, a]
                gathered[support[i, a]] += pushed
        else:
            for a in range(s):
                gathered[support[i, a]] += f * values[i, 0, a]


@njit
def _tangent(section: Section, weights: Array, slopes: Array, stiff: Array) -> None:
    """Write how gathered forces change with z (r, r) where points push back with ``slopes``."""
    n, s = section.support.shape
    support, values = section.support, section.values
    stiff[:, :] = 0.0
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
    solution = np.linalg.inv(core).T @ product
    inverse = section.inverse
    inverse[:, :] = 0.0
    for a in range(r):
        inverse[a, a] = 1.0
        for k in range(m):
            inverse[a, inner[k]] -= solution[k, a]
    section.factored[0] = True


@njit
def _eliminate(matrix: Array, right: Array, x: Array) -> None:
    """Solve ``matrix`` x = ``right`` by Gauss's elimination with pivots; the matrix is used up.

    For a handful of unknowns, where LAPACK's overhead is most of a step.
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


@njit
def _jacobian(compliance: Array, stiff: Array, jacobian: Array) -> None:
    """Write Newton's matrix 1 + C ``stiff``."""
    r = len(stiff)
    jacobian[:, :] = 0.0
    for a in range(r):
        for c in range(r):
            factor = compliance[a, c]
            for b in range(r):
                jacobian[a, b] += factor * stiff[c, b]
        jacobian[a, a] += 1.0


@njit
def _residual(section: Section, z: Array, gathered: Array, residual: Array) -> float:
    """Write z - C g, and how far it moves any point at most."""
    r, largest = len(z), 0.0
    for a in range(r):
        total = z[a]
        for b in range(r):
            total -= section.compliance[a, b] * gathered[b]
        residual[a] = total
        largest = max(largest, section.reach[a] * abs(total))
    return largest


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
    step, residual = np.zeros(r), np.empty(r)
    gathered, slopes, stiff = np.empty(r), np.empty((n, 6)), np.empty((r, r))
    jacobian = np.empty((r, r)) if r <= FEW else stiff
    far = 0.0
    for i in range(n):
        far = max(far, abs(free[i, 0]))
        for c in range(axes):
            far = max(far, abs(free[i, c] - start[i, c]))
    before, share = math.inf, 1.0
    for iteration in range(NEWTON_LIMIT):
        _gathered_forces(points, section, trial, z, slopes, gathered)
        change = _residual(section, z, gathered, residual)
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
        if r <= FEW:
            _tangent(section, points.weights, slopes, stiff)
            _jacobian(section.compliance, stiff, jacobian)
            _eliminate(jacobian, residual, step)
        else:
            if not section.factored[0] or change > SLOW * before or iteration >= JUMPING:
                _tangent(section, points.weights, slopes, stiff)
                _invert(section, stiff)
            step[:] = section.inverse @ residual
        if iteration >= JUMPING and change > STRAIGHT * before:
            step *= EASED
        before, share = change, 1.0
        z -= step
    section.factored[0] = False
    section.predictor[:] = 0.0
    return -1


@njit
def contact_stiffness(points: Points, section: Section, trial: Trial) -> Array:
    """The contact's stiffness (r, r) in series with the section's compliance, about the last
    solution: what the gathered forces lose for each unit by which the free section moves."""
    n, r = len(points.weights), len(section.compliance)
    slopes, gathered, stiff = np.empty((n, 6)), np.empty(r), np.empty((r, r))
    _gathered_forces(points, section, trial, section.predictor[0], slopes, gathered)
    _tangent(section, points.weights, slopes, stiff)
    return np.linalg.solve(np.eye(r) + stiff @ section.compliance, stiff)
