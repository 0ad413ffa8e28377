"""Restitution of bars against inclination and length, beside bars that were dropped.

Stoianovici and Hurmuzlu (J. Appl. Mech. 63, 1996) dropped bars of several lengths at varied
inclinations: the coefficient of restitution is far from constant, since the bar vibrates and its
tip touches several times in one impact, the more the more slender it is. Their figures are not
repeated here; the sizes of the bars and Kn are ours, the trend is what is compared.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure as Drawing

from ...solver.drop import DropResult
from ...solver.rigid import leaning, matrix_of
from ..inputs.choices import Deflection, Model, Tip, Until
from ..inputs.config import DropInputs
from ..report.figures import BLACK, SERIES, panels, picture, styled
from ..report.page import Column, Figure, Section, Table, Value, show
from .campaign import Results, Setup

LENGTHS_M = (0.1, 0.2, 0.3, 0.4, 0.6)
INCLINATIONS_DEG = (0.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0, 75.0)
DIAMETER_M = 12.7e-3
KN_N_M = 2e7
SPEED_M_S = 1.0
BETA_S = 1e-8
ITS_S = 1e-6


def restitution(result: DropResult, lean_deg: float, length_m: float) -> float:
    """Vertical speed of the tip after over before, of the rigid part of the motion."""
    rotation = np.asarray(matrix_of(leaning(lean_deg)))
    arm = np.array([0.0, 0.0, -0.5 * length_m])
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
class Bars:
    """Steel bars of several lengths, dropped at inclinations on a frictionless plane."""

    setup: Setup
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

    def cases(self) -> list[DropInputs]:
        return [self._case(length, lean) for length in self.lengths_m for lean in self.leans_deg]

    def section(self, results: Results) -> Section:
        table = Table(
            "bars",
            f"Steel bars of {1e3 * DIAMETER_M:g} mm, Kn = {KN_N_M / 1e6:g} MN/m, "
            f"{SPEED_M_S:g} m/s, β = {BETA_S:g} s, no friction.",
            (
                Column("length_mm", "length", "mm", 0),
                Column("lean_deg", "lean from vertical", "°", 0),
                Column("restitution", "e of the tip"),
                Column("touches", "touches"),
                Column("kept", "speed of the centre kept"),
                Column("rigid", "rigid bar"),
            ),
            [
                self._row(results, length, lean)
                for length in self.lengths_m
                for lean in self.leans_deg
            ],
            "A rigid bar keeps e = 1 at every inclination, in one touch.",
        )
        lowest = {
            length: min(self._e(results, length, lean) for lean in self.leans_deg)
            for length in (min(self.lengths_m), max(self.lengths_m))
        }
        most = {
            length: max(results[self._case(length, lean)].n_contacts for lean in self.leans_deg)
            for length in lowest
        }
        short, long = lowest
        text = [
            "A rigid bar on an elastic contact has e = 1 whatever its inclination. A real one "
            "vibrates, and its tip comes back before the bar has gone: the shortest bar "
            f"({1e3 * short:g} mm) touches at most {most[short]} times and e stays above "
            f"{show(lowest[short], 2)}; the longest ({1e3 * long:g} mm) touches up to "
            f"{most[long]} times and e falls to {show(lowest[long], 2)}.",
            "This is the trend that Stoianovici and Hurmuzlu (J. Appl. Mech. 63, 1996) found with "
            "steel bars: e varies with inclination, more for slender bars, by internal vibration "
            "and several collisions in one impact. Lengths, diameter and Kn are assumptions here.",
        ]
        return Section(
            "bars", "Bars of several lengths", text, figures=[self._figure(results, table)]
        )

    def _e(self, results: Results, length_m: float, lean_deg: float) -> float:
        return restitution(results[self._case(length_m, lean_deg)], lean_deg, length_m)

    def _row(self, results: Results, length_m: float, lean_deg: float) -> tuple[Value, ...]:
        found = results[self._case(length_m, lean_deg)]
        return (
            1e3 * length_m,
            lean_deg,
            self._e(results, length_m, lean_deg),
            found.n_contacts,
            found.cm_velocity_after_m_s / found.impact_speed_m_s,
            rigid_speed(lean_deg, length_m, DIAMETER_M),
        )

    def _figure(self, results: Results, table: Table) -> Figure:
        curves = {
            length: [self._e(results, length, lean) for lean in self.leans_deg]
            for length in self.lengths_m
        }
        return Figure(
            "bars",
            "Coefficient of restitution of the tip against inclination, bars of several lengths.",
            picture(_drawing(self.leans_deg, curves)),
            "Restitution against inclination, a line for each length",
            table,
        )


@styled
def _drawing(leans_deg: tuple[float, ...], curves: dict[float, list[float]]) -> Drawing:
    figure, axes = panels()
    ax = axes[0, 0]
    ax.axhline(1.0, color=BLACK, lw=0.8, ls="--", label="rigid bar")
    for (length, values), colour, marker in zip(curves.items(), SERIES, "os^vDxP", strict=False):
        ax.plot(leans_deg, values, color=colour, marker=marker, label=f"{1e3 * length:g} mm")
    ax.set(xlabel="lean from vertical (°)", ylabel="restitution e of the tip", ylim=(0.0, None))
    ax.legend(ncols=3, loc="lower right")
    return figure
