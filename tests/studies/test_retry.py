"""The steps at which a drop that fails is simulated again."""

import numpy as np
import pytest

from bristle.solver.batch import SHORTER
from bristle.solver.errors import ComputationError
from bristle.studies.running.steps import with_shorter_its

pytestmark = pytest.mark.serial
ITS_S = 1e-6


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
