"""The wave along a bristle's axis, and the window of a picture that holds all of its motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...solver.arrays import Array
from ...solver.paraview import Phase
from ..inputs.limits import round_down
from .field_series import FieldSeries

SHOWN_MOTION = 0.05
"""Greatest displacement during contact in a picture, over the bristle's length."""
SHOWN_FLIGHT = 0.25
"""The same in flight: what turns far is shown as it is."""
MARGIN = 0.3
"""Free room left and right of the bristle in a picture, in widths."""
SHOWN_WIDTH = 0.2
"""Least width of the bristle in a picture, over that of the window."""
SAME_LEVEL = 1e-6
"""Heights that differ by less, over the length, are one."""
TIP_WIDTHS = 2.0
"""Length of bristle that counts as near the tip, in widths of the section."""


@dataclass(frozen=True)
class Stand:
    """A rigid motion of the undeformed nodes into the world.

    A node at X is at ``turn`` (3, 3) times X - ``touching_m`` (3,): the world's origin is where the
    bristle first touches the ground.
    """

    turn: Array
    touching_m: Array

    @classmethod
    def of(cls, nodes_m: Array, displacement_m: Array) -> Stand:
        """The rigid motion nearest to a displacement (n, 3) of nodes (n, 3), in least squares
        (Kabsch, Acta Crystallographica A 32, 1976)."""
        middle, where = nodes_m.mean(axis=0), (nodes_m + displacement_m).mean(axis=0)
        left, _, right = np.linalg.svd((nodes_m - middle).T @ (nodes_m + displacement_m - where))
        # no mirror image, however thin the bristle
        proper = np.diag([1.0, 1.0, np.sign(np.linalg.det(right.T @ left.T))])
        turn = right.T @ proper @ left.T
        return cls(turn, middle - where @ turn)

    def moved(self, nodes_m: Array, displacement_m: Array) -> Array:
        """The displacement (n, 3) from that stand, along the bristle's axes there."""
        return (nodes_m + displacement_m) @ self.turn + self.touching_m - nodes_m

    def drawn(self, nodes_m: Array, moved_m: Array, factor: float, widening: Array) -> Array:
        """Places in the world, displacements from the stand ``factor`` times as large.

        ``widening`` (3,) makes the bristle larger along its own axes, about where it touches, so
        that it stays above the ground.
        """
        return ((nodes_m - self.touching_m) * widening + factor * moved_m) @ self.turn.T


@dataclass(frozen=True)
class Levels:
    """The nodes of a mesh, level by level from the tip up.

    ``order`` (n,) sorts them by level and, within one, by distance from the axis; ``first``
    (levels,) is where each level begins in it.
    """

    order: NDArray[np.intp]
    first: NDArray[np.intp]

    @classmethod
    def of(cls, nodes_m: Array) -> Levels:
        """The levels of nodes (n, 3)."""
        z = nodes_m[:, 2]
        level = np.round(z / (SAME_LEVEL * np.ptp(z))).astype(np.int64)
        order = np.lexsort((np.hypot(nodes_m[:, 0], nodes_m[:, 1]), level))
        return cls(order, np.unique(level[order], return_index=True)[1])

    @property
    def axis(self) -> NDArray[np.intp]:
        """The node nearest to the axis on each level."""
        return self.order[self.first]

    def bounds(self, values: Array) -> tuple[Array, Array]:
        """Least and greatest of nodes' values (n, k) on each level, (levels, k)."""
        ordered = values[self.order]
        low = np.minimum.reduceat(ordered, self.first, axis=0)
        return low, np.maximum.reduceat(ordered, self.first, axis=0)


@dataclass(frozen=True)
class Wave:
    """A series along the bristle's axis, and the extremes of all of it.

    ``times_s`` (frames,) from the first touch, ``z_m`` (levels,) upward, ``axial_stress_Pa``
    (frames, levels) on the axis; ``greatest_axial_Pa`` of all nodes and frames,
    ``tip_von_mises_Pa`` (frames,) the greatest near the tip; ``low_m``, ``high_m`` (frames, levels,
    3) of the displacement from its ``stand`` at the first frame, along its axes there, and of the
    nodes themselves, ``low_node_m`` and ``high_node_m`` (levels, 3). ``tip_stand`` is that of the
    tip at `tip_frame`. ``normal`` (3,) is the ground's, in the world.
    """

    times_s: Array
    phases: list[Phase]
    z_m: Array
    axial_stress_Pa: Array
    greatest_axial_Pa: float
    tip_von_mises_Pa: Array
    low_m: Array
    high_m: Array
    low_node_m: Array
    high_node_m: Array
    stand: Stand
    tip_stand: Stand
    normal: Array

    @cached_property
    def size_m(self) -> Array:
        """Of the bristle, along its axes (3,)."""
        return self.high_node_m.max(axis=0) - self.low_node_m.min(axis=0)

    @cached_property
    def side(self) -> int:
        """The lateral axis to show: the wide one, unless the bristle leans or bends along the
        other."""
        axis = 0.5 * (self.low_node_m + self.high_node_m)
        motion = 0.5 * (self.low_m + self.high_m)
        path = self.stand.drawn(axis, motion, 1.0, np.ones(3)).reshape(-1, 3)
        spread, rise = np.ptp(path, axis=0)[:2], np.ptp(motion[..., 2])
        return 0 if spread[0] > 2.0 * spread[1] and spread[0] > 0.01 * rise else 1

    @cached_property
    def exaggeration(self) -> float:
        """By how much displacements from the stand are to be multiplied to be seen."""
        motion = np.maximum(np.abs(self.low_m), np.abs(self.high_m)).max(axis=(1, 2))
        contact = contact_frames(self.phases, len(self.times_s))
        there = max(motion[contact].max() / SHOWN_MOTION, motion.max() / SHOWN_FLIGHT)
        return round_factor(self.size_m[2], float(there))

    @cached_property
    def widening(self) -> float:
        """By how much the section is to be widened to show its colours beside its swing."""
        side = self.side
        low, high = self.extent_m(np.ones(3))
        return round_factor(SHOWN_WIDTH * (high - low)[side], self.size_m[side])

    def extent_m(self, widening: Array) -> tuple[Array, Array]:
        """Two corners (3,) of a box in the world that holds every frame as it is drawn."""
        here = self.stand.touching_m
        low = (self.low_node_m - here) * widening + self.exaggeration * self.low_m
        high = (self.high_node_m - here) * widening + self.exaggeration * self.high_m
        forth, back = np.maximum(self.stand.turn, 0.0).T, np.minimum(self.stand.turn, 0.0).T
        least, greatest = low @ forth + high @ back, high @ forth + low @ back
        return least.min(axis=(0, 1)), greatest.max(axis=(0, 1))

    @cached_property
    def widenings(self) -> Array:
        """``widening`` of the side that is shown, and none of the others (3,)."""
        widening = np.ones(3)
        widening[self.side] = self.widening
        return widening

    @cached_property
    def window_m(self) -> tuple[float, float, float, float]:
        """Left, right, bottom, top that hold every frame, as it is drawn, and the ground under
        it."""
        side = self.side
        low, high = self.extent_m(self.widenings)
        room = MARGIN * self.widening * self.size_m[side]
        left, right = float(low[side] - room), float(high[side] + room)
        ground = self.ground_m(np.array([left, right]))
        bottom, top = min(low[2], ground.min()), max(high[2], ground.max())
        room = 0.03 * (top - bottom)
        return left, right, float(bottom - room), float(top + room)

    def ground_m(self, lateral_m: Array) -> Array:
        """Height of the ground at places along the side that is shown."""
        return -self.normal[self.side] / self.normal[2] * lateral_m

    @cached_property
    def tip_frame(self) -> int:
        """The frame of contact with the greatest stress near the tip."""
        return tip_frame(self.phases, self.tip_von_mises_Pa)


def read_wave(
    series: FieldSeries, touch_s: float, advance: Callable[[], None] = lambda: None
) -> Wave:
    """Read all frames of a solid's series; ``touch_s`` is the instant of the first touch.

    ``advance`` is called for each frame. Raises InputError where the series does not tell what is
    needed.
    """
    nodes, normal = series.nodes_m, series.ground_normal()
    levels = Levels.of(nodes)
    near = nodes[:, 2] <= TIP_WIDTHS * np.ptp(nodes[:, :2], axis=0).max()
    stand = Stand.of(nodes, series.read("displacement_m", 0))
    axial, tip, bounds, greatest = [], [], [], 0.0
    for frame in range(len(series.times_s)):
        stress = series.read("axial_stress_Pa", frame)
        axial.append(stress[levels.axis])
        greatest = max(greatest, float(np.abs(stress).max()))
        tip.append(series.read("von_mises_Pa", frame)[near].max())
        bounds.append(levels.bounds(stand.moved(nodes, series.read("displacement_m", frame))))
        advance()
    low_node, high_node = levels.bounds(nodes)
    shown = series.read("displacement_m", tip_frame(series.phases, np.array(tip)))
    return Wave(
        times_s=series.times_s - touch_s,
        phases=series.phases,
        z_m=nodes[levels.axis, 2],
        axial_stress_Pa=np.array(axial),
        greatest_axial_Pa=greatest,
        tip_von_mises_Pa=np.array(tip),
        low_m=np.array([low for low, _ in bounds]),
        high_m=np.array([high for _, high in bounds]),
        low_node_m=low_node,
        high_node_m=high_node,
        stand=stand,
        tip_stand=Stand.of(nodes[near], shown[near]),
        normal=normal,
    )


def contact_frames(phases: list[Phase], count: int) -> list[int]:
    """The frames that show contact, its beginning or its end; all ``count`` where none does."""
    shown = [i for i, phase in enumerate(phases) if phase is not Phase.FLIGHT]
    return shown or list(range(count))


def tip_frame(phases: list[Phase], tip_von_mises_Pa: Array) -> int:
    """The frame of contact with the greatest stress near the tip."""
    contact = contact_frames(phases, len(tip_von_mises_Pa))
    return contact[int(np.argmax(tip_von_mises_Pa[contact]))]


def round_factor(wanted: float, there: float) -> float:
    """1, 2 or 5 times a power of ten, 1 at least, that brings what is there near what is wanted."""
    return round_down(max(wanted / there, 1.0)) if there > 0.0 else 1.0
