"""What does the page of the loop's benchmark show?"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

from ..page.figures import (
    BLACK,
    BLUE,
    GREY,
    MARKERS,
    SERIES,
    SMALLEST,
    VERMILION,
    panels,
    picture,
    plain_ticks,
    styled,
)
from ..page.report import Column, Figure, Section, Table, Value, percent
from .loop_cases import ROWS
from .loop_table import LEVEL, Line, Outcomes
from .machine import facts
from .page import write_page

RIVAL = "right by "
HOW = (
    "The reduced solid makes the datasets, the loop reads them with the beam: the model that is "
    "fitted is not the one that made the data. Every dataset has a Kn, releases, errors and a seed "
    "of its own; d is how many standard errors an effect moves the data that no fit of the others "
    "takes up.",
    f"Intervals are Clopper and Pearson's at {percent(LEVEL, 0)}. A target is missed where the "
    "share lies beyond it, and missed for sure where the whole interval does.",
)


def page(lines: Sequence[Line], outcomes: Outcomes, out: Path, ranks: int) -> None:
    """Write report.html with its figures and tables into ``out``."""
    aimed = [line for line in lines if line.target]
    datasets = 1 + max((each["number"] for each in outcomes), default=-1)
    write_page(
        out,
        title="How often the loop is right",
        lead=f"{len(outcomes)} datasets whose truth the loop does not see, {datasets} of a kind.",
        command=("loop", "--datasets", datasets),
        headline=_headline(aimed),
        facts=[("Ranks", str(ranks)), *facts()],
        sections=[
            _rates(aimed, lines),
            _rivals([line for line in lines if line.quantity.startswith(RIVAL)]),
            *_held_out(outcomes),
        ],
        how=HOW,
    )


def within(target: str, value: float) -> bool:
    """Whether a share or number is what its target, such as ``≤ 5 %`` or ``87 to 93 %``, asks."""
    low, high = bounds(target)
    return low <= value <= high


def bounds(target: str) -> tuple[float, float]:
    """The least and the greatest value that a target allows."""
    found = [float(each) for each in re.findall(r"\d+(?:\.\d+)?", target)]
    ends = [each / 100.0 if "%" in target else each for each in found]
    if len(ends) == 2:
        return ends[0], ends[1]
    return (ends[0], float("inf")) if "≥" in target else (float("-inf"), ends[0])


def _headline(aimed: Sequence[Line]) -> list[str]:
    missed = [line for line in aimed if not within(line.target, line.value)]
    sentences = [f"{len(aimed) - len(missed)} of {len(aimed)} targets are met."]
    for line in missed:
        shown = f"{line.value:.2f}" if line.low is None else percent(line.value)
        sentences.append(f"Missed: {line.row}, {line.quantity}: {shown}, asked for {line.target}.")
    return sentences


def _rates(aimed: Sequence[Line], lines: Sequence[Line]) -> Section:
    shares = [line for line in aimed if line.low is not None]
    data = _table("rates", "Every rate with its target", lines)
    drawn = Figure(
        "rates",
        "Shares with their intervals; the grey bars are what is asked for. A cross misses it.",
        picture(rates_figure(shares)),
        "Shares with intervals and targets",
        data,
    )
    figures = [drawn] if shares else []
    return Section("rates", "Rates and targets", (), (), figures, [] if figures else [data])


def _rivals(lines: Sequence[Line]) -> Section:
    methods = list(dict.fromkeys(line.quantity.removeprefix(RIVAL) for line in lines))
    of = {(line.row, line.quantity.removeprefix(RIVAL)): 100.0 * line.value for line in lines}
    rows: list[list[Value]] = [
        [row.name, *(of.get((row.name, method)) for method in methods)]
        for row in ROWS
        if any(key[0] == row.name for key in of)
    ]
    names = [method.removesuffix(" alone") for method in methods]
    columns = [Column(re.sub(r"\W+", "_", each), each, "%", 3) for each in names]
    return Section(
        "rivals",
        "Beside simpler methods",
        tables=[
            Table(
                "rivals",
                "Share of datasets of which each says what is right",
                (Column("row", "Datasets"), *columns),
                rows,
                "Right is adequate, unknown, or a first name from the true effect's class.",
            )
        ],
    )


def _held_out(outcomes: Outcomes) -> list[Section]:
    """Errors of held-out drops before and after, where one listed effect was in the data."""
    names = {row.name for row in ROWS if row.listed == 1}
    own = [each for each in outcomes if each["row"] in names and each.get("before") is not None]
    if not own:
        return []
    columns = (
        Column("row", "Datasets"),
        Column("number", "Number", digits=0),
        Column("before_mm", "before", "mm", 3),
        Column("after_mm", "after", "mm", 3),
        Column("truth_mm", "by the truth", "mm", 3),
    )
    rows = [[each[key] for key in ("row", "number", "before", "after", "oracle")] for each in own]
    drawn = Figure(
        "held-out",
        "Error of predicted heights of drops that were held out, with what the loop found against "
        "without, each divided by the error that the truth leaves. Below the line is better.",
        picture(held_out_figure(own)),
        "Held-out error after against before",
        Table("held-out", "Errors of held-out drops", columns, rows),
    )
    return [Section("held-out", "Held-out drops, before and after", figures=[drawn])]


def _table(name: str, caption: str, lines: Sequence[Line]) -> Table:
    columns = (
        Column("row", "Datasets"),
        Column("quantity", "Quantity"),
        Column("value", "Value", digits=3),
        Column("low", "from", digits=3),
        Column("high", "to", digits=3),
        Column("count", "Hits", digits=0),
        Column("of", "of", digits=0),
        Column("target", "Target"),
    )
    rows: list[list[Value]] = [
        [
            *(line.row, line.quantity, line.value, line.low, line.high),
            line.count,
            line.of,
            line.target,
        ]
        for line in lines
        if not line.quantity.startswith(RIVAL)
    ]
    return Table(name, caption, columns, rows, "Shares are parts of one.")


@styled
def rates_figure(lines: Sequence[Line]) -> Drawing:
    """A dot with its interval for every share that has a target, over the target's range."""
    figure, axes = panels(height_in=1.0 + 0.28 * len(lines))
    ax: Axes = axes[0, 0]
    for place, line in enumerate(lines):
        low, high = (100.0 * min(max(end, 0.0), 1.0) for end in bounds(line.target))
        ax.barh(place, high - low, left=low, height=0.7, color=GREY, alpha=0.25, lw=0)
        good = within(line.target, line.value)
        colour = BLUE if good else VERMILION
        if line.low is not None and line.high is not None:
            ax.plot([100.0 * line.low, 100.0 * line.high], [place, place], color=colour, lw=1.0)
        ax.plot(100.0 * line.value, place, "o" if good else "x", color=colour, ms=5.0, mew=1.6)
    names = [f"{line.row}:\n{line.quantity}" for line in lines]
    ax.set_yticks(range(len(lines)), names, fontsize=SMALLEST, linespacing=0.95)
    ax.set(xlim=(-2, 102), ylim=(len(lines) - 0.4, -0.6), xlabel="share of datasets (%)")
    return figure


@styled
def held_out_figure(outcomes: Sequence[dict[str, Any]]) -> Drawing:
    """Held-out error after against before, in units of what the truth leaves."""
    figure, axes = panels(height_in=3.6)
    ax: Axes = axes[0, 0]
    for number, name in enumerate(dict.fromkeys(each["row"] for each in outcomes)):
        own = [each for each in outcomes if each["row"] == name]
        before, after = (
            [each[key] / each["oracle"] for each in own] for key in ("before", "after")
        )
        colour, marker = SERIES[number % len(SERIES)], MARKERS[number % len(MARKERS)]
        ax.plot(before, after, marker, color=colour, fillstyle="none", ms=3.0, label=name)
    ax.axline((1.0, 1.0), slope=1.0, color=BLACK, lw=0.8)
    ax.axhline(1.0, color=GREY, lw=0.8, ls="--")
    ax.set(xscale="log", yscale="log", xlabel="before, over what the truth leaves")
    ax.set_ylabel("after, over what the truth leaves")
    plain_ticks(ax)
    ax.legend(loc="upper left")
    return figure
