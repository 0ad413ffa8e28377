"""Rebound of a leaning bristle, and the error of contact with a point on the axis."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import pandas as pd
from matplotlib.axes import Axes

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
HEADS: dict[str, Head] = {
    "point": "beam, point",
    "face": "beam, face",
    "solid": "3-D reduced, face",
    "second_order": "beam, face, second order",
    "point_minus_face": ("point − face", "", 2),
    "solid_minus_face": ("3-D − beam", "", 2),
    "second_order_minus_face": ("second order − linear", "", 2),
    "kept": "speed kept",
}


@dataclass(frozen=True)
class Leaning(DropStudy):
    """Frictionless lean at several Kn and damping, then friction at one of each."""

    leans_deg: tuple[float, ...] = LEANS_DEG

    @property
    def betas_s(self) -> tuple[float, ...]:
        return tuple(dict.fromkeys((MEASURED_BETA_S, self.setup.base.beta_s)))

    def _case(
        self, way: str, beta_s: float, kn_N_m: float, lean_deg: float, mu: float = 0.0
    ) -> DropInputs:
        given = {"deflection": Deflection.SMALL, "until": Until.IMPACT, **WAYS[way]}
        lean: Labels = {"beta_s": beta_s, "tilt_deg": lean_deg, "friction": mu}
        return self.setup.case(kn_N_m=kn_N_m, **given, **lean)

    def plan(self) -> Iterator[tuple[DropInputs, Labels]]:
        for beta in self.betas_s:
            for kn in self.setup.ends_N_m:
                for lean in self.leans_deg:
                    for way in WAYS:
                        yield self._case(way, beta, kn, lean), {"way": way}
        kn = self.setup.chosen_N_m
        for lean in SLIDING_DEG:
            for mu in FRICTIONS:
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
        draft.figure("leaning", kept_figure(drawn), draft.data("leaning_figure", drawn, HEADS))
        draft.table("leaning", speeds, HEADS)
        columns = ["lean_deg", "mu", "kept", "friction_loss", "impulse_ratio"]
        draft.table("leaning_friction", sliding[columns], HEADS)
        return draft.section()


@drawing("lean (°)", "speed kept", legend="lower left", ylim=(0.0, 1.02), xlim=(0.0, None))
def kept_figure(ax: Axes, speeds: pd.DataFrame) -> None:
    """Share of speed kept against lean, a line a way."""
    looks = {
        "point": {"color": SERIES[1], "ls": ":", "marker": "x", "label": "1-D beam, point on axis"},
        "face": {"color": SERIES[0], "label": "1-D beam, end section", **LOOKS["beam"].line},
        "solid": {"color": BLACK, "label": "3-D reduced", **LOOKS["reduced"].line},
        "second_order": {
            "color": SERIES[2],
            "ls": "-.",
            "marker": "v",
            "label": "1-D beam, second order",
        },
    }
    for way, look in looks.items():
        ax.plot(speeds.lean_deg, speeds[way], **look)
