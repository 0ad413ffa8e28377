"""A bristle in a picture: a thin straight strip, nearly vertical, with an end that moves.

A strip is brighter or darker than what is beside it (a ridge of the grey levels). It is found in
samples of the film by the longest run of such rows along lines of all slopes, where the lower end
lies in what moves: so a ruler, a plumb line or a second bristle lying about are not it. From one
frame to the next it is followed: its axis by the centroids of rows, its end along the axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ...solver.arrays import Array
from ...solver.compiled import njit
from .scan import Scan, clear_background, coarser

WIDTHS = (1, 2, 3, 5, 8, 12, 18)
"""Widths in px that are tried."""
MOST_SLOPE = np.tan(np.radians(20.0))
FIRST_SAMPLES = 10
"""In which all widths are tried; in the others, the best."""
FINE_ROWS = 320
"""Pictures are made coarser to about as many rows before a strip is looked for."""
LEAST_RUN = 12
"""In rows: a strip that shows less has no direction."""
NEARBY = 3
LEVEL_PX = 0.6
"""What is held still moves less than that from one frame to another."""
BELOW_PX, BELOW_HELD_PX = 14.0, 6.0
"""How far below its first guess a strip may end, drawn out by the lens; and one that is held."""


@dataclass(frozen=True)
class Strip:
    """A strip: its column at row zero, slope in columns a row, the rows of its ends, its width in
    px and its contrast in grey levels, negative where it is darker than what is beside it."""

    column: float
    slope: float
    top: float
    tip: float
    width: float
    contrast: float

    def at(self, row: Array | NDArray[np.int64] | float) -> Array:
        """Columns of the axis at rows."""
        return np.asarray(self.column + self.slope * np.asarray(row, dtype=float))


@dataclass(frozen=True)
class Looks:
    """What the strip of a film looks like, its typical ``width`` in px and ``contrast`` in grey
    levels; and what is behind it, ``still`` (rows, columns)."""

    still: Array
    width: float
    contrast: float


def find_strip(film: Scan) -> tuple[Looks, dict[int, Strip]] | None:
    """The strip that moves in a film, and where it is in samples; None where there is none."""
    factor = max(1, round(film.shape[0] / FINE_ROWS))
    coarse = coarser(film.samples, factor)
    noise = film.noise / factor + 0.5
    spread = np.ptp(coarse, axis=0)
    moves = spread > max(8.0 * noise, 10.0)
    if not moves.any():
        return None
    few = np.unique(np.linspace(0, len(coarse) - 1, FIRST_SAMPLES).astype(int))
    found = _alike(coarse, few, moves, noise, WIDTHS, (1.0, -1.0))
    groups = {look: group for look, group in found.items() if _moving(group, len(few))}
    if not groups:
        return None
    width, sign = max(groups, key=lambda look: sum(map(_size, groups[look].values())))
    rest = np.setdiff1d(np.arange(len(coarse)), few)
    more = _alike(coarse, rest, moves, noise, (int(width),), (sign,))
    best = groups[width, sign] | more.get((width, sign), {})
    fine = {sample: _finer(strip, factor) for sample, strip in best.items()}
    contrast = float(np.median([strip.contrast for strip in fine.values()]))
    width = float(np.median([strip.width for strip in fine.values()]))
    seen = {int(film.number[sample]): fine[sample] for sample in sorted(fine)}
    speeds = np.abs(np.diff([strip.tip for strip in seen.values()]) / np.diff(list(seen)))
    # an exposure is at most as long as from one frame to the next; what is held still is not drawn
    # out, and shows what is behind its end as nothing else does
    own = np.maximum(np.append(speeds, 0.0), np.append(0.0, speeds))
    below = np.where(own < LEVEL_PX, BELOW_HELD_PX + own, BELOW_PX + speeds.max())
    # where the strip was not found in a sample, nothing is known to be clear
    covered = np.ones(film.samples.shape, dtype=bool)
    row, column = np.ogrid[: film.shape[0], : film.shape[1]]
    for sample, out in zip(sorted(fine), below, strict=True):
        strip = fine[sample]
        beside = np.abs(column - strip.at(row)) < 0.8 * width + 4.0
        covered[sample] = beside & (row < strip.tip + out)
    return Looks(clear_background(film.samples, covered), width, contrast), seen


def _alike(
    pictures: Array,
    samples: NDArray[np.int64],
    moves: NDArray[np.bool_],
    noise: float,
    widths: Sequence[int],
    signs: Sequence[float],
) -> dict[tuple[float, float], dict[int, Strip]]:
    """Strips of samples by their number, for each width and sign."""
    found: dict[tuple[float, float], dict[int, Strip]] = {}
    for sample in samples:
        for strip in strips(pictures[sample], moves, noise, widths, signs):
            look = strip.width, float(np.sign(strip.contrast))
            found.setdefault(look, {})[int(sample)] = strip
    return found


def strips(
    picture: Array,
    moves: NDArray[np.bool_],
    noise: float,
    widths: Sequence[int] = WIDTHS,
    signs: Sequence[float] = (1.0, -1.0),
) -> list[Strip]:
    """Strips in a picture (rows, columns) whose lower end lies where something ``moves``, the best
    of each width and sign."""
    rows, columns = picture.shape
    slopes = np.linspace(-MOST_SLOPE, MOST_SLOPE, 2 * int(MOST_SLOPE * rows / 4.0) + 1)
    found = []
    for width in widths:
        if 4 * width >= columns:
            break
        ridge = _ridge(picture, width)
        strong = max(6.0 * noise, 0.25 * float(np.percentile(np.abs(ridge), 99.5)))
        for sign in signs:
            best = _longest(sign * ridge / strong, moves, slopes)
            if best is not None:
                column, slope, top, tip = best
                row = np.arange(int(top), int(tip) + 1)
                at = np.clip(np.round(column + slope * row).astype(int), 0, columns - 1)
                contrast = float(np.median(ridge[row, at]))
                found.append(Strip(column, slope, top, tip, float(width), contrast))
    return found


def _longest(
    strength: Array, moves: NDArray[np.bool_], slopes: Array
) -> tuple[float, float, float, float] | None:
    """Column at row zero, slope, first and last row of the best run along a line.

    ``strength`` (rows, columns) is one where a row may well be of the strip. A run is best where
    the sum of what exceeds a half is greatest (Bentley 1984, the greatest sum of a stretch).
    """
    rows, columns = strength.shape
    middle = rows // 2
    gain = np.clip(strength, -1.0, 2.0) - 0.5
    best, first, last = _greatest_sums(gain, slopes, middle)
    column = np.arange(columns) + np.round(slopes[:, None] * (last - middle)).astype(int)
    column = np.clip(column, 0, columns - 1)
    seen = np.zeros(best.shape, dtype=bool)
    for down in range(-NEARBY, NEARBY + 1):
        seen |= moves[np.clip(last + down, 0, rows - 1), column]
    allowed = seen & (last - first >= LEAST_RUN) & (last < rows - 2)
    if not allowed.any():
        return None
    k, j = np.unravel_index(np.argmax(np.where(allowed, best, 0.0)), best.shape)
    slope = float(slopes[k])
    return float(j - slope * middle), slope, float(first[k, j]), float(last[k, j])


@njit
def _greatest_sums(
    gain: Array, slopes: Array, middle: int
) -> tuple[Array, NDArray[np.int32], NDArray[np.int32]]:
    """The greatest sum of a run down each line, and its first and last row (slopes, columns); a
    line is numbered by its column in the row ``middle``."""
    rows, columns = gain.shape
    beyond = int(np.ceil(np.abs(slopes).max() * rows))
    padded = np.full((rows, columns + 2 * beyond), np.float32(-1.5))
    padded[:, beyond : beyond + columns] = gain
    best = np.zeros((len(slopes), columns), dtype=np.float32)
    first = np.zeros((len(slopes), columns), dtype=np.int32)
    last = np.zeros((len(slopes), columns), dtype=np.int32)
    total = np.empty(columns, dtype=np.float32)
    begin = np.empty(columns, dtype=np.int32)
    for k in range(len(slopes)):
        total[:] = 0.0
        for row in range(rows):
            # columns innermost and without branches, so that several are done at once
            at = beyond + round(slopes[k] * (row - middle))
            along = padded[row, at : at + columns]
            for j in range(columns):
                fresh = total[j] <= 0.0
                begin[j] = row if fresh else begin[j]
                total[j] = along[j] + (np.float32(0.0) if fresh else total[j])
                better = total[j] > best[k, j]
                best[k, j] = total[j] if better else best[k, j]
                first[k, j] = begin[j] if better else first[k, j]
                last[k, j] = row if better else last[k, j]
    return best, first, last


def _ridge(picture: Array, width: int) -> Array:
    """By how much a band of ``width`` about each pixel exceeds the nearer of what is beside it."""
    columns = picture.shape[1]
    side = max(2, width // 2)
    edge = width + side
    padded = np.pad(picture, ((0, 0), (edge, edge)), mode="edge")

    def mean(begin: int, length: int) -> Array:
        """Means over ``length`` columns that begin so far right of each pixel."""
        first = edge + begin + length // 2
        return ndimage.uniform_filter1d(padded, length)[:, first : first + columns]

    half = (width - 1) // 2
    inner = mean(-half, width)
    left = inner - mean(-half - 1 - side, side)
    right = inner - mean(width - half + 1, side)
    same = np.sign(left) == np.sign(right)
    return np.where(same, np.sign(left) * np.minimum(np.abs(left), np.abs(right)), 0.0)


def _moving(group: dict[int, Strip], samples: int) -> bool:
    """Whether the lower end of what may be one strip moves, and is seen often enough."""
    tips = np.array([strip.tip for strip in group.values()])
    return len(tips) >= max(3, samples // 6) and bool(np.ptp(tips) > 3.0)


def _size(strip: Strip) -> float:
    return abs(strip.contrast) * (strip.tip - strip.top) * np.sqrt(strip.width)


def _finer(strip: Strip, factor: int) -> Strip:
    """A strip of a coarser picture in px of the fine one."""
    middle = (factor - 1) / 2.0
    return replace(
        strip,
        column=strip.column * factor + middle * (1.0 - strip.slope),
        top=strip.top * factor,
        tip=strip.tip * factor + middle,
        width=strip.width * factor,
    )
