"""Many drops of one body at once, in compiled code: what `drop.simulate` does, without histories.

Bodies in modes under the conserving scheme and a law that acts on gaps. Each drop has its own lean,
height, ground, stiffness and friction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .bodies.base import Array
from .compiled import njit
from .contact.step import Points
from .drop import TOUCH_LIMIT, WAIT_STEPS
from .errors import ComputationError
from .ground import local_frames
from .impact import STEP_LIMIT, compiled
from .rigid import leaning, matrix_of
from .time import ballistics, modal_march
from .time.ballistics import Flyer, apex, landing, launch, next_touch
from .time.flight import flyer
from .time.march import Marcher
from .time.modal_march import Modes, Touching, march

FAILURES = {
    modal_march.NOT_CONVERGED: "the contact forces did not converge; shorten the ITS",
    modal_march.NOT_FINITE: "the motion is not finite; shorten the ITS",
    modal_march.TOO_LONG: f"still in contact after {STEP_LIMIT} steps",
}


@dataclass(frozen=True)
class Drops:
    """What differs between drops, arrays of one entry (or row) a drop.

    ``normals`` (drops, points, 3) and ``rises_m`` (drops, points) are the ground's planes under the
    tip: each passes through its point of the end section, raised by ``rises_m``; the ground as a
    whole is moved until the first point touches. ``scale`` (drops, points) is the stiffness there
    over ``kn_N_m``.
    """

    height_m: Array
    tilt_deg: Array
    tilt_wide_deg: Array
    kn_N_m: Array
    mu: Array
    normals: Array
    rises_m: Array
    scale: Array

    def __len__(self) -> int:
        return len(self.height_m)

    def part(self, first: int, last: int) -> Drops:
        """Drops ``first`` to ``last`` - 1."""
        return Drops(
            **{field.name: getattr(self, field.name)[first:last] for field in fields(self)}
        )

    @classmethod
    def on_plane(
        cls,
        n_points: int,
        *,
        height_m: Array | float,
        kn_N_m: Array | float,
        tilt_deg: Array | float = 0.0,
        tilt_wide_deg: Array | float = 0.0,
        mu: Array | float = 0.0,
    ) -> Drops:
        """Drops onto a horizontal plane; numbers serve all, arrays (drops,) are taken in turn."""
        values = np.broadcast_arrays(height_m, tilt_deg, tilt_wide_deg, kn_N_m, mu)
        columns = [np.array(value, dtype=float).reshape(-1) for value in values]
        n = len(columns[0])
        normals = np.zeros((n, n_points, 3))
        normals[..., 2] = 1.0
        return cls(*columns, normals, np.zeros((n, n_points)), np.ones((n, n_points)))


class Outcome(NamedTuple):
    """What one drop gave, or arrays of it: names and units as in `drop.DropResult`."""

    rebound_height_m: Array
    cm_rebound_height_m: Array
    cm_velocity_after_m_s: Array
    contact_time_s: Array
    n_contacts: Array
    peak_force_N: Array
    impulse_N_s: Array
    spin_x_rad_s: Array
    spin_y_rad_s: Array
    spin_z_rad_s: Array
    material_loss_J: Array
    friction_loss_J: Array
    contact_loss_J: Array
    closure_relative: Array
    n_steps: Array


@njit
def _plane_offsets(normals: Array, rises: Array, rotation: Array, places: Array) -> Array:
    """Offsets (n,) of planes through the points of a body in the origin, the first just touching."""
    n = len(places)
    offsets = np.empty(n)
    clear = math.inf
    for i in range(n):
        at = rotation @ places[i]
        # the plane under the point lies where a flat ground would, raised
        height = rises[i]
        offsets[i] = normals[i, 0] * at[0] + normals[i, 1] * at[1] + normals[i, 2] * height
        gap = normals[i, 0] * at[0] + normals[i, 1] * at[1] + normals[i, 2] * at[2] - offsets[i]
        clear = min(clear, gap / normals[i, 2])
    for i in range(n):
        offsets[i] += clear * normals[i, 2]
    return offsets


@njit
def _top_of_centre(
    position: Array, velocity: Array, gravity: float, alpha: float, t: float
) -> float:
    speed = velocity[2]
    rise = 0.0
    if speed > 0.0:
        rise = speed / gravity if alpha == 0.0 else math.log1p(alpha * speed / gravity) / alpha
    return float(ballistics.fallen(position, velocity, gravity, alpha, min(rise, t))[0][2])


@njit
def _energy(omega2: Array, u: Array, v: Array, weight: float, height: float) -> float:
    total = weight * height
    for j in range(len(u)):
        total += 0.5 * (v[j] * v[j] + omega2[j] * u[j] * u[j])
    return total


@njit
def one_drop(
    modes: Modes,
    flyer: Flyer,
    points: Points,
    attitude: Array,
    height: float,
    normals: Array,
    rises: Array,
    gravity: float,
    out: Array,
) -> int:
    """Write what one drop gives to ``out``, in the order of `Outcome`; the status of the march."""
    n, m = len(modes.weights), len(modes.omega2)
    alpha, beta = flyer.alpha, flyer.beta
    speed = math.sqrt(2.0 * gravity * height)
    position = np.zeros(3)
    rotation = matrix_of(attitude)
    offsets = _plane_offsets(normals, rises, rotation, flyer.places)
    datum = 0.0
    for k in range(3):
        datum += rotation[2, k] * flyer.tip_place[k]
    far = np.abs(flyer.places[:, 2]).max()
    u = np.zeros(m)
    v = -speed * (flyer.translation @ rotation[2])
    initial = modes.mass * gravity * height
    top = centre_top = -math.inf
    loss = rubbed = spent = impulse = peak = 0.0
    first = -1.0
    last = now = wait = 0.0
    touches = steps = 0
    placed = True
    weight = modes.mass * gravity
    frames, gaps = local_frames(normals, offsets, position, rotation, flyer.places)
    for _ in range(TOUCH_LIMIT):
        if not placed:
            rotation = matrix_of(attitude)
            frames, gaps = local_frames(normals, offsets, position, rotation, flyer.places)
        touching = Touching(points, frames, gaps, rotation[2].copy(), 0.0, 0.0, gravity)
        done = march(
            modes, touching, u, v, max(wait - now, 0.0), math.inf, STEP_LIMIT, False, False
        )
        if done.status != modal_march.RELEASED:
            return done.status
        steps += done.count
        loss += done.material_loss
        rubbed += done.friction_loss
        spent += done.contact_loss
        if done.impulse > 0.0:
            touches += 1
            impulse += done.impulse
            peak = max(peak, done.peak)
            if first < 0.0:
                first = now
            last = now + done.release
        now += done.count * modes.its
        motion, amounts, which = launch(flyer, position, attitude, done.u, done.v, gravity)
        rising = motion.velocity[2]
        ringing = motion.reach.sum()
        longest = 2.0 * max(rising, 0.0) / gravity + math.sqrt(8.0 * ringing / gravity) + 1e-3
        longest += 2.0 * math.sqrt(8.0 * far / gravity)
        after = min(next_touch(motion, normals, offsets, longest), longest)
        falls = ballistics.fallen(motion.position, motion.velocity, gravity, alpha, after)[1][2]
        ends = rising > 0.0 and falls <= 0.0
        if not ends and after < WAIT_STEPS * modes.its:
            u, v, wait = done.u, done.v, now + after
            placed = True
            continue
        top = max(top, apex(motion, after)[1] - datum)
        centre_top = max(
            centre_top,
            _top_of_centre(motion.position, motion.velocity, gravity, alpha, after),
        )
        if ends:
            break
        before = _energy(modes.omega2, done.u, done.v, weight, 0.0)
        before += weight * (position[2] + (rotation @ ballistics.rigid_part(flyer, done.u)[0])[2])
        position, attitude, u, v = landing(flyer, motion, amounts, which, after)
        if alpha > 0.0 or beta > 0.0:
            loss += before - _energy(modes.omega2, u, v, weight, position[2])
        now += after
        wait = now
        placed = False
    else:
        return modal_march.TOO_LONG
    left = _energy(modes.omega2, done.u, done.v, weight, motion.position[2])
    back = last - now
    out[0], out[1] = top, centre_top
    out[2] = ballistics.fallen(motion.position, motion.velocity, gravity, alpha, back)[1][2]
    out[3], out[4], out[5], out[6] = last - first, touches, peak, impulse
    out[7], out[8], out[9] = motion.spin[0], motion.spin[1], motion.spin[2]
    out[10], out[11] = loss, rubbed
    out[12] = spent
    out[13] = abs(initial - left - loss - rubbed - spent) / initial
    out[14] = steps
    return modal_march.RELEASED


@njit
def many_drops(
    modes: Modes,
    flyer: Flyer,
    points: Points,
    kt_over_kn: float,
    gravity: float,
    kn: Array,
    mu: Array,
    attitude: Array,
    height: Array,
    normals: Array,
    rises: Array,
    scale: Array,
    out: Array,
    status: NDArray[np.int64],
) -> None:
    """`one_drop` for every entry, ``out`` (drops, …) and ``status`` (drops,) written."""
    for i in range(len(height)):
        law = points.law.copy()
        law[1] = kn[i]
        own = Points(
            law,
            kt_over_kn * kn[i],
            mu[i],
            scale[i],
            points.series,
            points.weights,
            points.end_weight,
            points.soft,
            points.drag,
        )
        status[i] = one_drop(
            modes,
            flyer,
            own,
            attitude[i],
            height[i],
            normals[i],
            rises[i],
            gravity,
            out[i],
        )


def drop_many(marcher: Marcher, drops: Drops) -> Outcome:
    """Every drop, of ``marcher``'s body at its ITS; arrays (drops,) in `Outcome`.

    The marcher's law gives all but Kn, its friction all but μ. Raises ComputationError where the
    marcher's method is not one for compiled code, or a drop fails, which it names.
    """
    if not compiled(marcher):
        raise ComputationError(
            "many drops at once need a body in modes, the conserving scheme, and penalty or the "
            "augmented Lagrangian at a finite Kn"
        )
    modes, touching = marcher.tables()
    attitude = np.array(
        [leaning(*pair) for pair in zip(drops.tilt_deg, drops.tilt_wide_deg, strict=True)]
    ).reshape(-1, 4)
    out = np.zeros((len(drops), len(Outcome._fields)))
    status = np.zeros(len(drops), dtype=np.int64)
    if marcher.body.alpha_1_s:
        raise ComputationError("many drops at once need alpha = 0")
    many_drops(
        modes,
        flyer(marcher.body),
        touching.points,
        marcher.method.friction.kt_over_kn,
        marcher.gravity_m_s2,
        np.ascontiguousarray(drops.kn_N_m),
        np.ascontiguousarray(drops.mu),
        attitude,
        np.ascontiguousarray(drops.height_m),
        np.ascontiguousarray(drops.normals),
        np.ascontiguousarray(drops.rises_m),
        np.ascontiguousarray(drops.scale),
        out,
        status,
    )
    failed = np.flatnonzero(status != modal_march.RELEASED)
    if len(failed):
        raise ComputationError(f"drop {failed[0]}: {FAILURES[int(status[failed[0]])]}")
    return Outcome(*out.T)
