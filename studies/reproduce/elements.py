"""The fewest beam elements for 1 % in rebound, contact time, force and penetration."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ...solver.arrays import Array
from ...solver.paper import ELEMENTS
from ..calibrate.curve import short_its_s
from ..inputs.config import DropInputs
from ..its.figures import error_figure
from ..report.page import Head, Section
from .campaign import GOAL, QUANTITIES, DropStudy, Labels, Results, prose

COUNTS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)
REFERENCE = 64
# What quantities are called in the tables' files.
KEYS = {"contact_time_us": "contact_time_s", "max_penetration_um": "max_penetration_m"}


def fewest(counts: tuple[int, ...], errors: Array, goal: float = GOAL) -> int | None:
    """The least count from which on every error is within ``goal``; None where there is none."""
    bad = np.flatnonzero(~(np.abs(errors) <= goal))
    if not len(bad):
        return counts[0]
    return counts[bad[-1] + 1] if bad[-1] + 1 < len(counts) else None


@dataclass(frozen=True)
class ElementStudy(DropStudy):
    """The beam in 1 to 32 elements against 64, in time steps short enough not to matter."""

    counts: tuple[int, ...] = COUNTS
    reference: int = REFERENCE

    def plan(self) -> Iterator[tuple[DropInputs, Labels]]:
        mass = self.setup.base.bristle().mass_kg
        for kn in self.setup.ends_N_m:
            its = max(short_its_s(mass, kn), 2e-7)
            for n in (*self.counts, self.reference):
                yield self.setup.case("beam", kn, elements=n, its_s=its), {"elements": n}

    def section(self, results: Results) -> Section:
        values = self.drops(results).set_index(["kn_MN_m", "elements"])[list(QUANTITIES)]
        values = values.rename(columns=KEYS)
        words = dict(zip(values, QUANTITIES.values(), strict=True))
        finest = values.xs(self.reference, level="elements")
        errors = values.drop(self.reference, level="elements").div(finest, level="kn_MN_m") - 1.0
        need = pd.DataFrame(
            [
                [fewest(self.counts, own[name]) for name in own]
                for _, own in errors.groupby(level=0)
            ],
            index=finest.index.sort_values(),
            columns=values.columns,
            dtype=object,
        )
        own = errors.abs().groupby(level="elements").max()
        draft = prose(
            "elements",
            reference=self.reference,
            most=self.counts[-1],
            kn_N_m=self.setup.ends_N_m,
            ratio=_range(need.rebound_ratio, self.counts[-1]),
            force=_range(need.peak_force_N, self.counts[-1]),
            worst=own.loc[ELEMENTS] if ELEMENTS in self.counts else None,
            goal=GOAL,
        )
        long = errors.reset_index().melt(
            ["kn_MN_m", "elements"], var_name="quantity", value_name="error_relative"
        )
        long = long.rename(columns={"elements": "count"}).assign(
            model="beam", y0_m=self.setup.top_m, kn_N_m=1e6 * long.kn_MN_m
        )
        heads: dict[str, Head] = {name: (head, "", 2) for name, head in words.items()}
        draft.figure(
            "elements",
            error_figure(long, words, GOAL, "beam elements"),
            draft.data("elements", errors.reset_index(), heads),
        )
        heads = {name: (head, "") for name, head in words.items()}
        draft.table("elements_needed", need.reset_index(), heads)
        return draft.section()


def _range(counts: pd.Series, most: int) -> str:
    """Least and greatest of the counts needed, in words."""
    if counts.isna().any():
        return f"more than {most}"
    low, high = counts.min(), counts.max()
    return str(low) if low == high else f"{low} to {high}"
