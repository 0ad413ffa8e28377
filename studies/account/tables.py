"""Which numbers stand in the tables of the accounts of the 65 %, and in which order?"""

from __future__ import annotations

import itertools
import math

from ...solver import paper
from ..page.report import Column, Table, Value, percent
from .design import INSTRUMENTS, MOST_DROPS, Instrument, Needed
from .film import PUBLISHED, Film, Moments, r2_definitions
from .findings import SURVIVES, Findings
from .fit import LEVEL, Fit

# Akaike's criteria closer than this leave two accounts equally good (Burnham and Anderson, 2002).
APART = 2.0
CLEARLY_APART = 6.0
# As many as the paper's own campaign, or nearly.
FEW_DROPS = 30


def ranked(found: Findings) -> list[Fit]:
    """The fits, the best by Akaike's criterion first."""
    return sorted(found.fits, key=lambda each: each.criterion)


def verdict(each: Fit, best: float) -> str:
    """What the fit says of an account, in plain words."""
    if each.p < SURVIVES:
        return "rejected: does not reproduce the published drops with any parameters"
    away = each.criterion - best
    bounds = [p.name for i, p in enumerate(each.account.parameters) if each.at_bound(i)]
    edge = f"; reaches the bound of {' and '.join(bounds)}" if bounds else ""
    if away <= APART:
        return f"holds: as good as the best{edge}"
    if away <= CLEARLY_APART:
        return f"holds, a little less well{edge}"
    return f"not excluded, clearly less well{edge}"


def worst_pairs(found: Findings) -> list[Needed]:
    """Every instrument at the pair that needs most drops, the most telling instrument first.

    Most telling is what tells most pairs apart in ``FEW_DROPS``; of equal ones the cheapest.
    """
    worst = []
    for instrument in INSTRUMENTS:
        rows = [row for pair in found.needed.values() for row in pair]
        own = [row for row in rows if row.instrument == instrument]
        if own:
            worst.append(max(own, key=lambda row: row.drops))
    return sorted(
        worst,
        key=lambda row: (-len(told(found, row.instrument)), row.instrument.cost, row.drops),
    )


def told(found: Findings, instrument: Instrument) -> set[tuple[str, str]]:
    """The pairs of accounts that an instrument tells apart in ``FEW_DROPS``."""
    return {
        pair
        for pair, rows in found.needed.items()
        if any(row.instrument == instrument and row.drops <= FEW_DROPS for row in rows)
    }


def cheapest_set(found: Findings) -> tuple[Instrument, ...]:
    """The cheapest instruments, three at most, that together tell most pairs apart.

    Of sets that tell as many, the one of least cost, then the smallest, then of fewest drops.
    """
    pairs = {each: told(found, each) for each in INSTRUMENTS}

    def rank(chosen: tuple[Instrument, ...]) -> tuple[int, int, int, float]:
        reached = set().union(*(pairs[each] for each in chosen))
        drops = 0.0
        for pair in reached:
            rows = found.needed[pair]
            drops += min(row.drops for row in rows if row.instrument in chosen)
        return -len(reached), sum(each.cost for each in chosen), len(chosen), drops

    sets = (chosen for n in (1, 2, 3) for chosen in itertools.combinations(INSTRUMENTS, n))
    return min(sets, key=rank)


def definition_table(film: Film) -> Table:
    """R² by every definition beside the published pair."""
    rows: list[list[Value]] = [
        [
            f"about {each.about}",
            each.quadratic,
            paper.R2_LINEAR,
            each.low,
            each.high,
            each.tail,
            paper.R2_QUADRATIC - paper.R2_LINEAR,
            each.gain,
            each.gain_tail,
        ]
        for each in r2_definitions(film)
    ]
    return Table(
        "account_r2",
        "Which definition of R² goes with the published pair: 26 drops with normal y1/y0, "
        "0.65 ± 0.21, on film.",
        (
            Column("about", "R²"),
            Column("quadratic", "quadratic"),
            Column("published", "published R²"),
            Column("low", "5 %"),
            Column("high", "95 %"),
            Column("p", "p", "", 2),
            Column("gain_published", "published gain", "", 2),
            Column("gain", "median gain", "", 2),
            Column("gain_p", "p", "", 2),
        ),
        rows,
        "R² about zero is excluded. The two forms of the quadratic are not told apart; the one "
        "through the origin, like the line, is used.",
    )


def fit_table(found: Findings) -> Table:
    """χ², p and criterion of every account."""
    best = ranked(found)[0].criterion
    rows: list[list[Value]] = [
        [
            each.account.key,
            each.account.title,
            len(each.account.parameters),
            each.chi2_declared,
            each.p_declared,
            each.chi2,
            each.p,
            each.criterion - best,
            verdict(each, best),
        ]
        for each in found.fits
    ]
    return Table(
        "account_fits",
        "Every account before and after its fit; χ² is for five summaries.",
        (
            Column("account", "account"),
            Column("what", "what"),
            Column("parameters", "parameters"),
            Column("chi2_declared", "χ² declared", "", 3),
            Column("p_declared", "p declared", "", 2),
            Column("chi2", "χ² fitted", "", 3),
            Column("p", "p fitted", "", 2),
            Column("aic", "Akaike above best", "", 2),
            Column("verdict", "verdict"),
        ),
        rows,
        "p at the fitted point does not know that it was fitted, so it is too kind rather than "
        f"too harsh. An account with p below {SURVIVES} is rejected.",
    )


def parameter_table(found: Findings) -> Table:
    """Every parameter before and after the fit."""
    rows: list[list[Value]] = []
    for each in found.fits:
        for i, p in enumerate(each.account.parameters):
            low, high = each.interval[i]
            rows.append(
                [
                    each.account.key,
                    p.name,
                    p.unit,
                    p.low,
                    p.high,
                    p.declared,
                    each.best[i],
                    low,
                    high,
                    "yes" if each.at_bound(i) else "no",
                    p.why,
                ]
            )
    return Table(
        "account_parameters",
        f"Parameters with their {percent(LEVEL, 0)} intervals.",
        (
            Column("account", "account"),
            Column("parameter", "parameter"),
            Column("unit", "unit"),
            Column("low", "from", "", 3),
            Column("high", "to", "", 3),
            Column("declared", "declared", "", 3),
            Column("best", "fitted", "", 3),
            Column("interval_low", "5 %", "", 3),
            Column("interval_high", "95 %", "", 3),
            Column("at_bound", "at bound"),
            Column("why", "why"),
        ),
        rows,
    )


def moment_table(found: Findings) -> Table:
    """Summaries as published and as predicted."""

    def row(name: str, of: Moments, known: float | None) -> list[Value]:
        return [name, *(float(value) for value in of), known]

    rows = [row("published", PUBLISHED, None)]
    for each in found.fits:
        rows.append(row(each.account.key, each.predicted, each.known_drop))
        rows.append(row(f"{each.account.key} 5 %", each.predicted_low, None))
        rows.append(row(f"{each.account.key} 95 %", each.predicted_high, None))
    return Table(
        "account_summaries",
        "Published summaries beside what films of the fitted accounts give: median, 5 and 95 %.",
        (
            Column("account", ""),
            Column("mean", "mean", "", 3),
            Column("std", "std", "", 3),
            Column("slope", "slope", "", 3),
            Column("r2_linear", "R² linear"),
            Column("r2_quadratic", "R² quadratic"),
            Column("share", "in 0.30 to 1.00", "", 3),
            Column("known", "near 50.5 → 34 mm", "", 3),
        ),
        rows,
        "The last column is the share of drops from 50 mm whose y1/y0 lies within 0.05 of the one "
        "published drop's. It is not fitted: that drop was chosen to be shown.",
    )


def variant_table(found: Findings) -> Table:
    """χ² under other assumptions."""
    keys = [each.account.key for each in found.fits]
    rows: list[list[Value]] = [["as stated", *(each.chi2 for each in found.fits)]]
    for variant in found.plan.variants:
        rows.append([variant.name, *(found.variants[key, variant.name].chi2 for key in keys)])
    return Table(
        "account_assumptions",
        "χ² after the fit under other assumptions on the film.",
        (
            Column("assumption", "assumption"),
            *(Column(f"account_{i}", key, "", 3) for i, key in enumerate(keys)),
        ),
        rows,
    )


def _finite(drops: float) -> Value:
    return drops if math.isfinite(drops) else f"> {MOST_DROPS}"


def ranking_table(found: Findings) -> Table:
    """The measurements, the most telling first."""
    pairs = len(found.needed)
    rows: list[list[Value]] = [
        [
            each.instrument.name,
            each.instrument.cost,
            len(told(found, each.instrument)),
            pairs,
            _finite(each.drops),
            f"{each.pair[0]} or {each.pair[1]}",
            each.instrument.apparatus,
        ]
        for each in worst_pairs(found)
    ]
    return Table(
        "account_measurements",
        "Measurements that would tell the surviving accounts apart, the most telling first.",
        (
            Column("measurement", "measurement"),
            Column("cost", "cost class"),
            Column("told", f"pairs told in {FEW_DROPS} drops"),
            Column("pairs", "of"),
            Column("worst", "drops for the worst pair", "", 3),
            Column("worst_pair", "which is"),
            Column("apparatus", "apparatus"),
        ),
        rows,
        "Cost class 1: a film and a desk; 2: simple electronics; 3: gauges or sensors with fast "
        "recording.",
    )


def pair_table(found: Findings) -> Table:
    """Every measurement for every pair."""
    rows: list[list[Value]] = [
        [
            f"{each.pair[0]} or {each.pair[1]}",
            each.instrument.name,
            each.instrument.unit,
            each.by,
            each.difference,
            each.scatter,
            each.instrument.noise,
            _finite(each.drops),
            each.instrument.cost,
        ]
        for pair in found.needed.values()
        for each in pair
    ]
    return Table(
        "account_pairs",
        "For every pair and measurement: the predicted difference, the scatter of a drop (the "
        "instrument's noise included), and the drops that decide.",
        (
            Column("pair", "pair"),
            Column("measurement", "measurement"),
            Column("unit", "unit"),
            Column("by", "told by"),
            Column("difference", "difference", "", 3),
            Column("scatter", "scatter", "", 3),
            Column("noise", "noise", "", 2),
            Column("drops", "drops", "", 3),
            Column("cost", "cost class"),
        ),
        rows,
        "By the mean, or by the spread (mean distance from the middle between the two means), "
        "whichever is quicker; normal approximation.",
    )
