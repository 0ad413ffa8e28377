"""`bristle scatter`: y1/y0 of bristles that lean by chance and land on a rough surface.

Writes drops.csv, figures, report.html and scatter.json. Also a script:
``mpirun -n 2 python3 -m bristle.studies.scatter --drops 2000``.
"""

from __future__ import annotations

import math
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pandas as pd
from mpi4py import MPI

from ...meshes.collective import run_on_one_rank
from ...solver.batch import Outcome
from ...solver.errors import ComputationError
from ..inputs.limits import closure_warnings, input_warnings
from ..report.page import REPORT_FILES
from ..running import results
from ..running.files import together, write_atomically, write_json
from ..running.journal import Journal
from ..running.parallel import share_out
from ..running.progress import progress, say, working
from ..surface.ground import surface_of
from .drops import CHECKS, CHUNK, Chunk, Scene, generator
from .inputs import ScatterInputs
from .page import Check, write_scatter

DOCUMENT, TABLE = "scatter.json", "drops.csv"
# Drops that are also computed by themselves, with the reduced body's error estimate.
CHECKED_SHARE, FEWEST_CHECKED = 0.01, 8
# Largest difference of y1/y0 between the two that rounding can make.
AGREES = 1e-6
# Largest share of drops that may fail: they are left out, and the rest stands for all.
FAILED_SHARE = 0.01


def run_scatter(
    inputs: ScatterInputs, out: Path, comm: MPI.Intracomm = MPI.COMM_WORLD, *, resume: bool = False
) -> None:
    """Compute the drops into the folder ``out``; the same for any number of ranks, to the bit.

    With ``resume`` finished chunks in ``out`` are kept. Collective. Raises InputError where ``out``
    cannot be used or holds another scatter, and ComputationError.
    """
    out, started = Path(out), time.perf_counter()
    inputs.drop()  # refused before anything is written, as is a surface
    with working("building the surface"):
        surface = run_on_one_rank(comm, lambda: surface_of(inputs))
    journal = Journal(out, inputs)
    files = (DOCUMENT, TABLE, *REPORT_FILES)
    done = run_on_one_rank(comm, lambda: journal.prepare(*files, resume=resume))
    if done is None:
        say(f"{out / DOCUMENT} is finished already, nothing to do")
        return
    with working("building the body"):
        scene = Scene(inputs, surface, comm)
    spent = scene.spent_s
    spent["setup"] = time.perf_counter() - started
    checking = time.perf_counter()
    check = _check(scene, comm)
    spent["check"] = time.perf_counter() - checking
    fresh, spent["drops"] = _compute(scene, comm, journal, done)
    drops, failed = run_on_one_rank(comm, lambda: _gather(scene, done))
    resources = results.resources(comm)

    @together(out, DOCUMENT)
    def write() -> None:
        writing = time.perf_counter()
        warnings = _warnings(scene, drops, failed)
        extra = write_scatter(inputs, drops, check, scene.surface, warnings, out)
        write_atomically(out / TABLE, drops.to_csv(index=False))
        spent["write"] = time.perf_counter() - writing
        spent["total"] = time.perf_counter() - started
        document = {
            **results.head(inputs),
            "n_drops": inputs.drops,
            "n_failed": len(failed),
            "failed": failed,
            **extra,
            "check": asdict(check),
            "warnings": warnings,
            "drops_per_second": fresh / spent["drops"] if fresh else None,
            "wall_s": spent,
            **resources,
        }
        write_json(out / DOCUMENT, document)

    run_on_one_rank(comm, write)
    if comm.rank == 0:
        journal.finish()
        say(f"{inputs.drops} drops: {out / 'report.html'}")


def _compute(
    scene: Scene, comm: MPI.Intracomm, journal: Journal, done: dict[int, Chunk]
) -> tuple[int, float]:
    """Fill ``done`` on rank 0 with what is missing; how many drops that was, and the seconds."""
    sizes = {
        number: min(CHUNK, scene.inputs.drops - number * CHUNK)
        for number in range(math.ceil(scene.inputs.drops / CHUNK))
    }
    missing = [number for number in sizes if number not in done]
    fresh = sum(sizes[number] for number in missing)
    started = time.perf_counter()
    with progress("scatter", scene.inputs.drops, done=scene.inputs.drops - fresh) as advance:

        def take(k: int, chunk: Chunk) -> None:
            done[missing[k]] = journal.add(missing[k], chunk)
            advance(sizes[missing[k]])

        share_out(comm, len(missing), lambda k: scene.chunk(missing[k]), take)
    return fresh, time.perf_counter() - started


def _gather(scene: Scene, done: dict[int, Chunk]) -> tuple[pd.DataFrame, dict[int, str]]:
    """A row for each drop that succeeded, and why others did not, by number.

    How they were released, over what, and what they gave. ComputationError where too many failed.
    """
    every = [row for number in sorted(done) for row in done[number]["rows"]]
    failed = {number: row for number, row in enumerate(every) if isinstance(row, str)}
    if len(failed) > FAILED_SHARE * len(every):
        first = min(failed)
        raise ComputationError(
            f"{len(failed)} of {len(every)} drops failed, the first is drop {first}: "
            f"{failed[first]}"
        )
    drops = scene.conditions().drop(index=list(failed)).reset_index(drop=True)
    good = [row for row in every if not isinstance(row, str)]
    outcome = pd.DataFrame(good, columns=Outcome._fields)
    drops["rebound_ratio"] = outcome.rebound_height_m / drops.y0_m
    drops["cm_rebound_ratio"] = outcome.cm_rebound_height_m / drops.y0_m
    return drops.join(outcome.astype({"n_contacts": int, "n_steps": int})), failed


def _check(scene: Scene, comm: MPI.Intracomm) -> Check:
    """Drops chosen at random, also by `drop.simulate`: before the others, since a reduced body
    that cannot be trusted ends it all. Raises ComputationError, also where the two differ."""
    n = scene.inputs.drops
    count = min(n, max(FEWEST_CHECKED, math.ceil(CHECKED_SHARE * n)))
    chosen = np.sort(generator(scene.inputs.seed, CHECKS).choice(n, count, replace=False))
    taken: list[tuple[float | None, float]] = []
    with progress("one by one", count) as advance:

        def take(_: int, found: tuple[float | None, float] | None) -> None:
            if found is not None:
                taken.append(found)
            advance()

        share_out(comm, count, lambda k: scene.check(int(chosen[k])), take)
    taken = comm.bcast(taken)
    errors = [error for error, _ in taken if error is not None]
    difference = max((difference for _, difference in taken), default=0.0)
    if not difference <= AGREES:
        raise ComputationError(
            f"y1/y0 of a drop among many differs by {difference:.2g} from that of the drop alone"
        )
    return Check(len(taken), max(errors) if errors else None, difference)


def _warnings(scene: Scene, drops: pd.DataFrame, failed: dict[int, str]) -> list[str]:
    warnings = input_warnings(scene.drop)
    if failed:
        warnings.append(f"{len(failed)} of {scene.inputs.drops} drops failed and are left out")
    return [*warnings, *closure_warnings(scene.drop, drops.closure_relative.to_numpy())]
