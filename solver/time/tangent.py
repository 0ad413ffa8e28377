"""Tangent of a finite-strain step: its factor, and the compliance of the contact points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from dolfinx.fem import petsc as fem_petsc
from petsc4py import PETSc

from ..arrays import Array
from ..bodies.linear import Solver, factor, solve_columns, take_direct
from ..bodies.solid import SolidBody
from ..bodies.tip import TipTractions
from ..form_cache import form
from ..forms import StepForms, own_values


@dataclass(frozen=True, eq=False)
class Tangent:
    """A body linearised about an increment ``d`` from a displacement ``u``.

    ``compliance`` is that of `ContactMarch`. The columns ``to_points`` (n_local, r) are responses
    to loads along the section's coordinates. For Nitsche's method ``to_tractions`` (n_local, 3 n)
    are those to forces that work on its tractions, and ``tractions`` gives the tractions' change (3
    n,) with a motion; else both are None.
    """

    u: Array
    d: Array
    solve: Callable[[Array], Array]
    to_points: Array
    compliance: Array
    to_tractions: Array | None = None
    tractions: Callable[[Array], Array] | None = None


class Tangents:
    """The tangents of all steppers of a solid that share forms, time step and Nitsche's constants.

    None depends on contact law, friction or ground. The tangent of the unstrained body is the
    small-strain effective matrix; the body has its factor, and its responses are cached here. Only
    the latest other tangent is cached, in a MUMPS factor that this object owns. ``surface`` has
    Nitsche's tractions, ``tau`` and ``theta`` its constants. ``close`` frees what PETSc holds.
    """

    def __init__(
        self,
        solid: SolidBody,
        forms: StepForms,
        surface: TipTractions | None,
        tau: float,
        theta: int,
    ) -> None:
        self._solid, self._forms, self._surface = solid, forms, surface
        self._tau, self._symmetric = tau, theta * tau
        self._form = form(forms.tangent())
        self._weights = np.repeat(solid.contact.weights, 3)
        self._solver: PETSc.KSP | None = None
        self._owned: tuple[PETSc.Object, ...] = ()
        self._unstrained: Tangent | None = None
        self._latest: Tangent | None = None

    def at(self, u: Array, d: Array) -> Tangent:
        """The tangent at an increment ``d`` from ``u``, valid until the next call; collective.

        Raises ComputationError if the factor cannot be made.
        """
        forms, solid = self._forms, self._solid
        for function, values in ((forms.u, u), (forms.v, 0.0 * u), (forms.d, d)):
            own_values(function, values)
        if solid.method is Solver.DIRECT and solid.dot(u, u) + solid.dot(d, d) == 0.0:
            if self._unstrained is None:
                h, beta = float(forms.its.value), solid.beta_s
                small = solid.factor((2.0 / h + solid.alpha_1_s) / h, 0.5 + beta / h)
                self._unstrained = self._made(u, d, small)
            return self._unstrained
        self._factor()
        self._latest = self._made(u, d, self._by_factor)
        return self._latest

    def has(self, tangent: Tangent) -> bool:
        """Whether a ``tangent`` is still valid."""
        return tangent in (self._unstrained, self._latest)

    def close(self) -> None:
        """Free what PETSc holds."""
        self._unstrained = self._latest = self._solver = None
        for thing in self._owned:
            thing.destroy()
        self._owned = ()

    def _factor(self) -> None:
        """Factor the tangent at the present data of the forms."""
        if self._solver is None:
            self._matrix = fem_petsc.create_matrix(self._form)
            self._right, self._left = self._matrix.createVecs()
            self._solver = PETSc.KSP().create(self._solid.comm)
            self._owned = (self._solver, self._matrix, self._right, self._left)
            take_direct(self._solver, PETSc.PC.Type.LU)
        self._matrix.zeroEntries()
        fem_petsc.assemble_matrix(self._matrix, self._form)
        self._matrix.assemble()
        self._solver.setOperators(self._matrix)
        factor(self._solver, "the tangent")

    def _by_factor(self, b: Array) -> Array:
        assert self._solver is not None
        if b.ndim == 2:
            return solve_columns(self._solver, b)
        self._right.array[:] = b
        self._solver.solve(self._right, self._left)
        return np.array(self._left.array)

    def _made(self, u: Array, d: Array, solve: Callable[[Array], Array]) -> Tangent:
        """The tangent with the responses that contact needs, given its factor's ``solve``."""
        points = self._solid.contact
        loads = points.coordinates.T.toarray(order="F")
        if self._surface is None:
            to_points = np.ascontiguousarray(solve(loads))
            compliance = np.ascontiguousarray(points.moved(to_points))
            return Tangent(u.copy(), d.copy(), solve, to_points, compliance)
        corrected, to_tractions, tractions = self._with_tractions(self._surface, solve)
        to_points = np.ascontiguousarray(corrected(loads))
        by_points = to_points @ points.rows.T - to_tractions
        compliance = self._tau * tractions(by_points) - points.rows @ points.moved(by_points)
        compliance = np.ascontiguousarray(compliance * self._weights)
        return Tangent(
            u.copy(), d.copy(), corrected, to_points, compliance, to_tractions, tractions
        )

    def _with_tractions(
        self, surface: TipTractions, solve: Callable[[Array], Array]
    ) -> tuple[Callable[[Array], Array], Array, Callable[[Array], Array]]:
        """A solver that includes Nitsche's symmetric term, to the accuracy of the tangent, and
        `Tangent`'s ``to_tractions`` and ``tractions``.

        The traction's change is P R with few rows R; the term -κ Rᵀ Pᵀ W P R of the tangent is
        Woodbury's correction of its inverse.
        """
        h, beta = float(self._forms.its.value), self._solid.beta_s
        left, right = surface.compressed()
        columns = np.ascontiguousarray(solve(np.asfortranarray(right.T)))
        inner = self._symmetric * (0.5 + beta / h) * (left.T * self._weights) @ left
        total = self._solid.comm.allreduce
        capacitance = np.eye(len(inner)) - inner @ total(right @ columns)
        correction = np.linalg.solve(capacitance, inner)

        def corrected(b: Array) -> Array:
            x = solve(b)
            return np.asarray(x + columns @ (correction @ total(right @ x)))

        to_tractions = self._symmetric * (corrected(np.asfortranarray(right.T)) @ left.T)
        return (
            corrected,
            to_tractions,
            lambda x: (1.0 + 2.0 * beta / h) * (left @ total(right @ x)),
        )
