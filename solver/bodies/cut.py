"""How is a slender body's matrix factored where cross-sections cut it into the parts of ranks?

Each rank eliminates what is inside its part; what is left is a small dense matrix of the cuts'
unknowns, the same on all ranks (Schur complement; Przemieniecki, AIAA J. 1, 1963). A solve is the
part's own elimination, one sum over ranks of as many numbers as the cuts have unknowns, and the
part's own substitution. A factor spread over ranks passes vectors up and down a tree of separators
instead, and waits at each level.

A part that ends at one cut is a chain whose last slice is that cut: nothing more is read than on
one rank. A part between two cuts also reads how it answers to the other.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_matrix, hstack

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
        heights = np.concatenate(comm.allgather(heights_m[self._shared]))
        self.n_cuts = len(cuts)
        self._own = np.searchsorted(cuts, first + self._shared)
        inside = rows[self._inside]
        coupling = inside[:, cuts]
        touched = np.unique(coupling.indices)
        own = inside[:, first + np.flatnonzero(self._inside)]
        self.part = _part(own, coupling[:, touched], heights_m[self._inside], heights[touched])
        self._touched = touched[self.part.order]
        schur = np.zeros((self.n_cuts, self.n_cuts))
        schur[self._own] = rows[self._shared][:, cuts].toarray()
        schur[np.ix_(self._touched, self._touched)] += self.part.left
        comm.Allreduce(MPI.IN_PLACE, schur)
        try:
            self._cuts = cho_factor(schur, lower=True)
        except np.linalg.LinAlgError as error:
            raise ComputationError(
                f"the matrix of the cuts could not be factored: {error}"
            ) from error

    def solve(self, b: Array) -> Array:
        """This rank's unknowns (n,) or (n, m) of the solution for its rows ``b``; collective."""
        kept, passed = self.part.forward(b[self._inside])
        load = np.zeros((self.n_cuts, *b.shape[1:]))
        load[self._own] = b[self._shared]
        load[self._touched] += passed
        self.comm.Allreduce(MPI.IN_PLACE, load)
        motion = cho_solve(self._cuts, load)
        x = np.empty_like(b, order="F")
        x[self._inside] = self.part.backward(kept, motion[self._touched])
        x[self._shared] = motion[self._own]
        return x

    def close(self) -> None:
        """Free what PETSc holds."""
        self.part.close()


class Part(Protocol):
    """One rank's own matrix between its cuts.

    ``order`` (t,) is how it sorts the unknowns on cuts that it touches, ``left`` (t, t) what
    eliminating its own adds to their matrix.
    """

    order: NDArray[np.int64]
    left: Array

    def forward(self, b: Array) -> tuple[Any, Array]:
        """What `backward` goes on from, and what elimination adds to the loads on cuts (t,) or
        (t, m), for its own right-hand sides (n,) or (n, m)."""
        ...

    def backward(self, kept: Any, motion: Array) -> Array:
        """Its own unknowns, those on cuts being ``motion``."""
        ...

    def close(self) -> None: ...


def _part(own: csr_matrix, coupling: csr_matrix, heights_m: Array, cuts_m: Array) -> Part:
    """The part with ``own`` (n, n) matrix, its ``coupling`` (n, t) to cuts, and places of both."""
    if not len(heights_m):
        return _Nothing(len(cuts_m))
    below = cuts_m < 0.5 * (heights_m.min() + heights_m.max())
    # toward the only cut, or down to the lower of two
    downward = not len(cuts_m) or bool(below.any())
    at_end = below if downward else ~below
    order = np.concatenate([np.flatnonzero(at_end), np.flatnonzero(~at_end)])
    coupling, last = coupling[:, order], int(at_end.sum())
    chained = hstack([own, coupling[:, :last]], format="csr")
    pattern = chained.indptr, chained.indices
    layout = lay_out(*pattern, heights_m if downward else -heights_m, last)
    if layout.entries > WIDEST * len(heights_m):
        return _ByMumps(own, coupling, order)
    factor = ChainFactor(layout, [(*pattern, chained.data, 1.0, 1)])
    return _Chained(factor, coupling[:, last:], order)


class _Chained:
    """A chain toward one cut. The unknowns of another, if there is one, are ``far``."""

    def __init__(self, factor: ChainFactor, far: csr_matrix, order: NDArray[np.int64]) -> None:
        self.factor, self.order = factor, order
        self._n, self._last = len(factor.layout.order), factor.layout.last
        # what elimination makes of the coupling to the far cut, a row for each of its unknowns
        self._far: Array = np.zeros((0, self._n))
        self.left = np.zeros((len(order), len(order)))
        self.left[: self._last, : self._last] = factor.left
        if far.shape[1]:
            # the sparse columns as dense right-hand sides: a cross-section
            works, passed = factor.forward(far.toarray(order="F"))
            self._far = np.vstack([work[:, : self._n] for work in works])
            self.left[: self._last, self._last :] = passed
            self.left[self._last :, : self._last] = passed.T
            self.left[self._last :, self._last :] = -self._far @ self._far.T

    def forward(self, b: Array) -> tuple[list[Array], Array]:
        works, passed = self.factor.forward(b)
        far = np.hstack([self._far @ work[:, : self._n].T for work in works])
        return works, np.concatenate([passed, -(far[:, 0] if b.ndim == 1 else far)])

    def backward(self, kept: list[Array], motion: Array) -> Array:
        near, far = motion[: self._last], motion[self._last :]
        far = far if far.ndim == 2 else far[:, None]
        done = 0
        for work in kept:
            work[:, : self._n] -= far[:, done : done + len(work)].T @ self._far
            done += len(work)
        return self.factor.backward(kept, near)

    def close(self) -> None:
        """Memory goes with the last reference."""


class _ByMumps:
    """A part that is not slender, as solved alone, and how it answers to all its cuts."""

    def __init__(self, own: csr_matrix, coupling: csr_matrix, order: NDArray[np.int64]) -> None:
        index = [part.astype(PETSc.IntType) for part in (own.indptr, own.indices)]
        matrix = PETSc.Mat().createAIJ(own.shape, csr=(*index, own.data), comm=MPI.COMM_SELF)
        matrix.setOption(PETSc.Mat.Option.SPD, True)
        try:
            self._mumps = Mumps(matrix)
        finally:
            matrix.destroy()
        self.order, self._coupling = order, coupling
        self._answer = self._mumps.solve(coupling.toarray(order="F"))
        self.left = -(coupling.T @ self._answer)

    def forward(self, b: Array) -> tuple[Array, Array]:
        alone = self._mumps.solve(b)
        return alone, -(self._coupling.T @ alone)

    def backward(self, kept: Array, motion: Array) -> Array:
        return np.asarray(kept - self._answer @ motion)

    def close(self) -> None:
        self._mumps.close()


class _Nothing:
    """Of a rank whose unknowns are all on cuts."""

    def __init__(self, touched: int) -> None:
        self.order, self.left = np.arange(touched), np.zeros((touched, touched))

    def forward(self, b: Array) -> tuple[Array, Array]:
        return b, np.zeros((len(self.order), *b.shape[1:]))

    def backward(self, kept: Array, motion: Array) -> Array:
        return kept

    def close(self) -> None:
        """Nothing is held."""
