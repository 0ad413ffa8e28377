"""A modal body in free flight under gravity: rigid motion exactly, ringing in closed form on top.

The frame of the body floats with its rigid motion; the ringing is small against it, and what the
frame's rotation does to the ringing (Coriolis and centrifugal forces, of the order of the angular
velocity over the frequency of bending) is left out.
"""

from __future__ import annotations

import numpy as np

from ..arrays import Array
from ..bodies.modal import ModalBody
from ..ground import Ground
from ..rigid import Pose, fallen, free_rotation
from .apex import apex
from .clearance import trace
from .motion import Chart, Flyer, chart, landing, launch, top_of_centre
from .touchdown import after_release


def flyer(body: ModalBody, tau_m_N: float = 0.0) -> Flyer:
    """A body as flight sees it: its contact points, or with ``tau_m_N`` minus their approach
    (contact.enforcement)."""
    points = body.contact
    weights, rows = points.weights, points.rows
    along: Array = np.asarray(points.coordinates)
    moved: Array = rows @ along
    tip = np.einsum("i,ixm->xm", weights, moved.reshape(len(weights), 3, -1))
    with_speed: Array = np.zeros((0, 0))
    if tau_m_N:
        along, rows = moved - tau_m_N * points.traction, np.zeros((0, 0))
        with_speed = -tau_m_N * body.beta_s * np.asarray(points.traction)
    places = np.ascontiguousarray(points.places_m, dtype=float)
    return Flyer(
        omega2=body.omega2,
        alpha=body.alpha_1_s,
        damping=body.damping_1_s,
        translation=np.ascontiguousarray(body.translation),
        rotation=np.ascontiguousarray(body.rotation),
        inertia=body.inertia_kg_m2,
        along=np.ascontiguousarray(along),
        with_speed=np.ascontiguousarray(with_speed),
        rows=np.ascontiguousarray(rows),
        places=places,
        tip=np.ascontiguousarray(tip),
        tip_place=weights @ places,
    )


def charted(body: ModalBody, tau_m_N: float = 0.0) -> tuple[Flyer, Chart]:
    """The `flyer` of a body, and what all its flights have in common."""
    known = flyer(body, tau_m_N)
    return known, chart(known)


class Flight:
    """Motion of a modal body from a state (u, v) in ``pose`` at ``t0_s``, gravity alone acting.

    The rigid part of (u, v) moves the pose. Times are absolute, in s. ``known`` is what `charted`
    gives of the body, where that is there already.
    """

    def __init__(
        self,
        body: ModalBody,
        pose: Pose,
        t0_s: float,
        u: Array,
        v: Array,
        gravity_m_s2: float,
        known: tuple[Flyer, Chart] | None = None,
    ) -> None:
        self.body, self.t0_s, self.gravity_m_s2 = body, t0_s, gravity_m_s2
        flyer, table = known or charted(body)
        self.motion = launch(
            table,
            flyer,
            np.asarray(pose.position_m, dtype=float),
            pose.attitude,
            np.ascontiguousarray(u),
            np.ascontiguousarray(v),
            float(gravity_m_s2),
        )

    def centre(self, t_s: float) -> tuple[Array, Array]:
        """Position and velocity (3,) of the centre of mass, also before the start."""
        return fallen(
            self.motion.position,
            self.motion.velocity,
            self.gravity_m_s2,
            self.body.alpha_1_s,
            t_s - self.t0_s,
        )

    def turned(self, t_s: float) -> tuple[Array, Array]:
        """Attitude (4,), and angular velocity (3,) in body axes."""
        return free_rotation(
            self.motion.attitude,
            self.motion.spin,
            self.motion.flyer.inertia,
            self.body.alpha_1_s,
            0.0,
            t_s - self.t0_s,
        )

    def state(self, t_s: float) -> tuple[Pose, Array, Array]:
        """The pose, and the displacement and velocity (modes,) on top of it.

        The displacement is elastic alone; the velocity has the rigid one too.
        """
        position, attitude, u, v = landing(self.motion, t_s - self.t0_s)
        return Pose(position, attitude), u, v

    def trace(self, ground: Ground, t_s: Array) -> Array:
        """Heights of the tip's middle and of the centre, and the smallest clearance: (k, 3)."""
        return np.asarray(
            trace(self.motion, ground.normals, ground.offsets_m, np.asarray(t_s) - self.t0_s)
        )

    def after_release(self, ground: Ground, slowest_s: float) -> tuple[float, bool]:
        """See `touchdown.after_release`; the time is absolute."""
        after, over = after_release(self.motion, ground.normals, ground.offsets_m, slowest_s)
        return self.t0_s + after, over

    def top_of_centre(self, until_s: float) -> tuple[float, float]:
        """Time and height of the highest place of the centre of mass in [t0, ``until_s``]."""
        after, height = top_of_centre(self.motion, until_s - self.t0_s)
        return self.t0_s + after, height

    def apex(self, until_s: float) -> tuple[float, float]:
        """Time and height of the highest place of the tip's middle in [t0, ``until_s``]."""
        after, height = apex(self.motion, until_s - self.t0_s)
        return self.t0_s + after, height
