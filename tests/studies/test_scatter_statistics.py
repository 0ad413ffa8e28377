"""Statistics of a scatter against closed forms."""

import math

import numpy as np
import pytest

from bristle.solver import paper
from bristle.studies.scatter.statistics import (
    first_order,
    percentile_interval,
    r_squared,
    sampled,
    share_interval,
    spread,
)

pytestmark = pytest.mark.serial


def test_spread_of_a_normal_sample():
    rng = np.random.default_rng(1)
    n = 4000
    found = spread(0.65 + 0.1 * rng.standard_normal(n), rng)
    error = 0.1 / math.sqrt(n)
    assert found.mean.estimate == pytest.approx(0.65, abs=4 * error)
    assert found.mean.high - found.mean.low == pytest.approx(2 * 1.645 * error, rel=0.05)
    std_error = 0.1 / math.sqrt(2 * n)
    assert found.std.high - found.std.low == pytest.approx(2 * 1.645 * std_error, rel=0.15)
    for each, z in zip(found.percentiles, (-1.645, 0.0, 1.645), strict=True):
        assert each.low <= each.estimate <= each.high
        assert each.estimate == pytest.approx(0.65 + 0.1 * z, abs=0.01)
    assert found.in_band.estimate == pytest.approx(1.0, abs=2e-3)
    assert abs(found.skewness) < 0.2


def test_spread_of_equal_drops_is_none():
    found = spread(np.full(20, 0.7), np.random.default_rng(0))
    assert found.std.estimate == 0.0
    assert found.mean.low == found.mean.high == pytest.approx(0.7)
    assert found.skewness is None
    assert first_order(np.full(20, 0.7), np.arange(20.0), np.random.default_rng(0)) is None


def test_percentile_interval_holds_what_it_promises():
    rng = np.random.default_rng(2)
    intervals = [percentile_interval(rng.random(80), 50.0) for _ in range(800)]
    held = np.mean([each.low <= 0.5 <= each.high for each in intervals])
    assert held == pytest.approx(0.92, abs=0.035)  # 90 % or a little more: drops are whole
    assert percentile_interval(rng.random(20), 5.0).low == -math.inf
    everything = share_interval(20, 20)
    assert everything.high == 1.0
    # Wilson's lower end n/(n + z²)
    assert everything.low == pytest.approx(20 / (20 + 1.6449**2), rel=1e-3)


def test_shares_of_a_sum_are_its_variances():
    rng = np.random.default_rng(3)
    x, y, z = rng.uniform(-1.0, 1.0, (3, 6000))
    ratio = 0.6 * x**2 * math.sqrt(45.0 / 4.0) + 0.8 * np.sign(y)
    found = [first_order(ratio, factor, rng).estimate for factor in (x, y, z)]
    np.testing.assert_allclose(found, [0.36, 0.64, 0.0], atol=0.03)
    levels = first_order(ratio, (y > 0.0).astype(float), rng)
    assert levels.low < 0.64 < levels.high


def test_samples_of_26_have_the_standard_errors_of_26():
    rng = np.random.default_rng(4)
    y0 = np.resize(paper.HEIGHTS_M, 5000)
    ratio = paper.RATIO_MEAN + paper.RATIO_STD * rng.standard_normal(5000)
    mean, std, slope, r2 = sampled(y0, ratio * y0, rng).itertuples()
    assert mean.std == pytest.approx(paper.RATIO_STD / math.sqrt(26), rel=0.03)
    assert std.mean == pytest.approx(paper.RATIO_STD * (1 - 1 / (4 * 25)), rel=0.03)
    for each in (mean, std, slope):
        assert each.p_value > 0.5
    assert r2.low < r2.mean < r2.high < 1.0
    assert (sampled(y0, 0.9 * y0, rng).p_value[:2] < 1e-3).all()
    assert r_squared(y0, 0.9 * y0) == pytest.approx(1.0)
    assert math.isnan(r_squared(np.ones(5), np.full(5, 0.7)))
    line = np.array([1.0, 2.0, 3.0])
    y = np.array([1.0, 3.0, 2.0])
    a = 13.0 / 14.0
    left = (1 - a) ** 2 + (3 - 2 * a) ** 2 + (2 - 3 * a) ** 2
    assert r_squared(line, y) == pytest.approx(1.0 - left / 2.0)


@pytest.mark.parametrize("n", [20, 21, 39, 40])
def test_few_drops_each_with_another_lean_have_a_share_all_the_same(n):
    """As many values as bins are no levels: nothing would vary within them."""
    random = np.random.default_rng(n)
    factor = random.normal(size=n)
    found = first_order(factor + 0.01 * random.normal(size=n), factor, random)
    assert found.low < found.estimate <= 1.0
    assert found.estimate > 0.3
