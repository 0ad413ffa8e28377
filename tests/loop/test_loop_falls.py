"""Falls with an accelerometer: closed forms, rows and noise against integration and statistics, and
the measured falls of a telephone that the package ships (``studies/measured/falls-phone``)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from model_fit import fit
from scipy.integrate import solve_ivp

from bristle.solver.errors import InputError
from bristle.studies.loop.kinds.falls.motion import (
    EARLIEST_S,
    LATEST_S,
    lead_s,
    mean_reading,
    speed,
)
from bristle.studies.loop.kinds.falls.noise import Noise, noise_of
from bristle.studies.loop.kinds.falls.problem import (
    BASELINE,
    EFFECT_PARAMETERS,
    FallModel,
    fall_problem,
)
from bristle.studies.loop.kinds.falls.record import SETTLING_S, freely, read_falls
from bristle.studies.loop.run import find

MEASURED = Path(__file__).resolve().parents[2] / "studies" / "measured" / "falls-phone"
GRAVITY = 9.8
BIAS, DRAG, NOISE = -0.08, 0.05, 0.03
HEIGHTS_M = (0.5, 0.9, 1.3, 1.8)
pytestmark = pytest.mark.serial


def write(folder, rows, keys='file = "falls.csv"\ngravity_m_s2 = 9.8\n', kind="falls", more=""):
    folder.mkdir(exist_ok=True)
    (folder / "dataset.toml").write_text(
        f'[dataset]\ntitle = "made"\nkind = "{kind}"\n[measurement]\n{keys}'
    )
    lines = [f"fall,t_s,a_m_s2{more}"]
    lines += [f"{n:.0f},{t:.9g},{','.join(f'{x:.9g}' for x in rest)}" for n, t, *rest in rows]
    (folder / "falls.csv").write_text("\n".join(lines) + "\n")
    return folder


def integrated(time_s, k, c=0.0):
    """Drag c v + k v² at times after release, from the fall's differential equation."""
    times = np.asarray(time_s)
    done = solve_ivp(
        lambda _, v: GRAVITY - c * v - k * v * v, (0, times[-1]), [0.0], t_eval=times, rtol=1e-10
    )
    return c * done.y[0] + k * done.y[0] ** 2


def made_rows(rng, k=DRAG, c=0.0, spread=0.0, noise=NOISE, per_height=3, bias=BIAS):
    """Falls from several heights, each recorded from a moment of its own until it lands."""
    rows = []
    for n in range(len(HEIGHTS_M) * per_height):
        time = np.arange(0.0, np.sqrt(2.0 * HEIGHTS_M[n // per_height] / GRAVITY), 0.005)
        own = k * np.exp(spread * rng.standard_normal())
        reading = bias + integrated(time, own, c) + noise * rng.standard_normal(len(time))
        late = int(rng.integers(25))
        rows += [
            (n + 1, *each) for each in zip(time[late:] - time[late], reading[late:], strict=True)
        ]
    return rows


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return read_falls(write(tmp_path_factory.mktemp("made"), made_rows(np.random.default_rng(5))))


@pytest.mark.parametrize(("k", "c"), [(1e-3, 0.0), (0.05, 0.0), (5.0, 0.0), (0.0, 0.3), (0.2, 1.0)])
def test_readings_solve_the_equation_of_a_fall_with_drag(k, c):
    """The mean over 2h differs from the middle's value by a'' h² / 6, here less than 1e-4 g."""
    time = np.linspace(1e-3, 1.5, 40)
    expected = integrated(np.concatenate([[0.0], time]), k, c)[1:]
    found = [mean_reading(t - 5e-4, t + 5e-4, k, c, GRAVITY) for t in time]
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_without_drag_speed_is_that_of_a_vacuum_and_nothing_is_read():
    for time in (-0.3, 0.0, 0.4, 2.0):
        assert speed(time, 0.0, 0.0, GRAVITY) == pytest.approx(GRAVITY * time, rel=1e-9)
    assert mean_reading(-0.2, -0.1, 0.5, 0.3, GRAVITY) == pytest.approx(0.0, abs=1e-12)
    assert mean_reading(0.3, 0.4, 0.0, 0.0, GRAVITY) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("k", [1e-3, 0.05, 5.0])
def test_a_mean_reading_tells_the_release(k):
    edges = np.linspace(0.0, 0.5, 11)
    begin, end = edges[:-1], edges[1:]
    for lead in (0.0, 0.03, 0.4):
        pairs = zip(lead + begin, lead + end, strict=True)
        level = np.mean([mean_reading(*pair, k, 0.0, GRAVITY) for pair in pairs])
        assert lead_s(level, begin, end, k, 0.0, GRAVITY) == pytest.approx(lead, abs=1e-7)
    assert lead_s(-1.0, begin, end, k, 0.0, GRAVITY) == EARLIEST_S
    assert lead_s(GRAVITY, begin, end, k, 0.0, GRAVITY) == LATEST_S


def test_rows_do_not_hang_on_a_bias_and_have_unit_noise_at_the_least(made):
    """The rows' covariance for white noise, the release told by the mean: the identity where the
    slope grows from release on, and never more than it without drag."""
    bins = fall_problem(made).baseline.bins
    assert np.abs(bins.rows(np.ones(len(bins.begin_s)))).max() < 1e-9
    for piece in bins.pieces:
        n = piece.stop - piece.start
        unit = np.zeros((n, len(bins.begin_s)))
        unit[:, piece] = np.eye(n)
        reached = bins.rows(unit)
        own = np.flatnonzero(np.abs(reached).max(axis=0) > 0)
        assert len(own) == n - 1
        to_rows = reached[:, own].T
        time = bins.middle_s[piece]
        through = np.eye(n) - np.outer(time / time.mean(), np.full(n, 1 / n))
        noise = bins.noise.covariance(n)
        np.testing.assert_allclose(
            to_rows @ through @ noise @ through.T @ to_rows.T, np.eye(n - 1), atol=1e-9
        )
        plain = np.linalg.eigvalsh(to_rows @ noise @ to_rows.T)
        assert plain[0] == pytest.approx(0.75, abs=0.1)
        assert plain[-1] < 1.0 + 1e-9


@pytest.mark.parametrize("truth", [Noise(0.02), Noise(0.02, 1.5), Noise(0.02, 0.0, 0.5)])
def test_noise_is_told_from_a_course_that_no_model_knows(truth):
    """Relative errors of a standard deviation from 30 falls x 8 degrees of freedom: 0.046, and
    twice that with a growth or a correlation beside it; a course of 1 m/s² is not in it."""
    rng = np.random.default_rng(3)
    found = []
    for _ in range(10):
        times, means = [], []
        for _ in range(30):
            time = np.linspace(0.0, 0.5, 11)
            shape = np.linalg.cholesky(truth.covariance(11))
            course = rng.normal() + rng.normal() * time + 4.0 * rng.normal() * time**2
            times.append(time)
            means.append(course + shape @ rng.standard_normal(11))
        found.append(noise_of(times, means))
    mean = np.mean(found, axis=0)
    assert mean[0] == pytest.approx(truth.sigma_m_s2, rel=0.1)
    assert mean[1] == pytest.approx(truth.growth, abs=0.2)
    assert mean[2] == pytest.approx(truth.correlation, abs=0.1)


def test_drag_that_was_put_in_comes_back_within_its_error_whatever_the_height(tmp_path):
    """24 sets: of the estimate over its standard error, the mean square is 1 ± 0.29."""
    rng = np.random.default_rng(9)
    misses, left = [], []
    for i in range(24):
        problem = fall_problem(read_falls(write(tmp_path / str(i), made_rows(rng))))
        found, error, squares = fit(problem.combine(("air_drag",)), problem.values)
        misses.append((found - [BIAS, DRAG]) / error)
        left.append(squares / (len(problem.values) - 2))
        assert error[1] < 0.05 * DRAG
    assert np.mean(np.square(misses)) == pytest.approx(1.0, abs=3 * 0.29 / np.sqrt(2))
    assert np.mean(left) == pytest.approx(1.0, abs=0.15)


def test_what_is_missing_is_named(tmp_path):
    rng = np.random.default_rng(11)
    found = find(fall_problem(read_falls(write(tmp_path / "air", made_rows(rng)))), 0)
    assert found.effects == ("air_drag",)
    assert found.held_out.rms_after < 0.1 * found.held_out.rms_before
    still = fall_problem(read_falls(write(tmp_path / "none", made_rows(rng, k=0.0))))
    assert str(find(still, 0).verdict) == "adequate"


@pytest.mark.parametrize(("fall", "factor"), [(6, 1.0 / GRAVITY), (12, 1.0 / GRAVITY), (9, 2.0)])
def test_a_fall_in_another_unit_is_set_aside_and_the_drag_is_found(fall, factor, tmp_path):
    """Wherever it is, among those held out or those fitted."""
    rows = made_rows(np.random.default_rng(11), k=0.12)
    rows = [(n, t, a * (factor if n == fall else 1.0)) for n, t, a in rows]
    found = find(fall_problem(read_falls(write(tmp_path / "one", rows))), 0)
    assert found.effects == ("air_drag",)
    assert [(each.kind, each.drops) for each in found.bookkeeping] == [("slip", (fall,))]
    assert found.parameters["k_1_m"].low < 0.12 < found.parameters["k_1_m"].high


def test_falls_that_all_differ_are_no_slips(tmp_path):
    rows = made_rows(np.random.default_rng(11), k=0.12, spread=0.3)
    found = find(fall_problem(read_falls(write(tmp_path, rows))), 0)
    assert "drag_scatter" in found.effects
    assert not found.bookkeeping


def test_the_course_of_a_drag_linear_in_speed_is_its_own(tmp_path):
    """That of k v² leaves more than the noise of it, that of c v the noise: √(2 / 100) = 0.14."""
    rng = np.random.default_rng(12)
    rows = made_rows(rng, k=0.0, c=0.4, noise=0.01)
    problem = fall_problem(read_falls(write(tmp_path, rows)))
    left = {}
    for name in ("air_drag", "linear_drag"):
        *_, squares = fit(problem.combine((name,)), problem.values)
        left[name] = squares / (len(problem.values) - 2)
    assert left["linear_drag"] < 1.0 + 3 * 0.14
    assert left["air_drag"] > 2.0


def test_models_are_vectorised_and_nested(made):
    problem = fall_problem(made)
    start = np.array([0.1])
    for names in [*[(n,) for n in EFFECT_PARAMETERS], tuple(EFFECT_PARAMETERS)]:
        model = problem.combine(names)
        assert isinstance(model, FallModel)
        assert model.weights.sum() == pytest.approx(1.0)
        absent = np.concatenate([start, [p.null for p in model.parameters[1:]]])
        rows = model.predict(np.stack([absent, absent])[:, None])
        assert rows.shape == (2, 1, len(model.weights), len(problem.values))
        expected = np.broadcast_to(problem.baseline.predict(start), rows.shape)
        np.testing.assert_allclose(rows, expected, atol=1e-5)
        corners = np.array([[p.low for p in model.parameters], [p.high for p in model.parameters]])
        assert np.all(np.isfinite(model.predict(corners)))
    assert problem.baseline.parameters == BASELINE


def test_drag_that_scatters_is_told_by_the_likelihood_over_its_nodes(tmp_path):
    """Sixty falls tell a deviation of 0.2 to 0.2 / √120; bounds are three times that."""
    rng = np.random.default_rng(6)
    rows = made_rows(rng, spread=0.2, per_height=15)
    problem = fall_problem(read_falls(write(tmp_path, rows)))
    model = problem.combine(("air_drag", "drag_scatter"))

    def likelihood(scatter):
        misfit = -0.5 * (model.predict(np.array([BIAS, DRAG, scatter])) - problem.values) ** 2
        total = 0.0
        for number in np.unique(problem.group):
            each = misfit[:, problem.group == number].sum(axis=1)
            total += each.max() + np.log(model.weights @ np.exp(each - each.max()))
        return total

    grid = np.linspace(0.02, 0.5, 49)
    best = grid[np.argmax([likelihood(each) for each in grid])]
    assert best == pytest.approx(0.2, abs=3 * 0.2 / np.sqrt(120))


def test_a_body_that_is_still_held_and_the_impact_are_left_aside_and_told(tmp_path):
    rng = np.random.default_rng(8)
    rows = made_rows(rng)
    plain = read_falls(write(tmp_path / "plain", rows))
    held = [(1, 0.005 * i - 0.2, sign_g) for i, sign_g in enumerate([9.8] * 30 + [8.0, 4.0, 1.5])]
    first = [row for row in rows if row[0] == 1]
    last = first[-1][1]
    struck = [(1, last + 0.005, first[-1][2] + 4.0), (1, last + 0.01, 80.0)]
    added = [*held, *first, *struck, *rows[len(first) :]]
    found = read_falls(write(tmp_path / "added", added))
    # noise says whether a sample or two after the release still seem to settle
    kept = len(found.reading_m_s2)
    assert len(plain.reading_m_s2) - 4 <= kept <= len(plain.reading_m_s2)
    np.testing.assert_array_equal(found.reading_m_s2, plain.reading_m_s2[-kept:])
    assert len(plain.left_aside) == 1
    told = " ".join(found.left_aside)
    assert re.search(r"fall 1: 3\d samples in which the body is still held", told)
    assert "fall 1: 2 sample(s) at its end, of the impact" in told
    assert fall_problem(found).left_aside == found.left_aside


def test_of_what_falls_freely_nothing_is_cut():
    rng = np.random.default_rng(2)
    time = np.arange(0.0, 0.6, 0.005)
    for k in (0.0, 0.05, 2.0):
        for _ in range(100):
            reading = integrated(time, k) + NOISE * rng.standard_normal(len(time))
            assert freely(reading, GRAVITY) == (0, len(time))


def test_the_first_part_of_every_record_is_left_aside(made, tmp_path):
    before = [row for row in made_rows(np.random.default_rng(5)) if row[0] == 12]
    kept = made.times_s[made.fall == 12]
    assert kept[0] == pytest.approx(SETTLING_S, abs=0.005)
    assert len(before) - len(kept) == round(SETTLING_S / 0.005)


def test_a_reading_of_the_other_sign_is_turned_and_told(tmp_path):
    rows = made_rows(np.random.default_rng(4))
    plain = read_falls(write(tmp_path / "plain", rows))
    turned = read_falls(write(tmp_path / "turned", [(n, t, -a) for n, t, a in rows]))
    np.testing.assert_allclose(turned.reading_m_s2, plain.reading_m_s2)
    assert not plain.warnings
    assert "its sign is turned" in fall_problem(turned).warnings[0]


def test_heights_are_read_where_the_table_has_them(tmp_path):
    rows = [
        (n, t, a, 1e3 * HEIGHTS_M[(n - 1) // 3]) for n, t, a in made_rows(np.random.default_rng(4))
    ]
    problem = fall_problem(read_falls(write(tmp_path / "good", rows, more=",y0_mm")))
    assert set(problem.covariates["height"]) == set(HEIGHTS_M)
    rows[3] = (*rows[3][:3], 7.0)
    with pytest.raises(InputError, match=r"falls.csv:5: y0_mm must be the same"):
        read_falls(write(tmp_path / "bad", rows, more=",y0_mm"))


def test_effects_that_a_fall_cannot_carry_are_refused(made):
    with pytest.raises(InputError, match="cannot carry hunt_crossley"):
        fall_problem(made).combine(("hunt_crossley",))


@pytest.fixture(scope="module")
def measured():
    return read_falls(MEASURED)


def test_measured_falls_lack_drag(measured):
    """Fitted on falls of odd number, held out are the even ones, two numbers for all of them.

    A telephone (0.2 kg, 0.08 m x 0.16 m, c between 1 and 1.3) has k = ½ ρ c A / m near 0.04 to
    0.05 1/m broadside, less edge on.
    """
    problem = fall_problem(measured)
    assert problem.confirm is None
    assert problem.confirm_why
    seen = problem.group % 2 == 1
    rms = {}
    for name in ("air_drag", "linear_drag"):
        model = problem.combine((name,))
        found, *_ = fit(model, problem.values, seen)
        residual = ((model.predict(found)[0] - problem.values) * problem.scale)[~seen]
        rms[name] = np.sqrt(np.mean(residual**2))
        if name == "air_drag":
            assert 0.03 < found[1] < 0.06
    before = np.sqrt(np.mean((problem.values * problem.scale)[~seen] ** 2))
    assert rms["air_drag"] < 0.1 * before
    assert rms["linear_drag"] > 1.7 * rms["air_drag"]


def test_of_the_measured_falls_nothing_but_their_first_part_is_left_aside(measured):
    assert len(measured.left_aside) == 1
    assert not measured.warnings
    assert len(measured.numbers) == 22


def test_nodes_between_others_are_interpolated(tmp_path):
    """With half of the scatter, a node lies where one of twice the deviation did."""
    rows = made_rows(np.random.default_rng(6), spread=0.2, per_height=2)
    problem = fall_problem(read_falls(write(tmp_path, rows)))
    model = problem.combine(("air_drag", "drag_scatter"))
    half, whole = np.array([BIAS, DRAG, 0.2]), np.array([BIAS, DRAG, 0.4])
    finer = model.finer(2)
    assert finer.weights.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(finer.predict(whole)[::2], model.predict(whole), atol=1e-9)
    # of nodes from -3 to 3 every one from -1.5 to 1.5, at twice the deviation
    np.testing.assert_allclose(finer.predict(whole)[20:61], model.predict(half), atol=1e-4)
