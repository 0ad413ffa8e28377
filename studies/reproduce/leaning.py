"""Rebound of what leans: a bristle, one whose tip sticks, and bars of several lengths.

Stoianovici and Hurmuzlu (J. Appl. Mech. 63, 1996) dropped bars of several lengths at varied
inclinations: the coefficient of restitution is far from constant, since the bar vibrates and its
tip touches several times in one impact, the more the more slender it is. Their figures are not
repeated here; the sizes of the bars and Kn are ours, the trend is what is compared.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from ...solver import paper
from ...solver.drop import DropResult
from ...solver.rigid import leaning, matrix_of
from ..inputs.choices import Deflection, Model, Tip, Until
from ..inputs.config import DropInputs
from ..report.figures import BLACK, LOOKS, SERIES, drawing
from ..report.page import Head, Section
from .campaign import GOAL, DropStudy, Labels, Results, prose

LEANS_DEG = (0.0, 0.5, 1.0, 2.0, 3.0, 5.0)
SLIDING_DEG = (1.0, 2.0, 5.0)
FRICTIONS = (0.0, 0.02, 0.05, 0.1, 0.2, 0.5)
# Damping by measured wave records of bars, and the paper's.
MEASURED_BETA_S = 1e-8
LINEAR: Labels = {"deflection": Deflection.SMALL, "until": Until.IMPACT}
# How the impact is computed, by its column: the last has the axial force on the slope as well.
WAYS: dict[str, Labels] = {
    "point": {"model": Model.BEAM, "tip": Tip.POINT},
    "face": {"model": Model.BEAM, "tip": Tip.FACE},
    "solid": {"model": Model.REDUCED, "tip": Tip.FACE},
    "second_order": {
        "model": Model.BEAM,
        "tip": Tip.FACE,
        "deflection": Deflection.SECOND_ORDER,
    },
}
LEANING_HEADS: dict[str, Head] = {
    "point": "beam, point",
    "face": "beam, face",
    "solid": "3-D reduced, face",
    "second_order": "beam, face, second order",
    "point_minus_face": ("point − face", "", 2),
    "solid_minus_face": ("3-D − beam", "", 2),
    "second_order_minus_face": ("second order − linear", "", 2),
    "kept": "speed kept",
}

STICKING_DEG = 5.0
ELEMENTS = (8, 16, 32)
ITS_S = (1e-5, 5e-6, 2e-6, 1e-6)
CELLS = ((1, 2, 84), (1, 4, 168), (1, 4, 337))
POINTS = (3, 5, 7, 9, 13)
# Tangential over normal stiffness: Mindlin's, and stiffer up to rigid for every purpose.
KT_RATIOS = (1.0, 10.0, 100.0, 1000.0)
DRAWN = ("beam, point: ITS (ms), 32 elements", "beam, face: ITS (ms), 32 elements")
SOLID = "3-D reduced: ITS (ms)"

LENGTHS_M = (0.1, 0.2, 0.3, 0.4, 0.6)
INCLINATIONS_DEG = (0.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0, 75.0)
DIAMETER_M = 12.7e-3
KN_N_M = 2e7
SPEED_M_S = 1.0
BARS_BETA_S = 1e-8


@dataclass(frozen=True)
class Leaning(DropStudy):
    """Frictionless lean at several Kn and damping, then friction at one of each; and the error of
    contact with a point on the axis."""

    leans_deg: tuple[float, ...] = LEANS_DEG

    def _case(
        self, way: str, beta_s: float, kn_N_m: float, lean_deg: float, mu: float = 0.0
    ) -> DropInputs:
        lean: Labels = {"beta_s": beta_s, "tilt_deg": lean_deg, "friction": mu}
        return self.setup.case(kn_N_m=kn_N_m, **(LINEAR | WAYS[way] | lean))

    def plan(self) -> Iterator[tuple[DropInputs, Labels]]:
        betas = dict.fromkeys((MEASURED_BETA_S, self.setup.base.beta_s))
        for beta, kn, lean, way in product(betas, self.setup.ends_N_m, self.leans_deg, WAYS):
            yield self._case(way, beta, kn, lean), {"way": way}
        kn = self.setup.chosen_N_m
        for lean, mu in product(SLIDING_DEG, FRICTIONS):
            yield self._case("second_order", MEASURED_BETA_S, kn, lean, mu), {"way": "sliding"}

    def section(self, results: Results) -> Section:
        s, drops = self.setup, self.drops(results)
        sliding = drops[drops.way == "sliding"]
        speeds = drops[drops.way != "sliding"].pivot(
            index=["beta_s", "kn_MN_m", "lean_deg"], columns="way", values="kept"
        )[list(WAYS)]
        for way in ("point", "solid", "second_order"):
            speeds[f"{way}_minus_face"] = speeds[way] - speeds.face
        speeds = speeds.reset_index()
        held = sliding.set_index(["lean_deg", "mu"]).kept
        two = min(SLIDING_DEG, key=lambda lean: abs(lean - 2.0))
        draft = prose(
            "leaning",
            setup=s,
            beta_s=MEASURED_BETA_S,
            off=speeds.filter(like="minus").abs().max(),
            at_two=held[two, 0.0],
            steepest=max(SLIDING_DEG),
            most=max(FRICTIONS),
            held=held[max(SLIDING_DEG)],
            goal=GOAL,
        )
        own = (speeds.beta_s == MEASURED_BETA_S) & (speeds.kn_MN_m == s.chosen_N_m / 1e6)
        drawn = speeds.loc[own, ["lean_deg", *WAYS]]
        data = draft.data("leaning_figure", drawn, LEANING_HEADS)
        draft.figure("leaning", leaning_figure(drawn), data)
        draft.table("leaning", speeds, LEANING_HEADS)
        columns = ["lean_deg", "mu", "kept", "friction_loss", "impulse_ratio"]
        draft.table("leaning_friction", sliding[columns], LEANING_HEADS)
        return draft.section()


@drawing("lean (°)", "speed kept", legend="lower left", ylim=(0.0, 1.02), xlim=(0.0, None))
def leaning_figure(ax: Axes, speeds: pd.DataFrame) -> None:
    """Share of speed kept against lean, a line a way."""
    for way, label, colour, look in (
        ("point", "1-D beam, point on axis", SERIES[1], {"ls": ":", "marker": "x"}),
        ("face", "1-D beam, end section", SERIES[0], LOOKS["beam"].line),
        ("solid", "3-D reduced", BLACK, LOOKS["reduced"].line),
        ("second_order", "1-D beam, second order", SERIES[2], {"ls": "-.", "marker": "v"}),
    ):
        ax.plot(speeds.lean_deg, speeds[way], label=label, color=colour, **look)


@dataclass(frozen=True)
class Sticking(DropStudy):
    """Convergence of a tip that sticks: a bristle that leans by 5° on a plane with μ = 0.5, with
    modes, cells and time step."""

    elements: tuple[int, ...] = ELEMENTS
    its_s: tuple[float, ...] = ITS_S
    cells: tuple[tuple[int, int, int], ...] = CELLS
    points: tuple[int, ...] = POINTS

    def _families(self) -> dict[str, dict[str, Labels]]:
        """What differs from case to case, by what is refined and the case's label."""
        steps = {f"{1e3 * its:g}": {"its_s": its} for its in self.its_s}
        fine = {"elements": 32, "its_s": 2e-6}
        families: dict[str, dict[str, Labels]] = {}
        for tip in (Tip.POINT, Tip.FACE):
            families |= {
                f"beam, {tip}: elements, ITS 0.002 ms": {
                    str(n): {**fine, "tip": tip, "elements": n} for n in self.elements
                },
                f"beam, {tip}: ITS (ms), 32 elements": {
                    at: {"tip": tip, "elements": 32, **step} for at, step in steps.items()
                },
                f"beam, {tip}: Kt/Kn, 32 elements, ITS 0.002 ms": {
                    f"{ratio:g}": {**fine, "tip": tip, "kt_ratio": ratio} for ratio in KT_RATIOS
                },
            }
        solid = {"model": Model.REDUCED}
        return families | {
            "beam, face: points across the section, ITS 0.002 ms": {
                str(n): {**fine, "contact_points": n} for n in self.points
            },
            "3-D reduced: cells": {
                " × ".join(map(str, cells)): {**solid, "cells": cells} for cells in self.cells
            },
            SOLID: {at: {**solid, **step} for at, step in list(steps.items())[:3]},
        }

    def plan(self) -> Iterator[tuple[DropInputs, Labels]]:
        usual = LINEAR | WAYS["face"] | {"beta_s": MEASURED_BETA_S, "tilt_deg": STICKING_DEG}
        usual |= {"friction": paper.FRICTION, "kn_N_m": self.setup.chosen_N_m}
        for refined, family in self._families().items():
            for at, changes in family.items():
                yield self.setup.case(**usual | changes), {"refined": refined, "at": at}

    def section(self, results: Results) -> Section:
        drops = self.drops(results)
        families = drops.groupby("refined", sort=False).kept
        drops["from_last"] = drops.kept - families.transform("last")
        spread = families.agg(np.ptp)
        draft = prose(
            "sticking",
            setup=self.setup,
            lean_deg=STICKING_DEG,
            beta_s=MEASURED_BETA_S,
            **{
                name: spread[spread.index.str.contains(part)].max()
                for name, part in (("solid", "3-D"), ("face", "face:"), ("point", "point:"))
            },
        )
        columns = ["refined", "at", "kept", "from_last", "impulse_ratio", "friction_loss"]
        draft.table(
            "sticking",
            drops[columns],
            {"kept": ("speed kept", "", 6), "from_last": ("from the finest", "", 2)},
        )
        drawn = drops[drops.refined.isin((*DRAWN, SOLID))]
        drawn = drawn.assign(model=drawn.refined.str.partition(":")[0], its_s=drawn.its_ms / 1e3)
        data = draft.data("sticking_figure", drawn[["model", "its_s", "kept"]])
        draft.figure("sticking", sticking_figure(drawn), data)
        return draft.section()


@drawing("ITS (ms)", "speed kept")
def sticking_figure(ax: Axes, drops: pd.DataFrame) -> None:
    """Speed kept against the time step, a line a model."""
    looks = [{"ls": ":", "marker": "x"}, {"ls": "-", "marker": "o"}, LOOKS["reduced"].line]
    models = drops.groupby("model", sort=False)
    for (name, own), colour, look in zip(models, SERIES, looks, strict=False):
        ax.semilogx(own.its_ms, own.kept, color=colour, label=name, **look)
    steps = sorted(set(drops.its_ms))
    ax.set_xticks(steps, [f"{step:g}" for step in steps])
    ax.minorticks_off()
    low, high = drops.kept.min(), drops.kept.max()
    room = max(0.02, 0.2 * (high - low))
    ax.set_ylim(math.floor(100 * (low - room)) / 100, min(1.0, high + room))


def restitution(result: DropResult, case: DropInputs) -> float:
    """Vertical speed of the tip after over before, of the rigid part of the motion."""
    rotation = np.asarray(matrix_of(leaning(case.tilt_deg)))
    arm = np.array([0.0, 0.0, -0.5 * case.bristle().length_m])
    turning = rotation @ np.cross(np.array(result.spin_after_rad_s), arm)
    return float(result.velocity_after_m_s[2] + turning[2]) / result.impact_speed_m_s


def rigid_speed(lean_deg: float, length_m: float, diameter_m: float) -> float:
    """Speed of the centre kept by a rigid bar, elastic point contact, no friction.

    The impulse 2 v / (1/m + a²/I) at the arm a = L/2 sin(lean) (Newton and Euler's equations).
    """
    inertia = length_m**2 / 12.0 + diameter_m**2 / 16.0
    arm = 0.5 * length_m * math.sin(math.radians(lean_deg))
    return 2.0 / (1.0 + arm**2 / inertia) - 1.0


@dataclass(frozen=True)
class Bars(DropStudy):
    """Steel bars of several lengths, dropped at inclinations on a frictionless plane."""

    lengths_m: tuple[float, ...] = LENGTHS_M
    leans_deg: tuple[float, ...] = INCLINATIONS_DEG

    def plan(self) -> Iterator[tuple[DropInputs, Labels]]:
        gravity = self.setup.base.gravity_m_s2
        bar = DropInputs(
            **LINEAR | WAYS["point"],
            diameter_m=DIAMETER_M,
            beta_s=BARS_BETA_S,
            kn_N_m=KN_N_M,
            height_m=SPEED_M_S**2 / (2.0 * gravity),
            friction=0.0,
            elements=48,
            its_s=1e-6,
            gravity_m_s2=gravity,
        )
        for length, lean in product(self.lengths_m, self.leans_deg):
            rigid = rigid_speed(lean, length, DIAMETER_M)
            case = bar.changed(length_m=length, tilt_deg=lean)
            yield case, {"length_mm": 1e3 * length, "rigid": rigid}

    def section(self, results: Results) -> Section:
        bars = self.drops(results)
        bars["restitution"] = [restitution(results[case], case) for case in self.cases()]
        ends = bars.groupby("length_mm").agg({"restitution": "min", "touches": "max"}).iloc[[0, -1]]
        draft = prose(
            "bars",
            diameter_m=DIAMETER_M,
            kn_N_m=KN_N_M,
            speed_m_s=SPEED_M_S,
            beta_s=BARS_BETA_S,
            ends=ends.reset_index().to_dict("records"),
        )
        table = draft.data(
            "bars",
            bars[["length_mm", "lean_deg", "restitution", "touches", "kept", "rigid"]],
            {
                "length_mm": ("length", "mm", 0),
                "lean_deg": ("lean from vertical", "°", 0),
                "restitution": "e of the tip",
                "kept": "speed of the centre kept",
                "rigid": "rigid bar",
            },
        )
        draft.figure("bars", restitution_figure(bars), table)
        return draft.section()


@drawing("lean from vertical (°)", "restitution e of the tip", legend=None, ylim=(0.0, None))
def restitution_figure(ax: Axes, bars: pd.DataFrame) -> None:
    """Restitution against lean, a line a length."""
    ax.axhline(1.0, color=BLACK, lw=0.8, ls="--", label="rigid bar")
    lengths = bars.groupby("length_mm")
    for (length, own), colour, marker in zip(lengths, SERIES, "os^vDxP", strict=False):
        ax.plot(own.lean_deg, own.restitution, marker, ls="-", color=colour, label=f"{length:g} mm")
    ax.legend(ncols=3, loc="lower right")
