"""The shape of a brush from two sides, coloured by bending stress."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.figure import Figure

from ...solver.arrays import Array
from ...solver.rods.frame import TipState
from ..report.figures import BLUE, GREY, VERMILION

# Of a view of the brush, over its height.
LEAST_WIDTH = 0.4
TONES = "viridis"
# What a tip does, and its colour in a picture.
TIPS = {TipState.STICK: ("sticks", BLUE), TipState.SLIP: ("slips", VERMILION)}


def spread(count: int, most: int) -> list[int]:
    """Numbers of as many as ``most`` of so many things, spread over all of them."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int)).tolist()


class Sides:
    """Two axes beside each other that show bristles along y and along x, in mm.

    ``low`` and ``high`` (3,) in mm are the corners of what is to be in view, ``stress_MPa`` is the
    top of the scale of colours.
    """

    def __init__(
        self, figure: Figure, axes: tuple[Axes, Axes], low: Array, high: Array, stress_MPa: float
    ) -> None:
        self.lines: list[LineCollection] = []
        self.tips: list[list[PathCollection]] = []
        # equally wide, so that both have one scale
        half = 0.55 * max(*(high - low)[:2], LEAST_WIDTH * high[2])
        for ax, side, name in zip(axes, (0, 1), "xy", strict=True):
            drawn = LineCollection([], cmap=TONES, linewidths=1.0)
            drawn.set_clim(0.0, max(stress_MPa, 1e-9))
            ax.add_collection(drawn)
            self.lines.append(drawn)
            self.tips.append(
                [ax.scatter([], [], s=9.0, color=colour, zorder=3) for _, colour in TIPS.values()]
            )
            ax.axhline(0.0, color=GREY, lw=0.8)
            middle = 0.5 * (low[side] + high[side])
            ax.set(xlabel=f"{name} from the hub (mm)", aspect="equal")
            ax.set(xlim=(middle - half, middle + half), ylim=(-0.05 * high[2], 1.05 * high[2]))
            ax.locator_params(axis="x", nbins=4)
        axes[0].set_ylabel("height (mm)")
        self.bar = figure.colorbar(drawn, ax=list(axes), label="bending stress (MPa)", shrink=0.8)

    def show(self, points_mm: Array, stress_MPa: Array, states: Array | None = None) -> None:
        """Draw bristles (n, nodes, 3) with their stress (n, nodes); and their tips if it is told
        what each does (n,), see `TipState`."""
        tone = 0.5 * (stress_MPa[:, :-1] + stress_MPa[:, 1:]).ravel()
        for side, (drawn, tips) in enumerate(zip(self.lines, self.tips, strict=True)):
            seen = points_mm[:, :, [side, 2]]
            pieces = np.stack([seen[:, :-1], seen[:, 1:]], axis=2).reshape(-1, 2, 2)
            drawn.set_segments(list(pieces))
            drawn.set_array(tone)
            if states is not None:
                for state, dots in zip(TIPS, tips, strict=True):
                    dots.set_offsets(seen[states == state, -1])
