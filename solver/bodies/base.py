"""What a body must offer to the stepper, and where and how it can touch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

Array = NDArray[np.floating]
SparseOrDense = Any  # a NumPy array or a SciPy sparse matrix; both know `@` and `.T`


@dataclass(frozen=True)
class ContactPoints:
    """The points of the end section that can touch, as operators on a body's unknowns.

    ``normal`` (n, dofs) gives the upward displacement of each point, ``pressure`` (n, dofs) the
    section area times the normal pressure -σ_zz there, both for the unknowns that this rank owns.
    ``weights`` (n,) are the points' shares of the area and sum to 1, ``xy_m`` (n, 2) their place
    on the section.
    """

    normal: SparseOrDense
    pressure: SparseOrDense
    weights: Array
    xy_m: Array
    comm: MPI.Intracomm = field(default_factory=lambda: MPI.COMM_SELF)

    def _reduce(self, local: Array) -> Array:
        if self.comm.size == 1:
            return local
        return self.comm.allreduce(local)

    def heights(self, u: Array) -> Array:
        """Upward displacement of every point (n,), the same on every rank."""
        return self._reduce(self.normal @ u)

    def pressures(self, u: Array) -> Array:
        """Section area times normal pressure at every point (n,), in N, the same on every rank."""
        return self._reduce(self.pressure @ u)

    def tip_height(self, u: Array) -> float:
        """Mean upward displacement of the end section."""
        return float(self.weights @ self.heights(u))


class StepDefect(Protocol):
    """How far a step of a reduced body is from the full order's (see modal.Defect)."""

    def energy_norm(
        self, force: Array, motion: Array, c_mass: float, c_stiffness: float
    ) -> float: ...


class Body(Protocol):
    """A linear body M, K with Rayleigh damping alpha M + beta K, free in space.

    Unknowns are vectors of the entries that this rank owns. ``lift`` is the rigid upward
    translation by 1 m.
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
    def lift(self) -> Array: ...
    @property
    def defect(self) -> StepDefect | None: ...

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
