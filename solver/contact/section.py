"""How are the contact forces of a step found where the points move with some of few coordinates?"""

from __future__ import annotations

import math

import numpy as np

from ..bodies.base import Array
from ..compiled import njit
from .normal import PLASTIC
from .rigid_section import EASED, JUMPING, NEWTON_LIMIT, SHORTEST, TOLERANCE
from .step import Points, Section, pushes

# Newton's inverse is renewed where an iteration leaves more than this share of the residual.
SLOW = 0.2


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
