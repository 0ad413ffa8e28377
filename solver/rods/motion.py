"""State of moving rods, and the clamped node that follows the hub."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from ..arrays import Array, zeros
from ..compiled import inlined, njit
from ..time.scheme import TimeScheme
from .chain import Chain
from .contact import Touch, no_touch
from .element import strain_energy
from .hub import hub_coordinates
from .rotation import exponential, multiply, spin_of, write_matrix


class Scheme(NamedTuple):
    """Constants of generalised-alpha (see `solver.time.scheme`), the allowed error of a step in m,
    and whether there is inertia; without it every step ends in static equilibrium."""

    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float
    error_m: float
    inertia: bool


def scheme_of(time: TimeScheme, error_m: float, *, inertia: bool = True) -> Scheme:
    """The constants for compiled code."""
    return Scheme(time.alpha_m, time.alpha_f, time.beta, time.gamma, error_m, inertia)


class Hub(NamedTuple):
    """The hub's path, see `hub.HubPath`."""

    breaks: Array
    coefficients: Array


class ClampedRod(NamedTuple):
    """A rod in the hub and its own loads: dead ``loads`` (n, 6), forces and moments at the nodes in
    world axes, and the clamp's ``place`` (3,) and ``attitude`` (4,) in the hub's axes."""

    chain: Chain
    loads: Array
    place: Array
    attitude: Array


# Rows of `Motion.totals`.
TIME, STEP, HUB_WORK, MATERIAL, FRICTION, CONTACT, STEPS, ITERATIONS, LAST, STRESS = range(10)
TOTALS = 10


class Motion(NamedTuple):
    """State of one rod at one instant.

    ``x`` (n, 3) and ``q`` (n, 4) are the nodes' positions and quaternions. ``velocity`` (n, 6) is
    linear in world axes, then angular in the section's; so are ``acceleration`` and the scheme's
    ``auxiliary``. ``strain`` (e, 6) is that of `element.measure`. ``holding`` and ``reaction`` (6,)
    are the clamp's load on the rod, without and with the inertia of its own half element.
    ``totals`` (`TOTALS`,) are the time, the next step, sums over time, counts, the step that
    ``auxiliary`` belongs to (see `fit_to_step`), and the greatest bending stress at the end of any
    step since the last frame.
    """

    x: Array
    q: Array
    velocity: Array
    acceleration: Array
    auxiliary: Array
    strain: Array
    holding: Array
    reaction: Array
    totals: Array
    touch: Touch


def motion_of(rods: int, nodes: int, points: int) -> Motion:
    """Empty states of this many rods, stacked along a first axis."""
    record = partial(Motion, touch=no_touch(rods, nodes, points))
    places, axes, strain = (rods, nodes, 3), (rods, nodes, 4), (rods, nodes - 1, 6)
    rows, ends, totals = (rods, nodes, 6), (rods, 6), (rods, TOTALS)
    return zeros(record, places, axes, rows, rows, rows, strain, ends, ends, totals)


class Pose(NamedTuple):
    """Nodes of one rod: their positions ``x`` (n, 3) and quaternions ``q`` (n, 4).

    Compiled code passes it faster than the whole of a `Motion`.
    """

    x: Array
    q: Array


@inlined
def pose_of(stack: Motion, i: int) -> Pose:
    """A view of the nodes of stacked rod ``i``."""
    return Pose(stack.x[i], stack.q[i])


# Largest ratio of steps by which auxiliary accelerations are extrapolated.
STEEPEST = 2.0


@njit
def fit_to_step(now: Motion, h: float) -> None:
    """Convert the scheme's auxiliary accelerations to a step of ``h`` seconds.

    They are accelerations a share of the step later than the present. Without the conversion the
    scheme is of first order where steps change their length (Brüls and Arnold, J. Comput. Nonlinear
    Dyn. 3 (2008) 041007). With it, steps that alternate by a factor of four diverge, so the
    extrapolation to a far longer step is limited.
    """
    last = now.totals[LAST]
    now.totals[LAST] = h
    if last == 0.0 or last == h:
        return
    ratio = min(h / last, STEEPEST)
    for i in range(len(now.x)):
        for c in range(6):
            a = now.acceleration[i, c]
            now.auxiliary[i, c] = a + ratio * (now.auxiliary[i, c] - a)


@njit
def clamp(hub: Hub, rod: ClampedRod, t_s: float, x: Array, q: Array, velocity: Array) -> None:
    """Write position (3,), attitude (4,) and velocity (6,) of the clamped node at time ``t_s``."""
    pose, turned, matrix = np.empty((2, 6)), np.empty(4), np.empty((3, 3))
    hub_coordinates(hub.breaks, hub.coefficients, t_s, pose)
    r, rate = pose[0, 3:], pose[1, 3:]
    exponential(r[0], r[1], r[2], turned)
    write_matrix(turned, matrix)
    spin = spin_of(r, rate)
    arm = np.empty(3)
    for c in range(3):
        arm[c] = matrix[c, 0] * rod.place[0] + matrix[c, 1] * rod.place[1]
        arm[c] += matrix[c, 2] * rod.place[2]
        x[c] = pose[0, c] + arm[c]
    velocity[0] = pose[1, 0] + spin[1] * arm[2] - spin[2] * arm[1]
    velocity[1] = pose[1, 1] + spin[2] * arm[0] - spin[0] * arm[2]
    velocity[2] = pose[1, 2] + spin[0] * arm[1] - spin[1] * arm[0]
    multiply(turned, rod.attitude, q)
    write_matrix(q, matrix)
    for c in range(3):
        velocity[3 + c] = matrix[0, c] * spin[0] + matrix[1, c] * spin[1] + matrix[2, c] * spin[2]


@njit
def energies(chain: Chain, now: Motion, gravity: Array) -> tuple[float, float, float]:
    """Kinetic, strain and potential energy in J; the last is zero at the world's origin."""
    kinetic = potential = 0.0
    for i in range(len(now.x)):
        for c in range(3):
            kinetic += 0.5 * chain.mass[i] * now.velocity[i, c] ** 2
            kinetic += 0.5 * chain.inertia[i, c] * now.velocity[i, 3 + c] ** 2
            potential -= chain.mass[i] * gravity[c] * now.x[i, c]
    return kinetic, strain_energy(chain, now.strain), potential
