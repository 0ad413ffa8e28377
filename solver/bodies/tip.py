"""Where a solid's tip can touch: the points of its facets, as rows over the unknowns."""

from __future__ import annotations

from dataclasses import dataclass

import basix
import numpy as np
from dolfinx import fem
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from ..bristle import CONTACT_POINTS, Material, gauss_lobatto
from ..errors import ComputationError
from .base import Array, ContactPoints

SAME_POINT_M = 1e-9
ALIGNED = 1e-9


@dataclass(frozen=True)
class FacetPoint:
    """One facet's view of a point: its place and its area; the face's nodes and their shares of its
    displacement; and rows (3, m) of the traction over the cell's unknowns."""

    xy_m: Array
    area_m2: float
    nodes: NDArray[np.int64]
    shares: Array
    column: NDArray[np.int64]
    traction_Pa: Array


def tip_contact(
    space: fem.FunctionSpace,
    facets: NDArray[np.int32],
    material: Material,
    centre_m: Array,
    points: int = CONTACT_POINTS,
) -> ContactPoints:
    """Contact points of the tip: Gauss-Lobatto points of its facets, shared ones merged.

    There are at least ``points`` across each side of the section, and the nodes of the face are
    among them, its edge and corners too. Where cells share a point, the traction is their mean,
    weighted by area. ``centre_m`` (3,) is the centre of mass. Collective; raises ComputationError
    where no rank has a facet of the tip.
    """
    comm = space.mesh.comm
    own = _owned_facets(space, facets)
    counts = _points_along(space, own, points)
    found = [
        point
        for part in comm.allgather(
            [
                point
                for facet, count in zip(own, counts, strict=True)
                for point in _points_of(space, facet, count, material)
            ]
        )
        for point in part
    ]
    if not found:
        raise ComputationError("no facet of the mesh carries the tip's tag")
    keys = np.round([point.xy_m / SAME_POINT_M for point in found]).astype(np.int64)
    unique, first, index = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    index = index.ravel()
    shares = np.array([point.area_m2 for point in found])
    areas = np.bincount(index, weights=shares)
    total = areas.sum()
    shares = shares / areas[index] * total
    nodes = np.unique(np.concatenate([point.nodes for point in found]))
    support, shapes = _shapes([found[i] for i in first], nodes)
    return ContactPoints(
        coordinates=_node_rows(space, nodes),
        support=support,
        shapes=shapes,
        traction=_traction_rows(space, found, index, shares),
        weights=areas / total,
        places_m=np.column_stack([unique * SAME_POINT_M, np.zeros(len(unique))]) - centre_m,
        comm=comm,
    )


def _shapes(found: list[FacetPoint], nodes: NDArray[np.int64]) -> tuple[NDArray[np.int64], Array]:
    """Support (n, s) and shapes (n, 3, s) of points over three coordinates per node."""
    width = max(len(point.nodes) for point in found)
    support = np.zeros((len(found), 3 * width), dtype=np.int64)
    shapes = np.zeros((len(found), 3, 3 * width))
    for i, point in enumerate(found):
        for a, (node, share) in enumerate(zip(point.nodes, point.shares, strict=True)):
            for axis in range(3):
                support[i, 3 * a + axis] = 3 * np.searchsorted(nodes, node) + axis
                shapes[i, axis, 3 * a + axis] = share
    return support, shapes


def _local_columns(space: fem.FunctionSpace) -> tuple[int, int]:
    """First and last global unknown of this rank."""
    block = space.dofmap.index_map_bs
    first, last = space.dofmap.index_map.local_range
    return block * first, block * last


def _node_rows(space: fem.FunctionSpace, nodes: NDArray[np.int64]) -> csr_matrix:
    """The displacements of ``nodes`` as rows over this rank's unknowns."""
    first, last = _local_columns(space)
    column = (3 * nodes[:, None] + np.arange(3)).ravel()
    row = np.arange(len(column))
    keep = (column >= first) & (column < last)
    shape = (len(column), last - first)
    return csr_matrix((np.ones(keep.sum()), (row[keep], column[keep] - first)), shape)


def _traction_rows(
    space: fem.FunctionSpace, found: list[FacetPoint], index: NDArray[np.intp], shares: Array
) -> csr_matrix:
    """Rows of traction, summed by ``shares`` per point and axis (3 n, unknowns of this rank)."""
    first, last = _local_columns(space)
    row = np.concatenate(
        [np.repeat(3 * i + np.arange(3), len(p.column)) for p, i in zip(found, index, strict=True)]
    )
    column = np.concatenate([np.tile(p.column, 3) for p in found])
    value = np.concatenate(
        [(s * p.traction_Pa).ravel() for p, s in zip(found, shares, strict=True)]
    )
    keep = (column >= first) & (column < last) & (value != 0.0)
    shape = (3 * (int(index.max()) + 1), last - first)
    return csr_matrix((value[keep], (row[keep], column[keep] - first)), shape)


@dataclass(frozen=True)
class _Facet:
    """A facet of an owned cell: its number in it, reference corner and tangents, and extents."""

    cell: int
    corner: Array
    tangents: Array
    sides_m: Array
    corners_m: Array


def _owned_facets(space: fem.FunctionSpace, facets: NDArray[np.int32]) -> list[_Facet]:
    """This rank's share of ``facets``."""
    domain = space.mesh
    tdim = domain.topology.dim
    domain.topology.create_connectivity(tdim - 1, tdim)
    domain.topology.create_connectivity(tdim, tdim - 1)
    cells_of = domain.topology.connectivity(tdim - 1, tdim)
    facets_of = domain.topology.connectivity(tdim, tdim - 1)
    owned = domain.topology.index_map(tdim).size_local
    vertices = np.asarray(basix.geometry(basix.CellType.hexahedron), dtype=float)
    sides = basix.topology(basix.CellType.hexahedron)[2]
    own = []
    for facet in facets:
        cell = int(cells_of.links(facet)[0])
        if cell < owned:
            local = int(np.flatnonzero(facets_of.links(cell) == facet)[0])
            corner = vertices[sides[local]]
            tangents = np.stack([corner[1] - corner[0], corner[2] - corner[0]])
            shapes = np.asarray(_coordinate(space).tabulate(0, corner), dtype=float)[0, ..., 0]
            places = shapes @ domain.geometry.x[domain.geometry.dofmap[cell]]
            along = np.stack([places[1] - places[0], places[2] - places[0]])
            own.append(_Facet(cell, corner[0], tangents, along[:, :2], places[:, :2]))
    return own


def _coordinate(space: fem.FunctionSpace) -> basix.finite_element.FiniteElement:
    map_ = space.mesh.geometry.cmap
    return basix.create_element(
        basix.ElementFamily.P,
        basix.CellType.hexahedron,
        map_.degree,
        basix.LagrangeVariant(map_.variant),
    )


def _points_along(space: fem.FunctionSpace, own: list[_Facet], points: int) -> list[list[int]]:
    """How many points each facet gets along its two sides: odd, so that nodes are among them.

    On a grid of equal facets each direction is served by itself; other faces take the root of the
    number of facets as the number across.
    """
    comm = space.mesh.comm
    corners = np.concatenate([facet.corners_m for facet in own]) if own else np.zeros((0, 2))
    low = comm.allreduce(corners.min(axis=0, initial=np.inf), np.minimum)
    high = comm.allreduce(corners.max(axis=0, initial=-np.inf), np.maximum)
    count = comm.allreduce(len(own))
    box = np.abs(high - low)
    aligned = all(
        min(np.abs(side)) < ALIGNED * box.max() for facet in own for side in facet.sides_m
    )
    gridded = comm.allreduce(aligned, lambda a, b: a and b)
    least = space.element.basix_element.degree + 1

    def odd(across: float) -> int:
        wanted = max(least, int(np.ceil((points - 1) / across - 1e-9)) + 1)
        return wanted + (wanted + 1) % 2

    if not gridded:
        return [[odd(np.sqrt(count))] * 2 for _ in own]
    return [
        [odd(float(np.round(box @ np.abs(side) / (side @ side)))) for side in facet.sides_m]
        for facet in own
    ]


def _points_of(
    space: fem.FunctionSpace, facet: _Facet, count: list[int], material: Material
) -> list[FacetPoint]:
    domain, element = space.mesh, space.element.basix_element
    (p, wp), (q, wq) = (gauss_lobatto(n) for n in count)
    plane = 0.5 * (np.stack(np.meshgrid(p, q, indexing="ij"), -1).reshape(-1, 2) + 1.0)
    weights = 0.25 * np.outer(wp, wq).ravel()
    reference = facet.corner + plane @ facet.tangents
    geometry = domain.geometry.x[domain.geometry.dofmap[facet.cell]]
    shapes = np.asarray(_coordinate(space).tabulate(1, reference), dtype=float)[..., 0]
    functions = np.asarray(element.tabulate(1, reference), dtype=float)[..., 0]
    nodes = space.dofmap.index_map.local_to_global(space.dofmap.cell_dofs(facet.cell))
    column = (3 * nodes[:, None] + np.arange(3)).ravel()
    on_face = np.flatnonzero(np.abs(functions[0]).max(axis=0) > 1e-12)
    lam, mu = material.lame_Pa
    points = []
    for k, weight in enumerate(weights):
        jacobian = shapes[1:, k] @ geometry
        gradient = np.linalg.solve(jacobian, functions[1:, k])
        # the traction -σ e_z: -σ_kz = -μ (u_k,z + u_z,k) - δ_kz λ div u
        traction = np.zeros((3, len(nodes), 3))
        for axis in range(3):
            traction[axis, :, axis] -= mu * gradient[2]
            traction[axis, :, 2] -= mu * gradient[axis]
        traction[2] -= lam * gradient.T
        area = float(weight) * float(np.linalg.norm(np.cross(*(facet.tangents @ jacobian))))
        points.append(
            FacetPoint(
                xy_m=shapes[0, k] @ geometry[:, :2],
                area_m2=area,
                nodes=nodes[on_face],
                shares=functions[0, k, on_face],
                column=column,
                traction_Pa=traction.reshape(3, -1),
            )
        )
    return points
