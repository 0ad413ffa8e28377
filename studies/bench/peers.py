"""How do this program and others compare in time, memory and error, on the same impact and mesh?

Every call is a process of its own, one at a time: each program in turn, then all of them again, so
that what slows the machine for a while slows all alike.
"""

from __future__ import annotations

import json
import math
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from mpi4py import MPI

from ...solver.errors import ComputationError, InputError
from ..inputs.fields import MODES
from ..running.files import prepare_folder, to_csv, to_json, together, write_atomically
from ..running.progress import progress
from .machine import facts, load
from .peers_page import page
from .peers_table import Converged, Point, Run, converged, points
from .peers_text import told
from .programs import (
    DAMPED,
    PROGRAMS,
    QUANTITIES,
    REFERENCES,
    UNDAMPED,
    Bench,
    Physics,
    Program,
    Setting,
    bench_folder,
)

REPEATS = 3
# The converged value: an ITS so short, and half of it, with so many times the Krylov vectors.
FINE_ITS_S, FINE_MODES = 1e-6, 2


@dataclass(frozen=True)
class Block:
    """One physics on one mesh, and the ITS at which programs compute it."""

    physics: Physics
    cells: tuple[int, int, int]
    its_s: tuple[float, ...]
    modes: int = MODES


# A mesh that every program gets through quickly and that is fine enough; and one as large as a
# user would take to be safe. Undamped waves are too sharp for the usual number of modes.
BLOCKS = (
    Block(DAMPED, (1, 2, 42), (2e-5, 1e-5, 5e-6, 2.5e-6)),
    Block(DAMPED, (1, 2, 168), (1e-5, 5e-6)),
    Block(UNDAMPED, (1, 2, 42), (5e-6, 2.5e-6, 1.25e-6), modes=100),
)


def run_peers(out: Path, repeats: int = REPEATS, blocks: tuple[Block, ...] = BLOCKS) -> str:
    """Measure all programs; write points.csv, runs.json and report.html; the table as text.

    A program that is not there, or fails, has a line that says so. Raises InputError under mpirun,
    ComputationError where this program itself fails.
    """
    if MPI.COMM_WORLD.size > 1:
        raise InputError("bench peers measures one process at a time: run it without mpirun")
    prepare_folder(out)
    started, about = time.perf_counter(), [load(), *facts()]
    plan = [
        (program, Setting(block.physics, block.cells, its, block.modes))
        for block in blocks
        for its in block.its_s
        for program in PROGRAMS
        if block.physics.name in program.physics and not program.absent()
    ]
    runs: list[Run] = []
    with bench_folder() as folder, progress("Calls", repeats * len(plan)) as advance:
        place = Bench(Path(folder))
        _compile(place)
        to = {name: _converged(place, block) for name, block in _finest(blocks).items()}
        for repeat in range(repeats):
            for program, setting in plan:
                answer = program.answer(setting, place, further=repeat == 0)
                runs.append(Run(program.name, setting, answer))
                advance()
    _check_own(runs)
    found = points(runs, to)
    with together(out, "runs.json"):
        write_atomically(out / "points.csv", _csv(found))
        write_atomically(out / "runs.json", to_json([asdict(run) for run in runs]) + "\n")
        page(found, to, runs, out, repeats, about)
    wall = time.perf_counter() - started
    return told(found, to, runs) + f"\n{len(runs)} calls in {wall:.0f} s: {out / 'report.html'}"


def _compile(place: Bench) -> None:
    """Have every program compile what it compiles once, by a short call that does not count."""
    for program in PROGRAMS:
        if not program.absent():
            physics = DAMPED if DAMPED.name in program.physics else UNDAMPED
            program.answer(Setting(physics, (1, 1, 4), 2e-5), place)


def _finest(blocks: tuple[Block, ...]) -> dict[str, Block]:
    """The block with most cells of each physics."""
    in_order = sorted(blocks, key=lambda block: math.prod(block.cells))
    return {block.physics.name: block for block in in_order}


def _converged(place: Bench, block: Block) -> Converged:
    """What this program's reduced solid tends to on the mesh of ``block``, and the exact rod's."""
    physics = block.physics
    program = Program("converged", model="reduced", fresh=False)
    found = []
    for its in (FINE_ITS_S, 0.5 * FINE_ITS_S):
        answer = program.answer(Setting(physics, block.cells, its, FINE_MODES * block.modes), place)
        if answer.why_not:
            raise ComputationError(
                f"the converged value of the {physics.name} drop {answer.why_not}"
            )
        found.append(answer.found)
    rod: dict[str, float] = {}
    script = REFERENCES / "modal_series.py"
    if script.exists():
        options = ["--kn", "--height", "--beta"]
        values = (physics.kn_N_m, physics.height_m, physics.beta_s)
        pairs = [text for pair in zip(options, map(repr, values), strict=True) for text in pair]
        done, answer = place.run([str(script), *pairs])
        if not answer.why_not:
            rod = json.loads(done.stdout.splitlines()[-1])
    coarse, fine = found
    return converged(coarse, fine, rod)


def _check_own(runs: list[Run]) -> None:
    own = {program.name for program in PROGRAMS if program.model}
    for run in runs:
        if run.program in own and run.answer.why_not:
            raise ComputationError(
                f"{run.program} at an ITS of {run.setting.its_s:g} s {run.answer.why_not}"
            )


def _csv(found: list[Point]) -> str:
    columns = (
        *("physics", "program", "cells_x", "cells_y", "cells_z", "its_s", "n_steps", "n_dofs"),
        *QUANTITIES,
        *(f"{name}_error" for name in QUANTITIES),
        *("wall_s", "wall_low_s", "wall_high_s", "further_s", "peak_rss_MB", "repeats"),
    )
    rows = [
        (
            *(each.setting.physics.name, each.program, *each.setting.cells, each.setting.its_s),
            *(each.found[name] for name in ("n_steps", "n_dofs", *QUANTITIES)),
            *(each.errors[name] for name in QUANTITIES),
            *(each.wall_s, each.wall_low_s, each.wall_high_s, each.further_s),
            *(each.peak_rss_MB, each.repeats),
        )
        for each in found
    ]
    return to_csv(columns, rows)
