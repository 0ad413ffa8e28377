"""Base of sections that run the loop on datasets of their own, and the tables that they share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

from mpi4py import MPI

from ..close_loop.run import Closed, close_several
from ..data.datasets import Manifest
from ..inputs.config import DropInputs
from ..loop.problem import Problem
from ..report.page import Column, Section, Table, Value
from .campaign import Results


class LoopStudy(ABC):
    """A section of `bristle reproduce` on what the loop finds; it needs no drops of others."""

    closed: Sequence[Closed] = ()

    @abstractmethod
    def datasets(self) -> list[tuple[Manifest, Callable[[], Problem]]]:
        """The datasets, each with what makes it a problem; the same on all ranks."""

    @abstractmethod
    def section(self, results: Results) -> Section:
        """The section, after `prepare`."""

    def cases(self) -> list[DropInputs]:
        """None."""
        return []

    def prepare(self, comm: MPI.Intracomm) -> None:
        """Run the loop, datasets dealt out over the ranks; rank 0 has what it finds. Collective."""
        self.closed = close_several(self.datasets(), comm)


def verdict_table(name: str, caption: str, closed: Sequence[Closed]) -> Table:
    """What the loop says of each dataset."""
    head = (
        Column("dataset", "Dataset"),
        Column("verdict", "verdict"),
        Column("effects", "effects (probability)"),
        Column("p_missing", "p that nothing is missing", digits=2),
        Column("p_left", "p of what is left", digits=2),
        Column("rms_before", "held-out error before", digits=3),
        Column("rms_after", "after", digits=3),
        Column("noise", "their noise", digits=3),
        Column("unit", "unit"),
        Column("coverage_90", "within 90 % intervals", digits=2),
        Column("next", "what would decide"),
        Column("doubts", "doubts"),
    )
    rows: list[tuple[Value, ...]] = []
    for each in closed:
        finding = each.finding
        held, proposed = finding.held_out, finding.next_experiment
        weighed = [f"{effect} ({finding.weights[effect]:.2f})" for effect in finding.effects]
        rows.append(
            (
                each.manifest.title,
                str(finding.verdict),
                ", ".join(weighed),
                finding.p_value,
                finding.open_set_p_value,
                *((held.rms_before, held.rms_after, held.sigma) if held else (None,) * 3),
                each.problem.unit,
                held.coverage_90 if held else None,
                proposed.change if proposed else "",
                "; ".join(finding.all_warnings()),
            )
        )
    return Table(name, caption, head, rows)


def estimate_table(name: str, closed: Sequence[Closed]) -> Table:
    """The parameters of each dataset's reported model."""
    head = (
        Column("dataset", "Dataset"),
        Column("parameter", "parameter"),
        Column("estimate", "estimate"),
        Column("low", "90 % from"),
        Column("high", "to"),
        Column("unit", "unit"),
    )
    rows = [
        (each.manifest.title, parameter, x.estimate, x.low, x.high, x.unit)
        for each in closed
        for parameter, x in each.finding.parameters.items()
    ]
    return Table(name, "Parameters of the likeliest model of each.", head, rows)
