"""`bristle its`: the integration time step that each quantity needs, against stiffness.

Writes table.csv, errors.csv, needs.csv, their figures and its.json. Also a script:
``mpirun -n 4 python3 -m bristle.studies.its --models beam``.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from ...solver import paper
from ...solver.errors import ComputationError
from ..inputs.fields import Heights, Steps
from ..report.figures import picture, picture_files, write_picture
from ..running.files import to_csv, write_atomically
from ..running.study import TABLE_FILE, Row, Study, StudyInputs, run_study
from .convergence import compare
from .figures import error_figure, need_figure

ITS_S = (1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 3e-7, 1e-7)
GOAL = 0.01
ERRORS, NEEDS = "errors", "needs"
ERRORS_FILE, NEEDS_FILE = f"{ERRORS}.csv", f"{NEEDS}.csv"
FILES = (ERRORS_FILE, NEEDS_FILE, *picture_files(ERRORS), *picture_files(NEEDS))
FEWEST_STEPS = 3
QUANTITIES = {
    "rebound_ratio": "rebound ratio y1/y0",
    "peak_force_N": "peak force",
    "contact_time_s": "contact time",
    "max_penetration_m": "greatest penetration",
}


class ItsInputs(StudyInputs):
    """As a sweep's, with a list of time steps and one height."""

    heights_m: Heights = paper.HEIGHTS_M[-1:]
    its_s: Steps = ITS_S


def study_of(inputs: ItsInputs) -> Study:
    """The study of time steps.

    Errors are against Richardson's limit of the three shortest steps where their order is clean,
    else against the shortest. A reduced model keeps the basis made for the paper's ITS: it is
    modal, so any step costs nothing, and its own error estimate is in the table. A case that fails
    is a row without values; ComputationError where all do.
    """
    finish = partial(_finish, inputs.bristle().mass_kg)
    return Study("its", finish, basis_its_s=paper.ITS_S, files=FILES, failures=True)


# Computes the study into a folder.
run_its = partial(run_study, study_of)


def _finish(mass_kg: float, rows: Sequence[Row], out: Path) -> dict[str, Any]:
    if all(row["energy_closure"] is None for row in rows):
        raise ComputationError(f"no case could be computed; the last {rows[-1]['warnings'][-1]}")
    errors, needs = compare(pd.DataFrame(rows), QUANTITIES, GOAL, mass_kg)
    needs["paper_its_s"] = paper.ITS_S
    needs["its_over_rule"] = needs.its_needed_s / needs.rule_s.where(needs.rule_s > 0.0)
    for name, frame in ((ERRORS_FILE, errors), (NEEDS_FILE, needs)):
        write_atomically(out / name, to_csv(list(frame), frame.itertuples(index=False)))
    names = [ERRORS_FILE, NEEDS_FILE]
    if len(errors):
        names += write_picture(out / ERRORS, picture(error_figure(errors, QUANTITIES, GOAL)))
        drawn = need_figure(needs, QUANTITIES, paper.ITS_S)
        names += write_picture(out / NEEDS, picture(drawn))
    return {"goal": GOAL, "files": names}


def answer(out: Path) -> list[str]:
    """What a finished study in ``out`` says, as lines: the longest ITS that each quantity allows,
    for each model and Kn, over all heights."""
    needs = pd.read_csv(out / NEEDS_FILE, keep_default_na=False)
    if needs.empty:
        return []
    needs["words"] = needs.bound + needs.its_needed_s.map("{:.2g}".format)
    least = needs.sort_values(["its_needed_s", "bound"]).pivot_table(
        index=["model", "kn_N_m"], columns="quantity", values="words", aggfunc="first"
    )
    lines = [
        f"longest ITS (s) for an error of {100 * GOAL:g} %",
        f"  {'model':<10}{'Kn (N/m)':<10}" + "".join(f"{name:>22}" for name in QUANTITIES.values()),
    ]
    for (model, kn), each in least.reindex(columns=list(QUANTITIES)).fillna("").iterrows():
        lines.append(f"  {model:<10}{kn:<10.6g}" + "".join(f"{words:>22}" for words in each))
    table = pd.read_csv(out / TABLE_FILE)
    if failed := int(table.energy_closure.isna().sum()):
        lines.append(f"  {failed} of {len(table)} cases failed: its.json says why")
    steps = table.its_s.nunique()
    if steps < FEWEST_STEPS:
        lines.append(f"  of {steps} steps alone: give --its {FEWEST_STEPS} or more to trust it")
    return lines
