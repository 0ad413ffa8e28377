"""Closed form, beam, reduced and full-order solid against each other, in Fig. 9 and beyond."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...solver.analytic import penetration_m, quarter_period_s
from ...solver.arrays import Array
from ...solver.drop import DropResult
from ..inputs.choices import Model
from ..inputs.config import DropInputs
from ..report.figures import picture, stiffness_label
from ..report.page import Column, Comparison, Figure, Section, Table, Value, Verdict, percent, show
from ..report.paper_figures import penetration_figure
from .campaign import Results, Setup

TARGET = 2e-3
BODIES = ("beam", "reduced", "solid")
NAMES = {
    "analytic": "analytic",
    "beam": "1-D beam",
    "reduced": "3-D reduced",
    "solid": "3-D full order",
}


def window(result: DropResult) -> tuple[Array, Array]:
    """Time since first touch and penetration, (n,) each in SI, while the first impact lasts."""
    rows = result.history.array()
    touched = np.flatnonzero(rows[:, 3] > 0.0)
    start = max(int(touched[0]) - 1, 0)
    t = rows[start:, 0] - rows[start, 0]
    inside = t <= result.contact_time_s * (1.0 + 1e-9)
    return t[inside], rows[start:, 4][inside]


@dataclass(frozen=True)
class Figure9:
    """Penetration against time at the chosen Kn."""

    setup: Setup

    def cases(self) -> list[DropInputs]:
        s = self.setup
        return [s.case(m, s.chosen_N_m, h) for h in s.fig9_heights_m for m in BODIES]

    def section(self, results: Results) -> Section:
        s = self.setup
        curves: dict[tuple[str, float], tuple[Array, Array]] = {
            (m, h): window(results[s.case(m, s.chosen_N_m, h)])
            for h in s.fig9_heights_m
            for m in BODIES
        }
        bristle, gravity = s.base.bristle(), s.base.gravity_m_s2
        for h in s.fig9_heights_m:
            quarter = quarter_period_s(bristle.mass_kg, s.chosen_N_m)
            t = np.asarray(np.linspace(0.0, 2.0 * quarter, 161), np.float64)
            curves["analytic", h] = (t, penetration_m(t, bristle.mass_kg, s.chosen_N_m, h, gravity))
        rows = [
            (NAMES[m], 1e3 * h, 1e6 * float(t), 1e6 * float(d))
            for (m, h), curve in curves.items()
            for t, d in zip(*curve, strict=True)
        ]
        table = Table(
            "fig9",
            f"Penetration against time, Kn = {stiffness_label(s.chosen_N_m)}.",
            (
                Column("model", "Model"),
                Column("y0_mm", "y0", "mm", 0),
                Column("time_us", "time since touch", "µs"),
                Column("penetration_um", "penetration", "µm"),
            ),
            rows,
        )
        drawn = picture(penetration_figure(curves))
        figure = Figure(
            "fig9",
            f"Fig. 9 of the paper: penetration against time, Kn = {stiffness_label(s.chosen_N_m)}, "
            f"ITS {1e3 * s.its_s:g} ms. Colour: height. Line: model.",
            drawn,
            "Penetration against time for several heights and models",
            table,
        )
        one = results[s.case("beam", s.chosen_N_m, s.top_m)]
        rule = results_analytic(s, s.chosen_N_m)
        text = [
            "Eq. 7 takes the bristle as a rigid mass on the spring Kn. Beam and solid agree with "
            "each other and not with it: a steel bristle of this length has an axial stiffness "
            f"EA/L of {axial_stiffness(s) / 1e6:.2g} MN/m, beside a Kn of "
            f"{stiffness_label(s.chosen_N_m)}, so it gives way as the contact does.",
            f"At {1e3 * s.top_m:g} mm the beam reaches {1e6 * one.max_penetration_m:.3g} µm and "
            f"Eq. 7 {1e6 * rule.max_penetration_m:.3g} µm; contact lasts "
            f"{1e6 * one.contact_time_s:.4g} µs instead of {1e6 * rule.contact_time_s:.4g} µs.",
        ]
        share = one.max_penetration_m / rule.max_penetration_m
        comparison = Comparison(
            "Penetration against time at Kn = " + stiffness_label(s.chosen_N_m),
            "Fig. 9",
            "curves, no numbers published",
            f"peak {1e6 * one.max_penetration_m:.3g} µm",
            f"peak {1e6 * results[s.case('solid', s.chosen_N_m)].max_penetration_m:.3g} µm",
            f"{percent(share - 1, 0, signed=True)} from Eq. 7",
            Verdict.OPEN,
            "The paper's curves cannot be read to the accuracy of this table.",
        )
        return Section("fig9", "Fig. 9: penetration against time", text, [comparison], [figure])


def axial_stiffness(setup: Setup) -> float:
    """E A / L of the bristle in N/m."""
    bristle = setup.base.bristle()
    return bristle.material.youngs_Pa * bristle.section.area_m2 / bristle.length_m


def results_analytic(setup: Setup, kn_N_m: float) -> DropResult:
    """Eqs. 1 to 8 at one Kn and the top height."""
    from ...solver.analytic import analytic_drop

    base = setup.base
    return analytic_drop(base.bristle().mass_kg, kn_N_m, setup.top_m, base.gravity_m_s2)


@dataclass(frozen=True)
class CrossCheck:
    """The four models side by side at one height for every Kn."""

    setup: Setup

    def cases(self) -> list[DropInputs]:
        s = self.setup
        modal = [s.case(m, kn) for kn in s.kn_N_m for m in ("beam", "reduced")]
        return modal + [s.case("solid", kn) for kn in s.full_kn_N_m]

    def section(self, results: Results) -> Section:
        s = self.setup
        rows: list[tuple[Value, ...]] = []
        for kn in s.kn_N_m:
            rows.append(_row("analytic", kn, results_analytic(s, kn)))
            for m in BODIES:
                if m != "solid" or kn in s.full_kn_N_m:
                    rows.append(_row(m, kn, results[s.case(m, kn)]))
        table = Table(
            "crosscheck",
            f"Four models, y0 = {1e3 * s.top_m:g} mm, ITS {1e3 * s.its_s:g} ms.",
            (
                Column("kn_MN_m", "Kn", "MN/m", 0),
                Column("model", "Model"),
                Column("rebound_ratio", "y1/y0"),
                Column("contact_time_us", "contact time", "µs"),
                Column("peak_force_N", "peak force", "N"),
                Column("max_penetration_um", "penetration", "µm"),
                Column("energy_closure", "energy not accounted for", "of m g y0", 2),
            ),
            rows,
        )
        beam_reduced = self._apart(results, "beam", "reduced", s.kn_N_m)
        reduced_full = self._apart(results, "reduced", "solid", s.full_kn_N_m)
        worst = max(results[case].energy.closure_relative for case in self.cases())
        names = ("y1/y0", "contact time", "peak force", "penetration")
        apart = Table(
            "crosscheck_apart",
            "Greatest relative difference over the stiffnesses above.",
            (
                Column("pair", "Pair"),
                *(Column(n.replace("/", "_").replace(" ", "_"), n, "", 2) for n in names),
            ),
            [
                ("1-D beam and 3-D reduced", *beam_reduced),
                ("3-D reduced and 3-D full order", *reduced_full),
            ],
            f"Target for y1/y0: {TARGET:g}.",
        )
        text = [
            f"Beam and reduced solid differ by at most {show(beam_reduced[0], 2)} in y1/y0, "
            f"reduced and full-order solid by {show(reduced_full[0], 2)}; the target is "
            f"{TARGET:g}.",
            f"Energy: fall, strain, motion, contact and material loss add up to the energy of the "
            f"drop, m g y0, within {show(worst, 2)} of it in every case.",
        ]
        return Section(
            "crosscheck",
            "Cross-validation of the models",
            text,
            (),
            (),
            [table, apart],
            headline=" ".join(text),
        )

    def _apart(
        self, results: Results, one: str, other: str, stiffnesses: tuple[float, ...]
    ) -> list[float]:
        s = self.setup
        pairs = [(results[s.case(one, kn)], results[s.case(other, kn)]) for kn in stiffnesses]
        return [
            max(abs(getattr(a, name) / getattr(b, name) - 1.0) for a, b in pairs)
            for name in ("rebound_ratio", "contact_time_s", "peak_force_N", "max_penetration_m")
        ]


def _row(model: str, kn_N_m: float, result: DropResult) -> tuple[Value, ...]:
    closure = None if model == Model.ANALYTIC else result.energy.closure_relative
    return (
        kn_N_m / 1e6,
        NAMES[model],
        result.rebound_ratio,
        1e6 * result.contact_time_s,
        result.peak_force_N,
        1e6 * result.max_penetration_m,
        closure,
    )
