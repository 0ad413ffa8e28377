"""One touch, from the instant of contact to release."""

from __future__ import annotations

import math

import numpy as np

from .bodies.axis import shortening
from .bodies.base import Array
from .bodies.modal import ModalBody
from .checkpoint import Checkpoint
from .contact.enforcement import Enforcement
from .errors import ComputationError
from .stepwise import march_stepwise
from .time import modal_march
from .time.march import Marcher
from .touch import STEP_LIMIT, History, Observer, Touch, deepest, not_finite, step_limit, too_long


def march_touch(
    marcher: Marcher,
    t_s: float,
    u: Array,
    v: Array,
    history: History,
    observer: Observer | None = None,
    until_s: float = np.inf,
    wait_s: float = 0.0,
    checkpoint: Checkpoint | None = None,
) -> Touch:
    """March from (u, v) at ``t_s`` until the tip is free again, or past ``until_s``.

    With ``wait_s`` the start may still be free of the plane: a touch is awaited until that time.
    What is marched step by step is kept in ``checkpoint``, and goes on from there.
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
    return march_stepwise(marcher, t_s, u, v, history, observer, until_s, wait_s, checkpoint)


def body_bends(marcher: Marcher) -> bool:
    """Whether the body is of second order in slope."""
    return isinstance(marcher.body, ModalBody) and marcher.body.axis is not None


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
        raise not_finite(t_s + marched.steps * modes.its)
    if marched.status == modal_march.TOO_LONG:
        raise too_long(marcher, limit)
    times = t_s + modes.its * np.arange(marched.steps + 1)
    rows = np.column_stack([times, marched.history])
    history.rows.extend(tuple(map(float, row)) for row in rows)
    depth, when = deepest(rows)
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
