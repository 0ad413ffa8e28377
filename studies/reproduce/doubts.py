"""Warnings of the drops behind a page."""

from __future__ import annotations

from ..inputs.limits import input_warnings, result_warnings
from ..inputs.stance import lean_deg
from ..report.page import Column, Section, Table
from .campaign import Results

COLUMNS = (
    Column("model", "model"),
    Column("contact", "contact"),
    Column("kn_N_m", "Kn", "N/m"),
    Column("y0_m", "y0", "m"),
    Column("its_s", "ITS", "s"),
    Column("lean_deg", "lean", "°"),
    Column("warning", "what is doubtful, and what to change"),
)


def doubts(results: Results) -> Section:
    """The warnings of all drops, each with its value, limit and remedy."""
    rows = [
        (
            str(case.model),
            str(case.contact),
            case.kn_N_m,
            case.height_m,
            case.its_s,
            lean_deg(case),
            message,
        )
        for case, result in results.items()
        for message in (*input_warnings(case), *result_warnings(case, result))
    ]
    many = len({row[:-1] for row in rows})
    text = [f"{many} of the {len(results)} drops behind this page come with a warning."]
    caption = "Warnings of single drops, as `bristle drop` gives them too."
    tables = [Table("warnings", caption, COLUMNS, rows)] if rows else []
    return Section("warnings", "What deserves doubt", text=text, tables=tables)
