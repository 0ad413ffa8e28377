"""`bristle mesh`: the mesh's files, and what is measured of it."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import gmsh
from mpi4py import MPI

from ...meshes.check import check_model
from ...meshes.collective import run_on_one_rank
from ...meshes.geometry import MeshSpec
from ...meshes.hexahedra import build_model, gmsh_model
from ..running.files import filled, new_folders, prepare_folder
from .convert import write_vtu
from .picture import write_picture
from .quality import measure_quality, write_csv

# All that it writes.
FILES = ("bristle.msh", "bristle.vtu", "quality.csv", "mesh.png")


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
    MeshError : gmsh failed or the mesh is not what was asked for
    DrawingError : the picture could not be drawn
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
    with gmsh_model():
        build_model(spec)
        check_model(spec)
        quality = measure_quality(spec)
        gmsh.write(str(msh))
    write_vtu(msh, vtu)
    write_csv(quality, table)
    write_picture(vtu, shown)
    return quality
