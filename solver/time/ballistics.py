"""Free flight, compiled: ringing in closed form on a rigid body that falls and turns exactly.

The next touch is found by conservative advancement (Mirtich, PhD thesis, Berkeley 1996): an instant
with clearance c, rate c' and a bound M on the second derivative is followed by a time in which
c + c' t - ½ M t² stays positive, which is stepped over. Ringing that cannot reach the ground is not
evaluated: it lessens the clearance by its bound. A shortest step resolves the fastest oscillation
that is left. The apex is the touch with a ceiling at the best height so far.
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
APEX_SEARCH_M = 5e-8
# How far a maximum may rise between two samples that look for it.
APEX_SAG_M = 1e-7
# Ringing stays out of sight while it is less than this share of the clearance.
OUT_OF_SIGHT = 0.25
ROOT_STEPS = 100
ROUNDING_M = 1e-13
COMPACT_EVERY = 8
LOOKS = 8
# Samples are taken eight at a time, this many in a row, while the body's turning is a series: up
# to this angle, and to this error.
LANES = 8
MOST_SAMPLES = 128
EXPANDED_RAD, EXPANDED_M = 0.02, 1e-8
REFINEMENTS = 6
# Exponents below which an exponential is nothing.
GONE = -80.0


class Flyer(NamedTuple):
    """What flight needs to know of a modal body: see ModalBody and ContactPoints.

    ``along`` (k, modes) are the coordinates in which the points move, ``with_speed`` (k, modes)
    what the velocity adds to them (empty where nothing); displacements are ``rows`` (3 n, k) times
    these, or these themselves where ``rows`` is empty. ``reach`` and ``reach_speed`` (modes,) bound
    how far a unit of each moves any point, ``damping`` (modes,) is each one's own, ``alpha`` that
    of rigid motion too, ``tip`` (3, modes) is the section's mean displacement.
    """

    omega2: Array
    alpha: float
    damping: Array
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
    inertia: Array
    gravity: float
    places: Array
    powers: Complex
    amounts: Complex
    modes: NDArray[np.int64]
    reach: Array
    reach_up: Array
    rest: Array
    flyer: Flyer
    chart: Chart


class Ring(NamedTuple):
    """Some exponentials of a motion, and what they do to k coordinates.

    Coordinate c moves by Σ exp(``decay`` t) (``cosine`` cos(``pitch`` t) - ``sine`` sin(…)), the
    tables (e, k). From the time on that the ring was made for, those from the j-th on together move
    no more than ``beyond[j]`` along the ground's normal, those before it have second derivatives
    below ``bend[j]`` along it, and reach ``wide[j]`` and speed ``rush[j]`` anywhere. ``finest`` is
    a time that resolves the fastest that is not much quieter than the largest, ``slant`` bounds the
    sine of the angle between the axis and the normal.
    """

    decay: Array
    pitch: Array
    cosine: Array
    sine: Array
    beyond: Array
    bend: Array
    wide: Array
    rush: Array
    finest: float
    slant: float


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
def _rigid_rows(places: Array) -> Array:
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
    stiff = _rigid_rows(flyer.places)
    nearest = np.linalg.pinv(stiff)
    fit: Array = nearest @ moved
    fit_speed: Array = np.zeros((0, 0))
    # where points stand for their drive, the tip, whose height counts too, may move further
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
    flyer: Flyer, position: Array, attitude: Array, u: Array, v: Array, gravity: float
) -> tuple[Motion, Complex, NDArray[np.int64]]:
    """The flight from a state (u, v) in a pose, and the amounts and modes (e,) of its exponentials.

    The rigid part of (u, v) moves the pose.
    """
    motion = launch_by(chart(flyer), flyer, position, attitude, u, v, gravity)
    return motion, motion.amounts, motion.modes


@njit
def launch_by(
    table: Chart,
    flyer: Flyer,
    position: Array,
    attitude: Array,
    u: Array,
    v: Array,
    gravity: float,
) -> Motion:
    """`launch` with the flyer's chart at hand."""
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
        flyer.inertia,
        gravity,
        flyer.places,
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
def _grown(power: complex, t: float) -> float:
    """The size of exp(``power`` t)."""
    exponent = power.real * t
    return math.exp(exponent) if exponent > GONE else 0.0


@njit
def _ring(
    motion: Motion, t: float, allowed: float, slant: float, along: Array, with_speed: Array
) -> Ring:
    """The ring of coordinates ``along`` and ``with_speed`` (k, modes) from ``t`` on.

    What is left out moves nothing by more than ``allowed``. ``slant`` bounds the share of motion
    across the axis that is motion along the ground's normal.
    """
    powers, e = motion.powers, len(motion.powers)
    swing = np.empty(e)
    for j in range(e):
        swing[j] = motion.reach[j] * _grown(powers[j], t)
    least = _quiet_level(swing, allowed)
    kept = np.empty(e, dtype=np.int64)
    count = 0
    for j in range(e):
        if swing[j] > least:
            kept[count] = j
            count += 1
    k = len(along)
    decay, pitch = np.empty(count), np.empty(count)
    cosine, sine = np.empty((count, k)), np.empty((count, k))
    beyond, bend = np.zeros(count + 1), np.zeros(count + 1)
    wide, rush = np.zeros(count + 1), np.zeros(count + 1)
    quick = with_speed.size > 0
    largest, fastest = swing.max() if e else 0.0, 0.0
    for j in range(count):
        i = kept[j]
        power, amount, mode = powers[i], motion.amounts[i], motion.modes[i]
        decay[j], pitch[j] = power.real, power.imag
        for c in range(k):
            cosine[j, c] = along[c, mode] * amount.real
            sine[j, c] = along[c, mode] * amount.imag
        if quick:
            pushed = power * amount
            for c in range(k):
                cosine[j, c] += with_speed[c, mode] * pushed.real
                sine[j, c] += with_speed[c, mode] * pushed.imag
        size = math.sqrt(power.real * power.real + power.imag * power.imag)
        up = swing[i]
        if swing[i] > 0.0:
            up = min(up, up * (motion.reach_up[i] / motion.reach[i] + slant))
        beyond[j] = up
        bend[j + 1] = bend[j] + up * size * size
        wide[j + 1] = wide[j] + swing[i]
        rush[j + 1] = rush[j] + swing[i] * size
        if swing[i] > LOUD * largest:
            fastest = max(fastest, abs(power.imag))
    for j in range(count - 1, -1, -1):
        beyond[j] += beyond[j + 1]
    spin = motion.spin
    fastest = max(fastest, math.sqrt(spin[0] ** 2 + spin[1] ** 2 + spin[2] ** 2))
    finest = 2.0 * math.pi / fastest / SAMPLES_PER_PERIOD if fastest > 0.0 else math.inf
    return Ring(decay, pitch, cosine, sine, beyond, bend, wide, rush, finest, slant)


@njit
def _quiet_level(swing: Array, allowed: float) -> float:
    """A level such that all ``swing`` (e,) up to it together are no more than ``allowed``."""
    level = allowed / max(len(swing), 1)
    while level > 0.0:
        total = 0.0
        for j in range(len(swing)):
            if swing[j] <= 2.0 * level:
                total += swing[j]
        if total > allowed or 2.0 * level > allowed:
            return level
        level *= 2.0
    return 0.0


@njit
def _coordinates(ring: Ring, count: int, t: float, moved: Array, speed: Array) -> None:
    """Write the coordinates (k,) and their rates by the first ``count`` exponentials."""
    moved[:] = 0.0
    speed[:] = 0.0
    k = len(moved)
    for j in range(count):
        exponent = ring.decay[j] * t
        if exponent < GONE:
            continue
        size = math.exp(exponent)
        c, s = size, 0.0
        if ring.pitch[j] != 0.0:
            c, s = size * math.cos(ring.pitch[j] * t), size * math.sin(ring.pitch[j] * t)
        dc = ring.decay[j] * c - ring.pitch[j] * s
        ds = ring.decay[j] * s + ring.pitch[j] * c
        for a in range(k):
            moved[a] += ring.cosine[j, a] * c - ring.sine[j, a] * s
            speed[a] += ring.cosine[j, a] * dc - ring.sine[j, a] * ds


@njit
def _product(rows: Array, x: Array, out: Array) -> None:
    """Write ``rows`` @ ``x``; of many columns by BLAS, of few without its overhead."""
    if rows.shape[1] > 16:
        out[:] = rows @ x
        return
    for i in range(len(rows)):
        total = 0.0
        for c in range(rows.shape[1]):
            total += rows[i, c] * x[c]
        out[i] = total


@njit
def _swung(motion: Motion, ring: Ring, count: int, rows: Array, t: float) -> tuple[Array, Array]:
    """Displacement of every point (3 n,) in body axes and its rate, as the ``ring`` sees it."""
    k = ring.cosine.shape[1]
    moved, speed = np.empty(k), np.empty(k)
    _coordinates(ring, count, t, moved, speed)
    if rows.size == 0:
        return moved, speed
    places, rates = np.empty(len(rows)), np.empty(len(rows))
    _product(rows, moved, places)
    _product(rows, speed, rates)
    return places, rates


@njit
def _turning(places: Array, inertia: Array, spin: Array) -> float:
    """A bound on the acceleration of any of ``places`` (n, 3) by turning.

    On the axis what a spin about it does to the tumbling nearly cancels what it does to a point
    that tumbles; off it, every term counts.
    """
    far, wide = 0.0, 0.0
    for i in range(len(places)):
        wide = max(wide, math.sqrt(places[i, 0] ** 2 + places[i, 1] ** 2))
        far = max(far, abs(places[i, 2]))
    x, y, z = spin[0], spin[1], spin[2]
    dx = (inertia[1] - inertia[2]) * y * z / inertia[0] if inertia[0] > 0.0 else 0.0
    dy = (inertia[2] - inertia[0]) * z * x / inertia[1] if inertia[1] > 0.0 else 0.0
    dz = (inertia[0] - inertia[1]) * x * y / inertia[2] if inertia[2] > 0.0 else 0.0
    tumbling = x * x + y * y
    on_axis = math.sqrt((dy + x * z) ** 2 + (dx - y * z) ** 2 + tumbling * tumbling)
    off_axis = tumbling + z * z + math.sqrt(dx * dx + dy * dy + dz * dz)
    return far * on_axis + wide * off_axis


@njit
def _bending(motion: Motion, ring: Ring, count: int, t: float, places: Array, spin: Array) -> float:
    """A bound on the second derivative of the clearance of ``places`` (n, 3), by all that was
    evaluated."""
    alpha, v, x, y, z = motion.flyer.alpha, motion.velocity, spin[0], spin[1], spin[2]
    size, tumbling = math.sqrt(x * x + y * y + z * z), math.sqrt(x * x + y * y)
    total = motion.gravity + _turning(places, motion.flyer.inertia, spin) + ring.bend[count]
    # what rings across the axis comes along the normal as the axis turns, or the body about it
    swept = tumbling + abs(z) * ring.slant
    total += 2.0 * swept * (ring.rush[count] + (size + alpha) * ring.wide[count])
    if alpha > 0.0:
        total += motion.gravity + alpha * math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
        total += alpha * size * math.sqrt((places**2).sum(axis=1).max())
    return total


@njit
def _ahead(clear: float, rate: float, bending: float) -> float:
    """The time in which clear + rate t - ½ bending t² stays positive."""
    if clear <= 0.0:
        return 0.0
    inside = rate * rate + 2.0 * bending * clear
    if inside < 0.0:
        return math.inf
    root = math.sqrt(inside)
    if rate <= 0.0:
        return 2.0 * clear / (root - rate) if root > rate else math.inf
    return (rate + root) / bending if bending > 0.0 else math.inf


@njit
def _clearance(
    motion: Motion,
    ring: Ring,
    count: int,
    rows: Array,
    normals: Array,
    offsets: Array,
    t: float,
    attitude: Array,
    spin: Array,
    slack: float,
    bending: float,
) -> tuple[float, float, float]:
    """The smallest clearance of any point from its plane, its rate, and a time without touch.

    For the time, clearances are less by ``slack`` and their second derivatives -``bending``.
    """
    flyer = motion.flyer
    position, velocity = fallen(motion.position, motion.velocity, motion.gravity, flyer.alpha, t)
    rotation = matrix_of(attitude)
    places = flyer.places
    moved, speed = _swung(motion, ring, count, rows, t)
    least, falls, safe = math.inf, 0.0, math.inf
    n0 = n1 = n2 = w0 = w1 = w2 = height = rise = 0.0
    for i in range(len(places)):
        same = i > 0
        for c in range(3):
            same = same and normals[i, c] == normals[i - 1, c]
        if not same:
            x, y, z = normals[i, 0], normals[i, 1], normals[i, 2]
            n0 = rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z
            n1 = rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z
            n2 = rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z
            # the rate of n · (ω × q) is (n × ω) · q
            w0 = n1 * spin[2] - n2 * spin[1]
            w1 = n2 * spin[0] - n0 * spin[2]
            w2 = n0 * spin[1] - n1 * spin[0]
            height = x * position[0] + y * position[1] + z * position[2]
            rise = x * velocity[0] + y * velocity[1] + z * velocity[2]
        q0 = places[i, 0] + moved[3 * i]
        q1 = places[i, 1] + moved[3 * i + 1]
        q2 = places[i, 2] + moved[3 * i + 2]
        clear = height - offsets[i] + n0 * q0 + n1 * q1 + n2 * q2
        rate = rise + n0 * speed[3 * i] + n1 * speed[3 * i + 1] + n2 * speed[3 * i + 2]
        rate += w0 * q0 + w1 * q1 + w2 * q2
        if clear < least:
            least, falls = clear, rate
        safe = min(safe, _ahead(clear - slack, rate, bending))
    return least, falls, safe


@njit
def _tip(
    motion: Motion, ring: Ring, count: int, t: float, attitude: Array, spin: Array
) -> tuple[float, float]:
    """Height of the middle of the end section, and its rate."""
    flyer = motion.flyer
    position, velocity = fallen(motion.position, motion.velocity, motion.gravity, flyer.alpha, t)
    moved, speed = np.empty(3), np.empty(3)
    _coordinates(ring, count, t, moved, speed)
    rotation = matrix_of(attitude)
    x, y, z = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    for c in range(3):
        moved[c] += flyer.tip_place[c]
    height = position[2] + x * moved[0] + y * moved[1] + z * moved[2]
    rate = velocity[2] + x * speed[0] + y * speed[1] + z * speed[2]
    rate += (y * spin[2] - z * spin[1]) * moved[0]
    rate += (z * spin[0] - x * spin[2]) * moved[1]
    rate += (x * spin[1] - y * spin[0]) * moved[2]
    return height, rate


@njit
def _slant(motion: Motion, attitude: Array, normals: Array, time: float) -> float:
    """A bound for ``time`` on the sine of the angle between the axis and the ``normals``."""
    spin, rotation = motion.spin, matrix_of(attitude)
    most = 0.0
    for i in range(len(normals)):
        along = 0.0
        for c in range(3):
            along += normals[i, c] * rotation[c, 2]
        most = max(most, math.sqrt(max(1.0 - along * along, 0.0)))
    # the axis of a top that is not quite symmetric does not turn at quite the same rate
    return min(1.0, most + 1.1 * time * math.sqrt(spin[0] ** 2 + spin[1] ** 2))


@njit
def _seen(ring: Ring, clear: float) -> int:
    """How many exponentials must be evaluated for the others to be out of sight of ``clear``."""
    count = len(ring.decay)
    allowed = OUT_OF_SIGHT * clear
    while count > 0 and ring.beyond[count - 1] <= allowed:
        count -= 1
    return count


@njit
def _search_ring(motion: Motion, t: float, slant: float) -> tuple[Ring, Array, float]:
    """The ring to search the next touch with, the points' rows on it, and what it may be off by.

    The section is taken as rigid, unless it is not nearly so.
    """
    flyer, slack = motion.flyer, 0.0
    for j in range(len(motion.rest)):
        slack += motion.rest[j] * _grown(motion.powers[j], t)
    if slack <= TOUCH_SEARCH_M:
        ring = _ring(motion, t, TOUCH_SEARCH_M, slant, motion.chart.fit, motion.chart.fit_speed)
        return ring, motion.chart.stiff, slack
    ring = _ring(motion, t, TOUCH_SEARCH_M, slant, flyer.along, flyer.with_speed)
    return ring, flyer.rows, 0.0


@njit
def next_touch(motion: Motion, normals: Array, offsets: Array, until: float) -> float:
    """The first time in (0, ``until``] at which a point comes down through its plane, or infinity.

    A point that starts below its plane, on its way up, touches when it turns down before it got
    out.
    """
    flyer = motion.flyer
    t = 0.0
    attitude, spin = motion.attitude, motion.spin
    ring, rows, slack = _search_ring(motion, t, _slant(motion, attitude, normals, until))
    seen = len(ring.decay)
    above = False
    before, age = -math.inf, 0
    later, turned, spun = t, attitude, spin
    while True:
        # look at `later`, as closely as what comes out calls for
        while True:
            clear, _, safe = _clearance(
                motion,
                ring,
                seen,
                rows,
                normals,
                offsets,
                later,
                turned,
                spun,
                ring.beyond[seen] + slack,
                _bending(motion, ring, seen, later, flyer.places, spun),
            )
            more = _seen(ring, clear)
            if more <= seen:
                break
            seen = more
        if later > 0.0:
            if above and clear <= 0.0:
                found = _root(motion, normals, offsets, t, later, attitude, spin)
                if not math.isinf(found):
                    return found
            elif not above and clear < before:
                return later
        if later >= until:
            return math.inf
        above = above or clear > 0.0
        t, attitude, spin, before = later, turned, spun, clear
        if age == COMPACT_EVERY:
            slant = _slant(motion, attitude, normals, until - t)
            ring, rows, slack = _search_ring(motion, t, slant)
            age = 0
        age += 1
        seen = min(_seen(ring, clear), len(ring.decay))
        later = min(t + max(min(ring.finest, until / 8.0), safe), until)
        turned, spun = free_rotation(attitude, spin, flyer.inertia, flyer.alpha, t, later)


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
    """Where the lowest clearance falls through zero about [left, right], or infinity: Newton's
    method, kept in a bracket.

    ``attitude`` and ``spin`` are those at ``left``. What saw the fall may have left something out,
    so that the bracket may have to be widened.
    """
    flyer = motion.flyer
    start, furthest = left, right + (right - left)
    ring = _ring(motion, left, ROUNDING_M, 1.0, flyer.along, flyer.with_speed)
    seen = len(ring.decay)
    at, bracketed = right, False
    for _ in range(ROOT_STEPS):
        turned, spun = free_rotation(attitude, spin, flyer.inertia, flyer.alpha, start, at)
        clear, rate, _ = _clearance(
            motion, ring, seen, flyer.rows, normals, offsets, at, turned, spun, 0.0, 0.0
        )
        if clear > 0.0:
            left = at
        else:
            bracketed, right = True, at
        newton = at - clear / rate if rate < 0.0 else math.inf
        if clear == 0.0 or abs(newton - at) <= 4e-16 * at:
            return at
        if not bracketed:
            if newton > furthest:
                return math.inf
        elif not left < newton < right:
            newton = 0.5 * (left + right)
            if right - left <= 4e-16 * right:
                return right
        at = newton
    return at


@njit
def _rigid_apex(motion: Motion, until: float) -> float:
    """When the centre of mass is highest in [0, ``until``]."""
    speed = motion.velocity[2]
    if speed <= 0.0:
        return 0.0
    if motion.flyer.alpha == 0.0:
        return min(speed / motion.gravity, until)
    return min(math.log1p(motion.flyer.alpha * speed / motion.gravity) / motion.flyer.alpha, until)


@njit
def apex(motion: Motion, until: float) -> tuple[float, float]:
    """Time and height of the highest place of the tip in [0, ``until``].

    Times from which the height could not reach the best so far are stepped over, the others sampled
    so finely that no maximum rises by more than `APEX_SAG_M` between samples. A first look at where
    the slow part of the motion is highest makes the best good from the start.
    """
    flyer = motion.flyer
    up, none = np.array([[0.0, 0.0, 1.0]]), np.zeros((0, 0))
    slant = _slant(motion, motion.attitude, up, until)
    ring = _ring(motion, 0.0, APEX_SEARCH_M, slant, flyer.tip, none)
    best_t = _slow_apex(motion, ring, until)
    best, width = -math.inf, 0.0
    start = ring
    for sweep in range(2):
        t = 0.0 if sweep else best_t
        attitude, spin = free_rotation(
            motion.attitude, motion.spin, flyer.inertia, flyer.alpha, 0.0, t
        )
        if sweep:
            ring = start
        age = 0
        while True:
            step = 0.0
            if sweep:
                step = _below(motion, ring, t, attitude, spin, best)
            spacing = _spacing(motion, ring, t, spin)
            if step < LANES * spacing:
                ring = _ring(motion, t, APEX_SEARCH_M, slant, flyer.tip, none)
                height, when, spacing, step = _highest_sample(
                    motion, ring, t, attitude, spin, until, not sweep
                )
                if height > best:
                    best, best_t, width = height, when, spacing
                age = 0
            elif age == COMPACT_EVERY:
                ring = _ring(motion, t, APEX_SEARCH_M, slant, flyer.tip, none)
                age = 0
            later = t + step
            if not sweep or later >= until:
                break
            attitude, spin = free_rotation(attitude, spin, flyer.inertia, flyer.alpha, t, later)
            t = later
            age += 1
    return _refined(motion, max(best_t - width, 0.0), best_t, min(best_t + width, until))


@njit
def _tip_alone(motion: Motion) -> Array:
    return motion.flyer.tip_place.reshape(1, 3)


@njit
def _spacing(motion: Motion, ring: Ring, t: float, spin: Array) -> float:
    """A time between samples in which no maximum of the tip's height hides by `APEX_SAG_M`."""
    bending = _bending(motion, ring, len(ring.decay), t, _tip_alone(motion), spin)
    return math.sqrt(8.0 * APEX_SAG_M / bending)


@njit
def _below(
    motion: Motion, ring: Ring, t: float, attitude: Array, spin: Array, ceiling: float
) -> float:
    """A time in which the tip does not rise to the ``ceiling``."""
    height, rate = _tip(motion, ring, 0, t, attitude, spin)
    seen = _seen(ring, ceiling - height)
    if seen:
        height, rate = _tip(motion, ring, seen, t, attitude, spin)
    # gravity, which _bending has as a bound, pulls down
    bending = _bending(motion, ring, seen, t, _tip_alone(motion), spin) - 2.0 * motion.gravity
    return _ahead(ceiling - height - ring.beyond[seen], -rate, bending)


@njit
def _slow_apex(motion: Motion, ring: Ring, until: float) -> float:
    """About when the tip is highest in [0, ``until``], but for ringing far below its rise."""
    flyer = motion.flyer
    seen = _seen(ring, 0.1 * motion.gravity * until * until / 8.0)
    top = _rigid_apex(motion, until)
    best, best_t = -math.inf, top
    start, spacing = 0.0, until / LOOKS
    rate = 0.0
    for _ in range(2):
        for i in range(LOOKS + 2):
            t = min(start + i * spacing, until) if i <= LOOKS else top
            attitude, spin = free_rotation(
                motion.attitude, motion.spin, flyer.inertia, flyer.alpha, 0.0, t
            )
            height, rises = _tip(motion, ring, seen, t, attitude, spin)
            if height > best:
                best, best_t, rate = height, t, rises
        start, spacing = max(best_t - spacing, 0.0), 2.0 * spacing / LOOKS
    fall = _bending(motion, ring, seen, best_t, _tip_alone(motion), motion.spin)
    return min(max(best_t + rate / fall, 0.0), until)


@njit
def _highest_sample(
    motion: Motion,
    ring: Ring,
    t: float,
    attitude: Array,
    spin: Array,
    until: float,
    about: bool,
) -> tuple[float, float, float, float]:
    """The highest of some samples of the tip's height from ``t`` on, its time, their spacing, and
    how long they last; with ``about`` from before to after ``t``.

    Exponentials go from sample to sample by multiplication, in lanes; the attitude is expanded in
    time, to second order for the place of the tip and to first for its ringing.
    """
    flyer = motion.flyer
    count = len(ring.decay)
    x, w, inertia = matrix_of(attitude)[2], spin, flyer.inertia
    dw = np.zeros(3)
    for c in range(3):
        i, j = (c + 1) % 3, (c + 2) % 3
        if inertia[c] > 0.0:
            dw[c] = (inertia[i] - inertia[j]) * w[i] * w[j] / inertia[c]
        dw[c] -= flyer.alpha * w[c]
    dx, ddx = np.empty(3), np.empty(3)
    for c in range(3):
        i, j = (c + 1) % 3, (c + 2) % 3
        dx[c] = x[i] * w[j] - x[j] * w[i]
    for c in range(3):
        i, j = (c + 1) % 3, (c + 2) % 3
        ddx[c] = dx[i] * w[j] - dx[j] * w[i] + x[i] * dw[j] - x[j] * dw[i]
    spacing = _spacing(motion, ring, t, spin)
    size = math.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
    most = MOST_SAMPLES
    tumbling = math.sqrt(w[0] ** 2 + w[1] ** 2)
    # the cubic terms of the expansion stay below what is looked for
    cubic = size * size * (tumbling * abs(flyer.tip_place[2]) + size * ring.wide[count]) / 6.0
    if size * spacing * most > EXPANDED_RAD or cubic * (spacing * most) ** 3 > EXPANDED_M:
        longest = min(EXPANDED_RAD / size, (EXPANDED_M / cubic) ** (1.0 / 3.0))
        most = max(int(longest / spacing), 2)
    first = max(t - 0.5 * most * spacing, 0.0) if about else t
    lasts = min(until - first, (most - 1) * spacing)
    samples = min(most, math.ceil(lasts / spacing) + 1)
    spacing = lasts / max(samples - 1, 1)
    blocks = (samples + LANES - 1) // LANES
    heights = np.zeros(blocks * LANES)
    turning = np.zeros(blocks * LANES)
    real, imag = np.empty(LANES), np.empty(LANES)
    for j in range(count):
        start = ring.decay[j] * first
        if start < GONE:
            continue
        a0 = a1 = b0 = b1 = 0.0
        for c in range(3):
            a0 += x[c] * ring.cosine[j, c]
            a1 += x[c] * ring.sine[j, c]
            b0 += dx[c] * ring.cosine[j, c]
            b1 += dx[c] * ring.sine[j, c]
        size = math.exp(start)
        turn0, turn1 = (
            size * math.cos(ring.pitch[j] * first),
            size * math.sin(ring.pitch[j] * first),
        )
        size = math.exp(ring.decay[j] * spacing)
        f0, f1 = size * math.cos(ring.pitch[j] * spacing), size * math.sin(ring.pitch[j] * spacing)
        g0, g1 = 1.0, 0.0
        for k in range(LANES):
            real[k], imag[k] = turn0, turn1
            turn0, turn1 = turn0 * f0 - turn1 * f1, turn0 * f1 + turn1 * f0
            g0, g1 = g0 * f0 - g1 * f1, g0 * f1 + g1 * f0
        for b in range(blocks):
            for k in range(LANES):
                c, s = real[k], imag[k]
                heights[b * LANES + k] += a0 * c - a1 * s
                turning[b * LANES + k] += b0 * c - b1 * s
                real[k], imag[k] = c * g0 - s * g1, c * g1 + s * g0
    best, which = -math.inf, 0
    place = flyer.tip_place
    p = x[0] * place[0] + x[1] * place[1] + x[2] * place[2]
    dp = dx[0] * place[0] + dx[1] * place[1] + dx[2] * place[2]
    ddp = ddx[0] * place[0] + ddx[1] * place[1] + ddx[2] * place[2]
    at, speed = fallen(motion.position, motion.velocity, motion.gravity, flyer.alpha, t)
    drag = motion.gravity + flyer.alpha * speed[2]
    for i in range(samples):
        time = first + i * spacing - t
        heights[i] += at[2] + p + time * (speed[2] + dp + turning[i] + 0.5 * time * (ddp - drag))
    for i in range(samples):
        height = heights[i]
        if 0 < i < samples - 1 and height > heights[i - 1] and height >= heights[i + 1]:
            # the parabola's top, lest a lower wave win because a sample fell on its crest
            bent = 2.0 * height - heights[i - 1] - heights[i + 1]
            height += 0.125 * (heights[i + 1] - heights[i - 1]) ** 2 / bent
        if height > best:
            best, which = height, i
    return best, first + which * spacing, spacing, lasts


@njit
def _refined(motion: Motion, left: float, best: float, right: float) -> tuple[float, float]:
    """Time and height of the highest place between ``left`` and ``right``, about ``best``: where
    the rate of rise is zero, by false position."""
    flyer, none = motion.flyer, np.zeros((0, 0))
    ring = _ring(motion, left, ROUNDING_M, 1.0, flyer.tip, none)
    attitude, spin = free_rotation(
        motion.attitude, motion.spin, flyer.inertia, flyer.alpha, 0.0, left
    )
    t, top, top_t = best, -math.inf, best
    end_rate, end = 0.0, best
    for step in range(REFINEMENTS):
        turned, spun = free_rotation(attitude, spin, flyer.inertia, flyer.alpha, left, t)
        height, rate = _tip(motion, ring, len(ring.decay), t, turned, spun)
        if height > top:
            top, top_t = height, t
        if rate == 0.0:
            break
        if step == 0:
            end, end_rate, t = t, rate, right if rate > 0.0 else left
            continue
        if rate * end_rate > 0.0:
            break
        now = t
        t = (end * rate - now * end_rate) / (rate - end_rate)
        end, end_rate = now, rate
    return top_t, top


@njit
def trace(motion: Motion, normals: Array, offsets: Array, times: Array) -> Array:
    """Heights of the tip's middle and of the centre, and the lowest clearance at times (k,)."""
    flyer, none = motion.flyer, np.zeros((0, 0))
    out = np.empty((len(times), 3))
    attitude, spin, before = motion.attitude, motion.spin, 0.0
    tips = _ring(motion, 0.0, 0.0, 1.0, flyer.tip, none)
    points = _ring(motion, 0.0, 0.0, 1.0, flyer.along, flyer.with_speed)
    count = len(points.decay)
    for i in range(len(times)):
        t = times[i]
        attitude, spin = free_rotation(attitude, spin, flyer.inertia, flyer.alpha, before, t)
        before = t
        centre, _ = fallen(motion.position, motion.velocity, motion.gravity, flyer.alpha, t)
        out[i, 0] = _tip(motion, tips, count, t, attitude, spin)[0]
        out[i, 1] = centre[2]
        out[i, 2] = _clearance(
            motion, points, count, flyer.rows, normals, offsets, t, attitude, spin, 0.0, 0.0
        )[0]
    return out


@njit
def landing(
    flyer: Flyer, motion: Motion, amounts: Complex, modes: NDArray[np.int64], t: float
) -> tuple[Array, Array, Array, Array]:
    """Position and attitude at ``t``, and displacement and velocity (modes,) on top of them.

    The displacement is elastic alone; the velocity has the rigid one too.
    """
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
