"""`bristle bench ranks`: what more ranks gain, with one large solid, with many, and with groups.

Starts mpirun itself, and is not to be run under it. Beside what is measured stands what the model
of `communication` says of larger machines.
"""

from __future__ import annotations

import os
import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bristle.solver.errors import InputError
from bristle.studies.running.parallel import launched_ranks
from bristle.studies.running.progress import progress

from .apart import apart, call
from .column import column
from .communication import Machine, prediction
from .records import Part, curves_figure, prepare, publish

# Cells of the one large solid (172 000 unknowns), and of the many.
LARGE, SMALL = (2, 8, 337), (1, 4, 337)
CASES_PER_GROUP = 3
# Soft contact: many steps, so that building does not hide them.
KN_N_M = 2e5
GOALS = {"one": 0.85, "many": 0.95, "mixed": 0.95}
KINDS = {"one": "one large solid", "many": "many, a rank each", "mixed": "groups of two ranks"}
HOW = (
    "One large solid over ranks, many of them dealt out, and groups of ranks.",
    "Efficiency is the time of one rank (or one group, with its share of the cases) over that of "
    "all, divided by how many times more ranks there are where the work is the same. Jobs run in "
    "turn, then all again; the least time of each counts. “Whole” is from before the first mesh to "
    "the last result, “march” the slowest group's time steps.",
    "What memory allows: a solve with a factor that no cache holds, on one rank while the others "
    "wait, over the same on all ranks at once. Nothing is sent, so what is lost is the memory's.",
    "Predicted: local work in the bytes that it reads, waiting in messages, with the rates "
    "measured here (tests/benchmarks/communication.py).",
)


@dataclass(frozen=True)
class Job:
    """Solids of ``kind``: so many ``cases`` on ``ranks``, each on ``ranks_per_case`` of them."""

    kind: str
    ranks: int
    ranks_per_case: int
    cases: int
    cells: tuple[int, int, int]

    @property
    def base(self) -> Job:
        """What it is held against: one rank, or one group of ranks with its share of the cases."""
        if self.kind == "one":
            return Job(self.kind, 1, 1, self.cases, self.cells)
        groups = self.ranks // self.ranks_per_case
        share = self.cases // groups
        return Job(self.kind, self.ranks_per_case, self.ranks_per_case, share, self.cells)

    @property
    def call(self) -> list[str]:
        """What asks for its times."""
        numbers = {"cases": self.cases, "per_case": self.ranks_per_case, "kn_N_m": KN_N_M}
        return call("jobs.solids", cells=self.cells, **numbers)

    @property
    def ideal(self) -> float:
        """The base's time over this one's if nothing were lost."""
        return float(self.ranks) if self.kind == "one" else 1.0


@dataclass(frozen=True)
class Memory:
    """Bytes per s that each of ``ranks`` reads as a stream and in a solve: all at once, and one of
    them while the others wait."""

    ranks: int
    memory_B_s: float
    memory_alone_B_s: float
    solve_B_s: float
    solve_alone_B_s: float

    @property
    def allows(self) -> float:
        """The efficiency of ranks that do nothing but solve, each for itself."""
        return self.solve_B_s / self.solve_alone_B_s


@dataclass(frozen=True, kw_only=True)
class Line:
    """A job's least times in s, and its efficiency beside what is asked for and memory allows.

    ``spread`` is how far repeats lie apart, over their median.
    """

    kind: str = column("Kind")
    ranks: int = column("Ranks", digits=0)
    ranks_per_case: int = column("a case", digits=0)
    cases: int = column("Cases", digits=0)
    total_s: float = column("Whole", "s")
    march_s: float = column("March", "s")
    efficiency: float = column("Efficiency")
    efficiency_march: float = column("of the march")
    goal: float = column("Goal")
    memory_allows: float | None = column("Memory allows")
    oversubscribed: bool = column("More ranks than cores")
    spread: float

    @property
    def base(self) -> bool:
        """Whether others of its kind are held against this job."""
        return self.ranks == (self.ranks_per_case if self.kind == "mixed" else 1)

    def sentence(self) -> str:
        """How efficient it is."""
        bound = self.memory_allows
        allowed = "" if bound is None else f", memory allows {100.0 * bound:.0f} %"
        busy = "; more ranks than cores" if self.oversubscribed else ""
        return (
            f"{KINDS[self.kind].capitalize()} on {self.ranks} ranks: efficiency "
            f"{100.0 * self.efficiency_march:.0f} % of the march, {100.0 * self.efficiency:.0f} % "
            f"of the whole (asked for {100.0 * self.goal:.0f} %{allowed}{busy})."
        )


def jobs(
    most: int, large: tuple[int, int, int] = LARGE, small: tuple[int, int, int] = SMALL
) -> list[Job]:
    """Every job for powers of two of ranks up to ``most``; the mixed one has two groups of two."""
    ranks = [2**k for k in range(most.bit_length()) if 2**k <= most]
    found = [Job("one", n, n, 1, large) for n in ranks]
    found += [Job("many", n, 1, n * CASES_PER_GROUP, small) for n in ranks]
    mixed = max(most, 4)
    found.append(Job("mixed", 2, 2, CASES_PER_GROUP, small))
    found.append(Job("mixed", mixed, 2, mixed // 2 * CASES_PER_GROUP, small))
    return found


def run_ranks(
    out: Path,
    *,
    repeats: int = 3,
    most: int | None = None,
    large: tuple[int, int, int] = LARGE,
    small: tuple[int, int, int] = SMALL,
) -> str:
    """Measure, write ranks.csv, ranks.json and report.html into ``out``; the table as text.

    All jobs are run ``repeats`` times in turns; the least time of each counts. ``most`` ranks:
    left out, as many as there are cores. Raises InputError under mpirun, ComputationError where a
    job fails.
    """
    if launched_ranks() > 1:
        raise InputError("bench ranks: starts mpirun itself, and is not to be run under mpirun")
    about = prepare("ranks", out)
    cores = len(os.sched_getaffinity(0))
    ranks = most or max(cores, 2)
    todo = jobs(ranks, large, small)
    times: dict[Job, list[dict[str, Any]]] = {job: [] for job in todo}
    with progress("Jobs", repeats * len(todo) + 2) as advance:
        sent = apart(call("jobs.ping"), 2)
        advance()
        memory = Memory(**apart(call("jobs.memory"), min(ranks, cores)))
        advance()
        machine = Machine(**sent, memory_B_s=memory.memory_B_s, solve_B_s=memory.solve_B_s)
        for _ in range(repeats):
            for job in todo:
                times[job].append(apart(job.call, job.ranks))
                advance()
    further = {
        "cores": cores,
        "repeats": repeats,
        "machine": asdict(machine),
        "memory": asdict(memory),
        "all_times": [{**asdict(job), "runs": runs} for job, runs in times.items()],
    }
    lines = list(_lines(times, cores, memory))
    return page(lines, machine, memory, out, repeats, about, most=most, further=further)


def page(
    lines: Sequence[Line],
    machine: Machine,
    memory: Memory,
    out: Path,
    repeats: int,
    about: Sequence[tuple[str, str]],
    *,
    most: int | None = None,
    further: Mapping[str, Any] | None = None,
) -> str:
    """Write the records with their page, the tables as text; ``about`` is the machine, and ``most``
    ranks were asked for, if any."""
    predicted = prediction(machine)
    ends = {
        "ranks": {
            f"{share} %": (
                [each.unknowns for each in predicted],
                [getattr(each, f"ranks_at_{share}") for each in predicted],
            )
            for share in (85, 50)
        }
    }
    parts = [
        Part("ranks", "Every job", lines, note="Efficiencies are parts of one."),
        Part(
            "predicted",
            "Where scaling ends",
            predicted,
            curves_figure("unknowns", ends),
            "Up to how many ranks one solid is predicted to be shared with an efficiency of 85 % "
            "and of 50 %, by its unknowns.",
        ),
    ]
    return publish(
        "ranks",
        parts,
        out,
        title="What more ranks gain",
        command=("ranks", "--repeats", repeats, *(() if most is None else ("--most", most))),
        headline=[line.sentence() for line in lines if not line.base],
        about=[
            *about,
            ("A message", f"{1e6 * machine.latency_s:.3g} µs between two ranks"),
            ("A rank reads memory", _rates(memory.memory_alone_B_s, memory.memory_B_s)),
            ("A rank reads a factor", _rates(memory.solve_alone_B_s, memory.solve_B_s)),
        ],
        how=HOW,
        further=further,
    )


def _rates(alone: float, together: float) -> str:
    return f"{alone / 1e9:.3g} GB/s alone, {together / 1e9:.3g} a rank together"


def _lines(times: Mapping[Job, list[dict[str, Any]]], cores: int, memory: Memory) -> Iterator[Line]:
    best = {
        job: {name: min(run[name] for run in runs) for name in ("total_s", "march_s")}
        for job, runs in times.items()
    }
    for job, found in best.items():
        base = best[job.base]
        yield Line(
            kind=job.kind,
            ranks=job.ranks,
            ranks_per_case=job.ranks_per_case,
            cases=job.cases,
            **found,
            efficiency=base["total_s"] / found["total_s"] / job.ideal,
            efficiency_march=base["march_s"] / found["march_s"] / job.ideal,
            goal=GOALS[job.kind],
            memory_allows=memory.allows if job.ranks == memory.ranks else None,
            oversubscribed=job.ranks > cores,
            spread=_spread([run["total_s"] for run in times[job]]),
        )


def _spread(values: Sequence[float]) -> float:
    """How far repeats lie apart, over their median."""
    return (max(values) - min(values)) / statistics.median(values)
