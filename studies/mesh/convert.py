"""Conversion of meshes from gmsh to other programs.

meshio carries a `.msh` file over to `.vtu`, which ParaView opens with second-order cells kept
(27-node hexahedra and 9-node quadrilaterals, VTK's tri- and biquadratic cells).  There is no XDMF:
ParaView's readers crash on it or show nothing where the cells are of second order.
"""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np

from ...meshes.geometry import Tag

TAG_DATA = "tag"
"""Name of the cell data that hold the values of `Tag`."""


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
