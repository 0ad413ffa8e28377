"""One time step of one rod, or of several that touch each other and share it.

Newton's matrix has a block-tridiagonal block for each rod and, for each point between two rods,
three more rows: with A the rods by themselves, B the displacements of one side of the points over
the other and K what their forces lose by them, (A + Bᵀ K B) u = -r. The rods are solved one by one,
for -r and for unit forces at their points, which gives the compliance C = B A⁻¹ Bᵀ of the points.
What is left is of the points alone, (1 + K C) z = -K B A⁻¹ r, and u = -A⁻¹ (r + Bᵀ z). This is
exact, so it converges as Newton's method does for one rod, but for the turning of normals and
arms, which the tangent leaves out, and for the first iterations, see `EARLY`.

Rods that touch each other now, directly or through others, are a cluster. Each cluster iterates by
itself: it rests where its residual counts as none, and goes on if another runs into it.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, cast

import numba
import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from ..arrays import Array, Integers
from ..compiled import njit, nth, with_python, within
from .chain import solve_columns, total_length
from .contact import Touch, no_touch
from .element import assemble_tangent
from .motion import ClampedRod, Motion, motion_of, pose_of, write
from .newton import ROUNDING, excess
from .pairs import (
    ROD_A,
    ROD_B,
    Meeting,
    Points,
    crossing_kn,
    meet_pair,
    new_meeting,
    room_for_points,
)
from .pairs import shortfall as pair_shortfall
from .rotation import cross
from .step import (
    Law,
    Scratch,
    assemble,
    begin,
    damping_rate,
    deepest,
    finish,
    go,
    inert,
    keep,
    new_scratch,
    shortfall,
)

# Newton's iterations of one step; one that needs more is halved instead.
ITERATION_LIMIT = 40
# In so many first iterations a point that stuck before the step has the tangent of one that sticks.
# A first guess that slides may still come to stick. With the tangent of sliding, which holds
# nothing, Newton's method would throw the section off the surface.
EARLY = 3
# After so many iterations a step that does not lessen the residual is halved, down to this part.
PATIENT, SHORTEST_PART = 6, 0.1
# The part of a step that just closes a contact is found in so many trials.
SHORTER = 12
# What a rod does next: nothing, as its cluster is in equilibrium, a step of Newton's, or back by a
# half of its last one.
RESTS, GOES, RETURNS = range(3)
# A cluster whose residual is not yet none after so many iterations rests where it is no more than
# so many times that, a tenth of the error that the step may have: where a contact passes from one
# face to another its force has a jump.
FEW, FAIR = 3, 10.0
# So many unknowns of a cluster's points are solved as a full matrix, more as a sparse one.
FULL = 240
# Instead of the number of iterations, where they do not converge.
FAILED = -1


class Room(NamedTuple):
    """Room for a step of several rods, stacked: their next state and scratch, what the points of
    pairs remember then, the force and the moment (rods, 2) that count as none of each, what
    friction took and contact holds of each (rods, 2) by itself and with the others, its residual by
    itself (rods, n, 6), its cluster, its cluster's greatest residual with the others over what
    counts as none, what it does next, the last such residual from which it took a step, how much
    of that step it took, and how much it ought to. Then the gaps of the pairs (pairs, 2), the
    points, and room for one pair."""

    new: Motion
    scratches: Scratch
    touch: Touch
    none: Array
    own_works: Array
    works: Array
    own: Array
    cluster: Integers
    worst: Array
    doing: Integers
    last: Array
    part: Array
    short: Array
    gaps: Array
    points: Points
    meeting: Meeting


def _stacked(one: Any, count: int) -> Any:
    """A record of arrays, each ``count`` times along a first axis."""
    if isinstance(one, tuple):
        return type(one)(*(_stacked(each, count) for each in one))
    return np.zeros((count, *one.shape), dtype=one.dtype)


def room_for(nodes: int, rim: int, rods: int, pairs: int) -> Room:
    """Room for so many rods of so many ``nodes`` with ``rim`` points to a section, and for so many
    pairs of elements at most."""
    return Room(
        motion_of(rods, nodes, rim),
        cast(Scratch, _stacked(new_scratch(nodes), rods)),
        no_touch(pairs, 2),
        np.zeros((rods, 2)),
        np.zeros((rods, 2)),
        np.zeros((rods, 2)),
        np.zeros((rods, nodes, 6)),
        np.zeros(rods, dtype=np.int64),
        np.zeros(rods),
        np.zeros(rods, dtype=np.int64),
        np.zeros(rods),
        np.zeros(rods),
        np.zeros(rods),
        np.zeros((pairs, 2)),
        room_for_points(pairs),
        new_meeting(),
    )


@within
def _begin_all(
    law: Law,
    rods: ClampedRod,
    members: Integers,
    pairs: Integers,
    stack: Motion,
    h: float,
    room: Room,
) -> None:
    for k in range(len(members)):
        rod, new = nth(rods, members[k]), nth(room.new, k)
        force, moment = begin(law, rod, nth(stack, members[k]), new, h, nth(room.scratches, k))
        rounding = 0.0
        if len(pairs):
            rounding = ROUNDING * crossing_kn(law.between) * np.abs(new.x).max()
        room.none[k, 0] = force + rounding
        room.none[k, 1] = moment + rounding * total_length(rod.chain)
        room.doing[k], room.last[k] = GOES, math.inf


@within
def _assemble_all(
    law: Law,
    rods: ClampedRod,
    members: Integers,
    pairs: Integers,
    stack: Motion,
    before: Touch,
    h: float,
    early: bool,
    room: Room,
) -> int:
    """Write residuals, of rods by themselves only where they moved, and points; how many points
    touch."""
    residual, works = room.scratches.system.residual, room.works
    for k in range(len(members)):
        if room.doing[k] != RESTS:
            old, new = nth(stack, members[k]), nth(room.new, k)
            lost, held = assemble(
                law, nth(rods, members[k]), old, new, h, early, nth(room.scratches, k)
            )
            room.own_works[k, 0], room.own_works[k, 1] = lost, held
            write(residual[k], room.own[k])
        else:
            write(room.own[k], residual[k])
        works[k, 0], works[k, 1] = room.own_works[k, 0], room.own_works[k, 1]
    count, step = 0, h if law.scheme.inertia else 0.0
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
            room.touch,
            step,
            early,
            room.meeting,
            room.gaps[p],
            room.points,
            count,
        )
        for k in (a, b):
            works[k, 0] += 0.5 * lost
            works[k, 1] += 0.5 * held
    for p in range(count):
        for side in range(2):
            _push(room.points, p, side, residual)
    for k in range(len(members)):
        over = excess(residual[k], room.none[k, 0], room.none[k, 1])
        room.worst[k] = over if math.isfinite(over) else math.inf
    return count


@njit
def _first_of(cluster: Integers, k: int) -> int:
    """The rod that stands for a cluster, from any of its rods."""
    while cluster[k] != k:
        k = cluster[k]
    return k


@within
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
        worst[c], last[c] = max(worst[c], worst[k]), max(last[c], last[k])
        part[c] = min(part[c], part[k])
    for k in range(len(cluster)):
        c = cluster[k]
        last[k], part[k], worst[k] = last[c], part[c], worst[c]


@within
def _decide(room: Room, iteration: int, fair: float) -> tuple[bool, bool]:
    """Decide what every rod does next, with ``fair`` as `FAIR`; whether any moves, and whether
    steps can mend it."""
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
            return True, False
        else:
            room.doing[k] = GOES
    return moves, True


@njit
def _push(points: Points, p: int, side: int, residual: Array) -> None:
    """Take a point's force on one side off the residual (rods, n, 6)."""
    sign = 1.0 if side == 0 else -1.0
    r, e = points.whole[p, 2 * side], points.whole[p, 2 * side + 1]
    push = points.push[p]
    moment = cross(points.arm[p, side], push)
    for node in range(2):
        part = sign * points.share[p, side, node]
        for c in range(3):
            residual[r, e + node, c] -= part * push[c]
            residual[r, e + node, 3 + c] -= 0.5 * sign * moment[c]


@njit
def _load(points: Points, p: int, side: int, loads: Array, j: int) -> None:
    """Add a unit force along each axis, at one side of a point, to three columns from ``j`` on of
    its rod's loads (n, 6, m)."""
    sign, e, arm = 1.0 if side == 0 else -1.0, points.whole[p, 2 * side + 1], points.arm[p, side]
    for node in range(2):
        part = sign * points.share[p, side, node]
        for c in range(3):
            a, b = (c + 1) % 3, (c + 2) % 3
            # arm × e_c
            loads[e + node, c, j + c] += part
            loads[e + node, 3 + a, j + c] += 0.5 * sign * arm[b]
            loads[e + node, 3 + b, j + c] -= 0.5 * sign * arm[a]


@njit
def _displacement(points: Points, p: int, side: int, moved: Array, j: int, out: Array) -> None:
    """Write the displacement (3,) of one side of a point, over the other's, by column ``j`` of its
    rod's (n, 6, m)."""
    sign, e, arm = 1.0 if side == 0 else -1.0, points.whole[p, 2 * side + 1], points.arm[p, side]
    for c in range(3):
        a, b = (c + 1) % 3, (c + 2) % 3
        out[c] = 0.0
        for node in range(2):
            u = moved[e + node]
            out[c] += points.share[p, side, node] * u[c, j]
            out[c] += 0.5 * (u[3 + a, j] * arm[b] - u[3 + b, j] * arm[a])
        out[c] *= sign


@njit
def _grouped(owner: Integers, many: int) -> tuple[Integers, Integers]:
    """The order that puts what has one of so ``many`` owners together, otherwise as it is, and
    where that of each begins (many + 1,)."""
    begins, order = np.zeros(many + 1, np.int64), np.empty(len(owner), np.int64)
    for each in owner:
        begins[each] += 1
    for k in range(many):
        begins[k + 1] += begins[k]
    for k in range(len(owner) - 1, -1, -1):
        begins[owner[k]] -= 1
        order[begins[owner[k]]] = k
    return order, begins


@within
def _in_clusters(room: Room, count: int) -> tuple[Integers, Integers]:
    """The points of rods that take a step, those of a cluster one after another, and where each
    cluster's begin (rods + 1,)."""
    first, rods = room.points.whole[:count, ROD_A], len(room.cluster)
    owner = np.empty(count, np.int64)
    # points of rods that take none have an owner of their own, which comes last
    for p in range(count):
        owner[p] = room.cluster[first[p]] if room.doing[first[p]] == GOES else rods
    order, begins = _grouped(owner, rods + 1)
    return order[: begins[rods]], begins[: rods + 1]


@njit
def _of_rod(columns: Array, nodes: int, begins: Integers, k: int) -> Array:
    """A rod's part (nodes, 6, m) of all columns: one, and three for each of its points' sides."""
    first, last = k + 3 * begins[k], k + 1 + 3 * begins[k + 1]
    return columns[6 * nodes * first : 6 * nodes * last].reshape(nodes, 6, -1)


@within
def _newton_steps(
    law: Law, rods: ClampedRod, members: Integers, h: float, room: Room, count: int
) -> bool:
    """Write Newton's step of every rod that takes one to its system's solution, and keep where it
    is; False where a matrix is singular.

    Unknowns are the forces at points, three each, those of a cluster one after another.
    """
    points, nodes = room.points, room.new.x.shape[1]
    chosen, clusters = _in_clusters(room, count)
    count = len(chosen)
    # side 2 k is the first of the k-th chosen point, 2 k + 1 its second; those of a rod in a row
    owner = np.empty(2 * count, np.int64)
    for k in range(count):
        first, second = points.whole[chosen[k], ROD_A], points.whole[chosen[k], ROD_B]
        owner[2 * k], owner[2 * k + 1] = first, second
    sides, begins = _grouped(owner, len(members))
    entries = 3 * count
    for k in range(len(members)):
        entries += (3 * (begins[k + 1] - begins[k])) ** 2
    # of 1 + K C, and the right-hand side
    values, places, at = np.ones(entries), np.empty((2, entries), np.int32), 3 * count
    for d in range(3 * count):
        places[0, d] = places[1, d] = d
    apart, right, out = np.zeros((count, 3)), np.zeros(3 * count), np.empty(3)
    # each rod's residual and unit forces at its points, then what it moves by them
    columns = np.zeros(6 * nodes * (len(members) + 6 * count))
    for k in range(len(members)):
        if room.doing[k] != GOES:
            continue
        own, scratch = sides[begins[k] : begins[k + 1]], nth(room.scratches, k)
        chain = nth(rods.chain, members[k])
        assemble_tangent(chain, damping_rate(law, chain, h), scratch.system, scratch.elements)
        moved = _of_rod(columns, nodes, begins, k)
        for i in range(nodes):
            for r in range(6):
                moved[i, r, 0] = -scratch.system.residual[i, r]
        for s in range(len(own)):
            _load(points, chosen[own[s] // 2], own[s] % 2, moved, 1 + 3 * s)
        if not solve_columns(scratch.system, moved):
            return False
        for side in own:
            k_th, p = side // 2, chosen[side // 2]
            _displacement(points, p, side % 2, moved, 0, out)
            for c in range(3):
                apart[k_th, c] += out[c]
            for j in range(3 * len(own)):
                _displacement(points, p, side % 2, moved, 1 + j, out)
                for c in range(3):
                    value = 0.0
                    for d in range(3):
                        value += points.stiff[p, c, d] * out[d]
                    values[at], places[0, at] = value, 3 * k_th + c
                    places[1, at] = 3 * (own[j // 3] // 2) + j % 3
                    at += 1
    for k in range(count):
        for c in range(3):
            for d in range(3):
                right[3 * k + c] += points.stiff[chosen[k], c, d] * apart[k, d]
    forces = _point_forces(values, places, right, 3 * clusters) if count else right
    for k in range(len(members)):
        if room.doing[k] != GOES:
            continue
        moved = _of_rod(columns, nodes, begins, k)
        solution = room.scratches.system.solution[k]
        for i in range(nodes):
            for r in range(6):
                solution[i, r] = moved[i, r, 0]
                for j in range(moved.shape[2] - 1):
                    force = forces[3 * (sides[begins[k] + j // 3] // 2) + j % 3]
                    solution[i, r] -= moved[i, r, 1 + j] * force
        keep(nth(room.new, k), nth(room.scratches, k))
    return True


def _sparse_solution(values: Array, places: Integers, right: Array) -> Array:
    """Of a sparse matrix by its entries; no numbers where it is singular."""
    try:
        return np.asarray(splu(csc_array((values, tuple(places)))).solve(right))
    except RuntimeError:  # singular
        return np.full(len(right), np.nan)


@with_python
def _by_scipy(values: Array, places: Integers, right: Array) -> Array:
    with numba.objmode(forces="float64[::1]"):
        forces = _sparse_solution(values, places, right)
    return forces


@njit
def _point_forces(values: Array, places: Integers, right: Array, begins: Integers) -> Array:
    """The forces at points, by the entries (m,) of a matrix and their rows and columns (2, m);
    those of a cluster begin at ``begins`` (clusters + 1,), and are no numbers if it is singular."""
    forces, sizes = right.copy(), np.diff(begins)
    if sizes.max() > FULL:
        return _by_scipy(values, places, right)
    first, matrices = np.repeat(begins[:-1], sizes), np.zeros((len(right), sizes.max()))
    for k in range(len(values)):
        row = places[0, k]
        matrices[row, places[1, k] - first[row]] += values[k]
    for c in range(len(sizes)):
        if sizes[c]:
            low, high = begins[c], begins[c + 1]
            try:
                forces[low:high] = np.linalg.solve(matrices[low:high, : sizes[c]], right[low:high])
            except Exception:  # singular, which compiled code tells by no class of its own
                forces[low:high] = np.nan
    return forces


@within
def _advance_all(
    law: Law, rods: ClampedRod, members: Integers, pairs: Integers, h: float, room: Room
) -> None:
    """Move rods by Newton's step, or by so much of it that what comes together just touches; those
    that return, back by a half.

    Without this a rod that bends far would fall deep into a stiff surface, which throws it out
    again, for ever.
    """
    short = room.short
    for k in range(len(members)):
        short[k] = 0.0
        if room.doing[k] == GOES:
            room.part[k], room.last[k] = 1.0, room.worst[k]
        elif room.doing[k] == RESTS:
            short[k] = 1.0
    chain = nth(rods.chain, members[0])
    stiffest = law.surface.kn if law.surface.there else 0.0
    if len(pairs):
        # of a point at the end of a whole element, or of one where two cross
        along = 0.5 * law.between.stiffness * chain.length.max()
        stiffest = max(stiffest, crossing_kn(law.between), along)
    trials = 0 if inert(chain, law.scheme, stiffest, h) else SHORTER
    for trial in range(trials + 1):
        for k in range(len(members)):
            if short[k] < 1.0:
                chain = nth(rods.chain, members[k])
                go(chain, nth(room.new, k), room.part[k], nth(room.scratches, k))
        if trial == trials:
            return
        _look(law, rods, members, pairs, room)
        shorter = False
        for k in range(len(members)):
            short[k] = short[room.cluster[k]]
            if short[k] < 1.0:
                room.part[k] *= max(short[k], 0.1)
                shorter = True
        if not shorter:
            return


@within
def _look(law: Law, rods: ClampedRod, members: Integers, pairs: Integers, room: Room) -> None:
    """Write of every cluster, where its first rod stands, how much of its step it ought to take if
    it has just moved and takes a step; one for others."""
    moved, short = room.short < 1.0, room.short
    for k in range(len(members)):
        moved[k] = moved[k] and room.doing[k] == GOES
        short[k] = 1.0
    for k in range(len(members)):
        if moved[k] and law.surface.there:
            chain, scratch = nth(rods.chain, members[k]), nth(room.scratches, k)
            part = shortfall(chain, law.surface, nth(room.new, k), scratch)
            short[room.cluster[k]] = min(short[room.cluster[k]], part)
    for p in range(len(pairs)):
        a, b = pairs[p, ROD_A], pairs[p, ROD_B]
        if not (moved[a] or moved[b]):
            continue
        allowed = deepest(nth(rods.chain, members[a]), crossing_kn(law.between))
        both = pose_of(room.new, a), pose_of(room.new, b)
        part = pair_shortfall(
            law.between, pairs[p], both[0], both[1], room.gaps[p], allowed, room.meeting
        )
        for k in (a, b):
            if moved[k]:
                short[room.cluster[k]] = min(short[room.cluster[k]], part)


@njit
def joint_step(
    law: Law,
    rods: ClampedRod,
    members: Integers,
    pairs: Integers,
    stack: Motion,
    before: Touch,
    h: float,
    room: Room,
) -> int:
    """Write the rods ``members`` of the ``stack`` after a step of ``h`` seconds into the room.

    ``rods`` are stacked too. ``pairs`` (p, 4) are the elements that may touch, see `pairs.Points`,
    their rods counted among the members, and ``before`` is what their points remember. Returns
    Newton's iterations, or `FAILED`.
    """
    _begin_all(law, rods, members, pairs, stack, h, room)
    fair = FAIR if law.scheme.inertia and len(pairs) else 1.0
    for iteration in range(ITERATION_LIMIT):
        early = iteration < EARLY
        count = _assemble_all(law, rods, members, pairs, stack, before, h, early, room)
        _gather(room, count)
        moves, fine = _decide(room, iteration, fair)
        if not moves:
            for k in range(len(members)):
                old, new, works = nth(stack, members[k]), nth(room.new, k), room.works[k]
                scratch = nth(room.scratches, k)
                finish(law, nth(rods, members[k]), old, new, h, works, iteration, scratch)
            return iteration
        if not (fine and _newton_steps(law, rods, members, h, room, count)):
            return FAILED
        _advance_all(law, rods, members, pairs, h, room)
    return FAILED
