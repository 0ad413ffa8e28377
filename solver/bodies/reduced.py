"""Reduced model of the solid: Krylov vectors from its contact loads, in nested sets.

The first vectors are the solid's responses to loads on its tip. Each further one is the response
(K + s M)⁻¹ M of an earlier one (Nour-Omid and Clough, Earthquake Eng. Struct. Dyn. 12, 1984). The
shift s is that of the time scheme's effective matrix, so after a rigid fall the full-order solution
stays in exactly this space. An upright bristle is loaded by a pressure alone. A leaning one is
loaded by forces and moments about all axes and then vibrates in bending, far below s. Its space is
therefore rational (Ruhe, Linear Algebra Appl. 58, 1984), with shifts down to the slowest bending.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from scipy.linalg import eigh
from scipy.sparse import csc_matrix, csr_matrix, diags_array, vstack

from ...meshes.collective import run_on_one_rank
from ..arrays import Array
from ..cache import load, store
from ..errors import ComputationError
from ..form_cache import form
from ..forms import Expr
from ..rigid import Pose
from .axis import Axis
from .base import ContactPoints, summed
from .matrices import assembled_rows
from .modal import ModalBody, body_in_modes, from_arrays, in_modes, to_arrays
from .solid import SolidBody

DEFLATED = 1e-10
# For a leaning body: Krylov vectors per load at the time scheme's shift, as a share of those
# requested; and further shifts, in units of the squared frequency of the slowest bending, each with
# its number of vectors per load. Long impacts (soft contact) need the latter.
SHARE = 0.3
SLOW = ((1.0, 16), (1e4, 16))
# As `SLOW`, for a body in flight: less than 1e-4 of an impact's energy is outside the vectors. At 2
# to 5 degrees it is 3e-5 with Kn 1e8 N/m (5e-4 with four vectors at the upper shift, 6e-5 with
# eight at the lower one alone), and 1e-7 with Kn 2e6 N/m.
FLYING_SLOW = ((1.0, 4), (1e4, 8))
# Uniform and linear tractions along and about three axes.
RESULTANTS = 6
# Slices along a solid of second order, with two points of its axis in each.
AXIS_SLICES = 64
# Numbers in a block of vectors that are processed together.
BLOCK = 1 << 25
# Default number of Krylov vectors per load, and the shares of it in the coarser models.
USUAL = 40
LEVELS = (0.25, 0.5, 1.0)


class Basis:
    """A growing set of M-orthonormal vectors (n_local, count)."""

    def __init__(self, solid: SolidBody, capacity: int) -> None:
        self.solid, self.count = solid, 0
        self._vectors: Array = np.empty((solid.n_local, capacity), order="F")

    @property
    def vectors(self) -> Array:
        return self._vectors[:, : self.count]

    def amounts(self, images: Array) -> Array:
        """Coefficients of the vectors in x, given ``images`` = M x, (n_local,) or (n_local, m)."""
        return summed(self.solid.comm, self.vectors.T @ images)

    def extend(self, vectors: Array) -> Array:
        """Add the part of ``vectors`` (n_local, m) outside the basis; returns M times that part.

        Orthogonalises twice: of nearly dependent vectors mostly rounding remains the first time.
        """
        solid = self.solid
        image = solid.mass(vectors)
        size = np.sqrt(summed(solid.comm, np.einsum("ij,ij->j", vectors, image)))
        vectors, image = vectors / size, image / size
        for _ in range(2):
            if self.count:
                vectors = vectors - _combined(self.vectors, self.amounts(image))
                image = solid.mass(vectors)
            size, turn = _eigenvectors(solid.comm, summed(solid.comm, vectors.T @ image))
            keep = size > max(DEFLATED * size.max(initial=0.0), DEFLATED**2)
            turn = turn[:, keep] / np.sqrt(size[keep])
            vectors, image = _combined(vectors, turn), _combined(image, turn)
        last = self.count + vectors.shape[1]
        self._vectors[:, self.count : last] = vectors
        self.count = last
        return image


@dataclass(frozen=True)
class ReducedModel:
    """The reduced body, and the maps between it and the solid.

    Its modes are the M-orthonormal ``vectors`` (n_local, k) times ``turn`` (k, k). ``coarser`` are
    the bodies of the first few vectors alone, in ascending order. The differences between their
    motion and the body's own give an estimate of its error against the solid.
    """

    body: SolidBody
    modal: ModalBody
    vectors: Array
    turn: Array
    coarser: tuple[ModalBody, ...] = ()

    def to_modal(self, x: Array) -> Array:
        return self.seen(self.body.mass(x))

    def from_modal(self, q: Array) -> Array:
        """The solid's displacement for modal coordinates ``q`` (k,), or columns (k, m)."""
        return np.asarray(self.vectors @ (self.turn @ q))

    @property
    def flexibility(self) -> Array:
        """One over the squared frequencies (k,), zero for rigid motions."""
        omega2 = self.modal.omega2
        return np.divide(1.0, omega2, out=np.zeros_like(omega2), where=omega2 > 0.0)

    def seen(self, load: Array) -> Array:
        """A load (n_local,) in modal coordinates."""
        return np.asarray(self.turn.T @ summed(self.body.comm, self.vectors.T @ load))

    def launched(self, pose: Pose, u: Array, v: Array) -> tuple[Pose, Array, Array]:
        """As `solver.drop.FlightFrame`: small motion is relative to the pose in contact.

        The strained part is the closest in energy, so a flight never has more of it than the body.
        """
        still = np.where(self.modal.omega2 > 0.0, 0.0, self.to_modal(u))
        strained = self.flexibility * self.seen(self.body.stiffness(u))
        return pose, still + strained, self.to_modal(v)

    def landed(self, q: Array, qv: Array) -> tuple[Array, Array]:
        """As `solver.drop.FlightFrame`."""
        return self.from_modal(q), self.from_modal(qv)

    def energy_J(self, u: Array, v: Array) -> float:
        """As `solver.drop.FlightFrame`."""
        body = self.body
        return 0.5 * (body.dot(v, body.mass(v)) + body.dot(u, body.stiffness(u)))


def krylov_basis(
    solid: SolidBody,
    shift_1_s2: float,
    n_krylov: int,
    *,
    leaning: bool,
    tractions: bool = False,
    flying: bool = False,
) -> tuple[Basis, list[int]]:
    """The basis of the reduced body, and the numbers of its vectors in the coarser models.

    It holds the rigid motions and the response to a force at each node of the face (along all axes
    if leaning), without which the tip would be too stiff against an uneven pressure. With
    ``tractions`` it also holds responses to the rows of the traction, along which Nitsche's method
    applies forces. Then come ``n_krylov`` Krylov vectors of a uniform pressure on the tip. A
    ``leaning`` body has instead `SHARE` as many of each resultant of its tractions, and vectors of
    slow motion. A body that is only ``flying`` needs neither the tip's responses nor coarser
    models. Linearly dependent directions are dropped.
    """
    loads = _resultants(solid.contact) if leaning else _resultants(solid.contact)[:, 2:3]
    own = _loads(solid.contact, leaning=leaning, tractions=tractions)
    if flying:
        own = own[:, :0]
    solve = solid.factor(shift_1_s2, 1.0)
    slow = FLYING_SLOW if flying else SLOW
    depth, *further = depths = _depths(n_krylov, slow if leaning else None)
    sequences = [KrylovSequence(solid, solve, loads, depth)]
    for (factor, _), deep in zip(slow if leaning else (), further, strict=True):
        slower = solid.factor(factor * slowest_1_s2(solid), 1.0)
        sequences.append(KrylovSequence(solid, slower, loads, deep))
    basis = Basis(solid, 6 + own.shape[1] + loads.shape[1] * sum(depths))
    basis.extend(np.asfortranarray(solid.rigid_motions()))
    counts: list[int] = []
    for share in LEVELS[-1:] if flying else LEVELS:
        for sequence in sequences:
            sequence.extend(basis, math.ceil(share * sequence.depth))
        if not counts:  # after the first of each sequence, of which these would leave nothing
            for part in _blocks(solid, own.shape[1]):
                basis.extend(solve(own[:, part].toarray(order="F")))
        counts.append(basis.count)
    return basis, counts[:-1]


def krylov_vectors(n_krylov: int, *, leaning: bool) -> int:
    """Largest number of Krylov vectors that `krylov_basis` makes."""
    return (RESULTANTS if leaning else 1) * sum(_depths(n_krylov, SLOW if leaning else None))


def _depths(n_krylov: int, slow: tuple[tuple[float, int], ...] | None) -> list[int]:
    """Krylov vectors of each load at the time scheme's shift, and at those of ``slow`` motion."""
    if slow is None:
        return [n_krylov]
    more = max(n_krylov / USUAL, 1.0)
    return [math.ceil(SHARE * n_krylov), *(round(more * n) for _, n in slow)]


class KrylovSequence:
    """Krylov vectors of the ``loads`` (n_local, m), at most ``depth`` of each.

    Each vector follows from earlier ones of the sequence, not from their part outside a basis.
    """

    def __init__(
        self, solid: SolidBody, solve: Callable[[Array], Array], loads: Array, depth: int
    ) -> None:
        self.depth, self._solve, self._loads, self._done = depth, solve, loads, 0
        self._own = Basis(solid, loads.shape[1] * depth)

    def extend(self, basis: Basis, depth: int) -> None:
        """Add the first ``depth`` vectors of each load to ``basis``."""
        while self._done < depth and self._loads.size:
            before = self._own.count
            self._loads = self._own.extend(self._solve(self._loads))
            if self._loads.size:
                basis.extend(self._own.vectors[:, before:])
            self._done += 1


def _blocks(solid: SolidBody, count: int) -> Iterator[slice]:
    """Slices that divide ``count`` vectors into blocks, the same on every rank."""
    width = max(BLOCK * solid.comm.size // solid.n_dofs, 1)
    for first in range(0, count, width):
        yield slice(first, min(first + width, count))


def _resultants(contact: ContactPoints) -> Array:
    """Loads (n_local, 6): uniform tractions along x, y, z and linear ones about x, y, z."""
    x, y = contact.xy_m.T / np.abs(contact.xy_m).max()
    forces = np.zeros((RESULTANTS, len(contact.weights), 3))
    forces[range(3), :, range(3)] = 1.0
    forces[3, :, 2], forces[4, :, 2] = y, x
    forces[5, :, 0], forces[5, :, 1] = -y, x
    weighted = (forces * contact.weights[:, None]).reshape(RESULTANTS, -1)
    return np.asfortranarray(contact.coordinates.T @ (contact.rows.T @ weighted.T))


def slowest_1_s2(solid: SolidBody) -> float:
    """Squared frequency of the slowest bending of a thin bar with this mass and stiffness."""
    rigid = solid.rigid_motions()
    turned = np.asfortranarray(rigid[:, 3:])
    moments = summed(solid.comm, np.einsum("ij,ij->j", turned, solid.mass(turned)))
    inertia, twist = moments[:2], moments[2]
    length = np.sqrt(12.0 * inertia.max() / solid.mass_kg)
    axial = (np.pi / length) ** 2 * solid.material.youngs_Pa / solid.material.density_kg_m3
    # the section's radius of gyration follows from the inertia in bending and in torsion
    return float(axial * (twist / inertia.max()))


def _loads(contact: ContactPoints, *, leaning: bool, tractions: bool) -> csc_matrix:
    """The possible contact forces (n_local, m): at each node of the face, and along the rows of the
    traction at each point."""
    rows = vstack([contact.coordinates, *([contact.traction] if tractions else [])], format="csr")
    return (rows if leaning else rows[2::3]).T.tocsc()


def reduce_solid(
    solid: SolidBody,
    shift_1_s2: float,
    n_krylov: int = USUAL,
    *,
    leaning: bool = False,
    tractions: bool = False,
    second_order: bool = False,
    flying: bool = False,
) -> ReducedModel:
    """The solid in rigid motions, ``n_krylov`` Krylov vectors per load and responses of its tip.

    ``shift_1_s2`` is s above. ``leaning`` is for bristles that do not touch upright, ``tractions``
    for Nitsche's method, ``flying`` for flight alone, see `krylov_basis`; for ``second_order`` see
    bodies.axis. Raises ComputationError if the reduced stiffness is not positive semidefinite.
    """
    how = {"leaning": leaning, "tractions": tractions, "flying": flying}
    grown, counts = krylov_basis(solid, shift_1_s2, n_krylov, **how)
    reduced: Array = np.empty((grown.count, grown.count))
    for part in _blocks(solid, grown.count):
        reduced[:, part] = grown.amounts(solid.stiffness(grown.vectors[:, part]))
    reduced = 0.5 * (reduced + reduced.T)
    reduced[:6, :] = reduced[:, :6] = 0.0
    rigid = grown.amounts(solid.mass(np.asfortranarray(solid.rigid_motions())))
    contact = in_modes(solid.contact, grown.vectors)
    axis = solid_axis(solid, grown.vectors) if second_order else None

    def body(count: int) -> tuple[ModalBody, Array]:
        """Of the first vectors, and its modes over all of them."""
        omega2, turn = _eigenvectors(solid.comm, reduced[:count, :count])
        scale = omega2.max()
        omega2[np.argsort(np.abs(omega2))[:6]] = 0.0
        if omega2.min() < -1e-12 * scale:
            raise ComputationError(
                f"the reduced stiffness is not semidefinite: ω² = {omega2.min():.3g}"
            )
        modes = np.zeros((grown.count, count))
        modes[:count] = turn
        damping = solid.alpha_1_s, solid.beta_s
        return body_in_modes("reduced", omega2, modes, rigid, contact, *damping, axis), modes

    modal, turn = body(grown.count)
    coarser = tuple(body(count)[0] for count in counts)
    return ReducedModel(solid, modal, grown.vectors, turn, coarser)


def flying_solid(
    solid: SolidBody, shift_1_s2: float, n_krylov: int = USUAL, *, leaning: bool = False
) -> ReducedModel:
    """The solid with the modes that it flies in, from the cache if an earlier run made them.

    Each rank stores its own part. Arguments and errors are those of `reduce_solid`.
    """
    comm, how = solid.comm, (shift_1_s2, n_krylov, leaning)
    made_of = solid.digest(), solid.material, solid.contact.places_m.tobytes(), solid.method
    key = str(("flying", *made_of, *how, comm.rank, comm.size))
    arrays = load(key)
    if not all(comm.allgather(arrays is not None)):
        made = reduce_solid(solid, shift_1_s2, n_krylov, leaning=leaning, flying=True)
        arrays = {"vectors": made.vectors, "turn": made.turn, **to_arrays([made.modal])}
        store(key, arrays)
    assert arrays is not None
    vectors, turn = arrays.pop("vectors"), arrays.pop("turn")
    return ReducedModel(solid, from_arrays(arrays)[0], vectors, turn)


def solid_axis(solid: SolidBody, vectors: Array) -> Axis:
    """Axial strain and slopes of ``vectors`` (n_local, k) at two heights in every slice.

    They are values of the straight line that best fits the gradients in the slice, and so integrals
    over it. A load on one is therefore a smooth stress, which stretches the solid like a bar. A
    load on differences of mean displacements would not, at the ends.
    """
    domain, comm = solid.domain, solid.comm
    cells = fem.functionspace(domain, ("Discontinuous Lagrange", 0))
    nodes = fem.functionspace(domain, ("Lagrange", solid.order))
    numbers, z = cells.dofmap.index_map, ufl.SpatialCoordinate(domain)[2]
    cell, node = ufl.TestFunction(cells), ufl.TestFunction(nodes)
    weights = (ufl.as_ufl(1.0), z, z * z)

    def of_all_ranks(own: Array) -> Array:
        return np.concatenate(comm.allgather(own[: numbers.size_local]))

    height = of_all_ranks(cells.tabulate_dof_coordinates()[:, 2])
    between = np.linspace(height.min(), height.max(), AXIS_SLICES + 1)[1:-1]
    slices = np.unique(np.digitize(height, between), return_inverse=True)[1]  # no empty ones
    volume, first, second = (
        np.bincount(slices, of_all_ranks(fem.assemble_vector(form(weight * cell * ufl.dx)).array))
        for weight in weights
    )
    middle = first / volume
    spread = np.sqrt(second / volume - middle**2)

    def gradients(weight: Expr) -> csr_matrix:
        """∫ ∂/∂z of nodes' shapes over slices, as rows (slices, nodes)."""
        energy = form(weight * ufl.TrialFunction(cells) * node.dx(2) * ufl.dx)
        (start, column, value), columns = assembled_rows(energy)
        at = slices[columns.local_to_global(column)]
        return csr_matrix((value, at, start), (len(start) - 1, len(volume))).T.tocsr()

    mean, moment = gradients(weights[0]), gradients(z)
    linear = diags_array(1.0 / spread) @ (moment - diags_array(middle) @ mean)
    rows = diags_array(np.tile(1.0 / volume, 2)) @ vstack([mean + linear, mean - linear])
    strain, slope_x, slope_y = (summed(solid.comm, rows @ vectors[axis::3]) for axis in (2, 0, 1))
    return Axis(strain, slope_x, slope_y, 0.5 * solid.material.youngs_Pa * np.tile(volume, 2))


def _eigenvectors(comm: MPI.Intracomm, matrix: Array) -> tuple[Array, Array]:
    """Eigenvalues and eigenvectors computed on rank 0: a basis' size and the vectors' signs may
    depend on rounding, which differs between kinds of machines."""
    return run_on_one_rank(comm, lambda: eigh(matrix))


def _combined(vectors: Array, amounts: Array) -> Array:
    """Vectors (n_local, k) times amounts (k, m), in Fortran order like the vectors."""
    return np.asarray((amounts.T @ vectors.T).T)
