"""Checks of a user's mesh in gmsh's current model: one kind of cells, one part, a fit tip."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import gmsh
import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from .check import MeshError

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

TIP = "tip"
DEGREES = (1, 2, 3)
# Corners of edges and faces of a cell, in gmsh's order.
EDGES = {
    "tetrahedra": ((0, 1), (1, 2), (2, 0), (3, 0), (3, 2), (3, 1)),
    "hexahedra": (
        *((0, 1), (0, 3), (0, 4), (1, 2), (1, 5), (2, 3)),
        *((2, 6), (3, 7), (4, 5), (4, 7), (5, 6), (6, 7)),
    ),
}
FACES = {
    "tetrahedra": ((0, 2, 1), (0, 1, 3), (0, 3, 2), (3, 1, 2)),
    "hexahedra": (
        *((0, 3, 2, 1), (0, 1, 5, 4), (0, 4, 7, 3)),
        *((1, 2, 6, 5), (2, 3, 7, 6), (4, 5, 6, 7)),
    ),
}
# Of a facet's unit normal: less than this downward, and it faces sideways or up.
DOWNWARD = 1e-3
# Of the body's height: how far above its lowest point a tip may begin.
LOWEST = 1e-6


@dataclass(frozen=True, eq=False)
class Cells:
    """The cells of a mesh: their ``kind``, gmsh's number for it, the geometry's ``degree``.

    ``points`` (n, 3) are the places of gmsh's nodes, ``corners`` (cells, 4 or 8) index them, so do
    ``used`` (m,), all nodes of cells; ``tags`` (cells,) are gmsh's numbers of the cells.
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
    def face_keys(self) -> tuple[Index, Index, Index]:
        """Keys of the mesh's faces, rising, and the faces of all cells (6 or 4 a cell), by number;
        of how many cells each is."""
        keys = self.keys(self.corners[:, FACES[self.kind]].reshape(-1, len(FACES[self.kind][0])))
        found, index, count = np.unique(keys, return_inverse=True, return_counts=True)
        return found, index.reshape(-1), count

    @property
    def counts(self) -> tuple[int, int, int, int]:
        """Corners, edges, faces and cells."""
        edges = np.unique(self.keys(self.corners[:, EDGES[self.kind]].reshape(-1, 2)))
        corners = np.unique(self.corners)
        return len(corners), len(edges), len(self.face_keys[0]), len(self.corners)

    def keys(self, nodes: Index) -> Index:
        """A number for each edge or face (k, 2 to 4), the same in whatever order its nodes are.

        Three nodes make a face, of a quadrilateral the three that are numbered lowest.
        """
        nodes, n = np.sort(nodes, axis=1), len(self.points)
        key = nodes[:, 0] * n + nodes[:, 1]
        if nodes.shape[1] == 2:
            return np.asarray(key)
        if n < 2_000_000:
            return np.asarray(key * n + nodes[:, 2])
        raise MeshError(f"the mesh has {n:,} nodes, too many")


@dataclass(frozen=True, eq=False)
class TipFace:
    """The facets of the tip: how many, the lowest and highest coordinates of their nodes (2, 3),
    and their centre of area (3,)."""

    n_facets: int
    box_m: Array
    centre_m: Array


def read_cells(path: Path) -> Cells:
    """The cells of gmsh's current model, which must be of one kind and hang together.

    Raises MeshError with the name of the file.
    """
    kinds, tags, nodes = gmsh.model.mesh.getElements(3)
    names = [gmsh.model.mesh.getElementProperties(kind) for kind in kinds]
    if not len(kinds):
        raise MeshError(f"{path}: there are no volume cells; mesh the body in 3-D, and save all")
    families = [name.split()[0] for name, *_ in names]
    if len(kinds) > 1 or families[0] not in ("Tetrahedron", "Hexahedron"):
        found = " and ".join(
            f"{len(own)} of {name}" for (name, *_), own in zip(names, tags, strict=True)
        )
        raise MeshError(f"{path}: must have tetrahedra or hexahedra alone, not {found}")
    name, _, degree, size, _, n_corners = names[0]
    complete = (degree + 1) ** 3
    if families[0] == "Tetrahedron":
        complete = (degree + 1) * (degree + 2) * (degree + 3) // 6
    if degree not in DEGREES or size != complete:
        raise MeshError(
            f"{path}: cells of {name} cannot be read; take complete ones of order "
            f"{', '.join(map(str, DEGREES))} (in gmsh Mesh.SecondOrderIncomplete = 0)"
        )
    numbers, places, _ = gmsh.model.mesh.getNodes()
    points = np.empty((len(numbers), 3))
    points[numbers.astype(np.int64) - 1] = places.reshape(-1, 3)
    kind = "tetrahedra" if families[0] == "Tetrahedron" else "hexahedra"
    of_cells = nodes[0].astype(np.int64).reshape(-1, size) - 1
    cells = Cells(
        kind=kind,
        gmsh_type=int(kinds[0]),
        degree=int(degree),
        tags=tags[0],
        points=points,
        corners=of_cells[:, :n_corners],
        used=np.unique(of_cells),
    )
    _check_parts(path, cells)
    return cells


def _check_parts(path: Path, cells: Cells) -> None:
    found, faces, _ = cells.face_keys
    n = len(cells.corners)
    first = np.arange(0, len(faces) + 1, len(faces) // n)
    touching = csr_matrix((np.ones(len(faces)), faces, first), shape=(n, len(found)))
    parts, _ = connected_components(touching @ touching.T, directed=False)
    if parts > 1:
        raise MeshError(
            f"{path}: the body is in {parts} parts whose cells share no face; fuse them, or merge "
            "nodes that stand at one place"
        )


def checked_tip(path: Path, cells: Cells) -> TipFace:
    """The facets in the physical group `TIP`: of the boundary, at its lower end, facing down.

    Raises MeshError with the name of the file and of the group.
    """
    where = f"{path}: the physical group '{TIP}'"
    facets, numbers = _tip_facets(path, where)
    nodes = cells.points[numbers]
    found, of_cells, count = cells.face_keys
    keys = cells.keys(facets)
    place = np.minimum(np.searchsorted(found, keys), len(found) - 1)
    ours = found[place] == keys
    if not ours.all():
        raise MeshError(f"{where} has {(~ours).sum()} facets that are on no cell of the body")
    inside = count[place] > 1
    if inside.any():
        raise MeshError(f"{where} has {inside.sum()} facets inside the body, not on its boundary")
    low, high = cells.box_m[:, 2]
    begins = nodes[:, 2].min()
    if begins > low + LOWEST * (high - low):
        raise MeshError(
            f"{where} begins at z = {begins:.6g} m, but the body reaches down to {low:.6g} m: it "
            "must be the lower end, with z pointing up"
        )
    owner = np.empty(len(found), dtype=np.int64)
    owner[of_cells] = np.arange(len(of_cells)) // len(FACES[cells.kind])
    x = cells.points[facets]
    middle = x.mean(axis=1)
    normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    if x.shape[1] == 4:
        normal = np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1])
    into = cells.points[cells.corners[owner[place]]].mean(axis=1) - middle
    normal *= -np.sign(np.einsum("ij,ij->i", normal, into))[:, None]
    area = np.linalg.norm(normal, axis=1)
    sideways = ~(-normal[:, 2] > DOWNWARD * area)
    if sideways.any():
        raise MeshError(
            f"{where} has {sideways.sum()} of {len(area)} facets that face sideways or up; it is "
            "for those of the lower end that may touch"
        )
    box = np.stack([nodes.min(axis=0), nodes.max(axis=0)])
    return TipFace(len(area), box, area @ middle / area.sum())


def _tip_facets(path: Path, where: str) -> tuple[Index, Index]:
    """The corners of the tip's facets (k, 3 or 4), and all its nodes, from 0."""
    groups = gmsh.model.getPhysicalGroups()
    names = {group: gmsh.model.getPhysicalName(*group) for group in groups}
    of_tip = [dim for (dim, _), name in names.items() if name == TIP]
    if of_tip != [2]:
        if of_tip:
            raise MeshError(f"{where} must be of surfaces, not of dimension {of_tip[-1]}")
        others = ", ".join(f"'{name}'" for name in names.values() if name) or "none with a name"
        raise MeshError(
            f"{path}: there is no physical group '{TIP}' of the facets that may touch; its groups: "
            f"{others}"
        )
    corners: list[Index] = []
    nodes: list[Index] = []
    for _, entity in gmsh.model.getEntitiesForPhysicalName(TIP):
        for kind, _, own in zip(*gmsh.model.mesh.getElements(2, entity), strict=True):
            _, _, _, size, _, n_corners = gmsh.model.mesh.getElementProperties(kind)
            own = own.astype(np.int64).reshape(-1, size) - 1
            corners.append(own[:, :n_corners])
            nodes.append(np.unique(own))
    if not corners or len({part.shape[1] for part in corners}) > 1:
        raise MeshError(f"{where} has {'facets of several kinds' if corners else 'no facets'}")
    return np.concatenate(corners), np.unique(np.concatenate(nodes))
