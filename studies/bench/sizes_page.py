"""What does the page of growth with size show?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

from ..report.figures import MARKERS, SERIES, panels, picture, plain_ticks, styled
from ..report.page import Column, Figure, Section, Table, Value, show
from .page import write_page

if TYPE_CHECKING:
    from .sizes import Line

PARTS = {
    "factor_s": "before the first step (s)",
    "step_s": "a step (s)",
    "peak_MB": "memory (MB)",
}
HOW = (
    "Each size is a process of its own on one rank and one thread, so that its greatest memory is "
    "its own; a step is the least of its repeats. Memory per unknown is what the process grew by "
    "since before the mesh.",
    "Along: the paper's bristle, divided ever finer along its axis. All ways: along and across it. "
    "Compact: a cube, directly and iteratively.",
    "A step of a cube, and one under conjugate gradients, is the solve alone.",
    "Before the first step: factor, compliance of the contact points, and what else a march needs.",
)


def page(
    lines: Sequence[Line],
    exponents: Mapping[str, Mapping[str, float]],
    failed: Sequence[str],
    out: Path,
    largest: int,
    about: Sequence[tuple[str, str]],
) -> None:
    """Write report.html with its figure and tables into ``out``; ``about`` is the machine."""
    drawn = Figure(
        "sizes",
        "Time before the first step, time of a step, and the process' greatest memory against the "
        "number of unknowns, by series and method.",
        picture(sizes_figure(lines)),
        "Three panels of lines that rise with the number of unknowns",
        _table(lines),
    )
    text = [f"Not done: {each}." for each in failed]
    grown = [_growth(exponents)] if exponents else []
    write_page(
        out,
        title="Time and memory against size",
        lead="The solid at full order, from small to large.",
        command=("sizes", "--largest", largest),
        headline=[_sentence(name, found) for name, found in exponents.items()],
        facts=about,
        sections=[
            Section("sizes", "Sizes", text, figures=[drawn] if lines else [], tables=grown),
        ],
        how=HOW,
    )


def _sentence(name: str, found: Mapping[str, float]) -> str:
    return (
        f"{name.capitalize()}: a step grows with the unknowns to the power "
        f"{show(found['step_s'], 3)}, the factor {show(found['factor_s'], 3)}, memory "
        f"{show(found['peak_MB'], 3)}."
    )


def _table(lines: Sequence[Line]) -> Table:
    columns = (
        Column("series", "Series"),
        Column("cells", "Cells"),
        Column("unknowns", "Unknowns", digits=0),
        Column("method", "Method"),
        Column("mesh_s", "Mesh", "s", 3),
        Column("assemble_s", "Assembly", "s", 3),
        Column("factor_s", "Factor", "s", 3),
        Column("step_s", "Step", "s", 3),
        Column("iterations", "Iterations", digits=0),
        Column("bytes_per_unknown", "Per unknown", "bytes", 3),
        Column("peak_MB", "Memory", "MB", 3),
    )
    rows = [[getattr(line, column.key) for column in columns] for line in lines]
    return Table("sizes", "Every size", columns, rows)


def _growth(exponents: Mapping[str, Mapping[str, float]]) -> Table:
    parts = list(next(iter(exponents.values())))
    heads = (Column(part, part.split("_")[0].capitalize(), digits=3) for part in parts)
    rows: list[list[Value]] = [
        [name, *(found[part] for part in parts)] for name, found in exponents.items()
    ]
    return Table(
        "exponents",
        "Exponents of growth",
        (Column("series", "Series and method"), *heads),
        rows,
        "By least squares of logarithms over three sizes or more; memory without what a process "
        "has from its start.",
    )


@styled
def sizes_figure(lines: Sequence[Line]) -> Drawing:
    """Each part against unknowns, a line for each series and method."""
    figure, axes = panels(rows=2, columns=2, height_in=5.0)
    names = list(dict.fromkeys((line.series, line.method) for line in lines))
    places: list[Axes] = list(axes.ravel()[: len(PARTS)])
    for number, name in enumerate(names):
        own = sorted(
            (line for line in lines if (line.series, line.method) == name),
            key=lambda line: line.unknowns,
        )
        look: dict[str, Any] = {"color": SERIES[number % len(SERIES)]}
        look["marker"] = MARKERS[number % len(MARKERS)]
        for ax, part in zip(places, PARTS, strict=True):
            values = [getattr(line, part) for line in own]
            ax.plot([line.unknowns for line in own], values, label=", ".join(name), **look)
    for ax, label in zip(places, PARTS.values(), strict=True):
        ax.set(xscale="log", yscale="log", xlabel="unknowns", ylabel=label)
        plain_ticks(ax)
    axes[1, 1].axis("off")
    axes[1, 1].legend(*places[0].get_legend_handles_labels(), loc="center")
    return figure
