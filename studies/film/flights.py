"""The free flights of a body in its track, the impacts between them, and so the drops of a film.

In flight a height is a parabola of one downward acceleration, that of gravity in pixels, whatever
scale and rate the film has. It is the acceleration that the most stretches of a track share. A hand
that carries a body may do so for a moment; it does not for long.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize_scalar

from ...solver.arrays import Array
from .edge import instants

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
LEVEL_PX = 0.6
"""A hand that holds still moves less than that from one frame to another."""
FEW = 8
"""Frames about a release that may be the last in which the body is held."""
SHARED = 0.03
"""By what share a fall's acceleration may differ from that of the flights after it."""
TURNED = 0.01
"""The same, once it is known which frames belong to which flight."""
MOST_CUT, CUT_COSTS = 6, 6.0
"""How many frames at a drop's end may be left out, and by how much each has to lower the sum of
squares."""
HELD_TELLS = 2.0
"""How many independent frames all those tell in which the body is held."""
TOUCHING_S = 1e-3
"""About how long a body touches: a frame so near to an impact may show it."""
BENT = 6e-4
"""About what a lens that is off by 0.2 %, or the air about a light ball, bends a fall from a
parabola by, as a share of the fall."""
FAR_PX, FAR_SIGMAS = 30.0, 300.0
"""How far a body flies that neither is let go in view nor bounces."""
SPEED_PX = 0.02
"""Of what a body moves from frame to frame, that its place in a frame is unsure by."""


@dataclass(frozen=True)
class Flight:
    """A parabola: frames ``first`` to ``last``, and height, speed and downward acceleration at the
    time ``t_s``, upward, in px and s."""

    first: int
    last: int
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


@dataclass(frozen=True)
class Drop:
    """A drop: its flights one after the other, the impacts between and after them.

    ``first`` and ``last`` are the frames that belong to it, those before the release in which the
    body is held still included; ``release_s`` and the height ``held`` before it are None where they
    are not filmed. ``impact_s`` and ``floor`` (impacts,) are instants and heights in px. The first
    flight is the fall. ``restitution_error`` (impacts,), ``gravity_error`` in px/s² and
    ``floor_error`` in px are standard errors, once `settled` knows them.
    """

    first: int
    last: int
    release_s: float | None
    held: float | None
    flights: tuple[Flight, ...]
    impact_s: Array
    floor: Array
    restitution_error: Array | None = None
    gravity_error: float | None = None
    floor_error: float = 0.0

    def phase(self, t_s: Array) -> NDArray[np.int64]:
        """Of which flight instants (n,) are: 0 the fall, 1 the first after an impact; -1 held."""
        phase = np.searchsorted(self.impact_s, t_s)
        return phase if self.release_s is None else np.where(t_s < self.release_s, -1, phase)

    def speed(self, t_s: Array) -> Array:
        """Upward speeds (n,) in px/s."""
        return self._of_flights(t_s, [each.speed_at(t_s) for each in self.flights], 0.0)

    def height(self, t_s: Array) -> Array:
        """Heights (n,) in px of hold and parabolas."""
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
        return _ratios(self.flights, self.impact_s)


def drops_of(t_s: Array, height: Array, sigma: Array, gravity: float | None = None) -> list[Drop]:
    """The drops in a track: ``height`` (frames,) upward and ``sigma`` in px at times in s.

    Where none is seen, longer stretches are looked at: a film may be played slower than it was
    taken. Last, where ``gravity`` is about known in px/s², flights of three frames are enough.
    """
    size = _frames_of(t_s)
    while True:
        found = _drops_of(t_s, height, sigma, size)
        if found or 2 * size > min(MOST_FRAMES, len(t_s)):
            break
        size *= 2
    if not found and gravity is not None:
        found = _drops_of(t_s, height, sigma, LEAST_FRAMES - 1, gravity)
    return found


def _drops_of(
    t_s: Array, height: Array, sigma: Array, size: int, known: float | None = None
) -> list[Drop]:
    gravity = known or gravity_of(t_s, height, sigma, size)
    if gravity is None:
        return []
    flights = _flights(t_s, height, sigma, gravity, size)
    chains: list[list[Flight]] = []
    for flight in flights:
        if chains and _impact(chains[-1][-1], flight, t_s) is not None:
            chains[-1].append(flight)
        else:
            chains.append([flight])
    drops = [_drop(chain, t_s, height, sigma) for chain in chains]
    return [drop for drop in drops if drop is not None]


def settled(
    drops: Sequence[Drop],
    t_s: Array,
    height: Array,
    sigma: Array,
    exposure_s: float,
    turned: float = TURNED,
    *,
    known: Known | None = None,
    turnings: Sequence[Turning] | None = None,
    through: NDArray[np.bool_] | None = None,
) -> list[Drop]:
    """The drops once more, each by all its frames that no impact blurs, at once: flights begin and
    end at one surface, and their accelerations are that of the fall to within a share ``turned``,
    by which a bristle's turning changes it.

    ``known`` is what is known besides, and ``turnings`` how each drop's body turns, where that is
    seen. In the frames ``through`` (frames,) an impact lies in the exposure, and the height is the
    mean over it.
    """
    through = np.zeros(len(t_s), dtype=bool) if through is None else through
    found, told = [], known or Known()
    for k, drop in enumerate(drops):
        n = len(drop.impact_s)
        turning = (
            Turning(np.zeros(n), np.full(n, turned), np.zeros(n))
            if turnings is None
            else turnings[k]
        )
        if not n:
            found.append(drop)
            continue
        # at its end a hand may already hold what flies: frames go that the rest contradicts
        tried = [
            _Joint(
                replace(drop, last=drop.last - cut),
                t_s,
                height,
                sigma,
                exposure_s,
                through,
                turning,
                told,
            )
            for cut in range(MOST_CUT + 1 if known else 1)
        ]
        best = tried[0].solved(), tried[0].square + 0.0
        for cut, joint in enumerate(tried[1:], start=1):
            if best[1] < 1.3 * len(tried[0].t):
                break
            solved = joint.solved()
            if joint.square + CUT_COSTS * cut < best[1]:
                best = solved, joint.square + CUT_COSTS * cut
        found.append(best[0])
    return found


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


class _Joint:
    """Least squares of a whole drop.

    Its numbers are the gravity of the fall, the surface, the height that the body is held at (or,
    where no release is filmed, the speed of the first impact), the instants of impacts and of the
    landing after the last, and by which share each further flight's acceleration differs. Between
    two instants the height over the surface is g/2 (t - t1) (t2 - t).
    """

    def __init__(
        self,
        drop: Drop,
        t_s: Array,
        height: Array,
        sigma: Array,
        exposure_s: float,
        through: NDArray[np.bool_],
        turning: Turning,
        known: Known,
    ) -> None:
        self.drop, self.turning, self.known, self.n = drop, turning, known, len(drop.impact_s)
        self.square = np.inf
        last, floor = drop.flights[-1], float(np.median(drop.floor))
        landing = _landing(last, floor)
        own = np.zeros(len(t_s), dtype=bool)
        own[drop.first : drop.last + 1] = True
        own &= through | clear_of(drop, t_s, exposure_s)
        own &= t_s < landing - 0.5 * exposure_s - TOUCHING_S
        self.frames = np.flatnonzero(own)
        self.t, self.y, self.sigma = t_s[own], height[own], sigma[own].copy()
        self.through, self.u = through[own], instants(exposure_s)
        if drop.release_s is not None:
            # a body that is held lies on the same pixels in all frames, and they all err alike
            held = self.t < drop.release_s
            self.sigma[held] *= np.sqrt(max(held.sum() / HELD_TELLS, 1.0))
        fall = drop.flights[0]
        start = drop.held if drop.held is not None else -float(fall.speed_at(drop.impact_s[0]))
        self.p = np.concatenate(
            [[fall.gravity, floor, start], [*drop.impact_s, landing], np.zeros(self.n)]
        )
        self.scale = np.concatenate(
            [[0.01 * fall.gravity, 0.1, 0.1], np.full(self.n + 1, 1e-3), np.full(self.n, 0.01)]
        )

    def flights(self, p: Array) -> list[Flight]:
        """The parabolas of the numbers ``p``."""
        g, start = p[0], p[2]
        at, shares = p[3 : 4 + self.n], p[4 + self.n :]
        floor = p[1] + self.turning.corner[[*range(self.n), -1]]
        if self.drop.held is not None:
            release = at[0] - np.sqrt(2.0 * max(start - floor[0], 1e-9) / max(g, 1e-9))
            found = [Flight(0, 0, float(release), float(start), 0.0, float(g))]
        else:
            found = [Flight(0, 0, float(at[0]), float(floor[0]), float(-start), float(g))]
        for k in range(self.n):
            bend, lasts = float(g * (1.0 + shares[k])), float(at[k + 1] - at[k])
            up = 0.5 * bend * lasts + float(floor[k + 1] - floor[k]) / max(lasts, 1e-9)
            found.append(Flight(0, 0, float(at[k]), float(floor[k]), up, bend))
        return found

    def phase(self, p: Array, flights: Sequence[Flight]) -> NDArray[np.int64]:
        """Of which flight each frame is; -1 where the body is held."""
        phase = np.searchsorted(p[3 : 3 + self.n], self.t)
        if self.drop.held is not None:
            phase = np.where(self.t < flights[0].t_s, -1, phase)
        return phase

    def left(self, scaled: Array) -> Array:
        """What frames and the shared gravity leave, over their errors."""
        p = self.p + scaled * self.scale
        flights = self.flights(p)
        phase = self.phase(p, flights)
        value = np.choose(np.maximum(phase, 0), [each.at(self.t) for each in flights])
        value = np.where(phase < 0, p[2], value)
        if self.through.any():
            value[self.through] = self._mean_of(flights, p)
        told = zip(p[:2], (self.known.gravity, self.known.floor), strict=True)
        return np.concatenate(
            [
                (self.y - value) / self.sigma,
                (p[4 + self.n :] - self.turning.shares) / self.turning.errors,
                [(number - each[0]) / each[1] for number, each in told if each is not None],
            ]
        )

    def _mean_of(self, flights: Sequence[Flight], p: Array) -> Array:
        """Mean heights over the exposures (frames through an impact,)."""
        t = self.t[self.through, None] + self.u
        phase = np.searchsorted(p[3 : 3 + self.n], t)
        return np.asarray(np.choose(phase, [each.at(t) for each in flights]).mean(axis=1))

    def solved(self) -> Drop:
        """The drop of least squares; as it was where there is none."""
        if len(self.t) < self.n + 3:
            return self.drop
        found = least_squares(self.left, np.zeros(len(self.p)), loss="soft_l1", f_scale=3.0)
        p = self.p + found.x * self.scale
        at = p[3 : 4 + self.n]
        if not np.isfinite(p).all() or p[0] <= 0.0 or (np.diff(at) <= 0.0).any():
            return self.drop
        flights = self.flights(p)
        phase = self.phase(p, flights)
        if phase.max() < self.n:  # no frame shows the last flight
            return self.drop
        placed = []
        for k, each in enumerate(flights):
            own, old = self.frames[phase == k], self.drop.flights[k]
            first, last = (int(own[0]), int(own[-1])) if len(own) else (old.first, old.last)
            placed.append(replace(each, first=first, last=last))
        covariance = np.linalg.pinv(found.jac.T @ found.jac) * np.outer(self.scale, self.scale)
        left = self.left(found.x)
        self.square = float(left @ left)
        covariance *= _alike(left[: len(self.t)], phase)
        slopes = np.stack(
            [
                (_ratios(self.flights(p + step), (p + step)[3:]) - _ratios(flights, p[3:]))
                / step.max()
                for step in np.diag(1e-4 * self.scale)
            ],
            axis=1,
        )
        errors = np.sqrt(np.einsum("ri,ij,rj->r", slopes, covariance, slopes))
        held = self.drop.held is not None
        return replace(
            self.drop,
            last=int(self.frames[-1]),
            release_s=flights[0].t_s if held else None,
            held=float(p[2]) if held else None,
            flights=tuple(placed),
            impact_s=at[: self.n],
            floor=np.full(self.n, p[1]),
            restitution_error=errors,
            gravity_error=float(np.sqrt(covariance[0, 0])),
            floor_error=float(np.sqrt(covariance[1, 1])),
        )


def _ratios(flights: Sequence[Flight], impact_s: Array) -> Array:
    """Speed after each impact over that before it (impacts,)."""
    pairs = zip(impact_s, flights[:-1], flights[1:], strict=False)
    return np.array([-b.speed_at(float(t)) / a.speed_at(float(t)) for t, a, b in pairs])


def _alike(left: Array, phase: NDArray[np.int64]) -> float:
    """By how much the variance of what frames tell together is larger than were they independent
    and as sure as they say; ``left`` is what they leave, over their errors."""
    together = (phase[1:] == phase[:-1]) & (phase[1:] >= 0)
    pairs, square = left[1:][together] * left[:-1][together], float(np.mean(left**2))
    rho = float(np.clip(np.mean(pairs) / square, 0.0, 0.9)) if len(pairs) > 9 else 0.3
    return max(square, 1.0) * (1.0 + rho) / (1.0 - rho)


def _landing(flight: Flight, floor: float) -> float:
    """When a flight comes down to the height ``floor``; where it never was above it, its top."""
    top_s = flight.t_s + flight.speed / flight.gravity
    above = float(flight.at(top_s)) - floor
    return top_s + float(np.sqrt(max(2.0 * above / flight.gravity, 0.0)))


def clear_of(drop: Drop, t_s: Array, exposure_s: float) -> NDArray[np.bool_]:
    """Which frames (frames,) no impact of the drop blurs."""
    near = 0.5 * exposure_s + TOUCHING_S
    return np.all(np.abs(t_s[:, None] - drop.impact_s) > near, axis=1)


def _frames_of(t_s: Array) -> int:
    """How many frames a stretch has in a film that plays as fast as it was taken."""
    frame = float(np.median(np.diff(t_s)))
    return int(np.clip(round(STRETCH_S / frame), LEAST_FRAMES, MOST_FRAMES))


def gravity_of(t_s: Array, height: Array, sigma: Array, size: int | None = None) -> float | None:
    """The downward acceleration in px/s² that most stretches of ``size`` frames share; None where
    none is sure."""
    bends, errors = _stretches(t_s, height, sigma, size or _frames_of(t_s))
    sure = (bends > SURE * errors) & np.isfinite(bends)
    if not sure.any():
        return None
    some, error = bends[sure], errors[sure]
    near = np.abs(some[:, None] - some[None, :]) < NEAR * error[None, :] + LIKE * some[:, None]
    # what is surer counts more: a sharp value that many share is no chance
    count = (near * np.minimum(some / error, 50.0)[None, :]).sum(axis=1)
    best = near[np.argmax(count)]
    return float(np.average(some[best], weights=error[best] ** -2.0))


def _stretches(t_s: Array, height: Array, sigma: Array, size: int) -> tuple[Array, Array]:
    """Downward accelerations of stretches of ``size`` frames, and their standard errors; not a
    number where no parabola passes."""
    frame = float(np.median(np.diff(t_s)))
    n = len(t_s) - size + 1
    if n < 1:
        return np.zeros(0), np.zeros(0)
    at = np.arange(n)[:, None] + np.arange(size)
    t, y, s = t_s[at], height[at], sigma[at]
    since = t - t.mean(axis=1, keepdims=True)
    design = np.stack([np.ones_like(since), since, -0.5 * since**2], axis=2) / s[:, :, None]
    normal = np.einsum("nki,nkj->nij", design, design)
    scale = np.sqrt(np.einsum("nii->ni", normal))
    inverse = np.linalg.inv(normal / scale[:, :, None] / scale[:, None, :])
    inverse = inverse / scale[:, :, None] / scale[:, None, :]
    found = np.einsum("nij,nkj,nk->ni", inverse, design, y / s)
    left = y / s - np.einsum("nki,ni->nk", design, found)
    square = (left**2).sum(axis=1) / max(size - 3, 1)
    gap = np.diff(t, axis=1).max(axis=1) > 4.0 * frame
    bad = (square > 16.0) | gap
    errors = np.sqrt(inverse[:, 2, 2] * np.maximum(square, 1.0))
    return np.where(bad, np.nan, found[:, 2]), errors


def _flights(t_s: Array, height: Array, sigma: Array, gravity: float, size: int) -> list[Flight]:
    """Stretches of that acceleration, each as long as its parabola goes on."""
    bends, errors = _stretches(t_s, height, sigma, size)
    near = np.abs(bends - gravity) < NEAR * errors + TURNING * gravity
    seeds = np.flatnonzero(near & np.isfinite(bends))
    seeds = seeds[np.argsort(errors[seeds] + np.abs(bends[seeds] - gravity), kind="stable")]
    taken: NDArray[np.bool_] = np.zeros(len(t_s), dtype=bool)
    flights = []
    for seed in seeds:
        if taken[seed : seed + size].any():
            continue
        flight = _grown(t_s, height, sigma, seed, seed + size - 1, gravity, taken)
        if flight is None:
            continue
        taken[flight.first : flight.last + 1] = True
        flights.append(flight)
    return sorted(flights, key=lambda each: each.first)


def _grown(
    t_s: Array,
    height: Array,
    sigma: Array,
    first: int,
    last: int,
    gravity: float,
    taken: NDArray[np.bool_],
) -> Flight | None:
    """The flight of these frames and of those beside them that lie on its parabola."""
    flight = _fitted(t_s, height, sigma, first, last, gravity)
    frame = float(np.median(np.diff(t_s)))
    for _ in range(3):
        before = (first, last)
        for step, end in ((-1, first), (1, last)):
            misses, at = 0, end + step
            while 0 <= at < len(t_s) and not taken[at] and misses < 2:
                if abs(t_s[at] - t_s[at - step]) > 6.0 * frame:
                    break
                unsure = np.hypot(sigma[at], SPEED_PX * abs(flight.speed_at(t_s[at])) * frame)
                near = abs(height[at] - flight.at(t_s[at])) < OFF * unsure
                wider = min(first, at), max(last, at)
                grown = _fitted(t_s, height, sigma, *wider, gravity) if near else flight
                # a body that is held before a flight would flatten the parabola, frame by frame
                least = min(flight.gravity, (1.0 - TURNING) * gravity)
                if near and (step > 0 or grown.gravity >= least):
                    (first, last), flight, misses = wider, grown, 0
                else:
                    misses += 1
                at += step
        if before == (first, last):
            break
    far = np.abs(height[first : last + 1] - flight.at(t_s[first : last + 1]))
    return flight if np.median(far / sigma[first : last + 1]) < OFF else None


def _fitted(
    t_s: Array, height: Array, sigma: Array, first: int, last: int, gravity: float
) -> Flight:
    """The parabola of frames ``first`` to ``last``, its acceleration about ``gravity``."""
    t, y, s = (each[first : last + 1] for each in (t_s, height, sigma))
    middle = float(t.mean())
    since = t - middle
    weight: Array = np.ones(len(t))
    solution: Array = np.zeros(3)
    for _ in range(3):
        design = np.stack([np.ones_like(since), since, -0.5 * since**2], axis=1)
        weighted = np.vstack(
            [design * (weight / s)[:, None], [0.0, 0.0, 1.0 / (TURNING * gravity)]]
        )
        right = np.append(y * weight / s, 1.0 / TURNING)
        solution = np.linalg.lstsq(weighted, right, rcond=None)[0]
        left = np.abs(y - design @ solution) / s
        usual = max(1.4826 * float(np.median(left)), 1.0)
        weight = np.sqrt(np.minimum(1.0, 3.0 * usual / np.maximum(left, 1e-9)))
    level, speed, bend = (float(each) for each in solution)
    return Flight(first, last, middle, level, speed, bend)


def _impact(before: Flight, after: Flight, t_s: Array) -> tuple[float, float] | None:
    """Instant and height of the impact between two flights; None where there is none.

    Frames that the impact blurs are of neither. The body must come down and go up.
    """
    frame = float(np.median(np.diff(t_s)))
    low, high = t_s[before.last] - 1.5 * frame, t_s[after.first] + 1.5 * frame
    if high - low > 7.0 * frame:
        return None
    tried = np.linspace(low, high, 400)
    gap = before.at(tried) - after.at(tried)
    crossing = np.flatnonzero((gap[:-1] > 0.0) & (gap[1:] <= 0.0))
    if not len(crossing):
        return None
    k = int(crossing[0])
    t = float(tried[k] + (tried[k + 1] - tried[k]) * gap[k] / (gap[k] - gap[k + 1]))
    if before.speed_at(t) >= 0.0 or after.speed_at(t) <= 0.0:
        return None
    return t, float(before.at(t))


def _drop(chain: list[Flight], t_s: Array, height: Array, sigma: Array) -> Drop | None:
    """The drop of flights with impacts between them; None where nothing falls."""
    gravity = float(
        np.average([f.gravity for f in chain], weights=[f.last - f.first for f in chain])
    )
    let_go = _let_go(chain[0], gravity, t_s, height, sigma)
    held_first = let_go is not None and let_go[1] <= chain[0].first
    if _rises(chain[0], t_s) and not held_first:
        # thrown up in view, or the fall before it has too few frames for a flight of its own
        before = _fall_before(chain[0], gravity, t_s, height, sigma)
        if before is not None:
            chain = [before[0], *chain]
            let_go = _let_go(chain[0], gravity, t_s, height, sigma)
    release, held, begin = None, None, chain[0].first
    if let_go is not None:
        fall, begin = let_go
        release, held = fall.t_s, fall.height
        chain = [fall, *chain[1:]]
    found = [_impact(before, after, t_s) for before, after in pairwise(chain)]
    impacts = [each for each in found if each is not None]
    if len(impacts) < len(found):
        return None
    fall = chain[0]
    top_s = fall.t_s + fall.speed / fall.gravity
    top_s = min(max(top_s, float(t_s[fall.first])), float(t_s[fall.last]))
    fallen = float(fall.at(top_s) - fall.at(impacts[0][0] if impacts else t_s[fall.last]))
    if fallen < max(LEAST_FALL_PX, 3.0 * SURE * float(np.median(sigma))):
        return None
    if not impacts:
        # without an impact it may be a hand that lowers the body: it has to be let go suddenly, or
        # to follow its parabola so far that no hand does
        still = 0.0 if release is None else 0.5 * fall.gravity * (release - t_s[begin]) ** 2
        error = float(np.median(sigma))
        sudden = still > max(1.0, 6.0 * error)
        lasted = float(t_s[fall.last] - t_s[fall.first])
        bent = 0.5 * fall.gravity * lasted**2
        far = fallen > max(FAR_PX, FAR_SIGMAS * error) and bent > 0.25 * fallen
        if fall.last - fall.first < LEAST_FRAMES or not (sudden or far):
            return None
        own = slice(fall.first, fall.last + 1)
        if not sudden and not _is_parabola(t_s[own], height[own], sigma[own]):
            return None
    both = np.array(impacts, dtype=float).reshape(-1, 2)
    return Drop(begin, chain[-1].last, release, held, tuple(chain), both[:, 0], both[:, 1])


def _is_parabola(t_s: Array, height: Array, sigma: Array) -> bool:
    """Whether a third and a fourth power make heights no better than lens and air bend a fall; the
    arc of a hand gains more."""
    since = (t_s - t_s.mean()) / np.ptp(t_s)
    sigma = np.hypot(sigma, BENT * np.ptp(height))
    squares = []
    for powers in (3, 5):
        design = np.vander(since, powers, increasing=True) / sigma[:, None]
        left = height / sigma - design @ np.linalg.lstsq(design, height / sigma, rcond=None)[0]
        squares.append(float(left @ left))
    usual = max(squares[1] / max(len(t_s) - 5, 1), 1.0)
    return squares[0] - squares[1] < OFF**2 * usual


def _rises(flight: Flight, t_s: Array) -> bool:
    """Whether a flight goes up for a good part of the time that it is seen."""
    top_s = flight.t_s + flight.speed / flight.gravity
    return bool(top_s - t_s[flight.first] > 0.25 * (t_s[flight.last] - t_s[flight.first]))


def _fall_before(
    rise: Flight, gravity: float, t_s: Array, height: Array, sigma: Array
) -> tuple[Flight, float] | None:
    """The fall from a hand that holds still to a rise, through few frames or none; and how well it
    fits. None where the frames before the rise are not so."""
    frame = float(np.median(np.diff(t_s)))
    best = None
    for last in range(max(rise.first - FEW, 1), rise.first):
        found = _held_and_let_go(last, rise.first - 1, gravity, t_s, height, sigma)
        if found is None or found[1] > OFF**2:
            continue
        fall = found[0]
        impact = _impact(fall, rise, t_s)
        if impact is None or impact[0] - fall.t_s < 0.5 * frame:
            continue
        if best is None or found[1] < best[1]:
            best = found
    return best


def _let_go(
    fall: Flight, gravity: float, t_s: Array, height: Array, sigma: Array
) -> tuple[Flight, int] | None:
    """The fall as one from a hand that holds still, and the first frame in which it does; None
    where the film does not show that."""
    top_s = fall.t_s + fall.speed / fall.gravity
    start = int(np.searchsorted(t_s, top_s))
    tried = range(max(fall.first - 1, start - FEW, 1), min(fall.last, start + FEW) + 1)
    found = [_held_and_let_go(last, fall.last, gravity, t_s, height, sigma) for last in tried]
    good = [each for each in found if each is not None]
    if not good:
        return None
    best, square = min(good, key=lambda each: each[1])
    if square > OFF**2:
        return None
    begin = int(np.searchsorted(t_s, best.t_s)) - 1
    while (
        begin > 0
        and abs(height[begin - 1] - best.height) < max(OFF * sigma[begin - 1], LEVEL_PX)
        and best.t_s - t_s[begin - 1] < HELD_S
    ):
        begin -= 1
    return best, max(begin, 0)


def _held_and_let_go(
    held: int,
    last: int,
    gravity: float,
    t_s: Array,
    height: Array,
    sigma: Array,
) -> tuple[Flight, float] | None:
    """A fall from rest after the frame ``held``, through the frames up to ``last``; and the mean
    square of what it leaves. None where that frame is not held still, or it does not fall so."""
    if last <= held or held < 1:
        return None
    some = slice(max(0, held - 4), held + 1)
    about = height[held]
    still = np.abs(height[some] - about) < np.maximum(OFF * sigma[some], LEVEL_PX)
    if not still[-2:].all():
        return None
    t, y, s = t_s[held - 1 : last + 1], height[held - 1 : last + 1], sigma[held - 1 : last + 1]

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

    tried = np.linspace(t_s[held - 1], t_s[held + 1], 21)
    k = int(np.argmin([let_go(each)[0] for each in tried]))
    found = minimize_scalar(
        lambda release: let_go(release)[0],
        bounds=(tried[max(k - 1, 0)], tried[min(k + 1, 20)]),
        method="bounded",
        options={"xatol": 1e-5 * float(tried[-1] - tried[0])},
    )
    square, (level, bend) = let_go(float(found.x))
    return Flight(held + 1, last, float(found.x), float(level), 0.0, float(bend)), square
