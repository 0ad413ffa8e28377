"""One rod's part of a time step, compiled: prediction, residual, and update at the end.

Generalised-alpha on the rotation group (Arnold and Brüls, Multibody Syst. Dyn. 18 (2007) 185;
Brüls, Cardona and Arnold, Mech. Mach. Theory 48 (2012) 121). It satisfies equilibrium at the end of
every step and averages accelerations, not strains. So contact and friction hold at the end of the
step, and the scheme does not stretch a rotating rod. It damps what a step does not resolve: axial
and shear waves within an element, and vibration from closing contact. Damping by β uses differences
of strain over the step. To the scheme's second-order error this adds one of first order in β times
the step, βhω²/2 of the elastic force.
"""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import numpy as np

from ..arrays import Array, zeros
from ..compiled import inlined, njit, within, write
from .chain import Chain, System, new_system, total_length
from .contact import (
    FREE,
    Obstacle,
    SectionPose,
    TouchStep,
    height,
    lowest,
    release,
    touch_section,
)
from .element import Elements, assemble_forces, foresee, new_elements
from .motion import (
    CONTACT,
    FRICTION,
    HUB_WORK,
    ITERATIONS,
    MATERIAL,
    STEPS,
    TIME,
    ClampedRod,
    Hub,
    Motion,
    Scheme,
    clamp,
)
from .newton import move, place_nodes
from .pairs import Between, crossing_kn
from .rotation import between, exponential, multiply, normalise, vector_factor, write_matrix

# Tolerance of the residual as a share of EI/L², and relative rounding of coordinates, which an
# element's stiffest springs amplify.
NEAR, ROUNDING = 1e-8, 2e-15
# With inertia the residual may also cause a displacement in the step of this share of the allowed
# error (0.01 to 0.1 in Hairer and Wanner, Solving Ordinary Differential Equations II, 1996, Sec.
# IV.8).
NEWTON = 0.01
# Largest contact force, over EI/L², of a section that enters the surface in one Newton step.
DEEPEST = 10.0
# Compliance of a corner of a free prism's section over that of its middle.
CORNER_YIELDS = 7.0


class Law(NamedTuple):
    """What all rods share: time scheme, hub, surface, and the contact law between rods."""

    scheme: Scheme
    hub: Hub
    surface: Obstacle
    between: Between


class Scratch(NamedTuple):
    """Work space of one rod's step, and its state in Newton's method: the system, the elements, and
    their ``foreseen`` strains (2, e, 3), see `element.foresee`; positions and quaternions before
    the Newton step; axes (3, 3) of two sections; gaps (n,) in m; tolerances (2,) of force and
    moment; friction's loss and contact's energy (2,), of the rod alone and with the others; and the
    rod's own residual (n, 6)."""

    system: System
    elements: Elements
    foreseen: Array
    x: Array
    q: Array
    matrix: Array
    matrix_before: Array
    gaps: Array
    none: Array
    own_works: Array
    works: Array
    own: Array


def new_scratch(n: int) -> Scratch:
    """Work space for a rod of ``n`` nodes."""
    record = partial(Scratch, new_system(n), new_elements(n - 1))
    axes = 3, 3
    return zeros(record, (2, n - 1, 3), (n, 3), (n, 4), axes, axes, n, 2, 2, 2, (n, 6))


class Step(NamedTuple):
    """A step of ``h`` seconds of one rod: the rod, its states before and after, and work space."""

    rod: ClampedRod
    old: Motion
    new: Motion
    h: float
    scratch: Scratch


@within
def _predict(step: Step, h: float) -> None:
    """Predict the free nodes after ``h`` seconds: they turn on, elements keep stretch and shear."""
    old, new, turn = step.old, step.new, np.empty(4)
    for i in range(1, len(new.x)):
        w, a = old.velocity[i], old.auxiliary[i]
        exponential(
            h * (w[3] + 0.5 * h * a[3]),
            h * (w[4] + 0.5 * h * a[4]),
            h * (w[5] + 0.5 * h * a[5]),
            turn,
        )
        multiply(old.q[i], turn, new.q[i])
        normalise(new.q[i])
    place_nodes(step.rod.chain, new.x, new.q, old.strain, old.strain, 0.0)


@inlined
def _rates(
    scheme: Scheme, h: float, moved: float, velocity: float, auxiliary: float, acceleration: float
) -> tuple[float, float, float]:
    """Velocity, acceleration and auxiliary at the end of a step with the displacement ``moved``."""
    new = (moved / (h * h) - velocity / h - (0.5 - scheme.beta) * auxiliary) / scheme.beta
    speed = velocity + h * ((1.0 - scheme.gamma) * auxiliary + scheme.gamma * new)
    mean = (1.0 - scheme.alpha_m) * new + scheme.alpha_m * auxiliary
    return speed, (mean - scheme.alpha_f * acceleration) / (1.0 - scheme.alpha_f), new


@inlined
def _inertia(scheme: Scheme, step: Step, i: int) -> None:
    """Add a free node's inertia and α-damping to the residual and the diagonal block.

    The tangent omits gyroscopic moments and the difference between a step's rotation vector and the
    spin. Both are of the order of the rotation in a step.
    """
    chain, old, new, h = step.rod.chain, step.old, step.new, step.h
    system, matrix = step.scratch.system, step.scratch.matrix
    weight = (1.0 - scheme.alpha_m) / ((1.0 - scheme.alpha_f) * scheme.beta * h * h)
    weight += chain.alpha * scheme.gamma / (scheme.beta * h)
    w, v0, v1, v2 = between(old.q[i], new.q[i])
    factor = vector_factor(w, v0, v1, v2)
    x, was = new.x[i], old.x[i]
    shift = x[0] - was[0], x[1] - was[1], x[2] - was[2]
    moved = (*shift, factor * v0, factor * v1, factor * v2)
    for c in range(6):
        new.velocity[i, c], new.acceleration[i, c], new.auxiliary[i, c] = _rates(
            scheme, h, moved[c], old.velocity[i, c], old.auxiliary[i, c], old.acceleration[i, c]
        )
    for c in range(3):
        force = new.acceleration[i, c] + chain.alpha * new.velocity[i, c]
        system.residual[i, c] += chain.mass[i] * force
        system.diagonal[i, c, c] += chain.mass[i] * weight
    moment = _inertial_moment(chain, i, new)
    for c in range(3):
        for d in range(3):
            system.residual[i, 3 + c] += matrix[c, d] * moment[d]
            value = 0.0
            for k in range(3):
                value += matrix[c, k] * chain.inertia[i, k] * matrix[d, k]
            system.diagonal[i, 3 + c, 3 + d] += weight * value


@inlined
def _inertial_moment(chain: Chain, i: int, now: Motion) -> tuple[float, float, float]:
    """J Ω̇ + Ω × J Ω + α J Ω about the section's axes."""
    j0, j1, j2 = chain.inertia[i, 0], chain.inertia[i, 1], chain.inertia[i, 2]
    w0, w1, w2 = now.velocity[i, 3], now.velocity[i, 4], now.velocity[i, 5]
    a, alpha = now.acceleration[i], chain.alpha
    return (
        j0 * (a[3] + alpha * w0) + (j2 - j1) * w1 * w2,
        j1 * (a[4] + alpha * w1) + (j0 - j2) * w2 * w0,
        j2 * (a[5] + alpha * w2) + (j1 - j0) * w0 * w1,
    )


@inlined
def damping_rate(law: Law, chain: Chain, h: float) -> float:
    """β over the step of ``h`` seconds: the relative stiffening of a rod by damping."""
    return chain.beta / h if law.scheme.inertia else 0.0


@inlined
def deepest(chain: Chain, stiffness: float) -> float:
    """Allowed penetration in m of a Newton step, at a contact stiffness in N/m."""
    bending = min(chain.stiffness[0, 3], chain.stiffness[0, 4])
    return DEEPEST * bending / total_length(chain) ** 2 / stiffness


@inlined
def inert(chain: Chain, scheme: Scheme, stiffness: float, h: float) -> bool:
    """Whether a step of ``h`` seconds is so short that inertia limits the rebound: a contact of
    this ``stiffness`` in N/m throws a section back by no more than it penetrated.

    Its corner yields by β h² (1/m + Σ a²/J), with J = m a²/3 about each axis of a prism.
    """
    return scheme.inertia and stiffness * CORNER_YIELDS * scheme.beta * h * h < chain.mass[-1]


@within
def shortfall(chain: Chain, surface: Obstacle, new: Motion, scratch: Scratch) -> float:
    """Part of the last Newton step after which new contacts just close; one if none is too deep."""
    allowed, least = deepest(chain, surface.kn), 1.0
    gaps, matrix = scratch.gaps, scratch.matrix
    for i in range(1, len(gaps)):
        if gaps[i] > 0.0 and height(surface, new.x[i]) <= surface.reach:
            write_matrix(new.q[i], matrix)
            gap = lowest(surface, SectionPose(new.x[i], matrix))
            if gap < -allowed:
                least = min(least, (gaps[i] + 0.5 * allowed) / (gaps[i] - gap))
    return least


@within
def finish(scheme: Scheme, step: Step, iterations: int) -> None:
    """Write strains, reactions and sums at the end of a step of this many ``iterations``."""
    chain, loads, system = step.rod.chain, step.rod.loads, step.scratch.system
    old, new, h = step.old, step.new, step.h
    write(step.scratch.elements.strain, new.strain)
    write(old.totals, new.totals)
    new.totals[TIME] = old.totals[TIME] + h
    new.totals[STEPS] += 1.0
    new.totals[ITERATIONS] += iterations
    w, v0, v1, v2 = between(old.q[0], new.q[0])
    factor = vector_factor(w, v0, v1, v2)
    matrix, turned, spin = np.empty((3, 3)), np.empty(3), (factor * v0, factor * v1, factor * v2)
    write_matrix(old.q[0], matrix)
    for c in range(3):
        # a rotation vector has the same components before and after its rotation
        turned[c] = matrix[c, 0] * spin[0] + matrix[c, 1] * spin[1] + matrix[c, 2] * spin[2]
        if scheme.inertia:
            new.acceleration[0, c] = (new.velocity[0, c] - old.velocity[0, c]) / h
            new.acceleration[0, 3 + c] = (new.velocity[0, 3 + c] - old.velocity[0, 3 + c]) / h
    write_matrix(new.q[0], matrix)
    moment = _inertial_moment(chain, 0, new)
    work = 0.0
    for c in range(3):
        drag = chain.mass[0] * chain.alpha * new.velocity[0, c] if scheme.inertia else 0.0
        new.holding[c] = system.residual[0, c] - loads[0, c] + drag
        new.holding[3 + c] = system.residual[0, 3 + c] - loads[0, 3 + c]
        new.reaction[c], new.reaction[3 + c] = new.holding[c], new.holding[3 + c]
        if scheme.inertia:
            new.reaction[c] += chain.mass[0] * new.acceleration[0, c]
            for k in range(3):
                new.reaction[3 + c] += matrix[c, k] * moment[k]
            work += 0.5 * chain.mass[0] * (new.velocity[0, c] ** 2 - old.velocity[0, c] ** 2)
            turning = new.velocity[0, 3 + c] ** 2 - old.velocity[0, 3 + c] ** 2
            work += 0.5 * chain.inertia[0, c] * turning
        work += 0.5 * (old.holding[c] + new.holding[c]) * (new.x[0, c] - old.x[0, c])
        work += 0.5 * (old.holding[3 + c] + new.holding[3 + c]) * turned[c]
    new.totals[HUB_WORK] += work
    new.totals[FRICTION] += step.scratch.works[0]
    new.totals[CONTACT] = step.scratch.works[1]
    if scheme.inertia:
        new.totals[MATERIAL] += _damped(step)


@within
def _damped(step: Step) -> float:
    """Energy dissipated by material damping over a step, in J."""
    chain, old, new, h = step.rod.chain, step.old, step.new, step.h
    taken = 0.0
    for e in range(len(chain.length)):
        for c in range(6):
            change = new.strain[e, c] - old.strain[e, c]
            taken += chain.length[e] * chain.stiffness[e, c] * chain.beta / h * change * change
    if chain.alpha > 0.0:
        for i in range(len(old.x)):
            for c in range(3):
                squares = old.velocity[i, c] ** 2 + new.velocity[i, c] ** 2
                taken += 0.5 * h * chain.alpha * chain.mass[i] * squares
                squares = old.velocity[i, 3 + c] ** 2 + new.velocity[i, 3 + c] ** 2
                taken += 0.5 * h * chain.alpha * chain.inertia[i, c] * squares
    return taken


@within
def begin(law: Law, step: Step, linked: bool) -> None:
    """Write the prediction of the rod at the end of the step, and the tolerances of its residual.

    ``linked`` says whether the rod may touch others.
    """
    rod, old, new, gaps = step.rod, step.old, step.new, step.scratch.gaps
    write(old.x, new.x)
    write(old.q, new.q)
    clamp(law.hub, rod, old.totals[TIME] + step.h, new.x[0], new.q[0], new.velocity[0])
    _predict(step, step.h if law.scheme.inertia else 0.0)
    for i in range(len(gaps)):
        gaps[i] = 1.0
    _write_none(law, step, linked)


@within
def _write_none(law: Law, step: Step, linked: bool) -> None:
    """Write the tolerances of force in N and moment in N m for this step."""
    chain, x, scheme, none = step.rod.chain, step.new.x, law.scheme, step.scratch.none
    square, total = scheme.beta * step.h * step.h, total_length(chain)
    stiffest = heaviest = farthest = 0.0
    for e in range(len(chain.length)):
        for c in range(3):
            stiffest = max(stiffest, chain.stiffness[e, c] / chain.length[e])
    for i in range(len(x)):
        heaviest = max(heaviest, chain.mass[i])
        for c in range(3):
            farthest = max(farthest, abs(x[i, c]))
    bending = min(chain.stiffness[0, 3], chain.stiffness[0, 4]) / (total * total)
    stiffer = 1.0 + damping_rate(law, chain, step.h)
    force = NEAR * bending + ROUNDING * stiffer * stiffest * (farthest + total)
    if scheme.inertia:
        force += ROUNDING * heaviest / square * farthest
    if law.surface.there:
        force += ROUNDING * law.surface.kn * farthest
    moment = force * total
    if scheme.inertia:
        least_force, least_moment = _stiffness(chain, square)
        force = max(force, NEWTON * scheme.error_m * least_force)
        moment = max(moment, NEWTON * scheme.error_m * least_moment)
    rounding = ROUNDING * crossing_kn(law.between) * farthest if linked else 0.0
    none[0], none[1] = force + rounding, moment + rounding * total


@njit
def _stiffness(chain: Chain, square: float) -> tuple[float, float]:
    """The least force in N that moves a node by a metre in a step, and the least moment in N m
    whose rotation moves the elements' other ends by a metre.

    ``square`` in s² is β of the scheme times the square of the step.
    """
    force = moment = math.inf
    for e in range(len(chain.length)):
        force = min(force, chain.mass[e + 1] / square)
        for c in range(3):
            turns = chain.stiffness[e, 3 + c] / chain.length[e] + chain.inertia[e + 1, c] / square
            moment = min(moment, turns / chain.length[e])
    return force, moment


@within
def assemble(law: Law, step: Step, early: bool) -> tuple[float, float]:
    """Write the residual, and add inertia and the surface to the diagonal blocks.

    ``early`` marks the first iterations, see `joint.EARLY`. Returns the energies of
    `contact.touch_section`: friction's loss and contact's energy.
    """
    surface, old, new, scratch = law.surface, step.old, step.new, step.scratch
    gaps, system = scratch.gaps, scratch.system
    rate = damping_rate(law, step.rod.chain, step.h)
    assemble_forces(step.rod.chain, new.x, new.q, old.strain, rate, system, scratch.elements)
    points = TouchStep(old.touch, new.touch, step.h if law.scheme.inertia else 0.0, early)
    lost = held = 0.0
    for i in range(1, len(new.x)):
        write_matrix(new.q[i], scratch.matrix)
        for c in range(6):
            system.residual[i, c] -= step.rod.loads[i, c]
        if law.scheme.inertia:
            _inertia(law.scheme, step, i)
        if surface.there:
            gaps[i] = height(surface, new.x[i])
            touched = False
            for k in range(len(surface.rim)):
                touched = touched or old.touch.state[i, k] != FREE
            if gaps[i] > surface.reach and not touched:
                release(new.touch, i)
                continue
            section = SectionPose(new.x[i], scratch.matrix)
            gaps[i] = lowest(surface, section)
            write_matrix(old.q[i], scratch.matrix_before)
            was = SectionPose(old.x[i], scratch.matrix_before)
            took, holds = touch_section(surface, i, section, was, points, system)
            lost += took
            held += holds
    return lost, held


@within
def keep(chain: Chain, new: Motion, scratch: Scratch) -> None:
    """Save the rod's pose, and what Newton's step adds to its elements' strains."""
    write(new.x, scratch.x)
    write(new.q, scratch.q)
    foresee(chain, scratch.elements, scratch.system.solution, scratch.foreseen)


@within
def go(chain: Chain, new: Motion, part: float, scratch: Scratch) -> None:
    """Move the rod by a ``part`` of Newton's step from the saved pose."""
    write(scratch.x, new.x)
    write(scratch.q, new.q)
    move(chain, new.x, new.q, scratch.system.solution, part, scratch.foreseen)
