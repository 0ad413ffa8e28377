"""Figures of a calibration, and the paper's Figs. 10 to 12."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...solver import paper
from ...solver.arrays import Array
from ..report.figures import BLACK, BLUE, GREY, SKY, VERMILION, panels, styled
from ..report.paper_figures import HEIGHTS, draw_published
from .curve import RatioCurve
from .estimate import RatioEstimate

MN = 1e6
DARK = "#444444"


@styled
def measured_figure(y0_m: Array, y1_m: Array, ratio: RatioEstimate) -> Figure:
    """Drops, the fitted line through the origin, and the band of single drops."""
    figure, axes = panels(height_in=3.4)
    ax: Axes = axes[0, 0]
    top = 1.05e3 * float(np.max(y0_m))
    x = np.array([0.0, top])
    band = ratio.population
    ax.fill_between(
        x,
        band.low * x,
        band.high * x,
        color=SKY,
        alpha=0.25,
        lw=0,
        label=f"90 % of drops: {band.low:.2f} to {band.high:.2f}",
    )
    ax.plot(x, ratio.mean.estimate * x, color=BLUE, label=f"y1 = {ratio.mean.estimate:.3f} y0")
    ax.plot(x, x, color=GREY, lw=0.8, ls="--", label="y1 = y0")
    ax.plot(1e3 * y0_m, 1e3 * y1_m, "o", color=BLACK, fillstyle="none", label="drops")
    ax.set(**HEIGHTS, xlim=(0, top), ylim=(0, None))
    ax.legend(loc="upper left")
    return figure


@styled
def curve_figure(curve: RatioCurve, ratio: RatioEstimate, paper_points: bool = False) -> Figure:
    """y1/y0 against Kn with the measured ratio, its interval, and the band of single drops."""
    figure, axes = panels(height_in=3.4)
    ax: Axes = axes[0, 0]
    shown = (curve.kn_N_m >= 9e3) & (curve.kn_N_m <= 1.1e9)
    grid = np.geomspace(curve.kn_N_m[shown][0], curve.kn_N_m[shown][-1], 300)
    ends = (grid[0] / MN, grid[-1] / MN)
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
        ax.annotate(
            words,
            (1.0, level),
            xycoords=("axes fraction", "data"),
            xytext=(-3, 3 if above else -3),
            textcoords="offset points",
            ha="right",
            va="bottom" if above else "top",
            fontsize=7.5,
            color=colour,
        )
    found = curve.stiffness(mean.estimate)
    if 0.0 < found < np.inf:
        ax.plot([found / MN], [mean.estimate], "o", color=BLUE)
        ax.annotate(
            f"Kn = {found / MN:.3g} MN/m",
            (found / MN, mean.estimate),
            xytext=(-6, -4),
            textcoords="offset points",
            fontsize=8,
            color=BLUE,
            ha="right",
            va="top",
        )
    if paper_points:
        kn = np.array(list(paper.RATIO_AT_KN))
        ax.plot(
            kn / MN,
            list(paper.RATIO_AT_KN.values()),
            "s",
            color=VERMILION,
            fillstyle="none",
            label="the paper's model",
        )
        ax.legend(loc="upper right", bbox_to_anchor=(1.0, 0.88))
    ax.set(
        xlabel="normal contact stiffness Kn (MN/m)",
        ylabel="y1/y0",
        xlim=ends,
        ylim=(min(0.2, band.low - 0.05), max(1.05, band.high + 0.03)),
    )
    return figure


@styled
def cloud_figure(y0_m: Array, y1_m: Array, label: str = "predicted here, not measured") -> Figure:
    """Figs. 10 to 12: the published line, band and one drop, and a cloud named ``label``."""
    figure, axes = panels(height_in=3.6)
    ax: Axes = axes[0, 0]
    top = 55.0
    ax.plot(
        1e3 * y0_m,
        1e3 * y1_m,
        ".",
        color=SKY,
        ms=2.5,
        zorder=1,
        label=label,
    )
    draw_published(ax, top)
    ax.set(ylim=(0, top))
    ax.legend(loc="upper left")
    return figure
