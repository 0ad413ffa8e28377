"""Height, force and penetration of a drop over time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ...solver.arrays import Array
from ...solver.contact_phase import HISTORY_COLUMNS
from ..data.tables import column, read_table
from ..report.figures import BLACK, BLUE, GREY, ORANGE, SMALLEST, VERMILION, beside, panels, styled

MARGIN = 0.1


def read_history(path: Path) -> dict[str, Array]:
    """The columns of a history.csv. Raises InputError that names the file and the line."""
    rows = read_table(path, HISTORY_COLUMNS)
    return {name: column(path, rows, name) for name in HISTORY_COLUMNS}


def touch_time_s(history: dict[str, Array]) -> float:
    """When the tip came to the plane: the time of the last row before there was a force."""
    pressed = np.flatnonzero(history["force_N"] > 0.0)
    return float(history["t_s"][max(pressed[0] - 1, 0)] if len(pressed) else history["t_s"][0])


@styled
def history_figure(history: dict[str, Array], document: dict[str, Any]) -> Figure:
    """Heights over the whole drop; force and penetration over the first impact."""
    figure, axes = panels(3, 1, height_in=6.0)
    height, force, depth = axes[:, 0]
    t = history["t_s"] * 1e3
    height.plot(t, history["tip_y_m"] * 1e3, color=BLUE, label="lower tip")
    height.plot(
        t, history["cm_y_m"] * 1e3, color=ORANGE, linestyle="--", label="centre of mass, as it fell"
    )
    height.axhline(0.0, color=BLACK, linewidth=0.7)
    height.set_xlabel("time since release (ms)")
    height.set_ylabel("height (mm)")
    height.set_ylim(top=1.3 * height.get_ylim()[1])
    height.legend(loc="upper right", ncols=2)
    start = touch_time_s(history)
    lasted = float(document.get("contact_time_s") or 0.0)
    end = start + lasted if lasted > 0.0 else float(history["t_s"][-1])
    room = MARGIN * (end - start)
    inside = (history["t_s"] >= start - room) & (history["t_s"] <= end + room)
    since = (history["t_s"][inside] - start) * 1e6
    marker = {"marker": "o", "markersize": 2.5}
    force.plot(since, history["force_N"][inside], color=VERMILION, **marker)
    depth.plot(since, history["penetration_m"][inside] * 1e6, color=BLUE, **marker)
    for plot, label in ((force, "contact force (N)"), (depth, "penetration (µm)")):
        plot.set_xlim(-1e6 * room, 1e6 * (end - start + room))
        plot.set_ylim(bottom=0.0)
        plot.set_ylabel(label)
        plot.set_xlabel("time since touch (µs)")
        plot.axvline(1e6 * (end - start), color=GREY, linewidth=0.8, linestyle=":")
    at = 1e6 * (end - start), 1.0
    where: dict[str, Any] = {"xycoords": ("data", "axes fraction"), "fontsize": SMALLEST}
    beside(force, "last release", at, "right", above=False, color=GREY, **where)
    height.set_title(_title(document))
    return figure


def _title(document: dict[str, Any]) -> str:
    inputs = document.get("inputs") or {}
    parts = [f"{document.get('model', '')} model, {document.get('contact', '')} contact"]
    if isinstance(inputs.get("kn_N_m"), int | float):
        parts.append(f"Kn {inputs['kn_N_m'] / 1e6:g} MN/m")
    if isinstance(inputs.get("height_m"), int | float):
        parts.append(f"from {inputs['height_m'] * 1e3:g} mm")
    return ", ".join(parts)
