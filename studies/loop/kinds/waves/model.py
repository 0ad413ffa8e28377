"""The rod with free ends as a model of a wave record: its parameters, effects and predictions.

Modulus and density of a bar enter as the speed of slow waves, √(E/ρ), alone; so does its length,
or the distance of two gauges, since only times are measured. Where modulus and density are both
declared the speed is held to theirs within `ALLOY`: by that much handbooks differ about one alloy,
and a length or a clock that is further off than that then shows as a misfit, with the speed on its
bound, and does not hide in a speed that no such material has. Where one of them is not declared, it
may be any metal's. Damping that is not declared is a free parameter too. So are the place of the
gauge, to a glued gauge's accuracy, and the first pass's size: bending passes one gauge as well.

Not identifiable: a clock that runs wrong, for a plain rod exactly a change of speed; a scale error;
a constant delay at each end, which is a longer bar.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .....solver.arrays import Array
from .....solver.effects.base import Parameter
from .propagation import Propagation
from .record import Waves
from .rod import Complex, attached_mass

ALLOY = 0.05
SPEEDS_M_S = (1500.0, 7000.0)
BETAS_S = (1e-12, 1e-4)
GAUGE_ERROR_M = 0.005
UNPLACED = 0.05
"""Of the bar's length: how far from mid-length a gauge may lie whose place is not declared."""
DRIVING_ERROR = 0.2
AT_ONCE = 256
"""Parameters that are predicted together: more would not fit the cache, then the memory."""

WaveNumbers = Callable[[Complex], Complex]
"""The solid's wave number from that of a plain rod, both over one metre."""


def material_declared(data: Waves) -> bool:
    """Whether modulus and density are known: both declared, or those of the paper's bristle."""
    declared = data.manifest.declared
    return not declared or {"youngs_modulus_Pa", "density_kg_m3"} <= set(declared)


def baseline_parameters(data: Waves, speed_m_s: float, beta_s: float) -> tuple[Parameter, ...]:
    """The baseline's free parameters; the search starts at this speed and this damping.

    The offset is left out where one arrival at a second gauge is all there is: it is a speed then.
    """
    declared = data.manifest.bristle.material.bar_speed_m_s
    low, high = (1 - ALLOY) * declared, (1 + ALLOY) * declared
    why = "handbook moduli and densities of one alloy differ by this much"
    if not material_declared(data):
        low, high = SPEEDS_M_S
        why = "any metal: modulus and density are not both declared"
    inside = float(np.clip(speed_m_s, low + 0.01 * (high - low), high - 0.01 * (high - low)))
    gauge, length = data.predicted, data.manifest.bristle.length_m
    off = GAUGE_ERROR_M if gauge.placed else max(GAUGE_ERROR_M, UNPLACED * length)
    off = min(off, 0.5 * gauge.x_m, 0.5 * (length - gauge.x_m))
    placed = "a gauge is glued on by hand" if gauge.placed else "its place is not declared"
    gain = (1 - DRIVING_ERROR, 1 + DRIVING_ERROR, 1.0, 1.0)
    own = "bending at the gauge while the driving pulse passes, a tenth of a slim bar's pulse"
    if data.second is not None:
        own = "gauge factor and amplifier of one gauge over those of the other"
    out = [Parameter("wave_speed_m_s", "m/s", low, high, inside, inside, why=why)]
    if sees_reflections(data, speed_m_s):
        out.append(Parameter("gauge_offset_m", "m", -off, off, 0.1 * off, why=placed))
    out.append(Parameter("driving_gain", "", *gain, why=own))
    if not data.manifest.damping_declared:
        out.append(_beta(beta_s, beta_s))
    return tuple(out)


def sees_reflections(data: Waves, speed_m_s: float) -> bool:
    """Whether what is predicted holds more than one arrival at a second gauge."""
    if data.second is None:
        return True
    to_end = data.manifest.bristle.length_m - data.second.x_m
    way = data.second.x_m - data.gauge.x_m + 2.0 * to_end
    begin, end = data.first_pass_s
    return 0.5 * (begin + end) + way / speed_m_s < data.predict_s[1]


def _beta(typical: float, null: float) -> Parameter:
    low, high = BETAS_S
    typical = float(np.clip(typical, 10 * low, 0.1 * high))
    why = "metals in ultrasound to bristles in slow bending"
    return Parameter("beta_s", "s", low, max(high, null), typical, null, logarithmic=True, why=why)


def effect_parameters(data: Waves) -> dict[str, tuple[Parameter, ...]]:
    """Parameters of each effect that such a record can carry, by its name.

    ``attached_mass`` stands outside the project's list of effects: see `wave_problem`.
    """
    loss = Parameter("loss_factor", "", 0.0, 0.1, 0.002, why="metals 1e-4 to 1e-2, and joints")
    rise = Parameter("dispersion", "", 0.0, 2.0, 1.0, why="1: as causality asks, 0: none of it")
    love = Parameter("strength", "", 0.0, 2.0, 1.0, why="0 is a plain rod, 1 is Love's")
    possible = {
        "hysteretic_damping": (loss, rise),
        "lateral_inertia": (love,),
        "attached_mass": (
            Parameter("share", "", 0.0, 0.02, 0.002, why="gauges, leads, glue on the bar's mass"),
            Parameter("frequency_Hz", "Hz", 2e4, 1e6, 1e5, 1e6, True, "glue, leads, a specimen"),
            Parameter("own_loss_factor", "", 0.01, 3.0, 0.3, 0.01, True, "polymers, grease"),
        ),
    }
    if data.manifest.damping_declared:
        declared = max(data.manifest.bristle.material.beta_s, BETAS_S[0])
        return {"material_damping": (_beta(1e-8, declared),), **possible}
    return possible


@dataclass(frozen=True)
class WaveModel:
    """The rod, with effects in it; a `Model`.

    ``baseline`` are its free parameters. ``synthesis`` (2 frequencies, rows) turns real and
    imaginary parts of a spectrum, side by side, into whitened rows. `material_damping` replaces the
    declared damping, `hysteretic_damping` adds a loss factor, with the dispersion that comes with
    it, to whatever stiffness-proportional damping there is. ``solid``, where it is not None, has
    its lateral inertia in itself: `lateral_inertia` then changes nothing.
    """

    propagation: Propagation
    baseline: tuple[Parameter, ...]
    synthesis: Array
    effects: tuple[str, ...] = ()
    solid: WaveNumbers | None = None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        possible = effect_parameters(self.propagation.data)
        return self.baseline + tuple(p for name in self.effects for p in possible[name])

    @property
    def weights(self) -> Array:
        return np.ones(1)

    def spectra(self, theta: Array, driving: Complex | None = None) -> Complex:
        """What is predicted for parameters (..., p), (..., frequencies).

        ``driving`` (..., frequencies) is what the first window holds; the record's own where None.
        """
        carried, data = self.propagation, self.propagation.data
        at = {
            each.name: np.asarray(theta, dtype=float)[..., i, None]
            for i, each in enumerate(self.parameters)
        }
        rod, declared = carried.rod, data.manifest.bristle.material
        speed, omega = at["wave_speed_m_s"], carried.omega
        none = np.zeros(1)
        offset = at.get("gauge_offset_m", none)
        damping = at.get("beta_s", np.full(1, declared.beta_s)), at.get("loss_factor", none)
        strength = at.get("strength", none) if self.solid is None else none
        alpha = declared.alpha_1_s if "damping_alpha_1_s" in data.manifest.declared else 0.0
        kappa = rod.wave_number(omega, speed, *damping, strength, alpha, at.get("dispersion", none))
        if self.solid is not None:
            kappa = self.solid(kappa)
        ends: Complex = np.ones(1, dtype=complex)
        if "share" in at:
            own = at["frequency_Hz"], at["own_loss_factor"]
            ends = attached_mass(omega, speed / rod.length_m, at["share"], *own)
        first = data.gauge.x_m + (offset if data.second is None else 0.0)
        after = rod.after_a_pass(kappa, first, ends)
        turns = carried.turns(self.baseline[0].high, data.gauge.x_m + self._off_m)
        held = carried.driving if driving is None else driving
        alone = carried.alone(held, after, turns)
        if data.second is not None:
            x2 = data.second.x_m + offset
            direct = np.exp(-1j * kappa * (x2 - data.gauge.x_m))
            after = direct * (1.0 + rod.after_a_pass(kappa, x2, ends))
        return np.asarray(at["driving_gain"] * after * alone)

    @property
    def _off_m(self) -> float:
        """How much nearer to the far end than declared the first gauge may be."""
        if self.propagation.data.second is not None:
            return 0.0
        return next((p.high for p in self.baseline if p.name == "gauge_offset_m"), 0.0)

    def rows(self, spectra: Complex) -> Array:
        """Whitened rows (..., rows) of spectra (..., frequencies)."""
        return np.concatenate([spectra.real, spectra.imag], axis=-1) @ self.synthesis

    def predict(self, theta: Array) -> Array:
        """Whitened predictions (..., 1, rows) for parameters (..., p)."""
        theta = np.asarray(theta, dtype=float)
        flat = theta.reshape(-1, theta.shape[-1])
        parts = [
            self.rows(self.spectra(flat[i : i + AT_ONCE])) for i in range(0, len(flat), AT_ONCE)
        ]
        return np.concatenate(parts).reshape(*theta.shape[:-1], 1, -1)
