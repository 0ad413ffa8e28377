"""One touch, from the instant of contact to release, marched step by step."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from .bodies.axis import shortening
from .bodies.base import Array
from .bodies.modal import ModalBody
from .contact.enforcement import Enforcement
from .contact.normal import PLASTIC
from .contact.step import share_under_drag
from .energy import marching_energy, step_loss
from .errors import ComputationError
from .time import modal_march
from .time.march import Marcher, State

HISTORY_COLUMNS = ("t_s", "tip_y_m", "cm_y_m", "force_N", "penetration_m")
STEP_LIMIT = 2_000_000
# What adhesion holds, or what has no speed to leave its indentation, stays: waiting for its release
# is given up so much sooner.
STAYING = 100


@dataclass
class History:
    """What was seen over time: rows of ``HISTORY_COLUMNS``."""

    rows: list[tuple[float, ...]] = field(default_factory=list)

    def array(self) -> Array:
        """(times, 5) in the order of HISTORY_COLUMNS."""
        return np.array(self.rows).reshape(-1, len(HISTORY_COLUMNS))


@dataclass
class Touch:
    """One touch: when it began and ended, and what it did.

    ``force_N`` and ``penetration_m`` are greatest values at the ends of steps, the latter refined
    by a parabola through its neighbours; ``push_N_s`` (3,) is the impulse along body axes, friction
    included; ``u`` and ``v`` are the first state after release. ``contact_J`` is what contact still
    holds where the march ended before that. ``defect`` bounds the energy norm
    in √J of what a reduced body got wrong.
    """

    start_s: float
    release_s: float
    end_s: float
    u: Array
    v: Array
    peak_force_N: float
    impulse_N_s: float
    push_N_s: Array
    max_penetration_m: float
    max_penetration_s: float
    material_loss_J: float
    friction_loss_J: float
    contact_loss_J: float
    contact_J: float
    defect: float
    n_steps: int


Observer = Callable[[State, Array], None]


def observe(marcher: Marcher, state: State, step_force: Array, history: History) -> float:
    """Append the state to the history; returns the normal contact force at that instant in N.

    ``step_force`` (n, 3) is that of the step before, along the points' local frames.
    """
    force = float(marcher.body.contact.weights @ instant_force(marcher, state, step_force))
    deepest = max(-float(marcher.gaps(state.u).min()), 0.0)
    history.rows.append((state.t_s, *marcher.heights(state), force, deepest))
    return force


def instant_force(marcher: Marcher, state: State, step_force: Array) -> Array:
    """Normal force per area share (n,) at the end of a step; on a rigid plane the step's own."""
    if marcher.rigid_multiplier:
        return step_force[:, 0]
    return marcher.normal_force(state.drive)


def march_touch(
    marcher: Marcher,
    t_s: float,
    u: Array,
    v: Array,
    history: History,
    observer: Observer | None = None,
    until_s: float = np.inf,
    wait_s: float = 0.0,
) -> Touch:
    """March from (u, v) at ``t_s`` until the tip is free again, or past ``until_s``.

    With ``wait_s`` the start may still be free of the plane: a touch is awaited until that time.
    Raises ComputationError where contact forces do not converge, motion is not finite, or the tip
    is still in contact after a number of steps that no impact needs.
    """
    if body_bends(marcher) and (observer is not None or not compiled(marcher)):
        raise ComputationError(
            "a body of second order is marched by compiled code alone: take the conserving scheme, "
            "penalty or the augmented Lagrangian at a finite Kn, and no fields"
        )
    if isinstance(marcher.body, ModalBody) and marcher.body.loss_factor and not compiled(marcher):
        raise ComputationError(
            "a loss factor belongs to modes marched by compiled code: take the conserving scheme, "
            "penalty or the augmented Lagrangian at a finite Kn, and no fields"
        )
    if observer is None and compiled(marcher):
        return _march_compiled(marcher, t_s, u, v, history, until_s, wait_s)
    start = marcher.start(t_s, u, v)
    weights = marcher.body.contact.weights
    state, first_row = start, len(history.rows)
    peak = impulse = loss = defect = rubbed = spent = last = 0.0
    push: Array = np.zeros(3)
    release = t_s
    none = np.zeros((len(weights), 3))
    observe(marcher, start, none, history)
    if observer is not None:
        observer(start, none)
    limit = step_limit(marcher, until_s)
    for count in range(1, limit):
        before = state
        state, force, friction, damped = marcher.step(before)
        spent += damped
        if not np.isfinite(state.drive).all():
            raise _not_finite(state.t_s)
        loss += step_loss(marcher, before, state)
        rubbed += friction
        defect += marcher.step_defect(before, state, force)
        total = float(weights @ force[:, 0])
        impulse += marcher.its_s * total
        push = push + marcher.its_s * (weights @ marcher.along_axes(force))
        now = observe(marcher, state, force, history)
        peak = max(peak, total if marcher.contact.points.drag > 0.0 else now)
        if observer is not None:
            observer(state, force)
        if total > 0.0 or (total < 0.0 and marcher.method.law.pulls):
            share = marcher.contact.share
            if marcher.contact.points.drag > 0.0 and state.drive[:, 0].max() > 0.0:
                share = float(share_under_drag(last, total))
            release = before.t_s + share * (state.t_s - before.t_s)
        last = total
        free = total == 0.0 or (now == 0.0 and not marcher.rigid_multiplier)
        done = free and state.t_s >= wait_s and _leaving(marcher, state)
        if done or state.t_s >= until_s:
            held = marching_energy(marcher, state).contact_J
            if done:
                rubbed += marcher.contact.spring_energy_J()
                held -= marcher.contact.spring_energy_J()
            depth, when = _deepest(np.array(history.rows[first_row:]))
            return Touch(
                start_s=t_s,
                release_s=release,
                end_s=state.t_s,
                u=state.u,
                v=state.v,
                peak_force_N=peak,
                impulse_N_s=impulse,
                push_N_s=push,
                max_penetration_m=depth,
                max_penetration_s=when - t_s,
                material_loss_J=loss,
                friction_loss_J=rubbed,
                contact_loss_J=spent,
                contact_J=held,
                defect=defect,
                n_steps=count,
            )
    raise _too_long(marcher, limit)


def body_bends(marcher: Marcher) -> bool:
    """Whether the body is of second order in slope."""
    return isinstance(marcher.body, ModalBody) and marcher.body.axis is not None


def step_limit(marcher: Marcher, until_s: float) -> int:
    """How many steps a touch may take that is to end before ``until_s``."""
    stays = marcher.method.law.parameters[0] >= PLASTIC and math.isinf(until_s)
    return STEP_LIMIT // STAYING if stays else STEP_LIMIT


def compiled(marcher: Marcher) -> bool:
    """Whether the compiled march serves: modes, the conserving scheme, a law that acts on gaps."""
    return (
        isinstance(marcher.body, ModalBody)
        and marcher.scheme.conserving
        and marcher.method.enforcement is not Enforcement.NITSCHE
        and not marcher.rigid_multiplier
    )


def _march_compiled(
    marcher: Marcher,
    t_s: float,
    u: Array,
    v: Array,
    history: History,
    until_s: float,
    wait_s: float,
) -> Touch:
    """`march_touch` of a modal body in compiled code."""
    modes, touching = marcher.tables()
    limit = step_limit(marcher, until_s)
    marched = modal_march.march(
        modes,
        touching,
        np.ascontiguousarray(u),
        np.ascontiguousarray(v),
        max(wait_s - t_s, 0.0),
        until_s - t_s,
        limit,
        True,
        marcher.body.defect is not None and not body_bends(marcher),
    )
    if marched.status == modal_march.NOT_CONVERGED:
        raise ComputationError(
            f"the contact forces did not converge at t = {t_s + marched.steps * modes.its:.6g} s; "
            "shorten the ITS"
        )
    if marched.status == modal_march.NOT_FINITE:
        raise _not_finite(t_s + marched.steps * modes.its)
    if marched.status == modal_march.TOO_LONG:
        raise _too_long(marcher, limit)
    times = t_s + modes.its * np.arange(marched.steps + 1)
    rows = np.column_stack([times, marched.history])
    history.rows.extend(tuple(map(float, row)) for row in rows)
    depth, when = _deepest(rows)
    return Touch(
        start_s=t_s,
        release_s=t_s + marched.release,
        end_s=float(times[-1]),
        u=marched.u,
        v=marched.v,
        peak_force_N=marched.peak,
        impulse_N_s=marched.impulse,
        push_N_s=marched.push,
        max_penetration_m=depth,
        max_penetration_s=when - t_s,
        material_loss_J=marched.material_loss,
        friction_loss_J=marched.friction_loss,
        contact_loss_J=marched.contact_loss,
        contact_J=marched.spring + _pressed(marcher, marched),
        defect=_defect(marcher, marched, np.ascontiguousarray(u), np.ascontiguousarray(v)),
        n_steps=marched.steps,
    )


def _defect(marcher: Marcher, marched: modal_march.Marched, u: Array, v: Array) -> float:
    """The reduced body's bound; of second order, that of the linear body's march from the same
    start, since the basis answers for contact loads."""
    body = marcher.body
    assert isinstance(body, ModalBody)
    if body.defect is not None and body.axis is not None:
        modes, touching = marcher.tables()
        linear = modes._replace(axis=shortening(None, body.omega2))
        limit = marched.steps + STEP_LIMIT // 1000
        marched = modal_march.march(linear, touching, u, v, 0.0, math.inf, limit, False, True)
    return marcher.march_defect(marched.forces, marched.motions)


def _pressed(marcher: Marcher, marched: modal_march.Marched) -> float:
    """What the contact law holds at the end of a march, in J."""
    drive, scale = marcher.drive(marched.u, marched.v)[:, 0], marcher.ground.scale
    stored = marcher.method.law.potential(drive, marcher.tau, scale, marched.memory[:, 2])
    return float(marcher.body.contact.weights @ stored)


def _not_finite(t_s: float) -> ComputationError:
    return ComputationError(f"the motion is not finite at t = {t_s:.6g} s; shorten the ITS")


def _too_long(marcher: Marcher, limit: int) -> ComputationError:
    return ComputationError(f"still in contact after {limit} steps of {marcher.its_s:g} s")


def _leaving(marcher: Marcher, state: State) -> bool:
    """Whether every point is clear and none is held, or on its way to be.

    A rigid plane under a multiplier has points that rest on it without a push.
    """
    if not marcher.rigid_multiplier:
        return bool(state.drive[:, 0].max() <= 0.0) and not marcher.contact.holds()
    rising = marcher.gaps(state.v) - marcher.ground.gaps_m
    return bool(np.all((marcher.gaps(state.u) > 0.0) | (rising > 0.0)))


def _deepest(rows: Array) -> tuple[float, float]:
    """Greatest penetration and its time, by the parabola through the deepest three instants."""
    t, depth = rows[:, 0], rows[:, 4]
    i = int(np.argmax(depth))
    if i == 0 or i == len(t) - 1:
        return float(depth[i]), float(t[i])
    left, mid, right = depth[i - 1 : i + 2]
    curvature = left - 2.0 * mid + right
    if curvature >= 0.0:
        return float(mid), float(t[i])
    shift = 0.5 * (left - right) / curvature
    return float(mid - 0.25 * (left - right) * shift), float(t[i] + shift * (t[i + 1] - t[i]))
