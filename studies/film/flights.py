"""The free flights of a body in its track, the impacts between them, and so the drops of a film.

In flight a height is a parabola of one downward acceleration, that of gravity in pixels, whatever
scale and rate the film has. It is the acceleration that the most stretches of a track share. A hand
that carries a body may do so for a moment; it does not for long.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise, takewhile

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize_scalar

from ...solver.arrays import Array
from .edge import instants
from .strip import LEVEL_PX

STRETCH_S = 0.05
LEAST_FRAMES, MOST_FRAMES = 4, 40
"""Of the stretches in which an acceleration is looked for."""
SURE = 5.0
"""Standard errors by which a stretch's acceleration differs from none."""
NEAR, LIKE = 3.0, 0.04
"""How near, in standard errors and as a share, an acceleration is that of another stretch."""
OFF = 4.0
"""Standard errors from its parabola beyond which a frame is not of a flight."""
TURNING = 0.1
"""By what share a tip's acceleration after an impact may differ from gravity, since it turns."""
LEAST_FALL_PX = 4.0
HELD_S = 0.25
"""How long before a release frames of the body held are kept."""
FEW = 8
"""Frames about a release that may be the last in which the body is held."""
SHARED = 0.03
"""By what share a fall's acceleration may differ from that of the flights after it."""
TURNED = 0.01
"""The same, once it is known which frames belong to which flight."""
MOST_CUT, CUT_COSTS = 6, 6.0
"""How many frames at a drop's end may be left out, and by how much each has to lower the sum of
squares."""
TOUCHING_S = 1e-3
"""About how long a body touches: a frame so near to an impact may show it."""
BENT = 6e-4
"""About what a lens that is off by 0.2 %, or the air about a light ball, bends a fall from a
parabola by, as a share of the fall."""
FAR_PX, FAR_SIGMAS = 30.0, 300.0
"""How far a body flies that neither is let go in view nor bounces."""
HAND = 1.3
"""By what factor an acceleration without an impact may differ from gravity, where that is about
known: a hand may hide a part of the length that tells it."""
MOST_KEPT = 1.5
"""What share of its speed a body seems to keep at most: whole pixels hide a part of a fall."""
LEAST_PAIRS, UNSEEN = 10, 0.3
"""How many pairs of frames tell a correlation of their errors, and its value if fewer are there."""
TINY = 1e-300
"""Instead of zero, where something is divided by it."""
SPEED_PX = 0.02
"""Of what a body moves from frame to frame, that its place in a frame is unsure by."""


@dataclass(frozen=True)
class Flight:
    """A parabola: height, speed and downward acceleration at the time ``t_s``, upward, in px and
    s."""

    t_s: float
    height: float
    speed: float
    gravity: float

    def at(self, t_s: Array | float) -> Array:
        """Heights in px."""
        since = np.asarray(t_s, dtype=float) - self.t_s
        return np.asarray(self.height + self.speed * since - 0.5 * self.gravity * since**2)

    def speed_at(self, t_s: Array | float) -> Array:
        """Upward speeds in px/s."""
        return np.asarray(self.speed - self.gravity * (np.asarray(t_s, dtype=float) - self.t_s))

    @property
    def top_s(self) -> float:
        """When it is highest."""
        return self.t_s + self.speed / self.gravity


@dataclass(frozen=True)
class Stretch(Flight):
    """A flight as it is found in a track: in the frames ``first`` to ``last``."""

    first: int
    last: int


@dataclass(frozen=True)
class Drop:
    """A drop: its flights one after the other, the impacts between and after them.

    ``first`` and ``last`` are the frames that belong to it, those before the release in which the
    body is held still included. The first flight is the fall; where it is ``let_go`` in view, it
    begins with the release. ``impact_s`` (impacts,) are instants, ``floor`` is the surface's height
    in px, zero where nothing bounces. ``restitution_error`` (impacts,), ``gravity_error`` in px/s²
    and ``floor_error`` in px are standard errors, and ``floor_with_gravity`` is their correlation,
    once `settled` knows them.
    """

    first: int
    last: int
    let_go: bool
    flights: tuple[Flight, ...]
    impact_s: Array
    floor: float
    restitution_error: Array | None = None
    gravity_error: float | None = None
    floor_error: float = 0.0
    floor_with_gravity: float = 0.0

    @property
    def frames(self) -> NDArray[np.int64]:
        """Numbers of its frames."""
        return np.arange(self.first, self.last + 1)

    @property
    def release_s(self) -> float | None:
        """When the body is let go; None where that is not filmed."""
        return self.flights[0].t_s if self.let_go else None

    @property
    def held(self) -> float | None:
        """The height in px at which it is held before; None where that is not filmed."""
        return self.flights[0].height if self.let_go else None

    def phase(self, t_s: Array) -> NDArray[np.int64]:
        """Of which flight instants are: 0 the fall, 1 the first after an impact; -1 held."""
        phase = np.searchsorted(self.impact_s, t_s)
        return np.where(t_s < self.flights[0].t_s, -1, phase) if self.let_go else phase

    def speed(self, t_s: Array) -> Array:
        """Upward speeds in px/s."""
        return self._of_flights(t_s, [each.speed_at(t_s) for each in self.flights], 0.0)

    def height(self, t_s: Array) -> Array:
        """Heights in px of hold and parabolas."""
        return self._of_flights(t_s, [each.at(t_s) for each in self.flights], self.held or 0.0)

    def _of_flights(self, t_s: Array, values: Sequence[Array], held: float) -> Array:
        phase = np.minimum(self.phase(t_s), len(self.flights) - 1)
        return np.where(phase < 0, held, np.choose(np.maximum(phase, 0), values))

    @property
    def gravity(self) -> float:
        return self.flights[0].gravity

    @property
    def restitution(self) -> Array:
        """Speed after each impact over that before it (impacts,)."""
        impacts = zip(map(float, self.impact_s), pairwise(self.flights), strict=False)
        return np.array([-after.speed_at(t) / before.speed_at(t) for t, (before, after) in impacts])

    def is_clear(self, t_s: Array, exposure_s: float) -> NDArray[np.bool_]:
        """Whether no impact blurs frames at times (frames,)."""
        near = 0.5 * exposure_s + TOUCHING_S
        return np.all(np.abs(t_s[:, None] - self.impact_s) > near, axis=1)


@dataclass(frozen=True)
class Track:
    """Heights (frames,) upward and their standard errors in px, at times in s.

    A frame's exposure lasts ``exposure_s``, and its time is the middle of that. In the frames whose
    numbers are in ``through`` an impact lies in the exposure, and the height is the mean over it.
    """

    t_s: Array
    height: Array
    sigma: Array
    exposure_s: float = 0.0
    through: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=int))

    @cached_property
    def frame_s(self) -> float:
        """From a frame to the next."""
        return float(np.median(np.diff(self.t_s)))

    @property
    def stretch(self) -> int:
        """How many frames a stretch has in a film that plays as fast as it was taken."""
        return int(np.clip(round(STRETCH_S / self.frame_s), LEAST_FRAMES, MOST_FRAMES))

    def clear(self, drop: Drop) -> NDArray[np.int64]:
        """Numbers of a drop's frames that no impact blurs."""
        own = drop.frames
        return own[drop.is_clear(self.t_s[own], self.exposure_s)]


def drops_of(track: Track, gravity: float | None = None) -> list[Drop]:
    """The drops in a track.

    Where none is seen, longer stretches are looked at: a film may be played slower than it was
    taken. Last, where ``gravity`` is about known in px/s², shorter ones, down to three frames.
    """
    size = track.stretch
    found = _drops_of(track, size, gravity_of(track, size), gravity)
    while not found and 2 * size <= min(MOST_FRAMES, len(track.t_s)):
        size *= 2
        found = _drops_of(track, size, gravity_of(track, size), gravity)
    size = track.stretch
    while not found and gravity is not None and size >= LEAST_FRAMES:
        size = max(3 * size // 4, LEAST_FRAMES - 1)
        found = _drops_of(track, size, gravity, gravity)
    return found


def _drops_of(track: Track, size: int, gravity: float | None, known: float | None) -> list[Drop]:
    if gravity is None:
        return []
    chains: list[list[Stretch]] = []
    for flight in _flights(track, gravity, size):
        if chains and _impact(chains[-1][-1], flight, track) is not None:
            chains[-1].append(flight)
        else:
            chains.append([flight])
    drops = [_drop(chain, track, known) for chain in chains]
    return [drop for drop in drops if drop is not None]


@dataclass(frozen=True)
class Known:
    """What is known of gravity in px/s² and of the surface's height in px from elsewhere, each with
    its standard error."""

    gravity: tuple[float, float] | None = None
    floor: tuple[float, float] | None = None


@dataclass(frozen=True)
class Turning:
    """How a body turns: by which ``shares`` (impacts,) its end's acceleration after each impact
    differs from gravity, their standard ``errors``, and how much lower than the middle of its end
    the ``corner`` (impacts,) is that touches, in px."""

    shares: Array
    errors: Array
    corner: Array


def settled(
    drops: Sequence[Drop],
    track: Track,
    turned: float = TURNED,
    *,
    known: Known | None = None,
    turnings: Sequence[Turning] | None = None,
) -> list[Drop]:
    """The drops once more, each by all its frames that no impact blurs, at once: flights begin and
    end at one surface, and their accelerations are that of the fall to within a share ``turned``,
    by which a bristle's turning changes it.

    ``known`` is what is known besides, and ``turnings`` how each drop's body turns, where that is
    seen.
    """
    if turnings is None:
        turnings = [
            Turning(np.zeros(n), np.full(n, turned), np.zeros(n))
            for n in (len(drop.impact_s) for drop in drops)
        ]
    return [_settled(*each, track, known) for each in zip(drops, turnings, strict=True)]


def _settled(drop: Drop, turning: Turning, track: Track, known: Known | None) -> Drop:
    if not len(drop.impact_s):
        return drop
    # at its end a hand may already hold what flies: frames go that the rest contradicts
    tried = [
        _Joint(replace(drop, last=drop.last - cut), track, turning, known or Known()).solved()
        for cut in range(MOST_CUT + 1 if known else 1)
    ]
    costs = [square + CUT_COSTS * cut for cut, (_, square) in enumerate(tried)]
    return tried[int(np.argmin(costs))][0]


class _Joint:
    """Least squares of a whole drop.

    Its numbers are the gravity of the fall, the surface, the height that the body is held at (or,
    where no release is filmed, the speed of the first impact), the instants of impacts and of the
    landing after the last, and by which share each further flight's acceleration differs. Between
    two instants the height over the surface is g/2 (t - t1) (t2 - t).
    """

    def __init__(self, drop: Drop, track: Track, turning: Turning, known: Known) -> None:
        self.drop, self.turning, self.known, self.n = drop, turning, known, len(drop.impact_s)
        fall, last = drop.flights[0], drop.flights[-1]
        # where it never was above the surface, its top
        above = float(last.at(last.top_s)) - drop.floor
        landing = last.top_s + float(np.sqrt(max(2.0 * above / last.gravity, 0.0)))
        own, exposure_s = drop.frames, track.exposure_s
        own = own[np.isin(own, track.through) | drop.is_clear(track.t_s[own], exposure_s)]
        own = own[track.t_s[own] < landing - 0.5 * exposure_s - TOUCHING_S]
        self.own, self.through = own, np.isin(own, track.through)
        self.t, self.y, self.sigma = track.t_s[own], track.height[own], track.sigma[own]
        self.exposed = self.t[self.through, None] + instants(exposure_s)
        # a body that is held lies on the same pixels in all frames, which so tell as much as one
        held = drop.phase(self.t) < 0
        self.sigma[held] *= np.sqrt(max(held.sum(), 1.0))
        start = fall.height if drop.let_go else -float(fall.speed_at(drop.impact_s[0]))
        self.p = np.array(
            [fall.gravity, drop.floor, start, *drop.impact_s, landing, *np.zeros(self.n)]
        )
        self.scale = np.array(
            [0.01 * fall.gravity, 0.1, 0.1, *np.full(self.n + 1, 1e-3), *np.full(self.n, 0.01)]
        )

    def drop_of(self, p: Array) -> Drop:
        """The drop of the numbers ``p``."""
        g, start = p[0], p[2]
        at, shares = p[3 : 4 + self.n], p[4 + self.n :]
        floor = p[1] + self.turning.corner[[*range(self.n), -1]]
        if self.drop.let_go:
            release = at[0] - np.sqrt(2.0 * max(start - floor[0], 1e-9) / max(g, 1e-9))
            flights = [Flight(float(release), float(start), 0.0, float(g))]
        else:
            flights = [Flight(float(at[0]), float(floor[0]), float(-start), float(g))]
        for k in range(self.n):
            bend, lasts = float(g * (1.0 + shares[k])), float(at[k + 1] - at[k])
            up = 0.5 * bend * lasts + float(floor[k + 1] - floor[k]) / max(lasts, 1e-9)
            flights.append(Flight(float(at[k]), float(floor[k]), up, bend))
        return replace(self.drop, flights=tuple(flights), impact_s=at[: self.n], floor=float(p[1]))

    def left(self, scaled: Array) -> Array:
        """What frames and the shared gravity leave, over their errors."""
        p = self.p + scaled * self.scale
        drop = self.drop_of(p)
        value = drop.height(self.t)
        value[self.through] = drop.height(self.exposed).mean(axis=1)
        told = zip(p[:2], (self.known.gravity, self.known.floor), strict=True)
        return np.concatenate(
            [
                (self.y - value) / self.sigma,
                (p[4 + self.n :] - self.turning.shares) / self.turning.errors,
                [(number - each[0]) / each[1] for number, each in told if each is not None],
            ]
        )

    def solved(self) -> tuple[Drop, float]:
        """The drop of least squares, and their sum; as it was where there is none."""
        if len(self.t) < self.n + 3:
            return self.drop, np.inf
        found = least_squares(self.left, np.zeros(len(self.p)), loss="soft_l1", f_scale=3.0)
        p = self.p + found.x * self.scale
        if not np.isfinite(p).all() or p[0] <= 0.0 or (np.diff(p[3 : 4 + self.n]) <= 0.0).any():
            return self.drop, np.inf
        drop = self.drop_of(p)
        phase = drop.phase(self.t)
        # where no frame shows the last flight, or frames do not hold the rest
        if phase.max() < self.n or not is_about(drop.gravity, self.drop.gravity):
            return self.drop, np.inf
        square, alike = spread_of(found.fun[: len(self.t)], phase, 4 + self.n)
        found.jac[: len(self.t)] /= np.sqrt(max(square, 1.0) * alike)
        covariance = np.linalg.pinv(found.jac.T @ found.jac) * np.outer(self.scale, self.scale)
        slopes = np.stack(
            [
                (self.drop_of(p + step).restitution - drop.restitution) / step.max()
                for step in np.diag(1e-4 * self.scale)
            ],
            axis=1,
        )
        drop = replace(
            drop,
            last=int(self.own[-1]),
            restitution_error=np.sqrt(np.einsum("ri,ij,rj->r", slopes, covariance, slopes)),
            gravity_error=float(np.sqrt(covariance[0, 0])),
            floor_error=float(np.sqrt(covariance[1, 1])),
            floor_with_gravity=float(
                covariance[0, 1] / max(np.sqrt(covariance[0, 0] * covariance[1, 1]), TINY)
            ),
        )
        return drop, float(found.fun @ found.fun)


def spread_of(left: Array, phase: NDArray[np.int64], numbers: int) -> tuple[float, float]:
    """The mean square of the errors of frames in flight, and by how much larger the variance of
    what frames tell together is than were they independent. ``left`` (frames,) is what a fit of so
    many ``numbers`` leaves, over their standard errors.

    Neighbours err alike, by the background and by compression, some for many frames. So
    correlations are summed up to the lag where two in a row are no longer beyond their standard
    error (after the initial positive sequence of Geyer, Statist. Sci. 7 (1992) 473), as far as the
    fit leaves them. What is smooth the fit takes for its own: of each number as much as so many
    independent frames have, and as much of what neighbours share.
    """
    square, shared = float(np.mean(left**2)), []
    for lag in range(1, max(len(left) // (2 * numbers), 1) + 1):
        together = (phase[lag:] == phase[:-lag]) & (phase[lag:] >= 0)
        if together.sum() < LEAST_PAIRS:
            break
        shared.append(float(np.mean(left[lag:][together] * left[:-lag][together])))
    taken, alike = 0.0, 1.0
    for _ in range(4):
        rho = [(each + taken) / max(square + taken, TINY) for each in shared] or [UNSEEN]
        first = float(np.clip(rho[0], 0.0, 0.9))
        two = [a + b for a, b in zip(rho[1::2], rho[2::2], strict=False)]
        several = sum(takewhile(lambda each: each > math.sqrt(2.0 / len(left)), two))
        alike = max((1.0 + first) / (1.0 - first), 1.0 + 2.0 * (first + several))
        taken = min(numbers * alike / len(left) * (square + taken), square)
    return square + taken, alike


def gravity_of(track: Track, size: int | None = None) -> float | None:
    """The downward acceleration in px/s² that most stretches of ``size`` frames share; None where
    none is sure."""
    bends, errors = _stretches(track, size or track.stretch)
    sure = (bends > SURE * errors) & np.isfinite(bends)
    if not sure.any():
        return None
    some, error = bends[sure], errors[sure]
    near = np.abs(some[:, None] - some) < NEAR * error + LIKE * some[:, None]
    # what is surer counts more: a sharp value that many share is no chance
    count = near @ np.minimum(some / error, 50.0)
    best = near[np.argmax(count)]
    return float(np.average(some[best], weights=error[best] ** -2.0))


def _stretches(track: Track, size: int) -> tuple[Array, Array]:
    """Downward accelerations of stretches of ``size`` frames, and their standard errors; not a
    number where no parabola passes."""
    if len(track.t_s) < size:
        return np.zeros(0), np.zeros(0)
    t, y, s = (sliding_window_view(each, size) for each in (track.t_s, track.height, track.sigma))
    # counted in frames, lest the powers differ by much
    since = (t - t.mean(axis=1, keepdims=True)) / track.frame_s
    design = np.stack([np.ones_like(since), since, -0.5 * since**2], axis=2) / s[:, :, None]
    inverse = np.linalg.inv(np.einsum("nki,nkj->nij", design, design))
    found = np.einsum("nij,nkj,nk->ni", inverse, design, y / s)
    left = y / s - np.einsum("nki,ni->nk", design, found)
    square = (left**2).sum(axis=1) / max(size - 3, 1)
    bad = (square > 16.0) | (np.diff(since, axis=1).max(axis=1) > 4.0)
    errors = np.sqrt(inverse[:, 2, 2] * np.maximum(square, 1.0))
    return np.where(bad, np.nan, found[:, 2]) / track.frame_s**2, errors / track.frame_s**2


def _flights(track: Track, gravity: float, size: int) -> list[Stretch]:
    """Stretches of that acceleration, each as long as its parabola goes on."""
    bends, errors = _stretches(track, size)
    near = np.abs(bends - gravity) < NEAR * errors + TURNING * gravity
    # a stretch too short to tell that gravity from none is like a flight whatever it does
    seeds = np.flatnonzero(near & np.isfinite(bends) & (OFF * errors < gravity))
    seeds = seeds[np.argsort(errors[seeds] + np.abs(bends[seeds] - gravity), kind="stable")]
    taken: NDArray[np.bool_] = np.zeros(len(track.t_s), dtype=bool)
    flights = []
    for seed in seeds:
        if taken[seed : seed + size].any():
            continue
        flight = _grown(
            _fitted(track, int(seed), int(seed) + size - 1, gravity), track, gravity, taken
        )
        if flight is not None:
            taken[flight.first : flight.last + 1] = True
            flights.append(flight)
    return sorted(flights, key=lambda each: each.first)


def _grown(
    flight: Stretch, track: Track, gravity: float, taken: NDArray[np.bool_]
) -> Stretch | None:
    """A flight with the frames beside it that lie on its parabola; None where few do."""
    t_s, height, sigma, frame = track.t_s, track.height, track.sigma, track.frame_s
    for _ in range(3):
        before = flight
        for step, at in ((-1, flight.first - 1), (1, flight.last + 1)):
            misses = 0
            while 0 <= at < len(t_s) and not taken[at] and misses < 2:
                if abs(t_s[at] - t_s[at - step]) > 6.0 * frame:
                    break
                unsure = np.hypot(sigma[at], SPEED_PX * abs(flight.speed_at(t_s[at])) * frame)
                near = abs(height[at] - flight.at(t_s[at])) < OFF * unsure
                first, last = min(flight.first, at), max(flight.last, at)
                grown = _fitted(track, first, last, gravity) if near else flight
                # a body that is held before a flight would flatten the parabola, frame by frame
                least = min(flight.gravity, (1.0 - TURNING) * gravity)
                if near and (step > 0 or grown.gravity >= least):
                    flight, misses = grown, 0
                else:
                    misses += 1
                at += step
        if before is flight:
            break
    own = slice(flight.first, flight.last + 1)
    far = np.abs(height[own] - flight.at(t_s[own]))
    return flight if np.median(far / sigma[own]) < OFF else None


def _fitted(track: Track, first: int, last: int, gravity: float) -> Stretch:
    """The parabola of frames ``first`` to ``last``, its acceleration about ``gravity``."""
    t, y, s = (each[first : last + 1] for each in (track.t_s, track.height, track.sigma))
    middle = float(t.mean())
    design = np.vander(t - middle, 3, increasing=True) * [1.0, 1.0, -0.5]
    weight: Array = np.ones(len(t))
    solution: Array = np.zeros(3)
    for _ in range(3):
        weighted = np.vstack(
            [design * (weight / s)[:, None], [0.0, 0.0, 1.0 / (TURNING * gravity)]]
        )
        right = np.append(y * weight / s, 1.0 / TURNING)
        solution = np.linalg.lstsq(weighted, right, rcond=None)[0]
        left = np.abs(y - design @ solution) / s
        usual = max(1.4826 * float(np.median(left)), 1.0)
        weight = np.sqrt(np.minimum(1.0, 3.0 * usual / np.maximum(left, 1e-9)))
    level, speed, bend = (float(each) for each in solution)
    return Stretch(middle, level, speed, bend, first, last)


def _impact(before: Stretch, after: Stretch, track: Track) -> float | None:
    """Instant of the impact between two flights; None where there is none.

    Frames that the impact blurs are of neither. The body must come down and go up.
    """
    reach = 1.5 * track.frame_s
    low, high = track.t_s[before.last] - reach, track.t_s[after.first] + reach
    if high - low > 7.0 * track.frame_s:
        return None
    apart = before.height - float(after.at(before.t_s))
    faster = before.speed - float(after.speed_at(before.t_s))
    root = faster**2 - 2.0 * (after.gravity - before.gravity) * apart
    closing = math.sqrt(max(root, 0.0)) - faster
    if root < 0.0 or closing == 0.0:
        return None
    # the gap closes at this one of both roots, where `before` comes down and `after` goes up
    t = before.t_s + 2.0 * apart / closing
    down, up = float(before.speed_at(t)), float(after.speed_at(t))
    return t if low <= t <= high and 0.0 < up < -MOST_KEPT * down else None


def _drop(chain: list[Stretch], track: Track, known: float | None) -> Drop | None:
    """The drop of flights with impacts between them; None where nothing falls. Gravity is about
    ``known`` in px/s² where it is."""
    gravity = float(
        np.average([f.gravity for f in chain], weights=[f.last - f.first for f in chain])
    )
    let_go = _let_go(chain[0], gravity, track)
    if let_go is None or let_go[1] > chain[0].first:
        # thrown up in view, or the fall before it has too few frames for a flight of its own
        before = _fall_before(chain[0], gravity, track)
        if before is not None:
            chain = [before, *chain]
            let_go = _let_go(before, gravity, track)
    first = chain[0].first
    if let_go is not None:
        fall, first = let_go
        chain = [fall, *chain[1:]]
    found = [_impact(before, after, track) for before, after in pairwise(chain)]
    impact_s = np.array([each for each in found if each is not None])
    if len(impact_s) < len(found):
        return None
    fall, error = chain[0], float(np.median(track.sigma))
    begin_s, end_s = float(track.t_s[fall.first]), float(track.t_s[fall.last])
    top = fall.at(float(np.clip(fall.top_s, begin_s, end_s)))
    fallen = float(top - fall.at(impact_s[0] if len(impact_s) else end_s))
    if fallen < max(LEAST_FALL_PX, 3.0 * SURE * error):
        return None
    if not len(impact_s):
        # without an impact it may be a hand that moves the body: it has to be let go suddenly, or
        # to follow its parabola so far that no hand does
        bent = 0.5 * fall.gravity * (end_s - begin_s) ** 2
        far = fallen > max(FAR_PX, FAR_SIGMAS * error) and bent > 0.25 * fallen
        if fall.last - fall.first < LEAST_FRAMES or not (
            let_go is not None or (far and _is_parabola(fall, track))
        ):
            return None
        if known is not None and not is_about(fall.gravity, known):
            return None
    bottoms = [float(f.at(float(t))) for f, t in zip(chain, impact_s, strict=False)]
    floor = float(np.median(bottoms or [0.0]))
    return Drop(first, chain[-1].last, let_go is not None, tuple(chain), impact_s, floor)


def is_about(acceleration: float, gravity: float) -> bool:
    """Whether an acceleration may be gravity, which is about known."""
    return gravity / HAND < acceleration < HAND * gravity


def _is_parabola(fall: Stretch, track: Track) -> bool:
    """Whether a third and a fourth power make heights no better than lens and air bend a fall; the
    arc of a hand gains more."""
    own = slice(fall.first, fall.last + 1)
    t, y = track.t_s[own] - fall.t_s, track.height[own]
    weight = 1.0 / np.hypot(track.sigma[own], BENT * np.ptp(y))
    squares = [np.polyfit(t, y, power, w=weight, full=True)[1].sum() for power in (2, 4)]
    usual = max(squares[1] / max(len(t) - 5, 1), 1.0)
    return bool(squares[0] - squares[1] < OFF**2 * usual)


def _fall_before(rise: Stretch, gravity: float, track: Track) -> Stretch | None:
    """The fall from a hand that holds still to a rise, through few frames or none; None where the
    frames before the rise are not so."""
    for fall in _falls(range(rise.first - FEW, rise.first), rise.first - 1, gravity, track):
        impact_s = _impact(fall, rise, track)
        if impact_s is not None and impact_s - fall.t_s >= 0.5 * track.frame_s:
            return fall
    return None


def _let_go(fall: Stretch, gravity: float, track: Track) -> tuple[Stretch, int] | None:
    """The fall as one from a hand that holds still, and the first frame in which it does; None
    where the film does not show that."""
    start = int(np.searchsorted(track.t_s, fall.top_s))
    tried = range(max(fall.first - 1, start - FEW), min(fall.last, start + FEW) + 1)
    falls = _falls(tried, fall.last, gravity, track)
    if not falls:
        return None
    best = falls[0]
    begin = max(int(np.searchsorted(track.t_s, best.t_s)) - 1, 0)
    off = np.abs(track.height[:begin] - best.height)
    moved = off >= np.maximum(OFF * track.sigma[:begin], LEVEL_PX)
    away = np.flatnonzero(moved | (best.t_s - track.t_s[:begin] >= HELD_S))
    first = int(away[-1]) + 1 if len(away) else 0
    # what flies over its top is nearly still for a moment, too
    risen = 0.5 * best.gravity * (best.t_s - float(track.t_s[first])) ** 2
    return (best, first) if risen > max(1.0, 6.0 * float(np.median(track.sigma))) else None


def _falls(held: range, last: int, gravity: float, track: Track) -> list[Stretch]:
    """Falls from rest after one of the frames ``held``, through the frames up to ``last``, the one
    that fits best first; those that do not fit are left out."""
    found = [_held_and_let_go(each, last, gravity, track) for each in held if 1 <= each < last]
    good = [each for each in found if each is not None and each[1] <= OFF**2]
    return [fall for fall, _ in sorted(good, key=lambda each: each[1])]


def _held_and_let_go(
    held: int, last: int, gravity: float, track: Track
) -> tuple[Stretch, float] | None:
    """A fall from rest after the frame ``held``, through the frames up to ``last``; and the mean
    square of what it leaves. None where that frame is not held still, or it does not fall so."""
    own = slice(held - 1, last + 1)
    t, y, s = track.t_s[own], track.height[own], track.sigma[own]
    if abs(y[0] - y[1]) >= max(OFF * s[0], LEVEL_PX):
        return None
    weight = s**-2.0

    def let_go(release: float) -> tuple[float, Array]:
        """The mean square that is left, and the level and the acceleration."""
        fallen = -0.5 * np.maximum(t - release, 0.0) ** 2
        middle = float(weight @ fallen) / weight.sum()
        # the acceleration about the gravity that is shared, the level freed of it
        tight = (SHARED * gravity) ** -2.0
        slopes = weight * (fallen - middle)
        bend = (slopes @ y + tight * gravity) / (slopes @ fallen + tight)
        level = float(weight @ y) / weight.sum() - bend * middle
        left = y - level - bend * fallen
        square = float(weight @ left**2) + tight * (bend - gravity) ** 2
        return square / max(len(t) - 2, 1), np.array([level, bend])

    found = minimize_scalar(
        lambda release: let_go(release)[0],
        bounds=(t[0], t[2]),
        method="bounded",
        options={"xatol": 1e-5 * float(t[2] - t[0])},
    )
    square, (level, bend) = let_go(float(found.x))
    return Stretch(float(found.x), float(level), 0.0, float(bend), held + 1, last), square
