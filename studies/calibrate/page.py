"""Page of a calibration."""

from __future__ import annotations

from pathlib import Path

from ...solver import paper
from ..inputs.again import into
from ..report.figures import picture
from ..report.page import Column, Figure, Report, Section, Table, write_report
from . import other_programs
from .estimate import LEVEL, Interval, RatioEstimate
from .figures import curve_figure, measured_figure
from .run import PAPER, Calibration, Stiffness


def write_calibration(found: Calibration, out: Path, version: str) -> Path:
    """Write ``report.html``, ``figures/`` and ``tables/`` into ``out``; returns the page's path."""
    sections = [_ratio_section(found), kn_section(found), _limits(found)]
    title = (
        "Kn from the paper's figures"
        if found.drops is None
        else (f"Kn from {found.drops.manifest.title}")
    )
    facts = [("Source", found.source), ("Drops", str(found.ratio.n)), ("Seed", str(found.seed))]
    if found.drops is not None:
        facts.append(("Licence of the data", found.drops.manifest.licence or "not declared"))
    page = Report(
        title=title,
        lead="The normal contact stiffness at which a beam model rebounds as the drops did.",
        version=version,
        command=_command(found, out),
        headline=headline(found),
        facts=facts,
        sections=sections,
    )
    return write_report(page, out)


def headline(found: Calibration) -> list[str]:
    """The result in two sentences."""
    ratio, kn = found.ratio, found.kn
    point = (
        "no Kn of the model fits" if kn.estimate is None else f"Kn = {kn.estimate / 1e6:.3g} MN/m"
    )
    return [
        f"y1/y0 = {ratio.mean.estimate:.3f} ({100 * ratio.mean.level:.0f} % interval of the mean "
        f"{ratio.mean.low:.3f} to {ratio.mean.high:.3f}): {point} ({kn.words()}).",
        f"Single drops, 5th to 95th percentile: y1/y0 from {ratio.population.low:.2f} to "
        f"{ratio.population.high:.2f}, that is Kn {found.population.words()}.",
    ]


def _command(found: Calibration, out: Path) -> str:
    level = ["--level", f"{found.kn.level:g}"] if found.kn.level != LEVEL else []
    return into(out, "calibrate", found.source, "--seed", found.seed, *level)


def _ratio_section(found: Calibration) -> Section:
    ratio, drops = found.ratio, found.drops
    if drops is None:
        text = [
            f"The paper gives {ratio.n} drops as their mean, {ratio.mean.estimate:.2f}, their "
            f"standard deviation, {ratio.spread:.2f}, and their 90 % band, "
            f"{ratio.population.low:.0%} to {ratio.population.high:.0%}; the drops themselves are "
            "not published as numbers. The interval of the mean follows from these with "
            "Student's t.",
        ]
        return Section("ratio", "What the paper measured", text, tables=[_ratio_table(ratio)])
    drawn = picture(measured_figure(drops.y0_m, drops.y1_m, ratio))
    columns = (drops.drop, drops.y0_m, drops.y1_m)
    table = Table(
        "drops",
        "The drops.",
        (
            Column("drop", "Drop"),
            Column("y0_mm", "y0", "mm"),
            Column("y1_mm", "y1", "mm"),
            Column("ratio", "y1/y0"),
            Column("kn_MN_m", "Kn alone", "MN/m", 3),
        ),
        [
            (int(n), 1e3 * y0, 1e3 * y1, y1 / y0, found.curve.stiffness(y1 / y0) / 1e6)
            for n, y0, y1 in zip(*(map(float, x) for x in columns), strict=True)
        ],
        "Kn alone: 0 and ∞ mark a ratio that no Kn of the model gives.",
    )
    text = [f"y1/y0 by {ratio.method}.", *_trend_text(ratio)]
    figure = Figure(
        "drops",
        "Height after impact against height before it.",
        drawn,
        "Scatter of y1 against y0 with the fitted line",
        table,
    )
    return Section(
        "ratio", "What the drops say", text, figures=[figure], tables=[_ratio_table(ratio)]
    )


def _trend_text(ratio: RatioEstimate) -> list[str]:
    if ratio.trend is None:
        return ["The drops do not differ enough in height to test y1/y0 for a trend with y0."]
    slope = ratio.trend.slope_1_m
    verdict = "there is one" if ratio.trend.p_value < 0.05 else "none is seen"
    return [
        f"Trend of y1/y0 with y0: {slope.estimate:+.3g} per m ({100 * slope.level:.0f} % interval "
        f"{slope.low:+.3g} to {slope.high:+.3g}), p = {ratio.trend.p_value:.3g}: {verdict}. In the "
        "model y1/y0 changes by less than 0.001 from 10 to 50 mm, so any trend means that "
        "something is missing from it."
    ]


def _ratio_table(ratio: RatioEstimate) -> Table:
    rows: list[tuple[str | float | None, ...]] = [_row("mean, Student's t", ratio.mean)]
    if ratio.bootstrap is not None:
        rows.append(_row("mean, bootstrap by drop (BCa)", ratio.bootstrap))
    rows.append(_row("single drops", ratio.population))
    return Table(
        "rebound_ratio",
        f"y1/y0 with {100 * ratio.mean.level:.0f} % intervals.",
        (
            Column("what", "y1/y0 of"),
            Column("estimate", "estimate"),
            Column("low", "from"),
            Column("high", "to"),
        ),
        rows,
    )


def _row(name: str, interval: Interval) -> tuple[str, float, float, float]:
    return name, interval.estimate, interval.low, interval.high


def kn_section(found: Calibration) -> Section:
    """Kn of the mean and of single drops, with the model's curve drawn."""
    low, high = found.curve.reachable
    from_paper = found.source == PAPER
    drawn = picture(curve_figure(found.curve, found.ratio, from_paper))
    curve = Table(
        "ratio_curve",
        "y1/y0 of the beam against Kn, time step short enough not to matter.",
        (Column("kn_N_m", "Kn", "N/m"), Column("ratio", "y1/y0", digits=5)),
        [
            (float(kn), float(ratio))
            for kn, ratio in zip(found.curve.kn_N_m, found.curve.ratio, strict=True)
        ],
    )
    figure = Figure(
        "kn-from-ratio",
        "y1/y0 of the model falls with Kn (black); where it meets the measured ratio, Kn is read. "
        "Dark band: interval of the mean. Light band: single drops.",
        drawn,
        "Falling curve of y1/y0 against Kn with the measured ratio",
        curve,
    )
    rows = [_kn_row("mean", found.kn)]
    if found.kn_bootstrap is not None:
        rows.append(_kn_row("mean, bootstrap", found.kn_bootstrap))
    rows.append(_kn_row("single drops", found.population))
    table = Table(
        "kn",
        f"Normal contact stiffness, {100 * found.kn.level:.0f} % intervals.",
        (
            Column("what", "Kn of"),
            Column("estimate_MN_m", "estimate", "MN/m", 3),
            Column("low_MN_m", "from", "MN/m", 3),
            Column("high_MN_m", "to", "MN/m", 3),
            Column("words", "in words"),
        ),
        rows,
        "A dash is a bound that the ratio cannot set.",
    )
    text = [
        f"No Kn gives the model a ratio above {high:.5f} or below {low:.4f}, its limit on a rigid "
        "plane. A measured ratio outside bounds Kn from one side only.",
    ]
    if from_paper:
        text.append(
            "The paper's band of 30 % to 100 % lies across both ends: "
            f"{paper.RATIO_BAND_90[0]:.2f} is below the rigid limit of {low:.4f}, "
            "and 1.00 is reached only as Kn goes to zero."
        )
    tables = [table]
    if found.kn.estimate is not None:
        tables.append(other_programs.table(found.kn.estimate, found.bristle.section.area_m2))
    return Section("kn", "Kn from y1/y0", text, figures=[figure], tables=tables)


def _kn_row(name: str, kn: Stiffness) -> tuple[str | float | None, ...]:
    scaled = [None if x is None else x / 1e6 for x in (kn.estimate, kn.low, kn.high)]
    return name, *scaled, kn.words()


def _limits(found: Calibration) -> Section:
    return Section("limits", "What this cannot tell", found.warnings)
