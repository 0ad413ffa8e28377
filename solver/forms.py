"""UFL forms of a solid in contact with a plane: strain, stress, inertia, damping, contact.

A step of length h adds the increment d to the displacement u and changes the velocity v to
2 d/h - v. The balance of momentum is taken at mid-step (Simo and Tarnow, ZAMP 43, 1992). It
conserves linear and angular momentum, and without damping also energy. At ``finite`` strain the
stress is that of St. Venant and Kirchhoff, S = C : E with the Green-Lagrange strain E. It is
carried by the deformation gradient F = 1 + grad u at mid-step. At small strain F = 1 and
E = sym grad u: linear elasticity. Damping is Rayleigh's: αM, and the stress β C : dE/dt.

Contact is an integral over the tip's facets (`StepForms.contact`). Its augmented gap, τ t - x less
the plane, and its symbols are those of solver.contact.enforcement.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from dolfinx import fem, mesh
from petsc4py import PETSc

from .arrays import Array
from .bristle import Material

Expr = Any  # of UFL, which has no types of its own


@dataclass(frozen=True)
class Elasticity:
    """St. Venant-Kirchhoff material, or Hooke's where strain is not ``finite``.

    The Lamé constants are data of the forms, so one compiled form serves all materials.
    """

    lam: fem.Constant
    mu: fem.Constant
    finite: bool

    @classmethod
    def of(cls, material: Material, domain: mesh.Mesh, *, finite: bool = False) -> Elasticity:
        """The elasticity of a ``material`` on a mesh."""
        lam, mu = (fem.Constant(domain, PETSc.ScalarType(value)) for value in material.lame_Pa)
        return cls(lam, mu, finite)

    def deformation(self, u: Expr) -> Expr:
        """The deformation gradient F; the identity at small strain."""
        return ufl.Identity(3) + ufl.grad(u) if self.finite else ufl.Identity(3)

    def strain(self, u: Expr) -> Expr:
        """The strain E, without the cancellation in FᵀF - 1."""
        gradient = ufl.grad(u)
        linear = ufl.sym(gradient)
        return linear + 0.5 * gradient.T * gradient if self.finite else linear

    def strain_change(self, at: Expr, w: Expr) -> Expr:
        """Derivative of E at displacement ``at`` in direction ``w``.

        At the middle of a step, with its increment, this is exactly the step's change of E.
        """
        return ufl.sym(self.deformation(at).T * ufl.grad(w))

    def stress(self, strain: Expr) -> Expr:
        """S = C : E, along the body's own axes, in Pa."""
        return self.lam * ufl.tr(strain) * ufl.Identity(3) + 2.0 * self.mu * strain

    def energy_density(self, u: Expr) -> Expr:
        """Strain energy per volume, ½ E : C : E."""
        strain = self.strain(u)
        return 0.5 * ufl.inner(self.stress(strain), strain)

    def traction(self, u: Expr, normal: Expr) -> Expr:
        """Force per undeformed area, F S N, on a surface with the unit ``normal`` N."""
        return self.deformation(u) * self.stress(self.strain(u)) * normal

    def traction_change(self, before: Expr, after: Expr, w: Expr, normal: Expr) -> Expr:
        """Change of the traction in direction ``w`` between two states.

        With w the difference of the states, it is exactly the change between them.
        """
        middle = 0.5 * (before + after)
        change = self.deformation(middle) * self.stress(self.strain_change(middle, w))
        if self.finite:
            mean = 0.5 * (self.stress(self.strain(before)) + self.stress(self.strain(after)))
            change += ufl.grad(w) * mean
        return change * normal


def cells_of(space: fem.FunctionSpace) -> ufl.Measure:
    """The cell measure for products of ``space``'s shape functions or of their gradients.

    Its degree is twice that of the shape functions along each axis; curved cells add that of the
    Jacobian. Small and finite strain share it, so that one is the limit of the other on any mesh.
    """
    domain = space.mesh
    degree = 2 * space.element.basix_element.degree + 2 * (domain.geometry.cmap.degree - 1)
    return ufl.Measure("dx", domain=domain, metadata={"quadrature_degree": degree})


@dataclass(frozen=True)
class TipMeasure:
    """Measures on the tip's facets, whose quadrature points are the contact points.

    ``parts`` add up to the tip, ``area_m2`` is its area.
    """

    parts: tuple[ufl.Measure, ...]
    area_m2: float


class StepForms:
    """The forms of one time step of a solid on ``space``, and their coefficients.

    ``u`` and ``v`` are displacement and velocity at the start of the step, ``d`` is its increment
    of displacement. ``pull`` is the vector (3,) of gravity in m/s².
    """

    def __init__(self, space: fem.FunctionSpace, material: Material, *, finite: bool) -> None:
        domain = self.domain = space.mesh
        self.elasticity = Elasticity.of(material, domain, finite=finite)
        self.u, self.v, self.d = (fem.Function(space) for _ in range(3))
        self.test, self.trial = ufl.TestFunction(space), ufl.TrialFunction(space)
        real = PETSc.ScalarType
        self.its, self.density, self.alpha, self.beta = (
            fem.Constant(domain, real(value))
            for value in (1.0, material.density_kg_m3, material.alpha_1_s, material.beta_s)
        )
        self.pull = fem.Constant(domain, np.zeros(3, dtype=real))
        # conservation holds at each quadrature point, so integrating finite strain's polynomials
        # below their full degree costs none
        self._dx = cells_of(space)
        self.normal = ufl.FacetNormal(domain)

    @property
    def middle(self) -> Expr:
        """The displacement at mid-step."""
        return self.u + self.d / 2

    @property
    def end_velocity(self) -> Expr:
        """The velocity at the end of the step."""
        return 2.0 / self.its * self.d - self.v

    def internal(self) -> Expr:
        """Virtual work of the stress at mid-step, damping included."""
        body = self.elasticity
        increase = body.strain_change(self.middle, self.d)
        stress = body.stress(body.strain(self.u) + (0.5 + self.beta / self.its) * increase)
        return ufl.inner(body.deformation(self.middle) * stress, ufl.grad(self.test)) * self._dx

    def inertia(self) -> Expr:
        """Virtual work of inertia, mass-proportional damping and gravity."""
        acceleration = 2.0 / self.its * (self.d / self.its - self.v)
        rest = acceleration + self.alpha / self.its * self.d - self.pull
        return self.density * ufl.inner(rest, self.test) * self._dx

    def tangent(self) -> Expr:
        """Derivative of `internal` and `inertia` by the increment ``d``."""
        inertia = self.density * (2.0 / self.its + self.alpha) / self.its
        return (
            ufl.derivative(self.internal(), self.d, self.trial)
            + inertia * ufl.inner(self.trial, self.test) * self._dx
        )

    def strain_energy(self) -> Expr:
        """Strain energy of the displacement ``u``, in J."""
        return self.elasticity.energy_density(self.u) * self._dx

    def stress_load(self) -> Expr:
        """Virtual work of the stress of ``u`` on small strains of the test."""
        body = self.elasticity
        return ufl.inner(body.stress(body.strain(self.u)), ufl.grad(self.test)) * self._dx

    def stress_rate_load(self) -> Expr:
        """Virtual work of the stress rate, at ``u`` and ``v``, on small strains of the test."""
        body = self.elasticity
        rate = body.stress(body.strain_change(self.u, self.v))
        return ufl.inner(rate, ufl.grad(self.test)) * self._dx

    def stress_loss(self) -> Expr:
        """Energy dissipated over the step by stiffness-proportional damping (β), in J."""
        increase = self.elasticity.strain_change(self.middle, self.d)
        rate = self.beta / self.its
        return rate * ufl.inner(self.elasticity.stress(increase), increase) * self._dx

    def _traction(self, u: Expr, v: Expr) -> Expr:
        """Traction for a displacement and a velocity, viscous part included."""
        body = self.elasticity
        viscous = body.stress(self.beta * body.strain_change(u, v))
        return body.traction(u, self.normal) + body.deformation(u) * viscous * self.normal

    def start_traction(self) -> Expr:
        """Traction at the start of the step, viscous part included."""
        return self._traction(self.u, self.v)

    def end_traction(self) -> Expr:
        """Traction at the end of the step, viscous part included."""
        return self._traction(self.u + self.d, self.end_velocity)

    def viscous_traction(self) -> Expr:
        """Viscous part of the traction at mid-step."""
        body = self.elasticity
        viscous = body.stress(self.beta / self.its * body.strain_change(self.middle, self.d))
        return body.deformation(self.middle) * viscous * self.normal

    def mean_traction(self) -> Expr:
        """Mean elastic traction of both ends of the step, plus the viscous one at mid-step."""
        body, end = self.elasticity, self.u + self.d
        elastic = 0.5 * (body.traction(self.u, self.normal) + body.traction(end, self.normal))
        return elastic + self.viscous_traction()

    def traction_change(self, w: Expr) -> Expr:
        """Change of the traction in direction ``w``, see `Elasticity.traction_change`."""
        return self.elasticity.traction_change(self.u, self.u + self.d, w, self.normal)

    def contact(self, tip: TipMeasure, plane: PlaneData) -> Expr:
        """Virtual work of contact with a plane: penalty (τ = 0) or Nitsche's method with θ.

        The force on the tip, per share of its area, is N n + T. The normal force N is the discrete
        gradient over the step (Gonzalez, J. Nonlinear Sci. 6, 1996) of the potential ½ k ⟨s⟩² of
        the augmented gap s, with k the stiffness of Kn in series with 1/τ. Friction T is the force
        of a spring that follows the slip, at mid-step, limited to μ N by return mapping.
        """
        total = 0.0
        x = ufl.SpatialCoordinate(self.domain)
        area, n = tip.area_m2, plane.normal
        before = area * plane.tau * self.start_traction()
        after = area * plane.tau * self.end_traction()
        start = before - (x + self.u)
        end = after - (x + self.u + self.d)
        normal = _mean_force(
            plane.stiffness, ufl.dot(start, n) + plane.offset, ufl.dot(end, n) + plane.offset
        )
        slip = (end - start) - ufl.dot(end - start, n) * n
        trial = plane.kt * (plane.elongation + 0.5 * slip)
        size = ufl.sqrt(ufl.dot(trial, trial))
        limit = plane.mu * normal
        share = ufl.conditional(ufl.gt(size, limit), limit / size, 1.0)
        force = normal * n + ufl.conditional(ufl.gt(normal, 0.0), share, 0.0) * trial
        along = area * self.traction_change(self.test)
        pushed = self.test - plane.theta * plane.tau * along
        work = ufl.dot(force, pushed)
        work += plane.theta * plane.tau * ufl.dot(area * self.mean_traction(), along)
        for part in tip.parts:
            total -= work / area * part
        return total


@dataclass(frozen=True)
class PlaneData:
    """Coefficients of a rigid plane and of its enforcement in the forms.

    The plane is n · x = offset. ``stiffness`` is Kn in series with Nitsche's compliance ``tau``,
    ``kt`` friction's stiffness, ``elongation`` (m) that of its springs at the start of the step.
    """

    normal: fem.Constant
    offset: fem.Constant
    stiffness: fem.Constant
    kt: fem.Constant
    mu: fem.Constant
    tau: fem.Constant
    theta: fem.Constant
    elongation: fem.Function


def _mean_force(stiffness: Expr, before: Expr, after: Expr) -> Expr:
    """(V(s1) - V(s0)) / (s1 - s0) of V = ½ k ⟨s⟩², case by case to avoid cancellation."""
    a, b = ufl.max_value(before, 0.0), ufl.max_value(after, 0.0)
    through = (a + b) ** 2 / abs(after - before)
    return 0.5 * stiffness * ufl.conditional(ufl.lt(before * after, 0.0), through, a + b)


def rigid_plane(space: fem.FunctionSpace) -> PlaneData:
    """A plane whose coefficients are still to be set."""
    real, domain = PETSc.ScalarType, space.mesh
    offset, stiffness, kt, mu, tau, theta = (fem.Constant(domain, real(0.0)) for _ in range(6))
    normal = fem.Constant(domain, np.array([0.0, 0.0, 1.0], dtype=real))
    return PlaneData(normal, offset, stiffness, kt, mu, tau, theta, fem.Function(space))


def own_values(function: fem.Function, values: Array) -> None:
    """Set this rank's ``values`` of ``function`` and update its ghosts."""
    function.x.array[: len(values)] = values
    function.x.scatter_forward()
