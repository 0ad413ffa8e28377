"""Contact phase of any body, marched step by step, with checkpoints."""

from __future__ import annotations

import numpy as np

from .arrays import Array
from .checkpoint import Checkpoint, Mark, prefixed, under
from .contact.step import share_under_damping
from .contact_phase import (
    ContactPhase,
    ContactSums,
    History,
    Observer,
    deepest,
    not_finite,
    observe,
    step_limit,
    too_long,
)
from .energy import marching_energy
from .time.march import ContactMarch, Moving


def march_stepwise(
    marcher: ContactMarch,
    start: tuple[float, Array, Array],
    memory: Array,
    history: History,
    observer: Observer | None,
    until_s: float,
    wait_s: float,
    checkpoint: Checkpoint | None,
) -> ContactPhase:
    """`impact.march_contact`, in steps of the marcher."""
    t_s, *_ = start
    first_row = len(history.rows)
    mark = checkpoint.begin(*start, memory) if checkpoint else None
    if mark is None:
        count, sums, state, done = 0, ContactSums(t_s), marcher.start(*start), False
        marcher.contact.memory[:, 2] = memory
        none = np.zeros((len(marcher.body.contact.weights), 3))
        observe(marcher, state, none, history)
        if observer is not None:
            observer(state, none)
    else:
        count, done = mark.steps, mark.done
        sums, state = _recalled(mark, marcher, history)
        if observer is not None:
            observer.recall(mark, state)
    limit = step_limit(marcher, until_s)
    while not done:
        count += 1
        if count >= limit:
            raise too_long(marcher, limit)
        state = _step(marcher, state, sums, history, observer, wait_s)
        done = sums.released or state.t_s >= until_s
        if checkpoint and (done or checkpoint.due()):
            rows = np.array(history.rows[first_row:])
            saved = _kept(marcher, state, sums, rows, observer)
            checkpoint.save(count, saved, done=done)
    held = marching_energy(marcher, state).contact_J
    if sums.released:
        spring = marcher.contact.spring_energy_J()
        sums.friction_loss_J += spring
        held -= spring
    depth, when = deepest(np.array(history.rows[first_row:]))
    return ContactPhase(
        **vars(sums),
        start_s=t_s,
        end_s=state.t_s,
        u=state.u,
        v=state.v,
        max_penetration_m=depth,
        max_penetration_s=when - t_s,
        contact_J=held,
        n_steps=count,
        memory=marcher.contact.memory[:, 2].copy(),
    )


def _step(
    marcher: ContactMarch,
    before: Moving,
    sums: ContactSums,
    history: History,
    observer: Observer | None,
    wait_s: float,
) -> Moving:
    """The state after a step from ``before``; what it did comes into ``sums`` and ``history``."""
    contact, weights = marcher.contact, marcher.body.contact.weights
    state, force, friction, damped = marcher.step(before)
    if not np.isfinite(state.approach).all():
        raise not_finite(state.t_s)
    total = float(weights @ force[:, 0])
    now = observe(marcher, state, force, history)
    if observer is not None:
        observer(state, force)
    sums.contact_loss_J += damped
    sums.material_loss_J += marcher.damping_loss_J(before, state, force)
    sums.friction_loss_J += friction
    sums.impulse_N_s += marcher.its_s * total
    sums.push_N_s = sums.push_N_s + marcher.its_s * (weights @ marcher.along_axes(force))
    sums.peak_force_N = max(sums.peak_force_N, now)
    if total > 0.0 or (total < 0.0 and marcher.method.law.pulls):
        share = contact.share
        if contact.points.dashpot != 0.0 and state.approach[:, 0].max() > 0.0:
            share = float(share_under_damping(sums.last_N, total))
        sums.release_s = before.t_s + share * (state.t_s - before.t_s)
    sums.last_N = total
    opened = not marcher.rigid_multiplier and not marcher.normal_force(state.approach).any()
    free = total == 0.0 or opened
    sums.released = free and state.t_s >= wait_s and _leaving(marcher, state)
    return state


def _leaving(marcher: ContactMarch, state: Moving) -> bool:
    """Whether every point is clear and none is held, or on its way to be.

    A rigid plane under a multiplier has points that rest on it without a push.
    """
    if not marcher.rigid_multiplier:
        return bool(state.approach[:, 0].max() <= 0.0) and not marcher.contact.holds()
    rising = marcher.gaps(state.v) - marcher.ground.gaps_m
    return bool(np.all((marcher.gaps(state.u) > 0.0) | (rising > 0.0)))


def _kept(
    marcher: ContactMarch, state: Moving, sums: ContactSums, rows: Array, observer: Observer | None
) -> dict[str, Array]:
    """Everything that the next step, and the touch, will need."""
    return {
        **kept_state(marcher, state),
        **prefixed("sums", vars(sums)),
        **prefixed("observer", observer.memory() if observer is not None else {}),
        "rows": rows,
    }


def _recalled(mark: Mark, marcher: ContactMarch, history: History) -> tuple[ContactSums, Moving]:
    """What `_kept` was given; the rows come back into ``history``."""
    history.extend(mark.arrays["rows"])
    sums = ContactSums(0.0)
    for name, value in under("sums", mark.arrays):
        setattr(sums, name, value.copy() if value.ndim else value.item())
    return sums, recalled_state(mark, marcher)


def kept_state(marcher: ContactMarch, state: Moving) -> dict[str, Array]:
    """The state and what contact remembers, as arrays by name."""
    return {
        **prefixed("state", vars(state)),
        **prefixed("contact", marcher.contact.kept()),
        **prefixed("march", marcher.memory()),
    }


def recalled_state(mark: Mark, marcher: ContactMarch) -> Moving:
    """The state that `kept_state` was given; contact remembers again."""
    marcher.recall(dict(under("march", mark.arrays)))
    marcher.contact.recall(dict(under("contact", mark.arrays)))
    state = dict(under("state", mark.arrays))
    return marcher.state_type(t_s=float(state.pop("t_s")), **state)
