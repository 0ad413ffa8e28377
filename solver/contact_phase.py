"""Record of one contact phase, whichever march computes it: history, sums and end state."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from .arrays import Array
from .checkpoint import Mark
from .errors import ComputationError
from .time.march import ContactMarch, Moving

HISTORY_COLUMNS = ("t_s", "tip_y_m", "cm_y_m", "force_N", "penetration_m")
STEP_LIMIT = 2_000_000
# What adhesion holds, or what has no speed to leave its indentation, stays: waiting for its release
# is given up so much sooner.
STAYING = 100


@dataclass
class History:
    """Course of a drop over time: rows of ``HISTORY_COLUMNS``."""

    rows: list[tuple[float, ...]] = field(default_factory=list)

    def extend(self, rows: Array) -> None:
        """Add rows (times, 5) in the order of HISTORY_COLUMNS."""
        self.rows.extend(tuple(map(float, row)) for row in rows)

    def array(self) -> Array:
        """(times, 5) in the order of HISTORY_COLUMNS."""
        return np.array(self.rows).reshape(-1, len(HISTORY_COLUMNS))


@dataclass
class ContactSums:
    """What has come together in a touch; ``released`` says that the tip is free again.

    ``peak_force_N`` is the greatest value at the ends of steps, ``push_N_s`` (3,) the impulse along
    body axes, friction included, ``last_N`` the mean normal force of the latest step.
    """

    release_s: float
    released: bool = False
    peak_force_N: float = 0.0
    impulse_N_s: float = 0.0
    push_N_s: Array = field(default_factory=lambda: np.zeros(3))
    material_loss_J: float = 0.0
    friction_loss_J: float = 0.0
    contact_loss_J: float = 0.0
    last_N: float = 0.0


@dataclass(kw_only=True)
class ContactPhase(ContactSums):
    """One touch: when it began and ended, and what it did.

    ``max_penetration_m`` is the greatest value at the ends of steps, refined by a parabola through
    its neighbours, ``max_penetration_s`` when that was since the start; ``u`` and ``v`` are the
    first state after release. ``contact_J`` is what contact still holds where the march ended
    before that, ``memory`` (n,) what the law remembers of its points.
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


class Observer(Protocol):
    """What sees every marched state, and the step's forces (n, 3) along the points' frames.

    The rest is asked of it only where a march is kept, see solver.checkpoint.
    """

    def __call__(self, state: Moving, step_force: Array) -> None: ...

    def memory(self) -> dict[str, Array]:
        """What it needs to go on."""
        ...

    def recall(self, mark: Mark, state: Moving) -> None:
        """Go on from what ``mark`` kept of it, the march being at ``state``."""
        ...


def observe(marcher: ContactMarch, state: Moving, step_force: Array, history: History) -> float:
    """Append the state to the history; returns the normal contact force at that instant in N.

    ``step_force`` (n, 3) is that of the step before, along the points' local frames.
    """
    force = float(marcher.body.contact.weights @ instant_force(marcher, state, step_force))
    moved = marcher.body.contact.displacements(state.u)
    deepest = max(-float(marcher.ground.gaps(moved).min()), 0.0)
    history.rows.append((state.t_s, *marcher.heights(state, moved), force, deepest))
    return force


def instant_force(marcher: ContactMarch, state: Moving, step_force: Array) -> Array:
    """Normal force per area share (n,) at the end of a step; on a rigid plane, and where a dashpot
    is in it, the step's own mean."""
    if marcher.rigid_multiplier or marcher.contact.points.dashpot != 0.0:
        return step_force[:, 0]
    return marcher.normal_force(state.approach)


def step_limit(marcher: ContactMarch, until_s: float) -> int:
    """How many steps a touch may take that is to end before ``until_s``."""
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
