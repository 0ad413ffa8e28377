"""What do the pages of all benchmarks have in common?"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from .. import __version__
from ..inputs.again import into
from ..report.page import Report, Section, write_report


def write_page(
    out: Path,
    *,
    title: str,
    lead: str,
    command: Sequence[object],
    headline: Sequence[str],
    facts: Sequence[tuple[str, str]],
    sections: Sequence[Section],
    how: Sequence[str],
) -> None:
    """Write report.html with its figures and tables into ``out``.

    ``command`` has the words of ``bristle bench`` that make it again, but for the folder; ``how``
    the benchmark is measured is told last.
    """
    report = Report(
        title=title,
        lead=lead,
        version=__version__,
        command=into(out, "bench", *command),
        headline=headline,
        facts=facts,
        sections=[*sections, Section("how", "How it was measured", how)],
    )
    write_report(report, out)
