"""Is the smallest honest set an ideal reader's: one where effects differ, all that are alike?"""

import loop_toys as toys
import numpy as np
import pytest

from bristle.studies.bench.loop_ideal import Ideal, ideal_set
from bristle.studies.loop.sizes import clean, value_for

pytestmark = pytest.mark.serial


def ideal(name: str, d: float) -> Ideal:
    problem, _ = toys.problem(3)
    data, base = clean(problem, np.array([1.0]), 3)
    model = next(each for each in problem.candidates if each.effects == (name,))
    value = value_for(data, base, model, d, 1)
    return ideal_set(problem, data, base, model, np.array([1.0, value]), d, 3)


def test_an_effect_that_nothing_imitates_is_alone():
    found = ideal("wear", 10.0)
    assert found.size == pytest.approx(1.0, abs=0.02)
    assert found.hit > 0.99


def test_effects_alike_are_both_in_the_set_which_holds_the_truth_as_often_as_it_says():
    """The toy's dashpot and Rayleigh damping differ by less than a tenth of a sigma."""
    found = ideal("dashpot", 10.0)
    assert found.size >= 2.0
    # 95 % of 300 sets, four standard deviations
    assert found.hit > 0.9


def test_a_weak_effect_leaves_more_in_the_set():
    assert ideal("adhesion", 4.0).size > ideal("adhesion", 12.0).size
