"""Records of a benchmark: dataclasses whose fields have their columns, and the one page of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from bristle.studies import __version__
from bristle.studies.inputs.sources import into
from bristle.studies.report.figures import (
    MARKERS,
    SERIES,
    panels,
    picture,
    styled,
)
from bristle.studies.report.page import (
    REPORT_FILES,
    Column,
    Figure,
    Report,
    Section,
    Table,
    show,
    write_report,
)
from bristle.studies.running.files import (
    prepare_folder,
    to_csv,
    together,
    write_atomically,
    write_json,
)

from .machine import facts, load

# Values along x and y by the name of a curve.
Curves = Mapping[str, tuple[Sequence[float], Sequence[float]]]


@dataclass(frozen=True)
class Part:
    """A part of a page: records with `column` fields, and the curves drawn from them, if any."""

    ident: str
    title: str
    records: Sequence[Any]
    drawn: Drawing | None = None
    caption: str = ""
    text: Sequence[str] = ()
    note: str = ""

    def table(self) -> Table:
        """A row a record."""
        columns = tuple(
            Column(each.name, *each.metadata["column"])
            for each in (fields(self.records[0]) if self.records else ())
            if "column" in each.metadata
        )
        rows = [[getattr(record, each.key) for each in columns] for record in self.records]
        return Table(self.ident, self.title, columns, rows, self.note)

    def section(self) -> Section:
        """As the page has it."""
        table = self.table()
        if self.drawn is None or not self.records:
            return Section(self.ident, self.title, self.text, tables=[table])
        drawn = Figure(self.ident, self.caption, picture(self.drawn), self.caption, table)
        return Section(self.ident, self.title, self.text, figures=[drawn])

    def lines(self) -> list[str]:
        """As a terminal has it."""
        if not self.records:
            return [self.title, *(f"  {line}" for line in self.text), ""]
        table = self.table()
        heads = [[each.head for each in table.columns], [each.unit for each in table.columns]]
        cells = [
            [show(value, each.digits) for value, each in zip(row, table.columns, strict=True)]
            for row in table.rows
        ]
        widths = [max(map(len, words)) for words in zip(*heads, *cells, strict=True)]
        rows = [
            "  ".join(
                [row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])],
            ).rstrip()
            for row in (*heads, *cells)
        ]
        return [self.title, *(f"  {line}" for line in (*rows, *self.text)), ""]


def prepare(name: str, out: Path) -> list[tuple[str, str]]:
    """Make ``out`` ready for what `publish` writes, and ask what the machine is; InputError where
    ``out`` cannot be used."""
    prepare_folder(out, f"{name}.csv", f"{name}.json", *REPORT_FILES)
    return [load(), *facts()]


def publish(
    name: str,
    parts: Sequence[Part],
    out: Path,
    *,
    title: str,
    command: Sequence[object],
    headline: Sequence[str],
    about: Sequence[tuple[str, str]],
    how: Sequence[str],
    further: Mapping[str, Any] | None = None,
) -> str:
    """Write NAME.csv of the first part and those like it, NAME.json and report.html; the tables and
    the ``headline`` as text.

    ``command`` has the words after ``bristle bench``; ``about`` is the machine; ``further`` goes
    into the JSON.
    """
    report = Report(
        title=title,
        lead=how[0],
        version=__version__,
        command=into(out, "bench", *command),
        headline=headline,
        facts=about,
        sections=[*(part.section() for part in parts), Section("how", "How it was measured", how)],
    )
    document = {
        **{part.ident: [asdict(record) for record in part.records] for part in parts},
        **(further or {}),
    }
    with together(out, f"{name}.json"):
        if parts and parts[0].records:
            kind = type(parts[0].records[0])
            alike = [each for part in parts for each in part.records if type(each) is kind]
            names = [each.name for each in fields(kind)]
            rows = [[getattr(record, column) for column in names] for record in alike]
            write_atomically(out / f"{name}.csv", to_csv(names, rows))
        write_json(out / f"{name}.json", document)
        write_report(report, out)
    told = [line for part in parts for line in part.lines()]
    return "\n".join([*told, *headline, f"{'page':<24}{out / 'report.html'}"])


@styled
def curves_figure(
    x_label: str, by_panel: Mapping[str, Curves], levels: Sequence[float] = ()
) -> Drawing:
    """A panel for each label of y, logarithmic both ways, with dashed lines at ``levels``."""
    figure, axes = panels(columns=len(by_panel), height_in=3.6)
    names = list(dict.fromkeys(name for curves in by_panel.values() for name in curves))
    for ax, (label, curves) in zip(axes[0], by_panel.items(), strict=True):
        for name, (x, y) in curves.items():
            number = names.index(name)
            look = {"color": SERIES[number % len(SERIES)], "lw": 0.8}
            ax.plot(x, y, marker=MARKERS[number % len(MARKERS)], label=name, **look)
        for level in levels:
            ax.axhline(level, color="grey", lw=0.6, ls="--", zorder=0)
        ax.set(xscale="log", yscale="log", xlabel=x_label, ylabel=label)
        _plain_ticks(ax)
    handles: dict[str, Any] = {}
    for ax in axes[0]:
        handles |= {text: each for each, text in zip(*ax.get_legend_handles_labels(), strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=3)
    return figure


def _plain_ticks(axes: Axes) -> None:
    """Numbers without powers on logarithmic axes: at 1, 2 and 5 of a decade, or at 1 of many."""
    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 100.0 * low else (1.0,)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_locator(NullLocator())
