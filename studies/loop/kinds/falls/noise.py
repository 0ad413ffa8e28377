"""Noise of a fall's mean readings, from what each fall shows beyond a smooth course.

What the bins of a fall have beyond a parabola of their own is noise; a higher degree serves where
that takes away most of the rest. So no misfit as smooth as that is in it. Its standard deviation,
the growth of that over a fall (a body in air is buffeted the more the faster it is) and the
correlation of neighbouring bins are the restricted likelihood's (H. D. Patterson and R. Thompson,
Biometrika 58 (1971) 545), which minds what polynomials take of such a noise. What stays for longer
than a few bins is no noise but motion: correlations end at `MOST`.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .....solver.arrays import Array

DEGREES = (2, 3, 4)
# A higher degree is taken where it leaves less than this share of the variance.
WORTH = 0.5
MOST = 0.6
CORRELATIONS = np.linspace(0.0, MOST, 13)
GROWTHS = np.linspace(-3.0, 3.0, 13)
NONE = np.zeros(1)
# Nats that a growth or a correlation must gain: the 95 % point of a likelihood ratio.
GAIN = 1.92


class Noise(NamedTuple):
    """Noise of a bin: standard deviation in m/s² half-way, the logarithm of its growth from a
    record's first bin to its last, and its correlation with its neighbour."""

    sigma_m_s2: float
    growth: float = 0.0
    correlation: float = 0.0

    def deviation(self, n: int) -> Array:
        """Standard deviations (n,) in m/s² of the bins of a record."""
        return np.asarray(self.sigma_m_s2 * np.exp(self.growth * (np.linspace(-0.5, 0.5, n))))

    def covariance(self, n: int) -> Array:
        """Covariance (n, n) of the bins of a record: correlations are powers of their distance."""
        apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
        each = self.deviation(n)
        return np.asarray(np.outer(each, each) * self.correlation**apart)


def noise_of(times_s: Sequence[Array], means_m_s2: Sequence[Array]) -> Noise:
    """The noise of bins at ``times_s`` that read ``means_m_s2``, an array a fall of each."""
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
    excess = _beyond(times_s, means_m_s2, degree)
    freedom = sum(values.size for _, values in excess)

    def height(growth: float, correlation: float) -> tuple[float, Noise]:
        plain = Noise(1.0, growth, correlation)
        squares = logs = 0.0
        for bases, values in excess:
            own = np.swapaxes(bases, 1, 2) @ plain.covariance(bases.shape[1]) @ bases
            squares += float(np.sum(values * np.linalg.solve(own, values[..., None])[..., 0]))
            logs += float(np.linalg.slogdet(own)[1].sum())
        sigma = np.sqrt(squares / freedom)
        found = -freedom * np.log(max(sigma, 1e-150)) - 0.5 * logs
        return float(found), plain._replace(sigma_m_s2=float(sigma))

    # the fewest numbers first: a further one has to earn its place
    best, found = height(0.0, 0.0)
    for growths, correlations in ((GROWTHS, NONE), (NONE, CORRELATIONS), (GROWTHS, CORRELATIONS)):
        several = [height(float(a), float(b)) for a, b in itertools.product(growths, correlations)]
        top, likeliest = max(several)
        further = np.count_nonzero(likeliest[1:]) - np.count_nonzero(found[1:])
        if top > best + GAIN * max(further, 0):
            best, found = top, likeliest
    return found


def _beyond(
    times_s: Sequence[Array], means_m_s2: Sequence[Array], degree: int
) -> list[tuple[Array, Array]]:
    """Orthonormal bases (falls, n, n - degree - 1) of what is no polynomial of that degree, and the
    readings in them (falls, n - degree - 1), of falls with equally many bins n together."""
    alike: dict[int, list[tuple[Array, Array]]] = {}
    for time, mean in zip(times_s, means_m_s2, strict=True):
        share = (time - time[0]) / (time[-1] - time[0])
        basis = np.linalg.qr(np.vander(share, degree + 1), mode="complete")[0][:, degree + 1 :]
        alike.setdefault(len(time), []).append((basis, basis.T @ mean))
    return [
        (np.stack([basis for basis, _ in each]), np.stack([values for _, values in each]))
        for each in alike.values()
    ]
