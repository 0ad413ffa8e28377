"""Interface of a body to the time stepper, and its contact points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...meshes.collective import ALONE
from ..arrays import Array

if TYPE_CHECKING:
    from mpi4py import MPI

SparseOrDense = Any  # a NumPy array or a SciPy sparse matrix; both know `@` and `.T`


@dataclass(frozen=True)
class ContactPoints:
    """Contact points of the end section, as operators on a body's unknowns.

    ``coordinates`` (r, dofs) are rows over this rank's unknowns for the few coordinates that move
    the section: a tip node's displacements and rotations, or the displacements of a face's nodes.
    The displacement of point i, along body axes, is ``shapes[i]`` (3, s) times their entries
    ``support[i]`` (s,). Row 3 i + k of ``traction`` (3 n, dofs) is the section area times the
    traction of the body's stress along axis k (a force on the body in N). ``weights`` (n,) are the
    points' shares of the area and sum to 1. ``places_m`` (n, 3) are their positions from the centre
    of mass, in body axes.
    """

    coordinates: SparseOrDense
    support: NDArray[np.int64]
    shapes: Array
    traction: SparseOrDense
    weights: Array
    places_m: Array
    comm: MPI.Intracomm = ALONE

    @cached_property
    def rows(self) -> Array:
        """Displacement of every point along every axis, as rows (3 n, r) over the coordinates."""
        n, s = self.support.shape
        dense = np.zeros((3 * n, self.coordinates.shape[0]))
        for i in range(n):
            for a in range(s):
                dense[3 * i : 3 * i + 3, self.support[i, a]] += self.shapes[i, :, a]
        return dense

    @cached_property
    def displacement(self) -> SparseOrDense:
        """Displacement of every point along every axis, as rows (3 n, dofs) over the unknowns."""
        return self.rows @ dense_of(self.coordinates)

    def moved(self, u: Array) -> Array:
        """The section's coordinates (r,), or (r, m) for columns, the same on every rank."""
        return np.asarray(summed(self.comm, self.coordinates @ u))

    def displacements(self, u: Array) -> Array:
        """Displacement of every point (n, 3), or (n, 3, m) for columns, the same on every rank."""
        moved = self.rows @ self.moved(u)
        return np.asarray(moved).reshape(len(self.weights), 3, *u.shape[1:])

    def tractions(self, u: Array) -> Array:
        """Section area times traction at every point (n, 3) in N, the same on every rank."""
        values = summed(self.comm, self.traction @ u)
        return np.asarray(values).reshape(len(self.weights), 3, *u.shape[1:])

    @property
    def xy_m(self) -> Array:
        """Positions on the section (n, 2)."""
        return self.places_m[:, :2]


def with_offsets(contact: ContactPoints, offsets_m: Array) -> ContactPoints:
    """The points moved up the axis by ``offsets_m`` (n,), for an end face that is not flat.

    Only their positions change, not the body's displacement or traction there.
    """
    places = contact.places_m.copy()
    places[:, 2] += offsets_m
    return replace(contact, places_m=places)


def axial_point(moved: Array, place_m: Array) -> ContactPoints:
    """One point at ``place_m`` (3,) that the unknowns displace by ``moved`` (dofs,) along the axis
    alone, without traction."""
    return ContactPoints(
        coordinates=np.ascontiguousarray(moved[None]),
        support=np.zeros((1, 1), dtype=np.int64),
        shapes=np.array([[[0.0], [0.0], [1.0]]]),
        traction=np.zeros((3, len(moved))),
        weights=np.ones(1),
        places_m=place_m[None],
    )


def summed(comm: MPI.Intracomm, local: Array) -> Array:
    """The sum of all ranks' arrays ``local``."""
    if comm.size == 1:
        return local
    total = np.empty(local.shape)
    comm.Allreduce(np.ascontiguousarray(local), total)
    return total


def dense_of(rows: SparseOrDense) -> Array:
    """Rows as a NumPy array."""
    return rows.toarray() if hasattr(rows, "toarray") else np.asarray(rows)


class Body(Protocol):
    """A linear body M, K with Rayleigh damping alpha M + beta K, free in space.

    Unknowns are vectors of the entries that this rank owns, in body axes. ``translation`` (dofs,
    3) are the rigid translations by 1 m.
    """

    @property
    def name(self) -> str: ...
    @property
    def n_dofs(self) -> int: ...
    @property
    def mass_kg(self) -> float: ...
    @property
    def alpha_1_s(self) -> float: ...
    @property
    def beta_s(self) -> float: ...
    @property
    def contact(self) -> ContactPoints: ...
    @property
    def translation(self) -> Array: ...

    def mass(self, x: Array) -> Array:
        """M x, for one vector (n,) or the columns of (n, m)."""
        ...

    def stiffness(self, x: Array) -> Array:
        """K x."""
        ...

    def factor(self, c_mass: float, c_stiffness: float) -> Callable[[Array], Array]:
        """A function that solves (c_mass M + c_stiffness K) x = b."""
        ...

    def dot(self, x: Array, y: Array) -> float:
        """Inner product over all ranks."""
        ...
