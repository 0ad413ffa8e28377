"""Page of a closed loop, step by step."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..inputs.sources import command_line
from ..inputs.study_fields import LoopInputs
from ..report.page import Report, percent, write_report
from .opening import few_data, names_of_groups, opening, would_have_shown
from .rows import Closed
from .sections import SECTIONS, prose


def write_page(closed: Closed, out: Path) -> Path:
    """Write ``report.html``, ``tables/`` and ``figures/`` into ``out``; returns the page's path."""
    manifest, asked, problem = closed.manifest, closed.inputs, closed.problem
    page = Report(
        title=f"What the model lacks: {manifest.title}",
        lead="The model is fitted to measured data. What it does not explain is tested and traced "
        "to an effect that the model lacks. The result is judged by data that took no part.",
        command=command_line("close-loop", asked, LoopInputs(), out, manifest.folder),
        headline=headline(closed),
        facts=[
            ("Dataset", manifest.title),
            ("Kind", manifest.kind),
            ("Values", f"{len(problem.values)} in {len(np.unique(problem.group))} groups"),
            ("Source", manifest.source or "not declared"),
            ("Licence of the data", manifest.licence or "not declared"),
            ("Seed", str(asked.seed)),
            ("False-alarm rate", percent(asked.alarm, 1)),
        ],
        sections=[section(closed) for section in SECTIONS],
    )
    return write_report(page, out)


def headline(closed: Closed) -> list[str]:
    """The verdict and what it is worth, in a few sentences."""
    found = closed.finding
    kind = closed.manifest.kind
    few = few_data(found, closed.problem, kind)
    shown = would_have_shown(found, closed.problem) if few is None else []
    told = {"opening": opening(found), "shown": shown, "few": few, "names": names_of_groups(kind)}
    solid, warnings = closed.confirmation.solid, closed.warnings
    return prose.text("headline", finding=found, solid=solid, warnings=warnings, **told)
