"""One implicit time step of one rod, or of several rods in contact.

Newton's matrix has one block-tridiagonal block per rod and three more rows per contact point
between rods. Let A be the matrix of the rods alone, B the relative displacements at the points, and
K minus the derivative of their forces by these: (A + Bᵀ K B) u = -r. Each rod is solved alone, for
-r and for unit forces at its points. This gives the points' compliance C = B A⁻¹ Bᵀ. What remains
is a system of the points alone, (1 + K C) z = -K B A⁻¹ r, and u = -A⁻¹ (r + Bᵀ z). The elimination
is exact, so convergence is that of Newton's method for one rod, except that the tangent omits the
rotation of normals and arms, and for the first iterations (`EARLY`).

A cluster is a set of rods in contact, directly or through others. Each cluster iterates by itself:
it stops when its residual is below the tolerance, and resumes if another rod runs into it.
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

# Limits of Newton iterations of a lone rod and of several; a step that needs more is halved. In a
# dense cup 5 % of two rods' steps need more than 24, most of which do not converge in 40.
ITERATION_LIMIT, LIMIT_OF_SEVERAL = 40, 24
# In the first `EARLY` iterations a point that stuck before the step has the tangent of sticking. A
# first guess that slides may still come to stick. The tangent of sliding has no resistance, and
# Newton's method would throw the section off the surface.
EARLY = 3
# After `PATIENT` iterations a Newton step that does not help is halved, down to `SHORTEST_PART`.
PATIENT, SHORTEST_PART = 6, 0.1
# Number of trials to find the part of a step that just closes a contact.
SHORTER = 12
# What a rod does next: nothing, in equilibrium; a Newton step; or half of its last one back.
RESTS, GOES, RETURNS = range(3)
# After `FEW` iterations a cluster also stops at `FAIR` times the tolerance, a tenth of the error
# allowed in a step: its force jumps where a contact passes from one face to another.
FEW, FAIR = 3, 10.0
# Up to this many unknowns of a cluster's points the matrix is dense, beyond it sparse.
FULL = 240
# Returned in place of the number of iterations if they do not converge.
FAILED = -1


class Brush(NamedTuple):
    """All rods: the law that they share, their properties and their state, both stacked."""

    law: Law
    rods: ClampedRod
    stack: Motion


class Group(NamedTuple):
    """Rods that share their time steps: their numbers ``members`` in the brush, the ``pairs`` (p,
    4) of elements that may touch (see `pairs.Points`; rods are numbered among the members), and the
    state of the pairs' contact points."""

    members: Integers
    pairs: Integers
    touch: Touch

    @classmethod
    def apart(cls, members: Integers) -> Self:
        """A group of rods that touch no other."""
        return cls(members, np.zeros((0, 4), np.int64), no_touch(0, 2))


class Progress(NamedTuple):
    """State of Newton's method per rod: its cluster, what it does next, its cluster's greatest
    residual over the tolerance, the last such residual from which it took a step, the part of that
    step that it took, and the part that it should take."""

    cluster: Integers
    doing: Integers
    worst: Array
    last: Array
    part: Array
    short: Array


class Room(NamedTuple):
    """Work space for a step of several rods: next state and scratch, both stacked, their progress,
    the state of the pairs' contact points at the end, and the points."""

    new: Motion
    scratches: Scratch
    progress: Progress
    touch: Touch
    points: Points


def _stacked(one: Any, count: int) -> Any:
    """A record of arrays, each repeated ``count`` times along a first axis."""
    if isinstance(one, tuple):
        return type(one)(*(_stacked(each, count) for each in one))
    return np.zeros((count, *one.shape), dtype=one.dtype)


def room_for(nodes: int, rim: int, rods: int, pairs: int) -> Room:
    """Work space for this many rods of ``nodes`` nodes with ``rim`` points per section, and for at
    most this many pairs of elements."""
    return Room(
        motion_of(rods, nodes, rim),
        cast(Scratch, _stacked(new_scratch(nodes), rods)),
        Progress(*np.zeros((2, rods), np.int64), *np.zeros((4, rods))),
        no_touch(pairs, 2),
        room_for_points(pairs),
    )


@inlined
def _step(brush: Brush, group: Group, h: float, room: Room, k: int) -> Step:
    """The step of the group's k-th rod."""
    rod, old = nth(brush.rods, group.members[k]), nth(brush.stack, group.members[k])
    return Step(rod, old, nth(room.new, k), h, nth(room.scratches, k))


@inlined
def _sides(brush: Brush, group: Group, room: Room, p: int) -> tuple[Side, Side]:
    """The two sides of the group's p-th pair."""
    a, e, b, f = group.pairs[p, 0], group.pairs[p, 1], group.pairs[p, 2], group.pairs[p, 3]
    old_a, old_b = pose_of(brush.stack, group.members[a]), pose_of(brush.stack, group.members[b])
    return Side(a, e, pose_of(room.new, a), old_a), Side(b, f, pose_of(room.new, b), old_b)


@within
def _assemble_all(brush: Brush, group: Group, h: float, early: bool, room: Room) -> int:
    """Write the contact points and all residuals; returns the number of points in contact.

    A rod's own residual is written only if it moved.
    """
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
    """The rod that represents a cluster, from any of its rods."""
    while cluster[k] != k:
        k = cluster[k]
    return k


@within
def _gather(room: Room, count: int) -> None:
    """Find the clusters formed by the contact points, and the greatest residual of each."""
    cluster, _, worst, last, part, _ = room.progress
    for k in range(len(cluster)):
        cluster[k] = k
    for p in range(count):
        a = _first_of(cluster, room.points.whole[p, ROD_A])
        b = _first_of(cluster, room.points.whole[p, ROD_B])
        cluster[max(a, b)] = min(a, b)
    for k in range(len(cluster)):
        # the representative has the lowest number, so it comes first
        c = cluster[k] = cluster[cluster[k]]
        worst[c], last[c] = max(worst[c], worst[k]), max(last[c], last[k])
        part[c] = min(part[c], part[k])
    for k in range(len(cluster)):
        c = cluster[k]
        last[k], part[k], worst[k] = last[c], part[c], worst[c]


@within
def _decide(progress: Progress, iteration: int, fair: float) -> tuple[bool, bool]:
    """Decide what every rod does next; returns whether any moves, and whether steps can help.

    ``fair`` is as `FAIR`.
    """
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
            # a rod that rested has no step to take back, but its cluster does
            doing[k] = RETURNS if moved else RESTS
        elif not math.isfinite(worst[k]):
            return True, False
        else:
            doing[k] = GOES
    return moves, True


@njit
def _push(points: Points, p: int, side: int, residual: Array) -> None:
    """Subtract a point's force on one side from the residual (rods, n, 6)."""
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
    """Add unit forces along each axis, on one side of a point, to three columns from ``j`` on of
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
    """Write a point's displacement (3,) on one side over the other's, from column ``j`` on."""
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
    """A stable order that sorts entries by ``owner``, and where each owner's begin (many + 1,)."""
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
    """Contact points of the rods that take a Newton step.

    ``chosen`` are the points, sorted by cluster, and ``clusters`` is where each cluster begins.
    ``sides`` are their sides, sorted by rod, and ``begins`` (rods + 1,) is where each rod begins.
    Side 2 k is the first side of the k-th of these points, 2 k + 1 its second.
    """

    chosen: Integers
    clusters: Integers
    sides: Integers
    begins: Integers


@within
def _links(room: Room, count: int) -> Links:
    whole, progress, rods = room.points.whole, room.progress, len(room.progress.cluster)
    cluster = np.empty(count, np.int64)
    # points of rods that take no step form a cluster of their own, which comes last
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
    """A rod's part (nodes, 6, m) of all columns: one for its residual, three for each side."""
    first, last = k + 3 * begins[k], k + 1 + 3 * begins[k + 1]
    return columns[6 * nodes * first : 6 * nodes * last].reshape(nodes, 6, -1)


@within
def _respond(
    brush: Brush, group: Group, h: float, room: Room, links: Links, k: int, moved: Array
) -> bool:
    """Write the k-th rod's response (n, 6, m) to its residual and to unit forces at its points.

    Returns False if its matrix is singular.
    """
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
    """Solve for Newton's step of every rod that takes one, and save where it is; False if singular.

    Unknowns are the forces at the points, three each, sorted by cluster.
    """
    points, doing, links = room.points, room.progress.doing, _links(room, count)
    chosen, _, sides, begins = links
    rods, nodes, count = len(doing), room.new.x.shape[1], len(chosen)
    entries = 3 * count
    for k in range(rods):
        entries += (3 * (begins[k + 1] - begins[k])) ** 2
    # entries of 1 + K C, and the right-hand side
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
    """Write a rod's Newton step (n, 6): its responses to the residual and to the points' forces."""
    for i in range(len(moved)):
        for r in range(6):
            solution[i, r] = moved[i, r, 0]
            for j in range(3 * len(sides)):
                force = forces[3 * (sides[j // 3] // 2) + j % 3]
                solution[i, r] -= moved[i, r, 1 + j] * force


def _sparse_solution(values: Array, places: Integers, right: Array) -> Array:
    """Solution with a sparse matrix given by its entries; NaN if it is singular."""
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
    """Forces at the points, by the matrix' entries (m,) and their rows and columns (2, m).

    ``begins`` (clusters + 1,) is where each cluster's forces begin. They are NaN if it is singular.
    """
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
            except Exception:  # singular; compiled code cannot name the class
                forces[low:high] = np.nan
    return forces


@within
def _advance_all(brush: Brush, group: Group, h: float, room: Room) -> None:
    """Move each rod by its Newton step, by the part that just closes contacts, or half a step back.

    Otherwise a rod that bends far would penetrate a stiff surface and be thrown out, for ever.
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
        # stiffness of a point at the end of a whole element, or where two cross
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
    """Write, at the first rod of every cluster that just moved and takes a step, the part of the
    step that it should take; one for others."""
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
    """Write the group's rods after a step of ``h`` seconds into ``room``; returns the number of
    Newton iterations, or `FAILED`."""
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
