"""Whitened rows of falls that do not depend on when each body was let go.

A record does not say when the fall began. One number of each fall is spent on that: its mean
reading. Rows are the means over `BIN_S` less that mean, one fewer than bins: contrasts C m of the
bins m, C a reflection that takes the mean to the middle bin (Householder; Golub and Van Loan,
Matrix Computations, §5.1). The mean carries noise, which moves the release and with it what is
predicted, in proportion to the slope s there: the noise e of the bins reaches the rows as
C (1 − s 1ᵀ/n) e, s of mean one. They are whitened by its covariance, symmetrically, so that each
row stays close to its bin. The slope is that of a small drag from release on, where the record
begins: one that begins later has less noise than that, along its trend and by √(4/3) at most.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from .....solver.arrays import Array
from ....data.tables import InPieces
from .noise import Noise, noise_of
from .record import BIN_S, LEAST_BINS, Falls

ROUNDED_TOGETHER = 10.0
"""By how much averaging betters the rounding of a reading, at best."""


@dataclass(frozen=True)
class Bins(InPieces):
    """Means of neighbouring readings: ``begin_s``, ``end_s``, ``mean_m_s2`` (bins,), times from the
    record's first sample; ``begins`` (falls + 1,) says where each fall's begin."""

    data: Falls
    begin_s: Array
    end_s: Array
    mean_m_s2: Array
    begins: NDArray[np.int64]

    @cached_property
    def middle_s(self) -> Array:
        return 0.5 * (self.begin_s + self.end_s)

    @cached_property
    def level_m_s2(self) -> Array:
        """Mean over the bins of each fall (falls,)."""
        return np.array([self.mean_m_s2[piece].mean() for piece in self.pieces])

    @cached_property
    def noise(self) -> Noise:
        """The measured noise of a bin (`falls_noise`), no less than rounding leaves."""
        several = [self.middle_s[p] for p in self.pieces], [self.mean_m_s2[p] for p in self.pieces]
        found = noise_of(*several)
        # readings come in steps: no mean is known better than the rounding of one of them
        steps = np.diff(np.unique(self.data.reading_m_s2))
        least = steps[steps > 0.0].min(initial=1.0) / np.sqrt(12.0) / ROUNDED_TOGETHER
        return found if found.sigma_m_s2 > least else Noise(float(least))

    @cached_property
    def sigma_m_s2(self) -> Array:
        """Standard deviation (bins,) of each bin's noise."""
        return np.concatenate([self.noise.deviation(p.stop - p.start) for p in self.pieces])

    @cached_property
    def bin_of_row(self) -> NDArray[np.int64]:
        """The bin that each row (rows,) differs least from: all but the middle one of each fall."""
        middles = [(piece.start + piece.stop) // 2 for piece in self.pieces]
        return np.delete(np.arange(len(self.mean_m_s2)), middles)

    @cached_property
    def _maps(self) -> list[Array]:
        return [_map(self.middle_s[piece], self.noise) for piece in self.pieces]

    def rows(self, readings_m_s2: Array) -> Array:
        """Whitened rows (..., rows) of mean readings (..., bins), see the file's head."""
        several = zip(self._maps, self.pieces, strict=True)
        return np.concatenate([readings_m_s2[..., p] @ m.T for m, p in several], axis=-1)


def in_bins(data: Falls) -> Bins:
    """Means over equal parts of about `BIN_S` of each fall, at least six."""
    bins, starts = [], [0]
    for piece in data.pieces:
        times, reading = data.times_s[piece], data.reading_m_s2[piece]
        times = times - times[0]
        count = max(LEAST_BINS, round(times[-1] / BIN_S))
        edges = np.round(np.linspace(0, len(times), count + 1)).astype(int)
        half = 0.5 * times[-1] / (len(times) - 1)
        for a, b in pairwise(edges):
            bins.append((times[a] - half, times[b - 1] + half, reading[a:b].mean()))
        starts.append(len(bins))
    begin, end, mean = np.array(bins).T.copy()
    return Bins(data, begin, end, mean, np.array(starts))


def _map(time_s: Array, noise: Noise) -> Array:
    """From a fall's bins in m/s² to its whitened rows (bins - 1, bins)."""
    n = len(time_s)
    mirror = np.full(n, 1.0 / np.sqrt(n))
    mirror[n // 2] -= 1.0
    mirror /= np.linalg.norm(mirror)
    contrasts = np.delete(np.eye(n) - 2.0 * np.outer(mirror, mirror), n // 2, axis=0)
    reaching = contrasts @ (np.eye(n) - np.outer(time_s / time_s.mean(), np.full(n, 1.0 / n)))
    variance, along = np.linalg.eigh(reaching @ noise.covariance(n) @ reaching.T)
    return np.asarray((along / np.sqrt(variance)) @ along.T @ contrasts)
