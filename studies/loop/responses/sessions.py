"""Drops of two sessions: the ways to part them, and the one that data ask for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from ....solver.arrays import Array
from ..fit import BOX_PRECISION, Fitted
from ..noise import Ints
from ..sample import Sample

# How many drops a session has, to be told from slips: one that the table tells, and others.
FEWEST_TOLD, FEWEST_IN_SESSION = 2, 4
# Another beginning that gains at most so many nats less is nearly as likely.
NEARLY = 2.0
# Residuals beyond so many standard deviations count as if they were no larger.
SOFT = 5.0


@dataclass(frozen=True)
class Partings:
    """Ways to part drops, of numbers ``drop`` (drops,), into two sessions.

    Where ``label`` (drops,) tells sessions apart, by their ``names`` or by gaps in the numbering,
    they are parted at one of their boundaries, or one of them from all others; else, where all
    labels are zero, anywhere in the order. ``second`` (drops,) is one in the second session, which
    may begin nearly as well with any drop between the numbers ``near``.
    """

    drop: Array
    label: Ints
    names: tuple[str, ...] = ()
    second: Array | float = 0.0
    near: tuple[float, float] = (0.0, 0.0)

    @cached_property
    def _told(self) -> bool:
        return int(self.label.max()) > 0

    @cached_property
    def _labels(self) -> Ints:
        return self.label if self._told else np.arange(len(self.label))

    def _sums(self, values: Array) -> Array:
        """Sums of values (drops, k) over the second session of every way (ways, k)."""
        count = int(self._labels.max()) + 1
        by_label = np.zeros((count, values.shape[1]))
        np.add.at(by_label, self._labels, values)
        later = np.cumsum(by_label[::-1], axis=0)[::-1][1:]
        # and of labels that are told each one alone
        return np.concatenate([later, by_label[1:-1]]) if self._told and count > 2 else later

    @cached_property
    def possible(self) -> Ints:
        """Numbers of the ways that leave drops enough on either side."""
        second = self._sums(np.ones((len(self.label), 1)))[:, 0]
        fewest = FEWEST_TOLD if self._told else FEWEST_IN_SESSION
        return np.flatnonzero(np.minimum(second, len(self.label) - second) >= fewest)

    def parted(self, gain: Array) -> Self:
        """Parted in the possible way of the largest ``gain`` (possible ways,), in nats."""
        best = int(self.possible[np.argmax(gain)])
        later = int(self._labels.max())
        second = self._labels > best if best < later else self._labels == 1 + best - later
        near = self.possible[gain > gain.max() - NEARLY]
        first, last = (0.0, 0.0) if self._told else self.drop[1 + near[[0, -1]]]
        return replace(self, second=second.astype(float), near=(float(first), float(last)))

    def gains(self, data: Sample, beside: Fitted, drop: Ints, slope: Array) -> Array:
        """What two sessions would gain, in nats and by the way to part them (possible ways,). The
        fit ``beside`` has one session, and what it leaves free is refitted.

        ``drop`` (rows,) is each row's, and ``slope`` (rows,) what a second session does to it. By
        the score of its size (C. R. Rao, Math. Proc. Camb. Phil. Soc. 44 (1948) 50).
        """
        left = np.clip(data.values - beside.mean, -SOFT, SOFT)
        weight = 1.0 / (1.0 + beside.spread**2)
        free = beside.mean_slopes
        weighted = free.T * weight
        held = np.linalg.inv(weighted @ free + BOX_PRECISION * np.eye(free.shape[1]))
        terms = np.column_stack([left, slope, free]) * (weight * slope)[:, None]
        sums = np.zeros((len(self.label), terms.shape[1]))
        np.add.at(sums, drop, terms)
        every = self._sums(sums)[self.possible]
        load, size, cross = every[:, 0], every[:, 1], every[:, 2:]
        own = size - np.einsum("wp,pq,wq->w", cross, held, cross)
        load = load - cross @ held @ (weighted @ left)
        return np.asarray(0.5 * load**2 / np.maximum(own, 1e-9 * size.max() + 1e-300))

    @property
    def words(self) -> str:
        """Which drops are those of the second session."""
        second = np.flatnonzero(self.second)
        if self.names and self._told:
            return "of " + ", ".join(dict.fromkeys(self.names[i] for i in self.label[second]))
        first, last = (f"{self.drop[i]:g}" for i in second[[0, -1]])
        if second[-1] < len(self.label) - 1:
            return f"of drops {first} to {last}"
        if self.near[0] == self.near[1]:
            return f"from drop {first} on"
        near = f"{self.near[0]:g} to {self.near[1]:g}"
        return f"from drop {first} on (any beginning from {near} explains nearly as much)"
