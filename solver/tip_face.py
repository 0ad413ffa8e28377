"""Contact pressure, gap and displacement as fields on the tip's face."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem, la, mesh
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .arrays import Array
from .bodies.solid import SolidBody
from .bodies.tip import SAME_POINT_M
from .errors import require
from .form_cache import form


class TipFace:
    """The tip's facets as a mesh, with fields of the solid's order on it. Collective.

    ``fields``: contact pressure (Pa), gap (m, positive above the plane), displacement (m). There
    are more contact points than nodes. Pressure and gap are area-weighted least-squares fits to the
    values at the points, under the constraint that the integral over the face is the points' sum;
    so the pressure carries the contact force. At the edge of contact the pressure may dip below
    zero, as polynomials of the solid's order do.
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
        nodes, places = solid.space.tabulate_dof_coordinates(), scalar.tabulate_dof_coordinates()
        self._node = _nearest(domain.comm, nodes, places)
        moving = contact.moved(nodes[: solid.n_local // 3].ravel()).reshape(-1, 3)
        self._moving = _nearest(domain.comm, moving, places)
        shares_m2 = self._shares_m2(scalar, len(moving))
        self.area_m2 = float(shares_m2.sum())
        self._fit = _fit(contact.rows[2::3, 2::3], contact.weights, shares_m2 / self.area_m2)

    @property
    def fields(self) -> list[fem.Function]:
        """Displacement, pressure, gap."""
        return [self.displacement, self.pressure, self.gap]

    def update(self, displacement: fem.Function, force: Array, gaps_m: Array) -> None:
        """Update the fields from the solid's ``displacement`` and, at the contact points, the
        normal ``force`` (n,) in N per area share and the gaps (n,)."""
        self.gap.x.array[:] = (self._fit @ gaps_m)[self._moving]
        self.pressure.x.array[:] = (self._fit @ force)[self._moving] / self.area_m2
        moved = displacement.x.array.reshape(-1, 3)[self._node]
        self.displacement.x.array[:] = moved.ravel()

    def _shares_m2(self, scalar: fem.FunctionSpace, count: int) -> Array:
        """Integrals over the face of its ``count`` nodes' shape functions."""
        degree = scalar.element.basix_element.degree + 2 * self.domain.geometry.cmap.degree
        dx = ufl.Measure("dx", domain=self.domain, metadata={"quadrature_degree": degree})
        local = fem.assemble_vector(form(ufl.TestFunction(scalar) * dx))
        local.scatter_reverse(la.InsertMode.add)
        owned = scalar.dofmap.index_map.size_local
        shares = np.bincount(self._moving[:owned], local.array[:owned], minlength=count)
        return np.asarray(self.domain.comm.allreduce(shares))


def _fit(shapes: Array, weights: Array, shares: Array) -> Array:
    """Matrix (nodes, n) from values at n points to values at nodes, see TipFace.

    ``shapes`` (n, nodes) are the nodes' shape functions at the points. ``weights`` (n,) and
    ``shares`` (nodes,) are the shares of points and nodes in the face's area.
    """
    weighted = shapes.T * weights
    normal = np.block([[weighted @ shapes, shares[:, None]], [shares, np.zeros(1)]])
    return np.linalg.solve(normal, np.vstack([weighted, weights]))[:-1]


def _nearest(comm: MPI.Intracomm, candidates: Array, places: Array) -> NDArray[np.intp]:
    """Index of the candidate at each place; ComputationError on all ranks if a place has none."""
    distance, index = cKDTree(candidates).query(places)
    far = float(distance.max(initial=0.0))
    message = f"a node of the tip is {far:.3g} m from the nearest node of the solid"
    require(comm, far <= 2.0 * SAME_POINT_M, message)
    return np.asarray(index, dtype=np.intp)
