"""Records of impact force as a dataset has them, with the heights that they are from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .....solver.arrays import Array
from .....solver.errors import InputError
from ....data.datasets import Manifest, read_manifest
from ....data.tables import (
    Series,
    column,
    in_order,
    inside,
    optional_column,
    read_series,
    read_table,
)
from ....data.units import check_contact_times, check_heights, check_peaks

KIND = "forces"
HEIGHTS = "drops.csv"
LEAST_SAMPLES = 12
PULSE = 0.2


@dataclass(frozen=True)
class Forces(Series):
    """Samples of all drops, one after the other: ``value`` (samples,) is the force in N.

    ``drop``, ``y0_m`` (drops,), and ``y1_m`` (drops,) or None. ``sigma_N`` and ``sigma_y_m`` are
    declared, or None.
    """

    manifest: Manifest
    drop: NDArray[np.int64]
    y0_m: Array
    y1_m: Array | None
    sigma_N: float | None
    sigma_y_m: float | None


def read_forces(folder: Path) -> Forces:
    """Read a dataset of kind ``forces``; four drops or more of twelve samples or more.

    Raises InputError naming file and line of the first value that cannot be used.
    """
    manifest = read_manifest(folder, KIND)
    name = manifest.measurement.get("file")
    if not isinstance(name, str) or name == HEIGHTS:
        raise manifest.wrong("file", f"must name the table of the forces, beside {HEIGHTS}")
    read = read_series(manifest.table(), "drop", "force_N")
    read.check_drops(LEAST_SAMPLES, "samples")
    numbers = read.number[read.begins[:-1]]
    for i, piece in enumerate(read.pieces):
        if not read.value[piece].max() > -min(read.value[piece].min(), 0.0):
            lowest = piece.start + int(np.argmin(read.value[piece]))
            raise InputError(
                f"{read.path}:{read.lines[lowest]}: drop {numbers[i]} never presses harder than it "
                "pulls; force_N is positive where the surface is pressed"
            )
    y0, y1 = _heights(manifest, read, numbers)
    declared = manifest.measurement
    data = Forces(
        **vars(read),
        manifest=manifest,
        drop=numbers,
        y0_m=y0,
        y1_m=y1,
        sigma_N=declared.get("sigma_force_N"),
        sigma_y_m=1e-3 * declared["sigma_y_mm"] if "sigma_y_mm" in declared else None,
    )
    _check_units(data)
    return data


def _check_units(data: Forces) -> None:
    """InputError where forces or times cannot be in N and s."""
    manifest, gravity = data.manifest, data.manifest.gravity_m_s2
    at = [piece.start + int(np.argmax(data.value[piece])) for piece in data.pieces]
    peaks, there = data.value[at], [data.rows[i][0] for i in at]
    check_peaks(data.path, there, "force_N", peaks, data.y0_m, manifest.bristle, gravity)
    lasting = np.array([_lasting_s(data.t_s[p], data.value[p]) for p in data.pieces])
    check_contact_times(data.path, there, "t_s", lasting, manifest.bristle)
    manifest.check_sigma("sigma_force_N", 1.0, data.value)
    manifest.check_sigma("sigma_y_mm", 1e-3, data.y0_m)


def _lasting_s(t_s: Array, force_N: Array) -> float:
    """How long the force is more than a fifth of its greatest value, about that."""
    peak = int(np.argmax(force_N))
    low = np.flatnonzero(force_N <= PULSE * force_N[peak])
    begin = low[low < peak].max(initial=-1) + 1
    end = low[low > peak].min(initial=len(t_s))
    return float((end - begin) * np.median(np.diff(t_s)))


def _heights(
    manifest: Manifest, records: Series, numbers: NDArray[np.int64]
) -> tuple[Array, Array | None]:
    """Heights before and after, of the drops that have a record."""
    path = inside(manifest.folder, HEIGHTS)
    rows_read, drop = in_order(path, read_table(path, required=("drop", "y0_mm")), "drop")
    y0 = 1e-3 * column(path, rows_read, "y0_mm", above=0.0)
    y1 = optional_column(path, rows_read, "y1_mm", 1e-3)
    check_heights(path, [line for line, _ in rows_read], y0, y1)
    of = {int(number): i for i, number in enumerate(drop)}
    for i, number in enumerate(numbers):
        if int(number) not in of:
            raise InputError(f"{records.at(i)}: drop {number} has no height in {HEIGHTS}")
    chosen = np.array([of[int(number)] for number in numbers])
    after = None if y1 is None or not np.isfinite(y1[chosen]).all() else y1[chosen]
    return y0[chosen], after
