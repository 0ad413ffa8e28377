"""Work over ranks: rank 0 speaks and hands out cases, a failing rank ends the job."""

from __future__ import annotations

import importlib
import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TextIO

from ...meshes.collective import ALONE, GRACE_S, done_within, run_on_one_rank
from ...solver.errors import BristleError

if TYPE_CHECKING:
    from mpi4py import MPI

# Set by Open MPI, and by the launchers of MPICH and its kin.
SIZE_VARIABLES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE")
RANK_VARIABLES = ("OMPI_COMM_WORLD_RANK", "PMI_RANK")


def launched_ranks() -> int:
    """How many ranks the launcher started, without starting MPI."""
    return _told(SIZE_VARIABLES, "SLURM_STEP_NUM_TASKS", 1)


def speaks() -> bool:
    """Whether this process is rank 0, without starting MPI."""
    return _told(RANK_VARIABLES, "SLURM_PROCID", 0) == 0


def all_ranks() -> MPI.Intracomm:
    """The ranks of this job, without starting MPI where there is one alone."""
    if launched_ranks() == 1:
        return ALONE
    from mpi4py import MPI

    return MPI.COMM_WORLD


def start_petsc(comm: MPI.Intracomm) -> None:
    """Start PETSc before one rank alone needs it: on all ranks together, or it never ends."""
    if comm.size > 1:
        importlib.import_module("petsc4py.PETSc")


def _told(names: Sequence[str], by_slurm: str, default: int) -> int:
    """What the launcher says by the first of these names that it knows.

    That of Slurm counts in a task that srun launched as a rank, through PMIx; a script has it too.
    """
    if "PMIX_RANK" in os.environ:
        names = (*names, by_slurm)
    numbers = (os.environ.get(name, "") for name in names)
    return next((int(number) for number in numbers if number.isdigit()), default)


@contextmanager
def rank_0_speaks() -> Iterator[None]:
    """Standard output and error of the other ranks go nowhere inside the block."""
    if speaks():
        yield
        return
    with (
        Path(os.devnull).open("w") as nowhere,
        redirect_stdout(nowhere),
        redirect_stderr(nowhere),
    ):
        yield


@contextmanager
def by_rank_0[Made](context: AbstractContextManager[Made], comm: MPI.Intracomm) -> Iterator[Made]:
    """What rank 0 enters and leaves for all; one that fails alone leaves nobody waiting."""
    made = run_on_one_rank(comm, context.__enter__)
    try:
        yield made
    except BaseException:
        if comm.rank == 0:
            context.__exit__(*sys.exc_info())
        raise
    run_on_one_rank(comm, lambda: context.__exit__(None, None, None) and None)


@dataclass(frozen=True)
class Ending:
    """How a command ended on one rank: its exit status and the lines for standard error."""

    status: int = 0
    message: str = ""

    def tell(self, stream: TextIO | None = None) -> None:
        """Print the message, on standard error where no other stream is given."""
        if self.message:
            print(self.message, file=stream or sys.stderr, flush=True)


class Ranks:
    """The ranks of a job, from before its work until they have agreed on how it ended."""

    def __init__(self) -> None:
        self._comm: Any = None
        if launched_ranks() > 1:
            from mpi4py import MPI

            # of its own, so that a lone failing rank's messages meet no other's collective call
            self._comm = MPI.COMM_WORLD.Dup()

    @property
    def alone(self) -> bool:
        """Whether this is the only rank."""
        return self._comm is None

    def finish(self, ending: Ending) -> int:
        """The job's exit status. Where one rank failed and others still work, the job is aborted.

        Rank 0 tells what happened; collective unless a rank fails alone.
        """
        if self._comm is None:
            ending.tell()
            return ending.status
        arrived = self._comm.Ibarrier()
        if ending.status and not done_within(arrived, GRACE_S):
            ending.tell(sys.__stderr__)  # also where this rank is silent otherwise
            self._comm.Abort(ending.status)
        arrived.Wait()
        endings = self._comm.allgather(ending)
        worst = next((each for each in endings if each.status), ending)
        if self._comm.rank == 0:
            worst.tell()
        self._comm.Barrier()  # nobody leaves before rank 0 has spoken: mpirun would end it
        return worst.status


def share_out(
    comm: Any,
    count: int,
    work: Callable[[int], Any],
    take: Callable[[int, Any], None],
    mine: Sequence[int] | None = None,
    *,
    leads: bool = True,
) -> None:
    """Do ``work(i)`` for i < ``count`` over the ranks; rank 0 takes what comes of it.

    A rank gets its next ones when it asks for them. Rank 0 calls ``take(i, result)`` as soon as a
    result is there, in no fixed order, one at a time, and from another thread while it works.
    ``work`` must not communicate, or only within a group of ranks with the same cases ``mine``, of
    which one, rank 0 for its own, ``leads``. A rank that fails with a BristleError goes on with
    other cases; at the end the failure with the smallest i is raised on all ranks. Collective.
    """
    failed: dict[int, BristleError] = {}

    def attempt(i: int) -> Done:
        try:
            return i, work(i), None
        except BristleError as error:
            return i, None, error

    def note(i: int, result: Any, error: BristleError | None) -> None:
        if error is None:
            take(i, result)
        else:
            failed[i] = error

    if comm.rank == 0:
        with _Desk(comm, count, note, mine) as desk:
            while (i := desk.next()) is not None:
                desk.note(attempt(i))
    else:
        sent, numbers = [], comm.sendrecv((None, True), dest=0, source=0) if mine is None else mine
        while numbers:
            for i in numbers:
                done, asks = attempt(i), mine is None and i == numbers[-1]
                if leads:
                    sent.append(comm.isend((done, asks), dest=0))
            numbers = comm.recv(source=0) if mine is None else ()
        for request in sent:
            request.wait()
    failed = comm.bcast(failed)
    if failed:
        raise failed[min(failed)]


# A number, what came of it, and what it failed with.
Done = tuple[int, Any, BristleError | None]
# Between two looks at the messages: short beside a case, long beside a look.
LOOK_S = 2e-3
# Of what is left, a rank that asks gets one part of so many for each rank.
PARTS = 4


class _Desk:
    """Rank 0's: hands out numbers below ``count``, and notes what comes of them.

    A thread serves the other ranks meanwhile. With ``mine`` they have numbers of their own.
    """

    def __init__(
        self, comm: Any, count: int, note: Callable[..., None], mine: Sequence[int] | None
    ) -> None:
        self._comm, self._note = comm, note
        self._left = deque(range(count) if mine is None else mine)
        # results of other ranks that are still to come, and ranks that have not asked in vain
        self._awaited = 0 if mine is None else count - len(mine)
        self._asking = comm.size - 1 if mine is None else 0
        self._lock = threading.Lock()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> Self:
        if self._awaited or self._asking:
            self._thread.start()
        return self

    def __exit__(self, kind: object, *raised: object) -> None:
        if kind is None and self._thread.ident is not None:
            self._thread.join()
            self._check()

    def next(self) -> int | None:
        """The next number, None where there is none; raises what noting another rank's did."""
        self._check()
        with self._lock:
            return self._left.popleft() if self._left else None

    def note(self, done: Done) -> None:
        """Note what came of a number."""
        with self._lock:
            self._note(*done)

    def _serve(self) -> None:
        from mpi4py import MPI

        status = MPI.Status()
        try:
            while self._awaited or self._asking:
                if not self._comm.iprobe(status=status):
                    time.sleep(LOOK_S)
                    continue
                rank = status.Get_source()
                done, asks = self._comm.recv(source=rank)
                if asks:
                    self._comm.send(self._several(), dest=rank)
                if done is not None:
                    self._awaited -= 1
                    self.note(done)
        except BaseException as error:  # of `take`; the other ranks are left as they are
            self._error = error

    def _several(self) -> list[int]:
        """Numbers for a rank that asks."""
        with self._lock:
            many = -(-len(self._left) // (PARTS * self._comm.size))
            several = [self._left.popleft() for _ in range(many)]
        self._awaited += len(several)
        self._asking -= not several
        return several

    def _check(self) -> None:
        if self._error is not None:
            raise self._error
