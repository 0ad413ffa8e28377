"""Free flight, compiled: ringing in closed form on a rigid body that falls and turns exactly.

The next touch is found by conservative advancement (Mirtich, PhD thesis, Berkeley 1996): from an
instant with clearance c nothing can touch before c over the greatest speed that any point can have,
so that time is stepped over; a shortest step resolves the fastest oscillation that is left.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..bodies.base import Array
from ..compiled import njit
from ..rigid import fallen, free_rotation, matrix_of, product, turn

Complex = NDArray[np.complex128]
SAMPLES_PER_PERIOD = 16
# Oscillations below this share of the largest do not set the shortest step.
LOUD = 1e-3
# What ringing may be left out of a search; roots and maxima are refined with all but rounding.
TOUCH_SEARCH_M = 1e-8
APEX_SEARCH_M = 5e-7
BISECTIONS = 200
ROUNDING_M = 1e-13
COMPACT_EVERY = 8
LOOKS = 8
GOLDEN_STEPS = 16


class Motion(NamedTuple):
    """A body in flight at its start, in the world's axes; the ringing as complex exponentials.

    ``shapes`` (k, e) times exp(``powers`` t) are the coordinates in which the contact points move:
    their displacements (k = 3 n) where ``rows`` is empty, else displacements are ``rows`` (3 n, k)
    times them. ``tip`` (3, e) is the mean displacement of the end section, ``reach`` (e,) a bound
    on how far each exponential moves any point.
    """

    position: Array
    velocity: Array
    attitude: Array
    spin: Array
    inertia: Array
    gravity: float
    alpha: float
    powers: Complex
    shapes: Complex
    rows: Array
    places: Array
    tip: Complex
    tip_place: Array
    reach: Array


class Flyer(NamedTuple):
    """What flight needs to know of a modal body: see ModalBody and ContactPoints.

    ``along`` (k, modes) are the coordinates in which the points move, ``with_speed`` (k, modes) what
    the velocity adds to them (empty where nothing); displacements are ``rows`` (3 n, k) times these,
    or these themselves where ``rows`` is empty. ``reach`` and ``reach_speed`` (modes,) bound how far
    a unit of each moves any point, ``tip`` (3, modes) is the section's mean displacement.
    """

    omega2: Array
    alpha: float
    beta: float
    translation: Array
    rotation: Array
    inertia: Array
    mass: float
    along: Array
    with_speed: Array
    rows: Array
    reach: Array
    reach_speed: Array
    places: Array
    tip: Array
    tip_place: Array


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
def launch(
    flyer: Flyer, position: Array, attitude: Array, u: Array, v: Array, gravity: float
) -> tuple[Motion, Complex, NDArray[np.int64]]:
    """The flight from a state (u, v) in a pose, and the amounts and modes (e,) of its exponentials.

    The rigid part of (u, v) moves the pose.
    """
    shift, angle = rigid_part(flyer, u)
    speed, spin = rigid_part(flyer, v)
    start = position + matrix_of(attitude) @ shift
    turned = product(attitude, turn(angle))
    powers, amounts, modes = exponentials(flyer.omega2, flyer.alpha, flyer.beta, u, v)
    k, e = len(flyer.along), len(powers)
    shapes = np.empty((k, e), dtype=np.complex128)
    tip = np.empty((3, e), dtype=np.complex128)
    reach = np.empty(e)
    quick = flyer.with_speed.size > 0
    for j in range(e):
        mode = modes[j]
        reach[j] = abs(amounts[j]) * flyer.reach[mode]
        if quick:
            reach[j] += abs(amounts[j] * powers[j]) * flyer.reach_speed[mode]
        for c in range(3):
            tip[c, j] = flyer.tip[c, mode] * amounts[j]
    for i in range(k):
        for j in range(e):
            value = flyer.along[i, modes[j]] * amounts[j]
            if quick:
                value += flyer.with_speed[i, modes[j]] * powers[j] * amounts[j]
            shapes[i, j] = value
    motion = Motion(
        start,
        matrix_of(attitude) @ speed,
        turned,
        spin,
        flyer.inertia,
        gravity,
        flyer.alpha,
        powers,
        shapes,
        flyer.rows,
        flyer.places,
        tip,
        flyer.tip_place,
        reach,
    )
    return motion, amounts, modes


@njit
def exponentials(
    omega2: Array, alpha: float, beta: float, u: Array, v: Array
) -> tuple[Complex, Complex, NDArray[np.int64]]:
    """Powers, amounts and modes (e,) such that u_i(t) = Re Σ amount exp(power t) of mode i.

    Under- and overdamped modes alike; rigid ones (ω² = 0) are left out.
    """
    n = len(omega2)
    powers = np.empty(2 * n, dtype=np.complex128)
    amounts = np.empty(2 * n, dtype=np.complex128)
    modes = np.empty(2 * n, dtype=np.int64)
    count = 0
    for i in range(n):
        if omega2[i] == 0.0 or (u[i] == 0.0 and v[i] == 0.0):
            continue
        damping = alpha + beta * omega2[i]
        inside = damping * damping - 4.0 * omega2[i]
        # critically damped modes have no second exponential; split roots err by the split squared
        if abs(inside) < 1e-12 * damping * damping:
            inside = 1e-12 * damping * damping
        if inside < 0.0:
            power = complex(-0.5 * damping, 0.5 * math.sqrt(-inside))
            powers[count] = power
            amounts[count] = complex(u[i], -(v[i] - power.real * u[i]) / power.imag)
            modes[count] = i
            count += 1
            continue
        fast = -0.5 * (damping + math.sqrt(inside))
        slow = omega2[i] / fast  # free of cancellation
        part = (v[i] - slow * u[i]) / (fast - slow)
        powers[count], amounts[count], modes[count] = fast, part, i
        powers[count + 1], amounts[count + 1], modes[count + 1] = slow, u[i] - part, i
        count += 2
    return powers[:count], amounts[:count], modes[:count]


@njit
def _waves(powers: Complex, t: float) -> Complex:
    out = np.empty(len(powers), dtype=np.complex128)
    for i in range(len(powers)):
        size = math.exp(powers[i].real * t)
        out[i] = complex(size * math.cos(powers[i].imag * t), size * math.sin(powers[i].imag * t))
    return out


@njit
def _real_product(shapes: Complex, waves: Complex) -> Array:
    out = np.zeros(len(shapes))
    for i in range(len(shapes)):
        total = 0.0
        for e in range(len(waves)):
            total += shapes[i, e].real * waves[e].real - shapes[i, e].imag * waves[e].imag
        out[i] = total
    return out


@njit
def displacements(motion: Motion, t: float) -> Array:
    """Elastic displacement of every point (n, 3) in body axes, ``t`` after the start."""
    moved = _real_product(motion.shapes, _waves(motion.powers, t))
    if motion.rows.size:
        moved = motion.rows @ moved
    return moved.reshape(-1, 3)


@njit
def lowest(motion: Motion, normals: Array, offsets: Array, t: float, attitude: Array) -> float:
    """The smallest clearance of any point from its plane."""
    position, _ = fallen(motion.position, motion.velocity, motion.gravity, motion.alpha, t)
    rotation = matrix_of(attitude)
    moved = displacements(motion, t)
    least = math.inf
    for i in range(len(motion.places)):
        clearance = -offsets[i]
        for k in range(3):
            at = position[k]
            for m in range(3):
                at += rotation[k, m] * (motion.places[i, m] + moved[i, m])
            clearance += normals[i, k] * at
        least = min(least, clearance)
    return least


@njit
def tip_height(motion: Motion, t: float, attitude: Array) -> float:
    """Height of the middle of the end section."""
    position, _ = fallen(motion.position, motion.velocity, motion.gravity, motion.alpha, t)
    moved = _real_product(motion.tip, _waves(motion.powers, t))
    rotation = matrix_of(attitude)
    height = position[2]
    for m in range(3):
        height += rotation[2, m] * (motion.tip_place[m] + moved[m])
    return float(height)


@njit
def resolving(motion: Motion, t: float) -> float:
    """A time that resolves the fastest motion that is not much quieter than the largest."""
    largest = 0.0
    for e in range(len(motion.powers)):
        largest = max(largest, motion.reach[e] * math.exp(motion.powers[e].real * t))
    fastest = math.sqrt(motion.spin[0] ** 2 + motion.spin[1] ** 2 + motion.spin[2] ** 2)
    for e in range(len(motion.powers)):
        swing = motion.reach[e] * math.exp(motion.powers[e].real * t)
        if swing > LOUD * largest:
            fastest = max(fastest, abs(motion.powers[e].imag))
    return 2.0 * math.pi / fastest / SAMPLES_PER_PERIOD if fastest > 0.0 else math.inf


@njit
def safe_time(motion: Motion, t: float, way: float) -> float:
    """A time in which no point moves by more than ``way``.

    Slow exponentials move at their speed; fast ones by twice their reach and no more, whatever the
    time. Which count as fast is chosen to make the time longest: ``powers`` rise in size.
    """
    _, velocity = fallen(motion.position, motion.velocity, motion.gravity, motion.alpha, t)
    limit = math.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2)
    far, wide = 0.0, 0.0
    for i in range(len(motion.places)):
        wide = max(wide, math.hypot(motion.places[i, 0], motion.places[i, 1]))
        far = max(far, abs(motion.places[i, 2]))
    tumbling = math.hypot(motion.spin[0], motion.spin[1])
    limit += tumbling * math.hypot(far, wide) + abs(motion.spin[2]) * wide
    fast = 0.0
    for e in range(len(motion.powers)):
        fast += 2.0 * motion.reach[e] * math.exp(motion.powers[e].real * t)
    longest = 0.0
    for e in range(len(motion.powers) + 1):
        left = way - fast
        if left > 0.0:
            time = 2.0 * left / (limit + math.sqrt(limit * limit + 2.0 * motion.gravity * left))
            longest = max(longest, time)
        if e < len(motion.powers):
            swing = motion.reach[e] * math.exp(motion.powers[e].real * t)
            fast -= 2.0 * swing
            limit += swing * abs(motion.powers[e])
    return longest


@njit
def without_quiet(motion: Motion, t: float, allowed: float) -> Motion:
    """The motion from ``t`` on without exponentials that together move nothing by ``allowed``.

    The others come out by rising size of their powers.
    """
    swing = motion.reach.copy()
    for e in range(len(swing)):
        swing[e] *= math.exp(motion.powers[e].real * t)
    order = np.argsort(swing)
    total, dropped = 0.0, 0
    for e in order:
        total += swing[e]
        if total > allowed:
            break
        dropped += 1
    keep = order[dropped:]
    keep = keep[np.argsort(np.abs(motion.powers[keep]))]
    return Motion(
        motion.position,
        motion.velocity,
        motion.attitude,
        motion.spin,
        motion.inertia,
        motion.gravity,
        motion.alpha,
        motion.powers[keep],
        np.ascontiguousarray(motion.shapes[:, keep]),
        motion.rows,
        motion.places,
        np.ascontiguousarray(motion.tip[:, keep]),
        motion.tip_place,
        motion.reach[keep],
    )


@njit
def _attitude(motion: Motion, attitude: Array, spin: Array, start: float, end: float) -> Array:
    return free_rotation(attitude, spin, motion.inertia, motion.alpha, start, end)[0]


@njit
def next_touch(motion: Motion, normals: Array, offsets: Array, until: float) -> float:
    """The first time in (0, ``until``] at which a point comes down through its plane, or infinity.

    A point that starts below its plane, on its way up, touches when it turns down before it got
    out.
    """
    t = 0.0
    attitude, spin = motion.attitude, motion.spin
    some = without_quiet(motion, t, TOUCH_SEARCH_M)
    clear = lowest(some, normals, offsets, t, attitude)
    above = False
    count = 0
    shortest = min(resolving(some, t), until / 8.0)
    while t < until:
        if count == COMPACT_EVERY:
            some = without_quiet(some, t, 0.1 * TOUCH_SEARCH_M)
            shortest = min(resolving(some, t), until / 8.0)
            count = 0
        count += 1
        step = max(shortest, safe_time(some, t, clear))
        later = min(t + step, until)
        turned, spun = free_rotation(attitude, spin, motion.inertia, motion.alpha, t, later)
        then = lowest(some, normals, offsets, later, turned)
        above = above or clear > 0.0
        if above and then <= 0.0:
            near = without_quiet(motion, t, ROUNDING_M)
            return _root(near, normals, offsets, t, later, attitude, spin)
        if not above and then < clear:
            return later
        t, clear, attitude, spin = later, then, turned, spun
    return math.inf


@njit
def _root(
    motion: Motion,
    normals: Array,
    offsets: Array,
    left: float,
    right: float,
    attitude: Array,
    spin: Array,
) -> float:
    """Where the lowest clearance falls through zero in [left, right], by the Illinois method.

    ``attitude`` and ``spin`` are those at ``left``.
    """
    start = left
    high = lowest(motion, normals, offsets, left, attitude)
    low = lowest(motion, normals, offsets, right, _attitude(motion, attitude, spin, start, right))
    if high <= 0.0:
        return left
    if low >= 0.0:
        return right
    side = 0
    for _ in range(BISECTIONS):
        middle = left + (right - left) * high / (high - low)
        if not left < middle < right:
            middle = 0.5 * (left + right)
        value = lowest(
            motion, normals, offsets, middle, _attitude(motion, attitude, spin, start, middle)
        )
        if value == 0.0 or right - left <= 4e-16 * right:
            return middle
        if value > 0.0:
            left, high = middle, value
            if side == 1:
                low *= 0.5
            side = 1
        else:
            right, low = middle, value
            if side == -1:
                high *= 0.5
            side = -1
    return right


@njit
def _rigid_apex(motion: Motion, until: float) -> float:
    """When the centre of mass is highest in [0, ``until``]."""
    speed = motion.velocity[2]
    if speed <= 0.0:
        return 0.0
    if motion.alpha == 0.0:
        return min(speed / motion.gravity, until)
    return min(math.log1p(motion.alpha * speed / motion.gravity) / motion.alpha, until)


@njit
def apex(motion: Motion, until: float) -> tuple[float, float]:
    """Time and height of the highest place of the tip in [0, ``until``].

    Times from which the height could not reach the best so far are stepped over. A first look at
    equal times and around the centre's own apex makes the best good from the start.
    """
    some = without_quiet(motion, 0.0, APEX_SEARCH_M)
    shortest = min(resolving(some, 0.0), until / 64.0)
    best, best_t, width = -math.inf, 0.0, until / LOOKS
    top = _rigid_apex(motion, until)
    for look in range(2):
        attitude, spin, t = motion.attitude, motion.spin, 0.0
        start, spacing = 0.0, until / LOOKS
        if look:
            start, spacing = max(best_t - until / LOOKS, 0.0), 2.0 * until / LOOKS / LOOKS
        if not look:
            turned = _attitude(motion, attitude, spin, 0.0, top)
            best, best_t = tip_height(some, top, turned), top
        for i in range(LOOKS + 1):
            later = min(start + i * spacing, until)
            attitude, spin = free_rotation(attitude, spin, motion.inertia, motion.alpha, t, later)
            t = later
            height = tip_height(some, t, attitude)
            if height > best:
                best, best_t, width = height, t, spacing
    attitude, spin, t = motion.attitude, motion.spin, 0.0
    height = tip_height(some, t, attitude)
    count = 0
    while t < until:
        if count == COMPACT_EVERY:
            some = without_quiet(some, t, 0.1 * APEX_SEARCH_M)
            shortest = min(resolving(some, t), until / 64.0)
            count = 0
        count += 1
        step = max(shortest, safe_time(some, t, best - height))
        later = min(t + step, until)
        attitude, spin = free_rotation(attitude, spin, motion.inertia, motion.alpha, t, later)
        height = tip_height(some, later, attitude)
        if height > best:
            best, best_t, width = height, later, step
        t = later
    near = without_quiet(motion, max(best_t - width, 0.0), ROUNDING_M)
    return _refined(near, max(best_t - width, 0.0), best_t, min(best_t + width, until))


@njit
def _refined(motion: Motion, left: float, best: float, right: float) -> tuple[float, float]:
    """Time and height of the highest place between ``left`` and ``right``, by golden section."""
    start = left
    attitude, spin = free_rotation(
        motion.attitude, motion.spin, motion.inertia, motion.alpha, 0.0, start
    )
    exact = tip_height(motion, best, _attitude(motion, attitude, spin, start, best))
    golden = 0.5 * (math.sqrt(5.0) - 1.0)
    a, b = right - golden * (right - left), left + golden * (right - left)
    at_a = tip_height(motion, a, _attitude(motion, attitude, spin, start, a))
    at_b = tip_height(motion, b, _attitude(motion, attitude, spin, start, b))
    for _ in range(GOLDEN_STEPS):
        if at_a >= at_b:
            right, b, at_b = b, a, at_a
            a = right - golden * (right - left)
            at_a = tip_height(motion, a, _attitude(motion, attitude, spin, start, a))
        else:
            left, a, at_a = a, b, at_b
            b = left + golden * (right - left)
            at_b = tip_height(motion, b, _attitude(motion, attitude, spin, start, b))
    middle = 0.5 * (left + right)
    at = tip_height(motion, middle, _attitude(motion, attitude, spin, start, middle))
    return (best, exact) if exact > at else (middle, at)


@njit
def trace(motion: Motion, normals: Array, offsets: Array, times: Array) -> Array:
    """Heights of the tip's middle and of the centre, and the lowest clearance at times (k,)."""
    out = np.empty((len(times), 3))
    attitude, spin, before = motion.attitude, motion.spin, 0.0
    for i in range(len(times)):
        t = times[i]
        attitude, spin = free_rotation(attitude, spin, motion.inertia, motion.alpha, before, t)
        before = t
        centre, _ = fallen(motion.position, motion.velocity, motion.gravity, motion.alpha, t)
        out[i, 0] = tip_height(motion, t, attitude)
        out[i, 1] = centre[2]
        out[i, 2] = lowest(motion, normals, offsets, t, attitude)
    return out


@njit
def landing(
    flyer: Flyer, motion: Motion, amounts: Complex, modes: NDArray[np.int64], t: float
) -> tuple[Array, Array, Array, Array]:
    """Position and attitude at ``t``, and displacement and velocity (modes,) on top of them.

    The displacement is elastic alone; the velocity has the rigid one too.
    """
    position, velocity = fallen(motion.position, motion.velocity, motion.gravity, motion.alpha, t)
    attitude, spin = free_rotation(
        motion.attitude, motion.spin, motion.inertia, motion.alpha, 0.0, t
    )
    u, v = np.zeros(len(flyer.omega2)), np.zeros(len(flyer.omega2))
    waves = _waves(motion.powers, t)
    for e in range(len(waves)):
        wave = amounts[e] * waves[e]
        u[modes[e]] += wave.real
        v[modes[e]] += (motion.powers[e] * wave).real
    v += flyer.translation @ (matrix_of(attitude).T @ velocity)
    v += flyer.rotation @ spin
    return position, attitude, u, v
