"""Is the loop's statistical core calibrated, and does it find what is in a toy problem?"""

import json
from dataclasses import replace

import loop_rates
import loop_toys as toys
import numpy as np
import pytest
from scipy import stats

from bristle.studies.loop.attribute import classes
from bristle.studies.loop.detect import detect, kept_noises, refit, shared_noise, simulate
from bristle.studies.loop.family import corrected, family, p_values
from bristle.studies.loop.finding import Finding, Verdict
from bristle.studies.loop.fit import fit, settle, to_box, to_theta
from bristle.studies.loop.heldout import split
from bristle.studies.loop.ladder import ladder
from bristle.studies.loop.noise import log_density
from bristle.studies.loop.posterior import posterior
from bristle.studies.loop.problem import Problem
from bristle.studies.loop.run import find, pieces
from bristle.studies.loop.sample import Sample, sample

pytestmark = pytest.mark.serial


def whole(problem: Problem) -> Sample:
    return sample(problem, np.unique(problem.group))


def started(problem: Problem, data: Sample):
    return settle(data, problem.baseline, np.array([[0.5], [0.2], [0.8]]))


def test_noise_densities_integrate_to_one():
    x = np.arange(log_density().shape[1]) * 0.01
    mass = 2 * np.trapezoid(np.exp(log_density()), x, axis=1)
    # Beyond sixty core scales Student's t with three degrees keeps 1e-5.
    np.testing.assert_allclose(mass, 1.0, atol=3e-5)


def test_likelihood_of_plain_noise_is_the_normal_density():
    problem, amounts = toys.problem(0)
    data = whole(problem)
    theta = np.array([amounts["kn"]])
    predicted = data.predict(problem.baseline, theta)
    zero = np.zeros(1, dtype=np.int64)
    found = data.log_likelihood(data.values[None], predicted[None], np.ones(1), (zero, zero, zero))
    exact = stats.norm.logpdf(data.values - predicted[0]).sum()
    # The table is linear between steps of 0.01: each row errs by less than 0.01² / 8.
    assert found[0] == pytest.approx(exact, abs=data.values.size * 1.3e-5 + 1e-9)


def test_likelihood_of_scatter_is_the_joint_normal_density():
    problem, amounts = toys.problem(1, {"slope": 6.0})
    data = whole(problem)
    model = next(m for m in problem.candidates if m.effects == ("slope",))
    theta = np.array([amounts["kn"], 0.6])
    predicted = data.predict(model, theta)
    weights = np.asarray(model.weights)
    zero = np.zeros(1, dtype=np.int64)
    found = data.log_likelihood(data.values[None], predicted[None], weights, (zero, zero, zero))
    mean = weights @ predicted
    part = (predicted - mean) * np.sqrt(weights)[:, None]
    same = data.group[:, None] == data.group[None]
    cov = part.T @ part * same + np.eye(mean.size)
    exact = stats.multivariate_normal.logpdf(data.values, mean, cov)
    assert found[0] == pytest.approx(exact, abs=0.3)


def test_parameters_survive_the_unit_box():
    problem, _ = toys.problem(0)
    several = problem.candidates[1].parameters
    u = np.array([[0.3, 0.9], [0.0, 1.0]])
    back = [
        [to_box(p, v) for p, v in zip(several, row, strict=True)] for row in to_theta(several, u)
    ]
    np.testing.assert_allclose(back, u, atol=1e-12)


def test_fit_agrees_with_scipy():
    from scipy.optimize import least_squares

    problem, _ = toys.problem(3, {"plastic": 9.0})
    data = whole(problem)
    model = next(m for m in problem.candidates if m.effects == ("plastic",))
    found = fit(data, model, np.array([[0.5, 0.01], [0.4, 0.1]]), noise=0)
    exact = least_squares(
        lambda t: data.predict(model, t)[0] - data.values,
        [1.0, 1.0],
        x_scale=[0.01, 1.0],
        xtol=1e-14,
    )
    np.testing.assert_allclose(found.theta, exact.x, rtol=2e-3)
    # Fisher information against the Jacobian of the independent solver.
    jacobian = exact.jac * np.array([exact.x[0] * np.log(400), 200.0])
    np.testing.assert_allclose(found.information, jacobian.T @ jacobian, rtol=2e-3)


def test_directions_that_data_do_not_see_are_named():
    problem, _ = toys.problem(0)
    alone = replace(problem.candidates[3], parts=((np.zeros(problem.values.size), False),))
    data = whole(problem)
    found = fit(data, alone, np.array([[0.5, 0.5]]), noise=0)
    assert found.unseen == ("clock",)


def test_size_of_a_ladder_is_the_projected_norm():
    problem, amounts = toys.problem(5, {"adhesion": 8.0})
    data = whole(problem)
    base, _ = started(problem, data)
    model = next(m for m in problem.candidates if m.effects == ("adhesion",))
    rungs = ladder(data, base, model)
    d = np.interp(amounts["adhesion"], rungs.u[:, 1] * 200.0, rungs.d)
    assert d == pytest.approx(8.0, rel=0.02)


def test_held_out_groups_are_a_quarter_at_every_height():
    problem, _ = toys.problem(0)
    fitted, held = split(problem, seed=4)
    assert held.size == 12
    assert not set(fitted) & set(held)
    height = problem.covariates["height"]
    counts = [
        np.unique(problem.group[np.isin(problem.group, held) & (height == h)]).size
        for h in np.unique(height)
    ]
    assert min(counts) >= 1
    again = split(problem, seed=4)
    np.testing.assert_array_equal(held, again[1])
    assert not np.array_equal(held, split(problem, seed=5)[1])


def test_smallest_p_value_is_corrected_for_all_tests():
    rng = np.random.default_rng(0)
    simulated = rng.chisquare(1, (499, 30))
    found = []
    for _ in range(300):
        single, sets = p_values(rng.chisquare(1, 30), simulated)
        found.append(corrected(single, sets)[0])
    assert stats.kstest(found, "uniform").pvalue > 0.01


def test_detection_is_uniform_where_nothing_is_missing():
    """Values drawn from one fitted baseline: every p-value from 0 to 1 is as likely."""
    problem, _ = toys.problem(2, drops=24)
    data = whole(problem)
    base, _ = started(problem, data)
    few = [m for m in problem.candidates if m.effects[0] in ("drag", "wear", "plastic", "adhesion")]
    ladders = [ladder(data, base, m) for m in few]
    shares = np.zeros(data.noises.scale.size)
    shares[0] = 1.0
    rng = np.random.default_rng(1)
    found = []
    for _ in range(200):
        values = simulate(data, base, shares, kept_noises(data, shares), 1, rng)[0]
        # Only the values change: the tangent and the ladders are those of the truth.
        each = detect(replace(data, values=values), base, shares, ladders, rng, 0.05, sets=199)
        found.append(each.p_value)
    assert stats.kstest(found, "uniform").pvalue > 0.01


def test_effects_that_look_alike_are_one_class():
    problem, _ = toys.problem(0)
    data = whole(problem)
    base, _ = started(problem, data)
    found = classes(data, base, [ladder(data, base, m) for m in problem.candidates])
    assert any({"dashpot", "rayleigh"} <= set(c) for c in found)
    # Of opposite sense, or another way with height: not alike.
    assert not any({"dashpot", "wear"} <= set(c) or {"slope", "phases"} <= set(c) for c in found)


def test_heavy_tails_and_correlation_are_recognised():
    problem, _ = toys.problem(4, how="ar1", drops=96)
    data = whole(problem)
    base, _ = started(problem, data)
    shares, _ = shared_noise(data, base, [])
    assert shares @ (data.noises.correlation > 0) > 0.9
    problem, _ = toys.problem(4, how="outliers", drops=96)
    data = whole(problem)
    base, _ = started(problem, data)
    shares, _ = shared_noise(data, base, [])
    assert shares @ (data.noises.shape > 0) > 0.9


def test_refit_leaves_nothing_along_the_tangent():
    problem, _ = toys.problem(0)
    data = whole(problem)
    base, _ = started(problem, data)
    rng = np.random.default_rng(0)
    found = refit(data, rng.standard_normal((5, data.values.size)), base.mean_slopes, np.array([0]))
    np.testing.assert_allclose(found.residual @ base.mean_slopes, 0.0, atol=1e-6)
    assert family(data)(found.standard).shape == (5, len(family(data).names))


def test_posterior_intervals_match_the_linear_theory():
    problem, _ = toys.problem(6, {"wear": 10.0})
    data = whole(problem)
    base, shares = started(problem, data)
    model = next(m for m in problem.candidates if m.effects == ("wear",))
    fitted, shares = settle(data, model, np.array([[0.5, 0.5]]))
    alone = np.zeros_like(shares)
    alone[0] = 1.0
    found = posterior(data, base, fitted, alone, np.random.default_rng(0))
    low, high = found.interval(1)
    sd = 400 * np.sqrt(np.linalg.inv(fitted.information)[1, 1])
    assert (high - low) / (2 * 1.645 * sd) == pytest.approx(1.0, abs=0.15)


@pytest.fixture(scope="module")
def named() -> Finding:
    return find(toys.problem(1, {"plastic": 12.0})[0], seed=1)


def test_one_effect_stands_alone(named):
    assert named.verdict is Verdict.EFFECT
    assert named.effects == ("plastic",)
    assert len(named.held_out.groups) == 12


@pytest.mark.parametrize("truth", [{}, {"plastic": 12.0}])
def test_all_of_the_work_is_told_of_as_it_gets_done(truth):
    problem, _ = toys.problem(1, truth)
    told: list[int] = []
    find(problem, seed=1, advance=lambda count=1: told.append(count))
    assert sum(told) == pieces(problem)
    assert len(told) > len(problem.candidates) + 2


def test_the_same_seed_gives_the_same_finding(named):
    again = find(toys.problem(1, {"plastic": 12.0})[0], seed=1)
    assert json.dumps(again.verdict_json()) == json.dumps(named.verdict_json())


def test_held_out_values_take_no_part(named):
    """Whatever the held-out drops measured, what is fitted and chosen stays to the bit."""
    problem, _ = toys.problem(1, {"plastic": 12.0})
    held = np.isin(problem.group, named.held_out.groups)
    spoiled = replace(problem, values=np.where(held, 1e3, problem.values))
    found = find(spoiled, seed=1)
    assert found.parameters == named.parameters
    assert (found.verdict, found.p_value) == (named.verdict, named.p_value)


def test_error_on_held_out_drops_falls():
    held = find(toys.problem(5, {"adhesion": 14.0})[0], seed=5).held_out
    assert held.rms_after < held.rms_before
    assert 0 < held.reduction_low < held.reduction_high < 1


def test_effects_alike_are_ambiguous_and_an_experiment_is_named():
    found = find(toys.problem(1, {"rayleigh": 12.0})[0], seed=1)
    assert found.verdict is Verdict.AMBIGUOUS
    assert {"rayleigh", "dashpot"} <= set(found.effects)
    assert sum(found.weights.values()) == pytest.approx(1.0)
    assert found.next_experiment is not None
    assert found.next_experiment.expected_gain > 0


def test_an_effect_that_nobody_listed_is_unknown():
    found = find(toys.problem(3, unlisted=("bump", 16.0))[0], seed=3)
    assert found.verdict is Verdict.UNKNOWN
    assert found.effects == ()


def test_two_effects_are_found_together():
    found = find(toys.problem(0, {"offset": 14.0, "wear": 14.0})[0], seed=0)
    assert set(found.effects) >= {"offset", "wear"}
    assert ("offset", "wear") in found.together or ("wear", "offset") in found.together


def test_scatter_is_told_from_noise():
    found = find(toys.problem(2, {"slope": 14.0})[0], seed=2)
    assert found.effects[:1] == ("slope",)


@pytest.mark.parametrize("name", ["session", "alternation"])
def test_a_step_and_an_alternation_in_order_are_unknown(name):
    """No random effect, and no two listed ones, may swallow them."""
    verdicts = [find(toys.problem(s, unlisted=(name, 12.0))[0], seed=s).verdict for s in range(3)]
    assert verdicts.count(Verdict.UNKNOWN) >= 2


def test_scatter_beyond_the_declared_sigma_is_missing_something():
    found = find(toys.problem(2, how="double", quantities=3)[0], seed=2)
    assert found.verdict is Verdict.UNKNOWN
    assert found.noise["scale"] <= 1.1
    free = find(toys.problem(2, how="double", declared=False)[0], seed=2)
    assert free.verdict is Verdict.ADEQUATE


@pytest.mark.parametrize("how", ["ar1", "t3 scaled", "outliers"])
def test_wrong_noise_is_no_effect(how):
    verdicts = [find(toys.problem(s, how=how)[0], seed=s).verdict for s in range(4)]
    assert verdicts.count(Verdict.ADEQUATE) >= 3


def within(rate: float, count: int, low: float, high: float) -> bool:
    """Whether an exact 99 % interval of a rate meets the range asked for."""
    k = round(rate * count)
    interval = stats.binomtest(k, count).proportion_ci(0.99)
    return interval.high >= low and interval.low <= high


@pytest.mark.campaign
@pytest.mark.timeout(7200)
def test_rates_over_many_datasets():
    count = 200
    rates = loop_rates.table(count, list(loop_rates.ROWS))
    for row in ("clean", "clean, 3 quantities", "clean, 1 quantity", "clean, sigma free"):
        assert within(rates[row]["adequate"], count, 0.95, 1.0), row
    for row in ("clean, ar1", "clean, t3 scaled", "clean, outliers"):
        assert within(rates[row]["adequate"], count, 0.92, 1.0), row
    for row in ("single d=8", "single d=8, 3 quantities"):
        assert within(rates[row]["in set"], count, 0.95, 1.0), row
        assert within(rates[row]["first"], count, 0.9, 1.0), row
        assert within(rates[row]["unknown"], count, 0.0, 0.05), row
        assert rates[row]["recovered"] >= 0.8
    assert within(rates["unlisted d=8"]["unknown"], count, 0.85, 1.0)
    assert within(rates["unlisted d=16"]["unknown"], count, 0.95, 1.0)
    assert within(rates["pair d=8 + 8"]["classes in set"], count, 0.7, 1.0)
