"""Which drops are simulated again where some fail, and at which steps?"""

import numpy as np
import pytest

from bristle.solver.errors import ComputationError
from bristle.studies.running.retry import SHORTER, drop_by_drop, with_shorter_its

pytestmark = pytest.mark.serial
ITS_S = 1e-6


@pytest.mark.parametrize("n", [1, 2, 7, 8])
@pytest.mark.parametrize("place", [0, 0.5, 1])
def test_one_drop_that_fails_takes_a_shorter_step_and_the_others_none(n, place):
    bad = round(place * (n - 1))

    def run(which, its):
        if which.start <= bad < which.stop and its > 0.3 * ITS_S:
            raise ComputationError("no convergence")
        return np.array([[i, its] for i in range(n)])[which]

    rows = drop_by_drop(run, n, ITS_S, np.full(2, np.nan))
    assert np.array_equal(rows[:, 0], np.arange(n))
    assert rows[bad, 1] == SHORTER[-1] * ITS_S
    assert np.all(np.delete(rows[:, 1], bad) == ITS_S)


def test_drops_that_fail_at_every_step_have_the_row_of_failure():
    def run(which, its):
        if which.stop > 3:
            raise ComputationError("held for good")
        return np.zeros((which.stop - which.start, 2))

    rows = drop_by_drop(run, 5, ITS_S, np.array([1.0, np.inf]))
    assert np.array_equal(rows, [[0, 0]] * 3 + [[1, np.inf]] * 2)


def test_the_longest_step_that_serves_is_taken_and_the_last_failure_told():
    def run_to(limit):
        def run(its):
            if its > limit:
                raise ComputationError(f"failed at {its:g}")
            return its

        return run

    assert with_shorter_its(run_to(np.inf), ITS_S) == ITS_S
    assert with_shorter_its(run_to(0.6 * ITS_S), ITS_S) == SHORTER[0] * ITS_S
    with pytest.raises(ComputationError, match=f"{SHORTER[-1] * ITS_S:g}"):
        with_shorter_its(run_to(0.0), ITS_S)
