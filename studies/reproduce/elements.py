"""The fewest beam elements for 1 % in rebound, contact time, force and penetration."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ...solver.arrays import Array
from ...solver.paper import ELEMENTS
from ..calibrate.curve import short_its_s
from ..inputs.config import DropInputs
from ..report.figures import picture, stiffness_label
from ..report.page import Column, Comparison, Figure, Section, Table, Value, Verdict, percent, show
from ..report.study_figures import element_figure
from .campaign import Results, Setup

GOAL = 0.01
COUNTS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)
REFERENCE = 64
QUANTITIES = {
    "y1/y0": "rebound_ratio",
    "contact time": "contact_time_s",
    "peak force": "peak_force_N",
    "penetration": "max_penetration_m",
}


def fewest(counts: tuple[int, ...], errors: Array, goal: float = GOAL) -> int | None:
    """The least count from which on every error is within ``goal``; None where there is none."""
    bad = np.flatnonzero(~(np.abs(errors) <= goal))
    if not len(bad):
        return counts[0]
    return counts[bad[-1] + 1] if bad[-1] + 1 < len(counts) else None


@dataclass(frozen=True)
class ElementStudy:
    """The beam in 1 to 32 elements against 64, in time steps short enough not to matter."""

    setup: Setup
    counts: tuple[int, ...] = COUNTS
    reference: int = REFERENCE

    def _case(self, kn_N_m: float, elements: int) -> DropInputs:
        mass = self.setup.base.bristle().mass_kg
        its = max(short_its_s(mass, kn_N_m), 2e-7)
        return self.setup.case("beam", kn_N_m, elements=elements, its_s=its)

    def cases(self) -> list[DropInputs]:
        return [
            self._case(kn, n) for kn in self.setup.ends_N_m for n in (*self.counts, self.reference)
        ]

    def errors(self, results: Results) -> dict[tuple[str, float], Array]:
        """Relative errors (counts,) by (quantity, Kn)."""
        return {
            (name, kn): np.array(
                [
                    getattr(results[self._case(kn, n)], key)
                    / getattr(results[self._case(kn, self.reference)], key)
                    - 1.0
                    for n in self.counts
                ]
            )
            for name, key in QUANTITIES.items()
            for kn in self.setup.ends_N_m
        }

    def section(self, results: Results) -> Section:
        errors = self.errors(results)
        data = Table(
            "elements",
            f"Relative error against {self.reference} elements.",
            (
                Column("kn_MN_m", "Kn", "MN/m", 0),
                Column("elements", "elements"),
                *(Column(key, name, "", 2) for name, key in QUANTITIES.items()),
            ),
            [
                (kn / 1e6, n, *(float(errors[name, kn][i]) for name in QUANTITIES))
                for kn in self.setup.ends_N_m
                for i, n in enumerate(self.counts)
            ],
        )
        need = {
            kn: [fewest(self.counts, errors[name, kn]) for name in QUANTITIES]
            for kn in self.setup.ends_N_m
        }
        rows: list[tuple[Value, ...]] = [(kn / 1e6, *found) for kn, found in need.items()]
        table = Table(
            "elements_needed",
            f"Fewest elements from which on the error stays within {percent(GOAL, 0)}.",
            (
                Column("kn_MN_m", "Kn", "MN/m", 0),
                *(Column(key, name) for name, key in QUANTITIES.items()),
            ),
            rows,
            f"A dash: more than {self.counts[-1]}.",
        )
        drawn = picture(element_figure(self.counts, errors, GOAL))
        figure = Figure(
            "elements",
            "Error of the beam against its number of elements.",
            drawn,
            "Error against number of elements, a panel per quantity",
            data,
        )
        ratio = self._words(found[0] for found in need.values())
        force = self._words(found[2] for found in need.values())
        own = (
            {kn: abs(float(errors["y1/y0", kn][self.counts.index(ELEMENTS)])) for kn in need}
            if ELEMENTS in self.counts
            else {}
        )
        worst = f"; {ELEMENTS} are within {show(max(own.values()), 2)} in y1/y0" if own else ""
        where = ", ".join(stiffness_label(kn) for kn in need)
        text = [
            f"Errors are taken against {self.reference} elements at {where}. For "
            f"{percent(GOAL, 0)} in y1/y0 {ratio} three-node elements are needed, for "
            f"{percent(GOAL, 0)} in peak force {force}{worst}.",
        ]
        comparison = Comparison(
            "Number of beam elements",
            "finite element model",
            f"{ELEMENTS} used",
            f"{ratio} for 1 % in y1/y0, {force} in peak force",
            "–",
            "–",
            Verdict.AGREES,
            f"{ELEMENTS} are enough at every Kn{worst.replace(';', ':')}." if own else "",
        )
        if own and max(max(own.values()), self._force_error(errors)) > GOAL:
            comparison = Comparison(
                comparison.quantity,
                comparison.place,
                comparison.paper,
                comparison.ours_1d,
                "–",
                "–",
                Verdict.DIFFERS,
                f"{ELEMENTS} miss 1 % in y1/y0 or in force at some Kn.",
            )
        return Section(
            "elements", "How many elements the beam needs", text, [comparison], [figure], [table]
        )

    def _force_error(self, errors: dict[tuple[str, float], Array]) -> float:
        i = self.counts.index(ELEMENTS)
        return max(abs(float(e[i])) for (name, _), e in errors.items() if name == "peak force")

    def _words(self, found: Iterable[int | None]) -> str:
        counts = list(found)
        found_counts = [n for n in counts if n is not None]
        if len(found_counts) < len(counts):
            return f"more than {self.counts[-1]}"
        low, high = min(found_counts), max(found_counts)
        return str(low) if low == high else f"{low} to {high}"
