"""What contact does in one time step: normal and friction forces of all points, compiled.

Every point has a local frame: its plane's normal, then two tangents. Its *drive* is minus the
displacement along these axes, the gap taken off the first (plus Nitsche's share of the body's
traction): the first component is the penetration s of contact.laws, the others grow as the point
slides backwards. The force on the body along the same axes is (N, T): N from the law, T from a
spring of stiffness Kt that elongates with the drive and gives way at μ N (return mapping, Wriggers,
Computational Contact Mechanics, 2006, Sec. 9.1, here at mid-step).

Over a step of the conserving scheme N is the discrete gradient of the normal potential and T that
of the spring's (Gonzalez, J. Nonlinear Sci. 6, 1996): elastic contact does no net work, and sliding
takes μ N times the slip, never less than zero. Schemes with an ``end_weight`` take the law at the
end of the step and interpolate.

``soft`` is the compliance of an augmented Lagrangian in its proximal form: forces then see the
drive plus soft × (multiplier - force).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..bodies.base import Array
from ..compiled import njit
from .laws import elastic

NEWTON_LIMIT = 200
TOLERANCE = 1e-11
# Newton's inverse is renewed where an iteration leaves more than this share of the residual.
SLOW = 0.2
# A step that does not lessen the residual is halved down to this share of it.
SHORTEST = 0.1
# Stages, and the factor between them, of `_solve_by_stiffening`.
STIFFENING_STAGES, STIFFENING = 8, 3.0
AUGMENTATION_LIMIT = 200
MULTIPLIER_TOLERANCE = 1e-9
CONSERVING = 0.0


@njit
def _mean_normal(
    law: Array,
    drag: float,
    scale: float,
    series: float,
    start: float,
    end: float,
    end_weight: float,
) -> tuple[float, float]:
    """Normal force over a step and its derivative by the drive at the end.

    The dashpot's is ``drag`` (damping over the step) times the change of penetration; together
    with the spring it pushes or does nothing.
    """
    mean, slope = _mean_elastic(law, scale, series, start, end, end_weight)
    if drag > 0.0 and (start > 0.0 or end > 0.0):
        mean += scale * drag * (max(end, 0.0) - max(start, 0.0))
        slope += scale * drag if end > 0.0 else 0.0
        if mean <= 0.0:
            return 0.0, 0.0
    return mean, slope


@njit
def _mean_elastic(
    law: Array, scale: float, series: float, start: float, end: float, end_weight: float
) -> tuple[float, float]:
    """The spring's part of the normal force over a step, and its derivative."""
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


@njit
def normal_force(
    law: Array,
    drag: float,
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
        return _mean_normal(law, drag, scale, series, start, end, end_weight)
    if math.isinf(law[1]):  # Signorini's condition holds at the end of the step
        force, slope, _ = elastic(law, scale, end + soft * multiplier, series + soft)
        return force, slope
    force = multiplier
    slope = 0.0
    for _ in range(NEWTON_LIMIT):
        mean, slope = _mean_normal(
            law, drag, scale, series, start, end + soft * (multiplier - force), end_weight
        )
        step = (mean - force) / (1.0 + soft * slope)
        force += step
        if abs(step) <= 1e-15 * abs(force):
            break
    return force, slope / (1.0 + soft * slope)


@njit
def tangential_stiffness(kt: float, scale: float, series: float) -> float:
    """The tangential spring seen through the compliance ``series``; infinite where both allow."""
    stiffness = scale * kt
    return 1.0 / (1.0 / stiffness + series) if series > 0.0 else stiffness


@njit
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


class Points(NamedTuple):
    """The law at the contact points over one step: what all of a step's functions read.

    ``law`` see contact.laws, ``kt`` and ``mu`` are friction's, ``scale`` (n,) the points' stiffness
    over the law's, ``series`` Nitsche's compliance, ``soft`` that of the augmented Lagrangian,
    ``drag`` the law's damping over the time step.
    ``end_weight`` is `CONSERVING` or the weight of the end of the step.
    """

    law: Array
    kt: float
    mu: float
    scale: Array
    series: float
    weights: Array
    end_weight: float
    soft: float
    drag: float = 0.0


@njit
def pushes(
    law: Array,
    drag: float,
    kt: float,
    mu: float,
    scale: float,
    series: float,
    end_weight: float,
    soft: float,
    start: float,
    end: float,
    slip0: float,
    slip1: float,
    e0: float,
    e1: float,
    m: float,
    m0: float,
    m1: float,
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Force N, T of one point over a step, and its derivatives by the drive at the end.

    ``start`` and ``end`` are the normal drives, the slips how far the tangential ones go over the
    step, (e0, e1) friction's spring, (m, m0, m1) the multiplier. The derivatives are dN/ds,
    dT0/d0, dT1/d1, dT0/d1 = dT1/d0, dT0/ds, dT1/ds.
    """
    normal, k = normal_force(law, drag, scale, series, start, end, end_weight, soft, m)
    if mu == 0.0 or normal <= 0.0:
        return normal, 0.0, 0.0, k, 0.0, 0.0, 0.0, 0.0, 0.0
    part, weight, at_end, k_end = 1.0, 1.0, normal, k
    rigid = math.isinf(law[1])
    if end_weight == CONSERVING and not rigid:
        part = 0.5
    elif not rigid:
        weight = end_weight
        at_end, k_end, _ = elastic(law, scale, end, series)
    stiffness = tangential_stiffness(kt, scale, series)
    t0, t1, stick, slides = friction_force(
        stiffness, mu * at_end, e0, e1, slip0, slip1, part, soft, m0, m1
    )
    f0, f1 = weight * t0, weight * t1
    if weight != 1.0 and start > 0.0:
        f0 += (1.0 - weight) * stiffness * e0
        f1 += (1.0 - weight) * stiffness * e1
    k_t = weight * stick
    if not slides:
        return normal, f0, f1, k, k_t, k_t, 0.0, 0.0, 0.0
    size = math.sqrt(t0 * t0 + t1 * t1)
    if size == 0.0:
        return normal, f0, f1, k, 0.0, 0.0, 0.0, 0.0, 0.0
    d0, d1 = t0 / size, t1 / size
    lean = weight * mu * k_end
    return (
        normal,
        f0,
        f1,
        k,
        k_t * (1.0 - d0 * d0),
        k_t * (1.0 - d1 * d1),
        -k_t * d0 * d1,
        lean * d0,
        lean * d1,
    )


@njit
def point_force(
    points: Points,
    i: int,
    start: Array,
    end: Array,
    elongation: Array,
    multiplier: Array,
    force: Array,
    slope: Array,
) -> None:
    """Write force (n, 3) of point ``i`` over a step and its derivative (n, 3, 3) by the drive.

    ``start`` and ``end`` (n, 3) are the drives, ``elongation`` (n, 2) that of friction's springs,
    ``multiplier`` (n, 3) the augmented Lagrangian's.
    """
    f, f0, f1, k, k00, k11, k01, k0, k1 = pushes(
        points.law,
        points.drag,
        points.kt,
        points.mu,
        points.scale[i],
        points.series,
        points.end_weight,
        points.soft,
        start[i, 0],
        end[i, 0],
        end[i, 1] - start[i, 1],
        end[i, 2] - start[i, 2],
        elongation[i, 0],
        elongation[i, 1],
        multiplier[i, 0],
        multiplier[i, 1],
        multiplier[i, 2],
    )
    force[i, 0], force[i, 1], force[i, 2] = f, f0, f1
    slope[i, 0, 0], slope[i, 0, 1], slope[i, 0, 2] = k, 0.0, 0.0
    slope[i, 1, 0], slope[i, 1, 1], slope[i, 1, 2] = k0, k00, k01
    slope[i, 2, 0], slope[i, 2, 1], slope[i, 2, 2] = k1, k01, k11


@njit
def commit(points: Points, start: Array, end: Array, force: Array, elongation: Array) -> float:
    """Let friction's springs ``elongation`` (n, 2) follow a step; returns what it took, in J.

    Where the normal force has ended, what is left in the spring is lost.
    """
    taken = 0.0
    if points.mu == 0.0:
        return taken
    weight, weights, scale = points.end_weight, points.weights, points.scale
    kt, series = points.kt, points.series
    for i in range(len(weights)):
        e0, e1 = elongation[i, 0], elongation[i, 1]
        if force[i, 0] <= 0.0 and e0 == 0.0 and e1 == 0.0:
            continue
        stiffness = tangential_stiffness(kt, scale[i], series)
        pull0, pull1 = force[i, 1], force[i, 2]
        work = pull0 * (end[i, 1] - start[i, 1]) + pull1 * (end[i, 2] - start[i, 2])
        if math.isinf(stiffness):
            taken += weights[i] * work
            continue
        before = 0.5 * stiffness * (e0 * e0 + e1 * e1)
        if force[i, 0] <= 0.0:
            elongation[i, 0] = elongation[i, 1] = 0.0
            taken += weights[i] * before
            continue
        if weight == CONSERVING:
            e0, e1 = 2.0 * pull0 / stiffness - e0, 2.0 * pull1 / stiffness - e1
        else:
            old = (1.0 - weight) * stiffness if start[i, 0] > 0.0 else 0.0
            e0 = (pull0 - old * e0) / (weight * stiffness)
            e1 = (pull1 - old * e1) / (weight * stiffness)
        elongation[i, 0], elongation[i, 1] = e0, e1
        after = 0.5 * stiffness * (e0 * e0 + e1 * e1)
        taken += weights[i] * (work - (after - before))
    return taken


@njit
def contact_loss(points: Points, start: Array, end: Array, force: Array) -> float:
    """What the law's dashpot took in a step, in J: the work on it that its spring does not hold."""
    taken = 0.0
    if points.drag == 0.0:
        return taken
    for i in range(len(points.weights)):
        if start[i, 0] > 0.0 or end[i, 0] > 0.0:
            held = elastic(points.law, points.scale[i], end[i, 0], points.series)[2]
            held -= elastic(points.law, points.scale[i], start[i, 0], points.series)[2]
            work = force[i, 0] * (end[i, 0] - start[i, 0])
            taken += points.weights[i] * (work - held)
    return taken


@njit
def spring_energy(points: Points, elongation: Array) -> float:
    """What the springs of friction hold, in J."""
    held = 0.0
    if points.mu == 0.0 or math.isinf(points.kt):
        return held
    for i in range(len(points.weights)):
        stiffness = tangential_stiffness(points.kt, points.scale[i], points.series)
        squared = elongation[i, 0] ** 2 + elongation[i, 1] ** 2
        held += 0.5 * points.weights[i] * stiffness * squared
    return held


@njit
def solve_dense(
    points: Points,
    response: Array,
    start: Array,
    free: Array,
    elongation: Array,
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
        active[i] = start[i, 0] > 0.0 or free[i, 0] + points.soft * multiplier[i, 0] > 0.0
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
                point_force(points, i, start, end, elongation, multiplier, force, slopes)
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


class Section(NamedTuple):
    """How contact points move with the coordinates z (r,) of the section, and these with force.

    The drive of point i changes by -``values[i]`` (3, s) times the entries ``support[i]`` (s,) of
    z, and z answers by ``response`` (r, r) to the points' forces gathered along the same rows.
    ``inverse`` (r, r) is Newton's, kept from step to step while it serves; ``ready`` (1,) says
    whether there is one. ``whole`` says that every point moves with all coordinates in their order,
    ``widest`` (r,) bounds how far a unit of each moves any point. ``guess`` (2, r) holds z
    after the step before and how that changed it, from which a rigid section's iteration starts.
    """

    support: NDArray[np.int64]
    values: Array
    response: Array
    inverse: Array
    ready: NDArray[np.bool_]
    whole: bool
    widest: Array
    guess: Array


@njit
def new_section(support: NDArray[np.int64], values: Array, response: Array) -> Section:
    """A section without an inverse yet; an empty ``response`` says that there is none."""
    inverse = np.zeros_like(response)
    whole = support.shape[1] == len(response)
    widest = np.zeros(len(response))
    for i in range(len(support)):
        for a in range(support.shape[1]):
            whole = whole and support[i, a] == a
            for c in range(3):
                if len(response):
                    reach = abs(values[i, c, a])
                    widest[support[i, a]] = max(widest[support[i, a]], reach)
    ready = np.zeros(1, dtype=np.bool_)
    guess = np.zeros((2, len(response)))
    return Section(support, values, response, inverse, ready, whole, widest, guess)


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
    elongation: Array,
    multiplier: Array,
    force: Array,
    end: Array,
) -> int:
    """As `solve_dense`, for points that move with few coordinates of the section.

    Newton's method on these; its inverse is renewed where it makes the residual fall too slowly.
    """
    n, r = len(points.weights), len(section.response)
    law, kt, mu, series = points.law, points.kt, points.mu, points.series
    drag = points.drag
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
            if normal + soft * m <= 0.0 and start[i, 0] <= 0.0 and m == 0.0:
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
                elongation[i, 0],
                elongation[i, 1],
                m,
                multiplier[i, 1],
                multiplier[i, 2],
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
        if not section.ready[0] or change > SLOW * before:
            _section_inverse(section, points.weights, force, slopes)
        before, share = change, 1.0
        step = section.inverse @ residual
        z -= step
    section.ready[0] = False
    return -1


@njit
def solve_rigid_section(
    points: Points,
    section: Section,
    start: Array,
    free: Array,
    elongation: Array,
    multiplier: Array,
    force: Array,
    end: Array,
) -> int:
    """As `solve_section`, where every point moves with all coordinates in their order.

    One pass over the points an iteration; points that do not touch cost one product.
    """
    n, r = len(points.weights), len(section.response)
    law, kt, mu, series = points.law, points.kt, points.mu, points.series
    drag = points.drag
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
            if normal + soft * m <= 0.0 and start[i, 0] <= 0.0 and m == 0.0:
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
                elongation[i, 0],
                elongation[i, 1],
                m,
                multiplier[i, 1],
                multiplier[i, 2],
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
        for a in range(r):
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


@njit
def _solve_at_once(
    points: Points,
    section: Section,
    response: Array,
    start: Array,
    free: Array,
    elongation: Array,
    multiplier: Array,
    force: Array,
    end: Array,
) -> int:
    """By way of the ``section`` where it has coordinates, else by `solve_dense`."""
    if section.whole:
        return solve_rigid_section(points, section, start, free, elongation, multiplier, force, end)
    if len(section.response):
        return solve_section(points, section, start, free, elongation, multiplier, force, end)
    return solve_dense(points, response, start, free, elongation, multiplier, force, end)


@njit
def _solve_by_stiffening(
    points: Points,
    section: Section,
    response: Array,
    start: Array,
    free: Array,
    elongation: Array,
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
        done = _solve_at_once(
            eased, section, response, start, free, elongation, multiplier, force, end
        )
        if done < 0:
            return -1
        total += done
    return total


@njit
def solve_step(
    points: Points,
    section: Section,
    response: Array,
    start: Array,
    free: Array,
    elongation: Array,
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
            points, section, response, start, free, elongation, multiplier, force, end
        )
        if done < 0 and points.mu > 0.0 and not math.isinf(points.kt):
            done = _solve_by_stiffening(
                points, section, response, start, free, elongation, multiplier, force, end
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
