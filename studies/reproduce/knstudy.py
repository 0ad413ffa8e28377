"""Kn of y1/y0 = 0.65, and the cloud of drops that the measured spread predicts (Figs. 10 to 12)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...solver import paper
from ...solver.arrays import Array
from ..calibrate.curve import GRID_N_M, RatioCurve, short_its_s
from ..calibrate.estimate import paper_ratio
from ..calibrate.figures import cloud_figure
from ..calibrate.page import headline, kn_section
from ..calibrate.run import Calibration, calibrate, stiffness_interval
from ..inputs.config import DropInputs
from ..report.figures import picture
from ..report.page import Column, Comparison, Figure, Section, Table, Verdict, percent
from .campaign import Results, Setup

SEED = 2018
CLOUD = 600
STIFFEST_3D_N_M = 1e9
RESAMPLED = 2000


@dataclass(frozen=True)
class KnStudy:
    """Kn from the published ratio by the beam and by the reduced solid."""

    setup: Setup
    grid_N_m: tuple[float, ...] = tuple(map(float, GRID_N_M))

    def _case(self, model: str, kn_N_m: float, height_m: float) -> DropInputs:
        its = short_its_s(self.setup.base.bristle().mass_kg, kn_N_m)
        return self.setup.case(model, kn_N_m, height_m, its_s=its)

    def _ends(self) -> tuple[float, float]:
        return min(paper.HEIGHTS_M), max(paper.HEIGHTS_M)

    def cases(self) -> list[DropInputs]:
        beam = [self._case("beam", kn, h) for kn in self.grid_N_m for h in self._ends()]
        return beam + [self._case("reduced", kn, self._ends()[1]) for kn in self._grid_3d()]

    def _grid_3d(self) -> list[float]:
        """Without the end that stands for a rigid plane, which few modes do not follow."""
        return [kn for kn in self.grid_N_m if kn <= STIFFEST_3D_N_M]

    def _curve_3d(self, results: Results) -> RatioCurve:
        grid = self._grid_3d()
        ratio = [results[self._case("reduced", kn, self._ends()[1])].rebound_ratio for kn in grid]
        return RatioCurve(np.array(grid), np.array(ratio, float))

    def _kn_row(self, kn_1d: float | None, kn_3d: float) -> Comparison:
        published = paper.KN_CHOSEN_N_M
        one = kn_1d or np.nan
        same = round(one / 1e6) == published / 1e6
        return Comparison(
            f"Kn at y1/y0 = {paper.RATIO_MEAN}",
            "section on Kn",
            f"{published / 1e6:g} MN/m",
            f"{one / 1e6:.3f} MN/m",
            f"{kn_3d / 1e6:.3f} MN/m",
            percent(one / published - 1, signed=True),
            Verdict.AGREES if same else Verdict.DIFFERS,
            "Rounds to the value printed." if same else "",
        )

    def _band_row(self, found: Calibration, solid: RatioCurve) -> Comparison:
        low, high = found.curve.reachable
        band = found.population
        same = None not in (band.low, band.high)
        ends = min(paper.RATIO_AT_KN), max(paper.RATIO_AT_KN)
        at = [float(found.curve.at(kn)) for kn in ends]
        return Comparison(
            "Kn of the 90 % band of single drops",
            "section on Kn",
            f"{ends[0] / 1e6:g} to {ends[1] / 1e6:g} MN/m",
            band.words(),
            stiffness_interval(solid, paper_ratio().population).words(),
            "–",
            Verdict.OPEN if same else Verdict.DIFFERS,
            f"The band's ends, {percent(paper.RATIO_BAND_90[0], 0)} and "
            f"{percent(paper.RATIO_BAND_90[1], 0)}, lie outside what any Kn gives ({low:.4f} to "
            f"{high:.5f}). {ends[0] / 1e6:g} and {ends[1] / 1e6:g} MN/m give {at[0]:.4f} and "
            f"{at[1]:.4f}.",
        )

    def calibration(self, results: Results) -> Calibration:
        """The calibration of ``bristle calibrate paper``, its drops looked up."""

        def model(kn_N_m: float, height_m: float) -> float:
            return float(results[self._case("beam", kn_N_m, height_m)].rebound_ratio or 0.0)

        return calibrate(None, model, grid_N_m=np.array(self.grid_N_m))

    def section(self, results: Results) -> Section:
        found = self.calibration(results)
        solid = self._curve_3d(results)
        base = kn_section(found)
        kn_1d, kn_3d = found.kn.estimate, solid.stiffness(paper.RATIO_MEAN)
        published = paper.KNOWN_DROP_M[1] / paper.KNOWN_DROP_M[0]
        comparisons = [self._kn_row(kn_1d, kn_3d), self._band_row(found, solid)]
        text = [
            *base.text,
            *headline(found),
            *found.warnings[-2:],
            f"The one drop with published numbers, {1e3 * paper.KNOWN_DROP_M[0]:g} to "
            f"{1e3 * paper.KNOWN_DROP_M[1]:g} mm, has y1/y0 = {published:.3f}; alone it asks for "
            f"Kn = {found.curve.stiffness(published) / 1e6:.3g} MN/m.",
        ]
        return Section(
            "kn",
            "Kn from the measured rebound",
            text,
            comparisons,
            base.figures,
            base.tables,
            "bristle calibrate paper",
        )


@dataclass(frozen=True)
class Figures10To12:
    """What can be shown of the measured drops, and the cloud that their spread implies."""

    kn: KnStudy

    def cases(self) -> list[DropInputs]:
        return self.kn.cases()

    def cloud(self, curve: RatioCurve, n: int, seed: int = SEED) -> tuple[Array, Array, Array]:
        """Heights (m) before and after, and Kn (N/m), of ``n`` predicted drops (n,)."""
        random = np.random.default_rng(seed)
        low, high = curve.reachable
        wanted = random.normal(paper.RATIO_MEAN, paper.RATIO_STD, n)
        held = np.clip(wanted, low, high)
        ends = float(curve.kn_N_m[0]), float(curve.kn_N_m[-1])
        kn = np.array([np.clip(curve.stiffness(float(r)), *ends) for r in held])
        y0 = random.uniform(min(paper.HEIGHTS_M), max(paper.HEIGHTS_M), n)
        return y0, y0 * curve.at(kn), kn

    def _r2(self, curve: RatioCurve) -> tuple[float, float]:
        """5th and 95th percentile of R² about the fitted line over sets of 26 predicted drops."""
        y0, y1, _ = self.cloud(curve, RESAMPLED * paper.N_DROPS, SEED + 1)
        y0, y1 = y0.reshape(RESAMPLED, -1), y1.reshape(RESAMPLED, -1)
        slope = np.sum(y0 * y1, axis=1) / np.sum(y0 * y0, axis=1)
        residual = np.sum((y1 - slope[:, None] * y0) ** 2, axis=1)
        about = np.sum((y1 - y1.mean(axis=1, keepdims=True)) ** 2, axis=1)
        return tuple(np.percentile(1.0 - residual / about, [5.0, 95.0]).tolist())

    def section(self, results: Results) -> Section:
        curve = self.kn.calibration(results).curve
        y0, y1, kn = self.cloud(curve, CLOUD)
        low, high = self._r2(curve)
        share = np.mean(
            (y1 / y0 <= curve.reachable[0] * (1 + 1e-9))
            | (y1 / y0 >= curve.reachable[1] * (1 - 1e-9))
        )
        table = Table(
            "fig10to12",
            "Predicted drops. None of them was measured.",
            (
                Column("y0_mm", "y0", "mm"),
                Column("y1_mm", "y1", "mm"),
                Column("kn_MN_m", "Kn", "MN/m"),
            ),
            np.stack([1e3 * y0, 1e3 * y1, kn / 1e6], axis=1).tolist(),
        )
        figure = Figure(
            "fig10to12",
            "Figs. 10 to 12 of the paper as far as they can be drawn: published fit, 30 % and "
            "100 % lines and one drop; small dots are predicted by us, not measured.",
            picture(cloud_figure(y0, y1)),
            "Height after impact against height before it",
            table,
        )
        text = [
            f"The {paper.N_DROPS} measured points are not published as numbers, so they are not "
            "shown. Drawn are the published linear fit, the 30 % and 100 % lines, and the one drop "
            f"whose numbers are in the text ({1e3 * paper.KNOWN_DROP_M[0]:g} → "
            f"{1e3 * paper.KNOWN_DROP_M[1]:g} mm).",
            f"The cloud is our prediction: each drop has a Kn of its own, such that y1/y0 follows "
            f"the published {paper.RATIO_MEAN} ± {paper.RATIO_STD}, and a height drawn evenly "
            f"from {1e3 * min(paper.HEIGHTS_M):g} to {1e3 * max(paper.HEIGHTS_M):g} mm. The "
            "heights that were measured are not known. "
            f"{percent(float(share), 0)} of the wanted ratios lie outside what any Kn gives "
            "and are held to the nearest that one does.",
            "It shows what a spread in Kn alone would look like. That the spread comes from Kn is "
            "an assumption: lean, slope and friction of the surface would spread y1/y0 too.",
        ]
        comparison = Comparison(
            "R² of y1 = a y0 over 26 drops",
            "Figs. 10 to 12",
            f"{paper.R2_LINEAR}",
            f"{low:.2f} to {high:.2f} predicted",
            "–",
            "–",
            Verdict.AGREES if low <= paper.R2_LINEAR <= high else Verdict.DIFFERS,
            "Taken about the mean of y1; the range is for sets of 26 drops at unknown heights.",
        )
        return Section(
            "fig10to12",
            "Figs. 10 to 12: height after against height before",
            text,
            [comparison],
            [figure],
        )
