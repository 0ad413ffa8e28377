"""Tables of simulated drops: what height, stiffness and one effect's size make of a drop.

Each effect that only a simulation can tell the result of has a table of its own: drops of the beam
over speed of impact, stiffness and the effect's parameter, with cubic splines between. Where
several of these act together in one model, their ratios to the plain table are multiplied: near
enough to choose by, and checked by direct simulation afterwards.
"""

from __future__ import annotations

import hashlib
import inspect
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np

from ....solver import paper
from ....solver.arrays import Array
from ....solver.bristle import Bristle, RigidMass
from ....solver.cache import cached_each, sources
from ....solver.contact.laws import Adhesive, ContactLaw, Damped, Linear, Plastic
from ....solver.effects import library
from ....solver.effects.base import TOUCHING, Effect, Parameter, Scene
from ....solver.effects.library import EFFECTS
from ....solver.effects.surface import MOST_SLOPE_DEG
from ...running.threads import in_threads
from . import table, table_drops
from .table import QUANTITIES, Axis, Table, coefficients, mended
from .table_drops import Outcome, beam_of, its_s, outcomes_of, quantities

# All that the paper tried: a fit without an effect does not tell where the effect takes Kn.
KN_RANGE_N_M = (1e4, 1e8)
KN_NODES = 97
EFFECT_KN_NODES = 29
LEAN_KN_NODES = 11
# Nodes over the height are powers of two in mm. A cubic needs at least four.
FEWEST_HEIGHTS = 4
EFFECT_NODES = 13
DECADES_NODES = 27
LEAN_NODES = 8
# Below half a degree, where a slope lifts a side of the tip by less than the contact gives way, the
# median error of a rebound is 0.03 % with so many, and would be 0.3 % with two thirds of them.
SLOPE_NODES = 9
SIDE_NODES = 4
# Of a table with parameters that refine: stiffnesses, shares of a scale, values of each, and the
# share up to which a limit is reached for sure, so that what they refine acts. Few: fits to
# simulations find the rest.
REFINED_KN_NODES, REFINED_SHARES, REFINED_NODES, REACHED = 11, 13, 4, 0.99
# Steps over those of `Emulator.step_s`: the table of plain drops is what all is read against. Those
# of effects say how much an effect changes, at one step for both.
PLAIN_STEP = 0.25
LEAN_STEP = 3.0
# Coefficients at which what leans is simulated where friction is not known; straight between.
# From the last on, the tip sticks.
FRICTIONS = (0.0, 0.1, 0.3)
FRICTION = Parameter(
    "friction", "", 0.0, 1.0, 0.3, null=0.5, why="steel on anything: from oiled to rough and dry"
)
# What tables come from beside the solver and the emulator's own files.
MADE_BY = (Path(library.__file__).parent, Path(table_drops.__file__), Path(table.__file__))

# A contact law of a stiffness and more values; what puts a point of a table into a scene.
Law = Callable[..., ContactLaw]
Change = Callable[[Scene, tuple[float, ...]], Scene]
# Effects whose first parameter counts against a scale that height and stiffness set: the law, the
# shares of the scale that matter, and how nodes lie. Adhesion and yield count against the peak
# force of the same drop without them (more adhesion holds the bristle for good; a yield force
# beyond changes nothing), a dashpot against critical damping (more than most of it holds the
# bristle too).
SCALED: Mapping[str, tuple[Law, Axis]] = {
    "adhesion": (Adhesive, Axis(0.0, 0.8, 27)),
    "plastic_contact": (Plastic, Axis(0.05, 1.0, 21)),
    "contact_damping": (Damped, Axis(0.0, 0.9, 21, "root")),
}


@dataclass(frozen=True)
class Emulator:
    """Tables of drops, each made when it is first asked for: of a body under gravity, with friction
    (None where it is unknown), over the heights and stiffnesses to cover.

    Data that show other quantities of a drop, or drops of another body, have a subclass that
    overrides `observed` and `reference`. ``no_solid`` says why there is no 3-D model of the body,
    ``scaled`` which laws count against a scale.
    """

    body: Bristle | RigidMass
    gravity_m_s2: float
    lowest_m: float
    highest_m: float
    kn_range_N_m: tuple[float, float] = KN_RANGE_N_M
    friction: float | None = paper.FRICTION
    no_solid: ClassVar[str] = ""
    scaled: ClassVar[Mapping[str, tuple[Law, Axis]]] = SCALED

    @property
    def bristle(self) -> Bristle:
        """The body, which has to be elastic."""
        assert isinstance(self.body, Bristle)
        return self.body

    @property
    def simulated(self) -> tuple[str, ...]:
        """Effects of a bounce whose result only a simulation can tell."""
        return tuple(
            n for n, kind in EFFECTS.items() if kind.kinds & TOUCHING and not kind.computed
        )

    def carries(self, name: str) -> bool:
        """Whether drops of this body can have the effect."""
        return True

    def outcomes(self, scenes: Sequence[Scene], its: float, friction: float) -> Outcome:
        """Drops of these scenes; NaN where one fails, or stays on the surface for good."""
        g = self.gravity_m_s2
        return outcomes_of(beam_of(self.bristle), scenes, g, its, friction, lenient=True)

    def observed(self, scenes: Sequence[Scene], its: float, friction: float) -> Array:
        """Three positive quantities of `outcomes` (scenes, quantities)."""
        return quantities(self.outcomes(scenes, its, friction))

    def reference(self, height_m: Array | float, kn_N_m: Array | float) -> Array:
        """What the quantities are measured by, (quantities, ...): a rigid body on a spring, which
        loses nothing (Eqs. 3 and 8 of the paper)."""
        speed, mass = self.speed_m_s(height_m), self.body.mass_kg
        time = math.pi * np.sqrt(mass / kn_N_m)
        return np.stack(np.broadcast_arrays(height_m, time, speed * np.sqrt(kn_N_m * mass)))

    def speed_m_s(self, height_m: Array | float) -> Array:
        """Of the impact after a fall from rest in a vacuum."""
        return np.sqrt(2.0 * self.gravity_m_s2 * np.asarray(height_m))

    def step_s(self, kn_N_m: float) -> float:
        """The ITS that resolves a contact of this stiffness."""
        return its_s(self.bristle, kn_N_m)

    def of_drops(self) -> Emulator:
        """The same place for plain drops, whatever this emulator shows."""
        return Emulator(**{each.name: getattr(self, each.name) for each in fields(Emulator)})

    def scene(self) -> Scene:
        """A drop without effects."""
        return Scene(beta_s=self.bristle.material.beta_s, front_m2=self.bristle.section.area_m2)

    def frictions(self) -> tuple[float, ...]:
        """At which coefficients of friction what leans is simulated."""
        return FRICTIONS if self.friction is None else (self.friction,)

    def key(self, name: str, axes: Sequence[Axis]) -> str:
        """Key of a part of a table that is kept from run to run. It holds no range of heights;
        friction is in it only where ``name`` has it."""
        own = {Path(inspect.getfile(kind)) for kind in type(self).__mro__[:-1]}
        anywhere = replace(self, lowest_m=0.0, highest_m=0.0, friction=None)
        return f"{name} {axes} {anywhere} {sources(*MADE_BY, *sorted(own))}"

    def heights(self) -> Axis:
        """Of tables: powers of two in mm, from below the lowest to above the highest. Drops of the
        body from other heights use those again that they have in common."""
        first = math.floor(math.log2(1e3 * self.lowest_m) + 1e-9)
        last = max(math.ceil(math.log2(1e3 * self.highest_m) - 1e-9), first + 1)
        first = min(first, last + 1 - FEWEST_HEIGHTS)
        return Axis(1e-3 * 2.0**first, 1e-3 * 2.0**last, last - first + 1, "log")

    def table(
        self,
        name: str,
        sides: Sequence[Axis],
        change: Change,
        kn_nodes: int,
        friction: float | None = None,
    ) -> Table:
        """Drops over height, stiffness and ``sides``; ``change`` puts a point of these in.

        ``friction`` is None where nothing leans. ``name`` tells tables on the same sides apart.
        Raises ComputationError where drops fail at all time steps.
        """
        axes = (self.heights(), Axis(*self.kn_range_N_m, kn_nodes, "log"), *sides)
        return Table(axes, coefficients(self.tabulated(name, axes, change, friction), len(axes)))

    def tabulated(
        self, name: str, axes: tuple[Axis, ...], change: Change, friction: float | None
    ) -> Array:
        """Values at the nodes (..., quantities). Each height is kept in a file of its own; those
        that are missing are simulated together, and lost if that is interrupted."""
        octaves = np.round(np.log2(1e3 * axes[0].nodes()))  # to the bit, whatever the range
        heights = np.ldexp(1e-3, octaves.astype(int))
        keys = [self.key(f"{name} {friction} {height}", axes[1:]) for height in heights]

        def make(missing: list[int]) -> list[dict[str, Array]]:
            nodes = [heights[missing], *(axis.nodes() for axis in axes[1:])]
            return [{"values": each} for each in self.filled(nodes, change, friction)]

        return mended(np.stack([each["values"] for each in cached_each(keys, make)]))

    def filled(self, nodes: Sequence[Array], change: Change, friction: float | None) -> Array:
        """What is tabulated at these ``nodes`` along the axes, of heights and stiffnesses first,
        (..., quantities); NaN where a drop failed.

        Drops that share step, damping and loss are simulated in one batch, large batches first:
        threads share them.
        """
        longer = LEAN_STEP if friction is not None else 1.0 if nodes[2:] else PLAIN_STEP
        steps = [longer * self.step_s(float(kn)) for kn in nodes[1]]
        batches: dict[tuple[float, float, float], list[tuple[tuple[int, ...], Scene]]] = {}
        for index, scene in self.scenes(nodes, change):
            key = (steps[index[1]], scene.beta_s, scene.loss_factor)
            batches.setdefault(key, []).append((index, scene))
        out = np.empty((*map(len, nodes), len(QUANTITIES)))

        def simulate(key: tuple[float, float, float]) -> None:
            places, scenes = zip(*batches[key], strict=True)
            out[*np.transpose(places)] = self.observed(scenes, key[0], friction or 0.0)

        list(in_threads(simulate, sorted(batches, key=lambda key: -len(batches[key]))))
        rigid = self.reference(*np.meshgrid(*nodes[:2], indexing="ij"))
        rigid = rigid.reshape(*rigid.shape, *(1,) * len(nodes[2:]))
        out[~(out > 0.0)] = np.nan  # a tip that does not come up again
        return np.asarray(np.log(out / np.moveaxis(rigid, 0, -1)))

    def scenes(
        self, nodes: Sequence[Array], change: Change
    ) -> Iterator[tuple[tuple[int, ...], Scene]]:
        """Every node of a table: its place, and the drop there."""
        for index in itertools.product(*(range(len(each)) for each in nodes)):
            height, kn, *point = (float(each[i]) for each, i in zip(nodes, index, strict=True))
            plain = replace(self.scene(), height_m=height, law=Linear(kn))
            yield index, change(plain, tuple(point))

    @cached_property
    def plain(self) -> Table:
        """Drops without effects."""
        return self.table("plain", (), lambda scene, _: scene, KN_NODES)

    @cached_property
    def _made(self) -> dict[str, tuple[Table, ...]]:
        return {}

    def of(self, name: str) -> tuple[Table, ...]:
        """The tables of an effect, one for each of `frictions` where it leans; raises
        ComputationError where its drops fail."""
        if name not in self._made:
            frictions = self.frictions() if EFFECTS[name].leaning else (None,)
            self._made[name] = tuple(self._make(name, friction) for friction in frictions)
        return self._made[name]

    def absent(self, name: str) -> Table:
        """Drops without an effect, over height and stiffness, as its own table has them."""
        key = f"{name} absent"
        if key not in self._made:
            table, places = self.of(name)[0], [0.0, 0.0]
            if name != "surface_slope":
                places = [each.null for each in self.own(name)]
            if name in self.scaled:  # absent is what lies beyond the shares, whatever the scale
                side, (first, *_) = table.axes[2], self.own(name)
                places = [side.high if first.null > first.typical else side.low]
            self._made[key] = (table.fixed(*places),)
        return self._made[key][0]

    def changes(self, name: str) -> tuple[Table, ...]:
        """The tables `of` an effect, of the difference that it makes."""
        key = f"{name} changes"
        if key not in self._made:
            self._made[key] = tuple(each.less(self.absent(name)) for each in self.of(name))
        return self._made[key]

    def refined(self, name: str) -> Table:
        """The table of an effect that is `scaled`, with the parameters that refine it."""
        key = f"{name} refined"
        if key not in self._made:
            law, side = self.scaled[name]
            more = [_axis(each, False) for each in EFFECTS[name].parameters if each.refines]
            sides = [
                replace(side, high=REACHED * side.high, n=REFINED_SHARES),
                *(replace(each, n=REFINED_NODES) for each in more),
            ]
            made = self.table(key, sides, self._scaled(name, law), REFINED_KN_NODES)
            self._made[key] = (made,)
        return self._made[key][0]

    def _make(self, name: str, friction: float | None) -> Table:
        if name == "surface_slope":
            sides = (Axis(0.0, MOST_SLOPE_DEG, SLOPE_NODES, "root"), Axis(0.0, 90.0, SIDE_NODES))
            return self.table(name, sides, _sloping, LEAN_KN_NODES, friction)
        if name in self.scaled:
            law, side = self.scaled[name]
            return self.table(name, (side,), self._scaled(name, law), EFFECT_KN_NODES)
        kind, leans = EFFECTS[name], EFFECTS[name].leaning

        def change(scene: Scene, point: tuple[float, ...]) -> Scene:
            return effect_at(name, *point).enter(scene)

        nodes = LEAN_KN_NODES if leans or len(kind.parameters) > 1 else EFFECT_KN_NODES
        axes = [_axis(each, leans) for each in kind.parameters]
        key = name
        if kind.origin:  # what it does may hang on more than its own file
            points = itertools.product(*(axis.nodes() for axis in axes))
            plain = [replace(self.scene(), height_m=h) for h in (0.01, 0.02, 0.05)]
            done = repr([change(scene, tuple(map(float, p))) for p in points for scene in plain])
            key += hashlib.sha256(done.encode()).hexdigest()
        return self.table(key, axes, change, nodes, friction)

    def _scaled(self, name: str, law: Law) -> Change:
        """Puts a law in whose parameter is a share of its scale."""

        def change(scene: Scene, point: tuple[float, ...]) -> Scene:
            kn = scene.law.kn_N_m
            most = self.scale(name, np.array(scene.height_m), np.array(kn))
            return replace(scene, law=law(kn, point[0] * float(most), *point[1:]))

        return change

    def scale(self, name: str, height_m: Array, kn_N_m: Array) -> Array:
        """What the parameter of an effect that is `scaled` counts against, in its own unit."""
        if name == "contact_damping":
            return np.asarray(2.0 * np.sqrt(kn_N_m * self.body.mass_kg))
        upright = self._upright
        logs = upright.plain.at(height_m, kn_N_m)
        return np.asarray(upright.reference(height_m, kn_N_m)[2] * np.exp(logs[2]))

    @cached_property
    def _upright(self) -> Emulator:
        """The emulator whose plain drops show the peak force."""
        plain = self.of_drops()
        return self if plain == self else plain

    def parameters(self, name: str, refined: bool = False) -> tuple[Parameter, ...]:
        """An effect's parameters, as far as drops show them: with the absence that this body
        declares, and with friction where the effect hangs on it and nobody knows it; those that
        refine it where it is ``refined``."""
        own = self.own(name, refined)
        return (*own, FRICTION) if EFFECTS[name].leaning and self.friction is None else own

    def own(self, name: str, refined: bool = False) -> tuple[Parameter, ...]:
        """An effect's parameters with what this body declares; those from outside as they are."""
        kind = EFFECTS[name]
        if kind.origin:
            return kind.parameters
        every = (each for each in kind.parameters if refined or not each.refines)
        return tuple(self.bounded(name, each) for each in every)

    def bounded(self, name: str, parameter: Parameter) -> Parameter:
        """One parameter of an effect with what this body declares."""
        if parameter.name == "beta_s":
            return replace(parameter, null=self.bristle.material.beta_s)
        if parameter.name == "speed_m_s":  # thrown up, it comes back as fast
            return replace(parameter, low=0.0)
        return parameter

    def change(
        self,
        name: str,
        height_m: Array,
        kn_N_m: Array,
        *value: Array | float,
        friction: Array | float | None = None,
    ) -> Array:
        """By how much an effect changes the logarithms of all quantities (quantities, ...)."""
        if name in self.scaled:
            most = self.scale(name, np.asarray(height_m), np.asarray(kn_N_m))
            value = value[0] / most, *value[1:]
        now = [np.asarray(each) for each in (height_m, kn_N_m, *value)]
        tables = self.changes(name)
        if len(now) > len(tables[0].axes):
            refined = self.refined(name)
            reached = now[2] < refined.axes[2].high
            found = refined.at(*now) - self.absent(name).at(*now[:2])
            return np.asarray(np.where(reached, found, tables[0].at(*now[:3])))
        if len(tables) == 1 or friction is None:
            return tables[0].at(*now)
        return _between(tables, np.asarray(friction), now)


def _axis(parameter: Parameter, leans: bool) -> Axis:
    """Nodes over a parameter, closer where it is absent at its low end."""
    low, high = parameter.low, parameter.high
    if parameter.logarithmic:
        return Axis(low, high, LEAN_NODES if leans else DECADES_NODES, "log")
    how = "root" if leans or parameter.null == low else "even"
    return Axis(low, high, LEAN_NODES if leans else EFFECT_NODES, how)


def effect_at(name: str, *values: float) -> Effect:
    """The effect at values of its parameters, taken into their bounds; those that refine it may be
    left out, and are at their nulls then."""
    kind = EFFECTS[name]
    left_out = [each.null for each in kind.parameters[len(values) :] if each.refines]
    own = {
        each.name: float(np.clip(value, each.low, each.high))
        for each, value in zip(kind.parameters, [*values, *left_out], strict=True)
    }
    return kind(**own)


def _between(tables: Sequence[Table], friction: Array, places: Sequence[Array]) -> Array:
    """Between tables at `FRICTIONS`, in a straight line; arrays (..., nodes, drops), ``friction``
    (..., 1, 1)."""
    lead = np.broadcast_shapes(*(each.shape[:-2] for each in (friction, *places)))
    at = np.interp(friction, FRICTIONS, np.arange(len(FRICTIONS)))
    at = np.broadcast_to(np.clip(at, 0, len(tables) - 1 - 1e-9), (*lead, 1, 1))
    every = [np.broadcast_to(each, (*lead, *each.shape[-2:])) for each in places]
    low = at.astype(np.int64)
    deep = np.broadcast_shapes(*(each.shape[-2:] for each in every))
    out = np.zeros((len(QUANTITIES), *lead, *deep))
    for i, each in enumerate(tables):
        share = np.where(low == i, 1.0 - (at - low), np.where(low == i - 1, at - low, 0.0))
        used = share[..., 0, 0] != 0.0
        if used.any():
            out[:, used] += share[used] * each.at(*(place[used] for place in every))
    return out


def _sloping(scene: Scene, point: tuple[float, ...]) -> Scene:
    steep, side = math.tan(math.radians(point[0])), math.radians(point[1])
    thin, wide = math.atan(steep * math.cos(side)), math.atan(steep * math.sin(side))
    return replace(scene, slope_deg=math.degrees(thin), slope_wide_deg=math.degrees(wide))
