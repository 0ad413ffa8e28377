"""Start and end of a free flight. Compiled.

It falls and turns exactly, as a rigid body; ringing is in closed form on top.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..compiled import njit
from ..rigid import fallen, free_rotation, matrix_of, product, turn

Complex = NDArray[np.complex128]


class Flyer(NamedTuple):
    """What flight needs to know of a modal body: see ModalBody and ContactPoints.

    ``along`` (k, modes) are the coordinates in which the points move, ``with_speed`` (k, modes)
    what the velocity adds to them (empty where nothing); displacements are ``rows`` (3 n, k) times
    these, or these themselves where ``rows`` is empty. ``damping`` (modes,) is each one's own,
    ``alpha`` that of rigid motion too, ``tip`` (3, modes) is the section's mean displacement.
    """

    omega2: Array
    alpha: float
    damping: Array
    translation: Array
    rotation: Array
    inertia: Array
    along: Array
    with_speed: Array
    rows: Array
    places: Array
    tip: Array
    tip_place: Array


class Chart(NamedTuple):
    """What every flight of a `Flyer` has in common.

    The exponentials (e,) of its elastic modes by rising size of their ``powers``: mode i moves by
    u_i(t) = Re Σ amount exp(power t) over those with ``modes`` = i, an amount being
    ``by_u`` u_i(0) + ``by_v`` v_i(0). A unit of such an amount moves no point by more than
    ``reach``, along the axis ``reach_up``.

    Searches see the section as rigid: ``fit`` and ``fit_speed`` (6, modes) are the coordinates of
    the rigid motion nearest to that of its points, ``stiff`` (3 n, 6) how these move with it,
    ``rest`` (e,) bounds what that leaves out.
    """

    powers: Complex
    modes: NDArray[np.int64]
    by_u: Complex
    by_v: Complex
    reach: Array
    reach_up: Array
    rest: Array
    fit: Array
    fit_speed: Array
    stiff: Array


class Motion(NamedTuple):
    """A body in flight at its start, in the world's axes; the ringing as complex exponentials.

    ``amounts`` times exp(``powers`` t) (e,) are those of ``modes``, by rising size of the powers.
    ``reach`` (e,) bounds how far each moves any point, ``reach_up`` along the axis alone and
    ``rest`` how far other than rigidly.
    """

    position: Array
    velocity: Array
    attitude: Array
    spin: Array
    gravity: float
    powers: Complex
    amounts: Complex
    modes: NDArray[np.int64]
    reach: Array
    reach_up: Array
    rest: Array
    flyer: Flyer
    chart: Chart


@njit
def rigid_part(flyer: Flyer, x: Array) -> tuple[Array, Array]:
    """Translation and rotation (3,) in body axes that modal coordinates ``x`` hold."""
    shift, angle = np.zeros(3), np.zeros(3)
    for k in range(3):
        size = 0.0
        for j in range(len(x)):
            shift[k] += flyer.translation[j, k] * x[j]
            angle[k] += flyer.rotation[j, k] * x[j]
            size += flyer.translation[j, k] ** 2
        shift[k] = shift[k] / size if size > 0.0 else 0.0
        angle[k] = angle[k] / flyer.inertia[k] if flyer.inertia[k] > 0.0 else 0.0
    return shift, angle


@njit
def _exponentials(
    omega2: Array, dampings: Array
) -> tuple[Complex, NDArray[np.int64], Complex, Complex]:
    """``powers``, ``modes``, ``by_u`` and ``by_v`` of a chart; rigid modes are left out."""
    n = len(omega2)
    powers = np.empty(2 * n, dtype=np.complex128)
    by_u, by_v = np.empty_like(powers), np.empty_like(powers)
    modes = np.empty(2 * n, dtype=np.int64)
    count = 0
    for i in range(n):
        if omega2[i] == 0.0:
            continue
        damping = dampings[i]
        inside = damping * damping - 4.0 * omega2[i]
        # critically damped modes have no second exponential; split roots err by the split squared
        if abs(inside) < 1e-12 * damping * damping:
            inside = 1e-12 * damping * damping
        modes[count] = i
        if inside < 0.0:
            power = complex(-0.5 * damping, 0.5 * math.sqrt(-inside))
            powers[count] = power
            by_u[count] = complex(1.0, power.real / power.imag)
            by_v[count] = complex(0.0, -1.0 / power.imag)
            count += 1
            continue
        fast = -0.5 * (damping + math.sqrt(inside))
        slow = omega2[i] / fast  # free of cancellation
        powers[count], powers[count + 1], modes[count + 1] = fast, slow, i
        by_u[count], by_v[count] = -slow / (fast - slow), 1.0 / (fast - slow)
        by_u[count + 1], by_v[count + 1] = fast / (fast - slow), -1.0 / (fast - slow)
        count += 2
    order = np.argsort(np.abs(powers[:count]))
    return powers[order], modes[order], by_u[order], by_v[order]


@njit
def rigid_rows(places: Array) -> Array:
    """Displacements (3 n, 6) of points by translations along x, y, z and rotations about them."""
    n = len(places)
    rows = np.zeros((3 * n, 6))
    for i in range(n):
        x = places[i, 0] - places[:, 0].mean()
        y = places[i, 1] - places[:, 1].mean()
        z = places[i, 2] - places[:, 2].mean()
        rows[3 * i, 0] = rows[3 * i + 1, 1] = rows[3 * i + 2, 2] = 1.0
        rows[3 * i + 1, 3], rows[3 * i + 2, 3] = -z, y
        rows[3 * i, 4], rows[3 * i + 2, 4] = z, -x
        rows[3 * i, 5], rows[3 * i + 1, 5] = -y, x
    return rows


@njit
def _greatest(moved: Array, first: int) -> Array:
    """Greatest displacement of any point (modes,) by rows (3 n, modes), from axis ``first`` on."""
    out = np.zeros(moved.shape[1])
    for j in range(moved.shape[1]):
        for i in range(len(moved) // 3):
            squared = 0.0
            for c in range(first, 3):
                squared += moved[3 * i + c, j] ** 2
            out[j] = max(out[j], math.sqrt(squared))
    return out


@njit
def _left_over(moved: Array, fitted: Array) -> Array:
    """Greatest displacement (modes,) beyond what was fitted; zero where that is rounding."""
    beyond, whole = _greatest(moved - fitted, 0), _greatest(moved, 0)
    return np.where(beyond > 1e-12 * whole, beyond, 0.0)


@njit
def chart(flyer: Flyer) -> Chart:
    """The chart of a flyer."""
    powers, modes, by_u, by_v = _exponentials(flyer.omega2, flyer.damping)
    moved = flyer.rows @ flyer.along if flyer.rows.size else flyer.along
    stiff = rigid_rows(flyer.places)
    nearest = np.linalg.pinv(stiff)
    fit: Array = nearest @ moved
    fit_speed: Array = np.zeros((0, 0))
    # where points stand for their approach, the tip, whose height counts too, may move further
    reach = np.maximum(_greatest(moved, 0), _greatest(flyer.tip, 0))[modes]
    reach_up = np.maximum(_greatest(moved, 2), _greatest(flyer.tip, 2))[modes]
    rest = _left_over(moved, stiff @ fit)[modes]
    if flyer.with_speed.size:
        quick, size = flyer.with_speed, np.abs(powers)
        fit_speed = nearest @ quick
        reach = reach + size * _greatest(quick, 0)[modes]
        reach_up = reach_up + size * _greatest(quick, 2)[modes]
        rest = rest + size * _left_over(quick, stiff @ fit_speed)[modes]
    return Chart(powers, modes, by_u, by_v, reach, reach_up, rest, fit, fit_speed, stiff)


@njit
def launch(
    table: Chart, flyer: Flyer, position: Array, attitude: Array, u: Array, v: Array, gravity: float
) -> Motion:
    """The flight from a state (u, v) in a pose, whose rigid part moves the pose."""
    shift, angle = rigid_part(flyer, u)
    speed, spin = rigid_part(flyer, v)
    start = position + matrix_of(attitude) @ shift
    turned = product(attitude, turn(angle))
    e = len(table.powers)
    powers, amounts = np.empty(e, dtype=np.complex128), np.empty(e, dtype=np.complex128)
    modes = np.empty(e, dtype=np.int64)
    reach, reach_up, rest = np.empty(e), np.empty(e), np.empty(e)
    count = 0
    for j in range(e):
        mode = table.modes[j]
        if u[mode] == 0.0 and v[mode] == 0.0:
            continue
        amount = table.by_u[j] * u[mode] + table.by_v[j] * v[mode]
        size = math.sqrt(amount.real * amount.real + amount.imag * amount.imag)
        powers[count], amounts[count], modes[count] = table.powers[j], amount, mode
        reach[count] = size * table.reach[j]
        reach_up[count] = size * table.reach_up[j]
        rest[count] = size * table.rest[j]
        count += 1
    return Motion(
        start,
        matrix_of(attitude) @ speed,
        turned,
        spin,
        gravity,
        powers[:count],
        amounts[:count],
        modes[:count],
        reach[:count],
        reach_up[:count],
        rest[:count],
        flyer,
        table,
    )


@njit
def top_of_centre(motion: Motion, until: float) -> tuple[float, float]:
    """Time and height of the highest place of the centre of mass in [0, ``until``]."""
    speed, gravity, alpha = motion.velocity[2], motion.gravity, motion.flyer.alpha
    rise = 0.0
    if speed > 0.0:
        rise = speed / gravity if alpha == 0.0 else math.log1p(alpha * speed / gravity) / alpha
    top = min(rise, until)
    return top, fallen(motion.position, motion.velocity, gravity, alpha, top)[0][2]


@njit
def landing(motion: Motion, t: float) -> tuple[Array, Array, Array, Array]:
    """Position and attitude at ``t``, and displacement and velocity (modes,) on top of them.

    The displacement is elastic alone; the velocity has the rigid one too.
    """
    flyer, amounts, modes = motion.flyer, motion.amounts, motion.modes
    position, velocity = fallen(motion.position, motion.velocity, motion.gravity, flyer.alpha, t)
    attitude, spin = free_rotation(motion.attitude, motion.spin, flyer.inertia, flyer.alpha, 0.0, t)
    u, v = np.zeros(len(flyer.omega2)), np.zeros(len(flyer.omega2))
    for e in range(len(motion.powers)):
        power = motion.powers[e]
        size = math.exp(power.real * t)
        wave = complex(size * math.cos(power.imag * t), size * math.sin(power.imag * t))
        wave = amounts[e] * wave
        u[modes[e]] += wave.real
        v[modes[e]] += (power * wave).real
    v += flyer.translation @ (matrix_of(attitude).T @ velocity)
    v += flyer.rotation @ spin
    return position, attitude, u, v
