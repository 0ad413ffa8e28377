"""Which bristles may touch each other: pairs of elements, and groups that share their time steps.

A list of pairs holds until rods have moved by a part of the margin it was made with, in the hub's
axes. Over a short span of time only those pairs count that come near each other if twice their
speed of approach is not exceeded. Rods that these pairs connect are a group, and march together.
All others march by themselves. If any of them turn out to have met, the span is marched again with
more pairs.
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..arrays import Array, Integers
from .contact import FREE, Touch, no_touch
from .hub import HubPose
from .motion import Motion
from .pairs import Between, candidates, near

# The margin of a list of pairs, and how far rods move in a span, over the wide side.
MARGIN, MOVED = 1.0, 0.125
# What counts as near where nothing moves, over the thin side.
NEAR = 0.01
LONGEST_S, SHORTEST_S = 1e-3, 1e-5
# Faces that are no deeper in each other just touch.
TOUCHING_M = 1e-9


@dataclass(frozen=True)
class Group:
    """Rods that march together, and the rows of the list of pairs that are between two of them."""

    members: Integers
    rows: Integers


class Neighbours:
    """The pairs of elements that may touch, and what their points remember.

    Parameters
    ----------
    law : between two bristles
    """

    def __init__(self, law: Between) -> None:
        self.law = law
        self.pairs: Integers = np.zeros((0, 4), dtype=np.int64)
        self.touch = no_touch(0, 2)
        self._placed: Array | None = None

    def search(self, x: Array, pose: HubPose) -> None:
        """Renew the list of pairs where rods (n, nodes, 3) moved too far in the hub's axes."""
        placed = (x - pose.position_m) @ pose.rotation
        margin = MARGIN * 2.0 * self.law.half[1]
        if self._placed is not None:
            moved = float(np.linalg.norm(placed - self._placed, axis=-1).max())
            # two that near each other both move
            if moved < 0.5 * margin * (1.0 - 2.0 * MOVED):
                return
        self._placed = placed
        room = np.zeros((len(self.pairs) + 1, 4), dtype=np.int64)
        count = candidates(self.law, placed, margin, room)
        if count > len(room):
            room = np.zeros((count, 4), dtype=np.int64)
            candidates(self.law, placed, margin, room)
        self._take(_sorted(room[:count]), self.touch, self.pairs)

    def _take(self, pairs: Integers, touch: Touch, before: Integers) -> None:
        """Another list of pairs; what points of ``before`` remember goes along."""
        self.pairs, self.touch = pairs, no_touch(len(pairs), 2)
        held = np.flatnonzero((touch.state != FREE).any(axis=1))
        at = _places(pairs, before[held])
        for new, old in zip(self.touch, touch, strict=True):
            new[at[at >= 0]] = old[held[at >= 0]]

    def span_s(self, stack: Motion, pose: HubPose) -> float:
        """For how long to march on before looking again, in s."""
        arms = stack.x - pose.position_m
        carried = pose.velocity_m_s + np.cross(pose.angular_velocity_rad_s, arms)
        fastest = float(np.linalg.norm(stack.velocity[..., :3] - carried, axis=-1).max())
        moved = MOVED * 2.0 * float(self.law.half[1])
        return float(np.clip(moved / max(fastest, 1e-12), SHORTEST_S, LONGEST_S))

    def groups(self, stack: Motion, span_s: float, wider: float) -> tuple[list[Group], Integers]:
        """The groups over a span of time, and each rod's group (n,) by its number, or by one of its
        own; ``wider`` multiplies how near is near."""
        rods = len(stack.x)
        close = np.zeros(len(self.pairs), dtype=np.bool_)
        apart = wider * NEAR * 2.0 * float(self.law.half[0])
        near(self.law, self.pairs, stack, apart, wider * span_s, close)
        ends = self.pairs[close][:, [0, 2]]
        graph = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(rods, rods))
        _, of = connected_components(graph, directed=False)
        counts = np.bincount(of, minlength=rods)
        rows = np.flatnonzero(of[self.pairs[:, 0]] == of[self.pairs[:, 2]])
        owner = of[self.pairs[rows, 0]]
        found = [
            Group(np.flatnonzero(of == g), rows[owner == g]) for g in np.flatnonzero(counts > 1)
        ]
        return found, of

    def met(self, stack: Motion, of: Integers | None = None) -> tuple[int, int] | None:
        """Two rods of different groups that are in each other, or None."""
        close = np.zeros(len(self.pairs), dtype=np.bool_)
        near(self.law, self.pairs, stack, -2.0 * TOUCHING_M, 0.0, close)
        if of is not None:
            close &= of[self.pairs[:, 0]] != of[self.pairs[:, 2]]
        found = np.flatnonzero(close)
        return (int(self.pairs[found[0], 0]), int(self.pairs[found[0], 2])) if len(found) else None

    def normal_N(self, rods: int) -> Array:
        """The sum of the normal forces of other rods on each (rods,)."""
        each = self.touch.normal.sum(axis=1)
        total = np.bincount(self.pairs[:, 0], each, rods) + np.bincount(
            self.pairs[:, 2], each, rods
        )
        return np.asarray(total)

    def checkpoint(self) -> dict[str, Any]:
        """What the next search needs of the past: points that touch, and where rods were."""
        held = (self.touch.state != FREE).any(axis=1)
        kept = {f"pair_{name}": each[held] for name, each in self.touch._asdict().items()}
        placed = np.zeros((0, 0, 3)) if self._placed is None else self._placed
        return kept | {"pairs": self.pairs, "pairs_held": self.pairs[held], "pairs_placed": placed}

    def restore(self, kept: Mapping[str, Any]) -> None:
        """Go back to a `checkpoint`."""
        placed = kept["pairs_placed"]
        self._placed = placed if placed.size else None
        touch = Touch(*(kept[f"pair_{name}"] for name in Touch._fields))
        self._take(kept["pairs"], touch, kept["pairs_held"])


def _sorted(pairs: Integers) -> Integers:
    """In the order of their numbers, whatever the order they were found in."""
    return pairs[np.lexsort(pairs.T[::-1])]


def _places(pairs: Integers, wanted: Integers) -> Integers:
    """Where the ``wanted`` pairs (m, 4) are among sorted ``pairs``, or -1."""
    if not len(pairs):
        return np.full(len(wanted), -1)
    top = 1 + max(int(pairs.max()), int(wanted.max(initial=0)))
    codes, sought = (
        ((each[:, 0] * top + each[:, 1]) * top + each[:, 2]) * top + each[:, 3]
        for each in (pairs, wanted)
    )
    at = np.minimum(np.searchsorted(codes, sought), len(codes) - 1)
    return np.where(codes[at] == sought, at, -1)


def shared_out(
    groups: list[Group], of: Integers, ranks: int
) -> tuple[list[list[int]], list[Integers]]:
    """Which groups, by their place in the list, and which lone rods each rank marches.

    The largest group goes first, to the rank with the least to do.
    """
    todo = [(0, rank) for rank in range(ranks)]
    mine: list[list[int]] = [[] for _ in range(ranks)]
    lone: list[list[int]] = [[] for _ in range(ranks)]
    for g in sorted(range(len(groups)), key=lambda g: (-len(groups[g].members), g)):
        load, rank = heapq.heappop(todo)
        mine[rank].append(g)
        heapq.heappush(todo, (load + len(groups[g].members), rank))
    for i in np.flatnonzero(np.bincount(of)[of] == 1):
        load, rank = heapq.heappop(todo)
        lone[rank].append(int(i))
        heapq.heappush(todo, (load + 1, rank))
    return mine, [np.array(each, dtype=np.int64) for each in lone]
