"""How does a pulse change from one pass of a gauge to the next on a bar that rings free-free?

Axial waves in the frequency domain, exp(+iωt). The equation of motion of Love's rod (A. E. H. Love,
A Treatise on the Mathematical Theory of Elasticity, 4th ed. 1927, article 278; K. F. Graff, Wave
Motion in Elastic Solids, 1975, chapter 2) follows from the kinetic energy ½ρ(A u̇² + ν² I_p u̇'²),
I_p the section's polar second moment about its axis:

    ρ ü = E u'' + ρ ν² (I_p / A) ü'',   so that   κ² = ρ ω² / (E(ω) − s ρ ν² (I_p / A) ω²)

with E(ω) = E (1 + iωβ + iη sign ω): β is stiffness-proportional damping, η a loss factor that does
not depend on frequency (A. D. Nashif et al., Vibration Damping, 1985, chapter 2). s is 1 for Love's
rod and 0 for a plain one. For slow waves c(k) = c (1 − ½ ν² k² I_p / A), which is exact to this
order for a section of any shape, circular ones being Pochhammer's and Chree's (Graff, chapter 8).

A free end returns a wave of stress with its sign changed and nothing else, so one length further
along the pulse is −exp(−iκL) times what it was.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...solver.bristle import Array, Bristle, Circle, Rectangle
from ...solver.errors import InputError

Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Rod:
    """A free-free bar: length in m and what lateral inertia is made of.

    ``gyration_m2`` is ν² I_p / A, in m².
    """

    length_m: float
    gyration_m2: float

    @classmethod
    def of(cls, bar: Bristle) -> Rod:
        """The rod of a bar's length, section and Poisson's ratio; InputError for other sections."""
        section = bar.section
        if isinstance(section, Circle):
            polar = section.diameter_m**2 / 8.0
        elif isinstance(section, Rectangle):
            polar = (section.thickness_m**2 + section.width_m**2) / 12.0
        else:
            raise InputError("lateral inertia is known of round and rectangular sections only")
        return cls(bar.length_m, bar.material.poisson**2 * polar)

    def wave_number(
        self,
        omega: Array,
        speed_m_s: Array | float,
        beta_s: Array | float = 0.0,
        loss_factor: Array | float = 0.0,
        strength: Array | float = 0.0,
    ) -> Complex:
        """κ (..., frequencies) in 1/m at ``omega`` (frequencies,) in rad/s, zero or more.

        The others are scalars or (..., 1). Its imaginary part is negative where there is loss:
        exp(iωt − iκx) decays along x.
        """
        elastic = speed_m_s**2 * (1.0 + 1j * (omega * beta_s + loss_factor))
        return np.asarray(omega / np.sqrt(elastic - strength * self.gyration_m2 * omega**2))


def attached_mass(
    omega: Array,
    speed_m_s: Array | float,
    length_m: float,
    share: Array | float,
    frequency_Hz: Array | float,
    loss_factor: Array | float,
) -> Complex:
    """What a mass on a lossy spring at each end adds to the phase κL of one pass.

    The result is (..., frequencies). ``share`` is the mass at one end over the bar's,
    ``frequency_Hz`` its own frequency on a rigid bar and ``loss_factor`` the viscous loss of its
    spring there. The mass pulls with the impedance
    Z = iωm (1 + iωη/ω₀) / (1 − (ω/ω₀)² + iωη/ω₀) on a bar of impedance ρcA = M c / L, which returns
    −(1 − z) / (1 + z) of a wave of stress, z = Z L / (M c) (Graff, chapter 2; den Hartog,
    Mechanical Vibrations, 4th ed. 1956, chapter 3, for Z).
    """
    ratio = omega / (2.0 * np.pi * np.asarray(frequency_Hz))
    spring = 1.0 + 1j * ratio * loss_factor
    z = 1j * omega * share * length_m / speed_m_s * spring / (spring - ratio**2)
    return np.asarray(1j * np.log((1.0 - z) / (1.0 + z)))


def ratio_to_first(
    phase: Complex, omega: Array, passes: Iterable[int], late_s: Array | float = 0.0
) -> Complex:
    """The sum of passes over the first pass, (..., frequencies), in stress, strain or voltage.

    ``phase`` is κL (..., frequencies) at ``omega`` (frequencies,); ``passes`` are counted from 1.
    Even ones come ``late_s`` late where the gauge is not quite at mid-length: by 2 δ / c for one
    that lies δ further from the end at which the wave turns back after each odd pass.
    """
    late = np.exp(-1j * omega * late_s)
    total = np.zeros(np.broadcast_shapes(phase.shape, late.shape), dtype=complex)
    for k in passes:
        term = (-1.0) ** (k - 1) * np.exp(-1j * (k - 1) * phase)
        total += term * late if k % 2 == 0 else term
    return total
