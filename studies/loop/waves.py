"""Which record of a ringing bar is measured, and what does a rod predict of its later passes?

Dataset kind ``waves``. A gauge near mid-length of a bar that rings free-free sees a pulse pass
again and again, one bar length apart, its sign alternating. The first pass drives the prediction
of all others, so whatever acts on every pass alike cancels: gain, gauge length, amplifier.

The values are, pass by pass, the components of the record in that pass's window along cosines and
sines of whole periods (orthonormal, so windows need no taper: the prediction is cut by the same
windows), from zero up to where the first pass stands out of the noise. A pass is a group; its rows
share one window and one driving pulse and are not independent.

The noise is measured, frequency by frequency. Two gauges on opposite faces: their half-difference
holds no axial wave, and where each carries disturbances of its own (bending, electrical noise) it
scatters as much as their mean does. One gauge: what stands before ``baseline_until_s``, twice,
since the driving pulse carries it too.

The declared modulus gives the wave speed to a per cent or so, far worse than the record does, so
the speed is a free parameter of the baseline; and so is the place of the gauge. Not identifiable:
a clock that runs wrong, for a plain rod exactly a change of speed; the gain; the modulus apart from
the density; a constant delay at each end, which is a longer bar.

A public example with its source, commit and licence in its ``dataset.toml`` is a square aluminium
bar from lanl/HopPyBar (examples/mini-Kolsky/PMMA-13, BSD-3-Clause).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.fft import next_fast_len

from ...solver.bristle import Array
from ...solver.effects.base import Parameter
from ...solver.errors import InputError
from ..dataset_tables import column, read_table
from ..datasets import Manifest, read_manifest
from .problem import Problem
from .rod import Complex, Rod, attached_mass, ratio_to_first

LEAST_BETA_S = 1e-11
STANDS_OUT = 2.0
"""How far the first pass must rise above the noise for a frequency to be used."""
BEYOND = 4.0
"""Frequencies that are propagated, in units of the highest used: windows mix neighbours."""
GAUGE_ERROR_M = 0.005

Phases = Callable[[Complex], Complex]


@dataclass(frozen=True)
class Waves:
    """A record: times (samples,) in s, evenly spaced; ``signal`` (samples,) less its offset.

    ``difference`` (samples,) is half the difference of two gauges on opposite faces, less its
    offset, or None where there is one. Both are in ``unit``. ``first_pass_s`` and ``predict_s``
    are (begin, end).
    """

    manifest: Manifest
    times_s: Array
    signal: Array
    difference: Array | None
    unit: str
    baseline_until_s: float
    first_pass_s: tuple[float, float]
    predict_s: tuple[float, float]

    @property
    def step_s(self) -> float:
        return float((self.times_s[-1] - self.times_s[0]) / (len(self.times_s) - 1))


def read_waves(folder: Path) -> Waves:
    """Read a dataset of kind ``waves``.

    Raises InputError naming file and line of what cannot be used: a key, a window outside the
    record, times that are not evenly spaced.
    """
    manifest = read_manifest(folder)
    if manifest.kind != "waves":
        raise manifest.wrong("kind", f"is {manifest.kind}, not waves")
    names = _signal(manifest)
    until = _number(manifest, "baseline_until_s", manifest.measurement.get("baseline_until_s"))
    first, predict = _window(manifest, "first_pass_s"), _window(manifest, "predict_s")
    if predict[0] < first[1]:
        raise manifest.wrong("predict_s", "must begin after the first pass has ended")
    path = manifest.table()
    rows = read_table(path, required=("t_s", *names))
    if len(rows) < 100:
        raise InputError(f"{path}: {len(rows)} samples are no record of a wave")
    times = column(path, rows, "t_s")
    step = (times[-1] - times[0]) / (len(times) - 1)
    uneven = np.flatnonzero(~(np.abs(np.diff(times) - step) < 0.01 * abs(step)) | (step <= 0.0))
    if len(uneven):
        raise InputError(f"{path}:{rows[uneven[0] + 1][0]}: t_s must grow in equal steps")
    for key, (begin, end) in (("first_pass_s", first), ("predict_s", predict)):
        if begin < times[0] or end > times[-1]:
            raise manifest.wrong(key, f"must lie within {times[0]:g} to {times[-1]:g}")
    quiet = times < until
    if np.count_nonzero(quiet) < 50 or until > first[0]:
        raise manifest.wrong("baseline_until_s", "must leave 50 samples before the first pass")
    gauges = np.array([column(path, rows, name) for name in names])
    gauges -= gauges[:, quiet].mean(axis=1, keepdims=True)
    return Waves(
        manifest=manifest,
        times_s=times,
        signal=gauges.mean(axis=0),
        difference=0.5 * (gauges[0] - gauges[1]) if len(names) == 2 else None,
        unit=str(manifest.measurement.get("unit", "V")),
        baseline_until_s=until,
        first_pass_s=first,
        predict_s=predict,
    )


def _signal(manifest: Manifest) -> tuple[str, ...]:
    names = manifest.measurement.get("signal")
    names = [names] if isinstance(names, str) else names
    good = isinstance(names, list) and 1 <= len(names) <= 2 and len(set(map(str, names)))
    if not (good and isinstance(names, list) and all(isinstance(name, str) for name in names)):
        raise manifest.wrong("signal", "must name one column, or two of gauges on opposite faces")
    if len(set(names)) != len(names):
        raise manifest.wrong("signal", "names a column twice")
    return tuple(names)


def _number(manifest: Manifest, key: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise manifest.wrong(key, f"must be a finite number, not {value!r}")
    return float(value)


def _window(manifest: Manifest, key: str) -> tuple[float, float]:
    value = manifest.measurement.get(key)
    if not (isinstance(value, list) and len(value) == 2):
        raise manifest.wrong(key, "must be [begin, end]")
    begin, end = (_number(manifest, key, each) for each in value)
    if not begin < end:
        raise manifest.wrong(key, "must end after it begins")
    return begin, end


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
        return int((end - begin) / self.n_passes / self.data.step_s)

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


def baseline_parameters(data: Waves) -> tuple[Parameter, ...]:
    """The baseline's free parameters: speed of slow waves, and where the gauge really sits."""
    speed = data.manifest.bristle.material.bar_speed_m_s
    modulus = "handbook moduli and densities of one alloy differ by this much"
    placed = "a gauge is glued on by hand"
    return (
        Parameter("wave_speed_m_s", "m/s", 0.95 * speed, 1.05 * speed, speed, speed, why=modulus),
        Parameter("gauge_offset_m", "m", -GAUGE_ERROR_M, GAUGE_ERROR_M, 0.0005, why=placed),
    )


def effect_parameters(data: Waves) -> dict[str, tuple[Parameter, ...]]:
    """Parameters of each effect that such a record can carry, by its name.

    ``attached_mass`` stands outside the project's list of effects: see `wave_problem`.
    """
    declared = max(data.manifest.bristle.material.beta_s, LEAST_BETA_S)
    beta = Parameter(
        "beta_s",
        "s",
        LEAST_BETA_S,
        max(1e-4, declared),
        1e-8,
        declared,
        logarithmic=True,
        why="metals in ultrasound to bristles in slow bending",
    )
    loss = Parameter("loss_factor", "", 0.0, 0.1, 0.002, why="metals 1e-4 to 1e-2, and joints")
    love = Parameter("strength", "", 0.0, 2.0, 1.0, why="0 is a plain rod, 1 is Love's")
    clock = Parameter("relative", "", -0.2, 0.2, 0.02, why="consumer cameras and sensors")
    return {
        "material_damping": (beta,),
        "hysteretic_damping": (loss,),
        "lateral_inertia": (love,),
        "clock_error": (clock,),
        "attached_mass": (
            Parameter("share", "", 0.0, 0.02, 0.002, why="gauges, leads, glue on the bar's mass"),
            Parameter("frequency_Hz", "Hz", 2e4, 1e6, 1e5, 1e6, True, "glue, leads, a specimen"),
            Parameter("own_loss_factor", "", 0.01, 3.0, 0.3, 0.01, True, "polymers, grease"),
        ),
    }


LIBRARY = ("material_damping", "hysteretic_damping", "lateral_inertia", "clock_error")


@dataclass(frozen=True)
class WaveModel:
    """The rod, with effects in it; a `Model`.

    `material_damping` replaces the declared damping, `hysteretic_damping` adds a loss factor to
    whatever stiffness-proportional damping there is. So where the declared one is far too large,
    only both together can say that the loss is hysteretic: β then goes to its lower bound.
    ``solid``, where it is not None, is the phase of the 3-D bar, which has its lateral inertia in
    itself: `lateral_inertia` then changes nothing.
    """

    propagation: Propagation
    effects: tuple[str, ...] = ()
    solid: Phases | None = None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        data = self.propagation.data
        known = effect_parameters(data)
        return baseline_parameters(data) + tuple(p for name in self.effects for p in known[name])

    @property
    def weights(self) -> Array:
        return np.ones(1)

    def ratio(self, theta: Array) -> Complex:
        """All later passes over the first one, (..., frequencies), for parameters (..., p)."""
        at = {
            each.name: np.asarray(theta, dtype=float)[..., i, None]
            for i, each in enumerate(self.parameters)
        }
        rod, declared = self.propagation.rod, self.propagation.data.manifest.bristle.material
        omega = self.propagation.omega * (1.0 + at.get("relative", np.zeros(1)))
        speed, beta = at["wave_speed_m_s"], at.get("beta_s", np.full(1, declared.beta_s))
        loss = at.get("loss_factor", np.zeros(1))
        if self.solid is None:
            strength = at.get("strength", np.zeros(1))
            phase = rod.length_m * rod.wave_number(omega, speed, beta, loss, strength)
        else:
            phase = self.solid(rod.length_m * rod.wave_number(omega, speed, beta, loss))
        if "share" in at:
            own = at["frequency_Hz"], at["own_loss_factor"]
            phase = phase + attached_mass(omega, speed, rod.length_m, at["share"], *own)
        passes = range(2, self.propagation.n_passes + 3)
        return ratio_to_first(phase, omega, passes, 2.0 * at["gauge_offset_m"] / speed)

    def predict(self, theta: Array) -> Array:
        """Whitened predictions (..., 1, rows) for parameters (..., p)."""
        return self.propagation.rows(self.ratio(theta))[..., None, :]


def wave_problem(data: Waves) -> Problem:
    """The passes after the first one as a `Problem`.

    ``combine`` also takes ``attached_mass``, a mass on a lossy spring at each end, which is no
    candidate by itself: it was thought of after looking at all passes of the record in this
    module's docstring, so that on that record it is a hypothesis and not a finding.
    """
    whole = Propagation(data, Rod.of(data.manifest.bristle))
    combine = _combine(whole)
    number = np.arange(2, whole.n_passes + 2)
    per_pass = len(whole.basis)
    group = np.repeat(number, per_pass).astype(np.int64)
    frequency = np.concatenate([[0.0], np.repeat(np.arange(1, whole.bins), 2)])
    share = whole.n_passes * per_pass
    return Problem(
        values=whole.measured(),
        scale=whole.scale,
        unit=data.unit,
        quantity=np.full(share, "strain signal"),
        group=group,
        covariates={
            "order": group.astype(float),
            "frequency": np.tile(frequency, whole.n_passes) * whole.resolution_Hz,
        },
        baseline=combine(()),
        candidates=[combine((name,)) for name in LIBRARY],
        combine=combine,
        confirm=_confirm(whole, group),
        notes={
            "highest_frequency_Hz": (whole.bins - 1) * whole.resolution_Hz,
            "absorbed": "gain, gauge length, amplifier: the first pass carries them too",
            "not_identifiable": "clock error and wave speed; a delay at the ends and the length",
        },
    )


def _combine(whole: Propagation) -> Callable[[tuple[str, ...]], WaveModel]:
    known = effect_parameters(whole.data)

    def combine(effects: tuple[str, ...]) -> WaveModel:
        for name in effects:
            if name not in known:
                raise InputError(f"a waves dataset cannot carry {name}; {', '.join(known)} it can")
        return WaveModel(whole, tuple(effects))

    return combine


def _confirm(
    whole: Propagation, group: np.ndarray
) -> Callable[[tuple[str, ...], Array, np.ndarray], Array]:
    def confirm(effects: tuple[str, ...], theta: Array, groups: np.ndarray) -> Array:
        """Predictions (rows of ``groups``,) by the 3-D bar; the baseline's with no effects."""
        from .waves_solid import solid_phases

        model = WaveModel(whole, tuple(effects), solid_phases(whole.data.manifest.bristle))
        return np.asarray(model.predict(theta)[0, np.isin(group, groups)])

    return confirm


def relative_residual(
    model: WaveModel, theta: Array, passes: Sequence[int] | None = None
) -> float:
    """Residual over signal, both rms over all samples in the windows of ``passes``.

    ``theta`` (p,). All frequencies that the record holds count, electrical noise among them.
    """
    whole = model.propagation
    predicted = whole.in_time(model.ratio(theta))
    chosen = np.zeros(len(predicted), dtype=bool)
    for number, begin in enumerate(whole.starts(), start=2):
        if passes is None or number in passes:
            chosen[begin : begin + whole.window] = True
    signal = whole.data.signal[chosen]
    return float(np.linalg.norm(signal - predicted[chosen]) / np.linalg.norm(signal))
