"""What is seen on the tip's face: contact pressure, gap and displacement as fields of their own."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem, mesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .bodies.base import Array
from .bodies.solid import SolidBody
from .bodies.tip import SAME_POINT_M
from .errors import ComputationError
from .forms import form


class TipFace:
    """The tip's facets as a mesh, with fields of the solid's order on it. Collective.

    The contact points of a solid of degree 1 or 2 are the nodes of its face, so the fields hold
    their values as they are. ``fields``: contact pressure (Pa), gap (m, positive above the plane),
    displacement (m).
    """

    def __init__(self, solid: SolidBody) -> None:
        domain, contact = solid.domain, solid.contact
        facets = solid.facet_tags.find(solid.tip_tag)
        self.domain = mesh.create_submesh(domain, domain.topology.dim - 1, facets)[0]
        scalar = fem.functionspace(self.domain, ("Lagrange", solid.order))
        vector = fem.functionspace(self.domain, ("Lagrange", solid.order, (3,)))
        self.pressure = fem.Function(scalar, name="pressure_Pa")
        self.gap = fem.Function(scalar, name="gap_m")
        self.displacement = fem.Function(vector, name="displacement_m")
        nodes = scalar.tabulate_dof_coordinates()
        self._point = _nearest(contact.xy_m, nodes[:, :2])
        self._node = _nearest(solid.space.tabulate_dof_coordinates(), nodes)
        self.area_m2 = _area(self.domain, solid)

    @property
    def fields(self) -> list[fem.Function]:
        """Displacement, pressure, gap."""
        return [self.displacement, self.pressure, self.gap]

    def update(self, displacement: fem.Function, force: Array, gaps_m: Array) -> None:
        """Take the solid's ``displacement``, and at the contact points the normal ``force`` (n,) in
        N per area share and the gaps (n,)."""
        self.gap.x.array[:] = gaps_m[self._point]
        self.pressure.x.array[:] = force[self._point] / self.area_m2
        moved = displacement.x.array.reshape(-1, 3)[self._node]
        self.displacement.x.array[:] = moved.ravel()


def _area(domain: mesh.Mesh, solid: SolidBody) -> float:
    degree = 2 * domain.geometry.cmap.degree
    dx = ufl.Measure("dx", domain=domain, metadata={"quadrature_degree": degree})
    area = form(fem.Constant(domain, np.float64(1.0)) * dx)
    return float(solid.comm.allreduce(fem.assemble_scalar(area)))


def _nearest(candidates: Array, places: Array) -> NDArray[np.intp]:
    """Index of the candidate at each place; raises ComputationError where there is none."""
    if not len(places):
        return np.empty(0, dtype=np.intp)
    distance, index = cKDTree(candidates).query(places)
    if distance.max() > 2.0 * SAME_POINT_M:
        raise ComputationError(
            f"a node of the tip is {distance.max():.3g} m from the nearest contact point"
        )
    return np.asarray(index, dtype=np.intp)
