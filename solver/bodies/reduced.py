"""The solid in a few modes: Krylov vectors from its contact loads, and how far off they are.

The first vector is the solid's response to a pressure on its tip, each further one the response
(K + s M)⁻¹ M of the last (Nour-Omid and Clough, Earthquake Eng. Struct. Dyn. 12, 1984). With s
the shift of the time scheme's own effective matrix, the full order's march from a rigid fall stays
in exactly this space, so the basis is right for the motion it is asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from ..errors import ComputationError
from .base import Array, ContactPoints
from .modal import Defect, ModalBody
from .solid import SolidBody

DEFLATED = 1e-10


@dataclass(frozen=True)
class ReducedModel:
    """The reduced body, and the way between it and the solid.

    ``basis`` (n_local, k) holds mass-normalised modes, ``mass_basis`` is M times it.
    """

    body: SolidBody
    modal: ModalBody
    basis: Array
    mass_basis: Array

    def to_modal(self, x: Array) -> Array:
        return _total(self.body, self.mass_basis.T @ x)

    def from_modal(self, q: Array) -> Array:
        return self.basis @ q


def krylov_basis(
    solid: SolidBody, solve: Callable[[Array], Array], n_krylov: int, *, tractions: bool = False
) -> tuple[Array, Array]:
    """M-orthonormal basis (n_local, k), and M times it.

    Rigid motions; ``n_krylov`` Krylov vectors of a uniform pressure on the tip; and the response
    to a force at each contact point alone, without which an uneven pressure would meet a tip too
    stiff, and with ``tractions`` to the rows of the pressure, along which Nitsche's method pushes
    too. Directions that carry nothing new are dropped.
    """
    contact = solid.contact
    local = solve(_loads(contact, tractions))
    basis, images = _orthonormal(solid, solid.rigid_motions(), None)
    vector: Array = local[:, : len(contact.weights)] @ contact.weights
    for _ in range(n_krylov):
        new, image = _orthonormal(solid, vector[:, None], (basis, images))
        if not new.size:
            break
        basis, images = np.hstack([basis, new]), np.hstack([images, image])
        vector = solve(image[:, 0])
    new, image = _orthonormal(solid, local, (basis, images))
    return np.hstack([basis, new]), np.hstack([images, image])


def _loads(contact: ContactPoints, tractions: bool) -> Array:
    """The forces (n_local, points or twice as many) that contact can put on the solid."""
    loads = contact.normal.T.toarray()
    return np.hstack([loads, contact.pressure.T.toarray()]) if tractions else loads


def _orthonormal(
    solid: SolidBody, vectors: Array, against: tuple[Array, Array] | None
) -> tuple[Array, Array]:
    """What ``vectors`` (n_local, m) hold beyond ``against``, M-orthonormal, and M times it.

    Twice, since what is left of nearly dependent vectors is mostly rounding the first time.
    """
    vectors = vectors / np.sqrt(_columns(solid, vectors, solid.mass(vectors)))
    for _ in range(2):
        if against is not None:
            vectors = vectors - against[0] @ _total(solid, against[1].T @ vectors)
        image = solid.mass(vectors)
        size, turn = eigh(_total(solid, vectors.T @ image))
        keep = size > max(DEFLATED * size.max(initial=0.0), DEFLATED**2)
        turn = turn[:, keep] / np.sqrt(size[keep])
        vectors, image = vectors @ turn, image @ turn
    return vectors, image


def _columns(solid: SolidBody, x: Array, y: Array) -> Array:
    """Inner products of the columns of ``x`` with those of ``y`` (m,)."""
    return _total(solid, np.einsum("ij,ij->j", x, y))


def reduce_solid(
    solid: SolidBody, shift_1_s2: float, n_krylov: int = 24, *, tractions: bool = False
) -> ReducedModel:
    """The solid in rigid motions, ``n_krylov`` Krylov vectors and its tip's own responses.

    ``shift_1_s2`` is s above; ``tractions`` is for Nitsche's method, see `krylov_basis`. Raises
    ComputationError where the reduced stiffness is not positive semidefinite.
    """
    solve = solid.factor(shift_1_s2, 1.0)
    contact = solid.contact
    basis, images = krylov_basis(solid, solve, n_krylov, tractions=tractions)
    stiff = solid.stiffness(basis)
    reduced = _total(solid, basis.T @ stiff)
    reduced[:6, :] = reduced[:, :6] = 0.0
    omega2, modes = eigh(0.5 * (reduced + reduced.T))
    scale = omega2.max()
    omega2[np.argsort(np.abs(omega2))[:6]] = 0.0
    if omega2.min() < -1e-12 * scale:
        raise ComputationError(
            f"the reduced stiffness is not semidefinite: ω² = {omega2.min():.3g}"
        )
    basis, images, stiff = basis @ modes, images @ modes, stiff @ modes
    normal, pressure = contact.heights(basis), contact.pressures(basis)
    loads = _loads(contact, tractions=True) - images @ np.vstack([normal, pressure]).T
    left_over = np.hstack([loads, stiff - images * omega2])
    modal = ModalBody(
        name="reduced",
        omega2=omega2,
        lift=_total(solid, images.T @ solid.lift),
        contact=ContactPoints(
            normal=normal,
            pressure=pressure,
            weights=contact.weights,
            xy_m=contact.xy_m,
        ),
        alpha_1_s=solid.alpha_1_s,
        beta_s=solid.beta_s,
        defect=Defect(_total(solid, left_over.T @ solve(left_over)), shift_1_s2),
    )
    return ReducedModel(solid, modal, basis, images)


def _total(solid: SolidBody, x: Array) -> Array:
    return x if solid.comm.size == 1 else solid.comm.allreduce(x)
