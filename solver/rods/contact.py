"""Contact of a rod's sections with a plane, and friction with a static and a kinetic coefficient.

Every node but the clamped one has a section with contact points on its rim. A point's normal force
is its share of Kn times its penetration. Friction is a return mapping behind a tangential spring at
the end of the step, as in `solver.contact.friction` (Wriggers, Computational Contact Mechanics,
2006, Sec. 9.1). That module cannot be used here: it keeps the spring's elongation in body axes,
which is exact for small rotation, and its conserving scheme evaluates forces at mid-step. Rods turn
far, so here the elongation is in world axes. Forces are evaluated at the end of the step, the limit
falls with the sliding speed, and a point's state says whether it slides.
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
# Sliding speed in m/s in statics, where there is no time.
SLOW_M_S = 1e-300


class Friction(NamedTuple):
    """The coefficients of friction and Stribeck's speed in m/s, for compiled code."""

    static: float
    kinetic: float
    speed: float


def friction_of(contact: Contact) -> Friction:
    """Friction of a ``contact``."""
    return Friction(contact.friction_static, contact.friction_kinetic, contact.stribeck_speed_m_s)


class Obstacle(NamedTuple):
    """The surface and its contact law, for compiled code.

    ``there`` says whether there is a surface. ``kn`` and ``kt`` are the stiffness in N/m of one
    point of the rim, ``rim`` (k, 2) the points in m. ``reach`` is the height in m of the axis below
    which a section may touch.
    """

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
    """The surface as contact law of one section: its rim points share Kn equally."""
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
    """State of contact of one rod's points (nodes, k): the elongation (…, 3) in m of their
    tangential springs, free, sticking or sliding, the sliding speed in m/s, and normal and
    tangential force in N. A free point has its own speed along the surface."""

    elongation: Array
    state: Array
    speed: Array
    normal: Array
    friction: Array


def no_touch(*shape: int) -> Touch:
    """The state of free points (…, nodes, k)."""
    return Touch(np.zeros((*shape, 3)), np.zeros(shape, np.int8), *np.zeros((3, *shape)))


class TouchStep(NamedTuple):
    """A step as contact points see it: their state ``before`` and ``now``, at its end, and its
    length ``h`` in s, zero in statics. In ``early`` Newton iterations a point that stuck before has
    the tangent of sticking, even if it slides."""

    before: Touch
    now: Touch
    h: float
    early: bool


class SectionPose(NamedTuple):
    """Pose of a section: its middle ``x`` (3,) and its axes ``matrix`` (3, 3)."""

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
    """Set the points of a section free."""
    for k in range(touch.normal.shape[1]):
        _make_free(touch, node, k)


@inlined
def coefficient(law: Friction, speed: float) -> float:
    """Coefficient of friction at a sliding speed in m/s, which is zero for a sticking point.

    A step uses the sliding speed at the end of the step before. With its own speed friction would
    fall, over a short step, faster than the tangential spring resists; a step would then have
    several solutions or none.
    """
    if speed == 0.0:
        return law.static
    ratio = speed / law.speed if law.speed > 0.0 else math.inf
    return law.kinetic + (law.static - law.kinetic) * math.exp(-ratio * ratio)


@inlined
def height(surface: Obstacle, place: Array) -> float:
    """Height in m of a place above the plane."""
    above = 0.0
    for c in range(3):
        above += surface.normal[c] * (place[c] - surface.point[c])
    return above


@njit
def place_gap(surface: Obstacle, place: Array, normal: Array, grows: Array) -> tuple[float, float]:
    """Gap in m at a place (3,) along the surface's normal, and the factor of the contact stiffness.

    Writes the ``normal`` (3,) and the factor's gradient ``grows`` (3,) per m. Over a relief the gap
    is that to the tangent plane below the place.
    """
    if surface.relief.there:
        above, factor = look(surface.relief, place[0], place[1], normal, grows)
        return (place[2] - above) * normal[2], factor
    for c in range(3):
        normal[c], grows[c] = surface.normal[c], 0.0
    return height(surface, place), 1.0


@njit
def point_gap(surface: Obstacle, k: int, section: SectionPose) -> float:
    """Gap in m of one of a section's points, as `place_gap`."""
    place, (x, matrix) = np.empty(3), section
    for c in range(3):
        place[c] = x[c] + matrix[c, 0] * surface.rim[k, 0] + matrix[c, 1] * surface.rim[k, 1]
    if surface.relief.there:
        return place_gap(surface, place, np.empty(3), np.empty(3))[0]
    return height(surface, place)


@njit
def lowest(surface: Obstacle, section: SectionPose) -> float:
    """The least gap in m of a section's points."""
    least = math.inf
    for k in range(len(surface.rim)):
        least = min(least, point_gap(surface, k, section))
    return least


class Springs(NamedTuple):
    """The springs of a point: stiffness ``kn`` and ``kt`` in N/m, the ``gap`` in m over a plane of
    ``normal`` (3,), and ``pull`` (3,) in m, the tangential elongation if the point stuck."""

    kn: float
    kt: float
    gap: float
    normal: Array
    pull: Array


@njit
def touch_point(
    law: Friction, springs: Springs, step: TouchStep, node: int, k: int, push: Array, stiff: Array
) -> tuple[float, float]:
    """Contact force and new state of a point below a plane.

    Writes the force ``push`` (3,) in N and ``stiff`` (3, 3), minus its derivative by the point's
    displacement. Returns friction's loss over the step and contact's energy at its end, in J.
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
    """Set a point free at the end of the step; returns the energy of its tangential spring, now
    lost."""
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
    """Subtract the contact forces of a section from the residual, add their tangent to the diagonal
    block, and write the points' state.

    The section's pose is ``now`` at the end of the step and ``was`` before it. Returns energies as
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
            # the stored energy kn gap² / 2 pushes the point to where the surface is softer
            push[c] -= 0.5 * surface.kn * grows[c] * gap * gap
        _add_point(arm, push, stiff, turned, system, node)
    return lost, held


@njit
def _add_point(
    arm: Array, push: Array, stiff: Array, turned: Array, system: System, node: int
) -> None:
    """Subtract the force ``push`` on a point at ``arm``; ``stiff`` is minus its derivative by the
    point's displacement."""
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
