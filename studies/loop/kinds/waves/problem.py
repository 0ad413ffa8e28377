"""Wave records of bars with free ends as problems of the loop: dataset kind ``waves``.

The first pass of a pulse at a gauge drives the prediction of all that comes after it, at the same
gauge or at a second one, so whatever acts on every pass alike cancels: gain, gauge length,
amplifier. What is predicted, with which noise, and by which models: `waves_layout`,
`waves_propagation`, `waves_noise`, `waves_model`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .....solver.arrays import Array
from ...problem import Model, Problem, carried
from .layout import MOST_BINS, Layout, lay_out, used_band
from .model import WaveModel, baseline_parameters, effect_parameters, material_declared
from .noise import Whitening, whitening
from .propagation import MOST_TURNS, Propagation
from .record import Waves, read_waves
from .rod import Rod
from .start import Start, find_start

LIBRARY = ("material_damping", "hysteretic_damping", "lateral_inertia")
LEAST_WINDOW = 16
ALLOYS_VARY = 0.03
FEW_QUIET = 50


def read_problem(folder: Path) -> Problem:
    """The problem of a dataset's folder. Raises InputError."""
    return wave_problem(read_waves(folder))


def wave_problem(data: Waves) -> Problem:
    """What comes after the first pass as a `Problem`, with the candidates of `LIBRARY`.

    ``combine`` also takes ``attached_mass``, a mass on a lossy spring at each end, which is no
    candidate: it was thought of after looking at all passes of the bundled record, so that on that
    record it is a hypothesis and not a finding. Raises InputError where the first pass does not
    stand out of the noise, or is overlapped by too many reflections.
    """
    rod = Rod.of(data.manifest.bristle)
    band, limit = used_band(data, rod)
    whole = Propagation(data, rod, band)
    _refuse(whole)
    declared = data.manifest.bristle.material.bar_speed_m_s
    start = find_start(whole, baseline_parameters(data, declared, 1e-8))
    baseline = baseline_parameters(data, start.value("wave_speed_m_s"), start.value("beta_s"))
    layout = lay_out(whole, baseline[0].typical)
    plain = whole.synthesis(layout.windows)
    white = _whitening(replace(start.model, synthesis=plain), start, layout)
    model = WaveModel(whole, baseline, plain @ white.factor.T)
    possible = effect_parameters(data)

    def combine(effects: Sequence[str]) -> WaveModel:
        return replace(model, effects=carried("waves", effects, possible))

    def confirm(found: Model, theta: Array, groups: NDArray[np.int64]) -> Array:
        """Predictions (rows of ``groups``,) by the 3-D bar."""
        from .solid import solid_wave_numbers

        assert isinstance(found, WaveModel)
        solid = solid_wave_numbers(data.manifest.bristle, band)
        predicted = replace(found, solid=solid).predict(theta)
        return np.asarray(predicted[0, np.isin(layout.group, groups)])

    values = white.factor @ layout.windows.components(data.predicted.signal)
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
        candidates=[combine((name,)) for name in LIBRARY if name in possible],
        combine=combine,
        held=layout.held or None,
        confirm=confirm,
        notes={
            "highest_frequency_Hz": float(layout.frequency_Hz.max()),
            "absorbed": "scale error, gauge length, amplifier: the first pass carries them too",
            "not_identifiable": "clock error, length and wave speed; a delay at the ends and the "
            "length",
        },
        warnings=_warnings(data, start, layout),
        left_aside=_left_aside(data, layout, limit),
    )


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


def _refuse(whole: Propagation) -> None:
    """InputError where passes are too few samples long, or too many overlap the first one."""
    data = whole.data
    speed = data.manifest.bristle.material.bar_speed_m_s
    samples = int(whole.rod.length_m / speed / data.step_s)
    if samples < LEAST_WINDOW:
        raise data.manifest.wrong(
            "predict_s",
            f"has {samples} samples a pass of the declared bar; {LEAST_WINDOW} are needed",
        )
    turns = whole.turns(speed, data.gauge.x_m)
    if turns > MOST_TURNS:
        raise data.manifest.wrong(
            "gauge_x_m" if data.gauge.placed else "first_pass_s",
            f"lets {turns} reflections overlap the first pass, of which {MOST_TURNS} can be told "
            "apart: a gauge farther from the far end, or a shorter first_pass_s, is needed",
        )


def _warnings(data: Waves, start: Start, layout: Layout) -> tuple[str, ...]:
    sentences: list[str] = []
    speed, found = data.manifest.bristle.material.bar_speed_m_s, start.value("wave_speed_m_s")
    if material_declared(data) and abs(found / speed - 1.0) > ALLOYS_VARY:
        sentences.append(
            f"the passes come as at {found:.4g} m/s along a bar of the declared length; the "
            f"declared modulus and density make {speed:.4g} m/s, {abs(found / speed - 1):.0%} off: "
            "length, place of the gauge, clock or material is not what is declared"
        )
    if layout.in_bands:
        count = len(layout.windows.begins)
        passes = "one window of passes" if count == 1 else f"{count} windows of passes"
        sentences.append(f"{passes} only: what is held out are bands of frequency, not passes")
    if data.quiet < FEW_QUIET:
        sentences.append(f"the noise is known from {data.quiet} quiet samples only")
    if not data.gauge.placed:
        sentences.append("gauge_x_m is not declared: the gauge is taken to be near mid-length")
    if data.sigma is not None:
        quiet = float(data.gauge.signal[: data.quiet].std())
        if data.sigma < 0.5 * quiet:
            sentences.append(
                f"the declared sigma, {data.sigma:.3g} {data.unit}, is far less than the scatter "
                f"before the pulse, {quiet:.3g} {data.unit}: that is used"
            )
    return tuple(sentences)


def _left_aside(data: Waves, layout: Layout, limit: bool) -> tuple[str, ...]:
    reasons: list[str] = []
    top = float(layout.frequency_Hz.max())
    if limit or layout.windows.bins == MOST_BINS:
        why = "their waves are too short for a rod" if limit else "there are enough without them"
        reasons.append(f"frequencies above {1e-3 * top:.4g} kHz: {why}")
    late = data.times_s[-1] - data.predict_s[1]
    if late > 0.1 * (data.predict_s[1] - data.predict_s[0]):
        reasons.append(f"the record's last {late:.3g} s, after predict_s")
    if data.second is not None:
        reasons.append("later passes at the first gauge: the second gauge alone is predicted")
    return tuple(reasons)
