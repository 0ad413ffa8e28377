"""Figures of a calibration."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from ...solver import paper
from ...solver.arrays import Array
from ..report.figures import BLACK, BLUE, DARK, GREY, SKY, VERMILION, beside, drawing
from ..report.paper_figures import HEIGHTS
from .curve import RatioCurve
from .estimate import RatioEstimate

MN = 1e6


@drawing(**HEIGHTS, height_in=3.4, legend="upper left", ylim=(0, None))
def measured_figure(ax: Axes, y0_m: Array, y1_m: Array, ratio: RatioEstimate) -> None:
    """Drops, the fitted line through the origin, and the band of single drops."""
    x = np.array([0.0, 1.05e3 * float(np.max(y0_m))])
    band, slope = ratio.population, ratio.mean.estimate
    label = f"90 % of drops: {band.low:.2f} to {band.high:.2f}"
    ax.fill_between(x, band.low * x, band.high * x, color=SKY, alpha=0.25, lw=0, label=label)
    ax.plot(x, slope * x, color=BLUE, label=f"y1 = {slope:.3f} y0")
    ax.plot(x, x, color=GREY, lw=0.8, ls="--", label="y1 = y0")
    ax.plot(1e3 * y0_m, 1e3 * y1_m, "o", color=BLACK, fillstyle="none", label="drops")
    ax.set_xlim(*x)


@drawing("normal contact stiffness Kn (MN/m)", "y1/y0", height_in=3.4, legend=None)
def curve_figure(
    ax: Axes, curve: RatioCurve, ratio: RatioEstimate, paper_points: bool = False
) -> None:
    """y1/y0 against Kn with the measured ratio, its interval, and the band of single drops."""
    shown = curve.kn_N_m[(curve.kn_N_m >= 9e3) & (curve.kn_N_m <= 1.1e9)]
    grid = np.geomspace(shown[0], shown[-1], 300)
    band, mean = ratio.population, ratio.mean
    ax.axhspan(band.low, band.high, color=SKY, alpha=0.18, lw=0)
    ax.axhspan(mean.low, mean.high, color=BLUE, alpha=0.25, lw=0)
    ax.semilogx(grid / MN, curve.at(grid), color=BLACK)
    for level, words, colour, above in (
        (mean.estimate, f"measured {mean.estimate:.3g}, 90 % interval of the mean", BLUE, True),
        (band.high, f"{band.high:.2f}: upper end of single drops", DARK, False),
        (band.low, f"{band.low:.2f}: lower end of single drops", DARK, False),
    ):
        ax.axhline(level, color=colour, lw=0.8)
        across = ax.get_yaxis_transform()
        beside(ax, words, (1.0, level), "right", above, xycoords=across, color=colour)
    kn = curve.stiffness(mean.estimate) / MN
    if 0.0 < kn < np.inf:
        ax.plot(kn, mean.estimate, "o", color=BLUE)
        words = f"Kn = {kn:.3g} MN/m"
        beside(ax, words, (kn, mean.estimate), "right", False, color=BLUE, fontsize=8)
    if paper_points:
        points = np.array(list(paper.RATIO_AT_KN.items())) / (MN, 1.0)
        label = "the paper's model"
        ax.plot(*points.T, "s", color=VERMILION, fillstyle="none", label=label)
        ax.legend(loc="upper right", bbox_to_anchor=(1.0, 0.88))
    ax.set_xlim(grid[0] / MN, grid[-1] / MN)
    ax.set_ylim(min(0.2, band.low - 0.05), max(1.05, band.high + 0.03))
