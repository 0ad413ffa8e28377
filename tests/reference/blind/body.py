"""Free-free modes of a slender body, axial and bending, with the damping of each.

Series of a uniform bar (Graff, Wave Motion in Elastic Solids, 1975, chapters 2 and 3); modes have
unit modal mass. Damping belongs to the material alone: a mode of frequency ω is damped by
β ω² + η ω. Numpy and scipy only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

Array = NDArray[np.float64]
STEEL_PA, STEEL_POISSON, STEEL_KG_M3 = 207e9, 0.28, 7800.0
AXIAL, BENDING = 48, 80


@dataclass(frozen=True)
class Body:
    """A bar of rectangular section, or round where ``diameter_m`` is given."""

    length_m: float = 0.3365
    width_m: float = 2.08e-3
    thickness_m: float = 0.5e-3
    diameter_m: float | None = None
    youngs_Pa: float = STEEL_PA
    poisson: float = STEEL_POISSON
    density_kg_m3: float = STEEL_KG_M3
    beta_s: float = 1.07e-5
    loss_factor: float = 0.0

    @property
    def area_m2(self) -> float:
        if self.diameter_m is None:
            return self.width_m * self.thickness_m
        return 0.25 * math.pi * self.diameter_m**2

    @property
    def mass_kg(self) -> float:
        return self.density_kg_m3 * self.area_m2 * self.length_m

    @property
    def wave_speed_m_s(self) -> float:
        return math.sqrt(self.youngs_Pa / self.density_kg_m3)

    @property
    def axial_N_m(self) -> float:
        """EA/L."""
        return self.youngs_Pa * self.area_m2 / self.length_m

    def damping(self, omega: Array) -> Array:
        return self.beta_s * omega**2 + self.loss_factor * omega

    def axial_omega(self, n: int = AXIAL) -> Array:
        """(n,) rad/s, the rigid motion first."""
        return np.arange(n) * math.pi * self.wave_speed_m_s / self.length_m

    def axial_tip(self, n: int = AXIAL) -> Array:
        """What the modes are at the tip (n,)."""
        shape = np.full(n, math.sqrt(2.0 / self.mass_kg))
        shape[0] = math.sqrt(1.0 / self.mass_kg)
        return shape

    def left_out_m_N(self, n: int = AXIAL) -> float:
        """Compliance at the tip of the axial modes from number ``n`` on: their sum is L/(3 EA)."""
        kept = np.sum(2.0 / (math.pi * np.arange(1, n)) ** 2) / self.axial_N_m
        return 1.0 / (3.0 * self.axial_N_m) - float(kept)


@lru_cache(maxsize=64)
def axial_steps(body: Body, dt_s: float, n: int = AXIAL) -> Array:
    """`forced_steps` of the axial modes under a force at the tip."""
    omega, shape = body.axial_omega(n), body.axial_tip(n)
    return forced_steps(omega, body.damping(omega), shape, dt_s)


def forced_steps(omega: Array, damping: Array, shape: Array, dt_s: float) -> Array:
    """Exact step of each mode under a force that varies linearly over it, (n, 2, 4).

    Rows are displacement and velocity after the step; columns what multiplies displacement,
    velocity, the force at its beginning and at its end.
    """
    system = np.zeros((len(omega), 4, 4))
    system[:, 0, 1] = 1.0
    system[:, 1, 0], system[:, 1, 1], system[:, 1, 2] = -(omega**2), -damping, shape
    system[:, 2, 3] = 1.0
    # equilibrated in time, for the exponential's sake
    scale = np.array([1.0, 1.0 / dt_s, 1.0 / dt_s**2, 1.0 / dt_s**3])
    balanced = system * dt_s * scale[None, None, :] / scale[None, :, None]
    one = expm(balanced) * scale[None, :, None] / scale[None, None, :]
    rate = one[:, :2, 3] / dt_s
    return np.ascontiguousarray(
        np.stack([one[:, :2, 0], one[:, :2, 1], one[:, :2, 2] - rate, rate], axis=2)
    )


def free_steps(omega: Array, damping: Array, dt_s: float) -> Array:
    """Exact step of modes that no force acts on, (n, 2, 2)."""
    free = forced_steps(omega, damping, np.zeros_like(omega), dt_s)
    return np.ascontiguousarray(free[:, :, :2])


def left_over_step(body: Body, dt_s: float, n: int = AXIAL) -> Array:
    """`delayed_step` (3,) of the displacement that the modes left out make, for forces."""
    return delayed_step(body.beta_s / dt_s) * [1.0, *2 * [body.left_out_m_N(n)]]


def delayed_step(delay: float) -> Array:
    """Step (3,) of what follows a force with a ``delay`` in steps, the force linear over the step:
    what multiplies itself, the force at the step's beginning, and at its end."""
    if delay < 1e-3:
        return np.array([0.0, 0.0, 1.0])
    stays = math.exp(-1.0 / delay)
    end = 1.0 - delay + stays * delay
    return np.array([stays, 1.0 - stays - end, end])


@dataclass(frozen=True, eq=False)
class Bending:
    """Modes of one plane: rotation first, then bending; ``shortens`` (n, n) is
    ∫ (1 - x/L) φ' φ'ᵀ dx, by which slopes draw the tip towards the centre of mass (twice)."""

    omega: Array
    tip: Array
    slope: Array
    shortens: Array


@lru_cache(maxsize=64)
def bending(body: Body, depth_m: float, n: int = BENDING) -> Bending:
    """Modes of a rectangular bar that bends over ``depth_m``."""
    length, mass = body.length_m, body.mass_kg
    inertia = math.sqrt(body.youngs_Pa / body.density_kg_m3 * depth_m**2 / 12.0)
    roots = _roots(n - 1)
    omega = np.append(0.0, roots**2 * inertia / length**2)
    points, weights = np.polynomial.legendre.leggauss(6 * n)
    x, weights = 0.5 * (points + 1.0), 0.5 * weights
    tip, slopes, at_tip = np.empty(n), np.empty((n, len(x))), np.empty(n)
    turn = math.sqrt(12.0)
    tip[0], slopes[0], at_tip[0] = -0.5 * turn, turn, turn
    for i, root in enumerate(roots, start=1):
        tip[i], slopes[i], at_tip[i] = 2.0, _slope(root, x), _slope(root, np.zeros(1))[0]
    shortens = (slopes * (weights * (1.0 - x))) @ slopes.T / (length * mass)
    unit = math.sqrt(mass)
    return Bending(omega, tip / unit, at_tip / (unit * length), np.ascontiguousarray(shortens))


def _roots(n: int) -> Array:
    """Roots (n,) of cos z cosh z = 1 above zero."""
    z = (np.arange(1, n + 1) + 0.5) * math.pi
    for _ in range(20):
        near = 1.0 / np.cosh(np.minimum(z, 700.0))
        z = z - (np.cos(z) - near) / (-np.sin(z) + near * np.tanh(z))
    return z


def _slope(root: float, x: Array) -> Array:
    """Derivative of a free-free mode with tip 2 at ``x`` in lengths, without cancellation."""
    small = math.exp(-root)
    rising = 2.0 * (math.cos(root) - math.sin(root) - small)
    rising /= 1.0 - small**2 - 2.0 * small * math.sin(root)
    sigma = 1.0 - rising * small
    up, down = rising * np.exp(root * (x - 1.0)), (1.0 + sigma) * np.exp(-root * x)
    wave = -np.sin(root * x) - sigma * np.cos(root * x)
    return root * (wave + 0.5 * (up - down))
