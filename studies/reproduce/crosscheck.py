"""Closed form, beam, reduced and full-order solid against each other, in Fig. 9 and beyond."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from ...solver.analytic import analytic_drop, penetration_m, quarter_period_s
from ...solver.arrays import Array
from ...solver.drop import DropResult
from ..inputs.choices import Contact, Model
from ..inputs.config import DropInputs
from ..report.figures import LOOKS, SERIES, beside, drawing, model_legend
from ..report.page import Section
from .campaign import QUANTITIES, DropStudy, Labels, Results, Setup, named, prose, record

BODIES = ("beam", "reduced", "solid")
VARIANTS: dict[str, dict[str, Any]] = {
    "penalty": {},
    "augmented Lagrangian": {"contact": Contact.AUGMENTED},
    "Nitsche, θ = 1": {"contact": Contact.NITSCHE, "theta": 1},
    "Nitsche, θ = 0": {"contact": Contact.NITSCHE, "theta": 0},
    "Nitsche, θ = −1": {"contact": Contact.NITSCHE, "theta": -1},
}


def window(result: DropResult) -> tuple[Array, Array]:
    """Time since first touch and penetration, (n,) each in SI, while the first impact lasts."""
    rows = result.history.array()
    touched = np.flatnonzero(rows[:, 3] > 0.0)
    start = max(int(touched[0]) - 1, 0)
    t = rows[start:, 0] - rows[start, 0]
    inside = t <= result.contact_time_s * (1.0 + 1e-9)
    return t[inside], rows[start:, 4][inside]


def analytic(setup: Setup, kn_N_m: float) -> DropResult:
    """Eqs. 1 to 8 at one Kn and the top height."""
    base = setup.base
    return analytic_drop(base.bristle().mass_kg, kn_N_m, setup.top_m, base.gravity_m_s2)


class Figure9(DropStudy):
    """Penetration against time at the chosen Kn."""

    def plan(self) -> Iterator[tuple[DropInputs, Labels]]:
        for height in self.setup.fig9_heights_m:
            for model in BODIES:
                yield self.setup.case(model, self.setup.chosen_N_m, height), {}

    def section(self, results: Results) -> Section:
        s, kn = self.setup, self.setup.chosen_N_m
        curves = {(case.model.value, case.height_m): window(results[case]) for case in self.cases()}
        mass, gravity = s.base.bristle().mass_kg, s.base.gravity_m_s2
        t = np.linspace(0.0, 2.0 * quarter_period_s(mass, kn), 161)
        for height in s.fig9_heights_m:
            curves["analytic", height] = t, penetration_m(t, mass, kn, height, gravity)
        data = pd.concat(
            pd.DataFrame(
                {"model": model, "y0_mm": 1e3 * height, "time_us": 1e6 * t, "depth": 1e6 * depth}
            )
            for (model, height), (t, depth) in curves.items()
        ).rename(columns={"depth": "penetration_um"})
        one, full = (results[s.case(model, kn)] for model in ("beam", "solid"))
        draft = prose("fig9", setup=s, one=one, full=full, rule=analytic(s, kn))
        table = draft.data(
            "fig9", data.assign(model=named(data.model)), {"time_us": "time since touch"}
        )
        draft.figure("fig9", penetration_figure(curves), table)
        return draft.section()


@drawing("time since touch (µs)", "penetration (µm)", height_in=3.8, legend=None, xlim=(0, None))
def penetration_figure(ax: Axes, curves: Mapping[tuple[str, float], tuple[Array, Array]]) -> None:
    """Fig. 9: penetration (µm) against time since touch (µs); keys are (model, height in m)."""
    heights = sorted({height for _, height in curves})
    colours = dict(zip(heights, SERIES, strict=False))
    for (model, height), (t, depth) in curves.items():
        ax.plot(1e6 * t, 1e6 * depth, color=colours[height], **LOOKS[model].line)
    for height in heights:
        t, depth = curves["analytic", height]
        top = 1e6 * t[np.argmax(depth)], 1e6 * depth.max()
        beside(ax, f"y0 = {1e3 * height:g} mm", top, "center", color=colours[height], fontsize=8)
    models = [model for model in LOOKS if any(m == model for m, _ in curves)]
    model_legend(ax, models, loc="upper right")
    ax.set_ylim(0, None)
    ax.set_ylim(0, 1.08 * ax.get_ylim()[1])


class CrossCheck(DropStudy):
    """The four models side by side at one height for every Kn."""

    def plan(self) -> Iterator[tuple[DropInputs, Labels]]:
        for kn in self.setup.kn_N_m:
            for model in BODIES:
                if model != Model.SOLID or kn in self.setup.full_kn_N_m:
                    yield self.setup.case(model, kn), {}

    def section(self, results: Results) -> Section:
        s, drops = self.setup, self.drops(results)
        rule = pd.DataFrame(
            record(s.case("beam", kn), analytic(s, kn)) | {"model": "analytic"} for kn in s.kn_N_m
        )
        every = pd.concat([rule, drops]).sort_values("kn_MN_m", kind="stable")
        every["energy_closure"] = every.energy_closure.where(every.model != "analytic")
        by_model = drops.pivot(index="kn_MN_m", columns="model")[list(QUANTITIES)]
        pairs = {
            "1-D beam and 3-D reduced": ("beam", "reduced"),
            "3-D reduced and 3-D full order": ("reduced", "solid"),
        }
        apart = pd.DataFrame(
            {
                words: (by_model.xs(a, axis=1, level=1) / by_model.xs(b, axis=1, level=1) - 1.0)
                .abs()
                .max()
                for words, (a, b) in pairs.items()
            }
        ).T.rename_axis("pair")
        draft = prose(
            "crosscheck",
            setup=s,
            apart=apart.rebound_ratio.tolist(),
            closure=drops.energy_closure.max(),
        )
        draft.table(
            "crosscheck",
            every.assign(model=named(every.model))[
                ["kn_MN_m", "model", *QUANTITIES, "energy_closure"]
            ],
            {
                "max_penetration_um": "penetration",
                "energy_closure": ("energy not accounted for", "of m g y0", 2),
            },
        )
        names = {key: re.sub("[ /]", "_", words) for key, words in QUANTITIES.items()}
        draft.table(
            "crosscheck_apart",
            apart.rename(columns=names).reset_index(),
            {names[key]: (words, "", 2) for key, words in QUANTITIES.items()},
        )
        return draft.section()


class Enforcements(DropStudy):
    """Penalty, augmented Lagrangian and Nitsche at the same Kn."""

    def plan(self) -> Iterator[tuple[DropInputs, Labels]]:
        for model in ("beam", "reduced"):
            for kn in self.setup.ends_N_m:
                for name, changes in VARIANTS.items():
                    yield self.setup.case(model, kn, **changes), {"enforcement": name}

    def section(self, results: Results) -> Section:
        s, drops = self.setup, self.drops(results)
        penalty = drops.groupby(["model", "kn_MN_m"])
        apart = {"rebound_ratio": "rebound_ratio_apart", "peak_force_N": "peak_force_apart"}
        for key, name in apart.items():
            drops[name] = drops[key] / penalty[key].transform("first") - 1.0
        ratio, force = drops[list(apart.values())].abs().max()
        columns = [each for pair in apart.items() for each in pair]
        draft = prose("enforcements", setup=s, ratio=ratio, force=force)
        draft.table(
            "enforcements",
            drops.assign(model=named(drops.model))[["model", "kn_MN_m", "enforcement", *columns]],
            {
                "rebound_ratio": ("y1/y0", "", 5),
                "peak_force_N": ("peak force", "N", 5),
                **dict.fromkeys(apart.values(), ("from penalty", "relative", 2)),
            },
        )
        return draft.section()
