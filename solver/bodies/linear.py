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

from ..arrays import Array
from ..errors import ComputationError
from .cells import cell_product
from .chain import WIDEST, ChainFactor
from .cut import MOST_ON_CUTS, CutFactor
from .mumps import Krylov, Mumps

if TYPE_CHECKING:
    from .solid import SolidBody

# Numbers in a factor: 8 GB of them.
LARGEST_FACTOR = 1_000_000_000
# Nested dissection of a compact body of n unknowns leaves about this times n^(4/3) (measured on
# cubes of second order under MUMPS; the exponent is George's, SIAM J. Numer. Anal. 10, 1973).
COMPACT = 24.0
# Of a slender one it leaves about this times c^0.7 per unknown, a chain having c of them (measured
# on bars of second order of 2 to 10 cells' depth, within a tenth; length does not matter).
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

    CHAIN = "chain"
    CUT = "cut"
    MUMPS = "mumps"
    ITERATIVE = "iterative"


class LinearSolver(Protocol):
    """Solves for (n,) or (n, m) right-hand sides until ``close``."""

    def solve(self, b: Array) -> Array: ...

    def close(self) -> None: ...


def choose(
    solver: Solver, unknowns: int, chained: int, *, alone: bool = True, on_cuts: int = 0
) -> Method:
    """The method for a body whose factor as a chain has ``chained`` numbers, or about so many.

    A chain needs a body ``alone`` on its rank; ``on_cuts`` are the unknowns that ranks share.
    """
    if solver is Solver.ITERATIVE:
        return Method.ITERATIVE
    compact = COMPACT * unknowns ** (4.0 / 3.0)
    slender = SLENDER * unknowns * (chained / unknowns) ** 0.7
    if solver is Solver.AUTO and min(chained, compact, slender) > LARGEST_FACTOR:
        return Method.ITERATIVE
    if alone and chained <= WIDEST * unknowns:
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
    if method is Method.CUT:
        parts = solid.parts(c_mass, c_stiffness)
        return CutFactor(parts, solid.columns, solid.on_cuts, solid.heights_m, solid.comm)
    matrix = solid.effective_matrix(c_mass, c_stiffness)
    try:
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


class Iterative(Krylov):
    """Conjugate gradients to `TOLERANCE` in the energy norm.

    The preconditioner is the diagonal where inertia rules, else smoothed aggregation that is told
    the rigid motions (Vaněk, Mandel and Brezina, Computing 56, 1996). Products are taken cell by
    cell where cells are alike, see `cells`.
    """

    def __init__(
        self, matrix: PETSc.Mat, solid: SolidBody, c_mass: float, c_stiffness: float
    ) -> None:
        super().__init__(matrix)
        self.solver.setType(PETSc.KSP.Type.CG)
        self.solver.setNormType(PETSc.KSP.NormType.NATURAL)
        self.solver.setTolerances(rtol=TOLERANCE, atol=0.0, max_it=ITERATIONS)
        product = cell_product(solid, c_mass, c_stiffness)
        self._operator = None if product is None else product.as_matrix(matrix)
        if self._operator is not None:
            self.solver.setOperators(self._operator, matrix)
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

    def close(self) -> None:
        super().close()
        if self._operator is not None:
            self._operator.destroy()

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
