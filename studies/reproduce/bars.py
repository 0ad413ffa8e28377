"""Restitution of bars against inclination and length, beside bars that were dropped.

Stoianovici and Hurmuzlu (J. Appl. Mech. 63, 1996) dropped bars of several lengths at varied
inclinations: the coefficient of restitution is far from constant, since the bar vibrates and its
tip touches several times in one impact, the more the more slender it is. Their figures are not
repeated here; the sizes of the bars and Kn are ours, the trend is what is compared.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from ...solver.drop import DropResult
from ...solver.rigid import leaning, matrix_of
from ..inputs.choices import Deflection, Model, Tip, Until
from ..inputs.config import DropInputs
from ..report.figures import BLACK, SERIES, drawing
from ..report.page import Section
from .campaign import DropStudy, Labels, Results, prose

LENGTHS_M = (0.1, 0.2, 0.3, 0.4, 0.6)
INCLINATIONS_DEG = (0.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0, 75.0)
DIAMETER_M = 12.7e-3
KN_N_M = 2e7
SPEED_M_S = 1.0
BETA_S = 1e-8
ITS_S = 1e-6


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

    def _case(self, length_m: float, lean_deg: float) -> DropInputs:
        height = SPEED_M_S**2 / (2.0 * self.setup.base.gravity_m_s2)
        return DropInputs(
            model=Model.BEAM,
            length_m=length_m,
            diameter_m=DIAMETER_M,
            beta_s=BETA_S,
            kn_N_m=KN_N_M,
            height_m=height,
            tilt_deg=lean_deg,
            friction=0.0,
            tip=Tip.POINT,
            elements=48,
            its_s=ITS_S,
            until=Until.IMPACT,
            deflection=Deflection.SMALL,
            gravity_m_s2=self.setup.base.gravity_m_s2,
        )

    def plan(self) -> Iterator[tuple[DropInputs, Labels]]:
        for length in self.lengths_m:
            for lean in self.leans_deg:
                rigid = rigid_speed(lean, length, DIAMETER_M)
                yield self._case(length, lean), {"length_mm": 1e3 * length, "rigid": rigid}

    def section(self, results: Results) -> Section:
        bars = self.drops(results)
        bars["restitution"] = [restitution(results[case], case) for case in self.cases()]
        ends = bars.groupby("length_mm").agg({"restitution": "min", "touches": "max"}).iloc[[0, -1]]
        draft = prose(
            "bars",
            diameter_m=DIAMETER_M,
            kn_N_m=KN_N_M,
            speed_m_s=SPEED_M_S,
            beta_s=BETA_S,
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
