"""Direct solvers of PETSc: CHOLMOD on one rank, MUMPS on several and where pivots are needed."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from ..arrays import Array
from ..errors import ComputationError


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
    right = dense(solver.comm, b)
    solution = right.duplicate()
    solver.matSolve(right, solution)
    x = solution.getDenseArray().copy(order="F")
    right.destroy()
    solution.destroy()
    return x


def dense(comm: PETSc.Comm, x: Array) -> PETSc.Mat:
    """A PETSc copy of this rank's rows ``x`` (n_local, m)."""
    matrix = PETSc.Mat().createDense(((len(x), None), (None, x.shape[1])), comm=comm)
    matrix.setUp()
    matrix.getDenseArray()[:] = x
    matrix.assemble()
    return matrix
