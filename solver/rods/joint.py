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
from typing import Any, NamedTuple, Self, cast

import numba
import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from ..arrays import Array, Integers
from ..compiled import inlined, njit, nth, with_python, within, write
from .chain import solve_columns
from .contact import Touch, TouchStep, no_touch
from .element import assemble_tangent
from .motion import ClampedRod, Motion, motion_of, pose_of
from .newton import excess
from .pairs import ROD_A, ROD_B, Points, Side, crossing_kn, meet_pair, room_for_points
from .pairs import shortfall as pair_shortfall
from .rotation import cross
from .step import (
    Law,
    Scratch,
    Step,
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

# Newton's iterations of one step, of a lone rod and of several; one that needs more is halved
# instead. Of two in a dense cup 5 % need more than 24, most of which do not converge in 40.
ITERATION_LIMIT, LIMIT_OF_SEVERAL = 40, 24
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


class Brush(NamedTuple):
    """All rods: the law that they have in common, what each is, and its state, both stacked."""

    law: Law
    rods: ClampedRod
    stack: Motion


class Group(NamedTuple):
    """Rods that take their steps together: their numbers ``members`` in the brush, the ``pairs``
    (p, 4) of elements that may touch, see `pairs.Points`, their rods counted among the members, and
    what the points of pairs remember."""

    members: Integers
    pairs: Integers
    touch: Touch

    @classmethod
    def apart(cls, members: Integers) -> Self:
        """Of rods that touch no other."""
        return cls(members, np.zeros((0, 4), np.int64), no_touch(0, 2))


class Progress(NamedTuple):
    """How far Newton's method is with each rod: its cluster, what it does next, its cluster's
    greatest residual with the others over what counts as none, the last such residual from which it
    took a step, how much of that step it took, and how much it ought to."""

    cluster: Integers
    doing: Integers
    worst: Array
    last: Array
    part: Array
    short: Array


class Room(NamedTuple):
    """Room for a step of several rods: their next state and their scratch, stacked, how far they
    are, what the points of pairs remember at the end, and the points."""

    new: Motion
    scratches: Scratch
    progress: Progress
    touch: Touch
    points: Points


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
        Progress(*np.zeros((2, rods), np.int64), *np.zeros((4, rods))),
        no_touch(pairs, 2),
        room_for_points(pairs),
    )


@inlined
def _step(brush: Brush, group: Group, h: float, room: Room, k: int) -> Step:
    """That of the group's k-th rod."""
    rod, old = nth(brush.rods, group.members[k]), nth(brush.stack, group.members[k])
    return Step(rod, old, nth(room.new, k), h, nth(room.scratches, k))


@inlined
def _sides(brush: Brush, group: Group, room: Room, p: int) -> tuple[Side, Side]:
    """Those of the group's p-th pair."""
    a, e, b, f = group.pairs[p, 0], group.pairs[p, 1], group.pairs[p, 2], group.pairs[p, 3]
    old_a, old_b = pose_of(brush.stack, group.members[a]), pose_of(brush.stack, group.members[b])
    return Side(a, e, pose_of(room.new, a), old_a), Side(b, f, pose_of(room.new, b), old_b)


@within
def _assemble_all(brush: Brush, group: Group, h: float, early: bool, room: Room) -> int:
    """Write residuals, of rods by themselves only where they moved, and points; how many points
    touch."""
    law, residual, works = brush.law, room.scratches.system.residual, room.scratches.works
    for k in range(len(group.members)):
        step = _step(brush, group, h, room, k)
        scratch = step.scratch
        if room.progress.doing[k] != RESTS:
            scratch.own_works[0], scratch.own_works[1] = assemble(law, step, early)
            write(scratch.system.residual, scratch.own)
        else:
            write(scratch.own, scratch.system.residual)
        write(scratch.own_works, scratch.works)
    count = 0
    between = TouchStep(group.touch, room.touch, h if law.scheme.inertia else 0.0, early)
    for p in range(len(group.pairs)):
        a, b = _sides(brush, group, room, p)
        count, lost, held = meet_pair(law.between, p, a, b, between, room.points, count)
        for k in (a.rod, b.rod):
            works[k, 0] += 0.5 * lost
            works[k, 1] += 0.5 * held
    for p in range(count):
        for side in range(2):
            _push(room.points, p, side, residual)
    for k in range(len(group.members)):
        none = room.scratches.none[k]
        over = excess(residual[k], none[0], none[1])
        room.progress.worst[k] = over if math.isfinite(over) else math.inf
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
    cluster, _, worst, last, part, _ = room.progress
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
def _decide(progress: Progress, iteration: int, fair: float) -> tuple[bool, bool]:
    """Decide what every rod does next, with ``fair`` as `FAIR`; whether any moves, and whether
    steps can mend it."""
    _, doing, worst, last, part, _ = progress
    moves = False
    for k in range(len(doing)):
        moved = doing[k] != RESTS
        if worst[k] <= (fair if iteration > FEW else 1.0):
            doing[k], last[k], part[k] = RESTS, math.inf, 1.0
            continue
        moves, stalls = True, iteration > PATIENT and worst[k] >= last[k]
        if stalls and part[k] > SHORTEST_PART:
            part[k] *= 0.5
            # one that rested has no step to take back, but its cluster does
            doing[k] = RETURNS if moved else RESTS
        elif not math.isfinite(worst[k]):
            return True, False
        else:
            doing[k] = GOES
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


class Links(NamedTuple):
    """The points of rods that take a step: which those are, those of a cluster one after another,
    and where each cluster's begin. Then their sides, those of a rod one after another, where 2 k is
    the first side of the k-th of these points and 2 k + 1 its second, and where each rod's begin
    (rods + 1,)."""

    chosen: Integers
    clusters: Integers
    sides: Integers
    begins: Integers


@within
def _links(room: Room, count: int) -> Links:
    whole, progress, rods = room.points.whole, room.progress, len(room.progress.cluster)
    cluster = np.empty(count, np.int64)
    # points of rods that take none have a cluster of their own, which comes last
    for p in range(count):
        first = whole[p, ROD_A]
        cluster[p] = progress.cluster[first] if progress.doing[first] == GOES else rods
    order, clusters = _grouped(cluster, rods + 1)
    chosen = order[: clusters[rods]]
    rod = np.empty(2 * len(chosen), np.int64)
    for k in range(len(chosen)):
        rod[2 * k], rod[2 * k + 1] = whole[chosen[k], ROD_A], whole[chosen[k], ROD_B]
    sides, begins = _grouped(rod, rods)
    return Links(chosen, clusters[: rods + 1], sides, begins)


@njit
def _of_rod(columns: Array, nodes: int, begins: Integers, k: int) -> Array:
    """A rod's part (nodes, 6, m) of all columns: one, and three for each of its points' sides."""
    first, last = k + 3 * begins[k], k + 1 + 3 * begins[k + 1]
    return columns[6 * nodes * first : 6 * nodes * last].reshape(nodes, 6, -1)


@within
def _respond(
    brush: Brush, group: Group, h: float, room: Room, links: Links, k: int, moved: Array
) -> bool:
    """Write how the k-th rod moves (n, 6, m) by its residual, then by unit forces at its points;
    False where its matrix is singular."""
    chain, scratch = nth(brush.rods.chain, group.members[k]), nth(room.scratches, k)
    system, first = scratch.system, links.begins[k]
    assemble_tangent(chain, damping_rate(brush.law, chain, h), system, scratch.elements)
    for i in range(len(moved)):
        for r in range(6):
            moved[i, r, 0] = -system.residual[i, r]
    for s in range(first, links.begins[k + 1]):
        side = links.sides[s]
        _load(room.points, links.chosen[side // 2], side % 2, moved, 1 + 3 * (s - first))
    return solve_columns(system, moved)


@within
def _newton_steps(brush: Brush, group: Group, h: float, room: Room, count: int) -> bool:
    """Write Newton's step of every rod that takes one to its system's solution, and keep where it
    is; False where a matrix is singular.

    Unknowns are the forces at points, three each, those of a cluster one after another.
    """
    points, doing, links = room.points, room.progress.doing, _links(room, count)
    chosen, _, sides, begins = links
    rods, nodes, count = len(doing), room.new.x.shape[1], len(chosen)
    entries = 3 * count
    for k in range(rods):
        entries += (3 * (begins[k + 1] - begins[k])) ** 2
    # of 1 + K C, and the right-hand side
    values, places, at = np.ones(entries), np.empty((2, entries), np.int32), 3 * count
    for d in range(3 * count):
        places[0, d] = places[1, d] = d
    apart, right, out = np.zeros((count, 3)), np.zeros(3 * count), np.empty(3)
    columns = np.zeros(6 * nodes * (rods + 6 * count))
    for k in range(rods):
        if doing[k] != GOES:
            continue
        moved = _of_rod(columns, nodes, begins, k)
        if not _respond(brush, group, h, room, links, k, moved):
            return False
        own = sides[begins[k] : begins[k + 1]]
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
    forces = _point_forces(values, places, right, 3 * links.clusters) if count else right
    for k in range(rods):
        if doing[k] == GOES:
            moved = _of_rod(columns, nodes, begins, k)
            own = sides[begins[k] : begins[k + 1]]
            _superpose(moved, own, forces, room.scratches.system.solution[k])
            chain = nth(brush.rods.chain, group.members[k])
            keep(chain, nth(room.new, k), nth(room.scratches, k))
    return True


@within
def _superpose(moved: Array, sides: Integers, forces: Array, solution: Array) -> None:
    """Write how a rod moves (n, 6) by its residual and by the forces at its points' sides."""
    for i in range(len(moved)):
        for r in range(6):
            solution[i, r] = moved[i, r, 0]
            for j in range(3 * len(sides)):
                force = forces[3 * (sides[j // 3] // 2) + j % 3]
                solution[i, r] -= moved[i, r, 1 + j] * force


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
def _advance_all(brush: Brush, group: Group, h: float, room: Room) -> None:
    """Move rods by Newton's step, or by so much of it that what comes together just touches; those
    that return, back by a half.

    Without this a rod that bends far would fall deep into a stiff surface, which throws it out
    again, for ever.
    """
    law, rods = brush.law, len(group.members)
    cluster, doing, worst, last, part, short = room.progress
    for k in range(rods):
        short[k] = 0.0
        if doing[k] == GOES:
            part[k], last[k] = 1.0, worst[k]
        elif doing[k] == RESTS:
            short[k] = 1.0
    chain = nth(brush.rods.chain, group.members[0])
    stiffest = law.surface.kn if law.surface.there else 0.0
    if len(group.pairs):
        # of a point at the end of a whole element, or of one where two cross
        along = 0.5 * law.between.stiffness * chain.length.max()
        stiffest = max(stiffest, crossing_kn(law.between), along)
    trials = 0 if inert(chain, law.scheme, stiffest, h) else SHORTER
    for trial in range(trials + 1):
        for k in range(rods):
            if short[k] < 1.0:
                chain, scratch = nth(brush.rods.chain, group.members[k]), nth(room.scratches, k)
                go(chain, nth(room.new, k), part[k], scratch)
        if trial == trials:
            return
        _look(brush, group, room)
        shorter = False
        for k in range(rods):
            short[k] = short[cluster[k]]
            if short[k] < 1.0:
                part[k] *= max(short[k], 0.1)
                shorter = True
        if not shorter:
            return


@within
def _look(brush: Brush, group: Group, room: Room) -> None:
    """Write of every cluster, where its first rod stands, how much of its step it ought to take if
    it has just moved and takes a step; one for others."""
    law, cluster, short = brush.law, room.progress.cluster, room.progress.short
    moved = short < 1.0
    for k in range(len(moved)):
        moved[k] = moved[k] and room.progress.doing[k] == GOES
        short[k] = 1.0
    for k in range(len(moved)):
        if moved[k] and law.surface.there:
            chain, scratch = nth(brush.rods.chain, group.members[k]), nth(room.scratches, k)
            part = shortfall(chain, law.surface, nth(room.new, k), scratch)
            short[cluster[k]] = min(short[cluster[k]], part)
    for p in range(len(group.pairs)):
        a, b = _sides(brush, group, room, p)
        if not (moved[a.rod] or moved[b.rod]):
            continue
        chain = nth(brush.rods.chain, group.members[a.rod])
        allowed = deepest(chain, crossing_kn(law.between))
        part = pair_shortfall(law.between, p, a, b, allowed, room.points)
        for k in (a.rod, b.rod):
            if moved[k]:
                short[cluster[k]] = min(short[cluster[k]], part)


@njit
def joint_step(brush: Brush, group: Group, h: float, room: Room) -> int:
    """Write the group's rods after a step of ``h`` seconds into the room; Newton's iterations, or
    `FAILED`."""
    scheme, linked = brush.law.scheme, len(group.pairs) > 0
    for k in range(len(group.members)):
        begin(brush.law, _step(brush, group, h, room, k), linked)
        room.progress.doing[k], room.progress.last[k] = GOES, math.inf
    fair = FAIR if scheme.inertia and linked else 1.0
    for iteration in range(LIMIT_OF_SEVERAL if linked else ITERATION_LIMIT):
        count = _assemble_all(brush, group, h, iteration < EARLY, room)
        _gather(room, count)
        moves, fine = _decide(room.progress, iteration, fair)
        if not moves:
            for k in range(len(group.members)):
                finish(scheme, _step(brush, group, h, room, k), iteration)
            return iteration
        if not (fine and _newton_steps(brush, group, h, room, count)):
            return FAILED
        _advance_all(brush, group, h, room)
    return FAILED
