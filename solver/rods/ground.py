"""Contact law of rods with a plane or with each other: stiffness and friction."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .. import paper
from ..arrays import Array
from ..bristle import positive
from ..contact.laws import mindlin_ratio
from ..errors import InputError
from .relief import RoughPlane


@dataclass(frozen=True)
class Contact:
    """The law of a contact.

    ``kn_N_m`` is the normal stiffness. On a plane it is that of an end section that lies flat,
    shared among its points; every other section has the same. Between two rods it is that of a
    crossing at right angles, wide side on wide side. Friction falls from the static to the kinetic
    coefficient with the sliding speed: μ(v) = μk + (μs - μk) exp(-(v/vs)²) (Stribeck's transition;
    Olsson et al., Eur. J. Control 4 (1998) 176). If ``stribeck_speed_m_s`` is zero it falls at
    once: a sliding point has the kinetic coefficient until it sticks again. ``kt_over_kn`` is the
    tangential spring's stiffness over the normal one.

    Raises InputError if a number is out of range.
    """

    kn_N_m: float = paper.KN_CHOSEN_N_M
    friction_kinetic: float = paper.FRICTION
    friction_static: float = paper.FRICTION
    stribeck_speed_m_s: float = 0.0
    kt_over_kn: float = mindlin_ratio(paper.POISSON)

    def __post_init__(self) -> None:
        positive("Kn", self.kn_N_m)
        positive("Kt / Kn", self.kt_over_kn)
        for name in ("friction_kinetic", "friction_static", "stribeck_speed_m_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InputError(f"{name} must be zero or more, not {value}")
        if self.friction_static < self.friction_kinetic:
            raise InputError(
                f"the static coefficient of friction, {self.friction_static}, must not be below "
                f"the kinetic one, {self.friction_kinetic}"
            )


@dataclass(frozen=True)
class Ground(Contact):
    """A plane through ``point_m`` (3,) with an outward ``normal`` (3,), and its contact.

    A ``rough`` plane has heights over z = 0, and Kn is the mean stiffness over it.
    """

    point_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    rough: RoughPlane | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (np.all(np.isfinite(self.point_m)) and np.linalg.norm(self.normal) > 0.0):
            raise InputError("the plane needs a finite point and a normal that is not zero")
        level = self.point_m == (0.0, 0.0, 0.0) and self.normal == (0.0, 0.0, 1.0)
        if self.rough is not None and not level:
            raise InputError("a rough plane is z = 0, with the normal along z")

    @property
    def unit_normal(self) -> Array:
        """The normal as unit vector (3,)."""
        return np.asarray(self.normal, dtype=float) / np.linalg.norm(self.normal)

    def gaps_m(self, points_m: Array) -> Array:
        """Heights (…,) of points (…, 3) above the plane."""
        return (points_m - np.asarray(self.point_m)) @ self.unit_normal
