"""Checks of the mesh in gmsh's current model: that it is valid and matches its specification."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import gmsh
import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from .geometry import MeshSpec
from .section import Circle

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

VOLUME_TOLERANCE = 1e-12
"""Relative: the mesh of either section has a closed form, so that round-off alone is left."""
DEGREES = (1, 2, 3)
REFERENCE_VOLUME = {"tetrahedra": 1.0 / 6.0, "hexahedra": 8.0}


class MeshError(RuntimeError):
    """A mesh could not be made, or is not what was asked for."""


@dataclass(frozen=True, eq=False)
class Cells:
    """The cells of a mesh: their ``kind``, gmsh's number for it, the geometry's ``degree``.

    ``points`` (n, 3) are the positions of gmsh's nodes. ``corners`` (cells, 4 or 8) and ``used``
    (m,), all nodes of cells, are indices into them. ``tags`` (cells,) are gmsh's numbers of the
    cells.
    """

    kind: str
    gmsh_type: int
    degree: int
    tags: Index
    points: Array
    corners: Index
    used: Index

    @property
    def box_m(self) -> Array:
        """Lowest and highest coordinates (2, 3)."""
        own = self.points[self.used]
        return np.stack([own.min(axis=0), own.max(axis=0)])

    @cached_property
    def edges(self) -> Index:
        """The corners of every edge (cells, 6 or 12, 2); the model must be gmsh's current one."""
        nodes = gmsh.model.mesh.getElementEdgeNodes(self.gmsh_type, primary=True)
        return np.asarray(nodes.astype(np.int64).reshape(len(self.corners), -1, 2) - 1)

    @cached_property
    def faces(self) -> Index:
        """gmsh's numbers of every cell's faces (cells, 4 or 6); as `edges`."""
        gmsh.model.mesh.createFaces()
        size = 3 if self.kind == "tetrahedra" else 4
        nodes = gmsh.model.mesh.getElementFaceNodes(self.gmsh_type, size, primary=True)
        numbers, _ = gmsh.model.mesh.getFaces(size, nodes)
        return np.asarray(numbers.astype(np.int64).reshape(len(self.corners), -1))

    @property
    def counts(self) -> tuple[int, int, int, int]:
        """Corners, edges, faces and cells; as `edges`."""
        gmsh.model.mesh.createEdges()
        edges, _ = gmsh.model.mesh.getEdges(self.edges.ravel() + 1)
        corners, n_edges, faces = (len(np.unique(x)) for x in (self.corners, edges, self.faces))
        return corners, n_edges, faces, len(self.corners)


def read_cells(where: str) -> Cells:
    """The cells of gmsh's current model, which must be of one kind.

    Raises MeshError, whose message names ``where``.
    """
    kinds, tags, nodes = gmsh.model.mesh.getElements(3)
    names = [gmsh.model.mesh.getElementProperties(kind) for kind in kinds]
    if not len(kinds):
        raise MeshError(f"{where}: there are no volume cells; mesh the body in 3-D, and save all")
    families = [name.split()[0] for name, *_ in names]
    if len(kinds) > 1 or families[0] not in ("Tetrahedron", "Hexahedron"):
        found = " and ".join(
            f"{len(own)} of {name}" for (name, *_), own in zip(names, tags, strict=True)
        )
        raise MeshError(f"{where}: must have tetrahedra or hexahedra alone, not {found}")
    name, _, degree, size, _, n_corners = names[0]
    complete = (degree + 1) ** 3
    if families[0] == "Tetrahedron":
        complete = (degree + 1) * (degree + 2) * (degree + 3) // 6
    if degree not in DEGREES or size != complete:
        raise MeshError(
            f"{where}: cells of {name} cannot be read; take complete ones of order "
            f"{', '.join(map(str, DEGREES))} (in gmsh Mesh.SecondOrderIncomplete = 0)"
        )
    numbers, places, _ = gmsh.model.mesh.getNodes()
    if not np.array_equal(np.sort(numbers), np.arange(1, len(numbers) + 1)):
        raise MeshError(f"{where}: the nodes are not numbered from 1 without gaps")
    points = np.empty((len(numbers), 3))
    points[numbers.astype(np.int64) - 1] = places.reshape(-1, 3)
    kind = "tetrahedra" if families[0] == "Tetrahedron" else "hexahedra"
    of_cells = nodes[0].astype(np.int64).reshape(-1, size) - 1
    return Cells(
        kind=kind,
        gmsh_type=int(kinds[0]),
        degree=int(degree),
        tags=tags[0],
        points=points,
        corners=of_cells[:, :n_corners],
        used=np.unique(of_cells),
    )


def require_one_part(where: str, cells: Cells) -> None:
    """Raise MeshError, which names ``where``, unless the cells are connected by their faces."""
    faces = cells.faces
    first = np.arange(0, faces.size + 1, faces.shape[1])
    touching = csr_matrix((np.ones(faces.size), faces.ravel(), first))
    parts, _ = connected_components(touching @ touching.T, directed=False)
    if parts > 1:
        raise MeshError(
            f"{where}: the body is in {parts} parts whose cells share no face; fuse them, or merge "
            "nodes that stand at one place"
        )


def quadrature_m3(where: str, cells: Cells, degree: int) -> tuple[Array, Array]:
    """Volume (cells, q) in m³ at each point of the Gauss rule of a ``degree``; the points (cells,
    q, 3).

    MeshError, which names ``where``, if a cell is inverted, at these or between them (gmsh's
    bound).
    """
    points, weights = gmsh.model.mesh.getIntegrationPoints(cells.gmsh_type, f"Gauss{degree}")
    # gmsh's rules on tetrahedra have twelve digits
    weights *= REFERENCE_VOLUME[cells.kind] / math.fsum(weights)
    _, determinants, places = gmsh.model.mesh.getJacobians(cells.gmsh_type, points)
    per_cell = determinants.reshape(-1, len(weights))
    bound = np.asarray(gmsh.model.mesh.getElementQualities(cells.tags, "minDetJac"))
    inverted = np.flatnonzero(~(np.minimum(bound, per_cell.min(axis=1)) > 0.0))
    if len(inverted):
        raise MeshError(
            f"{where}: {len(inverted)} of {len(bound)} cells are turned inside out or flat, the "
            f"first at element {cells.tags[inverted[0]]}: their Jacobian is not positive"
        )
    return per_cell * weights, places.reshape(*per_cell.shape, 3)


def volume_m3(where: str, cells: Cells) -> float:
    """Volume of the cells; MeshError as `quadrature_m3`."""
    return math.fsum(quadrature_m3(where, cells, determinant_degree(cells.degree))[0].ravel())


def determinant_degree(geometry_order: int) -> int:
    """Return the degree per direction of a hexahedron's Jacobian determinant: 2 or 5.

    One of its three factors has the geometry's degree less one in that direction.
    """
    return 3 * geometry_order - 1


def wire_volume_ratio(spec: MeshSpec) -> float:
    """Return the volume of a wire's mesh over the true one, from the shape of its perimeter.

    The perimeter is made of 4 NX arcs of angle 2a, each replaced by its chord (order 1) or by the
    parabola through its ends and middle (order 2): the triangle under the chord has the area
    sin a cos a, the parabola's segment (Archimedes) 4/3 sin a (1 - cos a), a circle's sector a.
    """
    a = math.pi / spec.n_perimeter_cells
    area = math.sin(a) * math.cos(a)
    if spec.geometry_order == 2:
        area += 4 / 3 * math.sin(a) * (1 - math.cos(a))
    return area / a


def meshed_volume_m3(spec: MeshSpec) -> float:
    """Return the volume that the mesh of `spec` must have, m³: less than a round body's."""
    ratio = wire_volume_ratio(spec) if isinstance(spec.section, Circle) else 1.0
    return ratio * spec.volume_m3


def check_model(spec: MeshSpec) -> None:
    """Require that gmsh's current model holds the mesh of `spec`.

    Checked: every cell a hexahedron of the right order and their number; every facet a
    quadrilateral and their number per group; nodes numbered without gaps and none unused; positive
    Jacobian determinants; the volume. MeshError says which of these fails.
    """
    where = "the mesh that was made"
    cells = read_cells(where)
    if (cells.kind, cells.degree) != ("hexahedra", spec.geometry_order):
        found = f"{cells.kind} of order {cells.degree}"
        raise MeshError(
            f"{where}: must have hexahedra alone, of order {spec.geometry_order}, not {found}"
        )
    if len(cells.tags) != spec.n_cells:
        raise MeshError(f"{where}: has {len(cells.tags)} hexahedra instead of {spec.n_cells}")
    _check_facets(spec)
    if len(cells.used) != len(cells.points):
        unused = len(cells.points) - len(cells.used)
        raise MeshError(f"{where}: {unused} nodes belong to no cell")
    volume, expected = volume_m3(where, cells), meshed_volume_m3(spec)
    if not abs(volume / expected - 1) <= VOLUME_TOLERANCE:
        raise MeshError(f"{where}: its volume is {volume:.15g} m³ instead of {expected:.15g} m³")


def _check_facets(spec: MeshSpec) -> None:
    expected = gmsh.model.mesh.getElementType("Quadrangle", spec.geometry_order)
    for tag, n_facets in spec.n_facets.items():
        found = 0
        for face in gmsh.model.getEntitiesForPhysicalGroup(2, tag):
            kinds, facets, _ = gmsh.model.mesh.getElements(2, face)
            if list(kinds) != [expected]:
                raise MeshError(f"The {tag.name.lower()} must have quadrilaterals alone.")
            found += len(facets[0])
        if found != n_facets:
            raise MeshError(f"The {tag.name.lower()} has {found} facets instead of {n_facets}.")
