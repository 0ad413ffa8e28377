"""Where the energy is and where it went: the budget of a run."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from .bodies.modal import ModalBody
from .time.march import Marcher, State


@dataclass
class Energy:
    """Energy at one instant in J; ``potential_J`` is zero with the unstrained tip on the plane."""

    kinetic_J: float
    strain_J: float
    potential_J: float
    contact_J: float = 0.0

    @property
    def total_J(self) -> float:
        return self.kinetic_J + self.strain_J + self.potential_J + self.contact_J


@dataclass
class Budget:
    """The energy budget: what there was, is, was lost to what, and what is unaccounted for.

    ``closure_relative`` is |``numerical_J``| over the energy of the impact, m g y0.
    """

    initial_J: float
    kinetic_J: float
    strain_J: float
    potential_J: float
    contact_J: float
    material_loss_J: float
    contact_loss_J: float
    friction_loss_J: float
    numerical_J: float
    closure_relative: float

    @classmethod
    def close(cls, initial_J: float, now: Energy, material_loss_J: float) -> Budget:
        """Close the budget: what neither remains nor was dissipated by physics is numerical."""
        numerical = initial_J - now.total_J - material_loss_J
        return cls(
            initial_J=initial_J,
            **asdict(now),
            material_loss_J=material_loss_J,
            contact_loss_J=0.0,
            friction_loss_J=0.0,
            numerical_J=numerical,
            closure_relative=abs(numerical) / initial_J,
        )


def marching_energy(marcher: Marcher, state: State) -> Energy:
    """Energy of a state on the march; Nitsche's boundary terms count as contact."""
    body, method = marcher.body, marcher.method
    points = body.contact
    potential = (
        method.law.potential(state.drive, marcher.tau) if not marcher.rigid_multiplier else 0.0
    )
    contact = float(np.sum(points.weights * potential))
    strain = 0.5 * body.dot(state.u, state.ku)
    if method.theta and marcher.tau:
        boundary = 0.5 * method.theta * marcher.tau
        boundary *= float(points.weights @ points.pressures(state.u) ** 2)
        strain, contact = strain + boundary, contact - boundary
    return Energy(
        kinetic_J=0.5 * body.dot(state.v, state.mv),
        strain_J=strain,
        potential_J=marcher.gravity_m_s2 * body.dot(body.lift, state.mu),
        contact_J=contact,
    )


def step_loss(marcher: Marcher, before: State, after: State) -> float:
    """Energy in J that Rayleigh damping took in a step, by the midpoint rule of the scheme."""
    body = marcher.body
    v = 0.5 * (before.v + after.v)
    loss = body.beta_s * body.dot(v, 0.5 * (before.kv + after.kv))
    if body.alpha_1_s:
        loss += body.alpha_1_s * body.dot(v, 0.5 * (before.mv + after.mv))
    return marcher.its_s * loss


def flight_energy(body: ModalBody, u: np.ndarray, v: np.ndarray, gravity_m_s2: float) -> Energy:
    """Energy of a modal state (u, v) in flight."""
    return Energy(
        kinetic_J=0.5 * float(v @ v),
        strain_J=0.5 * float(u @ (body.omega2 * u)),
        potential_J=gravity_m_s2 * float(body.lift @ u),
    )
