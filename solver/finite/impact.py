"""One impact of the finite-strain solid, from first touch on: what it did, and its energy."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from dolfinx import mesh

from ..bodies.base import Array
from ..bristle import Material, positive
from ..energy import Budget
from ..errors import InputError
from .contact import Plane, mindlin_ratio, stored_J
from .solid import FiniteSolid
from .step import PRECISION, FiniteState, FiniteStepper, Step

LONGEST_S = 0.05


@dataclass(frozen=True)
class FiniteHistory:
    """The march step by step; vectors in the mesh's axes. Entry 0 of each is the first touch.

    ``force_N`` (steps + 1, 3) is the plane's mean force on the body over the step that ends at
    ``t_s``; the rest holds at ``t_s``: velocity of the centre of mass, least height of the tip's
    points over the plane, and energies.
    """

    t_s: Array
    force_N: Array
    cm_velocity_m_s: Array
    clearance_m: Array
    kinetic_J: Array
    strain_J: Array
    contact_J: Array


@dataclass(frozen=True)
class FiniteImpact:
    """What an impact did. Vectors (3,) are in the mesh's axes, at first touch the body's own.

    ``cm_velocity_m_s`` and ``angular_momentum_kg_m2_s`` (about the centre of mass) are those at
    ``end_s``. ``speed_kept`` is the part of the speed towards the plane that the plane's impulse
    turned round, as a coefficient of restitution of the centre of mass: gravity's share of the
    velocity is left out. ``peak_force_N`` is the greatest normal force averaged over a step,
    ``contact_time_s`` the sum of the steps with contact, ``n_touches`` how many unbroken runs they
    form. ``clear`` tells whether the tip was clear for the time asked. ``n_iterations`` and
    ``n_factors`` say what the march cost.
    """

    end_s: float
    clear: bool
    mass_kg: float
    cm_velocity_m_s: Array
    angular_momentum_kg_m2_s: Array
    speed_kept: float
    normal_impulse_N_s: float
    tangential_impulse_N_s: Array
    peak_force_N: float
    contact_time_s: float
    n_touches: int
    energy: Budget
    history: FiniteHistory
    n_steps: int
    n_iterations: int
    n_factors: int


def impact(
    domain: mesh.Mesh,
    facet_tags: mesh.MeshTags,
    tip_tag: int,
    material: Material,
    order: int = 2,
    *,
    normal: Array,
    gravity_m_s2: Array,
    velocity_m_s: Array,
    spin_rad_s: Array = (0.0, 0.0, 0.0),  # type: ignore[assignment]
    kn_N_m: float,
    kt_N_m: float | None = None,
    friction: float = 0.0,
    its_s: float,
    until_s: float | None = None,
    clear_s: float | None = None,
    precision: float = PRECISION,
) -> FiniteImpact:
    """March one impact of a bristle with finite strain and rotation; collective.

    The mesh stands upright (axis z, tip at z = 0) whatever the bristle's lean: the plane's unit
    ``normal``, gravity, the centre's velocity and the spin about it are given in its axes, see
    ``seen_from_body``. At t = 0 the lowest point of the undeformed tip touches. The march ends at
    ``until_s``, or earlier when the tip has been clear of the plane for ``clear_s``; one of the two
    must be given. ``kt_N_m`` is Mindlin's share of Kn unless given. See FiniteSolid for the body,
    contact.respond for the law, FiniteStepper for the scheme.

    Raises InputError for values that cannot be, ComputationError where a step does not converge.
    """
    kt = kn_N_m * mindlin_ratio(material.poisson) if kt_N_m is None else kt_N_m
    plane = Plane(normal, kn_N_m, kt, friction)
    positive("ITS", its_s)
    solid = FiniteSolid(domain, facet_tags, tip_tag, material, order)
    try:
        stepper = FiniteStepper(solid, plane, gravity_m_s2, its_s, precision)
        start = stepper.touching(solid.rigid_velocity(velocity_m_s, spin_rad_s))
        return march_impact(stepper, start, until_s=until_s, clear_s=clear_s)
    finally:
        solid.close()


def seen_from_body(rotation: Array) -> Array:
    """The plane's normal (world z) in the mesh's axes, for the body's ``rotation`` (3, 3) to world.

    A world vector x is ``rotation.T @ x`` in the mesh's axes.
    """
    rotation = np.asarray(rotation, dtype=float)
    if rotation.shape != (3, 3) or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-9):
        raise InputError("the rotation must be an orthogonal 3 x 3 matrix")
    return rotation[2]


def march_impact(
    stepper: FiniteStepper,
    start: FiniteState,
    *,
    until_s: float | None = None,
    clear_s: float | None = None,
) -> FiniteImpact:
    """March from ``start`` as ``impact`` does, with a stepper that is kept; collective."""
    if until_s is None and clear_s is None:
        raise InputError("an impact needs an end: a time, or for how long the tip is to be clear")
    for name, value in (("the end", until_s), ("the time clear of the plane", clear_s)):
        if value is not None:
            positive(name, value)
    record = Record(stepper, start)
    n_steps = max(1, math.ceil((until_s or LONGEST_S) / stepper.its_s - 1e-9))
    needed = math.inf if clear_s is None else clear_s
    state, iterations, factors = start, 0, stepper.n_factors
    for _ in range(n_steps):
        step = stepper.step(state)
        record.add(state, step)
        state = step.state
        iterations += step.n_iterations
        if record.clear_s >= needed - 1e-9 * stepper.its_s:
            break
    return record.result(
        state,
        clear=record.clear_s >= needed - 1e-9 * stepper.its_s,
        n_iterations=iterations,
        n_factors=stepper.n_factors - factors,
    )


@dataclass
class Record:
    """Sums and histories of a march."""

    stepper: FiniteStepper
    start: FiniteState
    clear_s: float = 0.0
    material_loss_J: float = 0.0
    friction_loss_J: float = 0.0
    _rows: list[tuple] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._note(self.start, np.zeros(3))

    def add(self, before: FiniteState, step: Step) -> None:
        """Account for a step."""
        its, tip = self.stepper.its_s, self.stepper.tip
        self.material_loss_J += self.stepper.solid.damping_loss_J(before.u, step.d, its)
        self.friction_loss_J += float(tip.weights @ step.response.loss_J)
        free = not step.response.normal_N.any()
        self.clear_s = self.clear_s + its if free else 0.0
        self._note(step.state, tip.weights @ step.response.force_N)

    def _note(self, state: FiniteState, force: Array) -> None:
        stepper, solid = self.stepper, self.stepper.solid
        stored = stored_J(stepper.plane, state.penetration_m, state.elongation_m)
        self._rows.append(
            (
                state.t_s,
                force,
                solid.mean(state.v),
                -float(state.penetration_m.max()),
                0.5 * solid.dot(state.v, solid.mass(state.v)),
                solid.strain_energy_J(state.u),
                float(stepper.tip.weights @ stored),
            )
        )

    def result(
        self, state: FiniteState, *, clear: bool, n_iterations: int, n_factors: int
    ) -> FiniteImpact:
        """The impact that ends with ``state``."""
        solid, plane, its = self.stepper.solid, self.stepper.plane, self.stepper.its_s
        history = FiniteHistory(*(np.array(column) for column in zip(*self._rows, strict=True)))
        impulse = its * history.force_N.sum(axis=0)
        normal_force = history.force_N @ plane.normal
        touching = normal_force > 0.0
        normal_impulse = float(plane.normal @ impulse)
        approach = -float(plane.normal @ history.cm_velocity_m_s[0])
        after = normal_impulse / solid.mass_kg - approach
        return FiniteImpact(
            end_s=state.t_s,
            clear=clear,
            mass_kg=solid.mass_kg,
            cm_velocity_m_s=history.cm_velocity_m_s[-1],
            angular_momentum_kg_m2_s=solid.angular_momentum(state.u, state.v),
            speed_kept=after / approach if approach else math.nan,
            normal_impulse_N_s=normal_impulse,
            tangential_impulse_N_s=impulse - normal_impulse * plane.normal,
            peak_force_N=float(normal_force.max()),
            contact_time_s=its * int(touching.sum()),
            n_touches=int(np.sum(touching[1:] & ~touching[:-1])),
            energy=self._budget(history, state),
            history=history,
            n_steps=len(history.t_s) - 1,
            n_iterations=n_iterations,
            n_factors=n_factors,
        )

    def _budget(self, history: FiniteHistory, state: FiniteState) -> Budget:
        """The budget over the march; potential energy is zero at first touch."""
        potential = -self.stepper.solid.dot(self.stepper.weight, state.u - self.start.u)
        stored = history.kinetic_J + history.strain_J + history.contact_J
        loss = self.material_loss_J + self.friction_loss_J
        initial = float(stored[0])
        numerical = initial - float(stored[-1]) - potential - loss
        return Budget(
            initial_J=initial,
            kinetic_J=float(history.kinetic_J[-1]),
            strain_J=float(history.strain_J[-1]),
            potential_J=potential,
            contact_J=float(history.contact_J[-1]),
            material_loss_J=self.material_loss_J,
            contact_loss_J=0.0,
            friction_loss_J=self.friction_loss_J,
            numerical_J=numerical,
            closure_relative=abs(numerical) / initial if initial else abs(numerical),
        )
