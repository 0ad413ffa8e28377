"""State and forces of all rods at one output time, and means over the time before it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from ..arrays import Array
from .tally import Means


class TipState(IntEnum):
    """State of a bristle's contact; `SLIP` if most of its normal force is on sliding points."""

    FREE = 0
    STICK = 1
    SLIP = 2


@dataclass(frozen=True)
class RodEnergy:
    """Energy balance of all rods in J: stored energy, work done, and losses since the start.

    ``initial_J`` is the kinetic, strain and contact energy at the start; ``potential_J`` counts
    from there. ``contact_J`` includes the tangential springs. ``numerical_J`` is the part of the
    work that is neither stored nor dissipated by physics.
    """

    initial_J: float
    hub_work_J: float
    kinetic_J: float
    strain_J: float
    potential_J: float
    contact_J: float
    material_loss_J: float
    friction_loss_J: float

    @property
    def numerical_J(self) -> float:
        held = self.kinetic_J + self.strain_J + self.potential_J + self.contact_J
        lost = self.material_loss_J + self.friction_loss_J
        return self.initial_J + self.hub_work_J - held - lost

    @property
    def closure_relative(self) -> float:
        """|``numerical_J``| over the largest of the hub's work, the stored and the lost energy."""
        held = self.kinetic_J + self.strain_J + abs(self.potential_J) + self.contact_J
        lost = self.material_loss_J + self.friction_loss_J
        most = max(self.initial_J, abs(self.hub_work_J), held, lost)
        return abs(self.numerical_J) / most if most > 0.0 else 0.0


@dataclass(frozen=True)
class Frame:
    """All bristles at one instant, in world axes; the same on every rank.

    Parameters
    ----------
    t_s : the time
    force_N, torque_Nm : (3,), of the bristles on the hub; the torque is about the hub's origin
    tip_m : (n, 3), the middle of each end section
    tip_normal_N, tip_friction_N : (n,), of the surface on each bristle, over its length
    between_N : (n,), sum of the normal forces of other bristles on each
    state : (n,) int8, see `TipState`
    centre_m : (n, nodes, 3), the rods' centre lines, from the clamp to the tip
    rotation : (n, nodes, 4), unit quaternions of the sections' axes
    bending_stress_Pa : (n, nodes), the greatest over each section
    greatest_stress_Pa : (n,), the greatest bending stress in each bristle, over all time steps
        since the last frame
    energy : the sum over all bristles
    steps : time steps of all bristles so far
    means : over the time since the last frame
    """

    t_s: float
    force_N: Array
    torque_Nm: Array
    tip_m: Array
    tip_normal_N: Array
    tip_friction_N: Array
    between_N: Array
    state: Array
    centre_m: Array
    rotation: Array
    bending_stress_Pa: Array
    greatest_stress_Pa: Array
    energy: RodEnergy
    steps: int
    means: Means
