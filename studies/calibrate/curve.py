"""Kn of a measured y1/y0: the falling curve of a model of the bristle, and its inverse.

A model's ratio falls from one (soft contact: the bristle is rigid beside it) to its limit on a
rigid plane. Between, it is inverted; outside, a ratio bounds Kn from one side only.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

from ...solver.analytic import quarter_period_s
from ...solver.arrays import Array
from ...solver.bodies.beam import beam_body
from ...solver.bristle import Bristle
from ...solver.contact.enforcement import ContactMethod
from ...solver.contact.laws import Linear
from ...solver.drop import DropPlan, ModalFrame, simulate
from ...solver.errors import ComputationError
from ...solver.paper import ELEMENTS

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


def beam_model(bristle: Bristle, gravity_m_s2: float, elements: int = ELEMENTS) -> RatioModel:
    """y1/y0 of an upright beam in linear contact, in time steps short enough not to matter."""
    frame = ModalFrame(beam_body(bristle, elements, face=False))

    def ratio(kn_N_m: float, height_m: float) -> float:
        method = ContactMethod(Linear(kn_N_m))
        its = short_its_s(bristle.mass_kg, kn_N_m)
        plan = DropPlan(height_m, method, its, gravity_m_s2)
        return float(simulate(frame, plan).rebound_ratio or 0.0)

    return ratio


def short_its_s(mass_kg: float, kn_N_m: float) -> float:
    """A time step in which y1/y0 is converged to about 10⁻⁴."""
    return float(np.clip(quarter_period_s(mass_kg, kn_N_m) / STEPS_TO_PEAK, *ITS_RANGE_S))
