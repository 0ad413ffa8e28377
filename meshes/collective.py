"""Work of one rank with its result or error on all, and a communicator for a lone process."""

from __future__ import annotations

import math
import pickle
import time
from array import array
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    from mpi4py import MPI


class _Alone:
    """A communicator of one rank, with the methods that this program itself calls.

    Loading MPI takes a fifth of a second, which a drop of a beam can avoid.
    """

    rank, size = 0, 1

    def bcast(self, value: Any, root: int = 0) -> Any:
        return value

    def allgather(self, value: Any) -> list[Any]:
        return [value]

    def allreduce(self, value: Any) -> Any:
        return value


ALONE = cast("MPI.Intracomm", _Alone())
# Ranks that fail together end within this time of each other.
GRACE_S = 5.0


def with_mpi(comm: MPI.Intracomm) -> MPI.Intracomm:
    """``comm`` for dolfinx: MPI's own, also if it is `ALONE`."""
    if not isinstance(comm, _Alone):
        return comm
    from mpi4py import MPI

    return MPI.COMM_SELF


def run_on_one_rank[Result](
    comm: MPI.Intracomm, action: Callable[[], Result], rank: int = 0
) -> Result:
    """Run `action` on `rank` alone, and return its result on every rank; collective.

    The others wait, so it must not communicate, and its result must be picklable. An exception is
    raised on every rank, so that none waits forever; if it cannot be pickled, as a `RuntimeError`
    with the same message.
    """
    if comm.size == 1:
        return action()
    result: Any = None
    error: Exception | None = None
    if comm.rank == rank:
        try:
            result = action()
        except Exception as raised:  # any error, as the others wait
            error = raised
    outcome = (result, _sendable(error)) if comm.rank == rank else None
    result, sent_error = comm.bcast(outcome, root=rank)
    if error is not None:
        raise error
    if sent_error is not None:
        raise sent_error
    return result


class Parting:
    """Agreement of the ranks on when to leave operations that need all of them; collective."""

    def __init__(self, comm: MPI.Intracomm) -> None:
        # separate, so as not to interfere with other collective calls
        self._comm = comm.Dup() if comm.size > 1 else None

    def together(self, error: object) -> bool:
        """Whether all ranks end now, this one with an ``error`` or None.

        A rank that fails waits `GRACE_S` for the others. If it leaves without them, they are told.
        """
        if self._comm is None:
            return True
        if error is not None and not isinstance(error, Exception):
            return False  # an interrupted process ends
        here = done_within(self._comm.Ibarrier(), math.inf if error is None else GRACE_S)
        left, gone = array("i", [not here]), array("i", [0])
        heard = self._comm.Iallreduce(left, gone)
        if here:
            done_within(heard, math.inf)
            return not gone[0]
        self._left = heard, left, gone  # others may still read these
        return False

    def close(self) -> None:
        """Free the communicator; collective."""
        if self._comm is not None:
            self._comm.Free()
            self._comm = None


def done_within(request: Any, seconds: float) -> bool:
    """Whether ``request`` completes within the time."""
    until = time.monotonic() + seconds
    while not request.Test():
        if time.monotonic() > until:
            return False
        time.sleep(0.01)
    return True


def _sendable(error: Exception | None) -> Exception | None:
    try:
        copy = pickle.loads(pickle.dumps(error))
    except Exception:  # an error class may fail in any way when it is unpickled
        return RuntimeError(str(error))
    return error if str(copy) == str(error) else RuntimeError(str(error))
