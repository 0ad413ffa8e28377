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
    solid: SolidBody, solve: Callable[[Array], Array], n_krylov: int
) -> tuple[Array, Array]:
    """M-orthonormal basis (n_local, k), and M times it.

    Rigid motions; ``n_krylov`` Krylov vectors of a uniform pressure on the tip; and the response
    to each contact point alone, without which an uneven pressure would meet a tip too stiff.
    Directions that carry nothing new are dropped.
    """
    contact = solid.contact
    local = solve(contact.normal.T.toarray())
    limit = 6 + n_krylov + local.shape[1]
    basis, images = (np.empty((solid.n_local, limit), order="F") for _ in range(2))
    count = 0

    def add(x: Array) -> bool:
        nonlocal count
        size = np.sqrt(solid.dot(x, solid.mass(x)))
        for _ in range(2):
            x = x - basis[:, :count] @ _total(solid, images[:, :count].T @ x)
        image = solid.mass(x)
        norm = np.sqrt(max(solid.dot(x, image), 0.0))
        if norm <= DEFLATED * size:
            return False
        basis[:, count], images[:, count] = x / norm, image / norm
        count += 1
        return True

    for motion in solid.rigid_motions().T:
        add(motion)
    vector: Array = local @ contact.weights
    for _ in range(n_krylov):
        if not add(vector):
            break
        vector = solve(images[:, count - 1])
    for response in local.T:
        add(response)
    return basis[:, :count], images[:, :count]


def reduce_solid(solid: SolidBody, shift_1_s2: float, n_krylov: int = 24) -> ReducedModel:
    """The solid in rigid motions, ``n_krylov`` Krylov vectors and its tip's own responses.

    ``shift_1_s2`` is s above. Raises ComputationError where the reduced stiffness is not
    positive semidefinite.
    """
    solve = solid.factor(shift_1_s2, 1.0)
    contact = solid.contact
    basis, images = krylov_basis(solid, solve, n_krylov)
    stiff = np.stack([solid.stiffness(v) for v in basis.T], axis=1)
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
    left_over = np.hstack([contact.normal.T.toarray() - images @ normal.T, stiff - images * omega2])
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
