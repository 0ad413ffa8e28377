"""Rebound against height and Kn: the cloud of drops (Figs. 10 to 12), Kn, and Fig. 13."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
import pandas as pd

from ...solver import paper
from ...solver.arrays import Array
from ...solver.drop import DropResult
from ..calibrate.calibration import (
    GRID_N_M,
    Calibration,
    RatioCurve,
    calibrate,
    short_its_s,
    stiffness_interval,
)
from ..calibrate.page import headline, kn_section
from ..inputs.config import DropInputs
from ..report.page import Head, Section
from ..scatter.page import cloud_figure
from ..scatter.statistics import r_squared
from ..sweep import height_figure
from .campaign import DropStudy, Labels, Results, prose

SEED = 2018
CLOUD = 600
STIFFEST_3D_N_M = 1e9
RESAMPLED = 2000
LOW_M, TOP_M = min(paper.HEIGHTS_M), max(paper.HEIGHTS_M)
SAMPLES = 120
RATIO_HEADS: dict[str, Head] = {
    "ratio_1d": "y1/y0, 1-D",
    "ratio_3d": "y1/y0, 3-D",
    "apart": ("1-D from 3-D", "relative", 2),
    "y1_mm": "y1, 1-D",
}


@dataclass(frozen=True)
class KnStudy(DropStudy):
    """Kn from the published ratio by the beam and by the reduced solid."""

    grid_N_m: tuple[float, ...] = tuple(map(float, GRID_N_M))

    def _case(self, model: str, kn_N_m: float, height_m: float) -> DropInputs:
        its = short_its_s(self.setup.base.bristle().mass_kg, kn_N_m)
        return self.setup.case(model, kn_N_m, height_m, its_s=its)

    def plan(self) -> Iterator[tuple[DropInputs, Labels]]:
        for kn in self.grid_N_m:
            for height in (LOW_M, TOP_M):
                yield self._case("beam", kn, height), {}
            # The end that stands for a rigid plane is one that few modes do not follow.
            if kn <= STIFFEST_3D_N_M:
                yield self._case("reduced", kn, TOP_M), {}

    def calibration(self, results: Results) -> Calibration:
        """The calibration of ``bristle calibrate paper``, its drops looked up."""

        def model(kn_N_m: float, height_m: float) -> float:
            return float(results[self._case("beam", kn_N_m, height_m)].rebound_ratio or 0.0)

        return calibrate(None, model, grid_N_m=np.array(self.grid_N_m))

    def section(self, results: Results) -> Section:
        found = self.calibration(results)
        drops = self.drops(results)
        drops = drops[drops.model == "reduced"]
        solid = RatioCurve(1e6 * drops.kn_MN_m.to_numpy(), drops.rebound_ratio.to_numpy(float))
        published = paper.KNOWN_DROP_M[1] / paper.KNOWN_DROP_M[0]
        ends = min(paper.RATIO_AT_KN), max(paper.RATIO_AT_KN)
        draft = prose(
            "kn",
            kn_1d=found.kn.estimate,
            kn_3d=solid.stiffness(paper.RATIO_MEAN),
            band=found.population,
            band_3d=stiffness_interval(solid, found.ratio.population),
            reachable=found.curve.reachable,
            ends=[(kn, float(found.curve.at(kn))) for kn in ends],
            published=published,
            alone=found.curve.stiffness(published),
        )
        base = kn_section(found)
        draft.text = [*base.text, *headline(found), *found.warnings[-2:], *draft.text]
        draft.figures, draft.tables = base.figures, base.tables
        return draft.section("bristle calibrate paper")


class Figures10To12(KnStudy):
    """What can be shown of the measured drops, and the cloud that their spread implies."""

    def cloud(self, curve: RatioCurve, n: int, seed: int = SEED) -> tuple[Array, Array, Array]:
        """Heights (m) before and after, and Kn (N/m), of ``n`` predicted drops (n,)."""
        random = np.random.default_rng(seed)
        wanted = np.clip(random.normal(paper.RATIO_MEAN, paper.RATIO_STD, n), *curve.reachable)
        kn = np.array([curve.stiffness(float(ratio)) for ratio in wanted])
        kn = np.clip(kn, curve.kn_N_m[0], curve.kn_N_m[-1])
        y0 = random.uniform(LOW_M, TOP_M, n)
        return y0, y0 * curve.at(kn), kn

    def section(self, results: Results) -> Section:
        curve = self.calibration(results).curve
        y0, y1, kn = self.cloud(curve, CLOUD)
        low, high = curve.reachable
        sets = [
            each.reshape(RESAMPLED, -1)
            for each in self.cloud(curve, RESAMPLED * paper.N_DROPS, SEED + 1)[:2]
        ]
        draft = prose(
            "fig10to12",
            share=np.mean((y1 / y0 <= low * (1 + 1e-9)) | (y1 / y0 >= high * (1 - 1e-9))),
            r2=np.percentile(r_squared(*sets), [5.0, 95.0]).tolist(),
            low_m=LOW_M,
            top_m=TOP_M,
        )
        rows = {"y0_mm": 1e3 * y0, "y1_mm": 1e3 * y1, "kn_MN_m": kn / 1e6}
        data = draft.data("fig10to12", rows, {"kn_MN_m": ("Kn", "MN/m", 4)})
        draft.figure("fig10to12", cloud_figure(y0, y1), data)
        return draft.section()


def track(result: DropResult, samples: int = SAMPLES) -> tuple[Array, Array]:
    """Time and tip height, thinned to about ``samples`` equal times; the deepest instant stays."""
    rows = result.history.array()
    keep = np.searchsorted(rows[:, 0], np.linspace(0.0, rows[-1, 0], samples))
    keep = np.unique(np.append(np.minimum(keep, len(rows) - 1), np.argmin(rows[:, 1])))
    return rows[keep, 0], rows[keep, 1]


class Figure13(DropStudy):
    """Tip height against time, from release to the second impact, in 1-D and 3-D."""

    def plan(self) -> Iterator[tuple[DropInputs, Labels]]:
        heights, stiffnesses = self.setup.heights_m, self.setup.kn_N_m
        for height, kn, model in product(heights, stiffnesses, ("beam", "reduced")):
            yield self.setup.case(model, kn, height), {}

    def cases(self) -> list[DropInputs]:
        return [*super().cases(), self.setup.rigid("beam")]

    def section(self, results: Results) -> Section:
        s, drops = self.setup, self.drops(results)
        drops["rebound_ratio"] = drops.rebound_ratio.astype(float)
        ratios = drops.pivot(index=["y0_mm", "kn_MN_m"], columns="model", values="rebound_ratio")
        ratios = ratios.rename(columns={"beam": "ratio_1d", "reduced": "ratio_3d"}).reset_index()
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
        draft.table("fig13_ratios", ratios, RATIO_HEADS)
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
