"""The hub: where bristles are clamped, and its prescribed motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from scipy.interpolate import Akima1DInterpolator

from ..arrays import Array
from ..compiled import njit
from ..errors import InputError
from ..rigid import matrix_of, turn
from .rotation import spin_of

# A table whose rows imply a faster hub describes a jump, not a motion.
FASTEST_M_S, FASTEST_RAD_S = 100.0, 1e4
ORDER = 6


@dataclass(frozen=True)
class Clamps:
    """Positions and directions of the clamped bristles, in the hub's axes.

    Parameters
    ----------
    position_m : (n, 3)
    rotation : (n, 3, 3), columns are the bristle's thin side, its wide side, and its axis, which
        points away from the hub
    length_m : (n,), free length of each bristle

    Raises
    ------
    InputError : shapes differ, a matrix is not a rotation, or a length is not positive
    """

    position_m: Array
    rotation: Array
    length_m: Array

    def __post_init__(self) -> None:
        for name in ("position_m", "rotation", "length_m"):
            object.__setattr__(self, name, np.array(getattr(self, name), dtype=float))
        n = len(self.length_m)
        shapes = (self.position_m.shape, self.rotation.shape, self.length_m.shape)
        if n == 0 or shapes != ((n, 3), (n, 3, 3), (n,)):
            raise InputError(f"clamps must have shapes (n, 3), (n, 3, 3) and (n,), not {shapes}")
        if not (np.all(np.isfinite(self.position_m)) and np.all(np.isfinite(self.length_m))):
            raise InputError("positions and lengths of clamps must be finite")
        if not np.all(self.length_m > 0.0):
            raise InputError("every bristle must have a positive length")
        squares = self.rotation @ self.rotation.transpose(0, 2, 1)
        if not (
            np.allclose(squares, np.eye(3), atol=1e-9) and np.all(np.linalg.det(self.rotation) > 0)
        ):
            raise InputError("the rotation of every clamp must be a proper rotation matrix")

    def __len__(self) -> int:
        return len(self.length_m)


class HubPose(NamedTuple):
    """Pose of the hub at one instant: its origin (3,), its axes (3, 3), velocity and angular
    velocity (3,), all in world axes."""

    position_m: Array
    rotation: Array
    velocity_m_s: Array
    angular_velocity_rad_s: Array


@njit
def hub_coordinates(breaks: Array, coefficients: Array, t_s: float, out: Array) -> None:
    """Write the hub's six coordinates and their rates (2, 6) at time ``t_s``.

    The first segment extends to times before the first break, the last one beyond the last.
    """
    segment = 0
    while segment < len(breaks) - 2 and breaks[segment + 1] <= t_s:
        segment += 1
    s = t_s - breaks[segment]
    for c in range(6):
        value, rate = 0.0, 0.0
        for k in range(coefficients.shape[0]):
            rate = rate * s + value
            value = value * s + coefficients[k, segment, c]
        out[0, c], out[1, c] = value, rate


@dataclass(frozen=True)
class HubPath:
    """A prescribed motion: piecewise polynomials in six coordinates, position and rotation vector.

    ``breaks`` (m + 1,) in s separate the segments. ``coefficients`` (`ORDER`, m, 6) are those of
    scipy's PPoly: of falling powers of the time since the segment's start. Compiled code evaluates
    them. Raises InputError if the motion jumps between segments.
    """

    breaks: Array
    coefficients: Array

    def __post_init__(self) -> None:
        if not (np.all(np.diff(self.breaks) > 0.0) and np.all(np.isfinite(self.coefficients))):
            raise InputError("the times of a hub's path must increase, and its values be finite")
        span = np.diff(self.breaks)[:, None]
        ends = np.zeros(self.coefficients.shape[1:])
        for row in self.coefficients:
            ends = ends * span + row
        jumps = np.abs(ends[:-1] - self.coefficients[-1, 1:])
        if np.any(jumps > 1e-9 * (1.0 + np.abs(ends[:-1]))):
            at = self.breaks[1:-1][np.any(jumps > 1e-9 * (1.0 + np.abs(ends[:-1])), axis=1)][0]
            raise InputError(f"the hub's path jumps at {at:g} s")

    def pose(self, t_s: float) -> HubPose:
        """The hub's pose at time ``t_s``."""
        out = np.empty((2, 6))
        hub_coordinates(self.breaks, self.coefficients, float(t_s), out)
        turned = out[0, 3:]
        return HubPose(
            out[0, :3].copy(),
            np.asarray(matrix_of(turn(turned))),
            out[1, :3].copy(),
            spin_of(turned, out[1, 3:]),
        )

    @classmethod
    def still(cls) -> Self:
        """A hub at rest, with its origin and axes those of the world."""
        return cls(np.array([0.0, 1.0]), np.zeros((ORDER, 1, 6)))

    @classmethod
    def table(cls, t_s: Array, pose: Array) -> Self:
        """A motion through rows of a table: times ``t_s`` (m,), positions and rotation vectors (m,
        6).

        The interpolation is modified Akima (scipy's ``makima``): its first derivative is
        continuous, and a hub at rest over three rows does not overshoot. The hub rests before the
        first row and after the last. ``pose`` is in m and rad.

        Raises
        ------
        InputError : fewer than two rows, times that do not increase, values that are not finite,
            or rows that imply a hub faster than 100 m/s or 1e4 rad/s
        """
        t, rows = np.asarray(t_s, dtype=float), np.asarray(pose, dtype=float)
        if rows.shape != (len(t), 6) or len(t) < 2:
            raise InputError("a hub's path needs two rows or more of time and six coordinates")
        if not (np.all(np.isfinite(t)) and np.all(np.isfinite(rows))):
            raise InputError("a hub's path must have finite numbers only")
        late = np.flatnonzero(np.diff(t) <= 0.0)
        if len(late):
            raise InputError(f"the times of a hub's path must increase; row {late[0] + 2} does not")
        rates = np.abs(np.diff(rows, axis=0)) / np.diff(t)[:, None]
        limits = np.repeat([FASTEST_M_S, FASTEST_RAD_S], 3)
        far = np.flatnonzero(np.any(rates > limits, axis=1))
        if len(far):
            raise InputError(f"the hub's path jumps between rows {far[0] + 1} and {far[0] + 2}")
        if len(t) == 2:
            cubic = np.zeros((4, 1, 6))
            cubic[2, 0], cubic[3, 0] = (rows[1] - rows[0]) / (t[1] - t[0]), rows[0]
        else:
            cubic = Akima1DInterpolator(t, rows, method="makima").c
        held = np.zeros((2, 4, 1, 6))
        held[0, 3, 0], held[1, 3, 0] = rows[0], rows[-1]
        every = np.concatenate([held[0], cubic, held[1]], axis=1)
        orders = np.concatenate([np.zeros((ORDER - 4, *every.shape[1:])), every])
        return cls(np.array([t[0] - 1.0, *t, t[-1] + 1.0]), orders)
