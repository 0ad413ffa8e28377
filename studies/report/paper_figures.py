"""The paper's Figs. 9 and 13, and Eq. 8, beside the models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...solver import paper
from ...solver.arrays import Array
from .figures import (
    BLACK,
    GREY,
    LOOKS,
    SERIES,
    VERMILION,
    end_labels,
    model_legend,
    panels,
    stiffness_label,
    styled,
)

Curve = tuple[Array, Array]
# Of viridis: what is lighter is hardly seen on white.
LIGHTEST = 0.75
HEIGHTS = {"xlabel": "height before impact y0 (mm)", "ylabel": "height after impact y1 (mm)"}


@styled
def penetration_figure(curves: Mapping[tuple[str, float], Curve]) -> Figure:
    """Fig. 9: penetration (µm) against time since touch (µs); keys are (model, height in m)."""
    figure, axes = panels(height_in=3.8)
    ax: Axes = axes[0, 0]
    heights = sorted({height for _, height in curves})
    models = [model for model in LOOKS if any(m == model for m, _ in curves)]
    colours = dict(zip(heights, SERIES, strict=False))
    for (model, height), (t, depth) in curves.items():
        ax.plot(1e6 * t, 1e6 * depth, color=colours[height], **LOOKS[model].line)
    for height in heights:
        t, depth = curves["analytic", height]
        i = int(np.argmax(depth))
        ax.annotate(
            f"y0 = {1e3 * height:g} mm",
            (1e6 * t[i], 1e6 * depth[i]),
            xytext=(0, 3),
            textcoords="offset points",
            ha="center",
            color=colours[height],
            fontsize=8,
        )
    model_legend(ax, models, loc="upper right")
    ax.set(
        xlabel="time since touch (µs)", ylabel="penetration (µm)", xlim=(0, None), ylim=(0, None)
    )
    ax.set_ylim(0, 1.08 * ax.get_ylim()[1])
    return figure


@styled
def height_figure(histories: Mapping[tuple[str, float, float], Curve]) -> Figure:
    """Fig. 13: tip height (mm) against time (ms), a panel per height; keys (model, height, Kn)."""
    heights = sorted({height for _, height, _ in histories})
    stiffnesses = sorted({kn for _, _, kn in histories})
    models = [model for model in LOOKS if any(m == model for m, _, _ in histories)]
    colours = sequence(len(stiffnesses))
    figure, axes = panels(len(heights), 1, height_in=0.5 + 2.3 * len(heights), sharex=True)
    for ax, height in zip(axes[:, 0], heights, strict=True):
        last = []
        for kn, colour in zip(stiffnesses, colours, strict=True):
            for model in models:
                t, y = histories[model, height, kn]
                look = {"color": colour, **LOOKS[model].line}
                if model != models[0]:  # it lies on the first one's line: black and thin shows both
                    look |= {"color": BLACK, "linewidth": 0.7, "markersize": 2.5}
                ax.plot(1e3 * t, 1e3 * y, **look)
            after = histories[models[0], height, kn]
            last.append(1e3 * float(after[1][len(after[1]) // 2 :].max()))
        ax.set(ylabel="tip height (mm)", ylim=(-0.02e3 * height, 1.05e3 * height))
        ax.set_title(f"y0 = {1e3 * height:g} mm")
        figure.draw_without_rendering()
        end_labels(ax, last, [stiffness_label(kn) for kn in stiffnesses], colours, size=7.0)
    axes[-1, 0].set(xlabel="time after release (ms)", xlim=(0, None))
    model_legend(axes[-1, 0], models, loc="lower left")
    return figure


def sequence(n: int) -> list[tuple[float, ...]]:
    """``n`` colours from dark to light, told apart with any colour vision and on white."""
    shades = matplotlib.colormaps["viridis"]
    return [shades(x) for x in np.linspace(0.0, LIGHTEST, n)]


@styled
def time_to_peak_figure(
    kn_N_m: Array,
    rule_s: Array,
    beam_s: Array,
    points: Sequence[tuple[float, float]],
    printed: Mapping[float, float],
    limit_s: float,
) -> Figure:
    """Eq. 8 beside the beam (line), the solid (``points``: Kn, s) and the ``printed`` values."""
    figure, axes = panels(height_in=3.4)
    ax: Axes = axes[0, 0]
    ax.loglog(kn_N_m / 1e6, 1e6 * rule_s, color=BLACK, ls=":", label="Eq. 8, (π/2)√(m/Kn)")
    ax.loglog(kn_N_m / 1e6, 1e6 * beam_s, color=SERIES[0], label="1-D beam")
    kn, seconds = np.array(points).T
    ax.loglog(
        kn / 1e6,
        1e6 * seconds,
        color=SERIES[0],
        label="3-D reduced",
        ls="none",
        marker="o",
        fillstyle="none",
    )
    kn, seconds = np.array(list(printed.items())).T
    ax.loglog(
        kn / 1e6,
        1e6 * seconds,
        color=VERMILION,
        label="printed in the paper",
        ls="none",
        marker="s",
        fillstyle="none",
    )
    ax.axhline(1e6 * limit_s, color=GREY, lw=0.8)
    ax.annotate(
        "L/c: a wave to the top",
        (kn_N_m[0] / 1e6, 1e6 * limit_s),
        xytext=(3, -3),
        textcoords="offset points",
        va="top",
        fontsize=7.5,
        color="#444444",
    )
    ax.set(xlabel="normal contact stiffness Kn (MN/m)", ylabel="touch to greatest penetration (µs)")
    ax.legend(loc="upper right")
    return figure


def draw_published(ax: Axes, top_mm: float) -> None:
    """What the paper published of Figs. 10 to 12, up to a height: its line, its band, one drop."""
    x = np.array([0.0, top_mm])
    low, high = paper.RATIO_BAND_90
    ax.plot(x, paper.RATIO_MEAN * x, color=BLACK, label="published fit y1 = 0.65 y0")
    ax.plot(x, high * x, color=BLACK, lw=0.8, ls="--", label="30 % and 100 % lines")
    ax.plot(x, low * x, color=BLACK, lw=0.8, ls="--")
    drop = 1e3 * paper.KNOWN_DROP_M[0], 1e3 * paper.KNOWN_DROP_M[1]
    ax.plot(*drop, "D", color=VERMILION, label="the one drop with published numbers")
    ax.set(**HEIGHTS, xlim=(0, top_mm))
