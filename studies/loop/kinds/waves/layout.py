"""Layout of a wave record in rows: which frequencies, windows and groups, and the noise of each.

Groups are passes (where the gauge is not near mid-length, round trips, each of two passes that may
overlap); where there are fewer than `LEAST_PASSES`, bands of frequency in each, so that some can be
held out: a rod predicts all of them from the same few numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .....solver.arrays import Array
from .noise import Power, larger, power_of
from .propagation import Propagation, Windows
from .record import Waves
from .rod import SHORTEST_WAVE, Rod

STANDS_OUT = 3.0
"""How far the first pass must rise above the noise for a frequency to be used."""
GAP, FINER = 6, 4
"""Over how many points a spectrum may drown in the noise, `FINER` times as fine as its own."""
MOST_BINS = 48
NEAR_MIDDLE = 0.1
"""How far from mid-length, in half lengths, passes still come one length apart."""
LEAST_PASSES, BANDS, HELD_EVERY = 4, 6, 3


@dataclass(frozen=True)
class Layout:
    """A record laid out in rows: the windows, a group and a frequency to each row, what is held
    out, and the noise of each row and of the first pass."""

    windows: Windows
    group: NDArray[np.int64]
    held: tuple[int, ...]
    in_bands: bool
    noise: Power
    first_noise: Power

    @property
    def fitted(self) -> NDArray[np.bool_]:
        return ~np.isin(self.group, self.held)

    @property
    def frequency_Hz(self) -> Array:
        return np.tile(self.windows.frequency_Hz, len(self.windows.begins))


def used_band(data: Waves, rod: Rod) -> tuple[float, bool]:
    """The highest frequency used, in Hz, and whether it is the rod that ends there, not the pulse.

    Up to where the first pass drowns in the noise, zeros of its spectrum aside, and no further than
    a rod holds.
    """
    begin, end = data.first_pass_s
    first = data.gauge.signal[data.index(begin) : data.index(end) + 1]
    padded = FINER * len(first)
    spectrum = np.abs(np.fft.rfft(first, padded)) * np.sqrt(2.0 / len(first))
    frequency = np.fft.rfftfreq(padded, data.step_s)
    nyquist = 0.8 * frequency[-1]
    speed = data.manifest.bristle.material.bar_speed_m_s
    rod_ends = speed / (SHORTEST_WAVE * rod.radius_m)
    top = min(rod_ends, nyquist)
    later = [data.index(each) for each in np.linspace(*data.predict_s, 4)[:-1]]
    bins = max(3, int(top * len(first) * data.step_s))
    later = [each for each in later if each + len(first) <= len(data.times_s)]
    alike = Windows((data.index(begin), *later), len(first), bins, data.step_s)
    noise = np.sqrt(power_of(data, data.gauge, top, alike)(frequency))
    above = np.append(spectrum > STANDS_OUT * noise, np.zeros(GAP, dtype=bool))
    run = np.array([np.any(above[i : i + GAP]) for i in range(len(spectrum))])
    drowned = np.flatnonzero(~run)
    pulse_ends = frequency[drowned[0]] if len(drowned) else frequency[-1]
    if drowned.size and drowned[0] == 0:
        raise data.manifest.wrong("first_pass_s", "holds no pulse above the noise before it")
    ends = min(pulse_ends, nyquist)
    return float(min(ends, rod_ends)), bool(rod_ends < ends)


def lay_out(whole: Propagation, speed_m_s: float) -> Layout:
    """Windows, groups and noise of what is predicted, passes coming at ``speed_m_s``.

    Raises InputError where a pulse is too slow for its passes to be told apart.
    """
    data, length = whole.data, whole.rod.length_m
    begin, end = data.predict_s
    middle = data.second is None and abs(2 * data.gauge.x_m / length - 1.0) <= NEAR_MIDDLE
    count = max(1, round((end - begin) * speed_m_s / (length if middle else 2 * length)))
    samples = int((data.index(end) - data.index(begin)) / count)
    bins = 1 + int(whole.band_Hz * samples * data.step_s)
    bins = min(bins, MOST_BINS, samples // 2)
    if bins < 3:
        raise data.manifest.wrong(
            "first_pass_s", "holds a pulse too slow for its passes to be told apart"
        )
    begins = tuple(data.index(begin) + k * samples for k in range(count))
    windows = Windows(begins, samples, bins, data.step_s)
    in_bands = count < LEAST_PASSES
    group = np.repeat(np.arange(count), windows.rows) + (2 if middle else 1)
    first_held = HELD_EVERY - 1
    if in_bands:
        bands = min(-(-BANDS // count), bins)
        band = np.arange(bins) * bands // bins
        each = np.concatenate([band[:1], np.repeat(band[1:], 2)])
        group = (np.arange(count)[:, None] * bands + each + 1).ravel()
        first_held = 1
    held = tuple(int(i) for i in np.unique(group)[first_held::HELD_EVERY])
    later, first = _noises(data, whole, windows)
    return Layout(windows, group.astype(np.int64), held, in_bands, later, first)


def _noises(data: Waves, whole: Propagation, windows: Windows) -> tuple[Power, Power]:
    """Of the rows, and of the first pass."""
    begin, end = (data.index(each) for each in data.first_pass_s)
    bins = min(max(3, 1 + int(whole.band_Hz * (end - begin) * data.step_s)), (end - begin) // 2)
    own = Windows((begin,), end - begin, bins, data.step_s)
    later = power_of(data, data.predicted, whole.band_Hz, windows)
    first = power_of(data, data.gauge, whole.band_Hz, own)
    return later, first if data.second is not None else larger(first, later)
