"""Contact points on a rigid plane over one step: penalty with a potential, stick and slip."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import ufl
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray
from petsc4py import PETSc

from ..bodies.base import Array
from ..bristle import positive
from ..errors import ComputationError, InputError
from ..forms import form
from .solid import FiniteSolid

NEWTON_LIMIT = 60
HALVINGS = 8
PRECISION = 1e-12


def mindlin_ratio(poisson: float) -> float:
    """kt/Kn = 2(1-ν)/(2-ν) of a touching disc (Mindlin, J. Appl. Mech. 16, 1949)."""
    return 2.0 * (1.0 - poisson) / (2.0 - poisson)


@dataclass(frozen=True)
class Plane:
    """A rigid plane seen from the body: its outward unit normal (3,), stiffnesses, friction.

    ``kn_N_m`` and ``kt_N_m`` are those of the whole face; ``friction`` is Coulomb's coefficient.
    Raises InputError for a value that cannot be.
    """

    normal: Array
    kn_N_m: float
    kt_N_m: float
    friction: float = 0.0
    tangents: Array = field(init=False)

    def __post_init__(self) -> None:
        positive("Kn", self.kn_N_m)
        positive("the tangential stiffness", self.kt_N_m)
        if not (math.isfinite(self.friction) and self.friction >= 0.0):
            raise InputError(f"the friction coefficient must be zero or more, not {self.friction}")
        normal = np.array(self.normal, dtype=float)
        if normal.shape != (3,) or not abs(np.linalg.norm(normal) - 1.0) < 1e-9:
            raise InputError(f"the plane's normal must be a unit vector, not {self.normal}")
        first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
        first /= np.linalg.norm(first)
        object.__setattr__(self, "normal", normal)
        object.__setattr__(self, "tangents", np.stack([first, np.cross(normal, first)], axis=-1))


@dataclass(frozen=True)
class Response:
    """What the plane does to n points over a step, per area share.

    ``force_N`` (n, 3) on the body at mid-step, ``tangent_N_m`` (n, 3, 3) its derivative by the
    points' increments, ``normal_N`` (n,), and at the end of the step ``penetration_m`` (n,) and
    the tangential spring's ``elongation_m`` (n, 2); ``loss_J`` (n,) to friction over the step.
    """

    force_N: Array
    tangent_N_m: Array
    normal_N: Array
    penetration_m: Array
    elongation_m: Array
    loss_J: Array


def normal_force(kn_N_m: float, s0: Array, s1: Array) -> tuple[Array, Array]:
    """Discrete gradient (V(s1) - V(s0))/(s1 - s0) of V = Kn/2 max(s,0)², and d/ds1 of it.

    ``s0``, ``s1`` (n,) penetrations in m at both ends of the step. It conserves the energy of the
    contact spring (Gonzalez, J. Nonlinear Sci. 6, 1996). Written out by cases there is no quotient
    of small differences: both in contact it is the mean force.
    """
    in0, in1 = np.maximum(s0, 0.0), np.maximum(s1, 0.0)
    crossing = (s0 > 0.0) != (s1 > 0.0)
    width = np.where(crossing, np.abs(s1 - s0), 1.0)
    force = np.where(crossing, (in0 + in1) ** 2 / width, in0 + in1)
    slope_in = np.where(crossing, (2.0 - in1 / width) * in1 / width, 1.0)
    slope_out = np.where(crossing, (in0 / width) ** 2, 0.0)
    return 0.5 * kn_N_m * force, 0.5 * kn_N_m * np.where(s1 > 0.0, slope_in, slope_out)


def respond(plane: Plane, s0: Array, e0: Array, q: Array) -> Response:
    """Forces on points that begin a step with penetration ``s0`` (n,) and elongation ``e0`` (n, 2).

    ``q`` (n, 3) are their increments over the step, m. Coulomb's law by return mapping at
    mid-step: the trial is the mean elastic force kt (e0 + d/2); beyond mu N it is drawn back, and
    the spring's end is set so that the mean holds. Work done on the points is then the change of
    the springs' energy plus a loss mu N |slip| >= 0 exactly. A point free over the whole step
    loses its elongation, and the energy in it counts as lost.
    """
    kt, tangents = plane.kt_N_m, plane.tangents
    s1 = s0 - q @ plane.normal
    normal, slope = normal_force(plane.kn_N_m, s0, s1)
    trial = kt * (e0 + 0.5 * q @ tangents)
    size = np.linalg.norm(trial, axis=1)
    limit = plane.friction * normal
    touching, slips = normal > 0.0, (size > limit) | (plane.friction == 0.0)
    safe = np.where(size > 0.0, size, 1.0)
    direction = trial / safe[:, None]
    scale = np.where(slips, limit / safe, 1.0)
    traction = scale[:, None] * trial
    mean = traction / kt
    e1 = np.where(slips[:, None], 2.0 * mean - e0, e0 + q @ tangents)
    e1 = np.where(touching[:, None], e1, 0.0)
    slip = np.where(slips, 2.0 * (size - limit) / kt, 0.0)
    loss = np.where(touching, limit * slip, 0.5 * kt * np.sum(e0**2, axis=1))
    across = np.einsum("ni,nj->nij", direction, direction)
    plain = 0.5 * kt * np.eye(2)
    keep = np.where(slips[:, None, None], scale[:, None, None] * (plain - 0.5 * kt * across), plain)
    keep = np.where(touching[:, None, None], keep, 0.0)
    by_normal = np.where(slips & touching, -plane.friction * slope, 0.0)[:, None] * direction
    traction = np.where(touching[:, None], traction, 0.0)
    # the increment of the normal force is -slope times the increment along the normal
    tangent = -slope[:, None, None] * np.outer(plane.normal, plane.normal)
    tangent = tangent - tangents @ keep @ tangents.T
    tangent = tangent - np.einsum("ni,j->nij", by_normal @ tangents.T, plane.normal)
    force = normal[:, None] * plane.normal - traction @ tangents.T
    return Response(force, tangent, normal, s1, e1, loss)


def stored_J(plane: Plane, penetration_m: Array, elongation_m: Array) -> Array:
    """Energy per area share in the springs of n points (n,)."""
    tangential = np.sum(elongation_m**2, axis=1)
    return 0.5 * (plane.kn_N_m * np.maximum(penetration_m, 0.0) ** 2 + plane.kt_N_m * tangential)


def solve_contact(
    plane: Plane, weights: Array, s0: Array, e0: Array, free: Array, compliance: Array
) -> Response:
    """The response that agrees with the body: q = free + compliance (w force), for n points.

    ``free`` (n, 3) are the increments without contact, ``compliance`` (3n, 3n) what forces at the
    points add to them, m/N. Newton's method with halved steps; raises ComputationError where it
    does not converge.
    """
    n = len(weights)
    q = free
    response = respond(plane, s0, e0, q)
    if not response.normal_N.any():
        return response

    def rest(q: Array, response: Response) -> tuple[Array, float]:
        push = compliance @ (weights[:, None] * response.force_N).ravel()
        return q.ravel() - free.ravel() - push, max(np.abs(free).max(), np.abs(push).max())

    residual, size = rest(q, response)
    for _ in range(NEWTON_LIMIT):
        if np.abs(residual).max() <= PRECISION * size:
            return response
        blocks = weights[:, None, None] * response.tangent_N_m
        jacobian = np.einsum("aib,ibc->aic", compliance.reshape(3 * n, n, 3), blocks)
        jacobian = np.eye(3 * n) - jacobian.reshape(3 * n, 3 * n)
        step = np.linalg.solve(jacobian, residual).reshape(n, 3)
        before = np.linalg.norm(residual)
        for halving in range(HALVINGS):
            trial = q - 0.5**halving * step
            response = respond(plane, s0, e0, trial)
            residual, size = rest(trial, response)
            if np.linalg.norm(residual) < before:
                break
        q = trial
    raise ComputationError(
        f"contact forces did not converge in {NEWTON_LIMIT} iterations: "
        f"{np.abs(residual).max():.3g} m is left of {size:.3g} m; shorten the ITS"
    )


class TipPoints:
    """The nodes of the tip face that can touch, the same list on every rank.

    ``places_m`` (n, 3) in the mesh's axes, ``weights`` (n,) their shares of the face by
    Gauss-Lobatto quadrature, summing to 1. Raises ComputationError where no facet has the tag.
    """

    def __init__(self, solid: FiniteSolid) -> None:
        self.comm = solid.comm
        tip = ufl.Measure(
            "ds",
            domain=solid.domain,
            subdomain_data=solid.facet_tags,
            metadata={"quadrature_rule": "GLL", "quadrature_degree": 2 * solid.order - 1},
        )(solid.tip_tag)
        vector = fem_petsc.assemble_vector(form(ufl.TestFunction(solid.space)[2] * tip))
        vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        areas = vector.array[2::3].copy()
        vector.destroy()
        # functions of other nodes vanish at the rule's points but for round-off
        largest = self.comm.allreduce(areas.max(initial=0.0), max)
        if largest == 0.0:
            raise ComputationError("no facet of the mesh carries the tip's tag")
        own = np.flatnonzero(areas > 1e-9 * largest)
        parts = self.comm.allgather((solid.places_m[own], areas[own]))
        places = np.vstack([part[0] for part in parts])
        shares = np.concatenate([part[1] for part in parts])
        # an order that does not depend on how many ranks there are
        order = np.lexsort(np.round(places.T / 1e-9))
        start = sum(len(part[1]) for part in parts[: self.comm.rank])
        mine = np.flatnonzero((order >= start) & (order < start + len(own)))
        self._mine: NDArray[np.intp] = mine
        self._nodes: NDArray[np.intp] = own[order[mine] - start]
        self.places_m = places[order]
        self.weights = shares[order] / shares.sum()

    def pull(self, x: Array) -> Array:
        """Values at the points (n, 3) of the vector field ``x``, or (n, 3, m) of m columns."""
        values = np.zeros((len(self.weights), 3, *x.shape[1:]))
        values[self._mine] = x.reshape(-1, 3, *x.shape[1:])[self._nodes]
        return np.asarray(self.comm.allreduce(values))

    def rows(self, n_local: int) -> Array:
        """The transpose of ``pull`` as a matrix (n_local, 3n), for the unknowns of this rank."""
        matrix = np.zeros((n_local // 3, 3, len(self.weights), 3))
        matrix[self._nodes, :, self._mine, :] = np.eye(3)
        return matrix.reshape(n_local, -1)
