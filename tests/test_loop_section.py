"""Is the published scatter beyond the instruments, by the numbers that the page gives?"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from bristle.solver import paper
from bristle.studies.account.film import Film, planned_heights_m
from bristle.studies.sections.loop_section import LoopOnPaper, _log_sf, needed_mm, scatters

pytestmark = pytest.mark.serial


def test_expected_scatter_is_that_of_films_read_at_random(rng):
    """Drops of one ratio, filmed and read as the accounts' films are."""
    film = Film(sigma_m=0.5e-3)
    y0 = planned_heights_m()[:, None].repeat(4000, axis=1)
    seen0, seen1 = film.read(y0, paper.RATIO_MEAN * y0, rng.standard_normal((3, *y0.shape)))
    drawn = np.std((seen1 - paper.RATIO_MEAN * seen0) / y0)
    said = next(each for each in scatters() if each.sigma_mm == 0.5)
    assert said.expected == pytest.approx(drawn, rel=0.1)


def test_no_reading_error_makes_the_published_scatter():
    assert all(each.log10_p < -3.5 for each in scatters())
    assert needed_mm() > 2.0 * max(each.sigma_mm for each in scatters())


def test_far_tails_do_not_underflow():
    assert _log_sf(60.0, 25) == pytest.approx(np.log(chi2.sf(60.0, 25)))
    assert np.isfinite(_log_sf(1e5, 25))


def test_the_section_says_what_cannot_be_known():
    section = LoopOnPaper().section({})
    assert any("cannot be known" in paragraph for paragraph in section.text)
    assert len(section.tables[0].rows) == 6
