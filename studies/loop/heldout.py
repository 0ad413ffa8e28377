"""Held-out groups: prediction of what took no part in fitting or choosing.

Where the problem names no groups to hold out, a quarter of them are chosen by the seed before
anything is fitted: sorted by height, one of each four neighbours, so that every height is tried.
Whole groups, since rows of one group share its chance. What prepares a table sees all of its rows:
where two sessions are told apart, which rows are slips, how a height's error is whitened.

The log score is the logarithm of the predictive density (I. J. Good, J. R. Stat. Soc. B 14 (1952)
107; Gneiting and Raftery, J. Am. Stat. Assoc. 102 (2007) 359), the parameters integrated out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.special import logsumexp, ndtri

from ...solver.arrays import Array
from .noise import Ints, log_density_at
from .posterior import Posterior, posterior
from .problem import Problem
from .sample import HEIGHT, Sample, first_of, sample
from .search import fit_anew

LEAST_GROUPS = 4
# With fewer held-out groups their score is a matter of chance: drawn again with replacement, two
# are the worse one twice in a quarter of all draws, and so tell no end of a 90 % interval.
LEAST_SCORED = 3
RESAMPLED = 999
DRAWS = 999
POINTS = 60
# With fewer a model would be fitted to much less than it was, and a session might be missing (five
# or ten: R. Kohavi, Proc. IJCAI 2 (1995) 1137).
FOLDS = 5
# So many neighbours in order are in one block: correlation of 0.65, the strongest that noise may
# have, is 0.2 at that distance.
IN_BLOCK = 4
# A model is fitted anew to so many groups or more.
LEAST_FITTED = 2
# Noises of a smaller probability are left out.
LEAST_SHARE = 1e-6
TRIMMED = 1 / 8
# Of `HeldOut`, by their own names in verdict.json.
KEYS = (
    *("unit", "rms_before", "rms_after", "rms_sigma"),
    *("reduction_low", "reduction_high", "coverage_90"),
)


@dataclass(frozen=True)
class HeldOut:
    """Errors in ``unit`` on held-out ``groups``; ``reduction`` is 1 − after / before, with its 90 %
    interval over groups. ``sigma`` is the error that the final model and its noise allow for.
    ``surprise`` is the least chance, by draws of both, of errors as large in all quantities, of
    such in the main one if it has eight, both without the largest eighth, and of as few rows within
    their 90 % intervals. ``rms_sigma`` is the error of all quantities over the declared noise;
    ``greatest`` the largest of them over that noise or, if it is more, over what the model's 90 %
    interval allows, zero where no noise is declared, and ``farthest`` its group. ``by_quantity``
    are the errors of each over its noise, before and after.
    ``values``, ``before``, ``after``, ``low``, ``high`` (rows,) in ``unit`` by held-out row of the
    main quantity. ``gain`` is cross-validated over all groups."""

    groups: tuple[int, ...]
    unit: str
    rms_before: float
    rms_after: float
    sigma: float
    rms_sigma: float
    surprise: float
    greatest: float
    farthest: int
    by_quantity: Mapping[str, tuple[float, float]]
    reduction_low: float
    reduction_high: float
    coverage_90: float
    gain: Gain
    rows: Ints
    values: Array
    before: Array
    after: Array
    low: Array
    high: Array

    def keys(self) -> dict[str, Any]:
        """The ``held_out`` of verdict.json."""
        own = {name: getattr(self, name) for name in KEYS}
        gain = {
            "log_score_gain": self.gain.total,
            "log_score_gain_low": self.gain.low,
            "log_score_gain_high": self.gain.high,
        }
        return {"groups": list(self.groups), "noise": self.sigma, **own, **gain}


def split(problem: Problem, seed: int) -> tuple[Ints, Ints]:
    """Groups for fitting and groups held out."""
    rng = np.random.default_rng([seed, 1])
    groups = problem.groups
    if problem.held is not None:
        apart = np.isin(groups, problem.held)
        return groups[~apart], groups[apart]
    if groups.size < LEAST_GROUPS:
        return groups, groups[:0]
    height = first_of(problem.covariates, HEIGHT, np.zeros(problem.group.size))
    key = np.array([np.mean(height[problem.group == g]) for g in groups])
    order = np.lexsort((rng.random(groups.size), np.round(key, 12)))
    blocks = np.array_split(order, max(1, groups.size // 4))
    chosen = np.array([int(rng.choice(block)) for block in blocks])
    held = np.zeros(groups.size, dtype=bool)
    held[chosen] = True
    return groups[~held], groups[held]


@dataclass(frozen=True)
class Gain:
    """Log score gained, in nats, with its 90 % interval over groups, and whether squared errors
    fall."""

    total: float = 0.0
    low: float = 0.0
    high: float = 0.0
    nearer: bool = False


class Scores(NamedTuple):
    """Log scores (groups,) of data that a model was not fitted to, and the sum of the squared
    errors."""

    logs: Array
    squares: float


class Predicted(NamedTuple):
    """Whitened predictions of held-out rows: ``mean`` (rows,), ``draws`` (draws, rows)."""

    mean: Array
    draws: Array


@dataclass(frozen=True)
class Judge:
    """Scores models on rows that they are not fitted to, the baseline once."""

    problem: Problem
    data: Sample
    held: Sample
    base: Posterior
    seed: int

    @cached_property
    def before(self) -> Predicted:
        """The baseline's predictions."""
        return self.predict(self.base)

    def predict(self, final: Posterior) -> Predicted:
        """The predictive distribution of one model."""
        rng = np.random.default_rng([self.seed, 3])
        predicted = _drawn(self.held, final, rng)
        shares = _shares(final, self.held)
        draws = _draws(self.held, final, predicted, shares, rng)
        model = final.fitted.model
        mean = np.asarray(model.weights) @ self.held.predict(model, final.fitted.theta)
        return Predicted(np.asarray(mean), draws)

    @cached_property
    def plain(self) -> Scores:
        """The baseline's scores."""
        return self.scores(self.base)

    def scores(self, final: Posterior) -> Scores:
        """A model's scores, cross-validated: the held-out groups are scored by the model as it is
        fitted, and each fifth of the others, in blocks, by the model fitted anew without it; where
        there are few, each by itself. Errors are those of the mean prediction."""
        rng = np.random.default_rng([self.seed, 4])
        logs, squares = [], 0.0
        for fitted, scored in self._parts:
            model = final if fitted is self.data else self._anew(fitted, final, rng)
            drawn, weights = _drawn(scored, model, rng), np.asarray(final.fitted.model.weights)
            logs.append(_group_scores(scored, model, drawn, _shares(model, scored)))
            squares += float(np.sum((scored.values - (weights @ drawn).mean(axis=0)) ** 2))
        return Scores(np.concatenate(logs), squares)

    def _anew(self, data: Sample, final: Posterior, rng: np.random.Generator) -> Posterior:
        """The same model fitted to these rows alone, as if the others were not known."""
        fitted = fit_anew(data, final.fitted.model, final.fitted.u)
        return posterior(data, fitted, self.base.fitted.u.size, rng)

    def gain(self, one: Scores, other: Scores) -> Gain:
        """What a model with the scores ``one`` gains over another."""
        gains = one.logs - other.logs
        rng = np.random.default_rng([self.seed, 7])
        totals = gains[rng.integers(gains.size, size=(RESAMPLED, gains.size))].sum(axis=1)
        low, high = np.quantile(totals, [0.05, 0.95])
        nearer = one.squares < other.squares
        return Gain(float(gains.sum()), float(low), float(high), nearer)

    @cached_property
    def _parts(self) -> list[tuple[Sample, Sample]]:
        """Rows to fit a model to, and others to score it on."""
        folds = [(self.data, self.held)] if self.held.values.size else []
        labels = np.unique(self.problem.group[self.data.rows])
        if labels.size >= LEAST_FITTED + 1:
            unit = np.ones(self.problem.values.size)
            unit[self.data.rows] = self.data.unit
            for part in self._folds(labels):
                rest = np.setdiff1d(labels, part)
                folds.append((sample(self.problem, rest, unit), sample(self.problem, part, unit)))
        return folds

    def _folds(self, labels: Ints) -> list[Ints]:
        """Groups ``labels`` in `FOLDS` parts of blocks: neighbours in order stay together, since
        what they share would tell of each other, and neighbouring blocks do not."""
        if labels.size < 2 * FOLDS:  # one by one
            return list(labels[:, None])
        count = max(labels.size // IN_BLOCK, FOLDS)
        block = np.arange(labels.size) * count // labels.size
        return [labels[block % FOLDS == k] for k in range(FOLDS)]

    def judge(self, final: Posterior, gain: Gain) -> HeldOut:
        """Errors of baseline and final model on the held-out rows of the main quantity; ``gain`` is
        the final model's over the baseline."""
        problem, held = self.problem, self.held
        rng = np.random.default_rng([self.seed, 5])
        mine = np.flatnonzero(problem.is_main[held.rows])
        if not mine.size:
            mine = np.arange(held.rows.size)
        rows = held.rows[mine]
        scale = problem.scale[rows] / held.unit[mine]
        plain = final is self.base
        found = self.before if plain else self.predict(final)
        values, before = held.values[mine] * scale, self.before.mean[mine] * scale
        after = found.mean[mine] * scale
        low, high = np.quantile(found.draws, [0.05, 0.95], axis=0)
        inside = (held.values >= low) & (held.values <= high)
        spread = found.draws - found.draws.mean(axis=0)
        error, chance = held.values - found.mean, found.draws - found.mean
        unaided, names = held.values - self.before.mean, problem.quantity[held.rows]
        allowed = np.maximum((high - low) / (2.0 * ndtri(0.95)), 1.0)
        off = np.abs(error) / allowed if problem.sigma_declared else np.zeros(0)
        within = np.mean((found.draws >= low) & (found.draws <= high), axis=1)
        as_odd = [trimmed_rms(chance) >= trimmed_rms(error), within <= np.mean(inside)]
        if TRIMMED * mine.size >= 1.0:
            as_odd.append(trimmed_rms(chance[:, mine]) >= trimmed_rms(error[mine]))
        ends = _reduction(held.group[mine], values - before, values - after, rng)
        return HeldOut(
            groups=tuple(int(g) for g in np.unique(problem.group[held.rows])),
            unit=problem.unit,
            rms_before=rms(values - before),
            rms_after=rms(values - after),
            sigma=rms(spread[:, mine] * scale),
            rms_sigma=rms(error),
            surprise=min((float(np.sum(each)) + 1.0) / (len(each) + 1.0) for each in as_odd),
            greatest=float(off.max(initial=0.0)),
            farthest=int(problem.group[held.rows[np.argmax(off)]]) if off.size else -1,
            by_quantity={
                str(name): (rms(unaided[names == name]), rms(error[names == name]))
                for name in np.unique(names)
            },
            reduction_low=ends[0],
            reduction_high=ends[1],
            coverage_90=float(np.mean(inside)),
            gain=gain,
            rows=rows,
            values=values,
            before=before,
            after=after,
            low=low[mine] * scale,
            high=high[mine] * scale,
        )


def rms(error: Array) -> float:
    """Root mean square of all; zero of none."""
    return float(np.sqrt(np.mean(error**2))) if error.size else 0.0


def trimmed_rms(error: Array) -> Array:
    """Rms (...) of errors (..., rows) without the largest: an outlier is a finding on the noise."""
    rows = error.shape[-1]
    count = max(rows - round(TRIMMED * rows), min(rows, 1))
    return np.sqrt(np.mean(np.sort(error**2, axis=-1)[..., :count], axis=-1))


def _reduction(
    group: Ints, before: Array, after: Array, rng: np.random.Generator
) -> tuple[float, float]:
    """The 90 % interval over groups of 1 − after / before."""
    if not group.size or np.allclose(before, after):
        return 0.0, 0.0
    number = np.unique(group, return_inverse=True)[1]
    one, two = (np.bincount(number, weights=each**2) for each in (before, after))
    pick = rng.integers(one.size, size=(RESAMPLED, one.size))
    ratio = 1 - np.sqrt(two[pick].sum(axis=1) / np.maximum(one[pick].sum(axis=1), 1e-300))
    low, high = np.quantile(ratio, [0.05, 0.95])
    return float(low), float(high)


def _drawn(held: Sample, final: Posterior, rng: np.random.Generator) -> Array:
    """Predictions (points, nodes, rows) at draws of the parameters."""
    pick = rng.choice(final.weights.size, size=POINTS, p=final.weights)
    return held.predict(final.fitted.model, final.theta[pick])


def _shares(final: Posterior, held: Sample) -> dict[int, float]:
    """How probable each noise of the held-out rows is, by its number: as probable as the fitted one
    that it is alike. Who has fitted no outlier does not know that there is none."""
    shares = final.fitted.shares
    out: dict[int, float] = {}
    for which in np.flatnonzero(shares > LEAST_SHARE):
        alike = final.noises.alike(int(which), held.noises)
        out[alike] = out.get(alike, 0.0) + float(shares[which])
    return out


def _group_scores(
    held: Sample, final: Posterior, predicted: Array, shares: dict[int, float]
) -> Array:
    """Log predictive densities (groups,) of the values, averaged over parameters and noises."""
    weights = np.log(np.asarray(final.fitted.model.weights))[:, None]
    logs = []
    for noise, share in shares.items():
        scale, shape = held.noises.scale[noise], int(held.noises.shape[noise])
        density = log_density_at((held.values - predicted) / scale, shape) - np.log(scale)
        by_group = np.add.reduceat(density, held.starts[:-1], axis=-1)
        logs.append(logsumexp(by_group + weights, axis=(0, 1)) + np.log(share))
    return np.asarray(logsumexp(logs, axis=0) - np.log(predicted.shape[0]))


def _draws(
    held: Sample,
    final: Posterior,
    predicted: Array,
    shares: dict[int, float],
    rng: np.random.Generator,
) -> Array:
    """Predictive draws (draws, rows): parameters, each group's chance, and noise."""
    weights = np.asarray(final.fitted.model.weights)
    point = rng.integers(predicted.shape[0], size=DRAWS)
    node = rng.choice(weights.size, size=(DRAWS, held.starts.size - 1), p=weights / weights.sum())
    mean = predicted[point[:, None], node[:, held.group], np.arange(held.values.size)[None]]
    likely = np.array(list(shares.values()))
    noise = rng.choice(np.array(list(shares)), size=DRAWS, p=likely / likely.sum())
    return np.asarray(mean + held.noises.draw(noise, rng))
