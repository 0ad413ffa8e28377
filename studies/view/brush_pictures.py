"""Pictures of a brush's result: its film, its shape at the end, and force and torque over time."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
import pyvista
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ...solver.arrays import Array
from ...solver.errors import InputError
from ..brush.page import draw_shares, over_time
from ..brush.paraview import LINE, SERIES
from ..brush.record import LOAD_COLUMNS, MEAN_COLUMNS
from ..brush.shape import TIPS, Sides, spread
from ..data.tables import column, read_table
from ..film.encoding import film_writer
from ..report.figures import BLACK, STYLE, panels, styled

N_FILM, RATE, DPI = 250, 25, 160
# Bristles that are drawn at most, spread over all.
DRAWN = 400


@dataclass(frozen=True)
class BrushSeries:
    """The frames of a brush: ``times_s`` and the ``files`` with lines."""

    times_s: Array
    files: list[Path]

    @classmethod
    def of(cls, folder: Path) -> BrushSeries:
        """Of a folder of fields. Raises InputError where it is not what this program writes."""
        path = folder / SERIES
        try:
            entries = [each.attrib for each in ET.parse(path).getroot().iter("DataSet")]
            lines = [each for each in entries if each["part"] == "0"]
            times = [float(each["timestep"]) for each in lines]
            files = [folder / each["file"] for each in lines]
        except (OSError, ET.ParseError, KeyError, ValueError) as error:
            raise InputError(f"{path}: not a series of a brush: {error}") from error
        if not files:
            raise InputError(f"{path}: no frame of a brush is in it")
        return cls(np.array(times), files)

    def read(self, frame: int) -> tuple[Array, Array, Array]:
        """Points (n, nodes, 3) in mm from the hub, bending stress (n, nodes) in MPa, and state
        (n,), of bristles spread over all."""
        path = self.files[frame]
        if not path.is_file():
            raise InputError(f"{path}: this frame is missing; compute the brush again")
        grid: Any = pyvista.read(path)
        n = grid.n_cells
        if not n or set(grid.celltypes) != {LINE} or grid.n_points % n:
            raise InputError(f"{path}: not a frame of a brush")
        points = 1e3 * np.asarray(grid.points, dtype=float).reshape(n, -1, 3)
        stress = 1e-6 * np.asarray(grid.point_data["bending_stress_Pa"]).reshape(n, -1)
        # the clamps' middle follows the hub
        points[:, :, :2] -= points[:, 0, :2].mean(axis=0)
        chosen = spread(n, DRAWN)
        return points[chosen], stress[chosen], np.asarray(grid.cell_data["state"])[chosen]


def read_means(path: Path) -> pd.DataFrame:
    """Force, torque and shares over windows of time. Raises InputError where it is none."""
    rows = read_table(path, MEAN_COLUMNS)
    return pd.DataFrame({name: column(path, rows, name) for name in MEAN_COLUMNS})


@styled
def load_figure(means: pd.DataFrame) -> Figure:
    """Force, torque, and shares of tips over time, one below the other."""
    figure, axes = panels(rows=3, height_in=5.6, sharex=True)
    over_time(axes[0, 0], means, LOAD_COLUMNS[:3])
    over_time(axes[1, 0], means, LOAD_COLUMNS[3:])
    draw_shares(axes[2, 0], means, [label for label, _ in TIPS.values()])
    for ax, name in zip(axes[:, 0], ("force (N)", "torque (N m)", "share of tips"), strict=True):
        ax.set(ylabel=name)
        ax.legend(loc="upper left", ncols=3)
    axes[2, 0].set(xlabel="time (s)", ylim=(0.0, 1.0))
    return figure


def filmed(count: int) -> list[int]:
    """Which of ``count`` frames the film shows."""
    return spread(count, N_FILM)


def write_film(
    series: BrushSeries,
    means: pd.DataFrame,
    path: Path,
    advance: Callable[[], None] = lambda: None,
) -> Figure:
    """Write the brush from two sides over the force on its hub, frame after frame; returns the last
    picture. ``advance`` is called for each frame, twice."""
    frames = filmed(len(series.times_s))
    low, high, stress = np.full(3, np.inf), np.full(3, -np.inf), 0.0
    for frame in frames:
        points, tone, _ = series.read(frame)
        low = np.minimum(low, points.min(axis=(0, 1)))
        high = np.maximum(high, points.max(axis=(0, 1)))
        stress = max(stress, float(tone.max()))
        advance()
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 5.2), layout="constrained")
        parts: Any = figure.subplot_mosaic([["x", "y"], ["force", "force"]], height_ratios=[3, 1])
        sides = Sides(figure, (parts["x"], parts["y"]), low, high, stress)
        dots = [
            parts["y"].scatter([], [], s=9.0, color=colour, label=f"tip {label}")
            for label, colour in TIPS.values()
        ]
        figure.legend(handles=dots, loc="outside upper right", ncols=2)
        over_time(parts["force"], means, LOAD_COLUMNS[:3])
        parts["force"].set(xlabel="time (s)", ylabel="force on the hub (N)")
        parts["force"].legend(loc="upper left", ncols=3)
        now = parts["force"].axvline(0.0, color=BLACK, lw=0.8)
        title = figure.suptitle(" ", x=0.02, ha="left", fontsize=9.0)
        canvas = FigureCanvasAgg(figure)
        figure.set_dpi(DPI)
        canvas.draw()
        # settling the layout anew for each frame would take longer than all else
        figure.set_layout_engine("none")
        rows, columns = (2 * (side // 2) for side in np.asarray(canvas.buffer_rgba()).shape[:2])
        with film_writer(path, RATE, rows, columns) as add:
            for frame in frames:
                sides.show(*series.read(frame))
                now.set_xdata([series.times_s[frame]] * 2)
                title.set_text(f"{series.times_s[frame]:.4f} s")
                canvas.draw()
                add(np.asarray(canvas.buffer_rgba())[:rows, :columns, :3])
                advance()
    return figure
