"""The solid in a few modes: Krylov vectors from its contact loads, and how far off they are.

Starting vectors are the response of the solid to pressure on its tip; each further block is the
response (K + s M)⁻¹ M of the last (Nour-Omid and Clough, Earthquake Eng. Struct. Dyn. 12, 1984).
With s the shift of the time scheme's own effective matrix, the full order's march from a rigid
fall stays in exactly this space, so the basis is right for the motion it is asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from ..errors import ComputationError
from .base import Array, ContactPoints
from .modal import ModalBody
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


def load_patterns(contact: ContactPoints, degree: int) -> Array:
    """Pressures over the tip (n, patterns): products of powers of x and y up to ``degree``."""
    x, y = (contact.xy_m / np.abs(contact.xy_m).max(axis=0).clip(1e-300)).T
    powers = [x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)]
    return np.stack(powers, axis=1)


def krylov_basis(
    solid: SolidBody, solve: Callable[[Array], Array], loads: Array, n_vectors: int
) -> tuple[Array, Array]:
    """M-orthonormal (n_local, 6 + ``n_vectors``): rigid motions, then Krylov blocks; and M times it.

    ``loads`` (n_local, b) start it. Directions that carry nothing new are dropped, so fewer
    vectors may come back.
    """
    limit = 6 + n_vectors
    basis, images = (np.empty((solid.n_local, limit), order="F") for _ in range(2))
    count = 0

    def add(x: Array) -> Array | None:
        nonlocal count
        if count == limit:
            return None
        size = np.sqrt(solid.dot(x, solid.mass(x)))
        for _ in range(2):
            x = x - basis[:, :count] @ _total(solid, images[:, :count].T @ x)
        image = solid.mass(x)
        norm = np.sqrt(max(solid.dot(x, image), 0.0))
        if norm <= DEFLATED * size:
            return None
        basis[:, count], images[:, count] = x / norm, image / norm
        count += 1
        return x / norm

    for motion in solid.rigid_motions().T:
        add(motion)
    block = [solve(load) for load in loads.T]
    while count < limit and block:
        kept = [v for x in block if (v := add(x)) is not None]
        block = [solve(solid.mass(v)) for v in kept] if count < limit else []
    return basis[:, :count], images[:, :count]


def reduce_solid(
    solid: SolidBody, shift_1_s2: float, n_vectors: int = 40, load_degree: int = 0
) -> ReducedModel:
    """The solid in ``n_vectors`` Krylov vectors and its rigid motions, in modal form.

    ``shift_1_s2`` is s above. Raises ComputationError where the reduced stiffness is not
    positive semidefinite.
    """
    solve = solid.factor(shift_1_s2, 1.0)
    contact = solid.contact
    loads = contact.normal.T @ (contact.weights[:, None] * load_patterns(contact, load_degree))
    basis, images = krylov_basis(solid, solve, loads, n_vectors)
    stiff = np.stack([solid.stiffness(v) for v in basis.T], axis=1)
    reduced = _total(solid, basis.T @ stiff)
    reduced[:6, :] = reduced[:, :6] = 0.0
    omega2, modes = eigh(0.5 * (reduced + reduced.T))
    scale = omega2.max()
    omega2[np.argsort(np.abs(omega2))[:6]] = 0.0
    if omega2.min() < -1e-12 * scale:
        raise ComputationError(f"the reduced stiffness is not semidefinite: ω² = {omega2.min():.3g}")
    basis, images = basis @ modes, images @ modes
    modal = ModalBody(
        name="reduced",
        omega2=omega2,
        lift=_total(solid, images.T @ solid.lift),
        contact=ContactPoints(
            normal=contact.heights(basis),
            pressure=contact.pressures(basis),
            weights=contact.weights,
            xy_m=contact.xy_m,
            traction_scale_N_m=contact.traction_scale_N_m,
        ),
        alpha_1_s=solid.alpha_1_s,
        beta_s=solid.beta_s,
    )
    return ReducedModel(solid, modal, basis, images)


def _total(solid: SolidBody, x: Array) -> Array:
    return x if solid.comm.size == 1 else solid.comm.allreduce(x)
