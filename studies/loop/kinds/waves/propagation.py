"""The first pass of a wave record, carried on to where it is predicted.

The record at a gauge is a linear superposition: the first pass f and all of its reflections, which
may overlap with each other and with f itself. What the first window holds is r = f + g ∗ f, g the
reflections; since f ends with its window and every reflection comes later than what it reflects,
f = r − g ∗ f, cut to the window, is solved in as many turns as reflections fit into it, and a few
more, since signals of a limited band have no sharp ends.

Signals are damped by exp(−εt) before they are transformed and undamped afterwards, that is, the
frequencies have a negative imaginary part ε. So the reflections sum up in closed form and what
comes after the transform's period does not wrap around into it (Krylov damping; J. Phinney, J.
Geophys. Res. 70 (1965) 1751; E. Kausel and J. M. Roësset, J. Eng. Mech. 118 (1992) 721).

The values are, window by window, the components of the record along cosines and sines of whole
periods (orthonormal, so windows need no taper: the prediction is cut by the same windows).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.fft import dct, next_fast_len

from .....solver.arrays import Array
from .record import Waves
from .rod import Complex, Rod

BEYOND = 2.0
"""Frequencies that are carried, in units of the highest used: windows mix neighbours."""
PERIOD = 2.2
"""The transform's period over the time from the first pass to the end."""
DAMPING = 12.0
"""By what power of e signals are damped over one period."""
MORE_TURNS = 3
MOST_TURNS = 40
"""Reflections within the first pass beyond which its noise would be summed up too often."""


@dataclass(frozen=True)
class Windows:
    """Equal windows of a record: first samples, length in samples, and components of each.

    ``bins`` frequencies are used, zero among them; rows are window by window, in each a constant
    and then cosine and sine of each frequency.
    """

    begins: tuple[int, ...]
    samples: int
    bins: int
    step_s: float

    @property
    def rows(self) -> int:
        """Rows of one window."""
        return 2 * self.bins - 1

    @property
    def frequency_Hz(self) -> Array:
        """Of the rows of one window (rows,)."""
        number = np.concatenate([[0.0], np.repeat(np.arange(1, self.bins), 2)])
        return np.asarray(number / (self.samples * self.step_s))

    @cached_property
    def basis(self) -> Array:
        """Orthonormal constant, cosines and sines (rows of a window, samples)."""
        at = np.arange(self.samples) / self.samples
        turns = 2 * np.pi * np.arange(1, self.bins)[:, None] * at
        pairs = np.stack([np.cos(turns), np.sin(turns)], axis=1).reshape(-1, self.samples)
        constant = np.full((1, self.samples), math.sqrt(0.5))
        return np.vstack([constant, pairs]) * math.sqrt(2.0 / self.samples)

    def components(self, signal: Array) -> Array:
        """Of a signal over the record (samples,): (rows of all windows,)."""
        pieces = [self.basis @ signal[begin : begin + self.samples] for begin in self.begins]
        return np.concatenate(pieces)


@dataclass(frozen=True)
class Propagation:
    """The first pass of ``data``, carried along the ``rod`` at frequencies up to `BEYOND` times
    ``band_Hz``."""

    data: Waves
    rod: Rod
    band_Hz: float

    @cached_property
    def begin(self) -> int:
        """The first sample of the first pass, from which times are counted."""
        return self.data.index(self.data.first_pass_s[0])

    @cached_property
    def padded(self) -> int:
        """Samples of the transform's period."""
        end = self.data.index(self.data.predict_s[1])
        first = self.data.index(self.data.first_pass_s[1])
        return int(next_fast_len(round(PERIOD * (max(end, first) - self.begin)) + 1))

    @cached_property
    def damping(self) -> float:
        """ε in 1/s."""
        return DAMPING / (self.padded * self.data.step_s)

    @cached_property
    def omega(self) -> Complex:
        """Angular frequencies (frequencies,) in rad/s that are carried, −iε in each."""
        every = np.fft.rfftfreq(self.padded, self.data.step_s)
        count = max(8, int(np.count_nonzero(every <= BEYOND * self.band_Hz)))
        return np.asarray(2 * np.pi * every[:count] - 1j * self.damping)

    @cached_property
    def coarse(self) -> int:
        """Samples of the period that are enough for these frequencies."""
        return 2 * (len(self.omega) - 1)

    @cached_property
    def within(self) -> int:
        """How many of these lie in the first window."""
        begin, end = self.data.first_pass_s
        return min(self.coarse, math.ceil((end - begin) / self.data.step_s * self.coarse
                                          / self.padded) + 1)  # fmt: skip

    @cached_property
    def driving(self) -> Complex:
        """Spectrum (frequencies,) of all that the first window holds."""
        samples = self.data.gauge.signal[self.begin : self.begin + self.padded]
        faded = samples * np.exp(-self.damping * self.data.step_s * np.arange(len(samples)))
        spectrum = np.fft.rfft(faded, self.padded)[: len(self.omega)]
        return self.first_window(np.asarray(spectrum))

    def first_window(self, spectra: Complex) -> Complex:
        """Spectra (..., frequencies) of what of these signals lies in the first window."""
        signals = np.fft.irfft(spectra, self.coarse)
        signals[..., self.within :] = 0.0
        return np.asarray(np.fft.rfft(signals))

    def disturbances(self) -> tuple[Complex, Array]:
        """Spectra (components, frequencies) of a constant, then cosines in the first window, each
        the unit of what it is in the record, and their frequencies (components,) in Hz.

        Noise whose components along an orthonormal basis of the record's own samples have standard
        deviation σ has components σ along these.
        """
        waves = dct(np.eye(self.within), norm="ortho", axis=0)
        step = self.data.step_s * self.padded / self.coarse
        waves = waves * np.exp(-self.damping * step * np.arange(self.within))
        frequency = np.arange(self.within) / (2.0 * self.within * step)
        return np.fft.rfft(waves, self.coarse) * math.sqrt(self.padded / self.coarse), frequency

    def turns(self, speed_m_s: float, x_m: float) -> int:
        """How many reflections begin within the first window, at this speed and place; more than
        twice `MOST_TURNS` are not counted."""
        begin, end = self.data.first_pass_s
        back = 2.0 * (self.rod.length_m - x_m) / speed_m_s
        return min(int((end - begin) / back), 2 * MOST_TURNS)

    def alone(self, driving: Complex, after: Complex, turns: int) -> Complex:
        """Spectra (..., frequencies) of the first pass, freed from ``after`` (..., frequencies),
        its reflections, that overlap with it in the first window."""
        pass_alone = driving
        for _ in range(turns + MORE_TURNS if turns else 0):
            pass_alone = driving - self.first_window(after * pass_alone)
        return pass_alone

    def synthesis(self, windows: Windows) -> Array:
        """What turns real and imaginary parts of a spectrum, side by side, into the windows' rows,
        (2 frequencies, rows)."""
        step = self.data.step_s
        weight = np.full(len(self.omega), 2.0 / self.padded)
        weight[0] *= 0.5
        growth = np.exp(self.damping * step * np.arange(windows.samples))
        count = len(self.omega)
        # one by one: of a long record, all of them at once would not fit into the memory
        each = [np.fft.rfft(row * growth, self.padded)[:count].conj() for row in windows.basis]
        delays = step * (np.array(windows.begins) - self.begin)
        blocks = [weight * np.exp(1j * self.omega * delay) * each for delay in delays]
        whole = np.concatenate(blocks).T
        return np.concatenate([whole.real, -whole.imag])
