"""A bristle on a user's own mesh: gmsh's tetrahedra or hexahedra, checked and measured."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import permutations, product
from pathlib import Path

import gmsh
import numpy as np
import numpy.typing as npt

from .check import Cells, Index, MeshError, quadrature_m3, read_cells, require_one_part
from .geometry import Tag
from .hexahedra import gmsh_model
from .section import Rectangle

Array = npt.NDArray[np.float64]

HEADER = b"$MeshFormat"
LONGEST_M, SHORTEST_M = 10.0, 1e-4
# Least extent along z over the longest side of the mesh's box; with less, z is not the axis.
SLENDER = 0.5
# Largest products of inertia, over the largest moment, at which the file's axes are principal.
PRINCIPAL = 1e-6
# Offset of the centre of mass and height of the tip, over the tip's size, that count as none.
STRAIGHT = 1e-6
# The physical group of the facets that may touch.
TIP = "tip"
# A facet whose unit normal points less than this downward faces sideways or up.
DOWNWARD = 1e-3
# Largest height of a tip above the body's lowest point, over the body's height.
LOWEST = 1e-6


@dataclass(frozen=True, eq=False)
class OwnMesh:
    """Measures of the body in a mesh file, in the axes of the file.

    ``counts`` are its corners, edges, faces and cells; ``cell`` names their kind, ``degree`` is
    that of their geometry. ``second_moments_m5`` (3, 3) are the integrals of x xᵀ about the centre
    of volume ``centre_m`` (3,). ``box_m`` and ``tip_box_m`` (2, 3) are the lowest and highest
    coordinates of the body and of the tip, ``tip_centre_m`` (3,) is the tip's centre of area.
    """

    path: Path
    sha256: str
    cell: str
    degree: int
    counts: tuple[int, int, int, int]
    n_tip_facets: int
    volume_m3: float
    centre_m: Array
    second_moments_m5: Array
    box_m: Array
    tip_box_m: Array
    tip_centre_m: Array

    @property
    def length_m(self) -> float:
        """Extent along z."""
        return float(self.box_m[1, 2] - self.box_m[0, 2])

    @cached_property
    def tip_section(self) -> Rectangle:
        """The rectangle around the tip's face."""
        thin, wide, _ = self.tip_box_m[1] - self.tip_box_m[0]
        return Rectangle(float(thin), float(wide))

    @property
    def mean_section(self) -> Rectangle:
        """As `tip_section`, but with the area that follows from volume and length."""
        tip = self.tip_section
        scale = math.sqrt(self.volume_m3 / self.length_m / tip.area_m2)
        return Rectangle(scale * tip.thickness_m, scale * tip.width_m)

    @cached_property
    def axes(self) -> Array:
        """The principal axes as columns (3, 3), each the nearest to the file's x, y, z.

        They are the file's own axes if these are principal.
        """
        moments = self.second_moments_m5
        inertia = np.trace(moments) * np.eye(3) - moments
        products = inertia - np.diag(np.diag(inertia))
        if np.abs(products).max() <= PRINCIPAL * inertia.max():
            return np.eye(3)
        found = np.linalg.eigh(moments)[1]
        turned = (
            found[:, order] * signs
            for order in permutations(range(3))
            for signs in product((1.0, -1.0), repeat=3)
        )
        proper = [axes for axes in turned if np.linalg.det(axes) > 0.0]
        return np.asarray(max(proper, key=np.trace))

    @property
    def straight(self) -> bool:
        """Whether an impact on the tip from below loads the body along its axis alone.

        It does if the axes are principal, the centre is above the tip's, and the tip is flat.
        """
        small = STRAIGHT * max(self.tip_section.thickness_m, self.tip_section.width_m)
        beside = np.abs(self.centre_m - self.tip_centre_m)[:2].max()
        flat = self.tip_box_m[1, 2] - self.tip_box_m[0, 2]
        return bool(np.array_equal(self.axes, np.eye(3)) and max(beside, flat) <= small)

    def n_nodes(self, order: int) -> int:
        """Nodes of Lagrange elements of the first or second order."""
        corners, edges, faces, cells = self.counts
        if order == 1:
            return corners
        return corners + edges + (faces + cells if self.cell == "hexahedra" else 0)


def digest(path: Path) -> str:
    """SHA-256 of a mesh file. Raises MeshError if it cannot be read."""
    try:
        return _digest(path, path.stat().st_mtime_ns, path.stat().st_size)
    except OSError as error:
        raise MeshError(f"{path}: {error.strerror or error}") from error


@lru_cache
def _digest(path: Path, modified_ns: int, size: int) -> str:
    data = path.read_bytes()
    if not data.lstrip().startswith(HEADER):
        raise MeshError(f"{path} is not a mesh of gmsh: it does not begin with {HEADER.decode()}")
    return hashlib.sha256(data).hexdigest()


@lru_cache
def own_mesh(path: Path, sha256: str) -> OwnMesh:
    """Read, check and measure the mesh in ``path``, whose digest is ``sha256``.

    Raises MeshError with one line that says why the file is not a mesh of a bristle.
    """
    with opened(path, sha256):
        cells = read_cells(str(path))
        require_one_part(str(path), cells)
        n_facets, tip_box, tip_centre = _checked_tip(path, cells)
        volume, centre, second = _moments(path, cells)
        _check_size(path, cells.box_m)
        counts = cells.counts
    return OwnMesh(
        path=path,
        sha256=sha256,
        cell=cells.kind,
        degree=cells.degree,
        counts=counts,
        n_tip_facets=n_facets,
        volume_m3=volume,
        centre_m=centre,
        second_moments_m5=second,
        box_m=cells.box_m,
        tip_box_m=tip_box,
        tip_centre_m=tip_centre,
    )


@contextmanager
def opened(path: Path, sha256: str) -> Iterator[None]:
    """The mesh in gmsh's current model, nodes numbered without gaps. Raises MeshError."""
    if digest(path) != sha256:
        raise MeshError(f"{path} changed while it was in use")
    with gmsh_model():
        try:
            gmsh.merge(str(path))
            gmsh.model.mesh.renumberNodes()
        except Exception as error:  # gmsh raises a bare Exception
            raise MeshError(f"{path}: gmsh cannot read it: {error}") from error
        yield


def regroup() -> None:
    """Put all volumes into one physical group and the tip into another, and remove the others."""
    tip = gmsh.model.getEntitiesForPhysicalName(TIP)
    gmsh.model.removePhysicalGroups()
    volumes = [tag for _, tag in gmsh.model.getEntities(3)]
    gmsh.model.addPhysicalGroup(3, volumes, int(Tag.BODY))
    gmsh.model.addPhysicalGroup(2, [tag for dim, tag in tip if dim == 2], int(Tag.TIP))


def _moments(path: Path, cells: Cells) -> tuple[float, Array, Array]:
    """Volume, centre and second moments about it; MeshError if a cell is inverted."""
    volumes, places = quadrature_m3(str(path), cells, 5 * cells.degree - 1)
    parts: Array = volumes.ravel()
    x: Array = places.reshape(-1, 3)
    volume = math.fsum(parts)
    centre: Array = np.asarray(parts @ x / volume)
    x = x - centre
    return volume, centre, (x * parts[:, None]).T @ x


def _check_size(path: Path, box: Array) -> None:
    sides = box[1] - box[0]
    largest = float(sides.max())
    if not SHORTEST_M <= largest <= LONGEST_M:
        unit = "; were they in mm?" if largest > LONGEST_M else ""
        raise MeshError(
            f"{path}: the body is {largest:.4g} m long, where {SHORTEST_M:g} to {LONGEST_M:g} m "
            f"make sense; coordinates are taken in metres{unit}"
        )
    if sides[2] < SLENDER * largest:
        axis = "xyz"[int(np.argmax(sides))]
        raise MeshError(
            f"{path}: the body is longest along {axis} ({largest:.4g} m) and {sides[2]:.4g} m "
            "along z, which must be the bristle's axis"
        )


def _checked_tip(path: Path, cells: Cells) -> tuple[int, Array, Array]:
    """Number of facets in the physical group `TIP`, the lowest and highest coordinates of their
    nodes (2, 3), and their centre of area (3,).

    The facets must be on the boundary, at its lower end, and face down. Otherwise raises MeshError
    with the names of the file and of the group.
    """
    where = f"{path}: the physical group '{TIP}'"
    facets, numbers = _tip_facets(path, where)
    nodes = cells.points[numbers]
    faces = cells.faces
    ours, _ = gmsh.model.mesh.getFaces(facets.shape[1], facets.ravel() + 1)
    count = np.bincount(faces.ravel(), minlength=int(ours.max()) + 1)
    stray = count[ours] == 0
    if stray.any():
        raise MeshError(f"{where} has {stray.sum()} facets that are on no cell of the body")
    inside = count[ours] > 1
    if inside.any():
        raise MeshError(f"{where} has {inside.sum()} facets inside the body, not on its boundary")
    low, high = cells.box_m[:, 2]
    begins = nodes[:, 2].min()
    if begins > low + LOWEST * (high - low):
        raise MeshError(
            f"{where} begins at z = {begins:.6g} m, but the body reaches down to {low:.6g} m: it "
            "must be the lower end, with z pointing up"
        )
    owner = np.empty(len(count), dtype=np.int64)
    owner[faces] = np.arange(len(faces))[:, None]
    x = cells.points[facets]
    middle = x.mean(axis=1)
    normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    if x.shape[1] == 4:
        normal = np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1])
    into = cells.points[cells.corners[owner[ours]]].mean(axis=1) - middle
    normal *= -np.sign(np.einsum("ij,ij->i", normal, into))[:, None]
    area = np.linalg.norm(normal, axis=1)
    sideways = ~(-normal[:, 2] > DOWNWARD * area)
    if sideways.any():
        raise MeshError(
            f"{where} has {sideways.sum()} of {len(area)} facets that face sideways or up; it is "
            "for those of the lower end that may touch"
        )
    box = np.stack([nodes.min(axis=0), nodes.max(axis=0)])
    return len(area), box, area @ middle / area.sum()


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
