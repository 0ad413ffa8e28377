"""What comes of all accounts: tables of drops, fits, other assumptions, what to measure?"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from ...solver.bristle import Array
from ..running.parallel import share_out
from ..running.progress import progress
from .design import Needed, Trial, count_jobs, needed, readings
from .film import Film
from .fit import Effort, Fit, fit
from .library import CHUNK, Grid, Library, count_chunks, fill, no_tick
from .models import Account, rivals

# An account with a smaller p-value is not asked what to measure.
SURVIVES = 0.05


@dataclass(frozen=True)
class Variant:
    """Another assumption on how the film was read."""

    name: str
    film: Film
    centre: bool = False


VARIANTS = (
    Variant("heights read to 0.25 mm", Film(sigma_m=0.25e-3)),
    Variant("heights read to 1 mm", Film(sigma_m=1e-3)),
    Variant("apex not missed between frames", Film(frames_per_s=1000.0)),
    Variant("heights read at the centre of mass", Film(), centre=True),
)


@dataclass(frozen=True)
class Plan:
    """What is computed, and how finely."""

    accounts: tuple[Account, ...] = field(default_factory=lambda: tuple(rivals()))
    film: Film = field(default_factory=Film)
    effort: Effort = field(default_factory=Effort)
    rough: Effort = field(default_factory=lambda: Effort(9, 11, 80, 200, 500))
    trial: Trial = field(default_factory=Trial)
    variants: tuple[Variant, ...] = VARIANTS
    chunk: int = CHUNK

    @property
    def grids(self) -> list[Grid]:
        return [account.grid for account in self.accounts]


@dataclass(frozen=True)
class Findings:
    """What came of a plan: tables, fits, fits under other assumptions, and what to measure.

    ``needed`` holds, by pair of accounts, the instruments in order. ``wall_s`` is the time taken.
    """

    plan: Plan
    libraries: dict[Grid, Library]
    fits: tuple[Fit, ...]
    variants: dict[tuple[str, str], Fit]
    values: dict[tuple[str, str], Array]
    needed: dict[tuple[str, str], list[Needed]]
    wall_s: float

    @property
    def surviving(self) -> tuple[Fit, ...]:
        return tuple(each for each in self.fits if each.p >= SURVIVES)


def compute(plan: Plan, comm: Any, tick: Callable[[], None] = no_tick) -> Findings:
    """Fill the tables, fit all accounts, and weigh what to measure. Collective; on all ranks."""
    started = time.perf_counter()
    libraries = fill(plan.grids, comm, tick, plan.chunk)
    fits = _fits(plan, libraries, [Variant("", plan.film)], plan.effort, comm, tick)
    others = _fits(plan, libraries, plan.variants, plan.rough, comm, tick)
    own = tuple(fits[account.key, ""] for account in plan.accounts)
    alive = [each for each in own if each.p >= SURVIVES]
    for _ in range(count_jobs(len(own), plan.trial) - count_jobs(len(alive), plan.trial)):
        tick()  # what rejected accounts leave undone
    values = readings(alive, comm, tick, plan.trial) if alive else {}
    pairs = itertools.combinations([each.account.key for each in alive], 2)
    wall = comm.bcast(time.perf_counter() - started)
    return Findings(
        plan, libraries, own, others, values, {pair: needed(values, pair) for pair in pairs}, wall
    )


def _fits(
    plan: Plan,
    libraries: dict[Grid, Library],
    variants: Sequence[Variant],
    effort: Effort,
    comm: Any,
    tick: Callable[[], None],
) -> dict[tuple[str, str], Fit]:
    """Every account under every variant, by key of the one and name of the other."""
    jobs = [(account, variant) for account in plan.accounts for variant in variants]
    found: dict[int, Fit] = {}

    def work(i: int) -> Fit:
        account, variant = jobs[i]
        library = libraries[account.grid]
        if variant.centre:
            library = library.of_centre()
        return fit(account, library, film=variant.film, effort=effort)

    def take(i: int, result: Fit) -> None:
        found[i] = result
        tick()

    share_out(comm, len(jobs), work, take)
    found = comm.bcast(found)
    return {(a.key, v.name): found[i] for i, (a, v) in enumerate(jobs)}


def count_ticks(plan: Plan) -> int:
    """How often `compute` calls its ``tick``."""
    n = len(plan.accounts)
    return (
        count_chunks(plan.grids, plan.chunk)
        + n * (1 + len(plan.variants))
        + count_jobs(n, plan.trial)
    )


def compute_with_progress(plan: Plan, comm: Any) -> Findings:
    """`compute`, seen by the user."""
    if comm.rank:
        return compute(plan, comm)
    with progress("Accounts of the 65 %", count_ticks(plan)) as advance:
        return compute(plan, comm, advance)
