"""Tip height against time for every height and Kn of Fig. 13, in 1-D and 3-D."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from ...solver import paper
from ...solver.arrays import Array
from ...solver.drop import DropResult
from ..inputs.config import DropInputs
from ..report.page import Head, Section
from ..report.paper_figures import height_figure
from .campaign import DropStudy, Labels, Results, prose

BODIES = ("beam", "reduced")
SAMPLES = 120


def track(result: DropResult, samples: int = SAMPLES) -> tuple[Array, Array]:
    """Time and tip height, thinned to about ``samples`` equal times; the deepest instant stays."""
    rows = result.history.array()
    keep = np.searchsorted(rows[:, 0], np.linspace(0.0, rows[-1, 0], samples))
    keep = np.unique(np.append(np.minimum(keep, len(rows) - 1), np.argmin(rows[:, 1])))
    return rows[keep, 0], rows[keep, 1]


class Figure13(DropStudy):
    """Tip height against time, from release to the second impact."""

    def plan(self) -> Iterator[tuple[DropInputs, Labels]]:
        for height in self.setup.heights_m:
            for kn in self.setup.kn_N_m:
                for model in BODIES:
                    yield self.setup.case(model, kn, height), {}

    def cases(self) -> list[DropInputs]:
        return [*super().cases(), self.setup.rigid("beam")]

    def section(self, results: Results) -> Section:
        s, drops = self.setup, self.drops(results)
        drops["rebound_ratio"] = drops.rebound_ratio.astype(float)
        by_model = drops.pivot(index=["y0_mm", "kn_MN_m"], columns="model", values="rebound_ratio")
        ratios = by_model[list(BODIES)].set_axis(["ratio_1d", "ratio_3d"], axis=1).reset_index()
        ratios["apart"] = ratios.ratio_1d / ratios.ratio_3d - 1.0
        ratios["y1_mm"] = ratios.y0_mm * ratios.ratio_1d
        top = ratios[ratios.y0_mm == 1e3 * s.top_m].set_index("kn_MN_m")
        draft = prose(
            "fig13",
            setup=s,
            ratios=ratios,
            apart=ratios.apart.abs().max(),
            spread=ratios.groupby("kn_MN_m").ratio_1d.agg(np.ptp).max(),
            printed=[
                (kn, printed, top.loc[kn / 1e6])
                for kn, printed in paper.RATIO_AT_KN.items()
                if kn in s.kn_N_m
            ],
            limit=results[s.rigid("beam")].rebound_ratio,
        )
        tracks = {(c.model.value, c.height_m, c.kn_N_m): results[c] for c, _ in self.plan()}
        drawn = height_figure({key: track(result) for key, result in tracks.items()})
        draft.figure("fig13", drawn, draft.data("fig13_curves", *self._curves(tracks)))
        draft.table(
            "fig13_ratios",
            ratios,
            {
                "ratio_1d": "y1/y0, 1-D",
                "ratio_3d": "y1/y0, 3-D",
                "apart": ("1-D from 3-D", "relative", 2),
                "y1_mm": "y1, 1-D",
            },
        )
        return draft.section()

    def _curves(
        self, tracks: dict[tuple[str, float, float], DropResult]
    ) -> tuple[pd.DataFrame, dict[str, Head]]:
        """Heights at the same times for all that fall from the same height, until each ends."""
        heads: dict[str, Head] = {
            f"{m}_{kn / 1e6:g}_MN_m_mm": f"{m}, {kn / 1e6:g} MN/m" for m, _, kn in tracks
        }
        frames = []
        for height in self.setup.heights_m:
            own = [each.history.array() for key, each in tracks.items() if key[1] == height]
            t = np.linspace(0.0, max(rows[-1, 0] for rows in own), SAMPLES)
            curves = [1e3 * np.interp(t, rows[:, 0], rows[:, 1], right=np.nan) for rows in own]
            columns = dict(zip(heads, curves, strict=True))
            frames.append(pd.DataFrame({"y0_mm": 1e3 * height, "t_ms": 1e3 * t, **columns}))
        return pd.concat(frames).round(4), heads
