"""What does a step of the full-order solid cost, over a triangular solve and over reading memory?

`bristle bench step` asks it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median

import numpy as np
from mpi4py import MPI

from ...meshes.distribute import to_dolfinx
from ...meshes.geometry import MeshSpec, Tag
from ...meshes.section import Rectangle
from ...solver import paper
from ...solver.bodies.direct import Cholesky
from ...solver.bodies.linear import Solver
from ...solver.bodies.solid import SolidBody
from ...solver.bristle import Material
from ...solver.compiled import fast
from ...solver.contact.enforcement import ContactMethod
from ...solver.contact.laws import Linear
from ...solver.time.march import Marcher
from ...solver.time.scheme import TimeScheme
from ..running.files import prepare_folder, records_to_csv, to_json, together, write_atomically
from ..running.progress import progress
from .machine import facts, load

BODIES = (((1, 4, 337), 2), ((2, 8, 337), 2), ((1, 4, 337), 1))
REPEATS = 15
TRIAD = 1 << 24
DOUBLE = 8


@dataclass(frozen=True)
class Line:
    """One body: times in ms of processor time, medians of ``repeats`` in turn; GB/s at their best.

    ``over_read`` is the solve over one reading of the factor by the plainest loop there is;
    forward and backward substitution are two such readings.
    """

    cells: str
    order: int
    unknowns: int
    ranks: int
    repeats: int
    method: str
    factor_entries: int
    read_GB_s: float
    triad_GB_s: float
    read_ms: float
    solve_ms: float
    mass_ms: float
    step_ms: float
    contact_step_ms: float
    over_read: float
    step_over_solve: float
    contact_step_over_solve: float


@fast
def read(x: np.ndarray) -> float:
    """The sum of ``x``: a memory's greatest speed of reading."""
    total = 0.0
    for i in range(len(x)):
        total += x[i]
    return total


@fast
def triad(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> None:
    """a = b + 3 c, as in STREAM (McCalpin 1995)."""
    for i in range(len(a)):
        a[i] = b[i] + 3.0 * c[i]


def bar_solid(
    cells: tuple[int, int, int],
    order: int,
    solver: Solver = Solver.AUTO,
    sides_m: tuple[float, float, float] | None = None,
) -> tuple[SolidBody, dict[str, float]]:
    """A bar on this process alone, and the seconds of its mesh and its matrices.

    ``sides_m`` are thickness, width and length, by default the paper's bristle.
    """
    started = time.perf_counter()
    thickness, width, length = sides_m or (paper.THICKNESS_M, paper.WIDTH_M, paper.LENGTH_M)
    spec = MeshSpec(length, Rectangle(thickness, width), cells)
    domain, _, facets = to_dolfinx(spec, MPI.COMM_SELF)
    meshed = time.perf_counter()
    solid = SolidBody(domain, facets, int(Tag.TIP), Material(), order, solver=solver)
    assembled = time.perf_counter()
    return solid, {"mesh": meshed - started, "assemble": assembled - meshed}


def dropped(solid: SolidBody) -> Marcher:
    """A march of the paper's drop."""
    method = ContactMethod(Linear(paper.KN_CHOSEN_N_M))
    return Marcher(solid, method, TimeScheme.average(), paper.ITS_S, paper.GRAVITY_M_S2)


def in_turn(what: dict[str, Callable[[], object]], repeats: int) -> dict[str, list[float]]:
    """Milliseconds of processor time of each, one after another, ``repeats`` times."""
    found: dict[str, list[float]] = {name: [] for name in what}
    for turn in range(repeats + 1):
        for name, act in what.items():
            started = time.process_time()
            act()
            if turn:
                found[name].append(1e3 * (time.process_time() - started))
    return found


def step_line(cells: tuple[int, int, int], order: int, repeats: int = REPEATS) -> Line:
    """Measure one body."""
    solid, _ = bar_solid(cells, order)
    marcher = dropped(solid)
    solver = next(iter(solid._solvers.values()))
    assert isinstance(solver, Cholesky)
    entries = solver.entries
    factor = np.full(entries, 1e-9)
    speed = math.sqrt(2.0 * paper.GRAVITY_M_S2 * paper.HEIGHTS_M[-1])
    falling = -speed * solid.translation[:, 2]
    touching = marcher.start(0.0, np.zeros(solid.n_local), falling)
    above = marcher.start(0.0, 1e-3 * solid.translation[:, 2], falling)
    b = solid.mass(np.random.default_rng(0).standard_normal(solid.n_local))
    arrays = [np.ones(TRIAD) for _ in range(3)]
    found = in_turn(
        {
            "read": lambda: read(factor),
            "triad": lambda: triad(*arrays),
            "solve": lambda: solver.solve(b),
            "mass": lambda: solid.mass(b),
            "step": lambda: marcher.step(above),
            "contact": lambda: marcher.step(touching),
        },
        repeats,
    )
    ms = {name: median(values) for name, values in found.items()}
    line = Line(
        cells=" ".join(map(str, cells)),
        order=order,
        unknowns=solid.n_dofs,
        ranks=1,
        repeats=repeats,
        method=str(solid.method),
        factor_entries=entries,
        read_GB_s=1e-6 * DOUBLE * entries / min(found["read"]),
        triad_GB_s=1e-6 * 3 * DOUBLE * TRIAD / min(found["triad"]),
        read_ms=ms["read"],
        solve_ms=ms["solve"],
        mass_ms=ms["mass"],
        step_ms=ms["step"],
        contact_step_ms=ms["contact"],
        over_read=ms["solve"] / ms["read"],
        step_over_solve=ms["step"] / ms["solve"],
        contact_step_over_solve=ms["contact"] / ms["solve"],
    )
    solid.close()
    return line


def run_step(
    out: Path,
    bodies: tuple[tuple[tuple[int, int, int], int], ...] = BODIES,
    repeats: int = REPEATS,
) -> str:
    """Measure ``bodies`` (cells, order); write step.csv, step.json, report.html; the table.

    Everything runs on one rank and one thread.
    """
    from .step_page import page

    prepare_folder(out)
    about = [load(), *facts()]
    lines = []
    with progress("Bodies", len(bodies)) as advance:
        for cells, order in bodies:
            lines.append(step_line(cells, order, repeats))
            advance()
    with together(out, "step.json"):
        write_atomically(out / "step.csv", records_to_csv(Line, lines))
        write_atomically(out / "step.json", to_json([asdict(x) for x in lines]))
        page(lines, out, repeats, about)
    return "\n".join(_told(line) for line in lines)


def _told(line: Line) -> str:
    return (
        f"{line.cells}, order {line.order}, {line.unknowns} unknowns, {line.ranks} rank, "
        f"{line.repeats} repeats, {line.method} factor of {line.factor_entries / 1e6:.1f} million\n"
        f"  read at {line.read_GB_s:.1f} GB/s, triad at {line.triad_GB_s:.1f} GB/s\n"
        f"  solve {line.solve_ms:.2f} ms, {line.over_read:.2f} times one reading of the factor "
        f"(goal 2; forward and back are two readings)\n"
        f"  step {line.step_ms:.2f} ms free, {line.contact_step_ms:.2f} ms in contact: "
        f"{line.step_over_solve:.2f} and {line.contact_step_over_solve:.2f} solves (goal 1.3)"
    )
