"""Figures of what discretisation costs: errors, and the integration time step that is needed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..report.figures import (
    BLACK,
    GREY,
    LOOKS,
    SERIES,
    SMALLEST,
    beside,
    panels,
    sequence,
    stiffness_label,
    styled,
)

FLOOR_PERCENT = 1e-4
UNBOUNDED = {">=": "^", "<": "v", "": "o"}
ITS_LABEL = "integration time step (ms)"


@styled
def error_figure(
    errors: pd.DataFrame, quantities: Mapping[str, str], goal: float, against: str = ITS_LABEL
) -> Figure:
    """Error in % against ITS, a panel per quantity; colour is Kn, line style the model.

    ``against`` something else than ITS, errors have a few counts as the column ``count``. Errors
    below ``FLOOR_PERCENT`` are round-off beside what matters and not drawn.
    """
    shown = [name for name in quantities if name in set(errors.quantity)]
    models = [model for model in LOOKS if model in set(errors.model)]
    stiffnesses = sorted(set(errors.kn_N_m))
    colours = dict(zip(stiffnesses, sequence(len(stiffnesses)), strict=True))
    figure, axes = panels(len(shown), 1, height_in=0.9 + 2.1 * len(shown), sharex=True)
    counted = against != ITS_LABEL
    for ax, name in zip(axes[:, 0], shown, strict=True):
        own = errors[errors.quantity == name]
        for (model, kn, _), rows in own.groupby(["model", "kn_N_m", "y0_m"]):
            percent = 100.0 * rows.error_relative.abs()
            percent = percent.where(percent >= FLOOR_PERCENT)
            look = {"marker": "o", "fillstyle": "none"} if counted else {}
            x = rows["count"] if counted else 1e3 * rows.its_s
            ax.loglog(x, percent, color=colours[kn], **(look | LOOKS[model].line))
        ax.axhline(100.0 * goal, color=GREY, lw=0.8, ls="--")
        right = 1.0, 100.0 * goal
        beside(ax, f"{right[1]:g} %", right, "right", xycoords=ax.get_yaxis_transform())
        ax.set(title=quantities[name], ylabel="error (%)", ylim=(FLOOR_PERCENT, None))
    axes[-1, 0].set(xlabel=against)
    if counted:
        counts = sorted(set(errors["count"]))
        axes[-1, 0].set_xticks(counts, [str(n) for n in counts], fontsize=SMALLEST)
        axes[-1, 0].minorticks_off()
    lines = [Line2D([], [], color=colour) for colour in colours.values()]
    names = [stiffness_label(kn) for kn in stiffnesses]
    if len(models) > 1:
        lines += [Line2D([], [], color=BLACK, **LOOKS[model].line) for model in models]
        names += [LOOKS[model].label for model in models]
    figure.legend(lines, names, loc="outside upper center", ncols=4, title="Kn")
    return figure


@styled
def need_figure(needs: pd.DataFrame, quantities: Mapping[str, str], paper_its_s: float) -> Figure:
    """The longest good ITS against Kn, a panel per quantity, beside Eq. 8 and the paper's choice.

    An arrow up or down marks a bound: the longest or the shortest step that was computed.
    Solids have open markers.
    """
    shown = [name for name in quantities if name in set(needs.quantity)]
    figure, axes = panels(len(shown), 1, height_in=0.7 + 1.9 * len(shown), sharex=True, sharey=True)
    rule = needs[needs.rule_s > 0.0].drop_duplicates("kn_N_m").sort_values("kn_N_m")
    for ax, name in zip(axes[:, 0], shown, strict=True):
        for (model, look), colour in zip(LOOKS.items(), SERIES, strict=False):
            own = needs[(needs.quantity == name) & (needs.model == model)]
            points = own[np.isfinite(own.kn_N_m)].sort_values(["kn_N_m", "its_needed_s"])
            if own.empty:
                continue
            kn, its = points.kn_N_m / 1e6, 1e3 * points.its_needed_s
            ax.loglog(kn, its, color=colour, label=look.label, **{**look.line, "marker": None})
            solid = model in ("reduced", "solid")
            fill, size = ("none", 5.0) if solid else ("full", 3.0)
            for bound, marker in UNBOUNDED.items():
                mine = points.bound == bound
                ax.plot(kn[mine], its[mine], marker, color=colour, fillstyle=fill, ms=size)
        ax.loglog(rule.kn_N_m / 1e6, 1e3 * rule.rule_s, "k:", label="tp − ti, Eq. 8")
        label = f"{1e3 * paper_its_s:g} ms, the paper's"
        ax.axhline(1e3 * paper_its_s, color=GREY, lw=0.8, label=label)
        ax.set(title=quantities[name], ylabel="greatest ITS (ms)")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=2)
    axes[-1, 0].set(xlabel="normal contact stiffness Kn (MN/m)")
    return figure
