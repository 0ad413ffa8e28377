"""How does the rebound depend on contact stiffness and height (Fig. 13)?

Writes table.csv, heights.svg and .png, and sweep.json. Also a script:
``mpirun -n 4 python3 -m bristle.studies.sweep --models beam,reduced``.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from ..solver import paper
from .command.script import as_script
from .inputs.choices import Model
from .report.figures import picture, write_picture
from .report.paper_figures import height_figure
from .running.files import read_csv
from .running.study import TABLE_FILE, Row, Study, StudyInputs, run_study

FIGURE = "heights"
MARKERS = 60


def run_sweep(
    inputs: StudyInputs,
    out: Path,
    comm: MPI.Intracomm = MPI.COMM_WORLD,
    *,
    resume: bool = False,
    ranks_per_case: int | None = None,
) -> None:
    """Compute the sweep into the folder ``out``; see `study.run_study`."""
    study = Study("sweep", _finish, curves=True)
    run_study(study, inputs, out, comm, resume=resume, ranks_per_case=ranks_per_case)


def _finish(rows: Sequence[Row], out: Path) -> dict[str, Any]:
    """A figure for each ITS of the sweep."""
    steps = sorted({row["its_s"] for row in rows}, reverse=True)
    names = []
    for its_s in steps:
        name = FIGURE if len(steps) == 1 else f"{FIGURE}-its-{its_s:g}"
        curves = {
            (row["model"], row["y0_m"], row["kn_N_m"]): _path(row)
            for row in rows
            if row["its_s"] == its_s
        }
        names += write_picture(out / name, picture(height_figure(curves)))
    return {"files": names}


def answer(out: Path) -> list[str]:
    """What a finished sweep in ``out`` says, as lines: y1/y0 over stiffness and height for each
    model, and at which Kn it is the paper's."""
    rows = read_csv(out / TABLE_FILE)
    if not any(row["rebound_ratio"] for row in rows):
        return ["no rebound was computed: --until ends the drops before it"]
    lines: list[str] = []
    for model, its_s in dict.fromkeys((row["model"], row["its_s"]) for row in rows):
        ratio = {
            (float(row["kn_N_m"]), float(row["y0_m"])): float(row["rebound_ratio"] or "nan")
            for row in rows
            if (row["model"], row["its_s"]) == (model, its_s)
        }
        kns, heights = (sorted({key[i] for key in ratio}) for i in range(2))
        lines += [f"{model}, ITS {float(its_s):g} s: y1/y0", "  Kn (N/m) from (mm)"]
        lines[-1] += "".join(f"{1e3 * height:9.4g}" for height in heights)
        for kn in kns:
            values = "".join(f"{ratio[kn, height]:9.4f}" for height in heights)
            lines.append(f"  {kn:<18.6g}{values}")
        found = _kn_of(paper.RATIO_MEAN, kns, [ratio[kn, heights[-1]] for kn in kns])
        if found is not None:
            lines.append(
                f"  y1/y0 is {paper.RATIO_MEAN:g}, the paper's mean, from {1e3 * heights[-1]:g} mm "
                f"at Kn = {found:.3g} N/m"
            )
    return lines


def _kn_of(ratio: float, kns: Sequence[float], ratios: Sequence[float]) -> float | None:
    """Where ``ratio`` is passed between two stiffnesses, by their logarithms; None if nowhere."""
    above = np.array(ratios) > ratio
    turns = np.flatnonzero(above[1:] != above[:-1])
    finite = np.isfinite(ratios) & np.isfinite(kns)
    if len(turns) != 1 or not finite[turns[0] : turns[0] + 2].all():
        return None
    i = int(turns[0])
    share = (ratio - ratios[i]) / (ratios[i + 1] - ratios[i])
    return float(kns[i] * (kns[i + 1] / kns[i]) ** share)


def _path(row: Row) -> tuple[np.ndarray, np.ndarray]:
    """Times and heights; few where the model is drawn by markers."""
    t, y = (np.array(row["curve"][name]) for name in ("t_s", "tip_y_m"))
    if row["model"] == Model.SOLID:
        keep = np.searchsorted(t, np.linspace(t[0], t[-1], MARKERS))
        return t[keep], y[keep]
    return t, y


if __name__ == "__main__":
    as_script("sweep")
