"""Page and JSON of a scatter."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ...solver import paper
from .. import __version__
from ..inputs.sources import checked, command_line
from ..report.page import Head, Report, Section, show, write_report
from ..report.paper_figures import cloud_figure
from ..report.prose import Prose
from ..surface.rough import Surface
from .conditions import RESAMPLES, SAMPLES, Check, Scatter, generator
from .figures import DOTS, histogram_figure, lean_figure
from .inputs import ScatterInputs
from .statistics import Sampled, Share, Spread, sampled, shares, spread, through_origin

FACTORS = {
    "lean_deg": "lean against the ground",
    "tilt_deg": "tilt to the thin side",
    "tilt_wide_deg": "tilt to the wide side",
    "slope_deg": "slope to the thin side",
    "slope_wide_deg": "slope to the wide side",
    "rise_std_m": "unevenness under the tip",
    "stiffness_scale": "stiffness of the phase",
    "height_m": "height y0",
}
STATISTICS = {
    "mean": "mean of y1/y0",
    "std": "standard deviation of y1/y0",
    "slope": "a of y1 = a y0",
    "r_squared": "R² of y1 = a y0",
}
UNUSUAL = 0.05
HEADS: dict[str, Head] = {
    "ratio": "y1/y0",
    "y0_mm": ("y0", "mm", 4),
    "low": "from",
    "below": ("share below it", "", 3),
    "p_value": ("p", "", 2),
    "lean_deg": ("lean", "degrees", 4),
    "first_order": ("part", "", 3),
    "correlation": ("rank correlation", "", 3),
}
prose = Prose(Path(__file__).with_name("words.j2"), HEADS)


def write_scatter(
    inputs: ScatterInputs,
    found: Scatter,
    check: Check,
    surface: Surface | None,
    warnings: Sequence[str],
    out: Path,
) -> dict[str, Any]:
    """Write ``report.html``, ``figures/`` and ``tables/``; returns the statistics for the JSON."""
    random = generator(inputs.seed, RESAMPLES)
    ratio, y0 = found.ratio, found.released.height_m
    everything = {**vars(found.released), **vars(found.local)}
    statistics = spread(ratio, random)
    parts = shares(ratio, {name: everything[name] for name in FACTORS}, random)
    samples = sampled(y0, ratio * y0, generator(inputs.seed, SAMPLES))
    facts = None if surface is None else _surface_facts(surface)
    sections = [
        _spread_section(statistics, found),
        _measured_section(samples, found, generator(inputs.seed, RESAMPLES, 1)),
        _causes_section(parts, found),
        _conditions_section(inputs, facts, check),
        *([Section("warnings", "What deserves doubt", warnings)] if warnings else []),
    ]
    unusual = [STATISTICS[each.name] for each in samples if each.p_value < UNUSUAL]
    ground = "a measured surface" if inputs.surface is not None else "a rough, composite surface"
    page = Report(
        title="Scatter of the rebound",
        lead=f"{statistics.n} drops of bristles that lean by chance onto "
        f"{'a level plane' if inputs.flat else ground}.",
        version=__version__,
        command=command_line("scatter", inputs, checked(ScatterInputs, {}), out),
        headline=prose.text("headline", said=statistics, unusual=unusual),
        facts=[
            ("Model", inputs.model.value),
            ("Drops", f"{len(ratio)}, {len(found.failed)} failed"),
            ("Seeds", f"{inputs.seed} for the drops, {inputs.surface_seed} for the surface"),
            ("Kn", f"{_short(inputs.kn_N_m / 1e6)} MN/m"),
            ("Friction", _short(inputs.friction)),
            ("Material damping", f"β = {_short(inputs.beta_s)} s"),
        ],
        sections=sections,
    )
    write_report(page, out)
    percentiles = zip(("p5", "p50", "p95"), map(asdict, statistics.percentiles), strict=True)
    return {
        "statistics": {
            "mean": asdict(statistics.mean),
            "std": asdict(statistics.std),
            "percentiles": dict(percentiles),
            "share_in_0.30_to_1.00": asdict(statistics.in_band),
            "share_above_1": statistics.above_one,
            "skewness": statistics.skewness,
            "slope_through_origin": float(through_origin(y0, ratio * y0)),
        },
        "factors": {share.name: asdict(share) for share in parts},
        "samples_of_26": {each.name: asdict(each) | {"p_value": each.p_value} for each in samples},
        "measured": {
            "mean": paper.RATIO_MEAN,
            "std": paper.RATIO_STD,
            "band_90": paper.RATIO_BAND_90,
            "r_squared": paper.R2_LINEAR,
        },
        "surface": facts,
    }


def _short(value: float) -> str:
    return show(value).replace("·10^", "e")


def _spread_section(said: Spread, found: Scatter) -> Section:
    low, median, high = said.percentiles
    rows = pd.DataFrame(
        {"quantity": quantity, "predicted": each.estimate, **vars(each), "measured": measured}
        for quantity, each, measured in (
            ("mean", said.mean, paper.RATIO_MEAN),
            ("standard deviation", said.std, paper.RATIO_STD),
            ("5th percentile", low, paper.RATIO_BAND_90[0]),
            ("median", median, None),
            ("95th percentile", high, paper.RATIO_BAND_90[1]),
            ("share from 0.30 to 1.00", said.in_band, 0.9),
        )
    ).replace([np.inf, -np.inf], np.nan)
    draft = prose("spread", said=said)
    ratios = draft.data("ratio", {"ratio": found.ratio})
    draft.figure("histogram", histogram_figure(found.ratio), ratios)
    draft.table("spread", rows.drop(columns=["estimate", "level"]))
    return draft.section()


def _measured_section(
    samples: list[Sampled], found: Scatter, random: np.random.Generator
) -> Section:
    y0, y1 = found.released.height_m, found.ratio * found.released.height_m
    # Moved aside a little, so that drops from one height do not hide each other.
    top = 1.1 * float(max(y0.max(), y1.max()))
    aside = random.uniform(-0.012, 0.012, len(y0)) * top
    slope = float(through_origin(y0, y1))
    drawn = cloud_figure((y0 + aside)[:DOTS], y1[:DOTS], "predicted", 1e3 * top, slope)
    draft = prose("measured")
    heights = draft.data("heights", {"y0_mm": 1e3 * y0, "y1_mm": 1e3 * y1})
    draft.figure("cloud", drawn, heights)
    rows = pd.DataFrame(
        {"statistic": STATISTICS[each.name], **vars(each), "p_value": each.p_value}
        for each in samples
    )
    columns = ["statistic", "mean", "low", "high", "measured", "below", "p_value"]
    draft.table("samples", rows[columns], {"low": "5 %", "high": "95 %"})
    return draft.section()


def _causes_section(parts: list[Share], found: Scatter) -> Section:
    rows = pd.DataFrame(
        {
            "input": FACTORS[part.name],
            **({} if part.first_order is None else vars(part.first_order)),
            "correlation": part.correlation,
        }
        for part in parts
    )
    columns = ["input", "estimate", "low", "high", "correlation"]
    rows = rows.reindex(columns=columns).rename(columns={"estimate": "first_order"})
    draft = prose("causes")
    lean = {"lean_deg": found.local.lean_deg, "ratio": found.ratio}
    data = draft.data("lean", lean)
    draft.figure("lean", lean_figure(found.local.lean_deg, found.ratio), data)
    draft.table("causes", rows, {"low": ("from", "", 3), "high": ("to", "", 3)})
    return draft.section()


def _conditions_section(
    inputs: ScatterInputs, surface: dict[str, Any] | None, check: Check
) -> Section:
    draft = prose("conditions", inputs=inputs, check=check)
    if surface is not None:
        length = surface["correlation_length_m"]
        rows = {
            "rms height (µm)": 1e6 * surface["rms_height_m"],
            "correlation length (mm)": None if length is None else 1e3 * length,
            "rms slope along x (degrees)": surface["rms_slope_x_deg"],
            "rms slope along y (degrees)": surface["rms_slope_y_deg"],
            **{f"share of {name}": part for name, part in surface["fractions"].items()},
        }
        draft.table("surface", {"quantity": rows, "value": rows.values()})
    return draft.section()


def _surface_facts(surface: Surface) -> dict[str, Any]:
    measured = surface.statistics()
    return {
        "size_m": surface.size_m,
        "spacing_m": surface.spacing_m,
        "rms_height_m": measured.rms_height_m,
        "correlation_length_m": measured.correlation_length_m,
        "rms_slope_x_deg": math.degrees(math.atan(measured.rms_slope_x)),
        "rms_slope_y_deg": math.degrees(math.atan(measured.rms_slope_y)),
        "fractions": measured.fractions,
    }
