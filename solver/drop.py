"""One drop: free fall, impact after impact, exact flight between them."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .bodies.base import Array, Body
from .bodies.modal import ModalBody
from .contact.enforcement import ContactMethod
from .energy import Budget, Energy, flight_energy, marching_energy, step_loss
from .errors import ComputationError
from .impact import History, Observer, Touch, march_touch, observe
from .time.flight import Flight, Rows
from .time.march import Marcher
from .time.scheme import TimeScheme

TOUCH_LIMIT = 10_000
# A touch so few steps away is marched to, not flown to: it costs little, and the full order, which
# holds more than the modes that it flies in, loses nothing.
WAIT_STEPS = 100
# Largest error estimate of a reduced body, in units of the impact speed, that is let through.
REDUCTION_LIMIT = 1e-3
FLIGHT_ROWS = 200


class FlightFrame(Protocol):
    """A body together with the modal coordinates in which it flies."""

    @property
    def body(self) -> Body: ...

    @property
    def modal(self) -> ModalBody: ...

    def to_modal(self, x: Array) -> Array:
        """Modal coordinates of the body's vector ``x``."""
        ...

    def from_modal(self, q: Array) -> Array:
        """The body's vector of modal coordinates ``q``."""
        ...


@dataclass(frozen=True)
class ModalFrame:
    """A body that is modal already."""

    modal: ModalBody

    @property
    def body(self) -> ModalBody:
        return self.modal

    def to_modal(self, x: Array) -> Array:
        return x

    def from_modal(self, q: Array) -> Array:
        return q


@dataclass(frozen=True)
class DropPlan:
    """What to simulate: from which height, with which contact, steps and end.

    ``until_s`` is a time after release, or None to end after the first rebound; ``impact_only``
    ends at the last release of the first impact.
    """

    height_m: float
    method: ContactMethod
    its_s: float
    gravity_m_s2: float
    scheme: TimeScheme = field(default_factory=TimeScheme.average)
    until_s: float | None = None
    impact_only: bool = False


@dataclass
class DropResult:
    """What a drop gave; names and units as in result.json.

    ``reduction_error`` bounds what a reduced body got wrong against the full order by the end of
    the first impact, in units of the impact speed; None for bodies that leave nothing out.
    """

    impact_speed_m_s: float
    rebound_ratio: float | None
    rebound_height_m: float | None
    contact_time_s: float
    n_contacts: int
    peak_force_N: float
    impulse_N_s: float
    max_penetration_m: float
    time_to_max_penetration_s: float
    cm_velocity_after_m_s: float
    n_dofs: int
    n_steps: int
    energy: Budget
    history: History
    reduction_error: float | None = None


@dataclass
class Impact:
    """The touches of one impact, and the flight that follows it."""

    touches: list[Touch]
    flight: Flight
    energy_after: Energy
    next_touch_s: float
    material_loss_J: float
    n_steps: int

    @property
    def release_s(self) -> float:
        return self.touches[-1].release_s


def free_fall(height_m: float, gravity_m_s2: float, alpha_1_s: float) -> tuple[float, float]:
    """Time and speed of a rigid fall from rest through ``height_m`` (Eq. 1 where alpha is zero)."""
    if alpha_1_s == 0.0:
        speed = math.sqrt(2.0 * gravity_m_s2 * height_m)
        return speed / gravity_m_s2, speed
    from scipy.optimize import brentq

    def fallen(t: float) -> float:
        return gravity_m_s2 * (t + math.expm1(-alpha_1_s * t) / alpha_1_s) / alpha_1_s - height_m

    late = math.sqrt(2.0 * height_m / gravity_m_s2) + 2.0 * height_m * alpha_1_s / gravity_m_s2
    t = float(brentq(fallen, 0.0, 2.0 * late, xtol=1e-16))
    return t, -gravity_m_s2 * math.expm1(-alpha_1_s * t) / alpha_1_s


def simulate(
    frame: FlightFrame,
    plan: DropPlan,
    marcher: Marcher | None = None,
    observer: Observer | None = None,
) -> DropResult:
    """One drop by events: exact flight between impacts, only the impacts are marched.

    ``marcher`` may be one made before for the same body, contact, scheme, ITS and gravity (its
    factor is then used again). Raises ComputationError where a step does not converge.
    """
    body, g = frame.body, plan.gravity_m_s2
    marcher = marcher or Marcher(body, plan.method, plan.scheme, plan.its_s, g)
    history = History()
    fall_s, speed = free_fall(plan.height_m, g, body.alpha_1_s)
    initial = body.mass_kg * g * plan.height_m
    loss = initial - 0.5 * body.mass_kg * speed**2 if body.alpha_1_s else 0.0
    _record_fall(history, plan, fall_s, body.alpha_1_s)

    t = fall_s
    u: Array = np.zeros_like(body.lift)
    v: Array = -speed * body.lift
    end_s = math.inf if plan.until_s is None else plan.until_s
    if end_s <= fall_s:
        raise ComputationError(f"the drop ends at {end_s:g} s, before it touches at {fall_s:g} s")
    impacts: list[Impact] = []
    rebound: float | None = None
    while True:
        impact = _impact(frame, marcher, plan, history, t, u, v, observer, end_s)
        impacts.append(impact)
        loss += impact.material_loss_J
        now = impact.energy_after
        if plan.impact_only:
            break
        flight = impact.flight
        stop = min(impact.next_touch_s, end_s)
        if len(impacts) == 1:
            tip = frame.modal.contact.weights @ frame.modal.contact.normal
            rebound = flight.apex(tip, impact.next_touch_s)[1]
        _record_flight(history, frame.modal, flight, impact.release_s, stop)
        q, qv = flight.state(stop)
        after = flight_energy(frame.modal, q, qv, g)
        if body.alpha_1_s or body.beta_s:
            loss += now.total_J - after.total_J
        now = after
        if plan.until_s is None or stop >= end_s:
            break
        t, u, v = stop, frame.from_modal(q), frame.from_modal(qv)
    first = impacts[0]
    depths = [(touch.max_penetration_m, touch) for touch in first.touches]
    deepest = max(depths, key=lambda item: item[0])[1]
    return DropResult(
        impact_speed_m_s=speed,
        rebound_ratio=None if rebound is None else rebound / plan.height_m,
        rebound_height_m=rebound,
        contact_time_s=first.release_s - first.touches[0].start_s,
        n_contacts=len(first.touches),
        peak_force_N=max(touch.peak_force_N for touch in first.touches),
        impulse_N_s=sum(touch.impulse_N_s for touch in first.touches),
        max_penetration_m=deepest.max_penetration_m,
        time_to_max_penetration_s=deepest.start_s
        + deepest.max_penetration_s
        - first.touches[0].start_s,
        cm_velocity_after_m_s=first.flight.centre_velocity(first.release_s),
        n_dofs=body.n_dofs,
        n_steps=sum(impact.n_steps for impact in impacts),
        energy=Budget.close(initial, now, loss),
        history=history,
        reduction_error=_reduction_error(body, first, speed),
    )


def _reduction_error(body: Body, impact: Impact, speed_m_s: float) -> float | None:
    """The estimate of a reduced body; ComputationError where it is too large to trust."""
    if body.defect is None:
        return None
    error = sum(touch.defect for touch in impact.touches) / (math.sqrt(body.mass_kg) * speed_m_s)
    if error > REDUCTION_LIMIT:
        raise ComputationError(
            f"the reduced body may be off by {error:.2g} of the impact speed, more than "
            f"{REDUCTION_LIMIT:g}: give it more modes, or take the solid itself"
        )
    return error


def _impact(
    frame: FlightFrame,
    marcher: Marcher,
    plan: DropPlan,
    history: History,
    t: float,
    u: Array,
    v: Array,
    observer: Observer | None,
    end_s: float,
) -> Impact:
    """Touch after touch, until the centre of mass has turned to fall again before the next one.

    A tip that rings down onto the plane while the centre of mass still rises belongs to the same
    impact.
    """
    rows = _clearance(marcher, frame.modal)
    g = plan.gravity_m_s2
    damped = bool(marcher.body.alpha_1_s or marcher.body.beta_s)
    touches: list[Touch] = []
    loss = 0.0
    start, wait = marcher.start(t, u, v), 0.0
    for _ in range(TOUCH_LIMIT):
        touch = march_touch(marcher, start, history, observer, end_s, wait)
        touches.append(touch)
        loss += touch.material_loss_J
        state = touch.state
        q, qv = frame.to_modal(state.u), frame.to_modal(state.v)
        flight = Flight(frame.modal, state.t_s, q, qv, g)
        rising = flight.centre_velocity(state.t_s)
        ringing = float(flight.ringing(rows, np.array([state.t_s]))[0])
        longest = state.t_s + 2.0 * max(rising, 0.0) / g + math.sqrt(8.0 * ringing / g) + 1e-3
        again = flight.next_touch(rows, longest)
        landing = longest if again is None else again
        if landing >= end_s or (rising > 0.0 and flight.centre_velocity(landing) <= 0.0):
            break
        if landing - state.t_s < WAIT_STEPS * plan.its_s:
            start, wait = state, landing
            continue
        energy = flight_energy(frame.modal, q, qv, g).total_J
        q, qv = flight.state(landing)
        if damped:
            loss += energy - flight_energy(frame.modal, q, qv, g).total_J
        start, wait = marcher.start(landing, frame.from_modal(q), frame.from_modal(qv)), 0.0
    else:
        raise ComputationError(f"more than {TOUCH_LIMIT} touches in one impact; shorten the ITS")
    return Impact(
        touches=[touch for touch in touches if touch.impulse_N_s > 0.0],
        flight=flight,
        energy_after=flight_energy(frame.modal, q, qv, g),
        next_touch_s=landing,
        material_loss_J=loss,
        n_steps=sum(touch.n_steps for touch in touches),
    )


def _clearance(marcher: Marcher, modal: ModalBody) -> Rows:
    """How far each point is from being pushed: minus the drive that contact acts upon."""
    points, tau = modal.contact, marcher.tau
    normal = np.asarray(points.normal)
    if not tau:
        return Rows(normal)
    pressure = tau * np.asarray(points.pressure)
    return Rows(normal - pressure, -modal.beta_s * pressure)


def _record_fall(history: History, plan: DropPlan, fall_s: float, alpha_1_s: float) -> None:
    for t in np.linspace(0.0, fall_s, FLIGHT_ROWS, endpoint=False):
        if alpha_1_s:
            fallen = plan.gravity_m_s2 * (t + math.expm1(-alpha_1_s * t) / alpha_1_s) / alpha_1_s
        else:
            fallen = 0.5 * plan.gravity_m_s2 * t * t
        height = plan.height_m - fallen
        history.rows.append((float(t), height, height, 0.0, 0.0))


def _record_flight(
    history: History, modal: ModalBody, flight: Flight, start_s: float, stop_s: float
) -> None:
    """Tip and centre of mass at equal times; the marched step in which it was released stays."""
    rows = Rows(
        np.vstack([modal.contact.weights @ modal.contact.normal, modal.lift / modal.mass_kg])
    )
    start_s = max(start_s, history.rows[-1][0])
    times = np.linspace(start_s, stop_s, FLIGHT_ROWS + 1)[1:]
    tip, centre = flight.observe(rows, times).T
    table = np.stack([times, tip, centre, 0.0 * times, np.maximum(-tip, 0.0)], axis=1)
    history.rows.extend(tuple(map(float, row)) for row in table)


def _first_impact(active: NDArray[np.intp], velocity: Array) -> tuple[int, int]:
    """Last step of contact of the first impact, and the first of the second (or the end).

    ``active`` (k,) are the steps with contact, ``velocity`` the centre's after each step.
    """
    for end, start in itertools.pairwise(active):
        if start > end + 1 and velocity[end] > 0.0 and velocity[start - 1] <= 0.0:
            return int(end), int(start)
    return int(active[-1]), len(velocity)


def march_plainly(frame: FlightFrame, plan: DropPlan, until_s: float) -> DropResult:
    """The same drop marched at constant ITS from release on, to check ``simulate``."""
    body, g = frame.body, plan.gravity_m_s2
    marcher = Marcher(body, plan.method, plan.scheme, plan.its_s, g)
    history, forces = History(), []
    state = marcher.start(0.0, plan.height_m * body.lift, np.zeros_like(body.lift))
    loss = impulse = 0.0
    velocity = []
    none = np.zeros_like(body.contact.weights)
    observe(marcher, state, none, history)
    for _ in range(math.ceil(until_s / plan.its_s)):
        before = state
        state, force = marcher.step(before)
        loss += step_loss(marcher, before, state)
        observe(marcher, state, force, history)
        forces.append(float(body.contact.weights @ force))
        velocity.append(body.dot(body.lift, state.mv) / body.mass_kg)
    rows, force = history.array(), np.array(forces)
    active = np.flatnonzero(force > 0.0)
    if not len(active):
        raise ComputationError(f"nothing touched within {until_s:g} s")
    last, second = _first_impact(active, np.array(velocity))
    impulse = float(plan.its_s * force[: last + 1].sum())
    rebound = float(rows[last + 1 : second + 1, 1].max(initial=0.0))
    window = rows[active[0] : last + 2]
    deepest = int(np.argmax(window[:, 4]))
    return DropResult(
        impact_speed_m_s=-velocity[max(active[0] - 1, 0)],
        rebound_ratio=rebound / plan.height_m,
        rebound_height_m=rebound,
        contact_time_s=float((last - active[0] + 1) * plan.its_s),
        n_contacts=1 + int(np.sum(np.diff(active[active <= last]) > 1)),
        peak_force_N=float(window[:, 3].max()),
        impulse_N_s=impulse,
        max_penetration_m=float(window[deepest, 4]),
        time_to_max_penetration_s=float(window[deepest, 0] - rows[active[0], 0]),
        cm_velocity_after_m_s=velocity[last],
        n_dofs=body.n_dofs,
        n_steps=len(force),
        energy=Budget.close(
            body.mass_kg * g * plan.height_m, marching_energy(marcher, state), loss
        ),
        history=history,
    )
