"""What is measured in processes that `apart` starts, on the ranks that mpirun gave them."""

from __future__ import annotations

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
FURTHER = 3

comm = MPI.COMM_WORLD


def further(
    model: str,
    cells: tuple[int, int, int],
    modes: int,
    its: float,
    kn: float,
    height: float,
    beta: float,
) -> float:
    """What a further drop costs in a process that has made one already: the median of some, in s.

    Mesh, matrices, factor, basis and compiled code are there; march and flight are what is left.
    """
    inputs = DropInputs(
        model=Model(model),
        cells=cells,
        modes=modes,
        its_s=its,
        kn_N_m=kn,
        height_m=height,
        beta_s=beta,
    )
    with CaseSession(comm) as session:
        session.run(inputs)
        return _median_s(lambda: session.run(inputs), FURTHER)


def solids(cells: tuple[int, int, int], cases: int, per_case: int, kn_N_m: float) -> dict[str, Any]:
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


def ping() -> dict[str, Any]:
    """A message's latency and bandwidth between the first two ranks: half of a round trip's
    median."""
    large_s = _one_way_s(LARGE_B, MESSAGES // 50)
    return {"latency_s": _one_way_s(8, MESSAGES), "bandwidth_B_s": LARGE_B / large_s}


def memory() -> dict[str, Any]:
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


def _one_way_s(size_B: int, times: int) -> float:
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
