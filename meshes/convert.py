"""Conversion of meshes from gmsh to other programs, and back.

meshio carries a `.msh` file over to `.vtu`, which ParaView opens with second-order cells kept
(27-node hexahedra and 9-node quadrilaterals, VTK's tri- and biquadratic cells).  There is no XDMF:
ParaView's readers crash on it or show nothing where the cells are of second order.
"""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import gmsh
import meshio
import numpy as np

from .geometry import Tag

TAG_DATA = "tag"
"""Name of the cell data that hold the values of `Tag`."""

_DIMENSIONS = {"hexahedron": 3, "hexahedron27": 3, "quad": 2, "quad9": 2}


def write_msh(path: Path) -> None:
    """Write gmsh's current model as MSH 4.1, text, with its physical groups."""
    gmsh.write(str(path))


def read_msh(path: Path) -> meshio.Mesh:
    """Read a bristle's `.msh` file.

    Returns
    -------
    mesh : points in m; a block of hexahedra and a block of surface quadrilaterals in VTK's node
        order; cell data `TAG_DATA`; cell sets ``body``, ``tip``, ``top``, ``side``

    Raises
    ------
    ValueError : the file is not a mesh of a bristle
    """
    mesh = _read(path, meshio.gmsh)
    if "gmsh:physical" not in mesh.cell_data:
        raise ValueError(f"{path}: the mesh has no physical groups.")
    return _with_tags(path, mesh, mesh.cell_data["gmsh:physical"])


def write_vtu(mesh: meshio.Mesh, path: Path) -> None:
    """Write a mesh from `read_msh` for ParaView.

    Beside `TAG_DATA` each cell set becomes cell data of its name, 1 inside and 0 outside, because
    VTK has no cell sets.
    """
    data = dict(mesh.cell_data)
    for name, members in mesh.cell_sets.items():
        data[name] = [
            np.isin(np.arange(len(block)), inside).astype(np.int32)
            for block, inside in zip(mesh.cells, members, strict=True)
        ]
    meshio.write(path, meshio.Mesh(mesh.points, mesh.cells, cell_data=data), file_format="vtu")


def read_vtu(path: Path) -> meshio.Mesh:
    """Read a file from `write_vtu`; the same mesh as from `read_msh`.

    Raises
    ------
    ValueError : the file is not a mesh of a bristle
    """
    mesh = _read(path, meshio.vtu)
    if TAG_DATA not in mesh.cell_data:
        raise ValueError(f"{path}: the mesh has no cell data '{TAG_DATA}'.")
    return _with_tags(path, mesh, mesh.cell_data[TAG_DATA])


def _read(path: Path, reader: ModuleType) -> meshio.Mesh:
    # The format's own reader: meshio.read prints, and exits the process, where it fails.
    try:
        return reader.read(path)
    except OSError:
        raise
    except Exception as error:  # of many kinds, according to where the file is broken
        reason = str(error) or type(error).__name__
        raise ValueError(f"{path} is not a mesh that meshio can read: {reason}") from error


def _with_tags(path: Path, mesh: meshio.Mesh, tags: list[np.ndarray]) -> meshio.Mesh:
    """Join the blocks of each cell type, and name the sets after the tags."""
    kinds = sorted({block.type for block in mesh.cells}, key=lambda k: -_DIMENSIONS.get(k, 0))
    if len(kinds) != 2 or [_DIMENSIONS.get(kind) for kind in kinds] != [3, 2]:
        raise ValueError(f"{path}: expected hexahedra and quadrilaterals, found {kinds}.")
    cells, values = [], []
    for kind in kinds:
        of_kind = [i for i, block in enumerate(mesh.cells) if block.type == kind]
        cells.append((kind, np.concatenate([mesh.cells[i].data for i in of_kind])))
        values.append(np.concatenate([tags[i] for i in of_kind]).astype(np.int32))
    sets = {tag.name.lower(): [np.flatnonzero(v == tag) for v in values] for tag in Tag}
    return meshio.Mesh(mesh.points, cells, cell_data={TAG_DATA: values}, cell_sets=sets)
