"""Linear solvers of a solid, by PETSc: effective matrix c_M M + c_K K, and tangent.

A march solves with one matrix hundreds of times, so it is factored if the factor fits into memory.
Beyond `LARGEST_FACTOR` conjugate gradients take over. The tangent at finite strain needs pivoting,
and MUMPS factors it.

The Cholesky factor is CHOLMOD's on one rank and MUMPS' on several. A solve of 54 675 unknowns of a
bristle takes CHOLMOD 13 ms, MUMPS 18, and a purpose-written block factorisation along its axis 7.
Banded Cholesky by LAPACK of 15 255 unknowns takes 4.0 ms, CHOLMOD 1.9. None makes a whole drop or
sweep 1.5 times faster than these two.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Protocol

import numpy as np
from petsc4py import PETSc

from ..arrays import Array
from ..errors import ComputationError

# Entries of the largest factor. A leaning bristle keeps three, which then take 8 GB.
LARGEST_FACTOR = 330_000_000
# Entries in a factor by nested dissection of a compact body, over n^(4/3) for n unknowns (measured
# on cubes of second order under MUMPS; the exponent is George's, SIAM J. Numer. Anal. 10, 1973).
COMPACT = 24.0
# The same per unknown of a slender body, over w^0.7 with w the unknowns in 1 + order / 2 layers of
# nodes (measured within a tenth on bars of second order, 2 to 10 cells deep; length does not
# matter).
SLENDER = 3.0
# Largest c_K K_ii / c_M M_ii at which the diagonal alone is the better preconditioner: up to a
# hundred iterations, each a fifth of one with multigrid.
DIAGONAL = 100.0
# Tolerance in the energy norm. A residual r changes a step's energy norm by at most h/√2 √(rᵀA⁻¹r),
# so a thousand steps stay within 1e-6, the tolerance of energy budgets.
TOLERANCE = 1e-9
ITERATIONS = 5000


class Solver(StrEnum):
    """Choices for the user; ``AUTO`` is direct up to `LARGEST_FACTOR`."""

    AUTO = "auto"
    DIRECT = "direct"
    ITERATIVE = "iterative"


def choose(solver: Solver, unknowns: int, layers: int, order: int) -> Solver:
    """The solver, never ``AUTO``, for ``unknowns`` on ``layers`` of nodes along the axis."""
    if solver is not Solver.AUTO:
        return solver
    compact = COMPACT * unknowns ** (4.0 / 3.0)
    slender = SLENDER * unknowns * ((1.0 + 0.5 * order) * unknowns / layers) ** 0.7
    return Solver.DIRECT if min(compact, slender) <= LARGEST_FACTOR else Solver.ITERATIVE


class Solid(Protocol):
    """Interface of a solid to its solvers."""

    @property
    def stiffest_1_s2(self) -> float:
        """The greatest ratio of the diagonals of K and M."""

    @property
    def places_m(self) -> Array:
        """Positions of this rank's nodes (n, 3)."""

    def effective_matrix(self, c_mass: float, c_stiffness: float) -> PETSc.Mat:
        """A new matrix c_mass M + c_stiffness K."""


def make_solver(
    solid: Solid, method: Solver, c_mass: float, c_stiffness: float
) -> Cholesky | Iterative:
    """A solver of c_mass M + c_stiffness K. Collective; raises ComputationError."""
    matrix = solid.effective_matrix(c_mass, c_stiffness)
    try:
        if method is Solver.DIRECT:
            return Cholesky(matrix)
        return Iterative(matrix, solid, stiff=c_stiffness * solid.stiffest_1_s2 > DIAGONAL * c_mass)
    finally:
        matrix.destroy()


class Cholesky:
    """Cholesky factor of a positive definite matrix, which may be destroyed afterwards."""

    def __init__(self, matrix: PETSc.Mat) -> None:
        self.comm = matrix.comm
        solver = PETSc.KSP().create(self.comm)
        solver.setOperators(matrix)
        package = "cholmod" if self.comm.size == 1 else "mumps"
        take_direct(solver, PETSc.PC.Type.CHOLESKY, package)
        try:
            factor(solver, "the effective matrix")
            self._factor = solver.getPC().getFactorMatrix()
        finally:
            solver.destroy()
        self._right, self._left = matrix.createVecs()

    @property
    def entries(self) -> int:
        """Number of entries in the factor; MUMPS counts large ones in millions (INFOG(29))."""
        if self.comm.size == 1:
            return int(self._factor.getInfo()["nz_used"])
        count = self._factor.getMumpsInfog(29)
        return int(count) if count >= 0 else -1_000_000 * int(count)

    def solve(self, b: Array) -> Array:
        """x for (n,) or all columns of (n, m) at once."""
        if b.ndim == 2:
            return solve_columns(self._factor, b)
        self._right.array[:] = b
        self._factor.solve(self._right, self._left)
        return np.array(self._left.array)

    def close(self) -> None:
        """Free what PETSc holds."""
        for thing in (self._factor, self._right, self._left):
            thing.destroy()


def take_direct(solver: PETSc.KSP, kind: PETSc.PC.Type, package: str = "mumps") -> None:
    """Set ``solver`` to a direct solve with a factor of this kind by this package."""
    solver.setType(PETSc.KSP.Type.PREONLY)
    solver.getPC().setType(kind)
    solver.getPC().setFactorSolverType(package)


def factor(solver: PETSc.KSP, what: str) -> None:
    """Compute the factor; ComputationError that names ``what`` if that fails."""
    preconditioner = solver.getPC()
    package = preconditioner.getFactorSolverType()
    try:
        solver.setUp()
    except PETSc.Error as error:
        raise ComputationError(f"{package.upper()} could not factor {what}: {error}") from error
    status = preconditioner.getFactorMatrix().getMumpsInfog(1) if package == "mumps" else 0
    if status < 0:
        raise ComputationError(f"MUMPS could not factor {what}: INFOG(1) = {status}")


def solve_columns(solver: PETSc.KSP | PETSc.Mat, b: Array) -> Array:
    """Solutions (n_local, m) for all columns of ``b`` at once, by a solver or a factor."""
    sizes = ((len(b), None), (None, b.shape[1]))
    right = PETSc.Mat().createDense(sizes, array=np.asfortranarray(b), comm=solver.comm)
    solution = right.duplicate()
    solver.matSolve(right, solution)
    x = solution.getDenseArray().copy(order="F")
    right.destroy()
    solution.destroy()
    return x


class Iterative:
    """Conjugate gradients to `TOLERANCE` in the energy norm.

    The preconditioner is the diagonal if inertia dominates. For a ``stiff`` matrix it is smoothed
    aggregation with the rigid motions (Vaněk, Mandel and Brezina, Computing 56, 1996).
    """

    def __init__(self, matrix: PETSc.Mat, solid: Solid, *, stiff: bool) -> None:
        self.solver = PETSc.KSP().create(matrix.comm)
        self.solver.setOperators(matrix)
        self._right, self._left = matrix.createVecs()
        self.solver.setType(PETSc.KSP.Type.CG)
        self.solver.setNormType(PETSc.KSP.NormType.NATURAL)
        self.solver.setTolerances(rtol=TOLERANCE, atol=0.0, max_it=ITERATIONS)
        preconditioner = self.solver.getPC()
        if not stiff:
            preconditioner.setType(PETSc.PC.Type.JACOBI)
        else:
            preconditioner.setType(PETSc.PC.Type.GAMG)
            self._right.array[:] = solid.places_m.ravel()
            near = PETSc.NullSpace().createRigidBody(self._right)
            matrix.setNearNullSpace(near)
            self.solver.setUp()
            near.destroy()

    @property
    def iterations(self) -> int:
        """Number of iterations of the last solve."""
        return int(self.solver.getIterationNumber())

    def solve(self, b: Array) -> Array:
        """x for (n,) or (n, m); ComputationError if the iteration does not converge."""
        if b.ndim == 2:
            x = np.empty(b.shape, order="F")
            for k in range(b.shape[1]):
                x[:, k] = self.solve(b[:, k])
            return x
        self._right.array[:] = b
        self.solver.solve(self._right, self._left)
        reason = self.solver.getConvergedReason()
        if reason < 0:
            raise ComputationError(
                f"conjugate gradients ended without an answer after {self.iterations} iterations "
                f"(PETSc's reason {reason}); take a direct solver",
                inputs=("solver",),
            )
        return np.array(self._left.array)

    def close(self) -> None:
        """Free what PETSc holds."""
        for thing in (self.solver, self._right, self._left):
            thing.destroy()
