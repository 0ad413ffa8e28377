"""Page and JSON of a scatter."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ...solver import paper
from .. import __version__
from ..calibrate.estimate import Interval
from ..inputs.again import command_line
from ..inputs.sources import checked
from ..report.figures import picture
from ..report.page import Column, Figure, Report, Section, Table, percent, show, write_report
from ..surface.rough import Surface
from .conditions import RESAMPLES, SAMPLES, generator
from .figures import cloud_figure, histogram_figure, lean_figure
from .inputs import ScatterInputs
from .outcome import Check, Scatter
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
    y1 = ratio * y0
    everything = {**vars(found.released), **vars(found.local)}
    statistics = spread(ratio, random)
    parts = shares(ratio, {name: everything[name] for name in FACTORS}, random)
    samples = sampled(y0, y1, generator(inputs.seed, SAMPLES))
    slope = float(through_origin(y0, y1))
    cloud = Figure(
        "cloud",
        _CLOUD,
        picture(cloud_figure(y0, y1, slope, generator(inputs.seed, RESAMPLES, 1))),
        "Height after against height before of every drop, and two straight lines",
        Table(
            "heights",
            "Heights of every drop before and after",
            (Column("y0_mm", "y0", "mm"), Column("y1_mm", "y1", "mm")),
            [[1e3 * float(a), 1e3 * float(b)] for a, b in zip(y0, y1, strict=True)],
        ),
    )
    sections = [
        _spread_section(statistics, found),
        _measured_section(samples, cloud),
        _causes_section(parts, found),
        _conditions_section(inputs, surface, check),
        *([Section("warnings", "What deserves doubt", warnings)] if warnings else []),
    ]
    page = Report(
        title="Scatter of the rebound",
        lead=f"{statistics.n} drops of bristles that lean by chance onto {_ground_words(inputs)}.",
        version=__version__,
        command=command_line("scatter", inputs, checked(ScatterInputs, {}), out),
        headline=headline(statistics, samples),
        facts=_facts(inputs, found),
        sections=sections,
    )
    write_report(page, out)
    return {
        "statistics": {
            "mean": asdict(statistics.mean),
            "std": asdict(statistics.std),
            "percentiles": {
                name: asdict(each)
                for name, each in zip(("p5", "p50", "p95"), statistics.percentiles, strict=True)
            },
            "share_in_0.30_to_1.00": asdict(statistics.in_band),
            "share_above_1": statistics.above_one,
            "skewness": statistics.skewness,
            "slope_through_origin": slope,
        },
        "factors": {share.name: asdict(share) for share in parts},
        "samples_of_26": {each.name: asdict(each) | {"p_value": each.p_value} for each in samples},
        "measured": {
            "mean": paper.RATIO_MEAN,
            "std": paper.RATIO_STD,
            "band_90": paper.RATIO_BAND_90,
            "r_squared": paper.R2_LINEAR,
        },
        "surface": None if surface is None else _surface_facts(surface),
    }


_CLOUD = (
    "As Figs. 10 to 12 of the paper: height after impact against height before it. Dots are "
    "predicted, and moved aside a little where the height is the same; lines are the paper's, and "
    "the linear fit of the dots."
)


def headline(said: Spread, samples: list[Sampled]) -> list[str]:
    """The result in three sentences."""
    low, _, high = (each.estimate for each in said.percentiles)
    band = paper.RATIO_BAND_90
    unusual = [STATISTICS[each.name] for each in samples if each.p_value < UNUSUAL]
    verdict = (
        f"Samples of {paper.N_DROPS} of these drops seldom have the measured "
        f"{', '.join(unusual)}: below 5 % in both tails together."
        if unusual
        else f"Samples of {paper.N_DROPS} of these drops often look as the measured ones: no "
        "measured statistic lies in the outer 5 %."
    )
    return [
        f"y1/y0 = {said.mean.estimate:.3f} ± {said.std.estimate:.3f} is predicted "
        f"({_interval(said.mean)} and {_interval(said.std)} at "
        f"{percent(said.mean.level, 0)}), {paper.RATIO_MEAN} ± {paper.RATIO_STD} was measured.",
        f"90 % of the drops lie between {low:.2f} and {high:.2f}; "
        f"{percent(said.in_band.estimate)} lie in the measured {band[0]:.2f} to {band[1]:.2f}.",
        verdict,
    ]


def _interval(each: Interval, digits: int = 3) -> str:
    return f"{show(each.low, digits)} to {show(each.high, digits)}"


def _ground_words(inputs: ScatterInputs) -> str:
    if inputs.flat:
        return "a level plane"
    return "a measured surface" if inputs.surface is not None else "a rough, composite surface"


def _facts(inputs: ScatterInputs, found: Scatter) -> list[tuple[str, str]]:
    facts = [
        ("Model", inputs.model.value),
        ("Drops", f"{len(found.ratio)}, {len(found.failed)} failed"),
        ("Seeds", f"{inputs.seed} for the drops, {inputs.surface_seed} for the surface"),
        ("Kn", f"{show(inputs.kn_N_m / 1e6)} MN/m"),
        ("Friction", show(inputs.friction)),
        ("Material damping", f"β = {show(inputs.beta_s)} s"),
    ]
    return [(name, _plain_power(value)) for name, value in facts]


def _plain_power(text: str) -> str:
    return text.replace("·10^", "e")


def _spread_section(said: Spread, found: Scatter) -> Section:
    rows = [
        ("mean", said.mean, paper.RATIO_MEAN),
        ("standard deviation", said.std, paper.RATIO_STD),
        ("5th percentile", said.percentiles[0], paper.RATIO_BAND_90[0]),
        ("median", said.percentiles[1], None),
        ("95th percentile", said.percentiles[2], paper.RATIO_BAND_90[1]),
        ("share from 0.30 to 1.00", said.in_band, 0.9),
    ]
    table = Table(
        "spread",
        "y1/y0 of the drops, with 90 % intervals for the number of drops",
        (
            Column("quantity", "Quantity"),
            Column("predicted", "Predicted"),
            Column("low", "from"),
            Column("high", "to"),
            Column("measured", "Measured"),
        ),
        [[name, each.estimate, *_ends(each), there] for name, each, there in rows],
        "Intervals: Student's, the bootstrap's, drops in order (binomial), Wilson's.",
    )
    data = Table(
        "ratio",
        "y1/y0 of every drop",
        (Column("ratio", "y1/y0"),),
        [[float(each)] for each in found.ratio],
    )
    figure = Figure(
        "histogram",
        "Predicted y1/y0, and the normal distribution with the measured mean and standard "
        "deviation. The measured points themselves are not published.",
        picture(histogram_figure(found.ratio)),
        "Histogram of y1/y0",
        data,
    )
    text = [
        "y1 is the greatest height of the lower tip between the first and the second impact, as "
        "it was filmed. A bristle that turns after the impact lifts or lowers its tip, so that "
        f"y1/y0 is not the share of energy that is kept; {percent(said.above_one)} of the drops "
        "have y1 above y0.",
    ]
    return Section("spread", "How far y1/y0 scatters", text, (), [figure], [table])


def _ends(each: Interval) -> list[float | None]:
    return [value if math.isfinite(value) else None for value in (each.low, each.high)]


def _measured_section(samples: list[Sampled], cloud: Figure) -> Section:
    table = Table(
        "samples",
        f"Statistics of samples of {paper.N_DROPS} predicted drops, and the measured ones",
        (
            Column("statistic", "Statistic"),
            Column("mean", "Mean"),
            Column("low", "5 %"),
            Column("high", "95 %"),
            Column("measured", "Measured"),
            Column("below", "Share below it", digits=3),
            Column("p_value", "p", digits=2),
        ),
        [
            [STATISTICS[s.name], s.mean, s.low, s.high, s.measured, s.below, s.p_value]
            for s in samples
        ],
        "p is two-sided, and each statistic is judged by itself.",
    )
    text = [
        f"The paper has {paper.N_DROPS} drops. Drawn from the predicted drops are many samples "
        f"of {paper.N_DROPS}, with replacement, and in each the statistics that the paper gives. "
        "R² is about the mean of y1; it depends on the heights, which are not published and are "
        "the predicted drops' own here.",
    ]
    return Section("measured", "Beside the measurement", text, (), [cloud], [table])


def _causes_section(parts: list[Share], found: Scatter) -> Section:
    rows: list[list[str | float | None]] = []
    for part in parts:
        index = part.first_order
        ends: list[float | None] = [None, None, None]
        if index is not None:
            ends = [index.estimate, index.low, index.high]
        rows.append([FACTORS[part.name], *ends, part.correlation])
    table = Table(
        "causes",
        "Part of the variance of y1/y0 that goes with each input alone",
        (
            Column("input", "Input"),
            Column("first_order", "Part", digits=3),
            Column("low", "from", digits=3),
            Column("high", "to", digits=3),
            Column("correlation", "Rank correlation", digits=3),
        ),
        rows,
        "Variance of the conditional mean in bins of equal count (first-order index of Sobol'); "
        "0 within the interval is none. The correlation is Spearman's, with the size of an angle. "
        "The lean against the ground is made of tilt and slope: its part is not beside theirs.",
    )
    data = Table(
        "lean",
        "Lean and y1/y0 of every drop",
        (Column("lean_deg", "Lean", "degrees"), Column("ratio", "y1/y0")),
        [[float(a), float(b)] for a, b in zip(found.local.lean_deg, found.ratio, strict=True)],
    )
    figure = Figure(
        "lean",
        "y1/y0 against the angle between the bristle's axis and the normal of the ground under its "
        "tip. The horizontal line is the measured mean.",
        picture(lean_figure(found.local.lean_deg, found.ratio)),
        "y1/y0 against lean",
        data,
    )
    return Section("causes", "What makes it scatter", (), (), [figure], [table])


def _conditions_section(inputs: ScatterInputs, surface: Surface | None, check: Check) -> Section:
    text = [
        f"Lean at release toward the thin and the wide side: independent normals with a standard "
        f"deviation of {inputs.tilt_std_deg:g}° about {inputs.tilt_deg:g}° and "
        f"{inputs.tilt_wide_deg:g}°. It was not measured; the default is an assumption.",
        "The place of landing is uniform on the surface, and the bristle is turned about its axis "
        "by a uniform angle. Heights come in turn: "
        f"{', '.join(f'{1e3 * h:g}' for h in inputs.heights_m)} mm.",
        "Every contact point of the end face has the height, the slope and the stiffness of the "
        "surface under it, as it lands; Kn is the surface's mean.",
        "Not drawn at random: Kn, friction, damping, the bristle's size, its speed and spin at "
        "release. What they scatter by comes on top.",
        _check_words(check),
    ]
    if surface is None:
        return Section("conditions", "What is assumed", text)
    facts = _surface_facts(surface)
    rows: list[list[Any]] = [
        ["rms height (µm)", 1e6 * facts["rms_height_m"]],
        ["correlation length (mm)", _or_none(facts["correlation_length_m"], 1e3)],
        ["rms slope along x (degrees)", facts["rms_slope_x_deg"]],
        ["rms slope along y (degrees)", facts["rms_slope_y_deg"]],
        *([f"share of {name}", part] for name, part in facts["fractions"].items()),
    ]
    table = Table(
        "surface",
        "The tile of surface that the drops land on",
        (Column("quantity", "Quantity"), Column("value", "Value")),
        rows,
        "Roughness of a made surface is an assumption: macrotexture has wavelengths of 0.5 to "
        "50 mm and heights of 0.2 to 10 mm (PIARC).",
    )
    return Section("conditions", "What is assumed", text, tables=[table])


def _check_words(check: Check) -> str:
    same = (
        f"{check.n} drops chosen at random were also computed by themselves: y1/y0 differs by "
        f"{show(check.difference, 2)} at most."
    )
    if check.reduction_error is None:
        return same
    return (
        f"{same} The reduced body differs from the solid at full order by no more than "
        f"{show(check.reduction_error, 2)} of the impact speed in them."
    )


def _or_none(value: float | None, factor: float) -> float | None:
    return None if value is None else factor * value


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
