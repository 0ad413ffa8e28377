"""One touch, from the instant of contact to release, marched step by step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from .bodies.base import Array
from .energy import step_loss
from .errors import ComputationError
from .time.march import Marcher, State

HISTORY_COLUMNS = ("t_s", "tip_y_m", "cm_y_m", "force_N", "penetration_m")
STEP_LIMIT = 2_000_000


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
    by a parabola through its neighbours; ``state`` is the first one after release. ``defect``
    bounds the energy norm in √J of what a reduced body got wrong.
    """

    start_s: float
    release_s: float
    state: State
    peak_force_N: float
    impulse_N_s: float
    max_penetration_m: float
    max_penetration_s: float
    material_loss_J: float
    defect: float
    n_steps: int


Observer = Callable[[State, Array], None]


def observe(marcher: Marcher, state: State, step_force: Array, history: History) -> float:
    """Append the state to the history; returns the total contact force at that instant in N."""
    body = marcher.body
    heights = body.contact.heights(state.u)
    force = float(body.contact.weights @ instant_force(marcher, state, step_force))
    centre = body.dot(body.lift, state.mu) / body.mass_kg
    history.rows.append(
        (
            state.t_s,
            float(body.contact.weights @ heights),
            centre,
            force,
            max(-float(heights.min()), 0.0),
        )
    )
    return force


def instant_force(marcher: Marcher, state: State, step_force: Array) -> Array:
    """Force per area share at the end of a step; a rigid plane's multiplier is the step's own."""
    if marcher.rigid_multiplier:
        return step_force
    return marcher.end_force(state)


def march_touch(
    marcher: Marcher,
    start: State,
    history: History,
    observer: Observer | None = None,
    until_s: float = np.inf,
    wait_s: float = 0.0,
) -> Touch:
    """March from the instant of touch until the tip is free again, or past ``until_s``.

    With ``wait_s`` the start may still be free of the plane: a touch is awaited until that time.
    Raises ComputationError where contact forces do not converge, motion is not finite, or the tip
    is still in contact after a number of steps that no impact needs.
    """
    weights = marcher.body.contact.weights
    state, first_row = start, len(history.rows)
    peak = impulse = loss = defect = 0.0
    release = start.t_s
    none = np.zeros_like(weights)
    observe(marcher, start, none, history)
    if observer is not None:
        observer(start, none)
    for count in range(1, STEP_LIMIT):
        before = state
        state, force = marcher.step(before)
        if not np.isfinite(state.drive).all():
            raise ComputationError(
                f"the motion is not finite at t = {state.t_s:.6g} s; shorten the ITS"
            )
        loss += step_loss(marcher, before, state)
        defect += marcher.step_defect(before, state, force)
        total = float(weights @ force)
        impulse += marcher.its_s * total
        now = observe(marcher, state, force, history)
        peak = max(peak, now)
        if observer is not None:
            observer(state, force)
        if total > 0.0:
            release = _release_time(before, state)
        free = total == 0.0 or (now == 0.0 and not marcher.rigid_multiplier)
        done = free and state.t_s >= wait_s and _leaving(marcher, state)
        if done or state.t_s >= until_s:
            depth, when = _deepest(np.array(history.rows[first_row:]))
            return Touch(
                start_s=start.t_s,
                release_s=release,
                state=state,
                peak_force_N=peak,
                impulse_N_s=impulse,
                max_penetration_m=depth,
                max_penetration_s=when - start.t_s,
                material_loss_J=loss,
                defect=defect,
                n_steps=count,
            )
    raise ComputationError(f"still in contact after {STEP_LIMIT} steps of {marcher.its_s:g} s")


def _leaving(marcher: Marcher, state: State) -> bool:
    """Whether every point is clear, or on its way to be.

    A rigid plane under a multiplier has points that rest on it without a push.
    """
    if not marcher.rigid_multiplier:
        return bool(state.drive.max() <= 0.0)
    contact = marcher.body.contact
    return bool(np.all((contact.heights(state.u) > 0.0) | (contact.heights(state.v) > 0.0)))


def _release_time(before: State, after: State) -> float:
    """The end of a step with contact, or the instant in it at which its drive falls to zero."""
    first, last = float(before.drive.max()), float(after.drive.max())
    if last >= 0.0 or first <= last:
        return after.t_s
    share = max(first, 0.0) / (first - last)
    return before.t_s + share * (after.t_s - before.t_s)


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
