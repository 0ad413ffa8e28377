"""A body in modal coordinates: every system is diagonal, free flight has a closed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh, orth
from scipy.sparse.csgraph import connected_components

from .base import Array, ContactPoints


@dataclass(frozen=True)
class Defect:
    """What the reduced body leaves of the full order's equation of motion, measured by its energy.

    Modes satisfy the equation projected on themselves; left over is R_f f - R_k (u + β v), with
    R_f = Fᵀ - M V Vᵀ Fᵀ, F the rows of height and of pressure, and R_k = K V - M V Λ. ``gram``
    holds [R_f, R_k]ᵀ A⁻¹ [R_f, R_k] for A = s M + K, s = ``shift_1_s2``.
    """

    gram: Array
    shift_1_s2: float

    def energy_norm(self, force: Array, motion: Array, c_mass: float, c_stiffness: float) -> float:
        """Bound on √(rᵀ (c_mass M + c_stiffness K)⁻¹ r), r being what a step leaves over.

        ``force`` (2 points,) is f: what acts along the rows of height in N, and along those of
        pressure in m; ``motion`` (modes,) is u + β v where equilibrium is taken.
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
    rigid: Array,
    lift: Array,
    contact: ContactPoints,
    alpha_1_s: float,
    beta_s: float,
) -> ModalBody:
    """All modes of dense M, K (n, n), the motions ``rigid`` (n, r) having frequency zero.

    Unknowns that do not act on each other (axial motion, torsion, the two bendings) are solved
    apart, so that the rounding of fast ones does not reach slow ones. ``lift`` (n,) and the rows
    of ``contact`` are given for the physical unknowns. Raises ValueError where ``rigid`` strains
    the body, or rounding hides the lowest elastic mode.
    """
    n_groups, group = connected_components((mass != 0.0) | (stiffness != 0.0), directed=False)
    omega2: Array = np.zeros(len(lift))
    modes: Array = np.zeros_like(mass)
    first = 0
    for number in range(n_groups):
        own = np.flatnonzero(group == number)
        last = first + len(own)
        block = np.ix_(own, own)
        omega2[first:last], modes[own, first:last] = _modes_of_group(
            name, mass[block], stiffness[block], rigid[own]
        )
        first = last
    order = np.argsort(omega2, kind="stable")
    omega2, modes = omega2[order], modes[:, order]
    return ModalBody(
        name=name,
        omega2=omega2,
        lift=modes.T @ (mass @ lift),
        contact=ContactPoints(
            normal=np.asarray(contact.normal @ modes),
            pressure=np.asarray(contact.pressure @ modes),
            weights=contact.weights,
            xy_m=contact.xy_m,
        ),
        alpha_1_s=alpha_1_s,
        beta_s=beta_s,
    )


def _modes_of_group(name: str, mass: Array, stiffness: Array, rigid: Array) -> tuple[Array, Array]:
    """Squared frequencies (n,) and modes (n, n), rigid motions first and exact.

    The eigenvalues of (K, M) are good to rounding of the greatest: slow modes drown. Those of
    (M, K) are their inverses, good for the slow ones. Each serves for its half of the decades.
    """
    still = orth(rigid)
    if np.abs(stiffness @ still).max(initial=0.0) > 1e-9 * np.abs(stiffness).max():
        raise ValueError(f"{name}: a rigid motion strains the body")
    still = still @ np.linalg.inv(np.linalg.cholesky(still.T @ mass @ still)).T
    held = mass @ still
    omega2, modes = eigh(stiffness, mass)
    inverse, slow = eigh(mass, stiffness + omega2[-1] * held @ held.T)
    middle = np.sqrt(inverse[-1] / omega2[-1])
    n_slow, n_rigid = int(np.sum(inverse > middle)), still.shape[1]
    if np.finfo(float).eps * len(omega2) * omega2[-1] * middle > 0.01:
        raise ValueError(f"{name}: rounding hides the slowest modes")
    slow = slow[:, : -n_slow - 1 : -1] / np.sqrt(inverse[: -n_slow - 1 : -1])
    slow = slow - still @ (held.T @ slow)
    known = np.hstack([still, slow])
    fast = modes[:, n_rigid + n_slow :]
    fast = fast - known @ (known.T @ mass @ fast)
    omega2[:n_rigid] = 0.0
    omega2[n_rigid : n_rigid + n_slow] = 1.0 / inverse[: -n_slow - 1 : -1]
    return omega2, np.hstack([known, fast])
