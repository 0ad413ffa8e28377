"""Convergence of a tip that sticks, with modes, cells and time step."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Drawing

from ...solver import paper
from ..inputs.choices import Deflection, Model, Tip, Until
from ..inputs.config import DropInputs
from ..report.figures import LOOKS, SERIES, panels, picture, styled
from ..report.page import Column, Figure, Section, Table, Value, show
from .campaign import Results, Setup
from .leaning import MEASURED_BETA_S, kept

LEAN_DEG = 5.0
ELEMENTS = (8, 16, 32)
ITS_S = (1e-5, 5e-6, 2e-6, 1e-6)
CELLS = ((1, 2, 84), (1, 4, 168), (1, 4, 337))
POINTS = (3, 5, 7, 9, 13)
# Tangential over normal stiffness: Mindlin's, and stiffer up to rigid for every purpose.
KT_RATIOS = (1.0, 10.0, 100.0, 1000.0)


@dataclass(frozen=True)
class Sticking:
    """A bristle that leans by 5° on a plane with μ = 0.5, refined in every way."""

    setup: Setup
    elements: tuple[int, ...] = ELEMENTS
    its_s: tuple[float, ...] = ITS_S
    cells: tuple[tuple[int, int, int], ...] = CELLS
    points: tuple[int, ...] = POINTS

    def _case(self, model: str = Model.BEAM, tip: Tip = Tip.FACE, **changes: Any) -> DropInputs:
        return self.setup.case(
            model,
            self.setup.chosen_N_m,
            tip=tip,
            beta_s=MEASURED_BETA_S,
            tilt_deg=LEAN_DEG,
            friction=paper.FRICTION,
            until=Until.IMPACT,
            deflection=Deflection.SMALL,
            **changes,
        )

    def _families(self) -> dict[str, list[tuple[str, DropInputs]]]:
        """The cases by what is refined: a label and the inputs of each."""
        families: dict[str, list[tuple[str, DropInputs]]] = {}
        for tip in (Tip.POINT, Tip.FACE):
            families[f"beam, {tip}: elements, ITS 0.002 ms"] = [
                (str(n), self._case(tip=tip, elements=n, its_s=2e-6)) for n in self.elements
            ]
            families[f"beam, {tip}: ITS (ms), 32 elements"] = [
                (f"{1e3 * its:g}", self._case(tip=tip, elements=32, its_s=its))
                for its in self.its_s
            ]
            families[f"beam, {tip}: Kt/Kn, 32 elements, ITS 0.002 ms"] = [
                (f"{r:g}", self._case(tip=tip, elements=32, its_s=2e-6, kt_ratio=r))
                for r in KT_RATIOS
            ]
        families["beam, face: points across the section, ITS 0.002 ms"] = [
            (str(n), self._case(elements=32, its_s=2e-6, contact_points=n)) for n in self.points
        ]
        families["3-D reduced: cells"] = [
            (" × ".join(map(str, cells)), self._case(Model.REDUCED, cells=cells))
            for cells in self.cells
        ]
        families["3-D reduced: ITS (ms)"] = [
            (f"{1e3 * its:g}", self._case(Model.REDUCED, its_s=its)) for its in self.its_s[:3]
        ]
        return families

    def cases(self) -> list[DropInputs]:
        return [case for family in self._families().values() for _, case in family]

    def section(self, results: Results) -> Section:
        rows: list[tuple[Value, ...]] = []
        for name, family in self._families().items():
            last = kept(results[family[-1][1]])
            for label, case in family:
                found = results[case]
                rows.append(
                    (
                        name,
                        label,
                        kept(found),
                        kept(found) - last,
                        found.friction_impulse_N_s / found.impulse_N_s,
                        found.energy.friction_loss_J / found.energy.initial_J,
                    )
                )
        table = Table(
            "sticking",
            f"Lean {LEAN_DEG:g}°, μ = {paper.FRICTION:g}, Kn = "
            f"{self.setup.chosen_N_m / 1e6:g} MN/m, β = {MEASURED_BETA_S:g} s.",
            (
                Column("refined", "refined"),
                Column("at", "at"),
                Column("kept", "speed kept", "", 6),
                Column("from_last", "from the finest", "", 2),
                Column("impulse_ratio", "friction over normal impulse", "", 3),
                Column("friction_loss", "lost to friction", "of the energy", 2),
            ),
            rows,
        )
        spread = {
            name: max(kept(results[case]) for _, case in family)
            - min(kept(results[case]) for _, case in family)
            for name, family in self._families().items()
        }
        point = max(value for name, value in spread.items() if "point:" in name)
        face = max(value for name, value in spread.items() if "face:" in name)
        solid = max(value for name, value in spread.items() if "3-D" in name)
        text = [
            "Friction enters through an elastic spring of Mindlin's stiffness behind Coulomb's "
            "limit, so a tip that sticks does not creep, and the force that holds it is finite. "
            "With that spring every model has a limit; the table refines one thing at a time.",
            f"Over all refinements the speed kept moves by {show(solid, 2)} in 3-D, by "
            f"{show(face, 2)} in the beam with its end section and by {show(point, 2)} in the beam "
            "with a point on the axis. The stiffer the spring, the more the point depends on "
            "elements and step: a rigid point that sticks stops a node of vanishing mass at once, "
            "and a one-dimensional model has no limit for that.",
        ]
        return Section(
            "sticking",
            "A tip that sticks: modes, cells, steps",
            text,
            figures=[self._figure(results)],
            tables=[table],
        )

    def _figure(self, results: Results) -> Figure:
        names = ("beam, point: ITS (ms), 32 elements", "beam, face: ITS (ms), 32 elements")
        families = self._families()
        curves = {
            name.split(":")[0]: (
                np.array([case.its_s for _, case in families[name]]),
                np.array([kept(results[case]) for _, case in families[name]]),
            )
            for name in (*names, "3-D reduced: ITS (ms)")
        }
        data = Table(
            "sticking_figure",
            "Speed kept against the integration time step.",
            (Column("model", "model"), Column("its_s", "ITS", "s", 0), Column("kept", "kept")),
            [
                (name, float(its), float(value))
                for name, (steps, values) in curves.items()
                for its, value in zip(steps, values, strict=True)
            ],
        )
        return Figure(
            "sticking",
            "Speed kept by a sticking tip against the integration time step.",
            picture(_drawing(curves)),
            "Speed kept against time step for point, face and solid",
            data,
        )


@styled
def _drawing(curves: dict[str, tuple[np.ndarray, np.ndarray]]) -> Drawing:
    figure, axes = panels()
    ax = axes[0, 0]
    looks = [{"ls": ":", "marker": "x"}, {"ls": "-", "marker": "o"}, LOOKS["reduced"].line]
    for (name, (steps, values)), colour, look in zip(curves.items(), SERIES, looks, strict=False):
        ax.semilogx(1e3 * steps, values, color=colour, label=name, **look)
    tried = np.unique(np.concatenate([1e3 * steps for steps, _ in curves.values()]))
    ax.set_xticks(tried, [f"{step:g}" for step in tried])
    ax.minorticks_off()
    every = np.concatenate([values for _, values in curves.values()])
    room = max(0.02, 0.2 * float(np.ptp(every)))
    ax.set(
        xlabel="ITS (ms)",
        ylabel="speed kept",
        ylim=(math.floor(100 * (every.min() - room)) / 100, min(1.0, every.max() + room)),
    )
    ax.legend()
    return figure
