"""Films of bouncing bodies as a dataset has them: heights, frame by frame, in mm or in pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .....solver.arrays import Array
from .....solver.errors import InputError
from ....data.datasets import Manifest, read_manifest
from ....data.tables import Rows, Series, column, optional_column, read_series, read_table
from ....data.units import check_marks

KIND = "tracks"
LEAST_FRAMES = 6


@dataclass(frozen=True)
class Tracks(Series):
    """Frames of all films, one after the other: ``value`` (frames,) is the height in m or, where
    ``in_pixels``, in pixels.

    ``sigma_y_m`` and ``sigma_y_px`` are the declared uncertainty of a height, or None,
    ``sigma_t_s`` that of a time. ``relative`` (frames,) is how uncertain each frame is over that:
    one, unless the table has a column of its own for it. ``sigma_surface`` is how uncertain the
    zero of the heights is, in m or in pixels; drops of one ``film`` (frames,) share that error,
    where films are numbered. ``lean_deg`` (frames,) is by how much the bristle
    leans in the picture, and ``sigma_lean_deg`` its standard error, or None.
    """

    manifest: Manifest
    in_pixels: bool
    sigma_y_m: float | None
    sigma_y_px: float | None
    sigma_t_s: float
    relative: Array
    sigma_surface: float = 0.0
    film: Array | None = None
    lean_deg: Array | None = None
    sigma_lean_deg: Array | None = None

    @property
    def drop(self) -> NDArray[np.int64]:
        """The number of each frame's drop (frames,)."""
        return self.number

    @property
    def sharing(self) -> NDArray[np.int64]:
        """How many drops (films,) are of the same film as each."""
        if self.film is None:
            return np.ones(len(self.pieces), dtype=np.int64)
        number = self.film[self.begins[:-1]]
        return np.asarray(np.maximum((number[:, None] == number).sum(axis=1), 1))

    @property
    def lean_before_deg(self) -> Array:
        """The median lean in the first quarter of each film's frames, and its standard error, in
        degrees (2, films); not a number where it is not seen."""
        return np.array([self._lean_of(piece) for piece in self.pieces]).T

    def without_corner(self, width: float) -> Tracks:
        """Heights less half the ``width`` that films show times sin(lean): so high is the middle of
        the end of a bristle that leans as a corner of it touches."""
        y = self.value.copy()
        for film, lean_deg in zip(self.pieces, self.lean_before_deg[0], strict=True):
            if np.isfinite(lean_deg):
                y[film] -= 0.5 * width * abs(float(np.sin(np.radians(lean_deg))))
        return replace(self, value=y)

    def _lean_of(self, film: slice) -> tuple[float, float]:
        part = slice(film.start, (3 * film.start + film.stop) // 4 + 1)
        seen: Array = np.zeros(0) if self.lean_deg is None else self.lean_deg[part]
        seen = seen[np.isfinite(seen)]
        if not len(seen):
            return np.nan, np.nan
        middle = float(np.median(seen))
        # frames may err alike, so that many are no surer than one
        own = self.sigma_lean_deg
        told: Array = np.zeros(0) if own is None else own[part]
        told = told[np.isfinite(told)]
        scatter = 1.4826 * float(np.median(np.abs(seen - middle)))
        return middle, float(np.median(told)) if len(told) else scatter


def read_tracks(folder: Path) -> Tracks:
    """Read a dataset of kind ``tracks``; four films or more of six frames or more.

    Raises InputError naming file and line of the first value that cannot be used.
    """
    manifest = read_manifest(folder, KIND)
    path = manifest.table("tracks")
    columns = read_table(path, required=("drop", "t_s"))[0][1]
    if {"y_mm", "y_px"} <= set(columns):
        raise InputError(f"{path}: y_mm and y_px are both there; only one can be the height")
    in_pixels = "y_px" in columns
    read = read_series(path, "drop", "y_px" if in_pixels else "y_mm")
    read.check_drops(LEAST_FRAMES, "frames")
    _frame_rate(manifest, path, read.rows[1][0], read.t_s[read.pieces[0]])
    y = read.value
    if in_pixels:
        manifest.check_sigma("sigma_y_px", 1.0, y)
    else:
        y = 1e-3 * y
        check_marks(path, read.lines, y)
        manifest.check_sigma("sigma_y_mm", 1e-3, y)
    unit = "px" if in_pixels else "mm"
    # of an error that is common to all frames, rows tell apart what each has of its own
    apart = f"sigma_frame_{unit}" in columns
    own = optional_column(path, read.rows, f"sigma_{'frame_' * apart}{unit}", 1.0)
    sigmas = {each: manifest.measurement.get(f"sigma_y_{each}") for each in ("mm", "px")}
    relative: Array = np.ones(len(y))
    if own is not None:
        sigmas[unit], relative = _of_rows(path, read.lines, own, sigmas[unit])
    sigma_mm, sigma_px = sigmas["mm"], sigmas["px"]
    found = Tracks(
        **vars(replace(read, value=y)),
        manifest=manifest,
        in_pixels=in_pixels,
        sigma_y_m=None if sigma_mm is None else 1e-3 * float(sigma_mm),
        sigma_y_px=None if sigma_px is None else float(sigma_px),
        sigma_t_s=float(manifest.measurement.get("sigma_t_s", 0.0)),
        relative=relative,
        sigma_surface=(1.0 if in_pixels else 1e-3)
        * float(manifest.measurement.get(f"sigma_surface_{unit}", 0.0)),
        film=_films(read.rows) if "film" in columns else None,
        lean_deg=column(path, read.rows, "lean_deg", empty=True) if "lean_deg" in columns else None,
        sigma_lean_deg=optional_column(path, read.rows, "sigma_lean_deg", 1.0),
    )
    # a scale in pixels leaves the surface free
    width_mm = 0.0 if in_pixels else float(manifest.measurement.get("seen_width_mm", 0.0))
    return found.without_corner(1e-3 * width_mm)


def _films(rows: Rows) -> Array:
    """A number for the film of each row (frames,), whatever the films are called."""
    names = [cells["film"].strip() for _, cells in rows]
    return np.asarray(np.unique(names, return_inverse=True)[1], dtype=float)


def _of_rows(
    path: Path, lines: Sequence[int], own: Array, declared: float | None
) -> tuple[float, Array]:
    """The usual uncertainty of a column of its own, and each row's over that (frames,).

    An empty cell is as uncertain as is ``declared``, or as is usual. InputError where one is zero.
    """
    for line, each in zip(lines, own, strict=True):
        if each == 0.0:
            raise InputError(f"{path}:{line}: an uncertainty must be more than zero")
    known = own[np.isfinite(own)]
    usual = float(np.median(known)) if len(known) else declared or 1.0
    return usual, np.where(np.isfinite(own), own, declared or usual) / usual


def _frame_rate(manifest: Manifest, path: Path, line: int, times: Array) -> None:
    """InputError where the first film's frames are nearer than the declared rate has them."""
    fps = manifest.measurement.get("fps")
    nearest = float(np.diff(times).min())
    if fps is not None and nearest * float(fps) < 0.5:
        raise InputError(
            f"{path}:{line}: frames {nearest:g} s apart are more than the declared {fps:g} a second"
        )
