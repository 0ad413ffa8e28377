"""Contact of bristle against bristle: gap of two elements, contact force and friction, compiled.

An element is a straight prism with the rod's cross-section. Two elements meet over a *stretch*: the
part of the first that lies beside the second. It is short where they cross, and as long as both
where they are parallel. The direction of the gap depends on the angle:

- Where they cross, it is the common normal of both axes. The gap is constant over the stretch and
  is evaluated at the closest points of the axes. These may lie a little beyond an element's end,
  but not beyond a tip. Round wires meet so at any angle, at the closest point of the stretch.
- Elsewhere the gap is evaluated at both ends of the stretch, along one of several normals: those of
  the second element's faces, and cross products of its axis with edges of the first. The one with
  the least contact energy is taken or, without contact, the one with the largest gap. This serves
  nearly parallel elements, whose common normal is ill-defined and may point along the wide sides,
  and a tip that ends before the closest point or meets the other bristle end-on.

For a prism that ends beside one that goes on, these normals and the common one are all separating
axes (Gottschalk, Lin and Manocha, OBBTree, SIGGRAPH 1996). So where two prisms begin to touch, one
of them has no penetration, and the energy does not jump.

Contact at closest points alone fails at small angles (Meier, Popp and Wall, Comput. Methods Appl.
Mech. Engng 308 (2016) 377). Contact at fixed points of an element misses prisms that cross between
them. The stretches end at planes through the nodes, shared by both neighbouring elements, so each
place of a bent rod belongs to one element.

The normal force grows at first with the square of the penetration, like that of rough faces, and
then linearly (Meier, Popp and Wall, Sec. 4). Otherwise the corners of the polygons that represent
bent rods would decide which of several elements touches. Friction is that of a point on a plane,
`contact.touch_point`.
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

# A vector with a smaller square has no direction.
NO_AXIS = 1e-16
# Axes at a smaller angle in rad have no unique closest points.
NO_ANGLE = 1e-4
# Elements cross if the sine of their angle is larger; otherwise they lie side by side.
CROSSING = 0.25
# Edges are rounded over this angle in rad. Sharp ones would make flush faces turn back and forth.
CORNER = 0.02
WHOLE = math.sqrt(1.0 + CORNER * CORNER)
# Penetration in m from which the force grows linearly.
ROUGH_M = 1e-6
# Kinds of contact normal: the common normal of both axes, a face normal of the second element, the
# cross product of the second's axis with an edge of the first, the shortest connection of the axes.
COMMON, OTHER, OWN, SHORTEST = 0, 1, 3, 5
# A candidate normal replaces an earlier one only if its energy is lower by this share. Flush faces
# have nearly equal energies, and Newton's method would alternate between them.
LESS = 1e-3
# Columns of `Points.whole`: rod and element of either side.
ROD_A, ELEMENT_A, ROD_B, ELEMENT_B = range(4)


class Between(NamedTuple):
    """Law of contact between two bristles, for compiled code.

    ``half`` (2,) are the half sides of the cross-section in m, and ``round`` says whether it is
    round. ``stiffness`` is in N/m per m of the stretch, ``ratio`` the tangential stiffness over it.
    """

    half: Array
    round: bool
    stiffness: float
    ratio: float
    friction: Friction


def between_of(contact: Contact, section: RodSection) -> Between:
    """The law of a ``contact``. Its Kn is that of two bristles that cross at right angles, where
    the stretch is the section's width."""
    return Between(
        np.array([section.half_thin_m, section.half_wide_m]),
        section.is_round,
        contact.kn_N_m / (2.0 * section.half_wide_m),
        contact.kt_over_kn,
        friction_of(contact),
    )


@inlined
def crossing_kn(law: Between) -> float:
    """Stiffness in N/m of two bristles that cross at right angles, wide side on wide side."""
    return 2.0 * law.half[1] * law.stiffness


class Meeting(NamedTuple):
    """Work space for one pair of elements: the stretch of the first along the second.

    ``first`` and ``second`` (2, 3) are points of the two centre lines at the ends of the stretch.
    ``share_a`` and ``share_b`` (2,) locate them along the elements. ``gap`` (2,) is the gap there,
    ``normal`` (3,) its direction, ``axes_a`` and ``axes_b`` (3, 3) the elements' axes. ``arm_a``
    and ``arm_b`` (2, 3) lead from the centre lines to the contact points. ``room`` (9, 3) and
    ``was`` hold intermediate vectors.
    """

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
    """Empty work space."""
    ends, pair, axes = (2, 3), 2, (3, 3)
    return zeros(Meeting, ends, ends, pair, pair, pair, 3, axes, axes, ends, ends, (9, 3), axes)


class Points(NamedTuple):
    """The current contact points, then the gaps of all pairs and the work space for one.

    ``whole`` (m, 4) are rod and element of either side, ``share`` (m, 2, 2) the weights of the
    first and second node in each, ``arm`` (m, 2, 3) the vectors from the centre lines, which turn
    with the elements' middles. ``push`` (m, 3) is the force on the first side, ``stiff`` (m, 3, 3)
    minus its derivative by that side's displacement over the other's. ``gaps`` is (p, 2).
    """

    whole: Integers
    share: Array
    arm: Array
    push: Array
    stiff: Array
    gaps: Array
    meeting: Meeting


def room_for_points(pairs: int) -> Points:
    """Arrays for the contact points of this many pairs of elements."""
    m = 2 * pairs
    record = partial(Points, np.zeros((m, 4), np.int64), meeting=new_meeting())
    return zeros(record, (m, 2, 2), (m, 2, 3), (m, 3), (m, 3, 3), (pairs, 2))


class Side(NamedTuple):
    """One side of a pair: the rod's number in its group, the element, and the rod's nodes at the
    end of a step (``now``) and before it (``old``)."""

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
    """Half the extent of a section along the unit vector n: its support function."""
    one = n[0] * axes[0, 0] + n[1] * axes[1, 0] + n[2] * axes[2, 0]
    two = n[0] * axes[0, 1] + n[1] * axes[1, 1] + n[2] * axes[2, 1]
    if law.round:
        return law.half[0] * math.sqrt(one * one + two * two)
    return law.half[0] * _size(one) + law.half[1] * _size(two)


@njit
def _farthest(law: Between, axes: Array, n: Array, sign: float, out: Array) -> None:
    """Write the point (3,) of a section, from its centre, that is farthest along ``sign`` n: the
    gradient of `_reach` by n."""
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
    """Stiffness in N/m, force in N and energy in J at a penetration of ``approach``."""
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
    """The part of an interval on which a + b s ≥ 0; its end is below its begin if there is none."""
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
    """Write how element ``e`` of one rod meets element ``f`` of another, in ``out``.

    Returns a length in m, half of which either of its two points stands for. It is zero where the
    elements are nowhere beside each other. The normal points from the second to the first.
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
    # the stretch ends at the planes through the second's nodes
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
    # position along the first at which the axes are closest
    nearest = 0.5 * (low + high)
    if sine_2 > NO_ANGLE * NO_ANGLE:
        nearest = (cosine * along - dot(apart, ta)) / sine_2
    first, last = (COMMON if crosses else OTHER), SHORTEST - 1
    if law.round:
        # the least gap is there, or at an end of the stretch
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
            # only with this normal does the end of a prism matter
            ends = tip and abs(offset + slope * la) <= wide
            longest = max(met, 2.0 * law.half[1])
        elif crosses:
            # an end meets with its section, whatever the element's length
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
        # only there is the gap stationary as the normal turns; a tip has nothing beyond its end
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
        # a face normal turns with its own rod, so the contact point is on the other's edge; with a
        # common normal each has its own edge
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
    """Write the displacement (3,) in the step of an element's point whose present ``arm`` is given;
    ``was`` (3, 3) is work space."""
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
    """Append the contact points of one pair of elements to the first ``count`` of ``points``.

    Also writes friction's state and the pair's gaps. Returns the new count and, as `touch_point`,
    the energy in J that friction dissipated and that contact stores.
    """
    room, gaps = points.meeting, points.gaps[pair]
    length = meet(law, a.now, a.element, b.now, b.element, room)
    if length == 0.0:
        room.gap[0] = room.gap[1] = math.inf
    moved_a, moved_b, pull, n = room.room[6], room.room[7], room.room[8], room.normal
    kn, tip = 0.5 * length * law.stiffness, len(a.now.x) - 2
    if a.element == tip and b.element == tip:
        kn *= 0.5  # the list of pairs has two tips in both orders
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
        gap = -normal / slope  # of the linear law with this force and slope
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
    """Share of a step after which a newly closed pair has penetrated about half of ``allowed`` (m).

    The gaps in ``points`` are those before the step. Returns one if the pair is no deeper than
    ``allowed`` or was already closed.
    """
    room, gaps = points.meeting, points.gaps[pair]
    if gaps[0] < 0.0 or gaps[1] < 0.0:
        return 1.0
    if meet(law, a.now, a.element, b.now, b.element, room) == 0.0:
        return 1.0
    least = 1.0
    for k in range(2):
        if room.gap[k] < -allowed:
            # elements that were not beside each other have no earlier gap
            part = 0.5
            if gaps[k] < math.inf:
                part = (gaps[k] + 0.5 * allowed) / (gaps[k] - room.gap[k])
            least = min(least, part)
    return least


@inlined
def _farther(reach: Array, i: int, e: int) -> float:
    """The larger of the two reaches of an element's nodes."""
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
    """Write each pair's least gap in m, and the range (p, 2) of its nodes' closing speeds in m/s.

    ``pairs`` is (p, 4). Nodes may move by ``reach`` (rods, n) before elements count as beside each
    other; other pairs have an infinite gap. The gap is a lower bound: sections widened by the reach
    are used to find the normal, and the gap of the true sections is taken along it. If the true
    sections meet as they are, the smaller of both gaps counts.
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
    """Distance in m of two elements' axes (Ericson, Real-Time Collision Detection, 2005,
    §5.1.9)."""
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
    """The pairs (of (p, 4)) that may meet while nodes ``x`` (rods, n, 3) move by up to ``reach``
    (rods, n): their axes are no farther apart than the reaches plus the section's diagonal."""
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
    """Write the pairs of elements (p, 4) that are `near` each other; returns their number.

    The number counts pairs that did not fit in ``out`` too. Nodes are ``x`` (rods, n, 3), which may
    move by ``reach`` (rods, n). Each of the ``ranks`` finds its own part of the pairs. The search
    sorts boxes along the axes ``turned`` (3, 3) into a grid with cells as large as the largest box.
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
    # overlapping boxes have their centres in the same cell or in neighbouring ones
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
    # columns of cells that follow a cell's own, and the range of boxes in three cells of each
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
                # an element with a tip comes first, otherwise the rod with the lower number
                tip_a, tip_b = e == elements - 1, f == elements - 1
                if (tip_b and not tip_a) or (tip_a == tip_b and b < a):
                    a, e, b, f = b, f, a, e
                # two tips make two pairs: either may run into the other end-on
                for side in range(2 if tip_a and tip_b else 1):
                    if count < len(out):
                        pair = out[count]
                        pair[2 * side], pair[2 * side + 1] = a, e
                        pair[2 - 2 * side], pair[3 - 2 * side] = b, f
                    count += 1
    return count
