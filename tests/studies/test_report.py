"""The page is valid, whole in one file, and true to its tables."""

from __future__ import annotations

import base64
import csv
import io
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from jinja2 import UndefinedError
from web_page import Page

from bristle.studies.close_loop.figures import held_figure
from bristle.studies.report.figures import Picture, panels, picture, spread, styled
from bristle.studies.report.page import (
    Column,
    Comparison,
    Figure,
    Report,
    Section,
    Table,
    Verdict,
    column,
    percent,
    render_report,
    show,
    write_report,
)
from bristle.studies.report.prose import Prose

pytestmark = pytest.mark.serial

NASTY = '<script>alert("1")</script> & Co'


@styled
def _drawing():
    figure, axes = panels()
    axes[0, 0].plot([0, 1], [1, 0], "o-", label="a < b & c")
    axes[0, 0].legend()
    return figure


@pytest.fixture(scope="module")
def report() -> Report:
    table = Table(
        "one",
        NASTY,
        (Column("kn_MN_m", "Kn", "MN/m", 0), Column("ratio", "y1/y0"), Column("why", "Why")),
        [(2.0, 0.123456789, NASTY), (0.01, None, "so"), (1e8, float("inf"), "on")],
    )
    other = Table("two", "Two", (Column("x", "x"),), [(1.0,)])
    figures = [
        Figure(name, "Caption " + NASTY, picture(_drawing()), "Alt " + NASTY, data)
        for name, data in (("a", table), ("b", other))
    ]
    row = Comparison("Kn", "Eq. 8", "2", "2.05", NASTY, "3·10^−4", Verdict.AGREES, NASTY)
    section = Section("s", NASTY, [NASTY], [row], figures, [table], "bristle x")
    return Report("T " + NASTY, NASTY, "0", "bristle y", [NASTY], [("a", NASTY)], [section])


@pytest.fixture(scope="module")
def html(report: Report) -> str:
    return render_report(report)


def test_the_page_is_well_formed_and_escapes_what_it_is_given(html):
    page = Page(html)
    assert html.startswith("<!DOCTYPE html>")
    assert page.open == []
    assert not [tag for tag, _ in page.tags if tag == "script"]
    assert any(NASTY in text for text in page.text)


def test_identifiers_are_unique_and_every_reference_stays_in_the_file(html):
    page = Page(html)
    ids = [attrs["id"] for _, attrs in page.tags if "id" in attrs]
    assert len(ids) == len(set(ids))
    for tag, attrs in page.tags:
        for name in ("href", "src", "xlink:href", "srcset", "data"):
            where = attrs.get(name)
            if where is not None:
                assert where.startswith(("#", "data:")), (tag, where)
                if where.startswith("#"):
                    assert where[1:] in ids
        if "aria-labelledby" in attrs:
            assert attrs["aria-labelledby"] in ids
    assert "@import" not in html
    assert "http" not in html.replace("http-equiv", "")


def test_tables_in_the_page_the_link_and_the_file_hold_the_same_numbers(report, html, tmp_path):
    write_report(report, tmp_path)
    assert (tmp_path / "report.html").read_text() == html
    on_disk = (tmp_path / "tables" / "one.csv").read_text()
    links = [a["href"] for tag, a in Page(html).tags if a.get("download") == "one.csv"]
    assert {base64.b64decode(link.partition(",")[2]).decode() for link in links} == {on_disk}
    rows = list(csv.DictReader(io.StringIO(on_disk)))
    assert [row["kn_MN_m"] for row in rows] == ["2.0", "0.01", "100000000.0"]
    assert rows[1]["ratio"] == ""
    cells = [attrs["value"] for tag, attrs in Page(html).tags if tag == "data"]
    for row in rows:
        assert row["kn_MN_m"] in cells
    assert not list(tmp_path.rglob(".*"))


def test_tables_and_figures_of_an_earlier_page_go_and_what_is_the_users_stays(report, tmp_path):
    (section,) = report.sections
    write_report(report, tmp_path)
    (tmp_path / "tables" / "mine.csv").write_text("the user's")
    (tmp_path / "figures" / "b.svg").write_text("edited by the user")
    shorter = replace(section, figures=section.figures[:1], tables=[])
    write_report(replace(report, sections=[shorter]), tmp_path)
    left = {path.name for folder in ("tables", "figures") for path in (tmp_path / folder).iterdir()}
    assert left == {"one.csv", "mine.csv", "a.svg", "a.png", "b.svg"}
    write_report(replace(report, sections=[]), tmp_path)
    assert [path.name for path in (tmp_path / "tables").iterdir()] == ["mine.csv"]
    assert not (tmp_path / "figures" / "a.svg").exists()


def test_two_tables_of_one_name_are_refused(report):
    twin = Table("one", "Other", (Column("x", "x"),), [(1,)])
    double = Report("t", "", "0", "", sections=[*report.sections, Section("z", "z", tables=[twin])])
    with pytest.raises(ValueError, match="one"):
        render_report(double)


def test_a_row_must_fit_its_columns():
    with pytest.raises(ValueError, match="2 values under 1 columns"):
        Table("t", "t", (Column("x", "x"),), [(1, 2)])


@pytest.mark.parametrize(
    ("key", "head", "made"),
    [
        ("contact_time_us", None, Column("contact_time_us", "contact time", "µs", 4)),
        ("estimate_MN_m", None, Column("estimate_MN_m", "estimate", "MN/m", 4)),
        ("p_value", None, Column("p_value", "p value", "", 4)),
        ("y0_mm", None, Column("y0_mm", "y0", "mm", 0)),
        ("tp_rule_us", "Eq. 8", Column("tp_rule_us", "Eq. 8", "µs", 4)),
        (
            "contact_time_s",
            ("contact time", "", 2),
            Column("contact_time_s", "contact time", "", 2),
        ),
    ],
)
def test_a_column_is_headed_by_its_name_unless_told_otherwise(key, head, made):
    assert column(key, head) == made


def test_a_table_comes_of_a_frame_or_of_columns():
    frame = pd.DataFrame({"kn_MN_m": [2.0, np.nan], "touches": [1, 2], "seen": [True, False]})
    columns = {"kn_MN_m": [2.0, None], "touches": range(1, 3), "seen": np.array([True, False])}
    of_frame, of_columns = (Table.of("t", "T", each) for each in (frame, columns))
    assert of_frame == of_columns
    assert of_frame.csv_text() == "kn_MN_m,touches,seen\n2.0,1,true\n,2,false\n"
    with pytest.raises(ValueError, match="shorter"):
        Table.of("t", "T", {"a": [1, 2], "b": [1]})


WORDS = """
{% macro drop(kn_N_m, ratio) %}
# A drop

> At {{ kn_N_m | stiffness }} it keeps {{ ratio | percent(0) }}.

It fell,
and it rose.

| y1/y0 | Fig. 13 | 0.65 | {{ ratio | f(2) }} | – | – | {{ (ratio > 0.5) | verdict }} |

[figure a] Up and down

[alt a] A curve

[table numbers] Its {{ "numbers" }}

[note numbers] Made up.
{% endmacro %}
"""


@pytest.fixture
def prose(tmp_path) -> Prose:
    (tmp_path / "words.j2").write_text(WORDS)
    return Prose(tmp_path / "words.j2")


def test_words_of_a_section_stand_in_a_template(prose):
    draft = prose("drop", kn_N_m=2e6, ratio=0.657)
    draft.figure("a", _drawing(), draft.table("numbers", {"ratio": [0.657]}))
    section = draft.section("bristle drop")
    (table,), (figure,) = section.tables, section.figures
    assert (section.ident, section.title, section.command) == ("drop", "A drop", "bristle drop")
    assert section.headline == "At 2 MN/m it keeps 66\u00a0%."
    assert section.text == ["It fell, and it rose."]
    (row,) = section.comparisons
    assert row == Comparison("y1/y0", "Fig. 13", "0.65", "0.66", "–", "–", Verdict.AGREES, "")
    assert (table.caption, table.note) == ("Its numbers", "Made up.")
    assert (figure.caption, figure.alt, figure.data) == ("Up and down", "A curve", table)


def test_words_without_their_values_and_values_without_words_are_refused(prose):
    with pytest.raises(UndefinedError, match="ratio"):
        prose("drop", kn_N_m=2e6)
    with pytest.raises(TypeError, match="mu"):
        prose("drop", kn_N_m=2e6, ratio=0.5, mu=0.1)
    with pytest.raises(KeyError, match="table others"):
        prose("drop", kn_N_m=2e6, ratio=0.5).table("others", {"a": [1]})


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (0.65755, 4, "0.6575"),
        (1651.07, 4, "1651"),
        (0.0, 4, "0.000"),
        (3e-310, 2, "< 10^−300"),
        (-2.71e-5, 2, "−2.7·10^−5"),
        (None, 4, "–"),
        (float("inf"), 4, "∞"),
        (True, 4, "yes"),
        (-3, 4, "−3"),
        (0.01, 0, "0.01"),
    ],
)
def test_numbers_as_a_reader_wants_them(value, digits, text):
    assert show(value, digits) == text


def test_percentages():
    assert percent(0.194) == "19.4\u00a0%"
    assert percent(-0.786, 0, signed=True) == "−79\u00a0%"
    assert percent(-1e-6, signed=True) == "0.0\u00a0%"


def test_the_same_figure_gives_the_same_bytes():
    first, second = picture(_drawing()), picture(_drawing())
    assert isinstance(first, Picture)
    assert first == second
    assert first.png.startswith(b"\x89PNG")


@pytest.mark.parametrize(("count", "is_image"), [(1000, False), (20_000, True)])
def test_many_marks_are_an_image(count, is_image):
    figure, axes = panels()
    axes[0, 0].plot(np.linspace(0.0, 1.0, count), np.random.default_rng(1).random(count), "o")
    svg = picture(figure).svg
    assert ("data:image/png" in svg) == is_image
    assert len(svg) < 500_000


def test_of_many_held_out_drops_some_are_numbered():
    row = np.zeros(5000)
    held = SimpleNamespace(values=row, before=row, after=row, low=row, high=row)
    figure = held_figure(held, "y1 (mm)", range(1, 5001))
    ticks = [int(label.get_text()) for label in figure.axes[0].get_xticklabels()]
    assert 20 <= len(ticks) <= 30
    assert ticks[0] == 1


def test_labels_are_moved_apart_and_keep_their_order():
    placed = spread(np.array([0.0, 0.1, 0.12, 5.0, 9.99, 10.0]), 0.5, 0.0, 10.0)
    assert np.all(np.diff(placed) >= 0.5 - 1e-12)
    assert placed.max() <= 10.0
