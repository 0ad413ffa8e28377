"""Wave records of bars with free ends as problems of the loop: dataset kind ``waves``.

The first pass of a pulse at a gauge drives the prediction of all that comes after it, at the same
gauge or at a second one, so whatever acts on every pass alike cancels: gain, gauge length,
amplifier. What is predicted, with which noise, and by which models: `waves_propagation`,
`waves_noise`, `waves_model`.

Groups are passes (where the gauge is not near mid-length, round trips, each of two passes that may
overlap); where there are fewer than `LEAST_PASSES`, bands of frequency in each, so that some can be
held out: a rod predicts all of them from the same few numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...solver.bristle import Array
from ...solver.errors import InputError
from .problem import Problem
from .rod import SHORTEST_WAVE, Rod
from .waves_model import (
    WaveModel,
    baseline_parameters,
    effect_parameters,
    material_declared,
    real_synthesis,
)
from .waves_noise import Power, Whitening, apart_power, quiet_power, whitening
from .waves_propagation import MOST_TURNS, Propagation, Windows
from .waves_record import Waves, read_waves
from .waves_start import Start, find_start

__all__ = ["LIBRARY", "WaveModel", "Waves", "read_waves", "relative_residual", "wave_problem"]

LIBRARY = ("material_damping", "hysteretic_damping", "lateral_inertia")
STANDS_OUT = 3.0
"""How far the first pass must rise above the noise for a frequency to be used."""
GAP, FINER = 6, 4
"""Over how many points a spectrum may drown in the noise, `FINER` times as fine as its own."""
MOST_BINS = 48
LEAST_WINDOW = 16
NEAR_MIDDLE = 0.1
"""How far from mid-length, in half lengths, passes still come one length apart."""
LEAST_PASSES, BANDS, HELD_EVERY = 4, 6, 3
ALLOYS_VARY = 0.03
FEW_QUIET = 50


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


def wave_problem(data: Waves, library: Sequence[str] = LIBRARY) -> Problem:
    """What comes after the first pass as a `Problem`; ``library`` names the candidates.

    ``combine`` also takes ``attached_mass``, a mass on a lossy spring at each end, which is no
    candidate unless named: it was thought of after looking at all passes of the bundled record, so
    that on that record it is a hypothesis and not a finding. Raises InputError where the first
    pass does not stand out of the noise, or is overlapped by too many reflections.
    """
    rod = Rod.of(data.manifest.bristle)
    band, limit = _band(data, rod)
    whole = Propagation(data, rod, band)
    declared = data.manifest.bristle.material.bar_speed_m_s
    start = find_start(whole, baseline_parameters(data, declared, 1e-8))
    baseline = baseline_parameters(data, start.value("wave_speed_m_s"), start.value("beta_s"))
    layout = _layout(whole, baseline[0].typical)
    plain = whole.synthesis(layout.windows)
    white = _whitening(replace(start.model, synthesis=real_synthesis(plain)), start, layout)
    model = WaveModel(whole, baseline, real_synthesis(plain) @ white.factor.T)
    _refuse_overlap(model)
    combine = _combine(model)
    values = white.factor @ layout.windows.components(data.predicted.signal)
    known = effect_parameters(data)
    return Problem(
        values=values,
        scale=white.scale,
        unit=data.unit,
        quantity=np.full(len(values), "strain signal"),
        group=layout.group,
        covariates={
            "order": np.repeat(np.arange(len(layout.windows.begins)), layout.windows.rows) + 1.0,
            "frequency": layout.frequency_Hz,
        },
        baseline=combine(()),
        candidates=[combine((name,)) for name in library if name in known],
        combine=combine,
        held=layout.held or None,
        confirm=_confirm(model, layout.group),
        notes={
            "highest_frequency_Hz": float(layout.frequency_Hz.max()),
            "absorbed": "scale error, gauge length, amplifier: the first pass carries them too",
            "not_identifiable": "clock error, length and wave speed; a delay at the ends and the "
            "length",
        },
        warnings=_warnings(data, start, layout),
        left_aside=_left_aside(data, layout, limit),
    )


def _band(data: Waves, rod: Rod) -> tuple[float, bool]:
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
    power = _larger(quiet_power(data, data.gauge, top), apart_power(data.gauge, alike))
    noise = np.sqrt(power(frequency))
    above = np.append(spectrum > STANDS_OUT * noise, np.zeros(GAP, dtype=bool))
    run = np.array([np.any(above[i : i + GAP]) for i in range(len(spectrum))])
    drowned = np.flatnonzero(~run)
    pulse_ends = frequency[drowned[0]] if len(drowned) else frequency[-1]
    if drowned.size and drowned[0] == 0:
        raise data.manifest.wrong("first_pass_s", "holds no pulse above the noise before it")
    ends = min(pulse_ends, nyquist)
    return float(min(ends, rod_ends)), bool(rod_ends < ends)


def _layout(whole: Propagation, speed_m_s: float) -> Layout:
    data, length = whole.data, whole.rod.length_m
    begin, end = data.predict_s
    middle = data.second is None and abs(2 * data.gauge.x_m / length - 1.0) <= NEAR_MIDDLE
    count = max(1, round((end - begin) * speed_m_s / (length if middle else 2 * length)))
    samples = int((data.index(end) - data.index(begin)) / count)
    if samples < LEAST_WINDOW:
        raise data.manifest.wrong(
            "predict_s",
            f"has {samples} samples a pass of the declared bar; {LEAST_WINDOW} are needed",
        )
    bins = 1 + int(whole.band_Hz * samples * data.step_s)
    bins = min(bins, MOST_BINS, samples // 2)
    if bins < 3:
        raise data.manifest.wrong(
            "first_pass_s", "holds a pulse too slow for its passes to be told apart"
        )
    edges = begin + (end - begin) * np.arange(count) / count
    windows = Windows(tuple(data.index(each) for each in edges), samples, bins, data.step_s)
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
    band = whole.band_Hz
    later = _larger(quiet_power(data, data.predicted, band), apart_power(data.predicted, windows))
    first = _larger(quiet_power(data, data.gauge, band), apart_power(data.gauge, own))
    return later, first if data.second is not None else _larger(first, later)


def _larger(one: Power, other: Power | None) -> Power:
    if other is None:
        return one
    return lambda frequency_Hz: np.maximum(one(frequency_Hz), other(frequency_Hz))


def _whitening(model: WaveModel, start: Start, layout: Layout) -> Whitening:
    """By the noise of each row, and by that of the first pass and of the offsets, carried along by
    the model nearest the record."""
    data, carried = model.propagation.data, model.propagation
    spectra, frequency = carried.disturbances()
    spectra = spectra * np.sqrt(layout.first_noise(frequency))[:, None]
    shared = -model.rows(model.spectra(start.theta, spectra)).T
    # an error of the offset: a constant in all windows, and one that drives
    level = np.sqrt(layout.noise(np.zeros(1))[0] / data.quiet)
    constant = layout.windows.components(np.full(len(data.times_s), level))
    carried_samples = np.sqrt(carried.within * carried.padded / carried.coarse)
    drive = np.sqrt(layout.first_noise(np.zeros(1))[0] / data.quiet) * carried_samples
    moved = shared[:, 0] / np.sqrt(layout.first_noise(frequency[:1])[0]) * drive
    if data.second is None:
        offsets = (constant + moved)[:, None]
    else:
        offsets = np.stack([constant, moved], axis=1)
    own = np.sqrt(layout.noise(layout.frequency_Hz))
    return whitening(own, np.concatenate([shared, offsets], axis=1), layout.fitted)


def _refuse_overlap(model: WaveModel) -> None:
    carried, data = model.propagation, model.propagation.data
    slow = model.baseline[0].typical
    back = 2.0 * (carried.rod.length_m - data.gauge.x_m) / slow
    lasts = data.first_pass_s[1] - data.first_pass_s[0]
    if lasts > MOST_TURNS * back:
        raise data.manifest.wrong(
            "gauge_x_m",
            f"is so near the far end that {lasts / back:.0f} reflections overlap the first pass, "
            f"{MOST_TURNS} at most can be told apart: a gauge farther from that end, or a "
            "first_pass_s that is shorter, is needed",
        )


def _combine(model: WaveModel) -> Callable[[tuple[str, ...]], WaveModel]:
    known = effect_parameters(model.propagation.data)

    def combine(effects: tuple[str, ...]) -> WaveModel:
        for name in effects:
            if name not in known:
                raise InputError(f"a waves dataset cannot carry {name}; {', '.join(known)} it can")
        return replace(model, effects=tuple(effects))

    return combine


def _confirm(
    model: WaveModel, group: NDArray[np.int64]
) -> Callable[[tuple[str, ...], Array, NDArray[np.int64]], Array]:
    def confirm(effects: tuple[str, ...], theta: Array, groups: NDArray[np.int64]) -> Array:
        """Predictions (rows of ``groups``,) by the 3-D bar; the baseline's with no effects."""
        from .waves_solid import solid_wave_numbers

        bar, band = model.propagation.data.manifest.bristle, model.propagation.band_Hz
        solid = replace(model, effects=tuple(effects), solid=solid_wave_numbers(bar, band))
        return np.asarray(solid.predict(theta)[0, np.isin(group, groups)])

    return confirm


def _warnings(data: Waves, start: Start, layout: Layout) -> tuple[str, ...]:
    told: list[str] = []
    speed, found = data.manifest.bristle.material.bar_speed_m_s, start.value("wave_speed_m_s")
    if material_declared(data) and abs(found / speed - 1.0) > ALLOYS_VARY:
        told.append(
            f"the passes come as at {found:.4g} m/s along a bar of the declared length; the "
            f"declared modulus and density make {speed:.4g} m/s, {abs(found / speed - 1):.0%} off: "
            "length, place of the gauge, clock or material is not what is declared"
        )
    if layout.in_bands:
        count = len(layout.windows.begins)
        passes = "one window of passes" if count == 1 else f"{count} windows of passes"
        told.append(f"{passes} only: what is held out are bands of frequency, not passes")
    if data.quiet < FEW_QUIET:
        told.append(f"the noise is known from {data.quiet} quiet samples only")
    if not data.gauge.placed:
        told.append("gauge_x_m is not declared: the gauge is taken to be near mid-length")
    if data.sigma is not None:
        quiet = float(data.gauge.signal[: data.quiet].std())
        if data.sigma < 0.5 * quiet:
            told.append(
                f"the declared sigma, {data.sigma:.3g} {data.unit}, is far less than the scatter "
                f"before the pulse, {quiet:.3g} {data.unit}: that is used"
            )
    return tuple(told)


def _left_aside(data: Waves, layout: Layout, limit: bool) -> tuple[str, ...]:
    told: list[str] = []
    top = float(layout.frequency_Hz.max())
    if limit or layout.windows.bins == MOST_BINS:
        why = "their waves are too short for a rod" if limit else "there are enough without them"
        told.append(f"frequencies above {1e-3 * top:.4g} kHz: {why}")
    late = data.times_s[-1] - data.predict_s[1]
    if late > 0.1 * (data.predict_s[1] - data.predict_s[0]):
        told.append(f"the record's last {late:.3g} s, after predict_s")
    if data.second is not None:
        told.append("later passes at the first gauge: the second gauge alone is predicted")
    return tuple(told)


def relative_residual(model: WaveModel, theta: Array, passes: Sequence[int] | None = None) -> float:
    """Residual over signal, both rms over all samples that are predicted.

    ``theta`` (p,). ``passes``, counted from 2, are lengths of the bar of equal time in what is
    predicted. All frequencies that the record holds count, electrical noise among them.
    """
    whole = model.propagation
    data = whole.data
    begin, end = (data.index(each) for each in data.predict_s)
    chosen = np.zeros(len(data.times_s), dtype=bool)
    if passes is None:
        chosen[begin:end] = True
    else:
        span = (data.predict_s[1] - data.predict_s[0]) * model.baseline[0].typical
        count = round(span / whole.rod.length_m)
        for each in passes:
            first, last = (begin + (end - begin) * k // count for k in (each - 2, each - 1))
            chosen[first:last] = True
    signal = data.predicted.signal[chosen]
    predicted = whole.in_time(model.spectra(theta))[chosen]
    return float(np.linalg.norm(signal - predicted) / np.linalg.norm(signal))
