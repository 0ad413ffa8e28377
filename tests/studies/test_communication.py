"""A solid on several ranks sends what the model of its communication says."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from benchmarks import communication
from benchmarks.communication import Bar, Machine
from mpi4py import MPI
from petsc4py import PETSc

from bristle.solver.contact.enforcement import ContactMethod, Enforcement
from bristle.solver.contact.laws import Linear
from bristle.solver.impact import History, march_contact
from bristle.solver.time.march import Marcher
from bristle.solver.time.scheme import TimeScheme

COMM = MPI.COMM_WORLD
MACHINE = Machine(latency_s=1e-6, bandwidth_B_s=5e9, memory_B_s=8e9, solve_B_s=4e9)


def ghosts(matrix: PETSc.Mat) -> int:
    """Unknowns of other ranks that a product needs."""
    first, last = matrix.getOwnershipRangeColumn()
    columns = np.unique(matrix.getValuesCSR()[1])
    return int(((columns < first) | (columns >= last)).sum())


@pytest.mark.parametrize("cells", [(1, 2, 24), (1, 2, 48), (2, 3, 24)])
@pytest.mark.parametrize("order", [1, 2])
def test_a_cut_is_a_cross_section_whatever_the_length(make_solid, cells, order):
    solid, bar = make_solid(cells=cells, order=order), Bar(cells, order)
    assert solid.n_dofs == bar.unknowns
    needed = COMM.allgather(ghosts(solid.stiffness_matrix))
    touched = [communication.neighbours(rank, COMM.size) for rank in range(COMM.size)]
    assert sum(needed) <= sum(touched) * bar.most_ghosts
    # somebody lacks each node of a plane that is cut
    assert sum(needed) >= (COMM.size - 1) * bar.plane


def test_a_product_exchanges_what_the_matrix_couples_with_neighbours_alone(make_solid):
    solid = make_solid(cells=(1, 2, 24))
    others = solid.node_mass.columns
    assert COMM.allreduce(3 * others.num_ghosts) == COMM.allreduce(ghosts(solid.mass_matrix))
    touched = COMM.allgather(len(set(others.owners)))
    wanted = [communication.neighbours(rank, COMM.size) for rank in range(COMM.size)]
    assert sorted(touched) == sorted(wanted)


class Counted:
    """A communicator that counts reductions."""

    def __init__(self, comm: MPI.Intracomm) -> None:
        self._comm, self.count = comm, 0

    def __getattr__(self, name: str):
        if name in ("allreduce", "Allreduce"):
            self.count += 1
        return getattr(self._comm, name)


def test_reductions_of_a_step_are_those_counted(make_solid, monkeypatch):
    solid = make_solid(cells=(1, 2, 24))
    method = ContactMethod(Linear(2e6), Enforcement.PENALTY)
    marcher = Marcher(solid, method, TimeScheme.average(), 1e-6, 9.81)
    comm = Counted(COMM)
    # one rank alone does without; it is counted as two would
    size = max(COMM.size, 2)
    monkeypatch.setattr(comm, "size", size, raising=False)
    monkeypatch.setattr(solid, "comm", comm)
    object.__setattr__(solid.contact, "comm", comm)
    try:
        counts = []
        for end_s in (2.5e-6, 7.5e-6):
            comm.count = 0
            start = np.zeros(solid.n_local), -solid.translation[:, 2].copy()
            touch = march_contact(marcher, 0.0, *start, History(), until_s=end_s)
            counts.append((touch.n_steps, comm.count))
    finally:
        object.__setattr__(solid.contact, "comm", COMM)
    (few, count_few), (many, count_many) = counts
    assert many > few
    assert count_many - count_few == communication.ALLREDUCES * (many - few)


def test_efficiency_falls_with_ranks_and_grows_with_length():
    short, long = Bar((1, 4, 337)), Bar((1, 4, 3370))
    ranks = [1, 2, 4, 8, 16, 32]
    falling = [communication.efficiency(short, n, MACHINE) for n in ranks]
    assert falling[0] == 1.0
    assert all(a > b for a, b in itertools.pairwise(falling))
    assert communication.waiting_s(short, 8, MACHINE) == communication.waiting_s(long, 8, MACHINE)
    for n in ranks[1:]:
        shares = [communication.efficiency(bar, n, MACHINE) for bar in (short, long)]
        assert shares[0] < shares[1]
    ends = [communication.last_ranks(bar, 0.5, MACHINE) for bar in (short, long)]
    assert ends[0] < ends[1]


@pytest.mark.parametrize("share", communication.SHARES)
@pytest.mark.parametrize("cells", communication.SIZES)
def test_scaling_ends_where_efficiency_falls_under_the_share(cells, share):
    bar = Bar(cells)
    ranks = communication.last_ranks(bar, share, MACHINE)
    assert ranks == 1 or communication.efficiency(bar, ranks, MACHINE) >= share
    if 2 * ranks <= cells[2]:
        assert communication.efficiency(bar, 2 * ranks, MACHINE) < share


def test_the_sizes_are_those_asked_for():
    unknowns = [Bar(cells).unknowns for cells in communication.SIZES]
    np.testing.assert_allclose(unknowns, [5e4, 5e5, 3e6], rtol=0.1)
