"""`bristle bench`: this program and others in time, memory and error, on one impact and mesh.

Every call is a process of its own, one at a time: each program in turn, then all of them again, so
that what slows the machine for a while slows all alike.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from mpi4py import MPI

from bristle.solver.errors import ComputationError, InputError
from bristle.studies.inputs.fields import MODES
from bristle.studies.running.progress import progress

from .column import column
from .peers_points import (
    LEVELS,
    Converged,
    Point,
    Reached,
    Run,
    blocks,
    by_program,
    converged,
    points,
    reached,
)
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
    options,
)
from .records import Part, curves_figure, prepare, publish

REPEATS = 3
NEVER = "–"
ERRORS = ("rebound_ratio_error", "contact_time_error", "peak_force_error")
TITLES = {
    "damped": "With the paper's damping",
    "undamped": "Without damping",
}
HOW = (
    "Time, memory and error of programs that compute the same impact.",
    "One impact: the paper's bristle falls upright from 50 mm on Kn = 2 MN/m. Programs of solids "
    "share the mesh (quadratic hexahedra; CalculiX has 20 nodes in a cell, the others 27); the "
    "beam has 16 elements. All march with the average acceleration; this program alone takes the "
    "contact force so that energy is conserved. CalculiX cuts its steps where contact changes.",
    "Every call is a process of its own, on one thread and with nothing else running: each program "
    "in turn, then all again. Time is that of the whole process, from its start to its end: the "
    "median of the repeats. Memory is the kernel's peak of the process. What is compiled once and "
    "kept was compiled before.",
    "“A further drop” is what one more costs: for this program in a process that has made one, for "
    "the others all but the interpreter's start, as they keep nothing.",
    "y1/y0 is that of the centre of mass here: without damping the tip still rings at its top.",
)
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


@dataclass(frozen=True, kw_only=True)
class Line:
    """A program at one ITS: what it found, its errors in %, and what that cost."""

    physics: str
    cells: str
    program: str = column("Program")
    its_us: float = column("ITS", "µs", 0)
    n_steps: int = column("Steps", digits=0)
    rebound_ratio: float = column("y1/y0", digits=5)
    rebound_ratio_error: float = column("error", "%", 2)
    contact_time_us: float = column("Contact", "µs", 6)
    contact_time_error: float = column("error", "%", 2)
    peak_force_N: float = column("Peak", "N", 5)
    peak_force_error: float = column("error", "%", 2)
    wall_s: float = column("Time", "s", 3)
    wall_low_s: float = column("least", "s", 3)
    wall_high_s: float = column("most", "s", 3)
    further_s: float | None = column("A further drop", "s", 2)
    peak_rss_MB: float = column("Memory", "MB", 3)
    repeats: int

    @classmethod
    def of(cls, point: Point) -> Line:
        """The line of a point."""
        ratio, contact, peak = (point.found[key] for key in QUANTITIES)
        errors = (100.0 * point.errors[key] for key in QUANTITIES)
        return cls(
            physics=point.setting.physics.name,
            cells=" ".join(map(str, point.setting.cells)),
            program=point.program,
            its_us=1e6 * point.setting.its_s,
            n_steps=int(point.found["n_steps"]),
            rebound_ratio=ratio,
            contact_time_us=1e6 * contact,
            peak_force_N=peak,
            **dict(zip(ERRORS, errors, strict=True)),
            wall_s=point.wall_s,
            wall_low_s=point.wall_low_s,
            wall_high_s=point.wall_high_s,
            further_s=point.further_s,
            peak_rss_MB=point.peak_rss_MB,
            repeats=point.repeats,
        )


@dataclass(frozen=True)
class Equal:
    """Seconds of a program to an error of 1 and 0.1 %, of a whole process and of a further drop,
    in words."""

    program: str = column("Program")
    to_1: str = column("To 1 %", "s")
    to_01: str = column("to 0.1 %", "s")
    further_to_1: str = column("further, to 1 %", "s")
    further_to_01: str = column("further, to 0.1 %", "s")

    @classmethod
    def of(cls, program: str, points: Sequence[Point]) -> Equal:
        """From a program's points."""
        each = (reached(points, level, further) for further in (False, True) for level in LEVELS)
        return cls(program, *map(time_words, each))


def time_words(each: Reached) -> str:
    """Seconds, such as ``2.1``, ``≤ 0.9``, ``–`` where the error was not reached."""
    if each.time_s is None:
        return NEVER
    return f"{'≤ ' if each.coarsest else ''}{each.time_s:.3g}"


def run_peers(out: Path, repeats: int = REPEATS, blocks: tuple[Block, ...] = BLOCKS) -> str:
    """Measure all programs; write peers.json and report.html; the tables as text.

    A program that is not there, or fails, has a line that says so. Raises InputError under mpirun,
    ComputationError where this program itself fails.
    """
    if MPI.COMM_WORLD.size > 1:
        raise InputError("bench peers measures one process at a time: run it without mpirun")
    about = prepare("peers", out)
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
    return page(found, to, runs, out, repeats, about)


def page(
    found: Sequence[Point],
    to: Mapping[str, Converged],
    runs: Sequence[Run],
    out: Path,
    repeats: int,
    about: Sequence[tuple[str, str]],
) -> str:
    """Write the records with their page, the tables as text; ``about`` is the machine."""
    parts, sentences = [], []
    for own in blocks(found):
        setting = own[0].setting
        value, name = to[setting.physics.name], "x".join(map(str, setting.cells))
        title = f"{TITLES[setting.physics.name]}, {cells_words(own)}"
        ratio, contact, peak = (value.values[key] for key in QUANTITIES)
        unsure = ", ".join(f"{100.0 * value.unsure[key]:.2g}" for key in QUANTITIES)
        against = "an exact rod is" if value.rod else "the finest ITS is"
        text = (
            f"Converged: y1/y0 = {ratio:.6g}, contact time {1e6 * contact:.6g} µs, peak force "
            f"{peak:.6g} N; by Richardson's extrapolation of this program's reduced solid to no "
            f"ITS, on the finest mesh. Sure to {unsure} %: how far {against} from it.",
        )
        programs = by_program(own)
        by_panel = {
            f"error of y1/y0 (%), {label}": {
                program: (
                    [getattr(point, key) or math.nan for point in points],
                    [100.0 * point.errors[QUANTITIES[0]] for point in points],
                )
                for program, points in programs.items()
            }
            for key, label in (("wall_s", "whole process"), ("further_s", "a further drop"))
        }
        drawn = curves_figure("time (s)", by_panel, [100.0 * level for level in LEVELS])
        parts.append(
            Part(
                f"{setting.physics.name}-{name}",
                title,
                [Line.of(point) for points in programs.values() for point in points],
                drawn,
                "Error of y1/y0 against time, one point for each ITS: of the whole process, and of "
                "a further drop. Lines are 1 % and 0.1 %.",
                text,
                f"Time: median of {repeats}, with the least and the most.",
            )
        )
        equal = [Equal.of(program, points) for program, points in programs.items()]
        parts.append(
            Part(
                f"equal-{setting.physics.name}-{name}",
                "Time at equal error",
                equal,
                note="Error in y1/y0; between two ITS along a straight line of logarithms; – where "
                "no ITS of the list came so near.",
            )
        )
        near = [f"{each.program} {each.to_01} s" for each in equal if each.to_01 != NEVER]
        if near:
            sentences.append(f"{title}: time to 0.1 % in y1/y0: {'; '.join(near)}.")
    return publish(
        "peers",
        parts,
        out,
        title="This program beside others",
        command=("peers", "--repeats", repeats),
        headline=[*sentences, *absences(runs)],
        about=about,
        how=HOW,
        further={"runs": [asdict(run) for run in runs]},
    )


def cells_words(own: Sequence[Point]) -> str:
    """The mesh of a block."""
    unknowns = max(point.found["n_dofs"] for point in own if point.program != "bristle, beam")
    return f"{' × '.join(map(str, own[0].setting.cells))} cells, {unknowns:.0f} unknowns"


def absences(runs: Sequence[Run]) -> list[str]:
    """A line for every program that is not there or failed."""
    lines = [f"{each.name}: {each.absent()}" for each in PROGRAMS if each.absent()]
    failed = dict.fromkeys(
        f"{run.program}: ITS {run.setting.its_s:g} s: {run.answer.why_not}"
        for run in runs
        if run.answer.why_not
    )
    return [*lines, *failed]


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
        done, answer = place.run([str(script), *options(physics.numbers())])
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
