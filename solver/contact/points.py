"""Records of contact over one step: the law at the contact points, and their arrays.

Every point has a local frame: the normal of its plane, then two tangents. Its *approach* is minus
the augmented gap along these axes: minus the displacement, less the gap along the normal, plus
Nitsche's share of the body's traction. The normal component is the penetration in the law. The
tangential ones grow as the point slides backwards. The force on the body, along the same axes, is
(N, T).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Self

import numba

from ..arrays import Array
from ..compiled import Pointer, njit

# The ``end_weight`` that stands for the discrete gradient of the potential.
CONSERVING = 0.0

_float, _row = numba.float64, numba.float64[::1]
ELASTIC = numba.types.UniTuple(_float, 3)(_row, _float, _float, _float, _float)
REMEMBERED = _float(_row, _float, _float, _float)
CLEAR_AT = _float(_row, _float, _float)


class Kind(NamedTuple):
    """The compiled functions of a kind of contact law. Their ``numbers`` (k,) are the law's
    parameters, Kn first, and ``scale`` is the point's stiffness over the law's.

    ``elastic`` (numbers, scale, approach, compliance, memory) returns the force in N, the tangent
    in N/m and the potential in J. A law that ``remembers`` has two more: ``remembered`` (numbers,
    scale, approach, memory) returns the internal variable after a step that ends at the approach,
    ``clear_at`` (numbers, scale, memory) the approach in m at which contact ends. A law that
    ``pulls`` is tensile up to its second number in N, then lets go. ``damps_spring`` says that its
    damping multiplies the spring's force.
    """

    elastic: Pointer
    remembered: Pointer
    clear_at: Pointer
    remembers: bool
    pulls: bool
    damps_spring: bool

    @classmethod
    def of(
        cls,
        elastic: Callable[[Array, float, float, float, float], tuple[float, float, float]],
        remembered: Callable[[Array, float, float, float], float] | None = None,
        clear_at: Callable[[Array, float, float], float] | None = None,
        *,
        pulls: bool = False,
        damps_spring: bool = False,
    ) -> Self:
        """The kind with these functions, compiled by Numba; without the last two it has no
        memory."""
        return cls(
            Pointer(elastic, ELASTIC),
            Pointer(remembered or _unchanged, REMEMBERED),
            Pointer(clear_at or _at_touch, CLEAR_AT),
            remembered is not None,
            pulls,
            damps_spring,
        )


def _unchanged(numbers: Array, scale: float, approach: float, memory: float) -> float:
    return memory


def _at_touch(numbers: Array, scale: float, memory: float) -> float:
    return 0.0


class Points(NamedTuple):
    """The law at the contact points over one step.

    ``law`` (k,) are the parameters of a law of this ``kind``, ``kt`` and ``mu`` friction's.
    ``scale`` (n,) is the points' stiffness over the law's. ``compliance`` is Nitsche's, in series
    with the law, ``proximal`` the augmented Lagrangian's, ``dashpot`` the law's damping over the
    time step. ``end_weight`` is the weight of the end of the step, or `CONSERVING`.
    """

    kind: Kind
    law: Array
    kt: float
    mu: float
    scale: Array
    compliance: float
    weights: Array
    end_weight: float
    proximal: float
    dashpot: float = 0.0


@njit
def changed(
    points: Points,
    law: Array,
    kt: float,
    mu: float,
    scale: Array,
    proximal: float,
    dashpot: float,
) -> Points:
    """The points with other parameters of law and friction, or another proximal compliance."""
    return Points(
        kind=points.kind,
        law=law,
        kt=kt,
        mu=mu,
        scale=scale,
        compliance=points.compliance,
        weights=points.weights,
        end_weight=points.end_weight,
        proximal=proximal,
        dashpot=dashpot,
    )


class Trial(NamedTuple):
    """Arrays (n, 3) of one step: the approach at the ``start``, at the end without contact forces
    (``free``) and with them (``end``), the ``force`` over the step per area share, and the
    augmented Lagrangian's ``multiplier``. ``memory`` is the state: the elongation in m of
    friction's springs along both tangents, then the law's internal variable (zero if none)."""

    start: Array
    free: Array
    end: Array
    force: Array
    memory: Array
    multiplier: Array


class PointForce(NamedTuple):
    """Force of one point over a step, and its derivatives by the approach at the end: dN/ds,
    dT0/d0, dT1/d1, dT0/d1 = dT1/d0, dT0/ds, dT1/ds."""

    n: float
    t0: float
    t1: float
    n_s: float
    t0_0: float
    t1_1: float
    t0_1: float
    t0_s: float
    t1_s: float
