"""Figures of a scatter."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import stats

from ...solver import paper
from ...solver.arrays import Array
from ..report.figures import BLACK, BLUE, GREY, SKY, panels, styled
from ..report.paper_figures import draw_published

# More dots than these hide each other and swell the page.
DOTS = 3000
# Drops in a bin of the running median.
IN_A_BIN = 40


@styled
def histogram_figure(ratio: Array) -> Figure:
    """y1/y0 of the drops, with the paper's mean, standard deviation and 90 % band."""
    figure, axes = panels(height_in=3.2)
    ax: Axes = axes[0, 0]
    low, high = paper.RATIO_BAND_90
    top = max(1.3, float(ratio.max()))
    bottom = min(0.0, float(ratio.min()))
    ax.axvspan(low, high, color=SKY, alpha=0.18, lw=0, label=f"measured 90 %: {low:g} to {high:g}")
    edges = list(map(float, np.linspace(bottom, top, 61)))
    ax.hist(ratio, edges, density=True, color=BLUE, label="predicted")
    x = np.linspace(bottom, top, 300)
    ax.plot(
        x,
        stats.norm.pdf(x, paper.RATIO_MEAN, paper.RATIO_STD),
        color=BLACK,
        label=f"normal, measured {paper.RATIO_MEAN} ± {paper.RATIO_STD}",
    )
    ax.set(xlabel="y1/y0", ylabel="drops per unit of y1/y0, share", xlim=(bottom, top))
    ax.legend(loc="upper left")
    return figure


@styled
def cloud_figure(y0_m: Array, y1_m: Array, slope: float, random: np.random.Generator) -> Figure:
    """y1 against y0 as in Figs. 10 to 12: 30 % and 100 % lines, both linear fits.

    Dots are moved aside a little, so that drops from one height do not hide each other.
    """
    figure, axes = panels(height_in=3.6)
    ax: Axes = axes[0, 0]
    top = 1.1e3 * float(max(y0_m.max(), y1_m.max()))
    x = np.array([0.0, top])
    aside = random.uniform(-0.012, 0.012, len(y0_m)) * top
    shown = slice(0, DOTS)
    ax.plot((1e3 * y0_m + aside)[shown], 1e3 * y1_m[shown], ".", color=SKY, ms=2.5, zorder=1)
    draw_published(ax, top)
    ax.plot(x, slope * x, color=BLUE, label=f"fit of the predicted drops, y1 = {slope:.3f} y0")
    ax.set(ylim=(min(0.0, 1e3 * float(y1_m.min())), top))
    ax.legend(loc="upper left")
    return figure


@styled
def lean_figure(lean_deg: Array, ratio: Array) -> Figure:
    """y1/y0 against the angle between the bristle and the ground's normal, with its running
    5th, 50th and 95th percentiles."""
    figure, axes = panels(height_in=3.2)
    ax: Axes = axes[0, 0]
    ax.plot(lean_deg[:DOTS], ratio[:DOTS], ".", color=SKY, ms=2.5, zorder=1)
    bins = max(1, min(20, len(ratio) // IN_A_BIN))
    parts = np.array_split(np.argsort(lean_deg), bins)
    if len(parts) > 1:
        middle = [float(np.median(lean_deg[part])) for part in parts]
        percentiles = np.array([np.percentile(ratio[part], [5, 50, 95]) for part in parts])
        ax.plot(middle, percentiles[:, 1], color=BLUE, label="median")
        ax.plot(middle, percentiles[:, 0], color=BLUE, lw=0.8, ls="--", label="5 and 95 %")
        ax.plot(middle, percentiles[:, 2], color=BLUE, lw=0.8, ls="--")
        ax.legend(loc="best")
    ax.axhline(paper.RATIO_MEAN, color=GREY, lw=0.8)
    ax.set(
        xlabel="lean against the ground under the tip (degrees)",
        ylabel="y1/y0",
        xlim=(0, None),
        ylim=(min(0.0, float(ratio.min())), None),
    )
    return figure
