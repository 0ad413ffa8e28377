"""Figures of a closed loop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...solver.arrays import Array
from ..loop.finding import Evidence, Finding, Test
from ..loop.heldout import HeldOut
from ..report.figures import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    MARKERS,
    ORANGE,
    PURPLE,
    SKY,
    SMALLEST,
    VERMILION,
    panels,
    styled,
)
from .confirm import Solid
from .rows import COUNTING, Rows, names_of, title_of

BEFORE, AFTER = VERMILION, BLUE
LEAVES = ("leaves something", "leaves nothing")
KINDS: dict[str, dict[str, Any]] = {
    "leaves nothing": {"color": GREEN, "marker": "o", "ls": "none"},
    "leaves something": {"color": ORANGE, "marker": "X", "ls": "none"},
    "not asked": {"color": GREY, "marker": "s", "ls": "none", "fillstyle": "none"},
}
LINE_IN, EDGES_IN = 0.2, 0.9
FARTHEST = 1e3


@styled
def noise_figure(before: Array, after: Array, bins: Array) -> Figure:
    """Shares of residuals (rows,) in standard deviations by ``bins``, and the normal density."""
    figure, axes = panels(height_in=2.8)
    ax: Axes = axes[0, 0]
    for values, colour, label in ((before, BEFORE, "before"), (after, AFTER, "after")):
        share, _ = np.histogram(np.clip(values, bins[0], bins[-1]), bins)
        ax.stairs(share / len(values) / np.diff(bins), bins, color=colour, label=label, lw=1.4)
    x = np.linspace(bins[0], bins[-1], 200)
    normal = np.exp(-0.5 * x**2) / np.sqrt(2.0 * np.pi)
    ax.plot(x, normal, color=GREY, ls="--", lw=1.0, label="normal, as declared")
    ax.set(
        xlabel="residual (standard deviations; what is beyond counts at the ends)",
        ylabel="density",
        ylim=(0, None),
    )
    ax.legend()
    return figure


@styled
def fit_figure(rows: Rows, quantity: str) -> Figure:
    """The main quantity as measured, and the baseline's, against what it was measured at."""
    figure, axes = panels(height_in=3.2)
    ax: Axes = axes[0, 0]
    covariate, x = next(each for each in rows.covariates if each[0].name not in COUNTING)
    mine = rows.main
    values = rows.measured(rows.closed.problem.values)[mine]
    ax.plot(x[mine], values, "o", color=BLACK, fillstyle="none", label="measured")
    baseline = rows.measured(rows.before)[mine]
    ax.plot(x[mine], baseline, "+", color=BEFORE, ms=5, label="baseline, fitted")
    ax.set(xlabel=covariate.words, ylabel=quantity)
    ax.legend()
    return figure


@styled
def residual_figure(rows: Rows) -> Figure:
    """Residuals in standard deviations against every covariate, before and after."""
    covariates = rows.covariates
    quantity = rows.closed.problem.quantity
    names = list(dict.fromkeys(quantity.tolist()))
    figure, axes = panels(len(covariates), 2, height_in=0.4 + 1.9 * len(covariates))
    for column, (residual, words, colour) in enumerate(
        ((rows.left_before, "before", BEFORE), (rows.left_after, "after", AFTER))
    ):
        for line, (covariate, x) in enumerate(covariates):
            ax: Axes = axes[line, column]
            ax.axhspan(-2, 2, color=SKY, alpha=0.2, lw=0)
            ax.axhline(0.0, color=GREY, lw=0.7)
            for name, marker in zip(names, MARKERS * len(names), strict=False):
                mine = quantity == name
                ax.plot(
                    x[mine],
                    residual[mine],
                    marker,
                    color=colour,
                    fillstyle="none",
                    ms=3,
                )
            ax.set(xlabel=covariate.words, ylabel="residual (σ)", title=words if not line else "")
    if len(names) > 1:
        for name, marker in zip(names, MARKERS * len(names), strict=False):
            figure.axes[0].plot([], [], marker, color=BLACK, fillstyle="none", ms=3, label=name)
        figure.legend(loc="outside upper center", ncols=2, fontsize=SMALLEST)
    return figure


@styled
def tests_figure(before: Sequence[Test], after: Sequence[Test], corrected: float) -> Figure:
    """p-value of each test alone, before and after."""
    names = list(dict.fromkeys(test.name for test in (*before, *after)))
    figure, axes = panels(height_in=EDGES_IN + LINE_IN * len(names))
    ax: Axes = axes[0, 0]
    for tests, colour, marker, label in (
        (before, BEFORE, "o", "before"),
        (after, AFTER, "s", "after"),
    ):
        y = [names.index(test.name) for test in tests]
        p = [max(test.p_value, 1e-6) for test in tests]
        ax.plot(p, y, marker, color=colour, fillstyle="none", label=label)
    ax.axvline(corrected, color=GREY, ls=":", lw=1.0, label="corrected for all tests, before")
    _named(ax, [name.replace("_", " ") for name in names])
    ax.set(xscale="log", xlabel="p-value of the test alone", xlim=(None, 1.3))
    figure.legend(loc="outside upper right", fontsize=SMALLEST, ncols=3)
    return figure


@styled
def detectable_figure(shares: Sequence[tuple[str, float | None]]) -> Figure:
    """The least size at which an effect shows, over its typical size."""
    figure, axes = panels(height_in=EDGES_IN + LINE_IN * max(len(shares), 1))
    ax: Axes = axes[0, 0]
    for i, (_, share) in enumerate(shares):
        if share is None:
            words, across = "at no size within its bounds", ax.get_yaxis_transform()
            ax.text(0.01, i, words, size=SMALLEST, color=GREY, va="center", transform=across)
        else:
            ax.plot([share], [i], "o", color=BLUE)
    ax.axvline(1.0, color=GREY, ls=":", lw=1.0)
    _named(ax, [title_of(name) for name, _ in shares])
    shown = [share for _, share in shares if share]
    low, high = min([0.1, *shown]) / 3.0, max([10.0, *shown]) * 3.0
    ax.set(xscale="log", xlim=(low, high), xlabel="least size that shows over a typical size")
    return figure


@styled
def evidence_figure(evidences: Sequence[Evidence], unlisted: float) -> Figure:
    """Log evidence of every model tried over the baseline's."""
    figure, axes = panels(height_in=EDGES_IN + LINE_IN * len(evidences))
    ax: Axes = axes[0, 0]
    base = evidences[0].log_evidence
    for i, each in enumerate(evidences):
        left = each.left_p_value
        kind = "not asked" if left is None else LEAVES[left > 0.02]
        ax.plot([each.log_evidence - base], [i], **KINDS[kind])
    if np.isfinite(unlisted):
        ax.axvline(unlisted - base, color=PURPLE, ls="--", lw=1.0)
    _named(ax, [names_of(each.effects) for each in evidences])
    ax.set(xscale="symlog", xlabel="log evidence gained on the baseline (nats)")
    for label, look in KINDS.items():
        ax.plot([], [], label=label, **look)
    ax.plot([], [], color=PURPLE, ls="--", lw=1.0, label="best shape that no effect has")
    figure.legend(loc="outside upper right", fontsize=SMALLEST, ncols=2)
    return figure


@styled
def weights_figure(finding: Finding) -> Figure:
    """Probability of each effect of the verdict."""
    figure, axes = panels(height_in=EDGES_IN + LINE_IN * len(finding.effects))
    ax: Axes = axes[0, 0]
    weights = [finding.weights[name] for name in finding.effects]
    ax.barh(range(len(weights)), weights, color=BLUE, height=0.6)
    _named(ax, [title_of(name) for name in finding.effects])
    ax.set(xlim=(0, 1.02), xlabel="probability")
    return figure


@styled
def left_figure(expected: Array, before: Array, after: Array) -> Figure:
    """Sorted residuals (rows,) against the quantiles that normal noise would have."""
    figure, axes = panels(height_in=3.0)
    ax: Axes = axes[0, 0]
    ends = np.array([expected[0], expected[-1]])
    ax.plot(ends, ends, color=GREY, lw=0.8, ls="--")
    for values, colour, marker, label in (
        (before, BEFORE, "o", "before"),
        (after, AFTER, "s", "after"),
    ):
        shown = np.clip(values, -FARTHEST, FARTHEST)
        ax.plot(expected, shown, marker, color=colour, fillstyle="none", ms=3, label=label)
    ax.set_yscale("symlog", linthresh=3.0)
    ax.set(xlabel="normal quantile (σ)", ylabel="residual, sorted (σ)")
    ax.legend()
    return figure


@styled
def held_figure(held: HeldOut, quantity: str, labels: Sequence[int]) -> Figure:
    """What was predicted of held-out values before and after, with 90 % intervals, less them."""
    figure, axes = panels(height_in=3.4)
    ax: Axes = axes[0, 0]
    x = np.arange(len(held.values))
    low, high = held.low - held.values, held.high - held.values
    ax.vlines(x, low, high, color=SKY, lw=4, alpha=0.7, label="90 % interval, after")
    ax.plot(x, held.before - held.values, "x", color=BEFORE, label="before")
    ax.plot(x, held.after - held.values, "s", color=AFTER, fillstyle="none", label="after")
    ax.axhline(0.0, color=BLACK, lw=0.8, label="measured")
    starts = [i for i in range(len(labels)) if i == 0 or labels[i] != labels[i - 1]]
    ax.set_xticks(starts, [str(labels[i]) for i in starts])
    ax.set(xlabel="held-out drop, fall or pass (its number)")
    ax.set_ylabel(f"predicted less measured: {quantity}")
    ax.legend(loc="upper left", bbox_to_anchor=(0.0, 1.16), ncols=4, fontsize=SMALLEST)
    return figure


@styled
def solid_figure(solid: Solid, quantity: str) -> Figure:
    """Held-out values against the 3-D model's predictions, before and after."""
    figure, axes = panels(height_in=3.2)
    ax: Axes = axes[0, 0]
    ends = np.array([solid.values.min(), solid.values.max()])
    ax.plot(ends, ends, color=GREY, lw=0.8, ls="--", label="predicted as measured")
    ax.plot(solid.values, solid.before, "x", color=BEFORE, label="3-D, before")
    ax.plot(solid.values, solid.after, "s", color=AFTER, fillstyle="none", label="3-D, after")
    ax.set(xlabel=f"measured: {quantity}", ylabel=f"predicted: {quantity}")
    ax.legend()
    return figure


def _named(ax: Axes, names: Sequence[str]) -> None:
    """Names down the left side, the first on top."""
    ax.set_yticks(range(len(names)), names, fontsize=SMALLEST)
    ax.set_ylim(len(names) - 0.4, -0.6)
