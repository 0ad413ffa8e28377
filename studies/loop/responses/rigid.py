"""Tables of drops of a rigid mass, upright onto level ground, in the place of a bristle's.

A mass on a contact law has few scales, and tables over shares of them are smooth and serve every
mass, stiffness and height alike but for its weight: a dashpot by its damping ratio, Hunt and
Crossley's by λ v, forces that yield or hold by the greatest force v √(Kn m) of the undamped drop.
A contact that stiffens has a closed form.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.special import gamma

from ....solver.arrays import Array
from ....solver.bodies.modal import rigid_body
from ....solver.bristle import RigidMass
from ....solver.contact.laws import REFERENCE_M, Adhesive, Damped, HuntCrossley, Plastic
from ....solver.effects.base import Parameter, Scene
from ....solver.effects.library import EFFECTS
from ...data.datasets import Manifest
from .emulator import Emulator, Law
from .table import Axis
from .table_drops import Outcome, outcomes_of

# A ball of rubber on wood is softer than any bristle's contact, steel on steel is stiffer.
KN_RANGE_N_M = (1e3, 1e9)
# How far from a declared stiffness tables reach, as a ratio.
AROUND = 10.0
# The most that a mass at rest sinks into its contact, as a share of the height of fall.
SINKS = 0.1
# Steps of a contact of half a period: y1/y0, time and peak are then off by less than 1e-3.
STEPS = 200
STIFFENING = "stiffening_contact"
FAINT = 1e-4


@dataclass(frozen=True)
class Side:
    """A contact law's own axis of a table, in shares of the scale that ``scale`` gives for mass,
    stiffness and speed of impact, and the ``law`` of a stiffness and a value. Nodes lie where
    logarithms of the rise bend least. Where the scale grows with the stiffness, heights alone tell
    the share and not the value, which is then as likely in every decade, as the stiffness is: from
    the ``faintest`` share on, which nothing would show."""

    shares: Axis
    scale: Callable[[float, Array | float, Array | float], Array]
    law: Law
    faintest: float = 0.0


def _critical(mass_kg: float, kn_N_m: Array | float, speed_m_s: Array | float) -> Array:
    return np.asarray(2.0 * np.sqrt(kn_N_m * mass_kg) + 0.0 * np.asarray(speed_m_s))


def _slowness(mass_kg: float, kn_N_m: Array | float, speed_m_s: Array | float) -> Array:
    return np.asarray(1.0 / speed_m_s + 0.0 * np.asarray(kn_N_m))


def _peak(mass_kg: float, kn_N_m: Array | float, speed_m_s: Array | float) -> Array:
    return np.asarray(speed_m_s * np.sqrt(kn_N_m * mass_kg))


SIDES: dict[str, Side] = {
    "contact_damping": Side(Axis(0.0, 1.5, 21, "root"), _critical, Damped, FAINT),
    "hunt_crossley": Side(Axis(0.0, 10.0, 21, "root"), _slowness, HuntCrossley),
    "plastic_contact": Side(Axis(0.02, 1.0, 21, "log"), _peak, Plastic),
    # of the whole greatest force, nothing would come back
    "adhesion": Side(Axis(0.0, 0.95, 21), _peak, Adhesive, FAINT),
}


@dataclass(frozen=True)
class RigidEmulator(Emulator):
    """Tables of drops of a rigid mass."""

    no_solid: ClassVar[str] = "a rigid mass has no 3-D model: nothing of it bends"
    scaled: ClassVar[Mapping[str, tuple[Law, Axis]]] = {
        name: (side.law, side.shares) for name, side in SIDES.items()
    }

    @property
    def mass(self) -> RigidMass:
        """The body, which has to be rigid."""
        assert isinstance(self.body, RigidMass)
        return self.body

    @property
    def simulated(self) -> tuple[str, ...]:
        return (*SIDES, STIFFENING)

    def carries(self, name: str) -> bool:
        """None of an elastic body's, none of its lean and none across the surface; drag where its
        diameter is known."""
        if name == "air_drag":
            return self.mass.front_m2 is not None
        return name in self.simulated or (EFFECTS[name].computed and not EFFECTS[name].origin)

    def outcomes(self, scenes: Sequence[Scene], its: float, friction: float) -> Outcome:
        """Lean, slope and the body's own losses are not looked at."""
        level = [
            Scene(height_m=scene.height_m, law=scene.law, order=scene.order) for scene in scenes
        ]
        g = self.gravity_m_s2
        return outcomes_of(rigid_body(self.mass), level, g, its, 0.0, lenient=True)

    def stiffened(self, height_m: Array | float, kn_N_m: Array, exponent: Array | float) -> Array:
        """What a power law of contact gives, (quantities, ...), in closed form, weight neglected.

        Force Kn δref (δ/δref)^p stops ½ m v² at δmax and gives all of it back after
        2 δmax / v · √π Γ(1 + 1/(p + 1)) / Γ(½ + 1/(p + 1)); with p = 3/2 Hertz's impact (K. L.
        Johnson, Contact Mechanics, 1985, §11.4: 2.94 δmax / v).
        """
        power, speed = np.asarray(exponent) + 1.0, self.speed_m_s(height_m)
        share = 0.5 * power * self.mass.mass_kg * speed**2 / (kn_N_m * REFERENCE_M**2)
        share = share ** (1.0 / power)
        shape = math.sqrt(math.pi) * gamma(1.0 + 1.0 / power) / gamma(0.5 + 1.0 / power)
        time = 2.0 * share * REFERENCE_M / speed * shape
        peak = kn_N_m * REFERENCE_M * share ** (power - 1.0)
        return np.stack(np.broadcast_arrays(height_m, time, peak))

    def step_s(self, kn_N_m: float) -> float:
        """To one digit, so that few differ."""
        return float(f"{math.pi * math.sqrt(self.mass.mass_kg / kn_N_m) / STEPS:.0e}")

    def scene(self) -> Scene:
        return Scene(front_m2=self.mass.front_m2 or 0.0)

    def bounded(self, name: str, parameter: Parameter) -> Parameter:
        """Bounds hold all that `SIDES` covers, from softest and slowest to stiffest and fastest."""
        if name not in SIDES or parameter.refines:
            return super().bounded(name, parameter)
        side = SIDES[name]
        shares, low = side.shares, side.faintest or side.shares.low
        heights = np.array([[self.lowest_m], [self.highest_m]])
        scales = self.scale(name, heights, np.array(self.kn_range_N_m))
        least, most = float(scales.min()), float(scales.max())
        high = shares.high * most
        return replace(
            parameter,
            low=low * least,
            high=high,
            typical=0.2 * math.sqrt(least * most),
            null=high if name == "plastic_contact" else low * least,
            logarithmic=parameter.logarithmic or side.faintest > 0.0,
            why="share of its scale",
        )

    def scale(self, name: str, height_m: Array, kn_N_m: Array) -> Array:
        return SIDES[name].scale(self.mass.mass_kg, kn_N_m, self.speed_m_s(height_m))

    def change(
        self,
        name: str,
        height_m: Array,
        kn_N_m: Array,
        *value: Array | float,
        friction: Array | float | None = None,
    ) -> Array:
        if name != STIFFENING:
            return super().change(name, height_m, kn_N_m, *value, friction=friction)
        absent = self.stiffened(height_m, kn_N_m, EFFECTS[name].parameters[0].null)
        return np.log(self.stiffened(height_m, kn_N_m, value[0]) / absent)


def rigid_emulator(
    kind: type[RigidEmulator], manifest: Manifest, lowest_m: float, highest_m: float
) -> RigidEmulator:
    """Tables of a rigid mass: about the stiffness that is declared, or over all that balls meet and
    that carry its weight."""
    assert isinstance(manifest.body, RigidMass)
    kn, g = manifest.kn_N_m, manifest.gravity_m_s2
    low, high = KN_RANGE_N_M if kn is None else (kn / AROUND, kn * AROUND)
    sinks = manifest.body.mass_kg * g / (SINKS * lowest_m)
    low = max(low, min(sinks, kn or sinks))
    return kind(manifest.body, g, lowest_m, highest_m, (low, high), friction=0.0)
