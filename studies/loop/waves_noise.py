"""Noise of a wave record, measured where no misfit of a model can change it, and whitening by it.

The electrical noise shows in the quiet stretch before the pulse. Its spectrum is smooth: the
logarithm of the periodogram is fitted by a polynomial in the logarithm of frequency by Whittle's
likelihood (P. Whittle, J. R. Stat. Soc. B 15 (1953) 125), of the order that Akaike's criterion
takes. Two gauges on opposite faces: their half-difference while waves pass holds no axial wave, and
where each carries disturbances of its own (bending, electrical noise) it scatters as much as their
mean does. The larger of both counts, and of the ``sigma`` that may be declared. What else a gauge
does not reproduce, such as bending that one gauge cannot tell from an axial wave, is not in it:
that is a misfit, and looks like one.

The first pass is measured too. Its noise is carried along with it and returns in every prediction,
the same in all, and so does the error of the offset, which is the quiet stretch's mean. Rows of
several windows therefore share noise. Those that are fitted are whitened together by the Cholesky
factor of its covariance, in their order: of each row counts what the rows before it do not tell of
its noise. Rows that are held out stay as they are, each by its own standard deviation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from ...solver.bristle import Array
from .waves_propagation import Windows
from .waves_record import Gauge, Waves

Power = Callable[[Array], Array]
ORDERS = 3
REACH = 4.0
"""Frequencies that tell of the noise, in units of the highest used."""
LEAST_POINTS = 6


def quiet_power(data: Waves, gauge: Gauge, band_Hz: float) -> Power:
    """Mean square of a component of the noise at frequencies in Hz, in the unit squared.

    Few samples tell it to within a factor: it is larger by what that adds to the mean of squares
    over it, ν / (ν − 2) at ν degrees of freedom. Raises InputError where there is no noise at all.
    """
    least = 0.0 if data.sigma is None else data.sigma**2
    samples = gauge.signal[: data.quiet]
    if not np.any(np.abs(samples - samples.mean()) > 1e-12 * np.abs(gauge.signal).max()):
        if data.sigma is None:
            raise data.manifest.wrong(
                "baseline_until_s",
                "leaves samples without any noise; declare the sigma of a sample in [measurement]",
            )
        return lambda frequency_Hz: np.full(np.shape(frequency_Hz), least)
    power = np.abs(np.fft.rfft(samples)[1:]) ** 2 / len(samples)
    frequency = np.arange(1, len(power) + 1) / (len(samples) * data.step_s)
    used = frequency <= REACH * band_Hz
    used[:LEAST_POINTS] = True
    fitted, top = _whittle(frequency[used], power[used]), frequency[used].max()
    bottom = frequency[0]

    def at(frequency_Hz: Array) -> Array:
        return np.maximum(fitted(np.clip(frequency_Hz, bottom, top)), least)

    return at


def _whittle(frequency: Array, power: Array) -> Power:
    """A smooth spectrum through a periodogram, larger by what its own uncertainty asks for."""
    middle = np.log(frequency).mean()
    best, chosen = np.inf, (np.array([np.log(power.mean())]), 1)
    for order in range(ORDERS):
        if len(power) < LEAST_POINTS * (order + 1):
            break
        terms = np.vander(np.log(frequency) - middle, order + 1, increasing=True)

        def cost(c: Array, terms: Array = terms) -> tuple[float, Array]:
            level = np.clip(terms @ c, -600.0, 600.0)
            ratio = power * np.exp(-level)
            return float(np.sum(level + ratio)), terms.T @ (1.0 - ratio)

        start = np.zeros(order + 1)
        start[0] = np.log(power.mean())
        found = minimize(cost, start, jac=True, method="BFGS")
        score = 2.0 * found.fun + 2.0 * (order + 1)
        if score < best:
            best, chosen = score, (found.x, order + 1)
    coefficients, count = chosen
    freedom = max(3.0, 2.0 * len(power) / count)

    def at(frequency_Hz: Array) -> Array:
        terms = np.vander(np.log(frequency_Hz) - middle, count, increasing=True)
        return np.asarray(np.exp(terms @ coefficients) * freedom / (freedom - 2.0))

    return at


def apart_power(gauge: Gauge, windows: Windows) -> Power | None:
    """The same from the half-difference of gauges on opposite faces; None where there is none."""
    if gauge.difference is None:
        return None
    squares = windows.components(gauge.difference).reshape(-1, windows.rows) ** 2
    mean = squares.mean(axis=0)
    power = np.concatenate([mean[:1], 0.5 * (mean[1::2] + mean[2::2])])
    # a bin is an estimate with few degrees of freedom: take neighbours along
    smooth = np.convolve(np.pad(power, 1, mode="edge"), np.full(3, 1 / 3), mode="valid")
    freedom = 6.0 * len(windows.begins)
    frequency = np.arange(windows.bins) / (windows.samples * windows.step_s)
    corrected = smooth * freedom / (freedom - 2.0)
    return lambda frequency_Hz: np.interp(frequency_Hz, frequency, corrected)


@dataclass(frozen=True)
class Whitening:
    """What makes rows of noise rows of independent unit noise: ``factor`` (rows, rows), lower
    triangular, and ``scale`` (rows,), what a whitened row is worth in the unit."""

    factor: Array
    scale: Array


def whitening(own: Array, shared: Array, fitted: Array) -> Whitening:
    """From each row's own standard deviation (rows,) and what standard normal numbers that rows
    share do to each, ``shared`` (rows, numbers); ``fitted`` (rows,) are whitened together."""
    factor = np.zeros((len(own), len(own)))
    total = np.sqrt(own**2 + np.sum(shared**2, axis=1))
    scale = total.copy()
    apart = np.flatnonzero(~fitted)
    factor[apart, apart] = 1.0 / total[apart]
    kept = np.flatnonzero(fitted)
    covariance = np.diag(own[kept] ** 2) + shared[kept] @ shared[kept].T
    root = np.linalg.cholesky(covariance)
    factor[np.ix_(kept, kept)] = np.linalg.inv(root)
    scale[kept] = np.diag(root)
    return Whitening(factor, scale)
