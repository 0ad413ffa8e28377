"""A short solid to write fields of, and its files read back with adios2 alone."""

from __future__ import annotations

import csv
from pathlib import Path

import adios2
import numpy as np
from mpi4py import MPI

from bristle.meshes.distribute import to_dolfinx
from bristle.meshes.geometry import MeshSpec, Tag
from bristle.solver.bodies.solid import SolidBody
from bristle.solver.bristle import Material

COMM = MPI.COMM_WORLD
LENGTH_M = 0.02
MATERIAL = Material(beta_s=1e-8)


def solid_of(order=2, comm=COMM, **spec):
    mesh, _, facets = to_dolfinx(MeshSpec(LENGTH_M, **{"cells": (1, 2, 12), **spec}), comm)
    return SolidBody(mesh, facets, int(Tag.TIP), MATERIAL, order)


def blocks_of(file, name: str, step: int) -> list[np.ndarray]:
    """What each rank wrote, those left out that wrote nothing."""
    first = 0 if name in ("geometry", "connectivity") else step
    counts = [block["Count"] for block in file.engine.blocks_info(name, first)]
    return [
        file.read(name, step_selection=[first, 1], block_id=number)
        for number, count in enumerate(counts)
        if not count.startswith("0,")
    ]


def written(path: Path, name: str, step: int) -> dict[str, np.ndarray]:
    """Nodes, cells and a field of all blocks of a file, as a reader of one rank sees them."""
    with adios2.FileReader(str(path)) as file:
        cells = blocks_of(file, "connectivity", step)
        return {
            "nodes": np.concatenate(blocks_of(file, "geometry", step)),
            "values": np.concatenate(blocks_of(file, name, step)),
            "n_cells": sum(len(block) for block in cells),
            "nodes_per_cell": {int(n) for block in cells for n in block[:, 0]},
            "type": file.read("types").item(),
        }


def times_of(path: Path) -> list[float]:
    with adios2.FileReader(str(path)) as file:
        return [
            float(np.ravel(file.read("step", step_selection=[k, 1]))[0])
            for k in range(file.num_steps())
        ]


def phases(folder):
    with (folder / "frames.csv").open() as table:
        return [(float(row["t_s"]), row["phase"]) for row in csv.DictReader(table)]
