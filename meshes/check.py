"""Checks that the mesh in gmsh's current model is the one that was asked for."""

from __future__ import annotations

import math

import gmsh
import numpy as np

from .geometry import MeshSpec
from .section import Circle

VOLUME_TOLERANCE = 1e-12
"""Relative: the mesh of either section has a closed form, so that round-off alone is left."""


class MeshError(RuntimeError):
    """A mesh could not be made, or is not what was asked for."""


def hexahedron_type(geometry_order: int) -> int:
    """Return gmsh's element type of a complete hexahedron of the order (8 or 27 nodes)."""
    return gmsh.model.mesh.getElementType("Hexahedron", geometry_order)


def determinant_degree(geometry_order: int) -> int:
    """Return the degree per direction of a hexahedron's Jacobian determinant: 2 or 5.

    One of its three factors has the geometry's degree less one in that direction.
    """
    return 3 * geometry_order - 1


def integrated_volume_m3(geometry_order: int) -> tuple[float, float]:
    """Integrate over the current model's hexahedra.

    Returns
    -------
    (volume, smallest_determinant) : m³, and m³ per reference volume at the quadrature points,
        which integrate the determinant exactly
    """
    kind = hexahedron_type(geometry_order)
    points, weights = gmsh.model.mesh.getIntegrationPoints(
        kind, f"Gauss{determinant_degree(geometry_order)}"
    )
    _, determinants, _ = gmsh.model.mesh.getJacobians(kind, points)
    per_cell = determinants.reshape(-1, len(weights)) @ weights
    return math.fsum(per_cell), float(determinants.min())


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
    Jacobian determinants at the quadrature points and between them (gmsh's bound); the volume.

    Raises
    ------
    MeshError : says which of these fails
    """
    _check_cells(spec)
    _check_facets(spec)
    _check_nodes(spec)
    _check_volume(spec)


def _check_cells(spec: MeshSpec) -> None:
    expected = hexahedron_type(spec.geometry_order)
    kinds, cells, _ = gmsh.model.mesh.getElements(3)
    names = [gmsh.model.mesh.getElementProperties(kind)[0] for kind in kinds]
    if list(kinds) != [expected]:
        raise MeshError(
            f"The mesh must have hexahedra alone, but has {', '.join(names) or 'none'}."
        )
    if len(cells[0]) != spec.n_cells:
        raise MeshError(f"The mesh has {len(cells[0])} hexahedra instead of {spec.n_cells}.")


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


def _check_nodes(spec: MeshSpec) -> None:
    numbers, _, _ = gmsh.model.mesh.getNodes()
    _, connected = gmsh.model.mesh.getElementsByType(hexahedron_type(spec.geometry_order))
    if not np.array_equal(np.sort(numbers), np.arange(1, len(numbers) + 1)):
        raise MeshError("The nodes are not numbered from 1 without gaps.")
    if len(np.unique(connected)) != len(numbers):
        raise MeshError(f"{len(numbers) - len(np.unique(connected))} nodes belong to no cell.")


def _check_volume(spec: MeshSpec) -> None:
    volume, smallest = integrated_volume_m3(spec.geometry_order)
    _, cells, _ = gmsh.model.mesh.getElements(3)
    bound = float(np.min(gmsh.model.mesh.getElementQualities(cells[0], "minDetJac")))
    if not min(smallest, bound) > 0:
        raise MeshError(f"A cell is turned inside out: least Jacobian {min(smallest, bound):.3g}.")
    expected = meshed_volume_m3(spec)
    if not abs(volume / expected - 1) <= VOLUME_TOLERANCE:
        raise MeshError(f"The volume is {volume:.15g} m³ instead of {expected:.15g} m³.")
