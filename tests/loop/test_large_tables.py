"""Thousands of drops: the short ways that are taken for them give what the long ones give."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from made_drops import write_drops

from bristle.studies.data.datasets import read_drops
from bristle.studies.loop.adequacy import STATE_SHARES, STATE_SHIFTS, STATE_SPREADS, _two_states
from bristle.studies.loop.kinds.drops.problem import drops_problem, sessions
from bristle.studies.loop.sample import ENOUGH, sample
from bristle.studies.loop.shapes import Refit, Shapes, UnitShapes, bands_of

pytestmark = pytest.mark.serial

# These need no table but the plain one.
COMPUTED = ("height_offset", "release_velocity", "session", "surface_phases")
MANY = 2000


@pytest.fixture(scope="module")
def many(tmp_path_factory):
    """Drops of random heights whose rebound is a plain share of them, in two sessions."""
    rng = np.random.default_rng(4)
    data = read_drops(write_drops(tmp_path_factory.mktemp("many")))
    y0_m = rng.uniform(0.01, 0.05, MANY)
    y1_m = 0.6 * y0_m + 3e-4 * rng.standard_normal(MANY)
    session = ("a",) * (MANY // 2) + ("b",) * (MANY // 2)
    drop = 1.0 + np.arange(MANY)
    return drops_problem(replace(data, drop=drop, y0_m=y0_m, y1_m=y1_m, session=session))


@pytest.mark.parametrize("name", COMPUTED)
def test_drops_are_interpolated_to_far_less_than_their_noise(many, name):
    model = many.combine((name,))
    theta = np.array([each.typical for each in model.parameters])
    assert model._mesh is not None
    direct = many.combine((name,))
    direct.__dict__["_mesh"] = None  # as if it were a table of few drops
    assert np.abs(model.predict(theta) - direct.predict(theta)).max() < 1e-4


def test_a_share_of_the_drops_is_from_all_heights_and_predicted_alone(many):
    data = sample(many, np.unique(many.group))
    few = data.first
    assert few.values.size == ENOUGH
    assert data.times == pytest.approx(MANY / ENOUGH)
    height = few.covariates["height"]
    shares, _ = np.histogram(height, np.quantile(data.covariates["height"], np.linspace(0, 1, 11)))
    assert np.ptp(shares) <= 2
    model = many.combine(("session",))
    theta = np.array([each.typical for each in model.parameters])
    alone, with_all = few.predict(model, theta), model.predict(theta)[..., few.rows]
    np.testing.assert_allclose(alone, with_all, atol=1e-9)


def test_shapes_are_summed_by_their_parts_as_one_by_one():
    """Bands of a covariate, at either of two quantities, in proportion to a size or not."""
    rng = np.random.default_rng(3)
    cells, bands = bands_of(rng.uniform(size=200))
    kind, size = rng.integers(2, size=200), rng.uniform(0.5, 1.5, size=200)
    every = np.stack([how * (kind == k) for how in (np.ones(200), size) for k in (0, 1)])
    refit, z = Refit(rng.standard_normal((200, 3))), rng.standard_normal((5, 200))
    found = UnitShapes.of(Shapes(cells, every, bands), refit)
    left = refit(np.concatenate([bands @ cells * each for each in every]))
    units = left / np.linalg.norm(left, axis=1, keepdims=True)
    assert len(found) == len(units) > 1000
    np.testing.assert_allclose(found[np.arange(len(found))], units, atol=1e-12)
    np.testing.assert_allclose(found.loads(z), z @ units.T, atol=1e-12)


@pytest.mark.parametrize("told", ["by a column", "by nothing"])
def test_sessions_are_parted_where_two_levels_explain_most(told, tmp_path):
    """Against trying every way."""
    rng = np.random.default_rng(8)
    data = read_drops(write_drops(tmp_path))
    n = len(data.drop)
    left = rng.standard_normal((n, 2)) + (np.arange(n) >= 17)[:, None]
    left[rng.random((n, 2)) < 0.2] = np.nan
    label = np.arange(n)
    if told == "by a column":
        label = np.arange(n) // 8
        data = replace(data, session=tuple(f"day {k}" for k in label))
    ways = [label >= k for k in range(1, label.max() + 1)]
    if told == "by a column":
        ways += [label == k for k in range(1, label.max())]
    ways = [way for way in ways if 4 <= way.sum() <= n - 4]

    def gain(way):
        sides = (np.clip(left[side], -5, 5) for side in (way, ~way))
        return sum(np.sum(np.nansum(s, axis=0) ** 2 / np.isfinite(s).sum(axis=0)) for s in sides)

    found, count, (first, last) = sessions(data, left)
    assert count == len(ways)
    assert gain(found > 0) == pytest.approx(max(map(gain, ways)))
    if told == "by nothing":  # its change is at drop 18, which has number 18
        assert first <= data.drop[np.argmax(found)] <= last
        assert first <= 18 <= last


def test_two_states_are_weighed_as_their_likelihood_says():
    rng = np.random.default_rng(6)
    z, pattern = rng.standard_normal((3, 50)), rng.uniform(0.5, 1.5, 50)
    z[1] += 4.0 * pattern * (rng.random(50) < 0.3)

    def log(share, shift):
        off = z + share * shift * pattern
        one = np.log1p(-share) - 0.5 * off**2
        return np.logaddexp(one, np.log(share) - 0.5 * (off - shift * pattern) ** 2).sum(axis=1)

    both = [log(share, shift) for share, shift in itertools.product(STATE_SHARES, STATE_SHIFTS)]
    wide = np.sum(z**2, axis=1)[:, None] / STATE_SPREADS**2
    single = np.max(-0.5 * wide - 50 * np.log(STATE_SPREADS), axis=1)
    assert _two_states(z, [pattern]) == pytest.approx(np.max(both, axis=0) - single, abs=1e-3)
