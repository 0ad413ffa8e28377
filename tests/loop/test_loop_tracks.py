"""Films of bouncing bodies are cut rightly, their rows are unit noise, and effects come back.

The films are made by `film_data`: motion integrated, with drops of the beam for what the impact
does.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace

import film_data
import numpy as np
import pandas as pd
import pytest
from model_fit import fit
from scipy.special import logsumexp
from scipy.stats import chi2

from bristle.solver.effects.library import EFFECTS
from bristle.solver.errors import InputError
from bristle.studies.loop.kinds.tracks.common import together
from bristle.studies.loop.kinds.tracks.films import filmed
from bristle.studies.loop.kinds.tracks.problem import NAMES, tracks_problem
from bristle.studies.loop.kinds.tracks.record import read_tracks
from bristle.studies.loop.kinds.tracks.rows import FEATURES, Film
from bristle.studies.loop.kinds.tracks.scale import turned
from bristle.studies.loop.kinds.tracks.search import track
from bristle.studies.loop.run import find

G = film_data.GRAVITY
KN = 2e6
SIGMA_MM = 0.5
KEYS = f"sigma_y_mm = {SIGMA_MM}\nfps = 25\n"
pytestmark = pytest.mark.serial


def body(
    rng, y0, ratios, *, fps=240.0, sigma_m=2.5e-4, begins="held", drag=0.0, touching_s=(1e-4, 6e-4)
):
    """A film up to four fifths of the last rise and fall, and the true features of its bounces."""
    touching, fall = rng.uniform(*touching_s), math.sqrt(2 * y0 / G)
    release = {
        "held": rng.uniform(0.08, 0.12),
        "release": 0.0,
        "fall": -rng.uniform(0.2, 0.5) * fall,
    }
    speeds = [math.sqrt(-math.expm1(-2 * drag * y0) * G / drag) if drag else math.sqrt(2 * G * y0)]
    lasts = release[begins] + fall
    for ratio in ratios:
        lasts += 1.6 * speeds[-1] * math.sqrt(ratio) / G
        speeds.append(speeds[-1] * math.sqrt(ratio))
    t = np.arange(0.0, lasts if ratios else lasts - 0.03 * fall, 1 / fps)
    rises = [(ratio, G, touching) for ratio in ratios]
    y = film_data.path(t, y0, rises, release_s=release[begins], drag_1_m=drag)
    y += sigma_m * rng.standard_normal(t.size)
    u = drag * speeds[0] ** 2 / G
    truth = np.zeros((max(len(ratios), 1), len(FEATURES)))
    truth[0, FEATURES.index("u")] = u
    truth[0, FEATURES.index("h")] = -math.log1p(-u) / u - 1 if u else 0.0
    if ratios:
        truth[:, FEATURES.index("r")], truth[:, FEATURES.index("d")] = ratios, touching
    return Film(t + 7.0, y, sigma_m, 0.0, G), truth.ravel()


def noise_of(films, truths, bounces=1):
    """What rows (rows,) of films are beside the truth, which features lead them, and the tracks."""
    found = [track(film, bounces) for film in films]
    assert all(each is not None for each in found)
    tracks = together(films, found)
    left = [
        each.values - each.weights @ truth[: each.weights.shape[1]]
        for each, truth in zip(tracks, truths, strict=True)
    ]
    return np.concatenate(left), np.concatenate([each.leading for each in tracks]), tracks


def is_unit_noise(left, leading):
    """Variance one, and no mean in the rows of any feature, but one time in a thousand."""
    low, high = chi2.ppf([0.0005, 0.9995], left.size)
    assert low < left @ left < high
    for k in np.unique(leading):
        some = left[leading == k]
        assert abs(some.sum()) < 4.0 * math.sqrt(some.size), FEATURES[k]


@pytest.mark.parametrize("floor_known", [True, False])
@pytest.mark.parametrize("bounces", [0, 1])
@pytest.mark.parametrize("begins", ["held", "release", "fall"])
def test_rows_are_unit_noise_wherever_a_film_begins(begins, bounces, floor_known):
    rng = np.random.default_rng(12)
    made = [
        body(rng, rng.uniform(0.05, 0.3), [rng.uniform(0.4, 0.9)] * bounces, begins=begins)
        for _ in range(80)
    ]
    films = [film if floor_known else turned(film, 1) for film, _ in made]
    left, leading, tracks = noise_of(films, [truth for _, truth in made])
    assert all(each.bounces == bounces for each in tracks)
    # the hold of one in two thousand seems to move, by chance
    assert abs(sum(each.held for each in tracks) - 80 * (begins == "held")) <= 1
    is_unit_noise(left, leading)
    misfit, freedom = sum(t.misfit for t in tracks), sum(t.freedom for t in tracks)
    low, high = chi2.ppf([0.0005, 0.9995], freedom)
    # the frames' scatter, less what prior knowledge of weak features leaves in it
    assert low < misfit < high + 2 * len(tracks)


@pytest.mark.parametrize(("y0", "sigma_m"), [(0.05, 1e-3), (0.03, 2e-4)])
def test_rows_are_unit_noise_at_25_frames_a_second(y0, sigma_m):
    """A fall has two or three frames: films that can be read in two ways are left aside."""
    rng = np.random.default_rng(12)
    made = [
        body(rng, y0, 2 * [rng.uniform(0.4, 0.9)], fps=25.0, sigma_m=sigma_m) for _ in range(80)
    ]
    made = [(film, truth) for film, truth in made if track(film, 1) is not None]
    assert len(made) >= 72
    left, leading, _ = noise_of([film for film, _ in made], [truth for _, truth in made])
    is_unit_noise(left, leading)


@pytest.mark.parametrize("begins", ["held", "fall"])
def test_drag_is_in_the_rows_of_fall_and_rise(begins):
    """0.1 1/m, of a table-tennis ball: the fall's parabola is bent by a tenth."""
    rng = np.random.default_rng(5)
    made = [
        body(rng, rng.uniform(0.3, 1.0), [rng.uniform(0.5, 0.8)], begins=begins, drag=0.1)
        for _ in range(60)
    ]
    left, leading, tracks = noise_of([film for film, _ in made], [truth for _, truth in made])
    is_unit_noise(left, leading)
    assert np.sum(leading == FEATURES.index("u")) > 0.9 * len(tracks)


@pytest.mark.parametrize("fps", [60.0, 240.0])
def test_further_bounces_are_rows_too(fps):
    rng = np.random.default_rng(3)
    made = [
        body(rng, rng.uniform(0.3, 1.0), [0.6, 0.62, 0.64, 0.66], fps=fps, begins="fall", drag=0.05)
        for _ in range(40)
    ]
    left, leading, tracks = noise_of([film for film, _ in made], [truth for _, truth in made], 8)
    assert all(each.bounces >= 3 for each in tracks)
    is_unit_noise(left, leading)


def test_mistaken_marks_are_not_used():
    rng = np.random.default_rng(8)
    films, truths, wrong = [], [], 0
    for _ in range(40):
        film, truth = body(rng, rng.uniform(0.1, 0.3), [0.6])
        off = rng.choice(film.t_s.size, 2, replace=False)
        film.y_m[off] += rng.choice([-0.02, 0.02], 2)
        wrong += 2
        films.append(film)
        truths.append(truth)
    left, leading, tracks = noise_of(films, truths)
    is_unit_noise(left, leading)
    # those beside the release or the impact are not used anyway
    assert 0.6 * wrong < sum(each.mistaken for each in tracks) <= wrong


def test_films_that_tell_nothing_are_left_aside():
    rng = np.random.default_rng(2)
    t = np.arange(0.0, 0.5, 0.01)
    for y in (np.full(t.size, 0.05), np.zeros(t.size), rng.uniform(0.0, 0.1, t.size)):
        seen = y + 5e-4 * rng.standard_normal(t.size)
        assert track(Film(t, seen, 5e-4, 0.0, G), 1) is None


def made(folder, effects, seed=5, drops=40, keys=KEYS, px_per_m=None, off_m=0.0, **kinds):
    """A dataset of films; ``off_m`` is added to its heights."""
    rng = np.random.default_rng(seed)
    heights = kinds.pop("heights_m", film_data.HEIGHTS_M)
    sigma_m = kinds.pop("sigma_m", 1e-3 * SIGMA_MM)
    films = []
    for scene in film_data.scenes(drops, KN, effects, rng, heights):
        t, y, *rest = film_data.film(scene, rng, sigma_m=sigma_m, **kinds)
        films.append((t, y + off_m, *rest))
    return read_tracks(film_data.write(folder / "films", films, keys, px_per_m=px_per_m))


def fitted(problem, names):
    """Estimates and standard deviations by name, and what is left, of a model without chance."""
    model = problem.combine(names)
    theta, spread, left = fit(model, problem.values)
    said = [p.name for p in model.parameters]
    return dict(zip(said, theta, strict=True)), dict(zip(said, spread, strict=True)), left


def is_noise(left, problem, parameters):
    low, high = chi2.ppf([0.0005, 0.9995], problem.values.size - parameters)
    assert low < left < high


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
    problem = tracks_problem(made(tmp_path, {name: RECOVERED[name]}))
    theta, spread, left = fitted(problem, (name,))
    (parameter,) = EFFECTS[name].parameters
    assert abs(theta[parameter.name] - RECOVERED[name]) < 3 * spread[parameter.name]
    assert spread[parameter.name] < 0.4 * abs(RECOVERED[name])
    is_noise(left, problem, 2)


HIGH = {"fps": 240.0, "sigma_m": 2.5e-4, "heights_m": (0.1, 0.2, 0.3, 0.4), "drops": 16}
CD = 60.0


@pytest.mark.parametrize("begins", ["held", "fall"])
def test_clean_films_leave_noise_in_mm_and_in_pixels(begins, tmp_path):
    """Pixels count downward from anywhere, and say no uncertainty."""
    kinds = {**HIGH, "begins": begins, "seconds": 0.4 if begins == "fall" else 0.6}
    mm = tracks_problem(made(tmp_path / "mm", {}, keys="sigma_y_mm = 0.25\n", **kinds))
    px = tracks_problem(made(tmp_path / "px", {}, keys="", px_per_m=-2500.0, off_m=-1.0, **kinds))
    for problem, parameters in ((mm, 1), (px, 2)):
        theta, spread, left = fitted(problem, ())
        is_noise(left, problem, parameters)
        # tables of drops are right to some thousandths of Kn
        assert abs(math.log(theta["kn_N_m"] / KN)) < 3 * spread["kn_N_m"] + 5e-3
    assert abs(math.log(theta["scale_m_px"] * 2500.0)) < 3 * spread["scale_m_px"]
    assert spread["scale_m_px"] < 1e-3
    names = {name for each in px.candidates for name in each.effects}
    assert not names & {"scale_error", "clock_error", "height_offset"}
    assert ("release_velocity" in names) == (begins == "held")


@pytest.mark.parametrize("px_per_m", [None, 2500.0])
def test_drag_is_recovered_from_films_that_begin_in_mid_fall(px_per_m, tmp_path):
    keys = "sigma_y_mm = 0.25\n" if px_per_m is None else "sigma_y_px = 0.625\n"
    kinds = {**HIGH, "begins": "fall", "seconds": 0.4, "px_per_m": px_per_m, "keys": keys}
    problem = tracks_problem(made(tmp_path, {"air_drag": CD}, **kinds))
    theta, spread, left = fitted(problem, ("air_drag",))
    assert abs(theta["cd"] - CD) < 3 * spread["cd"]
    assert spread["cd"] < 0.2 * CD
    is_noise(left, problem, len(theta))
    assert fitted(problem, ())[2] > left + 50


def test_falls_without_a_bounce_serve_the_fall_alone(tmp_path):
    """Gravity and drag are seen, the contact is not."""
    kinds = {**HIGH, "drops": 12, "heights_m": (0.4,), "seconds": 0.17, "begins": "fall"}
    keys = "sigma_y_mm = 0.25\n"
    problem = tracks_problem(made(tmp_path, {"scale_error": 0.05}, keys=keys, **kinds))
    assert problem.left_aside == ("12 of 12 drops show no bounce, and serve the fall alone",)
    theta, spread, left = fitted(problem, ("scale_error",))
    assert abs(theta["relative"] - 0.05) < 3 * spread["relative"]
    is_noise(left, problem, 1)
    names = {name for each in problem.candidates for name in each.effects}
    assert {"scale_error", "air_drag"} <= names
    assert "hunt_crossley" not in names


def test_a_zero_of_heights_far_from_the_surface_is_said(tmp_path):
    data = made(tmp_path, {}, keys="sigma_y_mm = 0.25\n", off_m=0.1, seconds=0.6, **HIGH)
    problem = tracks_problem(data)
    level = float(re.search(r"surface seems to lie at ([0-9.]+) mm", problem.warnings[0])[1])
    assert abs(level - 100.0) < 0.5
    _, _, left = fitted(problem, ())
    is_noise(left, problem, 1)
    assert "height_offset" not in {name for each in problem.candidates for name in each.effects}


def test_frames_say_what_their_scatter_is(tmp_path):
    """Declared too small by half: frames are taken as they scatter, and it is said."""
    kinds = {**HIGH, "seconds": 0.6}
    optimistic = tracks_problem(made(tmp_path / "a", {}, keys="sigma_y_mm = 0.125\n", **kinds))
    assert "times the declared uncertainty" in optimistic.warnings[0]
    is_noise(fitted(optimistic, ())[2], optimistic, 1)
    silent = tracks_problem(made(tmp_path / "b", {}, keys="", **kinds))
    assert "no uncertainty of a height is declared: 0.25" in silent.warnings[0]
    freedom = silent.notes["freedom"]
    assert abs(silent.notes["sigma_y_m"] / 2.5e-4 - 1) < 4 / math.sqrt(2 * freedom)


def _with_column(folder, name, values, change=None):
    """The table of a dataset with a further column, and heights to which ``change`` is added."""
    path = folder / "tracks.csv"
    table = pd.read_csv(path)
    if change is not None:
        table["y_mm"] += change(table)
    table[name] = values(table) if callable(values) else values
    table.to_csv(path, index=False)
    return read_tracks(folder)


def test_every_row_may_have_an_uncertainty_of_its_own(tmp_path):
    """Every third frame is read four times as badly, and the table says so."""
    made(tmp_path, {}, keys="", **{**HIGH, "seconds": 0.6})
    rng = np.random.default_rng(8)

    def worse(table):
        return np.where(np.arange(len(table)) % 3 == 0, 4.0, 1.0)

    def added(table):
        return 0.25 * np.sqrt(worse(table) ** 2 - 1.0) * rng.standard_normal(len(table))

    data = _with_column(tmp_path / "films", "sigma_mm", lambda t: 0.25 * worse(t), added)
    problem = tracks_problem(data)
    assert not any("times the declared" in each for each in problem.warnings)
    is_noise(fitted(problem, ())[2], problem, 1)


def test_a_scale_is_fitted_within_its_declared_error(tmp_path):
    made(tmp_path, {}, keys="sigma_y_mm = 0.25\nsigma_scale = 0.01\n", **{**HIGH, "seconds": 0.6})
    data = _with_column(tmp_path / "films", "lean_deg", np.nan, lambda t: 0.012 * t.y_mm)
    problem = tracks_problem(data)
    best, apart, left = fitted(problem, ())
    is_noise(left, problem, 2)
    # lengths are read 1.2 % too long
    assert abs(1.0 / best["scale"] - 1.012) < 4.0 * apart["scale"]
    assert apart["scale"] < 0.003


def test_the_zero_of_one_film_is_one_for_all_its_drops(tmp_path):
    """A zero that is 0.6 mm too high, with a declared error of 0.5 mm, in drops of one film and in
    drops of a film each: what says that the zero is off must not grow with the drops of one."""
    pulls = []
    for k, film in enumerate(("one.mp4", lambda t: t["drop"])):
        made(tmp_path / f"{k}", {}, keys="sigma_y_mm = 0.25\nsigma_surface_mm = 0.5\n", **HIGH)
        data = _with_column(tmp_path / f"{k}" / "films", "film", film, lambda t: 0.6)
        tracks = filmed(data).tracks
        rows = [t.leading == FEATURES.index("z") for t in tracks]
        told = [(t.values[r], t.known[r]) for t, r in zip(tracks, rows, strict=True)]
        value, known = (np.concatenate(each) for each in zip(*told, strict=True))
        # the mean of what each says of the zero over the standard error of the mean
        pulls.append(float(value @ known / np.sqrt(known @ known)))
    one, each = pulls
    assert 0.5 < one < 2.0
    # sixteen films of a drop each are four times as sure
    assert each == pytest.approx(4.0 * one, rel=0.15)


@pytest.mark.parametrize("lean_deg", [-2.0, 0.05])
def test_a_lean_that_films_show_is_the_lean_of_the_model(lean_deg, tmp_path):
    """Bristles that lean to the left, and upright ones; each film's own lean is a little off."""
    made(tmp_path, {"bristle_tilt": 2.0} if lean_deg < 0.0 else {}, seed=3, drops=8)
    rng = np.random.default_rng(5)
    off = dict(enumerate(0.02 * rng.standard_normal(9)))
    data = _with_column(tmp_path / "films", "lean_deg", lambda t: lean_deg + t["drop"].map(off))
    problem = tracks_problem(data)
    rows = problem.quantity == NAMES["l"]
    assert list(problem.group[rows]) == list(range(1, 9))
    upright = problem.values[rows] ** 2  # the baseline predicts none
    theta, spread, _ = fitted(problem, ("bristle_tilt",))
    if lean_deg < 0.0:
        assert upright.sum() > 100.0
        assert abs(theta["tilt_deg"] - 2.0) < 3.0 * spread["tilt_deg"]
        assert spread["tilt_deg"] < 0.15
        assert any("lean by 2.0 degrees" in each for each in problem.warnings)
    else:
        assert upright.sum() < 1.0
        assert theta["tilt_deg"] < 0.3
        assert any("a lean towards the camera would not show" in e for e in problem.warnings)


def test_what_is_not_used_is_told(tmp_path):
    """Second impacts of bristles, and films of nothing."""
    data = made(tmp_path, {}, drops=8, keys="sigma_y_mm = 0.5\n", fps=60.0)
    still = slice(*data.begins[2:4])
    data.value[still] = 0.05
    problem = tracks_problem(data)
    assert problem.left_aside == (
        "1 of 8 drops do not show a fall unmistakably, and are not used",
        "7 of 8 drops go on after the second impact, which is not used: a bristle that has bounced "
        "rings and may lean",
    )
    assert 3 not in problem.group


def test_every_effect_of_the_kind_is_a_candidate(tmp_path):
    problem = tracks_problem(made(tmp_path, {}))
    names = {name for each in problem.candidates for name in each.effects}
    assert names == {name for name, effect in EFFECTS.items() if "tracks" in effect.kinds}
    assert problem.quantity[0] == NAMES["r"]
    assert problem.unit == "mm"
    # y1 counts most: rows about it in every drop that is used
    assert np.sum(problem.quantity == NAMES["r"]) == np.unique(problem.group).size


def test_filmed_faster_the_same_drops_tell_more(tmp_path):
    problem = tracks_problem(made(tmp_path, {}, drops=12))
    (faster,) = problem.experiments
    at = np.array([KN])
    step = np.array([1e-3 * KN])

    def told(model):
        return float(np.linalg.norm(model.predict(at + step) - model.predict(at - step)))

    assert told(faster.models(problem.baseline)) > 1.5 * told(problem.baseline)


def test_chance_makes_rows_scatter(tmp_path):
    """Stiffness that differs from drop to drop: likelier by far than none of it."""
    problem = tracks_problem(made(tmp_path, {"surface_phases": 0.5}))
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
    problem = tracks_problem(made(tmp_path, {}, seed=seed))
    assert str(find(problem, seed).verdict) == "adequate"


@pytest.mark.campaign
@pytest.mark.parametrize("name", ["clock_error", "scale_error"])
def test_clock_and_scale_are_one_class(name, tmp_path):
    """g = 2 y / t²: films alone cannot tell which of the two is wrong, and say so."""
    found = find(tracks_problem(made(tmp_path, {name: 0.08})), 0)
    assert str(found.verdict) == "ambiguous"
    assert {"clock_error", "scale_error"} <= set(found.effects)
    assert any({"clock_error", "scale_error"} <= set(each) for each in found.classes)


def test_fewer_frames_than_declared_are_fine_more_are_not(tmp_path):
    with pytest.raises(InputError, match=r"tracks\.csv:3: frames 0\.04 s apart"):
        made(tmp_path / "a", {}, drops=6, keys="fps = 10\n")
    assert made(tmp_path / "b", {}, drops=6, keys="fps = 60\n").sigma_y_m is None


def test_heights_that_count_downward_are_refused(tmp_path):
    data = made(tmp_path, {}, keys="sigma_y_mm = 0.25\n", seconds=0.6, **HIGH)
    data.value[:] = 0.5 - data.value
    with pytest.raises(InputError, match=r"tracks\.csv:2: y_mm falls as the body rises"):
        filmed(data)


def test_pixels_without_a_gravity_are_refused(tmp_path):
    rng = np.random.default_rng(0)
    films = [(np.arange(30) / 30.0, rng.uniform(0.0, 0.3, 30)) for _ in range(5)]
    data = read_tracks(film_data.write(tmp_path / "films", films, "", px_per_m=2500.0))
    with pytest.raises(InputError, match=r"tracks\.csv:2: "):
        filmed(data)


def test_a_ball_bounces_more_than_once_and_a_dashpot_explains_it(tmp_path):
    """A restitution of 0.8 at every speed: that of a mass on a spring and a dashpot, but for the
    depth at which it lets go, 0.1 % of y1 here; read to 1 mm. Without the dashpot it is 1."""
    rng = np.random.default_rng(31)
    how = {"begins": "fall", "touching_s": (3e-4, 3e-4), "sigma_m": 1e-3}
    films = [body(rng, y0, (0.64, 0.64), **how)[0] for y0 in np.linspace(0.2, 0.5, 8)]
    rows = [
        f"{i},{t:.6f},{1e3 * y:.5f}"
        for i, film in enumerate(films, start=1)
        for t, y in zip(film.t_s, film.y_m, strict=True)
    ]
    (tmp_path / "tracks.csv").write_text("\n".join(["drop,t_s,y_mm", *rows]) + "\n")
    (tmp_path / "dataset.toml").write_text(
        '[dataset]\ntitle = "ball"\nkind = "tracks"\nsource = "test"\nlicence = "none"\n'
        '[body]\nshape = "rigid"\nmass_kg = 0.01\n'
        '[measurement]\nfile = "tracks.csv"\nsigma_y_mm = 1.0\n'
    )
    problem = tracks_problem(read_tracks(tmp_path))
    rises = np.char.startswith(problem.quantity.astype(str), "y1")
    assert rises.sum() == 2 * len(films)
    names = {each.effects[0] for each in problem.candidates}
    assert "contact_damping" in names
    assert not names & {"bristle_tilt", "material_damping", "air_drag"}

    misfit = float(np.sum((problem.values - problem.baseline.predict(np.array([1e6]))[0]) ** 2))
    assert misfit > 20 * len(problem.values)
    best, _, left = fitted(problem, ("contact_damping",))
    is_noise(left, problem, 2)
    assert best["c_N_s_m"] > 0.0


@pytest.mark.campaign
def test_the_rebound_and_the_drag_of_a_table_tennis_ball_are_told_apart(tmp_path):
    """Each alone leaves so much that what it leaves points to neither."""
    drag = 0.5 * 1.204 * 0.45 * math.pi * 0.02**2 / 2.7e-3
    rng, films = np.random.default_rng(2101), []
    for y0 in (0.2, 0.4, 0.6, 0.8, 0.3, 0.5, 0.7):
        t = np.arange(0.0, rng.uniform(1.8, 2.0) * math.sqrt(y0 / 0.4), 1 / 240)
        y = film_data.path(t, y0, 4 * [(0.88**2, G, 2e-4)], release_s=0.06, drag_1_m=drag)
        films.append((t, y + 6e-4 * rng.standard_normal(t.size)))
    keys = "sigma_y_mm = 0.6\n[body]\nshape = 'rigid'\nmass_kg = 2.7e-3\ndiameter_m = 0.04\n"
    problem = tracks_problem(read_tracks(film_data.write(tmp_path / "films", films, keys)))
    steady = [each for each in problem.candidates if np.size(each.weights) == 1]
    found = find(replace(problem, candidates=steady))
    assert set(found.weights) == {"contact_damping", "air_drag"}
    cd = found.parameters["cd"]
    sigma = (cd.high - cd.low) / (2.0 * 1.645)
    assert abs(cd.estimate - 0.45) < 4.0 * sigma < 0.02
