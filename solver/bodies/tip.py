"""Where a solid's tip can touch: the points of its facets, as rows over the unknowns."""

from __future__ import annotations

from dataclasses import dataclass

import basix
import numpy as np
from dolfinx import fem
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from ..bristle import Material
from ..errors import ComputationError
from .base import Array, ContactPoints

SAME_POINT_M = 1e-9


@dataclass(frozen=True)
class FacetPoint:
    """One facet's view of a point: its place, its area, and the rows over the cell's unknowns."""

    xy_m: Array
    area_m2: float
    column: NDArray[np.int64]
    normal: Array
    pressure_Pa: Array


def tip_contact(
    space: fem.FunctionSpace, facets: NDArray[np.int32], material: Material
) -> ContactPoints:
    """Contact points of the tip: the Gauss-Lobatto points of its facets, shared ones merged.

    For degrees 1 and 2 these are the nodes of the face, its edge and corners among them. Where
    cells share a point, displacement and pressure are their mean, weighted by area. Collective;
    raises ComputationError where no rank has a facet of the tip.
    """
    comm = space.mesh.comm
    found = [
        point for part in comm.allgather(facet_points(space, facets, material)) for point in part
    ]
    if not found:
        raise ComputationError("no facet of the mesh carries the tip's tag")
    keys = np.round([point.xy_m / SAME_POINT_M for point in found]).astype(np.int64)
    unique, index = np.unique(keys, axis=0, return_inverse=True)
    index = index.ravel()
    shares = np.array([point.area_m2 for point in found])
    areas = np.bincount(index, weights=shares)
    total = areas.sum()
    shares = shares / areas[index]
    return ContactPoints(
        normal=_owned_rows(space, found, index, shares, [p.normal for p in found]),
        pressure=_owned_rows(space, found, index, shares * total, [p.pressure_Pa for p in found]),
        weights=areas / total,
        xy_m=unique * SAME_POINT_M,
        comm=comm,
    )


def _owned_rows(
    space: fem.FunctionSpace,
    found: list[FacetPoint],
    index: NDArray[np.intp],
    scales: Array,
    values: list[Array],
) -> csr_matrix:
    """Sum of the scaled ``values`` per point (n, unknowns of this rank)."""
    block = space.dofmap.index_map_bs
    first, last = (block * end for end in space.dofmap.index_map.local_range)
    row = np.concatenate([np.full(len(p.column), i) for p, i in zip(found, index, strict=True)])
    column = np.concatenate([p.column for p in found])
    value = np.concatenate([s * v for s, v in zip(scales, values, strict=True)])
    keep = (column >= first) & (column < last) & (value != 0.0)
    shape = (int(index.max()) + 1, last - first)
    return csr_matrix((value[keep], (row[keep], column[keep] - first)), shape)


def facet_points(
    space: fem.FunctionSpace, facets: NDArray[np.int32], material: Material
) -> list[FacetPoint]:
    """The points of this rank's share of ``facets``, columns numbered globally."""
    domain = space.mesh
    tdim = domain.topology.dim
    domain.topology.create_connectivity(tdim - 1, tdim)
    domain.topology.create_connectivity(tdim, tdim - 1)
    cells_of = domain.topology.connectivity(tdim - 1, tdim)
    facets_of = domain.topology.connectivity(tdim, tdim - 1)
    owned = domain.topology.index_map(tdim).size_local
    points = []
    for facet in facets:
        cell = int(cells_of.links(facet)[0])
        if cell < owned:
            local = int(np.flatnonzero(facets_of.links(cell) == facet)[0])
            points += _points_of_facet(space, cell, local, material)
    return points


def _points_of_facet(
    space: fem.FunctionSpace, cell: int, facet: int, material: Material
) -> list[FacetPoint]:
    domain, element = space.mesh, space.element.basix_element
    map_ = domain.geometry.cmap
    coordinate = basix.create_element(
        basix.ElementFamily.P,
        basix.CellType.hexahedron,
        map_.degree,
        basix.LagrangeVariant(map_.variant),
    )
    rule, weights = map(
        np.asarray,
        basix.make_quadrature(
            basix.CellType.quadrilateral, 2 * element.degree - 1, rule=basix.QuadratureType.gll
        ),
    )
    corners = np.asarray(basix.geometry(basix.CellType.hexahedron), dtype=float)
    corner = corners[basix.topology(basix.CellType.hexahedron)[2][facet]]
    tangents = np.stack([corner[1] - corner[0], corner[2] - corner[0]])
    reference = corner[0] + rule @ tangents
    geometry = domain.geometry.x[domain.geometry.dofmap[cell]]
    shapes = np.asarray(coordinate.tabulate(1, reference), dtype=float)[..., 0]
    functions = np.asarray(element.tabulate(1, reference), dtype=float)[..., 0]
    nodes = space.dofmap.index_map.local_to_global(space.dofmap.cell_dofs(cell))
    column = (3 * nodes[:, None] + np.arange(3)).ravel()
    lam, mu = material.lame_Pa
    points = []
    for q, weight in enumerate(weights):
        jacobian = shapes[1:, q] @ geometry
        gradient = np.linalg.solve(jacobian, functions[1:, q])
        normal = np.zeros((len(nodes), 3))
        normal[:, 2] = functions[0, q]
        pressure = -lam * gradient.T
        pressure[:, 2] -= 2.0 * mu * gradient[2]
        area = float(weight) * float(np.linalg.norm(np.cross(*(tangents @ jacobian))))
        place = shapes[0, q] @ geometry[:, :2]
        points.append(FacetPoint(place, area, column, normal.ravel(), pressure.ravel()))
    return points
