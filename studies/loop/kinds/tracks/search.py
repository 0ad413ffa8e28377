"""The track that fits a film best, and which of its frames show the body held, falling and rising.

Tracks of `track_flight` are fitted from the best few pairs of parabolas that `track_guesses` finds,
and held against a fall without any impact.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .....solver.arrays import Array
from .flight import (
    BOUNCE,
    FALL,
    HEAD,
    HELD,
    RISE,
    UNUSED,
    Phases,
    bouncing,
    derivatives,
    fall_of,
    heights,
    rises_of,
)
from .guesses import CAP, LATER, LEAST_FRAMES, Guess, guesses
from .phases import LEAST_HELD, LEAST_RATIO, phases
from .rows import LOOSE, Film, Track, deviation, is_free, names_of, reduced

RIVAL = 8.0
"""By how much the sum of squares of the best track must be less than any other's."""
APART_S = 0.004
OUTLYING = 5.0
"""Frames farther than that from the best track, in deviations, are mistaken marks."""
CLEAR = 3.0
"""Squares a frame below which a track with three frames of a rise is held against no fall alone."""
TURNS = 40
LARGEST_SHARE = 0.1
"""Of the heights' range: what strays farther from its best track is no flight."""
LEAST_RISE = 10.0
"""Of a further bounce, in deviations of a frame: a body at rest seems to hop less."""
LOOSE_GRAVITY, MOST_GRAVITY = 0.2, 0.8
"""How far gravity may seem to be from what it is, as a share when it is looked for; and its
logarithm: more is a wrong unit."""


def track(film: Film, bounces: int) -> Track | None:
    """The best track of a film, of at most so many bounces; none where it shows a fall alone.

    None where no flight is seen, or two tracks that differ fit alike: what a frame is, fall or
    rise, is then a guess.
    """
    found = [each for each in (_settled(film, p, 1) for p in _starts(film)) if each]
    found.sort(key=lambda each: each.cost)
    for other in found[1:]:
        if other.cost < found[0].cost + RIVAL and abs(other.p[0] - found[0].p[0]) > APART_S:
            return None
    clear = bool(found) and found[0].cost < CLEAR * len(film.t_s)
    clear = clear and (found[0].phase >= RISE).sum() >= LEAST_HELD
    alone = None if clear else _fall_alone(film)
    if alone and (not found or alone.cost < found[0].cost):
        best = alone
    elif found:
        best = _bounced_on(film, found[0], bounces)
    else:
        return None
    result = reduced(film, best.p, best.phase, best.held)
    result = replace(result, mistaken=best.mistaken)
    rms = film.sigma_y_m * np.sqrt(result.misfit / max(result.freedom, 1))
    strays = rms > LARGEST_SHARE * np.ptp(film.y_m)
    return None if strays or not len(result.values) or result.freedom < 1 else result


@dataclass(frozen=True)
class Settled:
    """A track that fits best near where it began, and the capped squares it leaves."""

    cost: float
    p: Array
    phase: Phases
    held: bool
    mistaken: int


def _settled(film: Film, p: Array, least_rise: int) -> Settled | None:
    """The best track near ``p``; None where it leaves what a film can show."""
    mistaken: NDArray[np.bool_] = np.zeros(len(film.t_s), dtype=bool)
    for turn in range(4):
        phase, held = phases(film, p)
        phase[mistaken] = UNUSED
        rises = len(p) > len(HEAD)
        if (phase != UNUSED).sum() < (4 if rises else LEAST_FRAMES):
            return None
        if rises and (phase >= RISE).sum() < least_rise:
            return None
        if not (phase == FALL).any() and not (held and rises):
            return None
        p = _least(film, p, phase, held)
        if p[1] <= 1e-3 or not np.isfinite(p).all() or abs(p[4]) > MOST_GRAVITY:
            return None
        if rises and p[len(HEAD)] < LEAST_RATIO:
            return None
        if turn >= 1:
            mistaken = _mistaken(film, p, held)
    return Settled(_cost(film, p, held), p, phase, held, int(mistaken.sum()))


def _mistaken(film: Film, p: Array, held: bool) -> NDArray[np.bool_]:
    """Frames (frames,) that lie where no neighbour's scatter can have put them."""
    phase, _ = phases(film, p)
    used = phase != UNUSED
    residual = np.abs(film.y_m - heights(p, film.t_s, phase, film.gravity_m_s2))
    usual = 1.4826 * float(np.median(residual[used])) if used.any() else 0.0
    sigma = np.maximum(film.sigma_y_m * np.asarray(film.relative), usual)
    speed = np.abs(derivatives(p, film.t_s, phase, film.gravity_m_s2)[:, 0])
    return used & (residual > OUTLYING * np.hypot(sigma, film.sigma_t_s * speed))


def _prior(film: Film, p: Array) -> tuple[Array, Array]:
    """Where the numbers of a track are looked for, and one over how far from there."""
    usual, tight = np.zeros(len(p)), np.zeros(len(p))
    for k, name in enumerate(names_of(p)):
        tight[k] = 1.0 / LOOSE[name] if name in LOOSE else 0.0
    usual[2], usual[len(HEAD) :: 3] = film.floor_m, 0.5
    tight[2] = 1.0 / film.floor_loose_m if len(p) > len(HEAD) else 0.0
    tight[len(HEAD) :: 3] = 0.1
    return usual, tight


def _least(
    film: Film, p: Array, phase: Phases, held: bool, prior: tuple[Array, Array] | None = None
) -> Array:
    """The track of least squares over the frames used, by Levenberg's and Marquardt's way."""
    used = phase != UNUSED
    t, y, part, g = film.t_s[used], film.y_m[used], phase[used], film.gravity_m_s2
    nuisances, features = is_free(film, p, held)
    free = np.flatnonzero(nuisances | features)
    usual, tight = _prior(film, p) if prior is None else prior
    loose = tight[free]
    sigma = deviation(film, derivatives(p, t, part, g), used)

    def left(q: Array) -> Array:
        return np.concatenate([(y - heights(q, t, part, g)) / sigma, loose * (usual - q)[free]])

    now, damping = left(p), 1e-6
    for _ in range(TURNS):
        slopes = derivatives(p, t, part, g)[:, free] / sigma[:, None]
        slopes = np.vstack([slopes, np.diag(loose)])
        normal, gradient = slopes.T @ slopes, slopes.T @ now
        gained = 0.0
        while damping < 1e8 and not gained:
            new = p.copy()
            sizes = np.diag(normal)
            ridge = np.diag(damping * sizes + 1e-14 * sizes.max())
            new[free] += np.linalg.solve(normal + ridge, gradient)
            new[1] = max(new[1], 0.2 * p[1])
            new[len(HEAD) :: 3] = np.maximum(new[len(HEAD) :: 3], 0.2 * p[len(HEAD) :: 3])
            after = left(new)
            gained = max(float(now @ now - after @ after), 0.0)
            damping *= 0.1 if gained else 10.0
        if not gained:
            break
        p, now = new, after
        if gained < 1e-4:
            break
    return p


def settled_about(film: Film, found: Track, usual: Array, loose: Array) -> Track:
    """A film's rows at the track that fits best near features ``usual`` (numbers,), from which it
    is as far as ``loose`` (numbers,) says; instants, speeds and ratios are free.

    Of the features that a film hardly tells, its own best track has them wrong by so much that rows
    of the others, linear there, are off; those that films tell together are nearer.
    """
    p = np.where(np.isfinite(loose), usual, found.p)
    phase = found.phase
    for _ in range(2):
        p = _least(film, p, phase, found.held, (usual, 1.0 / loose))
    return replace(reduced(film, p, phase, found.held), mistaken=found.mistaken)


def _cost(film: Film, p: Array, held: bool) -> float:
    """How badly a track fits all frames: bounded, and the later ones counting little."""
    t, g = film.t_s, film.gravity_m_s2
    phase, _ = phases(film, p)
    rises = rises_of(p, g)
    end, level = (rises[-1, 6], p[2]) if len(rises) else (np.inf, 0.0)
    top_s = fall_of(p, g)[0]
    # each frame in the phase that it would have without any margin
    whole = np.where((t < top_s) & (held | (phase == UNUSED)), HELD, FALL)
    levelled = p if held else np.concatenate([p[:3], [_level(p, g)], p[4:]])
    for j in range(len(rises)):
        whole[t >= rises[j, 0]] = RISE + j
    y = heights(levelled, t, whole, g)
    sigma = np.broadcast_to(film.sigma_y_m * np.asarray(film.relative), len(t)).copy()
    weight = np.ones(len(t))
    if len(rises):
        later = t > end
        speed, ratio = np.sqrt(p[len(HEAD)]) * p[1], p[len(HEAD)]
        faster = speed * np.sqrt(ratio)
        y[later] = [bouncing(float(since), faster, ratio, g) + level for since in t[later] - end]
        sigma[later] = np.hypot(sigma[later], 0.005 * p[1] + 0.025 * p[1] ** 2 / g)
        weight[later] = LATER
    squares = np.minimum(((film.y_m - y) / sigma) ** 2, CAP)
    # frames beside an event may be on its other side
    squares[(phase == UNUSED) & (t <= end)] *= LATER
    names = names_of(p)
    loose = sum((p[k] / LOOSE[n]) ** 2 for k, n in enumerate(names) if n in ("h", "b", "u", "a"))
    return float(np.sum(weight * squares) + loose)


def _level(p: Array, g: float) -> float:
    """The feature h of a body held where the fall is highest."""
    return float((fall_of(p, g)[1] - p[2]) * 2.0 * g / p[1] ** 2 - 1.0)


def _bounced_on(film: Film, best: Settled, bounces: int) -> Settled:
    """The track with further bounces, as many as are filmed well, up to ``bounces`` in all."""
    for _ in range(1, bounces):
        more = np.concatenate([best.p, best.p[-3:]])
        landing = rises_of(best.p, film.gravity_m_s2)[-1, 6]
        if (film.t_s > landing).sum() < LEAST_HELD:
            break
        found = _settled(film, more, 1)
        if found is None or not _goes_on(film, found):
            break
        best = found
    return best


def _goes_on(film: Film, found: Settled) -> bool:
    """Whether the last bounce of a track has frames, and they lie as near to it as the others."""
    used = found.phase != UNUSED
    predicted = heights(found.p, film.t_s, found.phase, film.gravity_m_s2)
    squares = (film.y_m - predicted) ** 2
    last = found.phase == found.phase.max()
    rises = (len(found.p) - len(HEAD)) // len(BOUNCE)
    if found.phase.max() != RISE + rises - 1 or last.sum() < LEAST_HELD:
        return False
    if predicted[last].max() - found.p[2] < LEAST_RISE * film.sigma_y_m:
        return False
    return bool(squares[last].mean() < CLEAR * max(squares[used & ~last].mean(), film.sigma_y_m**2))


def _starts(film: Film) -> list[Array]:
    """Tracks to begin from: the best three instants of the impact that differ."""
    found = guesses(film, film.gravity_m_s2, LOOSE_GRAVITY)
    chosen: list[Guess] = []
    for each in found:
        if all(abs(each.t_s - other.t_s) > 0.01 for other in chosen):
            chosen.append(each)
        if len(chosen) == 3 or each.cost > 4.0 * found[0].cost + 10.0 * RIVAL:
            break
    g = film.gravity_m_s2
    return [
        np.array([each.t_s, each.before_m_s, each.floor_m, 0.0, b, 0.0, each.ratio, b, 0.0])
        for each, b in ((each, np.log(each.gravity_m_s2 / g)) for each in chosen)
    ]


def _fall_alone(film: Film) -> Settled | None:
    """The best track without an impact: held, perhaps, and then a parabola up to the last frame."""
    t, y, g = film.t_s, film.y_m, film.gravity_m_s2
    release = np.linspace(4.0 * t[0] - 3.0 * t[-1], t[-1] - 0.02, 120)
    fallen = 0.5 * g * np.maximum(t - release[:, None], 0.0) ** 2
    residual = y + fallen
    level = residual.mean(axis=1)
    best = int(np.argmin(((residual - level[:, None]) ** 2).sum(axis=1)))
    v = g * max(float(t[-1] - release[best]), 0.0)
    p = np.array([t[-1], v, level[best] - fallen[best, -1], 0.0, 0.0, 0.0])
    return _settled(film, p, 0)
