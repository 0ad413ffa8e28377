"""How far does the loop come with what the paper published of its drops?

A section of `bristle reproduce`. Published are summaries and one drop, no table of points. So the
first step alone can be made, is something missing, and it can be made safely: no model of a
bristle under which all drops of a height are alike scatters more than its instruments do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr
from scipy.stats import chi2

from ...solver import paper
from ..account.film import Film, planned_heights_m
from ..command.config import DropInputs
from ..page.report import Column, Section, Table, Value, show
from ..running.campaign import Results

READINGS_MM = (0.25, 0.5, 1.0)
# The published standard deviation is rounded to two decimals; the least that it stands for.
LEAST_STD = paper.RATIO_STD - 0.005


@dataclass(frozen=True)
class Scatter:
    """Scatter of y1/y0 that instruments alone make, were all drops from ``heights_m`` (n,).

    ``log10_p`` is the logarithm of the chance that 26 drops scatter as much as the published ones.
    """

    heights: str
    sigma_mm: float
    expected: float
    log10_p: float


def scatters() -> list[Scatter]:
    """For each error of reading: drops spread over the paper's heights, and all from the lowest."""
    designs = {
        "as evenly as possible over the five": planned_heights_m(),
        "all from 10 mm, where a reading counts most": np.full(paper.N_DROPS, paper.HEIGHTS_M[0]),
    }
    return [
        _scatter(words, heights, sigma)
        for words, heights in designs.items()
        for sigma in READINGS_MM
    ]


def _scatter(words: str, heights_m: np.ndarray, sigma_mm: float) -> Scatter:
    film = Film(sigma_m=1e-3 * sigma_mm)
    both = film.sigma_m**2 * (1.0 + paper.RATIO_MEAN**2) + film.spread_low_m**2
    expected = float(np.sqrt(both * np.mean(heights_m**-2.0)))
    free = paper.N_DROPS - 1
    statistic = free * (LEAST_STD / expected) ** 2
    return Scatter(words, sigma_mm, expected, float(_log_sf(statistic, free) / np.log(10.0)))


def _log_sf(statistic: float, free: int) -> float:
    """Log of chi-square's upper tail, by Wilson and Hilferty's normal where it underflows."""
    exact = float(chi2.logsf(statistic, free))
    if np.isfinite(exact):
        return exact
    third = 2.0 / (9.0 * free)
    deviate = ((statistic / free) ** (1.0 / 3.0) - 1.0 + third) / np.sqrt(third)
    return float(log_ndtr(-deviate))


def needed_mm() -> float:
    """The error of reading, in mm, that would make the published scatter by itself."""
    inverse = float(np.mean(planned_heights_m() ** -2.0))
    square = LEAST_STD**2 / inverse - Film().spread_low_m ** 2
    return float(1e3 * np.sqrt(square / (1.0 + paper.RATIO_MEAN**2)))


class LoopOnPaper:
    """The section of `bristle reproduce`; it needs no drops."""

    def cases(self) -> list[DropInputs]:
        """None."""
        return []

    def section(self, results: Results) -> Section:
        """The section with its table."""
        del results
        found = scatters()
        worst = max(found, key=lambda each: each.log10_p)
        before, after = (1e3 * x for x in paper.KNOWN_DROP_M)
        missed = after - paper.RATIO_MEAN * before
        text = [
            f"Is something missing? Yes. One Kn gives all drops of a height the same y1/y0, and "
            f"what the film and its reading add is small: {paper.N_DROPS} drops scatter by "
            f"{paper.RATIO_STD:.2f} (1 standard deviation), and even if every one of them had been "
            f"made from 10 mm and read to 1 mm, that much comes by chance with p = "
            f"{show(10.0**worst.log10_p, 2)} at most. Spread over the five heights, they would "
            f"have to be read wrong by {show(needed_mm(), 2)} mm.",
            "What is it? Something that differs among drops of one height, by chance or with "
            f"their order: a bend with height adds next to nothing to the fit (R² = "
            f"{paper.R2_QUADRATIC:.3f} instead of {paper.R2_LINEAR:.3f}). Effects by which all "
            "drops of a height change alike do not scatter: drag, damping of any kind, a law of "
            "the contact, a wrong scale. Which of those that differ (lean, slope, stiffness of "
            "the phases, wear), the summaries cannot tell: see 'What the 65 % is made of' on "
            "this page for the accounts that they do not exclude, and for what would decide.",
            f"The one drop published as numbers, {before:.1f} to {after:.0f} mm, lies "
            f"{missed:.1f} mm above the mean line: one drop tests nothing.",
            "What cannot be known from summaries: a trend with height or order, a missing effect's "
            "name, how small an effect would have shown, the error on held-out drops. A table of "
            "the drops, in the order they were made, would be enough to ask: bristle close-loop.",
        ]
        return Section(
            "loop",
            "The loop on what the paper published",
            text,
            tables=[_table(found)],
            headline="The published scatter of y1/y0 is beyond what reading a film makes: the "
            "model lacks something that differs from drop to drop.",
        )


def _table(found: list[Scatter]) -> Table:
    rows: list[tuple[Value, ...]] = [
        (each.heights, each.sigma_mm, each.expected, paper.RATIO_STD, each.log10_p)
        for each in found
    ]
    return Table(
        "published_scatter",
        "Scatter of y1/y0 by film and reading alone, beside the published one.",
        (
            Column("heights", "26 drops from the heights"),
            Column("sigma_mm", "read to", "mm", 2),
            Column("expected", "expected", digits=2),
            Column("published", "published", digits=2),
            Column("log10_p", "log10 p", digits=3),
        ),
        rows,
        "How many drops were made from which height is not published; the second half of the "
        "table bounds it.",
    )
