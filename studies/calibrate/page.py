"""Page of a calibration, with its figures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from ...solver import paper
from ...solver.arrays import Array
from ..inputs.sources import into
from ..report.figures import BLACK, BLUE, DARK, GREY, SKY, VERMILION, beside, drawing
from ..report.page import Head, Report, Section, write_report
from ..report.prose import Prose
from .calibration import PAPER, Calibration, RatioCurve
from .estimate import LEVEL, RatioEstimate

HEADS: dict[str, Head] = {
    "low": "from",
    "ratio": "y1/y0",
    "kn_MN_m": ("Kn alone", "MN/m", 3),
    "estimate_MN_m": ("estimate", "MN/m", 3),
    "low_MN_m": ("from", "MN/m", 3),
    "high_MN_m": ("to", "MN/m", 3),
    "words": "in words",
    "value_si": ("in m and N", "N/m, N/m³", 3),
    "value_mm": ("in mm and N", "N/mm, N/mm³", 3),
}
HEIGHTS = {"xlabel": "height before impact y0 (mm)", "ylabel": "height after impact y1 (mm)"}
MN = 1e6
# Kn is a force over a penetration of the whole end face. Programs that take a pressure over a
# penetration want it over the face's area; programs that have springs at nodes want it divided
# among the nodes that touch, one on the axis of a beam, as in the paper.
AREA, NODE = "Kn over the face's area", "Kn over the nodes that touch"
# Program, where the number is entered, and what it is there. From the programs' manuals.
OPTIONS = (
    ("Abaqus", "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR, between surfaces", AREA),
    ("Abaqus", "the same, of a node-based surface", NODE),
    ("Ansys", "FKN of CONTA174, with a minus sign to be absolute, KEYOPT(3) = 0", AREA),
    ("Ansys", "FKN of CONTA175, with a minus sign to be absolute, KEYOPT(3) = 0", NODE),
    ("CalculiX", "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR", AREA),
    ("Code_Aster", "E_N of DEFI_CONTACT, FORMULATION='DISCRETE', PENALISATION", NODE),
    ("COMSOL", "pressure penalty factor of the contact node, penalty method", AREA),
)
prose = Prose(Path(__file__).with_name("words.j2"), HEADS)


def write_calibration(found: Calibration, out: Path) -> Path:
    """Write ``report.html``, ``figures/`` and ``tables/`` into ``out``; returns the page's path."""
    whence = "the paper's figures" if found.drops is None else found.drops.manifest.title
    facts = [("Source", found.source), ("Drops", str(found.ratio.n)), ("Seed", str(found.seed))]
    if found.drops is not None:
        facts.append(("Licence of the data", found.drops.manifest.licence or "not declared"))
    level = ["--level", f"{found.kn.level:g}"] if found.kn.level != LEVEL else []
    page = Report(
        title=f"Kn from {whence}",
        lead="The normal contact stiffness at which a beam model rebounds as the drops did.",
        command=into(out, "calibrate", found.source, "--seed", found.seed, *level),
        headline=headline(found),
        facts=facts,
        sections=[
            _ratio_section(found),
            kn_section(found),
            Section("limits", "What this cannot tell", found.warnings),
        ],
    )
    return write_report(page, out)


def headline(found: Calibration) -> list[str]:
    """The result in two sentences."""
    return prose.text("headline", ratio=found.ratio, kn=found.kn, population=found.population)


def _ratio_section(found: Calibration) -> Section:
    ratio, drops = found.ratio, found.drops
    draft = prose("ratio_of_paper" if drops is None else "ratio_of_drops", "ratio", ratio=ratio)
    if drops is not None:
        ratios = drops.y1_m / drops.y0_m
        rows = {
            "drop": drops.drop.astype(int),
            "y0_mm": 1e3 * drops.y0_m,
            "y1_mm": 1e3 * drops.y1_m,
            "ratio": ratios,
            "kn_MN_m": [found.curve.stiffness(each) / 1e6 for each in map(float, ratios)],
        }
        heads: dict[str, Head] = {"y0_mm": ("y0", "mm", 4)}
        drawn = measured_figure(drops.y0_m, drops.y1_m, ratio)
        draft.figure("drops", drawn, draft.data("drops", rows, heads))
    draft.table("rebound_ratio", _intervals(ratio), {"what": "y1/y0 of"})
    return draft.section()


@drawing(**HEIGHTS, height_in=3.4, legend="upper left", ylim=(0, None))
def measured_figure(ax: Axes, y0_m: Array, y1_m: Array, ratio: RatioEstimate) -> None:
    """Drops, the fitted line through the origin, and the band of single drops."""
    x = np.array([0.0, 1.05e3 * float(np.max(y0_m))])
    band, slope = ratio.population, ratio.mean.estimate
    label = f"90 % of drops: {band.low:.2f} to {band.high:.2f}"
    ax.fill_between(x, band.low * x, band.high * x, color=SKY, alpha=0.25, lw=0, label=label)
    ax.plot(x, slope * x, color=BLUE, label=f"y1 = {slope:.3f} y0")
    ax.plot(x, x, color=GREY, lw=0.8, ls="--", label="y1 = y0")
    ax.plot(1e3 * y0_m, 1e3 * y1_m, "o", color=BLACK, fillstyle="none", label="drops")
    ax.set_xlim(*x)


def _intervals(ratio: RatioEstimate) -> pd.DataFrame:
    found = {
        "mean, Student's t": ratio.mean,
        "mean, bootstrap by drop (BCa)": ratio.bootstrap,
        "single drops": ratio.population,
    }
    rows = [{"what": what, **vars(each)} for what, each in found.items() if each is not None]
    return pd.DataFrame(rows).drop(columns="level")


def kn_section(found: Calibration) -> Section:
    """Kn of the mean and of single drops, with the model's curve drawn."""
    from_paper = found.source == PAPER
    draft = prose(
        "kn", reachable=found.curve.reachable, level=found.kn.level, from_paper=from_paper
    )
    curve = {"kn_N_m": found.curve.kn_N_m, "ratio": found.curve.ratio}
    data = draft.data("ratio_curve", curve, {"ratio": ("y1/y0", "", 5)})
    draft.figure("kn-from-ratio", curve_figure(found.curve, found.ratio, from_paper), data)
    intervals = {
        "mean": found.kn,
        "mean, bootstrap": found.kn_bootstrap,
        "single drops": found.population,
    }
    rows = [
        (what, *(x and x / 1e6 for x in (kn.estimate, kn.low, kn.high)), kn.words())
        for what, kn in intervals.items()
        if kn is not None
    ]
    columns = ["what", "estimate_MN_m", "low_MN_m", "high_MN_m", "words"]
    draft.table("kn", pd.DataFrame(rows, columns=columns), {"what": "Kn of"})
    if found.kn.estimate is not None:
        others = programs(found.kn.estimate, found.bristle.section.area_m2)
        draft.table("other_programs", others)
    return draft.section()


def programs(kn_N_m: float, area_m2: float) -> pd.DataFrame:
    """What to enter where, for a face of ``area_m2``."""
    values = {AREA: (kn_N_m / area_m2, 1e-9 * kn_N_m / area_m2), NODE: (kn_N_m, 1e-3 * kn_N_m)}
    rows = [(*option, *values[option[-1]]) for option in OPTIONS]
    return pd.DataFrame(rows, columns=["program", "option", "is", "value_si", "value_mm"])


@drawing("normal contact stiffness Kn (MN/m)", "y1/y0", height_in=3.4, legend=None)
def curve_figure(
    ax: Axes, curve: RatioCurve, ratio: RatioEstimate, paper_points: bool = False
) -> None:
    """y1/y0 against Kn with the measured ratio, its interval, and the band of single drops."""
    shown = curve.kn_N_m[(curve.kn_N_m >= 9e3) & (curve.kn_N_m <= 1.1e9)]
    grid = np.geomspace(shown[0], shown[-1], 300)
    band, mean = ratio.population, ratio.mean
    ax.axhspan(band.low, band.high, color=SKY, alpha=0.18, lw=0)
    ax.axhspan(mean.low, mean.high, color=BLUE, alpha=0.25, lw=0)
    ax.semilogx(grid / MN, curve.at(grid), color=BLACK)
    for level, words, colour, above in (
        (mean.estimate, f"measured {mean.estimate:.3g}, 90 % interval of the mean", BLUE, True),
        (band.high, f"{band.high:.2f}: upper end of single drops", DARK, False),
        (band.low, f"{band.low:.2f}: lower end of single drops", DARK, False),
    ):
        ax.axhline(level, color=colour, lw=0.8)
        across = ax.get_yaxis_transform()
        beside(ax, words, (1.0, level), "right", above, xycoords=across, color=colour)
    kn = curve.stiffness(mean.estimate) / MN
    if 0.0 < kn < np.inf:
        ax.plot(kn, mean.estimate, "o", color=BLUE)
        words = f"Kn = {kn:.3g} MN/m"
        beside(ax, words, (kn, mean.estimate), "right", False, color=BLUE, fontsize=8)
    if paper_points:
        points = np.array(list(paper.RATIO_AT_KN.items())) / (MN, 1.0)
        label = "the paper's model"
        ax.plot(*points.T, "s", color=VERMILION, fillstyle="none", label=label)
        ax.legend(loc="upper right", bbox_to_anchor=(1.0, 0.88))
    ax.set_xlim(grid[0] / MN, grid[-1] / MN)
    ax.set_ylim(min(0.2, band.low - 0.05), max(1.05, band.high + 0.03))
