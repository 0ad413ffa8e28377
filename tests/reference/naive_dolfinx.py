"""The loop that a user of dolfinx would write: Newton with a fresh LU in every iteration.

Hexahedra, Newmark's average acceleration, penalty contact on the end face; the whole impact is
marched. Nothing is clever here, on purpose, and nothing is slow on purpose: forms are compiled
once, the quadrature is no finer than the elements need, and Newton stops where
rounding soon would.

    docker/run python3 tests/reference/naive_dolfinx.py --cells 1 2 42 --its 1e-5
"""

from __future__ import annotations

import sys

import numpy as np
import ufl
from dolfinx import fem, mesh
from dolfinx.fem.petsc import NonlinearProblem
from dolfinx.nls.petsc import NewtonSolver
from impact import AREA_M2, Impact, March, run
from mpi4py import MPI
from petsc4py import PETSc

from bristle.solver import paper

# of the residual; the contact force is 40 N
NEWTON_N = 1e-7


def march(impact: Impact) -> March:
    """March the impact on this process."""
    x, y = 0.5 * paper.THICKNESS_M, 0.5 * paper.WIDTH_M
    corners = [(-x, -y, 0.0), (x, y, paper.LENGTH_M)]
    domain = mesh.create_box(MPI.COMM_SELF, corners, impact.cells, mesh.CellType.hexahedron)
    V = fem.functionspace(domain, ("Lagrange", impact.order, (3,)))
    tip = mesh.locate_entities_boundary(domain, 2, lambda x: np.isclose(x[2], 0.0))
    tags = mesh.meshtags(domain, 2, tip, 1)
    exact = {"quadrature_degree": 2 * impact.order}
    dx = ufl.Measure("dx", domain=domain, metadata=exact)
    ds = ufl.Measure("ds", domain=domain, subdomain_data=tags, metadata=exact)(1)

    E, nu, rho = paper.YOUNGS_PA, paper.POISSON, paper.DENSITY_KG_M3
    lam, mu = E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), E / (2.0 * (1.0 + nu))

    def eps(w):
        return ufl.sym(ufl.grad(w))

    def sigma(w):
        return lam * ufl.tr(eps(w)) * ufl.Identity(3) + 2.0 * mu * eps(w)

    # the state at the start of the step, and the displacement at its end
    u0, v0, a0, u = (fem.Function(V) for _ in range(4))
    v0.x.array[2::3] = -impact.speed_m_s
    a0.x.array[2::3] = -paper.GRAVITY_M_S2
    h = impact.its_s
    a = 4.0 / h**2 * (u - u0 - h * v0) - a0
    v = v0 + 0.5 * h * (a0 + a)

    w = ufl.TestFunction(V)
    gravity = fem.Constant(domain, (0.0, 0.0, -paper.GRAVITY_M_S2))
    pressure = impact.kn_N_m / AREA_M2 * ufl.max_value(-u[2], 0.0)
    residual = (
        rho * ufl.inner(a - gravity, w) * dx
        + ufl.inner(sigma(u + impact.beta_s * v), eps(w)) * dx
        - pressure * w[2] * ds
    )
    solver = NewtonSolver(MPI.COMM_SELF, NonlinearProblem(residual, u))
    solver.convergence_criterion = "residual"
    solver.rtol, solver.atol = 0.0, NEWTON_N
    ksp = solver.krylov_solver
    ksp.setType(PETSc.KSP.Type.PREONLY)
    ksp.getPC().setType(PETSc.PC.Type.LU)
    ksp.getPC().setFactorSolverType("mumps")

    new_a = fem.Expression(a, V.element.interpolation_points())
    total_force, mean_tip = fem.form(pressure * ds), fem.form(u[2] / AREA_M2 * ds)
    acceleration = fem.Function(V)
    force_N, tip_m = [], []
    for _ in impact.t_s:
        solver.solve(u)
        acceleration.interpolate(new_a)
        v0.x.array[:] += 0.5 * h * (a0.x.array + acceleration.x.array)
        a0.x.array[:] = acceleration.x.array
        u0.x.array[:] = u.x.array
        force_N.append(fem.assemble_scalar(total_force))
        tip_m.append(fem.assemble_scalar(mean_tip))
    return March(impact.t_s, force_N, tip_m, V.dofmap.index_map.size_global * 3)


if __name__ == "__main__":
    sys.exit(run(__doc__, march))
