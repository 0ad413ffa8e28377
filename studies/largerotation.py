"""For which lean may the fast models be trusted? Linear, second order in slope, finite strain.

A script of its own, since the finite-strain solid refactors its tangent on the way:
``mpirun -n 2 python3 -m bristle.studies.largerotation --out results/largerotation``.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mpi4py import MPI

from ..meshes.collective import run_on_one_rank
from ..meshes.distribute import to_dolfinx
from ..meshes.geometry import MeshSpec, Rectangle, Tag
from ..solver import paper
from ..solver.bodies.beam import beam_body
from ..solver.bodies.reduced import reduce_solid
from ..solver.bodies.solid import SolidBody
from ..solver.bristle import Bristle, Material
from ..solver.contact.enforcement import ContactMethod
from ..solver.contact.laws import Coulomb, Linear
from ..solver.drop import DropPlan, FlightFrame, ModalFrame, simulate
from ..solver.finite.impact import impact, seen_from_body
from ..solver.rigid import leaning, matrix_of
from ..solver.time.scheme import TimeScheme
from .page.report import Column, Table
from .running.files import prepare_folder, write_atomically
from .running.progress import progress, say

BETA_S = 1e-8
ELEMENTS = 32
COLUMNS = (
    Column("height_mm", "height", "mm", 0),
    Column("friction", "μ", "", 0),
    Column("lean_deg", "lean", "°", 0),
    Column("beam_linear", "beam, linear"),
    Column("solid_linear", "3-D, linear"),
    Column("beam_second", "beam, second order"),
    Column("solid_second", "3-D reduced, second order"),
    Column("finite", "3-D, finite strain"),
    Column("linear_off", "linear − finite", "", 2),
    Column("second_off", "second order − finite", "", 2),
    Column("wall_s", "finite strain", "s", 2),
)


@dataclass(frozen=True)
class Campaign:
    """Which impacts to compare; ``cells`` and ITS are the same for all models."""

    leans_deg: tuple[float, ...] = (0.0, 0.5, 1.0, 2.0, 5.0)
    frictions: tuple[float, ...] = (0.0, paper.FRICTION)
    heights_m: tuple[float, ...] = (0.01, 0.05)
    cells: tuple[int, int, int] = (1, 2, 168)
    its_s: float = paper.ITS_S
    kn_N_m: float = paper.KN_CHOSEN_N_M

    def table(self, comm: MPI.Intracomm) -> Table:
        """The share of speed kept by every model, gravity during contact left out; collective."""
        material = Material(beta_s=BETA_S)
        spec = MeshSpec(
            paper.LENGTH_M, Rectangle(paper.THICKNESS_M, paper.WIDTH_M), self.cells, 1, 1.0
        )
        domain, _, facets = to_dolfinx(spec, comm)
        solid = SolidBody(domain, facets, int(Tag.TIP), material, 2)
        c_mass, c_stiffness = TimeScheme.average().effective(self.its_s, 0.0, BETA_S)
        bristle, shift = Bristle(material=material), c_mass / c_stiffness
        frames: list[FlightFrame] = [
            ModalFrame(beam_body(bristle, ELEMENTS)),
            ModalFrame(reduce_solid(solid, shift, 40, leaning=True).bounded()),
            ModalFrame(beam_body(bristle, ELEMENTS, second_order=True)),
            ModalFrame(reduce_solid(solid, shift, 40, leaning=True, second_order=True).bounded()),
        ]
        cases = [
            (height, mu, lean)
            for height in self.heights_m
            for mu in self.frictions
            for lean in self.leans_deg
        ]
        rows = []
        with progress("finite strain", len(cases)) as advance:
            for height, mu, lean in cases:
                fast = [self._fast(frame, height, mu, lean) for frame in frames]
                started = time.perf_counter()
                finite = self._finite(solid, height, mu, lean)
                wall = time.perf_counter() - started
                off = (fast[1] - finite, fast[3] - finite)
                rows.append((1e3 * height, mu, lean, *fast, finite, *off, wall))
                advance()
        solid.close()
        return Table(
            "largerotation",
            f"Share of the impact speed kept, β = {BETA_S:g} s, Kn = {self.kn_N_m / 1e6:g} MN/m, "
            f"ITS {1e3 * self.its_s:g} ms, {' × '.join(map(str, self.cells))} cells.",
            COLUMNS,
            rows,
        )

    def _fast(self, frame: FlightFrame, height_m: float, mu: float, lean_deg: float) -> float:
        method = ContactMethod(Linear(self.kn_N_m), friction=Coulomb(mu))
        plan = DropPlan(
            height_m,
            method,
            self.its_s,
            paper.GRAVITY_M_S2,
            tilt_deg=lean_deg,
            impact_only=True,
        )
        result = simulate(frame, plan)
        fallen = paper.GRAVITY_M_S2 * result.contact_time_s
        return (result.cm_velocity_after_m_s + fallen) / result.impact_speed_m_s

    def _finite(self, solid: SolidBody, height_m: float, mu: float, lean_deg: float) -> float:
        normal = seen_from_body(np.asarray(matrix_of(leaning(lean_deg))))
        result = impact(
            solid.domain,
            solid.facet_tags,
            solid.tip_tag,
            solid.material,
            solid.order,
            normal=normal,
            gravity_m_s2=-paper.GRAVITY_M_S2 * normal,
            velocity_m_s=-math.sqrt(2.0 * paper.GRAVITY_M_S2 * height_m) * normal,
            kn_N_m=self.kn_N_m,
            friction=mu,
            its_s=self.its_s,
            clear_s=2e-4,
        )
        return float(result.speed_kept)


def main(arguments: Sequence[str] | None = None) -> int:
    """Compute the table and write ``largerotation.csv``; the exit status."""
    parser = argparse.ArgumentParser(prog="bristle.studies.largerotation", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/largerotation"))
    parser.add_argument("--leans", type=float, nargs="+", metavar="DEG")
    parser.add_argument("--heights", type=float, nargs="+", metavar="M")
    parser.add_argument("--cells", type=int, nargs=3, metavar=("NX", "NY", "NZ"))
    given = parser.parse_args(arguments)
    usual = Campaign()
    campaign = Campaign(
        leans_deg=tuple(given.leans or usual.leans_deg),
        heights_m=tuple(given.heights or usual.heights_m),
        cells=tuple(given.cells or usual.cells),
    )
    comm = MPI.COMM_WORLD
    run_on_one_rank(comm, lambda: prepare_folder(given.out))
    table = campaign.table(comm)
    path = given.out / "largerotation.csv"
    run_on_one_rank(comm, lambda: write_atomically(path, table.csv_text()))
    for row in table.rows:
        say("  ".join(f"{value:.4g}" for value in row if isinstance(value, float)))
    say(f"wrote {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
