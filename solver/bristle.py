"""What falls: a bristle's section, length and material, and what follows from them; or a ball."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np

from . import paper
from .arrays import Array
from .errors import InputError

# Contact points across each side of the end section: what an edge-first touch of a stiff surface
# needs, see the study of leaning impacts.
CONTACT_POINTS = 9


def positive(name: str, value: float) -> None:
    """Raise InputError unless ``value`` is a finite positive number."""
    if not (math.isfinite(value) and value > 0.0):
        raise InputError(f"{name} must be a positive number, not {value}")


class Section(Protocol):
    """A cross-section centred on the axis: x is its thin side, y its wide side."""

    @property
    def area_m2(self) -> float: ...

    @property
    def second_moment_x_m4(self) -> float:
        """The integral of x² (bending toward x)."""
        ...

    @property
    def second_moment_y_m4(self) -> float:
        """The integral of y² (bending toward y)."""
        ...

    @property
    def torsion_m4(self) -> float:
        """St. Venant's torsion constant J."""
        ...

    def shear_coefficient(self, poisson: float) -> float:
        """Timoshenko's shear coefficient."""
        ...

    def contact_points(self, n: int) -> tuple[Array, Array]:
        """Points (m, 2) of the end section that can touch, edge included, and area weights (m,).

        ``n`` (3 or more) is how many lie across it.
        """
        ...


@dataclass(frozen=True)
class Rectangle:
    """A flat wire, ``thickness_m`` along x and ``width_m`` along y."""

    thickness_m: float = paper.THICKNESS_M
    width_m: float = paper.WIDTH_M

    def __post_init__(self) -> None:
        positive("thickness", self.thickness_m)
        positive("width", self.width_m)

    @property
    def area_m2(self) -> float:
        return self.thickness_m * self.width_m

    @property
    def second_moment_x_m4(self) -> float:
        return self.width_m * self.thickness_m**3 / 12.0

    @property
    def second_moment_y_m4(self) -> float:
        return self.thickness_m * self.width_m**3 / 12.0

    @cached_property
    def torsion_m4(self) -> float:
        """St. Venant's series (Timoshenko and Goodier, Theory of Elasticity, art. 109)."""
        a, b = sorted((self.thickness_m, self.width_m))
        n = np.arange(1, 200, 2)
        series = np.sum(np.tanh(n * math.pi * b / (2.0 * a)) / n**5.0)
        return float(a**3 * b / 3.0 * (1.0 - 192.0 * a / (math.pi**5 * b) * series))

    def shear_coefficient(self, poisson: float) -> float:
        """Cowper (1966), rectangle: 10(1+ν)/(12+11ν)."""
        return 10.0 * (1.0 + poisson) / (12.0 + 11.0 * poisson)

    def contact_points(self, n: int) -> tuple[Array, Array]:
        """Gauss-Lobatto points, n by n: exact to degree 2n - 3, edges and corners included."""
        x, w = gauss_lobatto(n)
        points = np.stack(
            np.meshgrid(0.5 * self.thickness_m * x, 0.5 * self.width_m * x, indexing="ij"), -1
        ).reshape(-1, 2)
        return points, np.outer(w, w).ravel() / 4.0


@dataclass(frozen=True)
class Circle:
    """A round wire."""

    diameter_m: float

    def __post_init__(self) -> None:
        positive("diameter", self.diameter_m)

    @property
    def area_m2(self) -> float:
        return math.pi * self.diameter_m**2 / 4.0

    @property
    def second_moment_x_m4(self) -> float:
        return math.pi * self.diameter_m**4 / 64.0

    @property
    def second_moment_y_m4(self) -> float:
        return self.second_moment_x_m4

    @property
    def torsion_m4(self) -> float:
        return 2.0 * self.second_moment_x_m4

    def shear_coefficient(self, poisson: float) -> float:
        """Cowper (1966), circle: 6(1+ν)/(7+6ν)."""
        return 6.0 * (1.0 + poisson) / (7.0 + 6.0 * poisson)

    def contact_points(self, n: int) -> tuple[Array, Array]:
        """The centre and rings of eight or more, the rim among them: exact to degree n - 2 in r².

        With s = r²/R² the area of a ring is proportional to ds: Gauss-Lobatto's rule in s. A ring
        has twice as many points as lie across the section.
        """
        rings = n // 2 + 1
        s, w = gauss_lobatto(rings)
        radius = 0.5 * self.diameter_m * np.sqrt(0.5 * (s[1:] + 1.0))
        around = max(8, 2 * n)
        angle = np.arange(around) * (2.0 * math.pi / around)
        circle = np.stack([np.cos(angle), np.sin(angle)], -1)
        points = (radius[:, None, None] * circle).reshape(-1, 2)
        weights = np.repeat(0.5 * w[1:] / around, around)
        return np.vstack([[[0.0, 0.0]], points]), np.concatenate([[0.5 * w[0]], weights])


def gauss_lobatto(n: int) -> tuple[Array, Array]:
    """The n-point Gauss-Lobatto rule on [-1, 1]: points (n,), weights (n,) that sum to 2."""
    legendre = np.polynomial.legendre.Legendre.basis(n - 1)
    x = np.concatenate([[-1.0], np.sort(legendre.deriv().roots().real), [1.0]])
    return x, 2.0 / (n * (n - 1) * legendre(x) ** 2)


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
        """The area that meets the air, or None where the diameter is not known."""
        return None if self.diameter_m is None else 0.25 * math.pi * self.diameter_m**2
