"""A closed loop and its rows: measured, predicted before and after, held out or not."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...solver.arrays import Array
from ...solver.effects.library import EFFECTS
from ..data.datasets import Manifest
from ..inputs.study_fields import LoopInputs
from ..loop.finding import Finding
from ..loop.problem import Problem
from ..loop.residuals import quantile_residuals
from .confirm import Confirmation


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
class Closed:
    """A loop that ran: what was asked, what was found in the data, and in 3-D."""

    manifest: Manifest
    inputs: LoopInputs
    finding: Finding
    confirmation: Confirmation

    @property
    def problem(self) -> Problem:
        """The data as they were fitted: their errors need not be those that were declared."""
        return self.finding.problem

    @property
    def warnings(self) -> list[str]:
        """All that deserves doubt, in sentences."""
        held = self.finding.held_out
        return [*self.finding.all_warnings(), *self.confirmation.doubts(held)]

    @cached_property
    def held(self) -> NDArray[np.bool_]:
        held = self.finding.held_out
        groups = held.groups if held is not None else ()
        return np.isin(self.problem.group, groups)

    @cached_property
    def _predicted(self) -> list[tuple[Array, Array]]:
        """Weights (nodes,) and whitened predictions (nodes, rows): first the fitted baseline's,
        last the reported model's."""
        finding = self.finding
        fitted = [(self.problem.baseline, np.array(finding.evidences[0].theta))]
        if finding.model.effects:
            fitted.append((finding.model, finding.theta))
        return [(np.asarray(model.weights), model.predict(theta)) for model, theta in fitted]

    @cached_property
    def means(self) -> tuple[Array, Array]:
        """Predictions (rows,) of the fitted baseline and of the reported model, whitened, their
        means over chance."""
        several = [np.asarray(weights @ predicted) for weights, predicted in self._predicted]
        return several[0], several[-1]

    @cached_property
    def unit(self) -> Array:
        """What takes whitened residuals (rows,) to σ where that is estimated, else one."""
        finding, problem = self.finding, self.problem
        unit = np.ones(len(problem.values))
        if problem.sigma_declared:
            return unit
        own = (problem.values - self.means[0])[finding.rows]
        for name in np.unique(problem.quantity):
            mine = (problem.quantity[finding.rows] == name) & (np.abs(own) > 1e-9)
            if mine.any():
                ratio = np.median(finding.residual_before[mine] / own[mine])
                unit[problem.quantity == name] = ratio
        return unit

    @cached_property
    def left(self) -> tuple[Array, Array]:
        """What the baseline and the reported model leave of each value (rows,), in standard
        deviations: `quantile_residuals` of each row by itself."""
        values, alone = self.problem.values * self.unit, np.arange(len(self.unit) + 1)
        several = [
            quantile_residuals(values, predicted * self.unit, weights, alone)
            for weights, predicted in self._predicted
        ]
        return several[0], several[-1]

    def measured(self, whitened: Array) -> Array:
        """Values (rows,) in the problem's unit; of the main quantity only."""
        return np.asarray(whitened * self.problem.scale)

    @property
    def covariates(self) -> list[tuple[Covariate, Array]]:
        """Covariates in their display units, (rows,) each."""
        found: list[tuple[Covariate, Array]] = []
        for name, values in self.problem.covariates.items():
            covariate = COVARIATES.get(name, Covariate(name, name.replace("_", " ")))
            found.append((covariate, covariate.factor * np.asarray(values, dtype=float)))
        return found


def title_of(name: str) -> str:
    """An effect in words."""
    return EFFECTS[name].title if name in EFFECTS else name.replace("_", " ")


def names_of(effects: tuple[str, ...] | list[str]) -> str:
    """Several effects in words."""
    return " and ".join(map(title_of, effects)) or "the baseline alone"
