"""Which pressure a penetration makes: contact laws, elastic ones with their potentials."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..bodies.base import Array


class ContactLaw(Protocol):
    """An elastic law seen through a compliance in series.

    Per unit of area share, ``force`` is what a total force would be were the whole face like this
    point. ``drive`` (m) is the penetration that the point would have without the compliance
    ``series_m_N``: penetration = drive - series × force. So a law serves penalty (series = 0),
    Nitsche (series = its stabilisation) and the augmented Lagrangian (series = 1/r) alike.
    """

    @property
    def kn_N_m(self) -> float:
        """Stiffness in N/m that the law is called by; infinite on a rigid plane."""
        ...

    def force(self, drive: Array, series_m_N: float) -> Array:
        """Force (n,) in N."""
        ...

    def potential(self, drive: Array, series_m_N: float) -> Array:
        """The antiderivative of ``force`` in ``drive`` (n,) in J, zero out of contact."""
        ...

    def tangent(self, drive: Array, series_m_N: float) -> Array:
        """d force / d drive (n,) in N/m."""
        ...


@dataclass(frozen=True)
class Linear:
    """Force = Kn × penetration (Eq. 3 of the paper); Kn = ∞ is Signorini's rigid contact."""

    kn_N_m: float

    def __post_init__(self) -> None:
        if math.isnan(self.kn_N_m) or self.kn_N_m <= 0.0:
            raise ValueError(f"Kn must be positive, not {self.kn_N_m}")

    def _stiffness(self, series_m_N: float) -> float:
        return 1.0 / (1.0 / self.kn_N_m + series_m_N)

    def force(self, drive: Array, series_m_N: float) -> Array:
        return self._stiffness(series_m_N) * np.maximum(drive, 0.0)

    def potential(self, drive: Array, series_m_N: float) -> Array:
        return 0.5 * self._stiffness(series_m_N) * np.maximum(drive, 0.0) ** 2

    def tangent(self, drive: Array, series_m_N: float) -> Array:
        return np.where(drive > 0.0, self._stiffness(series_m_N), 0.0)
