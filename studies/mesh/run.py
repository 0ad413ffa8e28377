"""`bristle mesh`: the mesh's files, and what is measured of it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import gmsh
import numpy as np
from mpi4py import MPI

from ...meshes.check import MeshError, check_model, read_cells, volume_m3
from ...meshes.collective import run_on_one_rank
from ...meshes.geometry import MeshSpec
from ...meshes.hexahedra import build_model, gmsh_model
from ...solver.errors import ComputationError
from ..running.files import filled, new_folders, prepare_folder, to_csv
from .picture import write_picture, write_vtu

# All that it writes.
FILES = ("bristle.msh", "bristle.vtu", "quality.csv", "mesh.png")
UNITS = {"m": "m", "m3": "m3"}
"""Of measures, by the ends of their names; others have none."""


def run_mesh(spec: MeshSpec, out: Path, comm: MPI.Intracomm = MPI.COMM_WORLD) -> dict[str, Any]:
    """Mesh a bristle and write ``bristle.msh``, ``bristle.vtu``, ``quality.csv``, ``mesh.png``.

    Rank 0 does it while the others wait; collective over `comm`.  The files take their places
    together when all four are there, so that a failure leaves what was there before.

    The folder `out` is made where it is missing.

    Returns
    -------
    summary : `spec` (SI), `files` (name: path), `quality` (`measure_quality`), `wall_s`; plain
        numbers, strings, lists and dicts alone; the same on every rank

    Raises
    ------
    ComputationError : gmsh failed, or the mesh is not what was asked for
    InputError : `out` cannot be written, or has files of these names that are not the program's
    """
    return run_on_one_rank(comm, lambda: _write_all(spec, Path(out)))


def _write_all(spec: MeshSpec, out: Path) -> dict[str, Any]:
    started = time.perf_counter()
    with new_folders(out):
        prepare_folder(out, *FILES)
        with filled(out) as folder:
            quality = _make(spec, *(folder / name for name in FILES))
    return {
        "spec": {**asdict(spec), "cells": list(spec.cells), "shape": type(spec.section).__name__},
        "files": {name: str(out / name) for name in FILES},
        "quality": quality,
        "wall_s": time.perf_counter() - started,
    }


def _make(spec: MeshSpec, msh: Path, vtu: Path, table: Path, shown: Path) -> dict[str, float]:
    try:
        with gmsh_model():
            build_model(spec)
            check_model(spec)
            quality = measure_quality(spec)
            gmsh.write(str(msh))
    except MeshError as error:
        raise ComputationError(str(error)) from error
    write_vtu(msh, vtu)
    write_csv(quality, table)
    write_picture(vtu, shown)
    return quality


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
    units = (UNITS.get(name.rsplit("_", 1)[-1], "1") for name in quality)
    rows = zip(quality, quality.values(), units, strict=True)
    path.write_text(to_csv(("measure", "value", "unit"), rows), newline="")
