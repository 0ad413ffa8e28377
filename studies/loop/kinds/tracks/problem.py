"""The problem of films of bouncing bodies: what their rows of features are, and what predicts them.

Dataset kind ``tracks``: heights of the lower tip, frame by frame, on the camera's own clock, in mm
or in pixels. A film may begin while the body is held, as it is let go or in mid-fall, and show one
bounce, several or none. Each is brought to a few rows (`track_rows`) that hang on the speed of
impact that it shows, and on no instant or place of release. Frames of one film share that speed, so
a film is a group.

Lengths and times are confounded: a clock that is slow by one part and a scale that is long by two
both change gravity alike, g = 2 y / t². Pixels have no scale: metres per pixel are a free parameter
of the baseline, fixed by gravity, and take up what is wrong with either.

What simulations tell comes from tables of drops, in which the third quantity is how much less the
tip of a bristle that turns is slowed: θ grows as ω t, and the tip's height over the centre of mass
by L/2 (ω t)²/2, hence an apparent gravity of g − L ω²/2, to the second order of the turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .....solver.arrays import Array
from .....solver.bristle import Bristle, RigidMass
from .....solver.effects.base import Parameter, Place, Scene
from .....solver.effects.library import EFFECTS
from ....data.datasets import Manifest
from ...problem import Experiment, Model, Problem
from ...responses.drop_model import BounceModel, Drops
from ...responses.emulator import Emulator
from ...responses.rigid import RigidEmulator, rigid_emulator
from ..drops.problem import carried, damping, heights_about, simulated_bristle, stiffness
from .films import Filmed, faster, filmed
from .flight import released
from .lean import with_lean
from .record import KIND, Tracks, read_tracks
from .rows import FEATURES, Track

NAMES = {
    "z": "surface (mm)",
    "h": "release height (mm)",
    "b": "gravity of the fall (%)",
    "u": "drag of the fall (% of weight)",
    "r": "y1 (mm)",
    "a": "gravity of the rise (%)",
    "d": "contact time (ms)",
    "l": "lean (°)",
}
MOST_CHANGE = 0.1
"""By how much, as a share, a film's speed of impact changes with what features are supposed."""
LEAST_SLOPE = 0.1
"""Of what a secant seeks: a speed that hardly decides between features is not followed far."""
LEAST_GRAVITY = 0.05
"""Of the rise's apparent gravity over g: a bristle that spins faster turns over."""
SCALE_RANGE = 3.0
"""How far metres per pixel may be from what the parabolas' gravity says at once, as a ratio."""
WITHIN = 2.5
"""Standard errors of a declared scale within which it is sought."""
IN_FLIGHT = (Place.RELEASE, Place.FLIGHT, Place.OBSERVATION)


@dataclass(frozen=True)
class TrackEmulator(Emulator):
    """Tables of rise, contact time, and one plus L ω²/(2 g) of the bristle's turning after."""

    def observed(self, scenes: Sequence[Scene], its: float, friction: float) -> Array:
        found, length = self.outcomes(scenes, its, friction), 0.0
        if isinstance(self.body, Bristle):
            length = self.body.length_m
        squared = found.spin_x_rad_s**2 + found.spin_y_rad_s**2
        lighter = 0.5 * length * squared / self.gravity_m_s2
        return np.stack([found.rebound_height_m, found.contact_time_s, 1.0 + lighter], axis=1)

    def reference(self, height_m: Array | float, kn_N_m: Array | float) -> Array:
        return _turning(super().reference(height_m, kn_N_m))


@dataclass(frozen=True)
class RigidTrackEmulator(TrackEmulator, RigidEmulator):
    """The same of a rigid mass, which does not turn."""

    def stiffened(self, height_m: Array | float, kn_N_m: Array, exponent: Array | float) -> Array:
        return _turning(super().stiffened(height_m, kn_N_m, exponent))


def _turning(quantities: Array) -> Array:
    """Quantities of drops (quantities, ...), with one for the peak force."""
    return np.stack([*quantities[:2], np.ones_like(quantities[2])])


@dataclass(frozen=True)
class TrackModel(BounceModel):
    """A `Model` of the rows of films, which are sums of `FEATURES`.

    A drop is a bounce, or the fall of a film that shows none; ``speed_m_s`` (drops,) is that of its
    impact, as the film's own track shows it, ``film`` (drops,) the film that it is of; given the
    features, impacts of a film are faster or slower by what ``faster`` (films, 1 + features of one
    film) says: a ratio where all features are zero, and what each adds. ``weights_of`` (rows,
    features of one film) are the sums, and ``of`` (rows, features of one film) says where each
    stands among the features of all drops, ``of_film`` (films, features of one film) likewise.
    Films in pixels are taken with ``pixel_m`` for the length of a pixel, and ``scale`` is the
    parameter that says how long one is.
    """

    speed_m_s: Array
    film: NDArray[np.int64]
    faster: Array
    of_film: NDArray[np.int64]
    weights_of: Array
    of: NDArray[np.int64]
    scale: Parameter | None = None
    pixel_m: float = 1.0

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (*(() if self.scale is None else (self.scale,)), *super().parameters)

    def predict(self, theta: Array) -> Array:
        """Whitened predictions (..., nodes, rows) for parameters (..., p)."""
        first: Array = np.ones(len(self.faster))
        second = self._ratio(self._features(theta, first))
        third = self._ratio(self._features(theta, second))
        # speeds that the features which they give leave as they are, by Steffensen's secant
        step = second - first
        slope = (third - second) / np.where(np.abs(step) > 1e-9, step, np.inf)
        best = second + (third - second) / np.maximum(1.0 - slope, LEAST_SLOPE)
        best = np.clip(best, 1.0 - MOST_CHANGE, 1.0 + MOST_CHANGE)
        every = self._features(theta, best)
        return np.asarray(np.einsum("...rf,rf->...r", every[..., self.of], self.weights_of))

    def _ratio(self, features: Array) -> Array:
        """What is the films' best speed over their tracks' own (..., nodes, films), of features."""
        found = np.einsum("...jf,jf->...j", features[..., self.of_film], self.faster[:, 1:])
        return np.clip(self.faster[:, 0] + found, 1.0 - MOST_CHANGE, 1.0 + MOST_CHANGE)

    def _features(self, theta: Array, ratio: Array) -> Array:
        """`FEATURES` of every drop (..., nodes, drops × features), were the films' speeds in a
        ``ratio`` (..., films) to those of their tracks."""
        speed_m_s = self.speed_m_s * ratio[..., self.film]
        theta = np.asarray(theta, dtype=float)
        length: Array = np.ones(1)
        if self.scale is not None:
            length, theta = self.pixel_m / theta[..., :1, None], theta[..., 1:]
        drops, g = self.drops, self.emulator.gravity_m_s2
        # what a theta says of release, air and camera does not hang on the drop: one tells it
        one = replace(drops, y0_m=drops.y0_m[:1], order=drops.order[:1])
        b, _ = BounceModel.bounced(replace(self, drops=one), theta)
        length = length * b.scale
        speed = speed_m_s * b.clock / length
        height = released(speed, g, b.speed_m_s, b.drag_1_m)
        fell = replace(drops, y0_m=b.scale * (height + b.offset_m))
        _, (rise, touching, lighter) = BounceModel.bounced(replace(self, drops=fell), theta)
        slowed = g * np.maximum(2.0 - lighter, LEAST_GRAVITY)
        found = {
            "z": length * b.offset_m,
            "h": 2.0 * g * length * height / speed_m_s**2 - 1.0,
            "b": np.log(length / b.clock**2),
            "u": b.drag_1_m * speed**2 / g,
            "r": 2.0 * slowed * rise / speed**2,
            "a": np.log(length * slowed / (g * b.clock**2)),
            "d": b.clock * touching,
            "l": self._lean_deg(theta),
        }
        full = (*np.shape(theta)[:-1], len(self.weights), len(self.speed_m_s))
        every = np.stack([np.broadcast_to(found[name], full) for name in FEATURES], axis=-1)
        return every.reshape(*full[:-1], -1)

    def _lean_deg(self, theta: Array) -> Array:
        """By how much the bristle leans before it lands (..., 1, 1)."""
        told = self.given(theta).get("bristle_tilt")
        return np.zeros((1, 1)) if told is None else np.asarray(told[0])[..., None, None]


def read_problem(folder: Path) -> Problem:
    """The problem of a dataset's folder. Raises InputError."""
    return tracks_problem(read_tracks(folder))


def tracks_problem(data: Tracks) -> Problem:
    """The problem of a dataset of tracks. Raises InputError where it cannot be one."""
    films = filmed(data)
    tracks, numbers = films.tracks, films.number
    drops_of = np.array([len(each.speed_m_s) for each in tracks])
    order = np.repeat(numbers - data.drop[0], drops_of)
    plain = _model(data.manifest, films, tracks, order)
    y0 = plain.drops.y0_m

    def combine(effects: tuple[str, ...]) -> TrackModel:
        return replace(plain, effects=tuple(effects))

    def filmed_faster(found: Model) -> TrackModel:
        fps = films.faster_fps
        others = [faster(film, each, fps) for film, each in zip(films.films, tracks, strict=True)]
        weights_of, of = _rows(with_lean(others, *films.lean_deg))
        return replace(combine(found.effects), weights_of=weights_of, of=of)

    leading = np.concatenate([each.leading for each in tracks])
    known = np.concatenate([each.known for each in tracks])
    film = np.repeat(np.arange(len(tracks)), [len(each.values) for each in tracks])
    drop = (np.cumsum(drops_of) - drops_of)[film] + np.concatenate([t.drop for t in tracks])
    unit = {name: 1e3 if name in "zd" else 100.0 for name in FEATURES} | {"l": 1.0}
    units = np.array([unit[name] for name in FEATURES])[leading]
    of_height = np.isin(leading, [FEATURES.index("r"), FEATURES.index("h")])
    return Problem(
        records=True,
        values=np.concatenate([each.values for each in tracks]),
        scale=np.where(of_height, 1e3 * y0[drop], units) / known,
        unit="mm",
        quantity=np.array([NAMES[name] for name in FEATURES])[leading],
        group=numbers[film],
        covariates={"height": y0[drop], "order": order[drop].astype(float)},
        baseline=plain,
        candidates=[
            combine((name,))
            for name in _candidates(films, plain.beta is not None)
            if plain.emulator.carries(name)
        ],
        combine=combine,
        experiments=[
            Experiment(f"film the same drops at {films.faster_fps:g} frames/s", filmed_faster)
        ],
        confirm_why="films are compared with the beam's tables; the solid follows its drops",
        sigma_declared=films.sigma_known,
        notes={
            "sigma_y_m": films.sigma_y_m,
            "misfit": float(sum(each.misfit for each in tracks)),
            "freedom": int(sum(each.freedom for each in tracks)),
        },
        warnings=films.warnings,
        left_aside=films.left_aside,
    )


def _model(
    manifest: Manifest, filmed_drops: Filmed, tracks: Sequence[Track], order: NDArray[np.int64]
) -> TrackModel:
    """The baseline of these films."""
    speed = np.concatenate([each.speed_m_s for each in tracks])
    y0 = speed**2 / (2.0 * manifest.gravity_m_s2)
    emulator = _emulator(manifest, y0)
    drops = Drops(emulator, y0, order.astype(float), (0, 1))
    kn = stiffness(manifest.kn_N_m, emulator)
    weights_of, of = _rows(tracks)
    width = of.shape[1]
    film = np.repeat(np.arange(len(tracks)), [len(each.speed_m_s) for each in tracks])
    first = len(FEATURES) * np.flatnonzero(np.diff(film, prepend=-1))
    of_each = [len(each.impact_weights) for each in tracks]
    of_film = first[:, None] + np.minimum(np.arange(width), np.array(of_each)[:, None] - 1)
    ratios = [
        np.pad(np.append(each.impact_m_s, each.impact_weights), (0, width - n)) / each.speed_m_s[0]
        for each, n in zip(tracks, of_each, strict=True)
    ]
    scale = None
    if filmed_drops.pixel_m is not None:
        low, high = filmed_drops.pixel_m / SCALE_RANGE, filmed_drops.pixel_m * SCALE_RANGE
        why = "gravity, as the parabolas show it, within what no clock is off by"
        scale = Parameter(
            "scale_m_px",
            "m/px",
            low,
            high,
            filmed_drops.pixel_m,
            filmed_drops.pixel_m,
            logarithmic=True,
            why=why,
        )
    elif "sigma_scale" in manifest.measurement:
        share = WITHIN * float(manifest.measurement["sigma_scale"])
        why = f"the declared uncertainty of the scale, {WITHIN:g} times to either side"
        middle = float(manifest.measurement.get("scale", 1.0))
        scale = Parameter("scale", "", middle - share, middle + share, middle, middle, why=why)
    return TrackModel(
        drops,
        kn,
        (),
        speed,
        film,
        np.array(ratios),
        of_film,
        weights_of,
        of,
        scale,
        filmed_drops.pixel_m or 1.0,
        beta=damping(manifest),
    )


def _rows(tracks: Sequence[Track]) -> tuple[Array, NDArray[np.int64]]:
    """Weights (rows, features of one film) of all films' rows, and where among all drops' features
    each of these stands (rows, features of one film)."""
    most = max(each.weights.shape[1] for each in tracks)
    weights, of, begin = [], [], 0
    for each in tracks:
        rows, width = each.weights.shape
        weights.append(np.pad(each.weights, ((0, 0), (0, most - width))))
        of.append(np.tile(begin + np.minimum(np.arange(most), width - 1), (rows, 1)))
        begin += width
    return np.concatenate(weights), np.concatenate(of)


def _candidates(filmed_drops: Filmed, free_damping: bool) -> list[str]:
    """The effects that these films can carry at all."""
    names = carried(KIND, (0, 1))
    impossible = {"material_damping"} if free_damping else set()
    if filmed_drops.pixel_m is not None:  # the free scale takes up what either does
        impossible |= {"scale_error", "clock_error"}
    if not filmed_drops.floor_known:
        impossible.add("height_offset")
    if not any(each.held for each in filmed_drops.tracks):
        impossible.add("release_velocity")
    if not any(each.bounces for each in filmed_drops.tracks):
        impossible |= {name for name in names if EFFECTS[name].place not in IN_FLIGHT}
    return [name for name in names if name not in impossible]


def _emulator(manifest: Manifest, y0_m: Array) -> Emulator:
    """Heights rounded outward, so that other data can use the tables again."""
    place = heights_about(y0_m)
    if isinstance(manifest.body, RigidMass):
        return rigid_emulator(RigidTrackEmulator, manifest, *place)
    return TrackEmulator(
        simulated_bristle(manifest), manifest.gravity_m_s2, *place, friction=manifest.friction
    )
