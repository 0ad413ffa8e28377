"""Work of one rank that ends on all ranks, with its result or with its error."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import Any

from mpi4py import MPI


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
