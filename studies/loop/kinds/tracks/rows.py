"""Rows of unit noise that the film of a bouncing body gives, linear in the features of its track.

The features are those of `track_flight`: ratios of what the film shows to what its own speed of
impact makes expect, so they do not hang on when, from where or whether in the film the body was let
go. Instant and speed of the impact are nuisances, and the surface's level where the zero of heights
is anywhere; where no bounce is filmed, speed and level at the last frame of the fall.

Few films tell all features: at 25 frames/s a fall from 50 mm has two or three frames. So a film is
not reduced to estimates but to rows: the frames' least squares at the best track, linear there, the
nuisances projected out, and of the features as many orthonormal combinations as the frames know
(C. D. Rodgers, Inverse Methods for Atmospheric Sounding (2000), ch. 2: measurement space). Where a
model's features hang on the speed of impact, it is the frames' best one given the features. The
weak prior that helps to find the best track is not in the rows, so it biases nothing but the place
about which they are linear.

Exposure and rolling shutter are left out: a frame is an instant, the same for all its lines.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .....solver.arrays import Array
from .flight import BOUNCE, HEAD, UNUSED, Phases, derivatives, heights, rises_of

FEATURES = ("z", "h", "b", "u", "r", "a", "d", "l")
"""Of one bounce; those of the fall (the first four) belong to the first. The last is the lean in
degrees, which heights do not tell: `with_lean` adds its row."""
LOOSE = {"z": 3e-3, "h": 0.1, "b": 0.1, "u": 0.05, "r": 0.2, "a": 0.1, "d": 1e-3}
"""How far from none the best track is looked for, as a standard deviation; a row is kept where the
frames know its feature better than that."""
ORDER = ("r", "b", "a", "h", "u", "z", "d")
"""In which order features are given rows: what an earlier one has told, a later does not repeat."""


@dataclass(frozen=True)
class Film:
    """Frames of one drop: ``t_s``, ``y_m`` (frames,), their deviations in m and s, and gravity.

    A height's deviation is ``sigma_y_m`` times ``relative`` (frames,).
    The surface is near ``floor_m``, to within ``floor_loose_m``; ``floor_known`` where heights are
    declared to be over it, to within ``sigma_floor_m``.
    """

    t_s: Array
    y_m: Array
    sigma_y_m: float
    sigma_t_s: float
    gravity_m_s2: float
    floor_known: bool = True
    floor_m: float = 0.0
    floor_loose_m: float = LOOSE["z"]
    relative: Array | float = 1.0
    sigma_floor_m: float = 0.0


@dataclass(frozen=True)
class Track:
    """The best track of a film and its rows.

    ``p`` are the numbers of `track_flight`, ``phase`` (frames,) what each frame shows, ``held``
    whether some show the body held. ``speed_m_s`` (drops,) are the speeds of its impacts at ``p``,
    ``impact_m_s`` + ``impact_weights`` (features × drops,) @ features is that of the first given
    features.
    ``values`` (rows,) = ``weights`` (rows, features × drops) @ features
    + unit noise, where a drop is a bounce, or the fall where none is filmed. ``leading`` (rows,)
    numbers the feature that a row is about, ``drop`` (rows,) its bounce, ``known`` (rows,) how well
    it tells it. ``misfit`` is the sum of squares that the ``freedom`` other combinations of frames
    leave, ``changes`` the mean squares of the differences of residuals one frame apart and two,
    ``pairs`` how many of these there are. ``mistaken`` counts frames that no track passes by.
    """

    p: Array
    phase: Phases
    held: bool
    speed_m_s: Array
    impact_m_s: float
    impact_weights: Array
    values: Array
    weights: Array
    leading: NDArray[np.int64]
    drop: NDArray[np.int64]
    known: Array
    misfit: float
    freedom: int
    changes: tuple[float, float]
    pairs: int
    mistaken: int = 0

    @property
    def bounces(self) -> int:
        return (len(self.p) - len(HEAD)) // len(BOUNCE)


def names_of(p: Array) -> tuple[str, ...]:
    """What the numbers of a track are."""
    return HEAD + BOUNCE * ((len(p) - len(HEAD)) // len(BOUNCE))


def is_free(film: Film, p: Array, held: bool) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which numbers of a track are nuisances, and which features (both (numbers,))."""
    bounces = len(p) > len(HEAD)
    nuisances = np.zeros(len(p), dtype=bool)
    nuisances[:3] = bounces, True, not (film.floor_known and bounces)
    features = ~nuisances
    features[0] = False
    features[3] = held
    return nuisances, features


def deviation(film: Film, slopes: Array, used: NDArray[np.bool_] | slice = slice(None)) -> Array:
    """Standard deviations (frames used,) in m, with what an error of the time moves."""
    relative = np.broadcast_to(film.relative, film.t_s.shape)[used]
    return np.hypot(film.sigma_y_m * relative, film.sigma_t_s * slopes[:, 0])


def reduced(film: Film, p: Array, phase: Phases, held: bool) -> Track:
    """Rows of a film's frames near the track ``p``."""
    used = phase != UNUSED
    t, part, g = film.t_s[used], phase[used], film.gravity_m_s2
    slopes = derivatives(p, t, part, g)
    sigma = deviation(film, slopes, used)
    slopes /= sigma[:, None]
    residual = (film.y_m[used] - heights(p, t, part, g)) / sigma
    nuisances, features = is_free(film, p, held)
    confounded = slopes[:, nuisances]
    if features[2] and film.sigma_floor_m > 0.0:
        # the zero is common to all frames: a further nuisance, and a reading of it that says none
        own = np.append(slopes[:, 2], 1.0 / film.sigma_floor_m)
        confounded = np.column_stack([np.pad(confounded, ((0, 1), (0, 0))), own])
        slopes, residual = np.pad(slopes, ((0, 1), (0, 0))), np.append(residual, 0.0)
    frame, _ = np.linalg.qr(confounded)
    speed = np.linalg.pinv(confounded)[: nuisances.sum()][np.flatnonzero(nuisances) == 1][0]
    by_features = -speed @ (slopes * features)
    names = names_of(p)
    basis = list(frame.T)
    n = len(basis)
    leading, drop, known = [], [], []
    told = [k for k in range(len(p)) if features[k]]
    for k in sorted(told, key=lambda k: (ORDER.index(names[k]), k)):
        column = slopes[:, k]
        for _ in range(2):  # once more against rounding
            made = np.array(basis)
            column = column - made.T @ (made @ column)
        size = float(np.linalg.norm(column))
        if size * LOOSE[names[k]] > 1.0:
            basis.append(column / size)
            leading.append(FEATURES.index(names[k]))
            drop.append(max(k - len(HEAD), 0) // len(BOUNCE))
            known.append(size)
    every = np.array(basis)
    rows = every[n:].reshape(-1, len(residual))
    of_rows = rows @ (slopes * features)
    beyond = residual - every.T @ (every @ residual)
    in_row, beyond = part[2:] == part[:-2], beyond[: len(t)]
    one, two = (beyond[2:] - beyond[1:-1])[in_row], (beyond[2:] - beyond[:-2])[in_row]
    rises = rises_of(p, g)
    return Track(
        p=p,
        phase=phase,
        held=held,
        speed_m_s=rises[:, 5] if len(rises) else p[1:2],
        impact_m_s=float(p[1] + speed @ residual - by_features @ p),
        impact_weights=_by_drop(by_features[None])[0],
        values=rows @ residual + of_rows @ p,
        weights=_by_drop(of_rows),
        leading=np.array(leading, dtype=np.int64),
        drop=np.array(drop, dtype=np.int64),
        known=np.array(known),
        misfit=float(beyond @ beyond),
        freedom=len(residual) - len(every),
        changes=(float(np.mean(one**2)), float(np.mean(two**2))) if len(one) else (0.0, 0.0),
        pairs=len(one),
    )


def _by_drop(weights: Array) -> Array:
    """Weights (rows, features × drops) of `FEATURES`, from those of a track's numbers (rows,
    numbers)."""
    n = (weights.shape[1] - len(HEAD)) // len(BOUNCE)
    out = np.zeros((len(weights), max(n, 1), len(FEATURES)))
    fall = len(HEAD) - 2
    out[:, 0, :fall] = weights[:, 2 : len(HEAD)]
    if n:
        rises = weights[:, len(HEAD) :].reshape(len(weights), n, len(BOUNCE))
        out[:, :, fall : fall + len(BOUNCE)] = rises
    return out.reshape(len(weights), max(n, 1) * len(FEATURES))
