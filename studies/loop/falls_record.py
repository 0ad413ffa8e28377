"""Which falls of an accelerometer are measured, and can every value of them be used?

A public example with its source, commit and licence in its ``dataset.toml`` are 22 falls of a
telephone, fsaliby/Air_Resistance_From_the_Acceleration_of_a_Falling_Smartphone (CC0-1.0).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...solver.bristle import Array
from ...solver.errors import InputError
from ..data.datasets import Manifest, read_manifest
from ..data.tables import column, group_begins, read_table

BIN_S = 0.05
"""Over which readings are averaged."""


@dataclass(frozen=True)
class Falls:
    """Readings of all falls, one after the other: ``fall``, ``times_s``, ``reading_m_s2`` (rows,).

    ``begins`` (falls + 1,) says where each fall's rows begin; times are those of the table.
    """

    manifest: Manifest
    fall: NDArray[np.int64]
    times_s: Array
    reading_m_s2: Array
    begins: NDArray[np.int64]

    @property
    def pieces(self) -> list[slice]:
        """The rows of each fall."""
        return [slice(a, b) for a, b in pairwise(self.begins)]

    @property
    def numbers(self) -> NDArray[np.int64]:
        """The falls' numbers (falls,)."""
        return self.fall[self.begins[:-1]]


def read_falls(folder: Path) -> Falls:
    """Read a dataset of kind ``falls``; three falls or more of twenty samples or more.

    Raises InputError naming file and line of the first value that cannot be used.
    """
    manifest = read_manifest(folder)
    if manifest.kind != "falls":
        raise manifest.wrong("kind", f"is {manifest.kind}, not falls")
    if not isinstance(manifest.measurement.get("file"), str):
        raise manifest.wrong("file", "must name the table of the falls")
    path = manifest.table()
    rows = read_table(path, required=("fall", "t_s", "a_m_s2"))
    fall = column(path, rows, "fall", whole=True).astype(np.int64)
    times, reading = column(path, rows, "t_s"), column(path, rows, "a_m_s2")
    begins = group_begins(path, rows, "fall", fall, times)
    if len(begins) < 4:
        raise InputError(f"{path}: {len(begins) - 1} falls; at least three are needed")
    for begin, size in zip(begins, np.diff(begins), strict=False):
        duration = times[begin + size - 1] - times[begin]
        where = f"{path}:{rows[begin][0]}: fall {fall[begin]}"
        if size * BIN_S < 2.0 * duration:
            raise InputError(
                f"{where} has {size} samples in {duration:g} s; {2 / BIN_S:g} a second are needed"
            )
        if size < 20 or duration < 4 * BIN_S:
            raise InputError(f"{where} has {size} samples in {duration:g} s; too short a record")
    return Falls(manifest, fall, times, reading, begins)
