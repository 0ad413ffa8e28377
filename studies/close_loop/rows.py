"""Rows of a closed loop: measured, predicted before and after, held out or not."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr, logsumexp, ndtri_exp

from ...solver.arrays import Array
from ...solver.effects.library import EFFECTS
from ..loop.problem import Model

if TYPE_CHECKING:
    from .run import Closed


@dataclass(frozen=True)
class Covariate:
    """What residuals are looked at against: its label, unit and the factor from SI to it."""

    name: str
    label: str
    unit: str = ""
    factor: float = 1.0

    @property
    def words(self) -> str:
        return f"{self.label} ({self.unit})" if self.unit else self.label


COVARIATES = {
    each.name: each
    for each in (
        Covariate("height", "height before the impact", "mm", 1e3),
        Covariate("speed", "speed of impact", "m/s"),
        Covariate("order", "order of measurement"),
        Covariate("session", "session"),
        Covariate("time", "time", "s"),
        Covariate("frequency", "frequency", "kHz", 1e-3),
        Covariate("phase", "phase"),
    )
}
# Those that only number the measurements.
COUNTING = ("order", "session")


@dataclass(frozen=True)
class Rows:
    """All rows of a problem under the baseline and under the reported model."""

    closed: Closed

    @property
    def main(self) -> NDArray[np.bool_]:
        """Rows of the main quantity, the one that errors are told of."""
        quantity = self.closed.problem.quantity
        return np.asarray(quantity == quantity[0])

    @cached_property
    def held(self) -> NDArray[np.bool_]:
        held = self.closed.finding.held_out
        groups = held.groups if held is not None else ()
        return np.isin(self.closed.problem.group, groups)

    @cached_property
    def before(self) -> Array:
        """Mean predictions (rows,) of the fitted baseline, whitened."""
        return mean_of(self.closed.problem.baseline, self.closed.finding.evidences[0].theta)

    @cached_property
    def after(self) -> Array:
        """Mean predictions (rows,) of the reported model, whitened."""
        finding = self.closed.finding
        return mean_of(finding.model, finding.theta) if finding.model_effects else self.before

    @cached_property
    def unit(self) -> Array:
        """What takes whitened residuals (rows,) to σ where that is estimated, else one."""
        finding, problem = self.closed.finding, self.closed.problem
        unit = np.ones(len(problem.values))
        if problem.sigma_declared:
            return unit
        own = (problem.values - self.before)[finding.rows]
        for name in np.unique(problem.quantity):
            mine = (problem.quantity[finding.rows] == name) & (np.abs(own) > 1e-9)
            if mine.any():
                ratio = np.median(finding.residual_before[mine] / own[mine])
                unit[problem.quantity == name] = ratio
        return unit

    @cached_property
    def left_before(self) -> Array:
        """What the baseline leaves of each value (rows,), in standard deviations."""
        return self._left(self.closed.problem.baseline, self.closed.finding.evidences[0].theta)

    @cached_property
    def left_after(self) -> Array:
        """What the reported model leaves of each value (rows,), in standard deviations."""
        finding = self.closed.finding
        if not finding.model_effects:
            return self.left_before
        return self._left(finding.model, finding.theta)

    def _left(self, model: Model, theta: Array | tuple[float, ...]) -> Array:
        """Residuals (rows,) in standard deviations; where a model has chance in it, the normal
        quantile of the value among all that it predicts with that chance and noise."""
        predicted = np.asarray(model.predict(np.asarray(theta, dtype=float)))
        residual = (self.closed.problem.values - predicted) * self.unit
        if len(residual) == 1:
            return np.asarray(residual[0])
        weights = np.asarray(model.weights)[:, None]
        below = logsumexp(log_ndtr(residual), b=weights, axis=0)
        above = logsumexp(log_ndtr(-residual), b=weights, axis=0)
        return np.where(below < above, ndtri_exp(below), -ndtri_exp(above))

    def measured(self, whitened: Array) -> Array:
        """Values (rows,) in the problem's unit; of the main quantity only."""
        return np.asarray(whitened * self.closed.problem.scale)

    @property
    def covariates(self) -> list[tuple[Covariate, Array]]:
        """Covariates in their display units, (rows,) each."""
        found: list[tuple[Covariate, Array]] = []
        for name, values in self.closed.problem.covariates.items():
            covariate = COVARIATES.get(name, Covariate(name, name.replace("_", " ")))
            found.append((covariate, covariate.factor * np.asarray(values, dtype=float)))
        return found


def mean_of(model: Model, theta: Array | tuple[float, ...]) -> Array:
    """Mean of a model's predictions over chance, (rows,)."""
    return np.asarray(np.asarray(model.weights) @ model.predict(np.asarray(theta, dtype=float)))


def title_of(name: str) -> str:
    """An effect in words."""
    return EFFECTS[name].title if name in EFFECTS else name.replace("_", " ")


def names_of(effects: tuple[str, ...] | list[str]) -> str:
    """Several effects in words."""
    return " and ".join(map(title_of, effects)) or "the baseline alone"
