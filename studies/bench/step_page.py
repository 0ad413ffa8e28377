"""What does the page of a step's cost show?"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure as Drawing

from ..report.figures import BLACK, GREY, SERIES, SMALLEST, panels, picture, styled
from ..report.page import Column, Figure, Section, Table, show
from .page import write_page

if TYPE_CHECKING:
    from .step import Line

READINGS, SOLVES = 2.0, 1.3
PARTS = {
    "read_ms": "one reading of the factor",
    "solve_ms": "a solve",
    "mass_ms": "a product with M",
    "step_ms": "a step, free",
    "contact_step_ms": "a step in contact",
}
RATIOS = {
    "over_read": ("solve over reading", READINGS),
    "step_over_solve": ("free step over solve", SOLVES),
    "contact_step_over_solve": ("contact step over solve", SOLVES),
}
HATCHES = ("", "//", "..", "xx", "\\\\", "++")
HOW = (
    "One rank, one thread, processor time. Each act is timed in turn, then all again; shown are "
    "medians. The step is that of the paper's drop at its ITS, with the average acceleration.",
    "Reading is the plainest loop over the factor there is, at the speed measured beside it. "
    "Forward and back substitution each need the whole factor, so two readings are the least.",
)


def page(lines: Sequence[Line], out: Path, repeats: int, about: Sequence[tuple[str, str]]) -> None:
    """Write report.html with its figure and table into ``out``; ``about`` is the machine."""
    text = (
        f"Goals: a solve within {READINGS:g} readings of its factor, a step within {SOLVES:g} "
        "solves.",
    )
    drawn = Figure(
        "step",
        "What a step of the full order is made of, for each body (left), and how its parts compare "
        "(right); dashed lines are the goals.",
        picture(step_figure(lines)),
        "Bars of times by body, and of their ratios beside the goals",
        _table(lines),
    )
    write_page(
        out,
        title="What a step costs",
        lead="A time step of the solid at full order, over a solve and over reading memory.",
        command=("step", "--repeats", repeats),
        headline=[_sentence(line) for line in lines],
        facts=about,
        sections=[
            Section("step", "A step and its parts", text, figures=[drawn]),
        ],
        how=HOW,
    )


def _sentence(line: Line) -> str:
    return (
        f"{line.unknowns} unknowns (order {line.order}): a solve takes {show(line.solve_ms, 3)} ms "
        f"or {show(line.over_read, 2)} readings of the factor, a step {show(line.step_over_solve)} "
        f"solves, {show(line.contact_step_over_solve)} in contact."
    )


def _table(lines: Sequence[Line]) -> Table:
    columns = (
        Column("cells", "Cells"),
        Column("order", "Order", digits=0),
        Column("unknowns", "Unknowns", digits=0),
        Column("method", "Factor"),
        Column("factor_entries", "numbers in it", digits=0),
        Column("read_GB_s", "Reading", "GB/s", 3),
        Column("triad_GB_s", "Triad", "GB/s", 3),
        *(Column(key, head.capitalize(), "ms", 3) for key, head in PARTS.items()),
        *(Column(key, head.capitalize(), digits=3) for key, (head, _) in RATIOS.items()),
    )
    rows = [[getattr(line, column.key) for column in columns] for line in lines]
    return Table("step", "Every body", columns, rows)


@styled
def step_figure(lines: Sequence[Line]) -> Drawing:
    """Times of each part of a step, and three ratios with their goals, a bar a body."""
    figure, axes = panels(columns=2, height_in=4.4, width_ratios=(3, 2))
    width = 0.8 / max(len(lines), 1)
    for number, line in enumerate(lines):
        shift = (number - 0.5 * (len(lines) - 1)) * width
        look = {"color": SERIES[number % len(SERIES)], "hatch": HATCHES[number % len(HATCHES)]}
        for ax, keys in zip(axes[0], (tuple(PARTS), tuple(RATIOS)), strict=True):
            places = np.arange(len(keys)) + shift
            values = [getattr(line, key) for key in keys]
            ax.barh(places, values, width, label=_name(line), edgecolor="white", **look)
    names = [head for head, _ in RATIOS.values()], list(PARTS.values())
    for ax, heads in zip(axes[0], reversed(names), strict=True):
        ax.set_yticks(range(len(heads)), [_broken(head) for head in heads], fontsize=SMALLEST)
        ax.set_ylim(len(heads) - 0.5, -0.5)
    for place, (_, goal) in enumerate(RATIOS.values()):
        axes[0, 1].plot([goal, goal], [place - 0.45, place + 0.45], color=BLACK, ls="--", lw=0.9)
    axes[0, 1].axvline(1.0, color=GREY, lw=0.6, zorder=0)
    axes[0, 0].set(xscale="log", xlabel="time (ms)")
    axes[0, 0].xaxis.set_major_formatter("{x:g}")
    axes[0, 1].set(xlabel="ratio")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center")
    return figure


def _name(line: Line) -> str:
    return f"{line.unknowns} unknowns, order {line.order}"


def _broken(head: str) -> str:
    """In two lines where it is long."""
    words = head.split()
    half = (len(words) + 1) // 2
    return head if len(words) < 3 else f"{' '.join(words[:half])}\n{' '.join(words[half:])}"
