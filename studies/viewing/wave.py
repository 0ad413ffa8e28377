"""What does a series of fields say about the wave in the bristle, and in which window to see it?"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...solver.paraview import Phase
from .field_series import Array, FieldSeries
from .stand import Stand

SHOWN_MOTION = 0.05
"""Greatest displacement during contact in a picture, over the bristle's length."""
MARGIN = 0.3
"""Free room left and right of the bristle in a picture, in widths."""
SHOWN_WIDTH = 0.2
"""Least width of the bristle in a picture, over that of the window."""
SAME_LEVEL = 1e-6
"""Heights that differ by less, over the length, are one."""


@dataclass(frozen=True)
class Wave:
    """A series along the bristle's axis, and the extremes of all of it.

    ``times_s`` (frames,) from the first touch, ``z_m`` (levels,) upward, ``axial_stress_Pa``
    (frames, levels) on the axis; ``greatest_axial_Pa`` of all nodes and frames,
    ``tip_von_mises_Pa`` (frames,) the greatest near the tip; ``low_m``, ``high_m`` (frames, 3) of
    the displacement from its ``stand`` at the first frame, along its axes there; ``size_m`` (3,) of
    the bristle. ``shift_m`` (frames,) is the greatest displacement from where the mesh is.
    """

    times_s: Array
    phases: list[Phase]
    z_m: Array
    axial_stress_Pa: Array
    greatest_axial_Pa: float
    tip_von_mises_Pa: Array
    low_m: Array
    high_m: Array
    size_m: Array
    stand: Stand
    shift_m: Array

    @property
    def side(self) -> int:
        """The lateral axis to show: the wide one, unless the bristle bends along the other."""
        swing = self.high_m.max(axis=0) - self.low_m.min(axis=0)
        return 0 if swing[0] > 2.0 * swing[1] and swing[0] > 0.01 * swing[2] else 1

    @property
    def exaggeration(self) -> float:
        """By how much displacements from the stand are to be multiplied to be seen."""
        contact = self._contact()
        motion = max(np.abs(self.low_m[contact]).max(), np.abs(self.high_m[contact]).max())
        return round_factor(SHOWN_MOTION * self.size_m[2], motion)

    @property
    def world_exaggeration(self) -> float:
        """The same for displacements from where the mesh is, lean included."""
        return round_factor(SHOWN_MOTION * self.size_m[2], self.shift_m[self._contact()].max())

    @property
    def widening(self) -> float:
        """By how much the section is to be widened to show its colours beside its swing."""
        side = self.side
        swing = max(self.high_m[:, side].max(), 0.0) - min(self.low_m[:, side].min(), 0.0)
        return round_factor(SHOWN_WIDTH * self.exaggeration * swing, self.size_m[side])

    def _contact(self) -> list[int]:
        contact = [i for i, phase in enumerate(self.phases) if phase is not Phase.FLIGHT]
        return contact or list(range(len(self.times_s)))

    @property
    def window_m(self) -> tuple[float, float, float, float]:
        """Left, right, bottom, top that hold every frame, as it is drawn."""
        side, factor = self.side, self.exaggeration
        width, length = self.widening * self.size_m[side], self.size_m[2]
        half, room = 0.5 * width, MARGIN * width
        return (
            float(-half + factor * min(self.low_m[:, side].min(), 0.0) - room),
            float(half + factor * max(self.high_m[:, side].max(), 0.0) + room),
            float(factor * min(self.low_m[:, 2].min(), 0.0) - 0.03 * length),
            float(length + factor * max(self.high_m[:, 2].max(), 0.0) + 0.03 * length),
        )


def read_wave(series: FieldSeries, touch_s: float) -> Wave:
    """Read all frames of a solid's series; ``touch_s`` is the instant of the first touch."""
    nodes = series.nodes_m
    axis, size = axis_nodes(nodes), np.ptp(nodes, axis=0)
    near_tip = nodes[:, 2] <= 2.0 * size[:2].max()
    stand = Stand.of(nodes, series.read("displacement_m", 0))
    axial, tip, low, high, shift, greatest = [], [], [], [], [], 0.0
    for frame in range(len(series.times_s)):
        stress = series.read("axial_stress_Pa", frame)
        moved = series.read("displacement_m", frame)
        shift.append(np.abs(moved).max())
        displacement = stand.moved(nodes, moved)
        axial.append(stress[axis])
        greatest = max(greatest, float(np.abs(stress).max()))
        tip.append(series.read("von_mises_Pa", frame)[near_tip].max())
        low.append(displacement.min(axis=0))
        high.append(displacement.max(axis=0))
    return Wave(
        times_s=series.times_s - touch_s,
        phases=series.phases,
        z_m=nodes[axis, 2],
        axial_stress_Pa=np.array(axial),
        greatest_axial_Pa=greatest,
        tip_von_mises_Pa=np.array(tip),
        low_m=np.array(low),
        high_m=np.array(high),
        size_m=size,
        stand=stand,
        shift_m=np.array(shift),
    )


def round_factor(wanted: float, there: float) -> float:
    """1, 2 or 5 times a power of ten, 1 at least, that brings what is there near what is wanted."""
    ratio = wanted / there if there > 0.0 else 1.0
    if ratio < 1.0:
        return 1.0
    decade = 10.0 ** math.floor(math.log10(ratio))
    return max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= ratio)


def axis_nodes(nodes_m: Array) -> NDArray[np.intp]:
    """The node nearest to the axis on each level, from the tip up."""
    level = np.round(nodes_m[:, 2] / (SAME_LEVEL * np.ptp(nodes_m[:, 2]))).astype(np.int64)
    order = np.lexsort((np.hypot(nodes_m[:, 0], nodes_m[:, 1]), level))
    _, first = np.unique(level[order], return_index=True)
    return order[first]
