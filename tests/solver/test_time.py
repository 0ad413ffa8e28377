"""Time scheme, march and flight against exact motion and each other."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import rate, rod
from scipy.linalg import expm

from bristle.solver.bodies.beam import beam_body
from bristle.solver.bodies.modal import ModalBody
from bristle.solver.bristle import Bristle, Material
from bristle.solver.contact.enforcement import ContactMethod, Enforcement
from bristle.solver.contact.laws import Linear
from bristle.solver.energy import marching_energy
from bristle.solver.ground import Ground, place
from bristle.solver.rigid import Pose, leaning, slope_normal
from bristle.solver.time.flight import Flight
from bristle.solver.time.march import Marcher
from bristle.solver.time.motion import flyer
from bristle.solver.time.scheme import TimeScheme
from bristle.solver.time.search import look, start_clock

pytestmark = pytest.mark.serial
SCHEMES = [
    TimeScheme.average(),
    TimeScheme.newmark(),
    TimeScheme.generalised(0.9),
    TimeScheme.generalised(0.5),
    TimeScheme.generalised(0.0),
]
G = 9.8
AWAY = ContactMethod(Linear(1.0))


def march(body, scheme, its, u, v, end, gravity=0.0, method=AWAY):
    marcher = Marcher(body, method, scheme, its, gravity)
    state = marcher.start(0.0, u, v)
    for _ in range(round(end / its)):
        state = marcher.step(state).state
    return state


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
@pytest.mark.parametrize("beta", [0.0, 0.02])
def test_second_order_in_displacement_velocity_and_acceleration(scheme, beta):
    """The first axial mode of a free rod, d'Alembert's standing wave, far above the plane."""
    body = rod(40, degree=2, beta=beta)
    omega = math.sqrt(body.omega2[1])
    start = np.zeros(len(body.omega2))
    start[1] = 1e-3
    u0 = start + 1.0 * body.translation[:, 2]
    end = 2.3
    decay = 0.5 * beta * omega**2
    ring = math.sqrt(omega**2 - decay**2)
    power = complex(-decay, ring)
    # u = Re(c e^{λt}) with u(0) = 1 and u'(0) = 0
    amount = 1e-3 * complex(1.0, -decay / ring)
    exact = [(amount * power**k * np.exp(power * end)).real for k in (0, 1, 2)]
    steps = (0.02, 0.01, 0.005)
    errors = {"u": [], "v": [], "a": []}
    for its in steps:
        state = march(body, scheme, its, u0, np.zeros_like(u0), end)
        when = end
        errors["u"].append(abs(state.u[1] - exact[0]))
        errors["v"].append(abs(state.v[1] - exact[1]))
        if not scheme.conserving:
            # generalised-alpha's acceleration belongs to the instant shifted by αf - αm
            when = end + (scheme.alpha_m - scheme.alpha_f) * its
            shifted = (amount * power**2 * np.exp(power * when)).real
            errors["a"].append(abs(state.a[1] - shifted))
    assert 1.8 < rate(steps, errors["u"]) < 2.3
    assert 1.8 < rate(steps, errors["v"]) < 2.3
    if errors["a"]:
        assert rate(steps, errors["a"]) > 1.7


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.8, 1.0])
def test_spectral_radius_at_infinite_frequency(rho):
    scheme = TimeScheme.generalised(rho)
    body = rod(4, degree=1)
    none, contact = np.zeros((1, 3)), body.contact
    contact = replace(contact, coordinates=np.zeros((1, 1)), traction=np.zeros((3, 1)))
    stiff = ModalBody("stiff", np.array([1e16]), none, none, contact, 0.0, 0.0)
    marcher = Marcher(stiff, AWAY, scheme, 1.0, 0.0)
    columns = []
    for u, v, a in np.eye(3):
        state = marcher.start(0.0, np.array([u]), np.array([v]))
        state.a, state.ma, state.ka = (np.array([a]), np.array([a]), 1e16 * np.array([a]))
        after = marcher.step(state).state
        columns.append([after.u[0], after.v[0], after.a[0]])
    # a double root at infinity: its square root of rounding limits what can be asked
    assert np.abs(np.linalg.eigvals(np.array(columns).T)).max() == pytest.approx(rho, abs=2e-2)


@pytest.mark.parametrize("beta", [0.0, 1e-3])
def test_mean_force_balances_momentum_of_the_centre_of_mass(beta):
    """Impulse minus weight is the change of momentum, to rounding, while it touches."""
    body = rod(20, degree=2, beta=beta)
    marcher = Marcher(body, ContactMethod(Linear(50.0)), TimeScheme.average(), 0.01, 0.3)
    state = marcher.start(0.0, np.zeros(len(body.omega2)), -0.1 * body.translation[:, 2])
    impulse = 0.0
    for _ in range(60):
        state, force, *_ = marcher.step(state)
        impulse += marcher.its_s * float(force.sum())
    momentum = float(body.translation[:, 2] @ state.v) + 0.1 * body.mass_kg
    assert impulse > 0.1
    assert momentum == pytest.approx(impulse - 0.3 * body.mass_kg * 0.6, abs=1e-12)


@pytest.mark.parametrize(
    "method",
    [
        ContactMethod(Linear(50.0)),
        ContactMethod(Linear(math.inf), Enforcement.NITSCHE, theta=1, gamma0=2.0),
        ContactMethod(Linear(50.0), Enforcement.NITSCHE, theta=1, gamma0=2.0),
        ContactMethod(Linear(50.0), Enforcement.AUGMENTED),
    ],
    ids=lambda m: f"{m.enforcement}-{m.law.kn_N_m:g}",
)
def test_conserving_scheme_conserves_energy_through_opening_and_closing(method):
    """Undamped, 600 steps, many touches: the total stays to rounding, whatever the step."""
    energy, touching = bounced(method, TimeScheme.average())
    assert energy == pytest.approx(np.full(601, energy[0]), rel=1e-9)
    assert np.count_nonzero(np.diff(touching.astype(int)) == 1) >= 3


def test_plain_newmark_makes_or_loses_energy_and_says_so():
    energy, _ = bounced(ContactMethod(Linear(50.0)), TimeScheme.newmark())
    assert abs(energy[-1] / energy[0] - 1.0) > 1e-6


def bounced(method, scheme):
    """A rod's energy (601,) from its fall on, and whether it touches after each of its steps."""
    body = rod(12, degree=2)
    marcher = Marcher(body, method, scheme, 0.037, 0.2)
    state = marcher.start(0.0, 0.05 * body.translation[:, 2], -0.3 * body.translation[:, 2])
    energy, touching = [marching_energy(marcher, state).total_J], [False]
    for _ in range(600):
        state, force, *_ = marcher.step(state)
        energy.append(marching_energy(marcher, state).total_J)
        touching.append(force.any())
    return np.array(energy), np.array(touching)


@given(
    omega=st.floats(1e-2, 1e4),
    zeta=st.floats(0.0, 30.0),
    t=st.floats(1e-6, 2.0),
    seed=st.integers(0, 1000),
)
@settings(max_examples=200, deadline=None)
def test_flight_of_one_mode_is_the_matrix_exponential(omega, zeta, t, seed):
    """Under-, over- and critically damped alike, a rigid motion that falls beside it."""
    u, v = np.random.default_rng(seed).normal(size=(2, 2))
    beta = 2.0 * zeta / omega
    translation = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    squares = np.array([0.0, omega**2])
    still = np.zeros((2, 3))
    body = ModalBody("two", squares, translation, still, rod(1).contact, 0.0, beta)
    flight = Flight(body, Pose.upright(), 0.0, u, v, 2.0)
    pose, got_u, got_v = flight.state(t)
    system = np.array([[0.0, 1.0], [-(omega**2), -beta * omega**2]])
    wanted = expm(system * t) @ np.array([u[1], v[1]])
    # near critical damping two nearly equal exponentials cancel to about 1e-9 of what moves
    moves = np.abs(u[1]) + np.abs(v[1]) / omega
    assert got_u[1] == pytest.approx(wanted[0], abs=1e-8 * moves)
    assert got_v[1] == pytest.approx(wanted[1], abs=1e-8 * moves * omega * max(1.0, zeta))
    assert pose.position_m[2] == pytest.approx(u[0] + v[0] * t - t * t, rel=1e-12, abs=1e-12)
    assert got_v[0] == pytest.approx(v[0] - 2.0 * t, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("alpha", [0.0, 0.7])
def test_flight_agrees_with_the_march_at_second_order(alpha):
    body = replace(rod(6, degree=2, beta=0.01), alpha_1_s=alpha)
    rng = np.random.default_rng(3)
    u = body.translation[:, 2] + 1e-3 * rng.normal(size=len(body.translation[:, 2])) / (
        1.0 + body.omega2
    )
    v = 1e-2 * rng.normal(size=len(body.translation[:, 2])) / np.sqrt(1.0 + body.omega2)
    pose, elastic, speed = Flight(body, Pose.upright(), 0.0, u, v, 0.1).state(1.0)
    exact = elastic + body.translation[:, 2] * pose.position_m[2], speed
    steps = (4e-3, 2e-3, 1e-3)
    errors = []
    for its in steps:
        state = march(body, TimeScheme.average(), its, u, v, 1.0, gravity=0.1)
        errors.append(np.abs(np.concatenate([state.u - exact[0], state.v - exact[1]])).max())
    assert rate(steps, errors) > 1.9


@pytest.mark.parametrize("beta", [0.0, 1e-5])
def test_rates_of_a_flight_are_the_slopes_of_what_it_moves(beta):
    """Of the tip's height and of the lowest clearance of a bristle that tumbles and rings."""
    body = beam_body(Bristle(material=Material(beta_s=beta)), 4)
    rng, t, step = np.random.default_rng(3), 7e-4, 1e-9
    v = rng.normal(size=len(body.omega2)) / (1.0 + 1e-4 * np.sqrt(body.omega2))
    motion = Flight(body, Pose(np.zeros(3), leaning(20.0, -9.0)), 0.0, 0.0 * v, v, G).motion
    points, tip = motion.flyer.points, motion.flyer.tip
    n = len(points.places)
    assert np.linalg.norm(motion.spin) > 10.0
    slope, offsets = np.tile(slope_normal(5.0, 3.0), (n, 1)), np.full(n, -1.0)
    up, level = np.array([[0.0, 0.0, 1.0]]), np.zeros(1)

    def at(time):
        clock = start_clock(motion)
        seen = ((tip, up, level), (points, slope, offsets))
        return np.array([look(motion, *each, clock, time, 0.0, 0.0)[:2] for each in seen])

    before, now, after = (at(time) for time in (t - step, t, t + step))
    slopes = (after[:, 0] - before[:, 0]) / (2.0 * step)
    # (ω step)²/6 at the highest frequency, and rounding over the step
    assert now[:, 1] == pytest.approx(slopes, rel=1e-6)


def test_with_nitsche_a_flight_is_clear_by_minus_the_approach(rng):
    """The traction at the tip, which its points count with, is the march's."""
    body = rod(6, degree=2, beta=0.01)
    method = ContactMethod(Linear(1.0), Enforcement.NITSCHE)
    marcher = Marcher(body, method, TimeScheme.average(), 1e-3, 0.0)
    pose = Pose(np.array([0.0, 0.0, 0.5]), leaning(0.0, 0.0))
    ground = Ground.plane(1)
    marcher.place(place(ground, pose, body.contact))
    u, v = 1e-2 * rng.normal(size=(2, len(body.omega2)))
    approach = marcher.approach(u, v)[0, 0] - marcher.ground.gaps_m[0]
    flight = Flight(body, pose, 0.0, u, v, 0.0, flyer(body, marcher.tau))
    assert marcher.tau > 0.0
    assert flight.trace(ground, np.zeros(1))[0, 2] == pytest.approx(-approach, rel=1e-9)


@pytest.mark.parametrize("bad", [-0.1, 1.1, float("nan")])
def test_impossible_spectral_radius_is_refused(bad):
    with pytest.raises(ValueError, match="rho_inf"):
        TimeScheme.generalised(bad)
