"""One implicit time step at finite rotation: mid-step equilibrium under contact."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..bodies.base import Array
from ..errors import ComputationError
from .contact import Plane, Response, TipPoints, solve_contact
from .solid import FiniteSolid

NEWTON_LIMIT = 60
# A factor is made anew where an iteration leaves more than this of the change before it, or
# where so many iterations were not enough: it costs as much as some thirty.
SLOW = 0.7
PATIENCE = 12
PRECISION = 1e-8
# Anderson's memory
DEPTH = 6


@dataclass(frozen=True)
class FiniteState:
    """Motion at one instant: this rank's ``u``, ``v``; every point's contact state, see respond."""

    t_s: float
    u: Array
    v: Array
    penetration_m: Array
    elongation_m: Array


@dataclass(frozen=True)
class Step:
    """What a step made: the state at its end, the increment ``d``, the plane's response."""

    state: FiniteState
    d: Array
    response: Response
    n_iterations: int


class FiniteStepper:
    """Marches a FiniteSolid over a plane at constant ``its_s`` (Simo and Tarnow, ZAMP 43, 1992).

    The increment d = u1 - u0 satisfies equilibrium at mid-step, and v1 = 2 d/its - v0. Each
    iteration linearises the body with a tangent factored some steps ago, and solves the contact
    law with no approximation on that linear body, through the compliance of the contact points; so
    neither opening nor slipping asks for a new factor, only a body that has turned or bent since.
    The iteration ends when it changes the increment by less than ``precision`` of it.
    ``gravity_m_s2`` (3,) is in the mesh's axes, as the plane is.
    """

    def __init__(
        self,
        solid: FiniteSolid,
        plane: Plane,
        gravity_m_s2: Array,
        its_s: float,
        precision: float = PRECISION,
    ) -> None:
        self.solid, self.plane, self.its_s, self.precision = solid, plane, its_s, precision
        self.tip = TipPoints(solid)
        self.weight = solid.mass(solid.lifts @ np.asarray(gravity_m_s2, dtype=float))
        self._rows = self.tip.rows(solid.n_local)
        self._inertia = solid.inertia_1_s2(its_s)
        self.n_factors = 0

    def touching(self, velocity: Array) -> FiniteState:
        """The undeformed body at t = 0, its lowest point of the tip on the plane."""
        heights = self.tip.places_m @ self.plane.normal
        return FiniteState(
            t_s=0.0,
            u=np.zeros(self.solid.n_local),
            v=velocity,
            penetration_m=heights.min() - heights,
            elongation_m=np.zeros((len(heights), 2)),
        )

    def step(self, state: FiniteState) -> Step:
        """The step from ``state``; collective.

        Raises ComputationError, with time and residual, where the iteration does not converge.
        """
        solid, its, u = self.solid, self.its_s, state.u
        constant = solid.mass(state.v) * (2.0 / its) + self.weight
        d: Array = its * state.v
        if not self.n_factors:
            # not at the guess, whose straight paths stretch a turning body
            self._factor(u, np.zeros_like(d))
        mixing = Mixing(solid.dot)
        last = change = size = np.inf
        for iteration in range(1, NEWTON_LIMIT + 1):
            out_of_balance = self._inertia * solid.mass(d) - constant
            out_of_balance += solid.internal_force(u, d, its)
            moved, response = self._linear(d - self._solve(out_of_balance), d, state)
            change, size = self._norm(moved - d), self._norm(moved)
            if not np.isfinite(change):
                break
            if change <= self.precision * size:
                end = FiniteState(
                    t_s=state.t_s + its,
                    u=u + moved,
                    v=2.0 / its * moved - state.v,
                    penetration_m=response.penetration_m,
                    elongation_m=response.elongation_m,
                )
                return Step(end, moved, response, iteration)
            if change > SLOW * last or mixing.length >= PATIENCE:
                d = moved
                self._factor(u, d)
                mixing = Mixing(solid.dot)
                last = np.inf
            else:
                d = mixing.next(d, moved)
                last = change
        raise ComputationError(
            f"Newton's method did not converge at t = {state.t_s:.6g} s in {NEWTON_LIMIT} "
            f"iterations of a step of {its:g} s: the last changed the increment by {change:.3g}, "
            f"of {size:.3g} m; shorten the ITS"
        )

    def _linear(self, free: Array, d: Array, state: FiniteState) -> tuple[Array, Response]:
        """The increment of the body linearised at ``d``, that without contact being ``free``."""
        try:
            response = solve_contact(
                self.plane,
                self.tip.weights,
                state.penetration_m,
                state.elongation_m,
                self.tip.pull(free),
                self._point_compliance,
            )
        except ComputationError as error:
            raise ComputationError(f"at t = {state.t_s:.6g} s: {error}") from error
        if not response.normal_N.any():
            return free, response
        push = self.tip.weights[:, None] * response.force_N
        return free + self._compliance @ push.ravel(), response

    def _factor(self, u: Array, d: Array) -> None:
        self._solve = self.solid.factor(u, d, self.its_s)
        self._compliance = self._solve(self._rows)
        n = 3 * len(self.tip.weights)
        self._point_compliance = self.tip.pull(self._compliance).reshape(n, n)
        self.n_factors += 1

    def _norm(self, x: Array) -> float:
        return float(np.sqrt(self.solid.dot(x, x)))


class Mixing:
    """Anderson's acceleration of d = G(d) (Walker and Ni, SIAM J. Numer. Anal. 49, 2011, Sect. 2).

    A tangent that has grown old leaves a few directions, those of the waves' steepest bending,
    that converge slowly; combining the last iterates removes them.
    """

    def __init__(self, dot: Callable[[Array, Array], float]) -> None:
        self._dot = dot
        self._values: list[Array] = []
        self._rests: list[Array] = []
        self.length = 0

    def next(self, d: Array, value: Array) -> Array:
        """The next argument after G(``d``) = ``value``."""
        rest = value - d
        self._values = [*self._values[-DEPTH:], value]
        self._rests = [*self._rests[-DEPTH:], rest]
        self.length += 1
        if self.length == 1:
            return value
        rows = np.diff(self._rests, axis=0)
        gram = np.array([[self._dot(a, b) for b in rows] for a in rows])
        right = np.array([self._dot(a, rest) for a in rows])
        scale = np.sqrt(np.diag(gram))
        weights = np.linalg.lstsq(gram / np.outer(scale, scale), right / scale, rcond=1e-14)[0]
        return value - (weights / scale) @ np.diff(self._values, axis=0)
