"""A solid at finite rotation as it flies: a frame that floats with it, and small motion in it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from dolfinx import fem, la

from ..arrays import Array
from ..form_cache import form
from ..forms import StepForms, own_values
from ..rigid import Pose, matrix_of, product, turn
from .base import summed
from .reduced import ReducedModel

# Turns of the frame, and corrections of a strain, until the next is rounding.
TURNS, STILL_RAD = 20, 1e-15
CORRECTIONS, SETTLED = 20, 1e-10


@dataclass(frozen=True)
class FloatingModel(ReducedModel):
    """The reduced model of a solid that has turned by more than is small.

    The frame is where the displacement from the unstrained body has neither translation nor
    rotation, weighted by mass (Tisserand's mean axes). The modes in it have the stress of the solid
    as nearly as they can, measured by energy. Their displacement is not the solid's: a section that
    has turned by θ has moved by -½ θ² without strain, where small strain would see one.
    """

    @cached_property
    def _motions(self) -> tuple[Array, Array, Array]:
        """Places from the centre (nodes, 3), M times the rigid motions (n_local, 6), their sums."""
        solid = self.body
        motions = solid.rigid_motions()
        image = solid.mass(np.asfortranarray(motions))
        places = solid.places_m - solid.centre_m
        return places, image, summed(solid.comm, motions.T @ image)

    @cached_property
    def _forms(self) -> tuple[StepForms, fem.Form, fem.Form]:
        forms = StepForms(self.body.space, self.body.material, finite=True)
        return forms, form(forms.stress_load()), form(forms.stress_rate_load())

    def launched(self, pose: Pose, u: Array, v: Array) -> tuple[Pose, Array, Array]:
        places, image, moments = self._motions
        shift = summed(self.body.comm, image[:, :3].T @ u) / self.body.mass_kg
        there = places + u.reshape(-1, 3) - shift
        turned = np.array([1.0, 0.0, 0.0, 0.0])
        for _ in range(TURNS):
            seen = there @ matrix_of(turned)
            spun = summed(self.body.comm, image[:, 3:].T @ (seen - places).ravel())
            angle = np.linalg.solve(moments[3:, 3:], spun)
            turned = product(turned, turn(angle))
            if np.abs(angle).max() <= STILL_RAD:
                break
        start = Pose(pose.position_m + pose.rotation @ shift, product(pose.attitude, turned))
        rotation = matrix_of(turned)
        seen, speed = there @ rotation, v.reshape(-1, 3) @ rotation
        by_spin = np.stack([np.cross(axis, seen).ravel() for axis in np.eye(3)], axis=1)
        about = summed(self.body.comm, image[:, 3:].T @ np.column_stack([by_spin, speed.ravel()]))
        spin = np.linalg.solve(about[:, :3], about[:, 3])
        velocity = summed(self.body.comm, image[:, :3].T @ speed.ravel()) / self.body.mass_kg
        modal = self.modal
        rigid = modal.translation @ velocity + modal.rotation @ spin
        elastic = modal.omega2 > 0.0
        flexibility = np.divide(1.0, modal.omega2, out=np.zeros_like(rigid), where=elastic)
        stress, rate = self._stress_loads(u, v)
        return start, flexibility * self._onto(stress), rigid + flexibility * self._onto(rate)

    def landed(self, q: Array, qv: Array) -> tuple[Array, Array]:
        u, v = self.from_modal(q), self.from_modal(qv)
        still = np.where(self.modal.omega2 > 0.0, qv, 0.0)
        solid = self.body
        target = solid.stiffness(u), solid.stiffness(self.from_modal(still))
        solve = solid.factor(self.slowest_1_s2, 1.0)
        size = np.sqrt(solid.dot(u, u))
        for _ in range(CORRECTIONS):
            stress, rate = self._stress_loads(u, v)
            change = solve(target[0] - stress)
            u, v = u + change, v + solve(target[1] - rate)
            if np.sqrt(solid.dot(change, change)) <= SETTLED * size:
                break
        return u, v

    def _stress_loads(self, u: Array, v: Array) -> tuple[Array, Array]:
        """What the stress, and its rate, do on small strains (n_local,)."""
        forms, *loads = self._forms
        own_values(forms.u, u)
        own_values(forms.v, v)
        found = []
        for load in loads:
            vector = fem.assemble_vector(load)
            vector.scatter_reverse(la.InsertMode.add)
            found.append(np.array(vector.array[: len(u)]))
        return found[0], found[1]

    def _onto(self, load: Array) -> Array:
        """A load as the modes see it."""
        return np.asarray(self.turn.T @ self.basis.amounts(load))
