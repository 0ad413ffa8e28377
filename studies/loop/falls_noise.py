"""Noise of a fall's mean readings, from what replicates show beyond a smooth course.

What the bins of a fall have beyond a polynomial of their own, less what all falls share at that
part of their record, is noise: no misfit common to all falls is in it, nor any that is as smooth. A
parabola serves, and a higher degree where that takes away most of the rest. Standard deviation and
correlation of neighbouring bins (a body in air is buffeted, a sensor filters) are the restricted
likelihood's (H. D. Patterson and R. Thompson, Biometrika 58 (1971) 545), which minds what the
polynomials take of a correlated noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...solver.bristle import Array

DEGREES = (2, 3, 4)
# A higher degree is taken where it leaves less than this share of the variance.
WORTH = 0.5
PARTS = 8
CORRELATIONS = np.linspace(0.0, 0.9, 37)
# Nats that a correlation must gain: the 95 % point of a likelihood ratio.
GAIN = 1.92


class Noise(NamedTuple):
    """Standard deviation in m/s² of a bin, and its correlation with its neighbour."""

    sigma_m_s2: float
    correlation: float

    def covariance(self, n: int) -> Array:
        """Covariance (n, n) of neighbouring bins: correlations are powers of their distance."""
        apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
        return np.asarray(self.sigma_m_s2**2 * self.correlation**apart)


def noise_of(times_s: Sequence[Array], means_m_s2: Sequence[Array]) -> Noise:
    """The noise of bins at ``times_s`` that read ``means_m_s2``, an array of each for every fall.

    Falls have at least four bins, and there are at least two.
    """
    found = _likeliest(times_s, means_m_s2, DEGREES[0])
    for degree in DEGREES[1:]:
        if min(len(time) for time in times_s) < degree + 2:
            break
        further = _likeliest(times_s, means_m_s2, degree)
        if further.sigma_m_s2**2 >= WORTH * found.sigma_m_s2**2:
            break
        found = further
    return found


def _likeliest(times_s: Sequence[Array], means_m_s2: Sequence[Array], degree: int) -> Noise:
    bases, left, part = [], [], []
    for time, mean in zip(times_s, means_m_s2, strict=True):
        share = (time - time[0]) / (time[-1] - time[0])
        beyond = np.linalg.qr(np.vander(share, degree + 1), mode="complete")[0][:, degree + 1 :]
        bases.append(beyond)
        left.append(beyond @ (beyond.T @ mean))
        part.append(np.minimum((PARTS * share).astype(int), PARTS - 1))
    shared = [_mean(left, part, each) for each in range(PARTS)]
    falls = len(bases)
    widened = np.sqrt(falls / (falls - 1))
    seen = [
        widened * (basis.T @ (own - np.array(shared)[where]))
        for basis, own, where in zip(bases, left, part, strict=True)
    ]
    freedom = sum(len(each) for each in seen)
    heights, variances = [], []
    for correlation in CORRELATIONS:
        squares = logs = 0.0
        for basis, values in zip(bases, seen, strict=True):
            own = basis.T @ Noise(1.0, float(correlation)).covariance(len(basis)) @ basis
            squares += values @ np.linalg.solve(own, values)
            logs += np.linalg.slogdet(own)[1]
        variances.append(squares / freedom)
        heights.append(-0.5 * (freedom * np.log(max(squares, 1e-300)) + logs))
    best = int(np.argmax(heights))
    if heights[best] < heights[0] + GAIN:
        best = 0
    return Noise(float(np.sqrt(variances[best])), float(CORRELATIONS[best]))


def _mean(left: Sequence[Array], part: Sequence[Array], which: int) -> float:
    """What all falls have on average in one part of their records."""
    several = np.concatenate([own[at == which] for own, at in zip(left, part, strict=True)])
    return float(several.mean()) if len(several) else 0.0
