"""Solvers of a solid's effective matrix c_M M + c_K K: a Cholesky factor, or conjugate gradients.

A march solves with one matrix hundreds of times, so it is factored wherever the factor fits into
memory; beyond `LARGEST_FACTOR` conjugate gradients take over.

The factor is CHOLMOD's on one rank and MUMPS' on several. A solve of 54 675 unknowns of a bristle
takes CHOLMOD 13 ms, MUMPS 18, a block factorisation along its axis written for the purpose 7, and
LAPACK's banded Cholesky of 15 255 unknowns 4.0 ms where CHOLMOD takes 1.9: none makes a whole drop
or sweep 1.5 times faster than these two.
"""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Protocol

import numpy as np
from petsc4py import PETSc

from ..arrays import Array
from ..errors import ComputationError
from .direct import Cholesky

if TYPE_CHECKING:
    from .solid import SolidBody

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


class Method(StrEnum):
    """What comes of it."""

    DIRECT = "direct"
    ITERATIVE = "iterative"


class LinearSolver(Protocol):
    """Solves for (n,) or (n, m) right-hand sides until ``close``."""

    def solve(self, b: Array) -> Array: ...

    def close(self) -> None: ...


def choose(solver: Solver, unknowns: int, layers: int, order: int) -> Method:
    """The method for a body of ``unknowns`` on ``layers`` of nodes along its axis."""
    if solver is not Solver.AUTO:
        return Method.DIRECT if solver is Solver.DIRECT else Method.ITERATIVE
    compact = COMPACT * unknowns ** (4.0 / 3.0)
    slender = SLENDER * unknowns * ((1.0 + 0.5 * order) * unknowns / layers) ** 0.7
    return Method.DIRECT if min(compact, slender) <= LARGEST_FACTOR else Method.ITERATIVE


def make_solver(
    solid: SolidBody, method: Method, c_mass: float, c_stiffness: float
) -> LinearSolver:
    """A solver of c_mass M + c_stiffness K. Collective; raises ComputationError."""
    matrix = solid.effective_matrix(c_mass, c_stiffness)
    try:
        if method is Method.DIRECT:
            return Cholesky(matrix)
        return Iterative(matrix, solid, stiff=c_stiffness * solid.stiffest_1_s2 > DIAGONAL * c_mass)
    finally:
        matrix.destroy()


class Iterative:
    """Conjugate gradients to `TOLERANCE` in the energy norm.

    The preconditioner is the diagonal where inertia rules; where the matrix is ``stiff``, smoothed
    aggregation that is told the rigid motions (Vaněk, Mandel and Brezina, Computing 56, 1996).
    """

    def __init__(self, matrix: PETSc.Mat, solid: SolidBody, *, stiff: bool) -> None:
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
                f"(PETSc's reason {reason}); take --solver direct"
            )
        return np.array(self._left.array)

    def close(self) -> None:
        """Free what PETSc holds."""
        for thing in (self.solver, self._right, self._left):
            thing.destroy()


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
