"""How do time and memory of the full-order solid grow with its size?

`bristle bench sizes` asks it. Each size runs in a process of its own, so that its greatest memory
is its own: this file as a script.
"""

from __future__ import annotations

import json
import math
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...solver import paper
from ...solver.errors import ComputationError, InputError
from ...solver.time.scheme import TimeScheme
from ..running.files import prepare_folder, records_to_csv, to_json, together, write_atomically
from ..running.progress import progress
from .machine import facts, load

if TYPE_CHECKING:
    from ...solver.bodies.solid import SolidBody

# The paper's bristle, divided ever finer along it; and along and across it.
ALONG = tuple((1, 4, cells) for cells in (308, 617, 1851, 6172, 18518))
ALL_WAYS = ((1, 4, 337), (2, 8, 674), (3, 12, 1011), (4, 16, 1348))
# A cube, direct against iterative.
COMPACT = ((8, 8, 8), (12, 12, 12), (16, 16, 16), (20, 20, 20))
CUBE_M = 0.01
ORDER = 2
STEPS = 5
PARTS = ("mesh_s", "assemble_s", "factor_s", "step_s", "peak_MB")


@dataclass(frozen=True)
class Line:
    """One size: wall seconds, the step the least of ``repeats``, and the process' greatest memory.

    ``factor_s`` has everything between the matrices and the first step. In the series `compact`,
    and under conjugate gradients, a step is the solve alone: marching would first ask for a solve
    for each node of the tip.
    ``bytes_per_unknown`` is what memory grew by since before the mesh.
    """

    series: str
    cells: str
    order: int
    unknowns: int
    ranks: int
    repeats: int
    method: str
    mesh_s: float
    assemble_s: float
    factor_s: float
    step_s: float
    iterations: int | None
    bytes_per_unknown: float
    peak_MB: float


def peak_bytes() -> int:
    """The greatest memory that this process has held."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def size_line(series: str, cells: tuple[int, int, int], solver: str) -> Line:
    """Measure one size in this process."""
    from ...solver.bodies.linear import Iterative, Method, Solver
    from .step import bar_solid

    sides = (CUBE_M,) * 3 if series == "compact" else None
    tiny = bar_solid((1, 1, 4), ORDER)[0]  # forms and loops are compiled before anything is timed
    _marching(tiny)()
    tiny.close()
    before = peak_bytes()
    solid, seconds = bar_solid(cells, ORDER, Solver(solver), sides)
    started = time.perf_counter()
    alone = bool(sides) or solid.method is Method.ITERATIVE
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
        peak_MB=peak / 2**20,
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
    prepare_folder(out)
    about = [load(), *facts()]
    lines, failed = [], []
    # a size takes about as long as it has unknowns
    total = sum(unknowns(cells) for _, cells, _ in cases)
    with progress("Unknowns of all sizes", total) as advance:
        for series, cells, solver in cases:
            try:
                lines.append(_apart(series, cells, solver))
            except ComputationError as error:
                failed.append(f"{series} {cells} {solver}: {error}")
            growth = exponents(lines)
            document = {"lines": [asdict(x) for x in lines], "exponents": growth, "failed": failed}
            with together(out, "sizes.json"):
                write_atomically(out / "sizes.csv", records_to_csv(Line, lines))
                write_atomically(out / "sizes.json", to_json(document))
            advance(unknowns(cells))
    # not before: a child's peak has in it what its parent held
    from .sizes_page import page

    page(lines, growth, failed, out, largest, about)
    return "\n".join([*map(_told, lines), *_growth(growth), *failed])


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


def _apart(series: str, cells: tuple[int, int, int], solver: str) -> Line:
    """`size_line` in a process of its own; ComputationError where that does not end well."""
    command = [sys.executable, "-m", __spec__.name, "--one", series, solver, *map(str, cells)]
    one_thread = {"OMP_NUM_THREADS": "1", **os.environ}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=one_thread)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["nothing said"])[-1]
        raise ComputationError(f"ended with status {done.returncode}: {last}")
    return Line(**json.loads(done.stdout.splitlines()[-1]))


def exponents(lines: list[Line]) -> dict[str, dict[str, float]]:
    """By series and method, the exponent of each part's growth with the number of unknowns.

    By least squares of logarithms, where there are three sizes or more.
    """
    groups: dict[str, list[Line]] = {}
    for line in lines:
        groups.setdefault(f"{line.series}, {line.method}", []).append(line)
    return {
        name: {part: _slope(group, part) for part in PARTS}
        for name, group in groups.items()
        if len(group) > 2
    }


def _slope(lines: list[Line], part: str) -> float:
    x = np.log([line.unknowns for line in lines])
    if part == "peak_MB":
        # without the interpreter and its libraries, which do not grow
        y = np.log([line.bytes_per_unknown * line.unknowns for line in lines])
    else:
        y = np.log([getattr(line, part) for line in lines])
    return float(np.polyfit(x, y, 1)[0])


def _told(line: Line) -> str:
    iterations = "" if line.iterations is None else f", {line.iterations} iterations"
    return (
        f"{line.series:<8} {line.cells:>12}, order {line.order}, {line.unknowns:>8} unknowns, "
        f"{line.ranks} rank, {line.method}: mesh {line.mesh_s:.3g} s, "
        f"assembly {line.assemble_s:.3g} s, factor {line.factor_s:.3g} s, "
        f"step {1e3 * line.step_s:.3g} ms (least of {line.repeats}{iterations}), "
        f"{line.bytes_per_unknown:.0f} bytes an unknown, peak {line.peak_MB:.0f} MB"
    )


def _growth(growth: dict[str, dict[str, float]]) -> list[str]:
    names = {part: part.split("_")[0] for part in PARTS}
    return [
        f"{group}: exponents " + ", ".join(f"{names[p]} {slope:.2f}" for p, slope in found.items())
        for group, found in growth.items()
    ]


def main(arguments: list[str]) -> None:
    """Print the line of one size, as `_apart` asks for it."""
    _, series, solver, *cells = arguments
    x, y, z = map(int, cells)
    print(json.dumps(asdict(size_line(series, (x, y, z), solver))))


if __name__ == "__main__":
    main(sys.argv[1:])
