"""The body and the surface of a scatter, the same to the last bit on every rank."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

from ...solver.arrays import Array
from ...solver.bodies.stored import from_arrays, to_arrays
from ...solver.drop import ModalFrame
from ...solver.time.march import Marcher
from ..inputs.config import DropInputs
from ..running.cases import Timings, Workshop
from ..running.parallel import start_petsc
from ..surface.rough import Surface
from .conditions import ground_surface
from .inputs import ScatterInputs


def prepared(
    inputs: ScatterInputs, comm: MPI.Intracomm
) -> tuple[ModalFrame, Marcher, Surface | None, Timings]:
    """The body and its marcher, the surface, and the seconds that the body took; collective.

    One rank alone makes the body, since what comes of a factorisation depends in its last bits on
    how many share it; another makes the surface at the same time. Raises InputError and
    ComputationError, on all ranks.
    """
    drop = inputs.drop()
    if drop.model.meshed:
        start_petsc(comm)
    made: Any = None
    surface: Surface | None = None
    error: Exception | None = None
    last = comm.size - 1
    try:
        if comm.rank == 0:
            made = _body(drop)
        if comm.rank == last:
            surface = ground_surface(inputs)
    except Exception as raised:  # whatever it is, the others wait for it
        error = raised
    failures = [each for each in comm.allgather(error) if each is not None]
    if failures:
        raise error or failures[0]
    arrays, timings = comm.bcast(made, 0)
    surface = comm.bcast(surface, last)
    body, *coarser = from_arrays(arrays)
    marcher = Marcher(
        body,
        drop.contact_method(),
        drop.time_scheme(),
        drop.its_s,
        drop.gravity_m_s2,
    )
    return ModalFrame(body, tuple(coarser)), marcher, surface, timings


def _body(drop: DropInputs) -> tuple[dict[str, Array], Timings]:
    """The body and coarser ones as arrays, to be sent."""
    with Workshop(MPI.COMM_SELF) as workshop:
        ready = workshop.prepare(drop)
        assert ready is not None
        frame = ready.frame
        assert isinstance(frame, ModalFrame)
        return to_arrays((frame.modal, *frame.coarser)), workshop.take_timings()
