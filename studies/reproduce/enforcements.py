"""Penalty, augmented Lagrangian and Nitsche's method at the same Kn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..inputs.choices import Contact
from ..inputs.config import DropInputs
from ..report.page import Column, Section, Table, Value, show
from .campaign import Results, Setup
from .crosscheck import NAMES, TARGET

VARIANTS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("penalty", {}),
    ("augmented Lagrangian", {"contact": Contact.AUGMENTED}),
    ("Nitsche, θ = 1", {"contact": Contact.NITSCHE, "theta": 1}),
    ("Nitsche, θ = 0", {"contact": Contact.NITSCHE, "theta": 0}),
    ("Nitsche, θ = −1", {"contact": Contact.NITSCHE, "theta": -1}),
)


@dataclass(frozen=True)
class Enforcements:
    """Penalty, augmented Lagrangian and Nitsche at the same Kn."""

    setup: Setup

    def _case(self, model: str, kn_N_m: float, changes: dict[str, Any]) -> DropInputs:
        return self.setup.case(model, kn_N_m, **changes)

    def cases(self) -> list[DropInputs]:
        return [
            self._case(model, kn, changes)
            for kn in self.setup.ends_N_m
            for _, changes in VARIANTS
            for model in ("beam", "reduced")
        ]

    def section(self, results: Results) -> Section:
        rows: list[tuple[Value, ...]] = []
        worst = {"rebound_ratio": 0.0, "peak_force_N": 0.0}
        for model in ("beam", "reduced"):
            for kn in self.setup.ends_N_m:
                reference = results[self._case(model, kn, {})]
                for name, changes in VARIANTS:
                    found = results[self._case(model, kn, changes)]
                    apart = [getattr(found, key) / getattr(reference, key) - 1.0 for key in worst]
                    for key, value in zip(worst, apart, strict=True):
                        worst[key] = max(worst[key], abs(value))
                    rows.append(
                        (
                            NAMES[model],
                            kn / 1e6,
                            name,
                            found.rebound_ratio,
                            apart[0],
                            found.peak_force_N,
                            apart[1],
                        )
                    )
        table = Table(
            "enforcements",
            f"Three enforcements of the same Kn, y0 = {1e3 * self.setup.top_m:g} mm, "
            f"ITS {1e3 * self.setup.its_s:g} ms.",
            (
                Column("model", "Model"),
                Column("kn_MN_m", "Kn", "MN/m", 0),
                Column("enforcement", "Enforcement"),
                Column("rebound_ratio", "y1/y0", digits=5),
                Column("rebound_ratio_apart", "from penalty", "relative", 2),
                Column("peak_force_N", "peak force", "N", 5),
                Column("peak_force_apart", "from penalty", "relative", 2),
            ),
            rows,
        )
        met = "met" if worst["rebound_ratio"] <= TARGET else "not met"
        text = [
            "Penalty puts the spring Kn between tip and plane; the augmented Lagrangian reaches "
            "the same law by a multiplier; Nitsche's method in the Robin form takes the stress of "
            "the bristle's own end as contact pressure. At the same Kn they must give the same "
            "impact.",
            "Penalty, augmented Lagrangian and Nitsche differ by at most "
            f"{show(worst['rebound_ratio'], 2)} in y1/y0 (target {TARGET:g}: {met}) "
            f"and by {show(worst['peak_force_N'], 2)} in peak force.",
        ]
        return Section(
            "enforcements",
            "Penalty, augmented Lagrangian, Nitsche",
            text,
            tables=[table],
            headline=text[1],
        )
