"""The record of an accelerometer that falls: read, and cut to where it falls freely.

Kind ``falls``: ``fall, t_s, a_m_s2``, optionally ``y0_mm``, the height that each fell from. A
reading is near zero as a fall begins and grows with drag. The table may hold more than the fall:
samples in which the body is still held (they read g), and the beginning of the impact. Both are
left aside and told, and so is each record's first `SETTLING_S`. A public example with its source,
commit and licence in its ``dataset.toml`` lies in ``studies/measured/falls-phone``.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .....solver.arrays import Array
from .....solver.errors import InputError
from ....data.datasets import Manifest, read_manifest
from ....data.tables import InPieces, Series, column, read_series

BIN_S = 0.05
"""Over which readings are averaged."""
LEAST_FALLS, LEAST_SAMPLES, LEAST_BINS = 3, 20, 6
SETTLING_S, SETTLING_SHARE = 0.1, 0.2
"""A hand lets go and the sensor's filter settles for this long, or this share of a short record."""
# Shares of g: a body that is held, one that is let go, and more than any drag makes.
HELD, LET_GO, STRUCK = 0.75, 0.4, 1.5
# Beyond so many times the usual scatter of neighbours a step at the end is the impact's.
JUMP = 10.0
# A drag that is negative by so many standard errors is one of the other sign.
TURNED = 5.0


@dataclass(frozen=True)
class Falls(InPieces):
    """Readings of all falls, one after the other: ``fall``, ``times_s``, ``reading_m_s2`` (rows,).

    ``begins`` (falls + 1,) says where each fall's rows begin; times are those of the table.
    ``height_m`` (falls,) is None where the table has none. Readings grow with drag: where they do
    not in the table, its sign is turned and ``warnings`` say so.
    """

    manifest: Manifest
    fall: NDArray[np.int64]
    times_s: Array
    reading_m_s2: Array
    begins: NDArray[np.int64]
    height_m: Array | None = None
    warnings: tuple[str, ...] = ()
    left_aside: tuple[str, ...] = ()

    @property
    def numbers(self) -> NDArray[np.int64]:
        """The falls' numbers (falls,)."""
        return self.fall[self.begins[:-1]]


def read_falls(folder: Path) -> Falls:
    """Read a dataset of kind ``falls``; three falls or more of twenty samples or more.

    Raises InputError naming file and line of the first value that cannot be used.
    """
    manifest = read_manifest(folder, "falls")
    read = read_series(manifest.table("falls"), "fall", "a_m_s2")
    if len(read.pieces) < LEAST_FALLS:
        raise InputError(f"{read.path}: {len(read.pieces)} falls; at least three are needed")
    gravity = manifest.gravity_m_s2
    parts, told = [], []
    for i, piece in enumerate(read.pieces):
        fall = read.number[piece.start]
        where = f"{read.at(i)}: fall {fall}"
        first, last = freely(read.value[piece], gravity)
        _check(where, read.t_s[piece][first:last], read.value[piece][first:last], gravity)
        settling = _settling(read.t_s[piece][first:last])
        parts.append(np.arange(piece.start + first + settling, piece.start + last))
        if first:
            told.append(f"fall {fall}: {first} samples in which the body is still held")
        if last < piece.stop - piece.start:
            late = piece.stop - piece.start - last
            told.append(f"fall {fall}: {late} sample(s) at its end, of the impact")
    told.append(
        f"of every fall the first {SETTLING_S:g} s, or {SETTLING_SHARE:.0%} of a shorter record: "
        "hand and sensor still settle"
    )
    rows = np.concatenate(parts)
    begins = np.cumsum([0, *(len(part) for part in parts)])
    reading, turned = _upright(
        read.value[rows], [slice(int(a), int(b)) for a, b in pairwise(begins)]
    )
    return Falls(
        manifest,
        read.number[rows],
        read.t_s[rows],
        reading,
        begins.astype(np.int64),
        _heights(read),
        (TURNED_SENTENCE,) if turned else (),
        tuple(told),
    )


TURNED_SENTENCE = (
    "the readings sink as the body gets faster, which no drag makes: a_m_s2 is taken to count in "
    "the other direction, and its sign is turned"
)


def freely(reading_m_s2: Array, gravity_m_s2: float) -> tuple[int, int]:
    """First sample, and the one after the last, at which a record's body falls freely.

    Before, it is held (it reads g, of either sign) or just let go (the sensor's filter still
    settles). After, it is struck: it reads more than drag can make, or a step that is `JUMP` times
    what steps usually differ by.
    """
    size = np.abs(reading_m_s2) / gravity_m_s2
    first, last = 0, len(size)
    low = np.flatnonzero(size < LET_GO)
    if size[0] > HELD and len(low):
        first = int(low[0])
        while first + 1 < last and size[first + 1] < size[first]:
            first += 1
    struck = np.flatnonzero(size[first:] > STRUCK)
    if len(struck):
        last = first + int(struck[0])
    steps = np.diff(reading_m_s2[first:last])
    if len(steps) < LEAST_SAMPLES - 1:
        return first, last
    middle = np.median(steps)
    rounding = np.abs(steps)[steps != 0.0].min(initial=np.inf)
    usual = 1.4826 * np.median(np.abs(steps - middle))
    usual = max(usual, rounding if np.isfinite(rounding) else 0.0)
    while last - first > 1 and abs(steps[last - first - 2] - middle) > JUMP * usual:
        last -= 1
    return first, last


def _settling(times_s: Array) -> int:
    """How many samples of a record are left aside while hand and sensor settle."""
    since = times_s - times_s[0]
    return int(np.searchsorted(since, min(SETTLING_S, SETTLING_SHARE * since[-1])))


def _check(where: str, times_s: Array, reading_m_s2: Array, gravity_m_s2: float) -> None:
    size = len(times_s)
    duration = times_s[-1] - times_s[0] if size else 0.0
    if size * BIN_S < 2.0 * duration:
        raise InputError(
            f"{where} has {size} samples in {duration:g} s; {2 / BIN_S:g} a second are needed"
        )
    begun = float(np.median(reading_m_s2[: max(3, size // 10)])) if size else 0.0
    if abs(begun) > HELD * gravity_m_s2:
        raise InputError(
            f"{where} reads {begun:.3g} m/s² as it begins; an accelerometer that falls reads near "
            "zero: gravity must not be in a_m_s2 (give g - dv/dt)"
        )
    if size < LEAST_SAMPLES:
        raise InputError(f"{where} has {size} samples in {duration:g} s; too short a record")


def _upright(reading_m_s2: Array, pieces: list[slice]) -> tuple[Array, bool]:
    """Readings that grow with drag, and whether their sign was turned for it."""
    gains = []
    for piece in pieces:
        early, _, late = np.array_split(reading_m_s2[piece], 3)
        gains.append(late.mean() - early.mean())
    gain = np.array(gains)
    error = gain.std(ddof=1) / np.sqrt(len(gain))
    if np.all(gain < 0.0) and gain.mean() < -TURNED * error:
        return -reading_m_s2, True
    return reading_m_s2, False


def _heights(read: Series) -> Array | None:
    """Heights (falls,) in m, where the table has them."""
    if "y0_mm" not in read.rows[0][1]:
        return None
    height = column(read.path, read.rows, "y0_mm", above=0.0)
    for piece in read.pieces:
        other = np.flatnonzero(height[piece] != height[piece.start])
        if len(other):
            line = read.lines[piece.start + int(other[0])]
            raise InputError(f"{read.path}:{line}: y0_mm must be the same all through a fall")
    return 1e-3 * height[read.begins[:-1]]
