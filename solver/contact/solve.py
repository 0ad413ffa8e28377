"""How are the contact forces of one step found? By Newton's method on what the points move with."""

from __future__ import annotations

import math

import numpy as np

from ..bodies.base import Array
from ..compiled import njit
from .normal import HELD, HELD_FAST, LETTING_GO, PLASTIC
from .rigid_section import EASED, JUMPING, NEWTON_LIMIT, SHORTEST, TOLERANCE, solve_rigid_section
from .step import Points, Section, holds, point_force, pushes, recalled

# Newton's inverse is renewed where an iteration leaves more than this share of the residual.
SLOW = 0.2
# Stages, and the factor between them, of `_solve_by_stiffening`.
STIFFENING_STAGES, STIFFENING = 8, 3.0
AUGMENTATION_LIMIT = 200
MULTIPLIER_TOLERANCE = 1e-9


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
    gathered = np.zeros(len(section.response))
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
def _section_inverse(section: Section, weights: Array, force: Array, slopes: Array) -> None:
    """Write the inverse of d(residual)/dz where points push back with ``slopes`` (n, 3, 3)."""
    n, s = section.support.shape
    r = len(section.response)
    stiff = np.zeros((r, r))
    left = np.empty((3, s))
    for i in range(n):
        if force[i, 0] == 0.0 and slopes[i, 0, 0] == 0.0:
            continue
        axes = 3 if slopes[i, 1, 1] != 0.0 or slopes[i, 2, 2] != 0.0 else 1
        for d in range(axes):
            for a in range(s):
                total = 0.0
                for c in range(3):
                    total += section.values[i, c, a] * slopes[i, c, d]
                left[d, a] = weights[i] * total
        for a in range(s):
            row = section.support[i, a]
            for d in range(axes):
                factor = left[d, a]
                if factor != 0.0:
                    for b in range(s):
                        stiff[row, section.support[i, b]] += factor * section.values[i, d, b]
    section.inverse[:, :] = np.linalg.inv(np.eye(r) + section.response @ stiff)
    section.ready[0] = True


@njit
def solve_dense(
    points: Points,
    response: Array,
    start: Array,
    free: Array,
    memory: Array,
    multiplier: Array,
    force: Array,
    end: Array,
) -> int:
    """Forces ``force`` and drives at the end ``end`` (n, 3) of one step, both written.

    ``free`` (n, 3) is the drive at the end without force, ``response`` (3 n, 3 n) how it changes by
    the forces. Newton's method on the drives of the points that touch; points that come to touch
    join. Returns the number of iterations, or minus one where they do not converge.
    """
    n = len(points.weights)
    width = 3 if points.mu > 0.0 else 1
    active = np.zeros(n, dtype=np.bool_)
    for i in range(n):
        pushed_on = free[i, 0] + points.soft * multiplier[i, 0] > 0.0
        active[i] = start[i, 0] > 0.0 or pushed_on or recalled(points, memory, i) != 0.0
    end[:, :] = free
    force[:, :] = 0.0
    slopes = np.zeros((n, 3, 3))
    total = 0
    if not active.any():
        return 0
    for _ in range(n + 1):
        touching = np.flatnonzero(active)
        size = width * len(touching)
        index = np.empty(size, dtype=np.int64)
        for p in range(len(touching)):
            for c in range(width):
                index[width * p + c] = 3 * touching[p] + c
        block = np.empty((size, size))
        for a in range(size):
            for b in range(size):
                block[a, b] = response[index[a], index[b]]
        pushed, x, base = np.empty(size), np.empty(size), np.empty(size)
        step: Array = np.zeros(size)
        reach = 0.0
        for a in range(size):
            i, c = index[a] // 3, index[a] % 3
            x[a], base[a] = end[i, c], free[i, c]
            reach = max(reach, abs(free[i, c] - start[i, c]), abs(free[i, 0]))
        done = False
        before, share = math.inf, 1.0
        for _ in range(NEWTON_LIMIT):
            for a in range(size):
                end[index[a] // 3, index[a] % 3] = x[a]
            for i in touching:
                point_force(points, i, start, end, memory, multiplier, force, slopes)
            for a in range(size):
                pushed[a] = force[index[a] // 3, index[a] % 3]
            residual = x - base - block @ pushed
            total += 1
            change = np.abs(residual).max()
            if change <= TOLERANCE * max(reach, np.abs(x - base).max()):
                done = True
                break
            if change >= before and share > SHORTEST:
                share *= 0.5
                x += share * step
                continue
            before, share = change, 1.0
            jacobian = np.eye(size)
            for p in range(len(touching)):
                for c in range(width):
                    for d in range(width):
                        s = slopes[touching[p], c, d]
                        if s != 0.0:
                            for a in range(size):
                                jacobian[a, width * p + d] -= block[a, width * p + c] * s
            step = np.linalg.solve(jacobian, residual)
            x -= step
        if not done:
            return -1
        joined = False
        flat = end.reshape(-1)
        flat[:] = free.reshape(-1) + response @ force.reshape(-1)
        for i in range(n):
            if not active[i] and end[i, 0] + points.soft * multiplier[i, 0] > 0.0:
                active[i] = joined = True
        if not joined:
            return total
    return -1


@njit
def solve_section(
    points: Points,
    section: Section,
    start: Array,
    free: Array,
    memory: Array,
    multiplier: Array,
    force: Array,
    end: Array,
) -> int:
    """As `solve_dense`, for points that move with few coordinates of the section.

    Newton's method on these; its inverse is renewed where it makes the residual fall too slowly.
    """
    n, r = len(points.weights), len(section.response)
    law, kt, mu, series = points.law, points.kt, points.mu, points.series
    drag, remembers = points.drag, points.law[0] >= PLASTIC
    end_weight, soft, scale = points.end_weight, points.soft, points.scale
    axes = 3 if mu > 0.0 else 1
    z = section.response @ section_gathers(section, points.weights, force)
    step: Array = np.zeros(r)
    moved = np.zeros((n, 3))
    slopes = np.zeros((n, 3, 3))
    reach = 0.0
    for i in range(n):
        reach = max(reach, abs(free[i, 0] - start[i, 0]), abs(free[i, 0]))
        for c in range(1, axes):
            reach = max(reach, abs(free[i, c] - start[i, c]))
    before, share = math.inf, 1.0
    for iteration in range(NEWTON_LIMIT):
        section_moves(section, z, axes, moved)
        for i in range(n):
            normal = free[i, 0] - moved[i, 0]
            m = multiplier[i, 0]
            kept = memory[i, 2] if remembers else 0.0
            clear = normal + soft * m <= 0.0 and start[i, 0] <= 0.0 and m == 0.0
            if clear and kept == 0.0:
                force[i, 0] = force[i, 1] = force[i, 2] = 0.0
                slopes[i, 0, 0] = slopes[i, 1, 1] = slopes[i, 2, 2] = 0.0
                continue
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
                free[i, 1] - moved[i, 1] - start[i, 1],
                free[i, 2] - moved[i, 2] - start[i, 2],
                memory[i, 0],
                memory[i, 1],
                m,
                multiplier[i, 1],
                multiplier[i, 2],
                kept,
            )
            force[i, 0], force[i, 1], force[i, 2] = f, f0, f1
            slopes[i, 0, 0] = k
            if mu > 0.0:
                slopes[i, 1, 0], slopes[i, 1, 1], slopes[i, 1, 2] = k0, k00, k01
                slopes[i, 2, 0], slopes[i, 2, 1], slopes[i, 2, 2] = k1, k01, k11
        residual = z - section.response @ section_gathers(section, points.weights, force)
        section_moves(section, residual, axes, moved)
        change = 0.0
        for i in range(n):
            for c in range(axes):
                change = max(change, abs(moved[i, c]))
        if change <= TOLERANCE * reach:
            section_moves(section, z, 3, moved)
            for i in range(n):
                for c in range(3):
                    end[i, c] = free[i, c] - moved[i, c]
            return iteration + 1
        if change >= before and share > SHORTEST:
            share *= 0.5
            z += share * step
            continue
        if not section.ready[0] or change > SLOW * before or iteration >= JUMPING:
            _section_inverse(section, points.weights, force, slopes)
        before, share = change, 1.0
        step = section.inverse @ residual
        if iteration >= JUMPING:
            step *= EASED
        z -= step
    section.ready[0] = False
    return -1


@njit
def _solve_at_once(
    points: Points,
    section: Section,
    response: Array,
    start: Array,
    free: Array,
    memory: Array,
    multiplier: Array,
    force: Array,
    end: Array,
) -> int:
    """By way of the ``section`` where it has coordinates, else by `solve_dense`."""
    if section.whole:
        return solve_rigid_section(points, section, start, free, memory, multiplier, force, end)
    if len(section.response):
        return solve_section(points, section, start, free, memory, multiplier, force, end)
    return solve_dense(points, response, start, free, memory, multiplier, force, end)


@njit
def _solve_by_stiffening(
    points: Points,
    section: Section,
    response: Array,
    start: Array,
    free: Array,
    memory: Array,
    multiplier: Array,
    force: Array,
    end: Array,
) -> int:
    """As `_solve_at_once`, friction's springs brought to their stiffness in stages.

    A stiff spring has so narrow a zone between sticking and sliding either way that Newton's method
    may jump across it for ever; each stage starts where a softer one ended.
    """
    force[:, :] = 0.0
    total = 0
    for stage in range(STIFFENING_STAGES, -1, -1):
        eased = Points(
            points.law,
            points.kt * STIFFENING**-stage,
            points.mu,
            points.scale,
            points.series,
            points.weights,
            points.end_weight,
            points.soft,
            points.drag,
        )
        section.guess[1, :] = 0.0
        done = _solve_at_once(eased, section, response, start, free, memory, multiplier, force, end)
        if done < 0:
            return -1
        total += done
    return total


@njit
def _solve_held(
    points: Points,
    section: Section,
    response: Array,
    start: Array,
    free: Array,
    memory: Array,
    multiplier: Array,
    force: Array,
    end: Array,
) -> int:
    """As `_solve_at_once`, adhesion first holding without limit; then what it cannot hold lets go.

    Letting go makes the force fall as the drive goes on, so a step may have several answers and
    Newton's method jump between them. Which points let go is decided here, once for each.
    """
    n = len(points.weights)
    total = 0
    for i in range(n):
        if memory[i, 2] == HELD:
            memory[i, 2] = HELD_FAST
    for _ in range(n + 1):
        force[:, :] = 0.0
        section.guess[:] = 0.0
        done = _solve_at_once(
            points, section, response, start, free, memory, multiplier, force, end
        )
        if done < 0:
            total = -1
            break
        total += done
        more = False
        for i in range(n):
            reach = points.law[2] / (points.scale[i] * points.law[1])
            if memory[i, 2] == HELD_FAST and end[i, 0] <= -reach:
                memory[i, 2] = LETTING_GO
                more = True
        if not more:
            break
    for i in range(n):
        if memory[i, 2] > HELD:
            memory[i, 2] = HELD
    return total


@njit
def solve_step(
    points: Points,
    section: Section,
    response: Array,
    start: Array,
    free: Array,
    memory: Array,
    multiplier: Array,
    force: Array,
    end: Array,
) -> int:
    """Forces ``force`` and drives at the end ``end`` (n, 3) of one step; returns the iterations.

    Where ``points`` are soft, ``multiplier`` (n, 3) is updated until it is the force itself: until
    an update changes no force by more than `MULTIPLIER_TOLERANCE` of the largest. Minus one where
    Newton's method fails, minus two where the updates take too long.
    """
    total = 0
    for _ in range(AUGMENTATION_LIMIT):
        done = _solve_at_once(
            points, section, response, start, free, memory, multiplier, force, end
        )
        if done < 0 and points.mu > 0.0 and not math.isinf(points.kt):
            done = _solve_by_stiffening(
                points, section, response, start, free, memory, multiplier, force, end
            )
        if done < 0 and holds(points, memory):
            done = _solve_held(
                points, section, response, start, free, memory, multiplier, force, end
            )
        if done < 0:
            return -1
        total += done
        if points.soft == 0.0:
            return total
        change = np.abs(force - multiplier).max()
        multiplier[:, :] = force
        if change <= MULTIPLIER_TOLERANCE * np.abs(force).max():
            return total
    return -2
