"""Tables of drops of a rigid mass, in the place of a bristle's."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from ....solver.arrays import Array
from ....solver.bristle import RigidMass
from ....solver.contact.laws import REFERENCE_M
from ....solver.effects.base import Parameter, Scene
from ....solver.effects.library import EFFECTS
from . import rigid_drops
from .response import MADE_BY, Emulator, Law, Tables
from .rigid_drops import SIDES, bounded, carried, observed, step_s, stiffened
from .table import Axis

# A ball of rubber on wood is softer than any bristle's contact, steel on steel is stiffer.
KN_RANGE_N_M = (1e3, 1e9)
# How far from a declared stiffness tables reach, as a ratio.
AROUND = 10.0
# Nodes along each law's own axis, and how they lie: where logarithms of the rise bend least.
NODES = {
    "contact_damping": (21, "root"),
    "hunt_crossley": (21, "root"),
    "plastic_contact": (21, "log"),
    "adhesion": (21, "even"),
}


@dataclass(frozen=True)
class RigidEmulator(Emulator):
    """Where tables of drops of a rigid mass are made, upright onto level ground."""

    made_by: ClassVar[tuple[Path, ...]] = (*MADE_BY, Path(rigid_drops.__file__), Path(__file__))
    no_solid: ClassVar[str] = "a rigid mass has no 3-D model: nothing of it bends"

    @property
    def mass(self) -> RigidMass:
        """The body, which has to be rigid."""
        assert isinstance(self.body, RigidMass)
        return self.body

    def carries(self, name: str) -> bool:
        return name in carried(self.mass)

    def observed(self, scenes: Sequence[Scene], its: float, friction: float) -> Array:
        return observed(self.mass, scenes, self.gravity_m_s2, its)

    def stiffened(self, height_m: Array, kn_N_m: Array, exponent: Array | float) -> Array:
        """What a contact that stiffens gives (quantities, ...), see `rigid_drops.stiffened`."""
        mass, gravity = self.mass.mass_kg, self.gravity_m_s2
        return stiffened(height_m, kn_N_m, exponent, REFERENCE_M, mass, gravity)

    def step_s(self, kn_N_m: float) -> float:
        return step_s(self.mass, kn_N_m)

    def plain(self) -> Scene:
        return Scene(front_m2=self.mass.front_m2 or 0.0)


@dataclass(frozen=True)
class RigidTables(Tables):
    """The tables of an emulator of drops of a rigid mass.

    What the law of contact does is told by shares of its scale (`rigid_drops.SIDES`), a contact
    that stiffens by its closed form.
    """

    scaled: ClassVar[Mapping[str, tuple[Law, Axis]]] = {
        name: (side.law, Axis(side.low, side.high, *NODES[name])) for name, side in SIDES.items()
    }

    @property
    def _rigid(self) -> RigidEmulator:
        assert isinstance(self.emulator, RigidEmulator)
        return self.emulator

    @property
    def simulated(self) -> tuple[str, ...]:
        return (*SIDES, "stiffening_contact")

    def _bounded(self, name: str, parameter: Parameter) -> Parameter:
        emulator = self._rigid
        speeds = self._speed_m_s(emulator.lowest_m), self._speed_m_s(emulator.highest_m)
        own = bounded(name, parameter, emulator.mass, emulator.kn_range_N_m, speeds)
        return super()._bounded(name, own)

    def _speed_m_s(self, height_m: float) -> float:
        return math.sqrt(2.0 * self.emulator.gravity_m_s2 * height_m)

    def _scale(self, name: str, height_m: Array, kn_N_m: Array) -> Array:
        speed = np.sqrt(2.0 * self.emulator.gravity_m_s2 * height_m)
        return SIDES[name].scale(self.emulator.body.mass_kg, kn_N_m, speed)

    def change(
        self,
        name: str,
        height_m: Array,
        kn_N_m: Array,
        *value: Array | float,
        friction: Array | float | None = None,
    ) -> Array:
        if name != "stiffening_contact":
            return super().change(name, height_m, kn_N_m, *value, friction=friction)
        emulator, absent = self._rigid, EFFECTS[name].parameters[0].null
        now = emulator.stiffened(height_m, kn_N_m, value[0])
        return np.log(now / emulator.stiffened(height_m, kn_N_m, absent))


def around(kn_N_m: float | None) -> tuple[float, float]:
    """The stiffnesses that tables cover: near what is declared, or all that balls meet."""
    return KN_RANGE_N_M if kn_N_m is None else (kn_N_m / AROUND, kn_N_m * AROUND)
