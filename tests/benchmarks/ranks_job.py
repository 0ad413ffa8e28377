"""One job of `ranks`, on the ranks that mpirun gave it.

``mpirun -n 2 python3 -m benchmarks.ranks_job '{"kind": "solids", …}'`` prints one line
of JSON.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from mpi4py import MPI

from bristle.meshes.distribute import Tag, to_dolfinx
from bristle.solver.bodies.solid import SolidBody
from bristle.solver.bristle import Material
from bristle.studies.inputs.choices import Model
from bristle.studies.inputs.config import DropInputs
from bristle.studies.running.cases import CaseSession, Timings
from bristle.studies.running.groups import run_cases

from .communication import Bar, solve_B

MESSAGES = 2000
READINGS = 15
LARGE_B = 1 << 22
TRIAD = 1 << 23
# A solid whose factor no cache holds, and the shift of a step of 0.01 ms.
SOLVED = (1, 4, 337)
SHIFT_1_S2 = 4e10


def solids(
    comm: MPI.Intracomm,
    cells: tuple[int, int, int],
    cases: int,
    per_case: int,
    kn_N_m: float,
) -> dict[str, Any]:
    """Seconds from before the first mesh to the last result, and of the slowest group's marches.

    All cases take the same steps: heights alone differ.
    """
    heights = np.linspace(0.03, 0.05, cases)
    inputs = [
        DropInputs(model=Model.SOLID, cells=cells, height_m=float(h), kn_N_m=kn_N_m)
        for h in heights
    ]
    spent: dict[int, float] = {}
    steps: dict[int, int] = {}
    place: dict[int, int] = {}

    def work(session: CaseSession, case: DropInputs) -> tuple[Timings, int, int]:
        result, timings = session.run(case)
        return timings, result.n_steps, comm.rank

    def take(i: int, found: tuple[Timings, int, int]) -> None:
        timings, steps[i], place[i] = found
        spent[i] = timings["march"]

    with CaseSession(comm) as session:
        comm.Barrier()
        started = time.perf_counter()
        run_cases(session, inputs, work, take, per_case)
        comm.Barrier()
        total = time.perf_counter() - started
    by_group = [sum(spent[i] for i in spent if place[i] == rank) for rank in set(place.values())]
    marched = max(by_group, default=0.0)
    return {"total_s": total, "march_s": marched, "steps": sum(steps.values())}


def ping(comm: MPI.Intracomm) -> dict[str, Any]:
    """A message's latency and bandwidth between the first two ranks: half of a round trip's
    median."""
    found = {"latency_s": _one_way_s(comm, 8, MESSAGES)}
    found["bandwidth_B_s"] = LARGE_B / _one_way_s(comm, LARGE_B, MESSAGES // 50)
    return found


def memory(comm: MPI.Intracomm) -> dict[str, Any]:
    """How fast ranks read memory and a factor: the first while the others wait, and all at once.

    The medians of a triad and of a solve; of all at once the slowest rank's.
    """
    a, b, c = np.zeros(TRIAD), np.ones(TRIAD), np.ones(TRIAD)

    def triad() -> None:
        np.multiply(c, 3.0, out=a)
        np.add(a, b, out=a)

    spec = DropInputs(model=Model.SOLID, cells=SOLVED).mesh_spec()
    domain, _, facets = to_dolfinx(spec, MPI.COMM_SELF)
    solid = SolidBody(domain, facets, int(Tag.TIP), Material())
    solve, load = solid.factor(SHIFT_1_S2, 1.0), np.ones(solid.n_local)
    found: dict[str, Any] = {"ranks": comm.size}
    # two passes over three arrays of eight bytes, less what is read again: 16 + 24 bytes
    for name, size_B, act in (
        ("memory", 40.0 * TRIAD, triad),
        ("solve", solve_B(Bar(SOLVED)), lambda: solve(load)),
    ):
        alone = _median_s(act, READINGS) if comm.rank == 0 else 0.0
        found[f"{name}_alone_B_s"] = size_B / comm.bcast(alone)
        comm.Barrier()
        found[f"{name}_B_s"] = size_B / comm.allreduce(_median_s(act, READINGS), MPI.MAX)
    solid.close()
    return found


def _one_way_s(comm: MPI.Intracomm, size_B: int, times: int) -> float:
    """Half of the median round trip of a message between ranks 0 and 1."""
    buffer = np.zeros(size_B, np.uint8)

    def trip() -> None:
        if comm.rank == 0:
            comm.Send(buffer, 1)
            comm.Recv(buffer, 1)
        elif comm.rank == 1:
            comm.Recv(buffer, 0)
            comm.Send(buffer, 0)

    return 0.5 * float(comm.bcast(_median_s(trip, times)))


def _median_s(action: Callable[[], object], times: int) -> float:
    spent = []
    for _ in range(times):
        started = time.perf_counter()
        action()
        spent.append(time.perf_counter() - started)
    return float(np.median(spent))


def main(arguments: dict[str, Any]) -> None:
    """Run the job and print what it found, from rank 0."""
    comm = MPI.COMM_WORLD
    kind = arguments.pop("kind")
    jobs: dict[str, Callable[..., dict[str, Any]]]
    jobs = {"ping": ping, "memory": memory, "solids": solids}
    found = jobs[kind](comm, **arguments)
    if comm.rank == 0:
        print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
