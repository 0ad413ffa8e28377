"""Which force a penetration and a slip make: contact laws and friction, with their potentials.

The scalar functions are compiled, for the loops over contact points and steps; the classes carry
parameters and speak numpy.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from .. import paper
from ..bodies.base import Array
from ..compiled import njit

LINEAR = 0.0


@njit
def elastic(
    law: Array, scale: float, drive: float, series_m_N: float
) -> tuple[float, float, float]:
    """Force in N, its tangent in N/m and its potential in J of an elastic law.

    ``law`` holds the kind of law and its parameters, ``scale`` is the point's own stiffness over
    the law's; ``drive`` and ``series_m_N`` as in `ContactLaw`.
    """
    if drive <= 0.0:
        return 0.0, 0.0, 0.0
    stiffness = scale * law[1]
    if series_m_N > 0.0:
        stiffness = 1.0 / (1.0 / stiffness + series_m_N)
    return stiffness * drive, stiffness, 0.5 * stiffness * drive * drive


class ContactLaw(Protocol):
    """An elastic law seen through a compliance in series, with a dashpot beside it.

    Per unit of area share, ``force`` is what a total force would be were the whole face like this
    point. ``drive`` (m) is the penetration that the point would have without the compliance
    ``series_m_N``: penetration = drive - series × force. So a law serves penalty (series = 0),
    Nitsche (series = its stabilisation) and the augmented Lagrangian (series = 1/r) alike.
    """

    @property
    def kn_N_m(self) -> float:
        """Stiffness in N/m that the law is called by; infinite on a rigid plane."""
        ...

    @property
    def parameters(self) -> Array:
        """What `elastic` reads: the kind of law, then its numbers."""
        ...

    @property
    def damping_N_s_m(self) -> float:
        """Force per speed of penetration while it touches; contact never pulls."""
        ...

    def force(self, drive: Array, series_m_N: float, scale: Array | float = 1.0) -> Array:
        """Elastic force (n,) in N; ``scale`` (n,) is each point's stiffness over the law's."""
        ...

    def potential(self, drive: Array, series_m_N: float, scale: Array | float = 1.0) -> Array:
        """The antiderivative of ``force`` in ``drive`` (n,) in J, zero out of contact."""
        ...

    def tangent(self, drive: Array, series_m_N: float, scale: Array | float = 1.0) -> Array:
        """d force / d drive (n,) in N/m."""
        ...


@dataclass(frozen=True)
class Linear:
    """Force = Kn × penetration (Eq. 3 of the paper); Kn = ∞ is Signorini's rigid contact."""

    kn_N_m: float

    def __post_init__(self) -> None:
        if math.isnan(self.kn_N_m) or self.kn_N_m <= 0.0:
            raise ValueError(f"Kn must be positive, not {self.kn_N_m}")

    @property
    def parameters(self) -> Array:
        return np.array([LINEAR, self.kn_N_m])

    @property
    def damping_N_s_m(self) -> float:
        return 0.0

    def _of_points(
        self, which: int, drive: Array, series_m_N: float, scale: Array | float
    ) -> Array:
        drive, scale = np.broadcast_arrays(drive, np.asarray(scale, dtype=float))
        law = self.parameters
        pairs = zip(scale.ravel(), drive.ravel(), strict=True)
        values = [elastic(law, float(s), float(d), series_m_N)[which] for s, d in pairs]
        return np.array(values).reshape(drive.shape)

    def force(self, drive: Array, series_m_N: float, scale: Array | float = 1.0) -> Array:
        return self._of_points(0, drive, series_m_N, scale)

    def tangent(self, drive: Array, series_m_N: float, scale: Array | float = 1.0) -> Array:
        return self._of_points(1, drive, series_m_N, scale)

    def potential(self, drive: Array, series_m_N: float, scale: Array | float = 1.0) -> Array:
        return self._of_points(2, drive, series_m_N, scale)


@dataclass(frozen=True)
class Damped(Linear):
    """A spring Kn and a dashpot beside it (Kelvin and Voigt): loss that lies in the contact."""

    c_N_s_m: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (math.isfinite(self.c_N_s_m) and self.c_N_s_m >= 0.0):
            raise ValueError(f"contact damping must be zero or more, not {self.c_N_s_m}")

    @property
    def damping_N_s_m(self) -> float:
        return self.c_N_s_m


def mindlin_ratio(poisson: float) -> float:
    """Tangential over normal stiffness of an elastic contact that sticks: 2(1-ν)/(2-ν).

    Mindlin, J. Appl. Mech. 16 (1949); the same for every contour that is nearly round.
    """
    return 2.0 * (1.0 - poisson) / (2.0 - poisson)


@dataclass(frozen=True)
class Coulomb:
    """Coulomb friction behind an elastic tangential spring: true stick, no creep.

    Friction is at most ``mu`` times the normal force. The spring's stiffness is ``kt_over_kn``
    times Kn, by default Mindlin's ratio for the paper's steel; a rigid plane has a rigid spring.
    """

    mu: float = 0.0
    kt_over_kn: float = mindlin_ratio(paper.POISSON)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.mu) and self.mu >= 0.0):
            raise ValueError(f"the coefficient of friction must be zero or more, not {self.mu}")
        if not self.kt_over_kn > 0.0:
            raise ValueError(f"Kt / Kn must be positive, not {self.kt_over_kn}")
