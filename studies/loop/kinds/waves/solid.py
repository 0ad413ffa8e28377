"""Phase of an axial wave along the 3-D bar, its free ends included, from its natural frequencies.

Mode n is where one length of the bar turns the phase by nπ. The modes come from the project's
solid, loaded on its end by a uniform pressure, in the Krylov vectors of that load
(solver.bodies.reduced): bending and torsion are never excited.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
from mpi4py import MPI

from .....meshes import geometry
from .....meshes.distribute import to_dolfinx
from .....solver.arrays import Array
from .....solver.bodies.base import dense_of
from .....solver.bodies.reduced import reduce_solid
from .....solver.bodies.solid import SolidBody
from .....solver.bristle import Bristle
from .....solver.errors import ComputationError
from .rod import Complex

LEVELS, ACROSS, VECTORS = 160, 2, 80
SHIFT = 14.0
"""Where the Krylov vectors are best: at this mode's frequency."""
DEGREE = 4
MODES = 28
BEYOND = 1.1


class SolidPhases:
    """The phase of one pass for the phase ωL / c that the plain rod gives, both real or complex.

    c is √(E/ρ). By similarity it holds for every speed, and for complex moduli with one loss for
    all deformations. ``modes`` (n,) are the solid's ω L / (π c), ideally 1, 2, 3 …
    """

    def __init__(self, modes: Array) -> None:
        self.modes = modes
        number = np.arange(1, len(modes) + 1)
        x2 = (np.pi * modes) ** 2
        powers = x2[:, None] ** np.arange(1, DEGREE + 1)
        size = powers[-1]
        excess = number / modes - 1.0
        # relative weights: slow modes have a tiny excess, and it counts as much
        coefficients = np.linalg.lstsq(powers / size / x2[:, None], excess / x2, rcond=None)[0]
        self.coefficients = coefficients / size

    def __call__(self, plain: Complex) -> Complex:
        x2 = plain**2
        beyond = np.abs(x2) > (np.pi * self.modes[-1]) ** 2
        # no polynomial is to be trusted further out: there the excess grows as it does at the last
        x2 = np.where(
            beyond, x2 / np.maximum(np.abs(x2), 1e-300) * (np.pi * self.modes[-1]) ** 2, x2
        )
        excess = sum(a * x2 ** (i + 1) for i, a in enumerate(self.coefficients))
        return np.asarray(plain * (1.0 + excess))


def solid_wave_numbers(bar: Bristle, band_Hz: float) -> Callable[[Complex], Complex]:
    """The solid's wave number (...) for that of a plain rod (...), in 1/m, up to ``band_Hz``.

    Of a bar so long that its first `MODES` do not reach that far, a piece is taken: waves disperse
    along it as along the whole, and its ends count as little as the bar's.
    """
    piece = min(bar.length_m, MODES * bar.material.bar_speed_m_s / (2.0 * BEYOND * band_Hz))
    phases = solid_phases(replace(bar, length_m=piece))

    def wave_numbers(plain: Complex) -> Complex:
        return np.asarray(phases(plain * piece) / piece)

    return wave_numbers


@lru_cache(maxsize=4)
def solid_phases(bar: Bristle) -> SolidPhases:
    """From the first `MODES` axial modes of a solid of the bar's section, length and material.

    Raises ComputationError where fewer are found in the reduced solid.
    """
    spec = geometry.MeshSpec(bar.length_m, bar.section, (ACROSS, ACROSS, LEVELS), 1)
    domain, _, facets = to_dolfinx(spec, MPI.COMM_SELF)
    solid = SolidBody(domain, facets, int(geometry.Tag.TIP), bar.material, 2)
    try:
        unit = np.pi * bar.material.bar_speed_m_s / bar.length_m
        reduced = reduce_solid(solid, (SHIFT * unit) ** 2, VECTORS)
        ratio = np.sqrt(np.maximum(reduced.modal.omega2, 0.0)) / unit
        tip = dense_of(reduced.modal.contact.coordinates)[2::3].mean(axis=0)
        axial = np.abs(tip) * np.sqrt(solid.mass_kg / 2.0) > 0.7
    finally:
        solid.close()
    found = np.sort(ratio[axial & (ratio > 0.5)])[:MODES]
    if len(found) < MODES or np.any(np.abs(found / np.arange(1, MODES + 1) - 1.0) > 0.05):
        raise ComputationError(f"the solid bar shows no {MODES} axial modes in order: {found}")
    return SolidPhases(found)
