"""Tables, figures and comparisons as one page that stands alone.

A `Report` holds plain data; `render_report` turns it into HTML with pictures, styles and the
tables' CSV inside, so that the one file can be sent, printed, or read on a phone.
"""

from __future__ import annotations

import base64
import csv
import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Self

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from ..running.files import together, write_atomically
from .figures import Picture, inline_svg, write_picture

TEMPLATES = Path(__file__).parent / "templates"
ROWS_SHOWN = 120
# How a text begins that a spreadsheet would compute.
FORMULA = ("=", "+", "-", "@", "\t", "\r")

Value = float | int | str | bool | None


@dataclass(frozen=True)
class Column:
    """A column of a table: its ``key`` heads the CSV, ``head`` and ``unit`` head the page's table.

    Numbers are shown with ``digits`` significant digits, or as short as they are where it is 0;
    the CSV keeps all of them.
    """

    key: str
    head: str
    unit: str = ""
    digits: int = 4


# Columns with their values, from the first row to the last.
Columns = Mapping[Column, Iterable[Any]]


@dataclass(frozen=True)
class Table:
    """Rows of values under columns; ``name`` is that of its CSV file."""

    name: str
    caption: str
    columns: tuple[Column, ...]
    rows: Sequence[Sequence[Value]]
    note: str = ""

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z0-9_-]+", self.name):
            raise ValueError(f"a table's name is made of a-z, 0-9, - and _, not {self.name!r}")
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(
                    f"{self.name}: {len(row)} values under {len(self.columns)} columns"
                )

    @classmethod
    def of(cls, name: str, caption: str, columns: Columns, note: str = "") -> Self:
        """A table by its columns; values are arrays (rows,) or other iterables of that length."""
        values = [
            each.tolist() if isinstance(each, np.ndarray) else list(each)
            for each in columns.values()
        ]
        return cls(name, caption, tuple(columns), list(zip(*values, strict=True)), note)

    def csv_text(self) -> str:
        """The table as CSV, numbers in full precision, what is missing left empty."""
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(column.key for column in self.columns)
        writer.writerows([_plain(value) for value in row] for row in self.rows)
        return stream.getvalue()

    def data_uri(self) -> str:
        """The CSV as an address that needs no other file."""
        return "data:text/csv;base64," + base64.b64encode(self.csv_text().encode()).decode()


@dataclass(frozen=True)
class Figure:
    """A picture with the table that it was drawn from; ``name`` is that of its files.

    ``alt`` says what is to be seen to who cannot see it.
    """

    name: str
    caption: str
    picture: Picture
    alt: str
    data: Table

    def inline(self) -> Markup:
        """The picture as an element of the page."""
        return Markup(inline_svg(self.picture.svg, f"f-{self.name}", self.alt))


class Verdict(StrEnum):
    """What comes of setting a number of the paper beside ours."""

    AGREES = "agrees"
    DIFFERS = "differs"
    OPEN = "cannot be compared"


@dataclass(frozen=True)
class Comparison:
    """One quantity: what the paper has and where, what our 1-D and 3-D models give."""

    quantity: str
    place: str
    paper: str
    ours_1d: str
    ours_3d: str
    difference: str
    verdict: Verdict
    remark: str = ""


@dataclass(frozen=True)
class Section:
    """A heading with text, comparisons, figures and tables, and the command that makes them.

    ``headline`` is its sentence for the top of the page.
    """

    ident: str
    title: str
    text: Sequence[str] = ()
    comparisons: Sequence[Comparison] = ()
    figures: Sequence[Figure] = ()
    tables: Sequence[Table] = ()
    command: str = ""
    headline: str = ""


@dataclass(frozen=True)
class Report:
    """A page: what was run, what came of it, and the sections.

    ``facts`` are (name, value) pairs on the run itself; ``headline`` is a list of sentences, the
    most important first.
    """

    title: str
    lead: str
    version: str
    command: str
    headline: Sequence[str] = ()
    facts: Sequence[tuple[str, str]] = ()
    sections: Sequence[Section] = ()
    licence_note: str = ""
    differences: Sequence[str] = field(default_factory=tuple)

    @property
    def comparisons(self) -> list[Comparison]:
        return [each for section in self.sections for each in section.comparisons]

    def tables(self) -> list[Table]:
        """Every table of the page, those behind figures included, each once."""
        found: dict[str, Table] = {}
        for section in self.sections:
            behind = [figure.data for figure in section.figures]
            for table in (*section.tables, *behind):
                if found.setdefault(table.name, table) is not table:
                    raise ValueError(f"two tables are named {table.name}")
        return list(found.values())


def show(value: Value, digits: int = 4) -> str:
    """A value as a reader wants it: significant digits, a true minus, a dash for nothing."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return str(value).replace("-", "−")
    if isinstance(value, str):
        return value
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if digits == 0:
        return f"{value:g}".replace("-", "−")
    if value != 0.0 and not 1e-3 <= abs(value) < 10 ** max(digits, 5):
        mantissa, exponent = f"{value:.{max(digits - 1, 0)}e}".split("e")
        return f"{mantissa}·10^{int(exponent)}".replace("-", "−")
    decimals = digits - 1 - (math.floor(math.log10(abs(value))) if value else 0)
    return f"{value:.{max(decimals, 0)}f}".replace("-", "−")


def percent(share: float, decimals: int = 1, signed: bool = False) -> str:
    """A share as a reader wants it, such as ``19.4 %``; a difference is ``signed``, zero is not."""
    text = f"{100.0 * share:{'+' if signed else ''}.{decimals}f}"
    text = text.lstrip("+-") if not text.strip("+-0.") else text
    return f"{text}\u00a0%".replace("-", "−")


def _plain(value: Value) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f"'{value}" if value.startswith(FORMULA) else value
    return repr(value) if isinstance(value, float) else str(value)


def _powers(text: str) -> Markup:
    """Escaped text with 10^n set as a power."""
    escaped = str(Markup.escape(text))
    return Markup(re.sub(r"10\^(−?\d+)", r"10<sup>\1</sup>", escaped))


def _is_number(value: Value) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["show"] = lambda value, digits: _powers(show(value, digits))
    environment.filters["powers"] = _powers
    environment.filters["plain"] = _plain
    environment.filters["is_number"] = lambda v: (
        isinstance(v, int | float) and not isinstance(v, bool)
    )
    return environment


def render_report(report: Report) -> str:
    """The whole page as HTML; everything that is not ours to mark up is escaped."""
    report.tables()
    environment = _environment()
    style = Markup((TEMPLATES / "style.css").read_text(encoding="utf-8"))
    template = environment.get_template("report.html.j2")
    return template.render(report=report, style=style, rows_shown=ROWS_SHOWN).lstrip() + "\n"


def write_report(report: Report, folder: Path) -> Path:
    """Write ``report.html``, its tables as ``tables/*.csv``, its figures as ``figures/*.svg|png``.

    All replace older ones together, the page last.
    """
    page, path = render_report(report), folder / "report.html"
    with together(folder, path.name):
        for table in report.tables():
            write_atomically(folder / "tables" / f"{table.name}.csv", table.csv_text())
        for figure in (figure for section in report.sections for figure in section.figures):
            write_picture(folder / "figures" / figure.name, figure.picture)
        write_atomically(path, page)
    return path
