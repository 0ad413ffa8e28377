"""`bristle bench step`: a step of the full-order solid over a solve and over reading memory."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np
from mpi4py import MPI

from bristle.meshes.distribute import to_dolfinx
from bristle.meshes.geometry import MeshSpec, Tag
from bristle.meshes.section import Rectangle
from bristle.solver import paper
from bristle.solver.bodies.linear import Cholesky, Solver
from bristle.solver.bodies.solid import SolidBody
from bristle.solver.bristle import Material
from bristle.solver.compiled import fast
from bristle.solver.contact.enforcement import ContactMethod
from bristle.solver.contact.laws import Linear
from bristle.solver.time.march import Marcher
from bristle.solver.time.scheme import TimeScheme
from bristle.studies.running.progress import progress

from .column import column
from .records import Part, curves_figure, prepare, publish

BODIES = (((1, 4, 337), 2), ((2, 8, 337), 2), ((1, 4, 337), 1))
REPEATS = 15
TRIAD = 1 << 24
DOUBLE = 8
READINGS, SOLVES = 2.0, 1.3
TIMES = {
    "read_ms": "one reading of the factor",
    "solve_ms": "a solve",
    "mass_ms": "a product with M",
    "step_ms": "a step, free",
    "contact_step_ms": "a step in contact",
}
HOW = (
    "A time step of the solid at full order, over a solve and over reading memory.",
    "One rank, one thread, processor time. Each act is timed in turn, then all again; shown are "
    "medians. The step is that of the paper's drop at its ITS, with the average acceleration.",
    "Reading is the plainest loop over the factor there is, at the speed measured beside it. "
    "Forward and back substitution each need the whole factor, so two readings are the least.",
)


@dataclass(frozen=True, kw_only=True)
class Line:
    """One body: times in ms of processor time, medians of ``repeats`` in turn; GB/s at their best.

    ``over_read`` is the solve over one reading of the factor by the plainest loop there is;
    forward and backward substitution are two such readings.
    """

    cells: str = column("Cells")
    order: int = column("Order", digits=0)
    unknowns: int = column("Unknowns", digits=0)
    ranks: int
    repeats: int
    method: str = column("Factor")
    factor_entries: int = column("numbers in it", digits=0)
    read_GB_s: float = column("Reading", "GB/s")
    triad_GB_s: float = column("Triad", "GB/s")
    read_ms: float = column("One reading", "ms")
    solve_ms: float = column("A solve", "ms")
    mass_ms: float = column("Product with M", "ms")
    step_ms: float = column("Step, free", "ms")
    contact_step_ms: float = column("in contact", "ms")
    over_read: float = column("Solve over reading")
    step_over_solve: float = column("Step over solve")
    contact_step_over_solve: float = column("in contact")


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
    about = prepare("step", out)
    lines = []
    with progress("Bodies", len(bodies)) as advance:
        for cells, order in bodies:
            lines.append(step_line(cells, order, repeats))
            advance()
    return page(lines, out, repeats, about)


def page(lines: Sequence[Line], out: Path, repeats: int, about: Sequence[tuple[str, str]]) -> str:
    """Write the records with their page, the table as text; ``about`` is the machine."""
    unknowns = [line.unknowns for line in lines]
    times = {
        name: (unknowns, [getattr(line, key) for line in lines]) for key, name in TIMES.items()
    }
    drawn = curves_figure("unknowns", {"time (ms)": times})
    caption = "What a step of the full order is made of, against the number of unknowns."
    return publish(
        "step",
        [Part("step", "A step and its parts", lines, drawn, caption)],
        out,
        title="What a step costs",
        command=("step", "--repeats", repeats),
        headline=[
            f"{line.unknowns} unknowns (order {line.order}): a solve takes {line.solve_ms:.3g} ms "
            f"or {line.over_read:.2g} readings of its factor (goal {READINGS:g}), a step "
            f"{line.step_over_solve:.3g} solves, {line.contact_step_over_solve:.3g} in contact "
            f"(goal {SOLVES:g})."
            for line in lines
        ],
        about=about,
        how=HOW,
    )
