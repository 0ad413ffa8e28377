"""One drop: free fall, impact after impact, exact flight between them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from .bodies.base import Array, Body
from .bodies.modal import ModalBody
from .checkpoint import Checkpoint
from .contact.enforcement import ContactMethod
from .energy import Budget, Energy, flight_energy
from .errors import ComputationError
from .fall import dragged_fall, dragged_path, free_fall, risen
from .ground import Ground, just_touched, place
from .impact import march_touch
from .rigid import Pose, leaning
from .time.flight import Flight, flyer
from .time.march import Marcher
from .time.scheme import TimeScheme
from .touch import History, Observer, Touch

TOUCH_LIMIT = 10_000
# A touch so few steps away is marched to, not flown to: it costs little, and the full order, which
# holds more than the modes that it flies in, loses nothing.
WAIT_STEPS = 100
# Largest error bound of a reduced body, in units of the impact speed, that is let through. It is a
# sum of norms over all steps: with little damping the true error is a thousandth of it or less.
REDUCTION_LIMIT = 0.1
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

    The bristle leans by ``tilt_deg`` toward its thin side and ``tilt_wide_deg`` toward its wide
    one, over ``ground`` (None: a horizontal plane), and falls ``height_m`` before a point of its
    tip
    touches. ``until_s`` is a time after release, or None to end after the first rebound;
    ``impact_only`` ends at the last release of the first impact. ``release_speed_m_s`` is the
    downward speed at the start, ``drag_kg_m`` the air's drag over the square of the speed: exact in
    the fall, and in the rebound of a bristle that does not turn.
    """

    height_m: float
    method: ContactMethod
    its_s: float
    gravity_m_s2: float
    scheme: TimeScheme = field(default_factory=TimeScheme.average)
    until_s: float | None = None
    impact_only: bool = False
    tilt_deg: float = 0.0
    tilt_wide_deg: float = 0.0
    ground: Ground | None = None
    release_speed_m_s: float = 0.0
    drag_kg_m: float = 0.0


@dataclass
class DropResult:
    """What a drop gave; names and units as in result.json.

    ``rebound_height_m`` is the greatest height of the lower tip's middle over where it first
    touched, ``cm_rebound_height_m`` that of the centre of mass over where it was then, both before
    the second impact. ``velocity_after_m_s`` (3,) of the centre of mass and ``spin_after_rad_s``
    (3,), about body axes, are those after the last release of the first impact.
    ``friction_impulse_N_s`` is the size of the impulse across the normal one. ``reduction_error``
    bounds what a reduced body got wrong against the full order by the end of
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
    cm_rebound_height_m: float | None
    velocity_after_m_s: tuple[float, ...]
    spin_after_rad_s: tuple[float, ...]
    friction_impulse_N_s: float
    reduction_error: float | None = None


@dataclass
class Impact:
    """The touches of one impact, and the flight that follows it.

    ``top_m`` and ``centre_top_m`` are the greatest heights of the tip and of the centre of mass
    between its touches.
    """

    touches: list[Touch]
    flight: Flight
    energy_after: Energy
    next_touch_s: float
    material_loss_J: float
    friction_loss_J: float
    contact_loss_J: float
    n_steps: int
    top_m: float
    centre_top_m: float

    @property
    def release_s(self) -> float:
        return self.touches[-1].release_s


def _fall(plan: DropPlan, body: Body) -> tuple[float, float]:
    if not (plan.release_speed_m_s or plan.drag_kg_m):
        return free_fall(plan.height_m, plan.gravity_m_s2, body.alpha_1_s)
    if body.alpha_1_s:
        raise ComputationError("alpha damping excludes air drag and a speed at release")
    drag = plan.drag_kg_m / body.mass_kg
    return dragged_fall(plan.height_m, plan.gravity_m_s2, plan.release_speed_m_s, drag)


def simulate(
    frame: FlightFrame,
    plan: DropPlan,
    marcher: Marcher | None = None,
    observer: Observer | None = None,
    checkpoint: Checkpoint | None = None,
) -> DropResult:
    """Simulate a drop: contact is marched, flight is exact.

    ``marcher`` may be handed in to share factors between drops; it must be made for the plan.
    ``observer`` sees every marched state. What is marched step by step goes on from
    ``checkpoint``. Raises ComputationError.
    """
    body, g = frame.body, plan.gravity_m_s2
    marcher = marcher or Marcher(body, plan.method, plan.scheme, plan.its_s, g)
    stage = Stage(frame, marcher, plan, observer, checkpoint)
    history = stage.history
    fall_s, speed = _fall(plan, body)
    initial = body.mass_kg * (g * plan.height_m + 0.5 * plan.release_speed_m_s**2)
    lossy = body.alpha_1_s or plan.drag_kg_m
    loss = initial - 0.5 * body.mass_kg * speed**2 if lossy else 0.0
    rubbed = spent = 0.0
    _record_fall(history, plan, fall_s, body)
    end_s = stage.end_s
    if end_s <= fall_s:
        raise ComputationError(f"the drop ends at {end_s:g} s, before it touches at {fall_s:g} s")

    t, pose = fall_s, stage.first_pose
    u: Array = np.zeros(len(body.translation))
    v: Array = body.translation @ (-speed * pose.rotation[2])
    impacts: list[Impact] = []
    rebound: float | None = None
    centre_rebound: float | None = None
    while True:
        impact = stage.impact(t, pose, u, v)
        impacts.append(impact)
        loss += impact.material_loss_J
        rubbed += impact.friction_loss_J
        spent += impact.contact_loss_J
        now = impact.energy_after
        if plan.impact_only:
            break
        flight = impact.flight
        stop = max(min(impact.next_touch_s, end_s), flight.t0_s)
        if len(impacts) == 1:
            top = flight.apex(impact.next_touch_s)[1] - stage.datum_m
            rebound = max(top, impact.top_m)
            centre_rebound = max(_centre_top(flight, impact.next_touch_s), impact.centre_top_m)
            rebound, centre_rebound = (
                float(risen(height, plan.drag_kg_m / body.mass_kg))
                for height in (rebound, centre_rebound)
            )
        _record_flight(history, flight, impact.touches[-1].release_s, stop, stage)
        after = flight_energy(flight, stop)
        if frame.modal.damping_1_s.any():
            loss += now.total_J - now.contact_J - after.total_J
        now = replace(after, contact_J=now.contact_J)
        if plan.until_s is None or stop >= end_s:
            break
        pose, q, qv = flight.state(stop)
        t, u, v = stop, frame.from_modal(q), frame.from_modal(qv)
    first = impacts[0]
    touches = first.touches
    deepest = max(touches, key=lambda touch: touch.max_penetration_m)
    velocity = first.flight.centre(first.release_s)[1]
    return DropResult(
        impact_speed_m_s=speed,
        rebound_ratio=None if rebound is None else rebound / plan.height_m,
        rebound_height_m=rebound,
        contact_time_s=first.release_s - touches[0].start_s,
        n_contacts=len(touches),
        peak_force_N=max(touch.peak_force_N for touch in touches),
        impulse_N_s=sum(touch.impulse_N_s for touch in touches),
        max_penetration_m=deepest.max_penetration_m,
        time_to_max_penetration_s=deepest.start_s + deepest.max_penetration_s - touches[0].start_s,
        cm_velocity_after_m_s=float(velocity[2]),
        n_dofs=body.n_dofs,
        n_steps=sum(impact.n_steps for impact in impacts),
        energy=Budget.close(initial, now, loss, rubbed, spent),
        history=history,
        cm_rebound_height_m=centre_rebound,
        velocity_after_m_s=tuple(map(float, velocity)),
        spin_after_rad_s=tuple(map(float, first.flight.turned(first.release_s)[1])),
        friction_impulse_N_s=sum(_across(touch) for touch in touches),
        reduction_error=_reduction_error(body, first, speed),
    )


def _across(touch: Touch) -> float:
    """Size of a touch's impulse beyond the normal one."""
    return math.sqrt(max(float(touch.push_N_s @ touch.push_N_s) - touch.impulse_N_s**2, 0.0))


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


def _centre_top(flight: Flight, until_s: float) -> float:
    """Greatest height of the centre of mass in a flight up to ``until_s``."""
    speed, g, alpha = (
        flight.centre_velocity(flight.t0_s),
        flight.gravity_m_s2,
        flight.body.alpha_1_s,
    )
    rise = 0.0
    if speed > 0.0:
        rise = speed / g if alpha == 0.0 else math.log1p(alpha * speed / g) / alpha
    return float(flight.centre(min(flight.t0_s + rise, until_s))[0][2])


def slowest_period_s(body: ModalBody) -> float:
    """Period of the slowest elastic mode; zero where the body is rigid."""
    elastic = body.omega2[body.omega2 > 0.0]
    return float(2.0 * math.pi / math.sqrt(elastic.min())) if len(elastic) else 0.0


class Stage:
    """A body over its ground: what the impacts of one drop share."""

    def __init__(
        self,
        frame: FlightFrame,
        marcher: Marcher,
        plan: DropPlan,
        observer: Observer | None = None,
        checkpoint: Checkpoint | None = None,
    ) -> None:
        self.frame, self.marcher, self.plan = frame, marcher, plan
        self.observer, self.checkpoint = observer, checkpoint
        self.history = History()
        self.end_s = math.inf if plan.until_s is None else plan.until_s
        points = frame.body.contact
        attitude = leaning(plan.tilt_deg, plan.tilt_wide_deg)
        self.first_pose = Pose(np.zeros(3), attitude)
        ground = plan.ground or Ground.plane(len(points.weights))
        self.ground = just_touched(ground, self.first_pose, points)
        self.datum_m = place(self.ground, self.first_pose, points).tip_m
        self._flyer = flyer(frame.modal, marcher.tau)
        self._slowest_s = slowest_period_s(frame.modal)

    def impact(self, t: float, pose: Pose, u: Array, v: Array) -> Impact:
        """Touch after touch, until the centre of mass has turned to fall before the next one, or
        falls on and the tip does not come back while the bristle swings once.

        A tip that rings down onto the plane while the centre of mass still rises belongs to the
        same impact.
        """
        frame, g, its = self.frame, self.plan.gravity_m_s2, self.plan.its_s
        damped = bool(frame.modal.damping_1_s.any())
        touches: list[Touch] = []
        loss, top, centre_top = 0.0, -math.inf, -math.inf
        wait = t
        self._place(pose)
        for _ in range(TOUCH_LIMIT):
            touch = march_touch(
                self.marcher,
                t,
                u,
                v,
                self.history,
                self.observer,
                self.end_s,
                wait,
                self.checkpoint,
            )
            touches.append(touch)
            loss += touch.material_loss_J
            released = touch.end_s
            q, qv = frame.to_modal(touch.u), frame.to_modal(touch.v)
            flight = Flight(frame.modal, pose, released, q, qv, g, self._flyer)
            rising = flight.centre_velocity(released)
            ringing = flight.ringing_m()
            longest = released + 2.0 * max(rising, 0.0) / g + math.sqrt(8.0 * ringing / g) + 1e-3
            longest += 2.0 * self._swing_s(flight)
            again = flight.next_touch(self.ground, longest)
            landing = longest if again is None else again
            # a centre that falls on is done when the bristle has had time to ring and not come back
            turned = rising > 0.0 and flight.centre_velocity(landing) <= 0.0
            gone = rising <= 0.0 and landing - released > self._slowest_s
            if landing >= self.end_s or turned or gone:
                break
            if landing - released < WAIT_STEPS * its:
                t, u, v, wait = released, touch.u, touch.v, landing
                continue
            top = max(top, flight.apex(landing)[1] - self.datum_m)
            centre_top = max(centre_top, _centre_top(flight, landing))
            energy = flight_energy(flight, released).total_J
            if damped:
                loss += energy - flight_energy(flight, landing).total_J
            pose, q, qv = flight.state(landing)
            t, u, v, wait = landing, frame.from_modal(q), frame.from_modal(qv), landing
            self._place(pose)
        else:
            raise ComputationError(
                f"more than {TOUCH_LIMIT} touches in one impact; shorten the ITS"
            )
        return Impact(
            touches=[touch for touch in touches if touch.impulse_N_s != 0.0],
            flight=flight,
            energy_after=replace(flight_energy(flight, released), contact_J=touch.contact_J),
            next_touch_s=landing,
            material_loss_J=loss,
            friction_loss_J=sum(touch.friction_loss_J for touch in touches),
            contact_loss_J=sum(touch.contact_loss_J for touch in touches),
            n_steps=sum(touch.n_steps for touch in touches),
            top_m=top,
            centre_top_m=centre_top,
        )

    def _place(self, pose: Pose) -> None:
        self.marcher.place(place(self.ground, pose, self.frame.body.contact, self.datum_m))

    def _swing_s(self, flight: Flight) -> float:
        """How long the tip can stay up because the bristle turns: a touch is sure to come then."""
        far = float(np.abs(flight.motion.places[:, 2]).max())
        return math.sqrt(8.0 * far / flight.gravity_m_s2)


def _record_fall(history: History, plan: DropPlan, fall_s: float, body: Body) -> None:
    alpha, g, v0 = body.alpha_1_s, plan.gravity_m_s2, plan.release_speed_m_s
    drag = plan.drag_kg_m / body.mass_kg
    for t in np.linspace(0.0, fall_s, FLIGHT_ROWS, endpoint=False):
        if alpha:
            fallen = g * (t + math.expm1(-alpha * t) / alpha) / alpha
        elif drag:
            fallen = dragged_path(float(t), g, v0, drag)
        else:
            fallen = v0 * t + 0.5 * g * t * t
        height = plan.height_m - fallen
        history.rows.append((float(t), height, height, 0.0, 0.0))


def _record_flight(
    history: History, flight: Flight, start_s: float, stop_s: float, stage: Stage
) -> None:
    """Tip and centre of mass at equal times; the marched step in which it was released stays."""
    start_s = max(start_s, history.rows[-1][0])
    times = np.linspace(start_s, stop_s, FLIGHT_ROWS + 1)[1:]
    heights = flight.trace(stage.ground, times)
    tip, centre, clear = heights.T
    rows = [times, tip - stage.datum_m, centre, 0.0 * times, np.maximum(-clear, 0.0)]
    history.rows.extend(tuple(map(float, row)) for row in np.stack(rows, axis=1))
