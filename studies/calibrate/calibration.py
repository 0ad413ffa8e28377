"""The contact stiffness that measured rebounds ask for, with its intervals."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...solver import paper
from ...solver.arrays import Array
from ...solver.bristle import Bristle
from ..data.datasets import Drops
from .curve import GRID_N_M, RatioCurve, RatioModel, beam_model, mean_curve
from .estimate import LEVEL, Interval, RatioEstimate, estimate_ratio, paper_ratio

PAPER = "paper"
CONFOUNDED = (
    "y1/y0 of a bristle is one number. Contact stiffness, damping in the contact, damping in the "
    "material, lean and friction all change it, and it cannot tell them apart.",
    "The Kn given here is the one that the model needs if the declared material damping is right "
    "and the contact itself loses nothing. Measure contact time or force as well to separate them.",
)


@dataclass(frozen=True)
class Stiffness:
    """Kn in N/m with its bounds; a bound of None is one that the ratio cannot set."""

    estimate: float | None
    low: float | None
    high: float | None
    level: float

    def words(self) -> str:
        """The interval as a sentence's part, in MN/m."""
        low, high = (None if x is None else f"{x / 1e6:.3g}" for x in (self.low, self.high))
        if low and high:
            return f"{low} to {high} MN/m"
        if high:
            return f"below {high} MN/m, with no lower bound"
        if low:
            return f"above {low} MN/m, with no upper bound"
        return "not bounded on either side"


@dataclass(frozen=True)
class Calibration:
    """What came of a calibration.

    ``population`` is the band of Kn that single drops ask for, from the ``ratio``'s percentiles;
    ``warnings`` are sentences for the user.
    """

    source: str
    bristle: Bristle
    gravity_m_s2: float
    drops: Drops | None
    ratio: RatioEstimate
    curve: RatioCurve
    kn: Stiffness
    kn_bootstrap: Stiffness | None
    population: Stiffness
    warnings: tuple[str, ...]
    seed: int


def stiffness_interval(curve: RatioCurve, ratio: Interval) -> Stiffness:
    """Kn of a ratio and its interval; the curve falls, so the ends change places."""
    ends = map(curve.stiffness, (ratio.estimate, ratio.high, ratio.low))
    estimate, low, high = (kn if 0.0 < kn < math.inf else None for kn in ends)
    return Stiffness(estimate, low, high, ratio.level)


def calibrate(
    source: Drops | None,
    model: RatioModel | None = None,
    *,
    seed: int = 0,
    level: float = LEVEL,
    grid_N_m: Array = GRID_N_M,
) -> Calibration:
    """Calibrate Kn from ``source``, or from the paper's published summary where it is None.

    ``model`` maps Kn (N/m) and height (m) to y1/y0; by default the beam. Raises ComputationError
    where the model's ratio does not fall with Kn.
    """
    if source is None:
        bristle, gravity = Bristle(), paper.GRAVITY_M_S2
        ratio, heights = paper_ratio(level), np.array(paper.HEIGHTS_M)
    else:
        bristle, gravity = source.manifest.bristle, source.manifest.gravity_m_s2
        ratio = estimate_ratio(source.y0_m, source.y1_m, source.sigma_y_m, seed, level)
        heights = source.y0_m
    curve = mean_curve(model or beam_model(bristle, gravity), heights, grid_N_m)
    kn = stiffness_interval(curve, ratio.mean)
    boot = None if ratio.bootstrap is None else stiffness_interval(curve, ratio.bootstrap)
    return Calibration(
        source=PAPER if source is None else str(source.manifest.folder),
        bristle=bristle,
        gravity_m_s2=gravity,
        drops=source,
        ratio=ratio,
        curve=curve,
        kn=kn,
        kn_bootstrap=boot,
        population=stiffness_interval(curve, ratio.population),
        warnings=tuple(_warnings(source, ratio, curve)),
        seed=seed,
    )


def _warnings(source: Drops | None, ratio: RatioEstimate, curve: RatioCurve) -> list[str]:
    low, high = curve.reachable
    doubts = [source.doubt] if source is not None and source.doubt else []
    if ratio.mean.low >= high:
        doubts.append(
            f"The drops return {ratio.mean.estimate:.3g} of their height, more than the model does "
            f"at any Kn ({high:.4f}): none explains them."
        )
    elif ratio.mean.estimate >= high:
        doubts.append(
            f"The drops return {ratio.mean.estimate:.3g} of their height, no less than the model "
            f"does at any Kn ({high:.4f}): they bound Kn from above only."
        )
    if ratio.mean.estimate <= low:
        doubts.append(
            f"The drops return {ratio.mean.estimate:.3g} of their height, no more than the model "
            f"does on a rigid plane ({low:.4f}): they bound Kn from below only, and something "
            "that the model lacks takes energy."
        )
    if ratio.population.low <= low < ratio.mean.estimate:
        doubts.append(
            f"Single drops fall below what a rigid plane gives ({low:.4f}); no Kn explains them."
        )
    if ratio.trend is not None and ratio.trend.p_value < 0.05:
        doubts.append(
            f"y1/y0 changes with y0 (p = {ratio.trend.p_value:.2g}). In this model it does not: "
            "something is missing from it, and Kn takes up what that something does."
        )
    if ratio.sigma_share is not None and ratio.sigma_share < 0.5:
        doubts.append(
            f"The declared uncertainty of a height explains {100 * ratio.sigma_share:.2g} % of the "
            "scatter; the rest is between drops."
        )
    if source is not None and source.manifest.kn_N_m is not None:
        doubts.append(
            f"The dataset declares Kn = {source.manifest.kn_N_m / 1e6:.4g} MN/m; it was not used."
        )
    return [*doubts, *CONFOUNDED]
