"""One contact phase of any body in time steps, with checkpoints, and its record."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from .arrays import Array
from .checkpoint import Checkpoint, Mark, prefixed, under
from .energy import contact_energy_J
from .errors import ComputationError
from .time.march import ContactMarch, Moving

HISTORY_COLUMNS = ("t_s", "tip_y_m", "cm_y_m", "force_N", "penetration_m")
STEP_LIMIT = 2_000_000
# A tip held by adhesion, or without the speed to leave its indentation, may stay in contact. Then
# the step limit is divided by this.
STAYING = 100


@dataclass
class History:
    """Course of a drop over time: rows of ``HISTORY_COLUMNS``."""

    rows: list[tuple[float, ...]] = field(default_factory=list)

    def extend(self, rows: Array) -> None:
        """Append rows (times, 5) in the order of HISTORY_COLUMNS."""
        self.rows.extend(tuple(map(float, row)) for row in rows)

    def array(self) -> Array:
        """All rows (times, 5) in the order of HISTORY_COLUMNS."""
        return np.array(self.rows).reshape(-1, len(HISTORY_COLUMNS))


@dataclass
class ContactSums:
    """Sums over a touch; ``released`` says that the tip is free again.

    ``peak_force_N`` is the greatest value at the ends of steps, ``push_N_s`` (3,) the impulse along
    body axes, friction included.
    """

    release_s: float
    released: bool = False
    peak_force_N: float = 0.0
    impulse_N_s: float = 0.0
    push_N_s: Array = field(default_factory=lambda: np.zeros(3))
    material_loss_J: float = 0.0
    friction_loss_J: float = 0.0
    contact_loss_J: float = 0.0


@dataclass(kw_only=True)
class ContactPhase(ContactSums):
    """One touch: its start and end, forces, losses and final state.

    ``max_penetration_m`` is the greatest value at the ends of steps, refined by a parabola through
    its neighbours, and ``max_penetration_s`` its time since the start. ``u`` and ``v`` are the
    first state after release. If the march ended earlier, ``contact_J`` is the energy still stored
    in contact. ``memory`` (n,) is the law's state at the points.
    """

    start_s: float
    end_s: float
    u: Array
    v: Array
    max_penetration_m: float
    max_penetration_s: float
    contact_J: float
    n_steps: int
    memory: Array

    @classmethod
    def ended(
        cls, marcher: ContactMarch, sums: ContactSums, rows: Array, state: Moving
    ) -> ContactPhase:
        """The touch of a march that ended in ``state``; ``rows`` (steps + 1, 5) are its history."""
        start_s, (depth, when) = float(rows[0, 0]), deepest(rows)
        return cls(
            **vars(sums),
            start_s=start_s,
            end_s=state.t_s,
            u=state.u,
            v=state.v,
            max_penetration_m=depth,
            max_penetration_s=when - start_s,
            contact_J=contact_energy_J(marcher, state),
            n_steps=len(rows) - 1,
            memory=marcher.contact.memory[:, 2].copy(),
        )


class Observer(Protocol):
    """Callback with every state of a march, and the step's forces (n, 3) along the points' frames.

    The other methods are called only with checkpoints, see solver.checkpoint.
    """

    def __call__(self, state: Moving, step_force: Array) -> None: ...

    def memory(self) -> dict[str, Array]:
        """The observer's state for a checkpoint."""
        ...

    def recall(self, mark: Mark, state: Moving) -> None:
        """Restore the observer's state from ``mark``; the march is at ``state``."""
        ...


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
    """`impact.march_contact` in steps of the marcher."""
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
    return ContactPhase.ended(marcher, sums, np.array(history.rows[first_row:]), state)


def _step(
    marcher: ContactMarch,
    before: Moving,
    sums: ContactSums,
    history: History,
    observer: Observer | None,
    wait_s: float,
) -> Moving:
    """The state after a step from ``before``; adds to ``sums`` and ``history``."""
    weights = marcher.body.contact.weights
    step = marcher.step(before)
    state, force, total = step.state, step.force, step.mean_N
    if not np.isfinite(state.approach).all():
        raise not_finite(state.t_s)
    now = observe(marcher, state, force, history)
    if observer is not None:
        observer(state, force)
    sums.contact_loss_J += step.contact_loss_J
    sums.material_loss_J += marcher.damping_loss_J(before, state, force)
    sums.friction_loss_J += step.friction_loss_J
    sums.impulse_N_s += marcher.its_s * total
    sums.push_N_s = sums.push_N_s + marcher.its_s * (weights @ marcher.along_axes(force))
    sums.peak_force_N = max(sums.peak_force_N, now)
    if total > 0.0 or (total < 0.0 and marcher.method.law.pulls):
        sums.release_s = before.t_s + step.share * (state.t_s - before.t_s)
    free = total == 0.0 or step.final_N == 0.0
    sums.released = free and state.t_s >= wait_s and _leaving(marcher, state)
    if sums.released:
        sums.friction_loss_J += marcher.contact.let_go()
    return state


def _leaving(marcher: ContactMarch, state: Moving) -> bool:
    """Whether every point is clear or about to be, and none is held.

    On a rigid plane under a multiplier, points may rest on it without a force.
    """
    if not marcher.rigid_multiplier:
        return bool(state.approach[:, 0].max() <= 0.0) and not marcher.contact.holds()
    rising = marcher.gaps(state.v) - marcher.ground.gaps_m
    return bool(np.all((marcher.gaps(state.u) > 0.0) | (rising > 0.0)))


def _kept(
    marcher: ContactMarch, state: Moving, sums: ContactSums, rows: Array, observer: Observer | None
) -> dict[str, Array]:
    """All data that the next step, and the record of the touch, will need."""
    return {
        **kept_state(marcher, state),
        **prefixed("sums", vars(sums)),
        **prefixed("observer", observer.memory() if observer is not None else {}),
        "rows": rows,
    }


def _recalled(mark: Mark, marcher: ContactMarch, history: History) -> tuple[ContactSums, Moving]:
    """The data given to `_kept`; the rows are put back into ``history``."""
    history.extend(mark.arrays["rows"])
    sums = ContactSums(0.0)
    for name, value in under("sums", mark.arrays):
        setattr(sums, name, value.copy() if value.ndim else value.item())
    return sums, recalled_state(mark, marcher)


def kept_state(marcher: ContactMarch, state: Moving) -> dict[str, Array]:
    """The state and contact's memory, as arrays by name."""
    return {
        **prefixed("state", vars(state)),
        **prefixed("contact", marcher.contact.kept()),
        **prefixed("march", marcher.memory()),
    }


def recalled_state(mark: Mark, marcher: ContactMarch) -> Moving:
    """The state given to `kept_state`; restores contact's memory."""
    marcher.recall(dict(under("march", mark.arrays)))
    marcher.contact.recall(dict(under("contact", mark.arrays)))
    state = dict(under("state", mark.arrays))
    return marcher.state_type(t_s=float(state.pop("t_s")), **state)


def observe(marcher: ContactMarch, state: Moving, step_force: Array, history: History) -> float:
    """Append the state to the history; returns the normal contact force at that instant in N.

    ``step_force`` (n, 3) is that of the last step, along the points' local frames.
    """
    force = float(marcher.body.contact.weights @ instant_force(marcher, state, step_force))
    moved = marcher.body.contact.displacements(state.u)
    deepest = max(-float(marcher.ground.gaps(moved).min()), 0.0)
    history.rows.append((state.t_s, *marcher.heights(state, moved), force, deepest))
    return force


def instant_force(marcher: ContactMarch, state: Moving, step_force: Array) -> Array:
    """Normal force per area share (n,) at a step's end; the mean for rigid planes and dashpots."""
    if marcher.rigid_multiplier or marcher.contact.points.dashpot != 0.0:
        return step_force[:, 0]
    return marcher.normal_force(state.approach)


def step_limit(marcher: ContactMarch, until_s: float) -> int:
    """Number of steps allowed for a touch that is to end before ``until_s``."""
    stays = marcher.method.law.kind.remembers and math.isinf(until_s)
    return STEP_LIMIT // STAYING if stays else STEP_LIMIT


def not_finite(t_s: float) -> ComputationError:
    return ComputationError(f"the motion is not finite at t = {t_s:.6g} s; shorten the ITS")


def too_long(marcher: ContactMarch, limit: int) -> ComputationError:
    found = f"still in contact after {limit} steps of {marcher.its_s:g} s"
    if limit == STEP_LIMIT:
        return ComputationError(found)
    return ComputationError(
        f"{found}; adhesion or its own indentation may hold it for good: end the drop at a time",
        inputs=("until",),
    )


def deepest(rows: Array) -> tuple[float, float]:
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
