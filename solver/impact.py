"""Contact phase of a drop, from first touch to release."""

from __future__ import annotations

from typing import TypeGuard

import numpy as np

from .arrays import Array
from .bodies.modal import ModalBody
from .checkpoint import Checkpoint
from .contact.enforcement import Enforcement
from .contact.solve import MULTIPLIER_TOLERANCE
from .contact_phase import (
    ContactPhase,
    ContactSums,
    History,
    Observer,
    march_stepwise,
    not_finite,
    step_limit,
    too_long,
)
from .errors import ComputationError
from .time import modal_march
from .time.march import ContactMarch, Marcher, Moving
from .time.modal_march import MarchLimits

# Bound on the rounding of a step's losses, over the present energy. A loss is work less the change
# of stored energy. Each is a product of a few rounded factors, and no greater than that energy;
# area shares sum to one, so the number of points does not matter.
ROUNDED = 64.0 * float(np.finfo(float).eps)


def march_contact(
    marcher: ContactMarch,
    t_s: float,
    u: Array,
    v: Array,
    history: History,
    observer: Observer | None = None,
    until_s: float = np.inf,
    wait_s: float = 0.0,
    checkpoint: Checkpoint | None = None,
    memory: Array | None = None,
) -> ContactPhase:
    """March from (u, v) at ``t_s`` until the tip is free again, or past ``until_s``.

    With ``wait_s`` the start may be clear of the plane: the march waits for a touch until that
    time. ``memory`` (n,) is the law's state at the points, None if they have not been touched. A
    stepwise march writes to ``checkpoint`` and resumes from it. Raises ComputationError if contact
    forces do not converge, motion is not finite, friction or the contact law added energy, or the
    tip is still in contact after a number of steps that no impact needs.
    """
    if body_bends(marcher) and (observer is not None or not compiled(marcher)):
        raise ComputationError(
            "a body of second order is marched by compiled code alone: take the conserving scheme, "
            "penalty or the augmented Lagrangian at a finite Kn, and no fields"
        )
    if memory is None:
        memory = np.zeros(len(marcher.body.contact.weights))
    if observer is None and compiled(marcher):
        touch = _march_compiled(marcher, (t_s, u, v), memory, history, until_s, wait_s)
    else:
        touch = march_stepwise(
            marcher, (t_s, u, v), memory, history, observer, until_s, wait_s, checkpoint
        )
    _check_losses(marcher, u, v, touch)
    return touch


def gain_allowed(marcher: ContactMarch, n_steps: Array | int) -> Array | float:
    """Share of the present energy up to which a negative loss counts as rounding.

    A multiplier is accurate to `MULTIPLIER_TOLERANCE` of the work of a step. All steps of an impact
    together do work of a few times its energy.
    """
    augmented = marcher.method.enforcement is Enforcement.AUGMENTED
    return ROUNDED * n_steps + (10.0 * MULTIPLIER_TOLERANCE if augmented else 0.0)


def _check_losses(marcher: ContactMarch, u: Array, v: Array, touch: ContactPhase) -> None:
    """Raise ComputationError if friction or the contact law added energy.

    Their losses are work less the change of stored energy, so a budget closes even with a law that
    creates energy. Schemes other than the conserving one guarantee nothing.
    """
    if not marcher.scheme.conserving:
        return
    body = marcher.body
    energy = 0.5 * (body.dot(v, body.mass(v)) + body.dot(u, body.stiffness(u)))
    energy += touch.peak_force_N * touch.max_penetration_m
    allowed = float(gain_allowed(marcher, touch.n_steps)) * energy
    for what, loss in (
        ("friction", touch.friction_loss_J),
        ("the contact law", touch.contact_loss_J),
    ):
        if loss < -allowed:
            raise ComputationError(
                f"{what} gave {-loss:.3g} J in the touch at t = {touch.start_s:.6g} s, of an "
                f"impact of {energy:.3g} J, where it can only take: the law or its step is wrong"
            )


def body_bends(marcher: ContactMarch) -> bool:
    """Whether the body is of second order in slope."""
    return isinstance(marcher.body, ModalBody) and marcher.body.axis is not None


def compiled(marcher: ContactMarch) -> TypeGuard[Marcher]:
    """Whether the compiled march applies: modes, the conserving scheme, a law that acts on gaps."""
    return (
        isinstance(marcher, Marcher)
        and isinstance(marcher.body, ModalBody)
        and marcher.scheme.conserving
        and marcher.method.enforcement is not Enforcement.NITSCHE
        and not marcher.rigid_multiplier
    )


def _march_compiled(
    marcher: Marcher,
    start: tuple[float, Array, Array],
    memory: Array,
    history: History,
    until_s: float,
    wait_s: float,
) -> ContactPhase:
    """`march_contact` of a modal body in compiled code, from a time and state."""
    t_s, *state = start
    modes, touching = marcher.tables()
    limit = step_limit(marcher, until_s)
    limits = MarchLimits(
        wait=max(wait_s - t_s, 0.0), until=until_s - t_s, limit=limit, history=True
    )
    u, v = map(np.ascontiguousarray, state)
    marched = modal_march.march(modes, touching, u, v, memory, limits)
    times = t_s + modes.its * np.arange(marched.steps + 1)
    if marched.status == modal_march.NOT_CONVERGED:
        raise ComputationError(
            f"the contact forces did not converge at t = {times[-1]:.6g} s; shorten the ITS"
        )
    if marched.status == modal_march.NOT_FINITE:
        raise not_finite(times[-1])
    if marched.status == modal_march.TOO_LONG:
        raise too_long(marcher, limit)
    rows = np.column_stack([times, marched.history])
    history.extend(rows)
    marcher.contact.memory[:] = marched.memory
    sums = ContactSums(
        release_s=t_s + marched.release,
        released=marched.status == modal_march.RELEASED,
        peak_force_N=marched.peak,
        impulse_N_s=marched.impulse,
        push_N_s=marched.push,
        material_loss_J=marched.material_loss,
        friction_loss_J=marched.friction_loss,
        contact_loss_J=marched.contact_loss,
    )
    u, v = marched.u, marched.v
    end = Moving(
        float(times[-1]), u, v, marcher.body.mass(u), marcher.body.mass(v), marched.approach
    )
    return ContactPhase.ended(marcher, sums, rows, end)
