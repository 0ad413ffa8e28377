"""Comparison of linear, second-order and finite-strain models of a leaning bristle's impact.

    docker/run python3 tests/reference/large_rotation.py > large-rotation.csv

On several ranks by ``mpirun -n 2 python3 …``. It takes an hour.
"""

from __future__ import annotations

import itertools
import sys
from dataclasses import dataclass

from mpi4py import MPI

from bristle.solver import paper
from bristle.studies.inputs.choices import Deflection, Model, Until
from bristle.studies.inputs.config import DropInputs
from bristle.studies.running.cases import CaseSession
from bristle.studies.running.files import to_csv
from bristle.studies.running.progress import logged_to_terminal, progress

BETA_S = 1e-8
ELEMENTS, MODES = 32, 40
# How the impact is computed, by its column.
MODELS = {
    "beam_linear": (Model.BEAM, Deflection.SMALL),
    "solid_linear": (Model.REDUCED, Deflection.SMALL),
    "beam_second": (Model.BEAM, Deflection.SECOND_ORDER),
    "solid_second": (Model.REDUCED, Deflection.SECOND_ORDER),
    "finite": (Model.SOLID, Deflection.FINITE),
}


@dataclass(frozen=True)
class Campaign:
    """Which impacts to compare; ``cells`` and ITS are the same for all models."""

    leans_deg: tuple[float, ...] = (0.0, 0.5, 1.0, 2.0, 5.0)
    frictions: tuple[float, ...] = (0.0, paper.FRICTION)
    heights_m: tuple[float, ...] = (0.01, 0.05)
    cells: tuple[int, int, int] = (1, 2, 168)
    its_s: float = paper.ITS_S
    kn_N_m: float = paper.KN_CHOSEN_N_M

    def case(
        self, model: Model, deflection: Deflection, height_m: float, mu: float, lean_deg: float
    ) -> DropInputs:
        """One impact of one model."""
        return DropInputs(
            model=model,
            deflection=deflection,
            height_m=height_m,
            friction=mu,
            tilt_deg=lean_deg,
            cells=self.cells,
            its_s=self.its_s,
            kn_N_m=self.kn_N_m,
            beta_s=BETA_S,
            elements=ELEMENTS,
            modes=MODES,
            until=Until.IMPACT,
        )

    def rows(self, comm: MPI.Intracomm) -> list[dict[str, float]]:
        """The share of speed kept by every model, gravity during contact left out; collective.

        A row an impact, by the names of the file's columns; ``wall_s`` is the finite strain's.
        """
        cases = list(itertools.product(self.heights_m, self.frictions, self.leans_deg))
        rows = []
        with progress("finite strain", len(cases)) as advance, CaseSession(comm) as session:
            for height, mu, lean in cases:
                row = {"height_mm": 1e3 * height, "friction": mu, "lean_deg": lean}
                for name, how in MODELS.items():
                    case = self.case(*how, height, mu, lean)
                    row[name], wall_s = speed_kept(session, case)
                row["linear_off"] = row["solid_linear"] - row["finite"]
                row["second_off"] = row["solid_second"] - row["finite"]
                rows.append(row | {"wall_s": wall_s})
                advance()
        return rows


def speed_kept(session: CaseSession, inputs: DropInputs) -> tuple[float, float]:
    """The centre's speed after over before, gravity during contact left out; and seconds."""
    result, timings = session.run(inputs)
    fallen = inputs.gravity_m_s2 * result.contact_time_s
    return (result.cm_velocity_after_m_s + fallen) / result.impact_speed_m_s, timings["march"]


def main() -> int:
    """Print the table as CSV from rank 0; the exit status."""
    comm = MPI.COMM_WORLD
    with logged_to_terminal():
        rows = Campaign().rows(comm)
        if comm.rank == 0:
            print(to_csv(list(rows[0]), [list(row.values()) for row in rows]), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
