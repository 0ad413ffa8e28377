"""Time to greatest penetration and contact time against Kn, and where Eq. 8 ceases to hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...solver import paper
from ...solver.analytic import quarter_period_s
from ...solver.arrays import Array
from ..calibrate.curve import short_its_s
from ..inputs.config import DropInputs
from ..report.figures import picture, stiffness_label
from ..report.page import Column, Comparison, Figure, Section, Table, Value, Verdict, percent
from ..report.paper_figures import time_to_peak_figure
from .campaign import Results, Setup
from .crosscheck import axial_stiffness

GRID_N_M = tuple(float(f"{kn:.4g}") for kn in np.geomspace(1e4, 1e8, 25))
# So stiff that y1/y0 has reached the limit of a rigid plane to about 10⁻³; the few modes of the
# reduced solid follow the shorter waves of a yet stiffer contact no longer.
RIGID_N_M = {"beam": 1e10, "reduced": 1e9}
RIGID_ITS_S = 1e-7
OFF = 0.10


def departs_at(kn_N_m: Array, ratio: Array, off: float = OFF) -> float | None:
    """Kn at which ``ratio`` (1 where Eq. 8 holds) first leaves 1 by ``off``; None if never."""
    gone = np.flatnonzero(np.abs(ratio - 1.0) > off)
    if not len(gone):
        return None
    i = int(gone[0])
    if i == 0:
        return float(kn_N_m[0])
    a, b = abs(ratio[i - 1] - 1.0), abs(ratio[i] - 1.0)
    share = (off - a) / (b - a)
    return float(kn_N_m[i - 1] * (kn_N_m[i] / kn_N_m[i - 1]) ** share)


@dataclass(frozen=True)
class PeakTime:
    """Eq. 8 beside beam and solid, and the limit of a rigid plane."""

    setup: Setup
    grid_N_m: tuple[float, ...] = GRID_N_M

    def _case(self, model: str, kn_N_m: float) -> DropInputs:
        its = short_its_s(self.setup.base.bristle().mass_kg, kn_N_m)
        return self.setup.case(model, kn_N_m, its_s=its)

    def _rigid(self, model: str, **changes: float) -> DropInputs:
        return self.setup.case(model, RIGID_N_M[model], its_s=RIGID_ITS_S, **changes)

    def cases(self) -> list[DropInputs]:
        both = [self._case(m, kn) for kn in self.setup.kn_N_m for m in ("beam", "reduced")]
        rigid = [self._rigid("beam"), self._rigid("reduced"), self._rigid("beam", beta_s=0.0)]
        return [*both, *(self._case("beam", kn) for kn in self.grid_N_m), *rigid]

    def section(self, results: Results) -> Section:
        s = self.setup
        bristle = s.base.bristle()
        grid = np.array(self.grid_N_m)
        rule = np.array([quarter_period_s(bristle.mass_kg, kn) for kn in grid])
        beam = np.array(
            [results[self._case("beam", kn)].time_to_max_penetration_s for kn in self.grid_N_m]
        )
        points = [
            (kn, results[self._case("reduced", kn)].time_to_max_penetration_s) for kn in s.kn_N_m
        ]
        printed = {kn: t for kn, t in paper.TIME_TO_PEAK_S.items() if kn in s.kn_N_m}
        drawn = picture(
            time_to_peak_figure(grid, rule, beam, points, printed, 0.5 * bristle.axial_period_s)
        )
        figure = Figure(
            "eq8",
            "Time from touch to greatest penetration against Kn: Eq. 8, beam, "
            "solid, and the two values printed in the paper.",
            drawn,
            "Time to greatest penetration against Kn",
            _figure_table(grid, rule, beam, dict(points), printed),
        )
        off = departs_at(grid, beam / rule)
        where = "nowhere on this grid" if off is None else f"from {off / 1e6:.2g} MN/m on"
        text = [
            f"Eq. 8, tp − ti = (π/2)√(m/Kn), takes the bristle as rigid. It is more than "
            f"{percent(OFF, 0)} off {where}, that is from about "
            f"{(off or 0) / axial_stiffness(s):.2g} of the bristle's own axial stiffness, "
            f"EA/L = {axial_stiffness(s) / 1e6:.2g} MN/m.",
            *self._extremes(results),
        ]
        return Section(
            "eq8",
            "Time to greatest penetration, contact time, and Eq. 8",
            text,
            self._comparisons(results),
            [figure],
            [self._table(results), self._rigid_table(results)],
        )

    def _extremes(self, results: Results) -> list[str]:
        kn = max(self.setup.kn_N_m)
        rule = quarter_period_s(self.setup.base.bristle().mass_kg, kn)
        found = results[self._case("beam", kn)]
        limit = self.setup.base.bristle().axial_period_s
        return [
            f"At {stiffness_label(kn)} Eq. 8 gives {1e6 * rule:.3g} µs to greatest penetration and "
            f"so {2e6 * rule:.3g} µs of contact; the beam reaches it after "
            f"{1e6 * found.time_to_max_penetration_s:.3g} µs and stays for "
            f"{1e6 * found.contact_time_s:.4g} µs. On a rigid plane an undamped bristle "
            f"leaves when the wave from its tip is back from the top, after 2L/c = "
            f"{1e6 * limit:.4g} µs; the paper's damping ends contact somewhat earlier."
        ]

    def _table(self, results: Results) -> Table:
        mass = self.setup.base.bristle().mass_kg
        rows: list[tuple[Value, ...]] = []
        for kn in self.setup.kn_N_m:
            rule = quarter_period_s(mass, kn)
            beam, solid = (results[self._case(m, kn)] for m in ("beam", "reduced"))
            printed = paper.TIME_TO_PEAK_S.get(kn)
            rows.append(
                (
                    kn / 1e6,
                    None if printed is None else 1e6 * printed,
                    1e6 * rule,
                    1e6 * beam.time_to_max_penetration_s,
                    1e6 * solid.time_to_max_penetration_s,
                    beam.time_to_max_penetration_s / rule,
                    2e6 * rule,
                    1e6 * beam.contact_time_s,
                    1e6 * solid.contact_time_s,
                )
            )
        return Table(
            "eq8",
            "Time to greatest penetration and contact time, time steps short enough not to matter.",
            (
                Column("kn_MN_m", "Kn", "MN/m", 0),
                Column("tp_printed_us", "tp − ti, printed", "µs"),
                Column("tp_rule_us", "Eq. 8", "µs"),
                Column("tp_beam_us", "1-D", "µs"),
                Column("tp_solid_us", "3-D", "µs"),
                Column("tp_ratio", "1-D over Eq. 8", "", 3),
                Column("contact_rule_us", "contact, 2(tp − ti)", "µs"),
                Column("contact_beam_us", "contact, 1-D", "µs"),
                Column("contact_solid_us", "contact, 3-D", "µs"),
            ),
            rows,
        )

    def _rigid_table(self, results: Results) -> Table:
        limit = self.setup.base.bristle().axial_period_s
        named = (
            ("1-D, the paper's damping", self._rigid("beam")),
            ("3-D, the paper's damping", self._rigid("reduced")),
            ("1-D, no damping", self._rigid("beam", beta_s=0.0)),
        )
        return Table(
            "rigid_plane",
            "Contact as good as rigid.",
            (
                Column("what", "Model"),
                Column("kn_MN_m", "Kn", "MN/m", 0),
                Column("rebound_ratio", "y1/y0"),
                Column("contact_time_us", "contact time", "µs"),
                Column("of_2L_c", "of 2L/c", "", 4),
            ),
            [
                (
                    name,
                    case.kn_N_m / 1e6,
                    results[case].rebound_ratio,
                    1e6 * results[case].contact_time_s,
                    results[case].contact_time_s / limit,
                )
                for name, case in named
            ],
            f"2L/c = {1e6 * limit:.4g} µs with c = √(E/ρ).",
        )

    def _comparisons(self, results: Results) -> list[Comparison]:
        rows = []
        for kn, printed in paper.TIME_TO_PEAK_S.items():
            if kn not in self.setup.kn_N_m:
                continue
            rule = quarter_period_s(self.setup.base.bristle().mass_kg, kn)
            one, three = (
                results[self._case(m, kn)].time_to_max_penetration_s for m in ("beam", "reduced")
            )
            close = abs(one / printed - 1.0) <= 0.05
            rows.append(
                Comparison(
                    f"tp − ti at {stiffness_label(kn)}",
                    "Eq. 8",
                    f"{1e3 * printed:g} ms",
                    f"{1e3 * one:.4f} ms",
                    f"{1e3 * three:.4f} ms",
                    percent(one / printed - 1.0, 0, signed=True),
                    Verdict.AGREES if close else Verdict.DIFFERS,
                    f"The formula itself gives {1e3 * rule:.4f} ms."
                    + ("" if close else " The bristle is not rigid beside this contact."),
                )
            )
        return rows


def _figure_table(
    grid_N_m: Array,
    rule_s: Array,
    beam_s: Array,
    solid_s: Mapping[float, float],
    printed_s: Mapping[float, float],
) -> Table:
    curves: dict[str, Mapping[float, float]] = {
        "rule": dict(zip(map(float, grid_N_m), rule_s, strict=True)),
        "beam": dict(zip(map(float, grid_N_m), beam_s, strict=True)),
        "solid": solid_s,
        "printed": printed_s,
    }
    stiffnesses = sorted({kn for curve in curves.values() for kn in curve})
    return Table(
        "eq8_figure",
        "Time from touch to greatest penetration.",
        (
            Column("kn_MN_m", "Kn", "MN/m", 3),
            Column("tp_rule_us", "Eq. 8", "µs"),
            Column("tp_beam_us", "1-D", "µs"),
            Column("tp_solid_us", "3-D", "µs"),
            Column("tp_printed_us", "printed", "µs"),
        ),
        [
            (kn / 1e6, *(_microseconds(curve.get(kn)) for curve in curves.values()))
            for kn in stiffnesses
        ],
    )


def _microseconds(seconds: float | None) -> float | None:
    return None if seconds is None else 1e6 * float(seconds)
