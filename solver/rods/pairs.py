"""Contact of bristle against bristle: the gap of two elements, forces, and friction, compiled.

An element is a straight prism of the rod's section. Two meet over the stretch of the first that
lies beside the second: short where they cross, as long as both where they are parallel. Where they
cross, the gap is along the normal that both axes have in common. It is the same all over the
stretch and is met where the axes are closest, be it a little beyond an element's end, though never
beyond a tip. Round wires are met so at any angle, at the closest place of the stretch. Where they
are nearly parallel that normal means little, and where bristles bend side by side in one plane it
points along their wide sides, deep into either. A tip may end before it is where the axes are
closest, or may run into the other with its end. There the gap is along the one of several normals
by which contact holds the least energy, or the prisms are farthest apart, and is met at both ends
of the stretch. Such normals are those of the second's faces, and those that its axis has in common
with the first's edges: of a prism that ends, beside one that goes on, these and the common normal
of the axes are all separating axes (Gottschalk, Lin and Manocha, OBBTree, SIGGRAPH 1996). So one of
them shows no depth where the two begin to touch, and the energy has no jump.

Contact at closest points alone fails at small angles (Meier, Popp and Wall, Comput. Methods Appl.
Mech. Engng 308 (2016) 377). Contact at fixed points of an element misses prisms that cross between
them. Planes through nodes, across both neighbours alike, bound the stretches, so each place of a
bent rod belongs to one element.

The normal force grows with the square of the approach at first, as that of rough faces does, and in
proportion to it beyond (Meier, Popp and Wall, Sec. 4). Without that, the corners of the polygons
that stand for bent rods would decide which of several elements touches. Friction is that of a
point on a plane, `contact.touch_point`.
"""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import numpy as np

from ..arrays import Array, Integers, zeros
from ..compiled import inlined, njit, unowned, write
from .contact import Friction, Springs, TouchStep, friction_of, lose_hold, touch_point
from .ground import Contact
from .motion import Motion, Pose, pose_of
from .rotation import cross, dot, write_middle
from .section import RodSection

# Directions whose square is below this are no axis.
NO_AXIS = 1e-16
# Below this angle in rad two axes have no closest points.
NO_ANGLE = 1e-4
# Elements cross where the sine of the angle between them is more; below, they lie side by side.
CROSSING = 0.25
# Edges are round over an angle of so many rad, or flush faces would turn each other to and fro.
CORNER = 0.02
WHOLE = math.sqrt(1.0 + CORNER * CORNER)
# The approach in m over which contact becomes as stiff as it is.
ROUGH_M = 1e-6
# Where the normal of a contact comes from: both axes have it in common, it is of one of the second
# element's faces, that one's axis has it in common with an edge of the first's, or it is the
# shortest way.
COMMON, OTHER, OWN, SHORTEST = 0, 1, 3, 5
# A face is taken over one before it where its contact holds less energy by this share. Faces that
# are flush hold nearly the same, and Newton's method would go to and fro between them.
LESS = 1e-3
# Columns of `Points.whole`: the rods and their elements.
ROD_A, ELEMENT_A, ROD_B, ELEMENT_B = range(4)


class Between(NamedTuple):
    """The law between two bristles, for compiled code: the sides' halves (2,) in m, whether the
    section is round, ``stiffness`` in N/m per m of the stretch, that of the tangential spring
    over it, and the friction."""

    half: Array
    round: bool
    stiffness: float
    ratio: float
    friction: Friction


def between_of(contact: Contact, section: RodSection) -> Between:
    """The law of a ``contact``: two that cross at right angles meet over their width."""
    return Between(
        np.array([section.half_thin_m, section.half_wide_m]),
        section.is_round,
        contact.kn_N_m / (2.0 * section.half_wide_m),
        contact.kt_over_kn,
        friction_of(contact),
    )


@inlined
def crossing_kn(law: Between) -> float:
    """The stiffness in N/m of two that cross at right angles, wide side on wide side."""
    return 2.0 * law.half[1] * law.stiffness


class Meeting(NamedTuple):
    """Room for the stretch of one element along another: the first's centre line at its ends, and
    the second's beside it (2, 3), their shares (2,) of the elements' lengths, gaps (2,), normal
    (3,), the axes of both elements (3, 3), from either centre line the arms (2, 3) of the points
    that meet, and vectors (9, 3) in between."""

    first: Array
    second: Array
    share_a: Array
    share_b: Array
    gap: Array
    normal: Array
    axes_a: Array
    axes_b: Array
    arm_a: Array
    arm_b: Array
    room: Array
    was: Array


def new_meeting() -> Meeting:
    """Room."""
    ends, pair, axes = (2, 3), 2, (3, 3)
    return zeros(Meeting, ends, ends, pair, pair, pair, 3, axes, axes, ends, ends, (9, 3), axes)


class Points(NamedTuple):
    """The points in contact, as last found: ``whole`` (m, 4) rod and element of either side,
    ``share`` (m, 2, 2) of the first and the second node in each, ``arm`` (m, 2, 3) from each centre
    line, ``push`` (m, 3) on the first side, and its loss ``stiff`` (m, 3, 3) by its displacement
    over the second's. The arms turn with the elements' middles. Then the ``gaps`` (p, 2) of all
    pairs of elements, and room for one pair."""

    whole: Integers
    share: Array
    arm: Array
    push: Array
    stiff: Array
    gaps: Array
    meeting: Meeting


def room_for_points(pairs: int) -> Points:
    """Room for all points of so many pairs of elements."""
    m = 2 * pairs
    record = partial(Points, np.zeros((m, 4), np.int64), meeting=new_meeting())
    return zeros(record, (m, 2, 2), (m, 2, 3), (m, 3), (m, 3, 3), (pairs, 2))


class Side(NamedTuple):
    """One side of a pair: the rod, by its number in a group, the element, and where the rod's nodes
    are ``now``, at the end of a step, and ``old``, before it."""

    rod: int
    element: int
    now: Pose
    old: Pose


@inlined
def _size(s: float) -> float:
    """|s| with a round corner at zero, exact at zero and one."""
    return WHOLE * s * s / math.sqrt(s * s + CORNER * CORNER)


@inlined
def _reach(law: Between, axes: Array, n: Array) -> float:
    """How far a section reaches from its centre along a unit vector."""
    one = n[0] * axes[0, 0] + n[1] * axes[1, 0] + n[2] * axes[2, 0]
    two = n[0] * axes[0, 1] + n[1] * axes[1, 1] + n[2] * axes[2, 1]
    if law.round:
        return law.half[0] * math.sqrt(one * one + two * two)
    return law.half[0] * _size(one) + law.half[1] * _size(two)


@njit
def _farthest(law: Between, axes: Array, n: Array, sign: float, out: Array) -> None:
    """Write the point (3,) of a section, from its centre, that reaches farthest along ``sign`` n:
    how `_reach` changes with n."""
    if law.round:
        for c in range(3):
            out[c] = sign * law.half[0] * n[c]
        return
    for c in range(3):
        out[c] = 0.0
    for k in range(2):
        s = n[0] * axes[0, k] + n[1] * axes[1, k] + n[2] * axes[2, k]
        square = s * s + CORNER * CORNER
        slope = WHOLE * s * (square + CORNER * CORNER) / (square * math.sqrt(square))
        for c in range(3):
            out[c] += sign * law.half[k] * slope * axes[c, k]


@inlined
def _rough(kn: float, approach: float) -> tuple[float, float, float]:
    """Slope in N/m, force in N, and energy in J of a contact that came so near."""
    if approach <= 0.0:
        return 0.0, 0.0, 0.0
    if approach < ROUGH_M:
        slope = kn * approach / ROUGH_M
        return slope, 0.5 * slope * approach, slope * approach * approach / 6.0
    more = approach - ROUGH_M
    force = kn * (0.5 * ROUGH_M + more)
    return kn, force, kn * (ROUGH_M**2 / 6.0 + 0.5 * more * (ROUGH_M + more))


@inlined
def _clip(low: float, high: float, a: float, b: float) -> tuple[float, float]:
    """The part of an interval on which a + b s is not negative; its end is below its begin where
    there is none."""
    if b > 0.0:
        return max(low, -a / b), high
    if b < 0.0:
        return low, min(high, -a / b)
    return (low, high) if a >= 0.0 else (0.0, -1.0)


@njit
def _across(q: Array, node: int, out: Array) -> None:
    """Write the normal (3,) of a node's section."""
    w, x, y, z = q[node, 0], q[node, 1], q[node, 2], q[node, 3]
    out[0], out[1] = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x)
    out[2] = 1.0 - 2.0 * (x * x + y * y)


@njit
def meet(law: Between, a: Pose, e: int, b: Pose, f: int, out: Meeting) -> float:
    """Write how element ``e`` of one rod meets element ``f`` of another; the length in m whose half
    either point has, zero where they are nowhere beside each other.

    The normal points from the second to the first.
    """
    (xa, qa), (xb, qb) = a, b
    ta, tb, apart = out.room[0], out.room[1], out.room[2]
    plane, n, m = out.room[3], out.room[4], out.room[5]
    la = lb = square = 0.0
    for c in range(3):
        ta[c], tb[c] = xa[e + 1, c] - xa[e, c], xb[f + 1, c] - xb[f, c]
        apart[c] = xa[e, c] - xb[f, c]
        la += ta[c] * ta[c]
        lb += tb[c] * tb[c]
        square += (apart[c] + 0.5 * (ta[c] - tb[c])) ** 2
    la, lb = math.sqrt(la), math.sqrt(lb)
    reach = 0.5 * (la + lb) + 2.0 * math.sqrt(law.half[0] ** 2 + law.half[1] ** 2)
    if square > reach * reach:
        return 0.0
    for c in range(3):
        ta[c] /= la
        tb[c] /= lb
    # the stretch between the planes through the second's nodes
    low, high = 0.0, la
    _across(qb, f, plane)
    low, high = _clip(low, high, dot(apart, plane), dot(ta, plane))
    _across(qb, f + 1, plane)
    beyond = lb * dot(tb, plane) - dot(apart, plane)
    low, high = _clip(low, high, beyond, -dot(ta, plane))
    if high <= low:
        return 0.0
    write_middle(qa, e, out.axes_a)
    write_middle(qb, f, out.axes_b)
    best, least_held, length = -math.inf, math.inf, 0.0
    tip, cosine = e == len(xa) - 2, dot(ta, tb)
    sine_2, along = 1.0 - cosine * cosine, dot(apart, tb)
    crosses, chosen, ends, longest = sine_2 > CROSSING * CROSSING, -1, False, math.inf
    # where the axes are closest, along the first
    nearest = 0.5 * (low + high)
    if sine_2 > NO_ANGLE * NO_ANGLE:
        nearest = (cosine * along - dot(apart, ta)) / sine_2
    first, last = (COMMON if crosses else OTHER), SHORTEST - 1
    if law.round:
        # within the stretch the gap is stationary there, or at its end
        nearest, first, last = min(max(nearest, low), high), SHORTEST, SHORTEST
    for kind in range(first, last + 1):
        if kind == OTHER and best > -law.half[0] and not ends:
            break
        if kind == COMMON:
            n[0], n[1], n[2] = cross(tb, ta)
        elif kind == SHORTEST:
            for c in range(3):
                n[c] = apart[c] + nearest * ta[c]
        elif kind >= OWN:
            n[0], n[1], n[2] = cross(tb, out.axes_a[:, kind - OWN])
        else:
            for c in range(3):
                n[c] = out.axes_b[c, kind - OTHER]
        slant = dot(n, tb)
        size = 0.0
        for c in range(3):
            n[c] -= slant * tb[c]
            size += n[c] * n[c]
        if size < NO_AXIS:
            continue
        size = math.sqrt(size)
        for c in range(3):
            n[c] /= size
        m[0], m[1], m[2] = cross(tb, n)
        wide = _reach(law, out.axes_a, m) + _reach(law, out.axes_b, m)
        offset, slope = dot(apart, m), dot(ta, m)
        begin, end = _clip(low, high, wide - offset, -slope)
        begin, end = _clip(begin, end, wide + offset, slope)
        if end <= begin:
            return 0.0
        at, rate = dot(apart, n), dot(ta, n)
        sign = 1.0 if at + 0.5 * rate * (begin + end) >= 0.0 else -1.0
        reaches = _reach(law, out.axes_a, n) + _reach(law, out.axes_b, n)
        at_begin, at_end = sign * (at + rate * begin), sign * (at + rate * end)
        if kind in (COMMON, SHORTEST):
            at_begin = at_end = sign * (at + rate * nearest)
        at_begin -= reaches
        at_end -= reaches
        least, met = min(at_begin, at_end), end - begin
        if kind == COMMON:
            # only there does it matter that a prism ends
            ends = tip and abs(offset + slope * la) <= wide
            longest = max(met, 2.0 * law.half[1])
        elif crosses:
            # an end meets with its section, however long its element
            met = min(met, longest)
        held = met * (_rough(1.0, -at_begin)[2] + _rough(1.0, -at_end)[2])
        if held < (1.0 - LESS) * least_held or (held == 0.0 and least > best):
            best, least_held, length, chosen = least, held, met, kind
            for c in range(3):
                out.normal[c] = sign * n[c]
            out.share_a[0], out.share_a[1] = begin / la, end / la
            out.gap[0], out.gap[1] = at_begin, at_end
    if length == 0.0:
        return 0.0
    at_nearest = chosen in (COMMON, SHORTEST)
    if at_nearest:
        # there alone the gap is stationary as the normal turns; a tip has nothing beyond its end
        out.share_a[0] = min(nearest, la) / la if tip else nearest / la
        out.gap[0], out.gap[1] = best, math.inf
        length *= 2.0
    for k in range(2):
        s = out.share_a[k] * la
        z = along + s * cosine
        if not at_nearest:
            z = max(z, 0.0)
        if not at_nearest or f == len(xb) - 2:
            z = min(z, lb)
        out.share_b[k] = z / lb
        for c in range(3):
            out.first[k, c] = xa[e, c] + s * ta[c]
            out.second[k, c] = xb[f, c] + z * tb[c]
        # a face's normal turns with its own rod, so it is met by the other's edge; with the normal
        # in common either has its own edge
        _farthest(law, out.axes_a, out.normal, -1.0, out.arm_a[k])
        _farthest(law, out.axes_b, out.normal, 1.0, out.arm_b[k])
        for c in range(3):
            if OTHER <= chosen < OWN:
                out.arm_b[k, c] = out.first[k, c] + out.arm_a[k, c] - out.second[k, c]
            elif not at_nearest:
                out.arm_a[k, c] = out.second[k, c] + out.arm_b[k, c] - out.first[k, c]
    return length


@njit
def _moved(side: Side, share: float, arm: Array, axes: Array, was: Array, out: Array) -> None:
    """Write how far a point of an element has moved in the step, given its ``arm`` now; ``was``
    (3, 3) is room."""
    e, now, old = side.element, side.now, side.old
    write_middle(old.q, e, was)
    for i in range(3):
        own = axes[0, i] * arm[0] + axes[1, i] * arm[1] + axes[2, i] * arm[2]
        for c in range(3):
            if i == 0:
                out[c] = arm[c] + (1.0 - share) * (now.x[e, c] - old.x[e, c])
                out[c] += share * (now.x[e + 1, c] - old.x[e + 1, c])
            out[c] -= was[c, i] * own


@njit
def meet_pair(
    law: Between, pair: int, a: Side, b: Side, step: TouchStep, points: Points, count: int
) -> tuple[int, float, float]:
    """Add the points in contact of one pair of elements to ``points``, which hold ``count``, and
    write what they remember and the pair's gaps.

    Returns how many points there are then, and as `touch_point` what friction took and contact
    holds.
    """
    room, gaps = points.meeting, points.gaps[pair]
    length = meet(law, a.now, a.element, b.now, b.element, room)
    if length == 0.0:
        room.gap[0] = room.gap[1] = math.inf
    moved_a, moved_b, pull, n = room.room[6], room.room[7], room.room[8], room.normal
    kn, tip = 0.5 * length * law.stiffness, len(a.now.x) - 2
    if a.element == tip and b.element == tip:
        kn *= 0.5  # two tips are met from both sides
    kt, matrix = law.ratio * kn, room.was
    lost = held = 0.0
    for k in range(2):
        gap = gaps[k] = room.gap[k]
        if gap >= 0.0:
            lost += lose_hold(step, pair, k)
            continue
        arm_a, arm_b = room.arm_a[k], room.arm_b[k]
        _moved(a, room.share_a[k], arm_a, room.axes_a, matrix, moved_a)
        _moved(b, room.share_b[k], arm_b, room.axes_b, matrix, moved_b)
        for c in range(3):
            pull[c] = moved_a[c] - moved_b[c]
        along, spring = dot(pull, n), step.before.elongation[pair, k]
        turned = dot(spring, n)
        for c in range(3):
            pull[c] = pull[c] + (spring[c] - along * n[c]) - turned * n[c]
        slope, normal, holds = _rough(kn, -gap)
        gap = -normal / slope  # of a linear law of the same force and slope
        springs, push, stiff = Springs(slope, kt, gap, n, pull), points.push[count], points.stiff
        took, stored = touch_point(law.friction, springs, step, pair, k, push, stiff[count])
        holds += stored - 0.5 * slope * gap * gap
        lost += took
        held += holds
        whole, share, arm = points.whole[count], points.share[count], points.arm[count]
        whole[ROD_A], whole[ELEMENT_A] = a.rod, a.element
        whole[ROD_B], whole[ELEMENT_B] = b.rod, b.element
        share[0, 0], share[0, 1] = 1.0 - room.share_a[k], room.share_a[k]
        share[1, 0], share[1, 1] = 1.0 - room.share_b[k], room.share_b[k]
        for c in range(3):
            arm[0, c], arm[1, c] = arm_a[c], arm_b[c]
        count += 1
    return count, lost, held


@njit
def shortfall(law: Between, pair: int, a: Side, b: Side, allowed: float, points: Points) -> float:
    """The part of a step after which a pair that it closes is about half of ``allowed`` deep.

    Its gaps in ``points`` are those before the step. One where the pair is no deeper than
    ``allowed``, or was closed before.
    """
    room, gaps = points.meeting, points.gaps[pair]
    if gaps[0] < 0.0 or gaps[1] < 0.0:
        return 1.0
    if meet(law, a.now, a.element, b.now, b.element, room) == 0.0:
        return 1.0
    least = 1.0
    for k in range(2):
        if room.gap[k] < -allowed:
            # how far apart they were is not known of elements that were not beside each other
            part = 0.5
            if gaps[k] < math.inf:
                part = (gaps[k] + 0.5 * allowed) / (gaps[k] - room.gap[k])
            least = min(least, part)
    return least


@inlined
def _farther(reach: Array, i: int, e: int) -> float:
    """What an element's nodes reach, by the one that reaches farther."""
    return max(reach[i, e], reach[i, e + 1])


@njit
def approach(
    law: Between,
    pairs: Integers,
    stack: Motion,
    reach: Array,
    room: Meeting,
    gaps: Array,
    closing: Array,
) -> None:
    """Write the least gap in m of every pair (p, 4), and the least and the greatest speed (p, 2) in
    m/s at which two of its nodes close it.

    Nodes may move by ``reach`` (rods, n) before elements count as beside each other; others have an
    infinite gap. Of sections that are so much wider, the gap is that of the sections as they are,
    along the normal by which the wider ones meet: they cannot be nearer than that. Where they meet
    as they are, it is the smaller of both.
    """
    pairs, stack, reach, gaps, closing = unowned((pairs, stack, reach, gaps, closing))
    room = unowned(room)
    wider, n = law.half.copy(), room.room[8]
    for p in range(len(pairs)):
        a, e, b, f = pairs[p, 0], pairs[p, 1], pairs[p, 2], pairs[p, 3]
        more = max(_farther(reach, a, e), _farther(reach, b, f))
        wider[0], wider[1] = law.half[0] + more, law.half[1] + more
        inflated = Between(wider, law.round, law.stiffness, law.ratio, law.friction)
        gaps[p], closing[p, 0], closing[p, 1] = math.inf, 0.0, 0.0
        if meet(inflated, pose_of(stack, a), e, pose_of(stack, b), f, room) == 0.0:
            continue
        write(room.normal, n)
        gaps[p] = min(room.gap[0], room.gap[1])
        for axes in (room.axes_a, room.axes_b):
            gaps[p] += _reach(inflated, axes, n) - _reach(law, axes, n)
        if meet(law, pose_of(stack, a), e, pose_of(stack, b), f, room) > 0.0:
            gap = min(room.gap[0], room.gap[1])
            if gap < gaps[p]:
                gaps[p] = gap
                write(room.normal, n)
        closing[p, 0], closing[p, 1] = math.inf, -math.inf
        for i in range(2):
            for j in range(2):
                speed = 0.0
                for c in range(3):
                    over = stack.velocity[b, f + j, c] - stack.velocity[a, e + i, c]
                    speed += over * n[c]
                closing[p, 0], closing[p, 1] = min(closing[p, 0], speed), max(closing[p, 1], speed)


@njit
def axes_apart(x_a: Array, e: int, x_b: Array, f: int) -> float:
    """The distance in m of the axes of two elements (Ericson, Real-Time Collision Detection, 2005,
    Sec. 5.1.9)."""
    aa = ab = bb = ac = bc = 0.0
    for k in range(3):
        a, b = x_a[e + 1, k] - x_a[e, k], x_b[f + 1, k] - x_b[f, k]
        c = x_a[e, k] - x_b[f, k]
        aa, ab, bb, ac, bc = aa + a * a, ab + a * b, bb + b * b, ac + a * c, bc + b * c
    square, s = aa * bb - ab * ab, 0.0
    if square > 0.0:
        s = min(max((ab * bc - ac * bb) / square, 0.0), 1.0)
    t = (ab * s + bc) / bb
    if not 0.0 <= t <= 1.0:
        t = 0.0 if t < 0.0 else 1.0
        s = min(max((t * ab - ac) / aa, 0.0), 1.0)
    square = 0.0
    for k in range(3):
        a, b = x_a[e + 1, k] - x_a[e, k], x_b[f + 1, k] - x_b[f, k]
        square += (x_a[e, k] - x_b[f, k] + s * a - t * b) ** 2
    return math.sqrt(square)


@njit
def near(law: Between, pairs: Integers, x: Array, reach: Array) -> Integers:
    """Those of the pairs (p, 4) that may meet while nodes ``x`` (rods, n, 3) move by ``reach``
    (rods, n): whose axes are no farther apart than that and their sections."""
    x, reach = unowned((x, reach))
    sections, count = 2.0 * math.hypot(law.half[0], law.half[1]), 0
    found = np.empty(pairs.shape, np.int64)
    for p in range(len(pairs)):
        a, e, b, f = pairs[p, 0], pairs[p, 1], pairs[p, 2], pairs[p, 3]
        within = sections + _farther(reach, a, e) + _farther(reach, b, f)
        if axes_apart(x[a], e, x[b], f) <= within:
            found[count] = pairs[p]
            count += 1
    return found[:count]


@njit
def candidates(
    law: Between, x: Array, turned: Array, reach: Array, rank: int, ranks: int, out: Integers
) -> int:
    """Write the pairs of elements (p, 4) of rods with nodes ``x`` (rods, n, 3) that are `near`
    within ``reach`` (rods, n); how many there are, written or not. Each of so many ``ranks`` finds
    a part of them.

    Boxes along the axes ``turned`` (3, 3) are sorted into cells as large as the largest of them.
    """
    x, reach = unowned((x, reach))
    rods, elements = x.shape[0], x.shape[1] - 1
    low: Array = np.empty((rods * elements, 3))
    high: Array = np.empty((rods * elements, 3))
    section = math.hypot(law.half[0], law.half[1])
    for i in range(rods * elements):
        r, e = i // elements, i % elements
        beyond = section + _farther(reach, r, e)
        for c in range(3):
            begin = end = 0.0
            for k in range(3):
                begin += turned[k, c] * x[r, e, k]
                end += turned[k, c] * x[r, e + 1, k]
            low[i, c], high[i, c] = min(begin, end) - beyond, max(begin, end) + beyond
    # boxes that meet have their middles in one cell, or in two beside each other
    cell, cells = np.empty((rods * elements, 3), np.int64), np.empty(3, np.int64)
    for c in range(3):
        least, side = low[:, c].min(), (high[:, c] - low[:, c]).max()
        side *= 1.0 + 1e-9  # rounding
        for i in range(rods * elements):
            cell[i, c] = 1 + int((0.5 * (low[i, c] + high[i, c]) - least) / side)
        cells[c] = cell[:, c].max() + 2
    keys = (cell[:, 0] * cells[1] + cell[:, 1]) * cells[2] + cell[:, 2]
    order, count = np.argsort(keys), 0
    keys, low, high = keys[order], low[order], high[order]
    # columns of cells that come after a cell's own, and which boxes are in three cells of each
    columns = np.array([0, 1, cells[1] - 1, cells[1], cells[1] + 1]) * cells[2]
    begins, ends = np.zeros(5, np.int64), np.zeros(5, np.int64)
    for first in range(len(order) * rank // ranks, len(order) * (rank + 1) // ranks):
        i = order[first]
        for k in range(5):
            middle_key = keys[first] + columns[k]
            while begins[k] < len(keys) and keys[begins[k]] < middle_key - 1:
                begins[k] += 1
            while ends[k] < len(keys) and keys[ends[k]] <= middle_key + 1:
                ends[k] += 1
            for second in range(max(begins[k], first + 1), ends[k]):
                if low[first, 0] > high[second, 0] or low[second, 0] > high[first, 0]:
                    continue
                if low[first, 1] > high[second, 1] or low[second, 1] > high[first, 1]:
                    continue
                if low[first, 2] > high[second, 2] or low[second, 2] > high[first, 2]:
                    continue
                j = order[second]
                a, e, b, f = i // elements, i % elements, j // elements, j % elements
                if a == b:
                    continue
                within = 2.0 * section + _farther(reach, a, e) + _farther(reach, b, f)
                if axes_apart(x[a], e, x[b], f) > within:
                    continue
                # the element with a tip is the first, else the rod of the lower number
                tip_a, tip_b = e == elements - 1, f == elements - 1
                if (tip_b and not tip_a) or (tip_a == tip_b and b < a):
                    a, e, b, f = b, f, a, e
                # two tips are met from both sides: either may run into the other end-on
                for side in range(2 if tip_a and tip_b else 1):
                    if count < len(out):
                        pair = out[count]
                        pair[2 * side], pair[2 * side + 1] = a, e
                        pair[2 - 2 * side], pair[3 - 2 * side] = b, f
                    count += 1
    return count
