"""The solid in a few modes: Krylov vectors from its contact loads, and how far off they are.

The first vectors are the solid's responses to loads on its tip, each further one the response
(K + s M)⁻¹ M of an earlier (Nour-Omid and Clough, Earthquake Eng. Struct. Dyn. 12, 1984). With s
the shift of the time scheme's own effective matrix, the full order's march from a rigid fall stays
in exactly this space, so the basis is right for the motion it is asked for. An upright bristle is
loaded by a pressure alone. A leaning one is loaded by forces and moments about all axes, and rings
in bending afterwards, far below s: its space is a rational one (Ruhe, Linear Algebra Appl. 58,
1984), with shifts down to the slowest bending.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from ..errors import ComputationError
from .base import Array, ContactPoints, dense_of
from .modal import Defect, ModalBody, in_modes
from .solid import SolidBody

DEFLATED = 1e-10
# Shifts of a leaning body's slow motion, in units of its slowest bending's squared frequency.
SLOW_SHIFTS = (1.0, 1e4)
N_SLOW = 6


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
    solid: SolidBody,
    solve: Callable[[Array], Array],
    n_krylov: int,
    *,
    leaning: bool = False,
    tractions: bool = False,
) -> tuple[Array, Array]:
    """M-orthonormal basis (n_local, k), and M times it.

    Rigid motions; ``n_krylov`` Krylov vectors of each load: a uniform pressure on the tip or, for a
    ``leaning`` body, the resultants of its tractions; and the response to a force at each contact
    point alone (along all axes where it leans), without which an uneven pressure would meet a tip
    too stiff, and with ``tractions`` to the rows of the traction, along which Nitsche's method
    pushes too. Directions that carry nothing new are dropped.
    """
    basis = _orthonormal(solid, solid.rigid_motions(), None)
    loads = _resultants(solid.contact) if leaning else _resultants(solid.contact)[:, 2:3]
    basis = _extended(solid, basis, solve, loads, n_krylov)
    if leaning:
        for shift in _slow_shifts(solid):
            basis = _extended(solid, basis, solid.factor(shift, 1.0), loads, N_SLOW)
    local = solve(_loads(solid.contact, leaning=leaning, tractions=tractions))
    new = _orthonormal(solid, local, basis)
    return np.hstack([basis[0], new[0]]), np.hstack([basis[1], new[1]])


def _extended(
    solid: SolidBody,
    basis: tuple[Array, Array],
    solve: Callable[[Array], Array],
    loads: Array,
    depth: int,
) -> tuple[Array, Array]:
    """``basis`` with ``depth`` Krylov vectors of every load (n_local, m)."""
    for _ in range(depth):
        new, image = _orthonormal(solid, solve(loads), basis)
        if not new.size:
            break
        basis = np.hstack([basis[0], new]), np.hstack([basis[1], image])
        loads = image
    return basis


def _resultants(contact: ContactPoints) -> Array:
    """Loads (n_local, 6) of uniform traction along x, y, z and of linear ones about x, y, z."""
    rows = contact.displacement.reshape(len(contact.weights), 3, -1)
    x, y = contact.xy_m.T / np.abs(contact.xy_m).max()
    forces = [contact.weights @ rows[:, axis] for axis in range(3)]
    about_x = (contact.weights * y) @ rows[:, 2]
    about_y = (contact.weights * x) @ rows[:, 2]
    about_z = (contact.weights * x) @ rows[:, 1] - (contact.weights * y) @ rows[:, 0]
    return np.stack([*forces, about_x, about_y, about_z], axis=1)


def _slow_shifts(solid: SolidBody) -> tuple[float, ...]:
    """Shifts (1/s²) at the slowest bending of a thin bar of this mass and stiffness, and above."""
    rigid = solid.rigid_motions()
    inertia = _columns(solid, rigid[:, 3:5], solid.mass(np.ascontiguousarray(rigid[:, 3:5])))
    length = np.sqrt(12.0 * inertia.max() / solid.mass_kg)
    axial = (np.pi / length) ** 2 * solid.material.youngs_Pa / solid.material.density_kg_m3
    # the radius of gyration of the section from how bending and torsion inertia compare
    twist = _columns(solid, rigid[:, 5:], solid.mass(np.ascontiguousarray(rigid[:, 5:])))[0]
    slow = axial * (twist / inertia.max())
    return tuple(slow * np.array(SLOW_SHIFTS))


def _loads(contact: ContactPoints, *, leaning: bool, tractions: bool) -> Array:
    """The forces (n_local, m) that contact can put on the solid: node by node of the face, and
    along the rows of the traction point by point."""
    rows = dense_of(contact.coordinates)
    if tractions:
        rows = np.vstack([rows, dense_of(contact.traction)])
    return np.ascontiguousarray((rows if leaning else rows[2::3]).T)


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
    solid: SolidBody,
    shift_1_s2: float,
    n_krylov: int = 24,
    *,
    leaning: bool = False,
    tractions: bool = False,
) -> ReducedModel:
    """The solid in rigid motions, ``n_krylov`` Krylov vectors a load and its tip's own responses.

    ``shift_1_s2`` is s above; ``leaning`` is for bristles that touch other than upright,
    ``tractions`` for Nitsche's method, see `krylov_basis`. Raises ComputationError where the
    reduced stiffness is not positive semidefinite.
    """
    solve = solid.factor(shift_1_s2, 1.0)
    contact = solid.contact
    basis, images = krylov_basis(solid, solve, n_krylov, leaning=leaning, tractions=tractions)
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
    seen = in_modes(contact, basis)
    loads = _loads(contact, leaning=True, tractions=True)
    loads = loads - images @ np.vstack([seen.coordinates, seen.traction]).T
    left_over = np.hstack([loads, stiff - images * omega2])
    rigid = _total(solid, images.T @ solid.rigid_motions())
    rigid[omega2 > 0.0] = 0.0
    modal = ModalBody(
        name="reduced",
        omega2=omega2,
        translation=rigid[:, :3],
        rotation=rigid[:, 3:],
        contact=seen,
        alpha_1_s=solid.alpha_1_s,
        beta_s=solid.beta_s,
        defect=Defect(_total(solid, left_over.T @ solve(left_over)), shift_1_s2),
    )
    return ReducedModel(solid, modal, basis, images)


def _total(solid: SolidBody, x: Array) -> Array:
    return x if solid.comm.size == 1 else solid.comm.allreduce(x)
