"""What is shown of rods at one instant, and over the time before it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from ..arrays import Array
from .tally import Means


class TipState(IntEnum):
    """How a bristle meets the surface; `SLIP` where most of its normal force slides."""

    FREE = 0
    STICK = 1
    SLIP = 2


@dataclass(frozen=True)
class RodEnergy:
    """Energy of all rods in J: what they hold, what went in, and what was lost since the start.

    ``initial_J`` is what they held at the start, kinetic, strain and contact energy together;
    ``potential_J`` counts from there. ``contact_J`` includes the tangential springs. What went in
    and neither remains nor was dissipated by physics is ``numerical_J``.
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
        """|``numerical_J``| over the most of: work of the hub, energy held, energy lost."""
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
    force_N, torque_Nm : (3,), what the bristles do to the hub, the torque about the hub's origin
    tip_m : (n, 3), the middle of each end section
    tip_normal_N, tip_friction_N : (n,), what the surface does to each bristle, over its length
    between_N : (n,), sum of the normal forces of other bristles on each
    state : (n,) int8, see `TipState`
    centre_m : (n, nodes, 3), the rods' centre lines, from the clamp to the tip
    rotation : (n, nodes, 4), unit quaternions of the sections' axes
    bending_stress_Pa : (n, nodes), the greatest over each section
    greatest_stress_Pa : (n,), the greatest bending stress in each bristle, over all time steps
        since the frame before
    energy : the sum over all bristles
    steps : time steps of all bristles so far
    means : over the time since the frame before
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
