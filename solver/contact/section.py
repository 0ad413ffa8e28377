"""Newton's method for the contact forces of a step, in the coordinates of the end section.

The points' approach depends on few coordinates z of the section. These respond to the points'
forces by a compliance C: z = C g(f(z)), with g the forces gathered along the rows of the points.
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
# A step that does not reduce the residual is halved, down to this share of it.
SHORTEST = 0.1
# Beyond `JUMPING` iterations, more than a smooth step needs, Newton's method may be alternating
# across a kink of the law. From then on its steps are shortened to `EASED`, except where the last
# one left at most `STRAIGHT` of the residual and so met no kink.
JUMPING, EASED, STRAIGHT = 50, 0.3, 0.75
# Without friction the line search reduces the energy's slope along a step to this share.
NEARLY, BISECTIONS = 0.1, 40
# The inverse of Newton's matrix is updated if an iteration leaves more than `SLOW` of the residual.
# Up to `FEW` coordinates, as of a rigid section, are solved for anew each time.
SLOW, FEW = 0.2, 8


class Room(NamedTuple):
    """Work space of a solution, so that steps allocate nothing: coordinates, their last values,
    Newton's step, residual and gathered forces (r,), the points' slopes (n, 6), the contact's
    stiffness and Newton's matrix (r, r), which is empty beyond `FEW` coordinates."""

    z: Array
    old: Array
    step: Array
    residual: Array
    gathered: Array
    slopes: Array
    stiff: Array
    jacobian: Array


class Section(NamedTuple):
    """Kinematics and compliance of the contact points in the section's coordinates z (r,).

    The approach of point i changes by -``values[i]`` (3, s) times the entries ``support[i]`` (s,)
    of z. z is ``compliance`` (r, r) times the points' forces gathered along the same rows.
    ``inverse`` (r, r) is a cached inverse of Newton's matrix, valid where ``factored`` (1,).
    ``reach`` (r,) is the largest displacement of a point by a unit of each coordinate.
    ``predictor`` (2, r) holds z after the last step and its change, from which the iteration
    starts.
    """

    support: NDArray[np.int64]
    values: Array
    compliance: Array
    inverse: Array
    factored: NDArray[np.bool_]
    reach: Array
    predictor: Array
    room: Room


@njit
def new_section(support: NDArray[np.int64], values: Array, compliance: Array) -> Section:
    """A section before its first step."""
    n, r = len(support), len(compliance)
    reach = np.zeros(r)
    for i in range(n):
        for a in range(support.shape[1]):
            for c in range(3):
                reach[support[i, a]] = max(reach[support[i, a]], abs(values[i, c, a]))
    factored, predictor = np.zeros(1, dtype=np.bool_), np.zeros((2, r))
    room = Room(
        z=np.zeros(r),
        old=np.zeros(r),
        step=np.zeros(r),
        residual=np.zeros(r),
        gathered=np.zeros(r),
        slopes=np.zeros((n, 6)),
        stiff=np.zeros((r, r)),
        jacobian=np.zeros((r, r) if r <= FEW else (0, 0)),
    )
    return Section(support, values, compliance, np.zeros((r, r)), factored, reach, predictor, room)


@inlined
def moved_approach(section: Section, z: Array, i: int, axis: int, free: float) -> float:
    """Approach of point ``i`` along an axis of its frame: ``free`` changed by ``z``."""
    for a in range(section.support.shape[1]):
        free -= section.values[i, axis, a] * z[section.support[i, a]]
    return free


@njit
def gather(section: Section, weights: Array, force: Array, gathered: Array) -> None:
    """Write forces (n, 3) along the local frames as loads (r,) on the section's coordinates."""
    n, s = section.support.shape
    support, values = section.support, section.values
    gathered[:] = 0.0
    for i in range(n):
        if force[i, 0] == 0.0:
            continue
        f, f0, f1 = weights[i] * force[i, 0], weights[i] * force[i, 1], weights[i] * force[i, 2]
        for a in range(s):
            pushed = f * values[i, 0, a] + f0 * values[i, 1, a] + f1 * values[i, 2, a]
            gathered[support[i, a]] += pushed


@njit
def _write_forces(points: Points, section: Section, trial: Trial, z: Array, slopes: Array) -> None:
    """Write the points' approach at the end and force at ``z``, and the ``slopes`` (n, 6) of the
    force.

    Points out of contact cost one product.
    """
    start, free, end, force = trial.start, trial.free, trial.end, trial.force
    for i in range(len(points.weights)):
        end[i, 0] = moved_approach(section, z, i, 0, free[i, 0])
        m = trial.multiplier[i, 0]
        clear = end[i, 0] + points.proximal * m <= 0.0 and start[i, 0] <= 0.0 and m == 0.0
        if clear and trial.memory[i, 2] == 0.0:
            force[i, 0] = force[i, 1] = force[i, 2] = 0.0
            for c in range(6):
                slopes[i, c] = 0.0
            continue
        if points.mu > 0.0:
            end[i, 1] = moved_approach(section, z, i, 1, free[i, 1])
            end[i, 2] = moved_approach(section, z, i, 2, free[i, 2])
        push = point_force(points, trial, i)
        force[i, 0], force[i, 1], force[i, 2] = push.n, push.t0, push.t1
        slopes[i, 0], slopes[i, 1], slopes[i, 2] = push.n_s, push.t0_0, push.t1_1
        slopes[i, 3], slopes[i, 4], slopes[i, 5] = push.t0_1, push.t0_s, push.t1_s


@njit
def _tangent(section: Section, weights: Array, slopes: Array, stiff: Array) -> None:
    """Write the derivative (r, r) of the gathered forces by z, for points with these ``slopes``."""
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
    """Write the inverse of Newton's matrix 1 + C ``stiff``, using only the rows that are loaded."""
    pushed = np.zeros(len(stiff), dtype=np.bool_)
    for a in range(len(stiff)):
        for b in range(len(stiff)):
            if stiff[a, b] != 0.0:
                pushed[a] = pushed[b] = True
    inner = np.flatnonzero(pushed)
    answers = section.compliance[:, inner] @ stiff[inner][:, inner]
    correction = answers @ np.linalg.inv(np.eye(len(inner)) + answers[inner])
    section.inverse[:, :] = np.eye(len(stiff))
    for k in range(len(inner)):
        section.inverse[:, inner[k]] -= correction[:, k]
    section.factored[0] = True


@njit
def _eliminate(matrix: Array, right: Array, x: Array) -> None:
    """Solve ``matrix`` x = ``right`` by Gaussian elimination with pivoting; overwrites the matrix.

    For a handful of unknowns LAPACK's overhead would be most of a step.
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
    """Write z - C g; returns the largest displacement of a point by it."""
    r, largest = len(z), 0.0
    for a in range(r):
        total = z[a]
        for b in range(r):
            total -= section.compliance[a, b] * gathered[b]
        residual[a] = total
        largest = max(largest, section.reach[a] * abs(total))
    return largest


@njit
def _descend(points: Points, section: Section, trial: Trial, z: Array, least: float) -> None:
    """Newton's method for ``z`` (r,) without friction, down to a residual of ``least``.

    The residual is then the compliance times the gradient of a convex energy of section and
    contact. A line search finds the zero of the energy's slope along each step. So the energy
    decreases with every step, and the iteration cannot alternate (J. Nocedal and S. J. Wright,
    Numerical Optimization (2006), §3.1).
    """
    n, r = len(points.weights), len(z)
    residual, gathered = np.empty(r), np.empty(r)
    slopes, stiff = np.empty((n, 6)), np.empty((r, r))
    here = z.copy()
    for _ in range(NEWTON_LIMIT):
        _write_forces(points, section, trial, z, slopes)
        gather(section, points.weights, trial.force, gathered)
        if _residual(section, z, gathered, residual) <= least:
            return
        _tangent(section, points.weights, slopes, stiff)
        step = np.linalg.solve(np.eye(r) + section.compliance @ stiff, residual)
        along = np.linalg.lstsq(section.compliance, step)[0]
        first, low, high, share = along @ residual, 0.0, 2.0, 1.0
        here[:] = z
        for _ in range(BISECTIONS):
            z[:] = here - share * step
            _write_forces(points, section, trial, z, slopes)
            gather(section, points.weights, trial.force, gathered)
            _residual(section, z, gathered, residual)
            slope = along @ residual
            if abs(slope) <= NEARLY * first or (share == 1.0 and slope > 0.0):
                break
            low, high = (share, high) if slope > 0.0 else (low, share)
            share = 0.5 * (low + high)


@njit
def solve_section(points: Points, section: Section, trial: Trial) -> int:
    """Write the ``trial``'s force, and its approach at the end; returns the number of iterations.

    Returns minus one if they do not converge.
    """
    n, r = len(points.weights), len(section.compliance)
    start, free, predictor = trial.start, trial.free, section.predictor
    axes = 3 if points.mu > 0.0 else 1
    z, old, step, residual, gathered, slopes, stiff, jacobian = section.room
    for a in range(r):
        old[a], step[a] = predictor[0, a], 0.0
        z[a] = old[a] + predictor[1, a]
    far = 0.0
    for i in range(n):
        far = max(far, abs(free[i, 0]))
        for c in range(axes):
            far = max(far, abs(free[i, c] - start[i, c]))
    before, share, descended = math.inf, 1.0, False
    for iteration in range(NEWTON_LIMIT):
        _write_forces(points, section, trial, z, slopes)
        gather(section, points.weights, trial.force, gathered)
        change = _residual(section, z, gathered, residual)
        if change <= TOLERANCE * far:
            for a in range(r):
                predictor[0, a], predictor[1, a] = z[a], z[a] - old[a]
            for i in range(n):
                for c in range(3):
                    trial.end[i, c] = moved_approach(section, z, i, c, free[i, c])
            return iteration + 1
        if iteration >= JUMPING and points.mu == 0.0 and not descended:
            _descend(points, section, trial, z, TOLERANCE * far)
            section.factored[0], descended = False, True
            before, share = math.inf, 1.0
            continue
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
    """The contact's stiffness (r, r) in series with the section's compliance, at the last solution:
    minus the derivative of the gathered forces by the coordinates of the free section."""
    n, r = len(points.weights), len(section.compliance)
    slopes, stiff = np.empty((n, 6)), np.empty((r, r))
    _write_forces(points, section, trial, section.predictor[0], slopes)
    _tangent(section, points.weights, slopes, stiff)
    return np.linalg.solve(np.eye(r) + stiff @ section.compliance, stiff)
