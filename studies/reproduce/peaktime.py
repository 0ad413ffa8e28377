"""Time to greatest penetration and contact time against Kn, and where Eq. 8 ceases to hold."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from ...solver import paper
from ...solver.analytic import quarter_period_s
from ...solver.arrays import Array
from ..calibrate.curve import short_its_s
from ..inputs.config import DropInputs
from ..report.figures import BLACK, GREY, SERIES, VERMILION, beside, drawing
from ..report.page import Head, Section
from .campaign import DropStudy, Labels, Results, prose, record

GRID_N_M = tuple(float(f"{kn:.4g}") for kn in np.geomspace(1e4, 1e8, 25))
OFF = 0.10
HEADS: dict[str, Head] = {
    "kn_MN_m": ("Kn", "MN/m", 3),
    "tp_rule_us": "Eq. 8",
    "tp_beam_us": "1-D",
    "tp_solid_us": "3-D",
    "tp_printed_us": "printed",
    "tp_ratio": ("1-D over Eq. 8", "", 3),
    "contact_rule_us": "contact, 2(tp − ti)",
    "contact_beam_us": "contact, 1-D",
    "contact_solid_us": "contact, 3-D",
}


def departs_at(kn_N_m: Array, ratio: Array, off: float = OFF) -> float | None:
    """Kn at which ``ratio`` (1 where Eq. 8 holds) first leaves 1 by ``off``; None if never."""
    apart = np.abs(np.asarray(ratio) - 1.0)
    gone = np.flatnonzero(apart > off)
    if not len(gone):
        return None
    between = slice(max(gone[0] - 1, 0), gone[0] + 1)
    return float(np.exp(np.interp(off, apart[between], np.log(kn_N_m[between]))))


@dataclass(frozen=True)
class PeakTime(DropStudy):
    """Eq. 8 beside beam and solid, and the limit of a rigid plane."""

    grid_N_m: tuple[float, ...] = GRID_N_M

    def plan(self) -> Iterator[tuple[DropInputs, Labels]]:
        mass = self.setup.base.bristle().mass_kg
        for grid, models in ((self.setup.kn_N_m, ("beam", "reduced")), (self.grid_N_m, ("beam",))):
            for kn in grid:
                rule = {"rule": 1e6 * quarter_period_s(mass, kn), "grid": grid is self.grid_N_m}
                for model in models:
                    case = self.setup.case(model, kn, its_s=short_its_s(mass, kn))
                    yield case, {**rule, "kn_N_m": kn}

    def _rigid(self) -> dict[str, DropInputs]:
        return {
            "1-D, the paper's damping": self.setup.rigid("beam"),
            "3-D, the paper's damping": self.setup.rigid("reduced"),
            "1-D, no damping": self.setup.rigid("beam", beta_s=0.0),
        }

    def cases(self) -> list[DropInputs]:
        return [*super().cases(), *self._rigid().values()]

    def section(self, results: Results) -> Section:
        s, drops = self.setup, self.drops(results)
        grid = drops[drops.grid]
        times = drops[~drops.grid].pivot(
            index=["kn_N_m", "kn_MN_m", "rule"],
            columns="model",
            values=["tp_us", "contact_time_us"],
        )
        times = times.set_axis([f"{key}_{model}" for key, model in times.columns], axis=1)
        times = times.reset_index()
        times["printed"] = 1e6 * times.kn_N_m.map(paper.TIME_TO_PEAK_S)
        limit_us = 1e6 * s.base.bristle().axial_period_s
        off = departs_at(grid.kn_N_m.array, grid.tp_us.array / grid.rule.array)
        draft = prose("eq8", setup=s, off=off, times=times, limit_us=limit_us)
        curves = grid.set_index("kn_MN_m")[["rule", "tp_us"]]
        points = times.set_index("kn_MN_m")[["tp_us_reduced", "printed"]]
        curves = curves.join(points, how="outer").reset_index()
        curves.columns = ["kn_MN_m", "tp_rule_us", "tp_beam_us", "tp_solid_us", "tp_printed_us"]
        drawn = time_to_peak_figure(grid, times, 0.5 * limit_us)
        draft.figure("eq8", drawn, draft.data("eq8_figure", curves, HEADS))
        draft.table(
            "eq8",
            {
                "kn_MN_m": times.kn_MN_m,
                "tp_printed_us": times.printed,
                "tp_rule_us": times.rule,
                "tp_beam_us": times.tp_us_beam,
                "tp_solid_us": times.tp_us_reduced,
                "tp_ratio": times.tp_us_beam / times.rule,
                "contact_rule_us": 2.0 * times.rule,
                "contact_beam_us": times.contact_time_us_beam,
                "contact_solid_us": times.contact_time_us_reduced,
            },
            HEADS | {"kn_MN_m": ("Kn", "MN/m", 0), "tp_printed_us": "tp − ti, printed"},
        )
        rows = pd.DataFrame(
            {"what": what, **record(case, results[case])} for what, case in self._rigid().items()
        )
        rows["of_2L_c"] = rows.contact_time_us / limit_us
        draft.table(
            "rigid_plane",
            rows[["what", "kn_MN_m", "rebound_ratio", "contact_time_us", "of_2L_c"]],
            {"what": "Model", "of_2L_c": "of 2L/c"},
        )
        return draft.section()


@drawing(
    "normal contact stiffness Kn (MN/m)",
    "touch to greatest penetration (µs)",
    height_in=3.4,
    legend="upper right",
)
def time_to_peak_figure(ax: Axes, grid: pd.DataFrame, times: pd.DataFrame, limit_us: float) -> None:
    """Eq. 8 and the beam on a ``grid`` of Kn; ``times`` of the solid, and printed, at some."""
    ax.loglog(grid.kn_MN_m, grid.rule, color=BLACK, ls=":", label="Eq. 8, (π/2)√(m/Kn)")
    ax.loglog(grid.kn_MN_m, grid.tp_us, color=SERIES[0], label="1-D beam")
    points: Labels = {"fillstyle": "none", "ls": "none"}
    ax.plot(times.kn_MN_m, times.tp_us_reduced, "o", color=SERIES[0], label="3-D reduced", **points)
    ax.plot(
        times.kn_MN_m, times.printed, "s", color=VERMILION, label="printed in the paper", **points
    )
    ax.axhline(limit_us, color=GREY, lw=0.8)
    beside(ax, "L/c: a wave to the top", (grid.kn_MN_m.iloc[0], limit_us), above=False)
