"""Contact over one step at the points: forces with their tangents, losses, and stored energy.

In the conserving scheme the normal force N is the discrete gradient of the law's potential
(Gonzalez, J. Nonlinear Sci. 6, 1996), and friction T that of its spring's. So elastic contact does
no net work, and friction never adds energy (contact.friction). Schemes with an ``end_weight``
evaluate the law at the end of the step and interpolate.

The augmented Lagrangian is in proximal form: its forces are evaluated at the approach plus the
proximal compliance × (multiplier - force).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ..arrays import Array
from ..compiled import inlined, njit
from .friction import elongated, friction_force, tangential_stiffness
from .normal import elastic_at_end, normal_force
from .points import CONSERVING, PointForce, Points, Trial


class Taken(NamedTuple):
    """Contact over a step: its mean and final normal force in N, the ``share`` of the step at which
    it ended, and the energy lost to friction and to the law, in J.

    The final force is that of the law without damping; on a rigid plane it is the mean force.
    """

    mean_N: float
    final_N: float
    share: float
    friction_loss_J: float
    contact_loss_J: float


@inlined
def point_force(points: Points, trial: Trial, i: int) -> PointForce:
    """Force of point ``i`` over a step, with its derivatives."""
    normal, k = normal_force(points, trial, i)
    mu = points.mu
    if mu == 0.0 or normal <= 0.0:
        return PointForce(normal, 0.0, 0.0, k, 0.0, 0.0, 0.0, 0.0, 0.0)
    part, weight, at_end, k_end = 1.0, 1.0, normal, k
    rigid = math.isinf(points.law[0])
    if points.end_weight == CONSERVING and not rigid:
        part = 0.5
    elif not rigid:
        weight = points.end_weight
        at_end, k_end = elastic_at_end(points, trial, i)
    t0, t1, stick, slides = friction_force(points, trial, i, mu * at_end, part)
    f0, f1 = weight * t0, weight * t1
    if weight != 1.0 and trial.start[i, 0] > 0.0:
        stiffness = tangential_stiffness(points, i)
        f0 += (1.0 - weight) * stiffness * trial.memory[i, 0]
        f1 += (1.0 - weight) * stiffness * trial.memory[i, 1]
    k_t = weight * stick
    if not slides:
        return PointForce(normal, f0, f1, k, k_t, k_t, 0.0, 0.0, 0.0)
    size = math.sqrt(t0 * t0 + t1 * t1)
    if size == 0.0:
        return PointForce(normal, f0, f1, k, 0.0, 0.0, 0.0, 0.0, 0.0)
    d0, d1 = t0 / size, t1 / size
    lean = weight * mu * k_end
    return PointForce(
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
def take(points: Points, trial: Trial, last: float) -> Taken:
    """Update friction's springs and the law's memory after a step; ``last`` is the mean normal
    force of the step before, in N."""
    weights, end = points.weights, trial.end
    rigid = math.isinf(points.law[0]) and points.proximal > 0.0
    mean = final = 0.0
    for i in range(len(weights)):
        mean += weights[i] * trial.force[i, 0]
    share = 1.0
    if points.dashpot != 0.0 and end[:, 0].max() > 0.0:
        share = _share_under_damping(last, mean)
    elif points.kind.remembers or end[:, 0].max() < 0.0:
        share = _share_in_contact(points, trial)
    friction, lost = commit(points, trial), settle(points, trial)
    for i in range(len(weights)):
        if not rigid and (end[i, 0] > 0.0 or points.kind.remembers):
            final += weights[i] * elastic_at_end(points, trial, i)[0]
    return Taken(mean, mean if rigid else final, share, friction, lost)


@inlined
def commit(points: Points, trial: Trial) -> float:
    """Update friction's springs in the memory after a step; returns the energy lost, in J.

    Where the normal force has ended, the energy left in the spring is lost.
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
        stiffness = tangential_stiffness(points, i)
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
            e0, e1 = elongated(points, trial, i)
        else:
            old = (1.0 - weight) * stiffness if start[i, 0] > 0.0 else 0.0
            e0 = (pull0 - old * e0) / (weight * stiffness)
            e1 = (pull1 - old * e1) / (weight * stiffness)
        memory[i, 0], memory[i, 1] = e0, e1
        after = 0.5 * stiffness * (e0 * e0 + e1 * e1)
        taken += weights[i] * (work - (after - before))
    return taken


@inlined
def settle(points: Points, trial: Trial) -> float:
    """Update the law's internal variables after a step; returns the energy lost, in J.

    That is the work done on the law less the change of its stored energy.
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
            memory[i, 2] = new
    return taken


@inlined
def _share_in_contact(points: Points, trial: Trial) -> float:
    """Share of a step at which its contact forces end: one, or less if contact ends within it.

    A point's force ends where it is clear, or before, where a dashpot pulls as hard as the spring
    pushes. Call it before `settle`.
    """
    share, remembers = 0.0, points.kind.remembers
    pulls = points.dashpot != 0.0 and not points.kind.damps_spring
    for i in range(len(points.weights)):
        start, end, scale = trial.start[i, 0], trial.end[i, 0], points.scale[i]
        clear = 0.0
        if remembers:
            if trial.force[i, 0] == 0.0:
                continue
            clear = points.kind.clear_at(points.law, scale, trial.memory[i, 2])
        if end >= clear:
            return 1.0
        if start <= clear:
            continue
        mine = (start - clear) / (start - end)
        if pulls:
            memory, compliance = trial.memory[i, 2], points.compliance
            pushed = points.kind.elastic(points.law, scale, start, compliance, memory)[0]
            pulled = points.dashpot * scale * (start - end)
            mine = mine * (1.0 - pulled / pushed) if pushed > pulled else 0.0
        share = max(share, mine)
    return share


@njit
def _share_under_damping(before: float, total: float) -> float:
    """Share of a step at which a force ends that a dashpot ends in compression.

    ``before`` and ``total`` are the mean forces of the last step and of this one, in N; the force
    is extrapolated linearly. The result may exceed one by up to a half, since the mean force of the
    next step is zero.
    """
    falling = before - total
    return 0.5 + min(total / falling, 1.0) if falling > 0.0 else 1.0


@njit
def spring_energy(points: Points, memory: Array) -> float:
    """Energy stored in friction's springs, in J."""
    held = 0.0
    if points.mu == 0.0 or math.isinf(points.kt):
        return held
    for i in range(len(points.weights)):
        squared = memory[i, 0] ** 2 + memory[i, 1] ** 2
        held += 0.5 * points.weights[i] * tangential_stiffness(points, i) * squared
    return held


@njit
def let_go(points: Points, memory: Array) -> float:
    """Release friction's springs at the end of a touch; returns the energy lost with them, in J."""
    held = spring_energy(points, memory)
    memory[:, :2] = 0.0
    return held
