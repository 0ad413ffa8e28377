"""The bristle at finite strain and rotation: forms, mid-step forces, tangent, energies, momenta."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import ufl
from dolfinx import fem, mesh
from dolfinx.fem import petsc as fem_petsc
from petsc4py import PETSc

from ..bodies.base import Array
from ..bodies.matrices import NodeMass
from ..bodies.mumps import factor, solve_columns, take_mumps
from ..bristle import Material
from ..errors import ComputationError
from ..forms import form


def green_strain(u: ufl.core.expr.Expr) -> ufl.core.expr.Expr:
    """Green and Lagrange's strain (∇u + ∇uᵀ + ∇uᵀ∇u)/2, free of the cancellation in FᵀF - I."""
    gradient = ufl.grad(u)
    return ufl.sym(gradient) + 0.5 * gradient.T * gradient


def stress(strain: ufl.core.expr.Expr, material: Material) -> ufl.core.expr.Expr:
    """Second Piola-Kirchhoff stress of St. Venant and Kirchhoff's material, C : E."""
    lam, mu = material.lame_Pa
    return lam * ufl.tr(strain) * ufl.Identity(3) + 2.0 * mu * strain


class FiniteSolid:
    """St. Venant-Kirchhoff solid in total Lagrangian form, on straight-edged hexahedra.

    Unknowns are a displacement ``u`` and its increment ``d`` over a step of ``its_s``; arrays hold
    the entries that this rank owns, in m, node by node. Internal forces are those at mid-step
    (Simo and Tarnow, ZAMP 43, 1992, Eq. 2.23 with the stress of Sect. 4): the mean strain of both
    ends, carried by the deformation gradient half way. Without damping that conserves linear and
    angular momentum, and energy. Stiffness-proportional damping is the objective stress
    beta C : (E1 - E0)/its, mass-proportional damping alpha M d/its; for small strain they are
    Rayleigh's. ``close`` frees what PETSc holds.

    Parameters: the mesh, its facet tags and the tip's tag (as SolidBody's), the material, and the
    polynomial ``order``, 1 or 2. Order 1 is far too stiff in bending with few cells.
    """

    def __init__(
        self,
        domain: mesh.Mesh,
        facet_tags: mesh.MeshTags,
        tip_tag: int,
        material: Material,
        order: int = 2,
    ) -> None:
        self.domain, self.facet_tags, self.tip_tag = domain, facet_tags, tip_tag
        self.material, self.order, self.comm = material, order, domain.comm
        self.space = fem.functionspace(domain, ("Lagrange", order, (3,)))
        index_map = self.space.dofmap.index_map
        self.n_local, self.n_dofs = 3 * index_map.size_local, 3 * index_map.size_global
        self._compile()
        self._x, self._y = self.mass_matrix.createVecs()
        self._solver: PETSc.KSP | None = None
        self.places_m = self.space.tabulate_dof_coordinates()[: index_map.size_local]
        self.lifts = np.tile(np.eye(3), (index_map.size_local, 1))
        self._mass_lifts = np.stack([self.mass(lift) for lift in self.lifts.T], axis=-1)
        self.mass_kg = self.dot(self.lifts[:, 2], self._mass_lifts[:, 2])

    def _compile(self) -> None:
        """Compile each form once. Their degree is that of the small-strain stiffness.

        Strain and stress are conserved point by point, so a degree below that of finite strain's
        polynomials costs no conservation, and three times fewer points than the exact one.
        """
        domain, space, material = self.domain, self.space, self.material
        self._u, self._d = fem.Function(space), fem.Function(space)
        real = PETSc.ScalarType
        # weights of the strain's increment in the stress, and of the mass in the tangent
        self._share = fem.Constant(domain, real(0.5))
        self._rate = fem.Constant(domain, real(0.0))
        self._inertia = fem.Constant(domain, real(0.0))
        test, trial = ufl.TestFunction(space), ufl.TrialFunction(space)
        dx = ufl.Measure("dx", domain=domain, metadata={"quadrature_degree": 2 * self.order})
        middle = ufl.Identity(3) + ufl.grad(self._u + self._d / 2)
        strain = green_strain(self._u)
        # E1 - E0 exactly, as a product: it may be many digits smaller than either
        increase = ufl.sym(middle.T * ufl.grad(self._d))
        inner = stress(strain + self._share * increase, material)
        force = ufl.inner(middle * inner, ufl.grad(test)) * dx
        density = fem.Constant(domain, real(material.density_kg_m3))
        tangent = ufl.derivative(force, self._d, trial)
        mass = density * ufl.inner(trial, test) * dx
        self._force_form = form(force)
        self._tangent_form = form(tangent + self._inertia * mass)
        self._energy_form = form(0.5 * ufl.inner(stress(strain, material), strain) * dx)
        self._loss_form = form(self._rate * ufl.inner(stress(increase, material), increase) * dx)
        self.mass_matrix = NodeMass(space, material.density_kg_m3).vector_matrix()
        self.tangent_matrix = fem_petsc.create_matrix(self._tangent_form)
        self._force = fem_petsc.create_vector(self._force_form)

    def _set(self, u: Array, d: Array, its_s: float) -> None:
        for function, values in ((self._u, u), (self._d, d)):
            function.x.array[: self.n_local] = values
            function.x.scatter_forward()
        self._rate.value = self.material.beta_s / its_s
        self._share.value = 0.5 + self.material.beta_s / its_s
        self._inertia.value = self.inertia_1_s2(its_s)

    def inertia_1_s2(self, its_s: float) -> float:
        """What multiplies M d at mid-step: 2/its² of inertia and alpha/its of damping."""
        return 2.0 / its_s**2 + self.material.alpha_1_s / its_s

    def mass(self, x: Array) -> Array:
        """M x (n_local,)."""
        self._x.array[:] = x
        self.mass_matrix.mult(self._x, self._y)
        return self._y.array.copy()

    def internal_force(self, u: Array, d: Array, its_s: float) -> Array:
        """Internal force at mid-step with its stiffness-proportional damping, N (n_local,)."""
        self._set(u, d, its_s)
        with self._force.localForm() as local:
            local.set(0.0)
        fem_petsc.assemble_vector(self._force, self._force_form)
        self._force.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        return self._force.array.copy()

    def tangent(self, u: Array, d: Array, its_s: float) -> PETSc.Mat:
        """Derivative by ``d`` of internal_force + inertia_1_s2 M d, N/m; not quite symmetric.

        The matrix is the body's own, and overwritten by the next call.
        """
        self._set(u, d, its_s)
        self.tangent_matrix.zeroEntries()
        fem_petsc.assemble_matrix(self.tangent_matrix, self._tangent_form)
        self.tangent_matrix.assemble()
        return self.tangent_matrix

    def factor(self, u: Array, d: Array, its_s: float) -> Callable[[Array], Array]:
        """LU factor of ``tangent`` by MUMPS; a function that solves for (n_local,) or (n_local, m).

        Every call ends the life of the function made before. Raises ComputationError where MUMPS
        fails.
        """
        matrix = self.tangent(u, d, its_s)
        if self._solver is None:
            self._solver = PETSc.KSP().create(self.comm)
            take_mumps(self._solver, PETSc.PC.Type.LU)
        self._solver.setOperators(matrix)
        factor(self._solver, "the tangent")
        return self._solve

    def _solve(self, b: Array) -> Array:
        if self._solver is None:
            raise ComputationError("the tangent was not factored")
        if b.ndim == 1:
            self._x.array[:] = b
            self._solver.solve(self._x, self._y)
            return self._y.array.copy()
        return np.ascontiguousarray(solve_columns(self._solver, b))

    def close(self) -> None:
        """Free matrices, vectors and the factor; the body cannot be used afterwards."""
        for thing in (self._solver, self.tangent_matrix, self.mass_matrix, self._force):
            if thing is not None:
                thing.destroy()
        self._x.destroy()
        self._y.destroy()

    def dot(self, x: Array, y: Array) -> float:
        """Inner product over all ranks."""
        return float(self.comm.allreduce(float(x @ y)))

    def strain_energy_J(self, u: Array) -> float:
        """Strain energy of the displacement ``u``."""
        self._set(u, np.zeros_like(u), 1.0)
        return float(self.comm.allreduce(fem.assemble_scalar(self._energy_form)))

    def damping_loss_J(self, u: Array, d: Array, its_s: float) -> float:
        """Energy that both dampings take over the step ``d`` from ``u``."""
        loss = 0.0
        if self.material.beta_s:
            self._set(u, d, its_s)
            loss += float(self.comm.allreduce(fem.assemble_scalar(self._loss_form)))
        if self.material.alpha_1_s:
            loss += self.material.alpha_1_s / its_s * self.dot(d, self.mass(d))
        return loss

    def mean(self, x: Array) -> Array:
        """Mass average of the vector field ``x``: of ``u`` the centre's, of v its velocity (3,)."""
        return np.asarray(self.comm.allreduce(self._mass_lifts.T @ x)) / self.mass_kg

    def centre_m(self, u: Array) -> Array:
        """Place of the centre of mass, in the mesh's axes (3,)."""
        return self.mean(self.places_m.ravel() + u)

    def angular_momentum(self, u: Array, v: Array) -> Array:
        """Angular momentum about the centre of mass, kg m²/s, in the mesh's axes (3,)."""
        arm = self.places_m + u.reshape(-1, 3) - self.centre_m(u)
        local = np.cross(arm, self.mass(v).reshape(-1, 3)).sum(axis=0)
        return np.asarray(self.comm.allreduce(local))

    def rigid_velocity(self, velocity_m_s: Array, spin_rad_s: Array) -> Array:
        """Nodal velocities of a rigid motion: the undeformed centre of mass's, and a spin."""
        arm = self.places_m - self.centre_m(np.zeros(self.n_local))
        return (np.asarray(velocity_m_s) + np.cross(spin_rad_s, arm)).ravel()
