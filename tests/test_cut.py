"""Is a body that ranks cut into parts factored like a whole one?"""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from bristle.solver.bodies import cut
from bristle.solver.bodies.cut import CutFactor
from bristle.studies.bench.step import bar_solid

COMM = MPI.COMM_WORLD


@pytest.mark.parametrize("cells", [(1, 1, 1), (1, 1, 3), (2, 3, 24)])
@pytest.mark.parametrize("order", [1, 2])
def test_a_solve_gives_back_what_was_multiplied(make_solid, cells, order):
    solid = make_solid(cells=cells, order=order)
    shift = 1e12
    x = np.random.default_rng(COMM.rank).standard_normal((solid.n_local, 5))
    for b_of in (x[:, 0].copy(), np.asfortranarray(x)):
        b = solid.stiffness(b_of) + shift * solid.mass(b_of)
        np.testing.assert_allclose(solid.factor(shift, 1.0)(b), b_of, atol=1e-9)
        np.testing.assert_allclose(solid.factor(2 * shift, 2.0)(b), b_of / 2, atol=1e-9)
    if COMM.size > 1 and cells != (1, 1, 1):  # one cell is on one rank
        (solver,) = {type(each) for each in solid._solvers.values()}
        assert solver is CutFactor
    solid.release_factors()


@pytest.mark.skipif(COMM.size == 1, reason="needs parts")
def test_parts_that_are_not_slender_are_factored_by_mumps(make_solid, monkeypatch):
    monkeypatch.setattr(cut, "WIDEST", 0)
    solid = make_solid(cells=(2, 3, 24), order=2)
    shift = 1e12
    x = np.random.default_rng(COMM.rank).standard_normal((solid.n_local, 5))
    for b_of in (x[:, 0].copy(), np.asfortranarray(x)):
        b = solid.stiffness(b_of) + shift * solid.mass(b_of)
        np.testing.assert_allclose(solid.factor(shift, 1.0)(b), b_of, atol=1e-9)
    (solver,) = solid._solvers.values()
    assert isinstance(solver.part, cut._ByMumps)
    solid.release_factors()


def test_a_cut_has_a_cross_section_of_unknowns(make_solid):
    for length in (24, 48):
        solid = make_solid(cells=(1, 2, length))
        assert COMM.allreduce(int(solid.on_cuts.sum())) == (COMM.size - 1) * 3 * 3 * 5


def test_parts_together_read_no_more_than_a_whole_bar(make_solid):
    """But for what a part between two cuts needs of the farther."""
    cells = (1, 2, 48)
    whole, _ = bar_solid(cells, 2)
    solid = make_solid(cells=cells)
    solid.factor(1e12, 1.0)
    (solver,) = solid._solvers.values()
    if COMM.size == 1:
        read, far = solver.factor.layout.entries, 0
    else:
        read, far = solver.part.factor.layout.entries, len(solver.part._far)
    assert COMM.allreduce(read) <= whole.layout.entries
    planes = COMM.allgather(far)
    assert sorted(planes) == sorted([0] * min(COMM.size, 2) + [3 * 3 * 5] * (COMM.size - 2))
    solid.release_factors()
    whole.close()
