"""Contact force over time, tabulated over height, stiffness and an effect's size.

Tables like `table.Table`, of whole histories in place of three numbers: the vertical force over
the speed of impact, its mean in each of `CELLS` equal times from the first touch. All tables of a
dataset together are brought to a few shapes, those that carry most of their variance (singular
value decomposition), and hold the amounts of these: a history is their sum.

The force is the momentum that the centre of mass gains beyond gravity's, so dashpots and adhesion
are in it, and it is what a load cell under the surface would show were it rigid and fast.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from ....solver import paper
from ....solver.arrays import Array
from ....solver.batch import COLUMN, symmetric_part
from ....solver.bodies.modal import ModalBody
from ....solver.bristle import Bristle
from ....solver.contact.enforcement import ContactMethod
from ....solver.contact.laws import Coulomb, Linear, mindlin_ratio
from ....solver.drop import DropPlan, ModalFrame, simulate
from ....solver.effects.base import Scene
from ....solver.effects.library import EFFECTS
from ....solver.errors import ComputationError
from ....solver.ground import Ground
from ....solver.rigid import slope_normal
from ...running.steps import with_shorter_its
from .emulator import Change, Emulator, effect_at
from .table import Axis, Table, coefficients
from .table_drops import beam_of, leans

CELLS = 640
KN_NODES = 31
LEAN_KN_NODES = 11
SIDE_NODES = 9
# Where a force is limited, histories have a kink as its limit passes the peak.
HELD_NODES = 25
# Decades to each side of the baseline's stiffness, which records tell to some per cent.
KN_DECADES = 0.5
# Steps of a march, of an upright bristle and of one that leans, which is slower.
ITS_S, LEAN_ITS_S = 5e-7, 2e-6
# A multiple of `table.AT_ONCE`.
SHAPES = 24
CLOCK = "clock_error"
CHECKS = 4


@lru_cache(maxsize=64)
def _body(bristle: Bristle, beta_s: float, loss_factor: float, upright: bool) -> ModalBody:
    body = replace(beam_of(bristle), beta_s=beta_s, loss_factor=loss_factor)
    column = symmetric_part(body, COLUMN) if upright else None
    return body if column is None else column.body


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
class ForceEmulator(Emulator):
    """Tables of histories, each ``length_s`` long, of force over speed of impact in N s/m: their
    amounts of ``shapes`` (shapes, cells) or, where there are none, they themselves (..., cells)."""

    length_s: float = 1e-3
    shapes: Array | None = field(default=None, repr=False, compare=False)

    @property
    def simulated(self) -> tuple[str, ...]:
        """The clock's among them: it stretches whole histories."""
        return (*super().simulated, CLOCK)

    def of_impacts(self, names: Sequence[str]) -> list[str]:
        """Those of these effects that change the impact, and not what its clock shows."""
        impacts = super().simulated
        return [name for name in names if name in impacts]

    @property
    def known_shapes(self) -> Array:
        """The shapes, which there have to be."""
        assert self.shapes is not None
        return self.shapes

    def around(self, kn_N_m: float) -> tuple[float, float]:
        """Stiffnesses near one, rounded so that others share the tables."""
        middle = round(4.0 * math.log10(kn_N_m)) / 4.0
        low, high = self.kn_range_N_m
        near = (10.0 ** (middle - KN_DECADES), 10.0 ** (middle + KN_DECADES))
        return max(low, near[0]), min(high, near[1])

    @property
    def cell_s(self) -> float:
        return self.length_s / CELLS

    def frictions(self) -> tuple[float, ...]:
        """The declared coefficient, or the paper's."""
        return (paper.FRICTION if self.friction is None else self.friction,)

    def curve(self, scene: Scene, finer: float = 1.0) -> Array:
        """Force over speed of impact (cells,); NaN where the drop fails at all time steps.

        Steps are ``finer`` times shorter than those of the tables.
        """
        step = self.step_s(scene.law.kn_N_m)
        step = min(step, LEAN_ITS_S if leans(scene) else ITS_S) / finer
        edges = self.cell_s * np.arange(CELLS + 1)
        g, mu = self.gravity_m_s2, self.frictions()[0]
        try:
            t, impulse = with_shorter_its(
                lambda its: force_history(self.bristle, scene, g, mu, its, self.length_s), step
            )
        except ComputationError:
            return np.full(CELLS, np.nan)
        gained = np.diff(np.interp(edges, t, impulse))
        return np.asarray(gained / (self.cell_s * self.speed_m_s(scene.height_m)))

    def table(
        self,
        name: str,
        sides: Sequence[Axis],
        change: Change,
        kn_nodes: int,
        friction: float | None = None,
    ) -> Table:
        """Of fewer nodes than one of three numbers."""
        kn = Axis(*self.kn_range_N_m, KN_NODES if friction is None else LEAN_KN_NODES, "log")
        fewer = [
            replace(a, n=HELD_NODES if name in self.scaled else min(a.n, SIDE_NODES)) for a in sides
        ]
        axes = (self.heights(), kn, *fewer)
        return self._in_shapes(axes, self.tabulated(f"curves {name}", axes, change, friction))

    def filled(self, nodes: Sequence[Array], change: Change, friction: float | None) -> Array:
        """Histories (..., cells)."""
        out = np.empty((*map(len, nodes), CELLS))
        own = replace(self, friction=friction)  # as the table's key has it
        for index, scene in self.scenes(nodes, change):
            out[index] = own.curve(scene)
        return out

    def _in_shapes(self, axes: tuple[Axis, ...], values: Array) -> Table:
        """The table of histories ``values`` (..., cells)."""
        if self.shapes is None:
            return Table(axes, values)
        return Table(axes, coefficients(values @ self.shapes.T / CELLS, len(axes)))

    def _make(self, name: str, friction: float | None) -> Table:
        if name != CLOCK:
            return super()._make(name, friction)
        plain, only = replace(self, shapes=None).plain, EFFECTS[CLOCK].parameters[0]
        axis = Axis(only.low, only.high, SIDE_NODES)
        places = np.arange(CELLS) + 0.5
        stretched = [
            [np.interp(places / (1.0 + x), places, row, right=0.0) for x in axis.nodes()]
            for row in plain.coefficients.reshape(-1, CELLS)
        ]
        values = np.reshape(stretched, (*plain.coefficients.shape[:-1], axis.n, CELLS))
        return self._in_shapes((*plain.axes, axis), values)


def with_shapes(emulator: ForceEmulator, names: Sequence[str]) -> ForceEmulator:
    """The emulator with the shapes that tables of these effects need.

    Each shape's mean square over `CELLS` is one.
    """
    histories = replace(emulator, shapes=None)
    moment = np.zeros((CELLS, CELLS))
    known = [histories.of(name)[0] for name in names if name in histories.simulated]
    for table in (histories.plain, *known):
        rows = table.coefficients.reshape(-1, CELLS)
        moment += rows.T @ rows / len(rows)
    _, vectors = np.linalg.eigh(moment)
    shapes = vectors[:, ::-1][:, :SHAPES].T * math.sqrt(CELLS)
    return replace(emulator, shapes=np.ascontiguousarray(shapes))


def table_errors(emulator: ForceEmulator, names: Sequence[str], kn_N_m: float) -> Array:
    """By how much tables miss direct simulations of finer steps near ``kn_N_m``, between nodes.

    Root mean squares (shapes,) in N s/m over the baseline and these effects at their usual sizes.
    """
    rng = np.random.default_rng(0)
    misses = []
    alike = [name for name in emulator.of_impacts(names) if not EFFECTS[name].random]
    for name in ("", *alike):
        for _ in range(CHECKS):
            height = rng.uniform(emulator.lowest_m, emulator.highest_m)
            kn = kn_N_m * 10.0 ** rng.uniform(-0.2, 0.2)
            scene = replace(emulator.scene(), height_m=height, law=Linear(kn))
            at = np.array(height), np.array(kn)
            tabulated = emulator.plain.at(*at)
            if name:
                typical = [each.typical for each in emulator.own(name)]
                scene = effect_at(name, *typical).enter(scene)
                tabulated = tabulated + emulator.change(name, *at, *typical)
            found = emulator.curve(scene, finer=2.0) @ emulator.known_shapes.T / CELLS
            if np.isfinite(found).all():
                misses.append(tabulated - found)
    return np.asarray(np.sqrt(np.mean(np.square(misses), axis=0)))
