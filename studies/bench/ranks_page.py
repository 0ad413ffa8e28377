"""What does the page of what ranks gain show?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure as Drawing

from ..report.figures import (
    BLACK,
    BLUE,
    MARKERS,
    ORANGE,
    SERIES,
    SMALLEST,
    VERMILION,
    panels,
    picture,
    plain_ticks,
    styled,
)
from ..report.page import Column, Figure, Section, Table, percent, show
from .page import write_page

if TYPE_CHECKING:
    from .communication import Machine
    from .ranks import Memory

Rows = Sequence[Mapping[str, Any]]
KINDS = {"one": "one large solid", "many": "many, a rank each", "mixed": "groups of two ranks"}
HOW = (
    "Efficiency is the time of one rank (or one group, with its share of the cases) over that of "
    "all, divided by how many times more ranks there are where the work is the same. Jobs run in "
    "turn, then all again; the least time of each counts. “Whole” is from before the first mesh to "
    "the last result, “march” the slowest group's time steps.",
    "What memory allows: a solve with a factor that no cache holds, on one rank while the others "
    "wait, over the same on all ranks at once. Nothing is sent, so what is lost is the memory's.",
    "Predicted: local work in the bytes that it reads, waiting in messages, with the rates "
    "measured here (studies/bench/communication.py).",
)


def page(
    rows: Rows,
    machine: Machine,
    memory: Memory,
    predicted: Sequence[Mapping[str, float]],
    out: Path,
    repeats: int,
    about: Sequence[tuple[str, str]],
    most: int | None = None,
) -> None:
    """Write report.html with its figures and tables into ``out``; ``about`` is the machine, and
    ``most`` ranks were asked for, if any."""
    measured = Figure(
        "efficiency",
        "Efficiency of the march and of the whole job. Dashed: what is asked for; dotted: what "
        "memory allows ranks that only read their factors.",
        picture(efficiency_figure(rows)),
        "Bars of efficiency for every job on more than one rank or group",
        _table(rows),
    )
    ends = Figure(
        "scaling",
        "Up to how many ranks one solid is predicted to be shared with an efficiency of 85 % and "
        "of 50 %, by its unknowns.",
        picture(scaling_figure(predicted)),
        "Two lines of ranks that rise with the number of unknowns",
        _predictions(predicted),
    )
    write_page(
        out,
        title="What more ranks gain",
        lead="One large solid over ranks, many of them dealt out, and groups of ranks.",
        command=("ranks", "--repeats", repeats, *(() if most is None else ("--most", most))),
        headline=[_sentence(row) for row in rows if not _base(row)],
        facts=[*about, *_facts(machine, memory)],
        sections=[
            Section("efficiency", "Measured", figures=[measured]),
            Section("scaling", "Where scaling ends", figures=[ends]),
        ],
        how=HOW,
    )


def _base(row: Mapping[str, Any]) -> bool:
    """Whether others of its kind are held against this job."""
    return bool(row["ranks"] == (row["ranks_per_case"] if row["kind"] == "mixed" else 1))


def _sentence(row: Mapping[str, Any]) -> str:
    bound = row["memory_allows"]
    allowed = "" if bound is None else f", memory allows {percent(bound, 0)}"
    busy = "; more ranks than cores" if row["oversubscribed"] else ""
    return (
        f"{KINDS[row['kind']].capitalize()} on {row['ranks']} ranks: efficiency "
        f"{percent(row['efficiency_march'], 0)} of the march, {percent(row['efficiency'], 0)} of "
        f"the whole (asked for {percent(row['goal'], 0)}{allowed}{busy})."
    )


def _facts(machine: Machine, memory: Memory) -> list[tuple[str, str]]:
    def rates(alone: float, together: float) -> str:
        return f"{show(alone / 1e9, 3)} GB/s alone, {show(together / 1e9, 3)} a rank together"

    return [
        ("A message", f"{show(1e6 * machine.latency_s, 3)} µs between two ranks"),
        ("A rank reads memory", rates(memory.memory_alone_B_s, memory.memory_B_s)),
        ("A rank reads a factor", rates(memory.solve_alone_B_s, memory.solve_B_s)),
    ]


def _table(rows: Rows) -> Table:
    columns = (
        Column("kind", "Kind"),
        Column("ranks", "Ranks", digits=0),
        Column("ranks_per_case", "A case", digits=0),
        Column("cases", "Cases", digits=0),
        Column("total_s", "Whole", "s", 3),
        Column("march_s", "March", "s", 3),
        Column("efficiency", "Efficiency", digits=3),
        Column("efficiency_march", "of the march", digits=3),
        Column("goal", "Goal", digits=3),
        Column("memory_allows", "Memory allows", digits=3),
        Column("oversubscribed", "More ranks than cores"),
    )
    table = [[row[column.key] for column in columns] for row in rows]
    return Table("ranks", "Every job", columns, table, "Efficiencies are parts of one.")


def _predictions(predicted: Sequence[Mapping[str, float]]) -> Table:
    columns = (
        Column("unknowns", "Unknowns", digits=0),
        Column("step_s", "A step on one rank", "s", 3),
        Column("cut_B", "A cut", "B", 3),
        Column("ranks_at_85", "85 % to", "ranks", 0),
        Column("ranks_at_50", "50 % to", "ranks", 0),
    )
    rows = [[each[column.key] for column in columns] for each in predicted]
    return Table("predicted", "What the model of communication predicts", columns, rows)


@styled
def efficiency_figure(rows: Rows) -> Drawing:
    """Two bars a job, with lines at its goal and at what memory allows."""
    shown = [row for row in rows if not _base(row)]
    figure, axes = panels(height_in=1.6 + 0.6 * len(shown))
    ax = axes[0, 0]
    looks = (("efficiency_march", "march", BLUE, ""), ("efficiency", "whole", ORANGE, "//"))
    for number, (key, label, colour, hatch) in enumerate(looks):
        places = np.arange(len(shown)) + 0.36 * (number - 0.5)
        values = [100.0 * row[key] for row in shown]
        look = {"color": colour, "hatch": hatch, "edgecolor": "white"}
        ax.barh(places, values, height=0.34, label=label, **look)
    for place, row in enumerate(shown):
        for key, colour, style in (("goal", BLACK, "--"), ("memory_allows", VERMILION, ":")):
            if row[key] is not None:
                ends = [place - 0.42, place + 0.42]
                ax.plot([100.0 * row[key]] * 2, ends, color=colour, ls=style, lw=1.4)
    ax.plot([], [], color=BLACK, ls="--", lw=1.4, label="asked for")
    ax.plot([], [], color=VERMILION, ls=":", lw=1.4, label="memory allows")
    names = [_job(row) for row in shown]
    ax.set_yticks(range(len(shown)), names, fontsize=SMALLEST)
    ax.set(xlabel="efficiency (%)", xlim=(0, 110), ylim=(len(shown) - 0.5, -0.5))
    figure.legend(loc="outside lower center", ncols=2)
    return figure


def _job(row: Mapping[str, Any]) -> str:
    crowded = "\n(more than cores)" if row["oversubscribed"] else ""
    return f"{KINDS[row['kind']]},\n{row['ranks']} ranks{crowded}"


@styled
def scaling_figure(predicted: Sequence[Mapping[str, float]]) -> Drawing:
    """Ranks at which efficiency falls under each share, against unknowns."""
    figure, axes = panels(height_in=3.0)
    ax = axes[0, 0]
    for number, share in enumerate((85, 50)):
        ranks = [each[f"ranks_at_{share}"] for each in predicted]
        look = {"color": SERIES[number], "marker": MARKERS[number]}
        ax.plot([each["unknowns"] for each in predicted], ranks, label=f"{share} %", **look)
    ax.set(xscale="log", yscale="log", xlabel="unknowns", ylabel="ranks")
    plain_ticks(ax)
    ax.legend(title="efficiency")
    return figure
