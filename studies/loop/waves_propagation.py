"""What are the values of a wave record, how noisy are they, and how is the first pass carried on?

The values are, pass by pass, the components of the record in that pass's window along cosines and
sines of whole periods (orthonormal, so windows need no taper: the prediction is cut by the same
windows), from zero up to where the first pass stands out of the noise. A pass is a group; its rows
share one window and one driving pulse and are not independent.

The noise is measured, frequency by frequency. Two gauges on opposite faces: their half-difference
holds no axial wave, and where each carries disturbances of its own (bending, electrical noise) it
scatters as much as their mean does. One gauge: what stands before ``baseline_until_s``, twice,
since the driving pulse carries it too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.fft import next_fast_len

from ...solver.bristle import Array
from .rod import Complex, Rod
from .waves_record import Waves

STANDS_OUT = 2.0
"""How far the first pass must rise above the noise for a frequency to be used."""
LEAST_WINDOW = 16
"""Samples of a pass."""
BEYOND = 4.0
"""Frequencies that are propagated, in units of the highest used: windows mix neighbours."""


@dataclass(frozen=True)
class Propagation:
    """The first pass, carried on to the windows of the later ones.

    ``data`` and the ``rod`` say all; frequencies are those of a record padded with zeros, so that
    nothing wraps around.
    """

    data: Waves
    rod: Rod

    @cached_property
    def n_passes(self) -> int:
        """How many further passes ``predict_s`` holds: its length over the time of one."""
        begin, end = self.data.predict_s
        return max(1, round((end - begin) / (self.rod.length_m / self.declared_speed_m_s)))

    @property
    def declared_speed_m_s(self) -> float:
        return self.data.manifest.bristle.material.bar_speed_m_s

    @cached_property
    def window(self) -> int:
        """Samples of the window of one pass."""
        begin, end = self.data.predict_s
        samples = int((end - begin) / self.n_passes / self.data.step_s)
        if samples < LEAST_WINDOW:
            raise self.data.manifest.wrong(
                "predict_s",
                f"has {samples} samples a pass of the declared bar; {LEAST_WINDOW} are needed",
            )
        return samples

    def starts(self) -> list[int]:
        """The first sample of each window."""
        begin, end = self.data.predict_s
        edges = begin + (end - begin) * np.arange(self.n_passes) / self.n_passes
        return [int(i) for i in np.searchsorted(self.data.times_s, edges - 1e-6 * self.data.step_s)]

    @cached_property
    def sigma(self) -> Array:
        """Noise of the components at each frequency of a window (window // 2,), in the unit."""
        data = self.data
        quiet = int(np.count_nonzero(data.times_s < data.baseline_until_s))
        if data.difference is not None:
            pieces = [data.difference[i : i + self.window] for i in self.starts()]
            power = np.mean([self._power(piece) for piece in pieces], axis=0)
        else:
            length = min(quiet, self.window)
            begins = np.unique(np.linspace(0, quiet - length, 3).astype(int))
            power = 2 * np.mean([self._power(data.signal[i : i + length]) for i in begins], axis=0)
        # a bin of one window is an estimate with few degrees of freedom: take neighbours along
        smooth = np.convolve(np.pad(power, 1, mode="edge"), np.full(3, 1 / 3), mode="valid")
        if not np.all(smooth > 0.0):
            raise data.manifest.wrong("baseline_until_s", "leaves samples without any noise")
        return np.asarray(np.sqrt(smooth))

    def _power(self, piece: Array) -> Array:
        """Mean square of cosine and sine components at each frequency of a window."""
        spectrum = np.fft.rfft(piece, self.window)[: self.window // 2]
        return np.asarray(np.abs(spectrum) ** 2 / len(piece))

    @cached_property
    def bins(self) -> int:
        """Frequencies used, zero among them: up to the first that drowns in the noise."""
        first = np.sqrt(self._power(self.driving[: self.window]))
        drowned = np.flatnonzero(first < STANDS_OUT * self.sigma)
        count = int(drowned[0]) if len(drowned) else len(first)
        if count < 3:
            raise self.data.manifest.wrong("first_pass_s", "holds no pulse above the noise")
        return count

    @property
    def resolution_Hz(self) -> float:
        """What separates two frequencies of a window."""
        return 1.0 / (self.window * self.data.step_s)

    @cached_property
    def basis(self) -> Array:
        """Orthonormal cosines and sines (rows of a window, window)."""
        at = np.arange(self.window) / self.window
        turns = 2 * np.pi * np.arange(1, self.bins)[:, None] * at
        pairs = np.stack([np.cos(turns), np.sin(turns)], axis=1).reshape(-1, self.window)
        constant = np.full((1, self.window), math.sqrt(0.5))
        return np.vstack([constant, pairs]) * math.sqrt(2.0 / self.window)

    @cached_property
    def driving(self) -> Array:
        """The first pass alone (window of it and zeros), from its begin on."""
        times = self.data.times_s
        begin, end = self.data.first_pass_s
        chosen = self.data.signal[(times >= begin) & (times <= end)]
        return np.concatenate([chosen, np.zeros(max(0, self.window - len(chosen)))])

    @cached_property
    def padded(self) -> int:
        return int(next_fast_len(2 * len(self.data.times_s)))

    @cached_property
    def omega(self) -> Array:
        """Angular frequencies (frequencies,) in rad/s that are carried on."""
        every = 2 * np.pi * np.fft.rfftfreq(self.padded, self.data.step_s)
        return np.asarray(every[every <= 2 * np.pi * BEYOND * self.bins * self.resolution_Hz])

    @cached_property
    def spectrum(self) -> Complex:
        """Of the first pass (frequencies,), its time counted from its begin."""
        return np.asarray(np.fft.rfft(self.driving, self.padded)[: len(self.omega)])

    @cached_property
    def synthesis(self) -> Complex:
        """What turns spectra (..., frequencies) into the rows' values, (frequencies, rows)."""
        times, weight = self.data.times_s, np.full(len(self.omega), 2.0 / self.padded)
        weight[0] *= 0.5
        begin = int(np.searchsorted(times, self.data.first_pass_s[0]))
        within = np.exp(1j * self.omega[:, None] * (self.data.step_s * np.arange(self.window)))
        projected = (weight * self.spectrum)[:, None] * (within @ self.basis.T)
        delays = self.data.step_s * (np.array(self.starts()) - begin)
        blocks = [np.exp(1j * self.omega * delay)[:, None] * projected for delay in delays]
        return np.concatenate(blocks, axis=1)

    @cached_property
    def scale(self) -> Array:
        """Standard deviation (rows,) of the values, in the unit."""
        each = np.concatenate([self.sigma[:1], np.repeat(self.sigma[1 : self.bins], 2)])
        return np.tile(each, self.n_passes)

    def measured(self) -> Array:
        """The values (rows,), whitened."""
        pieces = [self.basis @ self.data.signal[i : i + self.window] for i in self.starts()]
        return np.concatenate(pieces) / self.scale

    def rows(self, ratio: Complex) -> Array:
        """Whitened predictions (..., rows) from the ratio to the first pass (..., frequencies)."""
        return np.asarray((ratio @ self.synthesis).real / self.scale)

    def in_time(self, ratio: Complex) -> Array:
        """The prediction (samples,) over all of the record, from a ratio (frequencies,)."""
        spectrum = np.zeros(self.padded // 2 + 1, dtype=complex)
        spectrum[: len(self.omega)] = ratio * self.spectrum
        begin = int(np.searchsorted(self.data.times_s, self.data.first_pass_s[0]))
        late = np.fft.irfft(spectrum, self.padded)[: len(self.data.times_s) - begin]
        return np.concatenate([np.zeros(begin), late])
