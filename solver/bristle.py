"""The falling body: a bristle's section, length and material, and derived quantities; or a ball."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from ..meshes.section import Rectangle, Section
from . import paper
from .errors import InputError

# Contact points across each side of the end section, as an edge-first impact on a stiff surface
# needs; see the study of leaning impacts.
CONTACT_POINTS = 9


def positive(name: str, value: float) -> None:
    """Raise InputError unless ``value`` is a finite positive number."""
    if not (math.isfinite(value) and value > 0.0):
        raise InputError(f"{name} must be a positive number, not {value}")


@dataclass(frozen=True)
class Material:
    """Linear elastic material with Rayleigh damping C = alpha M + beta K."""

    youngs_Pa: float = paper.YOUNGS_PA
    poisson: float = paper.POISSON
    density_kg_m3: float = paper.DENSITY_KG_M3
    alpha_1_s: float = paper.ALPHA_1_S
    beta_s: float = paper.BETA_S

    def __post_init__(self) -> None:
        positive("Young's modulus", self.youngs_Pa)
        positive("density", self.density_kg_m3)
        if not -1.0 < self.poisson < 0.5:
            raise InputError(f"Poisson's ratio must lie between -1 and 0.5, not {self.poisson}")
        for name, value in (("alpha", self.alpha_1_s), ("beta", self.beta_s)):
            if not (math.isfinite(value) and value >= 0.0):
                raise InputError(f"Rayleigh damping {name} must be zero or more, not {value}")

    @property
    def shear_modulus_Pa(self) -> float:
        return self.youngs_Pa / (2.0 * (1.0 + self.poisson))

    @property
    def lame_Pa(self) -> tuple[float, float]:
        """Lamé's constants λ and μ."""
        e, nu = self.youngs_Pa, self.poisson
        return e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), self.shear_modulus_Pa

    @property
    def bar_speed_m_s(self) -> float:
        """Speed of axial waves in a thin bar, √(E/ρ)."""
        return math.sqrt(self.youngs_Pa / self.density_kg_m3)


@dataclass(frozen=True)
class Bristle:
    """A straight prismatic bristle; its axis is z, its lower tip at z = 0."""

    length_m: float = paper.LENGTH_M
    section: Section = field(default_factory=Rectangle)
    material: Material = field(default_factory=Material)

    def __post_init__(self) -> None:
        positive("length", self.length_m)

    @property
    def mass_kg(self) -> float:
        return self.material.density_kg_m3 * self.section.area_m2 * self.length_m

    @property
    def axial_period_s(self) -> float:
        """Period 2L/c of the first free-free axial mode; a rigid impact lasts as long."""
        return 2.0 * self.length_m / self.material.bar_speed_m_s

    @property
    def axial_damping(self) -> float:
        """Damping of that mode by β alone, over critical: β ω / 2; the paper's bristle has 0.26."""
        return math.pi / self.axial_period_s * self.material.beta_s


@dataclass(frozen=True)
class RigidMass:
    """A ball or any compact body, without elasticity of its own; ``diameter_m`` is for drag."""

    mass_kg: float
    diameter_m: float | None = None

    def __post_init__(self) -> None:
        positive("mass", self.mass_kg)
        if self.diameter_m is not None:
            positive("diameter", self.diameter_m)

    @property
    def front_m2(self) -> float | None:
        """The frontal area for drag, or None if the diameter is unknown."""
        return None if self.diameter_m is None else 0.25 * math.pi * self.diameter_m**2
