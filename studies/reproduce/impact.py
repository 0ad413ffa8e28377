"""The impact itself: penetration against time (Fig. 9), and its duration against Kn (Eq. 8)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from ...solver import paper
from ...solver.analytic import penetration_m, quarter_period_s
from ...solver.arrays import Array
from ...solver.drop import DropResult
from ..calibrate.calibration import short_its_s
from ..inputs.config import DropInputs
from ..report.figures import (
    BLACK,
    GREY,
    LOOKS,
    SERIES,
    VERMILION,
    beside,
    drawing,
    model_legend,
)
from ..report.page import Head, Section
from .campaign import BODIES, DropStudy, Labels, Results, named, prose, record

GRID_N_M = tuple(float(f"{kn:.4g}") for kn in np.geomspace(1e4, 1e8, 25))
OFF = 0.10
TIMES: dict[str, Head] = {
    "kn_MN_m": ("Kn", "MN/m", 3),
    "tp_printed_us": "printed",
    "tp_rule_us": "Eq. 8",
    "tp_beam_us": "1-D",
    "tp_solid_us": "3-D",
    "tp_ratio": ("1-D over Eq. 8", "", 3),
    "contact_rule_us": "contact, 2(tp − ti)",
    "contact_beam_us": "contact, 1-D",
    "contact_solid_us": "contact, 3-D",
}


def window(result: DropResult) -> tuple[Array, Array]:
    """Time since first touch and penetration, (n,) each in SI, while the first impact lasts."""
    rows = result.history.array()
    touched = np.flatnonzero(rows[:, 3] > 0.0)
    start = max(int(touched[0]) - 1, 0)
    t = rows[start:, 0] - rows[start, 0]
    inside = t <= result.contact_time_s * (1.0 + 1e-9)
    return t[inside], rows[start:, 4][inside]


class Figure9(DropStudy):
    """Penetration against time at the chosen Kn."""

    def plan(self) -> Iterator[tuple[DropInputs, Labels]]:
        for height, model in product(self.setup.fig9_heights_m, BODIES):
            yield self.setup.case(model, self.setup.chosen_N_m, height), {}

    def section(self, results: Results) -> Section:
        s, kn = self.setup, self.setup.chosen_N_m
        curves = {
            (case.model.value, 1e3 * case.height_m): window(results[case]) for case in self.cases()
        }
        mass, gravity = s.base.bristle().mass_kg, s.base.gravity_m_s2
        t = np.linspace(0.0, 2.0 * quarter_period_s(mass, kn), 161)
        for height in s.fig9_heights_m:
            curves["analytic", 1e3 * height] = t, penetration_m(t, mass, kn, height, gravity)
        frames = {
            key: pd.DataFrame({"time_us": 1e6 * t, "penetration_um": 1e6 * depth})
            for key, (t, depth) in curves.items()
        }
        data = pd.concat(frames, names=["model", "y0_mm"]).reset_index(["model", "y0_mm"])
        one, full = (results[s.case(model, kn)] for model in ("beam", "solid"))
        draft = prose("fig9", setup=s, one=one, full=full, rule=s.analytic(kn))
        shown = data.assign(model=named(data.model))
        table = draft.data("fig9", shown, {"time_us": "time since touch"})
        draft.figure("fig9", penetration_figure(data), table)
        return draft.section()


@drawing("time since touch (µs)", "penetration (µm)", height_in=3.8, legend=None, xlim=(0, None))
def penetration_figure(ax: Axes, data: pd.DataFrame) -> None:
    """Fig. 9: penetration against time since touch, a line a model and height."""
    colours = dict(zip(sorted(set(data.y0_mm)), SERIES, strict=False))
    for (model, height), own in data.groupby(["model", "y0_mm"], sort=False):
        ax.plot(own.time_us, own.penetration_um, color=colours[height], **LOOKS[model].line)
        if model == "analytic":
            top = own.loc[own.penetration_um.idxmax()]
            at, look = (top.time_us, top.penetration_um), {"color": colours[height], "fontsize": 8}
            beside(ax, f"y0 = {height:g} mm", at, "center", **look)
    model_legend(ax, [model for model in LOOKS if model in set(data.model)], loc="upper right")
    ax.set_ylim(0, None)
    ax.set_ylim(0, 1.08 * ax.get_ylim()[1])


def departs_at(kn_N_m: Array, ratio: Array) -> float | None:
    """Kn at which ``ratio`` (1 where Eq. 8 holds) first leaves 1 by `OFF`; None if never."""
    apart = np.abs(np.asarray(ratio) - 1.0)
    gone = np.flatnonzero(apart > OFF)
    if not len(gone):
        return None
    between = slice(max(gone[0] - 1, 0), gone[0] + 1)
    return float(np.exp(np.interp(OFF, apart[between], np.log(kn_N_m[between]))))


@dataclass(frozen=True)
class PeakTime(DropStudy):
    """Time to greatest penetration and contact time: Eq. 8 beside beam and solid, and the limit of
    a rigid plane."""

    grid_N_m: tuple[float, ...] = GRID_N_M

    def plan(self) -> Iterator[tuple[DropInputs, Labels]]:
        mass = self.setup.base.bristle().mass_kg
        for grid, models in ((self.setup.kn_N_m, ("beam", "reduced")), (self.grid_N_m, ("beam",))):
            for kn in grid:
                rule_us = 1e6 * quarter_period_s(mass, kn)
                labels = {"tp_rule_us": rule_us, "grid": grid is self.grid_N_m, "kn_N_m": kn}
                for model in models:
                    yield self.setup.case(model, kn, its_s=short_its_s(mass, kn)), labels

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
        grid = drops[drops.grid].rename(columns={"tp_us": "tp_beam_us"})
        times = drops[~drops.grid].pivot(
            index=["kn_N_m", "kn_MN_m", "tp_rule_us"],
            columns="model",
            values=["tp_us", "contact_time_us"],
        )
        bodies = {"beam": "beam", "reduced": "solid"}
        times = times.set_axis(
            [f"{key.partition('_')[0]}_{bodies[model]}_us" for key, model in times.columns], axis=1
        ).reset_index()
        times["tp_printed_us"] = 1e6 * times.kn_N_m.map(paper.TIME_TO_PEAK_S)
        times["tp_ratio"] = times.tp_beam_us / times.tp_rule_us
        times["contact_rule_us"] = 2.0 * times.tp_rule_us
        limit_us = 1e6 * s.base.bristle().axial_period_s
        off = departs_at(grid.kn_N_m.array, grid.tp_beam_us.array / grid.tp_rule_us.array)
        draft = prose("eq8", setup=s, off=off, times=times, limit_us=limit_us)
        curves = grid.set_index("kn_MN_m")[["tp_rule_us", "tp_beam_us"]]
        points = times.set_index("kn_MN_m")[["tp_solid_us", "tp_printed_us"]]
        data = draft.data("eq8_figure", curves.join(points, how="outer").reset_index(), TIMES)
        draft.figure("eq8", time_to_peak_figure(grid, times, 0.5 * limit_us), data)
        heads = TIMES | {"kn_MN_m": ("Kn", "MN/m", 0), "tp_printed_us": "tp − ti, printed"}
        draft.table("eq8", times[list(TIMES)], heads)
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
    ax.loglog(grid.kn_MN_m, grid.tp_rule_us, color=BLACK, ls=":", label="Eq. 8, (π/2)√(m/Kn)")
    ax.loglog(grid.kn_MN_m, grid.tp_beam_us, color=SERIES[0], label="1-D beam")
    for points, marker, colour, label in (
        (times.tp_solid_us, "o", SERIES[0], "3-D reduced"),
        (times.tp_printed_us, "s", VERMILION, "printed in the paper"),
    ):
        look: Labels = {"ls": "none", "fillstyle": "none", "color": colour, "label": label}
        ax.plot(times.kn_MN_m, points, marker, **look)
    ax.axhline(limit_us, color=GREY, lw=0.8)
    beside(ax, "L/c: a wave to the top", (grid.kn_MN_m.iloc[0], limit_us), above=False)
