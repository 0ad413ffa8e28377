"""Drops of a rigid mass for tables: which effects it can carry, over which sides, at which step.

A mass on a contact law has few scales, and tables over shares of them are smooth and serve every
mass, stiffness and height alike but for its weight: a dashpot by its damping ratio, Hunt and
Crossley's by λ v, forces that yield or hold by the greatest force v √(Kn m) of the undamped drop.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gamma

from ....solver.arrays import Array
from ....solver.bodies.rigid_mass import rigid_body
from ....solver.bristle import RigidMass
from ....solver.contact.laws import Adhesive, ContactLaw, Damped, HuntCrossley, Plastic
from ....solver.effects.base import Parameter, Scene
from ....solver.effects.library import EFFECTS
from .table_drops import drops_of

STEPS = 200
"""Of a contact of half a period: y1/y0, time and peak are then off by less than 1e-3."""


@dataclass(frozen=True)
class Side:
    """A contact law's own axis of a table: shares from ``low`` to ``high`` of the scale that
    ``scale`` gives for mass, stiffness and speed of impact, and the ``law`` of a stiffness and a
    value."""

    low: float
    high: float
    scale: Callable[[float, Array | float, Array | float], Array]
    law: Callable[[float, float], ContactLaw]


def _critical(mass_kg: float, kn_N_m: Array | float, speed_m_s: Array | float) -> Array:
    return np.asarray(2.0 * np.sqrt(kn_N_m * mass_kg) + 0.0 * np.asarray(speed_m_s))


def _slowness(mass_kg: float, kn_N_m: Array | float, speed_m_s: Array | float) -> Array:
    return np.asarray(1.0 / speed_m_s + 0.0 * np.asarray(kn_N_m))


def _peak(mass_kg: float, kn_N_m: Array | float, speed_m_s: Array | float) -> Array:
    return np.asarray(speed_m_s * np.sqrt(kn_N_m * mass_kg))


SIDES: dict[str, Side] = {
    "contact_damping": Side(0.0, 1.5, _critical, Damped),
    "hunt_crossley": Side(0.0, 10.0, _slowness, HuntCrossley),
    "plastic_contact": Side(0.02, 1.0, _peak, Plastic),
    # of the whole greatest force, nothing would come back
    "adhesion": Side(0.0, 0.95, _peak, Adhesive),
}


def carried(mass: RigidMass) -> tuple[str, ...]:
    """Names of the effects that drops of a rigid mass can carry.

    None of an elastic body, none of its lean and none across the surface; drag where its diameter
    is known.
    """
    computed = [each.name for each in EFFECTS.values() if each.computed and not each.origin]
    without = set() if mass.front_m2 is not None else {"air_drag"}
    return tuple(name for name in (*computed, *SIDES, "stiffening_contact") if name not in without)


def bounded(
    name: str,
    parameter: Parameter,
    mass: RigidMass,
    kn_range_N_m: tuple[float, float],
    speeds_m_s: tuple[float, float],
) -> Parameter:
    """An effect's parameter with the bounds that a mass gives it; others stay as they are.

    They hold all that `SIDES` covers, from softest and slowest to stiffest and fastest.
    """
    if name not in SIDES:
        return parameter
    side = SIDES[name]
    scales = [
        float(side.scale(mass.mass_kg, kn, speed)) for kn in kn_range_N_m for speed in speeds_m_s
    ]
    low, high = side.low * min(scales), side.high * max(scales)
    middle = math.sqrt(min(scales) * max(scales))
    null = high if name == "plastic_contact" else 0.0
    return replace(
        parameter, low=low, high=high, typical=0.2 * middle, null=null, why="share of its scale"
    )


def reference(
    height_m: Array | float, kn_N_m: Array | float, mass_kg: float, gravity_m_s2: float
) -> Array:
    """What tables measure by, (quantities, ...): the undamped drop of a mass (Eqs. 3 and 8)."""
    speed = np.sqrt(2.0 * gravity_m_s2 * np.asarray(height_m))
    time = math.pi * np.sqrt(mass_kg / np.asarray(kn_N_m))
    return np.stack(np.broadcast_arrays(height_m, time, _peak(mass_kg, kn_N_m, speed)))


def stiffened(
    height_m: Array | float,
    kn_N_m: Array | float,
    exponent: Array | float,
    reference_m: float,
    mass_kg: float,
    gravity_m_s2: float,
) -> Array:
    """What a power law of contact gives, (quantities, ...), in closed form, weight neglected.

    Force Kn δref (δ/δref)^p stops ½ m v² at δmax and gives all of it back after
    2 δmax / v · √π Γ(1 + 1/(p + 1)) / Γ(½ + 1/(p + 1)); with p = 3/2 Hertz's impact (K. L. Johnson,
    Contact Mechanics, 1985, §11.4: 2.94 δmax / v).
    """
    power = np.asarray(exponent) + 1.0
    speed = np.sqrt(2.0 * gravity_m_s2 * np.asarray(height_m))
    share = (0.5 * power * mass_kg * speed**2 / (kn_N_m * reference_m**2)) ** (1.0 / power)
    shape = math.sqrt(math.pi) * gamma(1.0 + 1.0 / power) / gamma(0.5 + 1.0 / power)
    time = 2.0 * share * reference_m / speed * shape
    peak = kn_N_m * reference_m * share ** (power - 1.0)
    return np.stack(np.broadcast_arrays(height_m, time, peak))


def step_s(mass: RigidMass, kn_N_m: float) -> float:
    """The ITS that resolves a contact of this stiffness, to one digit so that few differ."""
    return float(f"{math.pi * math.sqrt(mass.mass_kg / kn_N_m) / STEPS:.0e}")


def observed(mass: RigidMass, scenes: Sequence[Scene], gravity_m_s2: float, its: float) -> Array:
    """What is measured of drops of these scenes, (scenes, quantities of `table.QUANTITIES`).

    NaN for one that stays on the surface. Lean, slope and the body's own losses are not looked at.
    """
    level = [
        replace(
            scene,
            beta_s=0.0,
            loss_factor=0.0,
            tilt_deg=0.0,
            tilt_wide_deg=0.0,
            slope_deg=0.0,
            slope_wide_deg=0.0,
        )
        for scene in scenes
    ]
    return drops_of(rigid_body(mass), level, gravity_m_s2, its, 0.0, lenient=True)
