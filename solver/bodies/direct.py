"""Direct solvers of PETSc: CHOLMOD on one rank, MUMPS on several and where pivots are needed."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from ..arrays import Array
from ..errors import ComputationError


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


class Cholesky(Krylov):
    """Cholesky factor of a positive definite matrix."""

    def __init__(self, matrix: PETSc.Mat) -> None:
        super().__init__(matrix)
        package = "cholmod" if self.comm.size == 1 else "mumps"
        take_direct(self.solver, PETSc.PC.Type.CHOLESKY, package)
        factor(self.solver, "the effective matrix")

    @property
    def entries(self) -> int:
        """Numbers in the factor; MUMPS counts in millions where there are many (INFOG(29))."""
        found = self.solver.getPC().getFactorMatrix()
        if self.comm.size == 1:
            return int(found.getInfo()["nz_used"])
        count = found.getMumpsInfog(29)
        return int(count) if count >= 0 else -1_000_000 * int(count)

    def _solve_block(self, b: Array) -> Array:
        """All columns at once: several times faster than one by one."""
        return solve_columns(self.solver, b)


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


def solve_columns(solver: PETSc.KSP, b: Array) -> Array:
    """Solutions (n_local, m) for all columns of ``b`` at once."""
    right = dense(solver.comm, b)
    left = right.duplicate()
    solver.matSolve(right, left)
    x = left.getDenseArray().copy(order="F")
    right.destroy()
    left.destroy()
    return x


def dense(comm: PETSc.Comm, x: Array) -> PETSc.Mat:
    """A PETSc copy of this rank's rows ``x`` (n_local, m)."""
    matrix = PETSc.Mat().createDense(((len(x), None), (None, x.shape[1])), comm=comm)
    matrix.setUp()
    matrix.getDenseArray()[:] = x
    matrix.assemble()
    return matrix
