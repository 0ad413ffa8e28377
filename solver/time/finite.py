"""Time step of a solid at finite strain and rotation: PETSc's SNES around an exact contact solve.

The increment d of a step solves the balance of momentum at mid-step (solver.forms). SNES looks for
the fixed point d = G(d). G linearises the body with a tangent factored some steps ago, and solves
the contact law exactly on that linear body, through the compliance of its contact points. So
opening and slipping need no new factor, only further rotation or bending of the body does. A drop
of 40 steps at 54 675 unknowns needs one to five factors; Newton's method on the assembled form
(tests/reference/assembled.py) makes three a step.

With an old tangent a few directions, those of the steepest bending, converge slowly. SNES' Anderson
mixing (Walker and Ni, SIAM J. Numer. Anal. 49, 2011) removes them. PETSc options have the prefix
``bristle_``: ``-bristle_snes_type ngmres``, ``-bristle_snes_monitor``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

import numpy as np
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from petsc4py import PETSc

from ..arrays import Array
from ..bodies.solid import SolidBody
from ..bodies.tip import TipTractions
from ..contact.enforcement import ContactMethod
from ..contact.laws import ContactLaw, Coulomb
from ..errors import ComputationError
from ..form_cache import form
from ..forms import StepForms, own_values
from ..ground import Placement
from .march import ContactMarch, Moving, Step
from .scheme import TimeScheme
from .tangent import Tangent, Tangents

PREFIX = "bristle_"
# PETSc computes several inner products by one BLAS call if the vectors are evenly spaced in memory.
# Rounding would then depend on the heap, and a restart would not agree bit for bit.
BY_BLAS = "vec_mdot_use_gemv"
# Tolerance of the increment, relative to its size.
PRECISION = 1e-10
# Tolerance of the contact forces, which an increment that is mostly rigid motion does not resolve.
# The steps of an impact together do work of a few times its energy, so budgets, which must close to
# 1e-6, lose a hundredth of that. A change within rounding of the force that would balance the
# step's momentum counts as none.
FORCE_PRECISION, ROUNDED = 1e-8, 1e-13
# The tangent is factored again if an iteration leaves more than `SLOW` of the last error, or after
# `PATIENCE` iterations: a factor costs as much as some thirty.
SLOW, PATIENCE = 0.7, 15
FACTORS = 6


class FiniteMarcher(ContactMarch):
    """Time stepper of a solid at finite strain and rotation over the ground; conserves energy.

    Raises ComputationError for a time scheme other than the conserving one.
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
        if not scheme.conserving:
            raise ComputationError("finite strain is marched by the conserving scheme alone")
        super().__init__(body, method, scheme, its_s, gravity_m_s2)
        self.solid = body
        self.forms = StepForms(body.space, body.material, finite=finite)
        self.forms.its.value = its_s
        self._internal = form(self.forms.internal())
        self._energy = form(self.forms.strain_energy())
        self._loss = form(self.forms.stress_loss())
        self._surface: TipTractions | None = None
        if self.tau:
            self._surface = TipTractions(body.tip, self.forms, len(body.contact.weights))
        self.tangents = Tangents(body, self.forms, self._surface, self.tau, method.theta)
        self._tangent: Tangent | None = None
        options = PETSc.Options()
        if not options.hasName(BY_BLAS):
            options.setValue(BY_BLAS, False)
        self._force = fem_petsc.create_vector(self._internal)
        self._inertia = (2.0 / its_s + body.alpha_1_s) / its_s
        self._weights = np.repeat(body.contact.weights, 3)
        size = len(self._weights) if self.tau else body.contact.coordinates.shape[0]
        self._compliance = np.zeros((size, size))  # until there is a tangent
        self.place(Placement.upright(body.contact))

    # --- the state ------------------------------------------------------------------------------

    def start(self, t_s: float, u: Array, v: Array) -> Moving:
        """The state for displacement ``u`` and velocity ``v``; contact starts anew."""
        self.contact.reset()
        moved = -self.body.contact.displacements(u)
        if self._surface is not None:
            self._set(u, v, np.zeros_like(u))
            moved = moved + self.tau * self._surface.start()
        return Moving(t_s, u, v, self.body.mass(u), self.body.mass(v), self.in_frames(moved))

    def tractions(self, state: Moving) -> Array:
        assert self._surface is not None
        self._set(state.u, np.zeros_like(state.u), np.zeros_like(state.u))
        return self._surface.start()

    def strain_energy_J(self, state: Moving) -> float:
        self._set(state.u, state.v, np.zeros_like(state.u))
        return self._total(self._energy)

    def damping_loss_J(self, before: Moving, after: Moving, force: Array) -> float:
        body, loss, d = self.solid, 0.0, after.u - before.u
        if body.beta_s:
            self._set(before.u, before.v, d)
            loss += self._total(self._loss)
            if self._surface is not None:
                weighted = self.body.contact.weights[:, None]
                forces = weighted * self.along_axes(force)
                elastic = self.tractions(after) - self.tractions(before)
                self._set(before.u, before.v, d)
                viscous = self._surface.end() - self._surface.start() - elastic
                loss -= self.tau * float(np.sum(forces * viscous))
                mean = self._surface.viscous()
                loss -= self._symmetric * float(np.sum(weighted * mean * elastic))
        if body.alpha_1_s:
            loss += body.alpha_1_s / self.its_s * body.dot(d, after.mu - before.mu)
        return loss

    def with_law(self, law: ContactLaw, friction: Coulomb | None = None) -> Self:
        other = super().with_law(law, friction)
        other._tangent = None
        return other

    def memory(self) -> dict[str, Array]:
        """The state at which the present tangent was made."""
        return {} if self._tangent is None else {"u": self._tangent.u, "d": self._tangent.d}

    def recall(self, arrays: Mapping[str, Array]) -> None:
        if arrays:
            self._linearise(arrays["u"], arrays["d"])

    # --- the step -------------------------------------------------------------------------------

    def step(self, now: Moving) -> Step:
        """The next state and the contact forces; collective.

        Raises ComputationError, with time and residual, if the iteration does not converge.
        """
        h = self.its_s
        constant = 2.0 / h * now.mv + self._weight
        self._set(now.u, now.v, np.zeros_like(now.u))
        d: Array = h * now.v
        if self._tangent is None:
            # not at the guess: its straight paths stretch a rotating body
            self._linearise(now.u, np.zeros_like(d))
        elif not self.tangents.has(self._tangent):  # another march has replaced it
            self._linearise(self._tangent.u, self._tangent.d)
        force = np.zeros_like(now.approach)
        for _ in range(FACTORS):
            iteration = Iteration(self, now, constant, force)
            if iteration.run(d):
                break
            d, force = iteration.image, iteration.force
            if not np.isfinite(d).all():
                raise self._not_converged(now, iteration)
            self._linearise(now.u, d)
        else:
            raise self._not_converged(now, iteration)
        return self._arrived(now, iteration.image, iteration.force)

    def _arrived(self, now: Moving, d: Array, force: Array) -> Step:
        """The step with this increment and these contact forces."""
        h, moved = self.its_s, self.body.mass(d)
        later = Moving(
            t_s=now.t_s + h,
            u=now.u + d,
            v=2.0 / h * d - now.v,
            mu=now.mu + moved,
            mv=2.0 / h * moved - now.mv,
            approach=self.contact.end,
        )
        return Step(later, force, *self.taken(now.approach, force))

    def _not_converged(self, now: Moving, iteration: Iteration) -> ComputationError:
        return ComputationError(
            f"the step of {self.its_s:g} s from t = {now.t_s:.6g} s did not converge: the last "
            f"iteration changed the increment by {iteration.change:.3g} of it, and the contact "
            f"forces by {iteration.force_change:.3g} of them; shorten the ITS"
        )

    def linear_response(self, now: Moving, d: Array, constant: Array, force: Array) -> Array:
        """The increment of the body linearised at ``d``, with the contact forces that belong to it.

        ``force`` (n, 3), along the local frames, holds the last iterate's forces; it is
        overwritten.
        """
        self._set(now.u, now.v, d)
        rest = self._inertia * self.body.mass(d) - constant + self._internal_force()
        points, surface, tangent = self.body.contact, self._surface, self._tangent
        assert tangent is not None
        if surface is None:
            free = d - tangent.solve(rest)
            start = -points.displacements(now.u + free)
        else:
            assert tangent.to_tractions is not None
            assert tangent.tractions is not None
            along = self.along_axes(force)
            excess = self._weights.reshape(-1, 3) * (along - surface.mean())
            rest += self._symmetric * surface.pushed(excess)
            free = d - tangent.solve(rest)
            free += tangent.to_tractions @ (self._weights * along.ravel())
            moved = surface.end() + tangent.tractions(free - d).reshape(-1, 3)
            start = self.tau * moved - points.displacements(now.u + free)
        force[:] = self.pushed(now.approach, self.in_frames(start))
        if not force.any():
            return free
        forces = self._weights * self.along_axes(force).ravel()
        free += tangent.to_points @ (points.rows.T @ forces)
        if tangent.to_tractions is not None:
            free -= tangent.to_tractions @ forces
        return free

    def _linearise(self, u: Array, d: Array) -> None:
        """Make the tangent at ``d``, and the compliance of the contact points from it."""
        self._tangent = self.tangents.at(u, d)
        self._compliance = self._tangent.compliance
        self.contact.section = self._section()

    def _internal_force(self) -> Array:
        """Internal force at mid-step with damping, in N (n_local,)."""
        assemble(self._force, self._internal)
        return self._force.array.copy()

    def _set(self, u: Array, v: Array, d: Array) -> None:
        for function, values in ((self.forms.u, u), (self.forms.v, v), (self.forms.d, d)):
            own_values(function, values)

    def _total(self, energy: fem.Form) -> float:
        return float(self.solid.comm.allreduce(fem.assemble_scalar(energy)))

    def vector(self) -> PETSc.Vec:
        """A new vector of the body's unknowns, owned by the caller."""
        return self._force.duplicate()

    def close(self) -> None:
        """Free what PETSc holds; this march and those from `with_law` cannot be used afterwards."""
        self.tangents.close()
        self._force.destroy()


def assemble(vector: PETSc.Vec, load: fem.Form) -> None:
    """Assemble the ``load`` of all ranks into ``vector``."""
    with vector.localForm() as local:
        local.set(0.0)
    fem_petsc.assemble_vector(vector, load)
    vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)


class Iteration:
    """SNES' iteration for one step's increment with the present tangent.

    ``image`` is G of the last argument and ``force`` its contact forces. ``change`` is the relative
    difference between image and argument, ``force_change`` that between successive forces.
    """

    def __init__(self, march: FiniteMarcher, now: Moving, constant: Array, force: Array) -> None:
        self._march, self._now, self._constant = march, now, constant
        self.force, self.image = force.copy(), force
        self.change = self._last = self.force_change = np.inf
        self._smallest_N = ROUNDED * float(
            np.sqrt(march.solid.mass_kg * march.solid.dot(now.v, now.mv))
        )
        self._smallest_N /= march.its_s
        self._failure: ComputationError | None = None

    def run(self, d: Array) -> bool:
        """Iterate from ``d``; whether it ended at a fixed point."""
        x = self._march.vector()
        rest = x.duplicate()
        snes = PETSc.SNES().create(self._march.solid.comm)
        snes.setOptionsPrefix(PREFIX)
        snes.setType(PETSc.SNES.Type.ANDERSON)
        snes.setFunction(self._rest, rest)
        snes.setConvergenceTest(self._test)
        snes.setTolerances(max_it=PATIENCE)
        snes.setFromOptions()
        x.array[:] = d
        try:
            snes.solve(None, x)
            if self._failure is not None:
                raise ComputationError(
                    f"at t = {self._now.t_s:.6g} s: {self._failure}", inputs=self._failure.inputs
                )
            return bool(snes.getConvergedReason() > 0)
        finally:
            for thing in (snes, x, rest):
                thing.destroy()

    def _rest(self, _: PETSc.SNES, x: PETSc.Vec, out: PETSc.Vec) -> None:
        march, d, before = self._march, x.getArray(readonly=True).copy(), self.force.copy()
        try:
            self.image = march.linear_response(self._now, d, self._constant, self.force)
        except ComputationError as error:  # all ranks raise it, and SNES ends
            self._failure, self.change = error, np.nan
            return
        out.array[:] = d - self.image
        dot = march.solid.dot
        size = dot(self.image, self.image)
        self.change = float(np.sqrt(dot(out.array, out.array) / size)) if size else 0.0
        weights, moved = march.body.contact.weights, np.abs(self.force - before).sum(axis=1)
        self.force_change = 0.0
        if (change := float(weights @ moved)) > self._smallest_N:
            self.force_change = change / max(
                float(weights @ np.abs(self.force).sum(axis=1)), change
            )

    def _test(self, snes: PETSc.SNES, count: int, _: tuple[float, float, float]) -> int:
        """PETSc's reason to stop, decided on rank 0."""
        reasons = PETSc.SNES.ConvergedReason
        last, self._last = self._last, self.change
        arrived = self.change <= PRECISION
        reason = reasons.ITERATING
        if arrived and self.force_change <= FORCE_PRECISION:
            reason = reasons.CONVERGED_FNORM_RELATIVE
        elif not self.change <= (np.inf if arrived else SLOW * last) or count >= PATIENCE:
            reason = reasons.DIVERGED_MAX_IT
        return int(self._march.solid.comm.bcast(int(reason)))
