"""Geometry of a bristle and of its mesh.

A `MeshSpec` holds everything that a mesh depends on. It is checked when it is made, so nothing
downstream has to check again. The bristle stands on the plane z = 0: its tip is the face z = 0, its
top the face z = length, and the section is centred on the z axis.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from numbers import Integral

import numpy as np
import numpy.typing as npt

from .section import Circle, Rectangle, Section, require_positive

MIN_RELATIVE_CELL = 1e-6
"""Shortest cell edge over bristle length; gmsh merges points closer than 1e-8 of the model."""


class Tag(IntEnum):
    """Physical groups of every bristle mesh: one volume and the three parts of its surface."""

    BODY = 1
    TIP = 2
    TOP = 3
    SIDE = 4


@dataclass(frozen=True)
class MeshSpec:
    """A bristle and its division into hexahedra; the defaults are the paper's bristle.

    The paper: Vanegas-Useche, Abdel-Wahab and Parker, CMC 56(1), 2018.

    Parameters
    ----------
    length_m : length along z, m
    section : `Rectangle` or `Circle`
    cells : (NX, NY, NZ).  Rectangle: divisions in x (thickness), y (width) and z.  Circle: NX cells
        along each side of the core square, NY cells radially in the ring around it (so 4 NX
        cells around the circumference), NZ along z.
    geometry_order : 1 for straight edges, 2 for 27-node hexahedra whose edges follow a circle
    grading : length of the cell at the top over that of the cell at the tip; the lengths
        between are a geometric progression.  1 is uniform, more than 1 is finer at the tip.

    Raises
    ------
    ValueError : a value is of the wrong kind, not positive, or makes a cell edge shorter than
        1e-6 of the largest measure, which gmsh would merge away
    """

    length_m: float = 336.5e-3
    section: Section = field(default_factory=Rectangle)
    cells: tuple[int, int, int] = (1, 4, 337)
    geometry_order: int = 1
    grading: float = 1.0

    def __post_init__(self) -> None:
        require_positive("length_m", self.length_m)
        require_positive("grading", self.grading)
        if not isinstance(self.section, Rectangle | Circle):
            raise ValueError(f"section must be a Rectangle or a Circle, not {self.section!r}.")
        order = self.geometry_order
        if isinstance(order, bool) or not isinstance(order, Integral) or order not in (1, 2):
            raise ValueError(f"geometry_order must be 1 or 2, not {order!r}.")
        object.__setattr__(self, "geometry_order", int(order))
        self._normalise_cells()
        self._require_resolvable()

    def _normalise_cells(self) -> None:
        try:
            cells = tuple(self.cells)
        except TypeError:
            cells = ()
        if len(cells) != 3:
            raise ValueError(f"cells must be three numbers NX, NY, NZ, not {self.cells!r}.")
        for name, count in zip(("NX", "NY", "NZ"), cells, strict=True):
            if isinstance(count, bool) or not isinstance(count, Integral) or count < 1:
                raise ValueError(f"cells: {name} must be a whole number from 1, not {count!r}.")
        object.__setattr__(self, "cells", tuple(int(count) for count in cells))

    def _require_resolvable(self) -> None:
        nx, ny, _ = self.cells
        if isinstance(self.section, Rectangle):
            across = [self.section.thickness_m, self.section.width_m]
            edges = [self.section.thickness_m / nx, self.section.width_m / ny]
        else:
            across = [self.section.diameter_m]
            edges = [self.section.diameter_m / (2 * nx), self.section.diameter_m / (4 * ny)]
        edges.append(float(np.diff(self.levels_m).min()))
        shortest, largest = min(edges), max(self.length_m, *across)
        if not shortest > MIN_RELATIVE_CELL * largest:
            raise ValueError(
                f"cells {self.cells} with grading {self.grading:g} make an edge of "
                f"{shortest:.3g} m on a body of {largest:.3g} m: too short to mesh."
            )

    @property
    def levels_m(self) -> npt.NDArray[np.float64]:
        """Heights of the cell layers, m: shape (NZ + 1,), from 0 at the tip to the length."""
        nz = self.cells[2]
        exponents = np.linspace(0.0, 1.0, nz) if nz > 1 else np.zeros(1)
        lengths = self.grading**exponents
        levels = np.concatenate(([0.0], np.cumsum(lengths)))
        return self.length_m * (levels / levels[-1])

    @property
    def n_section_cells(self) -> int:
        """Cells in one layer, which is also the number of tip facets."""
        nx, ny, _ = self.cells
        return nx * ny if isinstance(self.section, Rectangle) else nx * nx + 4 * nx * ny

    @property
    def n_perimeter_cells(self) -> int:
        """Cell edges around the section."""
        nx, ny, _ = self.cells
        return 2 * (nx + ny) if isinstance(self.section, Rectangle) else 4 * nx

    @property
    def n_cells(self) -> int:
        """Hexahedra in the mesh."""
        return self.n_section_cells * self.cells[2]

    @property
    def n_facets(self) -> dict[Tag, int]:
        """Number of facets that each part of the surface has."""
        return {
            Tag.TIP: self.n_section_cells,
            Tag.TOP: self.n_section_cells,
            Tag.SIDE: self.n_perimeter_cells * self.cells[2],
        }

    @property
    def volume_m3(self) -> float:
        """Volume of the true body (not of its mesh), m³."""
        return self.section.area_m2 * self.length_m
