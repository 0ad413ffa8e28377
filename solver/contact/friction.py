"""Coulomb friction at one point behind an elastic tangential spring: stick and slip over a step.

The spring elongates with the tangential approach and slides at μ N (return mapping, Wriggers,
Computational Contact Mechanics, 2006, Sec. 9.1). Schemes with an ``end_weight`` evaluate the law at
the end of the step.

The conserving scheme evaluates it at mid-step: the spring is elongated by half the slip, and its
force is at most μ times the mean normal force. At the end of the step the spring keeps the energy
that was put into it, but no more than μ times the normal force at the end allows. So friction never
adds energy, and its loss is the work less the change of the stored energy. The plain discrete
gradient, an elongation whose mean over the step gives the force, would dissipate μ N times the slip
and, from the first step of sliding on, oscillate about the yield surface for ever.
"""

from __future__ import annotations

import math

from ..compiled import inlined
from .normal import normal_at_end
from .points import Points, Trial

TINY = 1e-300


@inlined
def tangential_stiffness(points: Points, i: int) -> float:
    """Point ``i``'s tangential spring in series with Nitsche's compliance; infinite if both are."""
    stiffness = points.scale[i] * points.kt
    return 1.0 / (1.0 / stiffness + points.compliance) if points.compliance > 0.0 else stiffness


@inlined
def friction_force(
    points: Points, trial: Trial, i: int, limit: float, part: float
) -> tuple[float, float, float, bool]:
    """Friction (2,) by return mapping, its stiffness d T / d slip, and whether the point slides.

    ``part`` is the share of the step at which the law is evaluated (½ or 1), ``limit`` is μ N.
    """
    stiffness, proximal = tangential_stiffness(points, i), points.proximal
    compliance = part * proximal
    if not math.isinf(stiffness):
        compliance += 1.0 / stiffness
    slip0 = trial.end[i, 1] - trial.start[i, 1] + proximal * trial.multiplier[i, 1]
    slip1 = trial.end[i, 2] - trial.start[i, 2] + proximal * trial.multiplier[i, 2]
    t0 = (trial.memory[i, 0] + part * slip0) / compliance
    t1 = (trial.memory[i, 1] + part * slip1) / compliance
    size = math.hypot(t0, t1)
    if size <= limit:
        return t0, t1, part / compliance, False
    return limit * t0 / size, limit * t1 / size, part / compliance * limit / size, True


@inlined
def elongated(points: Points, trial: Trial, i: int) -> tuple[float, float]:
    """Elongation (2,) of point ``i``'s spring after a step of the conserving scheme.

    While the point slides, the direction is that of a path with a constant limit. It is accurate to
    second order in the slip, and exact for long slips (tractrix: tan φ/2 falls as exp(-s/R), with φ
    the angle to the slip s and R the elongation at the limit).
    """
    normal, t0, t1 = trial.force[i, 0], trial.force[i, 1], trial.force[i, 2]
    stiffness, e0, e1 = tangential_stiffness(points, i), trial.memory[i, 0], trial.memory[i, 1]
    slip0, slip1 = trial.end[i, 1] - trial.start[i, 1], trial.end[i, 2] - trial.start[i, 2]
    limit = points.mu * normal / stiffness
    most = points.mu * normal_at_end(points, trial, i) / stiffness
    if math.hypot(e0 + 0.5 * slip0, e1 + 0.5 * slip1) <= limit:
        new0, new1 = 2.0 * t0 / stiffness - e0, 2.0 * t1 / stiffness - e1
        size = math.hypot(new0, new1)
        share = most / size if size > most else 1.0
        return share * new0, share * new1
    squared = e0 * e0 + e1 * e1 + 2.0 * (t0 * slip0 + t1 * slip1) / stiffness
    most = min(most, math.sqrt(max(squared, 0.0)))
    # the square of a limit of next to no friction is too small for a number
    further = 1.0 + 0.5 * max(e0 * slip0 + e1 * slip1, 0.0) / max(limit * limit, TINY)
    new0, new1 = e0 + further * slip0, e1 + further * slip1
    size = math.hypot(new0, new1)
    share = most / size if size > 0.0 else 0.0
    return share * new0, share * new1
