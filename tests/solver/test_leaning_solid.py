"""A leaning solid bounces alike at full order and reduced, as a beam does, on any ranks."""

import math

import numpy as np
import pytest
from leaning_helpers import beam, plan
from mpi4py import MPI

from bristle.solver.bodies.reduced import reduce_solid
from bristle.solver.bristle import Material
from bristle.solver.contact.enforcement import Enforcement
from bristle.solver.drop import ModalFrame, simulate
from bristle.solver.time.scheme import TimeScheme

LENGTH, CELLS, ITS = 0.05, (1, 2, 24), 1e-6
MATERIAL = Material(beta_s=1e-8)


def reduced_solid(solid, its=ITS, n_krylov=24, **options):
    c_mass, c_stiffness = TimeScheme.average().effective(its, solid.alpha_1_s, solid.beta_s)
    return reduce_solid(solid, c_mass / c_stiffness, n_krylov, leaning=True, **options)


@pytest.fixture(scope="module")
def models(make_solid):
    """By stiffness-proportional damping: steel's own, and the paper's."""
    materials = (MATERIAL, Material())
    return {m.beta_s: reduced_solid(make_solid(CELLS, LENGTH, material=m)) for m in materials}


def differences(one, other):
    """Of velocity and, as the speed of the ends, of spin, over the speed of fall."""
    speed = one.impact_speed_m_s
    moved = np.subtract(one.velocity_after_m_s, other.velocity_after_m_s)
    arms = np.array([0.5 * LENGTH, 0.5 * LENGTH, 1e-3])
    turned = np.subtract(one.spin_after_rad_s, other.spin_after_rad_s) * arms
    return np.abs(np.concatenate([moved, turned])) / speed


@pytest.mark.parametrize("mu", [0.0, 0.5])
@pytest.mark.parametrize("lean", [(2.0, 0.0), (5.0, 0.0), (2.0, 3.0)], ids=str)
@pytest.mark.parametrize("beta", [MATERIAL.beta_s, Material().beta_s])
def test_full_order_and_reduced_lean_alike(models, beta, lean, mu):
    """An edge or a corner first; the error that is stated is of the true one's size."""
    model = models[beta]
    the_plan = plan(mu=mu, tilt_deg=lean[0], tilt_wide_deg=lean[1], impact_only=False)
    full = simulate(model, the_plan)
    small = simulate(ModalFrame(model.modal, model.coarser), the_plan)
    off = differences(full, small)
    assert off.max() < 1e-4
    assert off[:3].max() <= 100.0 * small.reduction_error
    assert small.n_contacts == full.n_contacts
    assert small.rebound_ratio == pytest.approx(full.rebound_ratio, abs=1e-4)
    assert small.peak_force_N == pytest.approx(full.peak_force_N, rel=1e-4)
    loss = full.energy.friction_loss_J
    assert small.energy.friction_loss_J == pytest.approx(loss, abs=1e-4 * full.energy.initial_J)
    assert small.energy.closure_relative < 1e-9
    assert full.energy.closure_relative < 1e-4  # it flies in the modes, and leaves them the rest
    assert (loss > 0.0) == (mu > 0.0)


@pytest.mark.serial
@pytest.mark.parametrize("mu", [0.0, 0.5])
@pytest.mark.parametrize("lean", [(1.0, 0.0), (2.0, 0.0), (5.0, 0.0), (0.0, 3.0)], ids=str)
def test_a_beams_end_face_follows_the_solid(models, lean, mu):
    """Within 1 % of the speed of fall, for a bristle a hundred times as long as thick."""
    the_plan = plan(mu=mu, tilt_deg=lean[0], tilt_wide_deg=lean[1])
    thick = simulate(models[MATERIAL.beta_s], the_plan)
    slender = simulate(beam(MATERIAL.beta_s, 32, length_m=LENGTH), the_plan)
    off = differences(thick, slender)
    assert off[:3].max() < 0.01
    # a push across at the end turns the bar six times as fast as it moves it, over half a length 3
    assert off[3:5].max() < 0.03
    assert slender.peak_force_N == pytest.approx(thick.peak_force_N, rel=0.02)


@pytest.mark.parametrize("mu", [0.0, 0.5])
def test_ranks_do_not_matter_to_a_leaning_solid(make_solid, mu):
    """The same drop on this communicator and on each rank alone, full order."""
    the_plan = plan(mu=mu, tilt_deg=3.0, tilt_wide_deg=1.0)
    results = []
    for comm in (MPI.COMM_WORLD, MPI.COMM_SELF):
        solid = make_solid(CELLS, LENGTH, material=MATERIAL, comm=comm)
        results.append(simulate(reduced_solid(solid, n_krylov=8), the_plan))
    shared, alone = results
    assert shared.n_dofs == alone.n_dofs
    assert shared.n_steps == alone.n_steps
    assert differences(shared, alone).max() < 1e-8
    assert shared.peak_force_N == pytest.approx(alone.peak_force_N, rel=1e-8)
    loss = alone.energy.friction_loss_J
    assert shared.energy.friction_loss_J == pytest.approx(loss, abs=1e-8 * alone.energy.initial_J)


@pytest.mark.serial
@pytest.mark.parametrize(("lean", "mu"), [(0.0, 0.3), (5.0, 0.05), (5.0, 0.5)])
def test_a_rigid_plane_with_friction_obeys_signorini_and_coulomb(make_solid, lean, mu):
    """By the augmented Lagrangian, point by point and step by step."""
    solid = make_solid((1, 2, 12), 0.02, material=MATERIAL)
    the_plan = plan(math.inf, 5e-7, mu=mu, tilt_deg=lean,
                    method={"enforcement": Enforcement.AUGMENTED})  # fmt: skip
    model = reduced_solid(solid, its=the_plan.its_s)
    seen = []
    result = simulate(model, the_plan, observer=lambda state, force: seen.append((state, force)))
    forces = np.array([force for _, force in seen])
    approaches = np.array([state.approach for state, _ in seen])
    normal, pull = forces[..., 0], np.hypot(forces[..., 1], forces[..., 2])
    largest, deepest = normal.max(), 1e-6 * result.impact_speed_m_s * the_plan.its_s
    assert (normal >= 0.0).all()
    assert (pull <= mu * normal + 1e-6 * largest).all()
    touching = normal > 1e-6 * largest
    assert np.abs(approaches[..., 0][touching]).max() < deepest
    slips = np.diff(approaches[..., 1:], axis=0)
    # what sticks stays; what slides is pulled back with μ N
    sticks = touching[1:] & (pull < mu * normal - 1e-5 * largest)[1:]
    assert np.linalg.norm(slips[sticks], axis=-1).max(initial=0.0) < deepest
    slides = touching[1:] & (np.linalg.norm(slips, axis=-1) > 10.0 * deepest)
    work = np.sum(forces[1:, :, 1:] * slips, axis=-1)
    assert (work[slides] > 0.0).all()
    assert slides.any()
    assert result.energy.friction_loss_J > 0.0
    assert result.impulse_N_s > solid.mass_kg * result.impact_speed_m_s


@pytest.mark.serial
def test_the_march_of_a_reduced_solid_is_the_general_one(models):
    """Compiled and general give the same."""
    frame = ModalFrame(models[Material().beta_s].modal)
    the_plan = plan(mu=0.3, tilt_deg=3.0, tilt_wide_deg=1.0)
    compiled = simulate(frame, the_plan)
    general = simulate(frame, the_plan, observer=lambda state, force: None)
    assert differences(compiled, general).max() < 1e-8
