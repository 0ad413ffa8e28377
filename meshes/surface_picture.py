"""What does a surface look like?

Two maps side by side, heights and phases.  Drawn by matplotlib without a screen and without its
global state.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from .surface import Surface

HEIGHT_COLOURS = "cividis"
PHASE_COLOURS = (
    "#999999", "#E69F00", "#0072B2", "#009E73", "#CC79A7", "#F0E442", "#56B4E9", "#D55E00",
)  # fmt: skip
"""Okabe and Ito's colours, which colour-blind readers tell apart; the first for cement."""
DOTS_PER_INCH = 150

Extent = tuple[float, float, float, float]


def write_picture(surface: Surface, png: Path) -> None:
    """Draw one tile: heights in µm and phases, over x and y in mm."""
    figure = Figure(figsize=(12, 5.6), layout="constrained")
    FigureCanvasAgg(figure)
    heights, phases = figure.subplots(1, 2)
    extent = (0.0, surface.size_m[0] * 1e3, 0.0, surface.size_m[1] * 1e3)
    _draw_heights(figure, heights, surface, extent)
    _draw_phases(phases, surface, extent)
    for axes in (heights, phases):
        axes.set(xlabel="x (mm)", ylabel="y (mm)")
    figure.savefig(png, dpi=DOTS_PER_INCH, format="png")


def _draw_heights(figure: Figure, axes: Axes, surface: Surface, extent: Extent) -> None:
    measured = surface.statistics()
    length = measured.correlation_length_m
    said = "" if length is None else f", correlation length {length * 1e3:.3g} mm"
    axes.set_title(f"Height: rms {measured.rms_height_m * 1e6:.3g} µm{said}")
    image = axes.imshow(surface.heights_m * 1e6, origin="lower", extent=extent, cmap=HEIGHT_COLOURS)
    figure.colorbar(image, ax=axes, label="height (µm)")


def _draw_phases(axes: Axes, surface: Surface, extent: Extent) -> None:
    phases = surface.composite.phases
    colours = [PHASE_COLOURS[number % len(PHASE_COLOURS)] for number in range(len(phases))]
    axes.set_title("Phase")
    axes.imshow(
        surface.phase,
        origin="lower",
        extent=extent,
        interpolation="nearest",
        cmap=ListedColormap(colours),
        norm=BoundaryNorm(np.arange(len(phases) + 1) - 0.5, len(phases)),
    )
    entries = [
        Patch(
            facecolor=colour,
            edgecolor="black",
            label=f"{phase.name}, {phase.youngs_Pa * 1e-9:.4g} GPa, {100 * fraction:.3g} %",
        )
        for phase, colour, fraction in zip(phases, colours, surface.fractions, strict=True)
    ]
    axes.legend(handles=entries, loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=2)
