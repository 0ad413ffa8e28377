"""Metres per pixel of films whose scale is unknown, from the gravity that their parabolas show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .guesses import guesses
from .rows import Film

STEP = 1.5
"""Ratio of the gravities that are tried in turn."""
LOOSE = 0.4
LEAST_STEPS = 3.0
"""Frames that the fall from the greatest height has at least: in fewer no gravity is seen."""
FEW = 4
"""So many films tell which way pixels count."""
AGREEING = 0.15


def pixel_m(films: Sequence[Film]) -> tuple[float, int] | None:
    """About how long a pixel is in m, and 1 where heights count upward, -1 where downward.

    ``films`` have pixels for metres and an uncertainty in pixels. None where fewer than half of
    them agree on a gravity.
    """
    few = films[:: -(-len(films) // FEW)]
    best = [[_seen(turned(film, sign)) for film in few] for sign in (1, -1)]
    costs = [sum(cost for cost, _ in each) for each in best]
    sign, of_few = (1, best[0]) if costs[0] <= costs[1] else (-1, best[1])
    about = float(np.nanmedian([gravity for _, gravity in of_few]))
    if not np.isfinite(about):
        return None
    sizes = np.array([_seen(turned(film, sign), about)[1] for film in films])
    middle = float(np.nanmedian(sizes))
    agree = np.abs(np.log(sizes / middle)) < AGREEING
    if agree.sum() < max(0.5 * len(films), 2):
        return None
    return films[0].gravity_m_s2 / float(np.median(sizes[agree])), sign


def turned(film: Film, sign: int) -> Film:
    """The film with heights that count upward, and the surface near the lowest."""
    y = sign * film.y_m
    # the lowest frame may be half a frame's way above the surface
    loose = np.hypot(0.05 * float(np.ptp(y)), 0.5 * float(np.abs(np.diff(y)).max()))
    return replace(
        film,
        y_m=y,
        floor_known=False,
        floor_m=float(y.min()),
        floor_loose_m=max(float(loose), 1e-9),
    )


def _seen(film: Film, about: float | None = None) -> tuple[float, float]:
    """What the best pair of parabolas costs a frame, and its gravity in pixels per s²."""
    high, frame = float(np.ptp(film.y_m)), float(np.median(np.diff(film.t_s)))
    if high <= 0.0:
        return 25.0, np.nan
    most = 2.0 * high / (LEAST_STEPS * frame) ** 2
    slowest = high / float(np.ptp(film.t_s)) ** 2
    tried = np.geomspace(most, slowest, max(int(np.log(most / slowest) / np.log(STEP)), 2))
    best = _alone(film, high)
    for gravity in tried if about is None else (about,):
        for each in guesses(film, gravity, LOOSE, lowest=True)[:1]:
            best = min(best, (each.cost / len(film.t_s), each.gravity_m_s2))
    return best


def _alone(film: Film, high: float) -> tuple[float, float]:
    """What a fall without an impact costs a frame, and its gravity in pixels per s²."""
    t, y = film.t_s, film.y_m
    sigma, best = np.hypot(film.sigma_y_m, 0.01 * high), (25.0, np.nan)
    for release in np.linspace(2.0 * t[0] - t[-1], t[-1], 60)[:-3]:
        fallen = -0.5 * np.maximum(t - release, 0.0) ** 2
        design = np.stack([np.ones_like(t), fallen], axis=1)
        level, gravity = np.linalg.lstsq(design, y, rcond=None)[0]
        cost = float(np.mean(np.minimum(((y - level - gravity * fallen) / sigma) ** 2, 25.0)))
        if gravity > 0.0 and cost < best[0]:
            best = (cost, float(gravity))
    return best
