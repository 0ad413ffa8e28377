"""How does a drop answer to height, stiffness and one effect's size: a table of simulated drops.

Each effect that only a simulation can tell the result of has a table of its own: drops of the beam
over speed of impact, stiffness and the effect's parameter, with cubic splines between. Where
several of these act together in one model, their ratios to the plain table are multiplied: near
enough to choose by, and checked by direct simulation afterwards.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ...solver import paper
from ...solver.bristle import Array, Bristle
from ...solver.contact.laws import Adhesive, Linear, Plastic
from ...solver.effects import library
from ...solver.effects.base import Parameter, Scene
from ...solver.effects.library import EFFECTS
from ...solver.effects.surface import MOST_SLOPE_DEG
from ...solver.kept import kept, sources
from . import spline, table, table_drops
from .spline import coefficients
from .table import QUANTITIES, Axis, Table, mended
from .table_drops import beam_of, drops_of, its_s

# Softer and damped, a contact may hold the bristle for good.
KN_RANGE_N_M = (1e5, 1e8)
KN_NODES = 33
LEAN_KN_NODES = 9
# Decades to each side of the stiffness that the baseline has.
KN_DECADES = 1.0
HEIGHT_NODES = 4
EFFECT_NODES = 17
LEAN_NODES = 10
SLOPE_NODES = 8
SIDE_NODES = 4
# What tables come from beside the solver, whose sources name the folder that they are kept in.
MADE_BY = (
    Path(library.__file__).parent,
    Path(table_drops.__file__),
    Path(table.__file__),
    Path(spline.__file__),
    Path(__file__),
)


def reference(
    height_m: Array | float, kn_N_m: Array | float, mass_kg: float, gravity_m_s2: float
) -> Array:
    """What a rigid bristle on Kn gives, (quantities, ...): Eqs. 3 and 8 of the paper."""
    speed = np.sqrt(2.0 * gravity_m_s2 * height_m)
    time = math.pi * np.sqrt(mass_kg / kn_N_m)
    return np.stack(np.broadcast_arrays(height_m, time, speed * np.sqrt(kn_N_m * mass_kg)))


@dataclass(frozen=True)
class Bench:
    """Where tables are made: the body, gravity and friction, and the heights to cover.

    Data that show other quantities of a drop have a bench that overrides `seen` and `reference`,
    and names its own source in ``made_by``; ``shows_falls`` says that they show how it fell.
    """

    bristle: Bristle
    gravity_m_s2: float
    lowest_m: float
    highest_m: float
    kn_range_N_m: tuple[float, float] = KN_RANGE_N_M
    friction: float = paper.FRICTION
    made_by: ClassVar[tuple[Path, ...]] = MADE_BY
    shows_falls: ClassVar[bool] = False

    def seen(self, scenes: Sequence[Scene], its: float) -> Array:
        """Three positive quantities of drops of these scenes (scenes, quantities); NaN for one that
        fails, or stays on the surface for good."""
        body = beam_of(self.bristle)
        return drops_of(body, scenes, self.gravity_m_s2, its, self.friction, lenient=True)

    def reference(self, height_m: Array, kn_N_m: Array) -> Array:
        """What the quantities (quantities, ...) are measured by."""
        return reference(height_m, kn_N_m, self.bristle.mass_kg, self.gravity_m_s2)

    def about(self, kn_N_m: float) -> Bench:
        """The bench for stiffnesses near one, which is rounded so that others share its tables."""
        middle = round(2.0 * math.log10(kn_N_m)) / 2.0
        low, high = self.kn_range_N_m
        near = (10.0 ** (middle - KN_DECADES), 10.0 ** (middle + KN_DECADES))
        return replace(self, kn_range_N_m=(max(low, near[0]), min(high, near[1])))

    def of_drops(self) -> Bench:
        """The same place for plain drops, whatever this bench shows."""
        return Bench(**{each.name: getattr(self, each.name) for each in fields(Bench)})

    def plain(self) -> Scene:
        """A drop without effects."""
        return Scene(beta_s=self.bristle.material.beta_s, front_m2=self.bristle.section.area_m2)

    def _axes(self, leaning: bool) -> tuple[Axis, Axis]:
        low, high = self.kn_range_N_m
        n = LEAN_KN_NODES if leaning else KN_NODES
        return Axis(self.lowest_m, self.highest_m, HEIGHT_NODES, "root"), Axis(low, high, n, "log")

    def table(
        self,
        name: str,
        sides: Sequence[Axis],
        change: Callable[[Scene, tuple[float, ...]], Scene],
        leaning: bool,
    ) -> Table:
        """Drops over height, stiffness and ``sides``; ``change`` puts a point of these in.

        ``name`` tells tables on the same sides apart: they are kept from run to run. Raises
        ComputationError where drops fail at all time steps.
        """
        axes = (*self._axes(leaning), *sides)
        key = f"{name} {axes} {self} {sources(*self.made_by)}"
        made = kept(key, lambda: {"coefficients": self._filled(axes, change)})
        return Table(axes, made["coefficients"])

    def _filled(
        self, axes: tuple[Axis, ...], change: Callable[[Scene, tuple[float, ...]], Scene]
    ) -> Array:
        """Spline coefficients (..., quantities) of a table."""
        sides = axes[2:]
        heights, kns = axes[0].nodes(), [float(kn) for kn in axes[1].nodes()]
        steps: dict[float, list[int]] = {}
        for j, kn in enumerate(kns):
            steps.setdefault(its_s(self.bristle, kn), []).append(j)
        shape = tuple(axis.n for axis in axes)
        out = np.empty((*shape, len(QUANTITIES)))
        for index in itertools.product(*(range(axis.n) for axis in sides)):
            point = tuple(float(axis.nodes()[i]) for axis, i in zip(sides, index, strict=True))
            for its, columns in steps.items():
                scenes = [
                    change(replace(self.plain(), height_m=float(h), law=Linear(kns[j])), point)
                    for h in heights
                    for j in columns
                ]
                rows = self.seen(scenes, its).reshape(len(heights), len(columns), -1)
                place: tuple[Any, ...] = (slice(None), columns, *index)
                out[place] = rows
        grid = np.meshgrid(heights, kns, indexing="ij")
        rigid = self.reference(*grid)
        rigid = rigid.reshape(len(QUANTITIES), *shape[:2], *(1,) * len(sides))
        logs = np.log(out / np.moveaxis(rigid, 0, -1))
        return coefficients(mended(logs), len(axes))


SIMULATED = (
    "contact_damping",
    "hunt_crossley",
    "stiffening_contact",
    "plastic_contact",
    "adhesion",
    "material_damping",
    "hysteretic_damping",
    "bristle_tilt",
    "surface_slope",
)
LEANING = ("bristle_tilt", "surface_slope")
# Forces that count against the greatest force of the same drop without them, and the shares of it
# that matter: below, a bristle stays for good; a yield force beyond changes nothing, to the point.
HELD: dict[str, tuple[type, float, float]] = {
    "adhesion": (Adhesive, 0.0, 0.5),
    "plastic_contact": (Plastic, 0.06, 1.0),
}
HELD_NODES = 17


@dataclass(frozen=True)
class Tables:
    """The tables of a bench, each made when it is first asked for."""

    bench: Bench

    @property
    def simulated(self) -> tuple[str, ...]:
        """Effects whose result only a simulation can tell."""
        return SIMULATED

    def bounded(self, parameter: Parameter) -> Parameter:
        """The parameter with the absence that this body declares, and as far as drops show it."""
        if parameter.name == "beta_s":
            return replace(parameter, null=self.bench.bristle.material.beta_s)
        if parameter.name == "speed_m_s" and not self.bench.shows_falls:
            # thrown up, it comes back as fast
            return replace(parameter, low=0.0)
        return parameter

    @cached_property
    def plain(self) -> Table:
        return self.bench.table("plain", (), lambda scene, _: scene, False)

    @cached_property
    def _made(self) -> dict[str, Table]:
        return {}

    def of(self, name: str) -> Table:
        """The table of an effect; raises ComputationError where its drops fail."""
        if name not in self._made:
            self._made[name] = self._make(name)
        return self._made[name]

    def _make(self, name: str) -> Table:
        kind = EFFECTS[name]
        only = kind.parameters[0]
        if name == "surface_slope":
            sides = (Axis(0.0, MOST_SLOPE_DEG, SLOPE_NODES, "root"), Axis(0.0, 90.0, SIDE_NODES))
            return self.bench.table(name, sides, _sloping, True)
        if name in HELD:
            return self.bench.table(
                name, (Axis(*HELD[name][1:], HELD_NODES),), self._held(name), False
            )
        n = LEAN_NODES if name in LEANING else EFFECT_NODES
        how = "log" if only.logarithmic else "root" if name in LEANING else "even"
        axis = Axis(only.low, only.high, n, how)

        def change(scene: Scene, point: tuple[float, ...]) -> Scene:
            value = min(max(point[0], only.low), only.high)
            return kind(**{only.name: value}).enter(scene)

        return self.bench.table(name, (axis,), change, name in LEANING)

    def _held(self, name: str) -> Callable[[Scene, tuple[float, ...]], Scene]:
        """Puts a law in whose force is a share of the drop's greatest."""
        law = HELD[name][0]

        def change(scene: Scene, point: tuple[float, ...]) -> Scene:
            kn = scene.law.kn_N_m
            most = self._peak_N(np.array(scene.height_m), np.array(kn))
            return replace(scene, law=law(kn, point[0] * float(most)))

        return change

    @cached_property
    def _upright(self) -> Table:
        """Drops without effects as a `Bench` of drops has them, whatever this bench shows."""
        upright = self.bench.of_drops()
        return self.plain if upright == self.bench else Tables(upright).plain

    def _peak_N(self, height_m: Array, kn_N_m: Array) -> Array:
        """The greatest force of drops without effects."""
        height_m, kn_N_m = np.broadcast_arrays(height_m, kn_N_m)
        mass, gravity = self.bench.bristle.mass_kg, self.bench.gravity_m_s2
        rigid = reference(height_m, kn_N_m, mass, gravity)[2]
        return np.asarray(rigid * np.exp(self._upright.at(height_m, kn_N_m)[2]))

    def change(self, name: str, height_m: Array, kn_N_m: Array, *value: Array | float) -> Array:
        """By how much an effect changes the logarithms of all quantities (quantities, ...)."""
        table = self.of(name)
        absent = [np.asarray(0.0)] * len(value)
        if name != "surface_slope":
            absent = [np.asarray(self.bounded(EFFECTS[name].parameters[0]).null)]
        if name in HELD:
            most = self._peak_N(height_m, kn_N_m)
            value, absent = (value[0] / most,), [absent[0] / most]
        now = table.at(*np.broadcast_arrays(height_m, kn_N_m, *value))
        return now - table.at(*np.broadcast_arrays(height_m, kn_N_m, *absent))

    def rigid(self, height_m: Array, kn_N_m: Array) -> Array:
        """See `Bench.reference`."""
        return self.bench.reference(height_m, kn_N_m)


def _sloping(scene: Scene, point: tuple[float, ...]) -> Scene:
    steep, side = math.tan(math.radians(point[0])), math.radians(point[1])
    thin, wide = math.atan(steep * math.cos(side)), math.atan(steep * math.sin(side))
    return replace(scene, slope_deg=math.degrees(thin), slope_wide_deg=math.degrees(wide))
