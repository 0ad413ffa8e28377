"""One time step of several rods that touch each other, which share it.

Newton's matrix has a block-tridiagonal block for each rod and, for each point between two rods,
three more rows: with A the rods by themselves, B the displacements of one side of the points over
the other and K what their forces lose by them, (A + Bᵀ K B) u = -r. The rods are solved one by one,
for -r and for unit forces at their points, which gives the compliance C = B A⁻¹ Bᵀ of the points.
What is left is sparse and of the points alone, (1 + K C) z = -K B A⁻¹ r, and
u = -A⁻¹ (r + Bᵀ z). This is exact, so it converges as Newton's method does for one rod, but for
the turning of normals and arms, which the tangent leaves out.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, cast

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from ..arrays import Array, Integers
from ..compiled import inlined, njit
from .chain import Chain, System, chain_of, new_system, solve_columns, total_length
from .contact import Surface, Touch
from .element import Elements, assemble_tangent
from .motion import ITERATIONS, Hub, Motion, Scheme, hub_of, motion_of, rod
from .pairs import (
    ROD_A,
    ROD_B,
    Between,
    Points,
    crossing_kn,
    meet_pair,
    new_meeting,
    room_for_points,
)
from .pairs import shortfall as pair_shortfall
from .statics import ROUNDING, residual_norm
from .step import (
    ITERATION_LIMIT,
    PATIENT,
    SHORTER,
    SHORTEST_PART,
    Scratch,
    assemble,
    begin,
    deepest,
    finish,
    go,
    keep,
    new_scratch,
    shortfall,
)


class Room(NamedTuple):
    """Room for a step of several rods, stacked: their next state, systems and scratch, their
    residual's tolerances, what friction took and contact holds of each (rods, 2), the gaps of the
    pairs (pairs, 2), the points, and their begin in each rod's list (rods + 1,) of points and sides
    (2 m, 2)."""

    new: Motion
    systems: System
    scratches: Scratch
    tolerance: Array
    works: Array
    gaps: Array
    points: Points
    begins: Integers
    sides: Integers


def _stacked(one: Any, count: int) -> Any:
    """A record of arrays, each ``count`` times along a first axis."""
    if isinstance(one, tuple):
        return type(one)(*(_stacked(each, count) for each in one))
    return np.zeros((count, *one.shape), dtype=one.dtype)


def room_for(rods: int, nodes: int, rim: int, pairs: int) -> Room:
    """Room for so many rods of so many nodes, with so many pairs of elements."""
    points = room_for_points(pairs)
    return Room(
        motion_of(rods, nodes, rim),
        cast(System, _stacked(new_system(nodes), rods)),
        cast(Scratch, _stacked(new_scratch(nodes), rods)),
        np.zeros(rods),
        np.zeros((rods, 2)),
        np.zeros((pairs, 2)),
        points,
        np.zeros(rods + 1, dtype=np.int64),
        np.zeros((2 * len(points.push), 2), dtype=np.int64),
    )


@inlined
def _system_of(stack: System, i: int) -> System:
    return System(
        stack.diagonal[i], stack.above[i], stack.below[i], stack.residual[i], stack.solution[i]
    )


@inlined
def _scratch_of(stack: Scratch, i: int) -> Scratch:
    e = stack.elements
    return Scratch(
        Elements(e.middle[i], e.strain[i], e.load[i], e.ends[i], e.room[i]),
        stack.target[i],
        stack.x[i],
        stack.q[i],
        stack.solution[i],
        stack.matrix[i],
        stack.matrix_before[i],
        stack.gaps[i],
    )


class Law(NamedTuple):
    """What acts on rods: the scheme, the surface and the law between bristles."""

    scheme: Scheme
    surface: Surface
    between: Between


@njit
def _begin_all(
    law: Law, chains: Chain, hubs: Hub, members: Integers, stack: Motion, h: float, room: Room
) -> None:
    for k in range(len(members)):
        i = members[k]
        tolerance = begin(
            chain_of(chains, i),
            law.scheme,
            law.surface,
            hub_of(hubs, i),
            rod(stack, i),
            rod(room.new, k),
            h,
            _scratch_of(room.scratches, k),
        )
        farthest = 0.0
        for place in room.new.x[k].ravel():
            farthest = max(farthest, abs(place))
        room.tolerance[k] = tolerance + ROUNDING * crossing_kn(law.between) * farthest


@njit
def _assemble_all(
    law: Law,
    chains: Chain,
    loads: Array,
    members: Integers,
    pairs: Integers,
    stack: Motion,
    before: Touch,
    now: Touch,
    h: float,
    room: Room,
) -> tuple[int, float]:
    """Write residuals and points; how many points touch, and the greatest residual over what counts
    as none."""
    step = h if law.scheme.inertia else 0.0
    for k in range(len(members)):
        i = members[k]
        lost, held = assemble(
            chain_of(chains, i),
            law.scheme,
            law.surface,
            loads[i],
            rod(stack, i),
            rod(room.new, k),
            h,
            _system_of(room.systems, k),
            _scratch_of(room.scratches, k),
        )
        room.works[k, 0], room.works[k, 1] = lost, held
    meeting, count = new_meeting(), 0
    for p in range(len(pairs)):
        a, b = pairs[p, ROD_A], pairs[p, ROD_B]
        count, lost, held = meet_pair(
            law.between,
            p,
            pairs[p],
            rod(room.new, a),
            rod(stack, members[a]),
            rod(room.new, b),
            rod(stack, members[b]),
            before,
            now,
            step,
            meeting,
            room.gaps[p],
            room.points,
            count,
        )
        room.works[a, 0] += 0.5 * lost
        room.works[b, 0] += 0.5 * lost
        room.works[a, 1] += 0.5 * held
        room.works[b, 1] += 0.5 * held
    for p in range(count):
        for side in range(2):
            _push(room.points, p, side, room.systems.residual)
    worst = 0.0
    for k in range(len(members)):
        total = total_length(chain_of(chains, members[k]))
        norm = residual_norm(room.systems.residual[k], total)
        if not math.isfinite(norm):
            return count, math.inf
        worst = max(worst, norm / room.tolerance[k])
    return count, worst


@inlined
def _share(points: Points, p: int, side: int, node: int) -> float:
    """The part of a side's displacement that is of its element's first or second node.

    The arm turns with the element's middle.
    """
    second = points.share[p, side]
    return second if node == 1 else 1.0 - second


@njit
def _push(points: Points, p: int, side: int, residual: Array) -> None:
    """Take a point's force on one side off the residual (rods, n, 6)."""
    sign = 1.0 if side == 0 else -1.0
    r, e = points.whole[p, 2 * side], points.whole[p, 2 * side + 1]
    arm, push = points.arm[p, side], points.push[p]
    for node in range(2):
        part = sign * _share(points, p, side, node)
        for c in range(3):
            i, j = (c + 1) % 3, (c + 2) % 3
            residual[r, e + node, c] -= part * push[c]
            moment = arm[i] * push[j] - arm[j] * push[i]
            residual[r, e + node, 3 + c] -= 0.5 * sign * moment


@njit
def _displacement(points: Points, p: int, side: int, moved: Array, j: int, out: Array) -> None:
    """Write the displacement (3,) of one side of a point by column ``j`` of its rod's (n, 6, m)."""
    e, arm = points.whole[p, 2 * side + 1], points.arm[p, side]
    for c in range(3):
        a, b = (c + 1) % 3, (c + 2) % 3
        out[c] = 0.0
        for node in range(2):
            u = moved[e + node]
            out[c] += _share(points, p, side, node) * u[c, j]
            out[c] += 0.5 * (u[3 + a, j] * arm[b] - u[3 + b, j] * arm[a])


@njit
def _list_sides(points: Points, count: int, begins: Integers, sides: Integers) -> None:
    """Write each rod's list of points and which side of them it is."""
    begins[:] = 0
    for p in range(count):
        begins[points.whole[p, ROD_A] + 1] += 1
        begins[points.whole[p, ROD_B] + 1] += 1
    for k in range(1, len(begins)):
        begins[k] += begins[k - 1]
    filled = np.zeros(len(begins), dtype=np.int64)
    for p in range(count):
        for side in range(2):
            r = points.whole[p, 2 * side]
            at = begins[r] + filled[r]
            sides[at, 0], sides[at, 1] = p, side
            filled[r] += 1


@njit
def _linearise(
    law: Law, chains: Chain, members: Integers, h: float, room: Room, count: int
) -> tuple[bool, Array, Array, Integers, Integers, Array]:
    """Solve every rod for its residual, into its system's solution, and for unit forces at its
    points.

    Returns whether none is singular, these columns one rod after another, and of 1 + K C the
    values, rows and columns, and the right-hand side.
    """
    points, begins, sides = room.points, room.begins, room.sides
    nodes = room.new.x.shape[1]
    _list_sides(points, count, begins, sides)
    entries = 3 * count
    for k in range(len(members)):
        entries += (3 * (begins[k + 1] - begins[k])) ** 2
    values, rows, columns = (
        np.empty(entries),
        np.empty(entries, np.int32),
        np.empty(entries, np.int32),
    )
    apart, right = np.zeros((count, 3)), np.zeros(3 * count)
    kept = np.empty(nodes * 6 * 6 * count)
    at, used, out = 0, 0, np.empty(3)
    for d in range(3 * count):
        values[at], rows[at], columns[at] = 1.0, d, d
        at += 1
    for k in range(len(members)):
        chain, system = chain_of(chains, members[k]), _system_of(room.systems, k)
        rate = chain.beta / h if law.scheme.inertia else 0.0
        assemble_tangent(chain, rate, system, _scratch_of(room.scratches, k).elements)
        many = 3 * (begins[k + 1] - begins[k])
        loads = np.zeros((nodes, 6, 1 + many))
        for i in range(nodes):
            for r in range(6):
                loads[i, r, 0] = -system.residual[i, r]
        for s in range(begins[k], begins[k + 1]):
            p, side = sides[s, 0], sides[s, 1]
            sign, e, arm = (
                1.0 if side == 0 else -1.0,
                points.whole[p, 2 * side + 1],
                points.arm[p, side],
            )
            for node in range(2):
                part = sign * _share(points, p, side, node)
                for c in range(3):
                    a, b = (c + 1) % 3, (c + 2) % 3
                    j = 1 + 3 * (s - begins[k]) + c
                    # arm × e_c
                    loads[e + node, c, j] += part
                    loads[e + node, 3 + a, j] += 0.5 * sign * arm[b]
                    loads[e + node, 3 + b, j] -= 0.5 * sign * arm[a]
        if not solve_columns(system, loads):
            return False, kept, values, rows, columns, right
        for i in range(nodes):
            for r in range(6):
                system.solution[i, r] = loads[i, r, 0]
                for j in range(many):
                    kept[used + (i * 6 + r) * many + j] = loads[i, r, 1 + j]
        used += nodes * 6 * many
        for s in range(begins[k], begins[k + 1]):
            p, side = sides[s, 0], sides[s, 1]
            sign, stiff = 1.0 if side == 0 else -1.0, points.stiff[p]
            for j in range(1 + many):
                _displacement(points, p, side, loads, j, out)
                if j == 0:
                    for c in range(3):
                        apart[p, c] += sign * out[c]
                    continue
                other = 3 * sides[begins[k] + (j - 1) // 3, 0] + (j - 1) % 3
                for c in range(3):
                    value = 0.0
                    for d in range(3):
                        value += stiff[c, d] * sign * out[d]
                    values[at], rows[at], columns[at] = value, 3 * p + c, other
                    at += 1
    for p in range(count):
        for c in range(3):
            for d in range(3):
                right[3 * p + c] += points.stiff[p, c, d] * apart[p, d]
    return True, kept[:used], values, rows, columns, right


@njit
def _add_forces(room: Room, kept: Array, forces: Array) -> None:
    """Add what the points' forces move every rod by to its solution, and keep where it is."""
    used, nodes = 0, room.new.x.shape[1]
    for k in range(len(room.new.x)):
        solution, first = room.systems.solution[k], room.begins[k]
        many = 3 * (room.begins[k + 1] - first)
        for i in range(nodes):
            for r in range(6):
                for j in range(many):
                    force = forces[3 * room.sides[first + j // 3, 0] + j % 3]
                    solution[i, r] -= kept[used + (i * 6 + r) * many + j] * force
        used += nodes * 6 * many
        keep(rod(room.new, k), solution, _scratch_of(room.scratches, k))


@njit
def _go_all(chains: Chain, members: Integers, room: Room, part: float) -> None:
    for k in range(len(members)):
        scratch = _scratch_of(room.scratches, k)
        go(chain_of(chains, members[k]), rod(room.new, k), part, scratch)


@njit
def _advance_all(law: Law, chains: Chain, members: Integers, pairs: Integers, room: Room) -> None:
    """Move all by Newton's step, or by so much of it that what comes together just touches."""
    stiffness, meeting, part = crossing_kn(law.between), new_meeting(), 1.0
    for trial in range(SHORTER + 1):
        _go_all(chains, members, room, part)
        least = 1.0
        if law.surface.there:
            for k in range(len(members)):
                chain, scratch = chain_of(chains, members[k]), _scratch_of(room.scratches, k)
                least = min(least, shortfall(chain, law.surface, rod(room.new, k), scratch))
        for p in range(len(pairs)):
            a, b = pairs[p, ROD_A], pairs[p, ROD_B]
            allowed = deepest(chain_of(chains, members[a]), stiffness)
            both = rod(room.new, a), rod(room.new, b)
            short = pair_shortfall(
                law.between, pairs[p], both[0], both[1], room.gaps[p], allowed, meeting
            )
            least = min(least, short)
        if least == 1.0 or trial == SHORTER:
            return
        part *= max(least, 0.1)


@njit
def _finish_all(
    law: Law,
    chains: Chain,
    loads: Array,
    members: Integers,
    stack: Motion,
    h: float,
    room: Room,
    iterations: int,
) -> None:
    for k in range(len(members)):
        i = members[k]
        new = rod(room.new, k)
        finish(
            chain_of(chains, i),
            law.scheme,
            loads[i],
            rod(stack, i),
            new,
            h,
            _system_of(room.systems, k),
            room.works[k, 0],
            room.works[k, 1],
        )
        new.totals[ITERATIONS] += iterations


def joint_step(
    law: Law,
    chains: Chain,
    loads: Array,
    hubs: Hub,
    members: Integers,
    pairs: Integers,
    stack: Motion,
    before: Touch,
    now: Touch,
    h: float,
    room: Room,
) -> int:
    """Write the rods ``members`` of the ``stack`` after a step of ``h`` seconds into the room.

    ``pairs`` (p, 4) are the elements that may touch, see `pairs.Points`, their rods counted among
    the members; ``before`` and ``now`` are what their points remember. Returns Newton's iterations,
    or -1 where it does not converge.
    """
    _begin_all(law, chains, hubs, members, stack, h, room)
    least, part = math.inf, 1.0
    for iteration in range(ITERATION_LIMIT):
        count, worst = _assemble_all(
            law, chains, loads, members, pairs, stack, before, now, h, room
        )
        if worst <= 1.0:
            _finish_all(law, chains, loads, members, stack, h, room, iteration)
            return iteration
        if iteration > PATIENT and worst >= least and part > SHORTEST_PART:
            part *= 0.5
            _go_all(chains, members, room, part)
            continue
        if not math.isfinite(worst):
            return -1
        fine, kept, values, rows, columns, right = _linearise(law, chains, members, h, room, count)
        if not fine:
            return -1
        forces = np.zeros(0)
        if count:
            matrix = csc_array((values, (rows, columns)), shape=(3 * count, 3 * count))
            try:
                forces = splu(matrix).solve(right)
            except RuntimeError:  # singular
                return -1
        least, part = worst, 1.0
        _add_forces(room, kept, forces)
        _advance_all(law, chains, members, pairs, room)
    return -1
