"""Drops with the paper's summaries, and what the page says of the loop on them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from small_reproduction import toy

from bristle.solver import paper
from bristle.studies.loop.finding import Verdict
from bristle.studies.loop.kinds.drops.problem import damping
from bristle.studies.report.page import show
from bristle.studies.reproduce.loop_section import (
    ALL_LOW_M,
    LoopOnPaper,
    chance_of_scatter,
    film_scatter,
    needed_mm,
    told,
)
from bristle.studies.reproduce.published_drops import Film, dataset, planned_heights_m

pytestmark = pytest.mark.serial
SETS = 4


@pytest.fixture(scope="module")
def sets():
    return LoopOnPaper(SETS).drawn()


@pytest.fixture(scope="module")
def closed():
    study = LoopOnPaper(2, toy)
    study.prepare(MPI.COMM_SELF)
    return study


def apexes(rng, reading_m, n):
    """By how much apexes of parabolas are misread on films of random phase (n,)."""
    frame = 1.0 / paper.FRAMES_PER_S
    dt = rng.uniform(-0.5, 0.5, n) * frame
    return reading_m * rng.standard_normal(n) - 0.5 * paper.GRAVITY_M_S2 * dt**2


def test_apexes_are_misread_by_what_the_film_says(rng):
    film, n = Film(), 100_000
    wrong = apexes(rng, film.reading_m, n)
    assert wrong.mean() == pytest.approx(-film.mean_low_m, abs=4.0 * film.sigma_m / n**0.5)
    assert wrong.std() == pytest.approx(film.sigma_m, rel=4.0 / n**0.5)


def test_expected_scatter_is_that_of_films_read_at_random(rng):
    """Drops of one ratio; to first order in the error of y0, hence the tolerance."""
    film = Film()
    y0 = np.tile(planned_heights_m(), 4000)
    seen0 = y0 + film.reading_m * rng.standard_normal(len(y0))
    seen1 = paper.RATIO_MEAN * y0 + apexes(rng, film.reading_m, len(y0))
    drawn = np.std((seen1 - paper.RATIO_MEAN * seen0 + film.mean_low_m) / y0)
    assert film_scatter(film, planned_heights_m()) == pytest.approx(drawn, rel=0.02)


def test_no_reading_error_makes_the_published_scatter(rng):
    worst = Film(reading_m=1e-3)
    assert chance_of_scatter(film_scatter(worst, ALL_LOW_M)) < 1e-3
    assert needed_mm() > 2.0
    alike = rng.standard_normal((20_000, paper.N_DROPS)).std(axis=1, ddof=1)
    assert chance_of_scatter(0.2) == pytest.approx(np.mean(0.2 * alike >= 0.205), abs=0.02)


def test_heights_are_as_even_as_26_allow():
    heights, counts = np.unique(planned_heights_m(), return_counts=True)
    assert heights.tolist() == list(paper.HEIGHTS_M)
    assert counts.tolist() == [5, 5, 6, 5, 5]


@pytest.mark.parametrize("number", range(SETS))
def test_each_set_has_the_published_summaries_to_printed_digits(sets, number):
    y0, y1 = (1e3 * each for each in sets[number])
    ratio = y1 / y0
    assert f"{ratio.mean():.2f}" == f"{paper.RATIO_MEAN:.2f}"
    assert f"{ratio.std(ddof=1):.2f}" == f"{paper.RATIO_STD:.2f}"
    # normal equations of y1 = a y0 and of y1 = a y0 + b y0²
    s2, s3, s4 = (np.sum(y0**k) for k in (2, 3, 4))
    t1, t2 = np.sum(y0 * y1), np.sum(y0**2 * y1)
    slope = t1 / s2
    a, b = np.linalg.solve([[s2, s3], [s3, s4]], [t1, t2])
    about = np.sum((y1 - y1.mean()) ** 2)
    assert f"{slope:.2f}" == f"{paper.RATIO_MEAN:.2f}"
    assert f"{1 - np.sum((y1 - slope * y0) ** 2) / about:.4f}" == f"{paper.R2_LINEAR:.4f}"
    bent = y1 - a * y0 - b * y0**2
    assert f"{1 - np.sum(bent**2) / about:.4f}" == f"{paper.R2_QUADRATIC:.4f}"


def test_sets_have_the_planned_heights_and_the_one_drop_that_is_published(sets):
    planned = planned_heights_m()
    for y0, y1 in sets:
        known = y0 == paper.KNOWN_DROP_M[0]
        assert y1[known].tolist() == [paper.KNOWN_DROP_M[1]]
        assert np.array_equal(np.sort(y0[~known]), planned[:-1])
        assert np.all((y1 > 0.0) & (y1 <= y0))


def test_sets_differ_from_one_another_and_by_seed_alone(sets):
    for i, (_, one) in enumerate(sets):
        for _, other in sets[i + 1 :]:
            assert np.abs(np.sort(one) - np.sort(other)).max() > 1e-3
    assert np.array_equal(sets[0], LoopOnPaper(1).drawn()[0])


def test_a_dataset_declares_what_is_known_and_no_more(sets):
    y0, y1 = sets[0]
    free, declared = dataset("free", y0, y1), dataset("declared", y0, y1, damping=True)
    assert damping(free.manifest) is not None
    assert damping(declared.manifest) is None
    assert declared.manifest.bristle.material.beta_s == paper.BETA_S
    assert free.manifest.kn_N_m is None
    assert free.manifest.friction is None
    assert np.allclose(free.y1_m - y1, Film().mean_low_m)
    assert free.sigma_y_m == Film().sigma_m


def test_the_section_says_the_verdicts_of_its_findings(closed):
    section = closed.section({})
    rows = {row[0]: row for row in section.tables[0].rows}
    for each in closed.closed:
        assert rows[each.manifest.title][1] == each.finding.verdict
        assert all(name in rows[each.manifest.title][2] for name in each.finding.effects)
    assert len(section.figures[0].data.rows) == 2 * paper.N_DROPS
    assert any(told(closed.closed[:2])[0] in paragraph for paragraph in section.text)
    assert "None of the other drops was measured" in " ".join(section.text)


def test_words_follow_the_findings(closed):
    one, two = closed.closed[:2]

    def saying(each, verdict, weights):
        said = {"verdict": verdict, "weights": weights, "model": with_effects(*list(weights)[:1])}
        return replace(each, finding=replace(each.finding, **said))

    def with_effects(*names):
        return one.problem.combine(names)

    effect = saying(one, Verdict.EFFECT, {"slope": 1.0})
    tied = saying(two, Verdict.AMBIGUOUS, {"drag": 0.75, "slope": 0.25})
    answer = told(
        [effect, replace(tied, finding=replace(tied.finding, model=with_effects("drag")))]
    )[0]
    assert "effect in 1, ambiguous in 1" in answer
    assert "slope 0.62 (0.25 to 1.00); drag 0.38 (0.00 to 0.75)" in answer
    assert "Named in every set: slope." in answer
    assert "In 1 of 2 sets" in answer
    ends = [each.finding.parameters["kn"] for each in (effect, tied)]
    low, high = min(x.low for x in ends), max(x.high for x in ends)
    assert f"kn {show(low, 2)} to {show(high, 2)}" in answer
    nothing = saying(one, Verdict.ADEQUATE, {})
    said = told([nothing, nothing])[0]
    assert "verdict is adequate in 2." in said
    assert "Named" not in said


@pytest.mark.campaign
def test_the_loop_agrees_that_something_is_missing():
    """As the scatter says without any set: something is, and it differs from drop to drop."""
    study = LoopOnPaper(1)
    study.prepare(MPI.COMM_SELF)
    for each in study.closed:
        assert each.finding.p_value < each.finding.alarm
        assert each.finding.verdict is not Verdict.ADEQUATE
        likeliest = max(each.finding.evidences, key=lambda x: x.log_evidence)
        assert len(each.problem.combine(likeliest.effects).weights) > 1
