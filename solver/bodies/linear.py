"""Which solver takes a solid's effective matrix c_M M + c_K K, and how?

One factor is dear to make and cheap to use, and a march uses it hundreds of times, so a factor is
taken wherever it fits. Of a slender body alone on its rank it is a chain of slices (bodies.chain);
where ranks cut a body across, each factors its part (bodies.cut); else MUMPS makes it. Where it
would be too large, conjugate gradients take over.
"""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Protocol

import numpy as np
from petsc4py import PETSc

from ..errors import ComputationError
from .base import Array
from .chain import WIDEST, ChainFactor
from .cut import MOST_ON_CUTS, CutFactor

if TYPE_CHECKING:
    from .solid import SolidBody

# Numbers in a factor: 8 GB of them.
LARGEST_FACTOR = 1_000_000_000
# Nested dissection of a compact body of n unknowns leaves about this times n^(4/3) (measured on
# cubes of second order under MUMPS; the exponent is George's, SIAM J. Numer. Anal. 10, 1973).
COMPACT = 24.0
# Largest c_K K_ii / c_M M_ii up to which the diagonal alone is the better preconditioner: it then
# needs no more than a hundred iterations, each a fifth of one under multigrid.
DIAGONAL = 100.0
# Of the energy norm. A residual r changes the energy norm of a step by at most h/√2 √(rᵀA⁻¹r), so
# a thousand steps stay within 1e-6, to which budgets are held to close.
TOLERANCE = 1e-9
ITERATIONS = 5000


class Solver(StrEnum):
    """What a user can ask for; ``AUTO`` is direct up to `LARGEST_FACTOR`."""

    AUTO = "auto"
    DIRECT = "direct"
    ITERATIVE = "iterative"


class Method(StrEnum):
    """What comes of it."""

    CHAIN = "chain"
    CUT = "cut"
    MUMPS = "mumps"
    ITERATIVE = "iterative"


class LinearSolver(Protocol):
    """Solves for (n,) or (n, m) right-hand sides until ``close``."""

    def solve(self, b: Array) -> Array: ...

    def close(self) -> None: ...


def choose(solver: Solver, unknowns: int, chained: int | None, on_cuts: int = 0) -> Method:
    """The method for a body whose factor as a chain has ``chained`` numbers, None for no chain.

    A chain needs a body alone on its rank. Its size bounds any factor's from above. ``on_cuts`` are
    the unknowns that ranks share.
    """
    if solver is Solver.ITERATIVE:
        return Method.ITERATIVE
    compact = COMPACT * unknowns ** (4.0 / 3.0)
    least = compact if chained is None else min(chained, compact)
    if solver is Solver.AUTO and least > LARGEST_FACTOR:
        return Method.ITERATIVE
    if chained is not None and chained <= WIDEST * unknowns:
        return Method.CHAIN
    if 0 < on_cuts <= MOST_ON_CUTS:
        return Method.CUT
    return Method.MUMPS


def make_solver(
    solid: SolidBody, method: Method, c_mass: float, c_stiffness: float
) -> LinearSolver:
    """A solver of c_mass M + c_stiffness K. Collective; raises ComputationError."""
    if method is Method.CHAIN:
        layout = solid.layout
        assert layout is not None
        return Chain(ChainFactor(layout, solid.parts(c_mass, c_stiffness)))
    matrix = solid.effective_matrix(c_mass, c_stiffness)
    try:
        if method is Method.CUT:
            return CutFactor(matrix, solid.on_cuts, solid.heights_m, solid.comm)
        if method is Method.MUMPS:
            return Mumps(matrix)
        return Iterative(matrix, solid, c_mass, c_stiffness)
    finally:
        matrix.destroy()


class Chain:
    """A `ChainFactor` as a LinearSolver."""

    def __init__(self, factor: ChainFactor) -> None:
        self.factor = factor

    def solve(self, b: Array) -> Array:
        return self.factor.solve(b)

    def close(self) -> None:
        """Memory goes with the last reference."""


class Krylov:
    """What solvers of PETSc share."""

    def __init__(self, matrix: PETSc.Mat) -> None:
        self.comm, self.n_local = matrix.comm, matrix.getLocalSize()[0]
        self.solver = PETSc.KSP().create(matrix.comm)
        self.solver.setOperators(matrix)
        self._right, self._left = matrix.createVecs()

    def solve(self, b: Array) -> Array:
        if b.ndim == 2:
            return self._solve_block(b)
        self._right.array[:] = b
        self.solver.solve(self._right, self._left)
        self._check()
        return np.array(self._left.array)

    def _solve_block(self, b: Array) -> Array:
        x = np.empty(b.shape, order="F")
        for k in range(b.shape[1]):
            x[:, k] = self.solve(b[:, k])
        return x

    def _check(self) -> None:
        """Raise ComputationError where the last solve failed."""

    def close(self) -> None:
        """Free what PETSc holds."""
        for thing in (self.solver, self._right, self._left):
            thing.destroy()


class Mumps(Krylov):
    """Cholesky factor of a positive definite matrix by MUMPS, on any number of ranks."""

    def __init__(self, matrix: PETSc.Mat) -> None:
        super().__init__(matrix)
        self.solver.setType(PETSc.KSP.Type.PREONLY)
        preconditioner = self.solver.getPC()
        preconditioner.setType(PETSc.PC.Type.CHOLESKY)
        preconditioner.setFactorSolverType("mumps")
        try:
            self.solver.setUp()
        except PETSc.Error as error:
            raise ComputationError(
                f"MUMPS could not factor the effective matrix: {error}"
            ) from error
        status = preconditioner.getFactorMatrix().getMumpsInfog(1)
        if status < 0:
            raise ComputationError(
                f"MUMPS could not factor the effective matrix: INFOG(1) = {status}"
            )

    @property
    def entries(self) -> int:
        """Numbers in the factor; MUMPS counts in millions where there are many (INFOG(29))."""
        count = self.solver.getPC().getFactorMatrix().getMumpsInfog(29)
        return int(count) if count >= 0 else -1_000_000 * int(count)

    def _solve_block(self, b: Array) -> Array:
        """All columns at once: several times faster than one by one."""
        right = dense(self.comm, b)
        left = right.duplicate()
        self.solver.matSolve(right, left)
        x = left.getDenseArray().copy(order="F")
        right.destroy()
        left.destroy()
        return x


class Iterative(Krylov):
    """Conjugate gradients to `TOLERANCE` in the energy norm.

    The preconditioner is the diagonal where inertia rules, else smoothed aggregation that is told
    the rigid motions (Vaněk, Mandel and Brezina, Computing 56, 1996).
    """

    def __init__(
        self, matrix: PETSc.Mat, solid: SolidBody, c_mass: float, c_stiffness: float
    ) -> None:
        super().__init__(matrix)
        self.solver.setType(PETSc.KSP.Type.CG)
        self.solver.setNormType(PETSc.KSP.NormType.NATURAL)
        self.solver.setTolerances(rtol=TOLERANCE, atol=0.0, max_it=ITERATIONS)
        preconditioner = self.solver.getPC()
        if c_stiffness * solid.stiffest_1_s2 <= DIAGONAL * c_mass:
            preconditioner.setType(PETSc.PC.Type.JACOBI)
        else:
            preconditioner.setType(PETSc.PC.Type.GAMG)
            motions = _orthonormal(solid, matrix)
            near = PETSc.NullSpace().create(vectors=motions, comm=matrix.comm)
            matrix.setNearNullSpace(near)
            self.solver.setUp()
            near.destroy()
            for motion in motions:
                motion.destroy()

    @property
    def iterations(self) -> int:
        """Of the last solve."""
        return int(self.solver.getIterationNumber())

    def _check(self) -> None:
        reason = self.solver.getConvergedReason()
        if reason < 0:
            raise ComputationError(
                f"conjugate gradients ended without an answer after {self.iterations} iterations "
                f"(PETSc's reason {reason}); take --solver direct"
            )


def _orthonormal(solid: SolidBody, matrix: PETSc.Mat) -> list[PETSc.Vec]:
    """The rigid motions as vectors of which PETSc asks that they be orthonormal."""
    motions = solid.rigid_motions()
    gram = motions.T @ motions
    if solid.comm.size > 1:
        gram = solid.comm.allreduce(gram)
    motions = np.linalg.solve(np.linalg.cholesky(gram), motions.T)
    vectors = []
    for motion in motions:
        vector = matrix.createVecRight()
        vector.array[:] = motion
        vectors.append(vector)
    return vectors


def dense(comm: PETSc.Comm, x: Array) -> PETSc.Mat:
    """A PETSc copy of this rank's rows ``x`` (n_local, m)."""
    matrix = PETSc.Mat().createDense(((len(x), None), (None, x.shape[1])), comm=comm)
    matrix.setUp()
    matrix.getDenseArray()[:] = x
    matrix.assemble()
    return matrix
