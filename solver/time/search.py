"""Search for the next touch of a body in flight, and for the greatest height of its tip; compiled.

At an instant with clearance c, rate c' and a bound M on the second derivative, the search advances
by a time in which c + c' t - ½ M t² stays positive (conservative advancement: Mirtich, PhD thesis,
Berkeley 1996). That time vanishes near the ground, so a shortest step is set. Between two instants
w apart with positive clearance, the clearance is at least -M w²/8; the shortest step keeps this
within `TOUCH_SEARCH_M`. So the search misses no touch deeper than that plus the vibration it omits,
and takes at most √(M/8 `TOUCH_SEARCH_M`) steps a second.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..arrays import Array
from ..compiled import njit
from ..rigid import free_rotation, matrix_of
from .motion import Motion, Seen, centre, swung

# Vibration that a search may omit, and dips between its steps; roots and maxima are refined with
# all but rounding.
TOUCH_SEARCH_M, APEX_SEARCH_M, ROUNDING_M = 1e-8, 5e-8, 1e-13
# Exponent below which an exponential counts as zero.
GONE = -80.0
# Vibration is omitted while it is less than this share of the clearance.
OUT_OF_SIGHT = 0.25
# Largest ratio of a step to the last one; its bound depends on the rotation meanwhile.
LONGER = 8.0
ROOT_STEPS = 100
# Rise of a maximum between samples that may be missed; numbers of first samples and refinements.
APEX_SAG_M, LOOKS, REFINEMENTS = 1e-7, 8, 8
# `BLOCKS` blocks of `LANES` samples; rotation within a block is a quadratic in time to θ³/27.
BLOCKS, LANES, TURN_RAD = 8, 32, 0.01
# Sampling starts after `CROWDED` steps shorter than `SHORT` times the spacing of samples.
CROWDED, SHORT = 3, 4.0


class Look(NamedTuple):
    """The smallest clearance at an instant, its rate, and a time without touch.

    The clearance may be off by ``slack``. The size of its second derivative is at most ``bending``
    within the horizon of the look.
    """

    clear: float
    rate: float
    safe: float
    slack: float
    bending: float


@njit
def start_clock(motion: Motion) -> Array:
    """Time, attitude (4,) and spin (3,) of the latest look, where the next one starts."""
    clock = np.zeros(8)
    clock[1:5], clock[5:] = motion.attitude, motion.spin
    return clock


@njit
def time_ahead(clear: float, rate: float, bending: float) -> float:
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
def look(
    motion: Motion,
    seen: Seen,
    normals: Array,
    offsets: Array,
    clock: Array,
    t: float,
    allowed: float,
    horizon: float,
) -> Look:
    """Smallest clearance at ``t`` over the planes ``normals`` (n, 3) · x = ``offsets`` (n,).

    Vibration of up to ``allowed`` is omitted, the fastest first. The bound on the second derivative
    holds for the time ``horizon``. ``clock`` is that of `start_clock`.
    """
    flyer = motion.flyer
    position, velocity = centre(motion, t)
    attitude, spin = free_rotation(clock[1:5], clock[5:], flyer.inertia, flyer.alpha, clock[0], t)
    clock[0], clock[1:5], clock[5:] = t, attitude, spin
    rotation = matrix_of(attitude)
    steep, upward = 1.0, -1.0
    for i in range(len(normals)):
        along = 0.0
        for c in range(3):
            along += normals[i, c] * rotation[c, 2]
        steep, upward = min(steep, abs(along)), max(upward, normals[i, 2])
    slant = math.sqrt(max(1.0 - steep * steep, 0.0)) + motion.tumbling * horizon
    k, quick = seen.along.shape[1], seen.quick.shape[1] > 0
    moved, speed = np.zeros(k), np.zeros(k)
    slack = left_out = swings = rushes = bends = 0.0
    for j in range(len(flyer.powers) - 1, -1, -1):
        power = flyer.powers[j]
        if motion.loud[j] == 0.0 or power.real * t < GONE:
            continue
        now = motion.loud[j] * math.exp(power.real * t)
        slack += now * seen.rest[j]
        swing, up = now * seen.reach[j], now * (seen.reach_up[j] + slant * seen.reach[j])
        up = min(swing, up)
        if left_out + up <= allowed:
            left_out += up
            continue
        wave = motion.amounts[j] * swung(power, t)
        rush = power * wave
        bend = (power * rush).real if quick else 0.0
        for c in range(k):
            moved[c] += seen.along[j, c] * wave.real
            speed[c] += seen.along[j, c] * rush.real
            if quick:
                moved[c] += seen.quick[j, c] * rush.real
                speed[c] += seen.quick[j, c] * bend
        size = abs(power)
        swings += swing
        rushes += swing * size
        bends += up * size * size
    slack += left_out
    bending = bends + _bending(motion, seen, slant, swings, rushes)
    below = bending + upward * motion.gravity
    clear, rate, safe = _nearest(
        seen, normals, offsets, (position, velocity, spin), rotation, (moved, speed, slack, below)
    )
    return Look(clear, rate, min(safe, horizon), slack, bending + motion.gravity)


@njit
def _bending(motion: Motion, seen: Seen, slant: float, swings: float, rushes: float) -> float:
    """Bound on the clearance's acceleration beyond gravity's and that of vibration in a body
    without rotation, from the size and speed of the vibration."""
    alpha, gravity, v = motion.flyer.alpha, motion.gravity, motion.velocity
    spin = math.hypot(motion.tumbling, motion.twirling)
    total = seen.far * motion.swinging + seen.wide * (spin * spin + motion.swerving)
    # vibration across the axis gets a normal component as the axis turns, or the body about it
    swept = motion.tumbling + motion.twirling * min(slant, 1.0)
    total += 2.0 * swept * rushes + (swept * spin + motion.swerving) * swings
    if alpha > 0.0:
        total += gravity + alpha * math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
        total += alpha * spin * (seen.far + seen.wide + swings)
    if motion.drag > 0.0:  # no faster than at the start or than the final speed of fall
        total += gravity + motion.drag * v[2] * v[2]
    return total


@njit
def _nearest(
    seen: Seen,
    normals: Array,
    offsets: Array,
    rigid: tuple[Array, Array, Array],
    rotation: Array,
    ringing: tuple[Array, Array, float, float],
) -> tuple[float, float, float]:
    """The smallest clearance, its rate and the time without touch.

    The body is at ``rigid`` (position, velocity, spin), and its coordinates move by ``ringing``
    (displacement, speed, slack, bending).
    """
    position, velocity, spin = rigid
    moved, speed, slack, bending = ringing
    if seen.rows.size:
        moved, speed = seen.rows @ moved, seen.rows @ speed
    least, falls, safe = math.inf, 0.0, math.inf
    n0 = n1 = n2 = w0 = w1 = w2 = height = rise = 0.0
    for i in range(len(seen.places)):
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
        q0 = seen.places[i, 0] + moved[3 * i]
        q1 = seen.places[i, 1] + moved[3 * i + 1]
        q2 = seen.places[i, 2] + moved[3 * i + 2]
        clear = height - offsets[i] + n0 * q0 + n1 * q1 + n2 * q2
        rate = rise + n0 * speed[3 * i] + n1 * speed[3 * i + 1] + n2 * speed[3 * i + 2]
        rate += w0 * q0 + w1 * q1 + w2 * q2
        if clear < least:
            least, falls = clear, rate
        safe = min(safe, time_ahead(clear - slack, rate, bending))
    return least, falls, safe


@njit
def _closely(
    motion: Motion,
    seen: tuple[Seen, Seen],
    planes: tuple[Array, Array],
    clock: Array,
    t: float,
    expected: float,
    horizon: float,
    least: float,
) -> Look:
    """A look that omits at most what its clearance allows, or ``least``.

    ``expected`` is a guess of the clearance. The first of ``seen`` serves unless it omits too much.
    """
    which, allowed = seen[0], max(0.5 * least, OUT_OF_SIGHT * expected)
    while True:
        now = look(motion, which, planes[0], planes[1], clock, t, allowed, horizon)
        if now.slack <= max(least, 2.0 * OUT_OF_SIGHT * now.clear):
            return now
        wanted = max(0.5 * least, OUT_OF_SIGHT * now.clear)
        if allowed <= wanted:
            which = seen[1]
        allowed = min(allowed, wanted)


@njit
def next_touch(motion: Motion, normals: Array, offsets: Array, until: float) -> float:
    """The first time in (0, ``until``] at which a point crosses its plane downward, or infinity.

    A point that starts below its plane, moving up, touches when it turns down before it got out.
    """
    seen, planes = (motion.flyer.rigid, motion.flyer.points), (normals, offsets)
    t, step, expected, clock = 0.0, 0.0, 0.0, start_clock(motion)
    above, before, horizon = False, -math.inf, until
    while True:
        now = _closely(motion, seen, planes, clock, t, expected, horizon, TOUCH_SEARCH_M)
        if above and now.clear <= 0.0:
            found = _root(motion, normals, offsets, clock, t - step, t)
            if not math.isinf(found):
                return found
        elif not above and now.clear < before:
            return t
        if t >= until:
            return math.inf
        above, before = above or now.clear > 0.0, now.clear
        shortest = _spacing(now, TOUCH_SEARCH_M, horizon)
        if now.clear <= 0.0:  # moving out, until it turns
            shortest = min(shortest, until / 8.0)
        step = min(max(shortest, now.safe), until - t)
        t = t + step if step < until - t else until
        expected, horizon = now.clear + now.rate * step, LONGER * step


@njit
def _spacing(now: Look, dip: float, horizon: float) -> float:
    """Time between looks in which no clearance dips by more than ``dip`` below both."""
    return min(math.sqrt(8.0 * dip / now.bending), horizon) if now.bending > 0.0 else horizon


@njit
def _root(
    motion: Motion, normals: Array, offsets: Array, clock: Array, left: float, right: float
) -> float:
    """Time at which the lowest clearance falls through zero about [left, right], or infinity.

    Bracketed Newton's method; the bracket is widened if the look that saw the fall was inaccurate.
    """
    furthest, at, bracketed = right + (right - left), right, False
    for _ in range(ROOT_STEPS):
        now = look(motion, motion.flyer.points, normals, offsets, clock, at, ROUNDING_M, 0.0)
        if now.clear > 0.0:
            left = at
        else:
            bracketed, right = True, at
        newton = at - now.clear / now.rate if now.rate < 0.0 else math.inf
        if now.clear == 0.0 or abs(newton - at) <= 4e-16 * at:
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
def after_release(
    motion: Motion, normals: Array, offsets: Array, slowest: float
) -> tuple[float, bool]:
    """Time to the next touch, or one by which it must have come; and whether the impact is over
    then.

    It is over if the centre of mass has turned to fall. If the centre was falling already, the body
    must have stayed clear for one period of its ``slowest`` mode. A tip that vibrates down while
    the centre still rises belongs to the same impact.
    """
    gravity, rising, points = motion.gravity, motion.velocity[2], motion.flyer.points
    ringing = (motion.loud * points.reach).sum()
    longest = 2.0 * max(rising, 0.0) / gravity + math.sqrt(8.0 * ringing / gravity) + 1e-3
    # rotation can keep the tip up for this long
    longest += 2.0 * math.sqrt(8.0 * points.far / gravity)
    if motion.drag > 0.0:  # acosh(exp(k h)) <= √(2 k h) + k h
        height = 0.5 * rising * rising / gravity + ringing + 2.0 * points.far
        longest += height * math.sqrt(motion.drag / gravity)
    after = min(next_touch(motion, normals, offsets, longest), longest)
    if rising <= 0.0:
        return after, after > slowest
    return after, centre(motion, after)[1][2] <= 0.0


@njit
def top_of_centre(motion: Motion, until: float) -> tuple[float, float]:
    """Time and greatest height of the centre of mass in [0, ``until``]."""
    speed, gravity, alpha = motion.velocity[2], motion.gravity, motion.flyer.alpha
    rise = 0.0
    if speed > 0.0:
        rise = speed / gravity
        if motion.drag > 0.0:
            limit = math.sqrt(gravity / motion.drag)
            rise = math.atan(speed / limit) * limit / gravity
        elif alpha > 0.0:
            rise = math.log1p(alpha * speed / gravity) / alpha
    top = min(rise, until)
    return top, centre(motion, top)[0][2]


@njit
def _ceiling(height: float) -> tuple[Array, Array]:
    """The plane at a ``height``, seen from below."""
    return np.array([[0.0, 0.0, -1.0]]), np.array([-height])


@njit
def _below(motion: Motion, clock: Array, t: float, allowed: float) -> Look:
    """Distance of the tip's middle below the height zero."""
    normals, offsets = _ceiling(0.0)
    return look(motion, motion.flyer.tip, normals, offsets, clock, t, allowed, 0.0)


@njit
def apex(motion: Motion, until: float) -> tuple[float, float]:
    """Time and greatest height of the tip's middle in [0, ``until``].

    It is the touch with a ceiling at the best height so far. Times from which the tip could not
    reach that height are skipped. The others are sampled so finely that no maximum between samples
    rises by more than `APEX_SAG_M`. First, a few coarse samples provide a good best height.
    """
    best, best_t, clock = -math.inf, 0.0, start_clock(motion)
    tip = motion.flyer.tip, motion.flyer.tip
    looks = LOOKS if motion.tumbling > 0.0 else 0
    for i in range(looks + 1):
        t = until * (i / LOOKS) if i < looks else top_of_centre(motion, until)[0]
        height = -_below(motion, clock, t, APEX_SEARCH_M).clear
        if height > best:
            best, best_t = height, t
    t, horizon, expected, width, clock = 0.0, until, 0.0, 0.0, start_clock(motion)
    turning, crowded = max(math.hypot(motion.tumbling, motion.twirling), TURN_RAD / until), 0
    while True:
        ceiling = _ceiling(best)
        now = _closely(motion, tip, ceiling, clock, t, expected, horizon, APEX_SEARCH_M)
        spacing = _spacing(now, APEX_SAG_M, horizon)
        if now.clear < 0.0:
            best, best_t, width = best - now.clear, t, spacing
        elif t <= best_t:
            width = spacing
        if t >= until:
            break
        step = min(max(now.safe, spacing), until - t)
        crowded = crowded + 1 if step < SHORT * spacing else 0
        if crowded > CROWDED and step < until - t:
            most = min(BLOCKS * LANES * spacing, BLOCKS * TURN_RAD / turning, until - t)
            now = look(motion, tip[0], *ceiling, clock, t, APEX_SEARCH_M, most)
            spacing = _spacing(now, APEX_SAG_M, most)
            step = min(BLOCKS * LANES * spacing, most)
            height, when = _sampled(motion, clock, t, step)
            if height > best:
                best, best_t, width = height, when, spacing
        t = t + step if step < until - t else until
        expected, horizon = now.clear + now.rate * step, LONGER * step
    return _highest(motion, max(best_t - width, 0.0), best_t, min(best_t + width, until))


@njit
def _rigid_height(motion: Motion, clock: Array, t: float) -> Array:
    """The vertical in body axes and the height of the centre of mass, then their rates (2, 4)."""
    flyer, out = motion.flyer, np.empty((2, 4))
    attitude, spin = free_rotation(clock[1:5], clock[5:], flyer.inertia, flyer.alpha, clock[0], t)
    clock[0], clock[1:5], clock[5:] = t, attitude, spin
    x, (position, velocity) = matrix_of(attitude)[2], centre(motion, t)
    out[0, :3], out[0, 3], out[1, 3] = x, position[2], velocity[2]
    for c in range(3):
        i, j = (c + 1) % 3, (c + 2) % 3
        out[1, c] = x[i] * spin[j] - x[j] * spin[i]
    return out


@njit
def _sampled(motion: Motion, clock: Array, t: float, lasts: float) -> tuple[float, float]:
    """The tip's greatest height at `BLOCKS` times `LANES` instants from ``t`` on, and its time.

    An exponential at an instant is its value at the block's start times that of the time since, so
    a matrix product gives them all. Within a block the attitude is a quadratic in time.
    """
    flyer, tip = motion.flyer, motion.flyer.tip
    lane, block = lasts / (BLOCKS * LANES), lasts / BLOCKS
    chosen, left_out = np.zeros(len(flyer.powers), dtype=np.bool_), 0.0
    for j in range(len(flyer.powers) - 1, -1, -1):
        swing = motion.loud[j] * math.exp(flyer.powers[j].real * t) * tip.reach[j]
        left_out += swing
        chosen[j] = left_out > APEX_SEARCH_M
    powers, amounts, along = flyer.powers[chosen], motion.amounts[chosen], tip.along[chosen]
    starts = np.empty((BLOCKS, len(powers)), dtype=np.complex128)
    since = np.empty((len(powers), LANES), dtype=np.complex128)
    for j in range(len(powers)):
        for b in range(BLOCKS):
            starts[b, j] = amounts[j] * swung(powers[j], t + b * block)
        since[j, 0], more = 1.0, swung(powers[j], lane)
        for k in range(1, LANES):
            since[j, k] = since[j, k - 1] * more
    place = tip.places[0]
    moved = np.empty((3, BLOCKS, LANES))
    for c in range(3):
        moved[c] = ((starts * along[:, c]) @ since).real + place[c]
    best, when = -math.inf, t
    ahead = _rigid_height(motion, clock, t)
    for b in range(BLOCKS):
        start, now = t + b * block, ahead
        ahead = _rigid_height(motion, clock, start + block)
        bend = (ahead[0] - now[0] - block * now[1]) / (block * block)
        for k in range(LANES):
            since_start = k * lane
            at = now[0] + since_start * (now[1] + since_start * bend)
            height = at[3]
            for c in range(3):
                height += at[c] * moved[c, b, k]
            if height > best:
                best, when = height, start + since_start
    return best, when


@njit
def _highest(motion: Motion, left: float, best: float, right: float) -> tuple[float, float]:
    """Time and greatest height between ``left`` and ``right``, about ``best``: the zero of the rate
    of rise, by false position."""
    t, top, top_t = best, -math.inf, best
    other, other_fall, clock = best, 0.0, start_clock(motion)
    for step in range(REFINEMENTS):
        now = _below(motion, clock, t, ROUNDING_M)
        if -now.clear > top:
            top, top_t = -now.clear, t
        if now.rate == 0.0 or (step > 0 and now.rate * other_fall > 0.0):
            break
        here = t
        if step == 0:
            t = right if now.rate < 0.0 else left
        else:
            t = (other * now.rate - here * other_fall) / (now.rate - other_fall)
        if t == here:
            break
        other, other_fall = here, now.rate
    return top_t, top


@njit
def trace(motion: Motion, normals: Array, offsets: Array, times: Array) -> Array:
    """Heights of the tip's middle and of the centre, and the lowest clearance at times (k,)."""
    out, clock, points = np.empty((len(times), 3)), start_clock(motion), motion.flyer.points
    for i in range(len(times)):
        t = times[i]
        out[i, 0] = -_below(motion, clock, t, 0.0).clear
        out[i, 1] = centre(motion, t)[0][2]
        out[i, 2] = look(motion, points, normals, offsets, clock, t, 0.0, 0.0).clear
    return out
