"""Sections that run the loop on datasets of their own, and that on the measured ones."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
from mpi4py import MPI

from ..close_loop.page import headline
from ..close_loop.rows import Rows
from ..close_loop.run import Closed, close_several, problem_of
from ..close_loop.sections import held_out_section
from ..data.datasets import Manifest, read_manifest
from ..loop.problem import Problem
from ..report.page import Figure, Head, Section
from ..report.prose import Draft
from .campaign import Results, Study, prose

MEASURED = Path(__file__).parents[1] / "measured"
FOLDERS = (MEASURED / "square-bar", MEASURED / "falls-phone")
HEADS: dict[str, Head] = {
    "effects": "effects (probability)",
    "p_missing": ("p that nothing is missing", "", 2),
    "p_left": ("p of what is left", "", 2),
    "rms_before": ("held-out error before", "", 3),
    "rms_after": ("after", "", 3),
    "noise": ("their noise", "", 3),
    "coverage_90": ("within 90 % intervals", "", 2),
    "next": "what would decide",
}


class LoopStudy(Study):
    """A section of `bristle reproduce` on what the loop finds: made after `prepare`."""

    closed: Sequence[Closed] = ()

    @abstractmethod
    def datasets(self) -> list[tuple[Manifest, Callable[[], Problem]]]:
        """The datasets, each with what makes it a problem; the same on all ranks."""

    def prepare(self, comm: MPI.Intracomm) -> None:
        """Run the loop, datasets dealt out over the ranks; rank 0 has what it finds. Collective."""
        self.closed = close_several(self.datasets(), comm)

    def add_tables(self, draft: Draft, verdicts: str, estimates: str) -> None:
        """What the loop says of each dataset, and the parameters of the likeliest model of each."""
        draft.table(verdicts, pd.DataFrame(map(_verdict, self.closed), dtype=object), HEADS)
        rows = [
            {"dataset": each.manifest.title, "parameter": name, **vars(x)}
            for each in self.closed
            for name, x in each.finding.parameters.items()
        ]
        columns = ["dataset", "parameter", "estimate", "low", "high", "unit"]
        draft.table(estimates, pd.DataFrame(rows, columns=columns))


def _verdict(closed: Closed) -> dict[str, Any]:
    finding = closed.finding
    held, proposed = finding.held_out, finding.next_experiment
    weighed = [f"{effect} ({finding.weights[effect]:.2f})" for effect in finding.effects]
    return {
        "dataset": closed.manifest.title,
        "verdict": str(finding.verdict),
        "effects": ", ".join(weighed),
        "p_missing": finding.p_value,
        "p_left": finding.open_set_p_value,
        "rms_before": held and held.rms_before,
        "rms_after": held and held.rms_after,
        "noise": held and held.sigma,
        "unit": closed.problem.unit,
        "coverage_90": held and held.coverage_90,
        "next": proposed.change if proposed else "",
        "doubts": "; ".join(finding.all_warnings()),
    }


class LoopOnMeasured(LoopStudy):
    """The section of `bristle reproduce` on the datasets in ``folders``."""

    def __init__(self, folders: Sequence[Path] = FOLDERS) -> None:
        self.folders = folders

    def datasets(self) -> list[tuple[Manifest, Callable[[], Problem]]]:
        manifests = [read_manifest(folder) for folder in self.folders]
        return [(each, partial(problem_of, each)) for each in manifests]

    def section(self, results: Results) -> Section:
        """The section; its sentences are those of `bristle close-loop`."""
        del results
        draft = prose("measured", said=[(each, headline(each)) for each in self.closed])
        draft.figures = [_held_out(each) for each in self.closed]
        self.add_tables(draft, "measured", "measured_estimates")
        commands = (f"bristle close-loop studies/measured/{each.name}" for each in self.folders)
        return draft.section("\n".join(commands))


def _held_out(closed: Closed) -> Figure:
    """Held-out values as predicted, the figure of the dataset's own page."""
    (drawn,) = held_out_section(Rows(closed)).figures
    name = f"held-out-{closed.manifest.folder.name}"
    caption = f"{closed.manifest.title}: {drawn.caption}"
    return replace(drawn, name=name, caption=caption, data=replace(drawn.data, name=name))
