"""The finite-strain solid: conservation, linear limit, frequencies, ranks, Signorini's limit."""

import math

import numpy as np
import pytest
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from petsc4py import PETSc

from bristle.meshes.section import Circle
from bristle.solver.bristle import Material
from bristle.solver.contact.enforcement import ContactMethod, Enforcement, StepContact
from bristle.solver.contact.laws import Coulomb, Linear
from bristle.solver.energy import marching_energy
from bristle.solver.errors import ComputationError
from bristle.solver.form_cache import form
from bristle.solver.forms import StepForms, own_values
from bristle.solver.ground import Ground, just_touched, place
from bristle.solver.rigid import Pose, leaning
from bristle.solver.time import finite
from bristle.solver.time.finite import FiniteMarcher
from bristle.solver.time.march import Marcher
from bristle.solver.time.scheme import TimeScheme

G = 9.8
UNDAMPED = Material(alpha_1_s=0.0, beta_s=0.0)
DAMPED = Material(alpha_1_s=30.0, beta_s=1e-6)
FAR = 1.0  # a plane so far below that nothing touches it
LENGTH_M = 0.02


@pytest.fixture(scope="module")
def make_finite(make_solid):
    marchers = []

    def build(cells=(1, 1, 8), material=UNDAMPED, its=1e-6, method=None, **body):
        solid = make_solid(cells, material=material, **{"length_m": LENGTH_M, **body})
        how = (method or ContactMethod(Linear(2e6)), TimeScheme.average(), its, 0.0)
        marchers.append(FiniteMarcher(solid, *how))
        return marchers[-1]

    yield build
    for marcher in marchers:
        marcher.close()


def marched(marcher, v, steps):
    """So many steps of a body that begins unstrained with the velocity ``v``."""
    state, found = marcher.start(0.0, np.zeros_like(v), v), []
    for _ in range(steps):
        found.append(marcher.step(state))
        state = found[-1].state
    return found


def forces_of(marcher, steps):
    """Normal force on the tip after each."""
    weights = marcher.body.contact.weights
    return np.array([float(weights @ step.force[:, 0]) for step in steps])


def over_ground(marcher, tilt_deg=0.0, clear_m=0.0, speed_m_s=1.0):
    """Place the body over a horizontal plane; the velocity of its fall."""
    points, pose = marcher.body.contact, Pose(np.zeros(3), leaning(tilt_deg))
    ground = just_touched(Ground.plane(len(points.weights)), pose, points)
    marcher.place(place(ground, Pose(np.array([0.0, 0.0, clear_m]), pose.attitude), points))
    return marcher.body.translation @ (-speed_m_s * pose.rotation[2])


def momenta(solid, state):
    """Linear, and angular about the origin of the mesh."""
    momentum = state.mv.reshape(-1, 3)
    there = solid.places_m + state.u.reshape(-1, 3)
    local = np.concatenate([momentum.sum(axis=0), np.cross(there, momentum).sum(axis=0)])
    return np.asarray(solid.comm.allreduce(local))


def energy(marcher, state):
    return 0.5 * marcher.body.dot(state.v, state.mv) + marcher.strain_energy_J(state)


def pressed(marcher, state):
    """What the contact's spring holds."""
    depth = np.maximum(state.approach[:, 0], 0.0)
    return 0.5 * marcher.method.law.kn_N_m * float(marcher.body.contact.weights @ depth**2)


def test_a_tumbling_body_conserves_energy_and_both_momenta(make_finite):
    """Spin about all three axes through more than a turn, bending and stretching on the way."""
    marcher = make_finite((1, 1, 6), its=5e-6)
    solid, spin = marcher.solid, np.array([1500.0, 2000.0, 700.0])
    over_ground(marcher, clear_m=FAR)
    arm = solid.places_m - solid.centre_m
    v = np.array([0.5, -1.0, 2.0]) + np.cross(spin, arm)
    v += 1.5 * np.sin(300 * solid.places_m[:, [2, 2, 0]])
    state = marcher.start(0.0, np.zeros(v.size), v.ravel())
    before, start, strained = momenta(solid, state), energy(marcher, state), 0.0
    for _ in range(500):
        state = marcher.step(state).state
        strained = max(strained, marcher.strain_energy_J(state))
    assert state.t_s * np.linalg.norm(spin) > 2.0 * math.pi
    assert strained > 5e-4 * start
    assert energy(marcher, state) == pytest.approx(start, rel=1e-9)
    after = momenta(solid, state)
    for part in (slice(0, 3), slice(3, 6)):
        assert np.abs((after - before)[part]).max() < 1e-9 * np.linalg.norm(before[part])


@pytest.mark.parametrize("tilt_deg", [0.0, 4.0])
def test_an_impact_without_loss_keeps_energy_and_momenta(make_finite, tilt_deg):
    """What the plane's forces bring is their sum and moment; all else is conserved."""
    marcher = make_finite((1, 2, 12))
    solid = marcher.solid
    v = over_ground(marcher, tilt_deg)
    state = marcher.start(0.0, np.zeros_like(v), v)
    start, before, pushed = energy(marcher, state), momenta(solid, state), np.zeros(6)
    places = solid.contact.places_m + solid.centre_m
    for _ in range(40):
        moved = solid.contact.displacements(state.u)
        step = marcher.step(state)
        state, force = step.state, step.force
        assert step.friction_loss_J == step.contact_loss_J == 0.0
        push = solid.contact.weights[:, None] * marcher.along_axes(force)
        middle = places + 0.5 * (moved + solid.contact.displacements(state.u))
        sums = np.concatenate([push.sum(axis=0), np.cross(middle, push).sum(axis=0)])
        pushed += marcher.its_s * sums
    total = energy(marcher, state) + pressed(marcher, state)
    assert total == pytest.approx(start, rel=1e-9)
    rest = momenta(solid, state) - before - pushed
    size = np.linalg.norm(before[:3])
    assert np.abs(rest[:3]).max() < 1e-9 * size
    assert np.abs(rest[3:]).max() < 1e-9 * size * LENGTH_M


@pytest.mark.parametrize("mu", [0.0, 0.05, 0.5])
@pytest.mark.parametrize("enforcement", [Enforcement.PENALTY, Enforcement.NITSCHE])
def test_energy_closes_over_a_damped_leaning_impact(make_finite, mu, enforcement):
    method = ContactMethod(Linear(2e6), enforcement, friction=Coulomb(mu))
    marcher = make_finite((1, 1, 12), DAMPED, method=method)
    v = over_ground(marcher, 4.0)
    state = marcher.start(0.0, np.zeros_like(v), v)
    start, rubbed, damped = marching_energy(marcher, state).total_J, 0.0, 0.0
    for _ in range(40):
        before = state
        step = marcher.step(before)
        state = step.state
        rubbed += step.friction_loss_J
        damped += marcher.damping_loss_J(before, state, step.force)
    left = start - marching_energy(marcher, state).total_J - rubbed - damped
    assert abs(left) < 1e-9 * start
    assert damped > 0.0
    assert (rubbed > 1e-6 * start) == (mu > 0.0)


def test_slow_impacts_are_the_linear_solids(make_finite):
    """Second order in the speed is all that differs, where the solid stands upright."""
    apart = []
    for speed in (1e-2, 1e-3):
        velocities = []
        for kind in ("finite", "linear"):
            marcher = make_finite((1, 2, 24))
            if kind == "linear":
                how = (marcher.method, marcher.scheme, marcher.its_s, marcher.gravity_m_s2)
                marcher = Marcher(marcher.solid, *how)
            v = over_ground(marcher, speed_m_s=speed)
            velocities.append(marched(marcher, v, 30)[-1].state.v / speed)
        apart.append(np.abs(velocities[0] - velocities[1]).max())
    assert apart[1] < 1e-4
    assert apart[0] / apart[1] == pytest.approx(10.0, rel=0.2)


def test_first_bending_frequency_of_a_free_bar(make_finite):
    """Euler and Bernoulli's, less about 3e-3 for shear and rotary inertia at L/t = 40."""
    wave, radius = 4.730040744862704 / LENGTH_M, 0.5e-3 / math.sqrt(12.0)
    omega = wave**2 * radius * UNDAMPED.bar_speed_m_s
    period = 2 * math.pi / omega
    marcher = make_finite((1, 1, 16), its=period / 200)
    solid = marcher.solid
    over_ground(marcher, clear_m=FAR)
    z = solid.places_m[:, 2] * wave
    ratio = 0.982502214576238
    v = np.zeros_like(solid.places_m)
    v[:, 0] = 1e-4 * (np.cos(z) + np.cosh(z) - ratio * (np.sin(z) + np.sinh(z)))
    state = marcher.start(0.0, np.zeros(v.size), v.ravel())
    momentum, times, motion = solid.mass(v.ravel()), [], []
    while state.t_s < 1.6 * period:
        state = marcher.step(state).state
        times.append(state.t_s)
        motion.append(solid.dot(momentum, state.u))
    t, q = np.array(times), np.array(motion)
    crossing = np.flatnonzero(q[1:] * q[:-1] < 0.0)[:2]
    zeros = t[crossing] - q[crossing] * (t[crossing + 1] - t[crossing]) / (
        q[crossing + 1] - q[crossing]
    )
    assert 2 * (zeros[1] - zeros[0]) == pytest.approx(period, rel=6e-3)


def test_leaning_and_speed_make_the_impact_nonlinear(make_finite):
    """With gaps scaled as the speed, a linear body's answer would not change."""

    def kept(scale):
        marcher = make_finite((1, 1, 24), length_m=0.05)
        points, pose = marcher.body.contact, Pose(np.zeros(3), leaning(5.0))
        ground = just_touched(Ground.plane(len(points.weights)), pose, points)
        placed = place(ground, pose, points)
        placed.gaps_m[:] *= scale
        marcher.place(placed)
        v = marcher.body.translation @ (-scale * pose.rotation[2])
        momentum = marched(marcher, v, 60)[-1].state.mv
        return marcher.solid.dot(marcher._lift, momentum) / marcher.solid.mass_kg / scale

    slow, slower, fast = kept(2e-3), kept(1e-3), kept(1.0)
    assert slow == pytest.approx(slower, abs=1e-3)
    assert abs(fast - slow) > 20 * abs(slow - slower)


def test_signorinis_limit_of_an_upright_bar(make_finite):
    """Nitsche at Kn = ∞: the force ρ c A v for 2 L / c, then full rebound, as cells get finer.

    Poisson's ratio is zero, so that the bar is one-dimensional. The mesh disperses the wave's front
    over a width that shrinks as the cell to the power 2/3, and with it what rings on.
    """
    material, speed = Material(poisson=0.0, beta_s=0.0), 0.5
    method = ContactMethod(Linear(math.inf), Enforcement.NITSCHE)
    period = 2.0 * LENGTH_M / material.bar_speed_m_s
    held = material.density_kg_m3 * material.bar_speed_m_s * 0.5e-3 * 2.08e-3 * speed
    missing = []
    for n in (20, 40):
        marcher = make_finite((1, 1, n), material, 8e-6 / n, method)
        v = over_ground(marcher, speed_m_s=speed)
        steps = marched(marcher, v, math.ceil(1.3 * period / marcher.its_s))
        forces = forces_of(marcher, steps)
        middle = forces[len(forces) // 5 : len(forces) // 2]
        assert np.mean(middle) == pytest.approx(held, rel=0.01)
        lasted = marcher.its_s * np.flatnonzero(forces)[-1]
        assert lasted == pytest.approx(period, rel=0.6 * n ** (-2 / 3))
        solid = marcher.solid
        rebound = solid.dot(marcher._lift, steps[-1].state.mv) / solid.mass_kg / speed
        missing.append(1.0 - rebound)
    assert 0.0 < missing[1] < 0.06
    assert missing[0] / missing[1] == pytest.approx(2.0 ** (2 / 3), rel=0.25)


def test_ranks_do_not_matter(make_finite):
    """The same impact on this communicator and on each rank alone."""
    found = []
    for comm in (MPI.COMM_WORLD, MPI.COMM_SELF):
        method = ContactMethod(Linear(2e6), friction=Coulomb(0.3))
        marcher = make_finite((1, 1, 12), DAMPED, method=method, comm=comm)
        steps = marched(marcher, over_ground(marcher, 4.0), 20)
        forces = np.array([marcher.body.contact.weights @ step.force for step in steps])
        found.append((forces, momenta(marcher.solid, steps[-1].state)))
    (forces, momentum), (alone, expected) = found
    assert np.abs(forces - alone).max() < 1e-8 * np.abs(alone).max()
    assert np.abs(momentum[:3] - expected[:3]).max() < 1e-8 * np.abs(expected[:3]).max()


def test_a_march_goes_on_to_the_bit(make_finite, rng):
    """State, contact's memory and the factor in use are all that the next step needs."""
    method = ContactMethod(Linear(2e6), friction=Coulomb(0.3))
    marcher = make_finite((1, 1, 12), DAMPED, method=method)
    v = over_ground(marcher, 4.0)
    state = marched(marcher, v, 8)[-1].state
    marcher._linearise(state.u, marcher.its_s * state.v)  # as a step does that is hard to solve
    kept, memory = marcher.contact.kept(), marcher.memory()
    kept = {name: np.array(value) for name, value in kept.items()}
    onward = marcher.step(state).state
    other = make_finite((1, 1, 12), DAMPED, method=method)
    over_ground(other, 4.0)
    other.recall(memory)
    other.contact.recall(kept)
    assert np.array_equal(other._tangent.solve(v), marcher._tangent.solve(v))
    assert np.array_equal(other._compliance, marcher._compliance)
    again = other.step(state).state
    assert np.array_equal(again.u, onward.u)
    assert np.array_equal(again.v, onward.v)
    heap = []
    for _ in range(60):  # wherever in memory its vectors come to lie
        heap[:] = [np.empty(size) for size in rng.integers(1, 9000, 30)]
        marcher.contact.recall(kept)
        assert np.array_equal(marcher.step(state).state.u, onward.u)


def test_contact_forces_converge_where_the_increment_does_not_tell_of_them(
    make_finite, monkeypatch
):
    """An increment that is mostly rigid motion has arrived long before the forces have."""
    histories = []
    for precision in (finite.PRECISION, 1e-2):
        monkeypatch.setattr(finite, "PRECISION", precision)
        marcher = make_finite(method=ContactMethod(Linear(1e8)))
        steps = marched(marcher, over_ground(marcher, 4.0), 25)
        histories.append(forces_of(marcher, steps))
    exact, found = histories
    assert np.abs(found - exact).max() < finite.FORCE_PRECISION * exact.max()


@pytest.mark.parametrize("geometry_order", [1, 2])
def test_finite_strain_has_the_small_limit_on_curved_cells_too(make_solid, rng, geometry_order):
    """Stiffness and mass of both to rounding, and the load of a small displacement's stress."""
    section, its = Circle(1e-3), 1e-6
    how = {"section": section, "material": UNDAMPED, "geometry_order": geometry_order}
    solid = make_solid((2, 2, 4), LENGTH_M, **how)
    forms = StepForms(solid.space, UNDAMPED, finite=True)
    forms.its.value = its
    x = rng.normal(size=solid.n_local)
    tangent = fem_petsc.assemble_matrix(form(forms.tangent()))
    tangent.assemble()
    small = solid.effective_matrix(2.0 / its**2, 0.5)
    apart = tangent.copy()
    apart.axpy(-1.0, small)
    assert apart.norm() < 1e-12 * small.norm()
    for matrix in (tangent, small, apart):
        matrix.destroy()
    own_values(forms.u, 1e-12 * x)
    load = fem_petsc.assemble_vector(form(forms.stress_load()))
    load.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    linear = solid.stiffness(1e-12 * x)
    assert np.abs(load.array - linear).max() < 1e-7 * np.abs(linear).max()
    load.destroy()


@pytest.mark.skipif(MPI.COMM_WORLD.size == 1, reason="needs ranks that round otherwise")
@pytest.mark.parametrize("kind", [FiniteMarcher, Marcher])
def test_ranks_that_round_otherwise_march_as_rank_0(make_finite, monkeypatch, kind):
    """As on another kind of node: what is not zero there is no reason for a solve of its own."""
    marcher = make_finite((1, 1, 12))
    if kind is Marcher:
        monkeypatch.setattr("bristle.solver.time.march.MOST_KEPT", 0)  # it solves where it touches
        how = (marcher.method, marcher.scheme, marcher.its_s, marcher.gravity_m_s2)
        marcher = Marcher(marcher.body, *how)
    v = over_ground(marcher, 4.0, clear_m=3e-6)
    solve = StepContact.solve
    if MPI.COMM_WORLD.rank == 1:
        monkeypatch.setattr(StepContact, "solve", lambda *given: solve(*given) + 1e-13)
    forces = np.array([step.force for step in marched(marcher, v, 8)])
    every = MPI.COMM_WORLD.allgather(forces)
    assert all(np.array_equal(each, every[0]) for each in every)
    assert np.any(every[0])


def test_what_cannot_be_marched_is_refused(make_finite):
    solid = make_finite().solid
    with pytest.raises(ComputationError, match="conserving"):
        FiniteMarcher(solid, ContactMethod(Linear(2e6)), TimeScheme.newmark(), 1e-6, G)


def test_a_step_that_is_too_long_says_so(make_finite):
    marcher = make_finite(its=1e-4)
    over_ground(marcher, clear_m=FAR)
    wild = 500.0 * np.sin(5e3 * marcher.solid.places_m[:, [2, 0, 1]]).ravel()
    with pytest.raises(ComputationError, match="shorten the ITS"):
        marcher.step(marcher.start(0.0, np.zeros_like(wild), wild))
