"""A body in modal coordinates: diagonal matrices, and free flight in closed form."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from scipy.linalg import eigh, orth
from scipy.sparse.csgraph import connected_components

from ...meshes.collective import ALONE
from ..arrays import Array
from ..bristle import RigidMass
from .axis import Axis
from .base import ContactPoints, axial_point, dense_of

# Types of a body's fields that are not numbers.
NO_NUMBERS = (ContactPoints, Axis, type(ALONE), type(None))


@dataclass(frozen=True)
class ModalBody:
    """Mass-normalised modes with squared angular frequencies ``omega2`` (n,), zero for rigid ones.

    ``contact`` and the rigid motions are in modal coordinates: ``translation`` (n, 3) by 1 m along
    body axes, ``rotation`` (n, 3) by 1 rad about them through the centre of mass. A motion that the
    body does not have is zero. With an ``axis`` contact is computed to second order in slope.
    ``loss_factor`` η damps every elastic mode by η ω, in addition to Rayleigh's damping.
    """

    name: str
    omega2: Array
    translation: Array
    rotation: Array
    contact: ContactPoints
    alpha_1_s: float
    beta_s: float
    axis: Axis | None = None
    loss_factor: float = 0.0

    @property
    def n_dofs(self) -> int:
        return len(self.omega2)

    @property
    def damping_1_s(self) -> Array:
        """Viscous damping (modes,): Rayleigh's α + β ω², and η ω for a loss factor η."""
        return self.alpha_1_s + self.beta_s * self.omega2 + self.loss_factor * np.sqrt(self.omega2)

    @property
    def mass_kg(self) -> float:
        return float(np.sum(self.translation[:, 2] ** 2))

    @property
    def inertia_kg_m2(self) -> Array:
        """Principal moments (3,) about body axes."""
        return np.sum(self.rotation**2, axis=0)

    def mass(self, x: Array) -> Array:
        return x

    def stiffness(self, x: Array) -> Array:
        return self.omega2 * x

    def factor(self, c_mass: float, c_stiffness: float) -> Callable[[Array], Array]:
        inverse = 1.0 / (c_mass + c_stiffness * self.omega2)
        return lambda b: (inverse * b.T).T

    def dot(self, x: Array, y: Array) -> float:
        return float(x @ y)


def modal_form(
    name: str,
    mass: Array,
    stiffness: Array,
    rigid: Array,
    contact: ContactPoints,
    alpha_1_s: float,
    beta_s: float,
    axis: Axis | None = None,
) -> ModalBody:
    """All modes of dense M, K (n, n), given like ``contact``'s rows for the physical unknowns.

    ``rigid`` (n, 6) are translations along and rotations about body axes through the centre of
    mass; a column of zeros is a motion that the body does not have. Uncoupled unknowns (axial
    motion, torsion, the two bendings) are solved separately, so that rounding of fast modes does
    not affect slow ones. Raises ValueError if ``rigid`` strains the body, or rounding hides the
    lowest elastic mode.
    """
    n_groups, group = connected_components((mass != 0.0) | (stiffness != 0.0), directed=False)
    omega2: Array = np.zeros(len(mass))
    modes: Array = np.zeros_like(mass)
    first = 0
    for number in range(n_groups):
        own = np.flatnonzero(group == number)
        last = first + len(own)
        block = np.ix_(own, own)
        omega2[first:last], modes[own, first:last] = _modes_of_group(
            name, mass[block], stiffness[block], rigid[own]
        )
        first = last
    order = np.argsort(omega2, kind="stable")
    omega2, modes = omega2[order], modes[:, order]
    return body_in_modes(name, omega2, modes, mass @ rigid, contact, alpha_1_s, beta_s, axis)


def body_in_modes(
    name: str,
    omega2: Array,
    modes: Array,
    held: Array,
    contact: ContactPoints,
    alpha_1_s: float,
    beta_s: float,
    axis: Axis | None,
) -> ModalBody:
    """The body in the coordinates of ``modes`` (n, m) with squared frequencies ``omega2`` (m,).

    ``held`` (n, 6) is M times the rigid motions; for the rest see `modal_form`.
    """
    still = modes.T @ held
    still[omega2 > 0.0] = 0.0
    return ModalBody(
        name=name,
        omega2=omega2,
        translation=still[:, :3],
        rotation=still[:, 3:],
        contact=in_modes(contact, modes),
        alpha_1_s=alpha_1_s,
        beta_s=beta_s,
        axis=None if axis is None else axis.in_modes(modes),
    )


def in_modes(contact: ContactPoints, modes: Array) -> ContactPoints:
    """The contact points in the coordinates of ``modes`` (n_local, m), on every rank."""
    traction = contact.tractions(modes).reshape(3 * len(contact.weights), -1)
    return replace(
        contact,
        coordinates=np.ascontiguousarray(contact.moved(modes)),
        traction=np.ascontiguousarray(traction),
        comm=ALONE,
    )


def _modes_of_group(name: str, mass: Array, stiffness: Array, rigid: Array) -> tuple[Array, Array]:
    """Squared frequencies (n,) and modes (n, n), rigid motions first and exact.

    Eigenvalues of (K, M) are accurate to rounding of the greatest, so slow modes are lost in it.
    Those of (M, K) are their inverses, accurate for the slow ones. Each serves half of the decades.
    """
    still = orth(rigid) if rigid.any() else np.zeros((len(mass), 0))
    if np.abs(stiffness @ still).max(initial=0.0) > 1e-9 * np.abs(stiffness).max():
        raise ValueError(f"{name}: a rigid motion strains the body")
    still = still @ np.linalg.inv(np.linalg.cholesky(still.T @ mass @ still)).T
    held = mass @ still
    omega2, modes = eigh(stiffness, mass)
    inverse, slow = eigh(mass, stiffness + omega2[-1] * held @ held.T)
    middle = np.sqrt(inverse[-1] / omega2[-1])
    n_slow, n_rigid = int(np.sum(inverse > middle)), still.shape[1]
    if np.finfo(float).eps * len(omega2) * omega2[-1] * middle > 0.01:
        raise ValueError(f"{name}: rounding hides the slowest modes")
    slow = slow[:, : -n_slow - 1 : -1] / np.sqrt(inverse[: -n_slow - 1 : -1])
    slow = slow - still @ (held.T @ slow)
    found = np.hstack([still, slow])
    fast = modes[:, n_rigid + n_slow :]
    fast = fast - found @ (found.T @ mass @ fast)
    omega2[:n_rigid] = 0.0
    omega2[n_rigid : n_rigid + n_slow] = 1.0 / inverse[: -n_slow - 1 : -1]
    return omega2, np.hstack([found, fast])


def rigid_body(mass: RigidMass) -> ModalBody:
    """A ball or any compact body in modes: vertical translation is its only one.

    It touches at a point, does not rotate, slide or bend, and has no losses of its own. So it
    serves upright drops onto level ground, governed by the contact law alone.
    """
    return ModalBody(
        name="rigid",
        omega2=np.zeros(1),
        translation=np.array([[0.0, 0.0, math.sqrt(mass.mass_kg)]]),
        rotation=np.zeros((1, 3)),
        contact=axial_point(np.array([1.0 / math.sqrt(mass.mass_kg)]), np.zeros(3)),
        alpha_1_s=0.0,
        beta_s=0.0,
    )


def to_arrays(bodies: Sequence[ModalBody]) -> dict[str, Array]:
    """All numbers of the ``bodies`` by name; those of a part have the part's name as prefix."""
    return {
        f"{i}.{part}.{each.name}": dense_of(value)
        for i, body in enumerate(bodies)
        for part, record in (("body", body), ("contact", body.contact), ("axis", body.axis))
        if record is not None
        for each in fields(record)
        if not isinstance(value := getattr(record, each.name), NO_NUMBERS)
    }


def from_arrays(arrays: Mapping[str, Array]) -> tuple[ModalBody, ...]:
    """The bodies that `to_arrays` took apart, bit for bit."""
    found: dict[int, dict[str, dict[str, Any]]] = {}
    for key, value in arrays.items():
        number, part, name = key.split(".")
        own = found.setdefault(int(number), {"axis": {}}).setdefault(part, {})
        own[name] = value if value.ndim else value.item()
    return tuple(
        ModalBody(
            **own["body"],
            contact=ContactPoints(**own["contact"]),
            axis=Axis(**own["axis"]) if own["axis"] else None,
        )
        for _, own in sorted(found.items())
    )
