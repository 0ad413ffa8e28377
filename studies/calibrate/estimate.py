"""The ratio y1/y0 of measured drops: estimate, intervals, and its trend with height.

Statistics alone: nothing here knows of a model or of Kn.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import statsmodels.api as sm
from scipy import stats

from ...solver import paper
from ...solver.arrays import Array

LEVEL = 0.90
RESAMPLES = 4999


@dataclass(frozen=True)
class Interval:
    """An estimate with the interval that holds it at ``level``."""

    estimate: float
    low: float
    high: float
    level: float = LEVEL


@dataclass(frozen=True)
class Trend:
    """Change of y1/y0 per metre of y0, its interval, and the p-value of there being none."""

    slope_1_m: Interval
    p_value: float


@dataclass(frozen=True)
class RatioEstimate:
    """What drops, or their published summary, say of y1/y0.

    ``mean`` is the least-squares slope of y1 on y0 through the origin with its t interval,
    ``bootstrap`` the same by resampling drops (None for a published summary), ``population`` the
    5th and 95th percentile of single drops around their median, ``spread`` their standard
    deviation. ``sigma_share`` is the part of the scatter's variance that the declared uncertainty
    of a height explains, or None where none is declared.
    """

    n: int
    mean: Interval
    bootstrap: Interval | None
    population: Interval
    spread: float
    trend: Trend | None
    sigma_share: float | None
    method: str


def estimate_ratio(
    y0_m: Array, y1_m: Array, sigma_m: float | None = None, seed: int = 0, level: float = LEVEL
) -> RatioEstimate:
    """Estimate y1/y0 from drops (n,), n of three or more.

    The interval is Student's with n - 1 degrees of freedom and the standard error HC3 (MacKinnon
    and White, J. Econometrics 29, 1985), which holds where the scatter grows with height, as it
    does when every drop has a ratio of its own; it is never narrower than the declared ``sigma_m``
    of a height (in y0 and y1) allows.
    """
    mean = slope_interval(y0_m, y1_m, sigma_m, level)
    ratios = y1_m / y0_m
    residual = y1_m - mean.estimate * y0_m
    scatter = float(residual @ residual) / (len(y0_m) - 1)
    share = None
    if sigma_m is not None:
        share = sigma_m**2 * (1.0 + mean.estimate**2) / scatter if scatter > 0.0 else math.inf
    return RatioEstimate(
        n=len(y0_m),
        mean=mean,
        bootstrap=bootstrap_interval(y0_m, y1_m, seed, level),
        population=Interval(float(np.median(ratios)), *tails(ratios, level), level),
        spread=float(np.std(ratios, ddof=1)),
        trend=height_trend(y0_m, y1_m, level),
        sigma_share=share,
        method="least squares through the origin, HC3 standard error, Student's t",
    )


def slope_interval(
    y0_m: Array, y1_m: Array, sigma_m: float | None = None, level: float = LEVEL
) -> Interval:
    """Slope of y1 on y0 through the origin and its interval."""
    fit = _fit(y0_m, y1_m, 1)
    slope, error = float(fit.params[0]), float(fit.bse[0])
    if sigma_m is not None:
        error = max(error, sigma_m * math.sqrt((1.0 + slope**2) / float(y0_m @ y0_m)))
    half = float(stats.t.ppf(0.5 + 0.5 * level, len(y0_m) - 1)) * error
    return Interval(slope, slope - half, slope + half, level)


def _fit(y0_m: Array, y1_m: Array, degree: int) -> Any:
    """Powers of y0 up to ``degree``, without a constant, fitted to y1; HC3 errors."""
    return sm.OLS(y1_m, y0_m[:, None] ** np.arange(1, degree + 1)).fit(cov_type="HC3", use_t=True)


def through_origin(y0_m: Array, y1_m: Array, axis: int = -1) -> Array:
    """The slope a of y1 = a y0 by least squares, along ``axis``."""
    return np.asarray(np.sum(y0_m * y1_m, axis=axis) / np.sum(y0_m * y0_m, axis=axis))


def tails(values: Array, level: float) -> tuple[float, float]:
    """The percentiles between which ``level`` of the values lie, as many on either side."""
    tail = 50.0 * (1.0 - level)
    low, high = np.percentile(values, [tail, 100.0 - tail])
    return float(low), float(high)


def bootstrap_interval(y0_m: Array, y1_m: Array, seed: int, level: float = LEVEL) -> Interval:
    """The slope's bias-corrected and accelerated bootstrap interval (Efron 1987), drop by drop."""
    centre = float(through_origin(y0_m, y1_m))
    if np.ptp(y1_m - centre * y0_m) <= 1e-12 * np.max(y0_m):
        return Interval(centre, centre, centre, level)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", stats.DegenerateDataWarning)
        found = stats.bootstrap(
            (y0_m, y1_m),
            through_origin,
            paired=True,
            confidence_level=level,
            n_resamples=RESAMPLES,
            method="BCa",
            rng=np.random.default_rng(seed),
        ).confidence_interval
    return Interval(centre, float(found.low), float(found.high), level)


def height_trend(y0_m: Array, y1_m: Array, level: float = LEVEL) -> Trend | None:
    """Does y1/y0 change with y0? The coefficient of y0² in y1 = a y0 + b y0², HC3 errors.

    None where fewer than four drops or a single height leave nothing to tell it from.
    """
    if len(y0_m) < 4 or np.ptp(y0_m) < 1e-3 * np.max(y0_m):
        return None
    fit = _fit(y0_m, y1_m, 2)
    if fit.ssr <= 1e-24 * float(y1_m @ y1_m):
        exact = float(fit.params[1])
        return Trend(Interval(exact, exact, exact, level), 1.0)
    low, high = fit.conf_int(alpha=1.0 - level)[1]
    return Trend(
        Interval(float(fit.params[1]), float(low), float(high), level), float(fit.pvalues[1])
    )


def paper_ratio(level: float = LEVEL) -> RatioEstimate:
    """The paper's summary: 26 drops, mean 0.65, standard deviation 0.21, 0.30 to 1.00 at 90 %."""
    n, mean, std = paper.N_DROPS, paper.RATIO_MEAN, paper.RATIO_STD
    half = float(stats.t.ppf(0.5 + 0.5 * level, n - 1)) * std / math.sqrt(n)
    return RatioEstimate(
        n=n,
        mean=Interval(mean, mean - half, mean + half, level),
        bootstrap=None,
        population=Interval(mean, *paper.RATIO_BAND_90, level),
        spread=std,
        trend=None,
        sigma_share=None,
        method="the published mean and standard deviation, Student's t",
    )
