"""One drop: free fall, impacts, and exact flight between them."""

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
from .energy import MOST_LEFT, Budget, Energy
from .errors import ComputationError
from .fall import dragged_fall, falling, free_fall
from .ground import Ground, just_touched, place
from .impact import march_contact
from .rigid import Pose, leaning, product, quaternion_of
from .time.flight import Energies, Flight, Flown, Sky, fly, stance
from .time.march import ContactMarch, Marcher
from .time.motion import flyer
from .time.scheme import TimeScheme

TOUCH_LIMIT = 10_000
# A touch within this many steps is reached by time steps, not by flight. That costs little, and the
# full-order body loses no energy outside its flight modes.
WAIT_STEPS = 100
# Resolution of the estimated error of a reduced body, in units of the impact speed: the compared
# bodies share the responses of the tip, which are exact at one shift only.
RESOLVED = 1e-6
# Intervals of an impact in which the speeds of reduced bodies are compared.
COMPARED = 64
# Largest ratio assumed between successive differences of ever finer reduced bodies.
LARGEST_RATIO = 0.9
FLIGHT_ROWS = 200


class FlightFrame(Protocol):
    """A body together with the modal coordinates in which it flies."""

    @property
    def body(self) -> Body: ...

    @property
    def modal(self) -> ModalBody: ...

    def launched(self, pose: Pose, u: Array, v: Array) -> tuple[Pose, Array, Array]:
        """The pose at the start of flight, and modal displacement and velocity relative to it, from
        the body's own vectors in ``pose``."""
        ...

    def landed(self, q: Array, qv: Array) -> tuple[Array, Array]:
        """The body's own displacement and velocity from modal ones; ComputationError if none
        fit."""
        ...

    def energy_J(self, u: Array, v: Array) -> float:
        """Kinetic and strain energy of the body's own vectors."""
        ...


@dataclass(frozen=True)
class ModalFrame:
    """A body that is already modal; ``coarser`` ones, in ascending order, estimate its error."""

    modal: ModalBody
    coarser: tuple[ModalBody, ...] = ()

    @property
    def body(self) -> ModalBody:
        return self.modal

    def launched(self, pose: Pose, u: Array, v: Array) -> tuple[Pose, Array, Array]:
        return pose, u, v

    def landed(self, q: Array, qv: Array) -> tuple[Array, Array]:
        return q, qv

    def energy_J(self, u: Array, v: Array) -> float:
        return 0.5 * float(v @ v + u @ (self.modal.omega2 * u))


@dataclass(frozen=True)
class DropPlan:
    """Inputs of a drop: height, contact, time step and end.

    The bristle leans by ``tilt_deg`` toward its thin side and ``tilt_wide_deg`` toward its wide
    one, over ``ground`` (None: a horizontal plane), and falls ``height_m`` until a point of its tip
    touches. The columns of ``axes`` (3, 3) are the upright body's axes in the world (None: the
    world's own). ``until_s`` is a time after release, or None to end after the first rebound;
    ``impact_only`` ends at the last release of the first impact. ``release_speed_m_s`` is the
    downward speed at the start, ``drag_kg_m`` the air's drag over the square of the vertical speed.
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
    """Result of a drop; names and units as in result.json.

    ``rebound_height_m`` is the greatest height of the lower tip's middle over where it first
    touched, ``cm_rebound_height_m`` that of the centre of mass over its position then, both before
    the second impact. ``velocity_after_m_s`` (3,) of the centre of mass and ``spin_after_rad_s``
    (3,), about body axes, are those after the last release of the first impact. Heights are None if
    the drop ends before the top of the rebound or the second impact is reached. If it ends within
    the first impact the time in contact, and all that follows it, is NaN. ``friction_impulse_N_s``
    is the size of the tangential impulse. ``reduction_error`` estimates the error of a reduced body
    against the full order by the end of the first impact, in units of the impact speed; None for
    bodies without reduction.
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
    """Simulate a drop: time steps in contact, exact flight otherwise.

    A ``marcher`` made for the plan may be passed, to share factors between drops. ``observer`` is
    called with every state in contact. Stepwise marches resume from ``checkpoint``. Raises
    ComputationError.
    """
    body = frame.body
    marcher = marcher or Marcher(body, plan.method, plan.scheme, plan.its_s, plan.gravity_m_s2)
    stage = Stage(frame, marcher, plan)
    t, pose = stage.fall_s, stage.first_pose
    none = np.zeros(len(body.translation))
    start: tuple[float, Array, Array] = (t, none, body.translation @ stage.speed(pose))
    history, losses, end_s = stage.history, stage.losses, stage.end_s
    first: Impact | None = None
    touches: list[ContactPhase] = []
    tops: list[tuple[float, float]] = []
    memory, wait_s, n_steps = None, t, 0
    stage.place(pose)
    while True:
        touch = march_contact(marcher, *start, history, observer, end_s, wait_s, checkpoint, memory)
        touches.append(touch)
        losses.add(touch)
        n_steps += touch.n_steps
        flight, flown = stage.fly(pose, touch)
        next_s = flight.t0_s + flown.next
        if not flown.over and next_s < end_s:  # the impact goes on
            if len(touches) >= TOUCH_LIMIT:
                raise ComputationError(
                    f"more than {TOUCH_LIMIT} touches in one impact; shorten the ITS"
                )
            memory = touch.memory
            if flown.soon:
                start, wait_s = (flight.t0_s, touch.u, touch.v), next_s
                continue
            tops.append((flown.tip_m, flown.centre_m))
        losses.change(flight.energies(flight.t0_s), frame.energy_J(touch.u, touch.v), 1.0)
        if flown.over or next_s >= end_s:
            first = first or Impact(touches, flight, flown, tops, touch.released and flown.over)
            next_s = flight.t0_s if plan.impact_only else max(min(next_s, end_s), flight.t0_s)
            _record_flight(history, flight, touches[-1].release_s, next_s, stage)
            if plan.impact_only or plan.until_s is None or next_s >= end_s:
                break
            memory, touches, tops = None, [], []
        losses.fly(flight, next_s)
        pose, q, qv = flight.state(next_s)
        start, wait_s = (next_s, *frame.landed(q, qv)), next_s
        losses.change(flight.energies(next_s), frame.energy_J(*start[1:]), -1.0)
        stage.place(pose)
    losses.fly(flight, next_s)
    now = flight.energies(next_s)
    energy = Energy(now.kinetic, now.strain, now.potential, touch.contact_J)
    found = stage.result(first, energy, n_steps)
    return replace(found, reduction_error=_reduction_error(frame, plan, found))


@dataclass(frozen=True)
class Impact:
    """The touches of one impact, the greatest heights of the tip and of the centre of mass between
    them, and the flight that follows it. ``ended`` says that no touch of it was to come when the
    drop ended."""

    all_touches: list[ContactPhase]
    flight: Flight
    flown: Flown
    tops: list[tuple[float, float]]
    ended: bool

    @property
    def touches(self) -> list[ContactPhase]:
        """The touches with an impulse."""
        return [touch for touch in self.all_touches if touch.impulse_N_s != 0.0]


@dataclass
class Losses:
    """Energy lost in a drop so far, in J. A flight has losses if it is ``damped`` or if the air
    ``drags``, which takes all that rigid motion loses."""

    material_J: float
    drag_J: float
    damped: bool
    drags: bool
    friction_J: float = 0.0
    contact_J: float = 0.0
    flight_J: float = 0.0

    def change(self, flying: Energies, own_J: float, sign: float) -> None:
        """Account for take-off (``sign`` 1) or landing (-1): the energy of the body's own motion
        beyond that of its flight modes."""
        self.flight_J += sign * (own_J - flying.kinetic - flying.strain)

    def add(self, touch: ContactPhase) -> None:
        """Add the losses of a touch."""
        self.material_J += touch.material_loss_J
        self.friction_J += touch.friction_loss_J
        self.contact_J += touch.contact_loss_J

    def fly(self, flight: Flight, stop_s: float) -> None:
        """Add the losses of a flight until ``stop_s``: vibration's to damping, the rest to drag."""
        if not (self.damped or self.drags):
            return
        start, stop = flight.energies(flight.t0_s), flight.energies(stop_s)
        lost = start.total - stop.total
        slowed = lost - (start.elastic - stop.elastic) if self.drags else 0.0
        self.drag_J += slowed
        self.material_J += lost - slowed


class Stage:
    """A body over its ground: data shared by the events of one drop."""

    def __init__(self, frame: FlightFrame, marcher: ContactMarch, plan: DropPlan) -> None:
        self.frame, self.marcher, self.plan = frame, marcher, plan
        body, g = frame.body, plan.gravity_m_s2
        self.history = History()
        self.end_s = math.inf if plan.until_s is None else plan.until_s
        self.fall_s, self.speed_m_s = _fall(plan, body)
        if self.end_s <= self.fall_s:
            raise ComputationError(
                f"the drop ends at {self.end_s:g} s, before it touches at {self.fall_s:g} s"
            )
        self.initial_J = body.mass_kg * (g * plan.height_m + 0.5 * plan.release_speed_m_s**2)
        slowed = self.initial_J - 0.5 * body.mass_kg * self.speed_m_s**2
        damped, drags = bool(frame.modal.damping_1_s.any()), plan.drag_kg_m > 0.0
        fallen = slowed if body.alpha_1_s else 0.0, slowed if drags else 0.0
        self.losses = Losses(*fallen, damped, drags)
        points = body.contact
        attitude = leaning(plan.tilt_deg, plan.tilt_wide_deg)
        if plan.axes is not None:
            attitude = product(attitude, quaternion_of(plan.axes))
        self.first_pose = Pose(np.zeros(3), attitude)
        ground = plan.ground or Ground.plane(len(points.weights))
        self.ground = just_touched(ground, self.first_pose, points)
        self.datum_m = place(self.ground, self.first_pose, points).tip_m
        self._flyer = flyer(frame.modal, marcher.tau)
        self._sky = Sky(
            gravity=g,
            drag=plan.drag_kg_m / body.mass_kg,
            slowest=slowest_period_s(frame.modal),
            soon=WAIT_STEPS * plan.its_s,
        )
        _record_fall(self.history, plan, self.fall_s, body)

    def speed(self, pose: Pose) -> Array:
        """The velocity (3,) of the fall at its end, along body axes."""
        return -self.speed_m_s * pose.rotation[2]

    def place(self, pose: Pose) -> None:
        """Place the body in ``pose`` at the end of its fall."""
        self.marcher.place(place(self.ground, pose, self.frame.body.contact, self.datum_m))

    def fly(self, pose: Pose, touch: ContactPhase) -> tuple[Flight, Flown]:
        """The flight after a touch."""
        start = stance(*self.frame.launched(pose, touch.u, touch.v))
        most = MOST_LEFT * self.initial_J if touch.released else math.inf
        planes = self.ground.normals, self.ground.offsets_m
        flown = fly(self._flyer, *planes, start, self._sky, most)
        flight = Flight.of(flown.motion, touch.end_s)
        if flown.astray:
            left = flight.energies(touch.end_s).total
            raise ComputationError(
                f"the motion went astray: an impact at {touch.start_s:.6g} s left {left:.3g} J "
                f"of {self.initial_J:.3g} J; shorten the ITS, or lean it less"
            )
        return flight, flown

    def rebound(self, impact: Impact) -> tuple[float, float] | tuple[None, None]:
        """Greatest heights of the tip and of the centre of mass before the second impact; None if
        the drop ends before they, or the second impact, are reached."""
        flown = impact.flown
        seen_s = impact.flight.t0_s + max(flown.tip_s, flown.centre_s)
        if self.plan.impact_only or not impact.ended or self.end_s < seen_s:
            return None, None
        tip, centre = np.max([*impact.tops, (flown.tip_m, flown.centre_m)], axis=0)
        return float(tip - self.datum_m), float(centre)

    def result(self, first: Impact, energy: Energy, n_steps: int) -> DropResult:
        """The drop's result, from its ``first`` impact and the ``energy`` at its end."""
        touches, losses, height = first.touches, self.losses, self.plan.height_m
        began_s = touches[0].start_s
        deepest = max(touches, key=lambda touch: touch.max_penetration_m)
        rebound, centre_rebound = self.rebound(first)
        contact_s = math.nan
        velocity: Array = np.full(3, math.nan)
        spin: Array = np.full(3, math.nan)
        if first.ended:
            release_s = touches[-1].release_s
            contact_s = release_s - began_s
            velocity = first.flight.centre(release_s)[1]
            spin = first.flight.turned(release_s)[1]
        spent = losses.material_J, losses.friction_J, losses.contact_J, losses.drag_J
        return DropResult(
            impact_speed_m_s=self.speed_m_s,
            rebound_ratio=None if rebound is None else rebound / height,
            rebound_height_m=rebound,
            contact_time_s=contact_s,
            n_contacts=len(touches),
            peak_force_N=max(touch.peak_force_N for touch in touches),
            impulse_N_s=sum(touch.impulse_N_s for touch in touches),
            max_penetration_m=deepest.max_penetration_m,
            time_to_max_penetration_s=deepest.start_s + deepest.max_penetration_s - began_s,
            cm_velocity_after_m_s=float(velocity[2]),
            n_dofs=self.frame.body.n_dofs,
            n_steps=n_steps,
            energy=replace(Budget.close(self.initial_J, energy, *spent), flight_J=losses.flight_J),
            history=self.history,
            cm_rebound_height_m=centre_rebound,
            velocity_after_m_s=tuple(map(float, velocity)),
            spin_after_rad_s=tuple(map(float, spin)),
            friction_impulse_N_s=sum(_across(touch) for touch in touches),
        )


def _reduction_error(frame: FlightFrame, plan: DropPlan, found: DropResult) -> float | None:
    """Estimated error of a reduced body's velocities after the impact, over the impact speed.

    A spin counts by its energy. Bodies are compared by the motion after the impact and by the speed
    of the centre of mass throughout it, since a single number may agree by chance. Differences
    between ever finer bodies are extrapolated geometrically, with at most `LARGEST_RATIO`.
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
    """Size of a touch's tangential impulse."""
    return math.sqrt(max(float(touch.push_N_s @ touch.push_N_s) - touch.impulse_N_s**2, 0.0))


def slowest_period_s(body: ModalBody) -> float:
    """Period of the slowest elastic mode; zero if the body is rigid."""
    elastic = body.omega2[body.omega2 > 0.0]
    return float(2.0 * math.pi / math.sqrt(elastic.min())) if len(elastic) else 0.0


def _record_fall(history: History, plan: DropPlan, fall_s: float, body: Body) -> None:
    slowed = body.alpha_1_s, plan.drag_kg_m / body.mass_kg
    for t in map(float, np.linspace(0.0, fall_s, FLIGHT_ROWS, endpoint=False)):
        path, _ = falling(t, plan.gravity_m_s2, plan.release_speed_m_s, *slowed)
        height = plan.height_m - path
        history.rows.append((t, height, height, 0.0, 0.0))


def _record_flight(
    history: History, flight: Flight, start_s: float, stop_s: float, stage: Stage
) -> None:
    """Record tip and centre of mass at equal times; the step in which it was released stays."""
    start_s = max(start_s, history.rows[-1][0])
    if stop_s <= start_s:
        return
    times = np.linspace(start_s, stop_s, FLIGHT_ROWS + 1)[1:]
    heights = flight.trace(stage.ground, times)
    tip, centre, clear = heights.T
    rows = [times, tip - stage.datum_m, centre, 0.0 * times, np.maximum(-clear, 0.0)]
    history.extend(np.stack(rows, axis=1))
