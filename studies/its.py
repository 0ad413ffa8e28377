"""`bristle its`: the integration time step that each quantity needs, against stiffness.

Writes table.csv, errors.csv, needs.csv, their figures and its.json. Also a script:
``mpirun -n 4 python3 -m bristle.studies.its --models beam``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.optimize import brentq

from ..solver import paper
from ..solver.analytic import quarter_period_s
from ..solver.arrays import Array
from ..solver.errors import ComputationError
from .command.script import as_script
from .inputs.fields import Heights, Steps
from .report.figures import (
    BLACK,
    GREY,
    LOOKS,
    SERIES,
    SMALLEST,
    beside,
    panels,
    picture,
    picture_files,
    sequence,
    stiffness_label,
    styled,
    write_picture,
)
from .running.files import write_atomically
from .running.study import TABLE_FILE, Row, Study, StudyInputs, run_study

ITS_S = (1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 3e-7, 1e-7)
GOAL = 0.01
ERRORS, NEEDS = "errors", "needs"
ERRORS_FILE, NEEDS_FILE = f"{ERRORS}.csv", f"{NEEDS}.csv"
FILES = (ERRORS_FILE, NEEDS_FILE, *picture_files(ERRORS), *picture_files(NEEDS))
FEWEST_STEPS = 3
QUANTITIES = {
    "rebound_ratio": "rebound ratio y1/y0",
    "peak_force_N": "peak force",
    "contact_time_s": "contact time",
    "max_penetration_m": "greatest penetration",
}
CASE = ["model", "kn_N_m", "y0_m", "quantity"]
ERROR_COLUMNS = [*CASE, "its_s", "value", "converged", "order", "error_relative"]
NEED_COLUMNS = [*CASE, "goal", "its_needed_s", "bound", "rule_s"]
# Orders of which extrapolation is trusted: none of the schemes has another.
ORDERS = (0.8, 2.5)
FLOOR_PERCENT = 1e-4
UNBOUNDED = {">=": "^", "<": "v", "": "o"}
ITS_LABEL = "integration time step (ms)"


@dataclass(frozen=True)
class Limit:
    """What a quantity converges to; ``order`` is None where it was not clean enough to use."""

    value: float
    order: float | None


def limit(its_s: Array, values: Array) -> Limit:
    """Richardson's extrapolation from the three shortest steps, or the value at the shortest.

    ``its_s`` (n,) and ``values`` (n,) in any order. The order p solves
    (f₃ - f₂) / (f₂ - f₁) = (h₃ᵖ - h₂ᵖ) / (h₂ᵖ - h₁ᵖ) for h₁ < h₂ < h₃; it must lie in ``ORDERS``,
    and what is added must be smaller than the last change.
    """
    order = np.argsort(its_s)
    h, f = np.asarray(its_s, float)[order], np.asarray(values, float)[order]
    p = _order(h[:3], f[:3]) if len(h) >= 3 else None
    if p is None:
        return Limit(float(f[0]), None)
    slope = (f[1] - f[0]) / (h[1] ** p - h[0] ** p)
    return Limit(float(f[0] - slope * h[0] ** p), p)


def _order(h: Array, f: Array) -> float | None:
    near, far = f[1] - f[0], f[2] - f[1]
    round_off = 1e-12 * np.abs(f).max()
    if abs(near) <= round_off or far / near <= 0.0:
        return None

    def excess(p: float) -> float:
        return float((h[2] ** p - h[1] ** p) / (h[1] ** p - h[0] ** p) - far / near)

    low, high = ORDERS
    if excess(low) * excess(high) > 0.0:
        return None
    return float(brentq(excess, low, high))


@dataclass(frozen=True)
class Need:
    """The longest step that keeps an error small: ``its_s``, or a bound on it.

    ``bound`` is "" for a value between two steps that were computed, ">=" where the longest of
    them is short enough, "<" where the shortest is not.
    """

    its_s: float
    bound: str


def need(its_s: Array, errors: Array, goal: float) -> Need:
    """The longest step up to which every |error| stays below ``goal``, between steps by powers.

    ``its_s`` (n,) and relative ``errors`` (n,) in any order; NaN counts as too large.
    """
    order = np.argsort(its_s)
    h, e = np.asarray(its_s, float)[order], np.abs(np.asarray(errors, float))[order]
    bad = np.flatnonzero(~(e <= goal))
    if not len(bad):
        return Need(float(h[-1]), ">=")
    first = int(bad[0])
    if first == 0:
        return Need(float(h[0]), "<")
    good_e, bad_e = max(e[first - 1], 1e-3 * goal), e[first]
    if not math.isfinite(bad_e):
        return Need(float(h[first - 1]), ">=")
    share = math.log(goal / good_e) / math.log(bad_e / good_e)
    return Need(float(h[first - 1] * (h[first] / h[first - 1]) ** share), "")


def shortest(its_s: Array, values: Array) -> Limit:
    """The value at the shortest step, for what is too rough to extrapolate."""
    return Limit(float(values[np.argmin(its_s)]), None)


def compare(
    drops: pd.DataFrame,
    quantities: Iterable[str],
    goal: float,
    mass_kg: float,
    converged: Callable[[Array, Array], Limit] = limit,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The error of every step, and the step that each quantity needs (`need`) beside Eq. 8.

    Of ``drops`` those of one model, Kn and height differ in ITS alone; quantities that are not
    known of any of them are left out, and an unknown one is too far off. Where ``converged`` is the
    `shortest` step, that has no row.
    """
    errors: list[tuple[Any, ...]] = []
    needs: list[tuple[Any, ...]] = []
    for key, members in drops.groupby(["model", "kn_N_m", "y0_m"], sort=False):
        for name in quantities:
            its_s, values = members.its_s.to_numpy(), members[name].to_numpy(float)
            known = ~np.isnan(values)
            if not known.any():
                continue  # no rebound was asked for
            found = converged(its_s[known], values[known])
            error = values / found.value - 1.0
            kept = its_s > (its_s[known].min() if converged is shortest else 0.0)
            errors += [
                (*key, name, step, value, found.value, found.order, e)
                for step, value, e in zip(its_s[kept], values[kept], error[kept], strict=True)
            ]
            longest = need(its_s[kept], error[kept], goal)
            rule = quarter_period_s(mass_kg, key[1])
            needs.append((*key, name, goal, longest.its_s, longest.bound, rule))
    return pd.DataFrame(errors, columns=ERROR_COLUMNS), pd.DataFrame(needs, columns=NEED_COLUMNS)


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


class ItsInputs(StudyInputs):
    """As a sweep's, with a list of time steps and one height."""

    heights_m: Heights = paper.HEIGHTS_M[-1:]
    its_s: Steps = ITS_S


def study_of(inputs: ItsInputs) -> Study:
    """The study of time steps.

    Errors are against Richardson's limit of the three shortest steps where their order is clean,
    else against the shortest. A reduced model keeps the basis made for the paper's ITS: it is
    modal, so any step costs nothing, and its own error estimate is in the table. A case that fails
    is a row without values; ComputationError where all do.
    """
    finish = partial(_finish, inputs.bristle().mass_kg)
    return Study("its", finish, basis_its_s=paper.ITS_S, files=FILES, failures=True)


def run_its(inputs: ItsInputs, out: Path, **how: Any) -> None:
    """Compute the study into the folder ``out``, as `study.run_study`."""
    run_study(study_of, inputs, out, **how)


def _finish(mass_kg: float, rows: Sequence[Row], out: Path) -> dict[str, Any]:
    if all(row["energy_closure"] is None for row in rows):
        raise ComputationError(f"no case could be computed; the last {rows[-1]['warnings'][-1]}")
    errors, needs = compare(pd.DataFrame(rows), QUANTITIES, GOAL, mass_kg)
    needs["paper_its_s"] = paper.ITS_S
    needs["its_over_rule"] = needs.its_needed_s / needs.rule_s.where(needs.rule_s > 0.0)
    for name, frame in ((ERRORS_FILE, errors), (NEEDS_FILE, needs)):
        write_atomically(out / name, frame.to_csv(index=False))
    names = [ERRORS_FILE, NEEDS_FILE]
    if len(errors):
        names += write_picture(out / ERRORS, picture(error_figure(errors, QUANTITIES, GOAL)))
        drawn = need_figure(needs, QUANTITIES, paper.ITS_S)
        names += write_picture(out / NEEDS, picture(drawn))
    return {"goal": GOAL, "files": names}


def answer(out: Path) -> list[str]:
    """What a finished study in ``out`` says, as lines: the longest ITS that each quantity allows,
    for each model and Kn, over all heights."""
    needs = pd.read_csv(out / NEEDS_FILE, keep_default_na=False)
    if needs.empty:
        return []
    needs["words"] = needs.bound + needs.its_needed_s.map("{:.2g}".format)
    least = needs.sort_values(["its_needed_s", "bound"]).pivot_table(
        index=["model", "kn_N_m"], columns="quantity", values="words", aggfunc="first"
    )
    lines = [
        f"longest ITS (s) for an error of {100 * GOAL:g} %",
        f"  {'model':<10}{'Kn (N/m)':<10}" + "".join(f"{name:>22}" for name in QUANTITIES.values()),
    ]
    for (model, kn), each in least.reindex(columns=list(QUANTITIES)).fillna("").iterrows():
        lines.append(f"  {model:<10}{kn:<10.6g}" + "".join(f"{words:>22}" for words in each))
    table = pd.read_csv(out / TABLE_FILE)
    if failed := int(table.energy_closure.isna().sum()):
        lines.append(f"  {failed} of {len(table)} cases failed: its.json says why")
    steps = table.its_s.nunique()
    if steps < FEWEST_STEPS:
        lines.append(f"  of {steps} steps alone: give --its {FEWEST_STEPS} or more to trust it")
    return lines


if __name__ == "__main__":
    as_script("its")
