"""The bristle as a 3-D solid: dolfinx Lagrange hexahedra or tetrahedra and their matrices."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cached_property

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py import PETSc
from scipy.sparse import csr_matrix

from ..arrays import Array
from ..bristle import CONTACT_POINTS, Material
from ..errors import require
from ..form_cache import form
from ..forms import Elasticity, cells_of
from .linear import Cholesky, Iterative, Solver, choose, make_solver
from .matrices import NodeMass, assembled_rows, petsc_matrix
from .tip import tip_contact

# Decimals of a height in m to which nodes of one layer agree.
DECIMALS = 9
# Vectors that are multiplied together, so that the stiffness is read once.
TOGETHER = 16


class SolidBody:
    """Linear elastic solid of hexahedra or tetrahedra, its axis along z, its tip facets tagged.

    ``order`` is the polynomial degree, 1 or 2; for ``points`` see `tip_contact`, for ``solver``
    `linear.choose`. Matrices are distributed over the mesh's communicator; vectors are this rank's
    unknowns. ``factorisations`` counts the factors made. ``close`` frees what PETSc holds.
    """

    name = "solid"

    def __init__(
        self,
        domain: mesh.Mesh,
        facet_tags: mesh.MeshTags,
        tip_tag: int,
        material: Material,
        order: int = 2,
        points: int = CONTACT_POINTS,
        solver: Solver = Solver.AUTO,
    ) -> None:
        self.domain, self.facet_tags, self.tip_tag = domain, facet_tags, tip_tag
        self.material, self.order, self.solver = material, order, solver
        self.alpha_1_s, self.beta_s = material.alpha_1_s, material.beta_s
        self.comm = domain.comm
        self.space = fem.functionspace(domain, ("Lagrange", order, (3,)))
        index_map, block = self.space.dofmap.index_map, self.space.dofmap.index_map_bs
        self.n_local = index_map.size_local * block
        self.n_dofs = index_map.size_global * block
        self.factorisations = 0
        self._solvers: dict[tuple[float, bool], Cholesky | Iterative] = {}
        self._elasticity = Elasticity.of(material, domain)
        self._assemble()
        self.translation = np.tile(np.eye(3), (self.n_local // 3, 1))
        weight = self.mass(np.ascontiguousarray(self.translation[:, 2]))
        self.mass_kg = self.dot(self.translation[:, 2], weight)
        self.centre_m = self._centre(weight[2::3])
        normal = ufl.FacetNormal(domain)
        self.contact, self.tip = tip_contact(
            self.space,
            facet_tags.find(tip_tag),
            lambda u: self._elasticity.traction(u, normal),
            self.centre_m,
            points,
        )

    def _assemble(self) -> None:
        u, v = ufl.TrialFunction(self.space), ufl.TestFunction(self.space)
        hooke = self._elasticity
        work = ufl.inner(hooke.stress(hooke.strain(u)), hooke.strain(v))
        energy = form(work * cells_of(self.space))
        self._rows, self._columns = assembled_rows(energy)
        first, column, value = self._rows
        count = self._columns.size_local + self._columns.num_ghosts
        self._stiffness = csr_matrix((value, column, first), (self.n_local, count))
        self.columns = self._columns.local_to_global(np.arange(count, dtype=np.int32))
        self.node_mass = NodeMass(self.space, self.material.density_kg_m3)
        nodes = self.node_mass.columns
        own = np.arange(nodes.size_local + nodes.num_ghosts, dtype=np.int32)
        same = np.array_equal(self.columns[::3], 3 * nodes.local_to_global(own))
        require(self.comm, same, "dolfinx numbers the columns of stiffness and of mass apart")

    @cached_property
    def stiffness_matrix(self) -> PETSc.Mat:
        """K for PETSc and SLEPc."""
        return petsc_matrix(self._rows, self._columns, self.comm)

    @cached_property
    def mass_matrix(self) -> PETSc.Mat:
        """M over all unknowns, for PETSc and SLEPc."""
        return self.node_mass.vector_matrix()

    def mass(self, x: Array) -> Array:
        return self.node_mass.times(x)

    def stiffness(self, x: Array) -> Array:
        if x.ndim == 1:
            return np.asarray(self._stiffness @ self.node_mass.with_others(x))
        y = np.empty(x.shape, order="F")
        for k in range(0, x.shape[1], TOGETHER):
            part = x[:, k : k + TOGETHER]
            values = np.empty((len(self.columns), part.shape[1]))
            for i in range(part.shape[1]):
                values[:, i] = self.node_mass.with_others(part[:, i])
            y[:, k : k + TOGETHER] = self._stiffness @ values
        return y

    @cached_property
    def layers_m(self) -> Array:
        """Heights in m of the layers of nodes on all ranks, to `DECIMALS`."""
        own = np.unique(np.round(self.places_m[:, 2], DECIMALS))
        return np.unique(np.concatenate(self.comm.allgather(own)))

    @cached_property
    def method(self) -> Solver:
        """The solver for effective matrices."""
        return choose(self.solver, self.n_dofs, len(self.layers_m), self.order)

    @cached_property
    def stiffest_1_s2(self) -> float:
        """The greatest ratio of the diagonals of K and M."""
        ratio = self.stiffness_matrix.getDiagonal().array / self.mass_matrix.getDiagonal().array
        return float(self.comm.allreduce(ratio.max(initial=0.0), MPI.MAX))

    def factor(self, c_mass: float, c_stiffness: float) -> Callable[[Array], Array]:
        """A solver of (c_mass M + c_stiffness K) x = b for (n,) or (n, m), see `linear`.

        Pairs with the same ratio share one factor, kept until ``release_factors``. Raises
        ComputationError if it cannot be made.
        """
        stiff = c_stiffness > 0.0
        ratio, scale = (c_mass / c_stiffness, c_stiffness) if stiff else (1.0, c_mass)
        key = (float(f"{ratio:.12e}"), stiff)
        if key not in self._solvers:
            self._solvers[key] = make_solver(self, self.method, ratio, 1.0 if stiff else 0.0)
            self.factorisations += 1
        solver = self._solvers[key]

        def solve(b: Array) -> Array:
            x = solver.solve(b)
            x /= scale
            return x

        return solve

    def effective_matrix(self, c_mass: float, c_stiffness: float) -> PETSc.Mat:
        """A new matrix c_mass M + c_stiffness K."""
        matrix = self.stiffness_matrix.copy()
        matrix.scale(c_stiffness)
        mass = self.node_mass.vector_matrix()
        matrix.axpy(c_mass, mass, structure=PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        mass.destroy()
        matrix.setOption(PETSc.Mat.Option.SPD, True)
        return matrix

    def release_factors(self) -> None:
        """Free every factor made so far; solvers handed out before must not be used again."""
        for solver in self._solvers.values():
            solver.close()
        self._solvers.clear()

    def close(self) -> None:
        """Free matrices, vectors and factors; the body cannot be used afterwards."""
        self.release_factors()
        for name in ("mass_matrix", "stiffness_matrix"):
            if name in self.__dict__:
                self.__dict__.pop(name).destroy()

    def digest(self) -> str:
        """Digest that identifies this rank's part of the mesh."""
        found = hashlib.sha256(f"order {self.order}".encode())
        for part in (self.domain.geometry.x, self.space.dofmap.list):
            found.update(np.ascontiguousarray(part).tobytes())
        return found.hexdigest()

    def dot(self, x: Array, y: Array) -> float:
        local = float(x @ y)
        return local if self.comm.size == 1 else float(self.comm.allreduce(local))

    def rigid_motions(self) -> Array:
        """Translations along x, y, z and rotations about them through the centre (n_local, 6)."""
        x = self.places_m - self.centre_m
        motions = np.zeros((len(x), 3, 6))
        motions[:, [0, 1, 2], [0, 1, 2]] = 1.0
        for axis in range(3):
            motions[:, :, 3 + axis] = np.cross(np.eye(3)[axis], x)
        return motions.reshape(self.n_local, 6)

    @property
    def places_m(self) -> Array:
        """Positions of this rank's nodes in the unstrained body (n_local / 3, 3)."""
        return np.asarray(self.space.tabulate_dof_coordinates()[: self.n_local // 3])

    def _centre(self, weight: Array) -> Array:
        """Centre of mass (3,), with ``weight`` the nodes' shares of the mass."""
        return np.asarray(self.comm.allreduce(weight @ self.places_m)) / self.mass_kg
