"""Flights in tracks: parabolas, impacts and gravity of what is known exactly."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bristle.studies.film.flights import (
    Drop,
    Flight,
    Track,
    drops_of,
    gravity_of,
    settled,
    spread_of,
)
from bristle.studies.film.render import bouncing
from bristle.studies.film.scale import Scale, doubts_of, of_centre

pytestmark = pytest.mark.serial
G, PX = 9.8, 0.5e-3


def track(fps=240.0, noise=0.1, y0=0.04, y1=0.025, seed=0, **motion):
    height, until = bouncing(y0, y1, 0.0, G, **motion)
    t = np.arange(0.0, until, 1.0 / fps)
    y = height(t) / PX + noise * np.random.default_rng(seed).normal(size=len(t))
    return Track(t, y, np.full(len(t), noise))


def test_gravity_is_what_stretches_share():
    assert gravity_of(track()) == pytest.approx(G / PX, rel=0.03)


def test_impacts_and_what_they_keep_are_within_their_errors():
    pulls = []
    for seed in range(30):
        seen = track(seed=seed)
        # nothing turns here, so all flights have the same gravity
        (drop,) = settled(drops_of(seen), seen, turned=1e-4)
        assert drop.release_s == pytest.approx(0.12, abs=0.003)
        pulls.append((drop.restitution[0] - np.sqrt(0.025 / 0.04)) / drop.restitution_error[0])
    # a chi square of thirty pulls lies between these in all but one of a thousand sets
    assert 0.4 < np.mean(np.square(pulls)) < 2.0


@pytest.mark.parametrize(("size_px", "rate_Hz"), [(60.0, 0.7), (60.0, 0.4), (20.0, 1.0)])
def test_what_is_carried_is_no_drop(size_px, rate_Hz):
    t = np.arange(0.0, 2.0, 1.0 / 240.0)
    arc = size_px * np.sin(2.0 * np.pi * rate_Hz * t)
    y = arc + 0.1 * np.random.default_rng(1).normal(size=len(t))
    assert drops_of(Track(t, y, np.full(len(t), 0.1))) == []


def lowered(t, lasts_s):
    """Smoothly, from rest to rest (least jerk), by 60 px."""
    w = np.clip((t - 0.1) / lasts_s, 0.0, 1.0)
    return 60.0 * (1.0 - w**3 * (10.0 - 15.0 * w + 6.0 * w**2))


@pytest.mark.parametrize(
    "moved",
    [
        lambda t: lowered(t, 0.2),
        lambda t: lowered(t, 0.5),
        lambda t: -lowered(t, 0.25),
        lambda t: 23.0 * np.sin(2.0 * np.pi * 2.5 * t),
        lambda t: 20.0 * np.cos(2.0 * np.pi * 3.0 * t),
        lambda t: 150.0 * t,
    ],
)
@pytest.mark.parametrize("seed", range(3))
def test_what_a_hand_moves_is_no_drop_where_gravity_is_about_known(moved, seed):
    t = np.arange(0.0, 1.0, 1.0 / 240.0)
    y = moved(t) + 0.1 * np.random.default_rng(seed).normal(size=len(t))
    for sigma in (0.1, 0.27):
        assert drops_of(Track(t, y, np.full(len(t), sigma)), G / 0.65e-3) == []


def thrown(up_m_s=0.0, until_s=0.7):
    """Of a body that is thrown up at 0.1 s, bounces once and keeps 0.7 of its speed."""
    t, high = np.arange(0.0, until_s, 1.0 / 240.0), 0.1
    lands = (up_m_s + np.sqrt(up_m_s**2 + 2.0 * G * high)) / G
    since, again = t - 0.1, t - 0.1 - lands
    y = np.where(since < 0.0, high, high + up_m_s * since - 0.5 * G * since**2)
    rise = 0.7 * (G * lands - up_m_s) * again - 0.5 * G * again**2
    y = np.where(again > 0.0, rise, y) / PX
    y += 0.1 * np.random.default_rng(2).normal(size=len(t))
    return Track(t, y, np.full(len(t), 0.1))


def test_a_body_that_is_thrown_up_bounces_where_it_lands():
    (drop,) = drops_of(thrown(0.6, until_s=0.5), G / PX)
    assert len(drop.impact_s) == 1
    assert drop.restitution[0] == pytest.approx(0.7, abs=0.01)


@pytest.mark.parametrize(
    ("begin_s", "gravity", "impacts"),
    [(0.15, (), 2), *((begin_s, (G / PX,), 1) for begin_s in (0.26, 0.28, 0.3, 0.32))],
)
def test_a_release_before_the_film_is_not_invented(begin_s, gravity, impacts):
    """Nor is the top of a flight one."""
    whole = track()  # let go at 0.12 s, it lands at 0.21 s, and again at 0.35 s
    late = whole.t_s > begin_s
    (drop,) = drops_of(Track(whole.t_s[late], whole.height[late], whole.sigma[late]), *gravity)
    assert drop.release_s is None
    assert len(drop.impact_s) >= impacts


@pytest.mark.parametrize("bent", ["air", "lens"])
@pytest.mark.parametrize("seed", range(5))
def test_a_fall_out_of_view_is_one_though_air_and_lens_bend_it(bent, seed):
    drag_1_m = 0.1 if bent == "air" else 0.0
    whole = track(y0=0.3, y1=0.1, seed=seed, drag_1_m=drag_1_m)
    y = whole.height
    if bent == "lens":
        y = y * (1.0 + 0.002 * (y / y.max()) ** 2)
    seen = y > 0.1 * y.max()
    seen[np.argmin(seen) :] = False
    (drop,) = drops_of(Track(whole.t_s[seen], y[seen], whole.sigma[seen]))
    assert drop.release_s == pytest.approx(0.12, abs=0.003)
    assert not len(drop.impact_s)


def test_flights_of_three_frames_are_enough_where_gravity_is_about_known():
    # 25 frames a second, and rows of whole pixels
    height, _ = bouncing(0.05, 0.028, 0.0, G, held_s=0.2)
    t = np.arange(0.02, 0.47, 0.04)
    y = np.round(height(t) / 1e-3)
    seen = Track(t, y, np.full(len(t), 0.4))
    assert drops_of(seen) == []
    (drop,) = drops_of(seen, 1.03 * G / 1e-3)
    assert drop.restitution[0] == pytest.approx(np.sqrt(0.028 / 0.05), abs=0.03)


@pytest.mark.parametrize("y0_px", [8.0, 10.37, 14.0, 25.0])
@pytest.mark.parametrize("kept", [0.3, 0.6, 0.9])
def test_a_body_that_falls_few_whole_pixels_is_seen_to_be_let_go(y0_px, kept):
    for off in np.linspace(0.0, 0.9, 10):
        height, until = bouncing(y0_px * 1e-3, kept * y0_px * 1e-3, 0.0, G)
        t = np.arange(0.0, until, 1.0 / 240.0)
        y = np.round(height(t) / 1e-3 + off)
        (drop,) = drops_of(Track(t, y, np.full(len(t), 0.3)), G / 1e-3)
        # rows of whole pixels hide the first half pixel of the fall, which lasts 0.01 s
        assert drop.release_s == pytest.approx(0.12, abs=0.01)


def test_the_centre_of_a_bristle_that_turns_keeps_another_share_than_its_end():
    # a rod of 500 px that falls at 3 degrees, and turns with 0.6 rad/s after the impact
    lean, spin, down, up, length = np.radians(3.0), 0.6, 1500.0, 1100.0, 500.0
    t = np.linspace(-0.08, 0.1, 60)
    turn = lean + spin * np.maximum(t, 0.0)
    faster = 0.5 * length * spin * np.sin(lean)
    flights = (Flight(0.0, 0.0, -down, G / PX), Flight(0.0, 0.0, up + faster, G / PX))
    drop = Drop(0, 59, False, flights, np.zeros(1), 0.0)
    track = SimpleNamespace(t_s=t, turn=turn, sigma_turn=None, used=lambda _: np.arange(60))
    assert drop.restitution[0] == pytest.approx((up + faster) / down)
    assert of_centre(track, drop, length)[0] == pytest.approx(up / down, rel=1e-4)


@pytest.mark.parametrize(("shown", "doubted"), [(1.1, True), (9.0, False), (14.0, True)])
def test_what_falls_with_another_acceleration_is_doubted(shown, doubted):
    """Its standard error is 0.8 m/s², against which it is as far from gravity either way."""
    film = SimpleNamespace(path=Path("film.mp4"))
    track = SimpleNamespace(frame_s=1.0 / 240.0, film=film)
    scale = Scale(0.65, 0.01, "the bristle in view", gravity=(shown, 0.8))
    assert bool(doubts_of(track, scale, G)) == doubted


def test_the_rate_that_would_fit_is_not_the_one_that_there_is():
    track = SimpleNamespace(frame_s=1.0 / 240.0, film=SimpleNamespace(path=Path("film.mp4")))
    (doubt,) = doubts_of(track, Scale(1.0, 0.01, "the ball in view", gravity=(10.35, 0.05)), G)
    assert "has 233.5 frames a second, not 240 " in doubt


def test_at_few_frames_a_second_the_fall_is_found_before_the_rise():
    seen = track(fps=25.0, noise=0.05, y0=0.05, y1=0.04, held_s=0.503)
    (drop,) = settled(drops_of(seen), seen)
    assert drop.release_s == pytest.approx(0.503, abs=0.004)
    assert drop.restitution[0] == pytest.approx(np.sqrt(0.8), abs=0.02)


@pytest.mark.parametrize(
    ("count", "share", "memory"), [(120, 0.0, 0.0), (120, 1.0, 0.6), (1000, 0.5, 0.9)]
)
def test_errors_that_neighbours_share_are_not_taken_for_smaller_ones(count, share, memory):
    """A fit takes up more of them than of independent ones, whether or not a part of them is."""
    rng, numbers = np.random.default_rng(3), 6
    powers = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, count), numbers))[0]
    squares, alike = [], []
    for _ in range(300):
        error = np.empty(count)
        error[0] = rng.normal()
        for k in range(1, count):
            error[k] = memory * error[k - 1] + np.sqrt(1.0 - memory**2) * rng.normal()
        error = np.sqrt(share) * error + np.sqrt(1.0 - share) * rng.normal(size=count)
        left = error - powers @ (powers.T @ error)
        found = spread_of(left, np.zeros(count, dtype=int), numbers)
        squares.append(found[0])
        alike.append(found[1])
    # 120 frames of which four err alike are as many as 30, and six numbers are fitted
    assert np.mean(squares) == pytest.approx(1.0, abs=0.1)
    whole = 1.0 + 2.0 * share * memory / (1.0 - memory)
    assert np.median(alike) == pytest.approx(whole, rel=0.25)
