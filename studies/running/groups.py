"""Many cases over the ranks of a session: those of modal bodies, and groups of ranks for solids.

One solid on all ranks waits for messages in every step; a solid for each group of ranks, or for
each rank alone, does not, but every group builds its own mesh, factor and basis. The number of
groups is the one that a plain estimate of all this says ends first (`best_sizes`).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, cast

from mpi4py import MPI

from ...meshes.collective import GRACE_S, done_within
from ...solver.errors import BristleError, InputError
from ..inputs.choices import Model
from ..inputs.config import DropInputs
from ..inputs.limits import count_unknowns
from .cases import CaseSession
from .parallel import share_out

# What building mesh, matrices, factor and basis costs, in steps of the same solid.
BUILDING_STEPS = 250.0
# What a further rank adds to the time of a step, as a share of the step on one rank over that many.
WAITING = 0.15
# Unknowns that a rank's share of matrices, factor and basis may have: about 6 GB.
UNKNOWNS_PER_RANK = 500_000


@dataclass(frozen=True)
class Load:
    """What a case of the solid at full order is expected to cost in steps, how many unknowns it
    has, and the body that it is built on."""

    steps: float
    unknowns: int
    body: Hashable


def group_sizes(ranks: int, ranks_per_case: int) -> list[int]:
    """Ranks of each group: ``ranks_per_case``, and what is left over one by one on top."""
    count = max(ranks // ranks_per_case, 1)
    return [ranks // count + (i < ranks % count) for i in range(count)]


def deal(loads: Sequence[Load], sizes: Sequence[int]) -> tuple[list[list[int]], float]:
    """The cases of each group, and when the last group ends (in steps of one rank).

    Single cases, or all cases of a body as one: whichever ends first.
    """
    alone = [[i] for i in range(len(loads))]
    by_body: dict[Hashable, list[int]] = {}
    for i, load in enumerate(loads):
        by_body.setdefault(load.body, []).append(i)
    dealt = (_deal(loads, lots, sizes) for lots in (alone, list(by_body.values())))
    return min(dealt, key=lambda each: each[1])


def _deal(
    loads: Sequence[Load], lots: Sequence[Sequence[int]], sizes: Sequence[int]
) -> tuple[list[list[int]], float]:
    """Each lot of cases of one body, longest first, where it ends first (Graham, SIAM J. Appl.
    Math. 17, 1969), with the body that is built there already or is not."""
    hands: list[list[int]] = [[] for _ in sizes]
    ends, built = [0.0] * len(sizes), [set[Hashable]() for _ in sizes]
    steps = [sum(loads[i].steps for i in lot) for lot in lots]
    for k in sorted(range(len(lots)), key=lambda k: (-steps[k], k)):
        body = loads[lots[k][0]].body
        after = [
            end + (steps[k] + BUILDING_STEPS * (body not in there)) / _speed(size)
            for end, size, there in zip(ends, sizes, built, strict=True)
        ]
        first = min(range(len(sizes)), key=lambda g: (after[g], g))
        hands[first] += lots[k]
        built[first].add(body)
        ends[first] = after[first]
    return hands, max(ends, default=0.0)


def _speed(ranks: int) -> float:
    """How much faster than one rank a group of ``ranks`` makes its steps."""
    return ranks / (1.0 + WAITING * (ranks - 1))


def best_sizes(loads: Sequence[Load], ranks: int) -> list[int]:
    """Sizes of the groups with which `deal` ends first, of those whose ranks have memory enough."""
    largest = max((load.unknowns for load in loads), default=0)
    least = min(max(-(-largest // UNKNOWNS_PER_RANK), 1), ranks)
    choices = [group_sizes(ranks, n) for n in range(ranks, least - 1, -1)]
    return min(choices, key=lambda sizes: deal(loads, sizes)[1])


def refuse_more_ranks(cases: Sequence[DropInputs], ranks: int, ranks_per_case: int | None) -> None:
    """InputError where there are fewer ``ranks`` than a full-order solid is to have."""
    solid = any(case.model is Model.SOLID for case in cases)
    if ranks_per_case is not None and ranks_per_case > ranks and solid:
        there = "there is 1 rank" if ranks == 1 else f"there are {ranks} ranks"
        raise InputError(f"--ranks-per-case: {there}, not {ranks_per_case}")


def build_reduced(session: CaseSession, cases: Sequence[DropInputs]) -> None:
    """Build what the reduced ones of the ``cases`` need of all ranks, so that they need no
    communication later. Collective."""
    reduced = (case for case in cases if case.model is Model.REDUCED)
    for first in {session.body_key(case): case for case in reduced}.values():
        session.prepare(first)


def run_cases(
    session: CaseSession,
    cases: Sequence[DropInputs],
    work: Callable[[CaseSession, DropInputs], Any],
    take: Callable[[int, Any], None],
    ranks_per_case: int | None = None,
) -> None:
    """``work`` for every case over the session's ranks: bodies in modes, once `build_reduced` is
    done with them, on a rank each, then the solid at full order on groups of ranks.

    Rank 0 takes results as `parallel.share_out` says. Without ``ranks_per_case`` the groups are
    those of `best_sizes`. ``session`` itself serves where all ranks are one group. Collective;
    raises ComputationError.
    """
    world = session.comm
    modal = [i for i, case in enumerate(cases) if case.model is not Model.SOLID]
    solid = [i for i, case in enumerate(cases) if case.model is Model.SOLID]
    loads = [
        Load(case.contact_s() / case.its_s, count_unknowns(case), session.body_key(case))
        for case in (cases[i] for i in solid)
    ]
    sizes = best_sizes(loads, world.size)
    if ranks_per_case is not None:
        sizes = group_sizes(world.size, ranks_per_case)
    share_out(
        world,
        len(modal),
        lambda k: work(session, cases[modal[k]]),
        lambda k, result: take(modal[k], result),
    )
    if not solid:
        return
    hands, _ = deal(loads, sizes)
    with _grouped(session, sizes) as (group, own), _together(own.comm) as together:
        share_out(
            world,
            len(solid),
            lambda k: together(lambda: work(own, cases[solid[k]])),
            lambda k, result: take(solid[k], result),
            hands[group],
            leads=own.comm.rank == 0,
        )


@contextmanager
def _grouped(session: CaseSession, sizes: Sequence[int]) -> Iterator[tuple[int, CaseSession]]:
    """This rank's group of consecutive ranks, so many in each, and the session of that group."""
    if len(sizes) == 1:
        yield 0, session
        return
    world = session.comm
    owner = [group for group, size in enumerate(sizes) for _ in range(size)]
    comm = cast(MPI.Intracomm, world.Split(owner[world.rank]))
    with CaseSession(comm, session.basis_its_s) as own:
        yield owner[world.rank], own
    comm.Free()


@contextmanager
def _together(comm: MPI.Intracomm) -> Iterator[Callable[[Callable[[], Any]], Any]]:
    """What all ranks of a group do; one that fails alone ends the job."""
    # so that the barrier of a rank that failed alone meets no other's collective call
    after = comm.Dup()

    def together(work: Callable[[], Any]) -> Any:
        try:
            result = work()
        except BristleError as error:
            if not done_within(after.Ibarrier(), GRACE_S):
                raise RuntimeError(str(error)) from error
            raise
        after.Barrier()
        return result

    yield together
    after.Free()
