"""The integration time step that rebound and force need, against Kn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...solver import paper
from ...solver.analytic import quarter_period_s
from ...solver.arrays import Array
from ..inputs.config import DropInputs
from ..its.convergence import Need, need
from ..its.figures import error_figure, need_figure
from ..report.figures import picture, stiffness_label
from ..report.page import Column, Comparison, Figure, Section, Table, Value, Verdict, percent
from .campaign import Results, Setup

GOAL = 0.01
BODIES = ("beam", "reduced")
QUANTITIES = {"rebound_ratio": "y1/y0", "peak_force_N": "peak force"}
COARSE = (1.0, 1.25, 1.6, 2.0, 2.5, 3.2, 4.0, 5.0, 6.4, 8.0)
FINE = (1.0, 2.0, 5.0)
# Steps per contact: the longest and the shortest tried, and where the ladder grows dense, since
# the error of a peak that falls between steps is no smooth function of the step.
FEWEST_STEPS, DENSE_STEPS, MOST_STEPS = 4, 60, 3000
SHORTEST_S = 5e-8

Key = tuple[str, float, float]


@dataclass(frozen=True)
class StepStudy:
    """Steps from a quarter of the contact down, against the shortest."""

    setup: Setup
    most_steps: int = MOST_STEPS

    def ladder(self, kn_N_m: float) -> list[float]:
        """The steps for one Kn, increasing; the first is the reference."""
        contact = self.setup.case("beam", kn_N_m).contact_s()
        shortest = max(contact / self.most_steps, SHORTEST_S)
        dense = contact / DENSE_STEPS
        steps = {self.setup.its_s}
        for exponent in range(-8, -3):
            for mantissas, low, high in (
                (FINE, shortest, dense),
                (COARSE, dense, contact / FEWEST_STEPS),
            ):
                rungs = (float(f"{m}e{exponent}") for m in mantissas)
                steps |= {its for its in rungs if low <= its <= high}
        return sorted(steps)

    def _case(self, model: str, kn_N_m: float, its_s: float) -> DropInputs:
        return self.setup.case(model, kn_N_m, its_s=its_s)

    def cases(self) -> list[DropInputs]:
        return [
            self._case(m, kn, its)
            for kn in self.setup.kn_N_m
            for its in self.ladder(kn)
            for m in BODIES
        ]

    def errors(self, results: Results, name: str, model: str, kn_N_m: float) -> tuple[Array, Array]:
        """ITS (n,) and the relative error there (n,), the reference left out."""
        steps = self.ladder(kn_N_m)
        values = np.array([getattr(results[self._case(model, kn_N_m, its)], name) for its in steps])
        return np.array(steps[1:]), values[1:] / values[0] - 1.0

    def _all_errors(self, results: Results) -> dict[tuple[str, Key], tuple[Array, Array]]:
        return {
            (name, (m, kn, self.setup.top_m)): self.errors(results, name, m, kn)
            for name in QUANTITIES
            for m in BODIES
            for kn in self.setup.kn_N_m
        }

    def section(self, results: Results) -> Section:
        s = self.setup
        errors = self._all_errors(results)
        needs = {key: need(*found, GOAL) for key, found in errors.items()}
        own = {
            (name, kn): self._at_own(errors[name, ("reduced", kn, s.top_m)])
            for name in QUANTITIES
            for kn in s.kn_N_m
        }
        worst = {name: max((abs(own[name, kn]), kn) for kn in s.kn_N_m) for name in QUANTITIES}
        y1, force = worst.values()
        text = [
            f"Error against the shortest step of each Kn. ITS = {1e3 * s.its_s:g} ms keeps y1/y0 "
            f"within {percent(y1[0])} (worst at {stiffness_label(y1[1])}); the peak force it "
            f"misses by up to {percent(force[0])} (at {stiffness_label(force[1])}).",
            *self._rule_words(needs),
        ]
        needed = self._need_table(needs)
        figures = [
            Figure(
                "its-error",
                f"Error against the integration time step; goal {percent(GOAL, 0)}.",
                picture(error_figure(errors, QUANTITIES, GOAL)),
                "Error against time step, rebound and force",
                self._table(results),
            ),
            Figure(
                "its-need",
                f"Longest ITS that keeps the error within {percent(GOAL, 0)}, beside Eq. 8.",
                picture(need_figure(needs, QUANTITIES, self._rules(), s.its_s)),
                "Longest good time step against Kn",
                needed,
            ),
        ]
        comparisons = [
            _judge(
                f"Error of {label} at ITS = {1e3 * s.its_s:g} ms",
                worst[name],
                self._at_own(errors[name, ("beam", worst[name][1], s.top_m)]),
            )
            for name, label in QUANTITIES.items()
        ]
        return Section(
            "its",
            "Which integration time step is short enough",
            text,
            comparisons,
            figures,
            [needed],
        )

    def _rules(self) -> dict[float, float]:
        mass = self.setup.base.bristle().mass_kg
        return {kn: quarter_period_s(mass, kn) for kn in self.setup.kn_N_m}

    def _rule_words(self, needs: dict[tuple[str, Key], Need]) -> list[str]:
        sentences = [
            "The paper's rule takes ITS from the time to greatest penetration of a mass on a "
            "spring, tp − ti (Eq. 8)."
        ]
        for name, label in QUANTITIES.items():
            shares = [
                (needs[name, ("reduced", kn, self.setup.top_m)].its_s / rule, kn)
                for kn, rule in self._rules().items()
            ]
            (low, at_low), (high, at_high) = min(shares), max(shares)
            sentences.append(
                f"For {percent(GOAL, 0)} in {label} the step must be {low:.2g} "
                f"(at {stiffness_label(at_low)}) to {high:.2g} (at {stiffness_label(at_high)}) "
                "times tp − ti."
            )
        return [" ".join(sentences)]

    def _at_own(self, found: tuple[Array, Array]) -> float:
        its, error = found
        return float(error[np.argmin(np.abs(its - self.setup.its_s))])

    def _table(self, results: Results) -> Table:
        rows: list[tuple[Value, ...]] = []
        for kn in self.setup.kn_N_m:
            for m in BODIES:
                for its in self.ladder(kn):
                    found = results[self._case(m, kn, its)]
                    rows.append(
                        (
                            m,
                            kn / 1e6,
                            1e3 * its,
                            found.rebound_ratio,
                            found.peak_force_N,
                            1e6 * found.contact_time_s,
                        )
                    )
        return Table(
            "its",
            f"Rebound, force and contact time against ITS, y0 = {1e3 * self.setup.top_m:g} mm.",
            (
                Column("model", "Model"),
                Column("kn_MN_m", "Kn", "MN/m", 0),
                Column("its_ms", "ITS", "ms", 0),
                Column("rebound_ratio", "y1/y0", digits=5),
                Column("peak_force_N", "peak force", "N", 5),
                Column("contact_time_us", "contact time", "µs"),
            ),
            rows,
        )

    def _need_table(self, needs: dict[tuple[str, Key], Need]) -> Table:
        rows: list[tuple[Value, ...]] = []
        for kn, rule in self._rules().items():
            found = [needs[name, (m, kn, self.setup.top_m)] for name in QUANTITIES for m in BODIES]
            rows.append(
                (
                    kn / 1e6,
                    *(1e3 * each.its_s for each in found),
                    1e3 * rule,
                    ", ".join(each.bound or "=" for each in found),
                )
            )
        return Table(
            "its_needed",
            f"Longest ITS that keeps the error within {percent(GOAL, 0)}, and the paper's rule.",
            (
                Column("kn_MN_m", "Kn", "MN/m", 0),
                *(
                    Column(f"{key}_{m}_ms", f"{label}, {'1-D' if m == 'beam' else '3-D'}", "ms", 2)
                    for key, label in QUANTITIES.items()
                    for m in BODIES
                ),
                Column("rule_ms", "tp − ti, Eq. 8", "ms", 3),
                Column("bounds", "known as"),
            ),
            rows,
            f"Longest step tried: 1/{FEWEST_STEPS} of the contact; >= marks where it is short "
            "enough, < where the shortest tried is not.",
        )


def _judge(quantity: str, worst: tuple[float, float], beam: float) -> Comparison:
    error, kn = worst
    good = error <= GOAL
    return Comparison(
        quantity,
        "ITS study",
        f"ITS ≤ {1e3 * paper.ITS_S:g} ms is enough",
        f"{percent(abs(beam))} at {stiffness_label(kn)}",
        f"{percent(error)} at {stiffness_label(kn)}",
        f"goal {percent(GOAL, 0)}",
        Verdict.AGREES if good else Verdict.DIFFERS,
        "" if good else "Enough for the rebound that the paper looks at, not for forces.",
    )
