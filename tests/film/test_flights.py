"""Flights in tracks: parabolas, impacts and gravity of what is known exactly."""

import numpy as np
import pytest

from bristle.studies.film.flights import drops_of, gravity_of, settled
from bristle.studies.film.render import bouncing

pytestmark = pytest.mark.serial
G, PX = 9.8, 0.5e-3


def track(fps=240.0, noise=0.1, y0=0.04, y1=0.025, seed=0, **motion):
    height, until = bouncing(y0, y1, 0.0, G, **motion)
    t = np.arange(0.0, until, 1.0 / fps)
    y = height(t) / PX + noise * np.random.default_rng(seed).normal(size=len(t))
    return t, y, np.full(len(t), noise)


def test_gravity_is_what_stretches_share():
    t, y, sigma = track()
    assert gravity_of(t, y, sigma) == pytest.approx(G / PX, rel=0.03)


def test_impacts_and_what_they_keep_are_within_their_errors():
    pulls = []
    for seed in range(30):
        t, y, sigma = track(seed=seed)
        # nothing turns here, so all flights have the same gravity
        (drop,) = settled(drops_of(t, y, sigma), t, y, sigma, 0.0, turned=1e-4)
        assert drop.release_s == pytest.approx(0.12, abs=0.003)
        pulls.append((drop.restitution[0] - np.sqrt(0.025 / 0.04)) / drop.restitution_error[0])
    # a chi square of thirty pulls lies between these in all but one of a thousand sets
    assert 0.4 < np.mean(np.square(pulls)) < 2.0


def test_a_release_before_the_film_is_not_invented():
    t, y, sigma = track(held_s=0.0)
    late = t > 0.03
    (drop,) = drops_of(t[late], y[late], sigma[late])
    assert drop.release_s is None
    assert len(drop.impact_s) >= 2


def test_what_is_carried_is_no_drop():
    t = np.arange(0.0, 2.0, 1.0 / 240.0)
    y = 60.0 * np.sin(2.0 * np.pi * 0.7 * t) + 0.1 * np.random.default_rng(1).normal(size=len(t))
    assert drops_of(t, y, np.full(len(t), 0.1)) == []


def test_at_few_frames_a_second_the_fall_is_found_before_the_rise():
    t, y, sigma = track(fps=25.0, noise=0.05, y0=0.05, y1=0.04, held_s=0.503)
    (drop,) = settled(drops_of(t, y, sigma), t, y, sigma, 0.0)
    assert drop.release_s == pytest.approx(0.503, abs=0.004)
    assert drop.restitution[0] == pytest.approx(np.sqrt(0.8), abs=0.02)
