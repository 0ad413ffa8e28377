"""Cross-sections of a bristle, centred on the axis: x is the thin side, y the wide side.

Each provides its area, second moments, torsion constant, Timoshenko's shear coefficient, and the
contact points of an end section.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from numbers import Real

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.floating]


def require_positive(name: str, value: object) -> None:
    if isinstance(value, bool) or not isinstance(value, Real):
        raise ValueError(f"{name} must be a number, not {value!r}.")
    if not (math.isfinite(value) and float(value) > 0):
        raise ValueError(f"{name} must be positive and finite, not {value!r}.")


@dataclass(frozen=True)
class Rectangle:
    """A flat wire, ``thickness_m`` along x and ``width_m`` along y; ValueError unless positive.

    The defaults are the paper's.
    """

    thickness_m: float = 0.50e-3
    width_m: float = 2.08e-3

    def __post_init__(self) -> None:
        require_positive("thickness_m", self.thickness_m)
        require_positive("width_m", self.width_m)

    @property
    def area_m2(self) -> float:
        return self.thickness_m * self.width_m

    @property
    def second_moment_x_m4(self) -> float:
        """The integral of x² (bending toward x)."""
        return self.width_m * self.thickness_m**3 / 12.0

    @property
    def second_moment_y_m4(self) -> float:
        """The integral of y² (bending toward y)."""
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
        """Gauss-Lobatto points, n by n, and area weights: exact to degree 2n - 3, edges and corners
        included."""
        x, w = gauss_lobatto(n)
        points = np.stack(
            np.meshgrid(0.5 * self.thickness_m * x, 0.5 * self.width_m * x, indexing="ij"), -1
        ).reshape(-1, 2)
        return points, np.outer(w, w).ravel() / 4.0


@dataclass(frozen=True)
class Circle:
    """A round wire; ValueError unless its diameter is positive."""

    diameter_m: float

    def __post_init__(self) -> None:
        require_positive("diameter_m", self.diameter_m)

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
        """St. Venant's torsion constant J."""
        return 2.0 * self.second_moment_x_m4

    def shear_coefficient(self, poisson: float) -> float:
        """Cowper (1966), circle: 6(1+ν)/(7+6ν)."""
        return 6.0 * (1.0 + poisson) / (7.0 + 6.0 * poisson)

    def contact_points(self, n: int) -> tuple[Array, Array]:
        """The centre and rings of eight or more points, one on the rim, and area weights: exact to
        degree n - 2 in r².

        With s = r²/R² the area of a ring is proportional to ds: Gauss-Lobatto rule in s. A ring has
        twice as many points as lie across the section.
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


Section = Rectangle | Circle


def gauss_lobatto(n: int) -> tuple[Array, Array]:
    """The n-point Gauss-Lobatto rule on [-1, 1]: points (n,), weights (n,) that sum to 2."""
    legendre = np.polynomial.legendre.Legendre.basis(n - 1)
    x = np.concatenate([[-1.0], np.sort(legendre.deriv().roots().real), [1.0]])
    return x, 2.0 / (n * (n - 1) * legendre(x) ** 2)
