"""Figures of a scatter."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from scipy import stats

from ...solver import paper
from ...solver.arrays import Array
from ..report.figures import BLACK, BLUE, GREY, SKY, drawing

# More dots than these hide each other and swell the page.
DOTS = 3000
# Drops in a bin of the running median.
IN_A_BIN = 40


@drawing("y1/y0", "drops per unit of y1/y0, share", legend="upper left")
def histogram_figure(ax: Axes, ratio: Array) -> None:
    """y1/y0 of the drops, with the paper's mean, standard deviation and 90 % band."""
    low, high = paper.RATIO_BAND_90
    ends = min(0.0, float(ratio.min())), max(1.3, float(ratio.max()))
    ax.axvspan(low, high, color=SKY, alpha=0.18, lw=0, label=f"measured 90 %: {low:g} to {high:g}")
    ax.hist(ratio, 60, range=ends, density=True, color=BLUE, label="predicted")
    x = np.linspace(*ends, 300)
    density = stats.norm.pdf(x, paper.RATIO_MEAN, paper.RATIO_STD)
    label = f"normal, measured {paper.RATIO_MEAN} ± {paper.RATIO_STD}"
    ax.plot(x, density, color=BLACK, label=label)
    ax.set_xlim(*ends)


@drawing("lean against the ground under the tip (degrees)", "y1/y0", legend=None, xlim=(0, None))
def lean_figure(ax: Axes, lean_deg: Array, ratio: Array) -> None:
    """y1/y0 against the angle between the bristle and the ground's normal, with its running
    5th, 50th and 95th percentiles."""
    ax.plot(lean_deg[:DOTS], ratio[:DOTS], ".", color=SKY, ms=2.5, zorder=1)
    bins = max(1, min(20, len(ratio) // IN_A_BIN))
    parts = np.array_split(np.argsort(lean_deg), bins)
    if len(parts) > 1:
        middle = [float(np.median(lean_deg[part])) for part in parts]
        low, median, high = np.transpose(
            [np.percentile(ratio[part], [5, 50, 95]) for part in parts]
        )
        ax.plot(middle, median, color=BLUE, label="median")
        ax.plot(middle, low, color=BLUE, lw=0.8, ls="--", label="5 and 95 %")
        ax.plot(middle, high, color=BLUE, lw=0.8, ls="--")
        ax.legend()
    ax.axhline(paper.RATIO_MEAN, color=GREY, lw=0.8)
    ax.set_ylim(min(0.0, float(ratio.min())), None)
