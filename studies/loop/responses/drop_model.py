"""Models of drops: what a stiffness and effects predict for every drop of a dataset."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np

from ....solver import paper
from ....solver.arrays import Array
from ....solver.bristle import RigidMass
from ....solver.contact.laws import Linear
from ....solver.effects.base import Effect, Parameter, Scene
from ....solver.effects.library import EFFECTS, enter_all, in_order
from ....solver.effects.surface import steepness_deg
from ....solver.errors import InputError
from ....solver.fall import fallen, risen
from ..fit import Fitted, to_unit
from ..noise import Ints
from ..sample import Sample
from .emulator import Emulator, effect_at
from .errors import Errors
from .mesh import Mesh, mesh_of
from .sessions import Partings

# How many times closer nodes in two dimensions may lie. Their number grows with its square.
MOST_CLOSER_IN_TWO = 3
# Nodes of chance, ends and how many: stiffness by its normal deviate, slope by its size; and the
# slope's direction.
DEVIATES = (-3.25, 3.25, 53)
SIZES = (0.1, 3.5, 18)
# Share of a height by which slopes over it are found.
STEP = 1e-3
# Step in decades of stiffness, for the difference that a second session makes.
SESSION_STEP = 1e-3
# In the unit box: farther away a correction's slopes tell no more.
TRUSTED = 0.25
DIRECTIONS_DEG = (9.0, 27.0, 45.0, 63.0, 81.0)


@dataclass(frozen=True)
class Drops:
    """Drops as they were measured: ``y0_m``, ``order`` (drops,), and which quantities (of
    `table.QUANTITIES`) were. ``session`` (drops,) is one in the second of two sessions, and
    ``partings`` are the ways to part them. They may be a part, by numbers, of a ``whole``, whose
    mesh is theirs too."""

    emulator: Emulator
    y0_m: Array
    order: Array
    quantities: tuple[int, ...]
    session: Array | float = 0.0
    partings: Partings | None = None
    whole: tuple[Drops, Ints] | None = None

    def __len__(self) -> int:
        return len(self.y0_m)

    def of(self, which: Ints) -> Drops:
        """The drops numbered ``which``."""
        session = np.broadcast_to(self.session, len(self))[which]
        part = replace(self, y0_m=self.y0_m[which], order=self.order[which], session=session)
        return replace(part, whole=(self, which))

    @cached_property
    def _meshes(self) -> dict[tuple[bool, bool], Mesh | None]:
        return {}

    def mesh(self, order: bool, session: bool) -> Mesh | None:
        """Few drops that tell what these do, if that hangs on the height and on their ``order`` or
        ``session``; None where these, or those that they are a part of, are few themselves."""
        if (order, session) not in self._meshes:
            self._meshes[order, session] = self._mesh(order, session)
        return self._meshes[order, session]

    def _mesh(self, order: bool, session: bool) -> Mesh | None:
        if self.whole is not None:
            mesh = self.whole[0].mesh(order, session)
            return mesh and mesh.of(self.whole[1])
        apart = np.broadcast_to(self.session, len(self))
        return mesh_of(self.y0_m, self.order if order else None, apart if session else None)


class Landing(NamedTuple):
    """How drops fell and were read, arrays that broadcast to (..., nodes, drops).

    Heights of the release, and of the fall from rest in a vacuum that ends as fast; speed at
    release, drag over mass, stiffness; scale and zero of the heights, and rate of the clock, by
    which all is read.
    """

    height_m: Array
    same_m: Array
    speed_m_s: Array
    drag_1_m: Array
    kn_N_m: Array
    scale: Array
    offset_m: Array
    clock: Array


@dataclass(frozen=True)
class BounceModel:
    """The baseline with ``effects`` in, up to what data show of it: the base of `Model` classes.

    Computed effects enter all drops at once; two that are random vary together from drop to drop.

    ``kn``, ``beta`` where the body's damping is not declared and ``gain`` where forces are measured
    are the baseline's free parameters; nodes of chance lie ``closer`` so many times. Where it is
    ``refined``, effects have the parameters that refine them, too. A subclass adds `predict`.
    """

    drops: Drops
    kn: Parameter
    effects: tuple[str, ...]
    beta: Parameter | None = field(default=None, kw_only=True)
    gain: Parameter | None = field(default=None, kw_only=True)
    closer: int = field(default=1, kw_only=True)
    refined: bool = field(default=False, kw_only=True)

    @property
    def emulator(self) -> Emulator:
        """The tables."""
        return self.drops.emulator

    def finer(self, by: int) -> Self:
        """The same with ``by`` times as many nodes of stiffness or of the slope's size."""
        return replace(self, closer=by)

    @property
    def refinement(self) -> Self | None:
        """The same with the parameters that refine its effects; None where there are no others."""
        if self.refined or not any(p.refines for n in self.effects for p in EFFECTS[n].parameters):
            return None
        return replace(self, refined=True)

    @property
    def possible(self) -> bool:
        """Whether a drop can have all the effects at once: it has one law of contact."""
        kinds = [EFFECTS[name] for name in in_order(self.effects)]
        typical = [effect_at(each.name, *(p.typical for p in each.parameters)) for each in kinds]
        try:
            enter_all(self.emulator.scene(), typical)
        except InputError:
            return False
        return True

    @property
    def own(self) -> tuple[Parameter, ...]:
        """The baseline's."""
        return tuple(each for each in (self.kn, self.beta, self.gain) if each is not None)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (*self.own, *(each for name in self.effects for each in self._parameters_of(name)))

    def _parameters_of(self, name: str) -> tuple[Parameter, ...]:
        return self.emulator.parameters(name, self.refined)

    @cached_property
    def _chance(self) -> tuple[Array, Array]:
        """Deviates (nodes, 3) of a computed effect, size and direction of slope; weights
        (nodes,)."""
        stiff: Array = np.zeros(1)
        sizes: Array = np.zeros(1)
        sides: Array = np.zeros(1)
        stiff_weights: Array = np.ones(1)
        size_weights: Array = np.ones(1)
        stiffer = any(EFFECTS[name].computed and EFFECTS[name].random for name in self.effects)
        slopes = "surface_slope" in self.effects
        # nodes in two dimensions lie between each other: every third of either is enough, unless
        # one of both effects is small
        two = stiffer and slopes
        closer, every = (min(self.closer, MOST_CLOSER_IN_TWO), 3) if two else (self.closer, 1)
        if stiffer:
            stiff = _nodes(*DEVIATES, closer)[every // 2 :: every]
            stiff_weights = np.exp(-0.5 * stiff**2)
        if slopes:
            sizes = _nodes(*SIZES, closer)[every // 2 :: every]
            size_weights = sizes * np.exp(-0.5 * sizes**2)
            sides = np.array(DIRECTIONS_DEG)[:: (every + 1) // 2]
        grid = np.meshgrid(stiff, sizes, sides, indexing="ij")
        weights = np.einsum("i,j,k->ijk", stiff_weights, size_weights, np.ones(len(sides)))
        nodes = np.stack([each.ravel() for each in grid], axis=1)
        return nodes, weights.ravel() / weights.sum()

    @property
    def weights(self) -> Array:
        return self._chance[1]

    def answer(self, theta: Array) -> tuple[Landing, Array]:
        """How each drop landed, and what the tables say of it (quantities, ..., nodes, drops)."""
        theta = np.asarray(theta, dtype=float)
        given = self.given(theta)
        drops, emulator = self.drops, self.emulator
        nodes = self._chance[0]

        def value(name: str, which: int = 0) -> Array:
            return given[name][which][..., None, None]

        every: dict[str, Any] = {
            "law": Linear(theta[..., 0][..., None, None]),  # type: ignore[arg-type]
            "height_m": drops.y0_m,
            "order": drops.order,
            "session": drops.session,
            "chance": (nodes[:, :1], 0.0),
        }
        scene = replace(emulator.scene(), **every)
        for name in in_order(self.effects):
            kind = EFFECTS[name]
            if kind.computed:
                values = (value(name, i) for i in range(len(kind.parameters)))
                scene = kind.unchecked(*values).enter(scene)
        height = np.maximum(drops.y0_m / scene.y_scale - scene.y_offset_m, 1e-5)
        drag_1_m = np.asarray(scene.drag_kg_m / emulator.body.mass_kg)
        same = fallen(height, emulator.gravity_m_s2, scene.release_speed_m_s, drag_1_m)
        same, kn = np.atleast_2d(same), np.atleast_2d(np.asarray(scene.law.kn_N_m))
        logs = emulator.plain.at(same, kn)
        if self.beta is not None:
            beta = theta[..., 1][..., None, None]
            logs = logs + emulator.change("material_damping", same, kn, beta)
        for name in self.effects:
            count = len(emulator.own(name, self.refined))
            friction = value(name, count) if len(given[name]) > count else None
            if name == "surface_slope":
                lean = (steepness_deg(nodes[:, 1:2], value(name)), nodes[:, 2:3])
                logs = logs + emulator.change(name, same, kn, *lean, friction=friction)
            elif name in emulator.simulated:
                values = (value(name, i) for i in range(count))
                logs = logs + emulator.change(name, same, kn, *values, friction=friction)
        landing = Landing(
            height_m=height,
            same_m=same,
            speed_m_s=np.asarray(scene.release_speed_m_s),
            drag_1_m=drag_1_m,
            kn_N_m=kn,
            scale=np.asarray(scene.y_scale),
            offset_m=np.asarray(scene.y_offset_m),
            clock=np.asarray(scene.t_scale),
        )
        return landing, logs

    def bounced(self, theta: Array) -> tuple[Landing, Array]:
        """How each drop landed, and the tables' quantities in SI (quantities, ..., nodes, drops).

        The first is the rise in a vacuum.
        """
        landing, logs = self.answer(theta)
        return landing, np.exp(logs) * self.emulator.reference(landing.same_m, landing.kn_N_m)

    def given(self, theta: Array) -> Mapping[str, tuple[Array, ...]]:
        """Each effect's parameters (...,) by its name, of parameters (..., p)."""
        at = len(self.own)
        out = {}
        for name in self.effects:
            count = len(self._parameters_of(name))
            out[name] = tuple(theta[..., at + i] for i in range(count))
            at += count
        return out


@dataclass(frozen=True)
class Correction:
    """What simulated drops show over what tables say of them, as logarithms: ``logs`` (quantities,
    drops) at a point ``u`` (p,) of the unit box and their ``slopes`` (p, quantities, drops)."""

    u: Array
    logs: Array
    slopes: Array

    def at(self, u: Array) -> Array:
        """At points (..., p): (quantities, ..., 1 node, drops)."""
        away = np.clip(u - self.u, -TRUSTED, TRUSTED)
        logs = np.tensordot(away, self.slopes, axes=1) + self.logs
        return np.moveaxis(logs, -2, 0)[..., None, :]

    def of(self, which: Ints) -> Correction:
        """That of the drops numbered ``which``."""
        return replace(self, logs=self.logs[..., which], slopes=self.slopes[..., which])

    def spread(self, mesh: Mesh | None) -> Correction:
        """That of all drops from that of a mesh; itself where there is none."""
        if mesh is None:
            return self
        logs, slopes = (mesh.spread(each[..., None])[..., 0] for each in (self.logs, self.slopes))
        return replace(self, logs=logs, slopes=slopes)

    def moved(self, u: Array, logs: Array) -> Correction:
        """About another point where drops were simulated; slopes learn from it (C. G. Broyden,
        Math. Comp. 19 (1965) 577; space mapping: Bakr et al., Optim. Eng. 1 (2000) 241)."""
        step = u - self.u
        size = float(step @ step)
        if size == 0.0:
            return self
        missed = logs - self.logs - np.tensordot(step, self.slopes, axes=1)
        return Correction(u, logs, self.slopes + step[:, None, None] * missed / size)


@dataclass(frozen=True)
class DropModel(BounceModel):
    """A `Model` of whitened quantities, drop after drop, those that were read."""

    errors: Errors
    correction: Correction | None = field(default=None, kw_only=True)

    @property
    def refinement(self) -> Self | None:
        found = super().refinement
        return found and replace(found, correction=None)

    @property
    def _partings(self) -> Partings | None:
        return self.drops.partings if "session" in self.effects else None

    @property
    def choices(self) -> int:
        """Among how many ways to part sessions the data chose: see `fit.Chosen`."""
        return 1 if self._partings is None else max(self._partings.possible.size, 1)

    @property
    def remarks(self) -> dict[str, str]:
        """Which drops are those of the second session."""
        return {} if self._partings is None else {"session": self._partings.words}

    def chosen(self, data: Sample, beside: Fitted) -> Self:
        """The same with sessions parted as data ask for where ``beside`` has the other effects."""
        partings = self._partings
        if partings is None:
            return self
        assert isinstance(beside.model, BounceModel)
        known, own = beside.model.given(beside.theta), len(self.own)
        first = own + self._before("session")
        null = [each.null for each in self.parameters[own:]]
        theta = np.tile(np.concatenate([beside.theta[:own], null]), (2, 1))
        for name, values in known.items():
            at = own + self._before(name)
            theta[:, at : at + len(values)] = values
        theta[1, first] += SESSION_STEP
        all_second = replace(self, drops=replace(self.drops, session=1.0), correction=None)
        one, other = np.asarray(self.weights) @ data.predict(all_second, theta)
        drop = np.nonzero(self.errors.present)[0][data.rows]
        found = partings.parted(partings.gains(data, beside, drop, other - one))
        return replace(self, drops=replace(self.drops, session=found.second, partings=found))

    def _before(self, name: str) -> int:
        """How many parameters effects before this one have."""
        others = itertools.takewhile(lambda each: each != name, self.effects)
        return sum(len(self._parameters_of(each)) for each in others)

    @cached_property
    def _parts(self) -> dict[bytes, Self]:
        return {}

    def only(self, rows: Ints) -> Self:
        """The same of these rows alone, all of their drops; the same object each time."""
        key = rows.tobytes()
        if key not in self._parts:
            self._parts[key] = self._only(rows)
        return self._parts[key]

    def _only(self, rows: Ints) -> Self:
        which = np.unique(np.nonzero(self.errors.present)[0][rows])
        correction = self.correction
        if correction is not None and not (self._smooth and self._mesh is not None):
            correction = correction.of(which)
        drops, errors = self.drops.of(which), self.errors.only(which)
        return replace(self, drops=drops, errors=errors, correction=correction)

    @property
    def _smooth(self) -> bool:
        """Whether predictions have no kink over the height: none that a law makes where it begins
        to yield, or tables where wear leads out of them."""
        return not {"plastic_contact", "wear"} & set(self.effects)

    @cached_property
    def _mesh(self) -> Mesh | None:
        """Few drops that tell of all; None where there are few, or an effect from outside may hang
        on their order in any way."""
        if any(EFFECTS[name].origin for name in self.effects):
            return None
        return self.drops.mesh("wear" in self.effects, "session" in self.effects)

    @cached_property
    def _few(self) -> Self:
        """The model at the drops of the mesh."""
        assert self._mesh is not None
        mesh, each = self._mesh, self.errors
        few = replace(self.drops, y0_m=mesh.y0_m, order=mesh.order, session=mesh.session)
        few = replace(few, whole=None)
        plain = replace(each, present=np.ones((len(few), len(self.drops.quantities)), bool))
        return replace(self, drops=few, errors=plain)

    def simulated(self, theta: Array) -> Self:
        """The same with its tables made right at ``theta`` (p,), where every drop is simulated.

        Tables are off by some hundredths of an effect between their nodes, more where a law has a
        kink, and know several effects only one by one. Points that were simulated one after the
        other make the slopes right too. Itself where nothing is simulated, or means are over
        chance, and of a rigid mass, whose tables are close.
        """
        emulator = self.emulator
        acting = [name for name in self.effects if name in emulator.simulated]
        if not acting or len(self.weights) > 1 or isinstance(emulator.body, RigidMass):
            return self
        theta = np.asarray(theta, dtype=float)
        if self._mesh is not None:
            return self._simulated_on(self._mesh, theta)
        landing, logs = self.answer(theta)
        tabulated = logs - emulator.plain.at(landing.same_m, landing.kn_N_m)
        same, kn = np.broadcast_arrays(landing.same_m, landing.kn_N_m)
        falls = zip(same[0], kn[0], strict=True)
        plain = [
            replace(emulator.scene(), height_m=float(h), law=Linear(float(kn))) for h, kn in falls
        ]
        nothing = ((0.0, 0.0),) * len(self.effects)
        scenes = self.scenes(theta, range(len(self.drops)), nothing)
        leans = any(EFFECTS[name].leaning for name in acting)
        its = emulator.step_s(float(landing.kn_N_m.max()))
        friction = self.friction(theta) if leans else 0.0
        with np.errstate(invalid="ignore", divide="ignore"):
            change = np.log(emulator.observed(scenes, its, friction))
            change -= np.log(emulator.observed(plain, its, friction))
        shift = change.T - tabulated[:, 0]
        logs = np.where(np.isfinite(shift), shift, 0.0)
        u = self._place(theta)
        if self.correction is None:
            return replace(self, correction=Correction(u, logs, np.zeros((u.size, *logs.shape))))
        return replace(self, correction=self.correction.moved(u, logs))

    def _simulated_on(self, mesh: Mesh, theta: Array) -> Self:
        """`simulated` at the drops of the mesh alone."""
        if self._smooth:
            found = self._few.simulated(theta)
            return self if found is self._few else replace(self, correction=found.correction)
        plain = replace(self._few, correction=None)
        found = plain.simulated(theta)
        if found.correction is None:
            return self
        new = found.correction.spread(mesh)
        if self.correction is not None:
            new = self.correction.moved(new.u, new.logs)
        return replace(self, correction=new)

    def _place(self, theta: Array) -> Array:
        """Points of the unit box (..., p); of a sensor's gain, which moves no drop, always one."""
        u = to_unit(self.parameters, theta)
        if self.gain is not None:
            u[..., len(self.own) - 1] = 0.0
        return u

    def entered(self, theta: Array) -> list[Effect]:
        """The effects at their values, those that change Kn before the law that it enters."""
        given = self.given(theta)
        return [
            effect_at(name, *map(float, given[name][: len(self.emulator.own(name, self.refined))]))
            for name in in_order(self.effects)
        ]

    def friction(self, theta: Array) -> float:
        """The coefficient at which what leans slides: fitted, declared, or the paper's."""
        for name, values in self.given(theta).items():
            if len(values) > len(self.emulator.own(name, self.refined)):
                return float(values[-1])
        known = self.emulator.friction
        return paper.FRICTION if known is None else known

    def scenes(
        self, theta: Array, which: Iterable[int], chance: Sequence[tuple[float, ...]]
    ) -> list[Scene]:
        """Scenes of the drops numbered ``which``, with the effects in; ``chance`` by effect.

        Heights are those from which a fall from rest in a vacuum ends as fast.
        """
        effects, drops, emulator = self.entered(theta), self.drops, self.emulator
        observed = enter_all(Scene(), [e for e in effects if e.place.value == "observation"])
        out = []
        for i in which:
            height = max(float(drops.y0_m[i]) / observed.y_scale - observed.y_offset_m, 1e-5)
            scene = replace(
                emulator.scene(),
                height_m=height,
                order=int(drops.order[i]),
                session=float(np.broadcast_to(drops.session, len(drops))[i]),
                law=Linear(float(theta[0])),
            )
            if self.beta is not None:
                scene = replace(scene, beta_s=float(theta[1]))
            for effect, own in zip(effects, chance, strict=True):
                scene = enter_all(replace(scene, chance=own), [effect])
            drag = scene.drag_kg_m / emulator.body.mass_kg
            same = fallen(height, emulator.gravity_m_s2, scene.release_speed_m_s, drag)
            out.append(replace(scene, height_m=float(same)))
        return out

    def predict(self, theta: Array) -> Array:
        """Whitened predictions (..., nodes, rows) for parameters (..., p)."""
        errors, mesh = self.errors, self._mesh if self._smooth else None
        if errors.values is None:
            return errors.rows(self.everywhere(theta))
        if mesh is None:
            measured, higher = np.split(self._beside.measured(theta), 2, axis=-2)
            slopes = (higher - measured) / (STEP * self.drops.y0_m)[:, None]
            left = errors.whitened(errors.values - measured, slopes)
        else:
            left = errors.whitened_on(mesh, self._few.measured(theta))
        return errors.told - errors.read(left)

    @cached_property
    def _beside(self) -> Self:
        """The model at every drop, and then at a height `STEP` of its own above it."""
        y0_m, twice = self.drops.y0_m, np.tile(np.arange(len(self.drops)), 2)
        heights = np.concatenate([y0_m, y0_m + STEP * y0_m])
        drops = replace(self.drops.of(twice), y0_m=heights, whole=None)
        return replace(self, drops=drops, correction=self.correction and self.correction.of(twice))

    def everywhere(self, theta: Array) -> Array:
        """`measured`, by few drops where these tell of all."""
        return self.by_few(lambda few: few.measured(theta))

    def by_few(self, of: Callable[[DropModel], Array]) -> Array:
        """What a function gives for the model's drops (..., drops, q), which is asked for few of
        them where these tell of all."""
        if self._mesh is None or not self._smooth:
            return of(self)
        return self._mesh.spread(of(self._few))

    def measured(self, theta: Array) -> Array:
        """What instruments show, in SI (..., nodes, drops, quantities)."""
        drops, theta = self.drops, np.asarray(theta, dtype=float)
        b, found = self.bounced(theta)
        if self.correction is not None:
            found = found * np.exp(self.correction.at(self._place(theta)))
        top, time, force = found
        top = risen(top, b.drag_1_m)
        gain = 1.0 if self.gain is None else theta[..., len(self.own) - 1, None, None]
        observed = (b.scale * (top + b.offset_m), b.clock * time, gain * force + 0.0 * b.clock)
        nodes = len(self.weights)
        full = np.broadcast_shapes(*(each.shape for each in observed), (nodes, len(drops)))
        chosen = [np.broadcast_to(observed[q], full) for q in drops.quantities]
        return np.stack(chosen, axis=-1)


def _nodes(low: float, high: float, count: int, closer: int) -> Array:
    return np.linspace(low, high, (count - 1) * closer + 1)
