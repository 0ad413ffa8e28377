"""The drop marched at constant ITS from release on: what `drop.simulate` is checked against.

It meets the surface somewhere within a step, so the two agree as the ITS shrinks. Rotation is
linearised about the release: a leaning bristle is right only while it has turned little.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from bristle.solver.arrays import Array
from bristle.solver.contact_phase import History, observe
from bristle.solver.drop import DropPlan, DropResult, FlightFrame, Stage
from bristle.solver.energy import Budget, marching_energy
from bristle.solver.errors import ComputationError
from bristle.solver.ground import place
from bristle.solver.time.march import Marcher
from bristle.solver.time.motion import flyer, rigid_part


def _first_impact(active: NDArray[np.intp], velocity: Array) -> tuple[int, int]:
    """Last step of contact of the first impact, and the first of the second (or the end).

    ``active`` (k,) are the steps with contact, ``velocity`` the centre's after each step.
    """
    for end, start in itertools.pairwise(active):
        if start > end + 1 and velocity[end] > 0.0 and velocity[start - 1] <= 0.0:
            return int(end), int(start)
    return int(active[-1]), len(velocity)


def march_plainly(frame: FlightFrame, plan: DropPlan, until_s: float) -> DropResult:
    """The drop of ``plan`` from release to ``until_s``; ComputationError where nothing touches."""
    body, g = frame.body, plan.gravity_m_s2
    marcher = Marcher(body, plan.method, plan.scheme, plan.its_s, g)
    stage = Stage(frame, marcher, plan)
    marcher.place(place(stage.ground, stage.first_pose, body.contact, stage.datum_m))
    lift = body.translation @ marcher.ground.up
    history = History()
    sums: Array = np.zeros(3)
    state = marcher.start(0.0, plan.height_m * lift, np.zeros_like(lift))
    observe(marcher, state, np.zeros((len(body.contact.weights), 3)), history)
    steps: list[Array] = []
    for _ in range(math.ceil(until_s / plan.its_s)):
        before = state
        step = marcher.step(before)
        state, force = step.state, step.force
        damped = marcher.damping_loss_J(before, state, force)
        sums += (damped, step.friction_loss_J, step.contact_loss_J)
        observe(marcher, state, force, history)
        velocity = [body.dot(axis, state.mv) for axis in body.translation.T]
        pushed = body.contact.weights @ marcher.along_axes(force)
        steps.append(np.array([body.contact.weights @ force[:, 0], *pushed, *velocity]))
    made = np.array(steps)
    total, pushes, velocities = made[:, 0], made[:, 1:4], made[:, 4:]
    loss, rubbed, spent = map(float, sums)
    rows = history.array()
    flown = frame.launched(stage.first_pose, state.u, state.v)
    active = np.flatnonzero(total > 0.0)
    if not len(active):
        raise ComputationError(f"nothing touched within {until_s:g} s")
    speeds = velocities @ stage.first_pose.rotation.T / body.mass_kg
    last, second = _first_impact(active, speeds[:, 2])
    impulse = float(plan.its_s * total[: last + 1].sum())
    push = plan.its_s * np.sum(pushes[: last + 1], axis=0)
    # the march may end in contact, or on the way up
    ended = last < len(total) - 1
    tops: Array | None = None
    if ended:
        heights = rows[last + 1 : second + 1, 1:3]
        turned = (heights.argmax(axis=0) < len(heights) - 1).all()
        tops = heights.max(axis=0) if turned or second < len(total) else None
    none = np.full(3, math.nan)
    after = speeds[last] if ended else none
    spin = rigid_part(flyer(frame.modal), flown[2])[1] if ended else none
    window = rows[active[0] : last + 2]
    deepest = int(np.argmax(window[:, 4]))
    return DropResult(
        impact_speed_m_s=-float(speeds[max(active[0] - 1, 0), 2]),
        rebound_ratio=None if tops is None else float(tops[0]) / plan.height_m,
        rebound_height_m=None if tops is None else float(tops[0]),
        contact_time_s=float((last - active[0] + 1) * plan.its_s) if ended else math.nan,
        n_contacts=1 + int(np.sum(np.diff(active[active <= last]) > 1)),
        peak_force_N=float(window[:, 3].max()),
        impulse_N_s=impulse,
        max_penetration_m=float(window[deepest, 4]),
        time_to_max_penetration_s=float(window[deepest, 0] - rows[active[0], 0]),
        cm_velocity_after_m_s=float(after[2]),
        n_dofs=body.n_dofs,
        n_steps=len(total),
        energy=Budget.close(
            body.mass_kg * g * plan.height_m, marching_energy(marcher, state), loss, rubbed, spent
        ),
        history=history,
        cm_rebound_height_m=None if tops is None else float(tops[1]),
        velocity_after_m_s=tuple(map(float, after)),
        spin_after_rad_s=tuple(map(float, spin)),
        friction_impulse_N_s=math.sqrt(max(float(push @ push) - impulse**2, 0.0)),
    )
