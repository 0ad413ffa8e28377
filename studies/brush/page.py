"""Page and figures of a brush."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...solver.arrays import Array
from .. import __version__
from ..inputs.choices import Layout
from ..inputs.sources import checked, command_line
from ..report.figures import BLACK, BLUE, GREEN, VERMILION, drawing, panels, styled
from ..report.page import Head, Report, Section, write_report
from ..report.prose import Prose
from ..surface.ground import surface_rows
from .inputs import BrushInputs
from .record import DRAWN, LOAD_COLUMNS, SHARE_COLUMNS, Record
from .shape import TIPS, Sides, spread

# Instants of which the shape is drawn: of one bristle several, of many the last.
INSTANTS = 7
HEADS: dict[str, Head] = {
    "from_s": ("from", "s", 4),
    "to_s": ("to", "s", 4),
    **{name: (name.replace("_", " "), "share of tips", 3) for name in SHARE_COLUMNS},
    "stress_MPa": ("bending stress", "MPa", 4),
    **{f"f{axis}_N": (f"force along {axis}", "N", 4) for axis in "xyz"},
    **{f"m{axis}_Nm": (f"torque about {axis}", "N m", 4) for axis in "xyz"},
    "energy_J": ("energy", "J", 4),
}
ENERGIES = {
    "hub_work_J": "work of the hub",
    "kinetic_J": "motion of the bristles",
    "strain_J": "elastic energy of the bristles",
    "potential_J": "height of the bristles",
    "contact_J": "held by the contact springs",
    "material_loss_J": "lost in the material",
    "friction_loss_J": "lost to friction",
    "numerical_J": "lost by the time steps",
}
prose = Prose(Path(__file__).with_name("words.j2"), HEADS)


def write_page(inputs: BrushInputs, record: Record, document: Mapping[str, Any], out: Path) -> None:
    """Write ``report.html``, ``figures/`` and ``tables/`` of what a brush did."""
    over = record.interval_table()
    sections = [
        _force_section(over, document),
        _tips_section(over, document),
        _shape_section(inputs, record),
        _stress_section(record.over_time(), document, inputs.yield_strength_Pa),
        _energy_section(inputs, document),
    ]
    if document["surface"] is not None:
        draft = prose("surface")
        rows = surface_rows(document["surface"])
        draft.table("surface", {"quantity": rows, "value": rows.values()})
        sections.append(draft.section())
    if document["warnings"]:
        sections.append(Section("warnings", "What deserves doubt", document["warnings"]))
    page = Report(
        title="A brush on a surface",
        lead=prose.text("lead", inputs=inputs)[0],
        version=__version__,
        command=command_line("brush", inputs, checked(BrushInputs, {}), out),
        headline=prose.text("headline", said=document, inputs=inputs),
        facts=[("bristles", str(inputs.count)), ("time steps", str(record.frames[-1].steps))],
        sections=sections,
    )
    write_report(page, out)


def _force_section(over: pd.DataFrame, document: Mapping[str, Any]) -> Section:
    draft = prose("force", said=document)
    data = draft.data("intervals", over[["from_s", "to_s", *LOAD_COLUMNS]])
    for name, unit, names in (
        ("force", "N", LOAD_COLUMNS[:3]),
        ("torque", "N m", LOAD_COLUMNS[3:]),
    ):
        draw = drawing("time (s)", f"{name} on the hub ({unit})")(over_time)
        draft.figure(name, draw(over, names), data)
    return draft.section()


def over_time(ax: Axes, table: pd.DataFrame, names: Sequence[str]) -> None:
    """Draw three components over the intervals of a table."""
    for name, axis, colour in zip(names, "xyz", (VERMILION, GREEN, BLUE), strict=True):
        ax.stairs(table[name], edges(table), color=colour, label=axis, baseline=None)


def edges(table: pd.DataFrame) -> Array:
    """Where intervals that follow each other begin and end."""
    return np.array([*table.from_s, table.to_s.iloc[-1]])


def _tips_section(over: pd.DataFrame, document: Mapping[str, Any]) -> Section:
    draft = prose("tips", said=document)
    data = draft.data("shares", over[["from_s", "to_s", *SHARE_COLUMNS]])
    draft.figure("shares", shares_figure(over), data)
    return draft.section()


@drawing("time (s)", "share of tips", ylim=(-0.03, 1.03))
def shares_figure(ax: Axes, over: pd.DataFrame) -> None:
    """Shares of tips that stick and that slip over time."""
    draw_shares(ax, over, ["stick", "slip"])


def draw_shares(ax: Axes, table: pd.DataFrame, labels: Sequence[str]) -> None:
    """Draw shares of tips that stick and that slip over the intervals of a table."""
    shares = [np.repeat(table[name], 2) for name in SHARE_COLUMNS[1:]]
    colours = [colour for _, colour in TIPS.values()]
    ends = np.repeat(edges(table), 2)[1:-1]
    ax.stackplot(ends, *shares, labels=labels, colors=colours, alpha=0.55, lw=0)


def _shape_section(inputs: BrushInputs, record: Record) -> Section:
    several, count = inputs.layout is Layout.SINGLE, len(record.frames)
    shapes, rows, path = [], [], inputs.hub_motion
    for i in spread(count, INSTANTS) if several else [count - 1]:
        frame = record.frames[i]
        lines = np.concatenate([frame.centre_m, frame.bending_stress_Pa[..., None]], axis=-1)
        lines -= [*path.pose(frame.t_s).position_m[:2], 0.0, 0.0]
        shapes.extend(lines)
        for bristle, line in zip(spread(inputs.count, DRAWN), lines, strict=True):
            points = pd.DataFrame(1e3 * line[:, :3], columns=["x_mm", "y_mm", "z_mm"])
            points["stress_MPa"] = 1e-6 * line[:, 3]
            points.insert(0, "bristle", bristle)
            points.insert(0, "t_s", frame.t_s)
            rows.append(points)
    draft = prose("shape", several=several, drawn=min(inputs.count, DRAWN), count=inputs.count)
    data = draft.data("shape", pd.concat(rows))
    draft.figure("shape", shape_figure(np.array(shapes)), data)
    return draft.section()


@styled
def shape_figure(lines: Array) -> Figure:
    """Bristles (n, nodes, 4) from two sides, coloured by bending stress, the last coordinate."""
    figure, axes = panels(columns=2, height_in=3.6)
    stress, points = 1e-6 * lines[:, :, 3], 1e3 * lines[:, :, :3]
    low, high = points.min(axis=(0, 1)), points.max(axis=(0, 1))
    sides = Sides(figure, tuple(axes[0]), low, high, float(stress.max()))
    sides.show(points, stress)
    bar = sides.bar
    if bar.solids is not None:  # a page takes no pictures of pixels
        bar.solids.set(rasterized=False, edgecolor="face")
    return figure


def _stress_section(
    over: pd.DataFrame, document: Mapping[str, Any], yield_strength_Pa: float | None
) -> Section:
    draft = prose("stress", said=document, limit=yield_strength_Pa)
    table = pd.DataFrame({"t_s": over.t_s, "stress_MPa": 1e-6 * over.bending_stress_Pa})
    draft.figure("stress", stress_figure(table, yield_strength_Pa), draft.data("stress", table))
    return draft.section()


@drawing("time (s)", "greatest bending stress (MPa)", ylim=(0.0, None))
def stress_figure(ax: Axes, table: pd.DataFrame, yield_strength_Pa: float | None) -> None:
    """The greatest bending stress of all bristles over time, and the yield strength."""
    ax.plot(table.t_s, table.stress_MPa, color=BLUE, label="greatest of all bristles")
    if yield_strength_Pa is not None:
        ax.axhline(1e-6 * yield_strength_Pa, color=BLACK, ls="--", label="yield strength")


def _energy_section(inputs: BrushInputs, document: Mapping[str, Any]) -> Section:
    draft = prose("energy", said=document, inputs=inputs)
    energy = document["energy"]
    rows = {"what": list(ENERGIES.values()), "energy_J": [energy[name] for name in ENERGIES]}
    draft.table("energy", rows)
    return draft.section()
