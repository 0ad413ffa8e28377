"""One touch of a modal body under the conserving scheme, in compiled code.

The implicit midpoint rule per mode, with the contact forces of contact.solve: the same as `Marcher`
for the most common case.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..bodies.axis import (
    Shortening,
    second_order_force,
    second_order_loss,
    second_order_tangent,
    shortened,
)
from ..compiled import njit, unowned
from ..contact.normal import holds
from ..contact.points import Points, Trial
from ..contact.section import (
    Section,
    contact_stiffness,
    gather,
    moved_approach,
    new_section,
)
from ..contact.solve import solve_step
from ..contact.step import Taken, let_go, take
from .fixed_point import Secants, new_secants, next_move, remember

# Anderson acceleration finds the second-order force of a step to the relative tolerance `COUPLED`.
# Contact that opens or closes may mislead it. After `PLAIN_TURNS` iterations it restarts from its
# best, preconditioned by Newton's matrix, and again every `RESTART_EVERY`. A step that needs more
# than the limit is too long to be accurate.
COUPLED, PLAIN_TURNS, RESTART_EVERY, COUPLING_LIMIT = 1e-9, 25, 10, 65
RELEASED, UNTIL, TOO_LONG, NOT_CONVERGED, NOT_FINITE = 0, 1, 2, 3, 4


class Modes(NamedTuple):
    """A body's modes and contact points, and their compliance over a step of ``its`` s.

    ``along`` (r, modes) are the section's coordinates, ``support`` and ``shapes`` as in
    ContactPoints; ``tip`` (3, modes) is the section's mean displacement. ``compliance`` is
    Marcher's, ``axis`` that of bodies.axis. ``admittance`` (modes,) = 1/(1 + ½ h c + ¼ h² ω²).
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
    compliance: Array
    mass: float
    axis: Shortening


class Touching(NamedTuple):
    """The contact law at the points, and the body's placement: see Marcher and Placement."""

    points: Points
    frames: Array
    gaps: Array
    up: Array
    tip_m: float
    centre_m: float
    gravity: float


class MarchLimits(NamedTuple):
    """End of a march: all points clear after ``wait`` s, or ``until`` s, or ``limit`` steps;
    ``history`` says whether to record it."""

    wait: float
    until: float
    limit: int
    history: bool


class Marched(NamedTuple):
    """Result of a march.

    ``push`` (3,) is the impulse along body axes, ``approach`` (n, 3) the last one, ``memory`` (n,
    3) that of `Trial`. ``history`` (steps + 1, 4), if recorded, has heights of tip and centre,
    force and penetration.
    """

    status: int
    steps: int
    release: float
    impulse: float
    push: Array
    peak: float
    material_loss: float
    friction_loss: float
    contact_loss: float
    approach: Array
    memory: Array
    u: Array
    v: Array
    history: Array


class Work(NamedTuple):
    """Arrays (modes,) of one step: the state (u, v) before it, the displacement ``later``, the mean
    acceleration ``a`` with contact and ``free`` without, gravity's ``pull``; the contact ``loads``
    on the section (r,) and, ``pushed``, on modes. For a second-order body also its force ``bend``,
    the axis' rows times u ``before`` and ``after``, ``secants``, the ``best`` force so far, and the
    inverse of Newton's matrix (modes, modes) as ``preconditioner``, valid if ``made`` (1,)."""

    u: Array
    v: Array
    later: Array
    a: Array
    free: Array
    pull: Array
    loads: Array
    pushed: Array
    bend: Array
    before: Array
    after: Array
    secants: Secants
    best: Array
    preconditioner: Array
    made: NDArray[np.bool_]


@njit
def approaches(
    along: Array, section: Section, gaps: Array, u: Array, axes: int, approach: Array
) -> float:
    """Write the approach of every point along the first ``axes`` of its local frame (n, 3).

    Returns the greatest one along the normal.
    """
    z, most = section.room.z, -math.inf
    np.dot(along, u, z)
    for i in range(len(gaps)):
        for c in range(axes):
            approach[i, c] = moved_approach(section, z, i, c, -gaps[i] if c == 0 else 0.0)
        most = max(most, approach[i, 0])
    return most


@njit
def _new_work(modes: Modes, touching: Touching, u: Array, v: Array) -> Work:
    """The arrays of a first step; in a second-order body (u, v) include its shortening."""
    m = len(u)
    bent = m if len(modes.axis.weights) else 0
    if bent:
        du, dv = shortened(modes.axis, u, v)
        u, v = u + du, v + dv
    at_axis = modes.axis.rows @ u
    pull = -touching.gravity * (modes.translation @ touching.up)
    return Work(
        u=u.copy(),
        v=v.copy(),
        later=np.empty(m),
        a=np.empty(m),
        free=np.empty(m),
        pull=pull,
        loads=np.empty(len(modes.along)),
        pushed=np.empty(m),
        bend=np.zeros(m),
        before=at_axis,
        after=at_axis.copy(),
        secants=new_secants(modes.admittance[:bent]),
        best=np.zeros(bent),
        preconditioner=np.zeros((bent, bent)),
        made=np.zeros(1, dtype=np.bool_),
    )


@njit
def _solve(
    modes: Modes, touching: Touching, section: Section, trial: Trial, work: Work, deepest: float
) -> tuple[bool, bool]:
    """Find the step's force and acceleration; whether they converged, and whether contact acts.

    ``deepest`` is the greatest approach at its start.
    """
    h, points, admittance = modes.its, touching.points, modes.admittance
    u, v, a, later, bend = work.u, work.v, work.a, work.later, work.bend
    m = len(u)
    for j in range(m):
        elastic_pull = modes.omega2[j] * u[j]
        damped = (modes.damping[j] + 0.5 * h * modes.omega2[j]) * v[j]
        work.free[j] = admittance[j] * (work.pull[j] - elastic_pull - damped)
    # without friction no tangential approaches are needed
    axes = 3 if points.mu > 0.0 else 1
    loads, pushed, touches, before, move = work.loads, work.pushed, False, bend, bend
    least, restarted = math.inf, False
    for turn in range(COUPLING_LIMIT):
        for j in range(m):
            a[j] = work.free[j] + admittance[j] * bend[j]
            later[j] = u[j] + h * v[j] + (0.5 * h * h) * a[j]
        nearest = approaches(modes.along, section, touching.gaps, later, axes, trial.free)
        touches = max(nearest, deepest) > 0.0 or holds(points, trial.memory)
        if not touches and points.proximal > 0.0:
            touches = np.abs(trial.multiplier).max() > 0.0
        if touches:
            if solve_step(points, section, trial) < 0:
                return False, touches
            gather(section, modes.weights, trial.force, loads)
            np.dot(loads, modes.along, pushed)
            for j in range(m):
                change = admittance[j] * pushed[j]
                a[j] += change
                later[j] += (0.5 * h * h) * change
        else:
            trial.force[:, :] = 0.0
            trial.end[:, :] = trial.free
        if not len(modes.axis.weights):
            return True, touches
        np.dot(modes.axis.rows, later, work.after)
        residual = second_order_force(modes.axis, work.before, work.after, h) - bend
        size = max(np.abs(residual + bend).max(), np.abs(work.pull).max())
        left = np.abs(residual).max()
        if left <= COUPLED * size:
            return True, touches
        if left < least:
            work.best[:], least = bend, left
        if turn >= PLAIN_TURNS and (turn - PLAIN_TURNS) % RESTART_EVERY == 0:
            if not math.isfinite(least):
                break
            bend[:], restarted = work.best, True
            continue
        if restarted:
            newton = _newton_matrix(modes, points, section, trial, work)
            work.preconditioner[:, :] = np.linalg.inv(newton)
            work.made[0], work.secants.total[0] = True, 0
        if work.made[0]:
            residual = work.preconditioner @ residual
        if turn > 0 and not restarted:
            remember(work.secants, move, residual - before)
        before, restarted = residual, False
        move = next_move(work.secants, residual)
        bend += move
    return False, touches


@njit
def _newton_matrix(
    modes: Modes, points: Points, section: Section, trial: Trial, work: Work
) -> Array:
    """Newton's matrix (modes, modes): minus the derivative of the residual by the second-order
    force."""
    answer = 0.5 * modes.its * modes.its * modes.admittance
    moved = np.diag(answer)
    if np.abs(trial.force[:, 0]).max() > 0.0:
        along = modes.along * answer
        moved -= along.T @ (contact_stiffness(points, section, trial) @ along)
    tangent = second_order_tangent(modes.axis, work.before, work.after, modes.its)
    return np.eye(len(answer)) - tangent @ moved


@njit
def _damp(modes: Modes, work: Work, fast: Array) -> float:
    """Write the velocity ``fast`` at the end of a step; returns the energy lost to damping."""
    loss = 0.0
    if len(modes.axis.weights):
        loss = second_order_loss(modes.axis, work.before, work.after, modes.its)
    for j in range(len(fast)):
        fast[j] = work.v[j] + modes.its * work.a[j]
        middle = 0.5 * (work.v[j] + fast[j])
        loss += modes.its * modes.damping[j] * middle * middle
    return loss


@njit
def _longer(rows: Array, count: int) -> Array:
    """The ``rows``, or a copy with twice as many if ``count`` do not fit."""
    return rows if count <= len(rows) else np.concatenate((rows, np.zeros_like(rows)))


@njit
def march(
    modes: Modes, touching: Touching, u: Array, v: Array, memory: Array, limits: MarchLimits
) -> Marched:
    """March from the state (u, v), with the law's ``memory`` (n,).

    Times count from the start.
    """
    modes, touching = unowned(modes), unowned(touching)
    h, weights, points, frames = modes.its, modes.weights, touching.points, touching.frames
    n, m = len(weights), len(u)
    values = np.empty(modes.shapes.shape)
    for i in range(n):
        values[i] = frames[i] @ modes.shapes[i]
    section = new_section(modes.support, values, modes.compliance)
    work = _new_work(modes, touching, u, v)
    none = np.zeros((n, 3))
    trial = Trial(none.copy(), none.copy(), none.copy(), none.copy(), none.copy(), none.copy())
    trial.memory[:, 2] = memory
    owned = (section, trial, work)  # keeps the arrays alive while views of them are used
    section, trial, work = unowned(section), unowned(trial), unowned(work)
    axes = 3 if points.mu > 0.0 else 1
    deepest = approaches(modes.along, section, touching.gaps, work.u, axes, trial.start)
    lift = (modes.translation @ touching.up) / modes.mass
    tip = modes.tip.T @ touching.up
    fast, pushed = np.empty(m), np.zeros((n, 3))
    history: Array = np.zeros((64 if limits.history else 1, 4))
    release = peak = loss = rubbed = spent = 0.0
    status, count, last = TOO_LONG, 0, 0.0
    history[0, 0] = touching.tip_m + tip @ work.u
    history[0, 1] = touching.centre_m + lift @ work.u
    history[0, 3] = max(deepest, 0.0)
    for count in range(1, limits.limit + 1):
        converged, touches = _solve(modes, touching, section, trial, work, deepest)
        if not converged:
            status = NOT_CONVERGED
            break
        taken = Taken(0.0, 0.0, 1.0, 0.0, 0.0)
        if touches:
            taken = take(points, trial, last)
            rubbed += taken.friction_loss_J
            spent += taken.contact_loss_J
            pushed += trial.force
            if taken.mean_N > 0.0 or (points.kind.remembers and taken.mean_N < 0.0):
                release = h * (count - 1 + taken.share)
        loss += _damp(modes, work, fast)
        last = taken.mean_N
        force = taken.mean_N if points.dashpot != 0.0 else taken.final_N
        peak = max(peak, force)
        work.u[:], work.v[:], work.before[:] = work.later, fast, work.after
        trial.start[:, :] = trial.end
        deepest = trial.start[:, 0].max()
        if limits.history:
            history = _longer(history, count + 1)
            history[count, 0] = touching.tip_m + tip @ work.u
            history[count, 1] = touching.centre_m + lift @ work.u
            history[count, 2] = force
            history[count, 3] = max(deepest, 0.0)
        if not math.isfinite(trial.start[:, 0].sum()):
            status = NOT_FINITE
            break
        clear = deepest <= 0.0 and taken.final_N == 0.0 and not holds(points, trial.memory)
        if clear and count * h >= limits.wait:
            status = RELEASED
            rubbed += let_go(points, trial.memory)
            break
        if count * h >= limits.until:
            status = UNTIL
            break
    section, trial, work = owned
    u, v = work.u, work.v
    if len(modes.axis.weights):
        du, dv = shortened(modes.axis, u, v)
        u, v = u - du, v - dv
    push = np.zeros(3)
    for i in range(n):
        pushed[i] *= h * weights[i]
        push += pushed[i] @ frames[i]
    return Marched(
        status=status,
        steps=count,
        release=release,
        impulse=pushed[:, 0].sum(),
        push=push,
        peak=peak,
        material_loss=loss,
        friction_loss=rubbed,
        contact_loss=spent,
        approach=trial.start,
        memory=trial.memory,
        u=u,
        v=v,
        history=history[: count + 1],
    )
