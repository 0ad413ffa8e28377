"""What several studies draw of the paper: its Fig. 13, and what it published of Figs. 10 to 12."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...solver import paper
from ...solver.arrays import Array
from .figures import (
    BLACK,
    BLUE,
    LOOKS,
    SKY,
    VERMILION,
    drawing,
    end_labels,
    model_legend,
    panels,
    sequence,
    stiffness_label,
    styled,
)

Curve = tuple[Array, Array]
HEIGHTS = {"xlabel": "height before impact y0 (mm)", "ylabel": "height after impact y1 (mm)"}


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
        end_labels(ax, last, [stiffness_label(kn) for kn in stiffnesses], colours)
    axes[-1, 0].set(xlabel="time after release (ms)", xlim=(0, None))
    model_legend(axes[-1, 0], models, loc="lower left")
    return figure


@drawing(**HEIGHTS, height_in=3.6, legend="upper left")
def cloud_figure(
    ax: Axes,
    y0_m: Array,
    y1_m: Array,
    label: str = "predicted here, not measured",
    top_mm: float = 55.0,
    slope: float | None = None,
) -> None:
    """Figs. 10 to 12: the published line, band and one drop, and a cloud named ``label``.

    ``slope`` is that of a line that was fitted to the cloud.
    """
    x = np.array([0.0, top_mm])
    low, high = paper.RATIO_BAND_90
    ax.plot(1e3 * y0_m, 1e3 * y1_m, ".", color=SKY, ms=2.5, zorder=1, label=label)
    ax.plot(x, paper.RATIO_MEAN * x, color=BLACK, label="published fit y1 = 0.65 y0")
    ax.plot(x, high * x, color=BLACK, lw=0.8, ls="--", label="30 % and 100 % lines")
    ax.plot(x, low * x, color=BLACK, lw=0.8, ls="--")
    drop = 1e3 * paper.KNOWN_DROP_M[0], 1e3 * paper.KNOWN_DROP_M[1]
    ax.plot(*drop, "D", color=VERMILION, label="the one drop with published numbers")
    if slope is not None:
        words = f"fit of the predicted drops, y1 = {slope:.3f} y0"
        ax.plot(x, slope * x, color=BLUE, label=words)
    ax.set(xlim=(0, top_mm), ylim=(min(0.0, 1e3 * float(y1_m.min())), top_mm))
