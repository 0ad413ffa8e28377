"""Does the loop read films of bouncing bristles rightly, and which effects can such films show?

The films are made by `film_data`: parabolas, with drops of the beam for what the impact does.
"""

from __future__ import annotations

import math

import film_data
import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.special import logsumexp
from scipy.stats import chi2

from bristle.solver.effects.library import EFFECTS
from bristle.solver.errors import InputError
from bristle.studies.loop.run import find
from bristle.studies.loop.track_rows import FEATURES, Film
from bristle.studies.loop.track_search import track
from bristle.studies.loop.tracks import NAMES, tracks_problem
from bristle.studies.loop.tracks_record import read_tracks

KN = 2e6
SIGMA_MM = 0.5
KEYS = f"sigma_y_mm = {SIGMA_MM}\nfps = 25\n"
pytestmark = pytest.mark.serial


def parabolas(rng, y0, r, sigma_m, fps=25.0):
    """A film of a point that bounces, and when it was released."""
    t, release = np.arange(0.0, 0.8, 1 / fps), rng.uniform(0.08, 0.08 + 1 / fps)
    g = film_data.GRAVITY
    since, y = t - release, np.full(t.size, y0)
    y[since > 0] -= g * since[since > 0] ** 2 / 2
    begin, speed = math.sqrt(2 * y0 / g), math.sqrt(2 * g * y0)
    for _ in range(10):
        speed *= math.sqrt(r)
        on = since > begin
        y[on] = np.maximum(speed * (since - begin) - g * (since - begin) ** 2 / 2, 0.0)[on]
        begin += 2 * speed / g
    return Film(t, y + sigma_m * rng.standard_normal(t.size), sigma_m, 0.0, g), release


@pytest.mark.parametrize(("y0", "sigma_m"), [(0.05, 1e-3), (0.03, 2e-4)])
def test_films_are_reduced_without_bias(y0, sigma_m):
    """Release, y0, y1 within three standard errors; rows are unit noise about the truth."""
    rng = np.random.default_rng(12)
    misses, left, aside = [], [], 0
    for _ in range(100):
        r = rng.uniform(0.4, 0.9)
        film, release = parabolas(rng, y0, r, sigma_m)
        found = track(film)
        if found is None:
            aside += 1
            continue
        truth = np.array([r, 0.0, 1.0, 0.0, 0.0])
        misses.append([found.start_s - release, found.y0_m - y0, (found.features[0] - r) * y0])
        left.append(found.values - found.weights @ truth)
    errors = np.array(misses)
    assert aside <= 8
    assert np.all(np.abs(errors.mean(axis=0)) < 3 * errors.std(axis=0) / math.sqrt(len(errors)))
    assert errors[:, 0].std() < 0.01
    noise = np.concatenate(left)
    low, high = chi2.ppf([0.0005, 0.9995], noise.size)
    assert low < noise @ noise < high


def test_a_film_tells_more_rows_than_y1_alone():
    rng = np.random.default_rng(1)
    found = track(parabolas(rng, 0.05, 0.65, 5e-4)[0])
    assert found is not None
    assert [FEATURES[i] for i in found.leading][:3] == ["r", "a", "d"]
    # four frames of the rise: y1 to a millimetre, its gravity to some per cent
    assert 0.05 / found.known[0] < 1e-3
    assert 1 / found.known[1] < 0.1


def test_films_that_tell_nothing_are_left_aside():
    rng = np.random.default_rng(2)
    film, _ = parabolas(rng, 0.05, 0.6, 5e-4)
    late = film.t_s > 0.3
    assert track(Film(film.t_s[late], film.y_m[late], 5e-4, 0.0, film.gravity_m_s2)) is None


def made(folder, effects, seed=5, drops=40, sigma_mm=SIGMA_MM):
    rng = np.random.default_rng(seed)
    films = [
        film_data.film(scene, rng, sigma_m=1e-3 * sigma_mm)
        for scene in film_data.scenes(drops, KN, effects, rng)
    ]
    return tracks_problem(read_tracks(film_data.write(folder / "films", films, KEYS)))


def fitted(problem, names):
    """Least-squares estimate, standard deviations, and what is left, of a model without chance."""
    model = problem.combine(names)
    several = model.parameters
    start = np.array([p.typical for p in several])
    low, high = np.array([p.low for p in several]), np.array([p.high for p in several])
    logs = np.array([p.logarithmic for p in several])

    def out(u):
        return np.where(logs, np.exp(u), u)

    def into(x):
        return np.where(logs, np.log(np.maximum(x, 1e-300)), x)

    found = least_squares(
        lambda u: problem.values - model.predict(out(u))[0],
        into(start),
        bounds=(into(low), into(high)),
        x_scale=np.where(logs, 0.3, 0.1 * (high - low)),
    )
    spread = np.sqrt(np.diag(np.linalg.pinv(found.jac.T @ found.jac)))
    return out(found.x), spread, 2 * found.cost


RECOVERED = {
    "release_velocity": 0.25,
    "scale_error": 0.1,
    "clock_error": -0.05,
    "height_offset": 3e-3,
    "wear": 1.5,
    "bristle_tilt": 3.0,
}


@pytest.mark.parametrize("name", RECOVERED)
def test_effects_are_recovered(name, tmp_path):
    """The size within three standard deviations, and rows at the fit that are noise."""
    problem = made(tmp_path, {name: RECOVERED[name]})
    theta, spread, left = fitted(problem, (name,))
    assert abs(theta[1] - RECOVERED[name]) < 3 * spread[1]
    assert spread[1] < 0.4 * abs(RECOVERED[name])
    low, high = chi2.ppf([0.0005, 0.9995], problem.values.size - 2)
    assert low < left < high


def test_every_effect_of_the_kind_is_a_candidate(tmp_path):
    problem = made(tmp_path, {})
    names = {name for each in problem.candidates for name in each.effects}
    assert names == {name for name, effect in EFFECTS.items() if "tracks" in effect.kinds}
    assert problem.quantity[0] == NAMES[0]
    assert problem.unit == "mm"
    # y1 counts most: rows about it in every drop that is used
    assert np.sum(problem.quantity == NAMES[0]) == np.unique(problem.group).size


def test_chance_makes_rows_scatter(tmp_path):
    """Stiffness that differs from drop to drop: likelier by far than none of it."""
    problem = made(tmp_path, {"surface_phases": 0.5})
    starts = np.flatnonzero(np.diff(problem.group, prepend=-1))

    def likelihood(names, theta):
        model = problem.combine(names)
        squares = (problem.values - model.predict(np.array(theta))) ** 2
        of_drops = -0.5 * np.add.reduceat(squares, starts, axis=1)
        return float(np.sum(logsumexp(of_drops.T, axis=1, b=model.weights)))

    kns = np.geomspace(1e6, 4e6, 25)
    plain = max(likelihood((), [kn]) for kn in kns)
    assert max(likelihood(("surface_phases",), [kn, 0.5]) for kn in kns) > plain + 20


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(4))
def test_clean_films_are_adequate(seed, tmp_path):
    assert str(find(made(tmp_path, {}, seed=seed), seed).verdict) == "adequate"


@pytest.mark.campaign
@pytest.mark.parametrize("name", ["clock_error", "scale_error"])
def test_clock_and_scale_are_one_class(name, tmp_path):
    """g = 2 y / t²: films alone cannot tell which of the two is wrong, and say so."""
    found = find(made(tmp_path, {name: 0.08}))
    assert str(found.verdict) == "ambiguous"
    assert {"clock_error", "scale_error"} <= set(found.effects)
    assert any({"clock_error", "scale_error"} <= set(each) for each in found.classes)


def test_fewer_frames_than_declared_are_fine_more_are_not(tmp_path):
    rng = np.random.default_rng(0)
    films = [film_data.film(s, rng) for s in film_data.scenes(6, KN, {}, rng)]
    with pytest.raises(InputError, match=r"tracks\.csv:3: frames 0\.04 s apart"):
        read_tracks(film_data.write(tmp_path / "a", films, "fps = 10\n"))
    assert read_tracks(film_data.write(tmp_path / "b", films, "fps = 60\n")).sigma_y_m is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("y_mm", "height", 1), r"tracks\.csv:1: no column y_mm"),
        (lambda text: _changed(text, 5, 2, "nan"), r"tracks\.csv:5: y_mm must be a finite"),
        (lambda text: _changed(text, 6, 1, "0.0"), r"tracks\.csv:6: t_s must grow"),
        (lambda text: _changed(text, 40, 0, "1"), r"tracks\.csv:40: drop must count upwards"),
        (lambda text: "\n".join(text.splitlines()[:37]), r"drops; the loop needs four or more"),
        (lambda text: text + "9,0.0,1.0\n", r"drop 9 has 1 frames; 6 or more"),
    ],
)
def test_reading_is_strict(change, message, tmp_path):
    rng = np.random.default_rng(0)
    films = [film_data.film(s, rng) for s in film_data.scenes(7, KN, {}, rng)]
    folder = film_data.write(tmp_path / "films", films, KEYS)
    path = folder / "tracks.csv"
    path.write_text(change(path.read_text()))
    with pytest.raises(InputError, match=message):
        read_tracks(folder)


def _changed(text, line, column, value):
    lines = text.splitlines()
    cells = lines[line - 1].split(",")
    cells[column] = value
    lines[line - 1] = ",".join(cells)
    return "\n".join(lines) + "\n"
