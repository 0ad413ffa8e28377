"""Page of a calibration."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from ..inputs.sources import into
from ..report.page import Head, Report, Section, write_report
from ..report.prose import Prose
from .estimate import LEVEL, RatioEstimate
from .figures import curve_figure, measured_figure
from .other_programs import programs
from .run import PAPER, Calibration

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
prose = Prose(Path(__file__).with_name("words.j2"), HEADS)


def write_calibration(found: Calibration, out: Path, version: str) -> Path:
    """Write ``report.html``, ``figures/`` and ``tables/`` into ``out``; returns the page's path."""
    whence = "the paper's figures" if found.drops is None else found.drops.manifest.title
    facts = [("Source", found.source), ("Drops", str(found.ratio.n)), ("Seed", str(found.seed))]
    if found.drops is not None:
        facts.append(("Licence of the data", found.drops.manifest.licence or "not declared"))
    level = ["--level", f"{found.kn.level:g}"] if found.kn.level != LEVEL else []
    page = Report(
        title=f"Kn from {whence}",
        lead="The normal contact stiffness at which a beam model rebounds as the drops did.",
        version=version,
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
