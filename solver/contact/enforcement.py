"""How a contact law is enforced over a step: penalty, augmented Lagrangian, Nitsche.

All three meet the body through one scalar per contact point, the *drive*

    s = τ p̂(u, v) - g(u),

with the gap g, the section area times the body's own normal pressure p̂ = -A σ_zz (viscous part
included) and a compliance τ. The force per area share follows from the law through τ in series,
and acts along Q = N - θ τ S (N the rows of upward displacement, S those of p̂):

- penalty: τ = 0; the law acts on the gap alone.
- Nitsche: τ = 1 / (γ₀ C), C the constant of the inverse inequality Σ w p̂² ≤ C uᵀ K u (of the
  order of E A over the length of the tip's cell), the Robin form of Juntunen and Stenberg (Math.
  Comp. 78, 2009), which turns into penalty where 1/Kn ≫ τ and into Nitsche's method for Signorini's
  condition where Kn → ∞; θ = 1, 0, -1 are the symmetric, incomplete and skew variants of Chouly,
  Hild and Renard (SIAM J. Numer. Anal. 51, 2013). θ ≠ 0 adds -θ τ Sᵀ w S to the stiffness.
- augmented Lagrangian: τ = 0 and a multiplier per point, updated until the law holds exactly
  (proximal form of Rockafellar, Math. Oper. Res. 1, 1976); Kn = ∞ is Signorini's condition.

Over a step the force is the discrete gradient of the contact potential (Gonzalez, J. Nonlinear
Sci. 6, 1996), so that an elastic law does no net work; schemes that dissipate take the
interpolated force instead.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from ..bodies.base import Array, Body
from ..errors import ComputationError
from .laws import ContactLaw

NEWTON_LIMIT = 60
AUGMENTATION_LIMIT = 200
RELATIVE_TOLERANCE = 1e-11
MULTIPLIER_TOLERANCE = 1e-9
# Patterns of force that a body answers less than this share of the softest count as rigid.
STIFFEST = 1e-2
SHIFT = 1e-4
GAMMA0, GAMMA0_RIGID = 10.0, 2.0


class Enforcement(StrEnum):
    PENALTY = "penalty"
    AUGMENTED = "augmented"
    NITSCHE = "nitsche"


def default_gamma0(kn_N_m: float) -> float:
    """Nitsche's γ₀ where none is given."""
    return GAMMA0_RIGID if math.isinf(kn_N_m) else GAMMA0


def inverse_constant_N_m(body: Body) -> float:
    """The smallest C with Σ w p̂(u)² ≤ C uᵀ K u for every motion u of the body.

    It is the largest eigenvalue of S K⁻¹ Sᵀ weighted by w. Rigid motions have no pressure, so a
    shift of K by a little of M, far below the tip's own frequency, makes K invertible and changes
    C by about as little.
    """
    points = body.contact
    rows = np.asarray(points.pressure.T @ points.weights)
    local = body.dot(rows, body.stiffness(rows)) / body.dot(rows, body.mass(rows))
    rows = points.pressure.toarray() if hasattr(points.pressure, "toarray") else points.pressure
    answers = points.pressures(body.factor(SHIFT * local, 1.0)(np.ascontiguousarray(rows.T)))
    root = np.sqrt(points.weights)
    return float(np.linalg.eigvalsh(root[:, None] * answers * root).max())


@dataclass(frozen=True)
class ContactMethod:
    """A law, the way it is enforced, and that way's constants.

    ``theta`` (1, 0 or -1) and ``gamma0`` belong to Nitsche. The symmetric form (θ = 1) alone has a
    potential, so it alone conserves energy; the others can gain it from a rigid plane. At γ₀ = 1
    it stops being positive; larger values are closer to the law, and make a rigid contact chatter,
    so None stands for `GAMMA0` where Kn is finite and for `GAMMA0_RIGID` where it is not.
    ``augmentation`` belongs to the augmented Lagrangian: its parameter in units of what the body
    itself resists with over a step, so that an update of the multiplier leaves about one part in
    ``augmentation`` of the error, whatever the mesh and the ITS.
    """

    law: ContactLaw
    enforcement: Enforcement = Enforcement.PENALTY
    theta: int = 1
    gamma0: float | None = None
    augmentation: float = 10.0

    def __post_init__(self) -> None:
        if self.theta not in (-1, 0, 1):
            raise ValueError(f"theta must be 1, 0 or -1, not {self.theta}")
        if self.gamma0 is not None and not self.gamma0 >= 1.0:
            raise ValueError(f"gamma0 must be at least 1, not {self.gamma0}")
        if self.enforcement is Enforcement.PENALTY and math.isinf(self.law.kn_N_m):
            raise ValueError(
                "penalty needs a finite Kn; take nitsche or augmented for a rigid plane"
            )

    def compliance_m_N(self, body: Body) -> float:
        """τ (m/N)."""
        if self.enforcement is not Enforcement.NITSCHE:
            return 0.0
        gamma0 = self.gamma0 or default_gamma0(self.law.kn_N_m)
        return 1.0 / (gamma0 * inverse_constant_N_m(body))


@dataclass
class StepContact:
    """Solves for the contact forces of one step, given how the drive answers to them.

    ``response`` (n, n): d drive(end of step) / d force. ``end_weight`` is the share of the end of
    the step in an interpolated force, or None for the discrete gradient.
    """

    method: ContactMethod
    series_m_N: float
    response: Array
    end_weight: float | None
    multiplier: Array
    iterations: int = 0
    largest_N: float = 0.0

    def solve(self, drive_start: Array, drive_free: Array) -> Array:
        """Forces per area share (n,) in N that act over the step.

        ``drive_free`` is the drive at the end of the step without contact forces over it.
        Raises ComputationError where Newton's or the multiplier iteration does not converge.
        """
        if max(drive_start.max(), drive_free.max()) <= 0.0 and not self.multiplier.any():
            return np.zeros_like(drive_free)
        if self.method.enforcement is Enforcement.AUGMENTED:
            return self._augment(drive_start, drive_free)
        return self._newton(
            drive_start, drive_free, self.response, self.series_m_N, self.end_weight
        )

    def _augment(self, drive_start: Array, drive_free: Array) -> Array:
        answers = np.abs(np.linalg.eigvals(self.response))
        soft = max(answers.min(), STIFFEST * answers.max()) / self.method.augmentation
        rigid = math.isinf(self.method.law.kn_N_m)
        multiplier = self.multiplier
        for _ in range(AUGMENTATION_LIMIT):
            shifted = drive_free + soft * multiplier
            if rigid:  # the end of the step obeys Signorini's condition: no potential to average
                force = self._newton(drive_start, shifted, self.response, soft, 1.0, start=0.0)
            else:
                response = self.response - soft * np.eye(len(multiplier))
                force = self._newton(drive_start, shifted, response, 0.0, self.end_weight)
            change = np.abs(force - multiplier).max()
            multiplier = force
            self.largest_N = max(self.largest_N, float(np.abs(force).max()))
            if change <= MULTIPLIER_TOLERANCE * self.largest_N:
                self.multiplier = multiplier
                return force
        raise ComputationError(
            f"the augmented Lagrangian did not converge in {AUGMENTATION_LIMIT} updates "
            f"(last change {change:.3g} N); raise its augmentation parameter or shorten the ITS"
        )

    def _newton(
        self,
        drive_start: Array,
        drive_free: Array,
        response: Array,
        series_m_N: float,
        end_weight: float | None,
        start: float = 1.0,
    ) -> Array:
        law = self.method.law
        force = np.array(self.multiplier)
        start_force = start * law.force(drive_start, series_m_N)
        start_energy = law.potential(drive_start, series_m_N)
        identity = np.eye(len(force))
        size = np.abs(law.force(drive_free, series_m_N)).max() + np.abs(start_force).max()
        for iteration in range(NEWTON_LIMIT):
            drive = drive_free + response @ force
            target = law.force(drive, series_m_N)
            slope = law.tangent(drive, series_m_N)
            if end_weight is None:
                target, slope = self._discrete_gradient(
                    drive_start, drive, start_energy, target, slope, series_m_N
                )
            else:
                target = end_weight * target + (1.0 - end_weight) * start_force
                slope = end_weight * slope
            residual = force - target
            if np.abs(residual).max() <= RELATIVE_TOLERANCE * size:
                self.iterations += iteration
                return np.asarray(target)
            step = np.linalg.solve(identity - slope[:, None] * response, residual)
            force = force - (step if iteration < NEWTON_LIMIT // 2 else 0.5 * step)
        raise ComputationError(
            f"the contact forces did not converge in {NEWTON_LIMIT} Newton steps "
            f"(residual {np.abs(residual).max():.3g} N of {size:.3g} N); shorten the ITS"
        )

    def _discrete_gradient(
        self,
        start: Array,
        end: Array,
        start_energy: Array,
        end_force: Array,
        end_slope: Array,
        series_m_N: float,
    ) -> tuple[Array, Array]:
        """Mean force over the step and its derivative by the drive at the end."""
        law = self.method.law
        change = end - start
        near = np.abs(change) <= 1e-5 * np.maximum(np.abs(start), np.abs(end))
        safe = np.where(near, 1.0, change)
        mean = (law.potential(end, series_m_N) - start_energy) / safe
        slope = (end_force - mean) / safe
        if near.any():
            middle = 0.5 * (start + end)
            mean = np.where(near, law.force(middle, series_m_N), mean)
            slope = np.where(near, 0.5 * law.tangent(middle, series_m_N), slope)
        return mean, slope
