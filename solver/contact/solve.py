"""How are the contact forces of one step found, and what is tried where Newton's method fails?"""

from __future__ import annotations

import math

import numpy as np

from ..bodies.base import Array
from ..compiled import njit
from .normal import HELD, HELD_FAST, LETTING_GO
from .rigid_section import NEWTON_LIMIT, SHORTEST, TOLERANCE, solve_rigid_section
from .section import solve_section
from .step import Points, Section, holds, point_force, recalled

# Stages, and the factor between them, of `_solve_by_stiffening`.
STIFFENING_STAGES, STIFFENING = 8, 3.0
AUGMENTATION_LIMIT = 200
MULTIPLIER_TOLERANCE = 1e-9
# Of a drive that some sums of four products make.
ROUNDING = 1e-14


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
    an update changes no force by more than `MULTIPLIER_TOLERANCE` of the largest, or no drive by
    more than rounding. Minus one where Newton's method fails, minus two where the updates take too
    long.
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
        resolved = ROUNDING * np.abs(free).max() / points.soft
        if change <= max(MULTIPLIER_TOLERANCE * np.abs(force).max(), resolved):
            return total
    return -2
