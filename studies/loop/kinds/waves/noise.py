"""Noise of a wave record, measured where no misfit of a model can change it, and whitening by it.

The electrical noise shows in the quiet stretch before the pulse. Its spectrum is taken to be flat
or, where Whittle's likelihood (J. R. Stat. Soc. B 15 (1953) 125) asks for it, of several levels.
Two gauges on opposite faces: their half-difference while waves pass holds no axial wave, and where
each carries disturbances of its own (bending, electrical noise) it scatters as much as their mean
does. The larger of both counts, and of the ``sigma`` that may be declared.
Measured ones are larger by their standard error, since the loop takes them as known. What else a
gauge does not reproduce, such as bending that one gauge cannot tell from an axial wave, is not in
it: that is a misfit, and looks like one.

The first pass is measured too. Its noise is carried along with it and returns in every prediction,
the same in all, and so does the error of the offset, which is the quiet stretch's mean. Rows of
several windows therefore share noise. Those that are fitted are whitened together by the Cholesky
factor of its covariance, in their order: of each row counts what the rows before it do not tell of
its noise. Rows that are held out stay as they are, each by its own standard deviation.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .....solver.arrays import Array
from .propagation import Windows
from .record import Gauge, Waves

Power = Callable[[Array], Array]
ENOUGH_POINTS, LEAST_POINTS = 60, 8
FINEST = 1e-6
"""Of the largest signal: converters have up to 18 bits, and no noise is smaller."""
REACH = 8.0
"""Frequencies that tell of the noise, in units of the highest used, where they are enough."""


def quiet_power(data: Waves, gauge: Gauge, band_Hz: float) -> Power:
    """Mean square of a component of the noise at frequencies in Hz, in the unit squared.

    No less than what rounding to the record's steps makes of a signal that crosses many (W. R.
    Bennett, Bell Syst. Tech. J. 27 (1948) 446), which the quiet stretch, within one, need not show.
    Raises InputError where there is no noise at all.
    """
    sigma = max(0.0 if data.sigma is None else data.sigma, _resolution(gauge) / math.sqrt(12.0))
    least, largest = sigma**2, np.abs(gauge.signal).max()
    samples = gauge.signal[: data.quiet]
    if not np.any(np.abs(samples - samples.mean()) > 1e-12 * largest):
        if sigma < FINEST * largest:
            raise data.manifest.wrong(
                "baseline_until_s",
                "leaves samples without any noise; declare the sigma of a sample in [measurement]",
            )
        return lambda frequency_Hz: np.full(np.shape(frequency_Hz), least)
    power = np.abs(np.fft.rfft(samples)[1:]) ** 2 / len(samples)
    frequency = np.arange(1, len(power) + 1) / (len(samples) * data.step_s)
    count = max(ENOUGH_POINTS, int(np.count_nonzero(frequency <= REACH * band_Hz)))
    smooth = _smooth(frequency[:count], power[:count])
    return lambda frequency_Hz: np.maximum(smooth(frequency_Hz), least)


def _resolution(gauge: Gauge) -> float:
    """The step in which the samples come; less than any converter's where they come in none."""
    steps, whole = np.diff(np.unique(gauge.signal)), np.ptp(gauge.signal)
    return float(steps[steps > FINEST * whole].min(initial=whole))


def _smooth(frequency: Array, power: Array) -> Power:
    """A spectrum through a periodogram (points,), larger by its standard error.

    Flat; or, where that is far likelier (twice Schwarz's penalty), level by level of bands that are
    as wide as the frequencies below them.
    """
    ends = [len(power)]
    while ends[0] // 2 >= LEAST_POINTS:
        ends.insert(0, ends[0] // 2)
    bands = np.split(np.arange(len(power)), ends[:-1])
    several = np.array([power[band].mean() for band in bands])
    sizes = np.array([len(band) for band in bands])
    flat = power.mean()
    # at the best level the ratios of power to it are one in the mean, whatever the bands
    gain = len(power) * np.log(flat) - float(np.sum(sizes * np.log(np.maximum(several, 1e-300))))
    if gain < (len(bands) - 1) * np.log(len(power)):
        several, sizes = np.full(1, flat), np.array([len(power)])
        bands = [np.arange(len(power))]
    levels = several * (1.0 + np.sqrt(1.0 / sizes))
    centres = np.array([np.log(frequency[band]).mean() for band in bands])

    def at(frequency_Hz: Array) -> Array:
        return np.asarray(np.interp(np.log(np.maximum(frequency_Hz, 1e-300)), centres, levels))

    return at


def power_of(data: Waves, gauge: Gauge, band_Hz: float, windows: Windows) -> Power:
    """The larger of `quiet_power` and what the half-difference of gauges on opposite faces has in
    the windows, where there are two."""
    quiet = quiet_power(data, gauge, band_Hz)
    if gauge.difference is None:
        return quiet
    squares = windows.components(gauge.difference).reshape(-1, windows.rows) ** 2
    mean = squares.mean(axis=0)
    power = np.concatenate([mean[:1], 0.5 * (mean[1::2] + mean[2::2])])
    # a bin is an estimate with few degrees of freedom: take neighbours along
    smooth = np.convolve(np.pad(power, 1, mode="edge"), np.full(3, 1 / 3), mode="valid")
    error = math.sqrt(1.0 / (3.0 * len(windows.begins)))
    frequency = np.arange(windows.bins) / (windows.samples * windows.step_s)
    corrected = smooth * (1.0 + error)
    return larger(quiet, lambda frequency_Hz: np.interp(frequency_Hz, frequency, corrected))


def larger(one: Power, other: Power) -> Power:
    """The larger of both at each frequency."""
    return lambda frequency_Hz: np.maximum(one(frequency_Hz), other(frequency_Hz))


@dataclass(frozen=True)
class Whitening:
    """What makes rows of noise rows of independent unit noise: ``factor`` (rows, rows), lower
    triangular, and ``scale`` (rows,), what a whitened row is worth in the unit."""

    factor: Array
    scale: Array


def whitening(own: Array, shared: Array, fitted: NDArray[np.bool_]) -> Whitening:
    """From each row's own standard deviation (rows,) and what standard normal numbers that rows
    share do to each, ``shared`` (rows, numbers); ``fitted`` (rows,) are whitened together."""
    factor = np.zeros((len(own), len(own)))
    total = np.sqrt(own**2 + np.sum(shared**2, axis=1))
    scale = total.copy()
    apart = np.flatnonzero(~fitted)
    factor[apart, apart] = 1.0 / total[apart]
    chosen = np.flatnonzero(fitted)
    covariance = np.diag(own[chosen] ** 2) + shared[chosen] @ shared[chosen].T
    root = np.linalg.cholesky(covariance)
    factor[np.ix_(chosen, chosen)] = np.linalg.inv(root)
    scale[chosen] = np.diag(root)
    return Whitening(factor, scale)
