"""Quality of a mesh's cells."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import gmsh
import numpy as np

from ...meshes.check import read_cells, volume_m3
from ...meshes.geometry import MeshSpec

UNITS = {"m": "m", "m3": "m3"}
"""Of measures, by the ends of their names; others have none."""


def measure_quality(spec: MeshSpec) -> dict[str, float]:
    """Measure the mesh of `spec` that gmsh's current model holds.

    Returns
    -------
    quality : `n_cells`, `n_nodes`, `volume_m3` and `volume_error`, relative to the true body; and
        the least, mean and greatest (`…_min`, `…_mean`, `…_max`) of `sicn`, gmsh's signed inverse
        condition number of the Jacobian (1: a cube, 0: degenerate; a long cell has a small one and
        may still be sound), of `scaled_jacobian`, the determinant over the product of the lengths
        of its columns (1: right-angled; of both the smallest value within a cell is taken), of
        `aspect_ratio`, a cell's longest over its shortest edge, and of `edge_length`, straight from
        corner to corner in m
    """
    cells = read_cells("the mesh")
    ends = cells.points[cells.edges]
    lengths = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=-1)
    volume = volume_m3("the mesh", cells)
    measures = {
        "sicn": gmsh.model.mesh.getElementQualities(cells.tags, "minSICN"),
        "scaled_jacobian": gmsh.model.mesh.getElementQualities(cells.tags, "minSJ"),
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
    return {
        "n_cells": len(cells.tags),
        "n_nodes": len(cells.points),
        **statistics,
        "volume_m3": volume,
        "volume_error": volume / spec.volume_m3 - 1,
    }


def write_csv(quality: Mapping[str, float], path: Path) -> None:
    """Write the table as ``measure,value,unit``, the unit "1" where there is none."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("measure", "value", "unit"))
        for name, value in quality.items():
            writer.writerow((name, value, UNITS.get(name.rsplit("_", 1)[-1], "1")))
