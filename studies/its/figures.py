"""Figures of the study of the integration time step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..report.figures import BLACK, GREY, LOOKS, SERIES, panels, stiffness_label, styled
from ..report.paper_figures import sequence
from .convergence import Need

Key = tuple[str, float, float]
Curve = tuple[np.ndarray, np.ndarray]

FLOOR_PERCENT = 1e-4
UNBOUNDED = {">=": "^", "<": "v", "": "o"}


@styled
def error_figure(
    errors: Mapping[tuple[str, Key], Curve], quantities: Mapping[str, str], goal: float
) -> Figure:
    """Error in % against ITS, a panel per quantity; colour is Kn, line style the model."""
    shown = [name for name in quantities if any(n == name for n, _ in errors)]
    models = _models(errors)
    stiffnesses = sorted({kn for _, (_, kn, _) in errors})
    colours = dict(zip(stiffnesses, sequence(len(stiffnesses)), strict=True))
    figure, axes = panels(len(shown), 1, height_in=0.9 + 2.1 * len(shown), sharex=True)
    for ax, name in zip(axes[:, 0], shown, strict=True):
        for (quantity, (model, kn, _)), (its_s, error) in errors.items():
            if quantity == name:
                label = stiffness_label(kn) if model == models[0] else None
                percent = np.maximum(100.0 * np.abs(error), FLOOR_PERCENT)
                ax.loglog(1e3 * its_s, percent, color=colours[kn], label=label, **LOOKS[model].line)
        ax.axhline(100.0 * goal, color=GREY, lw=0.8, ls="--")
        ax.set_title(quantities[name])
        ax.set(ylabel="error (%)")
    stiffness, labels = axes[0, 0].get_legend_handles_labels()
    lines = [Line2D([], [], color=BLACK, **LOOKS[model].line) for model in models]
    names = [*dict.fromkeys(labels), *(LOOKS[model].label for model in models)]
    once = {label: handle for handle, label in zip(stiffness, labels, strict=True)}
    figure.legend([*once.values(), *lines], names, loc="outside upper center", ncols=4, title="Kn")
    axes[-1, 0].set(xlabel="integration time step (ms)")
    return figure


@styled
def need_figure(
    needs: Mapping[tuple[str, Key], Need],
    quantities: Mapping[str, str],
    rule_s: Mapping[float, float],
    paper_its_s: float,
) -> Figure:
    """The longest good ITS against Kn, a panel per quantity, beside Eq. 8 and the paper's choice.

    An arrow up or down marks a bound: the longest or the shortest step that was computed.
    Solids have open markers.
    """
    shown = [name for name in quantities if any(n == name for n, _ in needs)]
    models = _models(needs)
    stiffnesses = np.array(sorted(kn for kn in rule_s if rule_s[kn] > 0.0))
    figure, axes = panels(len(shown), 1, height_in=0.7 + 1.9 * len(shown), sharex=True, sharey=True)
    colours = dict(zip(LOOKS, SERIES, strict=False))
    for ax, name in zip(axes[:, 0], shown, strict=True):
        for model in models:
            _need_points(ax, needs, name, model, colours[model])
        rule = [1e3 * rule_s[kn] for kn in stiffnesses]
        ax.loglog(stiffnesses / 1e6, rule, color=BLACK, ls=":", label="tp − ti, Eq. 8")
        ax.axhline(
            1e3 * paper_its_s, color=GREY, lw=0.8, label=f"{1e3 * paper_its_s:g} ms, the paper's"
        )
        ax.set_title(quantities[name])
        ax.set(ylabel="greatest ITS (ms)")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=2)
    axes[-1, 0].set(xlabel="normal contact stiffness Kn (MN/m)")
    return figure


def _need_points(
    ax: Axes, needs: Mapping[tuple[str, Key], Need], name: str, model: str, colour: Any
) -> None:
    points = sorted(
        (kn, need.its_s, need.bound)
        for (quantity, (m, kn, _)), need in needs.items()
        if quantity == name and m == model and np.isfinite(kn)
    )
    kn, its_s = (np.array([point[i] for point in points]) for i in (0, 1))
    look = LOOKS[model]
    line = {**look.line, "marker": None}
    ax.loglog(kn / 1e6, 1e3 * its_s, color=colour, label=look.label, **line)
    for k, h, bound in points:
        solid = model in ("reduced", "solid")
        fill, size = ("none", 5.0) if solid else ("full", 3.0)
        ax.plot(k / 1e6, 1e3 * h, UNBOUNDED[bound], color=colour, fillstyle=fill, ms=size)


def _models(keyed: Mapping[tuple[str, Key], object]) -> list[str]:
    return [model for model in LOOKS if any(m == model for _, (m, _, _) in keyed)]
