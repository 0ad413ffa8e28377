"""`bristle bench sizes`: time and memory of the full-order solid against its size.

Each size runs in a process of its own, so that its greatest memory is its own.
"""

from __future__ import annotations

import math
import resource
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bristle.solver import paper
from bristle.solver.errors import ComputationError, InputError
from bristle.solver.time.scheme import TimeScheme
from bristle.studies.running.progress import progress

from .apart import apart, call
from .column import column

if TYPE_CHECKING:
    from bristle.solver.bodies.solid import SolidBody

# The paper's bristle, divided ever finer along it; and along and across it.
ALONG = tuple((1, 4, cells) for cells in (308, 617, 1851, 6172, 18518))
ALL_WAYS = ((1, 4, 337), (2, 8, 674), (3, 12, 1011), (4, 16, 1348))
# A cube, direct against iterative.
COMPACT = ((8, 8, 8), (12, 12, 12), (16, 16, 16), (20, 20, 20))
CUBE_M = 0.01
ORDER = 2
STEPS = 5
PARTS = ("mesh_s", "assemble_s", "factor_s", "step_s", "peak_MB")
PANELS = {
    "factor_s": "before the first step (s)",
    "step_s": "a step (s)",
    "peak_MB": "memory (MB)",
}
HOW = (
    "The solid at full order, from small to large.",
    "Each size is a process of its own on one rank and one thread, so that its greatest memory is "
    "its own; a step is the least of its repeats. Memory per unknown is what the process grew by "
    "since before the mesh.",
    "Along: the paper's bristle, divided ever finer along its axis. All ways: along and across it. "
    "Compact: a cube, directly and iteratively.",
    "A step of a cube, and one under conjugate gradients, is the solve alone.",
    "Before the first step: factor, compliance of the contact points, and what else a march needs.",
)


@dataclass(frozen=True, kw_only=True)
class Line:
    """One size: wall seconds, the step the least of ``repeats``, and the process' greatest memory.

    ``factor_s`` has everything between the matrices and the first step. In the series `compact`,
    and under conjugate gradients, a step is the solve alone: marching would first ask for a solve
    for each node of the tip.
    ``bytes_per_unknown`` is what memory grew by since before the mesh.
    """

    series: str = column("Series")
    cells: str = column("Cells")
    order: int
    unknowns: int = column("Unknowns", digits=0)
    ranks: int
    repeats: int
    method: str = column("Method")
    mesh_s: float = column("Mesh", "s")
    assemble_s: float = column("Assembly", "s")
    factor_s: float = column("Before the first step", "s")
    step_s: float = column("Step", "s")
    iterations: int | None = column("Iterations", digits=0)
    bytes_per_unknown: float = column("An unknown", "bytes")
    peak_MB: float = column("Memory", "MB")


@dataclass(frozen=True)
class Growth:
    """Exponents with which each part grows with the number of unknowns, in a series by a method."""

    series: str = column("Series and method")
    mesh_s: float = column("Mesh")
    assemble_s: float = column("Assembly")
    factor_s: float = column("Before the first step")
    step_s: float = column("Step")
    peak_MB: float = column("Memory")


def peak_bytes() -> int:
    """The greatest memory that this process has held."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def size_line(series: str, cells: tuple[int, int, int], solver: str) -> Line:
    """Measure one size in this process."""
    from bristle.solver.bodies.linear import Iterative, Solver

    from .step import bar_solid

    sides = (CUBE_M,) * 3 if series == "compact" else None
    tiny = bar_solid((1, 1, 4), ORDER)[0]  # forms and loops are compiled before anything is timed
    _marching(tiny)()
    tiny.close()
    before = peak_bytes()
    solid, seconds = bar_solid(cells, ORDER, Solver(solver), sides)
    started = time.perf_counter()
    alone = bool(sides) or solid.method is Solver.ITERATIVE
    act = _solving(solid) if alone else _marching(solid)
    factored = time.perf_counter() - started
    steps = []
    for _ in range(STEPS):
        started = time.perf_counter()
        act()
        steps.append(time.perf_counter() - started)
    used = next(iter(solid._solvers.values()))
    peak = peak_bytes()
    return Line(
        series=series,
        cells=" ".join(map(str, cells)),
        order=ORDER,
        unknowns=solid.n_dofs,
        ranks=1,
        repeats=STEPS,
        method=str(solid.method),
        mesh_s=seconds["mesh"],
        assemble_s=seconds["assemble"],
        factor_s=factored,
        step_s=min(steps),
        iterations=used.iterations if isinstance(used, Iterative) else None,
        bytes_per_unknown=(peak - before) / solid.n_dofs,
        peak_MB=peak / 1e6,
    )


def _marching(solid: SolidBody) -> Callable[[], object]:
    """Steps of the paper's drop, in contact."""
    from .step import dropped

    marcher = dropped(solid)
    speed = math.sqrt(2.0 * paper.GRAVITY_M_S2 * paper.HEIGHTS_M[-1])
    states = [marcher.start(0.0, np.zeros(solid.n_local), -speed * solid.translation[:, 2])]

    def step() -> None:
        states.append(marcher.step(states.pop()).state)

    return step


def _solving(solid: SolidBody) -> Callable[[], object]:
    """Solves of the step's equations, loaded by the tip's nodes."""
    effective = TimeScheme.average().effective(paper.ITS_S, solid.alpha_1_s, solid.beta_s)
    solve = solid.factor(*effective)
    load = np.asarray(solid.contact.coordinates.sum(axis=0)).ravel()
    return lambda: solve(load)


def unknowns(cells: tuple[int, int, int]) -> int:
    """Of a body of so many cells."""
    return 3 * math.prod(ORDER * count + 1 for count in cells)


def run_sizes(out: Path, largest: int = 3_000_000) -> str:
    """Every size up to ``largest`` unknowns; writes sizes.csv, sizes.json and report.html into
    ``out``; the table.

    A size that the machine cannot do is told, and the rest goes on.
    """
    cases = list(_cases(largest))
    if not cases:
        raise InputError(f"--largest: the smallest size has more unknowns than {largest}")
    from .records import prepare

    about = prepare("sizes", out)
    lines, failed = [], []
    # a size takes about as long as it has unknowns
    total = sum(unknowns(cells) for _, cells, _ in cases)
    with progress("Unknowns of all sizes", total) as advance:
        for series, cells, solver in cases:
            try:
                case = call("sizes.size_line", series=series, cells=cells, solver=solver)
                lines.append(Line(**apart(case, OMP_NUM_THREADS="1")))
            except ComputationError as error:
                failed.append(f"{series} {cells} {solver}: {error}")
            advance(unknowns(cells))
    # not before: a child's peak has in it what its parent held
    return page(lines, failed, out, largest, about)


def page(
    lines: Sequence[Line],
    failed: Sequence[str],
    out: Path,
    largest: int,
    about: Sequence[tuple[str, str]],
) -> str:
    """Write the records with their page, the tables as text; ``about`` is the machine."""
    from .records import Part, curves_figure, publish

    growth = exponents(lines)
    by_panel = {
        label: {
            name: ([line.unknowns for line in own], [getattr(line, key) for line in own])
            for name, own in groups(lines).items()
        }
        for key, label in PANELS.items()
    }
    drawn = curves_figure("unknowns", by_panel)
    parts = [
        Part(
            "sizes",
            "Every size",
            lines,
            drawn,
            "Time before the first step, time of a step, and the process' greatest memory against "
            "the number of unknowns.",
            [f"Not done: {each}." for each in failed],
        )
    ]
    if growth:
        parts.append(
            Part(
                "exponents",
                "Exponents of growth",
                growth,
                note="By least squares of logarithms over three sizes or more; memory without what "
                "a process has from its start.",
            )
        )
    return publish(
        "sizes",
        parts,
        out,
        title="Time and memory against size",
        command=("sizes", "--largest", largest),
        headline=[
            f"{each.series.capitalize()}: a step grows with the unknowns to the power "
            f"{each.step_s:.2f}, the factor {each.factor_s:.2f}, memory {each.peak_MB:.2f}."
            for each in growth
        ],
        about=about,
        how=HOW,
        further={"failed": list(failed)},
    )


def _cases(largest: int) -> Iterable[tuple[str, tuple[int, int, int], str]]:
    for series, sizes, solvers in (
        ("along", ALONG, ("auto",)),
        ("all ways", ALL_WAYS, ("auto",)),
        ("compact", COMPACT, ("direct", "iterative")),
    ):
        for cells in sizes:
            # the names of sizes are round: 3e6 is 81 unknowns more
            if unknowns(cells) <= 1.001 * largest:
                for solver in solvers:
                    yield series, cells, solver


def groups(lines: Sequence[Line]) -> dict[str, list[Line]]:
    """Lines by series and method."""
    found: dict[str, list[Line]] = {}
    for line in lines:
        found.setdefault(f"{line.series}, {line.method}", []).append(line)
    return found


def exponents(lines: Sequence[Line]) -> list[Growth]:
    """By series and method, the exponent of each part's growth with the number of unknowns.

    By least squares of logarithms, where there are three sizes or more.
    """
    return [
        Growth(name, *(_slope(own, part) for part in PARTS))
        for name, own in groups(lines).items()
        if len(own) > 2
    ]


def _slope(lines: list[Line], part: str) -> float:
    x = np.log([line.unknowns for line in lines])
    if part == "peak_MB":
        # without the interpreter and its libraries, which do not grow
        y = np.log([line.bytes_per_unknown * line.unknowns for line in lines])
    else:
        y = np.log([getattr(line, part) for line in lines])
    return float(np.polyfit(x, y, 1)[0])
