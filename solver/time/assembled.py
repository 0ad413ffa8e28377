"""A solid's step as its balance of momentum stands in UFL, assembled whole and solved by SNES.

The reference that the condensed marches are held against, and the place to try PETSc's solvers:
options with the prefix ``bristle_`` reach SNES (``-bristle_snes_type qn``,
``-bristle_snes_lag_jacobian 5``, ``-bristle_ksp_type gmres`` …). It takes many times as long.
"""

from __future__ import annotations

import math

import numpy as np
import ufl
from dolfinx.fem import petsc as fem_petsc
from petsc4py import PETSc

from ..bodies.linear import take_direct
from ..bodies.solid import SolidBody
from ..contact.enforcement import ContactMethod, Enforcement
from ..contact.laws import Linear
from ..errors import ComputationError, InputError
from ..form_cache import form
from ..forms import own_values, rigid_plane
from ..ground import Placement
from .finite import PREFIX, FiniteMarcher, assemble
from .march import Moving, Step
from .scheme import TimeScheme

PRECISION, ITERATIONS = 1e-12, 60


class AssembledMarcher(FiniteMarcher):
    """Marches a solid by Newton's method on the form of a whole step, contact included.

    Strain is ``finite`` or small. Contact is the linear law by penalty or Nitsche's method on one
    plane; with friction the contact points must be nodes. `place` raises InputError for others.
    """

    def __init__(
        self,
        body: SolidBody,
        method: ContactMethod,
        scheme: TimeScheme,
        its_s: float,
        gravity_m_s2: float,
        *,
        finite: bool = True,
    ) -> None:
        self._plane = rigid_plane(body.space)
        super().__init__(body, method, scheme, its_s, gravity_m_s2, finite=finite)
        forms, plane = self.forms, self._plane
        balance = forms.inertia() + forms.internal() + forms.contact(body.tip.measure, plane)
        self._balance = form(balance)
        self._derivative = form(ufl.derivative(balance, forms.d, forms.trial))
        self._jacobian = fem_petsc.create_matrix(self._derivative)
        self._newton = self._make_newton()

    def _make_newton(self) -> PETSc.SNES:
        snes = PETSc.SNES().create(self.solid.comm)
        snes.setOptionsPrefix(PREFIX)
        snes.setFunction(self._residual, self.vector())
        snes.setJacobian(self._assemble, self._jacobian)
        snes.setTolerances(rtol=PRECISION, atol=0.0, stol=PRECISION, max_it=ITERATIONS)
        take_direct(snes.getKSP(), PETSc.PC.Type.LU)
        snes.setFromOptions()
        return snes

    def place(self, placement: Placement) -> None:
        method, points = self.method, self.solid.contact
        normals = placement.frames[:, 0]
        if np.ptp(normals, axis=0).max() > 0.0 or (placement.scale != 1.0).any():
            raise InputError("the assembled form knows one plane for all contact points")
        if type(method.law) is not Linear or method.enforcement is Enforcement.AUGMENTED:
            raise InputError("the assembled form knows the linear law, by penalty or Nitsche")
        if method.friction.mu and points.rows.shape[0] != points.rows.shape[1]:
            raise InputError(
                "friction in the assembled form needs contact points at nodes: take --friction 0, "
                "or --order 2 and --contact-points 3"
            )
        super().place(placement)
        places = points.places_m + self.solid.centre_m
        kn, kt = method.law.kn_N_m, method.kt_N_m
        for name, number in (
            ("normal", normals[0]),
            ("offset", float(places[0] @ normals[0] - placement.gaps_m[0])),
            ("stiffness", 1.0 / (1.0 / kn + self.tau)),
            ("kt", 0.0 if math.isinf(kt) else 1.0 / (1.0 / kt + self.tau)),
            ("mu", method.friction.mu),
            ("tau", self.tau),
            ("theta", float(method.theta)),
        ):
            getattr(self._plane, name).value = number

    def step(self, now: Moving) -> Step:
        h, points = self.its_s, self.solid.contact
        self.forms.pull.value = -self.gravity_m_s2 * self.ground.up
        if self.method.friction.mu:
            held = np.einsum("iax,ia->ix", self.ground.frames[:, 1:], self.contact.memory[:, :2])
            own_values(
                self._plane.elongation, points.coordinates.T @ (points.rows.T @ held.ravel())
            )
        self._set(now.u, now.v, h * now.v)
        x = self.vector()
        x.array[:] = h * now.v
        self._newton.solve(None, x)
        d = x.array.copy()
        x.destroy()
        if self._newton.getConvergedReason() <= 0:
            raise ComputationError(
                f"SNES ended with reason {self._newton.getConvergedReason()} after "
                f"{self._newton.getIterationNumber()} iterations at t = {now.t_s:.6g} s; "
                "shorten the ITS, or see PETSc's options"
            )
        self._set(now.u, now.v, d)
        moved = -points.displacements(now.u + d)
        if self._surface is not None:
            moved = moved + self.tau * self._surface.end()
        # the body has answered already, so the law is only asked
        return self._arrived(now, d, self.contact.solve(now.approach, self.in_frames(moved)))

    def _residual(self, _: PETSc.SNES, x: PETSc.Vec, out: PETSc.Vec) -> None:
        own_values(self.forms.d, x.getArray(readonly=True))
        assemble(out, self._balance)

    def _assemble(self, _: PETSc.SNES, x: PETSc.Vec, jacobian: PETSc.Mat, __: PETSc.Mat) -> None:
        own_values(self.forms.d, x.getArray(readonly=True))
        jacobian.zeroEntries()
        fem_petsc.assemble_matrix(jacobian, self._derivative)
        jacobian.assemble()

    def close(self) -> None:
        super().close()
        self._newton.destroy()
        self._jacobian.destroy()
