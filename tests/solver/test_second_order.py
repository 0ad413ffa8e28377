"""Axial force bends a leaning bristle as it should: Euler's load, energy, finite strain."""

import math
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from scipy.linalg import eigh
from solids import reduced_for

from bristle.solver import paper
from bristle.solver.bodies.axis import (
    second_order_force,
    second_order_loss,
    second_order_tangent,
    shortened,
    shortening,
)
from bristle.solver.bodies.beam import UX, UY, beam_axis, beam_body, beam_matrices
from bristle.solver.bodies.floating import FloatingModel
from bristle.solver.bodies.reduced import reduce_solid, solid_axis
from bristle.solver.bristle import Bristle, Material
from bristle.solver.contact.enforcement import ContactMethod
from bristle.solver.contact.laws import Coulomb, Linear
from bristle.solver.drop import DropPlan, ModalFrame, simulate
from bristle.solver.rigid import Pose
from bristle.solver.time.finite import FiniteMarcher
from bristle.solver.time.march import Marcher
from bristle.solver.time.modal_march import MarchLimits, march
from bristle.solver.time.scheme import TimeScheme

G = 9.8
MEASURED = Material(beta_s=1e-8)


@pytest.mark.serial
@pytest.mark.parametrize(("unknown", "slope"), [(UX, "slope_x"), (UY, "slope_y")])
def test_euler_load_of_a_pinned_bristle(bristle, unknown, slope):
    """P = π² E I / L² (Timoshenko and Gere, Theory of Elastic Stability)."""
    n = 16
    _, stiffness = beam_matrices(bristle, n)
    axis = beam_axis(bristle, n)
    rows = getattr(axis, slope)
    stretch = bristle.material.youngs_Pa * bristle.section.area_m2
    load = rows.T @ (axis.weights_N_m[:, None] / stretch * rows)  # of unit axial force
    keep = [
        i for i in range(len(stiffness)) if i % 6 == unknown or i % 6 == (4 if unknown == UX else 3)
    ]
    ends = {unknown, len(stiffness) - 6 + unknown}
    keep = np.array([i for i in keep if i not in ends])
    block = np.ix_(keep, keep)
    inverse = eigh(load[block], stiffness[block], eigvals_only=True)
    section = bristle.section
    moment = section.second_moment_x_m4 if unknown == UX else section.second_moment_y_m4
    euler = math.pi**2 * bristle.material.youngs_Pa * moment / bristle.length_m**2
    assert 1.0 / inverse[-1] == pytest.approx(euler, rel=2e-4)


def change_of_force(axis, seen0, u1, move, its):
    """Of the force at the end of a step by ``move``, exact for a cubic; and what rounds there."""
    ahead, far, behind, back = (
        second_order_force(axis, seen0, axis.rows @ (u1 + k * move), its)
        for k in (1.0, 2.0, -1.0, -2.0)
    )
    scale = 1e-10 * np.abs([ahead, far, behind, back]).max()
    return (8.0 * (ahead - behind) - (far - back)) / 12.0, scale


def second_order_energy(axis, seen):
    """½ Σ E A Δz ((e + q)² - e²) of what the axis sees, in J."""
    e, x, y = seen.reshape(-1, len(axis.weights))[:3]
    q = 0.5 * (x**2 + y**2)
    return 0.5 * axis.weights @ ((2.0 * e + q) * q)


@pytest.mark.serial
def test_force_is_the_discrete_gradient_of_the_energy(bristle, rng):
    body = beam_body(bristle, 6, second_order=True)
    its, beta = 1e-5, 2e-5
    axis, damped = (shortening(body.axis, body.omega2, each) for each in (0.0, beta))
    for _ in range(20):
        u0, u1 = rng.normal(size=(2, len(body.omega2))) / (1e4 + np.sqrt(body.omega2))
        seen0, seen1 = axis.rows @ u0, axis.rows @ u1
        force = second_order_force(axis, seen0, seen1, its)
        gained = second_order_energy(axis, seen1) - second_order_energy(axis, seen0)
        size = np.abs(force * (u1 - u0)).sum()
        assert force @ (u1 - u0) == pytest.approx(-gained, abs=1e-12 * size)
        tangent = second_order_tangent(damped, seen0, seen1, its)
        move = 0.5 * (u1 - u0)
        change, scale = change_of_force(damped, seen0, u1, move, its)
        assert tangent @ move == pytest.approx(change, abs=scale)
        viscous = second_order_force(damped, seen0, seen1, its) - force
        lost = second_order_loss(damped, seen0, seen1, its)
        assert viscous @ (u1 - u0) == pytest.approx(-lost, abs=1e-10 * size)
        # with what the linear body loses, β E A times the square of the true strain's rate
        g = len(axis.weights)
        strains = [s[:g] + 0.5 * (s[g : 2 * g] ** 2 + s[2 * g :] ** 2) for s in (seen0, seen1)]
        linear = beta / its * axis.weights @ (seen1 - seen0)[:g] ** 2
        true = beta / its * axis.weights @ (strains[1] - strains[0]) ** 2
        assert lost == pytest.approx(true - linear, abs=1e-10 * (true + linear))


@pytest.mark.serial
def test_a_loss_factor_damps_what_strains_the_body(bristle, rng):
    body = replace(beam_body(bristle, 6, second_order=True), loss_factor=0.1)
    its, rates = 1e-5, 0.1 * np.sqrt(body.omega2)
    elastic = shortening(body.axis, body.omega2)
    damped = shortening(body.axis, body.omega2, loss_factor=body.loss_factor)
    for _ in range(20):
        u = rng.normal(size=(2, len(body.omega2))) / (1e4 + np.sqrt(body.omega2))
        force = [
            second_order_force(axis, axis.rows @ u[0], axis.rows @ u[1], its)
            for axis in (elastic, damped)
        ]
        lost = second_order_loss(damped, damped.rows @ u[0], damped.rows @ u[1], its)
        straining = [each - shortened(elastic, each, 0.0 * each)[0] for each in u]
        linear, true = (rates @ (x[1] - x[0]) ** 2 / its for x in (u, straining))
        assert lost == pytest.approx(true - linear, abs=1e-10 * (true + linear))
        work = (force[1] - force[0]) * (u[1] - u[0])
        assert work.sum() == pytest.approx(-lost, abs=1e-10 * np.abs(work).sum())
        move = 0.5 * (u[1] - u[0])
        change, scale = change_of_force(damped, damped.rows @ u[0], u[1], move, its)
        tangent = second_order_tangent(damped, damped.rows @ u[0], damped.rows @ u[1], its)
        assert tangent @ move == pytest.approx(change, abs=scale)


@pytest.mark.serial
@pytest.mark.parametrize("damping", [{"beta_s": 1e-7}, {"loss_factor": 0.1}], ids=str)
def test_damping_takes_nothing_of_an_axis_that_shortens_freely(bristle, damping):
    """A bristle that bends freely, marched: its bending is damped, its shortening is not."""
    damping = {"beta_s": 0.0, **damping}
    body = replace(beam_body(bristle, 32, second_order=True), **damping)
    slopes = np.linalg.norm(body.axis.slope_x, axis=0)
    bending = np.flatnonzero((body.omega2 > 0.0) & (slopes > 1e-6 * slopes.max()))[0]
    u, v = np.zeros((2, len(body.omega2)))
    v[bending] = 0.1 * np.sqrt(body.omega2[bending]) / np.abs(body.axis.slope_x[:, bending]).max()
    losses = []
    for each in (body, replace(body, axis=None)):
        method = ContactMethod(Linear(2e6))
        marcher = Marcher(each, method, TimeScheme.average(), 1e-5, 0.0)
        marcher.place(replace(marcher.ground, gaps_m=marcher.ground.gaps_m + 1.0))
        modes, touching = marcher.tables()
        limits = MarchLimits(wait=1.0, until=1e-2, limit=2000, history=False)
        marched = march(modes, touching, u, v, np.zeros(len(body.contact.weights)), limits)
        losses.append(marched.material_loss)
    assert losses[0] == pytest.approx(losses[1], rel=0.02)


@pytest.mark.serial
def test_free_bending_shortens_the_axis_and_does_not_strain_it(bristle):
    """In a pure bend of slope s the ends come together by ½ ∫ s², and the true strain vanishes."""
    body = beam_body(bristle, 32, second_order=True)
    axis = shortening(body.axis, body.omega2)
    slopes = np.linalg.norm(body.axis.slope_x, axis=0)
    bending = np.flatnonzero((body.omega2 > 0.0) & (slopes > 1e-6 * slopes.max()))[0]
    u = np.zeros(len(body.omega2))
    u[bending] = 0.02 / np.abs(body.axis.slope_x[:, bending]).max()
    du, _ = shortened(axis, u, np.zeros_like(u))
    q = 0.5 * (body.axis.slope_x @ u) ** 2
    strain = body.axis.strain @ (u + du) + q
    assert np.abs(strain).mean() < 0.02 * q.mean()
    assert second_order_energy(axis, axis.rows @ (u + du)) == pytest.approx(
        -0.5 * body.axis.weights_N_m @ q**2, rel=0.02
    )


def test_axis_of_a_solid_sees_strain_and_slope(make_solid):
    solid = make_solid((1, 2, 24), 0.05)
    x = solid.space.tabulate_dof_coordinates()[: solid.n_local // 3]
    fields = np.zeros((len(x), 3, 3))
    fields[:, 2, 0] = 1e-3 * x[:, 2]
    fields[:, 0, 1], fields[:, 1, 2] = 0.02 * x[:, 2], 0.03 * x[:, 2]
    axis = solid_axis(solid, fields.reshape(-1, 3))
    n = len(axis.weights_N_m)
    assert axis.strain == pytest.approx(np.outer(np.ones(n), [1e-3, 0, 0]), abs=1e-12)
    assert axis.slope_x == pytest.approx(np.outer(np.ones(n), [0, 0.02, 0]), abs=1e-12)
    assert axis.slope_y == pytest.approx(np.outer(np.ones(n), [0, 0, 0.03]), abs=1e-12)
    length = 207e9 * 0.5e-3 * 2.08e-3 * 0.05
    assert axis.weights_N_m.sum() == pytest.approx(length, rel=1e-9)


def test_a_solid_yields_to_stress_along_its_axis_as_a_bar_or_less(make_solid):
    """No state has less energy for its axial strain than ½ E e², and an even pull has as much."""
    solid = make_solid((1, 2, 24), 0.05)
    body = reduce_solid(solid, 1e10, 20, leaning=True, second_order=True).modal
    soft = shortening(body.axis, body.omega2).flexibility
    strain = np.sqrt(body.axis.weights_N_m)[:, None] * body.axis.strain
    yields = np.linalg.eigvalsh(strain @ (soft[:, None] * strain.T))
    assert 0.999 < yields.max() <= 1.0 + 1e-9


def drop(body, tilt, mu=0.0, its=1e-5):
    method = ContactMethod(Linear(2e6), friction=Coulomb(mu))
    plan = DropPlan(0.05, method, its, G, tilt_deg=tilt, impact_only=True)
    return simulate(ModalFrame(body), plan)


@pytest.mark.serial
def test_upright_nothing_changes(bristle):
    linear, curved = (drop(beam_body(bristle, 16, second_order=s), 0.0) for s in (False, True))
    assert curved.cm_velocity_after_m_s == pytest.approx(linear.cm_velocity_after_m_s, rel=1e-9)


@pytest.mark.serial
def test_small_impacts_are_linear():
    """The share of speed lost to the coupling falls with the height, at the same ratio of gaps."""
    lost = []
    for scale in (1.0, 0.1):
        kept = []
        for second_order in (False, True):
            body = beam_body(Bristle(material=MEASURED), 16, face=False, second_order=second_order)
            method = ContactMethod(Linear(2e6))
            plan = DropPlan(0.05 * scale**2, method, 1e-5, G, tilt_deg=2.0, impact_only=True)
            result = simulate(ModalFrame(body), plan)
            kept.append(result.cm_velocity_after_m_s / result.impact_speed_m_s)
        lost.append(kept[0] - kept[1])
    assert lost[0] > 0.05
    assert lost[1] == pytest.approx(0.1 * lost[0], rel=0.25)


@pytest.mark.parametrize(
    ("tilt", "mu", "beta"),
    [(1.0, 0.0, 1e-8), (2.0, 0.0, 1e-8), (2.0, 0.0, paper.BETA_S), (5.0, 0.5, 1e-8)],
)
def test_against_finite_strain(make_solid, tilt, mu, beta):
    """The total-Lagrangian solid shares its contact with the modes, not its mechanics."""
    cells, its, material = (1, 2, 84), 1e-5, Material(beta_s=beta)
    solid = make_solid(cells, 0.3365, material=material, comm=MPI.COMM_SELF)
    method = ContactMethod(Linear(2e6), friction=Coulomb(mu))
    model = reduce_solid(solid, 1e10, 40, leaning=True)
    marcher = FiniteMarcher(solid, method, TimeScheme.average(), its, G)
    plan = DropPlan(0.05, method, its, G, tilt_deg=tilt, impact_only=True)
    exact = simulate(FloatingModel(**vars(model)), plan, marcher)
    marcher.close()
    # of the same mesh, and a beam of the paper's elements, whose own error is some 4e-3
    bodies = [
        (reduced_for(solid, its, 40, leaning=True, second_order=True).modal, 1e-3),
        (beam_body(Bristle(material=material), 16, second_order=True), 6e-3),
    ]
    for body, within in bodies:
        ours = drop(body, tilt, mu)
        apart = ours.cm_velocity_after_m_s - exact.cm_velocity_after_m_s
        assert abs(apart) < within * exact.impact_speed_m_s
        # what the change to linear flight may leave over
        assert abs(ours.energy.numerical_J) < 2e-3 * ours.energy.initial_J


@pytest.mark.parametrize("way", ["launched", "landed"])
def test_small_motion_comes_through_the_change_of_frame(make_solid, rng, way):
    """What the modes have is what the finite solid has, but for the square of the strain."""
    solid = make_solid((1, 2, 24), 0.05, comm=MPI.COMM_SELF)
    model = FloatingModel(**vars(reduce_solid(solid, 1e10, 20, leaning=True)))
    omega = np.sqrt(model.modal.omega2)
    q = 1e-9 * np.divide(rng.normal(size=omega.size), omega, out=0.0 * omega, where=omega > 0.0)
    qv = 1e-9 * rng.normal(size=omega.size)
    u, v = model.from_modal(q), model.from_modal(qv)
    if way == "launched":
        pose, *found = model.launched(Pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])), u, v)
        assert np.abs(pose.position_m).max() < 1e-12
        wanted = q, qv
    else:
        found, wanted = model.landed(q, qv), (u, v)
    for one, other in zip(found, wanted, strict=True):
        assert one == pytest.approx(other, abs=1e-6 * np.abs(other).max())
