"""Which films of bouncing bristles are there, frame by frame, and can every value be used?"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...solver.bristle import Array
from ...solver.errors import InputError
from ..data.datasets import Manifest, read_manifest
from ..data.tables import InPieces, read_series
from ..data.units import check_marks

KIND = "tracks"
LEAST_FRAMES = 6


@dataclass(frozen=True)
class Tracks(InPieces):
    """Frames of all drops, one after the other: ``drop``, ``t_s``, ``y_m`` (frames,).

    ``begins`` (drops + 1,) says where each drop's frames begin. Times are those of the table.
    ``sigma_y_m`` is the declared uncertainty of a height or None, ``sigma_t_s`` that of a time.
    """

    manifest: Manifest
    drop: NDArray[np.int64]
    t_s: Array
    y_m: Array
    begins: NDArray[np.int64]
    sigma_y_m: float | None
    sigma_t_s: float


def read_tracks(folder: Path) -> Tracks:
    """Read a dataset of kind ``tracks``; six drops or more of six frames or more.

    Raises InputError naming file and line of the first value that cannot be used.
    """
    manifest = read_manifest(folder, KIND)
    if not isinstance(manifest.measurement.get("file"), str):
        raise manifest.wrong("file", "must name the table of the tracks")
    read = read_series(manifest.table(), "drop", "y_mm")
    read.check_drops(LEAST_FRAMES, "frames")
    _frame_rate(manifest, read.path, read.rows[1][0], read.t_s[read.pieces[0]])
    y = 1e-3 * read.value
    check_marks(read.path, read.lines, y)
    manifest.check_sigma("sigma_y_mm", 1e-3, y)
    sigma = manifest.measurement.get("sigma_y_mm")
    return Tracks(
        manifest=manifest,
        drop=read.number,
        t_s=read.t_s,
        y_m=y,
        begins=read.begins,
        sigma_y_m=None if sigma is None else 1e-3 * float(sigma),
        sigma_t_s=float(manifest.measurement.get("sigma_t_s", 0.0)),
    )


def _frame_rate(manifest: Manifest, path: Path, line: int, times: Array) -> None:
    """InputError where the first film's frames are nearer than the declared rate has them."""
    fps = manifest.measurement.get("fps")
    nearest = float(np.diff(times).min())
    if fps is not None and nearest * float(fps) < 0.5:
        raise InputError(
            f"{path}:{line}: frames {nearest:g} s apart are more than the declared {fps:g} a second"
        )
