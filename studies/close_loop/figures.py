"""Figures of a closed loop."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...solver.arrays import Array
from ..loop.adequacy import Test
from ..loop.finding import Evidence, Finding
from ..loop.heldout import HeldOut
from ..loop.noise import Ints
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
    drawing,
    panels,
    styled,
)
from .confirm import Solid
from .rows import COUNTING, Closed, names_of, title_of

BEFORE, AFTER = VERMILION, BLUE
LOOK: dict[str, Any] = {"ls": "none", "fillstyle": "none"}
LOOK_BEFORE = LOOK | {"marker": "o", "color": BEFORE, "label": "before"}
LOOK_AFTER = LOOK | {"marker": "s", "color": AFTER, "label": "after"}
LEAVES = ("leaves something", "leaves nothing")
KINDS: dict[str, dict[str, Any]] = {
    "leaves nothing": {"color": GREEN, "marker": "o", "ls": "none"},
    "leaves something": {"color": ORANGE, "marker": "X", "ls": "none"},
    "not asked": {"color": GREY, "marker": "s", "ls": "none", "fillstyle": "none"},
}
LINE_IN, EDGES_IN = 0.2, 0.9
FARTHEST = 1e3
# An axis has room for so many numbers.
MOST_LABELS = 30


@drawing(
    "residual (standard deviations; what is beyond counts at the ends)",
    "density",
    height_in=2.8,
    ylim=(0, None),
)
def noise_figure(ax: Axes, before: Array, after: Array, bins: Array) -> None:
    """Counts of residuals in standard deviations by ``bins``, and the normal density."""
    for count, colour, label in ((before, BEFORE, "before"), (after, AFTER, "after")):
        ax.stairs(count / count.sum() / np.diff(bins), bins, color=colour, label=label, lw=1.4)
    x = np.linspace(bins[0], bins[-1], 200)
    normal = np.exp(-0.5 * x**2) / np.sqrt(2.0 * np.pi)
    ax.plot(x, normal, color=GREY, ls="--", lw=1.0, label="normal, as declared")


@drawing()
def fit_figure(ax: Axes, closed: Closed, quantity: str) -> None:
    """The main quantity as measured, and the baseline's, against what it was measured at."""
    covariate, x = next(each for each in closed.covariates if each[0].name not in COUNTING)
    mine = closed.problem.is_main
    measured, fitted = (
        closed.measured(each)[mine] for each in (closed.problem.values, closed.means[0])
    )
    ax.plot(x[mine], measured, "o", color=BLACK, fillstyle="none", label="measured")
    ax.plot(x[mine], fitted, "+", color=BEFORE, ms=5, label="baseline, fitted")
    ax.set(xlabel=covariate.words, ylabel=quantity)


@styled
def residual_figure(closed: Closed) -> Figure:
    """Residuals in standard deviations against every covariate, before and after."""
    covariates = closed.covariates
    quantity = closed.problem.quantity
    names = list(dict.fromkeys(quantity.tolist()))
    figure, axes = panels(len(covariates), 2, height_in=0.4 + 1.9 * len(covariates))
    sides = zip(axes.T, closed.left, ("before", "after"), (BEFORE, AFTER), strict=True)
    markers = dict(zip(names, itertools.cycle(MARKERS), strict=False))
    for column, residual, words, colour in sides:
        column[0].set_title(words)
        for ax, (covariate, x) in zip(column, covariates, strict=True):
            ax.axhspan(-2, 2, color=SKY, alpha=0.2, lw=0)
            ax.axhline(0.0, color=GREY, lw=0.7)
            for name, marker in markers.items():
                mine = quantity == name
                look = {"color": colour, "fillstyle": "none", "ms": 3}
                ax.plot(x[mine], residual[mine], marker, **look)
            ax.set(xlabel=covariate.words, ylabel="residual (σ)")
    if len(names) > 1:
        for name, marker in markers.items():
            figure.axes[0].plot([], [], marker, color=BLACK, fillstyle="none", ms=3, label=name)
        figure.legend(loc="outside upper center", ncols=2, fontsize=SMALLEST)
    return figure


@drawing("p-value of the test alone", legend=None, xscale="log", xlim=(None, 1.3))
def tests_figure(ax: Axes, before: Sequence[Test], after: Sequence[Test], corrected: float) -> None:
    """p-value of each test alone, before and after."""
    names = list(dict.fromkeys(test.name for test in (*before, *after)))
    for tests, look in ((before, LOOK_BEFORE), (after, LOOK_AFTER)):
        p = [max(test.p_value, 1e-6) for test in tests]
        ax.plot(p, [names.index(test.name) for test in tests], **look)
    ax.axvline(corrected, color=GREY, ls=":", lw=1.0, label="corrected for all tests, before")
    _named(ax, [name.replace("_", " ") for name in names])
    _legend_above(ax, 3)


@drawing("least size that shows over a typical size", legend=None, xscale="log")
def detectable_figure(ax: Axes, shares: Sequence[tuple[str, float | None]]) -> None:
    """The least size at which an effect shows, over its typical size."""
    for i, (_, share) in enumerate(shares):
        if share is None:
            words, across = "at no size within its bounds", ax.get_yaxis_transform()
            ax.text(0.01, i, words, size=SMALLEST, color=GREY, va="center", transform=across)
        else:
            ax.plot(share, i, "o", color=BLUE)
    ax.axvline(1.0, color=GREY, ls=":", lw=1.0)
    _named(ax, [title_of(name) for name, _ in shares])
    shown = [share for _, share in shares if share]
    ax.set_xlim(min([0.1, *shown]) / 3.0, max([10.0, *shown]) * 3.0)


@drawing("log evidence gained on the baseline (nats)", legend=None, xscale="symlog")
def evidence_figure(ax: Axes, evidences: Sequence[Evidence], unlisted: float) -> None:
    """Log evidence of every model tried over the baseline's."""
    base = evidences[0].log_evidence
    for i, each in enumerate(evidences):
        left = each.left_p_value
        kind = "not asked" if left is None else LEAVES[left > 0.02]
        ax.plot(each.log_evidence - base, i, **KINDS[kind])
    best: dict[str, Any] = {"color": PURPLE, "ls": "--", "lw": 1.0}
    if np.isfinite(unlisted):
        ax.axvline(unlisted - base, **best)
    _named(ax, [names_of(each.effects) for each in evidences])
    for label, look in {**KINDS, "best shape that no effect has": best}.items():
        ax.plot([], [], label=label, **look)
    _legend_above(ax, 2)


@drawing("share in the verdict", legend=None, xlim=(0, 1.02))
def weights_figure(ax: Axes, finding: Finding) -> None:
    """Share of each effect in the verdict."""
    weights = [finding.weights[name] for name in finding.effects]
    ax.barh(range(len(weights)), weights, color=BLUE, height=0.6)
    _named(ax, [title_of(name) for name in finding.effects])


@drawing("normal quantile (σ)", "residual, sorted (σ)", height_in=3.0)
def left_figure(ax: Axes, expected: Array, before: Array, after: Array) -> None:
    """Sorted residuals (rows,) against the quantiles that normal noise would have."""
    ends = expected[[0, -1]]
    ax.plot(ends, ends, color=GREY, lw=0.8, ls="--")
    for values, look in ((before, LOOK_BEFORE), (after, LOOK_AFTER)):
        ax.plot(expected, np.clip(values, -FARTHEST, FARTHEST), ms=3, **look)
    ax.set_yscale("symlog", linthresh=3.0)


@drawing("held-out drop, fall or pass (its number)", height_in=3.4, legend=None)
def held_figure(ax: Axes, held: HeldOut, quantity: str, labels: Ints) -> None:
    """What was predicted of held-out values before and after, with 90 % intervals, less them."""
    x = np.arange(len(held.values))
    low, high = held.low - held.values, held.high - held.values
    ax.vlines(x, low, high, color=SKY, lw=4, alpha=0.7, label="90 % interval, after")
    ax.plot(x, held.before - held.values, "x", color=BEFORE, label="before")
    ax.plot(x, held.after - held.values, **LOOK_AFTER)
    ax.axhline(0.0, color=BLACK, lw=0.8, label="measured")
    starts = [i for i in range(len(labels)) if i == 0 or labels[i] != labels[i - 1]]
    starts = starts[:: math.ceil(len(starts) / MOST_LABELS)]
    ax.set_xticks(starts, [str(labels[i]) for i in starts])
    ax.set_ylabel(f"predicted less measured: {quantity}")
    ax.legend(loc="upper left", bbox_to_anchor=(0.0, 1.16), ncols=4, fontsize=SMALLEST)


@drawing()
def solid_figure(ax: Axes, solid: Solid, quantity: str) -> None:
    """Held-out values against the 3-D model's predictions, before and after."""
    ends = np.array([solid.values.min(), solid.values.max()])
    ax.plot(ends, ends, color=GREY, lw=0.8, ls="--", label="predicted as measured")
    ax.plot(solid.values, solid.before, "x", color=BEFORE, label="3-D, before")
    ax.plot(solid.values, solid.after, **LOOK_AFTER | {"label": "3-D, after"})
    ax.set(xlabel=f"measured: {quantity}", ylabel=f"predicted: {quantity}")


def _named(ax: Axes, names: Sequence[str]) -> None:
    """Names down the left side, the first on top, of a figure that is as high as they need."""
    assert isinstance(ax.figure, Figure)
    ax.figure.set_figheight(EDGES_IN + LINE_IN * max(len(names), 1))
    ax.set_yticks(range(len(names)), names, fontsize=SMALLEST)
    ax.set_ylim(len(names) - 0.4, -0.6)


def _legend_above(ax: Axes, columns: int) -> None:
    ax.figure.legend(loc="outside upper right", fontsize=SMALLEST, ncols=columns)
