"""What is the 65 % made of: which accounts of the measured bounces hold, and what would decide?

A section of `bristle reproduce`, and a page by itself: python3 -m bristle.studies.account --out DIR
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ...meshes.collective import run_on_one_rank
from ...solver import paper
from ...solver.errors import BristleError
from .. import __version__
from ..command.config import DropInputs
from ..page.report import Report, Section, write_report
from ..running.campaign import Results
from ..running.files import prepare_folder
from ..running.progress import say
from .findings import Findings, Plan, compute_with_progress
from .page import section_of


@dataclass
class AccountStudy:
    """The section of `bristle reproduce`; its own drops are computed by `prepare`."""

    plan: Plan = field(default_factory=Plan)
    findings: Findings | None = None

    def cases(self) -> list[DropInputs]:
        """None: thousands of leaning drops go through the batch, not through the workshop."""
        return []

    def prepare(self, comm: Any) -> None:
        """Compute what ``section`` tells. Collective."""
        self.findings = compute_with_progress(self.plan, comm)

    def section(self, results: Results) -> Section:
        """The section; raises RuntimeError before `prepare`."""
        if self.findings is None:
            raise RuntimeError("prepare() comes before section()")
        return section_of(self.findings)


def run_account(out: Path, plan: Plan | None = None, comm: Any = None) -> Findings:
    """The page by itself: ``report.html``, ``tables/`` and ``figures/`` in ``out``. Collective."""
    if comm is None:
        from mpi4py import MPI

        comm = MPI.COMM_WORLD
    run_on_one_rank(comm, lambda: prepare_folder(out))
    study = AccountStudy(plan or Plan())
    study.prepare(comm)
    found = study.findings
    assert found is not None

    def write() -> Path:
        section = study.section({})
        return write_report(
            Report(
                title=section.title,
                lead=f"{paper.CITATION}: a bristle keeps 65 % of its height. Rival accounts of "
                "where the rest goes, fitted to the published summaries, and what would decide.",
                version=__version__,
                command=section.command,
                headline=[section.headline],
                facts=[("Wall time", f"{found.wall_s:.0f} s on {comm.size} rank(s)")],
                sections=[replace(section, headline="")],
            ),
            out,
        )

    run_on_one_rank(comm, write)
    return found


def main(args: Sequence[str] | None = None) -> int:
    """Run the page from the command line; 2 for bad arguments, else 0 or an error's own status."""
    parser = argparse.ArgumentParser(prog="python3 -m bristle.studies.account", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/account"), metavar="DIR")
    out = parser.parse_args(args).out
    try:
        found = run_account(out)
    except BristleError as error:
        print(f"bristle: {error}", file=sys.stderr)
        return 1
    say(f"{len(found.fits)} accounts in {found.wall_s:.0f} s: {out / 'report.html'}")
    return 0
