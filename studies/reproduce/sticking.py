"""Convergence of a tip that sticks, with modes, cells and time step."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from ...solver import paper
from ..inputs.choices import Deflection, Model, Tip, Until
from ..inputs.config import DropInputs
from ..report.figures import LOOKS, SERIES, drawing
from ..report.page import Section
from .campaign import DropStudy, Labels, Results, prose
from .leaning import MEASURED_BETA_S

LEAN_DEG = 5.0
ELEMENTS = (8, 16, 32)
ITS_S = (1e-5, 5e-6, 2e-6, 1e-6)
CELLS = ((1, 2, 84), (1, 4, 168), (1, 4, 337))
POINTS = (3, 5, 7, 9, 13)
# Tangential over normal stiffness: Mindlin's, and stiffer up to rigid for every purpose.
KT_RATIOS = (1.0, 10.0, 100.0, 1000.0)
DRAWN = ("beam, point: ITS (ms), 32 elements", "beam, face: ITS (ms), 32 elements")
SOLID = "3-D reduced: ITS (ms)"


@dataclass(frozen=True)
class Sticking(DropStudy):
    """A bristle that leans by 5° on a plane with μ = 0.5, refined in every way."""

    elements: tuple[int, ...] = ELEMENTS
    its_s: tuple[float, ...] = ITS_S
    cells: tuple[tuple[int, int, int], ...] = CELLS
    points: tuple[int, ...] = POINTS

    def _families(self) -> dict[str, dict[str, dict[str, Any]]]:
        """What differs from case to case, by what is refined and the case's label."""
        steps = {f"{1e3 * its:g}": {"its_s": its} for its in self.its_s}
        fine = {"elements": 32, "its_s": 2e-6}
        families: dict[str, dict[str, dict[str, Any]]] = {}
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
        usual: Labels = {"model": Model.BEAM, "tip": Tip.FACE, "beta_s": MEASURED_BETA_S}
        usual |= {"tilt_deg": LEAN_DEG, "friction": paper.FRICTION, "until": Until.IMPACT}
        usual |= {"deflection": Deflection.SMALL, "kn_N_m": self.setup.chosen_N_m}
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
            lean_deg=LEAN_DEG,
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
        draft.figure("sticking", kept_figure(drawn), data)
        return draft.section()


@drawing("ITS (ms)", "speed kept")
def kept_figure(ax: Axes, drops: pd.DataFrame) -> None:
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
