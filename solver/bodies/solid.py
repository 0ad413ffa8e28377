"""The bristle as a 3-D solid: dolfinx Lagrange hexahedra, PETSc matrices, one MUMPS factor."""

from __future__ import annotations

import hashlib
from collections.abc import Callable

import numpy as np
import ufl
from dolfinx import fem, mesh
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray
from petsc4py import PETSc

from ..bristle import CONTACT_POINTS, Material
from ..errors import ComputationError
from ..forms import form
from .base import Array
from .cut import MOST_ON_CUTS, CutFactor
from .tip import tip_contact


def stress(u: ufl.core.expr.Expr, material: Material) -> ufl.core.expr.Expr:
    """Cauchy stress of small strain, isotropic. The material is data of the form, not part of it:
    one compiled form serves all."""
    domain = ufl.domain.extract_unique_domain(u)
    lam, mu = (fem.Constant(domain, PETSc.ScalarType(value)) for value in material.lame_Pa)
    strain = ufl.sym(ufl.grad(u))
    return lam * ufl.tr(strain) * ufl.Identity(3) + 2.0 * mu * strain


class SolidBody:
    """Linear elastic solid on a hexahedral mesh, its axis along z, its tip facets tagged.

    ``order`` is the polynomial degree, 1 or 2; ``points`` see `tip_contact`. Matrices are
    distributed over the mesh's communicator; vectors are this rank's owned unknowns. Forms take
    their quadrature degree from
    the degree of their integrand on straight cells. ``close`` frees what PETSc holds.
    """

    name = "solid"
    defect = None

    def __init__(
        self,
        domain: mesh.Mesh,
        facet_tags: mesh.MeshTags,
        tip_tag: int,
        material: Material,
        order: int = 2,
        points: int = CONTACT_POINTS,
    ) -> None:
        self.domain, self.facet_tags, self.tip_tag = domain, facet_tags, tip_tag
        self.material, self.order = material, order
        self.alpha_1_s, self.beta_s = material.alpha_1_s, material.beta_s
        self.comm = domain.comm
        self.space = fem.functionspace(domain, ("Lagrange", order, (3,)))
        index_map, block = self.space.dofmap.index_map, self.space.dofmap.index_map_bs
        self.n_local = index_map.size_local * block
        self.n_dofs = index_map.size_global * block
        self._solvers: dict[tuple[float, bool], PETSc.KSP | CutFactor] = {}
        self._on_cuts = self._shared()
        self._assemble()
        self._x, self._y = self.stiffness_matrix.createVecs()
        self.translation = np.tile(np.eye(3), (self.n_local // 3, 1))
        weight = self.mass(np.ascontiguousarray(self.translation[:, 2]))
        self.mass_kg = self.dot(self.translation[:, 2], weight)
        self.centre_m = self._centre(weight[2::3])
        self.contact = tip_contact(
            self.space, facet_tags.find(tip_tag), material, self.centre_m, points
        )

    def _assemble(self) -> None:
        u, v = ufl.TrialFunction(self.space), ufl.TestFunction(self.space)
        # products of shape functions reach twice the degree along each axis, and the geometry's
        # Jacobian adds to that on curved cells only
        degree = 2 * self.order + 2 * (self.domain.geometry.cmap.degree - 1)
        dx = ufl.Measure("dx", domain=self.domain, metadata={"quadrature_degree": degree})
        density = fem.Constant(self.domain, PETSc.ScalarType(self.material.density_kg_m3))
        form_k = form(ufl.inner(stress(u, self.material), ufl.sym(ufl.grad(v))) * dx)
        form_m = form(density * ufl.inner(u, v) * dx)
        self.stiffness_matrix = fem_petsc.assemble_matrix(form_k)
        self.stiffness_matrix.assemble()
        full = fem_petsc.assemble_matrix(form_m)
        full.assemble()
        self.mass_matrix = without_zeros(full)
        full.destroy()

    def mass(self, x: Array) -> Array:
        return self._product(self.mass_matrix, x)

    def stiffness(self, x: Array) -> Array:
        return self._product(self.stiffness_matrix, x)

    def _product(self, matrix: PETSc.Mat, x: Array) -> Array:
        if x.ndim == 2:
            dense = self._dense(x)
            result = matrix.matMult(dense)
            y = result.getDenseArray().copy(order="F")
            dense.destroy()
            result.destroy()
            return y
        self._x.array[:] = x
        matrix.mult(self._x, self._y)
        return self._y.array.copy()

    def factor(self, c_mass: float, c_stiffness: float) -> Callable[[Array], Array]:
        """Cholesky factor of c_mass M + c_stiffness K by MUMPS; solves for (n,) or (n, m).

        Pairs with the same ratio share one factor, kept until ``release_factors``. Raises
        ComputationError where MUMPS fails.
        """
        stiff = c_stiffness > 0.0
        ratio, scale = (c_mass / c_stiffness, c_stiffness) if stiff else (1.0, c_mass)
        key = (float(f"{ratio:.12e}"), stiff)
        if key not in self._solvers:
            self._solvers[key] = self._factored(ratio, 1.0 if stiff else 0.0)
        made = self._solvers[key]
        if isinstance(made, CutFactor):
            return lambda b: made.solve(b) / scale
        solver: PETSc.KSP = made
        right, left = self._x.duplicate(), self._x.duplicate()

        def solve(b: Array) -> Array:
            if b.ndim == 2:
                return self._solve_block(solver, b) / scale
            right.array[:] = b
            solver.solve(right, left)
            return left.array / scale

        return solve

    def _solve_block(self, solver: PETSc.KSP, b: Array) -> Array:
        """All columns of ``b`` (n, m) at once: several times faster than one by one."""
        right = self._dense(b)
        left = right.duplicate()
        solver.matSolve(right, left)
        x = left.getDenseArray().copy(order="F")
        right.destroy()
        left.destroy()
        return x

    def _dense(self, x: Array) -> PETSc.Mat:
        """A PETSc copy of this rank's rows ``x`` (n_local, m)."""
        dense = PETSc.Mat().createDense(((self.n_local, None), (None, x.shape[1])), comm=self.comm)
        dense.setUp()
        dense.getDenseArray()[:] = x
        dense.assemble()
        return dense

    def _shared(self) -> NDArray[np.bool_]:
        """Which of this rank's unknowns (n_local,) a cell of another rank has too."""
        index_map, block = self.space.dofmap.index_map, self.space.dofmap.index_map_bs
        others = index_map.index_to_dest_ranks()
        return np.repeat(np.diff(others.offsets)[: index_map.size_local] > 0, block)

    def _factored(self, c_mass: float, c_stiffness: float) -> PETSc.KSP | CutFactor:
        matrix = self.stiffness_matrix.copy()
        matrix.scale(c_stiffness)
        matrix.axpy(c_mass, self.mass_matrix, structure=PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        n_cuts = self.comm.allreduce(int(self._on_cuts.sum()))
        if 0 < n_cuts <= MOST_ON_CUTS:
            cut = CutFactor(matrix, self._on_cuts, self.comm)
            matrix.destroy()
            return cut
        matrix.setOption(PETSc.Mat.Option.SPD, True)
        solver = PETSc.KSP().create(self.comm)
        solver.setOperators(matrix)
        solver.setType(PETSc.KSP.Type.PREONLY)
        preconditioner = solver.getPC()
        preconditioner.setType(PETSc.PC.Type.CHOLESKY)
        preconditioner.setFactorSolverType("mumps")
        try:
            solver.setUp()
        except PETSc.Error as error:
            raise ComputationError(
                f"MUMPS could not factor the effective matrix: {error}"
            ) from error
        status = preconditioner.getFactorMatrix().getMumpsInfog(1)
        if status < 0:
            raise ComputationError(
                f"MUMPS could not factor the effective matrix: INFOG(1) = {status}"
            )
        matrix.destroy()
        return solver

    def release_factors(self) -> None:
        """Free every factor made so far; solvers handed out before must not be used again."""
        for solver in self._solvers.values():
            solver.destroy()
        self._solvers.clear()

    def close(self) -> None:
        """Free matrices, vectors and factors; the body cannot be used afterwards."""
        self.release_factors()
        for thing in (self.stiffness_matrix, self.mass_matrix, self._x, self._y):
            thing.destroy()

    def digest(self) -> str:
        """What tells this rank's part of the mesh from others."""
        found = hashlib.sha256(f"order {self.order}".encode())
        for part in (self.domain.geometry.x, self.space.dofmap.list):
            found.update(np.ascontiguousarray(part).tobytes())
        return found.hexdigest()

    def dot(self, x: Array, y: Array) -> float:
        local = float(x @ y)
        return local if self.comm.size == 1 else float(self.comm.allreduce(local))

    def rigid_motions(self) -> Array:
        """Translations along x, y, z and rotations about them through the centre (n_local, 6)."""
        x = self._coordinates() - self.centre_m
        motions = np.zeros((len(x), 3, 6))
        motions[:, [0, 1, 2], [0, 1, 2]] = 1.0
        for axis in range(3):
            motions[:, :, 3 + axis] = np.cross(np.eye(3)[axis], x)
        return motions.reshape(self.n_local, 6)

    def _coordinates(self) -> Array:
        return np.asarray(self.space.tabulate_dof_coordinates()[: self.n_local // 3])

    def _centre(self, weight: Array) -> Array:
        """Centre of mass (3,), the nodes' shares of the mass being ``weight``."""
        return np.asarray(self.comm.allreduce(weight @ self._coordinates())) / self.mass_kg


def without_zeros(matrix: PETSc.Mat) -> PETSc.Mat:
    """A copy that stores no zeros: a vector mass matrix couples no two directions."""
    start, column, value = matrix.getValuesCSR()
    keep = value != 0.0
    counts = np.add.reduceat(np.append(keep, False), start[:-1]) * (np.diff(start) > 0)
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(PETSc.IntType)
    return PETSc.Mat().createAIJ(
        matrix.getSizes(), csr=(offsets, column[keep], value[keep]), comm=matrix.comm
    )
