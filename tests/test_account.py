"""Do the accounts of the 65 % fit what they should, and does nothing depend on chance or ranks?"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from commands import mpirun
from mpi4py import MPI

from bristle.solver import paper
from bristle.solver.errors import InputError
from bristle.studies.account import models as models
from bristle.studies.account.design import (
    INSTRUMENTS,
    Spread,
    Trial,
    bending_strain,
    drops_needed,
    needed,
    readings,
    spread,
)
from bristle.studies.account.film import (
    PUBLISHED,
    Film,
    moments,
    planned_heights_m,
    r2_definitions,
    through_origin,
    vector,
)
from bristle.studies.account.findings import Plan, compute
from bristle.studies.account.fit import Drawn, Effort, films, fit, p_value, predict
from bristle.studies.account.library import (
    Conditions,
    Library,
    bristle_of,
    drops_under,
    fill,
)

serial = pytest.mark.serial
SELF = MPI.COMM_SELF
EFFORT = Effort(coarse=9, fine=13, few=100, sets=250, replicas=300)
KNS = tuple(float(kn) for kn in np.geomspace(1e4, 1e9, 13))
DASHPOTS = tuple(float(c) for c in np.geomspace(0.5, 200.0, 9))


def small() -> dict[str, tuple[models.Account, tuple[float, ...]]]:
    """Every account with a coarse table, and parameters to be found again."""
    few = {"leans_deg": (0.0, 1.0, 2.0, 3.0, 4.5, 6.0, 8.0), "sides_deg": (0.0, 30.0, 60.0, 90.0)}
    strong = replace(models.UPRIGHT, kn_N_m=KNS)
    return {
        "A": (models.OneStiffness(grid=strong), (2e6,)),
        "A′": (models.ScatteredStiffness(grid=strong), (1.5e6, 0.6)),
        "B": (models.Leaning(**few), (2.5, 0.02)),
        "C": (models.DampedContact(), (15.0, 0.5)),
        "C′": (models.ScatteredDashpot(), (20.0, 0.5)),
        "C″": (models.DampedLeaning(), (20.0, 3.0)),
        "D": (models.Leaning("D", "strong", paper.BETA_S, **few), (3.5, 0.08)),
    }


@cache
def library(key: str) -> Library:
    grid = small()[key][0].grid
    return fill([grid], SELF)[grid]


@serial
@pytest.mark.parametrize("key", ["A", "A′", "B", "C", "C′", "C″", "D"])
def test_a_fit_finds_the_parameters_behind_simulated_summaries(key):
    account, truth = small()[key]
    drawn = Drawn.of(40, seed=99)
    simulated = vector(moments(*films(account, truth, library(key), Film(), drawn)))
    # the middle of many films, so that a miss is the fit's and not the luck of 26 drops
    found = fit(account, library(key), simulated.mean(axis=0), effort=EFFORT)
    for value, (low, high), parameter in zip(
        truth, found.interval, account.parameters, strict=True
    ):
        assert low <= value <= high, parameter.name
        assert parameter.low <= low < high <= parameter.high
    assert found.p > 0.2
    assert found.chi2 <= found.chi2_declared + 1.0


@serial
def test_intervals_hold_the_truth_about_as_often_as_they_say():
    account, truth = small()["A′"]
    drawn = Drawn.of(30, seed=5)
    seen = vector(moments(*films(account, truth, library("A′"), Film(), drawn)))
    inside = 0
    for each in seen:
        (low, high), _ = fit(account, library("A′"), each, effort=EFFORT).interval
        inside += low <= truth[0] <= high
    assert inside >= 22  # of 30 at 90 %: fewer has a probability below 0.01


@serial
def test_p_values_are_even_where_the_account_is_true():
    account, truth = small()["A′"]

    def vectors(seed: int) -> np.ndarray:
        return vector(moments(*films(account, truth, library("A′"), Film(), Drawn.of(400, seed))))

    expected = predict(vectors(1))
    others = expected.misfit(vectors(2))
    p = np.array([p_value(others, float(d)) for d in expected.misfit(vectors(3))])
    assert abs(p.mean() - 0.5) < 0.06
    assert np.mean(p < 0.1) == pytest.approx(0.1, abs=0.06)
    assert p.min() > 0.0


def test_p_value_counts_what_is_at_least_as_far_out():
    assert p_value(np.array([1.0, 2.0, 3.0]), 2.0) == 0.75
    assert p_value(np.array([1.0, 2.0, 3.0]), 9.0) == 0.25


def test_the_film_reads_too_low_by_the_closed_form():
    film, n = Film(sigma_m=0.0), 200_000
    chance = np.random.default_rng(0).standard_normal((3, n))
    y0, y1 = film.read(np.full(n, 0.05), np.full(n, 0.03), chance)
    low = 0.03 - y1
    period = 1.0 / paper.FRAMES_PER_S
    assert np.all(y0 == 0.05)
    assert low.max() <= 9.8 * period**2 / 8.0
    assert film.mean_low_m == pytest.approx(9.8 * period**2 / 24.0)
    assert low.mean() == pytest.approx(film.mean_low_m, rel=0.01)
    assert low.std() == pytest.approx(film.spread_low_m, rel=0.01)


def test_reading_errors_add_to_both_heights():
    film, n = Film(), 100_000
    chance = np.random.default_rng(1).standard_normal((3, n))
    y0, y1 = film.read(np.full(n, 0.05), np.full(n, 0.03), chance)
    assert y0.std() == pytest.approx(0.5e-3, rel=0.02)
    assert y1.std() == pytest.approx(math.hypot(film.spread_low_m, 0.5e-3), rel=0.02)
    with pytest.raises(InputError):
        Film(sigma_m=-1.0)


def test_without_film_a_deterministic_account_has_no_spread():
    account, truth = small()["A"]
    still = Film(frames_per_s=1e9, sigma_m=0.0)
    y0, y1 = films(account, truth, library("A"), still, Drawn.of(20))
    of = moments(y0, y1)
    assert np.all(of.std < 1e-9)
    assert of.mean == pytest.approx(of.slope)
    assert np.all(of.r2_linear > 1.0 - 1e-12)


def test_a_deterministic_account_has_the_films_spread_alone():
    account, truth = small()["A"]
    film = Film()
    y0, y1 = films(account, truth, library("A"), film, Drawn.of(400))
    ratio = float(library("A").at(Conditions.of(0.05, kn_N_m=truth[0])))
    heights = planned_heights_m()
    reading = film.sigma_m**2 * (1.0 + ratio**2)
    each = (film.spread_low_m**2 + reading) / heights**2
    between = np.var(film.mean_low_m / heights, ddof=1)
    assert np.mean(moments(y0, y1).std ** 2) == pytest.approx(each.mean() + between, rel=0.05)


@pytest.mark.parametrize("key", ["A′", "C", "C′", "C″", "B", "D"])
def test_accounts_without_their_scatter_treat_all_drops_alike(key):
    account, truth = small()[key]
    still = [
        0.0 if p.name.startswith(("spread", "lean")) else t
        for p, t in zip(account.parameters, truth, strict=True)
    ]
    drawn = Drawn.of(5)
    at = account.conditions(still, drawn.heights_m, drawn.chance)
    assert at.height_m.shape == (5, paper.N_DROPS)
    for name in ("lean_deg", "mu", "kn_N_m", "damping_N_s_m"):
        assert np.ptp(getattr(at, name)) <= 1e-9 * np.max(getattr(at, name))


def test_heights_are_spread_as_evenly_as_can_be():
    values, counts = np.unique(planned_heights_m(26), return_counts=True)
    assert values == pytest.approx(paper.HEIGHTS_M)
    assert list(counts) == [5, 5, 6, 5, 5]
    assert len(planned_heights_m(3)) == 3


def test_curves_through_the_origin_are_least_squares():
    random = np.random.default_rng(2)
    x = random.uniform(0.01, 0.05, (4, 26))
    y = 0.65 * x + 3.0 * x**2 + 1e-3 * random.standard_normal(x.shape)
    linear, quadratic = through_origin(x, y)
    for i in range(4):
        columns = np.stack([x[i], x[i] ** 2], axis=-1)
        assert quadratic[i] == pytest.approx(np.linalg.lstsq(columns, y[i], rcond=None)[0])
        assert linear[i] == pytest.approx(np.linalg.lstsq(columns[:, :1], y[i], rcond=None)[0])


def test_r2_is_about_the_mean_and_the_quadratic_never_loses():
    x = np.array([1.0, 2.0, 3.0])
    of = moments(x, np.array([1.0, 2.0, 4.0]))
    slope = 17.0 / 14.0
    left = (1 - slope) ** 2 + (2 - 2 * slope) ** 2 + (4 - 3 * slope) ** 2
    assert of.slope == pytest.approx(slope)
    assert of.r2_linear == pytest.approx(1.0 - left / (14.0 / 3.0))
    assert of.r2_quadratic >= of.r2_linear
    assert of.share == pytest.approx(2.0 / 3.0)  # the last one lies above the band
    assert np.all(np.isfinite(vector(PUBLISHED)))


def test_the_published_pair_is_about_the_mean_not_about_zero():
    for each in r2_definitions(Film(), sets=1500):
        if each.about == "zero":
            assert each.tail < 0.01
            assert each.low > paper.R2_LINEAR
        else:
            assert each.tail > 0.1
            assert each.gain_tail > 0.1


def test_tables_are_exact_at_their_points_and_near_between():
    account, _ = small()["B"]
    table = library("B")
    at = account.grid.conditions()
    assert table.mended == 0
    assert table.at(at)[at.lean_deg > 0.0] == pytest.approx(table.ratio[at.lean_deg > 0.0])
    random = np.random.default_rng(3)
    at = account.conditions(
        (2.5, 0.03), random.choice(paper.HEIGHTS_M, 60), random.normal(size=(2, 60))
    )
    away = table.at(at) - drops_under(at, bristle_of(account.beta_s)).rebound_height_m / at.height_m
    assert np.sqrt(np.mean(away**2)) < 0.03
    assert abs(away.mean()) < 0.015


def test_a_drop_that_cannot_be_used_takes_its_neighbours_value():
    grid = models.Grid(0.0, lean_deg=(0.0, 1.0, 2.0))
    ratio = np.array([0.9, 0.8, np.nan])
    table = Library(grid, ratio, ratio)
    assert table.mended == 1
    assert table.at(Conditions.of(0.05, lean_deg=2.0)) == pytest.approx(0.8)


def test_leans_combine_and_are_held():
    size, side = models.lean_of(np.array([3.0, 0.0, -2.0, 30.0]), np.array([0.0, 4.0, 2.0, 0.0]))
    assert size == pytest.approx([3.0, 4.0, 2.828, models.MOST_LEAN_DEG], abs=2e-3)
    assert side == pytest.approx([0.0, 90.0, 45.0, 0.0])
    tilt, wide = Conditions.of(0.05, lean_deg=size[2], side_deg=side[2]).tilts_deg
    assert (tilt, wide) == (pytest.approx(2.0, abs=1e-9), pytest.approx(2.0, abs=1e-9))


def test_the_declared_dashpot_keeps_65_percent_of_a_rigid_bristle():
    c = models.dashpot_for(paper.RATIO_MEAN)
    zeta = c / (2.0 * math.sqrt(paper.KN_CHOSEN_N_M * paper.MASS_KG))
    kept = math.exp(-2.0 * math.pi * zeta / math.sqrt(1.0 - zeta**2))
    assert kept == pytest.approx(paper.RATIO_MEAN)


def test_a_dashpot_as_hard_to_move_as_the_bristles_waves_takes_most():
    bristle = bristle_of(models.MEASURED_BETA_S)
    waves = bristle.mass_kg / bristle.length_m * bristle.material.bar_speed_m_s
    dashpots = waves * np.array([0.02, 0.2, 1.0, 5.0, 50.0])
    at = Conditions.of(0.05, kn_N_m=1e5, damping_N_s_m=dashpots)
    ratio = drops_under(at, bristle).rebound_height_m / 0.05
    assert waves == pytest.approx(42.0, abs=0.5)
    assert np.argmin(ratio) == 2
    assert ratio[0] > 0.8
    assert ratio[-1] > 0.7


def test_drops_needed_is_the_normal_approximation():
    one, two = Spread(0.0, 1.0, 0.0), Spread(1.0, 1.0, 0.0)
    exact = (2.0 * 1.6449) ** 2
    assert exact <= drops_needed(one, two) <= exact * 1.03 + 1.0
    assert drops_needed(one, two._replace(between=0.7)) == math.inf
    assert drops_needed(one, two._replace(mean=10.0)) == 1.0
    assert drops_needed(one, one) == math.inf


def test_spread_parts_drops_from_parameters():
    random = np.random.default_rng(4)
    values = 2.0 * random.standard_normal((400, 1)) + random.standard_normal((400, 50))
    values[3, 7] = np.nan
    found = spread(values)
    assert found.within == pytest.approx(1.0, rel=0.03)
    assert found.between == pytest.approx(2.0, rel=0.1)


def test_an_upright_bristle_has_no_bending_ring_and_a_leaning_one_does():
    at = Conditions.of(0.05, lean_deg=np.array([0.0, 3.0]), mu=0.0)
    bristle = bristle_of(1e-8)
    strain = bending_strain(drops_under(at, bristle), at, 1e-8, paper.LENGTH_M)
    assert strain[0] == 0.0
    # all of the fall in bending is the most there can be
    fall = bristle.mass_kg * 9.8 * 0.05
    stiffness = paper.YOUNGS_PA * bristle.section.second_moment_x_m4 * paper.LENGTH_M
    most = 1e6 * 0.5 * paper.THICKNESS_M * math.sqrt(fall / stiffness)
    assert 0.2 * most < strain[1] < most


@serial
def test_the_decay_of_waves_tells_strong_from_weak_damping_at_once():
    fits = [fit(small()[key][0], library(key), effort=EFFORT) for key in ("A′", "B")]
    values = readings(fits, SELF, trial=Trial(4, 6))
    rows = needed(values, ("A′", "B"))
    assert {each.instrument.name for each in rows} == {each.name for each in INSTRUMENTS}
    assert [each.drops for each in rows] == sorted(each.drops for each in rows)
    decay = next(each for each in rows if each.instrument.name == "decay of axial waves")
    assert decay.drops == 1.0
    assert decay.difference == pytest.approx(
        math.log10(models.MEASURED_BETA_S / paper.BETA_S), abs=0.1
    )


def test_nothing_depends_on_ranks_or_chunks():
    accounts = tuple(small()[key][0] for key in ("A′", "C′"))
    tiny = Effort(5, 5, 40, 60, 60)
    plan = Plan(accounts, effort=tiny, rough=tiny, trial=Trial(2, 3), variants=())
    one = compute(plan, SELF)
    other = compute(replace(plan, chunk=7), MPI.COMM_WORLD)
    for grid, table in one.libraries.items():
        assert np.array_equal(table.ratio, other.libraries[grid].ratio)
    for a, b in zip(one.fits, other.fits, strict=True):
        assert a.best == b.best
        assert a.interval == b.interval
        assert a.p == b.p
    assert one.needed.keys() == other.needed.keys()
    for pair, rows in one.needed.items():
        assert [r.drops for r in rows] == [r.drops for r in other.needed[pair]]


@serial
def test_two_ranks_give_what_one_gives():
    done = mpirun(
        2,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        __file__,
        "-k",
        "ranks_or_chunks",
        timeout_s=400.0,
    )
    assert done.returncode == 0, done.stdout + done.stderr
