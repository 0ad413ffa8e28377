"""Quality of a mesh's cells."""

from __future__ import annotations

import csv
from dataclasses import asdict, dataclass
from pathlib import Path

import gmsh
import numpy as np
import numpy.typing as npt

from .check import hexahedron_type, integrated_volume_m3
from .geometry import MeshSpec

# Corners of a hexahedron that an edge joins, the same in gmsh and VTK.
_EDGES = np.array(
    [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]
)


@dataclass(frozen=True)
class MeshQuality:
    """Quality of one mesh; every field is a row of the table.

    `sicn` is gmsh's signed inverse condition number of the Jacobian (1: a cube, 0: degenerate; a
    long cell has a small one and may still be sound), `scaled_jacobian` the determinant over the
    product of the lengths of its columns (1: right-angled); of each the smallest value within a
    cell is taken.  Edges are measured straight from corner to corner; `aspect_ratio` is a cell's
    longest over its shortest.  `volume_error` is relative to the true body.
    """

    n_cells: int
    n_nodes: int
    sicn_min: float
    sicn_mean: float
    sicn_max: float
    scaled_jacobian_min: float
    scaled_jacobian_mean: float
    scaled_jacobian_max: float
    aspect_ratio_min: float
    aspect_ratio_mean: float
    aspect_ratio_max: float
    edge_length_min_m: float
    edge_length_mean_m: float
    edge_length_max_m: float
    volume_m3: float
    volume_error: float

    def rows(self) -> list[tuple[str, float, str]]:
        """Return (measure, value, unit) of each measure, the unit "1" where there is none."""
        units = {"m": "m", "m3": "m3"}
        return [
            (name, value, units.get(name.rsplit("_", 1)[-1], "1"))
            for name, value in asdict(self).items()
        ]


def measure_quality(spec: MeshSpec) -> MeshQuality:
    """Measure the mesh of `spec` that gmsh's current model holds."""
    kind = hexahedron_type(spec.geometry_order)
    cells, _ = gmsh.model.mesh.getElementsByType(kind)
    lengths = _edge_lengths_m(kind)
    volume, _ = integrated_volume_m3(spec.geometry_order)
    measures = {
        "sicn": gmsh.model.mesh.getElementQualities(cells, "minSICN"),
        "scaled_jacobian": gmsh.model.mesh.getElementQualities(cells, "minSJ"),
        "aspect_ratio": lengths.max(axis=1) / lengths.min(axis=1),
        "edge_length": lengths,
    }
    statistics = {
        f"{name}_{statistic.__name__}{'_m' if name == 'edge_length' else ''}": float(
            statistic(values)
        )
        for name, values in measures.items()
        for statistic in (np.min, np.mean, np.max)
    }
    return MeshQuality(
        n_cells=len(cells),
        n_nodes=len(gmsh.model.mesh.getNodes()[0]),
        volume_m3=volume,
        volume_error=volume / spec.volume_m3 - 1,
        **statistics,
    )


def _edge_lengths_m(kind: int) -> npt.NDArray[np.float64]:
    """Return the distances between the ends of the edges of all cells, m: shape (cells, 12)."""
    numbers, coordinates, _ = gmsh.model.mesh.getNodes()
    points = np.empty((len(numbers) + 1, 3))
    points[numbers] = coordinates.reshape(-1, 3)
    n_nodes = gmsh.model.mesh.getElementProperties(kind)[3]
    corners = gmsh.model.mesh.getElementsByType(kind)[1].reshape(-1, n_nodes)[:, :8]
    ends = points[corners[:, _EDGES]]
    return np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=-1)


def write_csv(quality: MeshQuality, path: Path) -> None:
    """Write the table as ``measure,value,unit``."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("measure", "value", "unit"))
        writer.writerows(quality.rows())
