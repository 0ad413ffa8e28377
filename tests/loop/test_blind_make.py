"""The blind benchmark's datasets have the size, noise and files they say, its table the rates."""

import math
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from blind.body import Body
from blind.drops import LISTED, Truth, bounce, seen, speed_down
from blind.films import (
    AT_RELEASE,
    HELD,
    MID_FALL,
    fall_time,
    fallen,
    film,
    flight,
    rise_time,
)
from blind.make import ROWS, _turn, beside, make
from blind.noise import ROUNDED, UNKNOWN
from blind.read import Plan
from blind.shapes import FAMILIES, Drops, impossible, unlisted
from blind.size import Gauge, plain, size, whitened
from blind.table import covered, exact, explained, table
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from scipy.stats import binomtest

from bristle.solver.effects.library import EFFECTS
from bristle.studies.data.datasets import read_drops
from bristle.studies.loop.kinds.tracks.record import read_tracks

pytestmark = pytest.mark.serial
HEIGHTS = np.linspace(0.01, 0.05, 12)
GAUGE = Gauge(Body(), (0,), 2.5e-4, 1e-6, 0.5)
NO_CHANCE = np.zeros((12, 2))


def test_effects_bear_the_programs_names_parameters_and_bounds():
    """Leans are drawn within less; a film or a drop carries all but what a bar alone shows."""
    assert set(LISTED) == {name for name, each in EFFECTS.items() if "drops" in each.kinds}
    for name, mine in LISTED.items():
        parameter, *_ = EFFECTS[name].parameters
        assert mine.parameter == parameter.name
        assert parameter.low <= mine.low < mine.high <= parameter.high
        assert mine.absent == parameter.null


@pytest.mark.parametrize("row", ROWS)
def test_the_same_seed_makes_the_same_dataset_which_the_program_reads(row, tmp_path):
    made, again, other = make(3, row, 1), make(3, row, 1), make(4, row, 1)
    assert made == again
    assert made.table != other.table
    made.write(tmp_path)
    if made.kind == "tracks":
        read = read_tracks(tmp_path)
        assert len(np.unique(read.drop)) == made.n_drops
    else:
        read = read_drops(tmp_path)
        assert len(read.drop) == made.n_drops
        assert (read.contact_time_s is not None) == (1 in made.columns)
        assert (read.peak_force_N is not None) == (2 in made.columns)
    text = made.manifest + made.table
    assert not [name for name in (*LISTED, *FAMILIES) if name in text]


def test_a_misfit_that_kn_absorbs_has_no_size_and_one_it_cannot_has_its_norm():
    data = seen(Truth(kn_N_m=7e5), HEIGHTS, NO_CHANCE)
    assert size(GAUGE, data) < 0.1
    raised = data.copy()
    raised[:, 1] *= 0.9  # another Kn
    assert size(GAUGE, raised) < 0.1
    # beyond the bounds of Kn: more than is dropped from, against all that a soft contact leaves
    raised[:, 1] = 1.2 * HEIGHTS
    best = plain(Body(), 4.0, HEIGHTS)[:, 0]
    sigma = 2.5e-4 * math.hypot(1.0, 1.2)
    assert size(GAUGE, raised) == pytest.approx(np.linalg.norm(raised[:, 1] - best) / sigma)
    # a wave that is square to heights: its own norm
    wave = np.cos(3.0 * HEIGHTS / 0.01)
    ratio = data[:, 1] / HEIGHTS
    wave -= HEIGHTS * (wave @ HEIGHTS) / (HEIGHTS @ HEIGHTS)
    raised[:, 1] = data[:, 1] + 1e-4 * wave
    sigma = 2.5e-4 * math.hypot(1.0, ratio.mean())
    expected = np.linalg.norm(1e-4 * wave) / sigma
    assert size(GAUGE, raised) == pytest.approx(expected, rel=0.02)


def read_back(made):
    """A dataset's files as (drops, 4) in SI and the gauge that they declare."""
    said = tomllib.loads(made.manifest)
    body, sensors = said["body"], said["measurement"]
    names = {
        "youngs_modulus_Pa": "youngs_Pa",
        "poisson_ratio": "poisson",
        "damping_beta_s": "beta_s",
    }
    gauge = Gauge(
        Body(**{names.get(key, key): value for key, value in body.items()}),
        made.columns,
        1e-3 * sensors["sigma_y_mm"],
        sensors.get("sigma_t_s", 1.0),
        sensors.get("sigma_force_N", 1.0),
        said.get("contact", {}).get("kn_N_m"),
    )
    read = np.loadtxt(made.table.splitlines(), delimiter=",", skiprows=1)
    seen = np.zeros((made.n_drops, 4))
    seen[:, [0, *(1 + c for c in made.columns)]] = read[:, 1:]
    return seen * [1e-3, 1e-3, 1e-3, 1.0], gauge


@pytest.mark.parametrize("row", ["clean", "gross", "listed8", "unlisted16"])
def test_what_is_read_misses_an_upright_bristle_by_its_noise_and_by_d(row):
    """χ² of the best fit: as many as there are values, and d² beside; within five deviations."""
    for number in range(4):
        made = make(6, row, number)
        if made.noise != "gaussian":
            continue
        seen, gauge = read_back(made)
        n, d2 = made.n_drops * len(made.columns), made.d**2
        # the error of a height before is carried by slopes, which a misfit has steeper or flatter
        error = 5.0 * math.sqrt(2.0 * n + 4.0 * d2) + 0.05 * d2
        assert size(gauge, seen) ** 2 == pytest.approx(n + d2, abs=error)


def test_the_seed_draws_in_which_order_effects_have_their_turn():
    """A run that stops early would otherwise know the first ones alone."""
    names = tuple(LISTED)
    one, other = ([_turn(names, seed, n) for n in range(len(names))] for seed in (1, 2))
    assert sorted(one) == sorted(other) == sorted(names)
    assert one != other


@pytest.mark.parametrize("row", ["listed16", "unlisted16", "unlisted8"])
def test_rows_hold_the_sizes_they_name(row):
    least, most = ROWS[row].d
    for number in (0, 2, 3):
        assert 0.95 * least <= make(5, row, number).d <= 1.05 * most


@pytest.mark.parametrize("number", range(4))
def test_pairs_hold_two_effects_of_which_neither_does_for_the_other(number):
    """Each is at least of the size that is asked for."""
    made = make(5, "pairs", number)
    assert len(set(made.truth.split(" with "))) == 2
    assert made.d >= ROWS["pairs"].d[0]


def test_what_one_of_two_effects_moves_beside_the_other_is_what_a_refit_of_it_leaves():
    """By least squares over the other's amount and Kn, of what is all but linear: an offset of the
    heights beside wear, in the order of the heights."""
    heights, shares = np.linspace(0.01, 0.05, 24), np.array([1.0, 1.0])
    truth = replace(Truth(), kn_N_m=2e6)
    plan = Plan(truth, GAUGE, heights, np.zeros((24, 2)), False)

    def clear(amounts):
        offset, wear = amounts * [1e-4, 0.01]
        return seen(replace(truth, offset_m=offset, wear_decades=wear), heights, plan.chance)

    data = clear(shares)

    def left(x):
        other = clear(np.array([0.0, x[0]]))
        stiff = plain(truth.body, math.log10(2e6) + 0.1 * (x[1] - 1.0), other[:, 0])
        stiff /= plain(truth.body, math.log10(2e6), other[:, 0])
        other[:, 1:] *= stiff
        return whitened(GAUGE, data, [other - data])[0]

    refit = least_squares(left, [1.0, 1.0], diff_step=1e-3)
    expected = math.sqrt(2.0 * refit.cost)
    assert beside(plan, clear, shares, 0) == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("name", UNKNOWN)
def test_noises_have_the_variance_that_is_declared(name):
    """Over many sets, to five standard errors; the bulk of a contaminated one alone, and a wrong
    sigma is wrong to either side."""
    rng = np.random.default_rng(7)
    sets = [UNKNOWN[name]((40, 4), rng) for _ in range(400)]
    each = np.array([np.mean(one**2) for one in sets])
    if name == "contaminated":
        assert np.median(each) == pytest.approx(1.0, abs=0.8)
        return
    if name == "student":
        # of little freedom, its variance is hardly ever seen
        each = np.sort(each)[:-20]
        assert 0.7 < each.mean() < 1.05
        return
    error = each.std() / math.sqrt(len(each))
    expected = 1.0 + 0.5**2 / 12.0 if name == "misdeclared" else 1.0
    assert each.mean() == pytest.approx(expected, abs=5.0 * error)


def test_rounded_heights_lie_on_marks_and_declare_them():
    made = next(m for m in (make(2, "noise", n) for n in range(60)) if m.noise == ROUNDED)
    y1 = [float(line.split(",")[2]) for line in made.table.splitlines()[1:]]
    assert np.allclose(np.mod(np.array(y1) / 0.5 + 0.25, 1.0), 0.25, atol=1e-6)


@pytest.mark.parametrize("family", FAMILIES)
def test_shapes_differ_from_draw_to_draw_and_move_drops(family):
    rng = np.random.default_rng(3)
    drops = Drops(HEIGHTS, np.sqrt(HEIGHTS))
    drawn = [unlisted(family, drops, HEIGHTS, rng) for _ in range(5)]
    assert all(np.count_nonzero(each) >= 2 for each in drawn)
    assert not any(np.allclose(drawn[0], each) for each in drawn[1:])


def test_impossible_levels_lie_beyond_what_contact_gives():
    rng = np.random.default_rng(3)
    for _ in range(20):
        name, y1 = impossible(HEIGHTS, rng)
        ratio = float((y1 / HEIGHTS)[0])
        assert ratio > 1.0 if "gained" in name else ratio < 0.313


@pytest.mark.parametrize("release", [0.3, -0.3])
def test_a_dragged_fall_and_rise_follow_their_equation(release):
    truth = Truth(cd=100.0, body=replace(Body(), density_kg_m3=80.0))
    drag = 0.5 * 1.204 * 100.0 * truth.body.area_m2 / truth.body.mass_kg

    def rates(t, state):
        return [state[1], 9.8 - drag * state[1] * abs(state[1])]

    def ground(t, state):
        return state[0] - 0.8

    ground.terminal = True
    exact_fall = solve_ivp(rates, (0.0, 3.0), [0.0, release], events=ground, rtol=1e-10, atol=1e-12)
    assert fall_time(truth, 0.8, release) == pytest.approx(exact_fall.t[-1], rel=1e-6)
    assert speed_down(truth, 0.8, release) == pytest.approx(exact_fall.y[1, -1], rel=1e-6)
    assert fallen(truth, exact_fall.t[3], release) == pytest.approx(exact_fall.y[0, 3], rel=1e-6)
    up = solve_ivp(rates, (0.0, 0.2), [0.0, -3.0], rtol=1e-10, atol=1e-12)
    top = math.log1p(drag * 9.0 / 9.8) / (2.0 * drag)
    assert flight(truth, 0.2, 3.0, top) == pytest.approx(-up.y[0, -1], rel=1e-6)
    assert rise_time(truth, 3.0) == pytest.approx(
        math.atan(3.0 * math.sqrt(drag / 9.8)) / math.sqrt(9.8 * drag)
    )


@pytest.mark.parametrize("begins", [HELD, AT_RELEASE, MID_FALL])
def test_a_film_has_no_jumps_and_rises_as_high_as_the_impact_gives(begins):
    truth, fps, rng = Truth(cd=50.0, release_m_s=0.1), 2e4, np.random.default_rng(2)
    times, y = film(truth, 0.1, 0, np.zeros(2), fps, begins, rng)
    fastest = speed_down(truth, 0.1, 0.1)
    assert np.diff(times) == pytest.approx(1.0 / fps)
    assert np.abs(np.diff(y)).max() <= 1.001 * fastest / fps
    top = bounce(truth, fastest, 0, np.zeros(2))[0]
    after = y[np.argmin(y) :]
    assert after.max() == pytest.approx(top, abs=1e-6)
    assert y[0] == pytest.approx(0.1, abs=1e-5) if begins != MID_FALL else y[0] < 0.098
    if begins == HELD:
        assert np.count_nonzero(y == 0.1) > 0.01 * fps - 1


def outcome(**other):
    interval = {"kn_N_m": {"estimate": 2.0, "low": 1.0, "high": 3.0}}
    held = {"groups": list(range(12)), "rms_after": 0.3, "log_score_gain_low": 1.0}
    said = {
        "row": "clean",
        "truth": "nothing",
        "noise": "gaussian",
        "noise_mm": 0.3,
        "moved": 0,
        "columns": [0],
        "true": {"kn_N_m": 2.5},
        "verdict": "adequate",
        "effects": [],
        "classes": [],
        "parameters": interval,
        "held_out": held,
        "rms_sigma": None,
        "wall_s": 1.0,
    }
    return said | other


def line(lines, row, quantity):
    return next(each for each in lines if (each.row, each.quantity) == (row, quantity))


def test_intervals_are_exact():
    for count, of in ((0, 20), (3, 20), (20, 20)):
        found = binomtest(count, of).proportion_ci(0.95, "exact")
        assert exact(count, of) == pytest.approx((found.low, found.high))


def test_what_is_explained_and_what_is_covered():
    named = outcome(verdict="effect", effects=["wear"], truth="waves")
    assert explained(named)
    assert not explained(named | {"verdict": "adequate"})
    assert not explained(named | {"noise_mm": 0.2})
    # another column's rest is asked of all rows
    assert not explained(named | {"moved": 1})
    assert explained(named | {"moved": 1, "rms_sigma": 1.0})
    assert covered(outcome()) == [True]
    assert covered(outcome(true={"kn_N_m": 5.0})) == [False]
    assert covered(outcome(truth="wear", verdict="effect", effects=["adhesion"])) == []


def test_the_table_counts_exact_names_and_marks_what_is_missed():
    wear = {"row": "listed16", "truth": "wear", "verdict": "ambiguous"}
    own = [outcome(**wear, effects=["wear", "adhesion"]) for _ in range(8)]
    own += [outcome(**wear, effects=["adhesion"], classes=[["wear", "adhesion"]])] * 2
    own += [outcome(row="gross", verdict="adequate"), outcome(verdict="unknown"), outcome()]
    lines = table(own)
    assert line(lines, "listed16", "exact name in the set").value == 0.8
    assert line(lines, "listed16", "its class first").value == 1.0
    assert line(lines, "listed16", "size of the set, median, heights alone").value == 2.0
    assert line(lines, "gross", "a misfit called adequate").missed == "MISSED"
    quiet = line(lines, "clean", "nothing missing, not called adequate")
    assert (quiet.value, quiet.missed) == (0.5, "missed")


def test_an_estimate_outside_its_interval_and_a_name_that_does_not_pay_are_counted():
    wrong = {"kn_N_m": {"estimate": 4.0, "low": 1.0, "high": 3.0}}
    held = {"groups": [1, 2], "rms_after": 1.0, "log_score_gain_low": -0.1}
    lines = table([outcome(parameters=wrong, verdict="effect", effects=["wear"], held_out=held)])
    assert line(lines, "all", "estimates outside their own interval").value == 1.0
    told = "named although the held-out log score does not rise"
    assert line(lines, "all", told).value == 1.0
