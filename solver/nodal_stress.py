"""Stress at the nodes of a solid, from its displacement.

The stress of a finite element displacement is discontinuous between cells, and least accurate at
the nodes. It is most accurate at the p × p × p Gauss points of a hexahedron of degree p (Barlow,
Int. J. Numer. Methods Eng. 10, 1976; Zienkiewicz and Zhu, ibid. 33, 1992), and within a tetrahedron
at the points of the rule of degree 2p - 2: the middle, or four about it. So it is evaluated there,
extrapolated to the nodes by the polynomial of degree p - 1, and averaged over the cells at a node.
In one material the true stress is continuous, and so is the result. It is defined on the nodes of
the displacement, so one file holds both, and a picture can be warped by one and coloured by the
other. The stress of a displacement of degree p is exact if the cells are not curved.
"""

from __future__ import annotations

import basix
import numpy as np
import ufl
from dolfinx import fem, la
from scipy.sparse import csr_matrix

from .arrays import Array
from .bristle import Material
from .form_cache import expression
from .forms import Elasticity

VOIGT = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


class NodalStress:
    """Stress at the nodes of ``displacement``'s space; compiled once, here. Collective.

    At ``finite`` strain it is the second Piola-Kirchhoff stress, along the body's own axes.
    """

    def __init__(
        self, displacement: fem.Function, material: Material, *, finite: bool = False
    ) -> None:
        self.displacement, space = displacement, displacement.function_space
        self._domain = space.mesh
        element = space.element.basix_element
        points = stress_points(element)
        body = Elasticity.of(material, space.mesh, finite=finite)
        sigma = body.stress(body.strain(displacement))
        components = ufl.as_vector([sigma[i, j] for i, j in VOIGT])
        self._expression = expression(components, points)
        self._to_nodes = extrapolation(element, points)
        self._cells = np.arange(space.mesh.topology.index_map(3).size_local, dtype=np.int32)
        nodes = space.dofmap.list[: len(self._cells)]
        column = np.arange(nodes.size)
        index_map = space.dofmap.index_map
        shape = (index_map.size_local + index_map.num_ghosts, nodes.size)
        self._gather = csr_matrix((np.ones(nodes.size), (nodes.ravel(), column)), shape)
        self._sum = la.vector(index_map, len(VOIGT))
        self._share = 1.0 / self._over_cells(np.ones((nodes.size, len(VOIGT))))[:, :1]

    def __call__(self) -> Array:
        """Stress (nodes, 6) in Pa as xx, yy, zz, yz, xz, xy; ghost nodes included. Collective.

        The displacement must be up to date at its ghost nodes.
        """
        values = self._expression.eval(self._domain, self._cells)
        at_points = values.reshape(len(self._cells), self._to_nodes.shape[1], len(VOIGT))
        at_nodes = np.einsum("np,cpi->cni", self._to_nodes, at_points)
        return self._share * self._over_cells(at_nodes.reshape(-1, len(VOIGT)))

    def _over_cells(self, at_nodes: Array) -> Array:
        """Sum (nodes, 6) over all ranks' cells of their values at nodes (cells × nodes, 6)."""
        self._sum.array[:] = (self._gather @ at_nodes).ravel()
        self._sum.scatter_reverse(la.InsertMode.add)
        self._sum.scatter_forward()
        return self._sum.array.reshape(-1, len(VOIGT)).copy()


def stress_points(element: basix.finite_element.FiniteElement) -> Array:
    """Points (m, 3) of a cell, as many as a polynomial of its strain's degree needs."""
    degree = 2 * element.degree - 2
    if element.cell_type is basix.CellType.hexahedron:
        degree += 1
    return np.asarray(basix.make_quadrature(element.cell_type, degree)[0])


def extrapolation(element: basix.finite_element.FiniteElement, points: Array) -> Array:
    """Matrix (nodes, points) from values at `stress_points` to the nodes of a cell."""
    through = basix.create_element(
        basix.ElementFamily.P,
        element.cell_type,
        element.degree - 1,
        basix.LagrangeVariant.gll_warped,
        discontinuous=True,
    )
    at_points = np.asarray(through.tabulate(0, points))[0, :, :, 0]
    at_nodes = np.asarray(through.tabulate(0, np.asarray(element.points)))[0, :, :, 0]
    return np.linalg.solve(at_points.T, at_nodes.T).T


def von_mises(stress_Pa: Array) -> Array:
    """Equivalent stress (n,) of stresses (n, 6) in the order of ``VOIGT``."""
    xx, yy, zz, yz, xz, xy = stress_Pa.T
    normal = (xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2
    return np.sqrt(0.5 * normal + 3.0 * (yz**2 + xz**2 + xy**2))
