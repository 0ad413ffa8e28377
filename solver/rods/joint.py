"""One time step of several rods that touch each other, which share it.

Newton's matrix has a block-tridiagonal block for each rod and, for each point between two rods,
three more rows: with A the rods by themselves, B the displacements of one side of the points over
the other and K what their forces lose by them, (A + Bᵀ K B) u = -r. The rods are solved one by one,
for -r and for unit forces at their points, which gives the compliance C = B A⁻¹ Bᵀ of the points.
What is left is of the points alone, (1 + K C) z = -K B A⁻¹ r, and u = -A⁻¹ (r + Bᵀ z). This is
exact, so it converges as Newton's method does for one rod, but for the turning of normals and
arms, which the tangent leaves out, and for the first iterations, see `step.EARLY`.

Rods that touch each other now, directly or through others, are a cluster. Each cluster iterates by
itself: it rests where its residual counts as none, and goes on if another runs into it.
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
from .contact import Obstacle, Touch
from .element import Elements, assemble_tangent
from .motion import ITERATIONS, Hub, Motion, Scheme, hub_of, motion_of, pose_of, rod, write
from .pairs import (
    ROD_A,
    ROD_B,
    Between,
    Meeting,
    Points,
    crossing_kn,
    meet_pair,
    new_meeting,
    room_for_points,
)
from .pairs import shortfall as pair_shortfall
from .statics import ROUNDING, excess
from .step import (
    EARLY,
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
    inert,
    keep,
    new_scratch,
    shortfall,
)

# What a rod does next: nothing, as its cluster is in equilibrium, a step of Newton's, or back by a
# half of its last one.
RESTS, GOES, RETURNS = range(3)
# A cluster whose residual is not yet none after so many iterations rests where it is no more than
# so many times that, a tenth of the error that the step may have: where a contact passes from one
# face to another its force has a jump.
FEW, FAIR = 3, 10.0
# So many unknowns of a cluster's points are solved as a full matrix, more as a sparse one.
FULL = 240
# Iterations that failed, and those that wait for a sparse solution.
FAILED, WAITS = -1, -2


class Room(NamedTuple):
    """Room for a step of several rods, stacked: their next state, systems and scratch, the
    force and the moment (rods, 2) that count as none of each, what friction took and contact holds
    of each (rods, 2) by itself and with the others, its residual by itself (rods, n, 6) and with
    the others over what counts as none, its cluster, its cluster's greatest residual, what it does
    next, the last such residual from which it took a step, how much of that step it took, and how
    much it ought to. Then the gaps of the pairs (pairs, 2), the points, and their begin in each
    rod's list (rods + 1,) of points and sides (2 m, 2)."""

    new: Motion
    systems: System
    scratches: Scratch
    none: Array
    own_works: Array
    works: Array
    own: Array
    excess: Array
    cluster: Integers
    worst: Array
    doing: Integers
    last: Array
    part: Array
    short: Array
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
    """Room for so many rods of so many nodes, with so many pairs of elements at most."""
    points = room_for_points(pairs)
    return Room(
        motion_of(rods, nodes, rim),
        cast(System, _stacked(new_system(nodes), rods)),
        cast(Scratch, _stacked(new_scratch(nodes), rods)),
        np.zeros((rods, 2)),
        np.zeros((rods, 2)),
        np.zeros((rods, 2)),
        np.zeros((rods, nodes, 6)),
        np.zeros(rods),
        np.zeros(rods, dtype=np.int64),
        np.zeros(rods),
        np.zeros(rods, dtype=np.int64),
        np.zeros(rods),
        np.zeros(rods),
        np.zeros(rods),
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
    surface: Obstacle
    between: Between


@njit
def _begin_all(
    law: Law, chains: Chain, hubs: Hub, members: Integers, stack: Motion, h: float, room: Room
) -> None:
    for k in range(len(members)):
        i = members[k]
        force, moment = begin(
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
        rounding = ROUNDING * crossing_kn(law.between) * farthest
        room.none[k, 0] = force + rounding
        room.none[k, 1] = moment + rounding * total_length(chain_of(chains, i))
        room.doing[k], room.last[k] = GOES, math.inf


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
    early: bool,
    room: Room,
) -> int:
    """Write residuals, of rods by themselves only where they moved, and points; how many points
    touch."""
    step = h if law.scheme.inertia else 0.0
    for k in range(len(members)):
        i = members[k]
        if room.doing[k] != RESTS:
            lost, held = assemble(
                chain_of(chains, i),
                law.scheme,
                law.surface,
                loads[i],
                rod(stack, i),
                rod(room.new, k),
                h,
                early,
                _system_of(room.systems, k),
                _scratch_of(room.scratches, k),
            )
            room.own_works[k, 0], room.own_works[k, 1] = lost, held
            write(room.systems.residual[k], room.own[k])
        else:
            write(room.own[k], room.systems.residual[k])
        room.works[k, 0], room.works[k, 1] = room.own_works[k, 0], room.own_works[k, 1]
    meeting, count = new_meeting(), 0
    for p in range(len(pairs)):
        a, b = pairs[p, ROD_A], pairs[p, ROD_B]
        count, lost, held = meet_pair(
            law.between,
            p,
            pairs[p],
            pose_of(room.new, a),
            pose_of(stack, members[a]),
            pose_of(room.new, b),
            pose_of(stack, members[b]),
            before,
            now,
            step,
            early,
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
    for k in range(len(members)):
        over = excess(room.systems.residual[k], room.none[k, 0], room.none[k, 1])
        room.excess[k] = over if math.isfinite(over) else math.inf
    return count


@njit
def _first_of(cluster: Integers, k: int) -> int:
    """The rod that stands for a cluster, from any of its rods."""
    while cluster[k] != k:
        k = cluster[k]
    return k


@njit
def _gather(room: Room, count: int) -> None:
    """Find the clusters that the points make, and the greatest residual of each."""
    cluster, worst, last, part = room.cluster, room.worst, room.last, room.part
    for k in range(len(cluster)):
        cluster[k] = k
    for p in range(count):
        a = _first_of(cluster, room.points.whole[p, ROD_A])
        b = _first_of(cluster, room.points.whole[p, ROD_B])
        cluster[max(a, b)] = min(a, b)
    for k in range(len(cluster)):
        # the first of a cluster has the lowest number, so that it comes first
        c = cluster[k] = cluster[cluster[k]]
        if c == k:
            worst[k] = room.excess[k]
        else:
            worst[c], last[c] = max(worst[c], room.excess[k]), max(last[c], last[k])
            part[c] = min(part[c], part[k])
    for k in range(len(cluster)):
        c = cluster[k]
        last[k], part[k], worst[k] = last[c], part[c], worst[c]


@njit
def _decide(room: Room, count: int, iteration: int, fair: float) -> tuple[bool, int]:
    """Decide what every rod does next, with ``fair`` as `FAIR`; whether any moves, and how many
    points are of rods that take a step, which come to stand first, or `FAILED` where a step cannot
    mend it."""
    moves = False
    for k in range(len(room.doing)):
        moved = room.doing[k] != RESTS
        if room.worst[k] <= (fair if iteration > FEW else 1.0):
            room.doing[k], room.last[k], room.part[k] = RESTS, math.inf, 1.0
            continue
        moves, stalls = True, iteration > PATIENT and room.worst[k] >= room.last[k]
        if stalls and room.part[k] > SHORTEST_PART:
            room.part[k] *= 0.5
            # one that rested has no step to take back, but its cluster does
            room.doing[k] = RETURNS if moved else RESTS
        elif not math.isfinite(room.worst[k]):
            return True, FAILED
        else:
            room.doing[k] = GOES
    points, kept = room.points, 0
    for p in range(count):
        if room.doing[points.whole[p, ROD_A]] == GOES:
            for c in range(4):
                points.whole[kept, c] = points.whole[p, c]
            for side in range(2):
                points.share[kept, side] = points.share[p, side]
                for c in range(3):
                    points.arm[kept, side, c] = points.arm[p, side, c]
            for c in range(3):
                points.push[kept, c] = points.push[p, c]
                for d in range(3):
                    points.stiff[kept, c, d] = points.stiff[p, c, d]
            kept += 1
    return moves, kept


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


class Waiting(NamedTuple):
    """An iteration that waits for its points' forces: its number, each point's ``place`` among the
    unknowns, where the points of each cluster begin there, the rods' displacements by unit forces,
    and of 1 + K C the values, rows, columns, and the right-hand side, see `_linearise`."""

    iteration: int
    place: Integers
    begins: Integers
    kept: Array
    values: Array
    rows: Integers
    columns: Integers
    right: Array


@njit
def _in_clusters(room: Room, count: int) -> tuple[Integers, Integers]:
    """Each point's place (points,) if those of a cluster come one after another, and where each
    cluster's points begin (rods + 1,)."""
    begins, place = np.zeros(len(room.cluster) + 1, np.int64), np.empty(count, np.int64)
    for p in range(count):
        begins[room.cluster[room.points.whole[p, ROD_A]] + 1] += 1
    for c in range(1, len(begins)):
        begins[c] += begins[c - 1]
    filled = begins.copy()
    for p in range(count):
        c = room.cluster[room.points.whole[p, ROD_A]]
        place[p] = filled[c]
        filled[c] += 1
    return place, begins


@njit
def _linearise(
    law: Law, chains: Chain, members: Integers, h: float, room: Room, count: int, iteration: int
) -> tuple[bool, Waiting]:
    """Solve every rod that takes a step for its residual, into its system's solution, and for unit
    forces at its points.

    Returns whether none is singular, and the rest of the ``iteration``.
    """
    points, begins, sides = room.points, room.begins, room.sides
    nodes = room.new.x.shape[1]
    _list_sides(points, count, begins, sides)
    place, blocks = _in_clusters(room, count)
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
        if room.doing[k] != GOES:
            continue
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
            return False, nothing_waits()
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
                other = 3 * place[sides[begins[k] + (j - 1) // 3, 0]] + (j - 1) % 3
                for c in range(3):
                    value = 0.0
                    for d in range(3):
                        value += stiff[c, d] * sign * out[d]
                    values[at], rows[at], columns[at] = value, 3 * place[p] + c, other
                    at += 1
    for p in range(count):
        for c in range(3):
            for d in range(3):
                right[3 * place[p] + c] += points.stiff[p, c, d] * apart[p, d]
    return True, Waiting(iteration, place, blocks, kept, values, rows, columns, right)


@njit
def _add_forces(room: Room, waiting: Waiting, forces: Array) -> None:
    """Add what the points' forces move every rod by to its solution, and keep where it is."""
    used, nodes, kept = 0, room.new.x.shape[1], waiting.kept
    for k in range(len(room.new.x)):
        if room.doing[k] != GOES:
            continue
        solution, first = room.systems.solution[k], room.begins[k]
        many = 3 * (room.begins[k + 1] - first)
        own = np.empty(many)
        for j in range(many):
            own[j] = forces[3 * waiting.place[room.sides[first + j // 3, 0]] + j % 3]
        for i in range(nodes):
            for r in range(6):
                for j in range(many):
                    solution[i, r] -= kept[used + (i * 6 + r) * many + j] * own[j]
        used += nodes * 6 * many
        keep(rod(room.new, k), solution, _scratch_of(room.scratches, k))


@njit
def _advance_all(
    law: Law, chains: Chain, members: Integers, pairs: Integers, h: float, room: Room
) -> None:
    """Move rods by Newton's step, or by so much of it that what comes together just touches; those
    that return, back by a half."""
    stiffness, meeting, short = crossing_kn(law.between), new_meeting(), room.short
    for k in range(len(members)):
        short[k] = 0.0
        if room.doing[k] == GOES:
            room.part[k], room.last[k] = 1.0, room.worst[k]
        elif room.doing[k] == RESTS:
            short[k] = 1.0
    chain = chain_of(chains, members[0])
    # of a point at the end of a whole element, or of one where two cross
    stiffest = max(stiffness, 0.5 * law.between.stiffness * chain.length.max())
    if law.surface.there:
        stiffest = max(stiffest, law.surface.kn)
    trials = 0 if inert(chain, law.scheme, stiffest, h) else SHORTER
    for trial in range(trials + 1):
        for k in range(len(members)):
            if short[k] < 1.0:
                chain, scratch = chain_of(chains, members[k]), _scratch_of(room.scratches, k)
                go(chain, rod(room.new, k), room.part[k], scratch)
        if trial == trials:
            return
        _look(law, stiffness, chains, members, pairs, room, meeting)
        shorter = False
        for k in range(len(members)):
            short[k] = short[room.cluster[k]]
            if short[k] < 1.0:
                room.part[k] *= max(short[k], 0.1)
                shorter = True
        if not shorter:
            return


@njit
def _look(
    law: Law,
    stiffness: float,
    chains: Chain,
    members: Integers,
    pairs: Integers,
    room: Room,
    meeting: Meeting,
) -> None:
    """Write of every cluster, where its first rod stands, how much of its step it ought to take if
    it has just moved and takes a step; one for others."""
    moved, short = room.short < 1.0, room.short
    for k in range(len(members)):
        moved[k] = moved[k] and room.doing[k] == GOES
        short[k] = 1.0
    for k in range(len(members)):
        if moved[k] and law.surface.there:
            chain, scratch = chain_of(chains, members[k]), _scratch_of(room.scratches, k)
            part = shortfall(chain, law.surface, rod(room.new, k), scratch)
            short[room.cluster[k]] = min(short[room.cluster[k]], part)
    for p in range(len(pairs)):
        a, b = pairs[p, ROD_A], pairs[p, ROD_B]
        if not (moved[a] or moved[b]):
            continue
        allowed = deepest(chain_of(chains, members[a]), stiffness)
        both = pose_of(room.new, a), pose_of(room.new, b)
        part = pair_shortfall(
            law.between, pairs[p], both[0], both[1], room.gaps[p], allowed, meeting
        )
        for k in (a, b):
            if moved[k]:
                short[room.cluster[k]] = min(short[room.cluster[k]], part)


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


@njit
def nothing_waits() -> Waiting:
    """Before the first iteration."""
    none, index = np.empty(0), np.empty(0, np.int32)
    places = np.empty(0, np.int64)
    return Waiting(0, places, places, none, none, index, index, none)


def sparse_solution(waiting: Waiting) -> Array:
    """The forces that an iteration waits for; no numbers where they have no solution."""
    count = len(waiting.right)
    matrix = csc_array((waiting.values, (waiting.rows, waiting.columns)), shape=(count, count))
    try:
        return np.asarray(splu(matrix).solve(waiting.right))
    except RuntimeError:  # singular
        return np.full(count, np.nan)


@njit
def _full_solution(waiting: Waiting) -> Array:
    """As `sparse_solution`, by a full matrix of each cluster."""
    forces, begins = waiting.right.copy(), 3 * waiting.begins
    first, size, starts = np.zeros((3, len(forces)), np.int64)
    total = 0
    for c in range(len(begins) - 1):
        width = begins[c + 1] - begins[c]
        for d in range(begins[c], begins[c + 1]):
            first[d], size[d], starts[d] = begins[c], width, total
        total += width * width
    matrices = np.zeros(total)
    for entry in range(len(waiting.values)):
        d = waiting.rows[entry]
        at = starts[d] + (d - first[d]) * size[d] + waiting.columns[entry] - first[d]
        matrices[at] += waiting.values[entry]
    for c in range(len(begins) - 1):
        low, high = begins[c], begins[c + 1]
        if low == high:
            continue
        width = high - low
        matrix = matrices[starts[low] : starts[low] + width * width].reshape(width, width)
        try:
            forces[low:high] = np.linalg.solve(matrix, waiting.right[low:high])
        except Exception:  # singular, which compiled code tells by no class of its own
            forces[low:high] = np.nan
    return forces


@njit
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
    waiting: Waiting,
    forces: Array,
) -> tuple[int, Waiting]:
    """Write the rods ``members`` of the ``stack`` after a step of ``h`` seconds into the room.

    ``pairs`` (p, 4) are the elements that may touch, see `pairs.Points`, their rods counted among
    the members; ``before`` and ``now`` are what their points remember. Returns Newton's iterations,
    or `FAILED` where it does not converge, or `WAITS` where it is to be called again with what
    waits then and its ``forces``, see `sparse_solution`.
    """
    iteration = waiting.iteration
    while True:
        if iteration == 0:
            _begin_all(law, chains, hubs, members, stack, h, room)
        else:
            _add_forces(room, waiting, forces)
            _advance_all(law, chains, members, pairs, h, room)
        count = _assemble_all(
            law, chains, loads, members, pairs, stack, before, now, h, iteration < EARLY, room
        )
        _gather(room, count)
        fair = FAIR if law.scheme.inertia else 1.0
        moves, count = _decide(room, count, iteration, fair)
        if not moves:
            _finish_all(law, chains, loads, members, stack, h, room, iteration)
            return iteration, nothing_waits()
        iteration += 1
        if count == FAILED or iteration == ITERATION_LIMIT:
            return FAILED, nothing_waits()
        fine, waiting = _linearise(law, chains, members, h, room, count, iteration)
        if not fine:
            return FAILED, nothing_waits()
        if 3 * np.diff(waiting.begins).max() > FULL:
            return WAITS, waiting
        forces = _full_solution(waiting) if count else waiting.right
