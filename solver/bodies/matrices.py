"""Assembly of a solid's stiffness and mass matrices.

A vector mass matrix repeats the scalar one for each direction. Only the scalar one is assembled: a
ninth of the numbers, read once for all three directions.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import ufl
from dolfinx import fem, la
from dolfinx.common import IndexMap
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from ..arrays import Array
from ..compiled import fast
from ..errors import require
from ..form_cache import form
from ..forms import cells_of

Rows = tuple[NDArray[np.integer], NDArray[np.integer], Array]


def assembled_rows(energy: fem.Form) -> tuple[Rows, IndexMap]:
    """This rank's rows of the matrix of the form ``energy``, and the index map of their columns:
    its own unknowns, then those of other ranks that they couple to. Collective."""
    own = fem.assemble_matrix(energy, block_mode=la.BlockMode.expanded)
    own.scatter_reverse()
    first = own.indptr[: own.index_map(0).size_local + 1].astype(PETSc.IntType)
    return (first, own.indices[: first[-1]], own.data[: first[-1]]), own.index_map(1)


def petsc_matrix(rows: Rows, columns: IndexMap, comm: MPI.Intracomm) -> PETSc.Mat:
    """`assembled_rows` of a vector space as a PETSc matrix; on one rank they share memory."""
    n = len(rows[0]) - 1
    if comm.size == 1:
        return PETSc.Mat().createAIJWithArrays(((n, n), (n, n)), rows, bsize=3, comm=comm)
    first, column, value = rows
    csr = (first, columns.local_to_global(column).astype(PETSc.IntType), value)
    return PETSc.Mat().createAIJ(((n, None),) * 2, bsize=3, csr=csr, comm=comm)


class NodeMass:
    """The mass matrix of a vector ``space``, stored by nodes.

    ``rows`` are offsets (m + 1,), columns and values of this rank's rows; columns count its own
    nodes, then those of other ranks that they couple to. Collective.
    """

    def __init__(self, space: fem.FunctionSpace, density_kg_m3: float) -> None:
        domain = space.mesh
        scalar = fem.functionspace(domain, ("Lagrange", space.element.basix_element.degree))
        same = np.array_equal(scalar.dofmap.list, space.dofmap.list)
        require(domain.comm, same, "dolfinx numbers the nodes of scalars and of vectors apart")
        u, v = ufl.TrialFunction(scalar), ufl.TestFunction(scalar)
        density = fem.Constant(domain, PETSc.ScalarType(density_kg_m3))
        self.rows, self.columns = assembled_rows(form(density * ufl.inner(u, v) * cells_of(space)))
        self.comm = domain.comm
        self._moved = la.vector(self.columns, 3)

    def times(self, x: Array) -> Array:
        """M x for this rank's (n,) or (n, k); collective."""
        y = np.empty(x.shape, order="F")
        columns, products = (x[None], y[None]) if x.ndim == 1 else (x.T, y.T)
        for k in range(len(columns)):
            own, product = self.with_others(columns[k]), products[k]
            _times(*self.rows, own.reshape(-1, 3), product.reshape(-1, 3))
        return y

    def with_others(self, x: Array) -> Array:
        """``x`` (n,) extended by the unknowns of other ranks that the rows need."""
        if self.comm.size == 1:
            return np.ascontiguousarray(x)
        self._moved.array[: len(x)] = x
        self._moved.scatter_forward()
        return np.asarray(self._moved.array)

    def vector_matrix(self) -> PETSc.Mat:
        """The matrix over vectors, as PETSc matrix."""
        first, column, value = self.rows
        nodes = self.columns.local_to_global(column)
        n = self.columns.size_global
        local = sp.csr_matrix((value, nodes, first), (len(first) - 1, n))
        full = sp.kron(local, sp.eye_array(3), format="csr")
        index = PETSc.IntType
        csr = (full.indptr.astype(index), full.indices.astype(index), full.data)
        return PETSc.Mat().createAIJ(((full.shape[0], None),) * 2, csr=csr, comm=self.comm)


@fast
def _times(
    first: NDArray[np.integer], column: NDArray[np.integer], value: Array, x: Array, y: Array
) -> None:
    for i in range(len(first) - 1):
        a = b = c = 0.0
        # unsigned, which skips the check for negative indices: twice as fast
        for k in range(np.uint64(first[i]), np.uint64(first[i + 1])):
            j, m = np.uint64(column[k]), value[k]
            a += m * x[j, 0]
            b += m * x[j, 1]
            c += m * x[j, 2]
        y[i, 0], y[i, 1], y[i, 2] = a, b, c
