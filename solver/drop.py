"""One drop: free fall, impact after impact, exact flight between them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from .arrays import Array
from .bodies.base import Body
from .bodies.modal import ModalBody
from .checkpoint import Checkpoint
from .contact.enforcement import ContactMethod
from .contact_phase import ContactPhase, History, Observer
from .energy import MOST_LEFT, Budget, Energy, flight_energy
from .errors import ComputationError
from .fall import damped_path, dragged_fall, dragged_path, free_fall, risen
from .ground import Ground, just_touched, place
from .impact import march_contact
from .rigid import Pose, leaning, product, quaternion_of
from .time.flight import Flight, charted
from .time.march import ContactMarch, Marcher
from .time.scheme import TimeScheme

TOUCH_LIMIT = 10_000
# A touch so few steps away is marched to, not flown to: it costs little, and the full order, which
# holds more than the modes that it flies in, loses nothing.
WAIT_STEPS = 100
# What an estimate of a reduced body's error resolves, in units of the impact speed: bodies that are
# compared share the responses of the tip, which are exact at one shift only.
RESOLVED = 1e-6
# Intervals of an impact in which the speeds of reduced bodies are compared.
COMPARED = 64
# Of a step from one reduced body to a finer one over the step before it: taken as at most this.
LARGEST_RATIO = 0.9
FLIGHT_ROWS = 200


class FlightFrame(Protocol):
    """A body together with the modal coordinates in which it flies."""

    @property
    def body(self) -> Body: ...

    @property
    def modal(self) -> ModalBody: ...

    def launched(self, pose: Pose, u: Array, v: Array) -> tuple[Pose, Array, Array]:
        """The pose in which the body flies off, and displacement and velocity in modes on top of
        it, from its own vectors in ``pose``."""
        ...

    def landed(self, q: Array, qv: Array) -> tuple[Array, Array]:
        """The body's own vectors of displacement and velocity in modes."""
        ...


@dataclass(frozen=True)
class ModalFrame:
    """A body that is modal already; ``coarser`` ones, from few modes on, tell how far it is off."""

    modal: ModalBody
    coarser: tuple[ModalBody, ...] = ()

    @property
    def body(self) -> ModalBody:
        return self.modal

    def launched(self, pose: Pose, u: Array, v: Array) -> tuple[Pose, Array, Array]:
        return pose, u, v

    def landed(self, q: Array, qv: Array) -> tuple[Array, Array]:
        return q, qv


@dataclass(frozen=True)
class DropPlan:
    """What to simulate: from which height, with which contact, steps and end.

    The bristle leans by ``tilt_deg`` toward its thin side and ``tilt_wide_deg`` toward its wide
    one, over ``ground`` (None: a horizontal plane), and falls ``height_m`` before a point of its
    tip touches. Upright, the body's axes are the columns of ``axes`` (3, 3) in the world (None: the
    world's own). ``until_s`` is a time after release, or None to end after the first rebound;
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
    axes: Array | None = None


@dataclass
class DropResult:
    """What a drop gave; names and units as in result.json.

    ``rebound_height_m`` is the greatest height of the lower tip's middle over where it first
    touched, ``cm_rebound_height_m`` that of the centre of mass over where it was then, both before
    the second impact. ``velocity_after_m_s`` (3,) of the centre of mass and ``spin_after_rad_s``
    (3,), about body axes, are those after the last release of the first impact. Heights are None
    where the drop ends before the rebound has been seen to its top or to the second impact; the
    time in contact and what follows it are NaN where it ends within the first impact.
    ``friction_impulse_N_s`` is the size of the impulse across the normal one. ``reduction_error``
    estimates what a reduced body got wrong against the full order by the end of the first impact,
    in units of the impact speed; None for bodies that leave nothing out.
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
    between its touches. ``ended`` says that no touch of it was to come when the drop ended.
    """

    touches: list[ContactPhase]
    flight: Flight
    energy_after: Energy
    next_touch_s: float
    material_loss_J: float
    friction_loss_J: float
    contact_loss_J: float
    n_steps: int
    top_m: float
    centre_top_m: float
    ended: bool

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
    marcher: ContactMarch | None = None,
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
    initial = stage.initial_J
    slowed = initial - 0.5 * body.mass_kg * speed**2
    loss, dragged = slowed if body.alpha_1_s else 0.0, slowed if plan.drag_kg_m else 0.0
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
            rebound, centre_rebound = stage.rebound(impact)
        _record_flight(history, flight, impact.touches[-1].release_s, stop, stage)
        after = flight_energy(flight, stop)
        if frame.modal.damping_1_s.any():
            loss += now.total_J - now.contact_J - after.total_J
        now = replace(after, contact_J=now.contact_J)
        if plan.until_s is None or stop >= end_s:
            break
        pose, q, qv = flight.state(stop)
        t, (u, v) = stop, frame.landed(q, qv)
    first = impacts[0]
    touches = first.touches
    deepest = max(touches, key=lambda touch: touch.max_penetration_m)
    contact_s = math.nan
    velocity: Array = np.full(3, math.nan)
    spin: Array = np.full(3, math.nan)
    if first.ended:
        contact_s = first.release_s - touches[0].start_s
        velocity = first.flight.centre(first.release_s)[1]
        spin = first.flight.turned(first.release_s)[1]
    found = DropResult(
        impact_speed_m_s=speed,
        rebound_ratio=None if rebound is None else rebound / plan.height_m,
        rebound_height_m=rebound,
        contact_time_s=contact_s,
        n_contacts=len(touches),
        peak_force_N=max(touch.peak_force_N for touch in touches),
        impulse_N_s=sum(touch.impulse_N_s for touch in touches),
        max_penetration_m=deepest.max_penetration_m,
        time_to_max_penetration_s=deepest.start_s + deepest.max_penetration_s - touches[0].start_s,
        cm_velocity_after_m_s=float(velocity[2]),
        n_dofs=body.n_dofs,
        n_steps=sum(impact.n_steps for impact in impacts),
        energy=Budget.close(initial, now, loss, rubbed, spent, dragged),
        history=history,
        cm_rebound_height_m=centre_rebound,
        velocity_after_m_s=tuple(map(float, velocity)),
        spin_after_rad_s=tuple(map(float, spin)),
        friction_impulse_N_s=sum(_across(touch) for touch in touches),
    )
    return replace(found, reduction_error=_reduction_error(frame, plan, found))


def _reduction_error(frame: FlightFrame, plan: DropPlan, found: DropResult) -> float | None:
    """About how far the velocities of the impact are from the full order's, for a reduced body.

    In units of the impact speed, a spin counting by its energy. Bodies are compared by the motion
    after the impact and by the speed of the centre of mass all through it, since a single number
    may agree by chance. Steps from body to finer body are taken to go on as a geometric series with
    the ratio of the last two, at most `LARGEST_RATIO`.
    """
    if not isinstance(frame, ModalFrame) or not frame.coarser or math.isnan(found.contact_time_s):
        return None
    gyration = np.sqrt(frame.modal.inertia_kg_m2 / frame.body.mass_kg)
    first = replace(plan, impact_only=True, until_s=None)
    try:
        drops = [*(simulate(ModalFrame(body), first) for body in frame.coarser), found]
    except ComputationError:
        return math.inf
    start_s = _fall(plan, frame.body)[0]
    end_s = start_s + min(each.contact_time_s for each in drops)
    times = np.linspace(start_s, end_s, COMPARED + 1)
    after = np.diff([_motion_after(each, gyration) for each in drops], axis=0)
    during = np.diff([_centre_speeds(each, times) for each in drops], axis=0)
    sizes = np.maximum(np.linalg.norm(after, axis=1), np.abs(during).max(axis=1))
    sizes /= found.impact_speed_m_s
    ratio = min(LARGEST_RATIO, sizes[-1] / sizes[-2]) if sizes[-2] > 0.0 else LARGEST_RATIO
    return max(RESOLVED, float(sizes[-1] * ratio / (1.0 - ratio)))


def _centre_speeds(found: DropResult, times: Array) -> Array:
    """Mean speeds (n - 1,) of the centre of mass, upward, between ``times`` (n,)."""
    rows = found.history.array()
    return np.diff(np.interp(times, rows[:, 0], rows[:, 2])) / np.diff(times)


def _motion_after(found: DropResult, gyration_m: Array) -> Array:
    """Velocity and spin (6,) after the first impact, in m/s."""
    spin = gyration_m * np.array(found.spin_after_rad_s)
    return np.concatenate([found.velocity_after_m_s, spin])


def _across(touch: ContactPhase) -> float:
    """Size of a touch's impulse beyond the normal one."""
    return math.sqrt(max(float(touch.push_N_s @ touch.push_N_s) - touch.impulse_N_s**2, 0.0))


def slowest_period_s(body: ModalBody) -> float:
    """Period of the slowest elastic mode; zero where the body is rigid."""
    elastic = body.omega2[body.omega2 > 0.0]
    return float(2.0 * math.pi / math.sqrt(elastic.min())) if len(elastic) else 0.0


class Stage:
    """A body over its ground: what the impacts of one drop share."""

    def __init__(
        self,
        frame: FlightFrame,
        marcher: ContactMarch,
        plan: DropPlan,
        observer: Observer | None = None,
        checkpoint: Checkpoint | None = None,
    ) -> None:
        self.frame, self.marcher, self.plan = frame, marcher, plan
        self.observer, self.checkpoint = observer, checkpoint
        self.history = History()
        self.end_s = math.inf if plan.until_s is None else plan.until_s
        self.initial_J = frame.body.mass_kg * (
            plan.gravity_m_s2 * plan.height_m + 0.5 * plan.release_speed_m_s**2
        )
        points = frame.body.contact
        attitude = leaning(plan.tilt_deg, plan.tilt_wide_deg)
        if plan.axes is not None:
            attitude = product(attitude, quaternion_of(plan.axes))
        self.first_pose = Pose(np.zeros(3), attitude)
        ground = plan.ground or Ground.plane(len(points.weights))
        self.ground = just_touched(ground, self.first_pose, points)
        self.datum_m = place(self.ground, self.first_pose, points).tip_m
        self._charted = charted(frame.modal, marcher.tau)
        self._slowest_s = slowest_period_s(frame.modal)

    def impact(self, t: float, pose: Pose, u: Array, v: Array) -> Impact:
        """Touch after touch, until the impact is over (`touchdown.after_release`) or the drop."""
        frame, marcher = self.frame, self.marcher
        g, its = self.plan.gravity_m_s2, self.plan.its_s
        damped = bool(frame.modal.damping_1_s.any())
        touches: list[ContactPhase] = []
        loss, top, centre_top = 0.0, -math.inf, -math.inf
        wait = t
        self._place(pose)
        for _ in range(TOUCH_LIMIT):
            touch = march_contact(
                marcher, t, u, v, self.history, self.observer, self.end_s, wait, self.checkpoint
            )
            touches.append(touch)
            loss += touch.material_loss_J
            released = touch.end_s
            start, q, qv = frame.launched(pose, touch.u, touch.v)
            flight = Flight(frame.modal, start, released, q, qv, g, self._charted)
            energy = flight_energy(flight, released)
            if touch.released and not energy.total_J <= MOST_LEFT * self.initial_J:
                raise ComputationError(  # the search for its next touch might never end
                    f"the motion went astray: an impact at {t:.6g} s left {energy.total_J:.3g} J "
                    f"of {self.initial_J:.3g} J; shorten the ITS, or lean it less"
                )
            landing, over = flight.after_release(self.ground, self._slowest_s)
            if over or landing >= self.end_s:
                break
            if landing - released < WAIT_STEPS * its:
                t, u, v, wait = released, touch.u, touch.v, landing
                continue
            top = max(top, flight.apex(landing)[1] - self.datum_m)
            centre_top = max(centre_top, flight.top_of_centre(landing)[1])
            if damped:
                loss += energy.total_J - flight_energy(flight, landing).total_J
            pose, q, qv = flight.state(landing)
            (u, v), t, wait = frame.landed(q, qv), landing, landing
            self._place(pose)
        else:
            raise ComputationError(
                f"more than {TOUCH_LIMIT} touches in one impact; shorten the ITS"
            )
        return Impact(
            touches=[touch for touch in touches if touch.impulse_N_s != 0.0],
            flight=flight,
            energy_after=replace(energy, contact_J=touch.contact_J),
            next_touch_s=landing,
            material_loss_J=loss,
            friction_loss_J=sum(touch.friction_loss_J for touch in touches),
            contact_loss_J=sum(touch.contact_loss_J for touch in touches),
            n_steps=sum(touch.n_steps for touch in touches),
            top_m=top,
            centre_top_m=centre_top,
            ended=touch.released and over,
        )

    def rebound(self, impact: Impact) -> tuple[float | None, float | None]:
        """Greatest heights of the tip and of the centre of mass before the second impact; None
        where the drop ends before they, or the second impact, have been seen."""
        flight, drag = impact.flight, self.plan.drag_kg_m / self.frame.body.mass_kg
        tip_s, tip = flight.apex(impact.next_touch_s)
        centre_s, centre = flight.top_of_centre(impact.next_touch_s)
        if not impact.ended or self.end_s < max(tip_s, centre_s):
            return None, None
        tip = max(tip - self.datum_m, impact.top_m)
        centre = max(centre, impact.centre_top_m)
        return float(risen(tip, drag)), float(risen(centre, drag))

    def _place(self, pose: Pose) -> None:
        self.marcher.place(place(self.ground, pose, self.frame.body.contact, self.datum_m))


def _record_fall(history: History, plan: DropPlan, fall_s: float, body: Body) -> None:
    alpha, g, v0 = body.alpha_1_s, plan.gravity_m_s2, plan.release_speed_m_s
    drag = plan.drag_kg_m / body.mass_kg
    for t in np.linspace(0.0, fall_s, FLIGHT_ROWS, endpoint=False):
        if alpha:
            fallen = damped_path(float(t), g, alpha)
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
    if stop_s <= start_s:
        return
    times = np.linspace(start_s, stop_s, FLIGHT_ROWS + 1)[1:]
    heights = flight.trace(stage.ground, times)
    tip, centre, clear = heights.T
    rows = [times, tip - stage.datum_m, centre, 0.0 * times, np.maximum(-clear, 0.0)]
    history.extend(np.stack(rows, axis=1))
