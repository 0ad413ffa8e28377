"""Held-out data predicted by the 3-D model with the effect switched on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...solver.arrays import Array
from ...solver.errors import BristleError
from ..loop.finding import Finding
from ..loop.heldout import HeldOut, rms
from ..loop.noise import Ints

LEFT_OUT = "left out on request (--no-3d)"
NOTHING_HELD = "too few groups to hold any out"
# How many times larger than the fitted model's the error of the 3-D model may be without a doubt.
FAR = 3.0


@dataclass(frozen=True)
class Solid:
    """Held-out values of the main quantity and what the 3-D model predicts of them, (rows,) in
    ``unit``; ``rows`` number them in the problem."""

    unit: str
    rows: Ints
    values: Array
    before: Array
    after: Array

    @property
    def rms_before(self) -> float:
        return rms(self.values - self.before)

    @property
    def rms_after(self) -> float:
        return rms(self.values - self.after)


@dataclass(frozen=True)
class Confirmation:
    """What the 3-D model says, or why it says nothing."""

    solid: Solid | None
    why: str | None = None

    def keys(self) -> dict[str, Any]:
        """``confirmed_in_3d`` and ``confirmed_in_3d_why`` of verdict.json."""
        names = ("rms_before", "rms_after", "unit")
        errors = self.solid and {name: getattr(self.solid, name) for name in names}
        return {"confirmed_in_3d": errors, "confirmed_in_3d_why": self.why}

    def doubts(self, held: HeldOut | None) -> list[str]:
        """That the 3-D model predicts the ``held`` data far worse than the fitted one, in words."""
        if self.solid is None or held is None:
            return []
        # few held-out data may lie nearer to the fitted model than their noise
        times = self.solid.rms_after / max(held.rms_after, held.sigma)
        if not times > FAR:
            return []
        return [
            f"the 3-D model predicts the held-out data {times:.2g} times worse than the model that "
            "was fitted; check the sizes and the material that are declared for the body"
        ]


def confirm(finding: Finding) -> Confirmation:
    """Baseline and reported model by `Problem.confirm` on the held-out groups.

    A 3-D model that cannot be made or that fails is an answer with its reason, not an error: the
    verdict stands without it.
    """
    problem = finding.problem
    if problem.confirm is None:
        return Confirmation(None, problem.confirm_why or "there is no 3-D model of such data")
    if finding.held_out is None:
        return Confirmation(None, NOTHING_HELD)
    groups = np.array(finding.held_out.groups, dtype=np.int64)
    rows = np.flatnonzero(np.isin(problem.group, groups))
    base = np.array(finding.evidences[0].theta)
    try:
        before = after = problem.confirm(problem.baseline, base, groups)
        if finding.model.effects:
            after = problem.confirm(finding.model, finding.theta, groups)
    except BristleError as error:
        return Confirmation(None, f"the 3-D model failed: {error}")
    main = problem.is_main[rows]
    scale = problem.scale[rows][main]
    several = (each[main] * scale for each in (problem.values[rows], before, after))
    return Confirmation(Solid(problem.unit, rows[main], *several))
