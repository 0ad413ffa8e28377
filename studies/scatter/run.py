"""`bristle scatter`: y1/y0 of bristles that lean by chance and land on a rough surface.

Writes drops.csv, figures, report.html and scatter.json. Also a script:
``mpirun -n 2 python3 -m bristle.studies.scatter --drops 2000``.
"""

from __future__ import annotations

import math
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from ...meshes.collective import run_on_one_rank
from ...solver.batch import Drops, Outcome, drop_many
from ...solver.bodies.modal import ModalBody
from ...solver.drop import ModalFrame, simulate
from ...solver.errors import ComputationError
from ...solver.time.march import Marcher
from .. import __version__
from ..inputs.config import DropInputs
from ..inputs.limits import closure_warnings, input_warnings
from ..running import results
from ..running.files import prepare_folder, to_csv, to_json, together, write_atomically
from ..running.journal import Journal
from ..running.parallel import share_out
from ..running.progress import progress, say, working
from ..surface.rough import Surface
from .body import prepared
from .conditions import (
    CHECKS,
    Conditions,
    Local,
    draw,
    drops_of,
    generator,
    ground_of,
    ground_under,
    local_ground,
)
from .inputs import ScatterInputs
from .outcome import COLUMNS, Check, Scatter, rows
from .page import write_scatter

DOCUMENT, TABLE = "scatter.json", "drops.csv"
CHUNK = 50
# Drops that are also computed by themselves, with the reduced body's error estimate.
CHECKED_SHARE, FEWEST_CHECKED = 0.01, 8
# Largest difference of y1/y0 between the two that rounding can make.
AGREES = 1e-6
# Largest share of drops that may fail: they are left out, and the rest stands for all.
FAILED_SHARE = 0.01

Chunk = dict[str, Any]


class _Scene:
    """The body over the surface, and any of the drops onto it."""

    def __init__(
        self,
        inputs: ScatterInputs,
        frame: ModalFrame,
        marcher: Marcher,
        surface: Surface | None,
    ) -> None:
        self.inputs, self.frame, self.marcher, self.surface = inputs, frame, marcher, surface
        self.drop = inputs.drop()
        self._steel = inputs.youngs_Pa, inputs.poisson

    @property
    def body(self) -> ModalBody:
        return self.frame.modal

    def conditions(self, first: int, last: int) -> Conditions:
        size = (1.0, 1.0) if self.surface is None else self.surface.size_m
        return draw(self.inputs, size, first, last)

    def local(self, released: Conditions) -> Local:
        under = ground_under(self.surface, self.body.contact, released, self._steel)
        return local_ground(released, under, self.body.contact.weights)

    def drops(self, released: Conditions) -> Drops:
        under = ground_under(self.surface, self.body.contact, released, self._steel)
        return drops_of(released, under, self.inputs.kn_N_m, self.drop.friction_law().mu)

    def chunk(self, number: int) -> Chunk:
        """The outcomes of one chunk of drops, and why those failed that did."""
        first = number * CHUNK
        last = min(first + CHUNK, self.inputs.drops)
        started = time.perf_counter()
        found, failed = _attempt(self.marcher, self.drops(self.conditions(first, last)), first)
        spent = time.perf_counter() - started
        return {"rows": found, "failed": failed, "wall_s": spent}

    def check(self, number: int) -> tuple[float | None, float] | None:
        """A drop by itself: the reduced body's error, and how far y1/y0 is from that among many.

        None where the drop fails among many; ComputationError where it does so by itself alone.
        """
        released = self.conditions(number, number + 1)
        (row,), _ = _attempt(self.marcher, self.drops(released), number)
        if row is None:
            return None
        under = ground_under(self.surface, self.body.contact, released, self._steel)
        plan = replace(
            self.drop.drop_plan(len(self.body.contact.weights)),
            height_m=float(released.height_m[0]),
            tilt_deg=float(released.tilt_deg[0]),
            tilt_wide_deg=float(released.tilt_wide_deg[0]),
            ground=ground_of(under, 0),
        )
        try:
            result = simulate(self.frame, plan, self.marcher)
        except ComputationError as error:
            raise ComputationError(f"drop {number}: {error}") from error
        ratio = row[Outcome._fields.index("rebound_height_m")] / plan.height_m
        return result.reduction_error, abs((result.rebound_ratio or 0.0) - ratio)


def _attempt(
    marcher: Marcher, drops: Drops, first: int
) -> tuple[list[list[float] | None], list[tuple[int, str]]]:
    """Rows of outcomes; where one drop fails, its row is None, and its number is told."""
    try:
        table = np.column_stack(drop_many(marcher, drops))
        return [list(map(float, row)) for row in table], []
    except ComputationError as error:
        if len(drops) == 1:
            return [None], [(first, str(error).removeprefix("drop 0: "))]
    half = len(drops) // 2
    found, failed = _attempt(marcher, drops.part(0, half), first)
    more, others = _attempt(marcher, drops.part(half, len(drops)), first + half)
    return found + more, failed + others


def run_scatter(
    inputs: ScatterInputs, out: Path, comm: MPI.Intracomm = MPI.COMM_WORLD, *, resume: bool = False
) -> None:
    """Compute the drops into the folder ``out``; the same for any number of ranks, to the bit.

    With ``resume`` finished chunks in ``out`` are kept. Collective. Raises InputError where ``out``
    cannot be used or holds another scatter, and ComputationError.
    """
    out, started = Path(out), time.perf_counter()
    drop = inputs.drop()
    journal = Journal(out, inputs)
    done = run_on_one_rank(comm, lambda: _prepare(journal, inputs, out, resume))
    if done is None:
        say(f"{out / DOCUMENT} is finished already, nothing to do")
        return
    with working("building the body and the surface"):
        frame, marcher, surface, spent = prepared(inputs, comm)
    spent["setup"] = time.perf_counter() - started
    scene = _Scene(inputs, frame, marcher, surface)
    checking = time.perf_counter()
    check = _check(scene, comm)
    spent["check"] = time.perf_counter() - checking
    fresh, dropping_s = _compute(scene, comm, journal, done)
    spent["drops"] = dropping_s
    found = run_on_one_rank(comm, lambda: _gather(scene, done))
    ranks, peak = comm.size, results.peak_rss_MB(comm)

    @together(out, DOCUMENT)
    def write() -> None:
        writing = time.perf_counter()
        warnings = _warnings(drop, found, inputs)
        extra = write_scatter(inputs, found, check, surface, warnings, out)
        write_atomically(out / TABLE, to_csv(COLUMNS, rows(found)))
        spent["write"] = time.perf_counter() - writing
        spent["total"] = time.perf_counter() - started
        document = {
            "schema": results.SCHEMA,
            "version": __version__,
            "inputs": results.plain_inputs(inputs),
            "n_drops": inputs.drops,
            "n_failed": len(found.failed),
            "failed": found.failed,
            **extra,
            "check": asdict(check),
            "warnings": warnings,
            "drops_per_second": fresh / dropping_s if fresh else None,
            "wall_s": spent,
            "peak_rss_MB": peak,
            "ranks": ranks,
        }
        write_atomically(out / DOCUMENT, to_json(document) + "\n")

    run_on_one_rank(comm, write)
    if comm.rank == 0:
        journal.finish()
        say(f"{inputs.drops} drops: {out / 'report.html'}")


def _prepare(
    journal: Journal, inputs: ScatterInputs, out: Path, resume: bool
) -> dict[int, Chunk] | None:
    """Chunks that are done, or None where the scatter is."""
    prepare_folder(out)
    if not resume:
        journal.begin()
        return {}
    document = results.read_document(out / DOCUMENT)
    if document is not None:
        results.check_same(out / DOCUMENT, document, inputs)
        return None
    return journal.resume()


def _compute(
    scene: _Scene, comm: MPI.Intracomm, journal: Journal, done: dict[int, Chunk]
) -> tuple[int, float]:
    """Fill ``done`` on rank 0 with what is missing; how many drops that was, and the seconds."""
    n_chunks = math.ceil(scene.inputs.drops / CHUNK)
    missing = [number for number in range(n_chunks) if number not in done]
    started = time.perf_counter()
    with progress("scatter", n_chunks, done=n_chunks - len(missing)) as advance:

        def take(k: int, chunk: Chunk) -> None:
            done[missing[k]] = journal.add(missing[k], chunk)
            advance()

        share_out(comm, len(missing), lambda k: scene.chunk(missing[k]), take)
    drops = sum(min(CHUNK, scene.inputs.drops - number * CHUNK) for number in missing)
    return drops, time.perf_counter() - started


def _gather(scene: _Scene, done: dict[int, Chunk]) -> Scatter:
    """All drops that succeeded; ComputationError where too many did not."""
    chunks = [done[number] for number in sorted(done)]
    every = [row for chunk in chunks for row in chunk["rows"]]
    failed = {int(i): str(why) for chunk in chunks for i, why in chunk["failed"]}
    if len(failed) > FAILED_SHARE * len(every):
        first = min(failed)
        raise ComputationError(
            f"{len(failed)} of {len(every)} drops failed, the first is drop {first}: "
            f"{failed[first]}"
        )
    released = scene.conditions(0, scene.inputs.drops)
    keep = np.array([row is not None for row in every])
    released = Conditions(**{name: value[keep] for name, value in vars(released).items()})
    table = np.array([row for row in every if row is not None])
    return Scatter(released, scene.local(released), Outcome(*table.T), failed)


def _check(scene: _Scene, comm: MPI.Intracomm) -> Check:
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


def _warnings(drop: DropInputs, found: Scatter, inputs: ScatterInputs) -> list[str]:
    warnings = input_warnings(drop)
    if found.failed:
        warnings.append(f"{len(found.failed)} of {inputs.drops} drops failed and are left out")
    return [*warnings, *closure_warnings(drop, found.outcome.closure_relative)]
