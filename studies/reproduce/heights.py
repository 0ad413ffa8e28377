"""Tip height against time for every height and Kn of Fig. 13, in 1-D and 3-D."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...solver import paper
from ...solver.arrays import Array
from ...solver.drop import DropResult
from ..inputs.config import DropInputs
from ..report.figures import picture
from ..report.page import Column, Comparison, Figure, Section, Table, Value, Verdict, percent, show
from ..report.paper_figures import height_figure
from .campaign import Results, Setup
from .crosscheck import TARGET

BODIES = ("beam", "reduced")
SAMPLES = 120
CLOSE = 0.02
RIGID_N_M, RIGID_ITS_S = 1e10, 1e-7


def track(result: DropResult, samples: int = SAMPLES) -> tuple[Array, Array]:
    """Time and tip height, thinned to about ``samples`` equal times; the deepest instant stays."""
    rows = result.history.array()
    keep = np.searchsorted(rows[:, 0], np.linspace(0.0, rows[-1, 0], samples))
    keep = np.unique(np.append(np.minimum(keep, len(rows) - 1), np.argmin(rows[:, 1])))
    return rows[keep, 0], rows[keep, 1]


def rebound(result: DropResult) -> float:
    """y1/y0, NaN where a drop ended before its rebound."""
    return math.nan if result.rebound_ratio is None else result.rebound_ratio


@dataclass(frozen=True)
class Figure13:
    """Tip height against time, from release to the second impact."""

    setup: Setup

    def cases(self) -> list[DropInputs]:
        s = self.setup
        flights = [s.case(m, kn, h) for h in s.heights_m for kn in s.kn_N_m for m in BODIES]
        return [*flights, self._rigid()]

    def _rigid(self) -> DropInputs:
        """The beam on what is as good as a rigid plane."""
        return self.setup.case("beam", RIGID_N_M, its_s=RIGID_ITS_S)

    def section(self, results: Results) -> Section:
        s = self.setup
        found = {
            (m, h, kn): results[s.case(m, kn, h)]
            for h in s.heights_m
            for kn in s.kn_N_m
            for m in BODIES
        }
        drawn = picture(height_figure({key: track(result) for key, result in found.items()}))
        figure = Figure(
            "fig13",
            "Fig. 13 of the paper: tip height against time from release to the second impact, a "
            "panel per height, colour and label by Kn. The 3-D curves lie on the 1-D ones.",
            drawn,
            "Tip height against time, a panel for each height",
            self._curves(found),
        )
        rows: list[tuple[Value, ...]] = []
        apart = 0.0
        for h in s.heights_m:
            for kn in s.kn_N_m:
                one, three = (rebound(found[m, h, kn]) for m in BODIES)
                apart = max(apart, abs(one / three - 1.0))
                rows.append(
                    (
                        1e3 * h,
                        kn / 1e6,
                        one,
                        three,
                        one / three - 1.0,
                        1e3 * h * one,
                    )
                )
        table = Table(
            "fig13_ratios",
            f"Rebound of every case of Fig. 13, ITS {1e3 * s.its_s:g} ms.",
            (
                Column("y0_mm", "y0", "mm", 0),
                Column("kn_MN_m", "Kn", "MN/m", 0),
                Column("ratio_1d", "y1/y0, 1-D"),
                Column("ratio_3d", "y1/y0, 3-D"),
                Column("apart", "1-D from 3-D", "relative", 2),
                Column("y1_mm", "y1, 1-D", "mm"),
            ),
            rows,
        )
        met = "met" if apart <= TARGET else "not met"
        spread = self._height_spread(found)
        text = [
            f"Over all {len(rows)} cases beam and 3-D solid (reduced) differ by at most "
            f"{show(apart, 2)} in y1/y0; the target is {TARGET:g}: {met}.",
            f"At one Kn, y1/y0 changes by at most {show(spread, 2)} between the lowest and the "
            "highest drop. A model of this kind has no trend with height.",
        ]
        return Section(
            "fig13",
            "Fig. 13: tip height against time",
            text,
            self._comparisons(found, rebound(results[self._rigid()])),
            [figure],
            [table],
            headline=text[0],
        )

    def _height_spread(self, found: dict[tuple[str, float, float], DropResult]) -> float:
        ratios = np.array(
            [
                [rebound(found["beam", h, kn]) for h in self.setup.heights_m]
                for kn in self.setup.kn_N_m
            ]
        )
        return float(np.ptp(ratios, axis=1).max())

    def _comparisons(
        self, found: dict[tuple[str, float, float], DropResult], rigid_ratio: float
    ) -> list[Comparison]:
        rows = []
        for kn, published in paper.RATIO_AT_KN.items():
            if kn not in self.setup.kn_N_m:
                continue
            one, three = (rebound(found[m, self.setup.top_m, kn]) for m in BODIES)
            off = one / published - 1.0
            digits = len(f"{published}".partition(".")[2])
            same = round(one, digits) == published
            remark = "Rounds to the value printed." if same else ""
            if same and published < rigid_ratio:
                remark += (
                    f" Taken as {published:.2f} it would lie below what a rigid plane gives this "
                    f"bristle, {rigid_ratio:.4f}."
                )
            close = same or abs(off) <= CLOSE
            rows.append(
                Comparison(
                    f"y1/y0 at Kn = {kn / 1e6:g} MN/m",
                    "Fig. 13 and text",
                    f"{published}",
                    f"{one:.4f}",
                    f"{three:.4f}",
                    percent(off, signed=True),
                    Verdict.AGREES if close else Verdict.DIFFERS,
                    remark or f"Within {percent(CLOSE, 0)}." if close else "",
                )
            )
        return rows

    def _curves(self, found: dict[tuple[str, float, float], DropResult]) -> Table:
        s = self.setup
        keys = [(m, kn) for kn in s.kn_N_m for m in BODIES]
        rows: list[list[Value]] = []
        for h in s.heights_m:
            history = {key: found[key[0], h, key[1]].history.array() for key in keys}
            end = max(rows_[-1, 0] for rows_ in history.values())
            for t in np.linspace(0.0, end, SAMPLES):
                row: list[Value] = [1e3 * h, round(1e3 * float(t), 4)]
                for each in history.values():
                    inside = t <= each[-1, 0]
                    y = 1e3 * float(np.interp(t, each[:, 0], each[:, 1]))
                    row.append(round(y, 4) if inside else None)
                rows.append(row)
        heads = tuple(
            Column(f"{m}_{kn / 1e6:g}_MN_m_mm", f"{m}, {kn / 1e6:g} MN/m", "mm") for m, kn in keys
        )
        return Table(
            "fig13_curves",
            "Tip height against time.",
            (Column("y0_mm", "y0", "mm", 0), Column("t_ms", "t", "ms"), *heads),
            rows,
        )
