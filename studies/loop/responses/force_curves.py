"""Contact force over time, tabulated over height, stiffness and an effect's size.

Tables like `table.Table`, of whole histories in place of three numbers: the vertical force over
the speed of impact, its mean in each of `CELLS` equal times from the first touch. All tables of a
dataset together are brought to a few shapes, those that carry most of their variance (singular
value decomposition), and hold the amounts of these: a history is their sum.

The force is the momentum that the centre of mass gains beyond gravity's, so dashpots and adhesion
are in it, and it is what a load cell under the surface would show were it rigid and fast.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import ClassVar

import numpy as np

from ....solver import paper
from ....solver.arrays import Array
from ....solver.batch import as_column
from ....solver.bodies.modal import ModalBody
from ....solver.bristle import Bristle
from ....solver.cache import cached, sources
from ....solver.contact.enforcement import ContactMethod
from ....solver.contact.laws import Coulomb, Linear, mindlin_ratio
from ....solver.drop import DropPlan, ModalFrame, simulate
from ....solver.effects.base import Scene
from ....solver.effects.library import EFFECTS
from ....solver.errors import ComputationError
from ....solver.ground import Ground
from ....solver.rigid import slope_normal
from ...running.retry import with_shorter_its
from .response import MADE_BY, SCALED, Emulator, Tables, effect_at, simulated
from .spline import coefficients, evaluate
from .table import Axis, Table, mended
from .table_drops import beam_of, its_s

CELLS = 640
HEIGHT_NODES = 4
KN_NODES = 31
LEAN_KN_NODES = 11
SIDE_NODES = 9
# Where a force is limited, histories have a kink as its limit passes the peak.
HELD_NODES = 25
# Decades to each side of the baseline's stiffness, which records tell to some per cent.
KN_DECADES = 0.5
# Steps of a march, of an upright bristle and of one that leans, which is slower.
ITS_S, LEAN_ITS_S = 5e-7, 2e-6
SHAPES = 24
"""A multiple of three, which `spline.evaluate` takes at a time."""
CLOCK = "clock_error"
RANDOM = tuple(name for name, effect in EFFECTS.items() if effect.random)
CHECKS = 4
Change = Callable[[Scene, tuple[float, ...]], Scene]


def leans(scene: Scene) -> bool:
    """Whether a bristle meets the surface otherwise than upright."""
    return any((scene.tilt_deg, scene.tilt_wide_deg, scene.slope_deg, scene.slope_wide_deg))


@lru_cache(maxsize=64)
def _body(bristle: Bristle, beta_s: float, loss_factor: float, upright: bool) -> ModalBody:
    body = replace(beam_of(bristle), beta_s=beta_s, loss_factor=loss_factor)
    return (as_column(body) or body) if upright else body


def force_history(
    bristle: Bristle,
    scene: Scene,
    gravity_m_s2: float,
    friction: float,
    its: float,
    length_s: float,
) -> tuple[Array, Array]:
    """Times (n,) in s from the first touch, and the vertical impulse (n,) in N s up to each.

    It ends with the impact, or after ``length_s`` where that lasts longer. The scene's height is
    that of a fall from rest in a vacuum. Raises ComputationError.
    """
    upright = not leans(scene)
    body = _body(bristle, scene.beta_s, scene.loss_factor, upright)
    mu = 0.0 if upright else friction
    normal = slope_normal(scene.slope_deg, scene.slope_wide_deg)
    speed = math.sqrt(2.0 * gravity_m_s2 * scene.height_m)
    plan = DropPlan(
        height_m=scene.height_m,
        method=ContactMethod(scene.law, friction=Coulomb(mu, mindlin_ratio(paper.POISSON))),
        its_s=its,
        gravity_m_s2=gravity_m_s2,
        until_s=speed / gravity_m_s2 + length_s,
        impact_only=True,
        tilt_deg=scene.tilt_deg,
        tilt_wide_deg=scene.tilt_wide_deg,
        ground=Ground.plane(len(body.contact.weights), normal),
    )
    history = simulate(ModalFrame(body), plan).history.array()
    t, centre = history[:, 0] - speed / gravity_m_s2, history[:, 2]
    # where a flight ends and a touch begins one instant stands twice
    rows = (t > -1e-9) & np.append(np.diff(t) > 1e-3 * its, True)
    t, centre = t[rows], centre[rows]
    middle = 0.5 * (t[1:] + t[:-1])
    gained = body.mass_kg * (np.diff(centre) / np.diff(t) + speed + gravity_m_s2 * middle)
    return np.concatenate([[0.0], middle, t[-1:]]), np.concatenate([[0.0], gained, gained[-1:]])


@dataclass(frozen=True)
class Curves:
    """Histories over ``axes``: ``values`` (..., cells) in N s/m, force over speed of impact."""

    axes: tuple[Axis, ...]
    values: Array


@dataclass(frozen=True)
class ForceEmulator(Emulator):
    """Where tables of histories are made, each ``length_s`` long."""

    length_s: float = 1e-3
    made_by: ClassVar[tuple[Path, ...]] = (*MADE_BY, Path(__file__))

    def around(self, kn_N_m: float) -> tuple[float, float]:
        """Stiffnesses near one, rounded so that others share the tables."""
        middle = round(4.0 * math.log10(kn_N_m)) / 4.0
        low, high = self.kn_range_N_m
        near = (10.0 ** (middle - KN_DECADES), 10.0 ** (middle + KN_DECADES))
        return max(low, near[0]), min(high, near[1])

    @property
    def cell_s(self) -> float:
        return self.length_s / CELLS

    @property
    def known_friction(self) -> float:
        """The declared coefficient, or the paper's."""
        return paper.FRICTION if self.friction is None else self.friction

    def frictions(self) -> tuple[float, ...]:
        return (self.known_friction,)

    def curve(self, scene: Scene, finer: float = 1.0) -> Array:
        """Force over speed of impact (cells,); NaN where the drop fails at all time steps.

        Steps are ``finer`` times shorter than those of the tables.
        """
        step = its_s(self.bristle, scene.law.kn_N_m)
        step = min(step, LEAN_ITS_S if leans(scene) else ITS_S) / finer
        edges = self.cell_s * np.arange(CELLS + 1)
        speed = math.sqrt(2.0 * self.gravity_m_s2 * scene.height_m)
        g, mu = self.gravity_m_s2, self.known_friction
        try:
            t, impulse = with_shorter_its(
                lambda its: force_history(self.bristle, scene, g, mu, its, self.length_s), step
            )
        except ComputationError:
            return np.full(CELLS, np.nan)
        return np.asarray(np.diff(np.interp(edges, t, impulse)) / (self.cell_s * speed))

    def curves(self, name: str, sides: Sequence[Axis], change: Change) -> Curves:
        """Histories over height, stiffness and ``sides``, kept from run to run."""
        kn_nodes = LEAN_KN_NODES if name in EFFECTS and EFFECTS[name].leaning else KN_NODES
        kn = Axis(*self.kn_range_N_m, kn_nodes, "log")
        fewer = [
            replace(a, n=HELD_NODES if name in SCALED else min(a.n, SIDE_NODES)) for a in sides
        ]
        axes = (Axis(self.lowest_m, self.highest_m, HEIGHT_NODES, "root"), kn, *fewer)
        key = f"curves {name} {axes} {self} {sources(*self.made_by)}"
        return Curves(axes, cached(key, lambda: {"values": self._curves(axes, change)})["values"])

    def _curves(self, axes: tuple[Axis, ...], change: Change) -> Array:
        nodes = [axis.nodes() for axis in axes]
        out = np.empty((*(axis.n for axis in axes), CELLS))
        for index in itertools.product(*(range(axis.n) for axis in axes)):
            height, kn, *point = (float(each[i]) for each, i in zip(nodes, index, strict=True))
            scene = replace(self.plain(), height_m=height, law=Linear(kn))
            out[index] = self.curve(change(scene, tuple(point)))
        return mended(out)


@dataclass(frozen=True)
class Scores(Table):
    """Amounts of shapes over ``axes``: splines through them, (..., shapes)."""

    def at(self, *places: Array) -> Array:
        """Amounts (shapes, ...) at places along the axes, arrays that broadcast."""
        spots = np.broadcast_arrays(
            *(axis.where(x) for axis, x in zip(self.axes, places, strict=True))
        )
        flat = np.stack([np.ravel(spot) for spot in spots], axis=1)
        sizes = np.array(self.coefficients.shape[:-1])
        rows = self.coefficients.reshape(-1, self.coefficients.shape[-1])
        parts = []
        for first in range(0, rows.shape[1], 3):
            out = np.empty((len(flat), 3))
            evaluate(np.ascontiguousarray(rows[:, first : first + 3]), sizes, flat, out)
            parts.append(out.T)
        return np.asarray(np.concatenate(parts).reshape(-1, *spots[0].shape))


@dataclass(frozen=True)
class CurveEmulator(ForceEmulator):
    """An emulator whose tables are the histories' amounts of ``shapes`` (shapes, cells)."""

    shapes: Array = field(default_factory=lambda: np.zeros((0, CELLS)), repr=False, compare=False)

    def table(
        self,
        name: str,
        sides: Sequence[Axis],
        change: Change,
        kn_nodes: int,
        friction: float | None = None,
    ) -> Scores:
        found = self.curves(name, sides, change)
        amounts = found.values @ self.shapes.T / CELLS
        return Scores(found.axes, coefficients(amounts, len(found.axes)))


class _Histories(ForceEmulator):
    """An emulator that keeps what it is asked for in ``found``, as histories."""

    def table(
        self,
        name: str,
        sides: Sequence[Axis],
        change: Change,
        kn_nodes: int,
        friction: float | None = None,
    ) -> Table:
        found = self.curves(name, sides, change)
        return Table(found.axes, found.values)


@dataclass(frozen=True)
class ForceTables(Tables):
    """The tables of an emulator of histories, with the clock's as one more."""

    @property
    def simulated(self) -> tuple[str, ...]:
        return (*simulated(), CLOCK)

    def _make(self, name: str, friction: float | None) -> Table:
        if name != CLOCK:
            return super()._make(name, friction)
        assert isinstance(self.emulator, ForceEmulator)
        stretched = stretched_curves(self.emulator)
        assert isinstance(self.emulator, CurveEmulator)
        amounts = stretched.values @ self.emulator.shapes.T / CELLS
        return Scores(stretched.axes, coefficients(amounts, len(stretched.axes)))


def plain_curves(emulator: ForceEmulator) -> Curves:
    """Histories without effects."""
    return emulator.curves("plain", (), lambda scene, _: scene)


def stretched_curves(emulator: ForceEmulator) -> Curves:
    """Histories as a clock shows them that is slow or fast."""
    plain, only = plain_curves(emulator), EFFECTS[CLOCK].parameters[0]
    axis = Axis(only.low, only.high, SIDE_NODES)
    places = np.arange(CELLS) + 0.5
    flat = plain.values.reshape(-1, CELLS)
    values = np.stack(
        [
            np.array([np.interp(places / (1.0 + x), places, row, right=0.0) for row in flat])
            for x in axis.nodes()
        ],
        axis=1,
    )
    return Curves((*plain.axes, axis), values.reshape(*plain.values.shape[:-1], axis.n, CELLS))


def with_shapes(emulator: ForceEmulator, names: Sequence[str]) -> CurveEmulator:
    """The emulator with the shapes that tables of these effects need.

    Each shape's mean square over `CELLS` is one.
    """
    own = {field.name: getattr(emulator, field.name) for field in fields(ForceEmulator)}
    histories = Tables(_Histories(**own))
    moment = np.zeros((CELLS, CELLS))
    for name in ("", *names):
        if name == CLOCK:
            values = stretched_curves(emulator).values
        elif name and name not in simulated():
            continue
        else:
            (only,) = histories.of(name) if name else (histories.plain,)
            values = only.coefficients
        rows = values.reshape(-1, CELLS)
        moment += rows.T @ rows / len(rows)
    _, vectors = np.linalg.eigh(moment)
    shapes = vectors[:, ::-1][:, :SHAPES].T * math.sqrt(CELLS)
    return CurveEmulator(**own, shapes=np.ascontiguousarray(shapes))


def table_errors(tables: ForceTables, names: Sequence[str], kn_N_m: float) -> Array:
    """By how much tables miss direct simulations of finer steps near ``kn_N_m``, between nodes.

    Root mean squares (shapes,) in N s/m over the baseline and these effects at their usual sizes.
    """
    emulator = tables.emulator
    assert isinstance(emulator, CurveEmulator)
    rng = np.random.default_rng(0)
    misses = []
    for name in ("", *(n for n in names if n in simulated() and n not in RANDOM)):
        for _ in range(CHECKS):
            height = rng.uniform(emulator.lowest_m, emulator.highest_m)
            kn = kn_N_m * 10.0 ** rng.uniform(-0.2, 0.2)
            scene = replace(emulator.plain(), height_m=height, law=Linear(kn))
            tabulated = tables.plain.at(np.array(height), np.array(kn))
            if name:
                typical = [each.typical for each in EFFECTS[name].parameters]
                scene = effect_at(name, *typical).enter(scene)
                tabulated = tabulated + tables.change(
                    name, np.array(height), np.array(kn), *typical
                )
            found = emulator.curve(scene, finer=2.0) @ emulator.shapes.T / CELLS
            if np.isfinite(found).all():
                misses.append(tabulated - found)
    return np.asarray(np.sqrt(np.mean(np.square(misses), axis=0)))
