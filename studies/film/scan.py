"""The first look at a film: samples of what moves, the noise, and the picture without the body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...solver.arrays import Array
from ...solver.errors import InputError
from .reading import Film, Frame, Picture

# Samples of a film, and the most memory that they take.
SAMPLES, SAMPLE_BYTES = 32, 40_000_000
LEAST_SAMPLES = 12
LEAST_FRAMES = 6
LEAST_CLEAR = 3
"""Samples that show a pixel of the background: one of them may be mistaken."""
LEAST_NOISE = 0.6
"""In grey levels: rounding to whole levels alone has 0.3, in either of two frames compared."""
CHANGED = 12
"""Grey levels by which a pixel changes where something moves; noise and flicker change less."""
STILL = 0.25
"""How much a frame in which nothing moves counts where samples are chosen."""
MOST_PIXELS = 15_000
"""On how many pixels a change is looked for."""


@dataclass(frozen=True)
class Scan:
    """What one reading of a film tells.

    ``t_s`` (frames,); ``samples`` (samples, rows, columns) and ``number`` (samples,) are frames
    chosen evenly over what moves; ``noise`` is a pixel's standard deviation in grey levels.
    ``damage`` are sentences that say what is wrong with the film, such as pictures left out.
    """

    t_s: Array
    number: Array
    samples: Picture
    noise: float
    damage: tuple[str, ...] = ()

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.samples.shape[1], self.samples.shape[2]


def scan(film: Film) -> Scan:
    """Read a film once. Raises InputError where it has too few frames."""
    damage: list[str] = []
    frames = film.frames(damage.append)
    first = next(frames)
    rows, columns = first.grey.shape
    most = int(np.clip(SAMPLE_BYTES // (rows * columns), LEAST_SAMPLES, SAMPLES))
    step = max(1, int(np.sqrt(rows * columns / MOST_PIXELS)))
    kept, times, spread = _Kept(first.grey, most), [first.t_s], []
    last = first.grey[::step, ::step].astype(np.int16)
    for frame in frames:
        coarse = frame.grey[::step, ::step].astype(np.int16)
        change = np.abs(coarse - last)
        last = coarse
        spread.append(float(np.mean(change[change <= np.percentile(change, 90)] ** 2)))
        kept.add(frame, bool((change > CHANGED).any()))
        times.append(frame.t_s)
    if len(times) < LEAST_FRAMES:
        raise InputError(f"{film.path}: {len(times)} frames; {LEAST_FRAMES} or more are needed")
    # of a normal distribution, values within its 90th percentile of size have 0.48 of its variance;
    # a difference has twice the variance of a frame
    noise = float(np.sqrt(np.median(spread) / 0.48 / 2.0))
    number, samples = kept.evenly()
    return Scan(np.array(times), number, samples, max(noise, LEAST_NOISE), tuple(damage))


class _Kept:
    """Frames chosen so that as many in which something moves lie between one and the next, without
    knowing how many come."""

    def __init__(self, first: Picture, most: int) -> None:
        self.most, self.every, self.count = most, 0.0, 0.0
        # each with how many came before it
        self.frames: list[tuple[float, int, Picture]] = [(0.0, 0, first)]

    def add(self, frame: Frame, moves: bool) -> None:
        # what is held still shows the background below it, of which a few samples are enough
        self.count += 1.0 if moves else STILL
        if self.count - self.frames[-1][0] < self.every:
            return
        self.frames.append((self.count, frame.number, frame.grey))
        if len(self.frames) >= 2 * self.most:
            self.every = self.count / self.most
            self.frames = self.apart()

    def apart(self) -> list[tuple[float, int, Picture]]:
        """Frames that are ``every`` or more from the one before."""
        kept = self.frames[:1]
        for each in self.frames[1:]:
            if each[0] - kept[-1][0] >= self.every:
                kept.append(each)
        return kept

    def evenly(self) -> tuple[Array, Picture]:
        """Numbers and pictures of the samples."""
        if len(self.frames) > self.most:
            self.every = max(self.every, self.count / self.most)
        chosen = self.apart()
        return np.array([number for _, number, _ in chosen]), np.stack([g for *_, g in chosen])


def clear_background(samples: Picture, covered: NDArray[np.bool_]) -> Array:
    """The picture (rows, columns) without the body: the median of what is not ``covered``.

    ``covered`` (samples, rows, columns) is boolean. A pixel that fewer than `LEAST_CLEAR` samples
    show is made of the nearest ones beside it.
    """
    still = np.empty(samples.shape[1:], dtype=np.float32)
    for row in range(len(still)):  # all at once would take much memory
        clear = ~covered[:, row]
        still[row] = median_of(samples[:, row].astype(np.float32), clear, axis=0)
        there = clear.sum(axis=0) >= LEAST_CLEAR
        if there.any():
            column = np.arange(len(there))
            still[row] = np.interp(column, column[there], still[row, there])
    return still


def median_of(values: Array, used: NDArray[np.bool_], axis: int) -> Array:
    """Medians along an axis of what is ``used``; of all where nothing is."""
    used = used | ~used.any(axis=axis, keepdims=True)
    ordered = np.sort(np.where(used, values, np.inf), axis=axis)  # what is not used comes last
    count = used.sum(axis=axis, keepdims=True)
    middle = np.concatenate([(count - 1) // 2, count // 2], axis=axis)
    return np.asarray(np.take_along_axis(ordered, middle, axis=axis).mean(axis=axis))


def coarser(pictures: Array | Picture, factor: int) -> Array:
    """Means over squares of so many pixels, of pictures (..., rows, columns)."""
    rows, columns = (side // factor for side in pictures.shape[-2:])
    cut = pictures[..., : rows * factor, : columns * factor]
    blocks = cut.reshape(*cut.shape[:-2], rows, factor, columns, factor)
    return np.asarray(blocks.mean(axis=(-3, -1), dtype=np.float32))
