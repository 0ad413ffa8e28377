"""Pictures of a mesh.

A bristle is hundreds of times longer than it is wide, so the picture has two panels: the tip in
true proportions, and the whole with its axis compressed.  `write_picture` is what to call; the
drawing itself is this module run as a program, see `display`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pyvista

from ...meshes.geometry import Tag
from .convert import TAG_DATA
from .display import run_drawing

PANEL_PIXELS = (800, 900)
CLOSE_UP_WIDTHS = 2.5
"""Length of bristle in the close-up, in widths of the section."""
WHOLE_WIDTHS = 6.0
"""Length to which the whole is compressed at most, in widths of the section."""
MAX_RINGS = 60
"""Cell layers that are outlined in the whole: with more it would be black."""
COLOURS = {Tag.SIDE: "#c9d3dc", Tag.TOP: "#aebccb", Tag.TIP: "#d9822b"}
VIEW_FROM = np.array([1.0, -0.9, -0.75])
"""Toward the camera: the tip is seen from below."""


def write_picture(vtu: Path, png: Path) -> None:
    """Draw the mesh in `vtu` (from `convert.write_vtu`) into `png`, screen or none.

    Raises DrawingError where there is nothing to draw on, or drawing failed.
    """
    run_drawing([sys.executable, "-m", __name__, str(vtu), str(png)])


def read_facets(vtu: Path) -> pyvista.UnstructuredGrid:
    """The facets of a mesh from `convert.write_vtu`, with their tags; in mm."""
    grid = pyvista.read(vtu)
    facets = grid.extract_cells(np.flatnonzero(grid.cell_data[TAG_DATA] != Tag.BODY))
    facets.points *= 1e3
    return facets


def below(facets: pyvista.UnstructuredGrid, z_mm: float) -> pyvista.UnstructuredGrid:
    """The facets up to the first layer boundary at or above a height."""
    tops = np.array([cell.bounds[5] for cell in facets.cell])
    slack = 1e-9 * np.ptp(facets.points[:, 2])
    cut = tops[tops >= z_mm - slack].min(initial=tops.max()) + slack
    return facets.extract_cells(np.flatnonzero(tops <= cut))


def thinned(edges: pyvista.PolyData, n_rings: int) -> pyvista.PolyData:
    """The edges without those across the axis, but for about `n_rings` layers."""
    z = edges.points[edges.lines.reshape(-1, 3)[:, 1:], 2] / np.ptp(edges.points[:, 2])
    across = np.ptp(z, axis=1) < 1e-9
    levels, level = np.unique(np.round(z[across, 0], 9), return_inverse=True)
    stride = max(1, round(len(levels) / n_rings))
    drawn = ~across
    drawn[across] = (level % stride == 0) | (level == len(levels) - 1)
    return pyvista.PolyData(edges.points, lines=edges.lines.reshape(-1, 3)[drawn].ravel())


def round_length_mm(limit_mm: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above the limit."""
    decade = 10.0 ** np.floor(np.log10(limit_mm) + 1e-9)
    return float(max(step * decade for step in (1, 2, 5) if step * decade <= limit_mm * (1 + 1e-9)))


def draw(facets: pyvista.UnstructuredGrid, png: Path) -> None:
    """Draw both panels; needs a display, and takes the process down where there is none."""
    extents = np.ptp(facets.points, axis=0)
    width, length = float(extents[:2].max()), float(extents[2])
    factor = max(1.0, length / (WHOLE_WIDTHS * width))
    plotter = pyvista.Plotter(
        off_screen=True, shape=(1, 2), window_size=(2 * PANEL_PIXELS[0], PANEL_PIXELS[1])
    )
    plotter.background_color = "white"
    plotter.subplot(0, 0)
    close_up = below(facets, CLOSE_UP_WIDTHS * width)
    _panel(plotter, close_up, round_length_mm(min(width, length)), "The tip, true proportions")
    plotter.subplot(0, 1)
    title = f"The whole, {length:g} mm" + f", axis compressed {factor:.3g} times" * (factor > 1)
    _panel(plotter, facets, round_length_mm(length / 2), title, factor)
    plotter.screenshot(str(png))
    plotter.close()


def _panel(
    plotter: pyvista.Plotter,
    facets: pyvista.UnstructuredGrid,
    bar_mm: float,
    title: str,
    compression: float = 1.0,
) -> None:
    """Draw facets with a title and, beside them, a bar along the axis that is `bar_mm` long."""
    squeezed = facets.scale([1.0, 1.0, 1.0 / compression])
    width = float(np.ptp(facets.points[:, :2], axis=0).max())
    for tag, colour in COLOURS.items():
        own = squeezed.extract_cells(np.flatnonzero(squeezed.cell_data[TAG_DATA] == tag))
        if own.n_cells:
            plotter.add_mesh(
                own.extract_surface(nonlinear_subdivision=1), color=colour, lighting=False
            )
    # A little toward the camera, so that faces do not hide half of each line.
    edges = thinned(squeezed.extract_all_edges(), MAX_RINGS).translate(0.005 * width * VIEW_FROM)
    plotter.add_mesh(edges, color="black", line_width=1.5, lighting=False)
    x, y, _ = squeezed.points.max(axis=0) + 0.3 * width
    bar = pyvista.Line([x, y, 0.0], [x, y, bar_mm / compression])
    plotter.add_mesh(bar, color="black", line_width=6, lighting=False)
    plotter.add_point_labels(
        [bar.center],
        [f"  {bar_mm:g} mm"],
        font_size=22,
        shape=None,
        show_points=False,
        always_visible=True,
        text_color="black",
    )
    plotter.add_text(title, position=(20, PANEL_PIXELS[1] - 45), font_size=14, color="black")
    plotter.enable_parallel_projection()  # type: ignore[call-arg]
    plotter.view_vector(VIEW_FROM, viewup=(0.0, 0.0, 1.0))  # type: ignore[arg-type]
    plotter.reset_camera(bounds=squeezed.merge(bar).bounds)  # type: ignore[call-arg]


if __name__ == "__main__":
    draw(read_facets(Path(sys.argv[1])), Path(sys.argv[2]))
