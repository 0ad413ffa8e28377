"""Cross-section of a rod: stiffness, inertia, damping, and its contact points."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from ...meshes.section import Circle, Rectangle, Section
from ..arrays import Array
from ..bristle import Bristle, positive
from ..errors import InputError

# Points on the rim of a round section.
RIM_POINTS = 8
# For a rigid contact: stiffness of one contact point over that of an element along the axis.
RIGID = 2.5


def half_sides_m(section: Section) -> tuple[float, float]:
    """Half of the thin and of the wide side; for a round section the radius, twice."""
    if isinstance(section, Rectangle):
        return 0.5 * section.thickness_m, 0.5 * section.width_m
    return 0.5 * section.diameter_m, 0.5 * section.diameter_m


@dataclass(frozen=True)
class RodSection:
    """A section in its own axes: 1 along the thin side, 2 along the wide side, 3 along the rod.

    Index 1 of a bending stiffness or a rotary inertia says about which axis the section turns.

    Parameters
    ----------
    EA_N, GA1_N, GA2_N : stiffness against stretch and against shear along axes 1 and 2, N
    EI1_Nm2, EI2_Nm2, GJ_Nm2 : stiffness against bending about axes 1 and 2 and twist, N m²
    rhoA_kg_m : mass per length
    rhoI1_kg_m, rhoI2_kg_m : rotary inertia per length about axes 1 and 2, kg m
    half_thin_m, half_wide_m : half sides; both the radius of a round section
    beta_s, alpha_1_s : Rayleigh's damping, on strain rates and on velocities
    curvature_1_m : natural curvatures about axes 1 and 2 and natural twist, 1/m
    is_round : whether the section is a disc, not a rectangle

    Raises
    ------
    InputError : a stiffness, inertia or side is not positive, or a damping is negative
    """

    EA_N: float
    GA1_N: float
    GA2_N: float
    EI1_Nm2: float
    EI2_Nm2: float
    GJ_Nm2: float
    rhoA_kg_m: float
    rhoI1_kg_m: float
    rhoI2_kg_m: float
    half_thin_m: float
    half_wide_m: float
    beta_s: float = 0.0
    alpha_1_s: float = 0.0
    curvature_1_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    is_round: bool = False

    def __post_init__(self) -> None:
        for name in ("EA_N", "GA1_N", "GA2_N", "EI1_Nm2", "EI2_Nm2", "GJ_Nm2", "rhoA_kg_m"):
            positive(name, getattr(self, name))
        for name in ("rhoI1_kg_m", "rhoI2_kg_m", "half_thin_m", "half_wide_m"):
            positive(name, getattr(self, name))
        for name in ("beta_s", "alpha_1_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InputError(f"{name} must be zero or more, not {value}")
        if not np.all(np.isfinite(self.curvature_1_m)):
            raise InputError(f"the natural curvature must be finite, not {self.curvature_1_m}")

    @classmethod
    def of(
        cls, bristle: Bristle, curvature_1_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> Self:
        """The section of a bristle: its material times its section's moments.

        Shear has Cowper's coefficient, torsion St. Venant's constant.
        """
        material, section = bristle.material, bristle.section
        e, g, rho = material.youngs_Pa, material.shear_modulus_Pa, material.density_kg_m3
        shear = section.shear_coefficient(material.poisson) * g * section.area_m2
        # turning about axis 1 moves points by their coordinate along axis 2
        about_1, about_2 = section.second_moment_y_m4, section.second_moment_x_m4
        half_thin_m, half_wide_m = half_sides_m(section)
        return cls(
            EA_N=e * section.area_m2,
            GA1_N=shear,
            GA2_N=shear,
            EI1_Nm2=e * about_1,
            EI2_Nm2=e * about_2,
            GJ_Nm2=g * section.torsion_m4,
            rhoA_kg_m=rho * section.area_m2,
            rhoI1_kg_m=rho * about_1,
            rhoI2_kg_m=rho * about_2,
            half_thin_m=half_thin_m,
            half_wide_m=half_wide_m,
            beta_s=material.beta_s,
            alpha_1_s=material.alpha_1_s,
            curvature_1_m=curvature_1_m,
            is_round=isinstance(section, Circle),
        )

    @property
    def second_moments_m4(self) -> tuple[float, float]:
        """Second moments of area for bending about axes 1 and 2."""
        thin, wide = self.half_thin_m, self.half_wide_m
        if self.is_round:
            return 0.25 * math.pi * thin**4, 0.25 * math.pi * thin**4
        return 4.0 / 3.0 * thin * wide**3, 4.0 / 3.0 * wide * thin**3

    @property
    def rim_m(self) -> Array:
        """The contact points (k, 2) of a section: its corners, or points on the rim."""
        if self.is_round:
            angle = np.arange(RIM_POINTS) * (2.0 * math.pi / RIM_POINTS)
            return self.half_thin_m * np.stack([np.cos(angle), np.sin(angle)], -1)
        signs = np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
        return signs * (self.half_thin_m, self.half_wide_m)

    def rigid_N_m(self, element_m: float) -> float:
        """Kn that stands for a rigid contact, with elements of this length.

        Each contact point is then `RIGID` times as stiff as an element along the axis, where a rod
        is softest. A stiffer contact would need shorter steps and hardly change a force.
        """
        return RIGID * len(self.rim_m) * self.EA_N / element_m

    def bending_stress_Pa(self, moment_Nm: Array) -> Array:
        """The greatest bending stress (…,) over the section under moments (…, 3) about its axes."""
        about_1, about_2 = self.second_moments_m4
        stress_1 = np.abs(moment_Nm[..., 0]) * self.half_wide_m / about_1
        stress_2 = np.abs(moment_Nm[..., 1]) * self.half_thin_m / about_2
        return np.hypot(stress_1, stress_2) if self.is_round else stress_1 + stress_2
