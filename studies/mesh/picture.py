"""A mesh for ParaView, and its picture.

meshio carries gmsh's `.msh` file over to `.vtu`, which ParaView opens with second-order cells kept
(27-node hexahedra and 9-node quadrilaterals, VTK's tri- and biquadratic cells).  There is no XDMF:
ParaView's readers crash on it or show nothing where the cells are of second order.

A bristle is hundreds of times longer than it is wide, so the picture has two panels: the tip in
true proportions, and the whole with its axis compressed.  Debian's VTK draws through X11 alone and
takes the whole process down where it finds no X server.  So `write_picture` has it drawn by this
module run as a program, on a display that xvfb-run provides for as long as the drawing lasts.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import meshio
import numpy as np
import pyvista

from ...meshes.geometry import Tag
from ...solver.errors import ComputationError

TAG_DATA = "tag"
"""Name of the cell data that hold the values of `Tag`."""
ON_XVFB = ["xvfb-run", "-a", "-e", "/dev/stderr", "-s", "-screen 0 640x480x24"]
# With its caller, or when its time is over, the drawing ends, and its display with it.
BOUNDED = ["setpriv", "--pdeathsig", "TERM", "timeout", "--kill-after=5"]
TIMED_OUT = 124  # what timeout exits with
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


def write_vtu(msh: Path, vtu: Path) -> None:
    """Write gmsh's file `msh` for ParaView: points in m, cells in VTK's node order.

    Beside `TAG_DATA` each physical group becomes cell data of its name, 1 inside and 0 outside,
    because VTK has no cell sets.
    """
    mesh = meshio.gmsh.read(msh)  # meshio.read prints, and exits the process, where it fails
    tags = [own.astype(np.int32) for own in mesh.cell_data["gmsh:physical"]]
    data = {tag.name.lower(): [(own == tag).astype(np.int32) for own in tags] for tag in Tag}
    whole = meshio.Mesh(mesh.points, mesh.cells, cell_data={TAG_DATA: tags, **data})
    meshio.write(vtu, whole, file_format="vtu")


def write_picture(vtu: Path, png: Path) -> None:
    """Draw the mesh in `vtu` (from `write_vtu`) into `png`, screen or none.

    Raises DrawingError where there is nothing to draw on, or drawing failed.
    """
    run_drawing([sys.executable, "-m", __name__, str(vtu), str(png)])


class DrawingError(ComputationError):
    """A picture could not be drawn."""


def run_drawing(command: Sequence[str], timeout_s: float = 300.0) -> None:
    """Run a command that draws, on a display of its own or, without xvfb-run, on the caller's.

    Raises DrawingError, with the last that was written to standard error, where there is no
    display, or the command fails, dies or takes more than `timeout_s`.
    """
    on_display = ON_XVFB if shutil.which("xvfb-run") else []
    if not on_display and not os.environ.get("DISPLAY"):
        raise DrawingError("There is no display to draw on: install Xvfb or set DISPLAY.")
    with (
        tempfile.TemporaryFile("w+", errors="replace") as log,
        subprocess.Popen(
            [*BOUNDED, str(timeout_s), *on_display, *command],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=log,
            text=True,
            errors="replace",
        ) as process,
    ):
        try:
            status = process.wait()
        finally:
            process.terminate()
        log.seek(0)
        output = log.read().strip().splitlines() or [f"exit status {status}"]
    if status == TIMED_OUT:
        raise DrawingError(f"Drawing took more than {timeout_s:g} s.")
    if status > 128 or status < 0:  # of a shell, or of the command itself
        name = signal.Signals(abs(status) % 128).name
        raise DrawingError(f"Drawing failed: {name}, {'; '.join(output[-2:])}")
    if status:
        raise DrawingError(f"Drawing failed: {output[-1]}")


def read_facets(vtu: Path) -> pyvista.UnstructuredGrid:
    """The facets of a mesh from `write_vtu`, with their tags; in mm."""
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
