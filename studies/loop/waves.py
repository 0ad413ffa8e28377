"""What does a rod predict of the passes of a pulse along a ringing bar, and what may it lack?

Dataset kind ``waves``. A gauge near mid-length of a bar that rings free-free sees a pulse pass
again and again, one bar length apart, its sign alternating. The first pass drives the prediction
of all others, so whatever acts on every pass alike cancels: gain, gauge length, amplifier.

The declared modulus gives the wave speed to a per cent or so, far worse than the record does, so
the speed is a free parameter of the baseline; and so is the place of the gauge. The first pass is
measured too, with the noise of any other, and its error returns in all predictions at once: its
size is the third free parameter, the rest of that error stays. Not identifiable: a clock that runs
wrong, for a plain rod exactly a change of speed; a scale error; the modulus apart from the density;
a constant delay at each end, which is a longer bar.

A public example with its source, commit and licence in its ``dataset.toml`` is a square aluminium
bar from lanl/HopPyBar (examples/mini-Kolsky/PMMA-13, BSD-3-Clause).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...solver.bristle import Array
from ...solver.effects.base import Parameter
from ...solver.errors import InputError
from .problem import Problem
from .rod import Complex, Rod, attached_mass, ratio_to_first
from .waves_propagation import Propagation
from .waves_record import Waves, read_waves

__all__ = ["LIBRARY", "WaveModel", "Waves", "read_waves", "relative_residual", "wave_problem"]

LIBRARY = ("material_damping", "hysteretic_damping", "lateral_inertia", "clock_error")
LEAST_BETA_S = 1e-11
GAUGE_ERROR_M = 0.005
DRIVING_ERROR = 0.2
AT_ONCE = 256
"""Parameters that are predicted together: more would not fit the cache, then the memory."""
LATER = 1
"""Passes after the last window that are carried on too: their fronts may reach into it."""

Phases = Callable[[Complex], Complex]


def baseline_parameters(data: Waves) -> tuple[Parameter, ...]:
    """The baseline's free parameters: speed of slow waves, where the gauge really sits, and the
    size of the true first pass over the measured one."""
    speed = data.manifest.bristle.material.bar_speed_m_s
    modulus = "handbook moduli and densities of one alloy differ by this much"
    placed, off = "a gauge is glued on by hand", GAUGE_ERROR_M + data.off_centre_m
    own = "bending at the gauge while the driving pulse passes, a tenth of a slim bar's pulse"
    return (
        Parameter("wave_speed_m_s", "m/s", 0.95 * speed, 1.05 * speed, speed, speed, why=modulus),
        Parameter("gauge_offset_m", "m", -off, off, 0.0005, why=placed),
        Parameter("driving_gain", "", 1 - DRIVING_ERROR, 1 + DRIVING_ERROR, 1.0, 1.0, why=own),
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
        passes = range(2, self.propagation.n_passes + 2 + LATER)
        late = 2.0 * at["gauge_offset_m"] / speed
        return at["driving_gain"] * ratio_to_first(phase, omega, passes, late)

    def predict(self, theta: Array) -> Array:
        """Whitened predictions (..., 1, rows) for parameters (..., p)."""
        theta = np.asarray(theta, dtype=float)
        flat = theta.reshape(-1, theta.shape[-1])
        parts = [
            self.propagation.rows(self.ratio(flat[i : i + AT_ONCE]))
            for i in range(0, len(flat), AT_ONCE)
        ]
        return np.concatenate(parts).reshape(*theta.shape[:-1], 1, -1)


def wave_problem(data: Waves, library: Sequence[str] = LIBRARY) -> Problem:
    """The passes after the first one as a `Problem`; ``library`` names the candidates.

    ``combine`` also takes ``attached_mass``, a mass on a lossy spring at each end, which is no
    candidate unless named: it was thought of after looking at all passes of the record in this
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
        candidates=[combine((name,)) for name in library],
        combine=combine,
        confirm=_confirm(whole, group),
        notes={
            "highest_frequency_Hz": (whole.bins - 1) * whole.resolution_Hz,
            "absorbed": "scale error, gauge length, amplifier: the first pass carries them too",
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
    whole: Propagation, group: NDArray[np.int64]
) -> Callable[[tuple[str, ...], Array, NDArray[np.int64]], Array]:
    def confirm(effects: tuple[str, ...], theta: Array, groups: NDArray[np.int64]) -> Array:
        """Predictions (rows of ``groups``,) by the 3-D bar; the baseline's with no effects."""
        from .waves_solid import solid_phases

        model = WaveModel(whole, tuple(effects), solid_phases(whole.data.manifest.bristle))
        return np.asarray(model.predict(theta)[0, np.isin(group, groups)])

    return confirm


def relative_residual(model: WaveModel, theta: Array, passes: Sequence[int] | None = None) -> float:
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
