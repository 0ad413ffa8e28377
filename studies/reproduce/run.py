"""`bristle reproduce`: every figure and table of the paper, and where it and we differ.

All drops are computed once, spread over the ranks, and then shown on one page.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from mpi4py import MPI

from ...meshes.collective import run_on_one_rank
from ...solver import paper
from ..inputs.config import DropInputs
from ..inputs.limits import input_warnings, result_warnings
from ..inputs.sources import command_line
from ..report.page import REPORT_FILES, Report, Section, Verdict, write_report
from ..running.cases import CaseSession
from ..running.files import prepare_folder
from ..running.groups import refuse_more_ranks
from ..running.progress import progress, working
from .campaign import Results, Setup, Study, compute, prose
from .discretisation import CrossCheck, ElementStudy, Enforcements, StepStudy
from .dragged import Dragged
from .impact import Figure9, PeakTime
from .leaning import Bars, Leaning, Sticking
from .loop_section import LoopOnMeasured, LoopOnPaper
from .rebound import Figure13, Figures10To12, KnStudy


@dataclass(frozen=True)
class Reproduction:
    """What came of a run: the page, how many drops it took, how long, and the sections."""

    report: Path
    n_cases: int
    wall_s: float
    sections: tuple[Section, ...]


def paper_studies(setup: Setup) -> list[Study]:
    """The sections of the page, in order."""
    on_drops = (
        *(Figure9, Figures10To12, KnStudy, Figure13, CrossCheck, Enforcements, ElementStudy),
        *(StepStudy, PeakTime, Leaning, Sticking, Bars),
    )
    return [*(study(setup) for study in on_drops), Dragged(), LoopOnPaper(), LoopOnMeasured()]


def run_reproduce(
    out: Path,
    setup: Setup | None = None,
    studies: Sequence[Study] | None = None,
    *,
    comm: MPI.Intracomm = MPI.COMM_WORLD,
    ranks_per_case: int | None = None,
) -> Reproduction:
    """Compute everything and write ``report.html``, ``tables/`` and ``figures/`` into ``out``.

    Collective. Nothing is written before all drops are computed and the page is made. Raises
    InputError where ``out`` cannot be written, ComputationError where a drop fails.
    """
    started = time.perf_counter()
    out = Path(out)
    setup = setup or Setup(DropInputs())
    studies = paper_studies(setup) if studies is None else list(studies)
    cases = list(dict.fromkeys(case for study in studies for case in study.cases()))
    refuse_more_ranks(cases, comm.size, ranks_per_case)
    run_on_one_rank(comm, lambda: prepare_folder(out, *REPORT_FILES))
    with (
        CaseSession(comm, basis_its_s=setup.its_s) as session,
        progress("Drops", len(cases)) as advance,
    ):
        results = compute(cases, session, advance, ranks_per_case)
    for study in studies:
        study.prepare(comm)

    def write() -> Reproduction:
        with working("writing the page"):
            sections = (*(study.section(results) for study in studies), doubts(results))
            wall = time.perf_counter() - started
            ranks = f"{comm.size} rank{'s' if comm.size > 1 else ''}"
            facts = [("Drops computed", str(len(cases))), ("Wall time", f"{wall:.0f} s on {ranks}")]
            command = command_line("reproduce", setup.base, DropInputs(), out)
            page = page_of(setup, sections, facts, command)
            return Reproduction(write_report(page, out), len(cases), wall, sections)

    return run_on_one_rank(comm, write)


def doubts(results: Results) -> Section:
    """The warnings of all drops, each with its value, limit and remedy."""
    rows = [
        (
            str(case.model),
            str(case.contact),
            case.kn_N_m,
            case.height_m,
            case.its_s,
            case.lean_deg,
            message,
        )
        for case, result in results.items()
        for message in (*input_warnings(case), *result_warnings(case, result))
    ]
    many = len({row[:-1] for row in rows})
    draft = prose("warnings", many=many, n=len(results))
    if rows:
        columns = ["model", "contact", "kn_N_m", "y0_m", "its_s", "lean_deg", "warning"]
        frame = pd.DataFrame(rows, columns=columns)
        draft.table("warnings", frame, {"warning": "what is doubtful, and what to change"})
    return draft.section()


def page_of(
    setup: Setup, sections: Sequence[Section], facts: list[tuple[str, str]], command: str
) -> Report:
    """The page of a run."""
    compared = [each for section in sections for each in section.comparisons]
    counts = {verdict: sum(c.verdict is verdict for c in compared) for verdict in Verdict}
    differences = [
        f"{each.quantity} ({each.place}): {each.paper} in the paper; here {each.ours_1d} (1-D), "
        f"{each.ours_3d} (3-D). {each.remark}"
        for each in compared
        if each.verdict is Verdict.DIFFERS
    ]
    base = setup.base
    cells = " × ".join(map(str, base.mesh_spec().cells))
    return Report(
        title="A steel bristle's impact on a rigid plane: the paper beside us",
        lead=f"{paper.CITATION}, in one dimension (a beam of {base.elements} three-node elements, "
        f"as the paper's) and in three (a solid of {cells} hexahedra of degree {base.order}).",
        command=command,
        headline=[
            f"Of {len(compared)} quantities of the paper, {counts[Verdict.AGREES]} agree, "
            f"{counts[Verdict.DIFFERS]} differ, {counts[Verdict.OPEN]} cannot be compared.",
            *(section.headline for section in sections if section.headline),
        ],
        differences=differences,
        facts=[
            *facts,
            ("Integration time step", f"{1e3 * base.its_s:g} ms where no other is named"),
            ("Contact", "penalty at Kn where no other is named"),
        ],
        sections=sections,
    )
