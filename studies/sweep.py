"""How does the rebound depend on contact stiffness and height (Fig. 13)?

Writes table.csv, heights.svg and .png, and sweep.json. Also a script:
``mpirun -n 4 python3 -m bristle.studies.sweep --models beam,reduced``.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from .command.choices import Model
from .page.figures import picture
from .page.figures_paper import height_figure
from .running.files import write_picture
from .running.study import Row, Study, StudyInputs, run_study

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


def _path(row: Row) -> tuple[np.ndarray, np.ndarray]:
    """Times and heights; few where the model is drawn by markers."""
    t, y = (np.array(row["curve"][name]) for name in ("t_s", "tip_y_m"))
    if row["model"] == Model.SOLID:
        keep = np.searchsorted(t, np.linspace(t[0], t[-1], MARKERS))
        return t[keep], y[keep]
    return t, y


if __name__ == "__main__":
    from .cli import main

    sys.exit(main(["sweep", *sys.argv[1:]]))
