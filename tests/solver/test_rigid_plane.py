"""Contact reaches Signorini's limit: bouncing elastic bars whose motion is known exactly.

Solutions jump, and a scheme of second order spreads a jump over a width that shrinks as h^(2/3):
times, the tip's displacement and the impulse given so far follow that rate. (The force itself
rings about its plateau at the frequency of the last cell; its mean is what converges.)
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from reference import rate, rod
from scipy.integrate import cumulative_trapezoid

from bristle.solver.bodies.beam import beam_body
from bristle.solver.bristle import Bristle, Material
from bristle.solver.contact.enforcement import ContactMethod, Enforcement
from bristle.solver.contact.laws import Coulomb, Linear
from bristle.solver.contact.solve import MULTIPLIER_TOLERANCE
from bristle.solver.contact_phase import History
from bristle.solver.drop import DropPlan, ModalFrame, simulate
from bristle.solver.impact import march_contact
from bristle.solver.time.march import Marcher
from bristle.solver.time.scheme import TimeScheme
from bristle.studies.inputs.config import DropInputs
from bristle.studies.inputs.sources import checked
from bristle.studies.running.cases import run_case

pytestmark = pytest.mark.serial
JUMP_RATE = 2.0 / 3.0


def rigid(theta=0, enforcement=Enforcement.NITSCHE):
    return ContactMethod(Linear(math.inf), enforcement, theta=theta)


def falling_bar(n, theta, enforcement=Enforcement.NITSCHE):
    """Doyen, Ern and Piperno (SIAM J. Sci. Comput. 33, 2011): L 10, E 900, ρ 1, g 10, from 5."""
    body = rod(n, length=10.0, youngs=900.0, density=1.0, degree=2)
    crossing = 10.0 / 30.0
    plan = DropPlan(5.0, rigid(theta, enforcement), crossing / n / 4, 10.0, impact_only=True)
    return body, simulate(ModalFrame(body), plan), crossing


@pytest.mark.parametrize("theta", [1, 0, -1])
def test_falling_bar_of_doyen_ern_and_piperno(theta):
    """In the falling frame the plane rises as v t + ½ g t²: p = ρ c (v + g t) until 2L/c."""
    sizes, errors, totals = [20, 80, 320], [], []
    for n in sizes:
        body, result, crossing = falling_bar(n, theta)
        assert result.impact_speed_m_s == pytest.approx(10.0, rel=1e-12)
        duration = 2.0 * crossing
        impulse = 2.0 * body.mass_kg * 10.0 + body.mass_kg * 10.0 * duration
        totals.append(abs(result.impulse_N_s / impulse - 1.0))
        rows = result.history.array()
        rows = rows[(rows[:, 0] >= 1.0) & (rows[:, 0] <= 1.0 + duration)]
        after = rows[:, 0] - 1.0
        given = cumulative_trapezoid(rows[:, 3], after, initial=0.0)
        exact = 30.0 * (10.0 * after + 5.0 * after**2)
        errors.append(math.sqrt(np.mean((given - exact) ** 2)) / impulse)
    sizes = 1.0 / np.array(sizes)
    assert (np.array(totals) < sizes**JUMP_RATE).all()
    assert rate(sizes, errors) > 0.85 * JUMP_RATE
    assert result.cm_velocity_after_m_s == pytest.approx(10.0, abs=10.0 * 320.0**-JUMP_RATE)


def test_falling_bar_under_the_augmented_lagrangian():
    body, result, crossing = falling_bar(80, 0, Enforcement.AUGMENTED)
    impulse = 2.0 * body.mass_kg * 10.0 + body.mass_kg * 10.0 * 2.0 * crossing
    assert result.impulse_N_s == pytest.approx(impulse, rel=80.0**-JUMP_RATE)
    assert result.max_penetration_m < 1e-10


def period_three(n, theta, periods=2):
    """The clamped bar of Chouly, Hild and Renard (ESAIM: M2AN 49, 2015), period 3.

    Compressed to ½ and released at rest, its tip falls for 1, stays on the plane for 1 under the
    pressure ½, and rises for 1. Returns errors (root mean square) of displacement and impulse.
    """
    body = rod(n, degree=1, clamped_top=True)
    compressed = linear_start(body)
    marcher = Marcher(body, rigid(theta), TimeScheme.average(), 0.5 / n, 0.0)
    state = marcher.start(0.0, compressed, np.zeros_like(compressed))
    tip, given, times = [], [], []
    for _ in range(round(3.0 * periods / marcher.its_s)):
        state, force, *_ = marcher.step(state)
        times.append(state.t_s)
        tip.append(float(body.contact.displacements(state.u)[0, 2]))
        given.append(marcher.its_s * float(force[0, 0]))
    phase = np.mod(times, 3.0)
    height = np.where(phase < 1.0, 0.5 - 0.5 * phase, np.where(phase < 2.0, 0.0, 0.5 * phase - 1.0))
    pushed = 0.5 * (np.floor_divide(times, 3.0) + np.clip(phase - 1.0, 0.0, 1.0))
    return (
        math.sqrt(np.mean((np.array(tip) - height) ** 2)),
        math.sqrt(np.mean((np.cumsum(given) - pushed) ** 2)),
    )


def linear_start(body):
    """Modal coordinates of u = ½ (1 - z): what a steady push of ½ at the tip makes of E A = 1."""
    return 0.5 * body.contact.coordinates[0] / body.omega2


@pytest.mark.parametrize("theta", [1, 0, -1])
def test_period_three_bar_of_chouly_hild_and_renard(theta):
    sizes = np.array([128, 512])
    errors = np.array([period_three(int(n), theta) for n in sizes])
    for each in errors.T:
        assert rate(1.0 / sizes, each) > 0.85 * JUMP_RATE
    assert errors[-1, 0] < 5e-3


def test_penalty_tends_to_the_rigid_limit():
    """Kn → ∞ from below: impulse and contact time come to 2 m v and 2L/c at first order in 1/Kn."""
    bristle = Bristle(material=Material(beta_s=0.0))
    body = ModalFrame(beam_body(bristle, 64, face=False))
    period = bristle.axial_period_s
    tip = bristle.material.youngs_Pa * bristle.section.area_m2 / bristle.length_m
    stiffness, errors = np.array([4.0, 16.0, 64.0]), []
    for ratio in stiffness:
        method = ContactMethod(Linear(ratio * tip))
        plan = DropPlan(2.0, method, period / 2000, 9.8, impact_only=True)
        errors.append(abs(simulate(body, plan).contact_time_s / period - 1.0))
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 0.05


def test_friction_on_a_rigid_plane_takes_from_a_body_that_was_at_rest():
    """Bent and pressed together, let go at rest on the plane: its energy is that of its strain."""
    body = beam_body(Bristle(material=Material(beta_s=0.0)), 6)
    elastic = np.divide(1.0, body.omega2, out=np.zeros_like(body.omega2), where=body.omega2 > 0.0)
    rng = np.random.default_rng(1)
    for mu in np.repeat([0.1, 0.5, 5.0], 3):
        method = replace(rigid(enforcement=Enforcement.AUGMENTED), friction=Coulomb(mu))
        marcher = Marcher(body, method, TimeScheme.average(), 1e-6, 9.8)
        pushes = 0.01 * rng.normal(size=(len(body.contact.weights), 3))
        pushes[:, 2] = np.abs(pushes[:, 2])
        u = elastic * (body.contact.displacement.T @ pushes.ravel())
        u -= body.translation[:, 2] * marcher.gaps(u).min()
        touch = march_contact(marcher, 0.0, u, np.zeros_like(u), History(), until_s=2e-4)
        strain = 0.5 * u @ (body.omega2 * u)
        assert touch.friction_loss_J > -10.0 * MULTIPLIER_TOLERANCE * strain


@pytest.mark.parametrize("kn", [2e6, 1e7, 1e8])
def test_nitsches_method_takes_of_the_material_what_penalty_takes(kn):
    """The work of the damping's own traction at the plane belongs to the material's loss: without
    it that would be off by the share of the tip's last cell."""
    body = beam_body(Bristle(), 16)
    drops = [
        simulate(
            ModalFrame(body),
            DropPlan(0.05, ContactMethod(Linear(kn), way), 1e-6, 9.8, impact_only=True),
        )
        for way in (Enforcement.PENALTY, Enforcement.NITSCHE)
    ]
    penalty, nitsche = (drop.energy.material_loss_J for drop in drops)
    assert nitsche == pytest.approx(penalty, rel=1e-5)
    assert drops[1].energy.closure_relative < 1e-10


@pytest.mark.parametrize(("its_s", "modes"), [(3e-8, 40), (1e-8, 20)])
def test_a_section_that_hardly_answers_to_some_forces_on_a_rigid_plane(its_s, modes):
    # 81 points on a reduced solid that moves its end section in a third as many ways
    values = {"model": "reduced", "length_m": 0.02, "cells": (1, 4, 20), "modes": modes}
    values |= {"its_s": its_s, "beta_s": 0.0, "kn_N_m": math.inf, "contact": "augmented"}
    values |= {"until": "impact", "reduction_tolerance": 1.0}
    result = run_case(checked(DropInputs, values), MPI.COMM_SELF)[0]
    off = result.cm_velocity_after_m_s / result.impact_speed_m_s - 1.0
    assert abs(off) < 20.0**-JUMP_RATE
    # what is left of a step's way into the ground, as the multiplier's tolerance says
    most = MULTIPLIER_TOLERANCE * result.impact_speed_m_s * its_s
    assert result.max_penetration_m < 10.0 * most
