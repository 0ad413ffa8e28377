"""Page, figures and JSON of a scatter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from scipy import stats

from ...solver import paper
from ...solver.arrays import Array
from ..calibrate.estimate import through_origin
from ..calibrate.page import HEIGHTS
from ..inputs.sources import checked, command_line
from ..report.figures import BLACK, BLUE, GREY, SKY, VERMILION, drawing
from ..report.page import Head, Report, Section, show, write_report
from ..report.prose import Prose
from ..surface.ground import surface_facts, surface_rows
from ..surface.rough import Surface
from .drops import RESAMPLES, SAMPLES, generator
from .inputs import ScatterInputs
from .statistics import Spread, sampled, shares, spread

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
# More dots than these hide each other and swell the page.
DOTS = 3000
# Drops in a bin of the running median.
IN_A_BIN = 40
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


@dataclass(frozen=True)
class Check:
    """Drops that were computed twice: how far the reduced body may be off, in impact speeds (None
    for a body that leaves nothing out), and by how much the two ways differ in y1/y0."""

    n: int
    reduction_error: float | None
    difference: float


def write_scatter(
    inputs: ScatterInputs,
    drops: pd.DataFrame,
    check: Check,
    surface: Surface | None,
    warnings: Sequence[str],
    out: Path,
) -> dict[str, Any]:
    """Write ``report.html``, ``figures/`` and ``tables/`` of ``drops``, the rows of drops.csv;
    returns the statistics for the JSON."""
    random = generator(inputs.seed, RESAMPLES)
    ratio, y0 = drops.rebound_ratio.to_numpy(), drops.y0_m.to_numpy()
    statistics = spread(ratio, random)
    factors = drops.rename(columns={"y0_m": "height_m"})[list(FACTORS)]
    parts = shares(ratio, {name: each.to_numpy() for name, each in factors.items()}, random)
    samples = sampled(y0, ratio * y0, generator(inputs.seed, SAMPLES))
    facts = None if surface is None else surface_facts(surface)
    sections = [
        _spread_section(statistics, ratio),
        _measured_section(samples, y0, ratio * y0, generator(inputs.seed, RESAMPLES, 1)),
        _causes_section(parts, drops),
        _conditions_section(inputs, facts, check),
        *([Section("warnings", "What deserves doubt", warnings)] if warnings else []),
    ]
    unusual = [STATISTICS[name] for name in samples.name[samples.p_value < UNUSUAL]]
    ground = "a measured surface" if inputs.surface is not None else "a rough, composite surface"
    page = Report(
        title="Scatter of the rebound",
        lead=f"{statistics.n} drops of bristles that lean by chance onto "
        f"{'a level plane' if inputs.flat else ground}.",
        command=command_line("scatter", inputs, checked(ScatterInputs, {}), out),
        headline=prose.text("headline", said=statistics, unusual=unusual),
        facts=[
            ("Model", inputs.model.value),
            ("Drops", f"{len(drops)}, {inputs.drops - len(drops)} failed"),
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
        "factors": parts,
        "samples_of_26": samples.set_index("name", drop=False).to_dict("index"),
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


def _spread_section(said: Spread, ratio: Array) -> Section:
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
    draft.figure("histogram", histogram_figure(ratio), draft.data("ratio", {"ratio": ratio}))
    draft.table("spread", rows.drop(columns=["estimate", "level"]))
    return draft.section()


@drawing("y1/y0", "drops per unit of y1/y0, share", legend="upper left")
def histogram_figure(ax: Axes, ratio: Array) -> None:
    """y1/y0 of the drops, with the paper's mean, standard deviation and 90 % band."""
    low, high = paper.RATIO_BAND_90
    ends = min(0.0, float(ratio.min())), max(1.3, float(ratio.max()))
    ax.axvspan(low, high, color=SKY, alpha=0.18, lw=0, label=f"measured 90 %: {low:g} to {high:g}")
    ax.hist(ratio, 60, range=ends, density=True, color=BLUE, label="predicted")
    x = np.linspace(*ends, 300)
    density = stats.norm.pdf(x, paper.RATIO_MEAN, paper.RATIO_STD)
    label = f"normal, measured {paper.RATIO_MEAN} ± {paper.RATIO_STD}"
    ax.plot(x, density, color=BLACK, label=label)
    ax.set_xlim(*ends)


def _measured_section(
    samples: pd.DataFrame, y0_m: Array, y1_m: Array, random: np.random.Generator
) -> Section:
    # Moved aside a little, so that drops from one height do not hide each other.
    top = 1.1 * float(max(y0_m.max(), y1_m.max()))
    aside = random.uniform(-0.012, 0.012, len(y0_m)) * top
    slope = float(through_origin(y0_m, y1_m))
    drawn = cloud_figure((y0_m + aside)[:DOTS], y1_m[:DOTS], "predicted", 1e3 * top, slope)
    draft = prose("measured")
    heights = draft.data("heights", {"y0_mm": 1e3 * y0_m, "y1_mm": 1e3 * y1_m})
    draft.figure("cloud", drawn, heights)
    rows = samples.assign(statistic=samples.name.map(STATISTICS))
    columns = ["statistic", "mean", "low", "high", "measured", "below", "p_value"]
    draft.table("samples", rows[columns], {"low": "5 %", "high": "95 %"})
    return draft.section()


@drawing(**HEIGHTS, height_in=3.6, legend="upper left")
def cloud_figure(
    ax: Axes,
    y0_m: Array,
    y1_m: Array,
    label: str = "predicted here, not measured",
    top_mm: float = 55.0,
    slope: float | None = None,
) -> None:
    """Figs. 10 to 12: the published line, band and one drop, and a cloud named ``label``.

    ``slope`` is that of a line that was fitted to the cloud.
    """
    x = np.array([0.0, top_mm])
    low, high = paper.RATIO_BAND_90
    ax.plot(1e3 * y0_m, 1e3 * y1_m, ".", color=SKY, ms=2.5, zorder=1, label=label)
    ax.plot(x, paper.RATIO_MEAN * x, color=BLACK, label="published fit y1 = 0.65 y0")
    ax.plot(x, high * x, color=BLACK, lw=0.8, ls="--", label="30 % and 100 % lines")
    ax.plot(x, low * x, color=BLACK, lw=0.8, ls="--")
    drop = 1e3 * paper.KNOWN_DROP_M[0], 1e3 * paper.KNOWN_DROP_M[1]
    ax.plot(*drop, "D", color=VERMILION, label="the one drop with published numbers")
    if slope is not None:
        words = f"fit of the predicted drops, y1 = {slope:.3f} y0"
        ax.plot(x, slope * x, color=BLUE, label=words)
    ax.set(xlim=(0, top_mm), ylim=(min(0.0, 1e3 * float(y1_m.min())), top_mm))


def _causes_section(parts: dict[str, Any], drops: pd.DataFrame) -> Section:
    rows = pd.DataFrame(
        {"input": FACTORS[name], **(part["first_order"] or {}), "correlation": part["correlation"]}
        for name, part in parts.items()
    )
    columns = ["input", "estimate", "low", "high", "correlation"]
    rows = rows.reindex(columns=columns).rename(columns={"estimate": "first_order"})
    draft = prose("causes")
    lean, ratio = drops.lean_deg.to_numpy(), drops.rebound_ratio.to_numpy()
    data = draft.data("lean", {"lean_deg": lean, "ratio": ratio})
    draft.figure("lean", lean_figure(lean, ratio), data)
    draft.table("causes", rows, {"low": ("from", "", 3), "high": ("to", "", 3)})
    return draft.section()


@drawing("lean against the ground under the tip (degrees)", "y1/y0", legend=None, xlim=(0, None))
def lean_figure(ax: Axes, lean_deg: Array, ratio: Array) -> None:
    """y1/y0 against the angle between the bristle and the ground's normal, with its running
    5th, 50th and 95th percentiles."""
    ax.plot(lean_deg[:DOTS], ratio[:DOTS], ".", color=SKY, ms=2.5, zorder=1)
    bins = max(1, min(20, len(ratio) // IN_A_BIN))
    parts = np.array_split(np.argsort(lean_deg), bins)
    if len(parts) > 1:
        middle = [float(np.median(lean_deg[part])) for part in parts]
        low, median, high = np.transpose(
            [np.percentile(ratio[part], [5, 50, 95]) for part in parts]
        )
        ax.plot(middle, median, color=BLUE, label="median")
        ax.plot(middle, low, color=BLUE, lw=0.8, ls="--", label="5 and 95 %")
        ax.plot(middle, high, color=BLUE, lw=0.8, ls="--")
        ax.legend()
    ax.axhline(paper.RATIO_MEAN, color=GREY, lw=0.8)
    ax.set_ylim(min(0.0, float(ratio.min())), None)


def _conditions_section(
    inputs: ScatterInputs, surface: dict[str, Any] | None, check: Check
) -> Section:
    draft = prose("conditions", inputs=inputs, check=check)
    if surface is not None:
        rows = surface_rows(surface)
        draft.table("surface", {"quantity": rows, "value": rows.values()})
    return draft.section()
