"""Linear solvers of a solid, by PETSc: its effective matrix c_M M + c_K K, and its tangent.

A march solves with one matrix hundreds of times, so it is factored wherever the factor fits into
memory; beyond `LARGEST_FACTOR` conjugate gradients take over. A tangent of finite strain, which
needs pivots, is MUMPS' to factor.

Cholesky's factor is CHOLMOD's on one rank and MUMPS' on several. A solve of 54 675 unknowns of a
bristle takes CHOLMOD 13 ms, MUMPS 18, a block factorisation along its axis written for the purpose
7, and LAPACK's banded Cholesky of 15 255 unknowns 4.0 ms where CHOLMOD takes 1.9: none makes a
whole drop or sweep 1.5 times faster than these two.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Protocol

import numpy as np
from petsc4py import PETSc

from ..arrays import Array
from ..errors import ComputationError

# Numbers in a factor. A leaning bristle keeps three, which then take 8 GB.
LARGEST_FACTOR = 330_000_000
# Nested dissection of a compact body of n unknowns leaves about this times n^(4/3) (measured on
# cubes of second order under MUMPS; the exponent is George's, SIAM J. Numer. Anal. 10, 1973).
COMPACT = 24.0
# Of a slender one it leaves about this times w^0.7 per unknown, w being the unknowns of so many
# layers of nodes as 1 + order / 2 (measured on bars of second order of 2 to 10 cells' depth, within
# a tenth; length does not matter).
SLENDER = 3.0
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


def choose(solver: Solver, unknowns: int, layers: int, order: int) -> Solver:
    """What serves a body of ``unknowns`` on ``layers`` of nodes along its axis, never ``AUTO``."""
    if solver is not Solver.AUTO:
        return solver
    compact = COMPACT * unknowns ** (4.0 / 3.0)
    slender = SLENDER * unknowns * ((1.0 + 0.5 * order) * unknowns / layers) ** 0.7
    return Solver.DIRECT if min(compact, slender) <= LARGEST_FACTOR else Solver.ITERATIVE


class Solid(Protocol):
    """What a solver wants to know of a solid."""

    @property
    def stiffest_1_s2(self) -> float:
        """The greatest ratio of the diagonals of K and M."""

    @property
    def places_m(self) -> Array:
        """Where this rank's nodes are (n, 3)."""

    def effective_matrix(self, c_mass: float, c_stiffness: float) -> PETSc.Mat:
        """c_mass M + c_stiffness K as a matrix of its own."""


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
    """Cholesky factor of a positive definite matrix, which itself is not needed afterwards."""

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
        """Numbers in the factor; MUMPS counts in millions where there are many (INFOG(29))."""
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
    """Have ``solver`` do with a factor of this kind by this package, and nothing else."""
    solver.setType(PETSc.KSP.Type.PREONLY)
    solver.getPC().setType(kind)
    solver.getPC().setFactorSolverType(package)


def factor(solver: PETSc.KSP, what: str) -> None:
    """Make the factor; ComputationError that says of ``what``, where that fails."""
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

    The preconditioner is the diagonal where inertia rules; where the matrix is ``stiff``, smoothed
    aggregation that is told the rigid motions (Vaněk, Mandel and Brezina, Computing 56, 1996).
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
        """Of the last solve."""
        return int(self.solver.getIterationNumber())

    def solve(self, b: Array) -> Array:
        """x for (n,) or (n, m); ComputationError where the iteration does not arrive."""
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
