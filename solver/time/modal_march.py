"""One touch of a modal body under the conserving scheme, marched in compiled code.

The implicit midpoint rule per mode, with the contact forces of contact.solve: what `Marcher` does
for any body and scheme, for the one case that most drops are.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..bodies.axis import Shortening, second_order_force, shortened
from ..bodies.base import Array
from ..compiled import njit
from ..contact.normal import PLASTIC, elastic
from ..contact.section import section_gathers, section_moves
from ..contact.solve import solve_step
from ..contact.step import (
    Points,
    Section,
    commit,
    holds,
    new_section,
    settle,
    share_in_contact,
    share_under_drag,
    spring_energy,
)

# The second-order force of a step is found by iteration, to this share of itself.
COUPLED, COUPLING_LIMIT = 1e-9, 100
RELEASED, UNTIL, TOO_LONG, NOT_CONVERGED, NOT_FINITE = 0, 1, 2, 3, 4


class Modes(NamedTuple):
    """A body's modes and contact points, and how they answer over a step of ``its`` s.

    ``along`` (r, modes) are the section's coordinates, ``support`` and ``shapes`` as in
    ContactPoints;
    ``tip`` (3, modes) is the section's mean displacement. ``answer`` is Marcher's, ``axis``
    bodies.axis'. ``admittance`` (modes,) = 1/(1 + ½ h c + ¼ h² ω²).
    """

    its: float
    omega2: Array
    damping: Array
    admittance: Array
    translation: Array
    along: Array
    support: NDArray[np.int64]
    shapes: Array
    tip: Array
    weights: Array
    answer: Array
    mass: float
    axis: Shortening


class Touching(NamedTuple):
    """The contact law at the points, and where the body stands: see Marcher and Placement."""

    points: Points
    frames: Array
    gaps: Array
    up: Array
    tip_m: float
    centre_m: float
    gravity: float


class Marched(NamedTuple):
    """What a march gave. ``slid`` is the greatest slip of any point, ``push`` (3,) the impulse
    along body axes; ``first_end`` and ``count`` in steps. ``history`` (steps + 1, 4): tip and
    centre
    heights, force, penetration."""

    status: int
    steps: int
    release: float
    impulse: float
    push: Array
    peak: float
    material_loss: float
    friction_loss: float
    contact_loss: float
    spring: float
    memory: Array
    u: Array
    v: Array
    history: Array
    forces: Array
    motions: Array


@njit
def local_section(modes: Modes, frames: Array) -> Section:
    """The section as contact.step sees it, along the points' local ``frames`` (n, 3, 3)."""
    n, s = modes.support.shape
    values = np.zeros((n, 3, s))
    for i in range(n):
        for a in range(3):
            for x in range(3):
                factor = frames[i, a, x]
                for c in range(s):
                    values[i, a, c] += factor * modes.shapes[i, x, c]
    return new_section(modes.support, values, modes.answer)


@njit
def drives(along: Array, section: Section, gaps: Array, u: Array, axes: int, drive: Array) -> float:
    """Write the drive of every point along the first ``axes`` of its local frame (n, 3).

    Returns the greatest along the normal.
    """
    section_moves(section, along @ u, axes, drive)
    most = -math.inf
    for i in range(len(gaps)):
        for a in range(axes):
            drive[i, a] = -drive[i, a]
        drive[i, 0] -= gaps[i]
        most = max(most, drive[i, 0])
    return most


@njit
def march(
    modes: Modes,
    touching: Touching,
    u: Array,
    v: Array,
    wait: float,
    until: float,
    limit: int,
    keep: bool,
    keep_states: bool,
) -> Marched:
    """March from the state (u, v) until all points are clear after ``wait`` s, or past ``until`` s.

    Times count from the start; at most ``limit`` times is a step solved, or solved again for what
    couples it. With ``keep`` the history is kept, with ``keep_states`` also the
    forces (steps, 3 n) along body axes per area share and the mid-step u + β v (steps, modes) that
    a reduced body's defect is measured by, β taken as damping over ω² where α is zero.
    """
    h, weights, frames = modes.its, modes.weights, touching.frames
    omega2, damping = modes.omega2, modes.damping
    admittance, along = modes.admittance, modes.along
    n, m = len(weights), len(u)
    points = touching.points
    remembers = points.law[0] >= PLASTIC
    law, scale, gaps = points.law, points.scale, touching.gaps
    section = local_section(modes, frames)
    response = np.zeros((0, 0))
    pull = -touching.gravity * (modes.translation @ touching.up)
    lift = (modes.translation @ touching.up) / modes.mass
    tip = modes.tip.T @ touching.up
    stiff = damping + 0.5 * h * omega2
    memory = np.zeros((n, 3))
    multiplier = np.zeros((n, 3))
    force = np.zeros((n, 3))
    end = np.zeros((n, 3))
    drive = np.zeros((n, 3))
    free = np.zeros((n, 3))
    axis = modes.axis
    bends = len(axis.weights) > 0
    bend: Array = np.zeros(m)
    if bends:
        du, dv = shortened(axis, u, v)
        u, v = u + du, v + dv
    seen = axis.rows @ u
    after = seen
    # without friction nobody asks for tangential drives
    axes = 3 if points.mu > 0.0 else 1
    deepest = drives(along, section, gaps, u, axes, drive)
    a: Array = np.empty(m)
    a0, later, fast = np.empty(m), np.empty(m), np.empty(m)
    u, v = u.copy(), v.copy()
    middle, weighted = np.empty(m), np.empty(m)
    size = 64
    history: Array = np.zeros((size if keep else 1, 4))
    forces: Array = np.zeros((size if keep_states else 1, 3 * n))
    motions: Array = np.zeros((size if keep_states else 1, m))
    push = np.zeros(3)
    release = impulse = peak = loss = rubbed = spent = last = 0.0
    status, count, solved = TOO_LONG, 0, 0
    if keep:
        history[0, 0] = touching.tip_m + tip @ u
        history[0, 1] = touching.centre_m + lift @ u
        history[0, 3] = max(drive[:, 0].max(), 0.0)
    for count in range(1, limit + 1):
        for j in range(m):
            a0[j] = admittance[j] * (pull[j] - omega2[j] * u[j] - stiff[j] * v[j])
        total = now = 0.0
        acts, touches, coupled, done = False, False, False, 0
        before: Array = bend
        share = 1.0
        for turn in range(COUPLING_LIMIT):
            for j in range(m):
                a[j] = a0[j] + admittance[j] * bend[j]
                later[j] = u[j] + h * v[j] + (0.5 * h * h) * a[j]
            touches = max(drives(along, section, gaps, later, axes, free), deepest) > 0.0
            touches = touches or (remembers and holds(points, memory))
            if not touches and points.soft > 0.0:
                touches = np.abs(multiplier).max() > 0.0
            if touches:
                done = solve_step(
                    points, section, response, drive, free, memory, multiplier, force, end
                )
                if done < 0:
                    break
                loads = section_gathers(section, weights, force)
                pushed = loads @ along
                for j in range(m):
                    change = admittance[j] * pushed[j]
                    a[j] += change
                    later[j] += (0.5 * h * h) * change
            else:
                force[:, :] = 0.0
                end[:, :] = free
            if not bends:
                coupled = True
                break
            after = axis.rows @ later
            newer = second_order_force(axis, seen, after)
            size = max(np.abs(newer).max(), np.abs(pull).max())
            apart = np.abs(newer - bend).max()
            coupled = apart <= COUPLED * size
            if coupled:
                break
            # Aitken's relaxation (Küttler and Wall, Comput. Mech. 43, 2008)
            left = newer - bend
            change_of = left - before
            squared = float(np.sum(admittance * change_of * change_of))
            if turn > 0 and squared > 0.0:
                share *= -float(np.sum(admittance * before * change_of)) / squared
                share = min(max(share, 0.05), 1.0)
            before = left
            bend = bend + share * left
        if done < 0 or not coupled:
            status = NOT_CONVERGED
            break
        solved += turn + 1
        if solved > limit:
            break
        seen = after
        if touches:
            for i in range(n):
                total += weights[i] * force[i, 0]
            acts = total > 0.0 or (remembers and total < 0.0)
            if acts:
                release = count * h
                if points.drag > 0.0 and end[:, 0].max() > 0.0:
                    release = h * (count - 1 + share_under_drag(last, total))
                elif remembers or end[:, 0].max() < 0.0:
                    release = h * (count - 1 + share_in_contact(points, drive, end, force, memory))
            rubbed += commit(points, drive, end, force, memory)
            if remembers or points.drag > 0.0:
                spent += settle(points, drive, end, force, memory)
            for i in range(n):
                if end[i, 0] > 0.0 or remembers:
                    now += weights[i] * elastic(law, scale[i], end[i, 0], 0.0, memory[i, 2])[0]
        elif remembers:
            memory[:, 2] = 0.0  # the next touch meets a fresh place
        for j in range(m):
            fast[j] = v[j] + h * a[j]
            middle[j] = 0.5 * (v[j] + fast[j])
            weighted[j] = h * damping[j] * middle[j]
        loss += float(weighted @ middle)
        if keep_states:
            if count > len(forces):
                forces = np.concatenate((forces, np.zeros_like(forces)))
                motions = np.concatenate((motions, np.zeros_like(motions)))
            for i in range(n):
                for x in range(3):
                    for c in range(3):
                        forces[count - 1, 3 * i + x] += frames[i, c, x] * force[i, c]
            for j in range(m):
                beta = damping[j] / omega2[j] if omega2[j] > 0.0 else 0.0
                motions[count - 1, j] = 0.5 * (u[j] + later[j]) + 0.5 * beta * (v[j] + fast[j])
        if acts:
            impulse += h * total
            for i in range(n):
                if force[i, 0] != 0.0:
                    for c in range(3):
                        share = h * weights[i] * force[i, c]
                        push[0] += share * frames[i, c, 0]
                        push[1] += share * frames[i, c, 1]
                        push[2] += share * frames[i, c, 2]
        peak = max(peak, total if points.drag > 0.0 else now)
        last = total
        u[:], v[:] = later, fast
        drive[:, :] = end
        deepest, sum_of_drives = -math.inf, 0.0
        for i in range(n):
            deepest = max(deepest, drive[i, 0])
            sum_of_drives += drive[i, 0]
        if keep:
            if count >= len(history):
                history = np.concatenate((history, np.zeros_like(history)))
            history[count, 0] = touching.tip_m + tip @ u
            history[count, 1] = touching.centre_m + lift @ u
            history[count, 2] = now
            history[count, 3] = max(drive[:, 0].max(), 0.0)
        if not math.isfinite(sum_of_drives):
            status = NOT_FINITE
            break
        if deepest <= 0.0 and now == 0.0 and count * h >= wait and not holds(points, memory):
            status = RELEASED
            break
        if count * h >= until:
            status = UNTIL
            break
    spring = spring_energy(points, memory)
    if status == RELEASED:
        # what the springs of friction still hold is lost with the touch
        rubbed += spring
        spring = 0.0
    if bends:
        du, dv = shortened(axis, u, v)
        u, v = u - du, v - dv
    kept = count + 1 if keep else 0
    stated = count if keep_states else 0
    return Marched(
        status,
        count,
        release,
        impulse,
        push,
        peak,
        loss,
        rubbed,
        spent,
        spring,
        memory,
        u,
        v,
        history[:kept],
        forces[:stated],
        motions[:stated],
    )
