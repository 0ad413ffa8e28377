"""Statistics of many predicted drops: spread, its causes, and whether the measurement is usual.

Statistics alone: nothing here knows of a model.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from ...solver import paper
from ...solver.arrays import Array
from ..calibrate.estimate import LEVEL, Interval, tails, through_origin

RESAMPLED, RESAMPLED_SHARES = 1000, 200
SAMPLES = 10_000
# Bins of equal count for a factor's conditional means; each has at least so many drops.
BINS, IN_A_BIN = 20, 10
PERCENTILES = (5.0, 50.0, 95.0)
# A standard deviation below this is rounding.
SAME = 1e-9


@dataclass(frozen=True)
class Spread:
    """The distribution of y1/y0 over ``n`` drops, each number with its interval."""

    n: int
    mean: Interval
    std: Interval
    percentiles: tuple[Interval, ...]
    in_band: Interval
    skewness: float | None
    above_one: float


def spread(ratio: Array, random: np.random.Generator, level: float = LEVEL) -> Spread:
    """The distribution of ``ratio`` (n,).

    The mean's interval is Student's, the standard deviation's the bootstrap's percentiles, a
    percentile's between two drops in order (binomial), a share's Wilson's.
    """
    n = len(ratio)
    same = n < 2 or float(np.std(ratio)) < SAME
    centre = float(np.mean(ratio))
    mean, std = Interval(centre, centre, centre, level), Interval(0.0, 0.0, 0.0, level)
    if not same:
        ends = stats.ttest_1samp(ratio, 0.0).confidence_interval(level)
        mean = Interval(centre, float(ends.low), float(ends.high), level)
        resampled = [np.std(random.choice(ratio, n), ddof=1) for _ in range(RESAMPLED)]
        std = Interval(float(np.std(ratio, ddof=1)), *tails(np.array(resampled), level), level)
    low, high = paper.RATIO_BAND_90
    inside = int(np.sum((ratio >= low) & (ratio <= high)))
    return Spread(
        n=n,
        mean=mean,
        std=std,
        percentiles=tuple(percentile_interval(ratio, p, level) for p in PERCENTILES),
        in_band=share_interval(inside, n, level),
        skewness=None if same else float(stats.skew(ratio)),
        above_one=float(np.mean(ratio > 1.0)),
    )


def percentile_interval(values: Array, percent: float, level: float = LEVEL) -> Interval:
    """A percentile, and the two drops in order between which it lies at ``level`` or more.

    An end is infinite where there are too few drops to bound it.
    """
    estimate = float(np.percentile(values, percent))
    found = stats.quantile_test(values, q=estimate, p=percent / 100.0).confidence_interval(level)
    low, high = (float(end) for end in found)
    return Interval(
        estimate,
        -math.inf if math.isnan(low) else low,
        math.inf if math.isnan(high) else high,
        level,
    )


def share_interval(count: int, n: int, level: float = LEVEL) -> Interval:
    """``count`` of ``n`` with Wilson's interval (J. Am. Stat. Assoc. 22, 1927)."""
    found = stats.binomtest(count, n).proportion_ci(level, method="wilson")
    return Interval(count / n, float(found.low), float(found.high), level)


def shares(
    ratio: Array, factors: Mapping[str, Array], random: np.random.Generator
) -> dict[str, dict[str, Any]]:
    """What each factor (n,) has to do with ``ratio`` (n,), as it stands in the JSON.

    ``first_order`` is the part of the variance of y1/y0 that goes with the input: the variance of
    its conditional mean (first-order index of Sobol'). ``correlation`` is Spearman's, with the
    input's size where its sign means a direction. Shares of dependent factors overlap, and what
    factors do together is in none of them.
    """
    found = {}
    for name, factor in factors.items():
        part = first_order(ratio, factor, random)
        found[name] = {
            "name": name,
            "first_order": part and asdict(part),
            "correlation": _rank_correlation(ratio, factor),
        }
    return found


def first_order(ratio: Array, factor: Array, random: np.random.Generator) -> Interval | None:
    """Part of the variance that the means within bins of equal count explain, None without bins.

    Of the variance within bins and in all, each by its degrees of freedom (Kelley's ε², Proc. Natl.
    Acad. Sci. 21, 1935), so that a factor without effect gives 0 on average; the interval is
    normal with the bootstrap's standard error.
    """
    levels = np.unique(factor)
    if len(levels) < 2 or float(np.std(ratio)) < SAME or len(ratio) < 2 * IN_A_BIN:
        return None
    if len(levels) <= min(BINS, len(ratio) // 2):
        bins = np.searchsorted(levels, factor)
    else:
        count = min(BINS, len(ratio) // IN_A_BIN)
        bins = np.argsort(np.argsort(factor, kind="stable")) * count // len(factor)
    estimate, n = _explained(ratio, bins), len(ratio)
    picks = (random.integers(0, n, n) for _ in range(RESAMPLED_SHARES))
    error = np.std([_explained(ratio[pick], bins[pick]) for pick in picks])
    half = float(stats.norm.ppf(0.5 + 0.5 * LEVEL) * error)
    return Interval(estimate, estimate - half, estimate + half, LEVEL)


def _explained(ratio: Array, bins: NDArray[np.intp]) -> float:
    count = np.bincount(bins)
    means = np.bincount(bins, ratio) / np.maximum(count, 1)
    within = float(np.sum((ratio - means[bins]) ** 2)) / (len(ratio) - np.count_nonzero(count))
    return 1.0 - within / float(np.var(ratio, ddof=1))


def _rank_correlation(ratio: Array, factor: Array) -> float | None:
    if len(ratio) < 3 or float(np.std(ratio)) < SAME or np.ptp(factor) == 0.0:
        return None
    signed = factor.min() < 0.0 < factor.max()
    return float(stats.spearmanr(ratio, np.abs(factor) if signed else factor).statistic)


def r_squared(y0_m: Array, y1_m: Array) -> Array:
    """R² of y1 = a y0 about the mean of y1, along the last axis; NaN where all y1 are the same."""
    slope = through_origin(y0_m, y1_m)
    residual = np.sum((y1_m - slope[..., None] * y0_m) ** 2, axis=-1)
    about = np.sum((y1_m - y1_m.mean(axis=-1, keepdims=True)) ** 2, axis=-1)
    about = np.where(about > SAME**2 * np.sum(y1_m**2, axis=-1), about, np.nan)
    return np.asarray(1.0 - residual / about)


def sampled(y0_m: Array, y1_m: Array, random: np.random.Generator) -> pd.DataFrame:
    """Mean, spread, slope and R² of samples of the paper's size, drawn from the drops (n,).

    With replacement: the drops stand for all that could be. A row a statistic: how it is
    distributed, and where the ``measured`` value falls. ``p_value`` is two-sided, twice the smaller
    tail, and no less than the number of samples can show.
    """
    pick = random.integers(0, len(y0_m), (SAMPLES, paper.N_DROPS))
    before, after = y0_m[pick], y1_m[pick]
    ratio = after / before
    return pd.DataFrame(
        _beside(name, measured, values[np.isfinite(values)])
        for name, measured, values in (
            ("mean", paper.RATIO_MEAN, ratio.mean(axis=1)),
            ("std", paper.RATIO_STD, ratio.std(axis=1, ddof=1)),
            ("slope", paper.RATIO_MEAN, through_origin(before, after)),
            ("r_squared", paper.R2_LINEAR, r_squared(before, after)),
        )
    )


def _beside(name: str, measured: float, values: Array) -> dict[str, Any]:
    """The row of `sampled` for the ``values`` of one statistic; NaN where there are none."""
    mean = std = low = high = below = p_value = math.nan
    if len(values):
        mean, std = float(values.mean()), float(values.std())
        low, high = tails(values, LEVEL)
        # the measured value is one more of its kind; half of what ties counts to either side
        less = np.sum(values < measured) + 0.5 * np.sum(values == measured)
        below = float(less + 0.5) / (len(values) + 1)
        p_value = min(1.0, 2.0 * min(below, 1.0 - below))
    return {
        "name": name,
        "measured": measured,
        "mean": mean,
        "std": std,
        "low": low,
        "high": high,
        "below": below,
        "p_value": p_value,
    }
