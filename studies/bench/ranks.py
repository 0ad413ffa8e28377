"""How much faster are more ranks, with one large solid, with many, and with groups of ranks?

`bristle bench ranks` starts mpirun itself; it is not to be run under mpirun. Beside what is
measured stands what the model of `communication` says of larger machines.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ...solver.errors import ComputationError, InputError
from ..running.files import prepare_folder, to_csv, to_json, together, write_atomically
from ..running.parallel import launched_ranks, unlaunched
from ..running.progress import progress
from .communication import Machine, prediction
from .machine import facts, load

# Cells of the one large solid (172 000 unknowns), and of the many.
LARGE, SMALL = (2, 8, 337), (1, 4, 337)
CASES_PER_GROUP = 3
# Soft contact: many steps, so that building does not hide them.
KN_N_M = 2e5
GOALS = {"one": 0.85, "many": 0.95, "mixed": 0.95}
TIMEOUT_S = 3600.0
COLUMNS = (
    "kind", "ranks", "ranks_per_case", "cases", "total_s", "march_s", "efficiency",
    "efficiency_march", "goal", "memory_allows", "oversubscribed",
)  # fmt: skip


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
    from .ranks_page import page

    prepare_folder(out)
    about = [load(), *facts()]
    cores = len(os.sched_getaffinity(0))
    ranks = most or max(cores, 2)
    todo = jobs(ranks, large, small)
    times: dict[Job, list[dict[str, Any]]] = {job: [] for job in todo}
    with progress("Jobs", repeats * len(todo) + 2) as advance:
        sent = launch(2, {"kind": "ping"})
        advance()
        memory = Memory(**launch(min(ranks, cores), {"kind": "memory"}))
        advance()
        machine = Machine(**sent, memory_B_s=memory.memory_B_s, solve_B_s=memory.solve_B_s)
        for _ in range(repeats):
            for job in todo:
                times[job].append(launch(job.ranks, _arguments(job)))
                advance()
    rows = list(_rows(times, cores, memory))
    predicted = prediction(machine)
    table = [[row[name] for name in COLUMNS] for row in rows]
    document = {
        "cores": cores,
        "repeats": repeats,
        "rows": rows,
        "machine": asdict(machine),
        "memory": asdict(memory),
        "predicted": predicted,
        "all_times": [{**asdict(job), "runs": runs} for job, runs in times.items()],
    }
    with together(out, "ranks.json"):
        write_atomically(out / "ranks.csv", to_csv(COLUMNS, table))
        write_atomically(out / "ranks.json", to_json(document) + "\n")
        page(rows, machine, memory, predicted, out, repeats, about, most)
    return "\n".join([*_told(rows, cores), "", *_foretold(machine, memory, predicted)])


def _arguments(job: Job) -> dict[str, Any]:
    return {
        "kind": "solids",
        "cells": job.cells,
        "cases": job.cases,
        "per_case": job.ranks_per_case,
        "kn_N_m": KN_N_M,
    }


def launch(ranks: int, arguments: dict[str, Any]) -> dict[str, Any]:
    """What a job of `ranks_job` finds; ComputationError where it fails."""
    command = ["mpirun", "-n", str(ranks), "--oversubscribe", sys.executable, "-m"]
    command += ["bristle.studies.bench.ranks_job", json.dumps(arguments)]
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            env=unlaunched(),
            stdin=subprocess.DEVNULL,
            timeout=TIMEOUT_S,
            check=True,
        )
        return dict(json.loads(done.stdout.splitlines()[-1]))
    except FileNotFoundError as error:
        raise ComputationError("there is no mpirun here") from error
    except subprocess.TimeoutExpired as error:
        raise ComputationError(f"a job on {ranks} ranks took over {TIMEOUT_S:g} s") from error
    except (subprocess.CalledProcessError, IndexError, ValueError) as error:
        told = getattr(error, "stderr", None) or str(error)
        last = [line for line in told.splitlines() if line.strip()][-1:]
        raise ComputationError(f"a job on {ranks} ranks failed: {' '.join(last)}") from error


def _rows(
    times: dict[Job, list[dict[str, Any]]], cores: int, memory: Memory
) -> Iterator[dict[str, Any]]:
    best = {
        job: {name: min(run[name] for run in runs) for name in ("total_s", "march_s")}
        for job, runs in times.items()
    }
    for job, found in best.items():
        base = best[job.base]
        yield {
            "kind": job.kind,
            "ranks": job.ranks,
            "ranks_per_case": job.ranks_per_case,
            "cases": job.cases,
            **found,
            "efficiency": base["total_s"] / found["total_s"] / job.ideal,
            "efficiency_march": base["march_s"] / found["march_s"] / job.ideal,
            "goal": GOALS[job.kind],
            "memory_allows": memory.allows if job.ranks == memory.ranks else None,
            "oversubscribed": job.ranks > cores,
            "spread": _spread([run["total_s"] for run in times[job]]),
        }


def _spread(values: Sequence[float]) -> float:
    """How far repeats lie apart, over their median."""
    return (max(values) - min(values)) / statistics.median(values)


def _told(rows: Sequence[dict[str, Any]], cores: int) -> Iterator[str]:
    yield f"{'':<7}{'ranks':>6}{'a case':>8}{'cases':>7}{'wall s':>9}{'march s':>9}  efficiency"
    for row in rows:
        line = f"{row['kind']:<7}{row['ranks']:>6}{row['ranks_per_case']:>8}{row['cases']:>7}"
        line += f"{row['total_s']:>9.2f}{row['march_s']:>9.2f}"
        shares = f"{100 * row['efficiency']:.0f} %, march {100 * row['efficiency_march']:.0f} %"
        why = f" ({row['ranks']} ranks on {cores} cores)" if row["oversubscribed"] else ""
        bound = row["memory_allows"]
        allowed = "" if bound is None else f", memory allows {100 * bound:.0f} %"
        yield f"{line}  {shares}, goal {100 * row['goal']:.0f} %{allowed}{why}"


def _foretold(
    machine: Machine, memory: Memory, predicted: Sequence[dict[str, float]]
) -> Iterator[str]:
    yield (
        f"a message takes {1e6 * machine.latency_s:.2f} µs and 1 s per "
        f"{machine.bandwidth_B_s / 1e9:.2f} GB"
    )
    alone, together, solve_alone, solve_together = (
        f"{rate / 1e9:.2f}"
        for rate in (
            *(memory.memory_alone_B_s, memory.memory_B_s),
            *(memory.solve_alone_B_s, memory.solve_B_s),
        )
    )
    yield (
        f"a rank reads {alone} GB/s alone, {together} where {memory.ranks} do; "
        f"a factor {solve_alone} and {solve_together}"
    )
    yield f"{'unknowns':>10}{'step ms':>9}{'a cut kB':>10}{'85 % to':>9}{'50 % to':>9}  predicted"
    for row in predicted:
        yield (
            f"{row['unknowns']:>10.0f}{1e3 * row['step_s']:>9.1f}{row['cut_B'] / 1e3:>10.1f}"
            f"{row['ranks_at_85']:>9.0f}{row['ranks_at_50']:>9.0f}   ranks"
        )
