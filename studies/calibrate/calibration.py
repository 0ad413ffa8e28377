"""The contact stiffness that measured rebounds ask for, with its intervals.

A model's y1/y0 falls with Kn from one (soft contact: the bristle is rigid beside it) to its limit
on a rigid plane. Between, the curve is inverted; outside, a ratio bounds Kn from one side only.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

from ...solver import paper
from ...solver.analytic import quarter_period_s
from ...solver.arrays import Array
from ...solver.bodies.beam import beam_body
from ...solver.bristle import Bristle
from ...solver.contact.enforcement import ContactMethod
from ...solver.contact.laws import Linear
from ...solver.drop import DropPlan, ModalFrame, simulate
from ...solver.errors import ComputationError
from ..data.datasets import Drops
from .estimate import LEVEL, Interval, RatioEstimate, estimate_ratio, paper_ratio

PAPER = "paper"
CONFOUNDED = (
    "y1/y0 of a bristle is one number. Contact stiffness, damping in the contact, damping in the "
    "material, lean and friction all change it, and it cannot tell them apart."
)
NEEDED = (
    "The Kn given here is the one that the model needs if the material damping is right and the "
    "contact itself loses nothing."
)
GRID_N_M = np.concatenate([[1e3, 3e3], np.geomspace(1e4, 1e8, 33), [3e8, 1e9, 1e10]])
# Wobble of the computed ratio that is the time step's and not the bristle's.
WOBBLE = 2e-4
STEPS_TO_PEAK = 60
ITS_RANGE_S = (1e-7, 1e-5)

RatioModel = Callable[[float, float], float]


@dataclass(frozen=True)
class RatioCurve:
    """y1/y0 against Kn, falling: ``ratio`` (n,) at ``kn_N_m`` (n,), increasing."""

    kn_N_m: Array
    ratio: Array

    def __post_init__(self) -> None:
        rise = float(np.diff(self.ratio).max())
        if rise > WOBBLE:
            at = self.kn_N_m[int(np.argmax(np.diff(self.ratio)))]
            raise ComputationError(
                f"y1/y0 does not fall steadily with Kn (it rises by {rise:.3g} above "
                f"{at:.3g} N/m), so one ratio belongs to several Kn; this body is damped too "
                "weakly for y1/y0 to tell Kn: measure contact time or force"
            )

    @cached_property
    def _ratio_of(self) -> PchipInterpolator:
        falling = np.minimum.accumulate(self.ratio) - 1e-12 * np.arange(len(self.ratio))
        return PchipInterpolator(np.log(self.kn_N_m), falling)

    @property
    def reachable(self) -> tuple[float, float]:
        """The least and the greatest ratio that any Kn of the curve gives."""
        return float(self._ratio_of(math.log(self.kn_N_m[-1]))), float(self.ratio[0])

    def at(self, kn_N_m: float | Array) -> Array:
        """y1/y0 at ``kn_N_m``, which is held to the ends of the curve."""
        bounded = np.clip(kn_N_m, self.kn_N_m[0], self.kn_N_m[-1])
        return np.asarray(self._ratio_of(np.log(bounded)))

    def stiffness(self, ratio: float) -> float:
        """Kn in N/m; 0 above the reachable ratios and infinity below them (one-sided bounds)."""
        low, high = self.reachable
        if ratio >= high:
            return 0.0
        if ratio <= low:
            return math.inf
        ends = np.log(self.kn_N_m[[0, -1]])
        return math.exp(brentq(lambda x: float(self._ratio_of(x)) - ratio, *ends, xtol=1e-12))


def ratio_curve(model: RatioModel, height_m: float, grid_N_m: Array = GRID_N_M) -> RatioCurve:
    """The curve of ``model`` (Kn in N/m, height in m → y1/y0) at one height.

    Raises ComputationError where it does not fall with Kn.
    """
    grid = np.asarray(grid_N_m, float)
    return RatioCurve(grid, np.array([model(float(kn), height_m) for kn in grid]))


def mean_curve(model: RatioModel, y0_m: Array, grid_N_m: Array = GRID_N_M) -> RatioCurve:
    """The curve that a least-squares slope of y1 on y0 follows: Σ y0² r(Kn, y0) / Σ y0².

    The model is asked at the least and the greatest height alone: between, its ratio is linear
    in y0 far below the accuracy of a measurement (3·10⁻⁴ from 10 to 50 mm).
    """
    low, high = float(np.min(y0_m)), float(np.max(y0_m))
    first = ratio_curve(model, low, grid_N_m)
    if high == low:
        return first
    last = ratio_curve(model, high, grid_N_m)
    share = float(np.sum(y0_m**2 * (y0_m - low)) / np.sum(y0_m**2) / (high - low))
    return RatioCurve(first.kn_N_m, (1.0 - share) * first.ratio + share * last.ratio)


def beam_model(bristle: Bristle, gravity_m_s2: float) -> RatioModel:
    """y1/y0 of an upright beam in linear contact, in time steps short enough not to matter."""
    frame = ModalFrame(beam_body(bristle, paper.ELEMENTS, face=False))

    def ratio(kn_N_m: float, height_m: float) -> float:
        method = ContactMethod(Linear(kn_N_m))
        its = short_its_s(bristle.mass_kg, kn_N_m)
        plan = DropPlan(height_m, method, its, gravity_m_s2)
        return float(simulate(frame, plan).rebound_ratio or 0.0)

    return ratio


def short_its_s(mass_kg: float, kn_N_m: float) -> float:
    """A time step in which y1/y0 is converged to about 10⁻⁴."""
    return float(np.clip(quarter_period_s(mass_kg, kn_N_m) / STEPS_TO_PEAK, *ITS_RANGE_S))


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
            "unless this is chance, something is missing from it, and Kn takes up what that does."
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
    return [*doubts, *_left_out(source), CONFOUNDED, f"{NEEDED} {_to_separate(source)}"]


def _left_out(source: Drops | None) -> list[str]:
    """What of the body is the paper's because the dataset does not declare it."""
    if source is None:
        return []
    manifest = source.manifest
    doubts = [manifest.lengths_doubt] if manifest.lengths_doubt else []
    if not manifest.damping_declared:
        doubts.append(
            f"[body] does not give damping_beta_s; the {manifest.bristle.material.beta_s:.3g} s of "
            "the paper's steel bristle is used, and Kn may be many times too small or too large if "
            "this damping is wrong. Declare the damping, or let `bristle close-loop` fit it."
        )
    return doubts


def _to_separate(source: Drops | None) -> str:
    """How to tell apart what changes y1/y0."""
    if source is None or (source.contact_time_s is None and source.peak_force_N is None):
        return "Measure contact time or force as well to separate them."
    return "`bristle close-loop` also uses these columns, which separate most of them."
