"""What do films of bouncing bristles say, as a problem for the loop?

Dataset kind ``tracks``: heights of the lower tip, frame by frame, on the camera's own clock. A
fall from 50 mm lasts a tenth of a second, two or three frames of 25 a second, and neither the
release nor the top is on any of them. So each film is brought to a few rows that do not hang on
its release (`track_rows`): the height of the rise, the gravity that rise and fall seem to have, the
time from the start of the fall to the rise, and the height that the fall seems to come from. Frames
of one film share its release, so a drop is a group. Only the fall and the rise after the first
impact are used.

Times and heights are confounded: a clock that is slow by one part and a scale that is long by two
both seem to change gravity alike, g = 2 y / t², and nothing else. They are named together.

What simulations tell comes from tables of drops, in which the third quantity is how much less the
tip of a bristle that turns is slowed: θ grows as ω t, and the tip's height over the centre of mass
by L/2 (ω t)²/2, hence an apparent gravity of g − L ω²/2, to the second order of the turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ...solver.bristle import Array
from ...solver.effects.base import Scene
from ...solver.errors import InputError
from ...solver.fall import risen
from ..data.datasets import Manifest
from ..data.tables import LEAST_DROPS
from .drop_model import Drops, FeatureModel
from .drops import SIGMA_M, carried, stiffness
from .problem import Experiment, Problem
from .response import MADE_BY, Bench, Tables, reference
from .table_drops import beam_of, outcomes_of
from .track_rows import (
    FALL,
    PLAIN,
    REST,
    RISE,
    Film,
    Track,
    events,
    positions,
    reduced,
)
from .track_search import NEAR_RELEASE_S, track
from .tracks_record import KIND, Tracks

NAMES = (
    "y1 (mm)",
    "gravity of the rise (%)",
    "time to the rise (%)",
    "gravity of the fall (%)",
    "start of the fall over y0 (%)",
)
FASTER_FPS = 250.0
LEAST_GRAVITY = 0.05
"""Of the rise's apparent gravity over g: a bristle that spins faster turns over."""


@dataclass(frozen=True)
class TrackBench(Bench):
    """Tables of rise, contact time, and one plus L ω²/(2 g) of the bristle's turning after."""

    made_by: ClassVar[tuple[Path, ...]] = (*MADE_BY, Path(__file__))
    shows_falls: ClassVar[bool] = True

    def seen(self, scenes: Sequence[Scene], its: float) -> Array:
        body = beam_of(self.bristle)
        found = outcomes_of(body, scenes, self.gravity_m_s2, its, self.friction, lenient=True)
        squared = found.spin_x_rad_s**2 + found.spin_y_rad_s**2
        lighter = 0.5 * self.bristle.length_m * squared / self.gravity_m_s2
        return np.stack([found.rebound_height_m, found.contact_time_s, 1.0 + lighter], axis=1)

    def reference(self, height_m: Array, kn_N_m: Array) -> Array:
        plain = reference(height_m, kn_N_m, self.bristle.mass_kg, self.gravity_m_s2)
        return np.stack([plain[0], plain[1], np.ones_like(plain[2])])


@dataclass(frozen=True)
class TrackModel(FeatureModel):
    """A `Model` of the rows of films."""

    def features(self, theta: Array) -> Array:
        """What `track_rows` calls r, a, d, b, h of every drop (..., nodes, drops, 5)."""
        b, (vacuum, touching, lighter) = self.bounced(theta)
        g, y0 = self.drops.bench.gravity_m_s2, self.drops.y0_m
        speed = np.sqrt(2.0 * g * b.same_m)
        lasted = 2.0 * b.height_m / np.maximum(speed + b.speed_m_s, 1e-3)
        # a parabola of the same height, start and end: drag bends it by less than can be seen
        falling = (speed - b.speed_m_s) / lasted
        slowed = g * np.maximum(2.0 - lighter, LEAST_GRAVITY)
        top = risen(vacuum, b.drag_1_m)
        up = np.sqrt(2.0 * slowed * vacuum)
        slowed = slowed * vacuum / top
        seen_top = np.maximum(b.scale * (top + b.offset_m), 1e-6)
        seen_slowed = b.scale * slowed / b.clock**2
        apex = b.clock * (lasted + touching + up / slowed)
        # the parabola is highest before, or with a speed upward after, the release
        apex = apex + b.clock * b.speed_m_s / falling
        left = apex - np.sqrt(2.0 * seen_top / seen_slowed)
        found = (
            seen_top / y0,
            np.log(seen_slowed / g),
            left / np.sqrt(2.0 * y0 / g),
            np.log(b.scale * falling / (g * b.clock**2)),
            b.scale * (b.height_m + 0.5 * b.speed_m_s**2 / falling) / y0
            + b.scale * b.offset_m / y0
            - 1.0,
        )
        full = (*np.shape(theta)[:-1], len(self.weights), len(y0))
        return np.stack([np.broadcast_to(each, full) for each in found], axis=-1)


def tracks_problem(data: Tracks) -> Problem:
    """The problem of a dataset of tracks. Raises InputError where it cannot be one."""
    sigma = data.sigma_y_m or _scatter_at_rest(data)
    films = [_film(data, piece, sigma) for piece in data.pieces]
    every = [track(film) for film in films]
    kept = [i for i, each in enumerate(every) if each is not None and len(each.values)]
    tracks = [each for each in every if each is not None and len(each.values)]
    if len(tracks) < LEAST_DROPS:
        raise InputError(
            f"{data.manifest.table()}: {len(tracks)} of {len(every)} films show rest, fall and "
            "rise unmistakably; the loop needs six or more. Is t_s in s, and y_mm in mm?"
        )
    y0 = np.array([each.y0_m for each in tracks])
    numbers = data.drop[data.begins[:-1]][kept]
    order = numbers - data.drop[0]
    bench = _bench(data.manifest, y0)
    wide = _model(Drops(bench, y0, order, (0, 1)), data.manifest.kn_N_m, tracks)
    drops = Drops(bench.about(_start(wide, tracks)), y0, order, (0, 1))
    plain = _model(drops, data.manifest.kn_N_m, tracks)

    def combine(effects: tuple[str, ...]) -> TrackModel:
        return replace(plain, effects=tuple(effects))

    def filmed_faster(effects: tuple[str, ...]) -> TrackModel:
        faster = [_faster(films[i], each) for i, each in zip(kept, tracks, strict=True)]
        weights, group = _rows(faster)
        return replace(combine(effects), weights_of=weights, group=group)

    leading = np.concatenate([each.leading for each in tracks])
    known = np.concatenate([each.known for each in tracks])
    group = plain.group
    unit = np.where(leading == 0, 1e3 * y0[group], 100.0)
    return Problem(
        values=np.concatenate([each.values for each in tracks]),
        scale=unit / known,
        unit="mm",
        quantity=np.array(NAMES)[leading],
        group=numbers[group],
        covariates={"height": y0[group], "order": order[group].astype(float)},
        baseline=plain,
        candidates=[combine((name,)) for name in carried(KIND, (0, 1))],
        combine=combine,
        experiments=[
            Experiment(f"film the same drops at {FASTER_FPS:.0f} frames/s", filmed_faster)
        ],
        confirm_why="films are compared with the beam's tables; the solid follows its drops",
        sigma_declared=data.sigma_y_m is not None,
        notes={
            "sigma_y_m": sigma,
            "left aside": f"{len(every) - len(tracks)} of {len(every)} films, which do not show "
            "rest, fall and rise unmistakably",
            "misfit": float(sum(each.misfit for each in tracks)),
            "freedom": int(sum(each.freedom for each in tracks)),
        },
    )


def _model(drops: Drops, kn_N_m: float | None, tracks: Sequence[Track]) -> TrackModel:
    """The baseline of these films."""
    kn = stiffness(kn_N_m, drops.bench)
    return TrackModel(drops, Tables(drops.bench), kn, (), *_rows(tracks))


def _rows(tracks: Sequence[Track]) -> tuple[Array, NDArray[np.int64]]:
    """Weights (rows, features) of all films' rows, and which film each is of."""
    group = np.repeat(np.arange(len(tracks)), [len(each.values) for each in tracks])
    return np.concatenate([each.weights for each in tracks]), group


def _start(plain: TrackModel, tracks: Sequence[Track]) -> float:
    """The stiffness of the baseline that the middle of the drops asks for."""
    kn = plain.kn
    ladder = np.geomspace(kn.low, kn.high, 400)
    rise = np.array([each.features[0] for each in tracks])
    miss = np.abs(plain.features(ladder[:, None])[:, 0, :, 0] - rise)
    return float(ladder[int(np.argmin(np.median(miss, axis=1)))])


def _film(data: Tracks, piece: slice, sigma_y_m: float) -> Film:
    gravity = data.manifest.gravity_m_s2
    return Film(data.t_s[piece], data.y_m[piece], sigma_y_m, data.sigma_t_s, gravity)


def _scatter_at_rest(data: Tracks) -> float:
    """The deviation of heights before release, where frames of one film differ by it alone."""
    squares, count = 0.0, 0
    for piece in data.pieces:
        y = data.y_m[piece]
        begin = int(np.argmax(y < 0.9 * np.median(y[:3]))) - 2
        if begin >= 3:
            squares += float(np.sum((y[:begin] - y[:begin].mean()) ** 2))
            count += begin - 1
    return float(np.sqrt(squares / count)) if count >= LEAST_DROPS and squares > 0.0 else SIGMA_M


def _bench(manifest: Manifest, y0_m: Array) -> TrackBench:
    """Heights rounded outward, so that other data can use the tables again."""
    step = 0.005
    lowest = max(step * np.floor(0.6 * float(y0_m.min()) / step), 0.002)
    highest = step * np.ceil(1.25 * float(y0_m.max()) / step)
    return TrackBench(
        manifest.bristle,
        manifest.gravity_m_s2,
        float(lowest),
        float(highest),
        friction=manifest.friction,
    )


def _faster(film: Film, found: Track) -> Track:
    """The same drop with more frames."""
    p = np.array([found.start_s, found.y0_m, found.features[0], *PLAIN])
    touch, launch, again = events(p, film.gravity_m_s2)
    t = np.arange(film.t_s[0], again, 1.0 / FASTER_FPS)
    t = t[(t < touch - 2e-3) | (t > launch + 2e-3)]
    t = t[np.abs(t - p[0]) > NEAR_RELEASE_S]
    phase = np.where(t > launch, RISE, np.where(t > p[0], FALL, REST))
    seen = positions(p, t, phase, film.gravity_m_s2)
    return reduced(replace(film, t_s=t, y_m=seen), p, t, seen, phase)
