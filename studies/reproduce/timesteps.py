"""The integration time step that rebound and force need, against Kn."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from ..inputs.config import DropInputs
from ..its.convergence import compare, shortest
from ..its.figures import error_figure, need_figure
from ..report.page import Head, Section
from .campaign import GOAL, DropStudy, Labels, Results, prose

BODIES = {"beam": "1-D", "reduced": "3-D"}
QUANTITIES = {"rebound_ratio": "y1/y0", "peak_force_N": "peak force"}
COARSE = (1.0, 1.25, 1.6, 2.0, 2.5, 3.2, 4.0, 5.0, 6.4, 8.0)
FINE = (1.0, 2.0, 5.0)
# Steps per contact: the longest and the shortest tried, and where the ladder grows dense, since
# the error of a peak that falls between steps is no smooth function of the step.
FEWEST_STEPS, DENSE_STEPS, MOST_STEPS = 4, 60, 3000
SHORTEST_S = 5e-8


@dataclass(frozen=True)
class StepStudy(DropStudy):
    """Steps from a quarter of the contact down, against the shortest."""

    most_steps: int = MOST_STEPS

    def ladder(self, kn_N_m: float) -> list[float]:
        """The steps for one Kn, increasing; the first is the reference."""
        contact = self.setup.case("beam", kn_N_m).contact_s()
        least = max(contact / self.most_steps, SHORTEST_S)
        dense = contact / DENSE_STEPS
        steps = {self.setup.its_s}
        for exponent in range(-8, -3):
            for mantissas, low, high in (
                (FINE, least, dense),
                (COARSE, dense, contact / FEWEST_STEPS),
            ):
                rungs = (float(f"{m}e{exponent}") for m in mantissas)
                steps |= {its for its in rungs if low <= its <= high}
        return sorted(steps)

    def plan(self) -> Iterator[tuple[DropInputs, Labels]]:
        for kn in self.setup.kn_N_m:
            for model in BODIES:
                for its in self.ladder(kn):
                    case = self.setup.case(model, kn, its_s=its)
                    yield case, {"kn_N_m": kn, "y0_m": case.height_m, "its_s": its}

    def section(self, results: Results) -> Section:
        s, drops = self.setup, self.drops(results)
        errors, needs = compare(drops, QUANTITIES, GOAL, s.base.bristle().mass_kg, shortest)
        errors["away_s"] = (errors.its_s - s.its_s).abs()
        nearest = errors.sort_values("away_s", kind="stable")
        nearest = nearest.drop_duplicates(["model", "kn_N_m", "quantity"]).sort_index()
        own = nearest.assign(error=nearest.error_relative.abs()).pivot(
            index=["quantity", "kn_N_m"], columns="model", values="error"
        )
        worst = {name: own.loc[name].sort_values("reduced").iloc[-1] for name in QUANTITIES}
        shares = needs.assign(share=needs.its_needed_s / needs.rule_s)
        shares = shares[shares.model == "reduced"].sort_values(["share", "kn_N_m"])
        draft = prose(
            "its",
            setup=s,
            names=QUANTITIES,
            worst=worst,
            shares={name: shares[shares.quantity == name].iloc[[0, -1]] for name in QUANTITIES},
            fewest=FEWEST_STEPS,
            goal=GOAL,
        )
        steps = draft.data(
            "its",
            drops[["model", "kn_MN_m", "its_ms", *QUANTITIES, "contact_time_us"]],
            {"rebound_ratio": ("y1/y0", "", 5), "peak_force_N": ("peak force", "N", 5)},
        )
        wide = needs.pivot(index="kn_N_m", columns=["quantity", "model"])
        order = [(name, model) for name in QUANTITIES for model in BODIES]
        bounds = wide.bound[order].replace("", "=").agg(", ".join, axis=1)
        columns = {"kn_MN_m": wide.index / 1e6}
        columns |= {f"{name}_{m}_ms": 1e3 * wide.its_needed_s[name, m] for name, m in order}
        columns |= {"rule_ms": 1e3 * wide.rule_s[order[0]], "bounds": bounds}
        heads: dict[str, Head] = {
            f"{name}_{model}_ms": (f"{QUANTITIES[name]}, {BODIES[model]}", "ms", 2)
            for name, model in order
        }
        heads |= {"rule_ms": ("tp − ti, Eq. 8", "ms", 3), "bounds": "known as"}
        needed = draft.table("its_needed", columns, heads)
        draft.figure("its-error", error_figure(errors, QUANTITIES, GOAL), steps)
        draft.figure("its-need", need_figure(needs, QUANTITIES, s.its_s), needed)
        return draft.section()
