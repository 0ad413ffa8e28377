"""Rows that are analysed together: their order, groups and units.

A `Sample` is a problem's rows of some groups, sorted by group, with the noises that they may have.
Where sigma is not declared, each quantity is first brought to unit scatter: by replicates (groups
of the same covariate height), else by successive differences (von Neumann 1941), both by medians.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ...solver.arrays import Array
from .noise import Chain, Ints, Noises, log_density, log_likelihoods, noises
from .problem import Divisible, Model, Problem

# Covariates that say in which order values were made, the finest first.
WITHIN = ("time", "phase")
BETWEEN = ("order",)
HEIGHT = ("height", "speed")
# Numbers that are predicted at once: a hundred megabytes with all that they are made from.
MOST_AT_ONCE = 500_000
# So many groups are enough to find out where a fit begins. With half as many a faint effect is
# begun elsewhere and found by the fit to all; with twice as many the search takes twice as long.
ENOUGH = 120
# Of fewer groups than these all are searched.
MANY = 400


@dataclass(frozen=True)
class Sample:
    """Rows of some groups: ``rows`` numbers them in the problem; all else is by row here.

    ``unit`` (rows,) multiplies whitened values where sigma is estimated. ``starts`` (groups + 1,).
    ``kind`` numbers the quantity of each row. ``share`` is a sample of some of these groups, from
    all heights, where there are many of them and models are `Divisible`: these predict the rows of
    a sample and no others.
    """

    rows: Ints
    values: Array
    unit: Array
    starts: Ints
    group: Ints
    kind: Ints
    covariates: dict[str, Array]
    noises: Noises
    share: Sample | None = None

    @property
    def first(self) -> Sample:
        """The sample on which fits begin."""
        return self.share or self

    @property
    def times(self) -> float:
        """How many times as many rows this has as `first`."""
        return self.values.size / self.first.values.size

    def predict(self, model: Model, theta: Array) -> Array:
        """Predictions (..., nodes, rows) at parameters (..., p)."""
        theta = np.asarray(theta, dtype=float)
        points = theta.reshape(-1, theta.shape[-1])
        place: Ints | None = self.rows
        if isinstance(model, Divisible):
            model, place = model.only(self.rows), self._place
        at_once = max(MOST_AT_ONCE // (np.asarray(model.weights).size * self.rows.size), 1)
        found = []
        for i in range(0, len(points), at_once):
            own = np.asarray(model.predict(points[i : i + at_once]), dtype=float)
            own = own if place is None else np.take(own, place, axis=-1)
            found.append(own if self._plain else own * self.unit)
        every = found[0] if len(found) == 1 else np.concatenate(found)
        return every.reshape(*theta.shape[:-1], *every.shape[1:])

    @cached_property
    def _place(self) -> Ints | None:
        """Of each row among these in the problem's order; None where they are in it: groups may
        stand in any order."""
        place = np.argsort(np.argsort(self.rows))
        return None if np.all(np.diff(place) == 1) else place

    @cached_property
    def _plain(self) -> bool:
        """Whether whitened values are as the problem has them."""
        return bool(np.all(self.unit == 1.0))

    def log_likelihood(
        self, values: Array, predicted: Array, weights: Array, at: tuple[Ints, Ints, Ints]
    ) -> Array:
        """Log likelihood of cases (value, prediction, noise), one number for each.

        ``values`` (sets, rows), ``predicted`` (predictions, nodes, rows), ``weights`` (nodes,);
        ``at``: three broadcastable arrays of numbers into values, predictions and noises. Groups
        are independent given the drop before; what that drop's own chance was is taken at its mean,
        which is exact without correlation.
        """
        first, second, third = np.broadcast_arrays(*at)
        found = log_likelihoods(
            np.ascontiguousarray(values, dtype=float),
            np.ascontiguousarray(predicted, dtype=float),
            np.ascontiguousarray(weights, dtype=float),
            self.starts,
            self.noises,
            log_density(),
            np.ascontiguousarray(first.ravel(), dtype=np.int64),
            np.ascontiguousarray(second.ravel(), dtype=np.int64),
            np.ascontiguousarray(third.ravel(), dtype=np.int64),
        )
        return found.reshape(first.shape)

    def heights(
        self, values: Array, predicted: Array, weights: Array, among: Ints | None = None
    ) -> Array:
        """Log likelihoods with prior (n, noises) under the noises ``among``, or all.

        Of ``values`` (n, rows) and ``predicted`` (n, nodes, rows), in pairs; one serves all.
        """
        among = np.arange(self.noises.scale.size) if among is None else among
        at = (np.arange(len(values))[:, None], np.arange(len(predicted))[:, None], among[None])
        return self.noises.prior[among] + self.log_likelihood(values, predicted, weights, at)

    def heights_at(self, model: Model, theta: Array, among: Ints) -> Array:
        """`heights` (points, noises) of the values at parameters (points, p)."""
        weights = np.asarray(model.weights)
        at_once = max(2 * MOST_AT_ONCE // (weights.size * self.rows.size), 1)
        found: list[Array] = [np.zeros((0, among.size))]
        for i in range(0, len(theta), at_once):
            predicted = self.predict(model, theta[i : i + at_once])
            found.append(self.heights(self.values[None], predicted, weights, among))
        return np.concatenate(found)

    def heights_of_noise(self, residuals: Array, among: Ints | None = None) -> Array:
        """`heights` of residuals (n, rows)."""
        return self.heights(residuals, np.zeros((1, 1, residuals.shape[1])), np.ones(1), among)


def sample(problem: Problem, groups: Ints, unit: Array | None = None) -> Sample:
    """The rows of these groups. ``unit`` (rows of the problem,) overrides what is estimated."""
    rows = np.flatnonzero(np.isin(problem.group, groups))
    rows = rows[np.argsort(problem.group[rows], kind="stable")]
    kinds = np.unique(problem.quantity, return_inverse=True)[1]
    kind = kinds[rows].astype(np.int64)
    label = problem.group[rows]
    starts = np.concatenate([[0], np.flatnonzero(np.diff(label)) + 1, [rows.size]])
    covariates = {name: np.asarray(x, dtype=float)[rows] for name, x in problem.covariates.items()}
    chain = _chain(label, kind, covariates)
    scaling = np.ones(rows.size) if unit is None else unit[rows]
    share = None
    if len(groups) > MANY and isinstance(problem.baseline, Divisible):
        share = sample(problem, _some(problem, groups), unit)
    return Sample(
        rows=rows,
        values=problem.values[rows] * scaling,
        unit=scaling,
        starts=starts.astype(np.int64),
        group=np.repeat(np.arange(starts.size - 1), np.diff(starts)),
        kind=kind,
        covariates=covariates,
        noises=noises(chain, problem.sigma_declared),
        share=share,
    )


def _some(problem: Problem, groups: Ints) -> Ints:
    """`ENOUGH` of ``groups``, evenly over the height, the lowest and the highest among them."""
    numbers, first = np.unique(problem.group, return_index=True)
    row = first[np.isin(numbers, groups)]
    height = first_of(problem.covariates, HEIGHT, np.zeros(problem.group.size))
    order = np.random.default_rng(0).permutation(row.size)  # of equal heights, none in turn
    order = order[np.argsort(np.asarray(height)[row][order], kind="stable")]
    chosen = order[np.linspace(0, row.size - 1, ENOUGH).astype(np.int64)]
    return np.sort(numbers[np.isin(numbers, groups)][chosen])


def first_of(covariates: Mapping[str, Array], names: tuple[str, ...], otherwise: Any = None) -> Any:
    """The first covariate of these names that there is."""
    return next((covariates[name] for name in names if name in covariates), otherwise)


def counted(order: Array) -> Ints:
    """Numbers (rows,) from zero in the steps that they come in, whole: drops that are numbered by
    fives come one after the other."""
    place = np.round(order).astype(np.int64)
    place -= place.min()
    return np.asarray(place // max(int(np.gcd.reduce(place)), 1))


def _chain(label: Ints, kind: Ints, covariates: dict[str, Array]) -> Chain:
    """The row before each: within its group where a quantity has several rows there, else in the
    order in which groups were made; always of the same quantity."""
    rows = label.size
    previous = np.full(rows, -1, dtype=np.int64)
    gap = np.ones(rows)
    order = first_of(covariates, BETWEEN, label.astype(float))
    fine = first_of(covariates, WITHIN, np.arange(rows, dtype=float))
    for each in np.unique(kind):
        mine = np.flatnonzero(kind == each)
        several = np.unique(label[mine]).size < mine.size
        key = (fine[mine], label[mine]) if several else (order[mine],)
        mine = mine[np.lexsort(key)]
        same = label[mine[1:]] == label[mine[:-1]] if several else np.ones(mine.size - 1, bool)
        previous[mine[1:]] = np.where(same, mine[:-1], -1)
        if not several:
            gap[mine[1:]] = np.maximum(np.diff(counted(order[mine])), 1.0)
    return Chain(previous, gap)


def estimated_units(problem: Problem, groups: Ints, fitted: Array) -> Array:
    """One over the scatter of each row's quantity, in whitened units, from residuals (rows,).

    Replicates first; where no two groups share a height, differences of neighbours. The relative
    error of a scale from n values is about 1.2 / √n.
    """
    unit = np.ones(problem.values.size)
    residual = problem.values - fitted
    height = first_of(problem.covariates, HEIGHT, np.arange(problem.values.size))
    chosen = np.isin(problem.group, groups)
    for name in np.unique(problem.quantity):
        mine = np.flatnonzero((problem.quantity == name) & chosen)
        spread = _replicate_spread(residual[mine], height[mine])
        unit[problem.quantity == name] = 1 / max(spread, 1e-12)
    return unit


def _replicate_spread(residual: Array, height: Array) -> float:
    pieces = []
    for level in np.unique(height):
        same = residual[height == level]
        if same.size >= 3:
            pieces.append((same - np.median(same)) * np.sqrt(same.size / (same.size - 1)))
    ordered = residual[np.argsort(height, kind="stable")]
    if sum(piece.size for piece in pieces) >= 10:
        return float(1.4826 * np.median(np.abs(np.concatenate(pieces))))
    if ordered.size < 3:
        return 1.0
    return float(1.4826 * np.median(np.abs(np.diff(ordered))) / np.sqrt(2))
