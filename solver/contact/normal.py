"""Compiled contact laws at one point: normal force, potential and internal variable.

``law`` holds the law's parameters in the order of the fields of its class in contact.laws, Kn
first. ``scale`` is the point's stiffness over the law's; ``approach`` and ``compliance`` are as in
`laws.ContactLaw`. Forces such as the yield force do not scale: like all contact forces they are per
unit of area share.

The approach is monotone within a step, so every law is elastic there. Plastic contact is a spring
from the indentation of the steps before, softer beyond yield; adhesion is a spring that pulls up to
its limit and then has no force. The state is in ``memory``, updated at the end of a step: the
permanent indentation in m, or one where the point is held. The mean force over a step, ∫ F dδ over
the change, is therefore the discrete gradient of one potential, and the loss of a step is its work
less the change of the stored energy.
"""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Array
from ..compiled import inlined, njit
from .points import CONSERVING, Kind, Points, Trial

# Memory of a point held by adhesion; for one step, of one held without limit or sure to let go.
HELD, HELD_FAST, LETTING_GO = 1.0, 2.0, 3.0
SCALAR_LIMIT = 200
# Over changes smaller than this share of the approach the mean force is that of the middle.
SHORT = 1e-5


@njit
def elastic_at(
    kind: Kind, law: Array, scale: Array, approach: Array, compliance: float, memory: Array
) -> Array:
    """Force in N, tangent in N/m and potential in J (3, n) at points; all arrays are (n,)."""
    out = np.empty((3, len(approach)))
    for i in range(len(approach)):
        out[:, i] = kind.elastic(law, scale[i], approach[i], compliance, memory[i])
    return out


def _linear(
    law: Array, scale: float, approach: float, compliance: float, memory: float
) -> tuple[float, float, float]:
    """Linear spring in compression."""
    if approach <= 0.0:
        return 0.0, 0.0, 0.0
    stiffness = scale * law[0]
    if compliance > 0.0:
        stiffness = 1.0 / (1.0 / stiffness + compliance)
    return stiffness * approach, stiffness, 0.5 * stiffness * approach * approach


def _stiffening(
    law: Array, scale: float, approach: float, compliance: float, memory: float
) -> tuple[float, float, float]:
    """Power law of the penetration, with a compliance in series."""
    if approach <= 0.0:
        return 0.0, 0.0, 0.0
    exponent, reference = law[1], law[2]
    size = scale * law[0] * reference
    depth = approach
    force = size * (depth / reference) ** exponent
    if compliance > 0.0:
        # convex and from above, so Newton's method does not overshoot
        for _ in range(SCALAR_LIMIT):
            change = (depth + compliance * force - approach) / (
                1.0 + compliance * exponent * force / depth
            )
            depth -= change
            force = size * (depth / reference) ** exponent
            if change <= 1e-15 * depth:
                break
    tangent = exponent * force / depth
    stored = force * depth / (exponent + 1.0) + 0.5 * compliance * force * force
    return force, tangent / (1.0 + compliance * tangent), stored


def _tabulated(
    law: Array, scale: float, approach: float, compliance: float, memory: float
) -> tuple[float, float, float]:
    """Cubics over equal cells, continued as a straight line.

    ``law`` holds Kn, the width of a cell, then force, slope and potential over Kn at every node.
    """
    if approach <= 0.0:
        return 0.0, 0.0, 0.0
    width, last = law[1], (len(law) - 2) // 3 - 1
    cell = int(min(approach / width, float(last)))
    at = 2 + 3 * cell
    f0, s0, stored = law[at], law[at + 1], law[at + 2]
    kn, x = scale * law[0], approach - cell * width
    if cell == last:
        return kn * (f0 + s0 * x), kn * s0, kn * (stored + f0 * x + 0.5 * s0 * x * x)
    f1, s1 = law[at + 3], law[at + 4]
    t = x / width
    bend, twist = 3.0 * (f1 - f0) / width - 2.0 * s0 - s1, 2.0 * (f0 - f1) / width + s0 + s1
    force = f0 + x * (s0 + t * (bend + t * twist))
    slope = s0 + t * (2.0 * bend + 3.0 * t * twist)
    stored += x * (f0 + x * (s0 / 2.0 + t * (bend / 3.0 + t * twist / 4.0)))
    return kn * force, kn * slope, kn * stored


def _plastic(
    law: Array, scale: float, approach: float, compliance: float, indented: float
) -> tuple[float, float, float]:
    """Spring from the indentation on, softer beyond yield; the potential is that of loading."""
    depth = approach - indented
    if depth <= 0.0:
        return 0.0, 0.0, 0.0
    stiffness, slope, reach = _until_yield(law, scale, indented)
    if depth <= reach:
        return stiffness * depth, stiffness, 0.5 * stiffness * depth * depth
    force, over = stiffness * reach, depth - reach
    stored = 0.5 * force * reach + over * (force + 0.5 * slope * over)
    return force + slope * over, slope, stored


@njit
def _until_yield(law: Array, scale: float, indented: float) -> tuple[float, float, float]:
    """Stiffness before and beyond yield in N/m, and the approach in m from indentation to yield."""
    kn, hardening = scale * law[0], law[2]
    stiffness = law[3] * kn if indented > 0.0 else kn
    slope = hardening * kn
    reach = (law[1] * (1.0 - hardening) + slope * indented) / (stiffness - slope)
    return stiffness, slope, reach


def _adhesive(
    law: Array, scale: float, approach: float, compliance: float, held: float
) -> tuple[float, float, float]:
    """Spring that also pulls, up to its limit, while it is held; potential as on the way out."""
    stiffness, most = scale * law[0], law[1]
    if approach <= 0.0 and held == 0.0:
        return 0.0, 0.0, 0.0
    if approach > -most / stiffness or held == HELD_FAST:
        return stiffness * approach, stiffness, 0.5 * stiffness * approach * approach
    return 0.0, 0.0, 0.5 * most * most / stiffness


def _indented(law: Array, scale: float, approach: float, memory: float) -> float:
    """The indentation in m after a step that ends at ``approach``."""
    stiffness, slope, reach = _until_yield(law, scale, memory)
    over = approach - memory - reach
    if over <= 0.0:
        return memory
    force = stiffness * reach + slope * over
    return max(memory, approach - force / (law[3] * scale * law[0]))


def _at_indentation(law: Array, scale: float, memory: float) -> float:
    return memory


def _held(law: Array, scale: float, approach: float, memory: float) -> float:
    if approach > 0.0:
        return HELD
    return memory if approach > -law[1] / (scale * law[0]) else 0.0


def _at_pull_off(law: Array, scale: float, memory: float) -> float:
    return -law[1] / (scale * law[0]) if memory > 0.0 else 0.0


LINEAR = Kind.of(_linear)
HUNT_CROSSLEY = Kind.of(_linear, damps_spring=True)
STIFFENING = Kind.of(_stiffening)
TABULATED = Kind.of(_tabulated)
PLASTIC = Kind.of(_plastic, _indented, _at_indentation)
ADHESIVE = Kind.of(_adhesive, _held, _at_pull_off, pulls=True)


@njit
def holds(points: Points, memory: Array) -> bool:
    """Whether adhesion holds any point."""
    return points.kind.pulls and memory[:, 2].max() > 0.0


@inlined
def _mean_elastic(
    points: Points, i: int, start: float, end: float, memory: float
) -> tuple[float, float]:
    """Mean over a step of the undamped force, and its derivative by the approach at the end."""
    kind, law, scale, compliance = points.kind, points.law, points.scale[i], points.compliance
    weight, change = points.end_weight, end - start
    if kind.pulls and memory > 0.0:
        stiffness = scale * law[0]
        reach = law[1] / stiffness
        lets_go = end <= -reach or memory == LETTING_GO
        if change < 0.0 and lets_go and memory != HELD_FAST:
            # the force ends within the step, however short that is
            mean = 0.5 * stiffness * (start - reach) * (start + reach) / -change
            return mean, mean / -change
    force1, slope1, energy1 = kind.elastic(law, scale, end, compliance, memory)
    force0, _, energy0 = kind.elastic(law, scale, start, compliance, memory)
    if weight != CONSERVING:
        return weight * force1 + (1.0 - weight) * force0, weight * slope1
    if abs(change) <= SHORT * max(abs(start), abs(end)):
        force, slope, _ = kind.elastic(law, scale, 0.5 * (start + end), compliance, memory)
        return force, 0.5 * slope
    mean = (energy1 - energy0) / change
    return mean, (force1 - mean) / change


@inlined
def _mean_normal(
    points: Points, i: int, start: float, end: float, memory: float
) -> tuple[float, float]:
    """Normal force over a step and its derivative by the approach at the end.

    A dashpot's force is ``points.dashpot`` times the change of penetration. Hunt and Crossley's is
    that times the spring's mean force. The sum with the spring is never tensile.
    """
    mean, slope = _mean_elastic(points, i, start, end, memory)
    if points.dashpot != 0.0 and (start > 0.0 or end > 0.0):
        kn, damping = points.law[0], points.dashpot * points.scale[i]
        before, after = max(start, 0.0), max(end, 0.0)
        if points.kind.damps_spring:
            mean += 0.5 * kn * damping * (after + before) * (after - before)
            slope += kn * damping * after
        else:
            mean += damping * (after - before)
            slope += damping if end > 0.0 else 0.0
        if mean <= 0.0:
            return 0.0, 0.0
    return mean, slope


@inlined
def normal_force(points: Points, trial: Trial, i: int) -> tuple[float, float]:
    """Normal force of point ``i`` over a step and its derivative by the approach at the end,
    multiplier included."""
    proximal, start, end = points.proximal, trial.start[i, 0], trial.end[i, 0]
    multiplier, memory = trial.multiplier[i, 0], trial.memory[i, 2]
    if proximal == 0.0:
        return _mean_normal(points, i, start, end, memory)
    if math.isinf(points.law[0]):  # Signorini's condition at the end of the step
        augmented, compliance = end + proximal * multiplier, points.compliance + proximal
        law, scale = points.law, points.scale[i]
        force, slope, _ = points.kind.elastic(law, scale, augmented, compliance, memory)
        return force, slope
    force = multiplier
    slope = 0.0
    for _ in range(SCALAR_LIMIT):
        augmented = end + proximal * (multiplier - force)
        mean, slope = _mean_normal(points, i, start, augmented, memory)
        step = (mean - force) / (1.0 + proximal * slope)
        force += step
        if abs(step) <= 1e-15 * abs(force):
            break
    return force, slope / (1.0 + proximal * slope)


@inlined
def elastic_at_end(points: Points, trial: Trial, i: int) -> tuple[float, float]:
    """Undamped normal force of point ``i`` at the end of a step, and its tangent."""
    law, scale, end, memory = points.law, points.scale[i], trial.end[i, 0], trial.memory[i, 2]
    force, slope, _ = points.kind.elastic(law, scale, end, points.compliance, memory)
    return force, slope


@inlined
def normal_at_end(points: Points, trial: Trial, i: int) -> float:
    """Normal force of point ``i`` at the end of a step, damped at the step's mean speed."""
    start, end = trial.start[i, 0], trial.end[i, 0]
    force, _ = elastic_at_end(points, trial, i)
    if points.dashpot != 0.0 and end > 0.0:
        speed = points.dashpot * (end - max(start, 0.0))
        force += speed * (force if points.kind.damps_spring else points.scale[i])
    return max(force, 0.0)
