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
from scipy.sparse import csr_matrix, eye_array, kron

from ..arrays import Array
from ..compiled import njit
from ..errors import ComputationError
from .chain import WIDEST, ChainFactor, Index, Rows, Summand, dense_rows, lay_out
from .mumps import Mumps

# Unknowns of all cuts together, whose dense factor every rank holds and reads in each solve.
MOST_ON_CUTS = 3000


class CutFactor:
    """Cholesky factor of a symmetric positive definite matrix distributed over ``comm``.

    ``parts`` are this rank's rows, see `chain`, with ``columns`` as all ranks number them: its own
    (n_local,), and then those of others that it couples to. ``shared`` (n_local,) marks unknowns
    that a cell of another rank has too; without them no part may touch another. ``heights_m``
    (n_local,) are places along the axis. Collective. Raises ComputationError where a factor fails.
    """

    def __init__(
        self,
        parts: list[Summand],
        columns: NDArray[np.int64],
        shared: NDArray[np.bool_],
        heights_m: Array,
        comm: MPI.Intracomm,
    ) -> None:
        self.comm, self._shared, inside = comm, np.flatnonzero(shared), np.flatnonzero(~shared)
        cuts = np.concatenate(comm.allgather(columns[self._shared]))
        heights = np.concatenate(comm.allgather(heights_m[self._shared]))
        self.n_cuts = len(cuts)
        on_cuts = _found(cuts, columns)
        self._own = on_cuts[self._shared]
        touched = np.flatnonzero(_coupled(*parts[0][:2], inside, len(columns)) & (on_cuts >= 0))
        touched = touched[np.argsort(on_cuts[touched])]
        self.part = _part(parts, inside, heights_m[inside], touched, heights[on_cuts[touched]])
        self._touched = on_cuts[touched][self.part.order]
        schur = np.zeros((self.n_cuts, self.n_cuts))
        schur[self._own] = dense_rows(parts, self._shared, on_cuts, self.n_cuts)
        schur[np.ix_(self._touched, self._touched)] += self.part.left
        comm.Allreduce(MPI.IN_PLACE, schur)
        try:
            self._cuts = cho_factor(schur, lower=True)
        except np.linalg.LinAlgError as error:
            raise ComputationError(
                f"the matrix of the cuts could not be factored: {error}"
            ) from error

    def solve(self, b: Array) -> Array:
        """This rank's unknowns (n_local,) or (n_local, m) of the solution for its rows ``b``;
        collective."""
        kept, passed = self.part.forward(b)
        load = np.zeros((self.n_cuts, *b.shape[1:]))
        load[self._own] = b[self._shared]
        load[self._touched] += passed
        self.comm.Allreduce(MPI.IN_PLACE, load)
        motion = cho_solve(self._cuts, load)
        x = np.empty_like(b, order="F")
        self.part.backward(kept, motion[self._touched], x)
        x[self._shared] = motion[self._own]
        return x

    def close(self) -> None:
        """Free what PETSc holds."""
        self.part.close()


def _found(cuts: NDArray[np.int64], columns: NDArray[np.int64]) -> Index:
    """Where ``columns`` are among ``cuts``, which ascend; -1 for those that are not."""
    place = np.searchsorted(cuts, columns)
    there = place < len(cuts)
    there[there] = cuts[place[there]] == columns[there]
    return np.where(there, place, -1)


@njit
def _coupled(first: Rows, column: Rows, rows: Index, count: int) -> NDArray[np.bool_]:
    """Which of ``count`` columns these rows have."""
    found = np.zeros(count, dtype=np.bool_)
    for row in rows:
        for k in range(first[row], first[row + 1]):
            found[column[k]] = True
    return found


class Part(Protocol):
    """One rank's own matrix between its cuts.

    ``order`` (t,) is how it sorts the unknowns on cuts that it touches, ``left`` (t, t) what
    eliminating its own adds to their matrix.
    """

    order: NDArray[np.int64]
    left: Array

    def forward(self, b: Array) -> tuple[Any, Array]:
        """What `backward` goes on from, and what elimination adds to the loads on cuts (t,) or
        (t, m), for right-hand sides (n_local,) or (n_local, m)."""
        ...

    def backward(self, kept: Any, motion: Array, x: Array) -> None:
        """Write its own unknowns into ``x`` (n_local,) or (n_local, m), those on cuts being
        ``motion``."""
        ...

    def close(self) -> None: ...


def _part(
    parts: list[Summand], inside: Index, heights_m: Array, touched: Index, cuts_m: Array
) -> Part:
    """The part of the rows ``inside`` (n,), and the columns on cuts that it ``touched`` (t,), with
    the places of both."""
    if not len(inside):
        return _Nothing(len(touched))
    below = cuts_m < 0.5 * (heights_m.min() + heights_m.max())
    # toward the only cut, or down to the lower of two
    downward = not len(cuts_m) or bool(below.any())
    at_end = below if downward else ~below
    order = np.concatenate([np.flatnonzero(at_end), np.flatnonzero(~at_end)])
    near, far = touched[at_end], touched[~at_end]
    layout = lay_out(*parts[0][:2], heights_m if downward else -heights_m, inside, near)
    if layout.entries > WIDEST * len(inside):
        whole = sum(_over_unknowns(part, len(layout.place)) for part in parts)
        return _ByMumps(whole[inside], inside, touched[order], order)
    return _Chained(ChainFactor(layout, parts), parts, far, order)


class _Chained:
    """A chain toward one cut. The columns of another, if there is one, are ``far``."""

    def __init__(
        self,
        factor: ChainFactor,
        parts: list[Summand],
        far: Index,
        order: NDArray[np.int64],
    ) -> None:
        self.factor, self.order = factor, order
        self._n, self._last = len(factor.layout.order), factor.layout.last
        # what elimination makes of the coupling to the far cut, a row for each of its unknowns
        self._far: Array = np.zeros((0, self._n))
        self.left = np.zeros((len(order), len(order)))
        self.left[: self._last, : self._last] = factor.left
        if len(far):
            place = np.full(len(factor.layout.place), -1)
            place[far] = np.arange(len(far))
            rows = np.arange(len(parts[0][0]) - 1)
            works, passed = factor.forward(dense_rows(parts, rows, place, len(far)))
            self._far = np.vstack([work[:, : self._n] for work in works])
            self.left[: self._last, self._last :] = passed
            self.left[self._last :, : self._last] = passed.T
            self.left[self._last :, self._last :] = -self._far @ self._far.T

    def forward(self, b: Array) -> tuple[list[Array], Array]:
        works, passed = self.factor.forward(b)
        far = np.hstack([self._far @ work[:, : self._n].T for work in works])
        return works, np.concatenate([passed, -(far[:, 0] if b.ndim == 1 else far)])

    def backward(self, kept: list[Array], motion: Array, x: Array) -> None:
        near, far = motion[: self._last], motion[self._last :]
        far = far if far.ndim == 2 else far[:, None]
        done = 0
        for work in kept:
            work[:, : self._n] -= far[:, done : done + len(work)].T @ self._far
            done += len(work)
        self.factor.backward(kept, near, x)

    def close(self) -> None:
        """Memory goes with the last reference."""


class _ByMumps:
    """A part that is not slender, as solved alone, and how it answers to all its cuts."""

    def __init__(
        self, rows: csr_matrix, inside: Index, touched: Index, order: NDArray[np.int64]
    ) -> None:
        own = rows[:, inside]
        index = [part.astype(PETSc.IntType) for part in (own.indptr, own.indices)]
        matrix = PETSc.Mat().createAIJ(own.shape, csr=(*index, own.data), comm=MPI.COMM_SELF)
        matrix.setOption(PETSc.Mat.Option.SPD, True)
        try:
            self._mumps = Mumps(matrix)
        finally:
            matrix.destroy()
        self.order, self._inside, self._coupling = order, inside, rows[:, touched]
        self._answer = self._mumps.solve(self._coupling.toarray(order="F"))
        self.left = -(self._coupling.T @ self._answer)

    def forward(self, b: Array) -> tuple[Array, Array]:
        alone = self._mumps.solve(b[self._inside])
        return alone, -(self._coupling.T @ alone)

    def backward(self, kept: Array, motion: Array, x: Array) -> None:
        x[self._inside] = kept - self._answer @ motion

    def close(self) -> None:
        self._mumps.close()


def _over_unknowns(part: Summand, columns: int) -> csr_matrix:
    first, column, value, weight, block = part
    shape = (len(first) - 1, columns // block)
    rows = csr_matrix((weight * value, column, first), shape)
    return rows if block == 1 else csr_matrix(kron(rows, eye_array(block), format="csr"))


class _Nothing:
    """Of a rank whose unknowns are all on cuts."""

    def __init__(self, touched: int) -> None:
        self.order, self.left = np.arange(touched), np.zeros((touched, touched))

    def forward(self, b: Array) -> tuple[None, Array]:
        return None, np.zeros((len(self.order), *b.shape[1:]))

    def backward(self, kept: None, motion: Array, x: Array) -> None:
        """Nothing is its own."""

    def close(self) -> None:
        """Nothing is held."""
