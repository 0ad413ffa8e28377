"""The scatter of values about a smooth course, against the errors that were declared."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.stats import rankdata

from ...solver.arrays import Array
from .noise import MOST_SCALE, Ints
from .problem import Problem
from .sample import BETWEEN, HEIGHT, WITHIN, first_of, sample
from .search import fit_baseline

# The relative error of Qn from n values over their root; 82 % efficient for normal ones (P. J.
# Rousseeuw and C. Croux, J. Am. Stat. Assoc. 88 (1993) 1273).
SCALE_ERROR = 0.78
# Standard errors by which a scale is off that is said to be wrong (one time in a thousand by
# chance), and those of a 90 % interval.
SURE, LEVEL = 3.3, 1.645
# Over that of values, the relative error of a scale that the differences of neighbours tell (J. von
# Neumann, Ann. Math. Stat. 12 (1941) 367, whose ratio of ranks tells whether neighbours are alike:
# R. Bartels, J. Am. Stat. Assoc. 77 (1982) 40).
BY_NEIGHBOURS = math.sqrt(1.5)
# Decades up and down within which errors may be declared wrongly, all factors being as likely.
WRONG_DECADES = 1.0
# Values for each term of the smooth course.
ENOUGH = 3
# Powers of height and order: what wears changes in proportion to the height.
TERMS = ((0, 0), (1, 0), (2, 0), (3, 0), (0, 1), (1, 1), (0, 2), (1, 2))
# A share of the declared errors: where values scatter by less, those are no measure of the noise.
FAR_SMALLER = 0.5


@dataclass(frozen=True)
class Scatter:
    """How far values of a quantity scatter about what is smooth in height and order.

    ``ratio`` is that over what their declared errors make, which is ``declared`` in the quantity's
    unit, ``error`` the relative standard error of either; ``near`` is the ratio by which values
    scatter at least, whatever drifts there are, ``whole`` that of their standard deviation, tails
    included.
    """

    quantity: str
    ratio: float
    error: float
    declared: float
    near: float
    whole: float

    @classmethod
    def each(cls, problem: Problem) -> list[Self]:
        """Those of a problem's quantities with values enough; none where nothing is declared."""
        records = first_of(problem.covariates, WITHIN) is not None
        if not problem.sigma_declared or problem.with_sigma is None or records:
            return []
        fitted = fit_baseline(sample(problem, np.unique(problem.group)), problem.baseline)
        model = problem.baseline
        mean = np.asarray(model.weights) @ np.asarray(model.predict(fitted.theta))
        none = np.zeros(problem.values.size)
        along = [first_of(problem.covariates, names, none) for names in (HEIGHT, BETWEEN)]
        found = []
        for name in dict.fromkeys(problem.quantity):
            mine = np.flatnonzero(problem.quantity == name)
            x = [_unit(np.asarray(each)[mine]) for each in along]
            one = cls._of(str(name), problem, mine, (problem.values - mean)[mine], x)
            found += [one] if one is not None else []
        return found

    @classmethod
    def _of(
        cls, name: str, problem: Problem, mine: Ints, left: Array, x: Sequence[Array]
    ) -> Self | None:
        """That of the quantity in the rows ``mine``, of which ``left`` is left; over height and
        order ``x``, from −1 to 1."""
        course = np.stack([x[0] ** i * x[1] ** j for i, j in TERMS], axis=1)
        rank = int(np.linalg.matrix_rank(course))
        if mine.size < ENOUGH * rank:
            return None
        left = left - course @ np.linalg.lstsq(course, left)[0]
        from statsmodels.robust.scale import qn_scale  # slow to import

        ratio = float(qn_scale(left)) * math.sqrt(mine.size / (mine.size - rank))
        error = SCALE_ERROR / math.sqrt(mine.size - rank)
        near = ratio / (1.0 + SURE * error)
        for each in x:
            row = left[np.argsort(each, kind="stable")]
            if np.ptp(each) and _alike(row):
                apart = float(qn_scale(np.diff(row))) / math.sqrt(2.0)
                near = min(near, apart / (1.0 + SURE * BY_NEIGHBOURS * error))
        declared = float(np.median(problem.scale[mine]))
        # what is read to the same mark scatters by no less than rounding does
        steps = np.diff(np.unique(np.round(problem.values[mine] * problem.scale[mine], 9)))
        if not steps.size:
            return None
        ratio = max(ratio, float(steps.min()) / math.sqrt(12.0) / declared)
        whole = float(np.sqrt(np.sum(left**2) / (mine.size - rank)))
        return cls(name, ratio, error, declared, near, whole)

    @property
    def cost(self) -> float:
        """Nats that it costs to have the errors' size told by the data: the logarithm of the range
        of what they might be over what the data leave of it."""
        wide = 2.0 * WRONG_DECADES * math.log(10.0)
        return max(math.log(wide / (math.sqrt(2.0 * math.pi) * self.error)), 0.0)

    @property
    def far_smaller(self) -> bool:
        """Whether it is less than half of what was declared, beyond doubt. Tails are part of that:
        most of what has them scatters by less."""
        small = max(self.ratio, self.whole) < FAR_SMALLER
        return small and self.ratio * (1.0 + SURE * self.error) < 1.0

    @property
    def larger(self) -> bool:
        """Whether it is more than noise of the declared size may have, beyond doubt. A drift, or a
        wave, is no scatter: where neighbours are alike, their differences have to be as well."""
        return self.near > MOST_SCALE

    def would_be(self) -> str:
        """The error bars' being wrong, as the subject of a sentence."""
        times = max(self.ratio, 1.0 / self.ratio)
        size = "small" if self.ratio > 1.0 else "large"
        return f"error bars of {self.quantity} that are {times:.2g} times too {size}"

    def words(self) -> str:
        """A sentence."""
        times = max(self.ratio, 1.0 / self.ratio)
        low, high = times / (1.0 + LEVEL * self.error), times * (1.0 + LEVEL * self.error)
        size = "small" if self.ratio > 1.0 else "large"
        own = self.ratio * self.declared
        return (
            f"your error bars are {times:.2g} times too {size} ({low:.2g} to {high:.2g}): "
            f"{self.quantity} scatters by {own:.2g} about a smooth curve over height and order, "
            "but the declared errors, with that of the height before, would make "
            f"{self.declared:.2g}. The loop uses {own:.2g}"
        )


def _alike(left: Array) -> bool:
    """Whether neighbours among values (n,) are alike, beyond doubt."""
    if np.ptp(left) == 0.0:
        return False
    ranks = rankdata(left)
    ratio = float(np.sum(np.diff(ranks) ** 2) / np.sum((ranks - ranks.mean()) ** 2))
    return (2.0 - ratio) * math.sqrt(left.size) > 2.0 * SURE


def _unit(x: Array) -> Array:
    """Values from −1 to 1; zeros where they are all the same."""
    spread = float(np.ptp(x))
    return 2.0 * (x - x.min()) / spread - 1.0 if spread > 0.0 else np.zeros_like(x)
