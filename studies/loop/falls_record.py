"""Which falls of an accelerometer are measured, and can every value of them be used?

A public example with its source, commit and licence in its ``dataset.toml`` are 22 falls of a
telephone, fsaliby/Air_Resistance_From_the_Acceleration_of_a_Falling_Smartphone (CC0-1.0).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...solver.bristle import Array
from ...solver.errors import InputError
from ..data.datasets import Manifest, read_manifest
from ..data.tables import InPieces, read_series

BIN_S = 0.05
"""Over which readings are averaged."""


@dataclass(frozen=True)
class Falls(InPieces):
    """Readings of all falls, one after the other: ``fall``, ``times_s``, ``reading_m_s2`` (rows,).

    ``begins`` (falls + 1,) says where each fall's rows begin; times are those of the table.
    """

    manifest: Manifest
    fall: NDArray[np.int64]
    times_s: Array
    reading_m_s2: Array
    begins: NDArray[np.int64]

    @property
    def numbers(self) -> NDArray[np.int64]:
        """The falls' numbers (falls,)."""
        return self.fall[self.begins[:-1]]


def read_falls(folder: Path) -> Falls:
    """Read a dataset of kind ``falls``; three falls or more of twenty samples or more.

    Raises InputError naming file and line of the first value that cannot be used.
    """
    manifest = read_manifest(folder, "falls")
    if not isinstance(manifest.measurement.get("file"), str):
        raise manifest.wrong("file", "must name the table of the falls")
    read = read_series(manifest.table(), "fall", "a_m_s2")
    if len(read.pieces) < 3:
        raise InputError(f"{read.path}: {len(read.pieces)} falls; at least three are needed")
    for i, piece in enumerate(read.pieces):
        size, times = piece.stop - piece.start, read.t_s[piece]
        duration = times[-1] - times[0]
        where = f"{read.at(i)}: fall {read.number[piece.start]}"
        if size * BIN_S < 2.0 * duration:
            raise InputError(
                f"{where} has {size} samples in {duration:g} s; {2 / BIN_S:g} a second are needed"
            )
        if size < 20 or duration < 4 * BIN_S:
            raise InputError(f"{where} has {size} samples in {duration:g} s; too short a record")
    return Falls(manifest, read.number, read.t_s, read.value, read.begins)
