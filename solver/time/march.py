"""One time step of a linear body in contact: one solve with a matrix factored once."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from scipy.sparse import issparse, vstack

from ...meshes.collective import run_on_one_rank
from ..arrays import Array
from ..bodies.axis import shortening
from ..bodies.base import Body, SparseOrDense, dense_of
from ..bodies.modal import ModalBody
from ..contact.enforcement import ContactMethod, StepContact
from ..contact.laws import ContactLaw, Coulomb
from ..contact.section import Section, new_section
from ..contact.step import Taken
from ..errors import ComputationError
from ..ground import Placement
from .advance import balance, combine, newmark
from .modal_march import Modes, Touching
from .scheme import TimeScheme

# Largest number of contact loads whose responses are stored. A step in contact reads them all;
# beyond this a second solve is faster and takes less memory.
MOST_KEPT = 400
AT_ONCE = 32


@dataclass
class Moving:
    """State of motion at one instant, with the momenta for heights and energies.

    All arrays hold this rank's unknowns. For ``approach`` (n contact points, 3) see
    contact.enforcement.
    """

    t_s: float
    u: Array
    v: Array
    mu: Array
    mv: Array
    approach: Array


@dataclass
class State(Moving):
    """State of a linear body, with the products that its next step needs.

    ``ku`` and the like use the scheme's stiffness, Nitsche's symmetric term included.
    """

    a: Array
    ma: Array
    ku: Array
    kv: Array
    ka: Array


class Step(NamedTuple):
    """Result of a step: the state after it, the contact forces over it per area share (n, 3) in N
    along the points' local frames, and forces and losses of contact (`contact.step.Taken`)."""

    state: Any
    force: Array
    mean_N: float
    final_N: float
    share: float
    friction_loss_J: float
    contact_loss_J: float


class ContactMarch:
    """What all time steppers in contact with the ground at a constant ``its_s`` share.

    ``place`` sets the body's pose and the ground. Initially it stands upright on a horizontal
    plane, unstrained, just touching. The contact force is Qᵀ (w P) with P the force per area share.
    """

    state_type: ClassVar[type] = Moving

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
        self.tau = method.compliance_m_N(body)
        self._symmetric = method.theta * self.tau
        self._mass_translation = body.mass(np.ascontiguousarray(body.translation))
        self._compliance: Array = np.zeros((0, 0))

    def place(self, placement: Placement) -> None:
        """Set the body's pose and the ground; contact starts anew.

        Raises ComputationError for a bristle that fell over: only its lower end can touch.
        """
        along = float(placement.frames[:, 0, 2].min())
        if along <= 0.0:
            raise ComputationError(
                f"the bristle falls over: it comes down at {math.degrees(math.acos(along)):.3g} "
                "degrees to the surface's normal, with its side or upper end, which cannot touch "
                "here; lean it less, or end the drop before that",
                inputs=("until",),
            )
        self.ground = placement
        self._pull = -self.gravity_m_s2 * (self.body.translation @ placement.up)
        self._weight = -self.gravity_m_s2 * (self._mass_translation @ placement.up)
        self._lift = self.body.translation @ placement.up
        self.contact = self._step_contact()

    @property
    def rigid_multiplier(self) -> bool:
        """Whether contact is a multiplier on a rigid plane: no energy, and zero approach."""
        return math.isinf(self.method.law.kn_N_m) and self.tau == 0.0

    def with_law(self, law: ContactLaw, friction: Coulomb | None = None) -> Self:
        """The same stepper, with the same placement, under another law and friction.

        Both share the body's factor and compliance, so closing one closes both. Raises ValueError
        if Nitsche's compliance τ would differ: the default γ₀ has another value on a rigid plane.
        """
        method = replace(
            self.method, law=law, friction=self.method.friction if friction is None else friction
        )
        if method.stabilisation != self.method.stabilisation:
            raise ValueError(
                f"Nitsche's gamma0 is {method.stabilisation:g} at a Kn of {law.kn_N_m:g} N/m, and "
                f"{self.method.stabilisation:g} in this march: make another, or give gamma0"
            )
        other = copy.copy(self)
        other.method = method
        other.contact = other._step_contact()
        return other

    def _section(self) -> Section:
        """Compliance of the contact points over a step.

        ``_compliance`` (r, r) is that of the section's coordinates. With Nitsche it is that of the
        approaches along body axes to the points' forces (3 n, 3 n), and the coordinates of the
        section are the points' own approaches along local frames.
        """
        points, frames = self.body.contact, self.ground.frames
        n = len(points.weights)
        if not self.tau:
            values = np.einsum("iax,ixs->ias", frames, points.shapes)
            return new_section(points.support, values, self._compliance)
        compliance = self._compliance.reshape(n, 3, n, 3) / -points.weights[:, None]
        local = np.einsum("iax,ixjy,jby->iajb", frames, compliance, frames, optimize=True)
        return new_section(
            np.arange(3 * n).reshape(n, 3),
            np.tile(np.eye(3), (n, 1, 1)),
            np.ascontiguousarray(local.reshape(3 * n, 3 * n)),
        )

    def _step_contact(self) -> StepContact:
        return StepContact(
            method=self.method,
            compliance_m_N=self.tau,
            section=self._section(),
            weights=self.body.contact.weights,
            scale=self.ground.scale,
            end_weight=None if self.scheme.conserving else 1.0 - self.scheme.alpha_f,
            its_s=self.its_s,
        )

    def gaps(self, u: Array) -> Array:
        """The gap (n,) in m between every contact point and the ground."""
        return self.ground.gaps(self.body.contact.displacements(u))

    def in_frames(self, moved: Array) -> Array:
        """The approach (n, 3) along the points' local frames for ``moved`` (n, 3) along body
        axes."""
        approach = np.einsum("iax,ix->ia", self.ground.frames, moved)
        approach[:, 0] -= self.ground.gaps_m
        return np.asarray(approach)

    def pushed(self, before: Array, free: Array) -> Array:
        """The forces of `StepContact.solve`, computed on rank 0; collective.

        Rounding differs between kinds of machines, and what the ranks do together depends on
        whether there is a force.
        """

        def solved() -> tuple[Array, Array]:
            return self.contact.solve(before, free), self.contact.end

        force, self.contact.end = run_on_one_rank(self.body.contact.comm, solved)
        return force

    def taken(self, before: Array, force: Array) -> Taken:
        """The result of `StepContact.commit`, computed on rank 0; collective."""
        contact = self.contact

        def committed() -> tuple[Taken, Array, Array]:
            return contact.commit(before, force), contact.memory, contact.last

        taken, contact.memory, contact.last = run_on_one_rank(self.body.contact.comm, committed)
        return taken

    def heights(self, state: Moving, moved: Array | None = None) -> tuple[float, float]:
        """Heights in m of the middle of the end section and of the centre of mass.

        ``moved`` (n, 3) is the points' displacement, if already available.
        """
        body, up = self.body, self.ground.up
        if moved is None:
            moved = body.contact.displacements(state.u)
        tip = body.contact.weights @ moved @ up
        raised = body.dot(self._lift, state.mu) / body.mass_kg
        return self.ground.tip_m + float(tip), self.ground.centre_m + raised

    def along_axes(self, force: Array) -> Array:
        """Forces (n, 3) along the points' local frames, rotated to body axes."""
        return np.einsum("iax,ia->ix", self.ground.frames, force)

    def start(self, t_s: float, u: Array, v: Array) -> Any:
        """The state for displacement ``u`` and velocity ``v``; contact starts anew."""
        raise NotImplementedError

    def step(self, now: Any) -> Step:
        """The next state and the contact forces; ComputationError if there is none."""
        raise NotImplementedError

    def tractions(self, state: Any) -> Array:
        """Section area times the elastic traction at the points (n, 3)."""
        raise NotImplementedError

    def strain_energy_J(self, state: Any) -> float:
        """Strain energy of the body, without Nitsche's boundary term."""
        raise NotImplementedError

    def damping_loss_J(self, before: Any, after: Any, force: Array) -> float:
        """Energy in J lost to Rayleigh damping in a step with the contact ``force`` (n, 3)."""
        raise NotImplementedError

    def memory(self) -> dict[str, Array]:
        """The data, beside state and contact, needed to restart from here bit for bit."""
        return {}

    def recall(self, arrays: Mapping[str, Array]) -> None:
        """Restore the data that `memory` returned."""

    def normal_force(self, approach: Array) -> Array:
        """The law's normal forces per area share (n,) in N at approaches (n, 3), with its
        memory."""
        memory = self.contact.memory[:, 2]
        return self.method.law.force(approach[:, 0], self.tau, self.ground.scale, memory)


class Marcher(ContactMarch):
    """Time stepper of a linear body.

    The effective matrix c_M M + c_K K is factored once. A step costs one solve (two in contact if
    the section has more coordinates than `MOST_KEPT`), one product with M, and a small problem for
    the contact forces through the compliance of the contact points.
    """

    state_type = State

    def __init__(
        self,
        body: Body,
        method: ContactMethod,
        scheme: TimeScheme,
        its_s: float,
        gravity_m_s2: float,
    ) -> None:
        super().__init__(body, method, scheme, its_s, gravity_m_s2)
        self._c_mass, self._c_stiffness = scheme.effective(its_s, body.alpha_1_s, body.beta_s)
        self._solve = self._factor()
        self._forcing = self._load_columns()
        self._green: Array | None = None
        if self.tau or self._forcing.shape[1] <= MOST_KEPT:
            self._green = np.asfortranarray(self._solve(dense_of(self._forcing)))
        self._compliance = self._section_compliance()
        self._modes: Modes | None = None
        self.place(Placement.upright(body.contact))

    def _load_columns(self) -> SparseOrDense:
        """Columns of the contact loads over this rank's unknowns, sparse if the rows are."""
        points = self.body.contact
        rows = [points.coordinates, points.traction] if self._symmetric else [points.coordinates]
        if all(issparse(part) for part in rows):
            return vstack(rows, format="csr").T.tocsc()
        return np.ascontiguousarray(np.vstack([dense_of(part) for part in rows]).T)

    def _factor(self) -> Callable[[Array], Array]:
        """Solver of the effective matrix; Nitsche's low-rank term by Woodbury's identity."""
        body, scheme = self.body, self.scheme
        solve = body.factor(self._c_mass, self._c_stiffness)
        if isinstance(body, ModalBody) and body.loss_factor:
            share = (1.0 - scheme.alpha_f) * scheme.gamma * self.its_s * body.loss_factor
            entries = self._c_mass + self._c_stiffness * body.omega2 + share * np.sqrt(body.omega2)
            return lambda b: (b.T / entries).T
        if self._symmetric == 0.0:
            return solve
        points = self.body.contact
        rows = dense_of(points.traction)
        columns = solve(np.ascontiguousarray(rows.T))
        weights = np.repeat(points.weights, 3)
        capacitance = np.diag(1.0 / (self._c_stiffness * self._symmetric * weights))
        capacitance = capacitance - points.tractions(columns).reshape(len(rows), -1)

        def corrected(b: Array) -> Array:
            x = solve(b)
            values = points.tractions(x).reshape(len(rows), *x.shape[1:])
            return np.asarray(x + columns @ np.linalg.solve(capacitance, values))

        return corrected

    def _section_compliance(self) -> Array:
        """Compliance (r, r) of the section's coordinates at the end of a step.

        With Nitsche, that of the approaches along body axes to the points' forces (3 n, 3 n).
        """
        points, h, scheme = self.body.contact, self.its_s, self.scheme
        du, dv = scheme.beta * h * h, scheme.gamma * h
        if self._green is None:
            parts = [
                points.moved(self._solve(dense_of(self._forcing[:, first : first + AT_ONCE])))
                for first in range(0, self._forcing.shape[1], AT_ONCE)
            ]
            return du * np.hstack(parts)
        if not self.tau:
            return np.ascontiguousarray(du * points.moved(self._green))
        n = 3 * len(points.weights)
        compliance = -du * points.displacements(self._green)
        compliance += self.tau * (du + self.body.beta_s * dv) * points.tractions(self._green)
        pushes = np.stack([self._loads(unit.reshape(-1, 3)) for unit in np.eye(n)], axis=1)
        return np.ascontiguousarray(compliance.reshape(n, -1) @ pushes)

    def _loads(self, force: Array) -> Array:
        """Forces (n, 3) along body axes per area share, as amounts of the load columns."""
        points = self.body.contact
        weighted = (points.weights[:, None] * force).ravel()
        loads = points.rows.T @ weighted
        return np.concatenate([loads, -self._symmetric * weighted]) if self._symmetric else loads

    def stiffness(self, x: Array) -> Array:
        """K x, Nitsche's symmetric term included."""
        kx = self.body.stiffness(x)
        if self._symmetric == 0.0:
            return kx
        points = self.body.contact
        forces = (points.weights[:, None] * points.tractions(x)).ravel()
        return kx - self._symmetric * (points.traction.T @ forces)

    def approach(self, u: Array, v: Array) -> Array:
        """The approach (n, 3) of contact.enforcement along the points' local frames."""
        points = self.body.contact
        moved = -points.displacements(u)
        if self.tau:
            moved = moved + self.tau * points.tractions(u + self.body.beta_s * v)
        return self.in_frames(moved)

    def start(self, t_s: float, u: Array, v: Array) -> State:
        """State for displacement ``u`` and velocity ``v``, with the acceleration of equilibrium.

        The conserving scheme does not depend on the initial acceleration and uses free fall. Raises
        ComputationError for a body with a loss factor, which only the compiled march
        (time.modal_march) supports.
        """
        body = self.body
        if isinstance(body, ModalBody) and body.loss_factor:
            raise ComputationError(
                "a loss factor belongs to modes marched by compiled code: take the conserving "
                "scheme, penalty or the augmented Lagrangian at a finite Kn, and no fields"
            )
        mu, mv, ku, kv = body.mass(u), body.mass(v), self.stiffness(u), self.stiffness(v)
        approach = self.approach(u, v)
        self.contact.reset()
        a: Array = self._pull
        if self.scheme.conserving:
            ma = self._weight
        else:
            force = np.zeros_like(approach)
            force[:, 0] = self.normal_force(approach)
            ma = self._weight + self._forcing @ self._loads(self.along_axes(force))
            ma = ma - body.alpha_1_s * mv - body.beta_s * kv - ku
            a = body.factor(1.0, 0.0)(ma)
        return State(t_s, u, v, mu, mv, approach, a, ma, ku, kv, self.stiffness(a))

    def step(self, now: State) -> Step:
        """The next state and the contact forces.

        Raises ComputationError if the contact forces do not converge.
        """
        body, scheme, h = self.body, self.scheme, self.its_s
        part = 1.0 - scheme.alpha_f
        early_v, early_u = part * h * (1.0 - scheme.gamma), part * h * h * (0.5 - scheme.beta)
        rhs = balance(
            self._weight,
            (now.ku, now.mv, now.ma, now.kv, now.ka),
            (
                body.alpha_1_s,
                scheme.alpha_m + body.alpha_1_s * early_v,
                part * h + body.beta_s,
                early_u + body.beta_s * early_v,
            ),
        )
        a = self._solve(rhs)
        u, v = newmark(now.u, now.v, now.a, a, h, scheme.beta, scheme.gamma)
        approach = self.approach(u, v)
        force = self.pushed(now.approach, approach)
        if force.any():
            loads = self._loads(self.along_axes(force))
            rhs += self._forcing @ loads
            if self._green is None:
                a = self._solve(rhs)
            else:
                combine(a, self._green, loads)
            u, v = newmark(now.u, now.v, now.a, a, h, scheme.beta, scheme.gamma)
            approach = self.contact.end
        ma = body.mass(a)
        ka = (rhs - self._c_mass * ma) / self._c_stiffness
        mu, mv = newmark(now.mu, now.mv, now.ma, ma, h, scheme.beta, scheme.gamma)
        ku, kv = newmark(now.ku, now.kv, now.ka, ka, h, scheme.beta, scheme.gamma)
        later = State(now.t_s + h, u, v, mu, mv, approach, a, ma, ku, kv, ka)
        return Step(later, force, *self.taken(now.approach, force))

    def tractions(self, state: State) -> Array:
        return self.body.contact.tractions(state.u)

    def strain_energy_J(self, state: State) -> float:
        strain = 0.5 * self.body.dot(state.u, state.ku)
        if self._symmetric:
            squared = self.body.contact.weights @ np.sum(self.tractions(state) ** 2, axis=1)
            strain += 0.5 * self._symmetric * float(squared)
        return strain

    def damping_loss_J(self, before: State, after: State, force: Array) -> float:
        """Energy in J lost to Rayleigh damping in a step with the contact ``force`` (n, 3).

        Computed by the scheme's midpoint rule. In Nitsche's method the damping traction moves the
        augmented gap, so the contact force does work on it. That work counts as material loss; over
        a touch the loss then equals that of penalty. In a single step it has either sign.
        """
        body = self.body
        v = 0.5 * (before.v + after.v)
        loss = body.beta_s * body.dot(v, 0.5 * (before.kv + after.kv))
        if body.alpha_1_s:
            loss += body.alpha_1_s * body.dot(v, 0.5 * (before.mv + after.mv))
        loss *= self.its_s
        if self.tau and body.beta_s:
            moved = self.tau * body.beta_s * body.contact.tractions(after.v - before.v)
            forces = body.contact.weights[:, None] * self.along_axes(force)
            loss -= float(np.sum(forces * moved))
        return loss

    def tables(self) -> tuple[Modes, Touching]:
        """The data of the compiled march, for a modal body under the conserving scheme."""
        body, contact, ground, h = self.body, self.contact, self.ground, self.its_s
        assert isinstance(body, ModalBody)
        if self._modes is None:
            points = body.contact
            damping = body.damping_1_s
            tip = np.einsum(
                "i,ixr->xr", points.weights, points.rows.reshape(len(points.weights), 3, -1)
            )
            self._modes = Modes(
                its=h,
                omega2=body.omega2,
                damping=damping,
                admittance=1.0 / (1.0 + 0.5 * h * damping + 0.25 * h * h * body.omega2),
                translation=np.ascontiguousarray(body.translation),
                along=np.ascontiguousarray(points.coordinates),
                support=points.support,
                shapes=np.ascontiguousarray(points.shapes),
                tip=np.ascontiguousarray(tip @ points.coordinates),
                weights=points.weights,
                compliance=self._compliance,
                mass=body.mass_kg,
                axis=shortening(body.axis, body.omega2, body.beta_s, body.loss_factor),
            )
        touching = Touching(
            points=contact.points,
            frames=np.ascontiguousarray(ground.frames),
            gaps=ground.gaps_m,
            up=ground.up,
            tip_m=ground.tip_m,
            centre_m=ground.centre_m,
            gravity=self.gravity_m_s2,
        )
        return self._modes, touching
