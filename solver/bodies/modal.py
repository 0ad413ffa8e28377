"""A body in modal coordinates: every system is diagonal, free flight has a closed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from .base import Array, ContactPoints


@dataclass(frozen=True)
class Defect:
    """What the reduced body leaves of the full order's equation of motion, measured by its energy.

    Modes satisfy the equation projected on themselves; left over is
    R_f (w P) - R_k (u + β v), with R_f = Qᵀ - M V Vᵀ Qᵀ and R_k = K V - M V Λ. ``gram`` holds
    [R_f, R_k]ᵀ A⁻¹ [R_f, R_k] for A = s M + K, s = ``shift_1_s2``.
    """

    gram: Array
    shift_1_s2: float

    def energy_norm(self, force: Array, motion: Array, c_mass: float, c_stiffness: float) -> float:
        """Bound on √(rᵀ (c_mass M + c_stiffness K)⁻¹ r), r being what a step leaves over.

        ``force`` (points,) is w P in N, ``motion`` (modes,) is u + β v where equilibrium is taken.
        The effective matrix is no softer than min(c_mass/s, c_stiffness) times A.
        """
        left = np.concatenate([force, -motion])
        squared = max(float(left @ self.gram @ left), 0.0)
        return float(np.sqrt(squared / min(c_mass / self.shift_1_s2, c_stiffness)))


@dataclass(frozen=True)
class ModalBody:
    """Modes (mass-normalised) with squared angular frequencies ``omega2`` (n,); zero is rigid.

    ``contact`` and ``lift`` are expressed in modal coordinates. ``n_dofs`` counts the unknowns of
    the discretisation that the modes came from or, for a reduced body, the modes themselves.
    ``defect`` is what a reduced body leaves out, None where the modes are complete.
    """

    name: str
    omega2: Array
    lift: Array
    contact: ContactPoints
    alpha_1_s: float
    beta_s: float
    defect: Defect | None = None

    @property
    def n_dofs(self) -> int:
        return len(self.omega2)

    @property
    def mass_kg(self) -> float:
        return float(self.lift @ self.lift)

    def mass(self, x: Array) -> Array:
        return x

    def stiffness(self, x: Array) -> Array:
        return self.omega2 * x

    def factor(self, c_mass: float, c_stiffness: float) -> Callable[[Array], Array]:
        inverse = 1.0 / (c_mass + c_stiffness * self.omega2)
        return lambda b: (inverse * b.T).T

    def dot(self, x: Array, y: Array) -> float:
        return float(x @ y)


def modal_form(
    name: str,
    mass: Array,
    stiffness: Array,
    lift: Array,
    contact: ContactPoints,
    alpha_1_s: float,
    beta_s: float,
    n_rigid: int,
) -> ModalBody:
    """All modes of dense M, K (n, n); the ``n_rigid`` lowest are rigid and get frequency zero.

    ``lift`` (n,) and the rows of ``contact`` are given for the physical unknowns. Raises
    ValueError where the ``n_rigid`` lowest frequencies are not small against the next one.
    """
    omega2, modes = eigh(stiffness, mass)
    if n_rigid < len(omega2) and abs(omega2[:n_rigid]).max(initial=0.0) > 1e-4 * omega2[n_rigid]:
        raise ValueError(
            f"{name}: fewer than {n_rigid} rigid motions: ω² = {omega2[: n_rigid + 1]}"
        )
    omega2 = np.concatenate([np.zeros(n_rigid), omega2[n_rigid:]])
    return ModalBody(
        name=name,
        omega2=omega2,
        lift=modes.T @ (mass @ lift),
        contact=ContactPoints(
            normal=np.asarray(contact.normal @ modes),
            pressure=np.asarray(contact.pressure @ modes),
            weights=contact.weights,
            xy_m=contact.xy_m,
            traction_scale_N_m=contact.traction_scale_N_m,
        ),
        alpha_1_s=alpha_1_s,
        beta_s=beta_s,
    )
