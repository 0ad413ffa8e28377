"""One touch of a modal body under the conserving scheme, marched in compiled code.

The implicit midpoint rule per mode, with the contact forces of contact.solve: what `Marcher` does
for any body and scheme, for the one case that most drops are.
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
from ..compiled import njit
from ..contact.normal import holds
from ..contact.points import Points, Trial
from ..contact.section import (
    Section,
    contact_stiffness,
    new_section,
    section_gathers,
    section_moves,
)
from ..contact.solve import solve_step
from ..contact.step import commit, settle, share_in_contact, share_under_damping, spring_energy
from .fixed_point import Secants, new_secants, next_move, remember

# The second-order force of a step is found by Anderson's acceleration, to this share of itself.
# Contact that opens or closes may lead it astray: after so many turns it starts again from its
# best, preconditioned by Newton's matrix, and so after every few. A step that asks for more is too
# long to be right.
COUPLED, PLAIN_TURNS, RESTART_EVERY, COUPLING_LIMIT = 1e-9, 25, 10, 65
RELEASED, UNTIL, TOO_LONG, NOT_CONVERGED, NOT_FINITE = 0, 1, 2, 3, 4


class Modes(NamedTuple):
    """A body's modes and contact points, and how they answer over a step of ``its`` s.

    ``along`` (r, modes) are the section's coordinates, ``support`` and ``shapes`` as in
    ContactPoints; ``tip`` (3, modes) is the section's mean displacement. ``compliance`` is
    Marcher's, ``axis`` bodies.axis'. ``admittance`` (modes,) = 1/(1 + ½ h c + ¼ h² ω²).
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
    """The contact law at the points, and where the body stands: see Marcher and Placement."""

    points: Points
    frames: Array
    gaps: Array
    up: Array
    tip_m: float
    centre_m: float
    gravity: float


class MarchLimits(NamedTuple):
    """Until when to march: all points clear after ``wait`` s, or past ``until`` s, in at most
    ``limit`` steps. ``history`` says whether to keep it."""

    wait: float
    until: float
    limit: int
    history: bool


class Marched(NamedTuple):
    """What a march gave.

    ``push`` (3,) is the impulse along body axes, ``approach`` (n, 3) the last one, ``memory`` (n,)
    what the law remembers; ``history`` (steps + 1, 4) has heights of tip and centre, force and
    penetration.
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
    spring: float
    approach: Array
    memory: Array
    u: Array
    v: Array
    history: Array


class Work(NamedTuple):
    """Arrays (modes,) of one step: the state (u, v) before it, the displacement ``later``, the mean
    acceleration ``a`` with contact and ``free`` without, gravity's ``pull``; of a body of second
    order its force ``bend``, what its axis sees ``before`` and ``after``, ``secants``, the ``best``
    force so far, and the inverse of Newton's matrix (modes, modes) as a ``preconditioner``,
    if one has been ``made`` (1,)."""

    u: Array
    v: Array
    later: Array
    a: Array
    free: Array
    pull: Array
    bend: Array
    before: Array
    after: Array
    secants: Secants
    best: Array
    preconditioner: Array
    made: NDArray[np.bool_]


class Taken(NamedTuple):
    """What contact did in a step: its mean and its final normal force, and what friction and the
    law took, in N and J; ``share`` is that of the step after which it has ended."""

    mean: float
    final: float
    share: float
    friction: float
    law: float


@njit
def local_section(modes: Modes, frames: Array) -> Section:
    """The section as contact.section sees it, along the points' local ``frames`` (n, 3, 3)."""
    n, s = modes.support.shape
    values = np.zeros((n, 3, s))
    for i in range(n):
        for a in range(3):
            for x in range(3):
                factor = frames[i, a, x]
                for c in range(s):
                    values[i, a, c] += factor * modes.shapes[i, x, c]
    return new_section(modes.support, values, modes.compliance)


@njit
def approaches(
    along: Array, section: Section, gaps: Array, u: Array, axes: int, approach: Array
) -> float:
    """Write the approach of every point along the first ``axes`` of its local frame (n, 3).

    Returns the greatest along the normal.
    """
    section_moves(section, along @ u, axes, approach)
    most = -math.inf
    for i in range(len(gaps)):
        for a in range(axes):
            approach[i, a] = -approach[i, a]
        approach[i, 0] -= gaps[i]
        most = max(most, approach[i, 0])
    return most


@njit
def _new_work(modes: Modes, touching: Touching, u: Array, v: Array) -> Work:
    """The arrays of a first step; a body of second order sees its own shortening in (u, v)."""
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
    # without friction nobody asks for tangential approaches
    axes = 3 if points.mu > 0.0 else 1
    touches, before, move = False, bend, bend
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
            pushed = section_gathers(section, modes.weights, trial.force) @ modes.along
            for j in range(m):
                change = admittance[j] * pushed[j]
                a[j] += change
                later[j] += (0.5 * h * h) * change
        else:
            trial.force[:, :] = 0.0
            trial.end[:, :] = trial.free
        if not len(modes.axis.weights):
            return True, touches
        work.after[:] = modes.axis.rows @ later
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
def _take(points: Points, trial: Trial, last: float) -> Taken:
    """Let friction's springs and the law's memory follow a step; ``last`` is the mean normal force
    of the step before."""
    kind, law, weights, end = points.kind, points.law, points.weights, trial.end
    remembers = kind.remembers
    mean = final = 0.0
    for i in range(len(weights)):
        mean += weights[i] * trial.force[i, 0]
    share = 1.0
    if points.dashpot != 0.0 and end[:, 0].max() > 0.0:
        share = share_under_damping(last, mean)
    elif remembers or end[:, 0].max() < 0.0:
        share = share_in_contact(points, trial)
    friction, lost = commit(points, trial), settle(points, trial)
    for i in range(len(weights)):
        if end[i, 0] > 0.0 or remembers:
            remembered = trial.memory[i, 2]
            final += weights[i] * kind.elastic(law, points.scale[i], end[i, 0], 0.0, remembered)[0]
    return Taken(mean, final, share, friction, lost)


@njit
def _damp(modes: Modes, work: Work, fast: Array) -> float:
    """Write the velocity ``fast`` at the end of a step; returns what damping took in it."""
    loss = second_order_loss(modes.axis, work.before, work.after, modes.its)
    for j in range(len(fast)):
        fast[j] = work.v[j] + modes.its * work.a[j]
        middle = 0.5 * (work.v[j] + fast[j])
        loss += modes.its * modes.damping[j] * middle * middle
    return loss


@njit
def _push(weights: Array, frames: Array, force: Array, push: Array) -> None:
    """Add a force (n, 3) along local frames to ``push`` (3,) along body axes."""
    for i in range(len(weights)):
        if force[i, 0] != 0.0:
            for c in range(3):
                share = weights[i] * force[i, c]
                for x in range(3):
                    push[x] += share * frames[i, c, x]


@njit
def _longer(rows: Array, count: int) -> Array:
    """The ``rows``, or twice as many where ``count`` do not fit."""
    return rows if count <= len(rows) else np.concatenate((rows, np.zeros_like(rows)))


@njit
def march(
    modes: Modes, touching: Touching, u: Array, v: Array, memory: Array, limits: MarchLimits
) -> Marched:
    """March from the state (u, v), the law remembering ``memory`` (n,).

    Times count from the start.
    """
    h, weights, points = modes.its, modes.weights, touching.points
    n, m = len(weights), len(u)
    remembers = points.kind.remembers
    section = local_section(modes, touching.frames)
    work = _new_work(modes, touching, u, v)
    none = np.zeros((n, 3))
    trial = Trial(none.copy(), none.copy(), none.copy(), none.copy(), none.copy(), none.copy())
    trial.memory[:, 2] = memory
    axes = 3 if points.mu > 0.0 else 1
    deepest = approaches(modes.along, section, touching.gaps, work.u, axes, trial.start)
    lift = (modes.translation @ touching.up) / modes.mass
    tip = modes.tip.T @ touching.up
    fast, push = np.empty(m), np.zeros(3)
    history: Array = np.zeros((64 if limits.history else 1, 4))
    release = impulse = peak = loss = rubbed = spent = 0.0
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
            taken = _take(points, trial, last)
            rubbed += taken.friction
            spent += taken.law
            if taken.mean > 0.0 or (remembers and taken.mean < 0.0):
                release = h * (count - 1 + taken.share)
                impulse += h * taken.mean
                _push(weights, touching.frames, h * trial.force, push)
        loss += _damp(modes, work, fast)
        last = taken.mean
        force = taken.mean if points.dashpot != 0.0 else taken.final
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
        clear = deepest <= 0.0 and taken.final == 0.0 and not holds(points, trial.memory)
        if clear and count * h >= limits.wait:
            status = RELEASED
            break
        if count * h >= limits.until:
            status = UNTIL
            break
    spring = spring_energy(points, trial.memory)
    if status == RELEASED:
        # what the springs of friction still hold is lost with the touch
        rubbed += spring
        spring = 0.0
    u, v = work.u, work.v
    if len(modes.axis.weights):
        du, dv = shortened(modes.axis, u, v)
        u, v = u - du, v - dv
    rows = count + 1 if limits.history else 0
    return Marched(
        status=status,
        steps=count,
        release=release,
        impulse=impulse,
        push=push,
        peak=peak,
        material_loss=loss,
        friction_loss=rubbed,
        contact_loss=spent,
        spring=spring,
        approach=trial.start,
        memory=trial.memory[:, 2].copy(),
        u=u,
        v=v,
        history=history[:rows],
    )
