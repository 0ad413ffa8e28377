"""How is a slender body's matrix factored where cross-sections cut it into the parts of ranks?

Each rank factors what is inside its part and keeps how that answers to the cuts; what is left is a
small dense matrix of the cuts' unknowns, the same on all ranks (Schur complement; Przemieniecki,
AIAA J. 1, 1963). A solve is one with the part's own factor, one sum over ranks of as many numbers
as the cuts have unknowns, and two products. A factor spread over ranks passes vectors up and down a
tree of separators instead, and waits at each level.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_matrix

from ..errors import ComputationError
from .base import Array
from .chain import WIDEST, ChainFactor, lay_out
from .mumps import Mumps

# Unknowns of all cuts together, whose dense factor every rank holds and reads in each solve.
MOST_ON_CUTS = 3000


class CutFactor:
    """Cholesky factor of a symmetric positive definite ``matrix`` distributed over ``comm``.

    ``shared`` (n_local,) marks this rank's unknowns that a cell of another rank has too; without
    them no part may touch another. ``heights_m`` (n_local,) are places along the
    axis. Collective. Raises ComputationError where a factor fails.
    """

    def __init__(
        self, matrix: PETSc.Mat, shared: NDArray[np.bool_], heights_m: Array, comm: MPI.Intracomm
    ) -> None:
        self.comm, self._shared, self._inside = comm, np.flatnonzero(shared), ~shared
        first, last = matrix.getOwnershipRange()
        offsets, columns, values = matrix.getValuesCSR()
        rows = csr_matrix((values, columns, offsets), (last - first, matrix.getSize()[1]))
        cuts = np.concatenate(comm.allgather(first + self._shared))
        self.n_cuts = len(cuts)
        self._own = np.searchsorted(cuts, first + self._shared)
        inside = rows[self._inside]
        coupling = inside[:, cuts]
        self._touched = np.unique(coupling.indices)
        self._coupling = coupling[:, self._touched]
        own = inside[:, first + np.flatnonzero(self._inside)]
        self._part = _part(own, heights_m[self._inside])
        # the sparse columns as dense right-hand sides: a few cross-sections
        self._answer = self._part.solve(self._coupling.toarray(order="F"))
        schur = np.zeros((self.n_cuts, self.n_cuts))
        schur[self._own] = rows[self._shared][:, cuts].toarray()
        schur[np.ix_(self._touched, self._touched)] -= self._coupling.T @ self._answer
        comm.Allreduce(MPI.IN_PLACE, schur)
        try:
            self._cuts = cho_factor(schur, lower=True)
        except np.linalg.LinAlgError as error:
            raise ComputationError(
                f"the matrix of the cuts could not be factored: {error}"
            ) from error

    def solve(self, b: Array) -> Array:
        """This rank's unknowns (n,) or (n, m) of the solution for its rows ``b``; collective."""
        alone = self._part.solve(b[self._inside])
        load = np.zeros((self.n_cuts, *b.shape[1:]))
        load[self._own] = b[self._shared]
        load[self._touched] -= self._coupling.T @ alone
        self.comm.Allreduce(MPI.IN_PLACE, load)
        motion = cho_solve(self._cuts, load)
        x = np.empty_like(b, order="F")
        x[self._inside] = alone - self._answer @ motion[self._touched]
        x[self._shared] = motion[self._own]
        return x

    def close(self) -> None:
        """Free what PETSc holds."""
        if isinstance(self._part, Mumps):
            self._part.close()


def _part(rows: csr_matrix, heights_m: Array) -> _Nothing | ChainFactor | Mumps:
    """A factor of one rank's own matrix."""
    if not len(heights_m):
        return _Nothing()
    layout = lay_out(rows.indptr, rows.indices, heights_m)
    if layout.entries > WIDEST * len(heights_m):
        return _by_mumps(rows)
    return ChainFactor(layout, [(rows.indptr, rows.indices, rows.data, 1.0, 1)])


def _by_mumps(rows: csr_matrix) -> Mumps:
    """A part that is not slender."""
    index = [part.astype(PETSc.IntType) for part in (rows.indptr, rows.indices)]
    matrix = PETSc.Mat().createAIJ(rows.shape, csr=(*index, rows.data), comm=MPI.COMM_SELF)
    matrix.setOption(PETSc.Mat.Option.SPD, True)
    try:
        return Mumps(matrix)
    finally:
        matrix.destroy()


class _Nothing:
    """Of a rank whose unknowns are all on cuts."""

    def solve(self, b: Array) -> Array:
        return b
