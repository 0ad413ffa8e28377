"""Flight of a modal body from a release to its next touch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..arrays import Array
from ..bodies.modal import ModalBody
from ..compiled import njit
from ..ground import Ground
from ..rigid import Pose
from .motion import Flyer, Motion, Stance, centre, flyer, landing, launch, turned
from .search import after_release, apex, top_of_centre, trace


class Energies(NamedTuple):
    """Energy in flight in J: kinetic, strain, potential (zero where the tip first touches), their
    total, and the ``elastic`` part of the first two, which is vibration."""

    kinetic: float
    strain: float
    potential: float
    total: float
    elastic: float


class Sky(NamedTuple):
    """What flights of a body share: ``gravity``, quadratic ``drag`` over mass (1/m), the
    ``slowest`` mode's period, and the time ``soon`` within which time steps lead to a touch."""

    gravity: float
    drag: float
    slowest: float
    soon: float


class Flown(NamedTuple):
    """A flight and its end; times in s from its start.

    ``next`` is the time of the next touch, or one by which it must have come. ``over`` says that
    the impact has ended by then, ``soon`` that the touch is close. The middle of the tip is highest
    at ``tip_s``, the centre of mass at ``centre_s``; neither is computed if ``soon``. A flight that
    starts with more than the allowed energy is ``astray`` and not followed.
    """

    motion: Motion
    astray: bool
    next: float
    over: bool
    soon: bool
    tip_s: float
    tip_m: float
    centre_s: float
    centre_m: float


@njit
def energies(motion: Motion, t: float) -> Energies:
    """The energies at ``t``."""
    flyer = motion.flyer
    position, _, u, v = landing(motion, t)
    kinetic = strain = elastic = mass = 0.0
    for j in range(len(u)):
        kinetic += 0.5 * v[j] * v[j]
        strain += 0.5 * flyer.omega2[j] * u[j] * u[j]
        elastic += 0.5 * v[j] * v[j] if flyer.omega2[j] > 0.0 else 0.0
        mass += flyer.translation[j, 2] ** 2
    potential = mass * motion.gravity * position[2]
    return Energies(kinetic, strain, potential, kinetic + strain + potential, elastic + strain)


@njit
def fly(
    flyer: Flyer, normals: Array, offsets: Array, start: Stance, sky: Sky, most_J: float
) -> Flown:
    """The flight after a release over the planes ``normals`` (n, 3) · x = ``offsets`` (n,).

    With more energy than ``most_J`` it is not followed: it might have no next touch to be found.
    """
    motion = launch(flyer, start, sky.gravity, sky.drag)
    if not energies(motion, 0.0).total <= most_J:
        return Flown(motion, True, 0.0, False, False, 0.0, 0.0, 0.0, 0.0)
    after, over = after_release(motion, normals, offsets, sky.slowest)
    if not over and after < sky.soon:
        return Flown(motion, False, after, over, True, 0.0, 0.0, 0.0, 0.0)
    tip_s, tip = apex(motion, after)
    centre_s, top = top_of_centre(motion, after)
    return Flown(motion, False, after, over, False, tip_s, tip, centre_s, top)


class Flight:
    """Motion of a modal body from a state (u, v) in ``pose`` at ``t0_s``, under gravity alone.

    The rigid part of (u, v) moves the pose. Times are absolute, in s. ``known`` is the body's
    `flyer` if it is already available.
    """

    def __init__(
        self,
        body: ModalBody,
        pose: Pose,
        t0_s: float,
        u: Array,
        v: Array,
        gravity_m_s2: float,
        known: Flyer | None = None,
    ) -> None:
        self.t0_s = t0_s
        self.motion = launch(known or flyer(body), stance(pose, u, v), float(gravity_m_s2), 0.0)

    @classmethod
    def of(cls, motion: Motion, t0_s: float) -> Flight:
        """The flight of a ``motion`` that starts at ``t0_s``."""
        flight = cls.__new__(cls)
        flight.t0_s, flight.motion = t0_s, motion
        return flight

    def centre(self, t_s: float) -> tuple[Array, Array]:
        """Position and velocity (3,) of the centre of mass, also before the start."""
        return centre(self.motion, t_s - self.t0_s)

    def turned(self, t_s: float) -> tuple[Array, Array]:
        """Attitude (4,), and angular velocity (3,) in body axes."""
        return turned(self.motion, t_s - self.t0_s)

    def state(self, t_s: float) -> tuple[Pose, Array, Array]:
        """The pose, and the displacement and velocity (modes,) relative to it.

        The displacement is only elastic; the velocity includes the rigid one.
        """
        position, attitude, u, v = landing(self.motion, t_s - self.t0_s)
        return Pose(position, attitude), u, v

    def energies(self, t_s: float) -> Energies:
        """The energies at ``t_s``."""
        return energies(self.motion, t_s - self.t0_s)

    def trace(self, ground: Ground, t_s: Array) -> Array:
        """Heights of the tip's middle and of the centre, and the smallest clearance: (k, 3)."""
        times = np.asarray(t_s) - self.t0_s
        return np.asarray(trace(self.motion, ground.normals, ground.offsets_m, times))

    def apex(self, until_s: float) -> tuple[float, float]:
        """Time and greatest height of the tip's middle in [t0, ``until_s``]."""
        after, height = apex(self.motion, until_s - self.t0_s)
        return self.t0_s + after, height


def stance(pose: Pose, u: Array, v: Array) -> Stance:
    """A body with displacement and velocity (modes,) relative to a pose."""
    position = np.asarray(pose.position_m, dtype=float)
    return Stance(position, pose.attitude, np.ascontiguousarray(u), np.ascontiguousarray(v))
