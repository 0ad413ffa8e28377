"""Which parameters of an account go with the published summaries, and does it explain them?

Only summaries are published, so the likelihood is synthetic (Wood, Nature 466, 2010): the summary
vectors of many simulated films are taken as normal, with their own mean and covariance. All
parameters are tried on one set of random numbers, so that the likelihood is smooth in them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...solver import paper
from ...solver.bristle import Array
from .film import PUBLISHED, ROUNDING, Film, Moments, moments, planned_heights_m, vector
from .library import Library
from .models import CHANCES, Account

SEED = 1807
LEVEL = 0.90
# Share of the greatest likelihood below which the second, finer ladder does not look.
NEGLIGIBLE = 1e-3
KNOWN_NEAR = 0.05


@dataclass(frozen=True)
class Effort:
    """How finely a fit looks: values per parameter, first and second time, and films simulated."""

    coarse: int = 13
    fine: int = 19
    few: int = 150
    sets: int = 400
    replicas: int = 2000


class Predicted(NamedTuple):
    """Mean (5,) and covariance (5, 5) of the summary vector."""

    mean: Array
    covariance: Array

    def misfit(self, seen: Array) -> Array:
        """χ² (…) of vectors (…, 5): -2 log of their likelihood relative to the greatest."""
        away = seen - self.mean
        return np.sum(away * np.linalg.solve(self.covariance, away[..., None])[..., 0], axis=-1)

    def deviance(self, seen: Array) -> Array:
        """-2 log of the synthetic likelihood, a constant left out."""
        return self.misfit(seen) + np.linalg.slogdet(self.covariance)[1]


@dataclass(frozen=True)
class Drawn:
    """The random numbers of films of 26 drops, the same for whatever is simulated with them."""

    heights_m: Array
    chance: Array
    film_chance: Array

    @classmethod
    def of(cls, sets: int, seed: int = SEED, n: int = paper.N_DROPS) -> Drawn:
        """Numbers for ``sets`` films of ``n`` drops."""
        random = np.random.default_rng(seed)
        heights = planned_heights_m(n)
        return cls(
            heights,
            random.standard_normal((CHANCES, sets, n)),
            random.standard_normal((3, sets, n)),
        )

    def first(self, sets: int) -> Drawn:
        """The same numbers for the first films alone."""
        return Drawn(self.heights_m, self.chance[:, :sets], self.film_chance[:, :sets])


def films(
    account: Account, values: Sequence[float], library: Library, film: Film, drawn: Drawn
) -> tuple[Array, Array]:
    """Heights before and after as read, (sets, drops)."""
    conditions = account.conditions(values, drawn.heights_m, drawn.chance)
    y1 = library.at(conditions) * drawn.heights_m
    return film.read(drawn.heights_m, y1, drawn.film_chance)


def predict(vectors: Array) -> Predicted:
    """Mean and covariance of summary vectors (sets, 5), the rounding in print included."""
    return Predicted(vectors.mean(axis=0), np.cov(vectors, rowvar=False) + np.diag(ROUNDING**2))


@dataclass(frozen=True)
class Fit:
    """What the published summaries say of one account.

    ``points`` (n, k) and ``weights`` (n,) are the posterior on a grid, flat between the bounds.
    ``best`` (k,) is its most likely point, ``interval`` (k, 2) holds ``LEVEL`` of each parameter.
    ``chi2`` and ``p`` are before (at declared values) and after the fit; ``criterion`` is the
    greatest deviance plus twice the number of parameters (Akaike).
    """

    account: Account
    points: Array
    weights: Array
    best: tuple[float, ...]
    interval: tuple[tuple[float, float], ...]
    chi2_declared: float
    chi2: float
    p_declared: float
    p: float
    criterion: float
    predicted: Moments
    predicted_low: Moments
    predicted_high: Moments
    known_drop: float

    def draws(self, n: int, seed: int = SEED) -> Array:
        """Points (n, k) of the posterior."""
        random = np.random.default_rng(seed)
        return self.points[random.choice(len(self.points), n, p=self.weights)]

    def at_bound(self, i: int) -> bool:
        """Whether the best value or the interval of parameter ``i`` ends where its bounds do."""
        low, high = self.account.parameters[i].ladder(2)
        ends = (self.best[i], *self.interval[i])
        return any(bool(np.isclose(end, (low, high), atol=1e-9).any()) for end in ends)


def fit(
    account: Account,
    library: Library,
    seen: Array | None = None,
    film: Film | None = None,
    effort: Effort | None = None,
    seed: int = SEED,
) -> Fit:
    """Fit ``account`` to the summary vector ``seen`` (5,), by default the published one."""
    film, effort = film or Film(), effort or Effort()
    seen = vector(PUBLISHED) if seen is None else seen
    drawn = Drawn.of(effort.sets, seed)

    def predicted(values: Sequence[float], drawn: Drawn) -> Predicted:
        return predict(vector(moments(*films(account, values, library, film, drawn))))

    ladders = [
        p.ladder(4 * effort.coarse if _alone(account) else effort.coarse)
        for p in account.parameters
    ]
    points, deviance = _scan(ladders, lambda v: predicted(v, drawn.first(effort.few)), seen)
    ladders = _closer(account, ladders, points, deviance, effort.fine)
    points, deviance = _scan(ladders, lambda v: predicted(v, drawn), seen)
    weights = np.exp(-0.5 * (deviance - deviance.min()))
    weights /= weights.sum()
    best = points[int(np.argmin(deviance))]
    declared = [p.declared for p in account.parameters]
    other = Drawn.of(effort.replicas, seed + 1)
    here, before = predicted(best, drawn), predicted(declared, drawn)
    replica = films(account, best, library, film, other)
    vectors = vector(moments(*replica))
    strangers = vector(moments(*films(account, declared, library, film, other)))
    own = _posterior_films(account, library, film, points, weights, other, seed)
    spread = [np.percentile(part, (5.0, 50.0, 95.0)) for part in moments(*own)]
    low, middle, high = (Moments(*column) for column in np.array(spread).T)
    return Fit(
        account,
        points,
        weights,
        tuple(map(float, best)),
        tuple(_interval(ladder, points[:, i], weights) for i, ladder in enumerate(ladders)),
        float(before.misfit(seen)),
        float(here.misfit(seen)),
        p_value(before.misfit(strangers), float(before.misfit(seen))),
        p_value(here.misfit(vectors), float(here.misfit(seen))),
        float(deviance.min()) + 2.0 * len(declared),
        middle,
        low,
        high,
        _near_known(*own),
    )


def _alone(account: Account) -> bool:
    return len(account.parameters) == 1


def _scan(ladders: list[Array], predicted, seen: Array) -> tuple[Array, Array]:
    """All points of the grid (n, k) and the deviance (n,) of ``seen`` at each."""
    points = np.array(list(itertools.product(*ladders)))
    return points, np.array([float(predicted(point).deviance(seen)) for point in points])


def _closer(
    account: Account, ladders: list[Array], points: Array, deviance: Array, n: int
) -> list[Array]:
    """Finer ladders over the part where the likelihood is not negligible, a step more each way."""
    likely = points[deviance - deviance.min() <= -2.0 * math.log(NEGLIGIBLE)]
    finer = []
    for i, (parameter, ladder) in enumerate(zip(account.parameters, ladders, strict=True)):
        first = int(np.searchsorted(ladder, likely[:, i].min() * (1 - 1e-12)))
        last = int(np.searchsorted(ladder, likely[:, i].max() * (1 - 1e-12)))
        low, high = ladder[max(first - 1, 0)], ladder[min(last + 1, len(ladder) - 1)]
        finer.append(parameter.ladder(4 * n if _alone(account) else n, low, high))
    return finer


def _interval(ladder: Array, values: Array, weights: Array) -> tuple[float, float]:
    """The interval that holds ``LEVEL``, as much outside on each side.

    Probability is spread evenly around each point of the ladder, so ends fall between points.
    """
    mass = np.array([weights[values == value].sum() for value in ladder])
    index = np.arange(len(ladder))
    edges = np.concatenate([[0.0], index[:-1] + 0.5, [float(len(ladder) - 1)]])
    total = np.concatenate([[0.0], np.cumsum(mass)]) / mass.sum()
    tail = 0.5 * (1.0 - LEVEL)
    ends = np.interp((tail, 1.0 - tail), total, edges)
    low, high = np.interp(ends, index, ladder)
    return float(low), float(high)


def _posterior_films(
    account: Account,
    library: Library,
    film: Film,
    points: Array,
    weights: Array,
    drawn: Drawn,
    seed: int,
) -> tuple[Array, Array]:
    """Films (sets, drops) with parameters drawn from the posterior, 20 films a draw."""
    random = np.random.default_rng(seed + 2)
    sets = drawn.chance.shape[1]
    picks = random.choice(len(points), max(sets // 20, 1), p=weights)
    parts = []
    for pick, group in zip(picks, np.array_split(np.arange(sets), len(picks)), strict=True):
        few = Drawn(drawn.heights_m, drawn.chance[:, group], drawn.film_chance[:, group])
        parts.append(films(account, points[pick], library, film, few))
    y0, y1 = (np.concatenate(heights) for heights in zip(*parts, strict=True))
    return y0, y1


def p_value(drawn: Array, seen: float) -> float:
    """Share of ``drawn`` (n,) that is at least ``seen``, never zero."""
    return float((1 + np.count_nonzero(drawn >= seen)) / (len(drawn) + 1))


def _near_known(y0_m: Array, y1_m: Array) -> float:
    """Share of drops from 50 mm with y1/y0 within ± 0.05 of the drop published with numbers."""
    known = paper.KNOWN_DROP_M[1] / paper.KNOWN_DROP_M[0]
    highest = np.abs(planned_heights_m() - paper.KNOWN_DROP_M[0]) < 2e-3
    ratio = (y1_m / y0_m)[:, highest]
    return float(np.mean(np.abs(ratio - known) <= KNOWN_NEAR))
