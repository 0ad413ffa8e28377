"""`bristle its`: the integration time step that each quantity needs, against stiffness.

Writes table.csv, errors.csv, needs.csv, their figures and its.json. Also a script:
``mpirun -n 4 python3 -m bristle.studies.its --models beam``.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from mpi4py import MPI

from ...solver import paper
from ...solver.analytic import quarter_period_s
from ..inputs.fields import Height, Its, Numbers
from ..report.figures import picture, write_picture
from ..running.files import read_csv, to_csv, write_atomically
from ..running.study import TABLE_FILE, Row, Study, StudyInputs, run_study
from .convergence import Limit, Need, limit, need
from .figures import error_figure, need_figure

ITS_S = (1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 3e-7, 1e-7)
GOAL = 0.01
NEEDS_FILE = "needs.csv"
FEWEST_STEPS = 3
QUANTITIES = {
    "rebound_ratio": "rebound ratio y1/y0",
    "peak_force_N": "peak force",
    "contact_time_s": "contact time",
    "max_penetration_m": "greatest penetration",
}
ERROR_COLUMNS = (
    "model", "kn_N_m", "y0_m", "quantity", "its_s", "value", "converged", "order", "error_relative",
)  # fmt: skip
NEED_COLUMNS = (
    "model", "kn_N_m", "y0_m", "quantity", "goal", "its_needed_s", "bound", "rule_s", "paper_its_s",
    "its_over_rule",
)  # fmt: skip

Key = tuple[str, float, float]


class ItsInputs(StudyInputs):
    """As a sweep's, with a list of time steps and one height."""

    heights_m: Annotated[tuple[Height, ...], Numbers] = paper.HEIGHTS_M[-1:]
    its_s: Annotated[tuple[Its, ...], Numbers] = ITS_S


def run_its(
    inputs: ItsInputs,
    out: Path,
    comm: MPI.Intracomm = MPI.COMM_WORLD,
    *,
    resume: bool = False,
    ranks_per_case: int | None = None,
) -> None:
    """Compute the study into the folder ``out``; see `study.run_study`.

    Errors are against Richardson's limit of the three shortest steps where their order is clean,
    else against the shortest. A reduced model keeps the basis made for the paper's ITS: it is
    modal, so any step costs nothing, and its own error estimate is in the table.
    """
    mass_kg = inputs.bristle().mass_kg

    def finish(rows: Sequence[Row], folder: Path) -> dict[str, Any]:
        return _finish(rows, mass_kg, folder)

    study = Study("its", finish, basis_its_s=paper.ITS_S)
    run_study(study, inputs, out, comm, resume=resume, ranks_per_case=ranks_per_case)


def group(rows: Sequence[Row]) -> dict[Key, list[Row]]:
    """The rows of each model, stiffness and height, which differ in ITS alone."""
    groups: dict[Key, list[Row]] = {}
    for row in rows:
        groups.setdefault((row["model"], row["kn_N_m"], row["y0_m"]), []).append(row)
    return groups


def _finish(rows: Sequence[Row], mass_kg: float, out: Path) -> dict[str, Any]:
    errors: dict[tuple[str, Key], tuple[np.ndarray, np.ndarray]] = {}
    needs: dict[tuple[str, Key], Need] = {}
    table = []
    for key, members in group(rows).items():
        its_s = np.array([row["its_s"] for row in members])
        for name in QUANTITIES:
            values = np.array([row[name] for row in members], float)
            if np.isnan(values).any():
                continue  # no rebound was asked for
            found = limit(its_s, values)
            error = values / found.value - 1.0
            errors[name, key] = its_s, error
            needs[name, key] = need(its_s, error, GOAL)
            table += _error_rows(key, name, members, found, error)
    write_atomically(out / "errors.csv", to_csv(ERROR_COLUMNS, table))
    write_atomically(out / NEEDS_FILE, to_csv(NEED_COLUMNS, _need_rows(needs, mass_kg)))
    names = ["errors.csv", NEEDS_FILE]
    if errors:
        names += write_picture(out / "errors", picture(error_figure(errors, QUANTITIES, GOAL)))
        rule = {kn: quarter_period_s(mass_kg, kn) for _, (_, kn, _) in needs}
        drawn = need_figure(needs, QUANTITIES, rule, paper.ITS_S)
        names += write_picture(out / "needs", picture(drawn))
    return {"goal": GOAL, "files": names}


def answer(out: Path) -> list[str]:
    """What a finished study in ``out`` says, as lines: the longest ITS that each quantity allows,
    for each model and Kn, over all heights."""
    rows = read_csv(out / NEEDS_FILE)
    if not rows:
        return []
    needed: dict[tuple[str, float], dict[str, tuple[float, str]]] = {}
    for row in rows:
        each = needed.setdefault((row["model"], float(row["kn_N_m"])), {})
        now = float(row["its_needed_s"]), row["bound"]
        each[row["quantity"]] = min(now, each.get(row["quantity"], now))
    lines = [
        f"longest ITS (s) for an error of {100 * GOAL:g} %",
        f"  {'model':<10}{'Kn (N/m)':<10}" + "".join(f"{name:>22}" for name in QUANTITIES.values()),
    ]
    for (model, kn), each in needed.items():
        needs = (each.get(name) for name in QUANTITIES)
        words = ("" if need is None else f"{need[1]}{need[0]:.2g}" for need in needs)
        lines.append(f"  {model:<10}{kn:<10.6g}" + "".join(f"{word:>22}" for word in words))
    steps = {row["its_s"] for row in read_csv(out / TABLE_FILE)}
    if len(steps) < FEWEST_STEPS:
        lines.append(
            f"  of {len(steps)} steps alone: give --its {FEWEST_STEPS} or more to trust it"
        )
    return lines


def _error_rows(
    key: Key, name: str, members: Sequence[Row], found: Limit, error: np.ndarray
) -> list[tuple[Any, ...]]:
    return [
        (*key, name, row["its_s"], row[name], found.value, found.order, float(e))
        for row, e in zip(members, error, strict=True)
    ]


def _need_rows(needs: dict[tuple[str, Key], Need], mass_kg: float) -> list[tuple[Any, ...]]:
    rows = []
    for (name, key), found in needs.items():
        rule = quarter_period_s(mass_kg, key[1])
        ratio = found.its_s / rule if rule else None
        rows.append((*key, name, GOAL, found.its_s, found.bound, rule, paper.ITS_S, ratio))
    return rows
