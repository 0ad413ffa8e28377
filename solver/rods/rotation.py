"""Rotations in compiled code: vectors, quaternions and matrices written into arrays.

`solver.rigid` has the same maps with results in new arrays; these are for loops in which allocation
costs more than the arithmetic. Quaternions are (w, x, y, z), rotation vectors in rad.
"""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Array
from ..compiled import inlined, njit

type Vector = Array | tuple[float, float, float]


@inlined
def dot(a: Vector, b: Vector) -> float:
    """Dot product of two vectors (3,)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross(a: Vector, b: Vector) -> tuple[float, float, float]:
    """Cross product of two vectors (3,)."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def multiply(p: Array, q: Array, out: Array) -> None:
    """Write the quaternion of ``q`` followed by ``p``; ``out`` may be either."""
    w = p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3]
    x = p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2]
    y = p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1]
    z = p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0]
    out[0], out[1], out[2], out[3] = w, x, y, z


@inlined
def exponential(v0: float, v1: float, v2: float, out: Array) -> None:
    """Write the quaternion of a rotation vector."""
    angle = math.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
    factor = 0.5 if angle < 1e-9 else math.sin(0.5 * angle) / angle
    out[0], out[1], out[2], out[3] = math.cos(0.5 * angle), factor * v0, factor * v1, factor * v2


@inlined
def between(p: Array, q: Array) -> tuple[float, float, float, float]:
    """Quaternion of the rotation from ``p`` to ``q`` in the axes of ``p``, by at most half a
    turn."""
    w = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3]
    x = p[0] * q[1] - p[1] * q[0] - p[2] * q[3] + p[3] * q[2]
    y = p[0] * q[2] + p[1] * q[3] - p[2] * q[0] - p[3] * q[1]
    z = p[0] * q[3] - p[1] * q[2] + p[2] * q[1] - p[3] * q[0]
    return (w, x, y, z) if w >= 0.0 else (-w, -x, -y, -z)


@inlined
def vector_factor(w: float, x: float, y: float, z: float) -> float:
    """Rotation vector over vector part of a unit quaternion."""
    size = math.sqrt(x * x + y * y + z * z)
    return 2.0 if size < 1e-9 else 2.0 * math.atan2(size, w) / size


@inlined
def write_matrix_of(w: float, x: float, y: float, z: float, out: Array) -> None:
    """Write the rotation matrix (3, 3) of a unit quaternion by its components."""
    out[0, 0], out[1, 1] = 1.0 - 2.0 * (y * y + z * z), 1.0 - 2.0 * (x * x + z * z)
    out[2, 2] = 1.0 - 2.0 * (x * x + y * y)
    out[0, 1], out[0, 2], out[1, 2] = 2 * (x * y - w * z), 2 * (x * z + w * y), 2 * (y * z - w * x)
    out[1, 0], out[2, 0], out[2, 1] = 2 * (x * y + w * z), 2 * (x * z - w * y), 2 * (y * z + w * x)


@inlined
def write_matrix(q: Array, out: Array) -> None:
    """Write the rotation matrix (3, 3) of a unit quaternion."""
    write_matrix_of(q[0], q[1], q[2], q[3], out)


@njit
def write_middle(q: Array, e: int, out: Array) -> None:
    """Write the axes (3, 3) halfway between those of node ``e`` (n, 4) and of the next."""
    same = square = 0.0
    for c in range(4):
        same += q[e, c] * q[e + 1, c]
    sign = 1.0 if same >= 0.0 else -1.0
    for c in range(4):
        square += (q[e, c] + sign * q[e + 1, c]) ** 2
    size = math.sqrt(square)
    write_matrix_of(
        (q[e, 0] + sign * q[e + 1, 0]) / size,
        (q[e, 1] + sign * q[e + 1, 1]) / size,
        (q[e, 2] + sign * q[e + 1, 2]) / size,
        (q[e, 3] + sign * q[e + 1, 3]) / size,
        out,
    )


@inlined
def normalise(q: Array) -> None:
    """Remove rounding from a unit quaternion."""
    size = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for k in range(4):
        q[k] /= size


@njit
def spin_of(vector: Array, rate: Array) -> Array:
    """Angular velocity (3,) in fixed axes of a body with a rotation vector and its ``rate`` (3,).

    Its tangent operator: Ibrahimbegovic, Frey and Kozar, Int. J. Numer. Meth. Engng 38 (1995).
    """
    angle = math.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    if angle < 1e-4:
        first, second = 0.5 - angle**2 / 24.0, 1.0 / 6.0 - angle**2 / 120.0
    else:
        first = (1.0 - math.cos(angle)) / angle**2
        second = (angle - math.sin(angle)) / angle**3
    once = cross(vector, rate)
    twice, out = cross(vector, once), np.empty(3)
    for c in range(3):
        out[c] = rate[c] + first * once[c] + second * twice[c]
    return out
