"""Materials of bristles by name: typical elastic constants, density and damping, with sources.

Plastics vary with grade, temperature and moisture by more than the ranges given here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from . import paper

ASHBY = "Ashby, Materials Selection in Mechanical Design, 4th ed. 2011"


class MaterialName(StrEnum):
    """The materials that `MATERIALS` has."""

    STEEL = "steel"
    STAINLESS = "stainless"
    POLYPROPYLENE = "polypropylene"
    NYLON = "nylon"


@dataclass(frozen=True)
class Typical:
    """A material: E in Pa, Poisson's ratio, density in kg/m³, yield strength in Pa, and damping.

    Damping is ``loss_factor``, the loss per radian over the elastic energy, or Rayleigh's
    ``beta_s`` in s if that was measured itself. ``source`` has the ranges.
    """

    youngs_Pa: float
    poisson: float
    density_kg_m3: float
    yield_Pa: float
    source: str
    loss_factor: float = 0.0
    beta_s: float | None = None

    def damping_s(self, length_m: float, youngs_Pa: float, density_kg_m3: float) -> float:
        """Rayleigh's β in s for which a free bar of this length, E and density has the loss factor
        in its first axial mode: η = β ω with ω = π c / L."""
        if self.beta_s is not None:
            return self.beta_s
        speed_m_s = math.sqrt(youngs_Pa / density_kg_m3)
        return self.loss_factor * length_m / (math.pi * speed_m_s)


MATERIALS = {
    MaterialName.STEEL: Typical(
        paper.YOUNGS_PA,
        paper.POISSON,
        paper.DENSITY_KG_M3,
        1e9,
        f"{paper.CITATION}; yield 0.4 to 1.16 GPa of high carbon steel: {ASHBY}",
        beta_s=paper.BETA_S,
    ),
    MaterialName.STAINLESS: Typical(
        200e9,
        0.3,
        7900.0,
        210e6,
        f"1.4301, annealed: EN 10088-1, EN 1993-1-4; loss factor 0.001: {ASHBY}",
        1e-3,
    ),
    MaterialName.POLYPROPYLENE: Typical(
        1.2e9,
        0.42,
        900.0,
        30e6,
        f"E 0.9 to 1.55 GPa, yield 21 to 37 MPa, loss factor 0.026 to 0.045: {ASHBY}",
        0.035,
    ),
    MaterialName.NYLON: Typical(
        2.9e9,
        0.35,
        1130.0,
        60e6,
        f"dry, E 2.6 to 3.2 GPa, yield 50 to 95 MPa, loss factor 0.012 to 0.015: {ASHBY}",
        0.014,
    ),
}
