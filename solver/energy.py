"""Energy budget of a run: energy at an instant, and losses."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from .time.march import ContactMarch, Moving

# A budget with a larger closure, in units of the impact's energy, means that the motion went
# astray, which misses by several times this. 600 drops that lean by up to 12 degrees close to 0.02.
ASTRAY = 0.1
# An impact that leaves more than so many times a drop's energy went astray too.
MOST_LEFT = 2.0


@dataclass
class Energy:
    """Energy at one instant in J; ``potential_J`` is zero where the tip first touches."""

    kinetic_J: float
    strain_J: float
    potential_J: float
    contact_J: float = 0.0

    @property
    def total_J(self) -> float:
        return self.kinetic_J + self.strain_J + self.potential_J + self.contact_J


@dataclass
class Budget:
    """The energy budget: initial and present energy, losses, and what is unaccounted for.

    ``closure_relative`` is |``numerical_J``| over the energy of the impact, m g y0. ``flight_J`` is
    the part of ``numerical_J`` from changes to and from the modes of flight, which omit some of a
    solid's energy.
    """

    initial_J: float
    kinetic_J: float
    strain_J: float
    potential_J: float
    contact_J: float
    material_loss_J: float
    contact_loss_J: float
    friction_loss_J: float
    drag_loss_J: float
    numerical_J: float
    closure_relative: float
    flight_J: float = 0.0

    @classmethod
    def close(
        cls,
        initial_J: float,
        now: Energy,
        material_loss_J: float,
        friction_loss_J: float = 0.0,
        contact_loss_J: float = 0.0,
        drag_loss_J: float = 0.0,
    ) -> Budget:
        """Close the budget: energy neither present nor dissipated by physics is numerical."""
        lost = material_loss_J + friction_loss_J + contact_loss_J + drag_loss_J
        numerical = initial_J - now.total_J - lost
        return cls(
            initial_J=initial_J,
            **asdict(now),
            material_loss_J=material_loss_J,
            contact_loss_J=contact_loss_J,
            friction_loss_J=friction_loss_J,
            drag_loss_J=drag_loss_J,
            numerical_J=numerical,
            closure_relative=abs(numerical) / initial_J,
        )


def contact_energy_J(marcher: ContactMarch, state: Moving) -> float:
    """Energy stored in contact in the march's latest state: by the law, friction's springs, and
    Nitsche's boundary terms."""
    weights, contact = marcher.body.contact.weights, marcher.contact
    held = contact.spring_energy_J()
    if not marcher.rigid_multiplier:
        law, scale = marcher.method.law, marcher.ground.scale
        pressed = law.potential(state.approach[:, 0], marcher.tau, scale, contact.memory[:, 2])
        held += float(weights @ pressed)
    boundary = 0.5 * marcher.method.theta * marcher.tau
    if boundary:
        held -= boundary * float(weights @ np.sum(marcher.tractions(state) ** 2, axis=1))
    return held


def marching_energy(marcher: ContactMarch, state: Moving) -> Energy:
    """Energy of the march's latest state; ``potential_J`` is zero where the tip first touches."""
    body = marcher.body
    return Energy(
        kinetic_J=0.5 * body.dot(state.v, state.mv),
        strain_J=marcher.strain_energy_J(state),
        potential_J=marcher.gravity_m_s2 * body.mass_kg * marcher.heights(state)[1],
        contact_J=contact_energy_J(marcher, state),
    )
