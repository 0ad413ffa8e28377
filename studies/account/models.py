"""Which accounts of the lost 35 % are there, and what does each say of a drop?

Each is a small class with named parameters. An account turns its parameters and common random
numbers into the conditions of drops; the mechanics and the film are the same for all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ...solver import paper
from ...solver.bristle import Array
from .library import Conditions, Grid, damped_law

MEASURED_BETA_S = 1e-8
HEIGHTS_M = (0.01, 0.025, 0.05)
MOST_LEAN_DEG = 8.0
# Standard normal numbers that a drop's conditions may use.
CHANCES = 2


@dataclass(frozen=True)
class Parameter:
    """A parameter with its bounds, what it was declared to be before the fit, and why so.

    ``logarithmic`` ones are fitted, and taken as equally likely, by their logarithm.
    """

    name: str
    unit: str
    low: float
    high: float
    declared: float
    why: str
    logarithmic: bool = False

    def ladder(self, n: int, low: float | None = None, high: float | None = None) -> Array:
        """``n`` values between the bounds, or ``low`` and ``high`` within them."""
        low = self.low if low is None else max(low, self.low)
        high = self.high if high is None else min(high, self.high)
        return np.geomspace(low, high, n) if self.logarithmic else np.linspace(low, high, n)


class Account(Protocol):
    """An explanation of the measured bounces."""

    @property
    def key(self) -> str:
        """Short name, of letters."""
        ...

    @property
    def title(self) -> str: ...

    @property
    def beta_s(self) -> float:
        """Stiffness-proportional damping of the material."""
        ...

    @property
    def parameters(self) -> tuple[Parameter, ...]: ...

    @property
    def grid(self) -> Grid:
        """Where its table of drops has points."""
        ...

    def conditions(
        self, values: Sequence[float], height_m: Array, chance: Array, lean_deg: float = 0.0
    ) -> Conditions:
        """Conditions of drops from ``height_m``, of the shape of ``chance`` (2, …) without its 2.

        ``lean_deg`` is a lean toward the thin side given on purpose.
        """
        ...


KN = Parameter(
    "Kn",
    "N/m",
    1e4,
    1e8,
    paper.KN_CHOSEN_N_M,
    "the paper's range; declared is its choice",
    logarithmic=True,
)
KN_MEDIAN = Parameter(
    "median Kn",
    "N/m",
    1e4,
    1e8,
    math.sqrt(1e4 * 1e8),
    "the paper's range; declared is the middle of its 90 % range, 0.01 to 100 MN/m",
    logarithmic=True,
)
KN_SPREAD = Parameter(
    "spread of Kn",
    "decades",
    0.0,
    2.5,
    4.0 / (2.0 * 1.6449),
    "standard deviation of log10 Kn; declared puts 90 % between 0.01 and 100 MN/m",
)
LEAN = Parameter(
    "lean",
    "°",
    0.0,
    5.0,
    2.0,
    "standard deviation about each axis; a bristle let go by hand; more would be seen",
)
FRICTION = Parameter(
    "friction",
    "",
    0.0,
    0.5,
    paper.FRICTION,
    "Coulomb's μ from none to the paper's 0.5, which is declared",
)


def dashpot_for(ratio: float, kn_N_m: float = paper.KN_CHOSEN_N_M) -> float:
    """Dashpot (N s/m) with which a rigid bristle on a spring would keep ``ratio`` of its height.

    A damped half oscillation keeps exp(-2π ζ/√(1-ζ²)) of the energy; ζ = c / (2 √(Kn m)).
    """
    decrement = -math.log(ratio) / (2.0 * math.pi)
    zeta = decrement / math.sqrt(1.0 + decrement**2)
    return 2.0 * zeta * math.sqrt(kn_N_m * paper.MASS_KG)


DASHPOT = Parameter(
    "dashpot",
    "N s/m",
    0.5,
    200.0,
    dashpot_for(paper.RATIO_MEAN),
    "around the bristle's wave impedance, 42; declared gives 0.65 to a rigid bristle at 2 MN/m",
    logarithmic=True,
)
DASHPOT_SPREAD = Parameter(
    "spread of dashpot",
    "decades",
    0.0,
    1.5,
    0.0,
    "standard deviation of log10 of the dashpot; declared is none",
)

# The tables' points: closer where y1/y0 bends.
LEANS_DEG = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0)
SIDES_DEG = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0)
SLIPS = (0.0, 0.25, 0.5, 0.7, 0.85, 1.0, 1.3, 2.0)
KNS_N_M = tuple(float(kn) for kn in np.geomspace(1e3, 1e10, 43))
DASHPOTS_N_S_M = tuple(float(c) for c in np.geomspace(0.1, 1000.0, 25))
FEW_DASHPOTS_N_S_M = tuple(float(c) for c in np.geomspace(0.5, 200.0, 7))
FEW_LEANS_DEG = (0.0, 1.0, 2.0, 3.0, 4.5, 6.0, 8.0)
FEW_SIDES_DEG = (0.0, 22.5, 45.0, 67.5, 90.0)
# Softer and damped, a contact holds the bristle for good.
DAMPED_KNS_N_M = tuple(float(kn) for kn in np.geomspace(1e5, 1e10, 21))


def lean_of(tilt_deg: Array, wide_deg: Array) -> tuple[Array, Array]:
    """Size and direction in degrees of a lean by ``tilt_deg`` (thin side) and ``wide_deg``.

    Leans beyond `MOST_LEAN_DEG` are held to it: nobody would have filmed them as a vertical drop.
    """
    x, y = np.abs(np.tan(np.radians(tilt_deg))), np.abs(np.tan(np.radians(wide_deg)))
    size = np.minimum(np.degrees(np.arctan(np.hypot(x, y))), MOST_LEAN_DEG)
    return size, np.degrees(np.arctan2(y, x))


UPRIGHT = Grid(paper.BETA_S, kn_N_m=KNS_N_M)


@dataclass(frozen=True)
class OneStiffness:
    """A: the paper's. Strong material damping; flat, vertical; one Kn."""

    key: str = "A"
    title: str = "the paper's damping, upright, one Kn"
    beta_s: float = paper.BETA_S
    parameters: tuple[Parameter, ...] = (KN,)
    grid: Grid = UPRIGHT

    def conditions(
        self, values: Sequence[float], height_m: Array, chance: Array, lean_deg: float = 0.0
    ) -> Conditions:
        return Conditions.of(
            np.broadcast_to(height_m, chance.shape[1:]), kn_N_m=values[0], lean_deg=lean_deg
        )


@dataclass(frozen=True)
class ScatteredStiffness:
    """A′: the paper's explanation of the spread. Every drop meets a Kn of its own."""

    key: str = "A′"
    title: str = "the paper's damping, upright, Kn scattered"
    beta_s: float = paper.BETA_S
    parameters: tuple[Parameter, ...] = (KN_MEDIAN, KN_SPREAD)
    grid: Grid = UPRIGHT

    def conditions(
        self, values: Sequence[float], height_m: Array, chance: Array, lean_deg: float = 0.0
    ) -> Conditions:
        kn = _scattered(values[0], values[1], chance[0], KNS_N_M)
        return Conditions.of(height_m, kn_N_m=kn, lean_deg=lean_deg)


@dataclass(frozen=True)
class Leaning:
    """B: lean scattered about both axes, Coulomb friction; Kn is the paper's. D: strong damping."""

    key: str = "B"
    title: str = "measured damping, lean scattered, friction"
    beta_s: float = MEASURED_BETA_S
    parameters: tuple[Parameter, ...] = (LEAN, FRICTION)
    leans_deg: tuple[float, ...] = LEANS_DEG
    sides_deg: tuple[float, ...] = SIDES_DEG

    @property
    def grid(self) -> Grid:
        return Grid(self.beta_s, self.leans_deg, self.sides_deg, SLIPS, height_m=HEIGHTS_M)

    def conditions(
        self, values: Sequence[float], height_m: Array, chance: Array, lean_deg: float = 0.0
    ) -> Conditions:
        size, side = _scattered_lean(values[0], chance, lean_deg)
        return Conditions.of(height_m, lean_deg=size, side_deg=side, mu=values[1])


@dataclass(frozen=True)
class DampedContact:
    """C: measured damping; a dashpot in the contact takes the energy, Kn is scattered.

    A dashpot takes most where it is as hard to move as the bristle's axial waves, ρ c A = 42 N s/m;
    a much stronger one stands still and takes nothing.
    """

    key: str = "C"
    title: str = "contact loss, upright, Kn scattered"
    beta_s: float = MEASURED_BETA_S
    parameters: tuple[Parameter, ...] = (DASHPOT, KN_SPREAD)

    @property
    def grid(self) -> Grid:
        return Grid(self.beta_s, kn_N_m=DAMPED_KNS_N_M, damping_N_s_m=DASHPOTS_N_S_M)

    def conditions(
        self, values: Sequence[float], height_m: Array, chance: Array, lean_deg: float = 0.0
    ) -> Conditions:
        kn = _scattered(paper.KN_CHOSEN_N_M, values[1], chance[0], DAMPED_KNS_N_M)
        return Conditions.of(height_m, kn_N_m=kn, damping_N_s_m=values[0], lean_deg=lean_deg)


@dataclass(frozen=True)
class ScatteredDashpot:
    """C′: the same with one Kn and a dashpot that differs from drop to drop."""

    key: str = "C′"
    title: str = "contact loss, upright, dashpot scattered"
    beta_s: float = MEASURED_BETA_S
    parameters: tuple[Parameter, ...] = (DASHPOT, DASHPOT_SPREAD)

    @property
    def grid(self) -> Grid:
        return Grid(self.beta_s, damping_N_s_m=DASHPOTS_N_S_M)

    def conditions(
        self, values: Sequence[float], height_m: Array, chance: Array, lean_deg: float = 0.0
    ) -> Conditions:
        c = _scattered(values[0], values[1], chance[0], DASHPOTS_N_S_M)
        return Conditions.of(height_m, damping_N_s_m=c, lean_deg=lean_deg)


@dataclass(frozen=True)
class DampedLeaning:
    """C″: a dashpot in the contact, lean scattered, the paper's friction."""

    key: str = "C″"
    title: str = "contact loss, lean scattered, μ = 0.5"
    beta_s: float = MEASURED_BETA_S
    parameters: tuple[Parameter, ...] = (DASHPOT, LEAN)

    @property
    def grid(self) -> Grid:
        return Grid(
            self.beta_s,
            FEW_LEANS_DEG,
            FEW_SIDES_DEG,
            damping_N_s_m=FEW_DASHPOTS_N_S_M,
            height_m=HEIGHTS_M,
            mu=paper.FRICTION,
        )

    def conditions(
        self, values: Sequence[float], height_m: Array, chance: Array, lean_deg: float = 0.0
    ) -> Conditions:
        size, side = _scattered_lean(values[1], chance, lean_deg)
        return Conditions.of(height_m, lean_deg=size, side_deg=side, damping_N_s_m=values[0])


def _scattered(median: float, decades: float, chance: Array, within: tuple[float, ...]) -> Array:
    """Log-normal values, held to the ends of ``within``."""
    exponent = math.log10(median) + decades * chance
    return np.asarray(10.0 ** np.clip(exponent, math.log10(within[0]), math.log10(within[-1])))


def _scattered_lean(std_deg: float, chance: Array, lean_deg: float) -> tuple[Array, Array]:
    """`lean_of` a lean that is normal about both axes, with ``lean_deg`` as its mean."""
    return lean_of(lean_deg + std_deg * chance[0], std_deg * chance[1])


def rivals() -> list[Account]:
    """All accounts that the solver can compute; those of contact loss need its damped law."""
    found: list[Account] = [OneStiffness(), ScatteredStiffness(), Leaning()]
    if damped_law() is not None:
        found += [DampedContact(), ScatteredDashpot(), DampedLeaning()]
    strong = Leaning("D", "the paper's damping, lean scattered, friction", paper.BETA_S)
    return [*found, strong]
