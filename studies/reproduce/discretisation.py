"""Agreement of models and of enforcements, and the elements and time steps that 1 % takes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from ...solver.arrays import Array
from ...solver.paper import ELEMENTS
from ..calibrate.calibration import short_its_s
from ..inputs.choices import Contact, Model
from ..inputs.config import DropInputs
from ..its import compare, error_figure, need_figure, shortest
from ..report.page import Head, Section
from .campaign import (
    BODIES,
    GOAL,
    QUANTITIES,
    DropStudy,
    Labels,
    Results,
    named,
    prose,
    record,
)

VARIANTS: dict[str, dict[str, Any]] = {
    "penalty": {},
    "augmented Lagrangian": {"contact": Contact.AUGMENTED},
    "Nitsche, θ = 1": {"contact": Contact.NITSCHE, "theta": 1},
    "Nitsche, θ = 0": {"contact": Contact.NITSCHE, "theta": 0},
    "Nitsche, θ = −1": {"contact": Contact.NITSCHE, "theta": -1},
}
COUNTS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)
REFERENCE = 64
# What quantities are called in the files of the tables on elements.
KEYS = {"contact_time_us": "contact_time_s", "max_penetration_um": "max_penetration_m"}
# Models and quantities of the study of time steps.
STEPPED = {"beam": "1-D", "reduced": "3-D"}
STEP_QUANTITIES = {name: QUANTITIES[name] for name in ("rebound_ratio", "peak_force_N")}
COARSE = (1.0, 1.25, 1.6, 2.0, 2.5, 3.2, 4.0, 5.0, 6.4, 8.0)
FINE = (1.0, 2.0, 5.0)
# Steps per contact: the longest and the shortest tried, and where the ladder grows dense, since
# the error of a peak that falls between steps is no smooth function of the step.
FEWEST_STEPS, DENSE_STEPS, MOST_STEPS = 4, 60, 3000
SHORTEST_S = 5e-8
# Errors are small beside what they are errors of.
PRECISE: dict[str, Head] = {
    "rebound_ratio": ("y1/y0", "", 5),
    "peak_force_N": ("peak force", "N", 5),
}


class CrossCheck(DropStudy):
    """The four models side by side at one height for every Kn."""

    def plan(self) -> Iterator[tuple[DropInputs, Labels]]:
        for kn, model in product(self.setup.kn_N_m, BODIES):
            if model != Model.SOLID or kn in self.setup.full_kn_N_m:
                yield self.setup.case(model, kn), {}

    def section(self, results: Results) -> Section:
        s, drops = self.setup, self.drops(results)
        rule = pd.DataFrame(
            record(s.case("beam", kn), s.analytic(kn)) | {"model": "analytic"} for kn in s.kn_N_m
        )
        every = pd.concat([rule, drops]).sort_values("kn_MN_m", kind="stable")
        every["energy_closure"] = every.energy_closure.where(every.model != "analytic")
        values = drops.set_index(["kn_MN_m", "model"])[list(QUANTITIES)].astype(float).unstack()
        beam, reduced, solid = (values.xs(model, axis=1, level="model") for model in BODIES)
        apart = pd.DataFrame(
            {
                "1-D beam and 3-D reduced": (beam / reduced - 1.0).abs().max(),
                "3-D reduced and 3-D full order": (reduced / solid - 1.0).abs().max(),
            }
        ).T.rename_axis("pair")
        draft = prose(
            "crosscheck",
            setup=s,
            apart=apart.rebound_ratio.tolist(),
            closure=drops.energy_closure.max(),
        )
        columns = ["kn_MN_m", "model", *QUANTITIES, "energy_closure"]
        draft.table(
            "crosscheck",
            every.assign(model=named(every.model))[columns],
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
        for model, kn, name in product(("beam", "reduced"), self.setup.ends_N_m, VARIANTS):
            yield self.setup.case(model, kn, **VARIANTS[name]), {"enforcement": name}

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
            {**PRECISE, **dict.fromkeys(apart.values(), ("from penalty", "relative", 2))},
        )
        return draft.section()


def fewest(counts: tuple[int, ...], errors: Array) -> int | None:
    """The least count from which on every error is within `GOAL`; None where there is none."""
    bad = np.flatnonzero(~(np.abs(errors) <= GOAL))
    if not len(bad):
        return counts[0]
    return counts[bad[-1] + 1] if bad[-1] + 1 < len(counts) else None


@dataclass(frozen=True)
class ElementStudy(DropStudy):
    """The beam in 1 to 32 elements against 64, in time steps short enough not to matter."""

    counts: tuple[int, ...] = COUNTS
    reference: int = REFERENCE

    def plan(self) -> Iterator[tuple[DropInputs, Labels]]:
        mass = self.setup.base.bristle().mass_kg
        for kn in self.setup.ends_N_m:
            its = max(short_its_s(mass, kn), 2e-7)
            for n in (*self.counts, self.reference):
                yield self.setup.case("beam", kn, elements=n, its_s=its), {"elements": n}

    def section(self, results: Results) -> Section:
        values = self.drops(results).set_index(["kn_MN_m", "elements"])[list(QUANTITIES)]
        values = values.rename(columns=KEYS)
        words = dict(zip(values, QUANTITIES.values(), strict=True))
        finest = values.xs(self.reference, level="elements")
        errors = values.drop(self.reference, level="elements").div(finest, level="kn_MN_m") - 1.0
        by_kn = errors.groupby(level="kn_MN_m")
        need = pd.DataFrame(
            {name: [fewest(self.counts, own) for _, own in by_kn[name]] for name in errors},
            index=finest.index.sort_values(),
            dtype=object,
        )
        own = errors.abs().groupby(level="elements").max()
        draft = prose(
            "elements",
            reference=self.reference,
            most=self.counts[-1],
            kn_N_m=self.setup.ends_N_m,
            ratio=_range(need.rebound_ratio, self.counts[-1]),
            force=_range(need.peak_force_N, self.counts[-1]),
            worst=own.loc[ELEMENTS] if ELEMENTS in self.counts else None,
            goal=GOAL,
        )
        long = errors.reset_index().melt(
            ["kn_MN_m", "elements"], var_name="quantity", value_name="error_relative"
        )
        long = long.rename(columns={"elements": "count"}).assign(
            model="beam", y0_m=self.setup.top_m, kn_N_m=1e6 * long.kn_MN_m
        )
        heads: dict[str, Head] = {name: (head, "", 2) for name, head in words.items()}
        draft.figure(
            "elements",
            error_figure(long, words, GOAL, "beam elements"),
            draft.data("elements", errors.reset_index(), heads),
        )
        heads = {name: (head, "") for name, head in words.items()}
        draft.table("elements_needed", need.reset_index(), heads)
        return draft.section()


def _range(counts: pd.Series, most: int) -> str:
    """Least and greatest of the counts needed, in words."""
    if counts.isna().any():
        return f"more than {most}"
    low, high = counts.min(), counts.max()
    return str(low) if low == high else f"{low} to {high}"


@dataclass(frozen=True)
class StepStudy(DropStudy):
    """Integration time steps from a quarter of the contact down, against the shortest."""

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
        for kn, model in product(self.setup.kn_N_m, STEPPED):
            for its in self.ladder(kn):
                case = self.setup.case(model, kn, its_s=its)
                yield case, {"kn_N_m": kn, "y0_m": case.height_m, "its_s": its}

    def section(self, results: Results) -> Section:
        s, drops = self.setup, self.drops(results)
        mass = s.base.bristle().mass_kg
        errors, needs = compare(drops, STEP_QUANTITIES, GOAL, mass, shortest)
        errors["away_s"] = (errors.its_s - s.its_s).abs()
        nearest = errors.sort_values("away_s", kind="stable")
        nearest = nearest.drop_duplicates(["model", "kn_N_m", "quantity"]).sort_index()
        own = nearest.assign(error=nearest.error_relative.abs()).pivot(
            index=["quantity", "kn_N_m"], columns="model", values="error"
        )
        worst = {name: own.loc[name].sort_values("reduced").iloc[-1] for name in STEP_QUANTITIES}
        shares = needs.assign(share=needs.its_needed_s / needs.rule_s)
        shares = shares[shares.model == "reduced"].sort_values(["share", "kn_N_m"])
        draft = prose(
            "its",
            setup=s,
            names=STEP_QUANTITIES,
            worst=worst,
            shares={n: shares[shares.quantity == n].iloc[[0, -1]] for n in STEP_QUANTITIES},
            fewest=FEWEST_STEPS,
            goal=GOAL,
        )
        columns = ["model", "kn_MN_m", "its_ms", *STEP_QUANTITIES, "contact_time_us"]
        steps = draft.data("its", drops[columns], PRECISE)
        wide = needs.pivot(index="kn_N_m", columns=["quantity", "model"])
        order = [(name, model) for name in STEP_QUANTITIES for model in STEPPED]
        needed = pd.DataFrame({"kn_MN_m": wide.index / 1e6}, index=wide.index)
        heads: dict[str, Head] = {"rule_ms": ("tp − ti, Eq. 8", "ms", 3), "bounds": "known as"}
        for name, model in order:
            key = f"{name}_{model}_ms"
            needed[key] = 1e3 * wide.its_needed_s[name, model]
            heads[key] = f"{STEP_QUANTITIES[name]}, {STEPPED[model]}", "ms", 2
        needed["rule_ms"] = 1e3 * wide.rule_s[order[0]]
        needed["bounds"] = wide.bound[order].replace("", "=").agg(", ".join, axis=1)
        table = draft.table("its_needed", needed, heads)
        draft.figure("its-error", error_figure(errors, STEP_QUANTITIES, GOAL), steps)
        draft.figure("its-need", need_figure(needs, STEP_QUANTITIES, s.its_s), table)
        return draft.section()
