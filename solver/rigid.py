"""Poses of a body in space, and the free rotation of a rigid body, to rounding.

A pose maps body axes (x thin side, y wide side, z along the bristle, origin in the centre of mass)
to the world's (z up). Attitudes are unit quaternions (w, x, y, z); angular velocities are in body
axes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .arrays import Array
from .compiled import njit
from .fall import falling

# Angle of one Runge-Kutta step; its error is about angle⁵/120.
STEP_RAD = 0.02
# Attitude, then angular velocity, of a rotating body.
State = tuple[float, float, float, float, float, float, float]


@njit
def matrix_of(q: Array) -> Array:
    """Rotation matrix (3, 3) of a unit quaternion (4,)."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    r = np.empty((3, 3))
    r[0, 0], r[0, 1], r[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    r[1, 0], r[1, 1], r[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    r[2, 0], r[2, 1], r[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return r


def quaternion_of(rotation: Array) -> Array:
    """Unit quaternion (4,) of a rotation matrix (3, 3) by less than half a turn."""
    w = 0.5 * math.sqrt(1.0 + np.trace(rotation))
    twice = rotation - rotation.T
    return np.array([w, *(np.array([twice[2, 1], twice[0, 2], twice[1, 0]]) / (4.0 * w))])


@njit
def product(p: Array, q: Array) -> Array:
    """Quaternion of the rotation ``q`` followed by ``p``."""
    out = np.empty(4)
    out[0] = p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3]
    out[1] = p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2]
    out[2] = p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1]
    out[3] = p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0]
    return out


@njit
def turn(vector: Array) -> Array:
    """Quaternion of the rotation vector (3,) in rad."""
    angle = math.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    out = np.empty(4)
    out[0] = math.cos(0.5 * angle)
    factor = 0.5 if angle < 1e-12 else math.sin(0.5 * angle) / angle
    out[1:] = factor * vector
    return out


@njit
def _rates(s: State, inertia: Array) -> State:
    """Rates of attitude and angular velocity without torque: Euler's equations."""
    q0, q1, q2, q3, w0, w1, w2 = s
    dw0 = (inertia[1] - inertia[2]) * w1 * w2 / inertia[0] if inertia[0] > 0.0 else 0.0
    dw1 = (inertia[2] - inertia[0]) * w2 * w0 / inertia[1] if inertia[1] > 0.0 else 0.0
    dw2 = (inertia[0] - inertia[1]) * w0 * w1 / inertia[2] if inertia[2] > 0.0 else 0.0
    dq0 = 0.5 * (-q1 * w0 - q2 * w1 - q3 * w2)
    dq1 = 0.5 * (q0 * w0 + q2 * w2 - q3 * w1)
    dq2 = 0.5 * (q0 * w1 - q1 * w2 + q3 * w0)
    dq3 = 0.5 * (q0 * w2 + q1 * w1 - q2 * w0)
    return dq0, dq1, dq2, dq3, dw0, dw1, dw2


@njit
def _ahead(s: State, h: float, d: State) -> State:
    s0, s1, s2, s3 = s[0] + h * d[0], s[1] + h * d[1], s[2] + h * d[2], s[3] + h * d[3]
    return s0, s1, s2, s3, s[4] + h * d[4], s[5] + h * d[5], s[6] + h * d[6]


@njit
def free_rotation(
    q: Array, w: Array, inertia: Array, alpha_1_s: float, start_s: float, end_s: float
) -> tuple[Array, Array]:
    """Attitude and angular velocity at ``end_s`` of a body in free rotation since ``start_s``.

    ``inertia`` (3,) are the principal moments. Rotation about one principal axis is in closed form;
    otherwise Euler's equations are integrated by the classical Runge-Kutta method in steps of
    `STEP_RAD`. Mass-proportional damping slows the clock of the free motion: with s = (1 - exp(-α
    t))/α, ω(t) = exp(-α t) ω_free(s).
    """
    duration = end_s - start_s
    slowed = 1.0
    if alpha_1_s > 0.0:
        slowed = math.exp(-alpha_1_s * duration)
        duration = (1.0 - slowed) / alpha_1_s
    size = math.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
    if size == 0.0 or duration == 0.0:
        return q.copy(), w * slowed
    largest = max(abs(w[0]), abs(w[1]), abs(w[2]))
    if abs(w[0]) + abs(w[1]) + abs(w[2]) - largest <= 1e-13 * largest:
        return product(q, turn(w * duration)), w * slowed
    n = math.ceil(size * abs(duration) / STEP_RAD)
    h = duration / n
    # a tuple, not an array: nothing is allocated in the loop
    s = (q[0], q[1], q[2], q[3], w[0], w[1], w[2])
    for _ in range(n):
        d1 = _rates(s, inertia)
        d2 = _rates(_ahead(s, 0.5 * h, d1), inertia)
        d3 = _rates(_ahead(s, 0.5 * h, d2), inertia)
        d4 = _rates(_ahead(s, h, d3), inertia)
        s = _ahead(_ahead(s, h / 6.0, d1), h / 3.0, d2)
        s = _ahead(_ahead(s, h / 3.0, d3), h / 6.0, d4)
        size = math.sqrt(s[0] ** 2 + s[1] ** 2 + s[2] ** 2 + s[3] ** 2)
        s = (s[0] / size, s[1] / size, s[2] / size, s[3] / size, s[4], s[5], s[6])
    return np.array(s[:4]), np.array(s[4:]) * slowed


@njit
def fallen(
    position: Array,
    velocity: Array,
    gravity_m_s2: float,
    alpha_1_s: float,
    t: float,
    drag_1_m: float = 0.0,
) -> tuple[Array, Array]:
    """Position and velocity (3,) of the centre of mass after ``t`` s of flight.

    Damping ``alpha_1_s`` acts on all motion, quadratic drag over mass ``drag_1_m`` on the vertical
    one; at most one of them may be nonzero.
    """
    at, speed = position.copy(), velocity.copy()
    path, down = falling(t, gravity_m_s2, -velocity[2], alpha_1_s, drag_1_m)
    decayed = -math.expm1(-alpha_1_s * t) / alpha_1_s if alpha_1_s > 0.0 else t
    at[:2] += velocity[:2] * decayed
    speed[:2] *= math.exp(-alpha_1_s * t)
    at[2] -= path
    speed[2] = -down
    return at, speed


@dataclass(frozen=True)
class Pose:
    """Position of the centre of mass (3,) in m, and attitude (4,) of the body axes in the world."""

    position_m: Array
    attitude: Array

    @property
    def rotation(self) -> Array:
        """Rotation matrix (3, 3) from body axes to the world's."""
        return np.asarray(matrix_of(self.attitude))

    @classmethod
    def upright(cls) -> Pose:
        """Body axes along the world's, the centre of mass at its origin."""
        return cls(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))

    def moved(self, shift_m: Array, angle_rad: Array) -> Pose:
        """The pose after a displacement and a small rotation (3,), both in body axes."""
        return Pose(
            self.position_m + self.rotation @ shift_m,
            product(self.attitude, turn(np.asarray(angle_rad, dtype=float))),
        )


@njit
def leaning(tilt_deg: float, tilt_wide_deg: float = 0.0) -> Array:
    """Attitude (4,) of a bristle whose upper end leans toward its thin (x) and wide (y) side.

    The axis points along (tan tilt, tan tilt_wide, 1); the section is not twisted about it.
    """
    x, y = math.tan(math.radians(tilt_deg)), math.tan(math.radians(tilt_wide_deg))
    sideways = math.hypot(x, y)
    if sideways == 0.0:
        return np.array([1.0, 0.0, 0.0, 0.0])
    share = math.atan(sideways) / sideways
    return turn(np.array([-y * share, x * share, 0.0]))


def slope_normal(slope_deg: float, slope_wide_deg: float = 0.0) -> Array:
    """Unit normal (3,) of a surface whose normal leans toward the thin (x) and wide (y) side."""
    normal = np.array(
        [math.tan(math.radians(slope_deg)), math.tan(math.radians(slope_wide_deg)), 1.0]
    )
    return normal / np.linalg.norm(normal)
