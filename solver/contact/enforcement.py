"""Enforcement of a contact law over a step: penalty, augmented Lagrangian, Nitsche.

All three act on one vector per contact point, the *approach* (minus the augmented gap)

    d = τ t̂(u, v) - D u.

D u is the point's displacement. t̂ = T u is the section area times the body's own traction there,
viscous part included, and τ is a compliance. The normal component, less the gap, is the penetration
in the law; the tangential components strain the spring of friction. The law acts in series with τ,
and its force per area share acts along Q = D - θ τ T:

- penalty: τ = 0; the law acts on the gap alone.
- Nitsche: τ = 1 / (γ₀ C), C the constant of the inverse inequality Σ w t̂² ≤ C uᵀ K u (of the
  order of E A over the length of the tip's cell). It is the Robin form of Juntunen and Stenberg
  (Math. Comp. 78, 2009): penalty where 1/Kn ≫ τ, and Nitsche's method for Signorini's condition
  where Kn → ∞. θ = 1, 0, -1 are the symmetric, incomplete and skew variants of Chouly, Hild and
  Renard (SIAM J. Numer. Anal. 51, 2013), with friction as in Chouly (J. Math. Anal. Appl. 411,
  2014). θ ≠ 0 adds -θ τ Tᵀ w T to the stiffness.
- augmented Lagrangian: τ = 0 and a multiplier per point, updated until the law holds exactly
  (proximal form of Rockafellar, Math. Oper. Res. 1, 1976); Kn = ∞ is Signorini's condition.

The forces of a step are in contact.step; contact.section and contact.solve find them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..bodies.base import Body, dense_of
from ..errors import ComputationError
from .laws import ContactLaw, Coulomb, check_compiled
from .normal import holds
from .points import CONSERVING, Points, Trial
from .section import NEWTON_LIMIT, Section
from .solve import AUGMENTATION_LIMIT, solve_step
from .step import Taken, let_go, spring_energy, take

# Force patterns to which a body is stiffer than this share of the softest count as rigid.
STIFFEST = 1e-2
SHIFT = 1e-4
GAMMA0, GAMMA0_RIGID = 10.0, 2.0


class Enforcement(StrEnum):
    """Method of enforcing the contact law."""

    PENALTY = "penalty"
    AUGMENTED = "augmented"
    NITSCHE = "nitsche"


def inverse_constant_N_m(body: Body) -> float:
    """The smallest C with Σ w t̂(u)² ≤ C uᵀ K u for every motion u of the body.

    It is the largest eigenvalue of T K⁻¹ Tᵀ weighted by w. Rigid motions make K singular but have
    no traction. So K is shifted by a little M, far below the tip's frequency, which hardly changes
    C.
    """
    points = body.contact
    rows = dense_of(points.traction)
    forces = np.ascontiguousarray(rows[2::3].T @ points.weights)
    local = body.dot(forces, body.stiffness(forces)) / body.dot(forces, body.mass(forces))
    columns = points.tractions(body.factor(SHIFT * local, 1.0)(np.ascontiguousarray(rows.T)))
    root = np.sqrt(np.repeat(points.weights, 3))
    columns = columns.reshape(len(root), len(root))
    return float(np.linalg.eigvalsh(root[:, None] * columns * root).max())


@dataclass(frozen=True)
class ContactMethod:
    """A contact law with friction, its enforcement, and the constants of that method.

    ``theta`` (1, 0 or -1) and ``gamma0`` belong to Nitsche. Only the symmetric form (θ = 1) has a
    potential and conserves energy; the others can gain energy from a rigid plane. At γ₀ = 1 the
    symmetric form stops being positive. Larger values are closer to the law but make a rigid
    contact chatter. None stands for `GAMMA0` at finite Kn and `GAMMA0_RIGID` on a rigid plane.
    ``augmentation`` belongs to the augmented Lagrangian: its parameter in units of the body's own
    resistance over a step. An update of the multiplier then leaves about 1/``augmentation`` of the
    error, whatever the mesh and the ITS.
    """

    law: ContactLaw
    enforcement: Enforcement = Enforcement.PENALTY
    theta: int = 1
    gamma0: float | None = None
    augmentation: float = 10.0
    friction: Coulomb = field(default_factory=Coulomb)

    def __post_init__(self) -> None:
        check_compiled(self.law)
        if self.theta not in (-1, 0, 1):
            raise ValueError(f"theta must be 1, 0 or -1, not {self.theta}")
        if self.gamma0 is not None and not self.gamma0 >= 1.0:
            raise ValueError(f"gamma0 must be at least 1, not {self.gamma0}")
        if self.enforcement is Enforcement.PENALTY and math.isinf(self.law.kn_N_m):
            raise ValueError(
                "penalty needs a finite Kn; take nitsche or augmented for a rigid plane"
            )
        if self.law.conserving_only and self.enforcement is Enforcement.NITSCHE:
            raise ValueError(
                f"{type(self.law).__name__} contact is not formulated for nitsche; take penalty"
            )
        if self.law.pulls and self.enforcement is Enforcement.AUGMENTED:
            raise ValueError(
                f"{type(self.law).__name__} contact lets go with a jump, which the multiplier of "
                "augmented cannot follow; take penalty"
            )

    @property
    def kt_N_m(self) -> float:
        """Tangential stiffness of the whole face."""
        return self.friction.kt_over_kn * self.law.kn_N_m

    @property
    def stabilisation(self) -> float:
        """Nitsche's γ₀, given or default; infinite for the other methods."""
        if self.enforcement is not Enforcement.NITSCHE:
            return math.inf
        return self.gamma0 or (GAMMA0_RIGID if math.isinf(self.law.kn_N_m) else GAMMA0)

    def compliance_m_N(self, body: Body) -> float:
        """Nitsche's compliance τ in m/N; zero for the other methods."""
        gamma0 = self.stabilisation
        return 0.0 if math.isinf(gamma0) else 1.0 / (gamma0 * inverse_constant_N_m(body))


@dataclass
class StepContact:
    """Solver for the contact forces of one step, given the compliance of the contact points.

    The compliance is in ``section``; with Nitsche its coordinates are the points' own approaches.
    ``compliance_m_N`` is Nitsche's τ, ``scale`` (n,) each point's stiffness over the law's.
    ``end_weight`` is the weight of the end of the step, or None for the discrete gradient.
    ``multiplier`` (n, 3) is the augmented Lagrangian's, ``memory`` (n, 3) the state of friction and
    the law, ``last`` (1,) the mean normal force of the step before, in N.
    """

    method: ContactMethod
    compliance_m_N: float
    section: Section
    weights: Array
    scale: Array
    end_weight: float | None
    its_s: float = 1.0

    def __post_init__(self) -> None:
        if self.method.law.conserving_only and self.end_weight is not None:
            raise ValueError(
                f"{type(self.method.law).__name__} contact needs the conserving scheme, the average"
            )
        augmented = self.method.enforcement is Enforcement.AUGMENTED
        self.points = Points(
            kind=self.method.law.kind,
            law=self.method.law.parameters,
            kt=self.method.kt_N_m,
            mu=self.method.friction.mu,
            scale=self.scale,
            compliance=self.compliance_m_N,
            weights=self.weights,
            end_weight=CONSERVING if self.end_weight is None else self.end_weight,
            proximal=self._proximal_m_N() if augmented else 0.0,
            dashpot=self.method.law.damping / self.its_s,
        )
        self.reset()

    def _proximal_m_N(self) -> float:
        """The proximal compliance: at most the body's own, over ``augmentation``."""
        section, n = self.section, len(self.weights)
        rows = np.zeros((n, len(section.compliance)))
        for i in range(n):
            np.add.at(rows[i], section.support[i], section.values[i, 0])
        own = np.abs(np.linalg.eigvals(rows @ section.compliance @ (rows.T * self.weights)))
        return float(max(own.min(), STIFFEST * own.max()) / self.method.augmentation)

    def reset(self) -> None:
        """Clear the state of earlier contact: multipliers, friction's springs, the law's memory."""
        n = len(self.weights)
        self.multiplier: Array = np.zeros((n, 3))
        self.memory: Array = np.zeros((n, 3))
        self.last: Array = np.zeros(1)

    def kept(self) -> dict[str, NDArray[Any]]:
        """The state that the next step needs, as arrays by name."""
        section = self.section
        return {
            "multiplier": self.multiplier,
            "memory": self.memory,
            "last": self.last,
            "inverse": section.inverse,
            "factored": section.factored,
            "predictor": section.predictor,
        }

    def recall(self, arrays: Mapping[str, Array]) -> None:
        """Restore the state that `kept` returned."""
        for name, own in self.kept().items():
            own[...] = arrays[name]

    def _trial(self, start: Array, free: Array, force: Array) -> Trial:
        return Trial(start, free, self.end, force, self.memory, self.multiplier)

    def solve(self, start: Array, free: Array) -> Array:
        """Contact forces per area share (n, 3) in N over the step, along the local frames.

        ``start`` is the approach (n, 3) at the start of the step, ``free`` that at its end without
        contact forces. The approach at the end with them is left in ``end``. Raises
        ComputationError if Newton's method or the updates of the multiplier do not converge.
        """
        force = np.zeros_like(free)
        clear = max(start[:, 0].max(), free[:, 0].max()) <= 0.0 and not self.multiplier.any()
        if clear and not self.holds():
            self.end = free
            return force
        self.end = np.empty_like(free)
        count = solve_step(self.points, self.section, self._trial(start, free, force))
        if count == -2:
            raise ComputationError(
                f"the augmented Lagrangian did not converge in {AUGMENTATION_LIMIT} updates; "
                "raise its augmentation parameter or shorten the ITS"
            )
        if count < 0:
            raise ComputationError(
                f"the contact forces did not converge in {NEWTON_LIMIT} Newton steps; "
                "shorten the ITS"
            )
        return force

    def commit(self, start: Array, force: Array) -> Taken:
        """Update friction's springs and the law's memory after a solved step."""
        taken = take(self.points, self._trial(start, self.end, force), self.last[0])
        self.last[0] = taken.mean_N
        return taken

    def holds(self) -> bool:
        """Whether adhesion holds any point."""
        return bool(holds(self.points, self.memory))

    def spring_energy_J(self) -> float:
        """Energy stored in friction's springs."""
        return float(spring_energy(self.points, self.memory))

    def let_go(self) -> float:
        """Release friction's springs; returns the energy that they stored, in J."""
        return float(let_go(self.points, self.memory))
