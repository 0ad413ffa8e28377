"""Axial waves along a rod with free ends: wave number, and all that follows the first pass.

In the frequency domain, exp(+iωt). The equation of motion of Love's rod (A. E. H. Love, A Treatise
on the Mathematical Theory of Elasticity, 4th ed. 1927, article 278; K. F. Graff, Wave Motion in
Elastic Solids, 1975, chapter 2) follows from the kinetic energy ½ρ(A u̇² + ν² I_p u̇'²), I_p the
section's polar second moment about its axis:

    ρ (ü + α u̇) = E u'' + ρ ν² (I_p / A) ü'',
    so that   κ² = ρ (ω² − iωα) / (E(ω) − s ρ ν² (I_p / A) ω²)

with E(ω) = E ((1 + iη) (ω/ω₁)^(2dγ) + iωβ): α and β are Rayleigh's damping, η = tan πγ a loss
factor that does not depend on frequency. No effect precedes its cause in a material whose modulus
rises with frequency as d = 1 has it (E. Kjartansson, J. Geophys. Res. 84 (1979) 4737); d = 0 is the
loss without that (S. H. Crandall, J. Sound Vib. 11 (1970) 3), and a loss that is constant over some
decades alone has another d. E is the modulus at ω₁ = πc/L, the first axial mode. s is 1 for Love's
rod and 0 for a plain one. For slow waves c(k) = c (1 − ½ ν² k² I_p / A), which is exact to this
order for a section of any shape, circular ones being Pochhammer's and Chree's (Graff, chapter 8).

A free end returns a wave of stress with its sign changed and nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .....meshes.section import Circle, Rectangle
from .....solver.arrays import Array
from .....solver.bristle import Bristle
from .....solver.errors import InputError

Complex = NDArray[np.complex128]
SHORTEST_WAVE = 10.0
"""Least wavelength at which Love's rod is used, in radii of a round bar of equal I_p / A: there its
phase speed is within 1e-3 of Pochhammer's and Chree's, and soon it is further off."""


@dataclass(frozen=True)
class Rod:
    """A free-free bar: length in m and what lateral inertia is made of.

    ``gyration_m2`` is ν² I_p / A and ``radius_m`` √(2 I_p / A), the radius of a round bar.
    """

    length_m: float
    gyration_m2: float
    radius_m: float = 0.0

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
        return cls(bar.length_m, bar.material.poisson**2 * polar, float(np.sqrt(2.0 * polar)))

    def wave_number(
        self,
        omega: Array | Complex,
        speed_m_s: Array | float,
        beta_s: Array | float = 0.0,
        loss_factor: Array | float = 0.0,
        strength: Array | float = 0.0,
        alpha_1_s: float = 0.0,
        dispersion: Array | float = 1.0,
    ) -> Complex:
        """κ (..., frequencies) in 1/m at ``omega`` (frequencies,) in rad/s, zero or more
        (more than zero where there is α).

        ``omega`` may have a negative imaginary part, which damps every signal in time. The others
        are scalars or (..., 1). κ has an imaginary part of zero or less: exp(iωt − iκx) never
        grows along x, and where Love's rod carries no wave, it decays.
        """
        square = speed_m_s**2
        power = 2.0 / np.pi * np.arctan(loss_factor) * dispersion
        stiffened = (omega * (self.length_m / (np.pi * speed_m_s)) + 0j) ** power
        elastic = (1.0 + 1j * np.asarray(loss_factor)) * stiffened + (1j * beta_s) * omega
        elastic = square * elastic - strength * self.gyration_m2 * omega**2
        elastic = np.where(np.abs(elastic) < 1e-9 * square, 1e-9 * square, elastic)
        inertia = omega if alpha_1_s == 0.0 else omega * np.sqrt(1.0 - 1j * alpha_1_s / omega)
        # each root by itself: that of the ratio would jump where the angles add up to more than π
        kappa = inertia / np.sqrt(elastic)
        return np.asarray(kappa.real + 1j * np.minimum(kappa.imag, 0.0))

    def after_a_pass(self, wave_number: Complex, x_m: Array | float, ends: Complex) -> Complex:
        """What a gauge at ``x_m`` sees after a pass toward the far end, over this pass, of stress,
        strain or voltage, (..., frequencies).

        The pass comes back from the far end after 2 (L − x) with its sign changed, from the near
        end after 2 L with its own sign, and so on for ever; ``ends`` is what each reflection does
        besides. The sum converges where κ has a negative imaginary part.
        """
        back = -ends * np.exp(-2j * wave_number * (self.length_m - x_m))
        round_trip = ends**2 * np.exp(-2j * wave_number * self.length_m)
        return np.asarray((back + round_trip) / (1.0 - round_trip))


def attached_mass(
    omega: Array | Complex,
    impedance: Array | float,
    share: Array | float,
    frequency_Hz: Array | float,
    loss_factor: Array | float,
) -> Complex:
    """What a mass on a lossy spring at an end does to a reflection, besides its sign.

    The result is (..., frequencies). ``impedance`` is the bar's over its mass, c / L in 1/s;
    ``share`` is the mass over the bar's, ``frequency_Hz`` its own frequency on a rigid bar and
    ``loss_factor`` the viscous loss of its spring there. The mass pulls with the impedance
    Z = iωm (1 + iωη/ω₀) / (1 − (ω/ω₀)² + iωη/ω₀) on a bar of impedance ρcA = M c / L, which returns
    −(1 − z) / (1 + z) of a wave of stress, z = Z L / (M c) (Graff, chapter 2; den Hartog,
    Mechanical Vibrations, 4th ed. 1956, chapter 3, for Z).
    """
    ratio = omega / (2.0 * np.pi * np.asarray(frequency_Hz))
    spring = 1.0 + 1j * ratio * loss_factor
    z = 1j * omega * share / impedance * spring / (spring - ratio**2)
    return np.asarray((1.0 - z) / (1.0 + z))
