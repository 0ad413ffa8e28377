"""How is the benchmark of the loop run, taken up again, and told?"""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from mpi4py import MPI
from pydantic import BaseModel, ConfigDict

from ...meshes.collective import run_on_one_rank
from ..running.files import prepare_folder, records_to_csv, to_json, together, write_atomically
from ..running.journal import Journal
from ..running.parallel import share_out
from ..running.progress import progress
from ..synth import reduced_body
from .loop_cases import ROWS, Case, run_case
from .loop_page import page
from .loop_table import Line, table

DATASETS = 100


class BenchInputs(BaseModel):
    """What a journal's cases belong to; how many of them there are may grow."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    what: str
    rows: tuple[str, ...] = tuple(row.name for row in ROWS)


def run_loop(
    out: Path,
    *,
    datasets: int = DATASETS,
    resume: bool = False,
    comm: MPI.Intracomm = MPI.COMM_WORLD,
) -> str:
    """Run ``datasets`` cases of every row; write table.csv, outcomes.json, report.html; the table.

    With ``resume`` finished cases in ``out`` are kept. Collective. Raises InputError,
    ComputationError.
    """
    started = time.perf_counter()
    journal = Journal(out, BenchInputs(what="loop"))
    done = run_on_one_rank(comm, lambda: _prepare(journal, out, resume))
    body = reduced_body()
    cases = [Case(row, number) for number in range(datasets) for row in ROWS]
    open_ = [i for i in range(len(cases)) if i not in done]
    with progress("Datasets", len(cases), done=len(cases) - len(open_)) as advance:

        def take(position: int, found: dict[str, Any]) -> None:
            done[open_[position]] = journal.add(open_[position], found)
            advance()

        share_out(comm, len(open_), lambda position: _found(cases[open_[position]], body), take)
    outcomes = [done[i] for i in range(len(cases))] if comm.rank == 0 else []
    return str(run_on_one_rank(comm, lambda: _tell(outcomes, out, journal, started, comm.size)))


def _prepare(journal: Journal, out: Path, resume: bool) -> dict[int, dict[str, Any]]:
    prepare_folder(out)
    if resume:
        return journal.resume()
    journal.begin()
    return {}


def _found(case: Case, body: Any) -> dict[str, Any]:
    outcome = run_case(case, body)
    if outcome is None:
        return {"row": case.row.name, "number": case.number, "verdict": None}
    return asdict(outcome)


def _tell(
    outcomes: list[dict[str, Any]], out: Path, journal: Journal, started: float, ranks: int
) -> str:
    lines = table(outcomes)
    with together(out, "outcomes.json"):
        write_atomically(out / "table.csv", records_to_csv(Line, lines))
        write_atomically(out / "outcomes.json", to_json(outcomes))
        page(lines, outcomes, out, ranks)
    journal.finish()
    wall = time.perf_counter() - started
    told = [_line(line) for line in lines]
    return "\n".join([*told, f"{len(outcomes)} datasets in {wall:.0f} s: {out / 'report.html'}"])


def _line(line: Line) -> str:
    what = f"{line.row}: {line.quantity}"
    if line.low is None or line.high is None:
        return f"{what:<75} {line.value:6.2f}                    {line.target}"
    interval = f"[{100 * line.low:.0f}, {100 * line.high:.0f}]"
    return f"{what:<75} {100 * line.value:5.1f} % {interval:>10} of {line.of:<4} {line.target}"
