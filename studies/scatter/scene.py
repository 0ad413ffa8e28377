"""What a scatter's drops have in common, the body over the surface, and any of these drops."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from mpi4py import MPI

from ...meshes.collective import run_on_one_rank
from ...solver.arrays import Array
from ...solver.batch import Drops, Outcome, drop_many
from ...solver.bodies.modal import from_arrays, to_arrays
from ...solver.drop import ModalFrame, simulate
from ...solver.errors import ComputationError
from ...solver.time.march import Marcher
from ..inputs.config import DropInputs
from ..running.cases import CaseSession, Timings
from ..running.parallel import start_petsc
from ..surface.ground import surface_of
from .conditions import Under, draw, ground_of, ground_under, local_ground
from .inputs import ScatterInputs

CHUNK = 50

Chunk = dict[str, Any]
Row = list[float]


class Scene:
    """The body over the surface, the same to the last bit on every rank; made by all together.

    One rank alone makes the body, since what comes of a factorisation depends in its last bits on
    how many share it. Raises InputError and ComputationError, on all ranks.
    """

    def __init__(self, inputs: ScatterInputs, comm: MPI.Intracomm) -> None:
        self.inputs, self.drop = inputs, inputs.drop()
        self.surface = run_on_one_rank(comm, lambda: surface_of(inputs))
        if self.drop.model.meshed:
            start_petsc(comm)
        arrays, self.spent_s = run_on_one_rank(comm, lambda: _body(self.drop))
        body, *coarser = from_arrays(arrays)
        self.frame = ModalFrame(body, tuple(coarser))
        self.marcher = Marcher(
            body,
            self.drop.contact_method(),
            self.drop.time_scheme(),
            self.drop.its_s,
            self.drop.gravity_m_s2,
        )

    def released(self, first: int, last: int) -> tuple[pd.DataFrame, Under]:
        """How drops ``first`` to ``last`` - 1 are released, and what lies under them."""
        size = (1.0, 1.0) if self.surface is None else self.surface.size_m
        released = draw(self.inputs, size, first, last)
        steel = self.inputs.youngs_Pa, self.inputs.poisson
        return released, ground_under(self.surface, self.frame.modal.contact, released, steel)

    def conditions(self) -> pd.DataFrame:
        """How all drops are released, and the ground under their tips in a few numbers."""
        released, under = self.released(0, self.inputs.drops)
        weights = self.frame.modal.contact.weights
        return released.join(local_ground(released, under, weights))

    def chunk(self, number: int) -> Chunk:
        """The rows of one chunk of drops (`_dropped`)."""
        first = number * CHUNK
        last = min(first + CHUNK, self.inputs.drops)
        started = time.perf_counter()
        rows = self._dropped(*self.released(first, last))
        return {"rows": rows, "wall_s": time.perf_counter() - started}

    def check(self, number: int) -> tuple[float | None, float] | None:
        """A drop by itself: the reduced body's error, and how far y1/y0 is from that among many.

        None where the drop fails among many; ComputationError where it does so by itself alone.
        """
        released, under = self.released(number, number + 1)
        (row,) = self._dropped(released, under)
        if isinstance(row, str):
            return None
        plan = replace(
            self.drop.drop_plan(len(self.frame.modal.contact.weights)),
            height_m=float(released.y0_m[0]),
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

    def _dropped(self, released: pd.DataFrame, under: Under) -> list[Row | str]:
        """The outcome of each drop, or why it failed."""
        n = len(released)
        drops = Drops(
            height_m=released.y0_m.to_numpy(),
            tilt_deg=released.tilt_deg.to_numpy(),
            tilt_wide_deg=released.tilt_wide_deg.to_numpy(),
            kn_N_m=np.full(n, self.inputs.kn_N_m),
            mu=np.full(n, self.drop.friction_law().mu),
            normals=under.normals,
            rises_m=under.rises_m,
            scale=under.scale,
        )
        return _attempt(self.marcher, drops)


def _body(drop: DropInputs) -> tuple[dict[str, Array], Timings]:
    """The body and coarser ones as arrays, to be sent, and the seconds that they took."""
    with CaseSession(MPI.COMM_SELF) as session:
        ready = session.prepare(drop)
        assert ready is not None
        assert isinstance(ready.frame, ModalFrame)
        return to_arrays((ready.frame.modal, *ready.frame.coarser)), session.take_timings()


def _attempt(marcher: Marcher, drops: Drops) -> list[Row | str]:
    """The outcome of each drop, or why it failed; those that fail are found by halving."""
    try:
        table = np.column_stack(drop_many(marcher, drops))
        return [list(map(float, row)) for row in table]
    except ComputationError as error:
        if len(drops) == 1:
            return [str(error).removeprefix("drop 0: ")]
    half = len(drops) // 2
    parts = drops.part(0, half), drops.part(half, len(drops))
    return [row for part in parts for row in _attempt(marcher, part)]
