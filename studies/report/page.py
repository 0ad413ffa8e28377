"""Tables, figures and comparisons as one page that stands alone.

A `Report` holds plain data; `render_report` turns it into HTML with pictures, styles and the
tables' CSV inside, so that the one file can be sent, printed, or read on a phone. A table comes
from records or a frame by the names of their columns: a name ends in the unit, and `column` has
what heads it. Words of sections stand in templates (`prose`).
"""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Protocol, Self

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from .. import __version__
from ..running.files import remove, to_csv, together, write_atomically
from .figures import Picture, inline_svg, write_picture

# All that `write_report` writes.
PAGE_FILE, TABLES, FIGURES = "report.html", "tables", "figures"
REPORT_FILES = (PAGE_FILE, f"{TABLES}/", f"{FIGURES}/")
TEMPLATES = Path(__file__).parent / "templates"
ROWS_SHOWN = 120
# Below it a number, such as the p-value of a far tail, is rounding.
LEAST = 1e-300
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


# What a name may end in, and how a reader has it.
UNITS = {"MN_m": "MN/m", "N_m": "N/m", "mm": "mm", "um": "µm", "us": "µs", "ms": "ms"}
UNITS |= {"N": "N", "m": "m", "s": "s", "deg": "°", "sigma": "σ"}
# Columns of many tables that are headed otherwise than their names say. Inputs are shown as short
# as they are.
USUAL: dict[str, tuple[str, str, int]] = {
    "kn_MN_m": ("Kn", "MN/m", 0),
    "kn_N_m": ("Kn", "N/m", 4),
    "y0_mm": ("y0", "mm", 0),
    "its_ms": ("ITS", "ms", 0),
    "its_s": ("ITS", "s", 0),
    "beta_s": ("β", "s", 0),
    "lean_deg": ("lean", "°", 0),
    "mu": ("μ", "", 0),
    "rebound_ratio": ("y1/y0", "", 4),
    "low": ("90 % from", "", 4),
    "high": ("to", "", 4),
    "impulse_ratio": ("friction over normal impulse", "", 3),
    "friction_loss": ("lost to friction", "of the energy", 2),
}
Head = str | tuple[str] | tuple[str, str] | tuple[str, str, int]


def column(key: str, head: Head | None = None) -> Column:
    """The column named ``key``.

    ``head`` is what heads it, or that, its unit and its digits; where these are not given they are
    the `USUAL` ones, else the words and the unit that the key is made of, and four digits.
    """
    given = (head,) if isinstance(head, str) else (head or ())
    ending = next((each for each in UNITS if key.endswith(f"_{each}")), "")
    own = key.removesuffix(f"_{ending}").replace("_", " "), UNITS.get(ending, ""), 4
    usual = USUAL.get(key, own)
    return Column(key, *given, *usual[len(given) :])


class Frame(Protocol):
    """Values by the name of their column: a mapping of iterables, or pandas' data frame."""

    def items(self) -> Iterable[tuple[Any, Any]]: ...


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
    def of(
        cls,
        name: str,
        caption: str,
        frame: Frame,
        heads: Mapping[str, Head] | None = None,
        note: str = "",
    ) -> Self:
        """A table of ``frame``'s columns, headed as `column` has it of their names and ``heads``.

        Values are arrays (rows,) or other iterables of that length; NaN is a value that is missing.
        """
        named = heads or {}
        columns = tuple(column(str(key), named.get(key)) for key, _ in frame.items())
        values = (
            each.tolist() if hasattr(each, "tolist") else list(each) for _, each in frame.items()
        )
        rows = [
            tuple(None if isinstance(x, float) and math.isnan(x) else x for x in row)
            for row in zip(*values, strict=True)
        ]
        return cls(name, caption, columns, rows, note)

    def csv_text(self) -> str:
        """The table as CSV, numbers in full precision, what is missing left empty."""
        keys = [column.key for column in self.columns]
        return to_csv(keys, [[_plain(value) for value in row] for row in self.rows])

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

    @classmethod
    def of(cls, agrees: bool) -> Verdict:
        return cls.AGREES if agrees else cls.DIFFERS


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


@dataclass
class Section:
    """A heading with text, comparisons, figures and tables, and the command that makes them.

    ``headline`` is its sentence for the top of the page.
    """

    ident: str
    title: str
    text: Sequence[str] = ()
    comparisons: list[Comparison] = field(default_factory=list)
    figures: list[Figure] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
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
    version: str = __version__
    command: str = ""
    headline: Sequence[str] = ()
    facts: Sequence[tuple[str, str]] = ()
    sections: Sequence[Section] = ()
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
    if 0.0 < value <= LEAST:
        return "< 10^−300"
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


def _plain(value: Value) -> Value:
    """A value for a CSV: a spreadsheet computes no text."""
    if isinstance(value, bool):
        return str(value).lower()
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA) else value


def _powers(text: str) -> Markup:
    """Escaped text with 10^n set as a power."""
    escaped = str(Markup.escape(text))
    return Markup(re.sub(r"10\^(−?\d+)", r"10<sup>\1</sup>", escaped))


def environment(
    folder: Path, filters: Mapping[str, Callable[..., Any]], **more: Any
) -> Environment:
    """Templates of a folder, which may use nothing that they are not given."""
    made = Environment(
        loader=FileSystemLoader(folder),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        **more,
    )
    made.filters |= filters
    return made


def render_report(report: Report) -> str:
    """The whole page as HTML; everything that is not ours to mark up is escaped."""
    report.tables()
    style = Markup((TEMPLATES / "style.css").read_text(encoding="utf-8"))
    filters: dict[str, Callable[..., Any]] = {
        "show": lambda value, digits: _powers(show(value, digits)),
        "powers": _powers,
    }
    template = environment(TEMPLATES, filters, autoescape=True).get_template("report.html.j2")
    return template.render(report=report, style=style, rows_shown=ROWS_SHOWN).lstrip() + "\n"


def write_report(report: Report, folder: Path) -> Path:
    """Write ``report.html``, its tables as ``tables/*.csv``, its figures as ``figures/*.svg|png``.

    All replace those of an older page together, the page last.
    """
    page, path = render_report(report), folder / PAGE_FILE
    with together(folder, path.name):
        remove(folder / TABLES, folder / FIGURES)
        for table in report.tables():
            write_atomically(folder / TABLES / f"{table.name}.csv", table.csv_text())
        for figure in (figure for section in report.sections for figure in section.figures):
            write_picture(folder / FIGURES / figure.name, figure.picture)
        write_atomically(path, page)
    return path
