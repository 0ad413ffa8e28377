"""Contact of a rod's sections with a plane, and friction with a static and a kinetic coefficient.

Every node but the clamped one has a section whose points on the rim can touch. A point's normal
force is its share of Kn times its penetration. Friction is a return map behind a tangential spring,
at the end of the step, as in `solver.contact.friction` (Wriggers, Computational Contact Mechanics,
2006, Sec. 9.1). Three things differ from there: rods turn far, so the spring's elongation is kept
in world axes; the limit falls with the speed of sliding; and a point knows whether it slides.
That law does not serve here as it is: it keeps the elongation in the body's axes, which is exact
for a body that turns little, and its conserving scheme asks for forces at mid-step, whereas rods
ask at the end. What both have in common, a force limited to μ N, is a line.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..arrays import Array
from ..compiled import inlined, njit
from .chain import System
from .ground import Contact, Ground
from .relief import Relief, highest_m, look, no_relief
from .rotation import cross, dot
from .section import RodSection

FREE, STICKS, SLIDES = 0, 1, 2
# The speed in m/s of a point that slides where there is no time, as in statics.
SLOW_M_S = 1e-300


class Friction(NamedTuple):
    """The coefficients of friction and Stribeck's speed in m/s, for compiled code."""

    static: float
    kinetic: float
    speed: float


def friction_of(contact: Contact) -> Friction:
    """That of a ``contact``."""
    return Friction(contact.friction_static, contact.friction_kinetic, contact.stribeck_speed_m_s)


class Obstacle(NamedTuple):
    """The surface and its law, for compiled code: ``kn`` and ``kt`` in N/m of one point of the rim,
    ``rim`` (k, 2) in m and at which height of the axis over the plane it may touch, whether there
    is a surface at all, and its relief."""

    there: bool
    point: Array
    normal: Array
    rim: Array
    reach: float
    kn: float
    kt: float
    friction: Friction
    relief: Relief


def obstacle_of(ground: Ground | None, section: RodSection) -> Obstacle:
    """The surface as a section meets it: Kn shared equally among the points of its rim."""
    there = ground is not None
    ground = ground or Ground()
    rim = np.ascontiguousarray(section.rim_m)
    kn = ground.kn_N_m / len(rim)
    relief = ground.rough.compiled() if ground.rough is not None else no_relief()
    return Obstacle(
        there,
        np.array(ground.point_m, dtype=float),
        ground.unit_normal,
        rim,
        float(np.linalg.norm(rim, axis=1).max()) + highest_m(relief),
        kn,
        ground.kt_over_kn * kn,
        friction_of(ground),
        relief,
    )


class Touch(NamedTuple):
    """What the points (nodes, k) of one rod remember of the surface: the elongation (…, 3) in m of
    their tangential springs, whether they stick or slide, their speed of sliding in m/s, and their
    normal and tangential force in N. A free point has the speed along the surface of its own."""

    elongation: Array
    state: Array
    speed: Array
    normal: Array
    friction: Array


def no_touch(*shape: int) -> Touch:
    """Points (…, nodes, k) that are free."""
    return Touch(np.zeros((*shape, 3)), np.zeros(shape, np.int8), *np.zeros((3, *shape)))


class TouchStep(NamedTuple):
    """A step as points see it: what they remember ``before`` and ``now``, at its end, its length
    ``h`` in s, zero in statics, and whether this is an ``early`` one of Newton's iterations, in
    which points that stuck before have the tangent of sticking even if they slide."""

    before: Touch
    now: Touch
    h: float
    early: bool


class SectionPose(NamedTuple):
    """Where a section is: its middle ``x`` (3,) and its axes ``matrix`` (3, 3)."""

    x: Array
    matrix: Array


@inlined
def _make_free(touch: Touch, node: int, k: int) -> None:
    touch.state[node, k] = FREE
    touch.speed[node, k] = touch.normal[node, k] = touch.friction[node, k] = 0.0
    for c in range(3):
        touch.elongation[node, k, c] = 0.0


@njit
def release(touch: Touch, node: int) -> None:
    """Make the points of a section free."""
    for k in range(touch.normal.shape[1]):
        _make_free(touch, node, k)


@inlined
def coefficient(law: Friction, speed: float) -> float:
    """The coefficient of friction at a sliding speed in m/s, which is zero at a point that sticks.

    A step takes the speed of sliding at the end of the step before. With its own speed the law
    would fall, over a short step, faster than the tangential spring holds, and a step would have
    several solutions or none.
    """
    if speed == 0.0:
        return law.static
    ratio = speed / law.speed if law.speed > 0.0 else math.inf
    return law.kinetic + (law.static - law.kinetic) * math.exp(-ratio * ratio)


@inlined
def height(surface: Obstacle, place: Array) -> float:
    """How far in m a place is above the plane."""
    above = 0.0
    for c in range(3):
        above += surface.normal[c] * (place[c] - surface.point[c])
    return above


@njit
def place_gap(surface: Obstacle, place: Array, normal: Array, grows: Array) -> tuple[float, float]:
    """Write the surface's ``normal`` (3,) under a place (3,), and how the factor of the contact
    stiffness ``grows`` (3,) per m; the gap in m along the normal, and that factor.

    Over a relief the gap is that to the plane that touches it below the place.
    """
    if surface.relief.there:
        above, factor = look(surface.relief, place[0], place[1], normal, grows)
        return (place[2] - above) * normal[2], factor
    for c in range(3):
        normal[c], grows[c] = surface.normal[c], 0.0
    return height(surface, place), 1.0


@njit
def point_gap(surface: Obstacle, k: int, section: SectionPose) -> float:
    """The gap in m of one of a section's points over the surface, as `place_gap`."""
    place, (x, matrix) = np.empty(3), section
    for c in range(3):
        place[c] = x[c] + matrix[c, 0] * surface.rim[k, 0] + matrix[c, 1] * surface.rim[k, 1]
    if surface.relief.there:
        return place_gap(surface, place, np.empty(3), np.empty(3))[0]
    return height(surface, place)


@njit
def lowest(surface: Obstacle, section: SectionPose) -> float:
    """The least gap in m of a section's points over the surface."""
    least = math.inf
    for k in range(len(surface.rim)):
        least = min(least, point_gap(surface, k, section))
    return least


class Springs(NamedTuple):
    """The springs of a point: their stiffness ``kn`` and ``kt`` in N/m, the ``gap`` in m over a
    plane of ``normal`` (3,), and ``pull`` (3,) in m, the elongation of the tangential one if the
    point stuck."""

    kn: float
    kt: float
    gap: float
    normal: Array
    pull: Array


@njit
def touch_point(
    law: Friction, springs: Springs, step: TouchStep, node: int, k: int, push: Array, stiff: Array
) -> tuple[float, float]:
    """Write the force ``push`` (3,) in N on a point that is below a plane, its loss ``stiff``
    (3, 3) by the point's displacement, and what the point remembers at the end of the step.

    Returns how much friction dissipated over the step and what contact holds at its end, in J.
    """
    (kn, kt, gap, n, pull), before, now = springs, step.before, step.now
    mu = coefficient(law, before.speed[node, k])
    normal, size = -kn * gap, math.sqrt(dot(pull, pull))
    slides = kt * size > mu * normal
    force = mu * normal if slides else kt * size
    gives = slides and not (step.early and before.state[node, k] == STICKS)
    slope, secant, grows = (0.0, force / size, mu) if gives else (kt, kt, 0.0)
    for i in range(3):
        e_i = pull[i] / size if size > 0.0 else 0.0
        push[i] = normal * n[i] - force * e_i
        for j in range(3):
            e_j = pull[j] / size if size > 0.0 else 0.0
            across = (1.0 if i == j else 0.0) - n[i] * n[j] - e_i * e_j
            stiff[i, j] = kn * n[i] * n[j] + secant * across + slope * e_i * e_j
            # normal = -kn gap falls as the point rises, and friction with it
            stiff[i, j] -= kn * grows * e_i * n[j]
    now.normal[node, k], now.friction[node, k] = normal, force
    now.state[node, k], now.speed[node, k] = STICKS, 0.0
    slid, kept = size - force / kt if slides else 0.0, 1.0
    if slid > 0.0:
        now.state[node, k], kept = SLIDES, force / (kt * size)
        now.speed[node, k] = slid / step.h if step.h > 0.0 else SLOW_M_S
    held = 0.5 * kn * gap * gap
    for c in range(3):
        now.elongation[node, k, c] = kept * pull[c]
        held += 0.5 * kt * (kept * pull[c]) ** 2
    return 0.5 * (force + before.friction[node, k]) * slid, held


@njit
def lose_hold(step: TouchStep, node: int, k: int) -> float:
    """Make a point free at the end of the step; what its tangential spring held, in J, which it
    loses to friction."""
    square = 0.0
    for c in range(3):
        square += step.before.elongation[node, k, c] ** 2
    _make_free(step.now, node, k)
    return 0.5 * step.before.friction[node, k] * math.sqrt(square)


@njit
def touch_section(
    surface: Obstacle,
    node: int,
    now: SectionPose,
    was: SectionPose,
    step: TouchStep,
    system: System,
) -> tuple[float, float]:
    """Take the forces of a section's points off the residual, add their tangent to the diagonal
    block, and write what the points remember at the end of the step.

    The section is where it is ``now``, at the end of the step, and ``was`` before. Returns as
    `touch_point`.
    """
    n, grows = np.empty(3), np.empty(3)
    arm, place, slip, push = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    stiff, turned = np.empty((3, 3)), np.empty((3, 3))
    lost = held = 0.0
    for k in range(len(surface.rim)):
        r0, r1 = surface.rim[k, 0], surface.rim[k, 1]
        for c in range(3):
            arm[c] = now.matrix[c, 0] * r0 + now.matrix[c, 1] * r1
            place[c] = now.x[c] + arm[c]
            slip[c] = place[c] - (was.x[c] + was.matrix[c, 0] * r0 + was.matrix[c, 1] * r1)
        gap, factor = place_gap(surface, place, n, grows)
        kn, kt = factor * surface.kn, factor * surface.kt
        normal_slip = dot(n, slip)
        for c in range(3):
            slip[c] -= normal_slip * n[c]
        if gap >= 0.0:
            lost += lose_hold(step, node, k)
            if step.h > 0.0:
                step.now.speed[node, k] = math.sqrt(dot(slip, slip)) / step.h
            continue
        spring = step.before.elongation[node, k]
        tilted = dot(n, spring)
        for c in range(3):
            slip[c] += spring[c] - tilted * n[c]
        springs = Springs(kn, kt, gap, n, slip)
        took, holds = touch_point(surface.friction, springs, step, node, k, push, stiff)
        lost += took
        held += holds
        for c in range(3):
            # the contact holds kn gap² / 2, and is pushed to where it is softer
            push[c] -= 0.5 * surface.kn * grows[c] * gap * gap
        _add_point(arm, push, stiff, turned, system, node)
    return lost, held


@njit
def _add_point(
    arm: Array, push: Array, stiff: Array, turned: Array, system: System, node: int
) -> None:
    """A force ``push`` on a point at ``arm``, whose loss by its displacement is ``stiff``."""
    block, residual = system.diagonal[node], system.residual[node]
    along, moment = dot(arm, push), cross(arm, push)
    for i in range(3):
        residual[i] -= push[i]
        residual[3 + i] -= moment[i]
        by_spin = cross(arm, (stiff[i, 0], stiff[i, 1], stiff[i, 2]))
        for j in range(3):
            turned[i, j] = by_spin[j]
            block[i, j] += stiff[i, j]
            block[i, 3 + j] += by_spin[j]
    for j in range(3):
        by_place = cross(arm, (stiff[0, j], stiff[1, j], stiff[2, j]))
        by_spin = cross(arm, (turned[0, j], turned[1, j], turned[2, j]))
        for i in range(3):
            block[3 + i, j] += by_place[i]
            # the arm turns too: δ(arm × push) = (spin × arm) × push
            turning = arm[i] * push[j] - (along if i == j else 0.0)
            block[3 + i, 3 + j] += by_spin[i] - turning
