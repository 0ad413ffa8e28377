"""Kn of y1/y0 = 0.65, and the cloud of drops that the measured spread predicts (Figs. 10 to 12)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ...solver import paper
from ...solver.arrays import Array
from ..calibrate.curve import GRID_N_M, RatioCurve, short_its_s
from ..calibrate.page import headline, kn_section
from ..calibrate.run import Calibration, calibrate, stiffness_interval
from ..inputs.config import DropInputs
from ..report.page import Section
from ..report.paper_figures import cloud_figure
from ..scatter.statistics import r_squared
from .campaign import DropStudy, Labels, Results, prose

SEED = 2018
CLOUD = 600
STIFFEST_3D_N_M = 1e9
RESAMPLED = 2000
LOW_M, TOP_M = min(paper.HEIGHTS_M), max(paper.HEIGHTS_M)


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
        text = [*base.text, *headline(found), *found.warnings[-2:], *draft.text]
        own = replace(draft, text=text, figures=list(base.figures), tables=list(base.tables))
        return own.section("bristle calibrate paper")


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
