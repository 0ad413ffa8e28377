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

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import csc_matrix, csr_matrix, vstack

from ..errors import ComputationError
from .axis import Axis
from .base import Array, ContactPoints
from .modal import Defect, ModalBody, in_modes
from .solid import DECIMALS, SolidBody

DEFLATED = 1e-10
# Of a leaning body: Krylov vectors of each load at the time scheme's shift, as a share of those
# asked for; and shifts of its slow motion, in units of its slowest bending's squared frequency,
# each with how many vectors of a load. Long impacts (soft contact) live on these.
SHARE = 0.3
SLOW = ((1.0, 16), (1e4, 16))
AXIS_POINTS = 128
# Numbers in a block of vectors that are worked on together.
BLOCK = 1 << 25


class Basis:
    """M-orthonormal vectors (n_local, count) that grow."""

    def __init__(self, solid: SolidBody, capacity: int) -> None:
        self.solid, self.count = solid, 0
        self._vectors: Array = np.empty((solid.n_local, capacity), order="F")

    @property
    def vectors(self) -> Array:
        return self._vectors[:, : self.count]

    def amounts(self, images: Array) -> Array:
        """How much of each vector is in what M times is ``images`` (n_local,) or (n_local, m)."""
        return _total(self.solid, self.vectors.T @ images)

    def extend(self, vectors: Array) -> Array:
        """Add what ``vectors`` (n_local, m) hold beyond the basis; returns M times what came in.

        Twice, since what is left of nearly dependent vectors is mostly rounding the first time.
        """
        solid = self.solid
        image = solid.mass(vectors)
        size = np.sqrt(_total(solid, np.einsum("ij,ij->j", vectors, image)))
        vectors, image = vectors / size, image / size
        for _ in range(2):
            if self.count:
                vectors = vectors - _combined(self.vectors, self.amounts(image))
                image = solid.mass(vectors)
            size, turn = eigh(_total(solid, vectors.T @ image))
            keep = size > max(DEFLATED * size.max(initial=0.0), DEFLATED**2)
            turn = turn[:, keep] / np.sqrt(size[keep])
            vectors, image = _combined(vectors, turn), _combined(image, turn)
        last = self.count + vectors.shape[1]
        self._vectors[:, self.count : last] = vectors
        self.count = last
        return image


@dataclass(frozen=True)
class ReducedModel:
    """The reduced body, and the way between it and the solid.

    Its modes are the vectors of the ``basis`` times ``turn`` (k, k). ``shift_1_s2`` and
    ``tractions`` are those of `reduce_solid`.
    """

    body: SolidBody
    modal: ModalBody
    basis: Basis
    turn: Array
    shift_1_s2: float
    tractions: bool

    def to_modal(self, x: Array) -> Array:
        return np.asarray(self.turn.T @ self.basis.amounts(self.body.mass(x)))

    def from_modal(self, q: Array) -> Array:
        return np.asarray(self.basis.vectors @ (self.turn @ q))

    def bounded(self) -> ModalBody:
        """The modes with a bound on what they leave out, for marches in them.

        Takes a solve for every coordinate of the section and every mode. Collective.
        """
        solid, modal = self.body, self.modal
        own = modal.contact
        rows = np.vstack([own.coordinates, own.traction]) if self.tractions else own.coordinates
        loads = _loads(solid.contact, leaning=True, tractions=self.tractions)
        modes = _combined(self.basis.vectors, self.turn)
        left_over = np.empty((solid.n_local, len(rows) + modal.n_dofs), order="F")
        for part in _blocks(solid, len(rows)):
            left_over[:, part] = loads[:, part].toarray(order="F")
            left_over[:, part] -= solid.mass(_combined(modes, rows[part].T))
        for part in _blocks(solid, modal.n_dofs):
            left = left_over[:, len(rows) :][:, part]
            left[:] = solid.stiffness(modes[:, part])
            left -= solid.mass(modes[:, part]) * modal.omega2[part]
        answers = solid.factor(self.shift_1_s2, 1.0)(left_over)
        gram = _total(solid, left_over.T @ answers)
        return replace(modal, defect=Defect(gram, self.shift_1_s2))


def krylov_basis(
    solid: SolidBody,
    solve: Callable[[Array], Array],
    n_krylov: int,
    *,
    leaning: bool = False,
    tractions: bool = False,
) -> Basis:
    """The basis of the reduced body.

    Rigid motions; ``n_krylov`` Krylov vectors of a uniform pressure on the tip or, for a
    ``leaning`` body, `SHARE` as many of each resultant of its tractions, and of slow motion; and
    the response to a force at each node of the face (along all axes where it leans), without which
    an uneven pressure would
    meet a tip too stiff, and with ``tractions`` to the rows of the traction, along which Nitsche's
    method pushes too. Directions that carry nothing new are dropped.
    """
    loads = _resultants(solid.contact) if leaning else _resultants(solid.contact)[:, 2:3]
    own = _loads(solid.contact, leaning=leaning, tractions=tractions)
    shifts = _slow_shifts(solid) if leaning else ()
    depth = math.ceil(SHARE * n_krylov) if leaning else n_krylov
    slow = sum(n for _, n in shifts)
    most = 6 + loads.shape[1] * (depth + slow) + own.shape[1]
    basis = Basis(solid, most)
    basis.extend(np.asfortranarray(solid.rigid_motions()))
    _extend_krylov(basis, solve, loads, depth)
    for shift, n in shifts:
        _extend_krylov(basis, solid.factor(shift, 1.0), loads, n)
    for part in _blocks(solid, own.shape[1]):
        basis.extend(solve(own[:, part].toarray(order="F")))
    return basis


def _blocks(solid: SolidBody, count: int) -> Iterator[slice]:
    """``count`` vectors in blocks, the same on every rank."""
    width = max(BLOCK * solid.comm.size // solid.n_dofs, 1)
    for first in range(0, count, width):
        yield slice(first, min(first + width, count))


def _extend_krylov(basis: Basis, solve: Callable[[Array], Array], loads: Array, depth: int) -> None:
    """Add ``depth`` Krylov vectors of every load (n_local, m)."""
    for _ in range(depth):
        loads = basis.extend(solve(loads))
        if not loads.size:
            return


def _resultants(contact: ContactPoints) -> Array:
    """Loads (n_local, 6) of uniform traction along x, y, z and of linear ones about x, y, z."""
    x, y = contact.xy_m.T / np.abs(contact.xy_m).max()
    forces = np.zeros((6, len(contact.weights), 3))
    forces[range(3), :, range(3)] = 1.0
    forces[3, :, 2], forces[4, :, 2] = y, x
    forces[5, :, 0], forces[5, :, 1] = -y, x
    weighted = (forces * contact.weights[:, None]).reshape(6, -1)
    return np.asfortranarray(contact.coordinates.T @ (contact.rows.T @ weighted.T))


def _slow_shifts(solid: SolidBody) -> tuple[tuple[float, int], ...]:
    """Shifts (1/s²) at the slowest bending of a thin bar of this mass and stiffness, and above,
    and how many vectors of each."""
    rigid = solid.rigid_motions()
    turned = np.asfortranarray(rigid[:, 3:])
    moments = _total(solid, np.einsum("ij,ij->j", turned, solid.mass(turned)))
    inertia, twist = moments[:2], moments[2]
    length = np.sqrt(12.0 * inertia.max() / solid.mass_kg)
    axial = (np.pi / length) ** 2 * solid.material.youngs_Pa / solid.material.density_kg_m3
    # the radius of gyration of the section from how bending and torsion inertia compare
    slow = axial * (twist / inertia.max())
    return tuple((slow * factor, n) for factor, n in SLOW)


def _loads(contact: ContactPoints, *, leaning: bool, tractions: bool) -> csc_matrix:
    """The forces (n_local, m) that contact can put on the solid: node by node of the face, and
    along the rows of the traction point by point."""
    rows = vstack([contact.coordinates, *([contact.traction] if tractions else [])], format="csr")
    return (rows if leaning else rows[2::3]).T.tocsc()


def reduce_solid(
    solid: SolidBody,
    shift_1_s2: float,
    n_krylov: int = 24,
    *,
    leaning: bool = False,
    tractions: bool = False,
    second_order: bool = False,
) -> ReducedModel:
    """The solid in rigid motions, ``n_krylov`` Krylov vectors a load and its tip's own responses.

    ``shift_1_s2`` is s above; ``leaning`` is for bristles that touch other than upright,
    ``tractions`` for Nitsche's method, see `krylov_basis`; ``second_order`` see bodies.axis. Raises
    ComputationError where the reduced stiffness is not positive semidefinite.
    """
    solve = solid.factor(shift_1_s2, 1.0)
    grown = krylov_basis(solid, solve, n_krylov, leaning=leaning, tractions=tractions)
    reduced: Array = np.empty((grown.count, grown.count))
    for part in _blocks(solid, grown.count):
        reduced[:, part] = grown.amounts(solid.stiffness(grown.vectors[:, part]))
    reduced = 0.5 * (reduced + reduced.T)
    reduced[:6, :] = reduced[:, :6] = 0.0
    omega2, modes = eigh(reduced)
    scale = omega2.max()
    omega2[np.argsort(np.abs(omega2))[:6]] = 0.0
    if omega2.min() < -1e-12 * scale:
        raise ComputationError(
            f"the reduced stiffness is not semidefinite: ω² = {omega2.min():.3g}"
        )
    rigid = modes.T @ grown.amounts(solid.mass(np.asfortranarray(solid.rigid_motions())))
    rigid[omega2 > 0.0] = 0.0
    modal = ModalBody(
        name="reduced",
        omega2=omega2,
        translation=rigid[:, :3],
        rotation=rigid[:, 3:],
        contact=in_modes(in_modes(solid.contact, grown.vectors), modes),
        alpha_1_s=solid.alpha_1_s,
        beta_s=solid.beta_s,
        axis=solid_axis(solid, grown.vectors).in_modes(modes) if second_order else None,
    )
    return ReducedModel(solid, modal, grown, modes, shift_1_s2, tractions)


def solid_axis(solid: SolidBody, vectors: Array) -> Axis:
    """Axial strain and slopes of the section's mean displacement for ``vectors`` (n_local, k).

    Between `AXIS_POINTS` + 1 layers of nodes at most; nodes count by their share of the mass.
    """
    place = solid.space.tabulate_dof_coordinates()[: solid.n_local // 3, 2]
    share = solid.mass(np.ascontiguousarray(solid.translation[:, 2]))[2::3]
    layers = solid.layers_m
    chosen = np.unique(np.linspace(0, len(layers) - 1, AXIS_POINTS + 1).round().astype(int))
    layer = np.searchsorted(layers, np.round(place, DECIMALS))
    slot = np.searchsorted(chosen, layer)
    own = np.flatnonzero(chosen[np.minimum(slot, len(chosen) - 1)] == layer)
    pick = csr_matrix((share[own], (slot[own], own)), (len(chosen), len(place)))
    total = _total(solid, np.asarray(pick.sum(axis=1)))
    height = np.diff((_total(solid, pick @ place[:, None]) / total)[:, 0])

    def slope(axis: int) -> Array:
        mean = _total(solid, pick @ vectors[axis::3]) / total
        return np.asarray(np.diff(mean, axis=0) / height[:, None])

    stretch = solid.material.youngs_Pa * solid.mass_kg / solid.material.density_kg_m3
    return Axis(slope(2), slope(0), slope(1), stretch / height.sum() * height)


def _combined(vectors: Array, amounts: Array) -> Array:
    """Vectors (n_local, k) times amounts (k, m), in Fortran's order as they are."""
    return np.asarray((amounts.T @ vectors.T).T)


def _total(solid: SolidBody, x: Array) -> Array:
    return x if solid.comm.size == 1 else solid.comm.allreduce(x)
