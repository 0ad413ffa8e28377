"""The strip of a bristle from frame to frame: its axis, and grey levels along it about its ends."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...solver.arrays import Array
from .reading import Frame, Picture
from .strip import LEAST_RUN, MOST_SLOPE, Looks, Strip

ASIDE_PX, TURN = 14, 0.05
"""How far the axis may be from where the frame before had it: px at the end, and its slope."""
LEAST_LIKE, MOST_LIKE = 0.15, 1.3
"""Share of the contrast below which a pixel is not of the strip, and which counts at most."""
AXIS_SIGMA_PX = 0.02
"""By how much the sides of a strip are unsure together: compression and what is behind it."""
AXIS_PX = 400
"""Rows above the end that the axis is fitted to: more do not make the end surer."""
WINDOW_PX = 28
"""Rows of the grey levels on each side of an end, beyond what blurs it."""
LEAST_SHARE = 0.5
"""Of the usual contrast, that a strip has on the rows above its end."""


@dataclass(frozen=True)
class End:
    """An end of the strip: its row as a first guess, and levels along the axis over rows.

    ``rows``, ``level`` and ``behind`` (rows,) run from the strip's inside to beyond its end, so
    that they count downward in the picture for the lower end and upward for the upper one;
    ``behind`` is what the background has there.
    """

    row: float
    rows: Array
    level: Array
    behind: Array


@dataclass(frozen=True)
class Sight:
    """The strip in one frame: the axis' column at row zero and slope, with the slope's standard
    error, its width in px, and its ends."""

    number: int
    t_s: float
    column: float
    slope: float
    sigma_slope: float
    width: float
    tip: End
    top: End | None


class Follower:
    """Finds the strip in one frame after the other; see `Sight`.

    ``found`` are strips by the number of their frame, from which it begins and where it goes on
    when it has lost the strip.
    """

    def __init__(self, looks: Looks, found: dict[int, Strip]) -> None:
        self.looks, self.found = looks, found
        self.sign, self.contrast = np.sign(looks.contrast), abs(looks.contrast)
        self.last: Strip | None = None
        self.inner = max(1.0, 0.7 * looks.width)
        # how far the tip went from a frame to the next of late, which blurs it
        self.speed_px = 0.0

    def sights(self, frames: Iterable[Frame]) -> list[Sight]:
        """What is seen in each frame in which the strip and its lower end are."""
        return [each for frame in frames if (each := self.sight(frame)) is not None]

    def sight(self, frame: Frame) -> Sight | None:
        """The strip in a frame; None where it is not seen, or its lower end is not."""
        sample = min(self.found, key=lambda number: abs(number - frame.number))
        for start in (self.last, self.found[sample]):
            if start is not None and (seen := self._near(frame, start)) is not None:
                return seen
        self.last = None
        return None

    def _near(self, frame: Frame, start: Strip) -> Sight | None:
        grey = frame.grey
        strip = self._coarsely(grey, start)
        rows = np.arange(max(0, int(strip.tip) - AXIS_PX), int(strip.tip) + 1)
        sigma_slope = width = 0.0
        # a few rows first, then all
        for beside, every in ((5.0, 4), (2.5, 1)):
            some = rows[-1 :: -min(every, len(rows) // (2 * LEAST_RUN) or 1)]
            fitted = self._axis(grey, strip, some, self.looks.width / 2.0 + beside)
            if fitted is None:
                return None
            strip, sigma_slope, width = fitted
            tip = self._lower_end(grey, strip)
            if tip is None:
                return None
            strip = replace(strip, tip=tip)
            rows = np.arange(max(0, int(tip) - AXIS_PX), int(tip) + 1)
        if strip.tip > grey.shape[0] - 4:
            return None
        self.speed_px = max(abs(strip.tip - start.tip), 0.7 * self.speed_px)
        top = self._upper_end(grey, strip)
        self.last = replace(strip, top=strip.top if top is None else top)
        return Sight(
            number=frame.number,
            t_s=frame.t_s,
            column=strip.column,
            slope=strip.slope,
            sigma_slope=sigma_slope,
            width=width,
            tip=self._end(grey, strip, strip.tip, 1),
            top=None if top is None else self._end(grey, strip, top, -1),
        )

    def _coarsely(self, grey: Picture, start: Strip) -> Strip:
        """The strip that is strongest among those near ``start``."""
        low, high = max(start.top, start.tip - AXIS_PX), start.tip - 2.0
        rows = np.arange(low, high, max(1.0, (high - low) / 60.0)).astype(int)
        aside = np.arange(-ASIDE_PX, ASIDE_PX + 1)
        turns = np.linspace(-TURN, TURN, 11)
        at = start.at(rows)[None, None, :] + aside[:, None, None]
        at = at + turns[None, :, None] * (rows - start.tip)
        column = np.clip(np.round(at).astype(int), 0, grey.shape[1] - 1)
        share = self._share(grey[rows, column], self.looks.still[rows, column])
        i, k = np.unravel_index(np.argmax(share.mean(axis=-1)), share.shape[:2])
        slope = float(np.clip(start.slope + turns[k], -MOST_SLOPE, MOST_SLOPE))
        return replace(
            start, column=float(start.at(start.tip)) + aside[i] - slope * start.tip, slope=slope
        )

    def _share(self, level: Array | Picture, behind: Array) -> Array:
        """Contrast over the usual one, within bounds."""
        return np.asarray(np.clip((level - behind) * (self.sign / self.contrast), -0.5, MOST_LIKE))

    def _columns(
        self, strip: Strip, rows: NDArray[np.int64], half: float
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
        """Rows (rows, 1), the columns about the axis (rows, columns), and which share of each lies
        within ``half`` px of it."""
        wide = int(np.ceil(half)) + 1
        about = strip.at(rows)[:, None]
        column = np.round(about).astype(int) + np.arange(-wide, wide + 1)
        seen = np.clip(column, 0, self.looks.still.shape[1] - 1)
        part = np.clip(half + 0.5 - np.abs(column - about), 0.0, 1.0) * (column == seen)
        return rows[:, None], seen, part

    def _axis(
        self, grey: Picture, strip: Strip, rows: NDArray[np.int64], half: float
    ) -> tuple[Strip, float, float] | None:
        """The axis by the rows' centroids within ``half`` px of ``strip``'s, the standard error of
        its slope, and its width in px."""
        at, column, near = self._columns(strip, rows, half)
        share = self._share(grey[at, column], self.looks.still[at, column])
        weight = np.maximum(share - LEAST_LIKE, 0.0) * near
        mass = weight.sum(axis=1)
        usual = np.median(mass[mass > 0.2]) if (mass > 0.2).any() else 0.0
        good = (mass > 0.5 * usual) & (mass < 1.6 * usual)
        if good.sum() < LEAST_RUN or usual < 0.3:
            return None
        centre = (weight * column).sum(axis=1)[good] / mass[good]
        row = rows[good].astype(float)
        use = np.ones(len(row), dtype=bool)
        for _ in range(3):
            x, y = centre[use].mean(), row[use].mean()
            slope = (row[use] - y) @ centre[use] / max(float((row[use] - y) @ row[use]), 1e-9)
            column_0 = x - slope * y
            left = centre - column_0 - slope * row
            spread = 1.4826 * np.median(np.abs(left[use])) + 0.02
            use = np.abs(left) < 3.0 * spread
        left = left[use]
        # neighbouring rows err alike, by compression above all
        memory = np.corrcoef(left[1:], left[:-1])[0, 1] if len(left) > 9 else 0.5
        memory = np.clip(memory, 0.0, 0.95)
        count = max(len(left) * (1.0 - memory) / (1.0 + memory), 3.0)
        if abs(slope) > 1.2 * MOST_SLOPE:
            return None
        fitted = replace(strip, column=float(column_0), slope=float(slope))
        error = np.hypot(max(left.std(), 0.02) / np.sqrt(count), AXIS_SIGMA_PX)
        sigma_slope = float(error / max(row[use].std(), 1.0))
        return fitted, sigma_slope, float(usual / np.median(weight.max(axis=1)[good]))

    def along(self, picture: Array | Picture, strip: Strip, rows: NDArray[np.int64]) -> Array:
        """Means over the inner width of the strip, row by row, of a picture."""
        at, column, part = self._columns(strip, rows, self.inner / 2.0)
        whole = np.maximum(part.sum(axis=1), 1e-9)
        return np.asarray((picture[at, column] * part).sum(axis=1) / whole)

    def _end_of(self, grey: Picture, strip: Strip, rows: NDArray[np.int64]) -> tuple[int, Array]:
        """Which of the rows is the strip's last, and its share (rows,) of the contrast: there the
        sum of what exceeds a half is greatest."""
        behind = self.along(self.looks.still, strip, rows)
        share = self._share(self.along(grey, strip, rows), behind)
        return int(np.argmax(np.cumsum(share - 0.5))), share

    def _lower_end(self, grey: Picture, strip: Strip) -> float | None:
        """The row at which the strip ends; None where it has too little contrast above."""
        sure = strip.tip - 2.0 * self.speed_px
        begin = int(max(0.0, np.clip(strip.top, sure - 160.0, sure - 60.0)))
        rows = np.arange(begin, grey.shape[0])
        end, share = self._end_of(grey, strip, rows)
        above = share[max(0, end - 40) : max(end - 3, 1)]
        if end < LEAST_RUN or above.mean() < LEAST_SHARE:
            return None
        usual = float(np.median(above))
        self.contrast *= float(np.clip(usual, 0.9, 1.1))
        return float(rows[end]) + 0.5

    def _upper_end(self, grey: Picture, strip: Strip) -> float | None:
        """The row above which the strip is no more; None where that is not in the picture."""
        rows = np.arange(int(strip.tip) - 10, -1, -1)
        row = float(rows[self._end_of(grey, strip, rows)[0]]) - 0.5
        return None if row < 4.0 else row

    def _end(self, grey: Picture, strip: Strip, row: float, down: int) -> End:
        """Levels about an end, from inside outward."""
        reach = WINDOW_PX + int(1.2 * self.speed_px)
        rows = np.round(row).astype(int) + down * np.arange(-reach, reach + 1)
        inside = (rows >= 0) & (rows < grey.shape[0])
        rows = rows[inside]
        return End(
            row,
            rows.astype(float),
            self.along(grey, strip, rows),
            self.along(self.looks.still, strip, rows),
        )
