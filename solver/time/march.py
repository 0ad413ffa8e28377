"""One time step of a linear body in contact: one solve with a matrix factored once."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..bodies.base import Array, Body
from ..contact.enforcement import ContactMethod, StepContact
from ..contact.laws import ContactLaw
from .scheme import TimeScheme


@dataclass
class State:
    """Motion at one instant with the products that the next step and the energies need.

    All arrays hold this rank's unknowns. ``ku`` and its like are with the stiffness that the
    scheme sees (Nitsche's symmetric term included). ``drive`` (n contact points,) see
    contact.enforcement.
    """

    t_s: float
    u: Array
    v: Array
    a: Array
    mu: Array
    mv: Array
    ma: Array
    ku: Array
    kv: Array
    ka: Array
    drive: Array


class Marcher:
    """Marches a body in contact with the plane at constant ``its_s``.

    The effective matrix c_M M + c_K K is factored once; a step costs one solve, one product with
    M, and a small problem for the contact forces through the compliance of the contact points. The
    upward contact force on the body is Qᵀ (w P) with P the force per area share.
    """

    def __init__(
        self,
        body: Body,
        method: ContactMethod,
        scheme: TimeScheme,
        its_s: float,
        gravity_m_s2: float,
    ) -> None:
        self.body, self.method, self.scheme, self.its_s = body, method, scheme, its_s
        self.gravity_m_s2 = gravity_m_s2
        points = body.contact
        self.tau = method.compliance_m_N(body)
        self._symmetric = method.theta * self.tau
        self._mass_lift = body.mass(body.lift)
        self._c_mass, self._c_stiffness = scheme.effective(its_s, body.alpha_1_s, body.beta_s)
        self._solve = self._factor()
        direction = points.normal - self._symmetric * points.pressure
        direction = direction.toarray() if hasattr(direction, "toarray") else direction
        self._forcing = np.ascontiguousarray((points.weights[:, None] * direction).T)
        self._compliance = self._solve(self._forcing)
        self.contact = self._step_contact()

    @property
    def rigid_multiplier(self) -> bool:
        """Whether contact is a multiplier on a rigid plane: no energy in it, its drive zero."""
        return math.isinf(self.method.law.kn_N_m) and self.tau == 0.0

    def with_law(self, law: ContactLaw) -> Marcher:
        """The same march under another law: factor and compliance are shared."""
        other = copy.copy(self)
        other.method = replace(self.method, law=law)
        other.contact = other._step_contact()
        return other

    def _factor(self) -> Callable[[Array], Array]:
        """Solver of the effective matrix, Nitsche's low-rank term by Woodbury's identity."""
        solve = self.body.factor(self._c_mass, self._c_stiffness)
        if self._symmetric == 0.0:
            return solve
        points = self.body.contact
        rows = points.pressure
        rows = rows.toarray() if hasattr(rows, "toarray") else np.asarray(rows)
        columns = solve(np.ascontiguousarray(rows.T))
        capacitance = np.diag(1.0 / (self._c_stiffness * self._symmetric * points.weights))
        capacitance = capacitance - points.pressures(columns)

        def corrected(b: Array) -> Array:
            x = solve(b)
            return np.asarray(x + columns @ np.linalg.solve(capacitance, points.pressures(x)))

        return corrected

    def _step_contact(self) -> StepContact:
        points, h, scheme = self.body.contact, self.its_s, self.scheme
        du, dv = scheme.beta * h * h, scheme.gamma * h
        response = -du * points.heights(self._compliance)
        if self.tau:
            response = response + self.tau * (du + self.body.beta_s * dv) * points.pressures(
                self._compliance
            )
        return StepContact(
            method=self.method,
            series_m_N=self.tau,
            response=response,
            end_weight=None if scheme.conserving else 1.0 - scheme.alpha_f,
            multiplier=np.zeros(len(points.weights)),
        )

    def stiffness(self, x: Array) -> Array:
        """K x with Nitsche's symmetric term."""
        kx = self.body.stiffness(x)
        if self._symmetric == 0.0:
            return kx
        points = self.body.contact
        return kx - self._symmetric * (points.pressure.T @ (points.weights * points.pressures(x)))

    def drive(self, u: Array, v: Array) -> Array:
        """The drive s (n contact points,) of contact.enforcement."""
        points = self.body.contact
        s = -points.heights(u)
        if self.tau:
            s = s + self.tau * points.pressures(u + self.body.beta_s * v)
        return s

    def start(self, t_s: float, u: Array, v: Array) -> State:
        """State for displacement ``u`` and velocity ``v``, its acceleration from equilibrium.

        The conserving scheme does not depend on the initial acceleration and takes free fall.
        """
        body = self.body
        mu, mv, ku, kv = body.mass(u), body.mass(v), self.stiffness(u), self.stiffness(v)
        drive = self.drive(u, v)
        self.contact.multiplier = np.zeros_like(drive)
        a: Array = -self.gravity_m_s2 * body.lift
        if self.scheme.conserving:
            ma = -self.gravity_m_s2 * self._mass_lift
        else:
            force = self.method.law.force(drive, self.tau)
            ma = -self.gravity_m_s2 * self._mass_lift + self._forcing @ force
            ma = ma - body.alpha_1_s * mv - body.beta_s * kv - ku
            a = body.factor(1.0, 0.0)(ma)
        return State(t_s, u, v, a, mu, mv, ma, ku, kv, self.stiffness(a), drive)

    def step(self, now: State) -> tuple[State, Array]:
        """The next state, and the contact forces per area share (n,) in N over the step.

        Raises ComputationError where the contact forces do not converge.
        """
        body, scheme, h = self.body, self.scheme, self.its_s
        part = 1.0 - scheme.alpha_f
        early_v, early_u = part * h * (1.0 - scheme.gamma), part * h * h * (0.5 - scheme.beta)
        rhs = (
            -self.gravity_m_s2 * self._mass_lift
            - scheme.alpha_m * now.ma
            - (now.ku + part * h * now.kv + early_u * now.ka)
            - body.beta_s * (now.kv + early_v * now.ka)
        )
        if body.alpha_1_s:
            rhs = rhs - body.alpha_1_s * (now.mv + early_v * now.ma)
        a_free = self._solve(rhs)
        u_free = now.u + h * now.v + h * h * ((0.5 - scheme.beta) * now.a + scheme.beta * a_free)
        v_free = now.v + h * ((1.0 - scheme.gamma) * now.a + scheme.gamma * a_free)
        drive_free = self.drive(u_free, v_free)
        force = self.contact.solve(now.drive, drive_free)
        if not force.any():
            a, u, v, drive = a_free, u_free, v_free, drive_free
        else:
            rhs = rhs + self._forcing @ force
            change = self._compliance @ force
            a = a_free + change
            u = u_free + scheme.beta * h * h * change
            v = v_free + scheme.gamma * h * change
            drive = drive_free + self.contact.response @ force
        ma = body.mass(a)
        ka = (rhs - self._c_mass * ma) / self._c_stiffness  # from the equation just solved
        du0, du1 = h * h * (0.5 - scheme.beta), h * h * scheme.beta
        dv0, dv1 = h * (1.0 - scheme.gamma), h * scheme.gamma
        later = State(
            t_s=now.t_s + h,
            u=u,
            v=v,
            a=a,
            mu=now.mu + h * now.mv + du0 * now.ma + du1 * ma,
            mv=now.mv + dv0 * now.ma + dv1 * ma,
            ma=ma,
            ku=now.ku + h * now.kv + du0 * now.ka + du1 * ka,
            kv=now.kv + dv0 * now.ka + dv1 * ka,
            ka=ka,
            drive=drive,
        )
        return later, force

    def step_defect(self, before: State, after: State, force: Array) -> float:
        """Bound on the energy norm √(2E) of what a reduced body's step got wrong, in √J.

        A residual r of the equation of motion changes velocity and displacement of the step by
        γ h A⁻¹ r and β h² A⁻¹ r, whose energy is at most h²/4 rᵀ A⁻¹ r for the average
        acceleration. Zero for bodies that leave nothing out.
        """
        if self.body.defect is None:
            return 0.0
        part = 1.0 - self.scheme.alpha_f
        u = part * after.u + self.scheme.alpha_f * before.u
        v = part * after.v + self.scheme.alpha_f * before.v
        motion, points = u + self.body.beta_s * v, self.body.contact
        along_pressure = self._symmetric * (points.pressures(motion) - force)
        norm = self.body.defect.energy_norm(
            np.concatenate([points.weights * force, points.weights * along_pressure]),
            motion,
            self._c_mass,
            self._c_stiffness,
        )
        return self.its_s / math.sqrt(2.0) * norm

    def end_force(self, state: State) -> Array:
        """Contact forces per area share (n,) in N at the instant of ``state``, from the law."""
        return self.method.law.force(state.drive, self.tau)
