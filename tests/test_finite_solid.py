"""Is the finite-strain solid right: tangents, conservation, the linear limit, contact, ranks?"""

import math
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from bristle.meshes import geometry
from bristle.meshes.distribute import to_dolfinx
from bristle.solver.bristle import Material
from bristle.solver.errors import ComputationError, InputError
from bristle.solver.finite.contact import Plane, TipPoints, normal_force, respond, stored_J
from bristle.solver.finite.impact import impact, march_impact, seen_from_body
from bristle.solver.finite.solid import FiniteSolid
from bristle.solver.finite.step import FiniteStepper

UNDAMPED = Material(alpha_1_s=0.0, beta_s=0.0)
DAMPED = Material(alpha_1_s=30.0, beta_s=1e-6)
UP = np.array([0.0, 0.0, 1.0])
FAR = 1.0  # a plane so far below that nothing touches it


@pytest.fixture(scope="module")
def make_finite():
    made = {}

    def build(cells=(1, 1, 8), material=UNDAMPED, order=2, comm=MPI.COMM_WORLD, length_m=0.02):
        key = (cells, material, order, comm.size, length_m)
        if key not in made:
            domain, _, facets = to_dolfinx(geometry.MeshSpec(length_m, cells=cells), comm)
            made[key] = FiniteSolid(domain, facets, int(geometry.Tag.TIP), material, order)
        return made[key]

    yield build
    for solid in made.values():
        solid.close()


def plane(normal=UP, kn=2e6, kt=1.67e6, friction=0.0):
    return Plane(np.asarray(normal), kn, kt, friction)


def lifted(state, height_m=FAR):
    return replace(state, penetration_m=state.penetration_m - height_m)


def bent(solid, slope=0.4):
    """A smooth displacement with strains and rotations of the order of ``slope``."""
    x = solid.places_m / 0.02
    return (
        slope
        * 0.02
        * np.stack(
            [np.sin(2 * x[:, 2]), 0.3 * np.cos(3 * x[:, 2] + x[:, 0]), -(x[:, 2] ** 2)], -1
        ).ravel()
    )


def rotation(vector):
    angle = np.linalg.norm(vector)
    k = np.cross(np.eye(3), np.asarray(vector) / angle)
    return np.eye(3) + math.sin(angle) * k + (1 - math.cos(angle)) * k @ k


@pytest.mark.parametrize("order", [1, 2])
def test_bulk_tangent_is_the_derivative_at_large_strain(make_finite, order):
    solid = make_finite(material=DAMPED, order=order)
    its = 1e-6
    u = bent(solid)
    d, direction = 0.2 * bent(solid, 0.3)[::-1].copy(), 1e-3 * np.cos(solid.places_m.ravel() * 700)

    def force(d):
        return solid.internal_force(u, d, its) + solid.inertia_1_s2(its) * solid.mass(d)

    solid._x.array[:] = direction
    solid.tangent(u, d, its).mult(solid._x, solid._y)
    exact = solid._y.array.copy()
    errors = []
    for size in (0.2, 0.1, 0.05):
        quotient = (force(d + size * direction) - force(d - size * direction)) / (2 * size)
        rest = quotient - exact
        errors.append(math.sqrt(solid.dot(rest, rest) / solid.dot(exact, exact)))
    # the force is cubic in d: central differences are exact but for a term of second order
    assert errors[-1] < 1e-3
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.05)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.05)


# penetration before; increment; tangential elongation before
STATES = {
    "open": (-2e-6, [1e-6, 2e-6, 1e-6], [0.0, 0.0]),
    "closing": (-2e-6, [0.2e-6, 0.1e-6, -5e-6], [0.0, 0.0]),
    "stick": (4e-6, [0.3e-6, 0.2e-6, -1e-6], [1e-7, -2e-7]),
    "slip": (4e-6, [9e-6, -4e-6, -1e-6], [1e-6, 3e-7]),
    "slip while opening": (4e-6, [9e-6, -4e-6, 7e-6], [1e-6, 3e-7]),
}


@pytest.mark.parametrize("state", STATES)
def test_contact_tangent_and_energy_of_a_point(state):
    lean = rotation([0.1, 0.3, -0.2])
    ground = plane(lean @ UP, friction=0.5)
    depth, increment, elongation = STATES[state]
    s0, e0 = np.array([depth]), np.array([elongation])
    frame = np.column_stack([ground.tangents, ground.normal])
    q = np.array([frame @ increment])
    result = respond(ground, s0, e0, q)
    size = 1e-11
    for axis in range(3):
        shift = size * np.eye(3)[[axis]]
        ahead, behind = (respond(ground, s0, e0, q + s * shift).force_N for s in (1, -1))
        quotient = (ahead - behind)[0] / (2 * size)
        assert quotient == pytest.approx(result.tangent_N_m[0, :, axis], abs=1e-4 * ground.kn_N_m)
    # work on the body, stored energy and loss balance exactly
    work = float(result.force_N[0] @ q[0])
    end = stored_J(ground, result.penetration_m, result.elongation_m)[0]
    start = stored_J(ground, s0, e0)[0]
    assert work + end - start + result.loss_J[0] == pytest.approx(0.0, abs=1e-12 * (start + 1e-6))
    assert result.loss_J[0] >= 0.0
    traction = result.force_N[0] @ ground.tangents
    ratio = np.linalg.norm(traction) / (result.normal_N[0] or 1.0)
    if state.startswith("slip"):
        assert ratio == pytest.approx(0.5, rel=1e-12)
        assert result.loss_J[0] > 0.0
        assert traction @ increment[:2] < 0.0
    elif state == "open":
        assert not result.force_N.any()
    else:
        assert ratio < 0.5
        assert result.loss_J[0] == 0.0


def test_a_point_that_lets_go_loses_its_elongation():
    ground = plane(friction=0.5)
    e0 = np.array([[3e-7, 4e-7]])
    result = respond(ground, np.array([-1e-6]), e0, np.zeros((1, 3)))
    assert not result.elongation_m.any()
    assert result.loss_J[0] == pytest.approx(0.5 * ground.kt_N_m * 25e-14, rel=1e-12)


def test_normal_force_is_a_discrete_gradient():
    s = np.array([-3.0, -1e-9, 0.0, 1e-9, 1.0, 2.0])
    s0, s1 = (grid.ravel() for grid in np.meshgrid(s, s))
    force, _ = normal_force(2.0, s0, s1)
    potential = np.maximum(s1, 0.0) ** 2 - np.maximum(s0, 0.0) ** 2
    assert force * (s1 - s0) == pytest.approx(potential, abs=1e-15)
    same = s0 == s1
    assert force[same] == pytest.approx(2.0 * np.maximum(s0[same], 0.0), abs=1e-15)


def test_rigid_rotation_makes_no_stress_and_moments_of_a_spin_are_right(make_finite):
    solid = make_finite()
    turn = rotation([0.7, -1.9, 0.4])
    u = (solid.places_m @ turn.T - solid.places_m).ravel()
    none = np.zeros_like(u)
    assert solid.strain_energy_J(u) < 1e-20 * 207e9 * 2e-8
    force = solid.internal_force(u, none, 1e-6)
    assert np.abs(force).max(initial=0.0) < 1e-9 * 207e9 * 1e-6
    v = solid.rigid_velocity([1.0, 2.0, 3.0], [40.0, 0.0, 0.0])
    assert solid.mean(v) == pytest.approx([1.0, 2.0, 3.0], rel=1e-12)
    inertia = solid.mass_kg * (0.02**2 + 2.08e-3**2) / 12.0
    assert solid.angular_momentum(none, v) == pytest.approx([40.0 * inertia, 0, 0], abs=1e-12)


def test_a_tumbling_body_conserves_energy_and_both_momenta(make_finite):
    """Spin about all three axes through more than a turn, bending and stretching on the way."""
    solid = make_finite((1, 1, 6))
    its, spin = 5e-6, np.array([1500.0, 2000.0, 700.0])
    stepper = FiniteStepper(solid, plane(), np.zeros(3), its, precision=1e-12)
    v = solid.rigid_velocity([0.5, -1.0, 2.0], spin)
    v += 1.5 * np.sin(300 * solid.places_m[:, [2, 2, 0]]).ravel()
    state = lifted(stepper.touching(v))
    linear, angular = solid.mean(v), solid.angular_momentum(state.u, v)
    energy = 0.5 * solid.dot(v, solid.mass(v))
    strained = 0.0
    for _ in range(500):
        state = stepper.step(state).state
        strained = max(strained, solid.strain_energy_J(state.u))
    assert state.t_s * np.linalg.norm(spin) > 2.0 * math.pi
    assert strained > 5e-4 * energy
    total = 0.5 * solid.dot(state.v, solid.mass(state.v)) + solid.strain_energy_J(state.u)
    assert total == pytest.approx(energy, rel=1e-11)
    assert solid.mean(state.v) == pytest.approx(linear, rel=1e-10)
    assert solid.angular_momentum(state.u, state.v) == pytest.approx(
        angular, abs=1e-9 * np.linalg.norm(angular)
    )


def test_small_forces_are_those_of_the_linear_solid(make_finite, make_solid):
    solid, linear = make_finite((1, 2, 24), DAMPED), make_solid((1, 2, 24), 0.02)
    its = 1e-6
    u, d = bent(solid, 1e-8), bent(solid, 3e-9)[::-1].copy()
    middle = linear.stiffness(u + d * (0.5 + DAMPED.beta_s / its))
    rest = solid.internal_force(u, d, its) - middle
    assert math.sqrt(solid.dot(rest, rest) / solid.dot(middle, middle)) < 1e-6
    rest = solid.mass(u) - linear.mass(u)
    assert math.sqrt(solid.dot(rest, rest) / solid.dot(u, u)) < 1e-12 * solid.mass_kg


def test_first_bending_frequency_of_a_free_bar(make_finite):
    """Euler and Bernoulli's, less about 3e-3 for shear and rotary inertia at L/t = 40."""
    solid = make_finite((1, 1, 16))
    wave, radius = 4.730040744862704 / 0.02, 0.5e-3 / math.sqrt(12.0)
    omega = wave**2 * radius * UNDAMPED.bar_speed_m_s
    period = 2 * math.pi / omega
    stepper = FiniteStepper(solid, plane(), np.zeros(3), period / 200)
    z = solid.places_m[:, 2] * wave
    ratio = 0.982502214576238
    shape = np.cos(z) + np.cosh(z) - ratio * (np.sin(z) + np.sinh(z))
    v = np.zeros_like(solid.places_m)
    v[:, 0] = 1e-4 * shape
    v = v.ravel()
    momentum = solid.mass(v)
    state = lifted(stepper.touching(v))
    times, motion = [], []
    while state.t_s < 1.6 * period:
        state = stepper.step(state).state
        times.append(state.t_s)
        motion.append(solid.dot(momentum, state.u))
    t, q = np.array(times), np.array(motion)
    crossing = np.flatnonzero(q[1:] * q[:-1] < 0.0)[:2]
    zeros = t[crossing] - q[crossing] * (t[crossing + 1] - t[crossing]) / (
        q[crossing + 1] - q[crossing]
    )
    assert 2 * (zeros[1] - zeros[0]) == pytest.approx(period, rel=6e-3)


def test_tip_points_cover_the_face(make_finite):
    for order, count in ((1, 6), (2, 15)):
        points = TipPoints(make_finite((1, 2, 8), order=order))
        assert points.places_m.shape == (count, 3)
        assert points.weights.sum() == pytest.approx(1.0, rel=1e-13)
        assert points.places_m[:, 2] == pytest.approx(np.zeros(count), abs=1e-12)
        assert points.weights @ points.places_m == pytest.approx(np.zeros(3), abs=1e-12)
    second = points.weights @ points.places_m**2
    assert second[:2] == pytest.approx([0.5e-3**2 / 12, 2.08e-3**2 / 12], rel=1e-9)


def strike(solid, lean_rad, friction, scale=1.0):
    normal = seen_from_body(rotation([0.0, -lean_rad, 0.0]) if lean_rad else np.eye(3))
    stepper = FiniteStepper(
        solid, plane(normal, friction=friction), -9.8 * scale * normal, 1e-6, precision=1e-9
    )
    start = stepper.touching(solid.rigid_velocity(-scale * normal, np.zeros(3)))
    start = replace(start, penetration_m=scale * start.penetration_m)
    return march_impact(stepper, start, until_s=1e-4, clear_s=1.5e-5)


@pytest.mark.parametrize("friction", [0.0, 0.05, 0.5])
@pytest.mark.parametrize("material", [UNDAMPED, DAMPED], ids=["undamped", "damped"])
def test_energy_and_impulse_close_over_a_leaning_impact(make_finite, friction, material):
    solid = make_finite((1, 1, 12), material)
    lean = math.radians(4.0)
    result = strike(solid, lean, friction)
    assert result.clear
    assert result.n_touches >= 1
    assert result.energy.closure_relative < 1e-8
    assert (result.energy.friction_loss_J > 1e-6 * result.energy.initial_J) == (friction > 0.0)
    assert (result.energy.material_loss_J > 0.0) == (material is DAMPED)
    normal = np.array([math.sin(lean), 0.0, math.cos(lean)])
    change = result.cm_velocity_m_s - result.history.cm_velocity_m_s[0]
    impulse = result.normal_impulse_N_s * normal + result.tangential_impulse_N_s
    if material is UNDAMPED:
        weight = -9.8 * normal * result.end_s
        assert change == pytest.approx(impulse / result.mass_kg + weight, abs=1e-9)
    across = np.linalg.norm(result.tangential_impulse_N_s)
    assert across <= friction * result.normal_impulse_N_s + 1e-12


def test_a_small_upright_impact_is_the_linear_solids(make_finite, make_solid):
    """March of M, K of the linear solid with the same scheme and law, written out here."""
    solid, linear = make_finite((1, 2, 24)), make_solid((1, 2, 24), 0.02, material=UNDAMPED)
    result = strike(solid, 0.0, 0.0, scale=1e-3)
    its, points = 1e-6, TipPoints(solid)
    solve = linear.factor(2.0 / its**2, 0.5)
    lift = solid.lifts[:, 2].copy()
    weight = 9.8e-3 * linear.mass(lift)
    rows = points.rows(solid.n_local)[:, 2::3]
    bend = points.pull(solve(rows))[:, 2]
    u, v, depth = np.zeros_like(lift), -1e-3 * lift, np.zeros(len(points.weights))
    velocities = [-1e-3]
    for _ in range(result.n_steps):
        right = linear.mass(2.0 / its * v) - weight - linear.stiffness(u)
        free = solve(right)
        low = points.pull(free)[:, 2]
        d = low
        for _ in range(30):
            force, slope = normal_force(2e6, depth, depth - d)
            matrix = np.eye(len(d)) + bend * (points.weights * slope)
            d = d - np.linalg.solve(matrix, d - low - bend @ (points.weights * force))
        step = free + solve(rows @ (points.weights * normal_force(2e6, depth, depth - d)[0]))
        u, v, depth = u + step, 2.0 / its * step - v, depth - d
        velocities.append(solid.mean(v)[2])
    found = result.history.cm_velocity_m_s[:, 2]
    assert found == pytest.approx(np.array(velocities), abs=2e-8)
    assert result.speed_kept > 0.8


def test_leaning_and_speed_make_the_impact_nonlinear(make_finite):
    """With gaps scaled as the speed, a linear body's answer would not change."""
    solid = make_finite((1, 1, 24), length_m=0.05)
    lean = math.radians(5.0)
    slow, slower, fast = (strike(solid, lean, 0.0, scale=s).speed_kept for s in (2e-3, 1e-3, 1.0))
    assert slow == pytest.approx(slower, abs=1e-3)
    assert abs(fast - slow) > 20 * abs(slow - slower)


def test_ranks_do_not_matter(make_finite):
    """The same impact on this communicator and on each rank alone."""
    lean = math.radians(4.0)
    shared, alone = (
        strike(make_finite((1, 1, 12), DAMPED, comm=comm), lean, 0.3)
        for comm in (MPI.COMM_WORLD, MPI.COMM_SELF)
    )
    assert shared.n_steps == alone.n_steps
    assert shared.cm_velocity_m_s == pytest.approx(alone.cm_velocity_m_s, abs=1e-7)
    assert shared.peak_force_N == pytest.approx(alone.peak_force_N, rel=1e-6)
    assert shared.energy.friction_loss_J == pytest.approx(alone.energy.friction_loss_J, rel=1e-5)


def test_what_cannot_be_is_refused(make_finite):
    solid = make_finite()
    with pytest.raises(InputError, match="unit vector"):
        plane([0.0, 0.0, 2.0])
    with pytest.raises(InputError, match="friction"):
        plane(friction=-0.1)
    with pytest.raises(InputError, match="orthogonal"):
        seen_from_body(2.0 * np.eye(3))
    where = (solid.domain, solid.facet_tags)
    given = {
        "normal": UP, "gravity_m_s2": -9.8 * UP, "velocity_m_s": -UP, "kn_N_m": 2e6, "its_s": 1e-5
    }  # fmt: skip
    with pytest.raises(InputError, match="needs an end"):
        impact(*where, int(geometry.Tag.TIP), UNDAMPED, **given)
    with pytest.raises(ComputationError, match="tip's tag"):
        impact(*where, 77, UNDAMPED, **given, until_s=1e-5)


def test_a_step_that_is_too_long_says_so(make_finite):
    solid = make_finite()
    stepper = FiniteStepper(solid, plane(), np.zeros(3), 1e-4)
    wild = 500.0 * np.sin(5e3 * solid.places_m[:, [2, 0, 1]]).ravel()
    with pytest.raises(ComputationError, match="shorten the ITS"):
        stepper.step(lifted(stepper.touching(wild), 1e4))
