"""The scatter of values about a smooth course, against the errors that were declared."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from ...solver.arrays import Array
from .noise import MOST_SCALE
from .problem import Problem
from .sample import BETWEEN, HEIGHT, WITHIN, first_of, sample
from .search import fit_baseline

# The relative error of Qn from n values over their root; 82 % efficient for normal ones (P. J.
# Rousseeuw and C. Croux, J. Am. Stat. Assoc. 88 (1993) 1273).
SCALE_ERROR = 0.78
# Standard errors by which a scale is off that is said to be wrong (one time in a thousand by
# chance), and those of a 90 % interval.
SURE, LEVEL = 3.3, 1.645
# Values for each term of the smooth course.
ENOUGH = 3
# Powers of height and order: what wears changes in proportion to the height.
TERMS = ((0, 0), (1, 0), (2, 0), (3, 0), (0, 1), (1, 1), (0, 2), (1, 2))
# A share of the declared errors: where values scatter by less, those are no measure of the noise.
FAR_SMALLER = 0.5


@dataclass(frozen=True)
class Scatter:
    """How far values of the main quantity scatter about what is smooth in height and order.

    ``ratio`` is that over what their declared errors make, which is ``declared`` in the problem's
    unit, ``error`` the relative standard error of either.
    """

    quantity: str
    ratio: float
    error: float
    declared: float

    @classmethod
    def of(cls, problem: Problem) -> Self | None:
        """That of a problem; None where nothing is declared, or values are too few."""
        mine = np.flatnonzero(problem.is_main)
        records = first_of(problem.covariates, WITHIN) is not None
        if not problem.sigma_declared or problem.with_sigma is None or records:
            return None
        model = problem.baseline
        fitted = fit_baseline(sample(problem, np.unique(problem.group)), model)
        mean = np.asarray(model.weights) @ np.asarray(model.predict(fitted.theta))
        x = [
            _unit(np.asarray(each)[mine]) if each is not None else np.zeros(mine.size)
            for each in (first_of(problem.covariates, names) for names in (HEIGHT, BETWEEN))
        ]
        course = np.stack([x[0] ** i * x[1] ** j for i, j in TERMS], axis=1)
        rank = int(np.linalg.matrix_rank(course))
        if mine.size < ENOUGH * rank:
            return None
        left = (problem.values - mean)[mine]
        left = left - course @ np.linalg.lstsq(course, left)[0]
        from statsmodels.robust.scale import qn_scale  # slow to import

        ratio = float(qn_scale(left)) * math.sqrt(mine.size / (mine.size - rank))
        declared = float(np.median(problem.scale[mine]))
        # what is read to the same mark scatters by no less than rounding does
        steps = np.diff(np.unique(np.round(problem.values[mine] * problem.scale[mine], 9)))
        if not steps.size:
            return None
        ratio = max(ratio, float(steps.min()) / math.sqrt(12.0) / declared)
        return cls(problem.main, ratio, SCALE_ERROR / math.sqrt(mine.size - rank), declared)

    @property
    def far_smaller(self) -> bool:
        """Whether it is less than half of what was declared, beyond doubt."""
        return self.ratio < FAR_SMALLER and self.ratio * (1.0 + SURE * self.error) < 1.0

    @property
    def larger(self) -> bool:
        """Whether it is more than noise of the declared size may have, beyond doubt."""
        return self.ratio / (1.0 + SURE * self.error) > MOST_SCALE

    def words(self) -> str:
        """A sentence."""
        times = max(self.ratio, 1.0 / self.ratio)
        low, high = times / (1.0 + LEVEL * self.error), times * (1.0 + LEVEL * self.error)
        size = "small" if self.ratio > 1.0 else "large"
        own = self.ratio * self.declared
        return (
            f"your error bars are {times:.2g} times too {size} ({low:.2g} to {high:.2g}): "
            f"{self.quantity} scatters by {own:.2g} about a smooth curve over height and order, "
            f"but the declared errors are {self.declared:.2g}; {own:.2g} is used"
        )


def _unit(x: Array) -> Array:
    """Values from −1 to 1; zeros where they are all the same."""
    spread = float(np.ptp(x))
    return 2.0 * (x - x.min()) / spread - 1.0 if spread > 0.0 else np.zeros_like(x)
