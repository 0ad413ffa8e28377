"""Work of one rank that ends on all ranks, and a communicator for a process without others."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    from mpi4py import MPI


class _Alone:
    """A communicator of one rank, as far as this program calls it itself.

    Loading MPI takes a fifth of a second. A drop of a beam does without.
    """

    rank, size = 0, 1

    def bcast(self, value: Any, root: int = 0) -> Any:
        return value

    def allgather(self, value: Any) -> list[Any]:
        return [value]

    def allreduce(self, value: Any) -> Any:
        return value


ALONE = cast("MPI.Intracomm", _Alone())


def with_mpi(comm: MPI.Intracomm) -> MPI.Intracomm:
    """``comm`` as dolfinx takes it: MPI's own, also for one that is `ALONE`."""
    if not isinstance(comm, _Alone):
        return comm
    from mpi4py import MPI

    return MPI.COMM_SELF


def run_on_one_rank[Result](
    comm: MPI.Intracomm, action: Callable[[], Result], rank: int = 0
) -> Result:
    """Run `action` on `rank` alone, and return its result on every rank; collective.

    The others wait: it must communicate with nobody, and its result be picklable. What it raises
    is raised on every rank, so that none waits for one that has given up; as a `RuntimeError` with
    the same message where the error itself cannot be sent.
    """
    result: Any = None
    error: Exception | None = None
    if comm.rank == rank:
        try:
            result = action()
        except Exception as raised:  # whatever it is, the others wait for it
            error = raised
    outcome = (result, _sendable(error)) if comm.rank == rank else None
    result, sent_error = comm.bcast(outcome, root=rank)
    if error is not None:
        raise error
    if sent_error is not None:
        raise sent_error
    return result


def _sendable(error: Exception | None) -> Exception | None:
    try:
        copy = pickle.loads(pickle.dumps(error))
    except Exception:  # an error class may fail in any way when it is unpickled
        return RuntimeError(str(error))
    return error if str(copy) == str(error) else RuntimeError(str(error))
