"""What contact does in one time step: normal and friction forces of all points, compiled.

Every point has a local frame: its plane's normal, then two tangents. Its *drive* is minus the
displacement along these axes, the gap taken off the first (plus Nitsche's share of the body's
traction): the first component is the penetration s of contact.laws, the others grow as the point
slides backwards. The force on the body along the same axes is (N, T): N from the law, T from a
spring of stiffness Kt that elongates with the drive and gives way at μ N (return mapping, Wriggers,
Computational Contact Mechanics, 2006, Sec. 9.1, here at mid-step).

Over a step of the conserving scheme N is the discrete gradient of the normal potential and T that of
the spring's (Gonzalez, J. Nonlinear Sci. 6, 1996): elastic contact does no net work, and sliding
takes μ N times the slip, never less than zero. Schemes with an ``end_weight`` take the law at the
end of the step and interpolate.

``soft`` is the compliance of an augmented Lagrangian in its proximal form: forces then see the drive
plus soft × (multiplier - force).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..bodies.base import Array
from .laws import elastic

NEWTON_LIMIT = 200
TOLERANCE = 1e-12
# Newton's inverse is renewed where an iteration leaves more than this share of the residual.
SLOW = 0.2
# A step that does not lessen the residual is halved down to this share of it.
SHORTEST = 0.1
AUGMENTATION_LIMIT = 200
MULTIPLIER_TOLERANCE = 1e-9
CONSERVING = 0.0


@njit(cache=True)
def _mean_normal(
    law: Array, scale: float, series: float, start: float, end: float, end_weight: float
) -> tuple[float, float]:
    """Normal force over a step and its derivative by the drive at the end."""
    force1, slope1, energy1 = elastic(law, scale, end, series)
    force0, _, energy0 = elastic(law, scale, start, series)
    if end_weight != CONSERVING:
        return end_weight * force1 + (1.0 - end_weight) * force0, end_weight * slope1
    change = end - start
    if abs(change) <= 1e-5 * max(abs(start), abs(end)):
        force, slope, _ = elastic(law, scale, 0.5 * (start + end), series)
        return force, 0.5 * slope
    mean = (energy1 - energy0) / change
    return mean, (force1 - mean) / change


@njit(cache=True)
def normal_force(
    law: Array,
    scale: float,
    series: float,
    start: float,
    end: float,
    end_weight: float,
    soft: float,
    multiplier: float,
) -> tuple[float, float]:
    """Normal force over a step and its derivative by the drive at the end, multiplier included."""
    if soft == 0.0:
        return _mean_normal(law, scale, series, start, end, end_weight)
    if math.isinf(law[1]):  # Signorini's condition holds at the end of the step
        force, slope, _ = elastic(law, scale, end + soft * multiplier, series + soft)
        return force, slope
    force = multiplier
    slope = 0.0
    for _ in range(NEWTON_LIMIT):
        mean, slope = _mean_normal(
            law, scale, series, start, end + soft * (multiplier - force), end_weight
        )
        step = (mean - force) / (1.0 + soft * slope)
        force += step
        if abs(step) <= 1e-15 * abs(force):
            break
    return force, slope / (1.0 + soft * slope)


@njit(cache=True)
def tangential_stiffness(kt: float, scale: float, series: float) -> float:
    """The tangential spring seen through the compliance ``series``; infinite where both allow."""
    compliance = series
    if not math.isinf(kt):
        compliance += 1.0 / (scale * kt)
    return math.inf if compliance == 0.0 else 1.0 / compliance


@njit(cache=True)
def friction_force(
    stiffness: float,
    limit: float,
    e0: float,
    e1: float,
    slip0: float,
    slip1: float,
    part: float,
    soft: float,
    m0: float,
    m1: float,
) -> tuple[float, float, float, bool]:
    """Friction (2,) by return mapping, d T / d slip while it sticks, and whether it slides.

    (e0, e1) is the spring's elongation at the start, (slip0, slip1) the change of drive over the
    step, ``part`` the share of it after which the law is asked (½ or 1), ``limit`` is μ N.
    """
    compliance = part * soft
    if not math.isinf(stiffness):
        compliance += 1.0 / stiffness
    t0 = (e0 + part * (slip0 + soft * m0)) / compliance
    t1 = (e1 + part * (slip1 + soft * m1)) / compliance
    size = math.hypot(t0, t1)
    if size <= limit:
        return t0, t1, part / compliance, False
    return limit * t0 / size, limit * t1 / size, part / compliance * limit / size, True


@njit(cache=True)
def point_force(
    law: Array,
    kt: float,
    mu: float,
    scale: float,
    series: float,
    start: Array,
    end: Array,
    elongation: Array,
    end_weight: float,
    soft: float,
    multiplier: Array,
    force: Array,
    slope: Array,
) -> None:
    """Force (3,) of one point over a step and its derivative (3, 3) by the drive at the end.

    ``start`` and ``end`` (3,) are the drives; ``force`` and ``slope`` are written.
    """
    normal, k = normal_force(law, scale, series, start[0], end[0], end_weight, soft, multiplier[0])
    force[0] = normal
    force[1] = force[2] = 0.0
    slope[:, :] = 0.0
    slope[0, 0] = k
    if mu == 0.0 or normal <= 0.0:
        return
    conserving = end_weight == CONSERVING
    part, weight, at_end, k_end = 1.0, 1.0, normal, k
    rigid = math.isinf(law[1])
    if conserving and not rigid:
        part = 0.5
    elif not rigid:
        weight = end_weight
        at_end, k_end, _ = elastic(law, scale, end[0], series)
    stiffness = tangential_stiffness(kt, scale, series)
    t0, t1, stick, slides = friction_force(
        stiffness,
        mu * at_end,
        elongation[0],
        elongation[1],
        end[1] - start[1],
        end[2] - start[2],
        part,
        soft,
        multiplier[1],
        multiplier[2],
    )
    force[1], force[2] = weight * t0, weight * t1
    if weight != 1.0 and start[0] > 0.0:
        force[1] += (1.0 - weight) * stiffness * elongation[0]
        force[2] += (1.0 - weight) * stiffness * elongation[1]
    if not slides:
        slope[1, 1] = slope[2, 2] = weight * stick
        return
    size = math.hypot(t0, t1)
    if size == 0.0:
        return
    d0, d1 = t0 / size, t1 / size
    slope[1, 1] = weight * stick * (1.0 - d0 * d0)
    slope[2, 2] = weight * stick * (1.0 - d1 * d1)
    slope[1, 2] = slope[2, 1] = -weight * stick * d0 * d1
    slope[1, 0] = weight * mu * k_end * d0
    slope[2, 0] = weight * mu * k_end * d1


@njit(cache=True)
def commit(
    law: Array,
    kt: float,
    scale: float,
    series: float,
    start: Array,
    end: Array,
    force: Array,
    elongation: Array,
    end_weight: float,
) -> float:
    """Let the spring's elongation (2,) follow a step; returns what friction took, in J.

    Where the normal force has ended, what is left in the spring is lost.
    """
    stiffness = tangential_stiffness(kt, scale, series)
    slip0, slip1 = end[1] - start[1], end[2] - start[2]
    if math.isinf(stiffness):
        return float(force[1] * slip0 + force[2] * slip1)
    before = 0.5 * stiffness * (elongation[0] ** 2 + elongation[1] ** 2)
    if force[0] <= 0.0:
        elongation[0] = elongation[1] = 0.0
        return float(before)
    work = force[1] * slip0 + force[2] * slip1
    if end_weight == CONSERVING:
        elongation[0] = 2.0 * force[1] / stiffness - elongation[0]
        elongation[1] = 2.0 * force[2] / stiffness - elongation[1]
    else:
        for k in range(2):
            part = 1.0 - end_weight if start[0] > 0.0 else 0.0
            old = part * stiffness * elongation[k]
            elongation[k] = (force[1 + k] - old) / (end_weight * stiffness)
    after = 0.5 * stiffness * (elongation[0] ** 2 + elongation[1] ** 2)
    return float(work - (after - before))


@njit(cache=True)
def solve_dense(
    law: Array,
    kt: float,
    mu: float,
    scale: Array,
    series: float,
    response: Array,
    start: Array,
    free: Array,
    elongation: Array,
    end_weight: float,
    soft: float,
    multiplier: Array,
    force: Array,
    end: Array,
) -> int:
    """Forces ``force`` and drives at the end ``end`` (n, 3) of one step, both written.

    ``free`` (n, 3) is the drive at the end without force, ``response`` (3 n, 3 n) how it changes by
    the forces. Newton's method on the drives of the points that touch; points that come to touch
    join. Returns the number of iterations, or minus one where they do not converge.
    """
    n = len(scale)
    width = 3 if mu > 0.0 else 1
    active = np.zeros(n, dtype=np.bool_)
    for i in range(n):
        shifted = free[i, 0] + soft * multiplier[i, 0]
        active[i] = start[i, 0] > 0.0 or shifted > 0.0
    end[:, :] = free
    force[:, :] = 0.0
    total = 0
    if not active.any():
        return 0
    for _ in range(n + 1):
        points = np.flatnonzero(active)
        size = width * len(points)
        index = np.empty(size, dtype=np.int64)
        for p in range(len(points)):
            for c in range(width):
                index[width * p + c] = 3 * points[p] + c
        block = np.empty((size, size))
        for a in range(size):
            for b in range(size):
                block[a, b] = response[index[a], index[b]]
        pushed = np.empty(size)
        slopes = np.empty((len(points), 3, 3))
        x = np.empty(size)
        base = np.empty(size)
        reach = 0.0
        for a in range(size):
            i, c = index[a] // 3, index[a] % 3
            x[a], base[a] = end[i, c], free[i, c]
            reach = max(reach, abs(free[i, c] - start[i, c]), abs(free[i, 0]))
        done = False
        before, share = math.inf, 1.0
        step = np.zeros(size)
        for _ in range(NEWTON_LIMIT):
            for p in range(len(points)):
                i = points[p]
                for c in range(width):
                    end[i, c] = x[width * p + c]
                point_force(
                    law,
                    kt,
                    mu,
                    scale[i],
                    series,
                    start[i],
                    end[i],
                    elongation[i],
                    end_weight,
                    soft,
                    multiplier[i],
                    force[i],
                    slopes[p],
                )
                for c in range(width):
                    pushed[width * p + c] = force[i, c]
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
            for p in range(len(points)):
                for c in range(width):
                    for d in range(width):
                        s = slopes[p, c, d]
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
            if not active[i] and end[i, 0] + soft * multiplier[i, 0] > 0.0:
                active[i] = joined = True
        if not joined:
            return total
    return -1


class Section(NamedTuple):
    """How contact points move with the coordinates z (r,) of the section, and these with force.

    The drive of point i changes by -``values[i]`` (3, s) times the entries ``support[i]`` (s,) of z,
    and z answers by ``response`` (r, r) to the points' forces gathered along the same rows.
    ``inverse`` (r, r) is Newton's, kept from step to step while it serves; ``ready`` (1,) says
    whether there is one.
    """

    support: NDArray[np.int64]
    values: Array
    response: Array
    inverse: Array
    ready: NDArray[np.bool_]


@njit(cache=True)
def new_section(support: NDArray[np.int64], values: Array, response: Array) -> Section:
    """A section without an inverse yet; an empty ``response`` says that there is none."""
    inverse = np.zeros_like(response)
    return Section(support, values, response, inverse, np.zeros(1, dtype=np.bool_))


@njit(cache=True)
def section_moves(section: Section, z: Array, moved: Array) -> None:
    """Write what ``z`` moves the points by along their local frames (n, 3)."""
    n, s = section.support.shape
    for i in range(n):
        for c in range(3):
            total = 0.0
            for a in range(s):
                total += section.values[i, c, a] * z[section.support[i, a]]
            moved[i, c] = total


@njit(cache=True)
def section_gathers(section: Section, weights: Array, force: Array) -> Array:
    """Forces (n, 3) along the local frames as loads (r,) on the section's coordinates."""
    n, s = section.support.shape
    gathered = np.zeros(len(section.response))
    for i in range(n):
        for c in range(3):
            pushed = weights[i] * force[i, c]
            if pushed != 0.0:
                for a in range(s):
                    gathered[section.support[i, a]] += section.values[i, c, a] * pushed
    return gathered


@njit(cache=True)
def _section_inverse(section: Section, weights: Array, slopes: Array) -> None:
    """Write the inverse of d(residual)/dz where points push back with ``slopes`` (n, 3, 3)."""
    n, s = section.support.shape
    r = len(section.response)
    stiff = np.zeros((r, r))
    left = np.empty((3, s))
    for i in range(n):
        if slopes[i, 0, 0] == 0.0:
            continue
        for d in range(3):
            for a in range(s):
                total = 0.0
                for c in range(3):
                    total += section.values[i, c, a] * slopes[i, c, d]
                left[d, a] = weights[i] * total
        for a in range(s):
            row = stiff[section.support[i, a]]
            for d in range(3):
                factor = left[d, a]
                if factor != 0.0:
                    for b in range(s):
                        row[section.support[i, b]] += factor * section.values[i, d, b]
    section.inverse[:, :] = np.linalg.inv(np.eye(r) + section.response @ stiff)
    section.ready[0] = True


@njit(cache=True)
def solve_section(
    law: Array,
    kt: float,
    mu: float,
    scale: Array,
    series: float,
    weights: Array,
    section: Section,
    start: Array,
    free: Array,
    elongation: Array,
    end_weight: float,
    soft: float,
    multiplier: Array,
    force: Array,
    end: Array,
) -> int:
    """As `solve_dense`, for points that move with few coordinates of the section.

    Newton's method on these; its inverse is renewed where it makes the residual fall too slowly.
    """
    n, r = len(scale), len(section.response)
    z = np.zeros(r)
    moved = np.empty((n, 3))
    slopes = np.empty((n, 3, 3))
    reach = 0.0
    for i in range(n):
        for c in range(3):
            reach = max(reach, abs(free[i, c] - start[i, c]), abs(free[i, 0]))
    before, share = math.inf, 1.0
    step = np.zeros(r)
    for iteration in range(NEWTON_LIMIT):
        section_moves(section, z, moved)
        for i in range(n):
            for c in range(3):
                end[i, c] = free[i, c] - moved[i, c]
            point_force(
                law,
                kt,
                mu,
                scale[i],
                series,
                start[i],
                end[i],
                elongation[i],
                end_weight,
                soft,
                multiplier[i],
                force[i],
                slopes[i],
            )
        residual = z - section.response @ section_gathers(section, weights, force)
        section_moves(section, residual, moved)
        change = np.abs(moved).max()
        if change <= TOLERANCE * reach:
            return iteration + 1
        if change >= before and share > SHORTEST:
            share *= 0.5
            z += share * step
            continue
        if not section.ready[0] or change > SLOW * before:
            _section_inverse(section, weights, slopes)
        before, share = change, 1.0
        step = section.inverse @ residual
        z -= step
    section.ready[0] = False
    return -1


@njit(cache=True)
def solve_step(
    law: Array,
    kt: float,
    mu: float,
    scale: Array,
    series: float,
    weights: Array,
    section: Section,
    response: Array,
    start: Array,
    free: Array,
    elongation: Array,
    end_weight: float,
    soft: float,
    multiplier: Array,
    force: Array,
    end: Array,
) -> int:
    """`solve_section` where the ``section`` has coordinates, else `solve_dense`.

    With ``soft``, ``multiplier`` (n, 3) is updated until it is the force itself: until an update
    changes no force by more than `MULTIPLIER_TOLERANCE` of the largest. Minus two where that takes
    too long.
    """
    total = 0
    for _ in range(AUGMENTATION_LIMIT):
        if len(section.response):
            done = solve_section(
                law,
                kt,
                mu,
                scale,
                series,
                weights,
                section,
                start,
                free,
                elongation,
                end_weight,
                soft,
                multiplier,
                force,
                end,
            )
        else:
            done = solve_dense(
                law,
                kt,
                mu,
                scale,
                series,
                response,
                start,
                free,
                elongation,
                end_weight,
                soft,
                multiplier,
                force,
                end,
            )
        if done < 0:
            return -1
        total += done
        if soft == 0.0:
            return total
        change = np.abs(force - multiplier).max()
        multiplier[:, :] = force
        if change <= MULTIPLIER_TOLERANCE * np.abs(force).max():
            return total
    return -2
