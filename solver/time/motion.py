"""Free flight of a modal body: exact rigid motion with vibration in closed form, compiled.

The body's frame floats with its rigid motion, and the vibration is small relative to it. Coriolis
and centrifugal effects of the frame's rotation on the vibration are neglected; they are of the
order of the angular velocity over the frequency of bending.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..bodies.modal import ModalBody
from ..compiled import njit
from ..rigid import fallen, free_rotation, matrix_of, product, turn

Complex = NDArray[np.complex128]
# Relative split of a critically damped mode's roots, and rounding of displacements.
SPLIT, ROUNDING = 1e-12, 1e-12


class Seen(NamedTuple):
    """Some points of the end section, for searches along a flight.

    The unstrained position of point i is ``places[i]`` (3,). Its displacement is its three ``rows``
    (3 n, k) times the section's coordinates, or the coordinates themselves if there are no rows.
    Exponential j changes these by ``along[j]`` (k,) times its displacement and ``quick[j]`` times
    its speed (no columns if speed has no effect). A unit of it moves no point by more than
    ``reach[j]``, along the axis ``reach_up[j]``; what the coordinates omit is at most ``rest[j]``.
    ``far`` and ``wide`` are the greatest distances along and from the axis, in m.
    """

    places: Array
    rows: Array
    along: Array
    quick: Array
    reach: Array
    reach_up: Array
    rest: Array
    far: float
    wide: float


class Flyer(NamedTuple):
    """Data of a body for all its flights, see ModalBody.

    Elastic mode i moves by u_i(t) = Re Σ amount exp(power t) over the exponentials (e,) with
    ``modes`` = i. An amount is ``by_u`` u_i(0) + ``by_v`` v_i(0). The exponentials are ordered by
    the size of their ``powers``. Searches use the end section as ``rigid`` or all its ``points``;
    ``tip`` is its middle. ``alpha`` damps rigid motion.
    """

    omega2: Array
    translation: Array
    rotation: Array
    inertia: Array
    alpha: float
    powers: Complex
    modes: NDArray[np.int64]
    by_u: Complex
    by_v: Complex
    points: Seen
    rigid: Seen
    tip: Seen


class Stance(NamedTuple):
    """State of a body: position (3,) and attitude (4,), and displacement and velocity (modes,)
    relative to them."""

    position: Array
    attitude: Array
    u: Array
    v: Array


class Motion(NamedTuple):
    """A flight, by its initial state in the world's axes. Its vibration has the ``amounts`` (e,) of
    the flyer's exponentials, with absolute values ``loud`` (e,).

    Quadratic drag ``drag`` (1/m, over mass) acts on vertical motion. The others are bounds: on
    angular velocity across the axis (``tumbling``) and about it (``twirling``), on angular
    acceleration (``swerving``), and on the acceleration of a place on the axis 1 m from the centre
    (``swinging``).
    """

    position: Array
    velocity: Array
    attitude: Array
    spin: Array
    gravity: float
    drag: float
    amounts: Complex
    loud: Array
    tumbling: float
    twirling: float
    swerving: float
    swinging: float
    flyer: Flyer


def flyer(body: ModalBody, tau_m_N: float = 0.0) -> Flyer:
    """Data of a body for flight: its contact points, or with ``tau_m_N`` minus their approach
    (contact.enforcement)."""
    points = body.contact
    places = np.ascontiguousarray(points.places_m, dtype=float)
    middle = points.weights @ places
    moved: Array = points.rows @ np.asarray(points.coordinates)
    tip = np.einsum("i,ixm->xm", points.weights, moved.reshape(len(places), 3, -1))
    powers, modes, by_u, by_v = _exponentials(body.omega2, body.damping_1_s)
    none: Array = np.zeros((0, 0))

    def seen(
        places: Array, rows: Array, along: Array, moved: Array, speed: tuple[Array, Array] | None
    ) -> Seen:
        """Of points that modes move by ``moved`` (3 n, modes), and by ``speed``, coordinates and
        points, if their rates matter too."""
        quick: Array = np.zeros((len(powers), 0))
        reach, reach_up = _greatest(moved)[modes], _greatest(moved, 2)[modes]
        rest = _beyond(moved, rows, along)[modes]
        if speed is not None:
            quick, size = speed[0].T[modes], np.abs(powers)
            reach = reach + size * _greatest(speed[1])[modes]
            reach_up = reach_up + size * _greatest(speed[1], 2)[modes]
            rest = rest + size * _beyond(speed[1], rows, speed[0])[modes]
        return Seen(
            places=places,
            rows=rows,
            along=np.ascontiguousarray(along.T[modes]),
            quick=np.ascontiguousarray(quick),
            reach=reach,
            reach_up=reach_up,
            rest=rest,
            far=float(np.abs(places[:, 2]).max()),
            wide=float(np.hypot(places[:, 0], places[:, 1]).max()),
        )

    stiff = rigid_rows(places)
    nearest = np.linalg.pinv(stiff)
    if tau_m_N:
        moved = moved - tau_m_N * np.asarray(points.traction)
        quick = -tau_m_N * body.beta_s * np.asarray(points.traction)
        all_points = seen(places, none, moved, moved, (quick, quick))
        rigid = seen(places, stiff, nearest @ moved, moved, (nearest @ quick, quick))
    else:
        coordinates = np.asarray(points.coordinates)
        all_points = seen(places, np.ascontiguousarray(points.rows), coordinates, moved, None)
        rigid = seen(places, stiff, nearest @ moved, moved, None)
    return Flyer(
        omega2=body.omega2,
        translation=np.ascontiguousarray(body.translation),
        rotation=np.ascontiguousarray(body.rotation),
        inertia=body.inertia_kg_m2,
        alpha=body.alpha_1_s,
        powers=powers,
        modes=modes,
        by_u=by_u,
        by_v=by_v,
        points=all_points,
        rigid=rigid,
        tip=seen(middle[None], none, tip, tip, None),
    )


def _exponentials(
    omega2: Array, damping: Array
) -> tuple[Complex, NDArray[np.int64], Complex, Complex]:
    """``powers``, ``modes``, ``by_u`` and ``by_v`` of a flyer; rigid modes have none."""
    elastic = np.flatnonzero(omega2 > 0.0)
    w2, c = omega2[elastic], damping[elastic]
    inside = c * c - 4.0 * w2
    # critically damped modes have no second exponential; split roots err by the split squared
    inside = np.where(np.abs(inside) < SPLIT * c * c, SPLIT * c * c, inside)
    rings, root = inside < 0.0, np.sqrt(np.abs(inside))
    ringing = -0.5 * c[rings] + 0.5j * root[rings]
    fast = -0.5 * (c + root)[~rings] + 0.0j
    slow = w2[~rings] / fast  # without cancellation
    powers = np.concatenate([ringing, fast, slow])
    by_u = np.concatenate(
        [1.0 + 1j * ringing.real / ringing.imag, -slow / (fast - slow), fast / (fast - slow)]
    )
    by_v = np.concatenate([-1j / ringing.imag, 1.0 / (fast - slow), -1.0 / (fast - slow)])
    modes = np.concatenate([elastic[rings], elastic[~rings], elastic[~rings]])
    order = np.argsort(np.abs(powers), kind="stable")
    return powers[order], modes[order], by_u[order], by_v[order]


def rigid_rows(places: Array) -> Array:
    """Displacements (3 n, 6) of points by translations along x, y, z and rotations about them."""
    arms = places - places.mean(axis=0)
    turned = [np.cross(axis, arms).ravel() for axis in np.eye(3)]
    return np.column_stack([np.tile(np.eye(3), (len(places), 1)), *turned])


def _greatest(moved: Array, first: int = 0) -> Array:
    """Greatest displacement of any point (modes,) by rows (3 n, modes), from axis ``first`` on."""
    squared = moved.reshape(-1, 3, moved.shape[1])[:, first:] ** 2
    return np.sqrt(squared.sum(axis=1)).max(axis=0)


def _beyond(moved: Array, rows: Array, along: Array) -> Array:
    """Greatest displacement (modes,) outside the coordinates; zero if it is rounding."""
    left = _greatest(moved - (rows @ along if rows.size else along))
    return np.where(left > ROUNDING * _greatest(moved), left, 0.0)


@njit
def rigid_part(flyer: Flyer, x: Array) -> tuple[Array, Array]:
    """Translation and rotation (3,) in body axes contained in modal coordinates ``x``."""
    shift, angle = flyer.translation.T @ x, flyer.rotation.T @ x
    for k in range(3):
        size = (flyer.translation[:, k] ** 2).sum()
        shift[k] = shift[k] / size if size > 0.0 else 0.0
        angle[k] = angle[k] / flyer.inertia[k] if flyer.inertia[k] > 0.0 else 0.0
    return shift, angle


@njit
def _over(value: float, by: float) -> float:
    return value / by if by > 0.0 else 0.0


@njit
def turning_bounds(inertia: Array, spin: Array) -> tuple[float, float, float, float]:
    """The bounds of a `Motion` on rotation, from the conserved energy and angular momentum.

    With 2 E = Σ I w² and L² = Σ I² w²: 2 E bounds the spin across the axis, and 2 E I_x - L² = I_y
    (I_x - I_y) w_y² + I_z (I_x - I_z) w_z², with I_x the greater of the moments across it, the spin
    about it.
    """
    x, y, z = inertia[0], inertia[1], inertia[2]
    twice_energy = (inertia * spin**2).sum()
    across, about = max(x, y), min(x, y)
    tumbling = math.sqrt(max(_over(twice_energy, about), spin[0] ** 2 + spin[1] ** 2))
    squared = _over(twice_energy, z)
    if z < across:
        left = twice_energy * across - ((inertia * spin) ** 2).sum()
        squared = min(squared, _over(max(left, 0.0), z * (across - z)))
    twirling = math.sqrt(max(squared, spin[2] ** 2))
    both, twice = tumbling * twirling, tumbling * tumbling
    swerving = math.sqrt(
        (_over(abs(y - z), x) * both) ** 2
        + (_over(abs(z - x), y) * both) ** 2
        + (0.5 * _over(abs(x - y), z) * twice) ** 2
    )
    # for a point on the axis the effect of a spin about it on the tumbling nearly cancels that on
    # the point
    left_over = max(_over(abs(z - x + y), y), _over(abs(y - z - x), x))
    return tumbling, twirling, swerving, math.hypot(left_over * both, twice)


@njit
def launch(flyer: Flyer, start: Stance, gravity: float, drag: float) -> Motion:
    """The flight from a ``start``; the rigid part of its state moves its pose."""
    position, attitude, u, v = start
    shift, angle = rigid_part(flyer, u)
    speed, spin = rigid_part(flyer, v)
    amounts = np.empty(len(flyer.powers), dtype=np.complex128)
    loud = np.empty(len(flyer.powers))
    for j in range(len(flyer.powers)):
        amounts[j] = flyer.by_u[j] * u[flyer.modes[j]] + flyer.by_v[j] * v[flyer.modes[j]]
        loud[j] = abs(amounts[j])
    rotation = matrix_of(attitude)
    tumbling, twirling, swerving, swinging = turning_bounds(flyer.inertia, spin)
    return Motion(
        position + rotation @ shift,
        rotation @ speed,
        product(attitude, turn(angle)),
        spin,
        gravity,
        drag,
        amounts,
        loud,
        tumbling,
        twirling,
        swerving,
        swinging,
        flyer,
    )


@njit
def centre(motion: Motion, t: float) -> tuple[Array, Array]:
    """Position and velocity (3,) of the centre of mass at ``t``, also before the start."""
    flyer = motion.flyer
    return fallen(motion.position, motion.velocity, motion.gravity, flyer.alpha, t, motion.drag)


@njit
def turned(motion: Motion, t: float) -> tuple[Array, Array]:
    """Attitude (4,), and angular velocity (3,) in body axes, at ``t``."""
    flyer = motion.flyer
    return free_rotation(motion.attitude, motion.spin, flyer.inertia, flyer.alpha, 0.0, t)


@njit
def landing(motion: Motion, t: float) -> Stance:
    """State of the body at ``t``.

    The displacement is only elastic; the velocity includes the rigid one.
    """
    flyer = motion.flyer
    position, velocity = centre(motion, t)
    attitude, spin = turned(motion, t)
    u = np.zeros(len(flyer.omega2))
    v = flyer.translation @ (matrix_of(attitude).T @ velocity) + flyer.rotation @ spin
    for j in range(len(flyer.powers)):
        if motion.loud[j] > 0.0:
            power, wave = flyer.powers[j], motion.amounts[j] * swung(flyer.powers[j], t)
            u[flyer.modes[j]] += wave.real
            v[flyer.modes[j]] += (power * wave).real
    return Stance(position, attitude, u, v)


@njit
def swung(power: complex, t: float) -> complex:
    """exp(``power`` t)."""
    size = math.exp(power.real * t)
    if power.imag == 0.0:
        return complex(size, 0.0)
    return complex(size * math.cos(power.imag * t), size * math.sin(power.imag * t))
