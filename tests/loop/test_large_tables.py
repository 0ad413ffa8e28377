"""Thousands of drops: the short ways that are taken for them give what the long ones give."""

from __future__ import annotations

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from made_drops import write_drops

from bristle.studies.data.datasets import read_drops
from bristle.studies.loop.adequacy import STATE_SHARES, STATE_SHIFTS, STATE_SPREADS, _two_states
from bristle.studies.loop.fit import BOX_PRECISION
from bristle.studies.loop.kinds.drops.problem import drops_problem, experiments
from bristle.studies.loop.responses.sessions import Partings
from bristle.studies.loop.sample import ENOUGH, sample
from bristle.studies.loop.search import chosen, fit_baseline
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
def test_sessions_are_parted_where_a_refit_gains_most(told):
    """Against least squares in every way."""
    rng = np.random.default_rng(8)
    n = 40
    label = np.arange(n) // 8 if told == "by a column" else np.zeros(n, dtype=int)
    drop = np.repeat(np.arange(n), 2)[rng.random(2 * n) > 0.2]
    slope, free = rng.uniform(0.5, 1.5, drop.size), rng.standard_normal((drop.size, 2))
    left = rng.standard_normal(drop.size) + (drop >= 17) * slope
    partings = Partings(1.0 + np.arange(n), label)
    beside = SimpleNamespace(mean=0.0, spread=np.zeros(drop.size), mean_slopes=free)
    found = partings.gains(SimpleNamespace(values=left), beside, drop, slope)
    start = label if told == "by a column" else np.arange(n)
    ways = [start >= k for k in range(1, start.max() + 1)]
    if told == "by a column":
        ways += [start == k for k in range(1, start.max())]
    ways = [way for way in ways if 4 <= way.sum() <= n - 4]

    def misfit(*steps):
        rows = np.vstack([np.column_stack([free, *steps]), np.zeros((2, 2 + len(steps)))])
        rows[-2:, :2] = np.sqrt(BOX_PRECISION) * np.eye(2)
        values = np.append(np.clip(left, -5, 5), [0.0, 0.0])
        return np.sum((values - rows @ np.linalg.lstsq(rows, values)[0]) ** 2)

    gains = [0.5 * (misfit() - misfit(slope * way[drop])) for way in ways]
    np.testing.assert_allclose(found, gains, rtol=1e-9, atol=1e-9)
    parted = partings.parted(found)
    np.testing.assert_array_equal(parted.second, ways[int(np.argmax(gains))])
    if told == "by nothing":  # its change is at the drop numbered 18
        assert parted.near[0] <= 18 <= parted.near[1]


def test_a_session_is_found_beside_wear_that_hides_it(many):
    """Wear of one sense and a session of the other all but cancel. Without the wear the second
    session seems to begin elsewhere."""
    one = replace(many.baseline.drops, whole=None).of(np.arange(48))
    label = np.zeros(48, dtype=int)
    drops = replace(one, whole=None, partings=Partings(1.0 + np.arange(48), label), session=0.0)
    rng = np.random.default_rng(2)
    errors = many.baseline.errors.only(np.arange(48))

    def model(*effects):
        return replace(many.baseline, drops=drops, errors=errors, effects=effects)

    second = replace(drops, session=(np.arange(48) >= 20).astype(float))
    true = replace(model("wear", "session"), drops=second)
    values = true.predict(np.array([2e6, 6.0, -0.4]))[0] + rng.standard_normal(48)
    problem = replace(
        many,
        values=values,
        **{name: getattr(many, name)[:48] for name in ("scale", "quantity", "group")},
        covariates={name: x[:48] for name, x in many.covariates.items()},
        baseline=model(),
    )
    data = sample(problem, problem.groups)
    worn = fit_baseline(data, model("wear"))
    plain = fit_baseline(data, model())
    both = chosen(data, worn, model("wear", "session"))
    assert both.drops.partings.near[0] <= 21 <= both.drops.partings.near[1]
    proposed = experiments(drops, {0: 1e-4}, lambda drops, *_: replace(both, drops=drops))[0]
    np.testing.assert_array_equal(proposed.models(both).drops.session, both.drops.session)
    alone = chosen(data, plain, model("session"))
    assert not alone.drops.partings.near[0] <= 21 <= alone.drops.partings.near[1]


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
