"""The loop on the measured datasets that come with the program."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from ..close_loop.page import headline
from ..close_loop.rows import Rows
from ..close_loop.run import Closed, problem_of
from ..close_loop.sections import held_out_section
from ..data.datasets import Manifest, read_manifest
from ..loop.problem import Problem
from ..report.page import Figure, Section, percent
from .campaign import Results
from .loop_study import LoopStudy, estimate_table, verdict_table

MEASURED = Path(__file__).parents[1] / "measured"
FOLDERS = (MEASURED / "square-bar", MEASURED / "falls-phone")


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
        return Section(
            "measured",
            "The loop on measured data",
            [_words(each) for each in self.closed],
            figures=[_figure(each) for each in self.closed],
            tables=[
                verdict_table("measured", "The loop on measured data.", self.closed),
                estimate_table("measured_estimates", self.closed),
            ],
            command="\n".join(
                f"bristle close-loop studies/measured/{folder.name}" for folder in self.folders
            ),
            headline=" ".join(
                f"{each.manifest.title}, measured: {headline(each)[0]}" for each in self.closed
            ),
        )


def _words(closed: Closed) -> str:
    manifest, held = closed.manifest, closed.finding.held_out
    whence = f"{manifest.source}; licence {manifest.licence}"
    sentences = [f"{manifest.title} ({whence}).", *headline(closed)]
    if held is not None:
        sentences.append(
            f"Within 90 % intervals: {percent(held.coverage_90, 0)} of the held-out values."
        )
    return " ".join(sentences)


def _figure(closed: Closed) -> Figure:
    """Held-out values as predicted, the figure of the dataset's own page."""
    (drawn,) = held_out_section(Rows(closed)).figures
    name = f"held-out-{closed.manifest.folder.name}"
    caption = f"{closed.manifest.title}: {drawn.caption}"
    return replace(drawn, name=name, caption=caption, data=replace(drawn.data, name=name))
