"""Where the search for a wave record's parameters starts, by a scan of wave speed and damping.

The phase of a late pass turns many times between one speed and another, so that a search from an
arbitrary speed ends in the wrong period. The scan goes in steps of a fraction of a turn over speeds
wider than a declared material allows, so that one that contradicts the record is noticed. It looks
at the frequencies that hold most of the pulse; its best is refined by least squares, the damping
with it, first there and then at all frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from .....solver.arrays import Array
from .....solver.effects.base import Parameter
from ...fit import differences, to_theta, to_unit
from .model import AT_ONCE, SPEEDS_M_S, WaveModel, material_declared
from .propagation import Propagation, Windows

TURN_RAD = 0.5
MOST_SPEEDS, MOST_BINS = 4000, 200
MOST = 0.9
SCANNED = 0.3
"""Speeds looked at around a declared material's, relative."""
STEP = 1e-6
BETAS_S = (1e-10, 1e-8, 1e-7, 1e-6)


@dataclass(frozen=True)
class Start:
    """The model with damping and lateral inertia freed, and the parameters (p,) nearest the record.

    They serve the search and the noise alone: what they leave is looked at by nobody.
    """

    model: WaveModel
    theta: Array

    def value(self, name: str) -> float:
        return float(self.theta[[p.name for p in self.model.parameters].index(name)])


def find_start(carried: Propagation, baseline: tuple[Parameter, ...]) -> Start:
    """From the ``baseline``'s parameters, and with all of what is predicted as one window."""
    data = carried.data
    declared = data.manifest.bristle.material.bar_speed_m_s
    low, high = SPEEDS_M_S
    if material_declared(data):
        low, high = (1 - SCANNED) * declared, (1 + SCANNED) * declared
    free = [replace(baseline[0], low=low, high=high)]
    free += [each for each in baseline[1:] if each.name != "beta_s"]
    free.append(Parameter("beta_s", "s", 1e-12, 1e-4, 1e-8, logarithmic=True))
    coarse = replace(carried, band_Hz=_most_of_it(carried))
    model, values = _as_one(coarse, tuple(free))
    fine = TURN_RAD / (2 * np.pi * coarse.band_Hz * (data.predict_s[1] - data.first_pass_s[0]))
    count = int(np.clip(np.log(high / low) / fine, 50, MOST_SPEEDS))
    speed, beta = np.meshgrid(np.geomspace(low, high, count), BETAS_S)
    points = np.tile([p.typical for p in model.parameters], (speed.size, 1))
    points[:, 0], points[:, len(free) - 1] = speed.ravel(), beta.ravel()
    if any(p.name == "gauge_offset_m" for p in free):
        points[:, 1] = 0.0
    cost = np.concatenate(
        [_alike(model, points[i : i + AT_ONCE], values) for i in range(0, len(points), AT_ONCE)]
    )
    near = _refined(model, points[int(np.argmin(cost))], values)
    model, values = _as_one(carried, tuple(free))
    return Start(model, _refined(model, near, values))


def _most_of_it(carried: Propagation) -> float:
    """The frequency in Hz below which `MOST` of the first pass's energy lies."""
    begin, end = (carried.data.index(each) for each in carried.data.first_pass_s)
    padded = 8 * (end - begin)
    power = np.abs(np.fft.rfft(carried.data.gauge.signal[begin:end], padded)) ** 2
    frequency = np.fft.rfftfreq(padded, carried.data.step_s)
    power[frequency > carried.band_Hz] = 0.0
    below = int(np.searchsorted(np.cumsum(power), MOST * power.sum()))
    return float(np.clip(frequency[below], min(1.0 / (end - begin) / carried.data.step_s,
                                               carried.band_Hz), carried.band_Hz))  # fmt: skip


def _as_one(carried: Propagation, baseline: tuple[Parameter, ...]) -> tuple[WaveModel, Array]:
    """The model with lateral inertia, with all of what is predicted as one window, and the record's
    rows in the unit."""
    data = carried.data
    begin, end = (data.index(each) for each in data.predict_s)
    bins = int(carried.band_Hz * (end - begin) * data.step_s) + 1
    windows = Windows((begin,), end - begin, max(3, min(bins, MOST_BINS)), data.step_s)
    model = WaveModel(carried, baseline, carried.synthesis(windows), ("lateral_inertia",))
    return model, windows.components(data.predicted.signal)


def _alike(model: WaveModel, points: Array, values: Array) -> Array:
    """What is left of the values (points,), of one, at each point's best size."""
    predicted = model.predict(points)[:, 0]
    size = np.maximum(predicted @ values, 0.0)
    return 1.0 - size**2 / np.maximum(np.sum(predicted**2, axis=1) * (values @ values), 1e-300)


def _refined(model: WaveModel, point: Array, values: Array) -> Array:
    """The parameters (p,) of least squares near a point."""
    several = model.parameters
    size = np.linalg.norm(values) + 1e-300

    def left(u: Array) -> Array:
        return (model.predict(to_theta(several, u))[..., 0, :] - values) / size

    def slopes(u: Array) -> Array:
        return differences(left, u[None], np.full((1, u.size), STEP))[1][0].T

    start = np.clip(to_unit(several, point), 1e-3, 1 - 1e-3)
    found = least_squares(left, start, jac=slopes, bounds=(0.0, 1.0), x_scale=0.01, max_nfev=60)
    return to_theta(several, found.x)
