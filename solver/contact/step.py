"""What contact does in one time step: normal and friction forces of a point, what they took.

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
from .friction import friction_force, tangential_stiffness
from .normal import ADHESIVE, CONSERVING, PLASTIC, clear_at, elastic, normal_force, remembered


class Points(NamedTuple):
    """The law at the contact points over one step: what all of a step's functions read.

    ``law`` see contact.laws, ``kt`` and ``mu`` are friction's, ``scale`` (n,) the points' stiffness
    over the law's, ``series`` Nitsche's compliance, ``soft`` that of the augmented Lagrangian,
    ``drag`` the law's damping over the time step.
    ``end_weight`` is `CONSERVING` or the weight of the end of the step.

    What changes from step to step is the points' ``memory`` (n, 3): the elongation in m of
    friction's springs along both tangents, then what the law remembers (contact.normal).
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
def recalled(points: Points, memory: Array, i: int) -> float:
    """What the law remembers of point ``i``."""
    return memory[i, 2] if points.law[0] >= PLASTIC else 0.0


@njit
def holds(points: Points, memory: Array) -> bool:
    """Whether adhesion holds a point."""
    return points.law[0] == ADHESIVE and memory[:, 2].max() > 0.0


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
    memory: float,
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Force N, T of one point over a step, and its derivatives by the drive at the end.

    ``start`` and ``end`` are the normal drives, the slips how far the tangential ones go over the
    step, (e0, e1) friction's spring, (m, m0, m1) the multiplier, ``memory`` the normal law's. The
    derivatives are dN/ds, dT0/d0, dT1/d1, dT0/d1 = dT1/d0, dT0/ds, dT1/ds.
    """
    normal, k = normal_force(law, drag, scale, series, start, end, end_weight, soft, m, memory)
    if mu == 0.0 or normal <= 0.0:
        return normal, 0.0, 0.0, k, 0.0, 0.0, 0.0, 0.0, 0.0
    part, weight, at_end, k_end = 1.0, 1.0, normal, k
    rigid = math.isinf(law[1])
    if end_weight == CONSERVING and not rigid:
        part = 0.5
    elif not rigid:
        weight = end_weight
        at_end, k_end, _ = elastic(law, scale, end, series, memory)
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
    memory: Array,
    multiplier: Array,
    force: Array,
    slope: Array,
) -> None:
    """Write force (n, 3) of point ``i`` over a step and its derivative (n, 3, 3) by the drive.

    ``start`` and ``end`` (n, 3) are the drives, ``multiplier`` (n, 3) the augmented Lagrangian's.
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
        memory[i, 0],
        memory[i, 1],
        multiplier[i, 0],
        multiplier[i, 1],
        multiplier[i, 2],
        recalled(points, memory, i),
    )
    force[i, 0], force[i, 1], force[i, 2] = f, f0, f1
    slope[i, 0, 0], slope[i, 0, 1], slope[i, 0, 2] = k, 0.0, 0.0
    slope[i, 1, 0], slope[i, 1, 1], slope[i, 1, 2] = k0, k00, k01
    slope[i, 2, 0], slope[i, 2, 1], slope[i, 2, 2] = k1, k01, k11


@njit
def commit(points: Points, start: Array, end: Array, force: Array, memory: Array) -> float:
    """Let friction's springs in ``memory`` follow a step; returns what it took, in J.

    Where the normal force has ended, what is left in the spring is lost.
    """
    taken = 0.0
    if points.mu == 0.0:
        return taken
    weight, weights, scale = points.end_weight, points.weights, points.scale
    kt, series = points.kt, points.series
    for i in range(len(weights)):
        e0, e1 = memory[i, 0], memory[i, 1]
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
            memory[i, 0] = memory[i, 1] = 0.0
            taken += weights[i] * before
            continue
        if weight == CONSERVING:
            e0, e1 = 2.0 * pull0 / stiffness - e0, 2.0 * pull1 / stiffness - e1
        else:
            old = (1.0 - weight) * stiffness if start[i, 0] > 0.0 else 0.0
            e0 = (pull0 - old * e0) / (weight * stiffness)
            e1 = (pull1 - old * e1) / (weight * stiffness)
        memory[i, 0], memory[i, 1] = e0, e1
        after = 0.5 * stiffness * (e0 * e0 + e1 * e1)
        taken += weights[i] * (work - (after - before))
    return taken


@njit
def settle(points: Points, start: Array, end: Array, force: Array, memory: Array) -> float:
    """Let the normal law's memory follow a step; returns what the law took, in J.

    That is the work done on it less the change of what it stores.
    """
    taken = 0.0
    law, remembers = points.law, points.law[0] >= PLASTIC
    if points.drag == 0.0 and not remembers:
        return taken
    for i in range(len(points.weights)):
        old = recalled(points, memory, i)
        if start[i, 0] > 0.0 or end[i, 0] > 0.0 or old != 0.0:
            scale = points.scale[i]
            new = remembered(law, scale, end[i, 0], old)
            held = elastic(law, scale, end[i, 0], points.series, new)[2]
            held -= elastic(law, scale, start[i, 0], points.series, old)[2]
            work = force[i, 0] * (end[i, 0] - start[i, 0])
            taken += points.weights[i] * (work - held)
            if remembers:
                memory[i, 2] = new
    return taken


@njit
def share_in_contact(
    points: Points, start: Array, end: Array, force: Array, memory: Array
) -> float:
    """The share of a step after which its forces have ended: one, or less where contact ends in it.

    To be asked before `settle`.
    """
    first = last = -math.inf
    remembers = points.law[0] >= PLASTIC
    for i in range(len(points.weights)):
        clear = 0.0
        if remembers:
            if force[i, 0] == 0.0:
                continue
            clear = clear_at(points.law, points.scale[i], recalled(points, memory, i))
        first, last = max(first, start[i, 0] - clear), max(last, end[i, 0] - clear)
    if last >= 0.0 or first <= last:
        return 1.0
    return max(first, 0.0) / (first - last)


@njit
def share_under_drag(before: float, total: float) -> float:
    """The share of a step after which a force that drag ends while it is still pressed has ended.

    ``before`` and ``total`` are the mean forces of the step before and of this one, in N: the force
    goes on as straight as it came down. Up to half a step more than the step, since the next one
    has a mean of nothing.
    """
    falling = before - total
    return 0.5 + min(total / falling, 1.0) if falling > 0.0 else 1.0


@njit
def spring_energy(points: Points, memory: Array) -> float:
    """What the springs of friction hold, in J."""
    held = 0.0
    if points.mu == 0.0 or math.isinf(points.kt):
        return held
    for i in range(len(points.weights)):
        stiffness = tangential_stiffness(points.kt, points.scale[i], points.series)
        squared = memory[i, 0] ** 2 + memory[i, 1] ** 2
        held += 0.5 * points.weights[i] * stiffness * squared
    return held


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
