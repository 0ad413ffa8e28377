"""Pictures of a mesh.

A bristle is hundreds of times longer than it is wide, so the picture has two panels: the tip in
true proportions, and the whole with its axis compressed.  `write_picture` is what to call; the
drawing itself is this module run as a program, see `bristle.meshes.display`.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import meshio
import numpy as np
import numpy.typing as npt
import pyvista

from .convert import TAG_DATA, read_vtu
from .display import run_drawing
from .geometry import Tag

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


@dataclass(frozen=True)
class Surface:
    """The outside of a mesh: flat pieces of facets (n, 4), the tag of each, edges (m, 2 or 3)."""

    points_mm: npt.NDArray[np.float64]
    pieces: npt.NDArray[np.int64]
    tags: npt.NDArray[np.int32]
    edges: npt.NDArray[np.int64]

    @property
    def width_mm(self) -> float:
        """Larger extent of the section."""
        return float(np.ptp(self.points_mm[:, :2], axis=0).max())

    @property
    def length_mm(self) -> float:
        """Extent along the axis."""
        return float(np.ptp(self.points_mm[:, 2]))

    def below(self, z_mm: float) -> Surface:
        """Return the cells up to the first layer boundary at or above a height."""
        z = self.points_mm[:, 2]
        ends = np.unique(z[self.edges[:, [0, -1]]])
        slack = 1e-9 * self.length_mm
        cut = ends[ends >= z_mm - slack].min(initial=z.max()) + slack
        keep = (z[self.pieces] <= cut).all(axis=1)
        return replace(
            self,
            pieces=self.pieces[keep],
            tags=self.tags[keep],
            edges=self.edges[(z[self.edges] <= cut).all(axis=1)],
        )

    def compressed(self, factor: float) -> Surface:
        """Return the surface with its heights divided by a factor."""
        return replace(self, points_mm=self.points_mm / np.array([1.0, 1.0, factor]))

    def thinned(self, n_rings: int) -> Surface:
        """Return it with the edges across the axis left out but for about `n_rings` layers."""
        z = self.points_mm[:, 2] / self.length_mm
        across = np.ptp(z[self.edges], axis=1) < 1e-9
        levels, level = np.unique(np.round(z[self.edges[:, 0]], 9), return_inverse=True)
        stride = max(1, round(len(levels) / n_rings))
        drawn = (level % stride == 0) | (level == len(levels) - 1)
        return replace(self, edges=self.edges[~across | drawn])


def outside(mesh: meshio.Mesh) -> Surface:
    """Return the outside of a mesh from `bristle.meshes.convert`."""
    (index,) = [i for i, block in enumerate(mesh.cells) if block.type.startswith("quad")]
    quads, tags = mesh.cells[index].data, mesh.cell_data[TAG_DATA][index]
    pieces: list[tuple[int, ...]]
    edges: list[tuple[int, ...]]
    if mesh.cells[index].type == "quad":
        pieces, edges = [(0, 1, 2, 3)], [(0, 1), (1, 2), (2, 3), (3, 0)]
    else:
        pieces = [(0, 4, 8, 7), (4, 1, 5, 8), (8, 5, 2, 6), (7, 8, 6, 3)]
        edges = [(0, 4, 1), (1, 5, 2), (2, 6, 3), (3, 7, 0)]
    return Surface(
        points_mm=mesh.points * 1e3,
        pieces=quads[:, pieces].reshape(-1, 4),
        tags=np.repeat(tags, len(pieces)),
        edges=quads[:, edges].reshape(-1, len(edges[0])),
    )


def round_length_mm(limit_mm: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above the limit."""
    decade = 10.0 ** np.floor(np.log10(limit_mm) + 1e-9)
    return float(max(step * decade for step in (1, 2, 5) if step * decade <= limit_mm * (1 + 1e-9)))


def write_picture(vtu: Path, png: Path, timeout_s: float = 300.0) -> None:
    """Draw the mesh in `vtu` (from `bristle.meshes.convert.write_vtu`) into `png`, screen or none.

    Raises
    ------
    DrawingError : there is nothing to draw on, or drawing failed
    """
    run_drawing([sys.executable, "-m", __name__, str(vtu), str(png)], timeout_s)


def draw(mesh: meshio.Mesh, png: Path) -> None:
    """Draw both panels; needs a display, and takes the process down where there is none."""
    surface = outside(mesh)
    width, length = surface.width_mm, surface.length_mm
    factor = max(1.0, length / (WHOLE_WIDTHS * width))
    plotter = pyvista.Plotter(
        off_screen=True, shape=(1, 2), window_size=(2 * PANEL_PIXELS[0], PANEL_PIXELS[1])
    )
    plotter.background_color = "white"
    panels = [
        (
            surface.below(CLOSE_UP_WIDTHS * width),
            1.0,
            round_length_mm(min(width, length)),
            "The tip, true proportions",
        ),
        (
            surface.thinned(MAX_RINGS).compressed(factor),
            factor,
            round_length_mm(length / 2),
            f"The whole, {length:g} mm" + f", axis compressed {factor:.3g} times" * (factor > 1),
        ),
    ]
    for column, panel in enumerate(panels):
        plotter.subplot(0, column)
        _panel(plotter, *panel)
    plotter.screenshot(str(png))
    plotter.close()


def _panel(
    plotter: pyvista.Plotter, surface: Surface, compression: float, bar_mm: float, title: str
) -> None:
    """Draw a surface with a title and, beside it, a bar along the axis that is `bar_mm` long."""
    for tag, colour in COLOURS.items():
        pieces = surface.pieces[surface.tags == tag]
        if len(pieces):
            body = pyvista.PolyData(surface.points_mm, faces=_counted(pieces))
            plotter.add_mesh(body, color=colour, lighting=False)
    # A little toward the camera, so that faces do not hide half of each line.
    nearer = surface.points_mm + 0.005 * surface.width_mm * VIEW_FROM
    edges = pyvista.PolyData(nearer, lines=_counted(surface.edges))
    plotter.add_mesh(edges, color="black", line_width=1.5, lighting=False)
    x, y, _ = surface.points_mm.max(axis=0) + 0.3 * surface.width_mm
    bar = np.array([[x, y, 0.0], [x, y, bar_mm / compression]])
    plotter.add_mesh(pyvista.Line(*bar), color="black", line_width=6, lighting=False)
    plotter.add_point_labels(
        bar.mean(axis=0)[None],
        [f"  {bar_mm:g} mm"],
        font_size=22,
        shape=None,
        show_points=False,
        always_visible=True,
        text_color="black",
    )
    top_left = (20, PANEL_PIXELS[1] - 45)
    plotter.add_text(title, position=top_left, font_size=14, color="black")
    plotter.enable_parallel_projection()  # type: ignore[call-arg]
    shown = surface.points_mm[np.unique(surface.pieces)]
    plotter.camera.focal_point = (shown.min(axis=0) + shown.max(axis=0)) / 2
    plotter.camera.position = plotter.camera.focal_point + VIEW_FROM
    plotter.camera.up = (0.0, 0.0, 1.0)
    plotter.reset_camera(bounds=_bounds(np.vstack([shown, bar])))  # type: ignore[call-arg]


def _counted(rows: npt.NDArray) -> npt.NDArray:
    """Return rows of indices as VTK's flat array, a count before each."""
    return np.insert(rows, 0, rows.shape[1], axis=1).ravel()


def _bounds(points: npt.NDArray) -> list[float]:
    return [float(x) for column in points.T for x in (column.min(), column.max())]


if __name__ == "__main__":
    draw(read_vtu(Path(sys.argv[1])), Path(sys.argv[2]))
