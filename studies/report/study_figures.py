"""Figure of the number of beam elements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...solver.arrays import Array
from .figures import GREY, SERIES, SMALLEST, panels, stiffness_label, styled

PERCENT = 100.0
FLOOR = 1e-4


@styled
def element_figure(
    elements: Sequence[int], errors: Mapping[tuple[str, float], Array], goal: float
) -> Figure:
    """Error in % against number of elements; a panel per quantity, keys (quantity, Kn).

    Errors below ``FLOOR`` are round-off beside what matters and not drawn.
    """
    quantities = list(dict.fromkeys(quantity for quantity, _ in errors))
    figure, axes = panels(len(quantities), 1, height_in=0.5 + 1.9 * len(quantities), sharex=True)
    for ax, quantity in zip(axes[:, 0], quantities, strict=True):
        stiffnesses = [kn for q, kn in errors if q == quantity]
        for kn, colour in zip(stiffnesses, SERIES, strict=False):
            error = PERCENT * np.abs(errors[quantity, kn])
            ax.loglog(
                elements,
                np.where(error >= FLOOR, error, np.nan),
                "o-",
                color=colour,
                fillstyle="none",
                label=stiffness_label(kn),
            )
        _goal(ax, goal)
        ax.set_title(quantity)
        ax.set(ylabel="error (%)", ylim=(FLOOR, None))
    last = axes[-1, 0]
    last.set_xticks(list(elements), [str(n) for n in elements], fontsize=SMALLEST)
    last.minorticks_off()
    last.set(xlabel="beam elements")
    axes[-1, 0].legend(loc="upper right", title="Kn", title_fontsize=8)
    return figure


def _goal(ax: Axes, goal: float) -> None:
    ax.axhline(PERCENT * goal, color=GREY, lw=0.8, ls="--")
    ax.annotate(
        f"{PERCENT * goal:g} %",
        (1.0, PERCENT * goal),
        xycoords=("axes fraction", "data"),
        xytext=(-3, 2),
        ha="right",
        textcoords="offset points",
        fontsize=7.5,
        color="#444444",
    )
