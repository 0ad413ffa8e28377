"""What does a contact law do at one point: its force at an instant, over a step, and what it keeps?

Compiled, for the loops over points and steps. ``law`` holds the kind of law, its stiffness Kn, then
its other numbers, in the order of the fields of its class in contact.laws; ``scale`` is the point's
own stiffness over the law's; ``drive`` and ``series`` as in `ContactLaw`. Forces such as a yield
force do not scale: they are per unit of area share as all forces of contact are.

Within a step, along which the drive runs one way, every law is an elastic one: plastic contact is a
spring from the place where the step before has left the surface, with a force that stays at yield;
adhesion one that holds as far as it can, and no force beyond. What tells these is the point's
``memory``, a number that `remembered` renews at the end of a step: the permanent indentation in m,
or one where the point is held. So the mean force over a step, ∫ F dδ over the change, is the
discrete gradient of one potential, and what a step took is its work less the change of what is
stored.
"""

from __future__ import annotations

import math

from ..bodies.base import Array
from ..compiled import njit

# Kinds of law; from PLASTIC on they have a memory.
LINEAR, HUNT_CROSSLEY, STIFFENING, PLASTIC, ADHESIVE = 0.0, 1.0, 2.0, 3.0, 4.0
# Memory of a point that adhesion holds; for one step, of one that is held without limit, and of one
# that is sure to let go.
HELD, HELD_FAST, LETTING_GO = 1.0, 2.0, 3.0
CONSERVING = 0.0
SCALAR_LIMIT = 200
# Over steps shorter than this share of the drive the mean force is that of the middle.
SHORT = 1e-5


@njit
def elastic(
    law: Array, scale: float, drive: float, series: float, memory: float
) -> tuple[float, float, float]:
    """Force in N, its tangent in N/m and its potential in J at a drive, given what is remembered.

    Laws with a memory know no compliance in series.
    """
    if law[0] >= STIFFENING:
        if law[0] == STIFFENING:
            return _stiffening(law, scale, drive, series)
        if law[0] == PLASTIC:
            return _plastic(law, scale, drive, memory)
        return _adhesive(law, scale, drive, memory)
    return _linear(law, scale, drive, series)


@njit
def _linear(law: Array, scale: float, drive: float, series: float) -> tuple[float, float, float]:
    """A spring that pushes."""
    if drive <= 0.0:
        return 0.0, 0.0, 0.0
    stiffness = scale * law[1]
    if series > 0.0:
        stiffness = 1.0 / (1.0 / stiffness + series)
    return stiffness * drive, stiffness, 0.5 * stiffness * drive * drive


@njit
def _stiffening(
    law: Array, scale: float, drive: float, series: float
) -> tuple[float, float, float]:
    """A power of the penetration, which a compliance in series takes part of the drive from."""
    if drive <= 0.0:
        return 0.0, 0.0, 0.0
    exponent, reference = law[2], law[3]
    size = scale * law[1] * reference
    depth = drive
    force = size * (depth / reference) ** exponent
    if series > 0.0:
        # convex and from above, so Newton's method comes down without overshooting
        for _ in range(SCALAR_LIMIT):
            change = (depth + series * force - drive) / (1.0 + series * exponent * force / depth)
            depth -= change
            force = size * (depth / reference) ** exponent
            if change <= 1e-15 * depth:
                break
    tangent = exponent * force / depth
    stored = force * depth / (exponent + 1.0) + 0.5 * series * force * force
    return force, tangent / (1.0 + series * tangent), stored


@njit
def _plastic(law: Array, scale: float, drive: float, indented: float) -> tuple[float, float, float]:
    """A spring from the indentation on, up to the yield force; its potential along the way in."""
    stiffness, most, depth = scale * law[1], law[2], drive - indented
    if depth <= 0.0:
        return 0.0, 0.0, 0.0
    if stiffness * depth <= most:
        return stiffness * depth, stiffness, 0.5 * stiffness * depth * depth
    return most, 0.0, most * (depth - 0.5 * most / stiffness)


@njit
def _adhesive(law: Array, scale: float, drive: float, held: float) -> tuple[float, float, float]:
    """A spring that also pulls where it is held, as far as it can; its potential on the way out."""
    stiffness, most = scale * law[1], law[2]
    if drive <= 0.0 and held == 0.0:
        return 0.0, 0.0, 0.0
    if drive > -most / stiffness or held == HELD_FAST:
        return stiffness * drive, stiffness, 0.5 * stiffness * drive * drive
    return 0.0, 0.0, 0.5 * most * most / stiffness


@njit
def remembered(law: Array, scale: float, drive: float, memory: float) -> float:
    """The memory after a step that ends at ``drive``."""
    if law[0] == PLASTIC:
        return max(memory, drive - law[2] / (scale * law[1]))
    if law[0] == ADHESIVE:
        if drive > 0.0:
            return HELD
        return memory if drive > -law[2] / (scale * law[1]) else 0.0
    return memory


@njit
def clear_at(law: Array, scale: float, memory: float) -> float:
    """The drive in m down to which a point in contact has a force."""
    if law[0] == PLASTIC:
        return memory
    if law[0] == ADHESIVE and memory > 0.0:
        return -law[2] / (scale * law[1])
    return 0.0


@njit
def _mean_elastic(
    law: Array,
    scale: float,
    series: float,
    start: float,
    end: float,
    end_weight: float,
    memory: float,
) -> tuple[float, float]:
    """The mean over a step of the force without damping, and its derivative by the end's drive."""
    if law[0] >= STIFFENING:
        return _mean_curved(law, scale, series, start, end, end_weight, memory)
    force1, slope1, energy1 = _linear(law, scale, end, series)
    force0, _, energy0 = _linear(law, scale, start, series)
    if end_weight != CONSERVING:
        return end_weight * force1 + (1.0 - end_weight) * force0, end_weight * slope1
    change = end - start
    if abs(change) <= SHORT * max(abs(start), abs(end)):
        force, slope, _ = _linear(law, scale, 0.5 * (start + end), series)
        return force, 0.5 * slope
    mean = (energy1 - energy0) / change
    return mean, (force1 - mean) / change


@njit
def _mean_curved(
    law: Array,
    scale: float,
    series: float,
    start: float,
    end: float,
    end_weight: float,
    memory: float,
) -> tuple[float, float]:
    """`_mean_elastic` of every other law, apart because most drops have the linear one."""
    change = end - start
    if law[0] == ADHESIVE and memory > 0.0:
        stiffness = scale * law[1]
        reach = law[2] / stiffness
        lets_go = end <= -reach or memory == LETTING_GO
        if change < 0.0 and lets_go and memory != HELD_FAST:
            # the force ends on the way, be that ever so short
            mean = 0.5 * stiffness * (start - reach) * (start + reach) / -change
            return mean, mean / -change
    force1, slope1, energy1 = elastic(law, scale, end, series, memory)
    force0, _, energy0 = elastic(law, scale, start, series, memory)
    if end_weight != CONSERVING:
        return end_weight * force1 + (1.0 - end_weight) * force0, end_weight * slope1
    if abs(change) <= SHORT * max(abs(start), abs(end)):
        force, slope, _ = elastic(law, scale, 0.5 * (start + end), series, memory)
        return force, 0.5 * slope
    mean = (energy1 - energy0) / change
    return mean, (force1 - mean) / change


@njit
def _mean_normal(
    law: Array,
    drag: float,
    scale: float,
    series: float,
    start: float,
    end: float,
    end_weight: float,
    memory: float,
) -> tuple[float, float]:
    """Normal force over a step and its derivative by the drive at the end.

    ``drag`` is the law's damping over the step. A dashpot's force is it times the change of
    penetration, Hunt and Crossley's that times the spring's mean force; together with the spring
    both push or do nothing.
    """
    mean, slope = _mean_elastic(law, scale, series, start, end, end_weight, memory)
    if drag > 0.0 and (start > 0.0 or end > 0.0):
        before, after = max(start, 0.0), max(end, 0.0)
        if law[0] == HUNT_CROSSLEY:
            mean += 0.5 * scale * law[1] * drag * (after + before) * (after - before)
            slope += scale * law[1] * drag * after
        else:
            mean += scale * drag * (after - before)
            slope += scale * drag if end > 0.0 else 0.0
        if mean <= 0.0:
            return 0.0, 0.0
    return mean, slope


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
    memory: float,
) -> tuple[float, float]:
    """Normal force over a step and its derivative by the drive at the end, multiplier included."""
    if soft == 0.0:
        return _mean_normal(law, drag, scale, series, start, end, end_weight, memory)
    if math.isinf(law[1]):  # Signorini's condition holds at the end of the step
        force, slope, _ = elastic(law, scale, end + soft * multiplier, series + soft, memory)
        return force, slope
    force = multiplier
    slope = 0.0
    for _ in range(SCALAR_LIMIT):
        seen = end + soft * (multiplier - force)
        mean, slope = _mean_normal(law, drag, scale, series, start, seen, end_weight, memory)
        step = (mean - force) / (1.0 + soft * slope)
        force += step
        if abs(step) <= 1e-15 * abs(force):
            break
    return force, slope / (1.0 + soft * slope)
