"""Neighbour search: pairs of elements that may touch, and groups of rods that share time steps.

For a short span of time only those pairs are active that touch, or would touch at their present
speed of approach. Rods connected by active pairs form a group and march together; all others march
alone. Afterwards the gaps and their rates at both ends of the span tell which other pairs may have
met. These become active too, and their rods repeat the span.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from mpi4py import MPI
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..arrays import Array, Flags, Integers
from ..compiled import njit, unowned
from .contact import FREE, Touch, no_touch
from .hub import HubPose
from .joint import Group
from .motion import Motion
from .pairs import ROD_A, ROD_B, Between, approach, candidates, near, new_meeting
from .rotation import cross

# Largest motion of a rod in a span, over the wide side.
MOVED = 0.125
# Margin for a node's motion in a span: a factor on its speed; at rest, a share of the above.
FASTER, KICKED = 2.0, 0.5
# The list of pairs is made for this many times the motion expected in the next span.
LASTS = 4.0
# Distance that counts as near, over the thin side.
NEAR = 0.001
# Faces with less penetration just touch.
TOUCHING_M = 1e-9
# Cost of a rod in a group over the average.
GROUPED = 5.0
# Number of instants in a span at which gaps are evaluated.
LOOKS = 9


class Linked(NamedTuple):
    """Rods that march together, and the rows of the list of pairs that are between two of them."""

    members: Integers
    rows: Integers


class Neighbours:
    """The pairs of elements that may touch, and the state of their contact points.

    Each rank evaluates only a list of pairs that may meet soon (Verlet, Phys. Rev. 159 (1967) 98).
    It renews the list when a node has moved farther than the list allows for. Results do not depend
    on when that happens.

    Parameters
    ----------
    law : between two bristles
    comm : ranks that share the search; each knows the positions of all bristles
    """

    def __init__(self, law: Between, comm: MPI.Intracomm = MPI.COMM_SELF) -> None:
        self.law, self._comm = law, comm
        self.pairs: Integers = np.zeros((0, 4), dtype=np.int64)
        self.touch = no_touch(0, 2)
        self.span_s = 0.0
        self._apart = NEAR * 2.0 * float(law.half[0])
        self._room = new_meeting()
        self._listed = self.pairs
        self._listed_within: Array = np.zeros(0)
        self._listed_at: Array = np.zeros(0)
        # of the current span
        self._possible = self.pairs
        self._gaps: Array = np.zeros(0)
        self._closing: Array = np.zeros(0)
        self._placed: Array = np.zeros(0)
        self._reach: Array = np.zeros(0)

    def search(self, stack: Motion, pose: HubPose, longest_s: float) -> None:
        """Find the active pairs and the next span's length, at most ``longest_s``; collective."""
        self._placed, speeds = _in_hub(stack, pose)
        most = MOVED * 2.0 * float(self.law.half[1])
        self.span_s = min(most / max(float(speeds.max()), 1e-12), longest_s)
        self._reach = self._apart + np.maximum(FASTER * speeds * self.span_s, KICKED * most)
        self._list(stack)
        self._possible = near(self.law, self._listed, stack.x, self._reach)
        self._gaps, (_, self._closing) = self._approach(stack)
        soon = self._gaps - self._closing * self.span_s < self._apart
        held = self.pairs[(self.touch.state != FREE).any(axis=1)]
        self._take(_joined(held, *self._comm.allgather(self._possible[soon])))

    def begun_in_each_other(self) -> Integers:
        """The pairs (p, 4) that penetrate each other beyond rounding at the start of the span;
        collective."""
        return _joined(*self._comm.allgather(self._possible[self._gaps < -TOUCHING_M]))

    def outran(self, stack: Motion, pose: HubPose) -> bool:
        """Whether a rod has moved farther in the span than `search` allowed for."""
        placed, _ = _in_hub(stack, pose)
        return _moved_beyond(self._placed, placed, self._reach)

    def missed(self, stack: Motion, span_s: float) -> Integers:
        """The inactive pairs (p, 4) that may have met in the span that ends now; collective.

        Gaps over time are cubic, from values and rates at both ends; they are linear if the
        elements are beside each other at one end only. Of the rates of an element's nodes the one
        with the smaller gap counts: the fastest closing at the start, the slowest at the end.
        """
        gaps, (closing, _) = self._approach(stack)
        was, closed = self._gaps.copy(), self._closing.copy()
        new, gone = np.isinf(was) & np.isfinite(gaps), np.isfinite(was) & np.isinf(gaps)
        was[new], closed[new] = gaps[new] + closing[new] * span_s, closing[new]
        gaps[gone], closing[gone] = was[gone] - closed[gone] * span_s, closed[gone]
        s = np.linspace(0.0, 1.0, LOOKS)[:, None]
        known = np.flatnonzero(np.isfinite(was))
        one, two = was[known], gaps[known]
        course = one + s**2 * (3.0 - 2.0 * s) * (two - one)
        course -= s * (1.0 - s) ** 2 * span_s * closed[known]
        course += s**2 * (1.0 - s) * span_s * closing[known]
        met = self._possible[known[course.min(axis=0) < self._apart]]
        return _joined(*self._comm.allgather(met[_places(self.pairs, met) < 0]))

    def add(self, pairs: Integers, before: Mapping[str, Any], rods: int) -> Flags:
        """Add active pairs; returns which rods (rods,) must repeat the span for them.

        Their points return to their state at the `checkpoint` ``before``.
        """
        marched, touch = self.pairs, self.touch
        self.restore(before)
        self._take(_joined(marched, pairs))
        _, of = self.groups(rods)
        again = np.isin(of, of[pairs[:, 0]])
        stay = ~again[marched[:, 0]]
        at = _places(self.pairs, marched[stay])
        put(self.touch, at, [each[stay] for each in touch])
        return np.asarray(again)

    def _list(self, stack: Motion) -> None:
        """Renew this rank's list of pairs if it may miss some in the span; the boxes' axes follow
        the elements' directions, which keeps them slim."""
        axes, (rank, ranks) = None, (self._comm.rank, self._comm.size)
        left = self._listed_within - self._reach if len(self._listed_at) else None
        if left is None or _moved_beyond(self._listed_at, self._placed, left):
            sides = (stack.x[:, 1:] - stack.x[:, :-1]).reshape(-1, 3)
            axes = np.linalg.eigh(sides.T @ sides)[1]
        # different machines may round differently and find axes of other signs
        axes = self._comm.bcast(axes)
        if axes is None:
            return
        self._listed_at, self._listed_within = self._placed, LASTS * self._reach
        room, count = self._listed, len(self._listed) + 1
        while count > len(room):
            room = np.zeros((count + 1000, 4), dtype=np.int64)
            within = self._listed_within
            count = candidates(self.law, stack.x, axes, within, rank, ranks, room)
        self._listed = room[:count]

    def _approach(self, stack: Motion) -> tuple[Array, Array]:
        """Gaps (p,) of all pairs on the list, and the range (2, p) of their closing speeds."""
        gaps, closing = np.empty(len(self._possible)), np.empty((len(self._possible), 2))
        approach(self.law, self._possible, stack, self._reach, self._room, gaps, closing)
        return gaps, closing.T

    def _take(self, pairs: Integers) -> None:
        """Replace the list of active pairs; the state of their points is kept."""
        before, touch = self.pairs, self.touch
        self.pairs, self.touch = pairs, no_touch(len(pairs), 2)
        held = np.flatnonzero((touch.state != FREE).any(axis=1))
        at = _places(pairs, before[held])
        put(self.touch, at[at >= 0], [each[held[at >= 0]] for each in touch])

    def group(self, linked: Linked) -> Group:
        """Rods that march together, with the state of the points between them, for compiled
        code."""
        pairs = self.pairs[linked.rows]
        for column in (ROD_A, ROD_B):
            pairs[:, column] = np.searchsorted(linked.members, pairs[:, column])
        return Group(linked.members, pairs, Touch(*(each[linked.rows] for each in self.touch)))

    def groups(self, rods: int) -> tuple[list[Linked], Integers]:
        """The groups that active pairs form, and each rod's group (n,), or a number of its own."""
        ends = self.pairs[:, [0, 2]]
        graph = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(rods, rods))
        _, of = connected_components(graph, directed=False)
        owner, numbers = of[self.pairs[:, 0]], np.arange(rods + 1)
        members, rows = np.argsort(of, kind="stable"), np.argsort(owner, kind="stable")
        begins, first = np.searchsorted(of[members], numbers), np.searchsorted(owner[rows], numbers)
        found = [
            Linked(members[begins[g] : begins[g + 1]], rows[first[g] : first[g + 1]])
            for g in np.flatnonzero(np.diff(begins) > 1)
        ]
        return found, of

    def normal_N(self, rods: int) -> Array:
        """Sum of the normal forces of other rods on each (rods,), in N."""
        each = self.touch.normal.sum(axis=1)
        sides = (np.bincount(self.pairs[:, side], each, rods) for side in (ROD_A, ROD_B))
        # without pairs numpy would return integers
        return np.sum([*sides], axis=0, dtype=float)

    def checkpoint(self) -> dict[str, Any]:
        """The state that the next search needs: the points in contact."""
        held = (self.touch.state != FREE).any(axis=1)
        kept = {f"pair_{name}": each[held] for name, each in self.touch._asdict().items()}
        return kept | {"pairs": self.pairs[held]}

    def restore(self, kept: Mapping[str, Any]) -> None:
        """Return to a `checkpoint`."""
        self.pairs = kept["pairs"]
        self.touch = Touch(*(kept[f"pair_{name}"] for name in Touch._fields))


def _joined(*pairs: Integers) -> Integers:
    """The union of the lists, sorted."""
    return np.unique(np.concatenate(pairs), axis=0)


@njit
def _in_hub(stack: Motion, pose: HubPose) -> tuple[Array, Array]:
    """Positions of nodes (rods, n, 3) in the hub's axes, and their speeds (rods, n) in it."""
    stack = unowned(stack)
    rods, nodes, _ = stack.x.shape
    placed, speeds, arm = np.empty((rods, nodes, 3)), np.empty((rods, nodes)), np.empty(3)
    for i in range(rods):
        for k in range(nodes):
            for c in range(3):
                arm[c] = stack.x[i, k, c] - pose.position_m[c]
            carried, square = cross(pose.angular_velocity_rad_s, arm), 0.0
            for c in range(3):
                own = stack.velocity[i, k, c] - pose.velocity_m_s[c] - carried[c]
                square += own * own
                placed[i, k, c] = 0.0
                for d in range(3):
                    placed[i, k, c] += pose.rotation[d, c] * arm[d]
            speeds[i, k] = math.sqrt(square)
    return placed, speeds


@njit
def _moved_beyond(before: Array, now: Array, reach: Array) -> bool:
    """Whether any node (rods, n) has moved farther than its reach."""
    for i in range(reach.shape[0]):
        for k in range(reach.shape[1]):
            square = 0.0
            for c in range(3):
                square += (now[i, k, c] - before[i, k, c]) ** 2
            # a negative reach is always exceeded
            if not math.sqrt(square) <= reach[i, k]:
                return True
    return False


def _places(pairs: Integers, wanted: Integers) -> Integers:
    """Indices of the ``wanted`` pairs (m, 4) among sorted ``pairs``, or -1."""
    if not len(pairs):
        return np.full(len(wanted), -1)
    top = 1 + max(int(pairs.max()), int(wanted.max(initial=0)))
    codes, sought = (
        np.asarray(np.ravel_multi_index(tuple(each.T), (top,) * 4)) for each in (pairs, wanted)
    )
    at = np.minimum(np.searchsorted(codes, sought), len(codes) - 1)
    return np.where(codes[at] == sought, at, -1)


def put(arrays: Sequence[Any], those: Integers | Flags, values: Sequence[Any]) -> None:
    """Write ``values`` to rows ``those`` of each of the arrays."""
    for array, value in zip(arrays, values, strict=True):
        array[those] = value


def alone(groups: list[Linked], rods: int) -> Flags:
    """Which rods (rods,) are in no group."""
    lone = np.ones(rods, dtype=np.bool_)
    for group in groups:
        lone[group.members] = False
    return lone


def shared_out(groups: list[Linked], holder: Integers, cost: Array, ranks: int) -> Integers:
    """The rank (n,) that marches each rod; the members of a group share one.

    The largest group comes first. A group goes to the ``holder`` (n,) of most of its members,
    unless that rank already has its share of all groups, and otherwise to the rank with the least
    work. Lone rods follow in the same way, weighted by their ``cost`` (n,), zero if a rod does not
    march. Groups count by their members, since their past cost predicts little: steps that do not
    converge take the longest.
    """
    load, who, left = np.zeros(ranks), holder.copy(), list[int]()
    lone, marches = alone(groups, len(holder)), cost > 0.0
    mean = cost.sum() / max(np.count_nonzero(marches), 1)
    cost = np.where(marches & ~lone, GROUPED * mean, cost)
    weights = [np.bincount(holder[g.members], cost[g.members], ranks) for g in groups]
    share, share_of_groups = cost.sum() / ranks, cost[~lone].sum() / ranks
    for g in sorted(range(len(groups)), key=lambda g: (-weights[g].sum(), g)):
        rank = weights[g].argmax()
        if load[rank] >= share_of_groups:
            rank = load.argmin()
        who[groups[g].members] = rank
        load[rank] += weights[g].sum()
    for each in range(ranks):
        own = np.flatnonzero(lone & (holder == each))
        stays = np.count_nonzero(load[each] + np.cumsum(cost[own]) - cost[own] < share)
        load[each] += cost[own[:stays]].sum()
        left.extend(own[stays:])
    for i in left:
        who[i] = load.argmin()
        load[who[i]] += cost[i]
    return who
