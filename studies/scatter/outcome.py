"""Records of many drops: how each was released, over what, and what it gave."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...solver.arrays import Array
from ...solver.batch import Outcome
from .conditions import Conditions, Local

COLUMNS = (
    "drop", "y0_m", "tilt_deg", "tilt_wide_deg", "x_m", "y_m", "turn_deg",
    "slope_deg", "slope_wide_deg", "lean_deg", "rise_std_m", "stiffness_scale",
    "rebound_ratio", "cm_rebound_ratio", *Outcome._fields,
)  # fmt: skip


@dataclass(frozen=True)
class Check:
    """Drops that were computed twice: how far the reduced body may be off, in impact speeds (None
    for a body that leaves nothing out), and by how much the two ways differ in y1/y0."""

    n: int
    reduction_error: float | None
    difference: float


@dataclass(frozen=True)
class Scatter:
    """All drops that were computed: how they were released, over what, and what they gave.

    ``failed`` tells of those that are left out, by number.
    """

    released: Conditions
    local: Local
    outcome: Outcome
    failed: dict[int, str]

    @property
    def ratio(self) -> Array:
        """y1/y0 of the lower tip (n,)."""
        return np.asarray(self.outcome.rebound_height_m / self.released.height_m)


def rows(found: Scatter) -> list[list[float]]:
    """A row a drop, under `COLUMNS`."""
    released, local, outcome = found.released, found.local, found.outcome
    columns = (
        *vars(released).values(),
        *vars(local).values(),
        found.ratio,
        outcome.cm_rebound_height_m / released.height_m,
        *outcome,
    )
    whole = {COLUMNS.index(name) for name in ("drop", "n_contacts", "n_steps")}
    as_lists = [
        column.astype(int).tolist() if i in whole else column.tolist()
        for i, column in enumerate(map(np.asarray, columns))
    ]
    return [list(row) for row in zip(*as_lists, strict=True)]
