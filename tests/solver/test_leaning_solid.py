"""A leaning solid bounces alike at full order and reduced, as a beam does, on any ranks."""

import math
import time

import numpy as np
import pytest
from leaning_helpers import G, beam, plan
from mpi4py import MPI
from solids import reduced_for

from bristle.solver.bodies.floating import SETTLED, FloatingModel
from bristle.solver.bodies.reduced import flying_solid, reduce_solid
from bristle.solver.bristle import Material
from bristle.solver.contact.enforcement import Enforcement
from bristle.solver.drop import ModalFrame, simulate
from bristle.solver.errors import ComputationError
from bristle.solver.rigid import Pose
from bristle.solver.time.finite import FiniteMarcher
from bristle.solver.time.march import Marcher
from bristle.solver.time.scheme import TimeScheme

LENGTH, CELLS, ITS = 0.05, (1, 2, 24), 1e-6
MATERIAL = Material(beta_s=1e-8)


@pytest.fixture(scope="module")
def models(make_solid):
    """By stiffness-proportional damping: steel's own, and the paper's."""
    materials = (MATERIAL, Material())
    solids = (make_solid(CELLS, LENGTH, material=each) for each in materials)
    return {solid.beta_s: reduced_for(solid, ITS, leaning=True) for solid in solids}


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
        results.append(simulate(reduced_for(solid, ITS, 8, leaning=True), the_plan))
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
    model = reduced_for(solid, the_plan.its_s, leaning=True)
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


# --- the solid at finite strain: it flies in modes of small strain ---


@pytest.fixture(scope="module")
def flying(make_solid):
    """A solid that flies in modes of its own, at finite strain."""
    solid = make_solid(CELLS, LENGTH, material=MATERIAL)
    c_mass, c_stiffness = TimeScheme.average().effective(ITS, 0.0, MATERIAL.beta_s)
    return FloatingModel(**vars(flying_solid(solid, c_mass / c_stiffness, 24, leaning=True)))


def bent(model, slope):
    """Modes (q, qv) of slow bending with slopes of about so much, turning and falling."""
    omega = np.sqrt(model.modal.omega2)
    slow = np.argsort(omega)[6:12]
    q, qv = np.zeros_like(omega), np.zeros_like(omega)
    own = np.abs(model.from_modal(np.eye(omega.size)[:, slow])).max(axis=0)
    shapes = np.max(model.body.comm.allgather(own), axis=0)  # the same on each rank
    q[slow] = slope * LENGTH / (10.0 * shapes) * [1, -1, 1, 1, -1, 1]
    qv[slow] = omega[slow] * q[slow]
    qv += model.modal.rotation @ np.array([3.0, -5.0, 1.0]) - model.modal.translation[:, 2]
    return q, qv


def test_landing_ends_where_the_stress_is_that_of_the_flight(flying):
    """To what it says, slow bending included; a body that is bent too far says so."""
    q, qv = bent(flying, 0.05)
    u, v = flying.landed(q, qv)
    still = np.where(flying.modal.omega2 > 0.0, qv, 0.0)
    for found, modal in zip(flying._stress_loads(u, v), (q, still), strict=True):
        left = flying.flexibility * flying.seen(found) - modal
        energy = flying.modal.omega2 @ modal**2
        assert flying.modal.omega2 @ left**2 < SETTLED**2 * energy
    with pytest.raises(ComputationError, match="bends too far"):
        flying.landed(*bent(flying, 30.0))


def test_take_off_and_landing_lose_the_square_of_the_slope(flying):
    """There and back again, and the energy on the way; rotation of the body's axes included."""
    apart = []
    for slope in (0.02, 0.01):
        q, qv = bent(flying, slope)
        u, v = flying.landed(q, qv)
        upright = Pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
        _, again, _ = flying.launched(upright, u, v)
        size = np.sqrt(flying.modal.omega2 @ q**2)
        off = np.sqrt(flying.modal.omega2 @ (again - q) ** 2) / size
        elastic = np.where(flying.modal.omega2 > 0.0, qv, 0.0)
        _, slow = flying.landed(q, elastic)
        kept = flying.energy_J(u, slow) / (0.5 * (elastic @ elastic + size**2)) - 1.0
        apart.append((off, abs(kept)))
    (off, kept), (less_off, less_kept) = apart
    assert off < 1e-6
    assert less_off < 1e-6
    assert 3.0 < kept / less_kept < 5.0


@pytest.mark.parametrize("lean", [0.3, 0.6])
def test_a_finite_solid_states_what_its_flights_leave_out(flying, lean):
    """All that the budget lacks: the march itself conserves. Touch after touch, and after a flight
    too."""
    the_plan = plan(tilt_deg=lean, until_s=0.32, its=2e-6)
    marcher = FiniteMarcher(
        flying.body, the_plan.method, the_plan.scheme, the_plan.its_s, the_plan.gravity_m_s2
    )
    landings = []
    own = flying.landed
    flying.__dict__["landed"] = lambda *modal: landings.append(1) or own(*modal)
    result = simulate(flying, the_plan, marcher)
    del flying.__dict__["landed"]
    marcher.close()
    energy = result.energy
    assert landings
    assert abs(energy.numerical_J - energy.flight_J) < 1e-8 * energy.initial_J
    assert 1e-8 * energy.initial_J < abs(energy.flight_J) < 1e-2 * energy.initial_J


def test_what_flies_is_kept_from_run_to_run(make_solid, monkeypatch):
    """To the bit, and made again for another material."""
    made = []

    def counted(*given, **how):
        made.append(given)
        return reduce_solid(*given, **how)

    monkeypatch.setattr("bristle.solver.bodies.reduced.reduce_solid", counted)
    density = 7000.0 + time.time() % 1000.0  # a body that no run had before
    density = MPI.COMM_WORLD.bcast(density)
    material = Material(density_kg_m3=density)
    solid = make_solid(CELLS, LENGTH, material=material)
    one, other = (flying_solid(solid, 1e10, 8, leaning=True) for _ in range(2))
    assert len(made) == 1
    assert np.array_equal(one.vectors, other.vectors)
    assert np.array_equal(one.turn, other.turn)
    assert np.array_equal(one.modal.omega2, other.modal.omega2)
    assert np.array_equal(one.modal.contact.rows, other.modal.contact.rows)
    flying_solid(solid, 2e10, 8, leaning=True)
    assert len(made) == 2


def test_modes_of_flight_hold_what_leaves_an_impact(make_solid):
    """All but 1e-4 of its energy, in half the vectors of a body that touches in them."""
    solid = make_solid(CELLS, LENGTH, material=MATERIAL)
    the_plan = plan(1e8, tilt_deg=5.0, mu=0.3)
    marcher = Marcher(solid, the_plan.method, the_plan.scheme, the_plan.its_s, G)
    c_mass, c_stiffness = the_plan.scheme.effective(the_plan.its_s, 0.0, MATERIAL.beta_s)
    shift = c_mass / c_stiffness
    small = reduce_solid(solid, shift, leaning=True, flying=True)
    found = simulate(small, the_plan, marcher)
    assert 0.0 < found.energy.flight_J < 1e-4 * found.energy.initial_J
    assert small.modal.n_dofs < 0.6 * reduce_solid(solid, shift, leaning=True).modal.n_dofs
