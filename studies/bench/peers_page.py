"""What does the page of the comparison of programs show?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure as Drawing

from ..report.figures import GREY, MARKERS, SERIES, panels, picture, plain_ticks, styled
from ..report.page import Column, Figure, Section, Table, Value, percent, show
from .page import write_page
from .peers_table import LEVELS, Converged, Point, Run, blocks, by_program, reached
from .peers_text import absences, cells_words, time_words, unsure_words
from .programs import PROGRAMS, QUANTITIES

TITLES = {
    "damped": "With the paper's damping",
    "undamped": "Without damping",
}
HOW = (
    "One impact: the paper's bristle falls upright from 50 mm on Kn = 2 MN/m. Programs of solids "
    "share the mesh (quadratic hexahedra; CalculiX has 20 nodes in a cell, the others 27); the "
    "beam has 16 elements. All march with the average acceleration; this program alone takes the "
    "contact force so that energy is conserved. CalculiX cuts its steps where contact changes.",
    "Every call is a process of its own, on one thread and with nothing else running: each program "
    "in turn, then all again. Time is that of the whole process, from its start to its end: the "
    "median of the repeats. Memory is the kernel's peak of the process. What is compiled once and "
    "kept was compiled before.",
    "“A further drop” is what one more costs: for this program in a process that has made one, for "
    "the others all but the interpreter's start, as they keep nothing.",
    "y1/y0 is that of the centre of mass here: without damping the tip still rings at its top.",
)


def page(
    found: Sequence[Point],
    to: dict[str, Converged],
    runs: Sequence[Run],
    out: Path,
    repeats: int,
    about: Sequence[tuple[str, str]],
) -> None:
    """Write report.html with its figures and tables into ``out``; ``about`` is the machine."""
    sections = [_section(to[own[0].setting.physics.name], own) for own in blocks(found)]
    write_page(
        out,
        title="This program beside others",
        lead="Time, memory and error of programs that compute the same impact.",
        command=("peers", "--repeats", repeats),
        headline=_headline(found),
        facts=about,
        sections=sections,
        how=(*HOW, *absences(runs)),
    )


def _headline(found: Sequence[Point]) -> list[str]:
    """Seconds to 0.1 % of every program that comes so near, block by block."""
    sentences = []
    for own in blocks(found):
        times = {
            program: reached(points, LEVELS[-1]) for program, points in by_program(own).items()
        }
        said = [f"{name} {time_words(each)} s" for name, each in times.items() if each.time_s]
        if said:
            sentences.append(
                f"{_title(own)}: time to {_level(LEVELS[-1])} in y1/y0: {'; '.join(said)}."
            )
    return sentences


def _level(level: float) -> str:
    return percent(level, 0 if level >= 1e-2 else 1)


def _title(own: Sequence[Point]) -> str:
    return f"{TITLES[own[0].setting.physics.name]}, {cells_words(own)}"


def _section(value: Converged, own: Sequence[Point]) -> Section:
    setting = own[0].setting
    name = f"{setting.physics.name}-{'x'.join(map(str, setting.cells))}"
    ratio, contact, peak = (value.values[key] for key in QUANTITIES)
    unsure = ", ".join(show(100.0 * value.unsure[key], 2) for key in QUANTITIES)
    text = (
        f"Converged: y1/y0 = {show(ratio, 6)}, contact time {show(1e6 * contact, 6)} µs, peak "
        f"force {show(peak, 6)} N; by Richardson's extrapolation of this program's reduced solid "
        f"to no ITS, on the finest mesh. Sure to {unsure} %: {unsure_words(value)}.",
    )
    data = _points(name, own)
    drawn = Figure(
        f"precision-{name}",
        "Error of y1/y0 against time, one point for each ITS: of the whole process, and of a "
        "further drop. Lines are 1 % and 0.1 %; within the grey band, where there is one, the "
        "converged value is not sure.",
        picture(precision_figure(own, value.unsure[QUANTITIES[0]])),
        "Error of y1/y0 against time",
        data,
    )
    return Section(name, _title(own), text, (), [drawn], [_equal(name, own)])


def _points(name: str, own: Sequence[Point]) -> Table:
    columns = (
        Column("program", "Program"),
        Column("its_us", "ITS", "µs", 0),
        Column("n_steps", "Steps", digits=0),
        Column("rebound_ratio", "y1/y0", digits=5),
        Column("rebound_ratio_error", "error", "%", 2),
        Column("contact_time_us", "Contact", "µs", 6),
        Column("contact_time_error", "error", "%", 2),
        Column("peak_force_N", "Peak", "N", 5),
        Column("peak_force_error", "error", "%", 2),
        Column("wall_s", "Time", "s", 3),
        Column("wall_low_s", "least", "s", 3),
        Column("wall_high_s", "most", "s", 3),
        Column("further_s", "A further drop", "s", 2),
        Column("peak_rss_MB", "Memory", "MB", 3),
    )
    rows: list[list[Value]] = [
        [
            point.program,
            1e6 * point.setting.its_s,
            int(point.found["n_steps"]),
            *_with_error(point, QUANTITIES[0], 1.0),
            *_with_error(point, QUANTITIES[1], 1e6),
            *_with_error(point, QUANTITIES[2], 1.0),
            *(point.wall_s, point.wall_low_s, point.wall_high_s),
            *(point.further_s, point.peak_rss_MB),
        ]
        for points in by_program(own).values()
        for point in points
    ]
    repeats = max((point.repeats for point in own), default=0)
    note = f"Time: median of {repeats}, with the least and the most."
    return Table(f"points-{name}", "Every program at every ITS", columns, rows, note)


def _with_error(point: Point, quantity: str, scale: float) -> list[float]:
    return [scale * point.found[quantity], 100.0 * point.errors[quantity]]


def _equal(name: str, own: Sequence[Point]) -> Table:
    whole = [
        Column(f"to_{100 * level:g}_percent_s", f"To {_level(level)}", "s") for level in LEVELS
    ]
    further = [
        Column(f"further_to_{100 * level:g}_percent_s", f"further, to {_level(level)}", "s")
        for level in LEVELS
    ]
    rows: list[list[Value]] = [
        [
            program,
            *(time_words(reached(points, level)) for level in LEVELS),
            *(time_words(reached(points, level, further=True)) for level in LEVELS),
        ]
        for program, points in by_program(own).items()
    ]
    columns = (Column("program", "Program"), *whole, *further)
    note = (
        "Error in y1/y0; between two ITS along a straight line of logarithms; – where no ITS of "
        "the list came so near."
    )
    return Table(f"equal-{name}", "Time at equal error", columns, rows, note)


@styled
def precision_figure(own: Sequence[Point], unsure: float) -> Drawing:
    """Error of y1/y0 against the time of a process and of a further drop, one line a program."""
    figure, axes = panels(columns=2, height_in=3.6, sharey=True)
    number = [program.name for program in PROGRAMS].index
    for name, points in by_program(own).items():
        errors = [100.0 * point.errors[QUANTITIES[0]] for point in points]
        look = {"color": SERIES[number(name) % len(SERIES)], "lw": 0.8}
        look["marker"] = MARKERS[number(name) % len(MARKERS)]
        axes[0, 0].plot([point.wall_s for point in points], errors, label=name, **look)
        axes[0, 1].plot([point.further_s or math.nan for point in points], errors, **look)
    for ax, title in zip(axes[0], ("whole process", "a further drop"), strict=True):
        ax.set(xscale="log", yscale="log", title=title, xlabel="time (s)")
        for level in LEVELS:
            ax.axhline(100.0 * level, color=GREY, lw=0.6, ls="--", zorder=0)
        low, high = ax.get_ylim()
        if 100.0 * unsure > low:
            ax.axhspan(low, 100.0 * unsure, color=GREY, alpha=0.15, lw=0)
        ax.set_ylim(low, high)
        plain_ticks(ax)
    axes[0, 0].set_ylabel("error of y1/y0 (%)")
    figure.legend(loc="outside lower center", ncols=3)
    return figure
