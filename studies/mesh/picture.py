"""A mesh for ParaView, and its picture.

meshio carries gmsh's `.msh` file over to `.vtu`, which ParaView opens with second-order cells kept
(27-node hexahedra and 9-node quadrilaterals, VTK's tri- and biquadratic cells).  There is no XDMF:
ParaView's readers crash on it or show nothing where the cells are of second order.

A bristle is hundreds of times longer than it is wide, so the picture has two panels: the tip in
true proportions, and the whole with its axis compressed.  It is convex: the facets that face the
camera are all that is seen of it, and none hides another.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ...meshes.geometry import Tag
from ...solver.arrays import Array
from ..inputs.limits import round_down
from ..report.figures import BLACK, styled

TAG_DATA = "tag"
"""Name of the cell data that hold the values of `Tag`."""
OUTLINES = {"quad": (0, 1, 2, 3), "quad9": (0, 4, 1, 5, 2, 6, 3, 7)}
"""Nodes around a facet, by the name that meshio has for its kind."""
SIZE_IN, DPI = (16.0, 9.0), 100
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


@dataclass(frozen=True)
class Facets:
    """Facets of a mesh: the nodes around each, ``outline`` (facets, nodes, 3) in mm, and its
    ``tag`` (facets,)."""

    outline: Array
    tag: NDArray[np.int32]

    def of(self, which: NDArray[np.bool_]) -> Facets:
        """Those that ``which`` (facets,) tells."""
        return Facets(self.outline[which], self.tag[which])

    def below(self, z_mm: float) -> Facets:
        """Those up to the first layer boundary at or above a height."""
        tops = self.outline[..., 2].max(axis=1)
        slack = 1e-9 * np.ptp(tops)
        cut = tops[tops >= z_mm - slack].min(initial=tops.max()) + slack
        return self.of(tops <= cut)

    def squeezed(self, factor: float) -> Facets:
        """The same with the axis compressed."""
        return Facets(self.outline * np.array([1.0, 1.0, 1.0 / factor]), self.tag)

    def facing(self) -> Facets:
        """Those of a convex body that the camera sees."""
        one, other = (self.outline[:, k] - self.outline[:, 0] for k in (1, -1))
        normal, middle = np.cross(one, other), self.outline.mean(axis=1)
        outward = np.einsum("fx,fx->f", normal, middle - 0.5 * (middle.min(0) + middle.max(0)))
        return self.of(np.sign(outward) * (normal @ VIEW_FROM) > 0.0)

    def edges(self) -> Array:
        """Straight pieces (edges, 2, 3) of their outlines."""
        return np.stack([self.outline, np.roll(self.outline, -1, axis=1)], axis=2).reshape(-1, 2, 3)


def read_facets(vtu: Path) -> Facets:
    """The facets of a mesh from `write_vtu`."""
    mesh = meshio.vtu.read(vtu)
    blocks = zip(mesh.cells, mesh.cell_data[TAG_DATA], strict=True)
    found = [
        (1e3 * mesh.points[block.data[:, OUTLINES[block.type]]], tag)
        for block, tag in blocks
        if block.type in OUTLINES
    ]
    outline, tag = (np.concatenate(each) for each in zip(*found, strict=True))
    return Facets(outline, tag)


def thinned(edges: Array, n_rings: int) -> Array:
    """The edges (n, 2, 3) without those across the axis, but for about `n_rings` layers."""
    z = edges[..., 2] / np.ptp(edges[..., 2])
    across = np.ptp(z, axis=1) < 1e-9
    levels, level = np.unique(np.round(z[across, 0], 9), return_inverse=True)
    stride = max(1, round(len(levels) / n_rings))
    drawn = ~across
    drawn[across] = (level % stride == 0) | (level == len(levels) - 1)
    return edges[drawn]


@styled
def write_picture(vtu: Path, png: Path) -> None:
    """Draw the mesh in `vtu` (from `write_vtu`) into `png`."""
    facets = read_facets(vtu)
    extents = np.ptp(facets.outline.reshape(-1, 3), axis=0)
    width, length = float(extents[:2].max()), float(extents[2])
    factor = max(1.0, length / (WHOLE_WIDTHS * width))
    figure = Figure(figsize=SIZE_IN, layout="constrained")
    tip, whole = figure.subplots(1, 2)
    close_up = facets.below(CLOSE_UP_WIDTHS * width)
    _panel(tip, close_up, round_down(min(width, length)), "The tip, true proportions")
    title = f"The whole, {length:g} mm" + f", axis compressed {factor:.3g} times" * (factor > 1)
    _panel(whole, facets, round_down(length / 2), title, factor)
    figure.savefig(png, format="png", dpi=DPI, metadata={"Software": None})


def _panel(ax: Axes, facets: Facets, bar_mm: float, title: str, compression: float = 1.0) -> None:
    """Draw facets with a title and, beside them, a bar along the axis that is `bar_mm` long."""
    right = np.cross([0.0, 0.0, 1.0], VIEW_FROM)
    axes = np.array([right, np.cross(VIEW_FROM, right)])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    squeezed = facets.squeezed(compression)
    seen = squeezed.facing()
    colours = [COLOURS[Tag(int(tag))] for tag in seen.tag]
    ax.add_collection(PolyCollection(list(seen.outline @ axes.T), facecolors=colours))
    lines = thinned(seen.edges(), MAX_RINGS)
    ax.add_collection(LineCollection(list(lines @ axes.T), colors=BLACK, linewidths=1.1))
    points = squeezed.outline.reshape(-1, 3)
    x, y, _ = points.max(axis=0) + 0.3 * np.ptp(points[:, :2], axis=0).max()
    bar = np.array([[x, y, 0.0], [x, y, bar_mm / compression]]) @ axes.T
    ax.plot(*bar.T, color=BLACK, lw=4.0)
    ax.annotate(f"  {bar_mm:g} mm", bar.mean(axis=0), va="center", fontsize=16)
    ax.set_title(title, fontsize=14)
    ax.set_aspect("equal")
    ax.set_axis_off()
    ax.margins(0.1)
