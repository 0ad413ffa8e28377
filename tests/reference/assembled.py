"""A solid's step as its balance of momentum stands in UFL, assembled whole and solved by SNES.

    docker/run python3 tests/reference/assembled.py --tilt 2 --its 1e-6

The reference that the condensed marches are held against, and the place to try PETSc's solvers:
options with the prefix ``bristle_`` reach SNES, as in
``PETSC_OPTIONS="-bristle_snes_monitor -bristle_snes_lag_jacobian 5"`` (``-bristle_snes_type qn``,
``-bristle_ksp_type gmres`` …). It takes many times as long. As a script it drops a solid by both.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Sequence
from typing import Self

import numpy as np
import ufl
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from petsc4py import PETSc

from bristle.solver.bodies.linear import take_direct
from bristle.solver.bodies.solid import SolidBody
from bristle.solver.contact.enforcement import ContactMethod, Enforcement
from bristle.solver.contact.laws import ContactLaw, Coulomb, Linear
from bristle.solver.drop import DropResult, simulate
from bristle.solver.errors import ComputationError, InputError
from bristle.solver.form_cache import form
from bristle.solver.forms import own_values, rigid_plane
from bristle.solver.ground import Placement
from bristle.solver.time.finite import PREFIX, FiniteMarcher, assemble
from bristle.solver.time.march import Moving, Step
from bristle.solver.time.scheme import TimeScheme
from bristle.studies.inputs.config import DropInputs
from bristle.studies.inputs.sources import checked
from bristle.studies.running.cases import CaseSession

PRECISION, ITERATIONS = 1e-12, 60


class AssembledMarcher(FiniteMarcher):
    """Marches a solid by Newton's method on the form of a whole step, contact included.

    Strain is ``finite`` or small. Contact is the linear law by penalty or Nitsche's method on one
    plane; with friction the contact points must be nodes. InputError says what is not known.
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
        normals = placement.frames[:, 0]
        if np.ptp(normals, axis=0).max() > 0.0 or (placement.scale != 1.0).any():
            raise InputError("the assembled form knows one plane for all contact points")
        self._check_method()
        super().place(placement)

    def with_law(self, law: ContactLaw, friction: Coulomb | None = None) -> Self:
        other = super().with_law(law, friction)
        other._check_method()
        return other

    def _check_method(self) -> None:
        method, points = self.method, self.solid.contact
        if type(method.law) is not Linear or method.enforcement is Enforcement.AUGMENTED:
            raise InputError("the assembled form knows the linear law, by penalty or Nitsche")
        if method.friction.mu and points.rows.shape[0] != points.rows.shape[1]:
            raise InputError(
                "friction in the assembled form needs contact points at nodes: take none, or "
                "three points across each cell of second order"
            )

    def _set_plane(self) -> None:
        """Have the form know the plane, which marches under other laws share."""
        method, points, ground = self.method, self.solid.contact, self.ground
        normal = ground.frames[0, 0]
        places = points.places_m + self.solid.centre_m
        kn, kt = method.law.kn_N_m, method.kt_N_m
        for name, number in (
            ("normal", normal),
            ("offset", float(places[0] @ normal - ground.gaps_m[0])),
            ("stiffness", 1.0 / (1.0 / kn + self.tau)),
            ("kt", 0.0 if math.isinf(kt) else 1.0 / (1.0 / kt + self.tau)),
            ("mu", method.friction.mu),
            ("tau", self.tau),
            ("theta", float(method.theta)),
        ):
            getattr(self._plane, name).value = number

    def step(self, now: Moving) -> Step:
        h, points = self.its_s, self.solid.contact
        self._set_plane()
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


def drop_assembled(inputs: DropInputs, comm: MPI.Intracomm = MPI.COMM_WORLD) -> DropResult:
    """The solid's drop of ``inputs``, its impacts marched on the assembled form; collective."""
    with CaseSession(comm) as session:
        prepared = session.prepare(inputs)
        assert prepared is not None
        frame, solid = prepared.frame, prepared.frame.body
        assert isinstance(solid, SolidBody)
        plan = inputs.drop_plan(len(solid.contact.weights))
        how = (solid, plan.method, plan.scheme, plan.its_s, plan.gravity_m_s2)
        marcher = AssembledMarcher(*how, finite=inputs.finite)
        try:
            return simulate(frame, plan, marcher)
        finally:
            marcher.close()


def drop_condensed(inputs: DropInputs, comm: MPI.Intracomm = MPI.COMM_WORLD) -> DropResult:
    """The same drop as the program computes it; collective."""
    with CaseSession(comm) as session:
        return session.run(inputs)[0]


def main(arguments: Sequence[str] | None = None) -> None:
    """Print both drops."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tilt", type=float, default=0.0)
    parser.add_argument("--its", type=float, default=2e-6)
    parser.add_argument("--length", type=float, default=0.02)
    parser.add_argument("--cells", type=int, nargs=3, default=(1, 2, 10))
    given = parser.parse_args(arguments)
    values = {"length_m": given.length, "cells": tuple(given.cells), "tilt_deg": given.tilt}
    values |= {"its_s": given.its, "friction": 0.0, "until": "impact"}
    inputs = checked(DropInputs, {"model": "solid", **values})
    for name, computed in (("condensed", drop_condensed), ("assembled", drop_assembled)):
        started = time.perf_counter()
        found = computed(inputs)
        numbers = (found.peak_force_N, found.contact_time_s, found.cm_velocity_after_m_s)
        if MPI.COMM_WORLD.rank == 0:
            words = "  ".join(f"{number:.12g}" for number in numbers)
            print(f"{name}  {words}  in {time.perf_counter() - started:.1f} s")


if __name__ == "__main__":
    main()
