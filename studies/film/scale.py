"""How long a pixel is, from a length in view; and what gravity says of scale and clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...solver.arrays import Array
from .flights import TURNED, Drop, Known, Turning, settled, spread_of
from .tracker import BALL_TURNED, Tracked

LENS = 0.002
"""Share by which a lens' distortion and a body beside the plane of its fall change a scale."""
EDGES_PX = 0.15
"""By how much both edges of a body may seem farther apart than they are: light spreads."""
CLOCK = 5e-4
"""Share by which a clock and the air change what falls show of gravity: a ball of steel that falls
300 mm lands with 1.3e-3 less energy, and its parabolas show a quarter of that."""
AGREEING = 2.6
"""Standard errors within which gravity and a length in view agree on the scale."""
LEAST_SHARE, MOST_SHARE = 1e-3, 0.05
"""How sure it may be by which share a bristle that turns falls more slowly."""
FRAMES_WORTH = 8
"""How many frames' scatter about a parabola tells as much of errors as is known before."""
MOST_FLIGHTS = 1000
"""Of a drop: they are numbered apart from those of the next."""
SURELY = 2.6
LEAN_FRAMES = 6
"""About an impact, whose median lean says which corner of the end touches."""
SURFACE_PX = 0.04
"""By how much an end at rest and one that comes down fast may be seen to differ: common to all
frames of a film."""
GIVEN = 0.001
"""Share by which a given scale, which holds in the middle of a picture, is off elsewhere."""
TOUCH_S = 1.5e-4
"""By how much it is unsure how long a body touches, which a film does not show."""
DIFFERENT = 0.03
"""Share by which two scales differ visibly, whatever their errors."""
ROUND_RATES = (24, 25, 30, 50, 60, 100, 120, 200, 240, 480, 500, 960, 1000)


@dataclass(frozen=True)
class Scale:
    """Millimetres a pixel, the share by which it may be off (a standard error), and its source.

    ``by_length`` is the scale of the length in view over this one, and ``length_error`` its own
    standard error as a share: where gravity was used as well, they are what does not rest on it.
    ``gravity`` is with which acceleration things fall by that length alone, in m/s², and its
    standard error. ``with_zero`` is the correlation of the scale's error with that of the zero of
    heights: if gravity seems greater in a film, the surface is taken for lower and a pixel for
    shorter, and both together move a height less than they would each for itself.
    """

    mm_per_px: float
    error: float
    source: str
    by_length: float = 1.0
    length_error: float = 0.0
    gravity: tuple[float, float] | None = None
    with_zero: float = 0.0


def scale_of(track: Tracked, length_mm: float | None, mm_per_px: float | None) -> Scale | None:
    """The scale of a film; None where nothing gives one.

    ``length_mm`` is the length of the bristle, or the diameter of the ball.
    """
    if mm_per_px is not None:
        return Scale(mm_per_px, GIVEN, "--mm-per-px", 1.0, GIVEN)
    seen = track.length[np.isfinite(track.length)]
    if length_mm is None or len(seen) < 3:
        return None
    # a hand that still hides an end makes it shorter in a few frames
    length = float(np.median(seen))
    spread = 1.4826 * float(np.median(np.abs(seen - length))) / np.sqrt(len(seen))
    edges = float(np.hypot(EDGES_PX, track.length_error)) / length
    error = float(np.sqrt((spread / length) ** 2 + edges**2 + LENS**2))
    source = f"the {track.body} in view, {length_mm:g} mm long and {length:.1f} px"
    return Scale(length_mm / length, error, source, 1.0, error)


def weighed(
    track: Tracked, scale: Scale | None, gravity_m_s2: float, length_mm: float | None
) -> tuple[Tracked, Scale | None]:
    """The track and its scale once more, with what gravity says of a pixel where that agrees: a
    fall that is known better has its impacts, and so the surface, in surer places."""
    about = gravity_px(track)
    if scale is None or about is None:
        return track, scale
    turned, turnings = TURNED if track.turn is not None else BALL_TURNED, None
    if track.turn is not None and length_mm is not None:
        # a flight of which it is seen how it turns tells gravity as well as the fall does
        half_s2 = 0.5 * length_mm / scale.mm_per_px / about[0]
        turnings = [_turning(track, drop, half_s2) for drop in track.drops]

    def once_more(known: Known) -> list[Drop]:
        return settled(track.drops, track.track, turned, known=known, turnings=turnings)

    track = replace(track, drops=once_more(Known()))
    track = replace(track, sigma=track.sigma * _scatter(track))
    seen = gravity_px(track) or about
    shown = 1e-3 * scale.mm_per_px * seen[0]
    scale = replace(scale, gravity=(shown, shown * float(np.hypot(seen[1], scale.error))))
    by_fall = 1e3 * gravity_m_s2 / seen[0]
    error = float(np.hypot(seen[1], CLOCK))
    apart = np.log(by_fall / scale.mm_per_px)
    agree = abs(apart) <= AGREEING * np.hypot(error, scale.error)
    g_px = 1e3 * gravity_m_s2 / scale.mm_per_px
    known = Known((g_px, g_px * float(np.hypot(scale.error, CLOCK)))) if agree else Known()
    drops = once_more(known)
    if len(drops) > 1:  # then with the surface that all drops have in common
        drops = once_more(replace(known, floor=floor_of(drops)))
    track = replace(track, drops=drops, sigma=_sigma_held(track, drops))
    if not agree:
        return track, scale
    share = scale.error**2 / (scale.error**2 + error**2)
    better = scale.mm_per_px * float(np.exp(share * apart))
    return track, replace(
        scale,
        mm_per_px=better,
        error=scale.error * error / float(np.hypot(scale.error, error)),
        by_length=scale.mm_per_px / better,
        with_zero=float(np.mean([drop.floor_with_gravity for drop in drops])),
    )


def _sigma_held(track: Tracked, drops: Sequence[Drop]) -> Array:
    """Standard errors of frames in px (frames,), those of a body that is held not less than how far
    it is from where its fall begins: it lies on the same pixels, so all frames are off alike."""
    sigma = track.sigma.copy()
    for drop in drops:
        used = track.used(drop)
        held = used[drop.phase(track.t_s[used]) < 0]
        if drop.held is not None and len(held):
            off = abs(float(np.mean(track.down[held])) + drop.held)
            sigma[held] = np.maximum(sigma[held], off)
    return sigma


def _scatter(track: Tracked) -> float:
    """By how much standard errors are to be larger, as frames in flight scatter about their
    parabolas."""
    parts: list[Array] = [np.zeros(0)]
    phases: list[NDArray[np.int64]] = [np.zeros(0, dtype=int)]
    for number, drop in enumerate(track.drops):
        used = track.used(drop)
        phase = drop.phase(track.t_s[used])
        flying = phase >= 0
        parts.append((track.residual(drop) / track.sigma[used])[flying])
        phases.append(phase[flying] + MOST_FLIGHTS * number)
    left, phase = np.concatenate(parts), np.concatenate(phases)
    numbers = sum(2 * len(drop.flights) for drop in track.drops)
    # not so far off as to be mistaken, of which the rest has its usual share
    robust = 1.4826 * float(np.median(np.abs(left))) if len(left) else 1.0
    near = np.abs(left) < 3.0 * max(robust, 0.2)
    freedom = near.sum() - numbers
    if freedom < 1:
        return 1.0
    square, _ = spread_of(left[near], phase[near], numbers)
    return float(np.sqrt((freedom * square + FRAMES_WORTH) / (freedom + FRAMES_WORTH)))


def _turning(track: Tracked, drop: Drop, half_s2: float) -> Turning:
    """How the lower end of a bristle moves that turns with ω: it falls more slowly by the share
    L/2 ω² over g. ``half_s2`` is L/2 over g."""
    used = track.used(drop)
    phase, shares, errors, corner = drop.phase(track.t_s[used]), [], [], []
    for k, impact_s in enumerate(drop.impact_s):
        spin = spin_of(track, used[phase == k + 1])
        rate, error = (0.0, 0.0) if spin is None else spin
        shares.append(-half_s2 * max(rate**2 - error**2, 0.0))
        unsure = half_s2 * np.hypot(2.0 * rate * error, error**2)
        errors.append(TURNED if spin is None else np.clip(unsure, LEAST_SHARE, MOST_SHARE))
        near = used[np.argsort(np.abs(track.t_s[used] - impact_s))[:LEAN_FRAMES]]
        lean = 0.0 if track.turn is None else float(np.median(track.turn[near]))
        corner.append(0.5 * track.width * abs(np.sin(lean)))
    return Turning(np.array(shares), np.array(errors), np.array(corner))


def of_centre(track: Tracked, drop: Drop, length_px: float) -> Array:
    """Restitutions (impacts,) of the centre of mass: a bristle of uniform mass that leans by θ and
    turns with ω has it L/2 above its end, which is so faster by L/2 ω sin θ."""
    if track.turn is None:
        return drop.restitution
    used = track.used(drop)
    phase, ratios = drop.phase(track.t_s[used]), []
    flights = zip(drop.flights[:-1], drop.flights[1:], drop.impact_s, strict=False)
    for k, (before, after, impact_s) in enumerate(flights):
        speeds = []
        for number, flight in ((k, before), (k + 1, after)):
            own = used[phase == number]
            spin, added = spin_of(track, own), 0.0
            # what a film shows less surely than that it turns is no turn
            if spin is not None and abs(spin[0]) > SURELY * spin[1]:
                middle = float(track.t_s[own].mean())
                lean = float(np.mean(track.turn[own])) + spin[0] * (float(impact_s) - middle)
                added = 0.5 * length_px * spin[0] * np.sin(lean)
            speeds.append(float(flight.speed_at(float(impact_s))) - added)
        ratios.append(-speeds[1] / speeds[0])
    return np.array(ratios)


def spin_of(track: Tracked, own: NDArray[np.int64]) -> tuple[float, float] | None:
    """How fast a bristle turns in frames of one flight, in rad/s, and its standard error; None
    where they do not tell."""
    if track.turn is None or len(own) < 3 or np.ptp(track.t_s[own]) <= 0.0:
        return None
    t, turn = track.t_s[own] - track.t_s[own].mean(), track.turn[own]
    rate = float(t @ turn) / float(t @ t)
    left = turn - turn.mean() - rate * t
    spread = float(np.sqrt(left @ left / max(len(own) - 2, 1)))
    usual = 0.0 if track.sigma_turn is None else float(np.median(track.sigma_turn[own]))
    return rate, max(spread, 0.3 * usual) * 2.0 / float(np.sqrt(t @ t))


def gravity_px(track: Tracked) -> tuple[float, float] | None:
    """Gravity in px/s², and the share by which it may be off (a standard error), from all drops;
    None where none tells it."""
    found = _mean_of([(d.gravity, d.gravity_error) for d in track.drops if d.gravity_error])
    return None if found is None else (found[0], found[1] / found[0])


def doubts_of(track: Tracked, scale: Scale | None, gravity_m_s2: float) -> list[str]:
    """What scale, clock and gravity say of each other where they disagree, in sentences."""
    if scale is None or scale.gravity is None:
        return []
    shown, error = scale.gravity
    ratio = shown / gravity_m_s2
    if abs(ratio - 1.0) < max(3.0 * error / gravity_m_s2, DIFFERENT):
        return []
    rate = 1.0 / track.frame_s
    fitting = rate / np.sqrt(ratio)
    near = min(ROUND_RATES, key=lambda each: abs(np.log(each / fitting)))
    if abs(np.log(near / fitting)) < DIFFERENT < abs(np.log(near / rate)):
        fitting = near
    return [
        f"{track.film.path.name}: things fall here with {shown:.3g} m/s2 instead of "
        f"{gravity_m_s2:g}. Either the film has {fitting:.4g} frames a second, not {rate:.4g} "
        f"(give --fps {fitting:.4g}), or a pixel is {scale.mm_per_px / ratio:.4g} mm, not "
        f"{scale.mm_per_px:.4g} by {scale.source} (give its true length, or --mm-per-px)"
    ]


def touching_px(drops: Sequence[Drop]) -> float:
    """By how much, in px, the height at which flights meet is unsure for how long a body touches:
    parabolas of which one begins later by τ meet lower by τ v v'/(v + v')."""
    bounced = [drop for drop in drops if len(drop.impact_s) and len(drop.flights) > 1]
    speeds = [[abs(float(f.speed_at(d.impact_s[0]))) for f in d.flights[:2]] for d in bounced]
    return max((TOUCH_S * a * b / (a + b) for a, b in speeds if a + b > 0.0), default=0.0)


def floor_of(drops: Sequence[Drop]) -> tuple[float, float] | None:
    """The height in px at which bodies bounce, of all drops of a film, and its standard error; None
    where none bounces."""
    found = _mean_of([(d.floor, d.floor_error or 1.0) for d in drops if len(d.impact_s)])
    return None if found is None else (found[0], float(np.hypot(found[1], SURFACE_PX)))


def _mean_of(values: Sequence[tuple[float, float]]) -> tuple[float, float] | None:
    """The mean of values with standard errors, and its own; None where there is none."""
    if not values:
        return None
    each, errors = np.array(values).T
    weights = errors**-2.0
    mean = float(np.average(each, weights=weights))
    # more scatter than their errors say has a reason that is not known
    square = float(weights @ (each - mean) ** 2) / max(len(each) - 1, 1)
    return mean, float(np.sqrt(max(square, 1.0) / weights.sum()))
