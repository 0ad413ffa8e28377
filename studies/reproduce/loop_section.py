"""The loop in a reproduction: on sets of drops with the published summaries, and on measured data.

What y1/y0 = 0.65 ± 0.21 is made of: that something is missing needs no set of drops, since no model
of a bristle under which all drops of a height are alike scatters more than its instruments do. What
it is, only a loop over drops can say.
"""

from __future__ import annotations

from abc import abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from mpi4py import MPI
from scipy.stats import chi2

from ...solver import paper
from ...solver.arrays import Array
from ..close_loop.page import headline
from ..close_loop.rows import Closed, title_of
from ..close_loop.run import close_several, problem_of
from ..close_loop.sections import held_out_section
from ..data.datasets import Drops, Manifest, read_manifest
from ..loop.finding import Finding
from ..loop.kinds.drops.problem import drops_problem
from ..loop.problem import Problem
from ..report.page import Figure, Head, Section
from ..report.prose import Draft
from ..scatter.page import cloud_figure
from .campaign import Results, Study, prose
from .published_drops import Film, dataset, draw, planned_heights_m

SETS, SEED = 5, 26
# Of these so many are also told the paper's damping, which needs tables of its own.
DECLARED = 2
# The published standard deviation is rounded to two decimals; the least that it stands for.
LEAST_STD = paper.RATIO_STD - 0.005
ALL_LOW_M = np.full(paper.N_DROPS, min(paper.HEIGHTS_M))
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
        "doubts": "; ".join(closed.warnings),
    }


def film_scatter(film: Film, y0_m: Array) -> float:
    """Standard deviation of y1/y0 that the film alone makes, were drops from ``y0_m`` (n,) alike:
    to first order in what each height is read wrong by."""
    both = film.sigma_m**2 + (film.reading_m * paper.RATIO_MEAN) ** 2
    return float(np.sqrt(both * np.mean(y0_m**-2.0)))


def chance_of_scatter(expected: float) -> float:
    """How often 26 drops that scatter by ``expected`` show the published scatter or more."""
    free = paper.N_DROPS - 1
    return float(chi2.sf(free * (LEAST_STD / expected) ** 2, free))


def needed_mm() -> float:
    """The error of reading, in mm, that would make the published scatter by itself."""
    square = LEAST_STD**2 / np.mean(planned_heights_m() ** -2.0) - Film().spread_low_m ** 2
    return float(1e3 * np.sqrt(square / (1.0 + paper.RATIO_MEAN**2)))


class LoopOnPaper(LoopStudy):
    """The section of `bristle reproduce`: the loop on so many ``sets``, each as a ``problem``, with
    the damping unknown, and the first `DECLARED` again with the paper's."""

    def __init__(
        self, sets: int = SETS, problem: Callable[[Drops], Problem] = drops_problem
    ) -> None:
        self.sets, self.problem = sets, problem

    def drawn(self) -> list[tuple[Array, Array]]:
        """The sets: heights before and after, as read."""
        return [draw(np.random.default_rng([SEED, i])) for i in range(self.sets)]

    def datasets(self) -> list[tuple[Manifest, Callable[[], Problem]]]:
        drawn = self.drawn()
        made = [
            dataset(f"set {number}, damping {known}", *each, damping=damping)
            for damping, known, sets in (
                (False, "unknown", drawn),
                (True, "the paper's", drawn[:DECLARED]),
            )
            for number, each in enumerate(sets, 1)
        ]
        return [(each.manifest, partial(self.problem, each)) for each in made]

    def section(self, results: Results) -> Section:
        """The section with its sentences, tables and the sets."""
        del results
        drawn = self.drawn()
        film, worst = Film(), Film(reading_m=1e-3)
        draft = prose(
            "loop_on_paper",
            "loop",
            n=len(drawn),
            film=film,
            film_scatter=film_scatter(film, planned_heights_m()),
            by_chance=chance_of_scatter(film_scatter(worst, ALL_LOW_M)),
            needed_mm=needed_mm(),
            spreads=[_scatter_from(drawn, paper.HEIGHTS_M[i]) for i in (0, -1)],
            told=told(self.closed[: self.sets]),
            told_beta=told(self.closed[self.sets :])[0],
        )
        rows = [
            (number, drop, 1e3 * a, 1e3 * b)
            for number, each in enumerate(drawn, 1)
            for drop, (a, b) in enumerate(zip(*each, strict=True), 1)
        ]
        sets = pd.DataFrame(rows, columns=["set", "drop", "y0_mm", "y1_mm"])
        y0, y1 = (np.concatenate(each) for each in zip(*drawn, strict=True))
        draft.figure(
            "published-sets",
            cloud_figure(y0, y1, "drawn here, not measured"),
            draft.data("published_sets", sets, {"y0_mm": ("y0", "mm", 4)}),
        )
        self.add_tables(draft, "loop_sets", "loop_estimates")
        return draft.section()


def _scatter_from(drawn: Sequence[tuple[Array, Array]], height_m: float) -> float:
    """Standard deviation of y1/y0 of the drops from one height, over the sets."""
    return float(np.sqrt(np.mean([np.var((y1 / y0)[y0 == height_m], ddof=1) for y0, y1 in drawn])))


def told(sets: Sequence[Closed]) -> list[str]:
    """What holds over the sets, in words; the first paragraph is the answer."""
    findings = [each.finding for each in sets]
    names = dict.fromkeys(name for each in findings for name in each.effects)
    weights = {
        title_of(name): [float(each.weights.get(name, 0.0)) for each in findings] for name in names
    }
    held = [each.held_out for each in findings if each.held_out is not None]
    errors = [(x.rms_before, x.rms_after, x.sigma, x.coverage_90) for x in held]
    tied = [each.next_experiment for each in findings if each.next_experiment is not None]
    return prose.text(
        "told",
        n=len(sets),
        verdicts=_counted(str(each.verdict) for each in findings),
        pooled=sorted(weights.items(), key=lambda each: -sum(each[1])),
        by_chance=sum(np.size(each.model.weights) > 1 for each in findings),
        reach=_reach(findings),
        errors=np.mean(errors, axis=0) if held else None,
        unit=held[0].unit if held else "",
        noise=_counted(str(x.noise["finding"]) for x in findings if x.noise["finding"]),
        tied=_counted(each.change for each in tied),
    )


def _counted(words: Iterable[str]) -> str:
    return ", ".join(f"{word} in {count}" for word, count in Counter(words).most_common())


def _reach(findings: Sequence[Finding]) -> list[tuple[str, float, float, str]]:
    """How far the intervals of parameters that all sets have reach together, and the unit."""
    every = {
        name: [each.parameters[name] for each in findings if name in each.parameters]
        for name in findings[0].parameters
    }
    return [
        (name, min(x.low for x in found), max(x.high for x in found), found[0].unit)
        for name, found in every.items()
        if len(found) == len(findings)
    ]


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
    (drawn,) = held_out_section(closed).figures
    name = f"held-out-{closed.manifest.folder.name}"
    caption = f"{closed.manifest.title}: {drawn.caption}"
    return replace(drawn, name=name, caption=caption, data=replace(drawn.data, name=name))
