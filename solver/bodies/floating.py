"""A solid in flight at finite rotation: a floating frame, with small motion relative to it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from dolfinx import fem, la

from ..arrays import Array
from ..errors import ComputationError
from ..form_cache import form
from ..forms import StepForms, own_values
from ..rigid import Pose, matrix_of, product, turn
from .base import summed
from .reduced import ReducedModel, slowest_1_s2

# Limits of iteration: rotations of the frame, and corrections of a strain.
TURNS, STILL_RAD = 20, 1e-13
# Tolerance in the energy norm. The change between small and finite strain itself has an error of
# second order in the slopes of the bending, 1e-4 and more.
CORRECTIONS, SETTLED = 30, 1e-8
RUNAWAY = 1e6  # beyond this relative error in the energy norm the corrections diverge
SMALLEST = float(np.finfo(float).tiny)  # stands for an energy of zero


@dataclass(frozen=True)
class FloatingModel(ReducedModel):
    """The reduced model of a solid at finite rotation.

    Relative to the frame the displacement from the unstrained body has neither translation nor
    rotation, weighted by mass (Tisserand's mean axes). The modes have the closest stress to the
    solid's, measured by energy. Their displacement differs from the solid's: a section rotated by θ
    moves by -½ θ² without strain, where small strain would see one.
    """

    @cached_property
    def _motions(self) -> tuple[Array, Array, Array]:
        """Positions from the centre (nodes, 3), M times the rigid motions (n_local, 6), and the
        sums."""
        solid = self.body
        motions = solid.rigid_motions()
        image = solid.mass(np.asfortranarray(motions))
        places = solid.places_m - solid.centre_m
        return places, image, summed(solid.comm, motions.T @ image)

    @cached_property
    def _forms(self) -> tuple[StepForms, fem.Form, fem.Form, fem.Form]:
        forms = StepForms(self.body.space, self.body.material, finite=True)
        loads = form(forms.stress_load()), form(forms.stress_rate_load())
        return forms, *loads, form(forms.strain_energy())

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
        else:
            raise ComputationError(
                f"the body bends too far to fly: its own axes still turn by "
                f"{np.abs(angle).max():.2g} rad after {TURNS} turns; lean it less"
            )
        start = Pose(pose.position_m + pose.rotation @ shift, product(pose.attitude, turned))
        rotation = matrix_of(turned)
        seen, speed = there @ rotation, v.reshape(-1, 3) @ rotation
        by_spin = np.stack([np.cross(axis, seen).ravel() for axis in np.eye(3)], axis=1)
        about = summed(self.body.comm, image[:, 3:].T @ np.column_stack([by_spin, speed.ravel()]))
        spin = np.linalg.solve(about[:, :3], about[:, 3])
        velocity = summed(self.body.comm, image[:, :3].T @ speed.ravel()) / self.body.mass_kg
        modal = self.modal
        rigid = modal.translation @ velocity + modal.rotation @ spin
        stress, rate = (self.flexibility * self.seen(load) for load in self._stress_loads(u, v))
        return start, stress, rigid + rate

    def landed(self, q: Array, qv: Array) -> tuple[Array, Array]:
        """As `solver.drop.FlightFrame`: the motion whose stress, and its rate, do the same work on
        small strains as those of the modes.

        Each correction combines one in the modes with one outside them, under a shift. The error
        shrinks by the slopes of the bending. Raises ComputationError if it does not.
        """
        solid, omega2 = self.body, self.modal.omega2
        modal = np.column_stack([q, np.where(omega2 > 0.0, qv, 0.0)])
        target = solid.stiffness(np.asfortranarray(self.from_modal(modal)))
        energies = np.maximum(np.sum(omega2[:, None] * modal**2, axis=0), SMALLEST)
        solve = solid.factor(slowest_1_s2(solid), 1.0)
        u, v = self.from_modal(q), self.from_modal(qv)
        for _ in range(CORRECTIONS):
            left = np.asfortranarray(target - np.column_stack(self._stress_loads(u, v)))
            by_modes = self.from_modal(self.flexibility[:, None] * self.seen(left))
            rest = left - solid.stiffness(np.asfortranarray(by_modes))
            change = by_modes + solve(np.asfortranarray(rest))
            u, v = u + change[:, 0], v + change[:, 1]
            off = np.sqrt(np.abs(summed(solid.comm, np.sum(change * left, axis=0))) / energies)
            if off.max() <= SETTLED:
                return u, v
            if not off.max() < RUNAWAY:
                break
        raise ComputationError(
            "the body bends too far to touch again: corrected, its stress is still off by "
            f"{off.max():.2g} from that of its flight; lean it less, or end the drop with its "
            "first impact",
            inputs=("until",),
        )

    def energy_J(self, u: Array, v: Array) -> float:
        """As `solver.drop.FlightFrame`, at finite strain."""
        forms, _, _, strain = self._forms
        own_values(forms.u, u)
        stored = self.body.comm.allreduce(fem.assemble_scalar(strain))
        return float(stored) + 0.5 * self.body.dot(v, self.body.mass(v))

    def _stress_loads(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Work of the stress, and of its rate, on small strains (n_local,)."""
        forms, *loads, _ = self._forms
        own_values(forms.u, u)
        own_values(forms.v, v)
        found = []
        for load in loads:
            vector = fem.assemble_vector(load)
            vector.scatter_reverse(la.InsertMode.add)
            found.append(np.array(vector.array[: len(u)]))
        return found[0], found[1]
