"""How are the accounts of the 65 % told: text, tables and figures of the section?"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ...solver import paper
from ...solver.bristle import Array
from ..page.figures import picture
from ..page.report import Column, Figure, Section, Table, Value, show
from .design import HEIGHT_M
from .figures import EDGES, clouds_figure, density, distribution_figure
from .film import Film, planned_heights_m
from .findings import SURVIVES, Findings
from .fit import Drawn, Fit, films
from .library import bristle_of, drops_under, sound
from .models import MEASURED_BETA_S, rivals
from .tables import (
    APART,
    FEW_DROPS,
    cheapest_set,
    definition_table,
    fit_table,
    moment_table,
    pair_table,
    parameter_table,
    ranked,
    ranking_table,
    told,
    variant_table,
)

COMMAND = "python3 -m bristle.studies.account"
CHECKED = 120
DRAWING_SEED = 26


def section_of(found: Findings) -> Section:
    """The section with its tables, figures and sentences."""
    return Section(
        "account",
        "What the 65 % is made of",
        [*_introduction(found), *_verdicts(found), *_advice(found), *_cautions(found)],
        (),
        _figures(found),
        [
            definition_table(found.plan.film),
            fit_table(found),
            parameter_table(found),
            moment_table(found),
            variant_table(found),
            ranking_table(found),
            pair_table(found),
        ],
        COMMAND,
        headline=_headline(found),
    )


def _names(fits: Sequence[Fit]) -> str:
    words = [f"{each.account.key} ({each.account.title})" for each in fits]
    return "; ".join(words) if words else "none"


def _headline(found: Findings) -> str:
    alive = found.surviving
    chosen = cheapest_set(found) if found.needed else ()
    words = " with ".join(each.name for each in chosen)
    advice = f" Cheapest to decide: {words}." if chosen else ""
    return (
        f"What the 65 % is made of: {len(alive)} of {len(found.fits)} accounts reproduce the "
        f"published drops ({', '.join(each.account.key for each in alive)}); y1/y0 alone cannot "
        f"choose among them.{advice}"
    )


def _introduction(found: Findings) -> list[str]:
    film = found.plan.film
    declared = next(each for each in found.fits if each.account.key == "A")
    return [
        f"The paper explains y1/y0 = {paper.RATIO_MEAN} by damping inside the steel, β = "
        f"{paper.BETA_S:g} s. Waves measured in bars ask for about {MEASURED_BETA_S:g} s, and then "
        "no Kn takes more than 8 % from an upright bristle. So where does the rest go? Each "
        "account below is fitted to what is published of the 26 drops, through the same film.",
        f"The film: {film.frames_per_s:g} frames/s at unknown phase, so that the apex is read too "
        f"low by g dt²/2, on the average {1e3 * film.mean_low_m:.2f} mm and at most "
        f"{1e3 * film.gravity_m_s2 / (8 * film.frames_per_s**2):.2f} mm; both heights are read to "
        f"{1e3 * film.sigma_m:g} mm, an assumption. From 10 mm the film alone scatters y1/y0 by "
        f"{film_std(film, 0.01):.3f}, from 50 mm by {film_std(film, 0.05):.3f}. The heights are "
        "taken as spread over the paper's five as evenly as 26 allows, also an assumption. The "
        "tip is read. Leans beyond 8° are held to that: nobody would have filmed them as upright.",
        "The likelihood is synthetic: films of 26 drops are simulated, and mean and covariance of "
        "their summaries (mean, log of the standard deviation, slope, log(1 - R²), what the "
        "quadratic adds) make a normal density, evaluated at the published ones. The published "
        "90 % band, 0.30 to 1.00, is 0.65 ± 1.645 × 0.21 and so no measurement of its own: it is "
        "predicted, not fitted. χ² is -2 log of the likelihood relative to the greatest, for five "
        "numbers; p is the share of films simulated with the same parameters that lie at least as "
        f"far out. Account A, one Kn, has χ² = {show(declared.chi2, 3)}: whatever its Kn, it "
        "scatters by the film alone.",
    ]


def film_std(film: Film, height_m: float) -> float:
    """Standard deviation of y1/y0 from the film alone at the paper's ratio, to first order."""
    reading = film.sigma_m**2 * (1.0 + paper.RATIO_MEAN**2)
    return math.sqrt(film.spread_low_m**2 + reading) / height_m


def _verdicts(found: Findings) -> list[str]:
    fits = ranked(found)
    best = fits[0].criterion
    alive = [each for each in fits if each.p >= SURVIVES]
    equal = [each for each in alive if each.criterion - best <= APART]
    failed = [each for each in fits if each.p < SURVIVES]
    text = [
        f"Rejected: {_names(failed)}. Not rejected, the best first: {_names(alive)}.",
    ]
    if len(equal) > 1:
        text.append(
            f"Within two units of Akaike's criterion of the best, and so equally good on what is "
            f"published: {', '.join(each.account.key for each in equal)}. Five summaries of 26 "
            "drops do not tell strong damping in the steel from loss in the contact or from "
            "leaning. That is a result: y1/y0 is not a measurement of where the energy goes."
        )
    for each in alive:
        values = zip(each.account.parameters, each.best, each.interval, strict=True)
        words = ", ".join(
            f"{p.name} {show(b, 3)}{' ' + p.unit if p.unit else ''} ({show(i[0], 3)} to "
            f"{show(i[1], 3)})"
            for p, b, i in values
        )
        text.append(
            f"{each.account.key}: {words}; χ² {show(each.chi2_declared, 3)} as declared, "
            f"{each.chi2:.1f} after the fit (p = {each.p:.2f})."
        )
    return [*text, *_meaning(alive)]


def _meaning(alive: Sequence[Fit]) -> list[str]:
    text = []
    for each in alive:
        key = each.account.key
        if key in ("B", "D"):
            low, high = each.interval[1]
            text.append(
                f"{key} needs a coefficient of friction of {low:.2f} to {high:.2f}: at more, a tip "
                "that leans by less than the angle of friction sticks, and a sticking tip gives "
                f"back nearly all. The paper's {paper.FRICTION} is "
                f"{'inside' if low <= paper.FRICTION <= high else 'outside'}."
            )
    if any(each.account.beta_s > 10 * MEASURED_BETA_S for each in alive):
        text.append(
            "Accounts with the paper's damping go against the measured wave records, which no "
            "summary of these drops knows of: taken together with them, only those at "
            f"{MEASURED_BETA_S:g} s remain, unless this steel damps waves a thousand times more."
        )
    return text


def _advice(found: Findings) -> list[str]:
    if not found.needed:
        return []
    text = []
    for (one, two), rows in found.needed.items():
        cheap = next((r for r in rows if r.instrument.cost == 1 and math.isfinite(r.drops)), None)
        first = rows[0]
        if not math.isfinite(first.drops):
            text.append(f"{one} and {two} are not told apart by anything on the list.")
            continue
        words = f"{one} or {two}: {first.instrument.name}, {_count(first.drops)}"
        if cheap is not None and cheap is not first:
            words += f"; with a film alone: {cheap.instrument.name}, {_count(cheap.drops)}"
        text.append(words + ".")
    chosen = cheapest_set(found)
    reached = set().union(*(told(found, each) for each in chosen))
    names = " and ".join(f"{each.name} ({each.apparatus})" for each in chosen)
    return [
        f"What to measure next (drops from {1e3 * HEIGHT_M:g} mm, 95 % power at 5 % false alarm, "
        f"the parameters' uncertainty included). Cheapest: {names}; it tells {len(reached)} of "
        f"{len(found.needed)} pairs apart in {FEW_DROPS} drops each. By pair: " + " ".join(text)
    ]


def _count(drops: float) -> str:
    return "one drop" if drops <= 1 else f"{drops:.0f} drops"


def _cautions(found: Findings) -> list[str]:
    mended = sum(library.mended for library in found.libraries.values())
    n = sum(library.ratio.size for library in found.libraries.values())
    error = interpolation_error(found)
    missing = {each.key for each in rivals()} - {each.account.key for each in found.fits}
    checked = "; ".join(
        f"{key}: rms {rms:.3f}, mean {mean:+.3f}" for key, (mean, rms) in error.items()
    )
    text = [
        f"y1/y0 is read from tables of {n} drops of the beam. Interpolated against computed at "
        f"{CHECKED} drops of each fitted account: {checked}. The numbers of drops to be measured "
        "rest on the normal approximation, also where one drop is said to do: take a few."
    ]
    if mended:
        text.append(
            f"{mended} drops of the tables did not close their energy budget and were replaced by "
            "their neighbour of less lean."
        )
    if missing:
        text.append(f"Not computed: {', '.join(sorted(missing))}.")
    return text


def interpolation_error(found: Findings) -> dict[str, tuple[float, float]]:
    """Mean and rms of interpolated less computed y1/y0 over drops of each surviving account."""
    result = {}
    random = np.random.default_rng(DRAWING_SEED)
    for each in found.surviving:
        account = each.account
        heights = random.choice(planned_heights_m(), CHECKED)
        at = account.conditions(each.best, heights, random.standard_normal((2, CHECKED)))
        outcome = drops_under(at, bristle_of(account.beta_s))
        away = found.libraries[account.grid].at(at) - outcome.rebound_height_m / at.height_m
        away = away[sound(outcome)]
        result[account.key] = float(away.mean()), float(np.sqrt(np.mean(away**2)))
    return result


def _label(each: Fit) -> str:
    return f"{each.account.key}: {each.account.title}"


def _figures(found: Findings) -> list[Figure]:
    clouds: dict[str, tuple[Array, Array]] = {}
    densities: dict[str, Array] = {}
    many = Drawn.of(600, DRAWING_SEED)
    for each in found.fits:
        library = found.libraries[each.account.grid]
        y0, y1 = films(each.account, each.best, library, found.plan.film, many)
        densities[_label(each)] = density(y1 / y0)
        clouds[_label(each)] = y0[0], y1[0]
    middle = 0.5 * (EDGES[1:] + EDGES[:-1])
    keys = [f"account_{i}" for i in range(len(densities))]
    columns = tuple(Column(key, label, "", 3) for key, label in zip(keys, densities, strict=True))
    rows = np.column_stack([middle, *densities.values()]).tolist()
    drops: list[list[Value]] = [
        [name.split(":")[0], 1e3 * float(a), 1e3 * float(b)]
        for name, cloud in clouds.items()
        for a, b in zip(*cloud, strict=True)
    ]
    return [
        Figure(
            "account-distributions",
            "y1/y0 as each fitted account predicts the film to show it; black: the measured "
            "normal, 0.65 ± 0.21; blue: its 90 % band.",
            picture(distribution_figure(densities)),
            "Predicted distributions of y1/y0 beside the measured one",
            Table(
                "account_distributions",
                "Density of y1/y0 as filmed.",
                (Column("ratio", "y1/y0"), *columns),
                rows,
            ),
        ),
        Figure(
            "account-clouds",
            "26 drops of each fitted account, as Figs. 10 to 12 show the measured ones; line 65 %, "
            "dashes 30 % and 100 %, diamond the one drop published. None of the circles was "
            "measured.",
            picture(clouds_figure(clouds)),
            "Height after against before for 26 simulated drops of each account",
            Table(
                "account_clouds",
                "Simulated drops.",
                (
                    Column("account", "account"),
                    Column("y0_mm", "y0", "mm"),
                    Column("y1_mm", "y1", "mm"),
                ),
                drops,
            ),
        ),
    ]
