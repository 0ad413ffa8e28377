"""What do the accounts of the lost 35 % predict: distributions of y1/y0, and clouds of drops?"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import norm

from ...solver import paper
from ...solver.bristle import Array
from ..page.figures import BLACK, GREY, SERIES, SKY, SMALLEST, VERMILION, panels, styled

EDGES = np.linspace(-0.1, 1.3, 57)
TOP_MM = 55.0
TITLE_WIDTH = 34


def density(ratio: Array) -> Array:
    """Density of y1/y0 (any shape) between ``EDGES``, smoothed over three bins."""
    counts = np.histogram(ratio, EDGES)[0].astype(float)
    smooth = np.convolve(counts, [0.25, 0.5, 0.25], mode="same")
    return smooth / (np.size(ratio) * np.diff(EDGES))


@styled
def distribution_figure(densities: Mapping[str, Array]) -> Figure:
    """Densities of y1/y0 as filmed, by account, beside the measured normal and its band.

    One panel an account, so that black and white print and any colour vision can tell them apart.
    """
    rows = (len(densities) + 1) // 2
    figure, axes = panels(rows, 2, height_in=0.5 + 1.55 * rows, sharex=True, sharey=True)
    middle = 0.5 * (EDGES[1:] + EDGES[:-1])
    for ax, (name, values), colour in zip(_flat(axes), densities.items(), SERIES, strict=False):
        ax.axvspan(*paper.RATIO_BAND_90, color=SKY, alpha=0.18, lw=0)
        ax.plot(middle, norm.pdf(middle, paper.RATIO_MEAN, paper.RATIO_STD), color=BLACK, lw=0.9)
        ax.fill_between(middle, values, color=colour, alpha=0.35, lw=0, step="mid")
        ax.plot(middle, values, color=colour, drawstyle="steps-mid")
        ax.set_title(textwrap.fill(name, TITLE_WIDTH), fontsize=SMALLEST)
        ax.set(xlim=(EDGES[0], EDGES[-1]), ylim=(0, 4))
    _trim(axes, len(densities))
    figure.supxlabel("y1/y0 as filmed", fontsize=9)
    figure.supylabel("density", fontsize=9)
    return figure


@styled
def clouds_figure(clouds: Mapping[str, tuple[Array, Array]]) -> Figure:
    """26 drops of each account as Figs. 10 to 12 show the measured ones; heights in m."""
    rows = (len(clouds) + 1) // 2
    figure, axes = panels(rows, 2, height_in=0.5 + 1.9 * rows, sharex=True, sharey=True)
    x = np.array([0.0, TOP_MM])
    low, high = paper.RATIO_BAND_90
    for ax, (name, (y0, y1)), colour in zip(_flat(axes), clouds.items(), SERIES, strict=False):
        ax.plot(x, paper.RATIO_MEAN * x, color=BLACK, lw=0.9)
        ax.plot(x, high * x, color=GREY, lw=0.8, ls="--")
        ax.plot(x, low * x, color=GREY, lw=0.8, ls="--")
        ax.plot(1e3 * y0, 1e3 * y1, "o", color=colour, fillstyle="none", ms=3.0)
        known = [[1e3 * height] for height in paper.KNOWN_DROP_M]
        ax.plot(*known, "D", color=VERMILION if colour != VERMILION else BLACK, ms=3.5)
        ax.set_title(textwrap.fill(name, TITLE_WIDTH), fontsize=SMALLEST)
        ax.set(xlim=(0, TOP_MM), ylim=(0, TOP_MM))
    _trim(axes, len(clouds))
    figure.supxlabel("height before impact y0 (mm)", fontsize=9)
    figure.supylabel("height after impact y1 (mm)", fontsize=9)
    return figure


def _flat(axes: np.ndarray) -> Sequence[Axes]:
    return list(axes.ravel())


def _trim(axes: np.ndarray, used: int) -> None:
    for ax in _flat(axes)[used:]:
        ax.set_axis_off()
