"""Films of drops as one dataset: their tracks in one unit, numbered, with what each shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ...solver import paper
from .. import __version__
from ..film.edge import Camera
from ..film.flights import Drop
from ..film.reading import Film
from ..film.scale import (
    CLOCK,
    Scale,
    doubts_of,
    floor_of,
    of_centre,
    scale_of,
    weighed,
)
from ..film.tracker import Expected, Tracked, tracked
from ..inputs.choices import Body
from ..inputs.study_fields import TrackInputs
from ..running import results
from ..running.progress import progress

SCHEMA = "bristle-track-1"
TABLE = "tracks.csv"
# A drop in mid-flight so many frames after the body is first seen has lost what was before.
LATE_FRAMES = 5
NORMAL_90 = 1.645


@dataclass(frozen=True)
class ScaledFilm:
    """A film: its number in the dataset, its track, its scale, which all films have or none, and
    the height of the surface and its standard error in px."""

    number: int
    track: Tracked
    scale: Scale | None
    floor: tuple[float, float]

    @property
    def unit(self) -> str:
        """Of heights: mm, or px where there is no scale."""
        return "px" if self.scale is None else "mm"

    @property
    def by(self) -> float:
        """How many units a pixel is."""
        return 1.0 if self.scale is None else self.scale.mm_per_px


@dataclass(frozen=True)
class FilmedDrop:
    """A drop of a film, and its number in the dataset."""

    number: int
    film: ScaledFilm
    drop: Drop


@dataclass(frozen=True)
class TrackedFilms:
    """All films and their drops, a row of ``table`` for each frame that is used, and what deserves
    doubt."""

    inputs: TrackInputs
    films: Sequence[ScaledFilm]
    drops: Sequence[FilmedDrop]
    table: pd.DataFrame
    warnings: Sequence[str]

    @property
    def unit(self) -> str:
        """Of heights."""
        return self.films[0].unit


def track_films(films: Sequence[Path], inputs: TrackInputs) -> TrackedFilms:
    """Track films one after the other. Raises InputError."""
    given = Camera(
        exposure_s=inputs.exposure_s or 0.0,
        exposure_known=inputs.exposure_s is not None,
        rolling_s=inputs.rolling_shutter_s_per_row,
    )
    length = _length_mm(inputs)
    expected = Expected(1e3 * inputs.gravity_m_s2, length, inputs.mm_per_px)
    tracks = []
    with progress("films", len(films)) as advance:
        for path in films:
            film = Film(path, inputs.fps, inputs.roi, inputs.down)
            tracks.append(tracked(film, inputs.body, given, expected))
            advance()
    found = [
        weighed(track, scale_of(track, length, inputs.mm_per_px), inputs.gravity_m_s2, length)
        for track in tracks
    ]
    warnings = [doubt for each in found for doubt in _doubts(*each, inputs)]
    scales = [scale for _, scale in found]
    if None in scales and any(scales):
        warnings.append(
            "some films have no scale, so all heights are in pixels: give --mm-per-px, or show the "
            "whole body"
        )
        scales = [None] * len(scales)
    scaled = [
        ScaledFilm(number, track, scale, floor_of(track.drops) or (float(-track.down.max()), 0.0))
        for number, ((track, _), scale) in enumerate(zip(found, scales, strict=True), start=1)
    ]
    pairs = [(film, drop) for film in scaled for drop in film.track.drops]
    drops = [FilmedDrop(number, *each) for number, each in enumerate(pairs, start=1)]
    table = pd.concat([_rows(each) for each in drops], ignore_index=True)
    return TrackedFilms(inputs, scaled, drops, table, warnings)


def _length_mm(inputs: TrackInputs) -> float | None:
    """The length of the bristle, or the diameter of the ball where that is given."""
    if inputs.body is Body.BALL:
        return inputs.diameter_mm
    return inputs.length_mm or 1e3 * paper.LENGTH_M


def _doubts(track: Tracked, scale: Scale | None, inputs: TrackInputs) -> list[str]:
    """What of a film deserves doubt, in sentences."""
    name = track.film.path.name
    doubts = doubts_of(track, scale, inputs.gravity_m_s2)
    doubts += track.damage
    for drop in track.drops:
        if drop.release_s is None and drop.first > LATE_FRAMES:
            doubts.append(
                f"{name}: a drop begins in mid-flight, at {track.t_s[drop.first]:.3f} s, though "
                f"the {track.body} is in view before; an earlier impact may be missing. Look at "
                "the overlay film, and show the body alone by --roi"
            )
    if not any(len(drop.impact_s) for drop in track.drops):
        doubts.append(f"{name}: no impact is seen, so heights count from the lowest frame")
    if scale is None:
        doubts.append(
            f"{name}: nothing of known length is in view, so heights are in pixels; give "
            "--mm-per-px if you know the scale"
        )
    if inputs.body is Body.BALL and not inputs.mass_g:
        doubts.append(f"{name}: no --mass-g is given, so dataset.toml has that of a steel ball")
    if len(track.t_s) < 0.5 * track.frames:
        doubts.append(
            f"{name}: the {track.body} is seen in {len(track.t_s)} of {track.frames} frames"
        )
    return doubts


def _rows(each: FilmedDrop) -> pd.DataFrame:
    """A row for each frame of a drop that is used; standard errors include the surface's."""
    film, track = each.film, each.film.track
    used, unit, by = track.used(each.drop), film.unit, film.by
    x, y = track.film.shown(track.column, track.row, track.shape)
    up = by * (-track.down[used] - film.floor[0])
    share, both = (0.0, 0.0) if film.scale is None else (film.scale.error, film.scale.with_zero)
    zero, scale = by * film.floor[1], share * up
    total = np.sqrt((by * track.sigma[used]) ** 2 + zero**2 + scale**2 + 2.0 * both * zero * scale)
    # frames of a body that is held err alike, since it lies on the same pixels in all of them
    held = each.drop.phase(track.t_s[used]) < 0
    own = by * track.sigma[used] * np.where(held, np.sqrt(max(held.sum(), 1.0)), 1.0)
    rows: dict[str, Any] = {
        "drop": each.number,
        "t_s": np.round(track.t_s[used], 7),
        f"y_{unit}": np.round(up, 4),
        f"sigma_{unit}": np.round(total, 4),
        f"sigma_frame_{unit}": np.round(own, 4),
    }
    if track.turn is not None and track.sigma_turn is not None:
        rows["lean_deg"] = np.round(np.degrees(track.turn[used]), 4)
        sigma = np.hypot(track.sigma_turn[used], track.vertical[1])
        rows["sigma_lean_deg"] = np.round(np.degrees(sigma), 4)
    rows |= {
        "film": film.number,
        "frame": track.number[used],
        "tip_x_px": np.round(x[used], 3),
        "tip_y_px": np.round(y[used], 3),
        "flight": each.drop.phase(track.t_s[used]),
    }
    return pd.DataFrame(rows)


def summary(found: TrackedFilms) -> dict[str, Any]:
    """``track.json``: what each film and each drop shows."""
    return {
        "schema": SCHEMA,
        "version": __version__,
        "inputs": results.plain_inputs(found.inputs),
        "unit": found.unit,
        "films": [_film(each) for each in found.films],
        "drops": [_drop(each, _length_mm(found.inputs)) for each in found.drops],
        "warnings": list(found.warnings),
    }


def _interval(estimate: float, error: float) -> dict[str, float]:
    """An estimate with its 90 % interval."""
    half = NORMAL_90 * error
    return {"estimate": estimate, "low": estimate - half, "high": estimate + half}


def _film(film: ScaledFilm) -> dict[str, Any]:
    track, scale, gravity = film.track, film.scale, None
    if scale is not None and scale.gravity is not None:
        gravity = _interval(*scale.gravity)
    return {
        "film": str(track.film.path),
        "frames": track.frames,
        "frames_seen": len(track.t_s),
        "frames_per_s": 1.0 / track.frame_s,
        "down": str(track.film.down),
        "mm_per_px": None if scale is None else scale.mm_per_px,
        "mm_per_px_error": None if scale is None else scale.error,
        "scale_from": None if scale is None else scale.source,
        "gravity_m_s2": gravity,
        "exposure_s": track.camera.exposure_s,
        "exposure_known": track.camera.exposure_known,
        "blur_px": track.camera.psf_px,
        "gamma": track.camera.gamma,
        "roll_deg": float(np.degrees(np.arctan(track.vertical[0]))),
        "roll_error_deg": float(np.degrees(track.vertical[1])),
    }


def _drop(each: FilmedDrop, length_mm: float | None) -> dict[str, Any]:
    film, track, drop = each.film, each.film.track, each.drop
    unit, by, ratios = film.unit, film.by, drop.restitution
    if film.scale is not None and length_mm is not None:
        ratios = of_centre(track, drop, length_mm / by)
    errors = np.zeros_like(ratios) if drop.restitution_error is None else drop.restitution_error
    if film.track.turn is None:  # the air takes about as large a share of a ball's speeds
        errors = np.hypot(errors, CLOCK * ratios)
    used = track.used(drop)
    fall = drop.flights[0]
    top = float(fall.at(fall.top_s))
    lean = None
    if track.turn is not None:
        own = used[drop.phase(track.t_s[used]) <= 0]
        lean = float(np.degrees(np.median(track.turn[own]))) if len(own) else None
    return {
        "drop": each.number,
        "film": film.number,
        "release_s": drop.release_s,
        f"y0_{unit}": by * (top - film.floor[0]),
        "impact_s": drop.impact_s.tolist(),
        "restitution": [_interval(float(e), float(s)) for e, s in zip(ratios, errors, strict=True)],
        "lean_before_deg": lean,
        "frames": int(drop.last - drop.first + 1),
        "frames_used": len(used),
        f"rms_residual_{unit}": by * float(np.sqrt(np.mean(track.residual(drop) ** 2))),
        f"sigma_{unit}": by * float(np.median(track.sigma[used])),
    }
