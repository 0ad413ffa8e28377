"""Contact over one step at the points: forces with their tangents, losses, and what is stored.

Over a step of the conserving scheme the normal force N is the discrete gradient of the law's
potential (Gonzalez, J. Nonlinear Sci. 6, 1996): elastic contact does no net work. Schemes with an
``end_weight`` take the law at the end of the step and interpolate. The proximal compliance is that
of an augmented Lagrangian in its proximal form: forces then see the approach plus the compliance ×
(multiplier - force).

Friction T is Coulomb's behind an elastic tangential spring. The spring elongates with the
tangential approach and gives way at μ N (return mapping, Wriggers, Computational Contact Mechanics,
2006, Sec. 9.1). The conserving scheme asks it at mid-step: the force over a step is that of the
spring elongated by half the slip, at most μ times the mean normal force. At the end of the step the
spring is on the yield surface or within: it keeps what was put into it, at most what μ times the
normal force at the end holds. So a step never gains (what went in is the work and what was stored,
what remains is no more), and what it takes is the work less the change of what is stored. The
discrete gradient alone, an elongation whose mean over the step makes the force, would take μ N
times the slip, and from the first step of sliding on swing about the yield surface for ever.
"""

from __future__ import annotations

import math

from ..arrays import Array
from ..compiled import inlined, njit
from .normal import normal_at_end, normal_force
from .points import CONSERVING, Points, Trial


@njit
def _tangential_stiffness(points: Points, i: int) -> float:
    """The tangential spring in series with Nitsche's compliance; infinite where both allow."""
    stiffness = points.scale[i] * points.kt
    return 1.0 / (1.0 / stiffness + points.compliance) if points.compliance > 0.0 else stiffness


@inlined
def point_force(points: Points, trial: Trial, i: int, tangent: Array) -> None:
    """Write the force of point ``i`` over a step into the ``trial``, and its derivatives (3, 3) by
    the approach at the end, all along the local frame."""
    force, end_weight = trial.force[i], points.end_weight
    normal, slope = normal_force(points, trial, i)
    force[0], force[1], force[2] = normal, 0.0, 0.0
    tangent[:, :] = 0.0
    tangent[0, 0] = slope
    mu = points.mu
    if mu == 0.0 or normal <= 0.0:
        return
    part, weight, at_end, slope_at_end = 1.0, 1.0, normal, slope
    rigid = math.isinf(points.law[0])
    if end_weight == CONSERVING and not rigid:
        part = 0.5
    elif not rigid:
        weight = end_weight
        at_end, slope_at_end, _ = points.kind.elastic(
            points.law, points.scale[i], trial.end[i, 0], points.compliance, trial.memory[i, 2]
        )
    stiffness, proximal = _tangential_stiffness(points, i), points.proximal
    compliance = part * proximal
    if not math.isinf(stiffness):
        compliance += 1.0 / stiffness
    for k in range(1, 3):
        slip = trial.end[i, k] - trial.start[i, k] + proximal * trial.multiplier[i, k]
        force[k] = (trial.memory[i, k - 1] + part * slip) / compliance
    size, limit = math.hypot(force[1], force[2]), mu * at_end
    share = limit / size if size > limit else 1.0
    stick = weight * part / compliance * share
    tangent[1, 1] = tangent[2, 2] = stick
    if size > limit:
        d1, d2, lean = force[1] / size, force[2] / size, weight * mu * slope_at_end
        tangent[1, 0], tangent[2, 0] = lean * d1, lean * d2
        tangent[1, 1] -= stick * d1 * d1
        tangent[2, 2] -= stick * d2 * d2
        tangent[1, 2] = tangent[2, 1] = -stick * d1 * d2
    for k in range(1, 3):
        force[k] *= weight * share
        if weight != 1.0 and trial.start[i, 0] > 0.0:
            force[k] += (1.0 - weight) * stiffness * trial.memory[i, k - 1]


@njit
def _elongated(points: Points, trial: Trial, i: int) -> tuple[float, float]:
    """Elongation (2,) of a point's spring after a step of the conserving scheme.

    Where it slides its direction is that of a path with a constant limit to second order in the
    slip, and the path's own where the slip is long (see the tractrix: tan φ/2 falls as exp(-s/R),
    with φ the angle to the slip s and R the elongation at the limit).
    """
    stiffness, e0, e1 = _tangential_stiffness(points, i), trial.memory[i, 0], trial.memory[i, 1]
    normal, t0, t1 = trial.force[i, 0], trial.force[i, 1], trial.force[i, 2]
    slip0, slip1 = trial.end[i, 1] - trial.start[i, 1], trial.end[i, 2] - trial.start[i, 2]
    limit = points.mu * normal / stiffness
    most = points.mu * normal_at_end(points, trial, i) / stiffness
    if math.hypot(e0 + 0.5 * slip0, e1 + 0.5 * slip1) <= limit:
        new0, new1 = 2.0 * t0 / stiffness - e0, 2.0 * t1 / stiffness - e1
        most = min(most, math.hypot(new0, new1))
    else:
        squared = e0 * e0 + e1 * e1 + 2.0 * (t0 * slip0 + t1 * slip1) / stiffness
        most = min(most, math.sqrt(max(squared, 0.0)))
        further = 1.0 + 0.5 * max(e0 * slip0 + e1 * slip1, 0.0) / (limit * limit)
        new0, new1 = e0 + further * slip0, e1 + further * slip1
    size = math.hypot(new0, new1)
    share = most / size if size > 0.0 else 0.0
    return share * new0, share * new1


@njit
def commit(points: Points, trial: Trial) -> float:
    """Let friction's springs in the memory follow a step; returns what it took, in J.

    Where the normal force has ended, what is left in the spring is lost.
    """
    taken = 0.0
    if points.mu == 0.0:
        return taken
    weight, weights = points.end_weight, points.weights
    start, end, force, memory = trial.start, trial.end, trial.force, trial.memory
    for i in range(len(weights)):
        e0, e1 = memory[i, 0], memory[i, 1]
        if force[i, 0] <= 0.0 and e0 == 0.0 and e1 == 0.0:
            continue
        stiffness = _tangential_stiffness(points, i)
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
            e0, e1 = _elongated(points, trial, i)
        else:
            old = (1.0 - weight) * stiffness if start[i, 0] > 0.0 else 0.0
            e0 = (pull0 - old * e0) / (weight * stiffness)
            e1 = (pull1 - old * e1) / (weight * stiffness)
        memory[i, 0], memory[i, 1] = e0, e1
        after = 0.5 * stiffness * (e0 * e0 + e1 * e1)
        taken += weights[i] * (work - (after - before))
    return taken


@njit
def settle(points: Points, trial: Trial) -> float:
    """Let the law's internal variables follow a step; returns what the law took, in J.

    That is the work done on it less the change of what it stores.
    """
    taken = 0.0
    kind, law, remembers = points.kind, points.law, points.kind.remembers
    if points.dashpot == 0.0 and not remembers:
        return taken
    start, end, force, memory = trial.start, trial.end, trial.force, trial.memory
    for i in range(len(points.weights)):
        old = memory[i, 2]
        if start[i, 0] > 0.0 or end[i, 0] > 0.0 or old != 0.0:
            scale = points.scale[i]
            new = kind.remembered(law, scale, end[i, 0], old)
            held = kind.elastic(law, scale, end[i, 0], points.compliance, new)[2]
            held -= kind.elastic(law, scale, start[i, 0], points.compliance, old)[2]
            work = force[i, 0] * (end[i, 0] - start[i, 0])
            taken += points.weights[i] * (work - held)
            if remembers:
                memory[i, 2] = new
    return taken


@njit
def share_in_contact(points: Points, trial: Trial) -> float:
    """The share of a step after which its forces have ended: one, or less where contact ends in it.

    To be asked before `settle`.
    """
    first = last = -math.inf
    remembers = points.kind.remembers
    for i in range(len(points.weights)):
        clear = 0.0
        if remembers:
            if trial.force[i, 0] == 0.0:
                continue
            clear = points.kind.clear_at(points.law, points.scale[i], trial.memory[i, 2])
        first, last = max(first, trial.start[i, 0] - clear), max(last, trial.end[i, 0] - clear)
    if last >= 0.0 or first <= last:
        return 1.0
    return max(first, 0.0) / (first - last)


@njit
def share_under_damping(before: float, total: float) -> float:
    """The share of a step after which a force that a dashpot ends in compression has ended.

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
        stiffness = _tangential_stiffness(points, i)
        squared = memory[i, 0] ** 2 + memory[i, 1] ** 2
        held += 0.5 * points.weights[i] * stiffness * squared
    return held
